//! The pipeline on one page: from a frame to the Sun's centre on the plate.

mod conclusion;
mod overlay;
mod solution;
mod stages;

pub use overlay::overlay;
pub use solution::{
    AdoptedMapping, Aspect, Mark, Origin, Quality, Solution, Stage, Stopped, Track,
};

use crate::frame::Frame;
use crate::instrument::Instrument;
use crate::{fiducial, limb, registration, sky};
use jiff::Timestamp;
use stages::Work;

/// What the ephemeris says of the Sun, computed by the caller: it costs more than it changes from frame to frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Expected {
    /// Angular radius of the disc.
    pub radius_arcsec: f64,
}

impl Expected {
    /// The expectation for an instant; where the ephemeris does not know, that is logged and nothing is expected.
    pub fn at(utc: Timestamp) -> Option<Self> {
        sky::sun_angular_radius(utc)
            .inspect_err(|error| tracing::warn!(%error, "the Sun's size is not known"))
            .ok()
            .map(|radius_arcsec| Self { radius_arcsec })
    }
}

/// The tunable parts of every stage.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Settings {
    pub limb: limb::Settings,
    pub fiducial: fiducial::Settings,
    pub registration: registration::Settings,
}

/// Solves a frame with the default settings; see [`solve_with`].
pub fn solve(
    frame: &Frame,
    instrument: &Instrument,
    expected: Option<Expected>,
    prior: Option<&Track>,
) -> Solution {
    solve_with(&Settings::default(), frame, instrument, expected, prior)
}

/// Finds the Sun's centre on the plate.
///
/// The same frame, instrument, expectation and prior always give the same solution. A stage that fails ends the
/// frame's way, but what earlier stages found stays in the solution.
///
/// # Algorithm
/// 1. Levels of background and disc.
/// 2. The disc, by sparse chords: about the prior's place first, then anywhere.
/// 3. Its limb, by dense chords.
/// 4. The marks on the flattened disc.
/// 5. Their ids.
/// 6. The mapping from sensor to plate; where the marks give none, the prior's, else the calibration's.
/// 7. The limb again, without the crossings near a mark of the plate, seen or not; the disc's circle on the plate.
/// 8. The Sun's centre on plate and sensor, with covariance; quality.
pub fn solve_with(
    settings: &Settings,
    frame: &Frame,
    instrument: &Instrument,
    expected: Option<Expected>,
    prior: Option<&Track>,
) -> Solution {
    let mut solution = Solution::none();
    let work = Work::new(settings, frame, instrument, expected, prior);
    if let Err(stopped) = run(&work, &mut solution) {
        // What ended the frame's way outweighs what only made it coarse.
        solution.stopped = Some(stopped);
    }
    solution
}

fn run(work: &Work<'_>, solution: &mut Solution) -> Result<(), Stopped> {
    let levels = work.levels()?; // 1
    solution.levels = Some(levels);
    let coarse = work.find_disc(&levels)?; // 2
    let crossings = work.limb(&levels, &coarse)?; // 3
    solution.crossings.clone_from(&crossings);
    let disc = work.sensor_disc(&crossings, &coarse)?;
    solution.detections = work.detect(&levels, &disc); // 4
    let mut registration = None;
    match work.identify(&solution.detections, &disc) {
        Ok(marks) => {
            solution.marks = marks; // 5
            match work.register(&solution.marks) {
                Ok(fitted) => registration = Some(fitted), // 6
                Err(stopped) => solution.stopped = Some(stopped),
            }
        }
        Err(stopped) => solution.stopped = Some(stopped),
    }
    let adopted = work.adopt(registration.as_ref())?;
    let clear = work.clear_of_marks(crossings, &adopted);
    let limb = work.plate_disc(&clear, &disc, &adopted)?; // 7
    let aspect = work.aspect(&limb, &clear, &adopted, registration.as_ref())?; // 8
    solution.quality = work.judge(&aspect, &adopted, solution);
    solution.track = Some(work.track(&aspect, registration));
    solution.crossings = clear;
    solution.aspect = Some(aspect);
    solution.mapping = Some(adopted);
    Ok(())
}
