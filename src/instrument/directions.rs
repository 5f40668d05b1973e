//! Reference point of directions on the plate relative to the zenith.

use serde::Deserialize;

/// Point at which directions on the plate are related to the zenith. The zenith's direction at the Sun is not parallel to
/// that at the telescope: the two rules give the same pointing with the Sun at the boresight, and at an angle a from it
/// differ by up to about a^2 tan(elevation).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
pub enum Directions {
    /// At the telescope, in which the plate is fixed.
    #[serde(rename = "telescope")]
    Telescope,
    /// At the Sun, as the HEROES flight program of 2013 did.
    #[serde(rename = "sun-2013")]
    Sun2013,
}

impl Directions {
    pub const ALL: [Self; 2] = [Self::Telescope, Self::Sun2013];

    /// The rule's name in an instrument's file and in a frame's keywords.
    pub fn name(self) -> &'static str {
        match self {
            Self::Telescope => "telescope",
            Self::Sun2013 => "sun-2013",
        }
    }
}
