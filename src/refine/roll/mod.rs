//! The roll camera's frames: each one's nadir, and the roll and pitch of the gondola's body over the flight.
//!
//! Each frame is observed by itself ([`RollRecipe`]), like those of the other cameras. The history ([`RollHistory`]) sorts them by
//! time and smooths them. The body's nadir at any time of the flight enters the offsets of the cameras that see the plate.

mod history;
mod path;
mod record;
mod row;

pub use history::RollHistory;
pub use record::HorizonRecord;
pub use row::{ROLL, ROLL_COLUMNS, RollRow, SmoothedRoll, kind};

use super::recipe::plain_toml;
use crate::archive::{ArchiveReader, Flown, FlownFiles, StoredFile};
use crate::config::{self, Config};
use crate::fits::Header;
use crate::frame::Frame;
use crate::horizon::{self, HorizonSettings, Solution, Sphere, Stage, Stopped};
use crate::instrument::MountedCamera;
use crate::observe::{Observer, Span, Unsolved, with_frame};
use crate::reasons::{at, horizon as reasons};
use crate::units::{Place, Rejected};

/// Recipe for the roll camera's frames: everything that a frame's own record depends on.
#[derive(Debug, Clone)]
pub struct RollRecipe {
    pub camera: MountedCamera,
    pub settings: config::Roll,
    /// Used for frames that do not state their position.
    pub place: Option<Place>,
    /// The effective configuration and the camera's file.
    pub flown: Flown,
    /// Cameras that frames may name, if camera and configuration are the archive's.
    pub archived: FlownFiles,
    /// Text of camera, settings and place.
    stated: String,
}

impl Observer for RollRecipe {
    type Output = HorizonRecord;

    fn stated(&self) -> String {
        self.stated.clone()
    }

    fn observe(
        &self,
        archive: &ArchiveReader,
        input: &StoredFile,
        span: &Span,
    ) -> Result<Option<HorizonRecord>, Unsolved> {
        let (size_px, archived) = (self.camera.optics.size_px(), &self.archived);
        let record = |frame: &Frame, header: &Header| self.record(frame, header);
        with_frame(archive, input, span, size_px, archived, record)
    }
}

impl RollRecipe {
    /// Makes a recipe from a camera, the text that it was read from, and a configuration, of which roll and place are used.
    pub fn new(
        (camera, text): (MountedCamera, String),
        config: &Config,
        archived: FlownFiles,
    ) -> Self {
        let stated = Config {
            roll: config.roll,
            site: config.site.clone(),
            ..Config::default()
        };
        Self {
            camera,
            settings: config.roll,
            place: config.site.place(),
            stated: format!("{}\n{}", plain_toml(&text), plain_toml(&stated.to_toml())),
            flown: Flown::new(config.to_toml(), Some(text)),
            archived,
        }
    }

    fn record(&self, frame: &Frame, header: &Header) -> Result<HorizonRecord, String> {
        let optics = &self.camera.optics;
        optics.check(frame).map_err(|error| error.to_string())?;
        let solution = match self.sphere(frame) {
            Some(sphere) => {
                horizon::solve(&HorizonSettings::default(), frame, optics, &sphere, None)
            }
            None => Solution::none(self.not_above_the_limb(frame)),
        };
        let turn = &self.camera.body_from_camera;
        Ok(HorizonRecord::new(&frame.info, header, &solution, turn))
    }

    /// The Earth as seen from the camera when it took a frame; `None` if the camera was not above the limb's edge.
    fn sphere(&self, frame: &Frame) -> Option<Sphere> {
        self.settings.sphere(self.height_m(frame))
    }

    /// Height at which a frame was taken, m; the settings may state another one.
    fn height_m(&self, frame: &Frame) -> Option<f64> {
        let place = frame.info.place.or(self.place);
        place.map(|place| place.height_m)
    }

    /// The reason for which such a frame has no nadir, as in flight: a height that is not stated counts as 0.
    fn not_above_the_limb(&self, frame: &Frame) -> Stopped {
        let height_m = self.settings.height_m.or(self.height_m(frame));
        let rejected = Rejected {
            reason: reasons::NOT_ABOVE_LIMB,
            measured: height_m.unwrap_or_default(),
            limit: self.settings.atmosphere_m,
        };
        at(Stage::Light)(rejected)
    }

    /// Solves a frame again, for a picture of it. `None` where it cannot be solved.
    pub(super) fn solve_again(&self, frame: &Frame) -> Option<(Solution, Sphere)> {
        let optics = &self.camera.optics;
        optics.check(frame).ok()?;
        let sphere = self.sphere(frame)?;
        let solution = horizon::solve(&HorizonSettings::default(), frame, optics, &sphere, None);
        Some((solution, sphere))
    }
}

#[cfg(test)]
mod tests {
    use super::super::record::Grade;
    use super::*;
    use crate::frame::{FrameInfo, Pixels};
    use std::path::Path;

    const CAMERA: &str = "[camera]
width_px = 64
height_px = 48
centre_px = [31.5, 23.5]
focal_px = [60.0, 60.0]
body_from_camera = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
";

    /// Record of a dark frame taken at some height, where settings may state another.
    fn record(of_frame_m: f64, stated_m: Option<f64>) -> HorizonRecord {
        let camera = MountedCamera::parse(Path::new("roll.toml"), CAMERA).unwrap();
        let roll = config::Roll {
            height_m: stated_m,
            ..config::Roll::default()
        };
        let config = Config {
            roll,
            ..Config::default()
        };
        let recipe = RollRecipe::new((camera, CAMERA.into()), &config, FlownFiles::default());
        let info = FrameInfo {
            number: Some(7),
            mid_exposure: Some("2013-09-21T18:00:00Z".parse().unwrap()),
            place: Place::new(34.49, -104.2218, of_frame_m).ok(),
            ..FrameInfo::default()
        };
        let pixels = Pixels::U8(vec![0; 64 * 48]);
        let frame = Frame::new(64, 48, pixels, 255, info).unwrap();
        recipe.record(&frame, &Header::default()).unwrap()
    }

    #[test]
    fn a_frame_from_below_the_limb_keeps_its_time_and_says_why_it_has_no_nadir() {
        let low = record(1_200.0, None);
        assert_eq!((low.quality, low.facts.number), (Grade::None, Some(7)));
        assert!(low.facts.utc().is_some());
        let [low, lower] = [low, record(900.0, None)].map(|low| low.reason.unwrap());
        assert!(
            low.starts_with(
                "light: the camera is not above the limb of the atmosphere (measured 1200.0000"
            ),
            "{low}"
        );
        assert_eq!(kind(&low), kind(&lower));
        let stated = record(1_200.0, Some(38_000.0)).reason.unwrap();
        assert!(!stated.contains("not above the limb"), "{stated}");
    }
}
