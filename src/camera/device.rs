//! A camera that Aravis opens, as the user names it.

use std::fmt;

/// The device that Aravis carries within itself, by the id that Aravis gives it. It shows a test picture.
const FAKE: &str = "Fake_1";

/// A camera, by how it is found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Device {
    /// A GigE Vision camera, by IP address, serial number or Aravis's id.
    Gige(String),
    /// Any camera that Aravis opens, by its id, its serial number or, of GigE Vision, its IP address.
    Genicam(String),
}

impl Device {
    /// Without the word in front.
    pub fn id(&self) -> &str {
        match self {
            Self::Gige(id) | Self::Genicam(id) => id,
        }
    }

    /// Whether it is no camera, but Aravis's fake device.
    pub fn is_fake(&self) -> bool {
        *self == Self::Genicam(FAKE.into())
    }
}

impl fmt::Display for Device {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Gige(id) => write!(out, "gige:{id}"),
            Self::Genicam(id) => write!(out, "genicam:{id}"),
        }
    }
}
