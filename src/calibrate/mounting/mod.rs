//! How plate and telescope sit to each other: the boresight on the plate (its calibrated centre), the clocking and the
//! plate's distance from the lens, from the Sun's places on the plate and the ephemeris.
//!
//! # Method
//! A [`SunObservation`] is one frame's Sun on the plate beside the Sun in the sky. Given where the telescope pointed,
//! [`pointing::sun_on_plate`](crate::pointing::sun_on_plate) says where the Sun should stand; the unknowns are those that make
//! what was seen and what should be seen agree. In a drift scan the telescope's one direction is unknown too.
//!
//! 1. `start`: to a part in fifty the chain is a similarity in the plane; the one of least median distance, over many
//!    pairs of sights, is right while more than half of the sights are.
//! 2. `fit`: least squares on the whole chain, first with Tukey's loss, then on the sights that agree.
//!    What they scatter beyond their own sigmas is taken as noise of every sight; where neighbours scatter alike the covariance
//!    grows by as much.
//!    All this twice: directions on the plate count from the zenith at the Sun, as the pointing has it, or at the telescope, as on a
//!    plate rigid in the gondola; the sights decide, see [`Chain`].
//! 3. The same with the plate in a mirror, to tell whether the data know the difference.
//! 4. `verdict`: each quantity is determined, with a sigma, or keeps the instrument's value.

mod chain;
mod collect;
mod fit;
mod log;
mod observation;
mod report;
mod scatter;
mod start;
mod verdict;

pub use chain::Chain;
pub use collect::{Frames, collect};
pub use fit::{MountingFit, Pointings, Unknown};
pub use log::{LogError, PointingLog};
pub use observation::{MountingError, SunObservation};
pub use report::page;
pub use verdict::{Finding, Verdict};

use super::frames::LeftOut;
use super::revision::{Provenance, Revision};
use crate::geometry::Handedness;
use crate::instrument::Instrument;

/// What came of a calibration.
#[derive(Debug, Clone)]
pub struct Mounting {
    pub fit: MountingFit,
    pub findings: Vec<Finding>,
    /// How the camera sees the plate, as the marks say.
    pub handedness: Handedness,
    /// Sights and frames that did not take part.
    pub left_out: Vec<LeftOut>,
}

/// Calibrates the mounting of an instrument from sights.
///
/// # Errors
/// Sights that do not determine a mounting at all; see [`MountingError`].
pub fn calibrate(
    sights: &[SunObservation],
    pointings: Pointings,
    stated: &Instrument,
) -> Result<Mounting, MountingError> {
    let sights: Vec<SunObservation> = match pointings {
        Pointings::Known => sights
            .iter()
            .filter(|s| s.pointing.is_some())
            .cloned()
            .collect(),
        Pointings::Fixed => sights.to_vec(),
    };
    check_enough(&sights, pointings)?;
    check_spread(&sights, pointings)?;
    let straight = fit::fit(&sights, pointings, stated, chain::Side::Front)?;
    let mirrored = fit::fit(&sights, pointings, stated, chain::Side::Back);
    let mirror = verdict::mirror(&straight, mirrored.as_ref().ok())?;
    check_agreement(&straight, pointings)?;
    let left_out = straight.rejected();
    Ok(Mounting {
        findings: verdict::findings(&straight, mirror, stated),
        handedness: stated.mounting.handedness,
        fit: straight,
        left_out,
    })
}

/// Fewest sights: with fewer, outliers cannot be told.
fn check_enough(sights: &[SunObservation], pointings: Pointings) -> Result<(), MountingError> {
    let (limit, with) = match pointings {
        Pointings::Known => (5, " and a known pointing"),
        Pointings::Fixed => (10, ""),
    };
    let found = sights.len();
    if found < limit {
        return Err(MountingError::TooFew { found, limit, with });
    }
    Ok(())
}

/// The Sun must move enough for an angle to mean something.
fn check_spread(sights: &[SunObservation], pointings: Pointings) -> Result<(), MountingError> {
    const LEAST_MIL: f64 = 100.0;
    let extent = |coordinate: fn(&SunObservation) -> f64| {
        // Without the tenth at each end, which spoiled frames may make up.
        let mut values: Vec<f64> = sights.iter().map(coordinate).collect();
        values.sort_by(f64::total_cmp);
        values[values.len() - 1 - values.len() / 10] - values[values.len() / 10]
    };
    let found_mil = extent(|s| s.sun_plate.position.x).hypot(extent(|s| s.sun_plate.position.y));
    if found_mil >= LEAST_MIL {
        return Ok(());
    }
    let instead = match pointings {
        Pointings::Known => "point at the Sun and half a degree to each side of it",
        Pointings::Fixed => "fix the gondola ahead of the Sun and take frames for 10 minutes",
    };
    Err(MountingError::OnePlace {
        found_mil,
        limit_mil: LEAST_MIL,
        instead,
    })
}

/// A telescope that moved, or pointings of another night, fit nothing.
fn check_agreement(fit: &MountingFit, pointings: Pointings) -> Result<(), MountingError> {
    let (limit_mil, instead) = match pointings {
        Pointings::Known => (200.0, "check the clock and the place of the pointings"),
        Pointings::Fixed => (
            30.0,
            "the gondola must stand still; one that moves needs --pointing",
        ),
    };
    if fit.scatter_mil <= limit_mil {
        return Ok(());
    }
    Err(MountingError::NoAgreement {
        found_mil: fit.scatter_mil,
        limit_mil,
        instead,
    })
}

impl Mounting {
    /// Writes what was determined into an instrument's file; what was not stays as it is.
    pub fn revise(&self, revision: &mut Revision, provenance: &Provenance) {
        for finding in &self.findings {
            finding.revise(revision, provenance);
        }
        revision.sign(provenance);
    }
}
