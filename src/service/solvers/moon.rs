//! The solver of a Moon camera: it takes a frame of the night sky and gives the Moon's place and direction.

use super::{Solver, timed};
use crate::aspect::Quality;
use crate::camera::Brightness;
use crate::commands::controls::Snapshot;
use crate::frame::{self, Frame, Region};
use crate::geometry::attitude::Direction;
use crate::instrument::{DirectionCamera, WrongSize};
use crate::link::MoonOutcome;
use crate::link::moon::{BELOW_HORIZON, FIRST_STAGE, MoonFix, NEAR_SUN, WRONG_SIZE};
use crate::moon::{
    self, Disc, Expected, Levels, MoonSettings, Optics, Shading, Stage, Stopped, bright_dn,
};
use crate::reasons::{at, moon as reasons};
use crate::service::messages::{Found, MoonResult, MoonState, Solved, SolvedMoon, UnsolvedFrame};
use crate::service::shared::Shared;
use crate::sky::{Ephemeris, MoonPosition};
use crate::units::{Place, Rejected};
use jiff::Timestamp;
use tracing::Level;

pub(super) struct MoonSolver {
    camera: DirectionCamera,
    ephemeris: Ephemeris,
    state: Shared<MoonState>,
    /// Whether it was night at the last frame; `None` if its time or place is not known.
    is_night: Option<bool>,
}

/// Directions of Moon and Sun by the ephemeris, and whether the Moon can be seen.
struct MoonSky {
    moon: MoonPosition,
    hidden: Option<Rejected>,
    is_night: bool,
}

impl MoonSolver {
    pub fn new(camera: DirectionCamera, ephemeris: Ephemeris, state: Shared<MoonState>) -> Self {
        Self {
            camera,
            ephemeris,
            state,
            is_night: None,
        }
    }

    /// `None` for dates outside the ephemeris.
    fn sky(&mut self, utc: Timestamp, place: Place, snapshot: &Snapshot) -> Option<MoonSky> {
        let moon = self.ephemeris.moon(utc, place).ok()?;
        let sun = self.ephemeris.sun(utc, place).ok()?;
        let clear_deg = snapshot.moon.clear_of_sun_deg;
        let near_sun = || moon::near_sun(&moon, &sun, place, clear_deg);
        Some(MoonSky {
            hidden: moon::below_horizon(&moon, place).or_else(near_sun),
            is_night: moon::is_night(&sun, place),
            moon,
        })
    }

    /// The Moon in a frame. A frame of another size than the camera's, or taken while the Moon cannot be seen, is stored and not searched.
    fn disc(&self, frame: &Frame, sky: Option<&MoonSky>) -> Result<Disc, Stopped> {
        if let Err(wrong) = self.camera.check(frame) {
            return Err(at(Stage::Light)(Rejected {
                reason: reasons::WRONG_SIZE,
                measured: wrong.width as f64,
                limit: wrong.expected_width as f64,
            }));
        }
        if let Some(hidden) = sky.and_then(|sky| sky.hidden) {
            return Err(at(Stage::Sky)(hidden));
        }
        let settings = MoonSettings {
            shading: Shading::LommelSeeliger,
            optics: Optics::Camera(self.camera.lens),
        };
        let expected = sky.map_or(Expected::default(), |sky| Expected::of(&sky.moon));
        moon::solve(&settings, frame, &expected)
    }

    fn direction(&self, disc: &Disc) -> Option<Direction> {
        self.camera.lens.direction(&disc.centre)
    }

    /// The answer to a request.
    fn outcome(&self, found: &Result<Disc, Stopped>, time: Timestamp) -> MoonOutcome {
        match found {
            Ok(disc) => match self.direction(disc) {
                Some(direction) => {
                    let (centre, covariance) = (disc.centre.position, disc.centre.covariance);
                    MoonOutcome::Found(MoonFix {
                        x_px: centre.x,
                        y_px: centre.y,
                        covariance_px2: [
                            covariance[(0, 0)],
                            covariance[(0, 1)],
                            covariance[(1, 1)],
                        ],
                        direction: direction.unit.into_inner().into(),
                        time,
                    })
                }
                None => not_found(Stage::Detection),
            },
            Err(Stopped { stage, rejected }) => match (stage, rejected.reason) {
                (Stage::Sky, reasons::NEAR_SUN) => MoonOutcome::NotVisible { code: NEAR_SUN },
                (Stage::Sky, _) => MoonOutcome::NotVisible {
                    code: BELOW_HORIZON,
                },
                (_, reasons::WRONG_SIZE) => MoonOutcome::NotFound { code: WRONG_SIZE },
                _ => not_found(*stage),
            },
        }
    }
}

