//! Requests for the Moon and their answers, as in "The Development of a Moon Sensor" (2005, section 4.3.4).

use super::fields::{Milliseconds, fields};
use super::number::Codes;
use jiff::Timestamp;

fields! {
    /// Position and direction of the Moon in a picture.
    MoonFix, format!("found at {x_px} {y_px} px, towards {direction:?}, at {time}") => {
        x_px: f64, "px", "the disc's centre";
        y_px: f64, "px", "the disc's centre";
        /// Covariance of the centre, px^2: xx, xy and yy.
        covariance_px2: [f64; 3] [
            "covariance_xx_px2", "px^2", "covariance of the centre";
            "covariance_xy_px2", "px^2", "covariance of the centre";
            "covariance_yy_px2", "px^2", "covariance of the centre";
        ];
        /// Unit vector in the camera's axes: x right, y down, z forward.
        direction: [f64; 3] [
            "direction_x", "", "unit vector in the camera's axes, to the right";
            "direction_y", "", "down";
            "direction_z", "", "forward";
        ];
        /// Mid-exposure; sent to the nearest millisecond.
        time: Timestamp as Milliseconds [
            "seconds", "s", "mid-exposure, UTC since 1970";
            "milliseconds", "ms", "of its time";
        ];
    }
}

/// Answer to a request.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MoonAnswer {
    /// The sequence number of the request's packet.
    pub request: u16,
    pub outcome: MoonOutcome,
}

/// Result for the Moon in a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum MoonOutcome {
    Found(MoonFix),
    /// By the ephemeris the Moon cannot be seen; the number is one of [`NOT_VISIBLE`].
    NotVisible {
        code: u16,
    },
    /// It should be in the picture and was not found; the number is one of [`NOT_FOUND`].
    NotFound {
        code: u16,
    },
}

pub const BELOW_HORIZON: u16 = 1;
pub const NEAR_SUN: u16 = 2;
/// Reasons why the Moon cannot be seen.
#[rustfmt::skip] // One row, one line.
pub static NOT_VISIBLE: Codes = Codes { name: "not_visible_code", rows: &[
    (BELOW_HORIZON, "below_horizon", "it is below the Earth's limb"),
    (NEAR_SUN, "near_sun", "it is too near to the Sun, and the Sun is up (`moon.clear_of_sun_deg`)"),
] };

pub const NO_PICTURE: u16 = 1;
pub const WRONG_SIZE: u16 = 2;
/// Code of the solver's first stage; the other stages follow in their order.
pub const FIRST_STAGE: u16 = 3;
/// Reasons why the Moon is not found.
#[rustfmt::skip] // One row, one line.
pub static NOT_FOUND: Codes = Codes { name: "not_found_code", rows: &[
    (NO_PICTURE, "no_picture", "no picture that was begun after the request came in time (`moon.answer_within_s`)"),
    (WRONG_SIZE, "wrong_size", "the picture is of another size than the camera's file states"),
    (FIRST_STAGE, "light", "light: the picture is bright all over"),
    (FIRST_STAGE + 1, "detection", "detection: no light is as large as the Moon"),
    (FIRST_STAGE + 2, "limb", "limb: no circle fits the light's edge"),
    (FIRST_STAGE + 3, "checks", "checks: the light has another size, shape or phase than the Moon now has"),
] };
