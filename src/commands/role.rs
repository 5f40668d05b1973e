//! What cameras are for.

/// The cameras that commands tell apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum CameraRole {
    PitchYaw,
    Roll,
    Moon,
}

impl CameraRole {
    pub const COUNT: usize = 3;
}
