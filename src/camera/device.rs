//! A camera that Aravis opens, with the name that the user gives it.

use std::fmt;

/// Aravis's id of the fake device that it contains. It shows a test picture.
const FAKE: &str = "Fake_1";

/// A camera, by its kind and name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Device {
    /// A GigE Vision camera, by IP address, serial number or Aravis's id.
    Gige(String),
    /// Any camera that Aravis opens, by its id, its serial number or, for GigE Vision, its IP address.
    Genicam(String),
}

impl Device {
    /// The name without the prefix.
    pub fn id(&self) -> &str {
        match self {
            Self::Gige(id) | Self::Genicam(id) => id,
        }
    }

    /// Whether it is Aravis's fake device.
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
