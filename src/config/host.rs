//! Requests to the operating system.

/// Nothing unless set: a flight must not fail, nor a laptop become unresponsive, for lack of a privilege.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Host {
    /// Real-time priority of the solvers; other threads between frame and packet have one more. `None` if all threads are scheduled normally.
    pub realtime_priority: Option<u8>,
    pub memory: Memory,
}

/// Handling of the program's memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Memory {
    /// The operating system may swap it out.
    #[default]
    Swappable,
    Locked,
}

impl Memory {
    pub const KINDS: [Self; 2] = [Self::Swappable, Self::Locked];
    pub const NAMES: &'static [&'static str] = &["swappable", "locked"];

    pub fn name(self) -> &'static str {
        match self {
            Self::Swappable => "swappable",
            Self::Locked => "locked",
        }
    }
}
