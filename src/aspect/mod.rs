//! The pipeline in overview: from a frame to the Sun's centre on the plate.

mod acquire;
mod adopted;
mod conclusion;
mod measure;
mod solution;
mod stages;

pub(crate) use acquire::missed_share;
pub use adopted::Adopted;
pub use measure::Measured;
pub use solution::{Aspect, Mark, Quality, Solution, Stage, Stopped, Track};
pub use stages::{DiscImage, Pipeline};
pub(crate) use stages::{MARK_MARGIN_PX, cutout, marks_mask};

use crate::frame::Frame;
use crate::geometry::Circle;
use crate::instrument::Instrument;
use crate::log::Seldom;
use crate::{fiducial, limb, registration, sky};
pub(crate) use conclusion::printed_mil;
use conclusion::{check_borrowed, judge};
use jiff::Timestamp;
use stages::at;

/// The Sun by the ephemeris, computed by the caller: it costs more time than the change from frame to frame justifies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Expected {
    /// Angular radius of the disc.
    pub radius_arcsec: f64,
}

impl Expected {
    /// The expected values for an instant; if the ephemeris does not cover it, this is logged and `None` returned.
    pub fn at(utc: Timestamp) -> Option<Self> {
        sky::sun_angular_radius(utc)
            .inspect_err(|error| {
                static UNKNOWN: Seldom = Seldom::new();
                if let Some(frames) = UNKNOWN.counted() {
                    tracing::warn!(%error, frames, "the Sun's size is not known");
                }
            })
            .ok()
            .map(|radius_arcsec| Self { radius_arcsec })
    }
}

/// Tunable settings of every stage.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SolverSettings {
    pub limb: limb::LimbSettings,
    pub fiducial: fiducial::FiducialSettings,
    pub registration: registration::RegistrationSettings,
}

/// Solves a frame with the default settings; see [`solve_with`].
pub fn solve(
    frame: &Frame,
    instrument: &Instrument,
    expected: Option<Expected>,
    prior: Option<&Track>,
) -> Solution {
    solve_with(
        &SolverSettings::default(),
        frame,
        instrument,
        expected,
        prior,
    )
}

/// Finds the Sun's centre on the plate.
///
/// The same frame, instrument, expectation and prior always give the same solution. A stage that fails ends the processing
/// of the frame, but the results of earlier stages stay in the solution.
///
/// # Algorithm
/// 1. Levels of background and disc.
/// 2. The disc, by sparse chords: near the prior's position first, then anywhere.
/// 3. Its light model and its outline, from every fourth row.
/// 4. A mapping from sensor to plate: the prior's, if the marks are where it predicts them; else an acquired one, from
///    marks that are detected on the flattened disc and identified by the code in their spacings.
/// 5. Limb and marks from their own pixels: the limb without pixels near any mark of the plate, detected or not; the marks
///    where the mapping predicts them, in the illumination that follows from the limb.
/// 6. The mapping and the disc on the plate, adjusted together; if the marks give no mapping, the prior's, else the
///    calibration's.
/// 7. The Sun's centre on plate and sensor, with covariance; quality.
pub fn solve_with(
    settings: &SolverSettings,
    frame: &Frame,
    instrument: &Instrument,
    expected: Option<Expected>,
    prior: Option<&Track>,
) -> Solution {
    let mut solution = Solution::none();
    let work = Pipeline::new(settings, instrument, expected);
    if let Err(stopped) = run(&work, frame, prior, &mut solution) {
        // The reason that ended the processing outweighs a reason that only made the solution coarse.
        solution.stopped = Some(stopped);
    }
    solution
}

fn run(
    work: &Pipeline<'_>,
    frame: &Frame,
    prior: Option<&Track>,
    solution: &mut Solution,
) -> Result<(), Stopped> {
    let levels = work.levels(frame)?; // 1
    solution.levels = Some(levels);
    let found = work.find_disc(frame, &levels, prior.map(|prior| &prior.disc))?; // 2
    let image = work.image(frame, &levels, &found)?; // 3
    let (Measured { limb, marks, .. }, predicted) = match work.tracked(&image, prior) {
        Some(measured) => measured, // 4, 5
        None => (work.alone(frame, &image, solution)?, 0),
    };
    solution.limb.clone_from(&limb.points);
    solution.limb_blur_px = Some(limb.light.blur_px());
    let marks = work.check_motion(&limb).and(marks);
    let mut doubted = None;
    let own = marks.and_then(|marks| {
        let own = work
            .register(&marks, &limb)
            .map_err(at(Stage::Registration))?; // 6
        match work.check_stated(&own, &marks) {
            Ok(()) => {
                // Ids that give no mapping are not reliable.
                solution.marks = marks;
                Ok(own)
            }
            Err(rejected) => {
                doubted = Some(own);
                Err(at(Stage::Registration)(rejected))
            }
        }
    });
    let own = own.map_err(|stopped| solution.stopped = Some(stopped)).ok();
    let adopted = work.adopt(own, prior)?;
    let aspect = work.aspect(&limb, &adopted)?; // 7
    if let (Some(doubted), Some(stopped)) = (doubted, solution.stopped) {
        check_borrowed(&aspect, &doubted).map_err(|_| stopped)?;
    }
    let (quality, reason) = judge(&aspect, &adopted);
    solution.quality = quality;
    solution.stopped = solution.stopped.or(reason);
    solution.track = Some(Track {
        disc: Circle {
            centre: aspect.sun_px.position.vector(),
            radius: aspect.sun_radius_px.value,
        },
        predicted,
        registration: adopted.registration().cloned(),
    });
    solution.aspect = Some(aspect);
    solution.mapping = Some(adopted);
    Ok(())
}
