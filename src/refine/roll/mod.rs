//! The roll camera's frames: each one's nadir, and the roll and pitch of the gondola's body as the flight has them.
//!
//! The first pass is the same as the other cameras', with frames of the horizon ([`RollRecipe`]). The second ([`RollHistory`]) puts
//! them in the order of time and smooths them. The body's nadir at any time of the flight goes into the offsets of the cameras that see
//! the plate.

mod history;
mod output;
mod record;
mod report;

pub use history::{RollHistory, RollRow, SmoothedRoll};
pub use output::{RollSummary, write_roll};
pub use record::HorizonRecord;

use super::first_pass::{FirstPass, JOURNAL_VERSION, Span, Taken, Unsolved, hash_of};
use crate::archive::{Flown, FlownFiles};
use crate::config;
use crate::fits::Header;
use crate::frame::Frame;
use crate::horizon::{self, Settings, Solution, Sphere};
use crate::instrument::MountedCamera;
use crate::provenance;
use crate::units::Place;
use std::path::Path;

/// What the roll camera's frames are solved with; everything that a frame's own record depends on.
#[derive(Debug, Clone)]
pub struct RollRecipe {
    pub camera: MountedCamera,
    pub settings: config::Roll,
    /// For frames that do not say where they were taken.
    pub place: Option<Place>,
    /// The effective configuration and the camera's file.
    pub flown: Flown,
    /// What frames may name, where camera and configuration are the archive's.
    pub archived: FlownFiles,
}

impl FirstPass for RollRecipe {
    type Frame = HorizonRecord;

    fn hash(&self) -> u64 {
        let text = format!(
            "{} {JOURNAL_VERSION} {:?} {:?} {:?}",
            provenance::VERSION,
            self.camera,
            self.settings,
            self.place
        );
        hash_of(text.as_bytes())
    }

    fn solve(&self, path: &Path, span: &Span) -> Result<Option<HorizonRecord>, Unsolved> {
        let Some(taken) = Taken::open(path, span)? else {
            return Ok(None);
        };
        taken.check(&self.archived)?;
        taken.with_frame(|frame, header| self.record(frame, header).map_err(Unsolved::Unreadable))
    }
}

impl RollRecipe {
    fn record(&self, frame: &Frame, header: &Header) -> Result<HorizonRecord, String> {
        let optics = &self.camera.optics;
        optics.check(frame).map_err(|error| error.to_string())?;
        let sphere = self.sphere(frame)?;
        let solution = horizon::solve(&Settings::default(), frame, optics, &sphere, None);
        let turn = &self.camera.body_from_camera;
        Ok(HorizonRecord::new(&frame.info, header, &solution, turn))
    }

    /// The Earth about the camera when it took a frame.
    fn sphere(&self, frame: &Frame) -> Result<Sphere, String> {
        let place = frame.info.place.or(self.place);
        let height_m = place.map(|place| place.height_m);
        self.settings.sphere(height_m).ok_or_else(|| {
            let found = self.settings.height_m.or(height_m);
            let found = found.map_or("none".into(), |height_m| format!("{height_m} m"));
            let limb_m = self.settings.atmosphere_m;
            format!("OBSGEO-H: expected a height above the limb's edge ({limb_m} m), found {found}; --place tells one")
        })
    }

    /// The solution of a frame, once more: for a picture of it. `None` where it cannot be solved.
    fn solve_again(&self, frame: &Frame) -> Option<(Solution, Sphere)> {
        let optics = &self.camera.optics;
        optics.check(frame).ok()?;
        let sphere = self.sphere(frame).ok()?;
        let solution = horizon::solve(&Settings::default(), frame, optics, &sphere, None);
        Some((solution, sphere))
    }
}
