//! The pipeline on one page: from a frame to the Sun's centre on the plate.

mod conclusion;
mod contradiction;
mod marks;
mod overlay;
mod predicted;
mod solution;
mod stages;

pub use contradiction::{CalibrationCheck, Contradiction, Quantity, contradictions};
pub use overlay::overlay;
pub use solution::{
    AdoptedMapping, Aspect, Mark, Origin, Quality, Solution, Stage, Stopped, Track,
};

use crate::frame::{Cutout, Frame, Levels, Mask};
use crate::geometry::{Circle, Ellipse};
use crate::instrument::Instrument;
use crate::limb::Limb;
use crate::log::Seldom;
use crate::{fiducial, limb, registration, sky};
use jiff::Timestamp;
pub use marks::MarkScene;
pub use stages::Pipeline;
use stages::at;
pub(crate) use stages::{cutout, marks_mask};

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
/// 3. Its outline, from the whole limb.
/// 4. The marks on the flattened disc.
/// 5. Their ids.
/// 6. A first mapping from sensor to plate.
/// 7. The outline again, without the pixels of any mark of the plate, seen or not.
/// 8. The marks' places by their own pixels, in the illumination that follows from the limb.
/// 9. The mapping and the disc on the plate, adjusted together; where the marks give no mapping, the prior's, else the
///    calibration's.
/// 10. The Sun's centre on plate and sensor, with covariance; quality.
///
/// A prior whose mapping predicts every mark that must be lit spares steps 4 to 6: the marks are measured where it
/// predicts them, in the same way.
pub fn solve_with(
    settings: &Settings,
    frame: &Frame,
    instrument: &Instrument,
    expected: Option<Expected>,
    prior: Option<&Track>,
) -> Solution {
    let mut solution = Solution::none();
    let work = Pipeline::new(settings, frame, instrument, expected, prior);
    if let Err(stopped) = run(&work, &mut solution) {
        // What ended the frame's way outweighs what only made it coarse.
        solution.stopped = Some(stopped);
    }
    solution
}

/// The levels of a frame, and nothing more: for cameras whose pictures nobody solves yet.
pub fn levels_only(settings: &Settings, frame: &Frame, instrument: &Instrument) -> Solution {
    let mut solution = Solution::none();
    match Pipeline::new(settings, frame, instrument, None, None).levels() {
        Ok(levels) => solution.levels = Some(levels),
        Err(stopped) => solution.stopped = Some(stopped),
    }
    solution
}

fn run(work: &Pipeline<'_>, solution: &mut Solution) -> Result<(), Stopped> {
    let levels = work.levels()?; // 1
    solution.levels = Some(levels);
    let found = work.find_disc(&levels)?; // 2
    let mut cutout = work.cutout(&levels, &found);
    let DiscAndMarks {
        limb,
        marks,
        predicted,
    } = match work.predicted(&levels, &mut cutout, found.centre.into()) {
        Some(found) => found, // 3 to 8, the short way
        None => look_for_marks(work, &levels, &mut cutout, &found, solution)?,
    };
    solution.limb.clone_from(&limb.points);
    solution.limb_blur_px = Some(limb.blur_px());
    let marks = work.check_motion(&limb).and(marks);
    let registration = marks.and_then(|marks| {
        let registration = work.register(&marks, Some(&limb))?; // 9
        // Ids that give no mapping are not to be trusted.
        solution.marks = marks;
        Ok(registration)
    });
    let registration = registration
        .map_err(|stopped| solution.stopped = Some(stopped))
        .ok();
    let adopted = work.adopt(registration.as_ref())?;
    let aspect = work.aspect(&limb, &adopted, registration.as_ref())?; // 10
    solution.quality = work.judge(&aspect, &adopted, solution);
    solution.track = Some(work.track(&aspect, registration, predicted));
    solution.aspect = Some(aspect);
    solution.mapping = Some(adopted);
    Ok(())
}

/// The limb, and the marks by their own pixels or why there are none.
struct DiscAndMarks {
    limb: Limb,
    marks: Result<Vec<Mark>, Stopped>,
    /// Frames in succession, this one included, whose marks the prior predicted.
    predicted: u32,
}

/// Steps 3 to 8 where no prior predicts the marks.
fn look_for_marks(
    work: &Pipeline<'_>,
    levels: &Levels,
    cutout: &mut Cutout,
    found: &Circle,
    solution: &mut Solution,
) -> Result<DiscAndMarks, Stopped> {
    let found = Ellipse::from(*found);
    let nothing = Mask::none(cutout.region());
    let mut limb = work
        .limb_fit(levels, cutout)
        .roughly_near(&found, &nothing)
        .map_err(at(Stage::Limb))?; // 3
    cutout.noise = limb.noise();
    let disc = limb.outline.ellipse;
    solution.detections = work.detect(cutout, &limb); // 4
    let read = work
        .identify(&solution.detections, &limb) // 5
        .and_then(|marks| Ok((work.register(&marks, None)?, marks))); // 6
    let mask = match &read {
        Ok((first, _)) => work.marks_mask(cutout.region(), &disc, &first.mapping),
        Err(_) => work.detections_mask(cutout.region(), &solution.detections),
    };
    let limb_fit = work.limb_fit(levels, cutout);
    // 7; with too much masked, what the marks do to the limb is the lesser evil.
    limb = limb_fit
        .again(&limb, &mask)
        .or_else(|_| limb_fit.again(&limb, &nothing))
        .map_err(at(Stage::Limb))?;
    let marks = read.map(|(first, marks)| {
        let scene = MarkScene {
            cutout,
            limb: &limb,
            mapping: &first.mapping,
        };
        work.place(&scene, &marks) // 8
    });
    Ok(DiscAndMarks {
        limb,
        marks,
        predicted: 0,
    })
}