impl Solver for MoonSolver {
    fn solve(
        &mut self,
        frame: &mut UnsolvedFrame,
        commanded: &Snapshot,
    ) -> Result<Solved, WrongSize> {
        let requested_from = self.state.lock().requested_from;
        let frame = &mut frame.exposure.frame;
        let info = &mut frame.info;
        // The platform's place has priority; the file states the place on which its answer rests.
        info.place = requested_from.or(info.place).or(commanded.place);
        let known = info.mid_exposure.zip(info.place);
        let ((sky, found), solve_time) = timed(|| {
            let sky = known.and_then(|(utc, place)| self.sky(utc, place, commanded));
            let found = self.disc(frame, sky.as_ref());
            (sky, found)
        });
        self.is_night = sky.map(|sky| sky.is_night);
        let (levels, brightness) = light(frame, &found);
        let disc = found.as_ref().ok();
        Ok(Solved {
            quality: match disc.map(|disc| disc.quality) {
                Some(moon::Quality::Fine) => Quality::Fine,
                Some(moon::Quality::Coarse) => Quality::Coarse,
                None => Quality::None,
            },
            stopped: found.as_ref().err().map(Stopped::named),
            levels,
            brightness,
            roll: None,
            solve_time,
            found: Found::Moon(Box::new(SolvedMoon {
                direction: disc.and_then(|disc| self.direction(disc)),
                found,
            })),
        })
    }

    fn share(&mut self, frame: &UnsolvedFrame, solved: &Solved) {
        if let Found::Moon(moon) = &solved.found {
            let utc = frame.exposure.frame.info.mid_exposure;
            self.state.lock().result = Some(MoonResult {
                began: frame.began(),
                outcome: self.outcome(&moon.found, utc.unwrap_or_else(Timestamp::now)),
                is_night: self.is_night,
            });
        }
    }

    fn log_entry(&self, solved: &Solved) -> Option<(Level, &'static str)> {
        Some(match solved.stopped?.stage == Stage::Sky.name() {
            true => (Level::INFO, "the Moon cannot be seen"),
            false => (Level::WARN, "no Moon"),
        })
    }
}

fn not_found(stage: Stage) -> MoonOutcome {
    let after = match stage {
        Stage::Sky | Stage::Light => 0,
        Stage::Detection => 1,
        Stage::Limb => 2,
        Stage::Checks => 3,
    };
    MoonOutcome::NotFound {
        code: FIRST_STAGE + after,
    }
}

/// A frame's levels for the logs, and the Moon's brightness for the automatic exposure. While the Moon cannot be seen, it has no brightness.
fn light(frame: &Frame, found: &Result<Disc, Stopped>) -> (Option<frame::Levels>, Brightness) {
    let full_dn = f64::from(frame.saturation_dn());
    let levels = match (Levels::of(frame), found) {
        (Ok(levels), _) => levels,
        (
            Err(_),
            Err(Stopped {
                stage: Stage::Sky, ..
            }),
        ) => return (None, Brightness::NoDisc),
        (Err(_), _) => {
            let (level, background) = (1.0, 1.0);
            return (None, Brightness::Disc { level, background });
        }
    };
    let around = found
        .as_ref()
        .ok()
        .and_then(|disc| disc_region(frame, disc));
    let bright = bright_dn(frame, around.unwrap_or(frame.region()));
    let disc_dn = bright.unwrap_or(levels.dark_dn);
    let frame_levels = frame::Levels {
        background_dn: levels.dark_dn,
        noise_dn: levels.noise_dn,
        disc_dn,
    };
    let is_lit = disc_dn > levels.dark_dn + levels.least_dn();
    let brightness = match found {
        Err(Stopped {
            stage: Stage::Sky, ..
        }) => Brightness::NoDisc,
        _ if !is_lit => Brightness::NoDisc,
        _ => Brightness::Disc {
            level: disc_dn / full_dn,
            background: levels.dark_dn / full_dn,
        },
    };
    (Some(frame_levels), brightness)
}

fn disc_region(frame: &Frame, disc: &Disc) -> Option<Region> {
    let reach = disc.radius_px.value * disc.aspect.max(1.0);
    frame.around(disc.centre.position, reach)
}
