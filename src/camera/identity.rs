//! Identity of a camera of a flight.

use crate::instrument::role::of_several;
use crate::instrument::{Instrument, Role, Sees};
use std::path::PathBuf;

/// A camera of a flight.
#[derive(Debug, Clone, PartialEq)]
pub struct Camera {
    /// Name of its table in the configuration.
    pub name: String,
    pub role: Role,
    pub sees: Sees,
    /// Verbatim text of its calibration file; `None` without one.
    pub toml: Option<String>,
    /// Label of its frames and logs, and name of its instrument in headers.
    pub label: String,
    /// Folder of its frames and logs under the archive's root; empty for the root itself.
    pub folder: PathBuf,
}

impl Camera {
    /// The first camera of its role. A camera that sees no plate has a folder of its own.
    pub fn new(name: &str, role: Role, sees: Sees) -> Self {
        let label = role.label(1);
        let folder = label.as_deref().unwrap_or_default().into();
        let instrument = sees.plate().map(|instrument| instrument.name.clone());
        Self {
            name: name.into(),
            role,
            label: label.or(instrument).unwrap_or_else(|| name.into()),
            folder,
            sees,
            toml: None,
        }
    }

    /// The first pitch-yaw camera.
    pub fn of_plate(instrument: Instrument) -> Self {
        Self::new("camera", Role::PitchYaw, Sees::Plate(Box::new(instrument)))
    }
}

/// Labels cameras that fly together so that the folders named by the labels differ.
pub fn give_names(cameras: &mut [Camera], folder: impl Fn(&str) -> String) {
    for index in 0..cameras.len() {
        let (before, rest) = cameras.split_at_mut(index);
        let camera = &mut rest[0];
        let shared = camera.label.clone();
        let is_taken = |label: &String| {
            before
                .iter()
                .any(|other| folder(&other.label) == folder(label))
        };
        let labels = (1..).map(|ordinal| of_several(&shared, ordinal));
        camera.label = { labels }.find(|label| !is_taken(label)).unwrap_or(shared);
        if let Sees::Plate(instrument) = &mut camera.sees {
            instrument.name.clone_from(&camera.label);
        }
    }
}
