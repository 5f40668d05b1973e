//! Reasons for which there is no offset.

use super::HIGHEST_ELEVATION_DEG;
use crate::reasons::pointing as reasons;
use crate::sky::SkyError;
use crate::units::Rejected;

/// Reasons for which an offset or a plate position cannot be computed.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum PointingError {
    #[error(
        "expected an elevation up to {HIGHEST_ELEVATION_DEG} deg, where azimuth is still well defined, found {elevation_deg:.3} deg"
    )]
    NearZenith { elevation_deg: f64 },
    #[error(
        "too near the zenith for any pointing: expected the Sun farther from the vertical than from the boresight, {sun_from_boresight_deg:.3} deg, found it {sun_from_vertical_deg:.3} deg from the vertical"
    )]
    NoBoresight {
        sun_from_vertical_deg: f64,
        sun_from_boresight_deg: f64,
    },
    #[error(
        "expected the Sun within 90 deg of the pointing, found it {separation_deg:.3} deg away"
    )]
    BehindTheLens { separation_deg: f64 },
    #[error(
        "expected a target on the disc, up to {limb_arcsec:.1} arcsec from its centre, found {from_centre_arcsec:.1} arcsec"
    )]
    OffTheDisc {
        from_centre_arcsec: f64,
        limb_arcsec: f64,
    },
    #[error(
        "the Sun's rotation has carried the target behind the limb: expected up to {limb_deg:.2} deg from the disc's centre, found {from_centre_deg:.2} deg"
    )]
    BehindTheLimb { from_centre_deg: f64, limb_deg: f64 },
}

impl PointingError {
    /// The error as a frame's reason.
    pub fn rejected(&self) -> Rejected {
        let (reason, measured, limit) = match *self {
            Self::NearZenith { elevation_deg } => {
                (reasons::NEAR_ZENITH, elevation_deg, HIGHEST_ELEVATION_DEG)
            }
            Self::NoBoresight {
                sun_from_vertical_deg,
                sun_from_boresight_deg,
            } => (
                reasons::NO_BORESIGHT,
                sun_from_vertical_deg,
                sun_from_boresight_deg,
            ),
            Self::BehindTheLens { separation_deg } => (reasons::BEHIND_LENS, separation_deg, 90.0),
            Self::OffTheDisc {
                from_centre_arcsec,
                limb_arcsec,
            } => (reasons::OFF_DISC, from_centre_arcsec, limb_arcsec),
            Self::BehindTheLimb {
                from_centre_deg,
                limb_deg,
            } => (reasons::BEHIND_LIMB, from_centre_deg, limb_deg),
        };
        Rejected {
            reason,
            measured,
            limit,
        }
    }
}

/// Reasons for which a frame with a Sun, a time and a place has no offset.
#[derive(Debug, thiserror::Error)]
pub(super) enum NoOffset {
    #[error(transparent)]
    Sky(#[from] SkyError),
    #[error(transparent)]
    Pointing(#[from] PointingError),
}

impl NoOffset {
    pub fn rejected(&self) -> Rejected {
        match self {
            Self::Sky(error) => error.rejected(),
            Self::Pointing(error) => error.rejected(),
        }
    }
}
