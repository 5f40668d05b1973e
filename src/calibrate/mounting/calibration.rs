//! Calibrates a mounting from observations.

use super::fit::{self, Fits, MountingFit, Pointings};
use super::observation::{MountingError, SunObservation};
use super::side::Side;
use super::verdict;
use crate::calibrate::quantity::{CalibratedQuantity, Verdict};
use crate::calibrate::revision::{Provenance, Revision};
use crate::geometry::Handedness;
use crate::instrument::{Directions, Instrument};
use crate::observe::RejectedFrame;

/// The result of a calibration.
#[derive(Debug, Clone)]
pub struct Mounting {
    pub fit: MountingFit,
    pub quantities: Vec<CalibratedQuantity>,
    /// Handedness of the camera's view of the plate, as determined by the marks.
    pub handedness: Handedness,
    /// Convention for directions on the plate; `None` if the observations do not distinguish it.
    pub directions: Option<Directions>,
    /// Frames whose observation was rejected.
    pub rejected: Vec<RejectedFrame>,
}

/// Calibrates the mounting of an instrument from observations of the Sun.
///
/// # Errors
/// If the observations do not determine a mounting at all; see [`MountingError`].
pub fn calibrate(
    observations: &[SunObservation],
    pointings: Pointings,
    stated: &Instrument,
) -> Result<Mounting, MountingError> {
    let usable = |o: &&SunObservation| pointings == Pointings::Fixed || o.pointing.is_some();
    let observations: Vec<_> = observations.iter().filter(usable).cloned().collect();
    check_enough(&observations, pointings)?;
    check_spread(&observations, pointings)?;
    let Fits { best: fit, other } = fit::fit(&observations, pointings, stated, Side::Front)?;
    let mirrored = fit::fit(&observations, pointings, stated, Side::Back);
    let mirror = verdict::mirror(&fit, mirrored.ok().map(|fits| fits.best).as_ref())?;
    check_agreement(&fit, pointings)?;
    let directions = verdict::directions(&fit, other.as_ref());
    let determined = directions.verdict == Verdict::Determined;
    Ok(Mounting {
        quantities: verdict::quantities(&fit, [mirror, directions], stated),
        handedness: stated.mounting.handedness,
        directions: determined.then_some(fit.directions),
        rejected: fit.rejected(),
        fit,
    })
}

/// Fewest observations: with fewer, outliers cannot be found.
fn check_enough(
    observations: &[SunObservation],
    pointings: Pointings,
) -> Result<(), MountingError> {
    let (limit, with) = match pointings {
        Pointings::Known => (5, " and a known pointing"),
        Pointings::Fixed => (10, ""),
    };
    let found = observations.len();
    if found < limit {
        return Err(MountingError::TooFew { found, limit, with });
    }
    Ok(())
}

/// Requires that the Sun moves enough to determine an angle.
fn check_spread(
    observations: &[SunObservation],
    pointings: Pointings,
) -> Result<(), MountingError> {
    const LEAST_MIL: f64 = 100.0;
    let extent = |coordinate: fn(&SunObservation) -> f64| {
        // Ignore a tenth at each end, which may be bad frames.
        let mut values: Vec<f64> = observations.iter().map(coordinate).collect();
        values.sort_by(f64::total_cmp);
        values[values.len() - 1 - values.len() / 10] - values[values.len() / 10]
    };
    let found_mil = extent(|s| s.sun_plate.position.x).hypot(extent(|s| s.sun_plate.position.y));
    if found_mil >= LEAST_MIL {
        return Ok(());
    }
    let advice = match pointings {
        Pointings::Known => "point at the Sun and half a degree to each side of it",
        Pointings::Fixed => "fix the gondola ahead of the Sun and take frames for 10 minutes",
    };
    Err(MountingError::OnePlace {
        found_mil,
        limit_mil: LEAST_MIL,
        advice,
    })
}

/// Refuses a poor fit: the telescope moved, or the pointings are of another night.
fn check_agreement(fit: &MountingFit, pointings: Pointings) -> Result<(), MountingError> {
    let (limit_mil, advice) = match pointings {
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
        advice,
    })
}

impl Mounting {
    /// Writes the determined values into an instrument's file; the other values stay.
    pub fn revise(&self, revision: &mut Revision, provenance: &Provenance) {
        for quantity in &self.quantities {
            quantity.revise(revision, provenance);
        }
        if let Some(directions) = self.directions {
            revision.set(
                "mounting.directions",
                directions.name().into(),
                None,
                provenance,
            );
        }
        revision.sign(provenance);
    }
}
