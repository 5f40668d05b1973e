//! The solver of a roll camera: it takes a frame of the horizon and gives the nadir in the body's axes.

use super::{Solver, timed};
use crate::aspect::Quality;
use crate::camera::Brightness;
use crate::commands::controls::Snapshot;
use crate::frame::{self, Frame};
use crate::horizon::{self, HorizonSettings, Levels, Solution, Stage};
use crate::instrument::{MountedCamera, WrongSize};
use crate::pointing::body_roll_deg;
use crate::reasons::{Stopped, at, horizon as reasons};
use crate::service::messages::{BodyNadir, BodyRoll, Found, LatestNadir, Solved, UnsolvedFrame};
use crate::units::{Reason, Rejected};
use nalgebra::UnitVector3;
use tracing::Level;

pub(super) struct HorizonSolver {
    camera: MountedCamera,
    latest: LatestNadir,
    /// The nadir of the last frame, in the camera's axes.
    last: Option<UnitVector3<f64>>,
}

impl HorizonSolver {
    pub fn new(camera: MountedCamera, latest: LatestNadir) -> Self {
        Self {
            camera,
            latest,
            last: None,
        }
    }

    /// The horizon of a frame. A frame of another size than the camera's is stored, and not solved.
    fn horizon(&self, frame: &Frame, commanded: &Snapshot) -> Solution {
        let camera = &self.camera.optics;
        if camera.check(frame).is_err() {
            let (width, expected) = (frame.width() as f64, camera.width_px as f64);
            return unsolved(frame, reasons::WRONG_SIZE, width, expected);
        }
        let height_m = frame.info.place.map(|place| place.height_m);
        match commanded.roll.sphere(height_m) {
            Some(sphere) => {
                let last = self.last.as_ref();
                horizon::solve(&HorizonSettings::default(), frame, camera, &sphere, last)
            }
            None => {
                let limit_m = commanded.roll.atmosphere_m;
                let height_m = commanded.roll.height_m.or(height_m).unwrap_or_default();
                unsolved(frame, reasons::NOT_ABOVE_LIMB, height_m, limit_m)
            }
        }
    }
}

impl Solver for HorizonSolver {
    fn solve(
        &mut self,
        frame: &mut UnsolvedFrame,
        commanded: &Snapshot,
    ) -> Result<Solved, WrongSize> {
        let arrived = frame.arrived;
        let frame = &mut frame.exposure.frame;
        frame.info.place = frame.info.place.or(commanded.place);
        let (solution, solve_time) = timed(|| self.horizon(frame, commanded));
        let nadir = solution.nadir.as_ref().ok();
        self.last = nadir.map(|nadir| nadir.direction.unit);
        let in_body = nadir.map(|nadir| nadir.direction.turned(&self.camera.body_from_camera));
        let levels = solution.levels.map(|levels| frame::Levels {
            background_dn: levels.dark_dn,
            noise_dn: levels.noise_dn,
            disc_dn: levels.bright_dn,
        });
        Ok(Solved {
            quality: match solution.quality() {
                horizon::Quality::Fine => Quality::Fine,
                horizon::Quality::Coarse => Quality::Coarse,
                horizon::Quality::None => Quality::None,
            },
            stopped: solution.reason().map(Stopped::named),
            levels,
            brightness: brightness(&solution, frame.saturation_dn()),
            roll: in_body.map(|in_body| BodyRoll {
                deg: body_roll_deg(&in_body),
                arrived,
            }),
            found: Found::Nadir(Box::new(solution)),
            solve_time,
        })
    }

    fn share(&mut self, frame: &UnsolvedFrame, solved: &Solved) {
        let Found::Nadir(solution) = &solved.found else {
            return;
        };
        if let Ok(nadir) = &solution.nadir {
            let in_body = nadir.direction.turned(&self.camera.body_from_camera);
            let mut latest = self.latest.lock();
            *latest = Some(BodyNadir {
                arrived: frame.arrived,
                ..BodyNadir::next(*latest, in_body, frame.middle)
            });
        }
    }

    fn log_entry(&self, solved: &Solved) -> Option<(Level, &'static str)> {
        (solved.quality == Quality::None).then_some((Level::WARN, "no horizon"))
    }
}

/// A frame that is not searched, with its brightness: the automatic exposure uses that all the same.
fn unsolved(frame: &Frame, reason: Reason, measured: f64, limit: f64) -> Solution {
    let whole_px = frame.width().max(frame.height()) as f64;
    let rejected = Rejected::new(reason, measured, limit);
    match Levels::of(frame, whole_px) {
        Ok(levels) => Solution {
            levels: Some(levels),
            ..Solution::none(at(Stage::Light)(rejected))
        },
        Err(light) => Solution::none(at(Stage::Light)(light)),
    }
}

/// The limb's brightness for the automatic exposure: the Sun in the picture is too small to count. A picture that is saturated all over has too
/// much light, and a dark one does not show the limb.
fn brightness(solution: &Solution, saturation_dn: u16) -> Brightness {
    let full_dn = f64::from(saturation_dn);
    let is_too_bright = |stopped: &horizon::Stopped| stopped.rejected.reason == reasons::TOO_BRIGHT;
    match (&solution.levels, &solution.nadir) {
        (Some(levels), _) => Brightness::Disc {
            level: levels.bright_dn / full_dn,
            background: levels.dark_dn / full_dn,
        },
        (None, Err(stopped)) if is_too_bright(stopped) => Brightness::Disc {
            level: 1.0,
            background: 1.0,
        },
        _ => Brightness::NoDisc,
    }
}
