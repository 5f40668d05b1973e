//! The request for the Moon, and its answers: request and response as in "The Development of a Moon Sensor" (2005, section 4.3.4).

use super::fields::{MessageError, Reader, Writer};
use crate::units::{Place, PlaceError};
use jiff::Timestamp;

/// The keys of these messages.
pub const REQUEST: u16 = 0x1010;
pub const FOUND: u16 = 0x1110;
pub const NOT_VISIBLE_KEY: u16 = 0x1111;
pub const NOT_FOUND_KEY: u16 = 0x1112;

/// The platform asks where the Moon is, and says where it is itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MoonRequest {
    pub latitude_deg: f64,
    /// East positive.
    pub longitude_deg: f64,
    /// Above the WGS 84 ellipsoid.
    pub height_m: f64,
}

impl MoonRequest {
    /// The platform's place.
    ///
    /// # Errors
    /// Coordinates out of range.
    pub fn place(&self) -> Result<Place, PlaceError> {
        Place::new(self.latitude_deg, self.longitude_deg, self.height_m)
    }

    pub(super) fn write(&self, out: &mut Writer) -> Result<(), MessageError> {
        out.f64("latitude", self.latitude_deg)?;
        out.f64("longitude", self.longitude_deg)?;
        out.f64("height", self.height_m)
    }

    pub(super) fn read(input: &mut Reader) -> Result<Self, MessageError> {
        Ok(Self {
            latitude_deg: input.f64("latitude")?,
            longitude_deg: input.f64("longitude")?,
            height_m: input.f64("height")?,
        })
    }
}

/// What a request is answered with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MoonAnswer {
    /// The sequence number of the request's packet.
    pub request: u16,
    pub sight: MoonSight,
}

/// What is known of the Moon after a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum MoonSight {
    Found(MoonFix),
    /// The ephemeris has it where it cannot be seen; the number is one of [`NOT_VISIBLE`].
    NotVisible {
        code: u16,
    },
    /// It should be in the picture and is not found; the number is one of [`NOT_FOUND`].
    NotFound {
        code: u16,
    },
}

/// Where the Moon was found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MoonFix {
    /// Of the whole disc's centre, px.
    pub x_px: f64,
    pub y_px: f64,
    /// xx, xy and yy, px^2.
    pub covariance_px2: [f64; 3],
    /// Unit vector in the camera's axes: x right, y down, z forward.
    pub direction: [f64; 3],
    /// Mid-exposure; sent to the nearest millisecond.
    pub time: Timestamp,
}

pub const BELOW_HORIZON: u16 = 1;
pub const NEAR_SUN: u16 = 2;
/// Why the Moon cannot be seen: code, name, meaning.
#[rustfmt::skip] // One row, one line.
pub const NOT_VISIBLE: &[(u16, &str, &str)] = &[
    (BELOW_HORIZON, "below_horizon", "it is below the Earth's limb"),
    (NEAR_SUN, "near_sun", "it is too near to the Sun, and the Sun is up (`moon.clear_of_sun_deg`)"),
];

pub const NO_PICTURE: u16 = 1;
pub const WRONG_SIZE: u16 = 2;
/// The stages of the solver follow in their order.
pub const FIRST_STAGE: u16 = 3;
/// Why the Moon is not found: code, name, meaning.
#[rustfmt::skip] // One row, one line.
pub const NOT_FOUND: &[(u16, &str, &str)] = &[
    (NO_PICTURE, "no_picture", "no picture that was begun after the request came in time (`moon.answer_within_s`)"),
    (WRONG_SIZE, "wrong_size", "the picture is of another size than the camera's file states"),
    (FIRST_STAGE, "light", "light: the picture is bright all over"),
    (FIRST_STAGE + 1, "detection", "detection: no light is as large as the Moon"),
    (FIRST_STAGE + 2, "limb", "limb: no circle fits the light's edge"),
    (FIRST_STAGE + 3, "checks", "checks: the light has another size, shape or phase than the Moon now has"),
];

impl MoonSight {
    pub(super) fn key(&self) -> u16 {
        match self {
            Self::Found(_) => FOUND,
            Self::NotVisible { .. } => NOT_VISIBLE_KEY,
            Self::NotFound { .. } => NOT_FOUND_KEY,
        }
    }
}

impl MoonAnswer {
    pub(super) fn write(&self, out: &mut Writer) -> Result<(), MessageError> {
        out.u16(self.request);
        match self.sight {
            MoonSight::NotVisible { code } | MoonSight::NotFound { code } => out.u16(code),
            MoonSight::Found(fix) => {
                out.f64("x", fix.x_px)?;
                out.f64("y", fix.y_px)?;
                for value in fix.covariance_px2 {
                    out.f64("covariance", value)?;
                }
                for value in fix.direction {
                    out.f64("direction", value)?;
                }
                out.time_to_millisecond(fix.time)?;
            }
        }
        Ok(())
    }

    pub(super) fn read(input: &mut Reader) -> Result<Self, MessageError> {
        let request = input.u16()?;
        let sight = match input.key() {
            NOT_VISIBLE_KEY => MoonSight::NotVisible { code: input.u16()? },
            NOT_FOUND_KEY => MoonSight::NotFound { code: input.u16()? },
            _ => MoonSight::Found(MoonFix {
                x_px: input.f64("x")?,
                y_px: input.f64("y")?,
                covariance_px2: three(input, "covariance")?,
                direction: three(input, "direction")?,
                time: input.time_to_millisecond()?,
            }),
        };
        Ok(Self { request, sight })
    }
}

fn three(input: &mut Reader, field: &'static str) -> Result<[f64; 3], MessageError> {
    Ok([input.f64(field)?, input.f64(field)?, input.f64(field)?])
}
