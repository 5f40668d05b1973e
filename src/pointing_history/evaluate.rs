//! Converts a state to sky coordinates, and checks whether it is valid.

use super::seconds::Axes;
use super::state::{Basis, State};
use crate::pointing::{HelioprojectiveArcsec, Horizontal};
use crate::sky::sphere::angles_deg;
use crate::units::ARCSEC_PER_RAD;
use nalgebra::{Matrix3, UnitVector3, Vector3};

/// Reasons for which a pointing is invalid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Invalid {
    /// Nothing was measured for too long.
    Gap,
    /// Before the first measurement, or after the last.
    Extrapolated,
    /// The Sun or the horizon contradicts the gyros.
    Contradicted,
    /// The telescope rotates faster than [`Limits::fastest_arcsec_per_s`].
    Slew,
    /// 1 sigma is larger than [`Limits::most_sigma_arcsec`].
    Uncertain,
}

impl Invalid {
    pub fn name(self) -> &'static str {
        match self {
            Self::Gap => "gap",
            Self::Extrapolated => "extrapolated",
            Self::Contradicted => "contradicted",
            Self::Slew => "slew",
            Self::Uncertain => "uncertain",
        }
    }
}

/// Limits of a valid pointing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// 1 sigma of the boresight, random part, in its worse axis.
    pub most_sigma_arcsec: f64,
    /// Greatest speed of the boresight over the sky.
    pub fastest_arcsec_per_s: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            most_sigma_arcsec: 10.0,
            fastest_arcsec_per_s: 450.0,
        }
    }
}

/// The pointing at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pointed {
    /// `None` if the pointing is not known.
    pub line_of_sight: Option<LineOfSight>,
    /// `None` if the pointing is valid.
    pub invalid: Option<Invalid>,
}

/// The telescope's pointing, and its rotation about that.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LineOfSight {
    pub helioprojective_arcsec: HelioprojectiveArcsec,
    /// Angle from the telescope's up to solar north, counter-clockwise as seen looking out.
    pub north_angle_deg: f64,
    pub horizontal: Horizontal,
    /// Roll about the boresight, from the vertical plane, right side low positive.
    pub roll_deg: f64,
    /// Covariances, random and from the calibration: right, up and about the boresight.
    pub random_arcsec2: Matrix3<f64>,
    pub systematic_arcsec2: Matrix3<f64>,
    pub basis: Basis,
    /// Rotation from the telescope's axes to those about the Sun: to its centre, to solar west and north.
    pub sun_from_telescope: Matrix3<f64>,
    /// The same to north, east and up.
    pub horizon_from_telescope: Matrix3<f64>,
}

impl Pointed {
    pub(super) fn unknown(why: Invalid) -> Self {
        Self {
            line_of_sight: None,
            invalid: Some(why),
        }
    }

    pub fn is_valid(&self) -> bool {
        self.invalid.is_none()
    }
}

impl LineOfSight {
    /// Position relative to the Sun of a direction in the telescope's axes: forward, right and down.
    pub fn helioprojective(&self, towards: &UnitVector3<f64>) -> HelioprojectiveArcsec {
        HelioprojectiveArcsec::of_direction(&(self.sun_from_telescope * towards.into_inner()))
    }

    /// The direction of a position relative to the Sun, towards north, east and up.
    pub fn direction(&self, place: HelioprojectiveArcsec) -> Vector3<f64> {
        let in_telescope = self.sun_from_telescope.tr_mul(&place.direction());
        self.horizon_from_telescope * in_telescope
    }

    /// The telescope's pointing, towards north, east and up.
    pub fn boresight(&self) -> Vector3<f64> {
        self.horizon_from_telescope.column(0).into()
    }
}

impl Limits {
    /// Sky coordinates of a state, and their validity.
    pub(super) fn pointed(&self, state: State, axes: &Axes) -> Pointed {
        let telescope = state.attitude.to_rotation_matrix().into_inner();
        let sun_from_telescope = axes.sun.tr_mul(&telescope);
        let horizon_from_telescope = axes.horizon.tr_mul(&telescope);
        let (azimuth_deg, elevation_deg) = angles_deg(&horizon_from_telescope.column(0).into());
        // Solar north is the third axis about the Sun; the telescope's up is opposite to its down.
        let (north_right, north_down) = (sun_from_telescope.m32, sun_from_telescope.m33);
        let (up_right, up_down) = (horizon_from_telescope.m32, horizon_from_telescope.m33);
        let arcsec2 = ARCSEC_PER_RAD * ARCSEC_PER_RAD;
        let line_of_sight = LineOfSight {
            helioprojective_arcsec: HelioprojectiveArcsec::of_direction(
                &sun_from_telescope.column(0).into(),
            ),
            north_angle_deg: (-north_right).atan2(-north_down).to_degrees(),
            horizontal: Horizontal {
                azimuth_deg,
                elevation_deg,
            },
            roll_deg: (-up_right).atan2(-up_down).to_degrees(),
            random_arcsec2: state.covariance_rad2 * arcsec2,
            systematic_arcsec2: axes.systematic_rad2 * arcsec2,
            basis: state.basis,
            sun_from_telescope,
            horizon_from_telescope,
        };
        Pointed {
            invalid: self.invalid(&state, &line_of_sight),
            line_of_sight: Some(line_of_sight),
        }
    }

    fn invalid(&self, state: &State, line_of_sight: &LineOfSight) -> Option<Invalid> {
        let worse = line_of_sight
            .random_arcsec2
            .m11
            .max(line_of_sight.random_arcsec2.m22);
        let moves_arcsec_per_s = state.rate_rad_s.yz().norm() * ARCSEC_PER_RAD;
        if state.is_contradicted {
            Some(Invalid::Contradicted)
        } else if moves_arcsec_per_s > self.fastest_arcsec_per_s {
            Some(Invalid::Slew)
        } else if worse.sqrt() > self.most_sigma_arcsec {
            Some(Invalid::Uncertain)
        } else {
            None
        }
    }
}
