//! Positions with their reference frame in the type, values with their uncertainty, and the observer's place.
//!
//! A position on the sensor and one on the plate have different types, so that mixing them does not compile.

use nalgebra::{Matrix2, Vector2};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;
use std::str::FromStr;

/// One mil, the unit of the plate, in millimetres.
pub const MIL_MM: f64 = 0.0254;

/// Arc seconds in one radian.
pub const ARCSEC_PER_RAD: f64 = 180.0 * 3600.0 / std::f64::consts::PI;

/// The Earth's mean radius, m.
pub const EARTH_RADIUS_M: f64 = 6_371_000.0;

/// A place nearer than this to latitude and longitude 0 is that of a receiver without a fix, deg.
const NOWHERE_DEG: f64 = 0.1;

/// Whether latitude and longitude are both about 0: sent by a GPS receiver that has no position.
pub fn is_nowhere(latitude_deg: f64, longitude_deg: f64) -> bool {
    latitude_deg.abs() < NOWHERE_DEG && longitude_deg.abs() < NOWHERE_DEG
}

/// A count with its noun: "1 packet", "2 packets". The noun's plural ends in s.
pub fn counted(count: u64, noun: &str) -> String {
    let ending = if count == 1 { "" } else { "s" };
    format!("{count} {noun}{ending}")
}

/// A position on the sensor, px. Pixel (0, 0) is the centre of the first pixel; y grows down the rows.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SensorPx {
    pub x: f64,
    pub y: f64,
}

/// A position on the fiducial plate, mil from the plate's centre.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PlateMil {
    pub x: f64,
    pub y: f64,
}

macro_rules! plane_position {
    ($name:ident) => {
        impl $name {
            pub const fn new(x: f64, y: f64) -> Self {
                Self { x, y }
            }

            /// The position as a vector, in the unit of the type.
            pub fn vector(self) -> Vector2<f64> {
                Vector2::new(self.x, self.y)
            }

            /// Distance to another position, in the unit of the type.
            pub fn distance(self, other: Self) -> f64 {
                (self.x - other.x).hypot(self.y - other.y)
            }
        }

        impl From<Vector2<f64>> for $name {
            fn from(v: Vector2<f64>) -> Self {
                Self::new(v.x, v.y)
            }
        }
    };
}

plane_position!(SensorPx);
plane_position!(PlateMil);

/// A value with its 1-sigma uncertainty, both in the same unit; serialised as the pair.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Measured {
    pub value: f64,
    pub sigma: f64,
}

impl Measured {
    pub const fn new(value: f64, sigma: f64) -> Self {
        Self { value, sigma }
    }

    /// The value and its sigma multiplied by a factor.
    pub fn scaled(self, by: f64) -> Self {
        Self::new(self.value * by, self.sigma * by.abs())
    }
}

impl<'de> Deserialize<'de> for Measured {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let [value, sigma] = Deserialize::deserialize(deserializer)?;
        Ok(Self { value, sigma })
    }
}

impl Serialize for Measured {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        [self.value, self.sigma].serialize(serializer)
    }
}

/// A position with the covariance of its two coordinates, in the unit of the position, squared.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Estimate<P> {
    pub position: P,
    pub covariance: Matrix2<f64>,
}

impl<P> Estimate<P> {
    /// 1-sigma of x and y, in the unit of the position.
    pub fn sigma(&self) -> [f64; 2] {
        self.variance().map(f64::sqrt)
    }

    /// Variance of x and y, in the square of that unit.
    pub fn variance(&self) -> [f64; 2] {
        [0, 1].map(|axis| self.covariance[(axis, axis)].max(0.0))
    }
}

/// A reason: its stable code for programs, and a sentence for people.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Reason {
    /// Code in snake case.
    pub code: &'static str,
    pub sentence: &'static str,
}

/// An expected rejection: the reason, the measured value and the limit that it failed. It is data, not an error: a frame
/// without a Sun is not a failure of the program.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Rejected {
    pub reason: Reason,
    pub measured: f64,
    pub limit: f64,
}

impl fmt::Display for Reason {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(self.sentence)
    }
}

impl Rejected {
    pub fn new(reason: Reason, measured: f64, limit: f64) -> Self {
        Self {
            reason,
            measured,
            limit,
        }
    }

    /// Rejects a measured value that is below a limit, or NaN.
    pub fn at_least(limit: f64, measured: f64, reason: Reason) -> Result<(), Self> {
        Self::unless(measured >= limit, limit, measured, reason)
    }

    /// Rejects a measured value that is above a limit, or NaN.
    pub fn at_most(limit: f64, measured: f64, reason: Reason) -> Result<(), Self> {
        Self::unless(measured <= limit, limit, measured, reason)
    }

    fn unless(holds: bool, limit: f64, measured: f64, reason: Reason) -> Result<(), Self> {
        holds
            .then_some(())
            .ok_or(Self::new(reason, measured, limit))
    }
}

/// The observer's place: geodetic (WGS 84) latitude and longitude, east positive, and height.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    pub latitude_deg: f64,
    pub longitude_deg: f64,
    pub height_m: f64,
}

/// Why a place was rejected.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PlaceError {
    #[error("expected LAT,LON,HEIGHT_M (deg, deg, m), found \"{0}\"")]
    Format(String),
    #[error("expected a latitude from -90 to 90 deg, found {0}")]
    Latitude(f64),
    #[error("expected a longitude from -180 to 360 deg, found {0}")]
    Longitude(f64),
    #[error("expected a height from -1000 to 2000000 m, found {0}")]
    Height(f64),
}

impl Place {
    /// A place whose coordinates are checked against their ranges.
    pub fn new(latitude_deg: f64, longitude_deg: f64, height_m: f64) -> Result<Self, PlaceError> {
        if !(-90.0..=90.0).contains(&latitude_deg) {
            return Err(PlaceError::Latitude(latitude_deg));
        }
        if !(-180.0..=360.0).contains(&longitude_deg) {
            return Err(PlaceError::Longitude(longitude_deg));
        }
        if !(-1000.0..=2_000_000.0).contains(&height_m) {
            return Err(PlaceError::Height(height_m));
        }
        Ok(Self {
            latitude_deg,
            longitude_deg,
            height_m,
        })
    }
}

impl FromStr for Place {
    type Err = PlaceError;

    fn from_str(text: &str) -> Result<Self, PlaceError> {
        let numbers: Option<Vec<f64>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
        match numbers.as_deref() {
            Some([latitude, longitude, height]) => Self::new(*latitude, *longitude, *height),
            _ => Err(PlaceError::Format(text.into())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_is_read_from_three_numbers_and_refused_outside_its_ranges() {
        let place: Place = "34.49,-104.2218,38405".parse().unwrap();
        assert_eq!(place.longitude_deg, -104.2218);
        assert_eq!("91,0,0".parse::<Place>(), Err(PlaceError::Latitude(91.0)));
        assert!("34.49,-104".parse::<Place>().is_err());
        assert!("NaN,0,0".parse::<Place>().is_err());
    }
}
