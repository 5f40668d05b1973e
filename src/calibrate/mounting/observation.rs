//! Observation of one frame, and reasons for which observations give no mounting.

use crate::estimation::FitError;
use crate::pointing::Horizontal;
use crate::sky::SunPosition;
use crate::units::{Estimate, PlateMil};
use jiff::Timestamp;
use std::path::PathBuf;

/// The Sun on the plate and in the sky at the middle of one frame's exposure. Directions are apparent, with refraction.
#[derive(Debug, Clone, PartialEq)]
pub struct SunObservation {
    /// The frame's file.
    pub file: PathBuf,
    pub utc: Timestamp,
    pub sun_plate: Estimate<PlateMil>,
    pub sun: SunPosition,
    /// The telescope's pointing, if known.
    pub pointing: Option<Horizontal>,
}

/// Reasons for which the observations give no mounting; each says which frames to take instead.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MountingError {
    #[error(
        "too few frames: expected at least {limit} with the whole Sun, a time and a place{with}, found {found}; take more, the Sun all over the plate"
    )]
    TooFew {
        found: usize,
        limit: usize,
        with: &'static str,
    },
    #[error(
        "all frames in one place: expected the Sun to move over at least {limit_mil} mil of the plate, found {found_mil:.0} mil; {advice}"
    )]
    OnePlace {
        found_mil: f64,
        limit_mil: f64,
        advice: &'static str,
    },
    #[error(
        "the observations agree with no mounting: expected most of them within {limit_mil} mil of one, found them {found_mil:.0} mil off; {advice}"
    )]
    NoAgreement {
        found_mil: f64,
        limit_mil: f64,
        advice: &'static str,
    },
    #[error("no mounting fits the frames: {0}; check times, place and pointings")]
    NoFit(#[from] FitError),
    #[error(
        "the Sun moves over the plate as in a mirror ({against} against {for_it} mil rms): check the times, the place and from which side the marks were numbered"
    )]
    Mirrored { for_it: String, against: String },
}
