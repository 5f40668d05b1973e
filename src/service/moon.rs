//! The Moon camera's solver: a frame of the night sky in, the Moon's place and direction out.

use super::answer::{Answer, SolvedMoon};
use super::flight::{Station, UnsolvedFrame};
use super::outlet::Outlet;
use super::shared::Shared;
use super::tally::MoonTally;
use super::worker::Life;
use crate::aspect;
use crate::camera::Brightness;
use crate::commands::controls::Snapshot;
use crate::frame::{self, Frame, Region};
use crate::instrument::DirectionCamera;
use crate::link::MoonSight;
use crate::link::moon::{BELOW_HORIZON, FIRST_STAGE, MoonFix, NEAR_SUN, WRONG_SIZE};
use crate::log::worth_a_line;
use crate::moon::{
    self, Disc, Expected, Levels, Optics, Settings, Shading, Stage, Stopped, bright_dn,
};
use crate::reasons::{at, moon as reasons};
use crate::sky::{Ephemeris, MoonPosition};
use crate::units::{Place, Rejected};
use crossbeam_channel::Receiver;
use jiff::Timestamp;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

/// What the line asks of the Moon camera, and what that has seen last.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct MoonDesk {
    /// Where the platform was at the latest request.
    pub asked_from: Option<Place>,
    pub seen: Option<SeenMoon>,
}

/// What came of the Moon camera's last frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct SeenMoon {
    /// When its exposure began.
    pub began: Instant,
    pub sight: MoonSight,
    /// Whether the Sun was below the horizon; `None` where time or place is not known.
    pub is_night: Option<bool>,
}

#[derive(Clone)]
pub(super) struct MoonSolver {
    pub station: Arc<Station>,
    pub camera: DirectionCamera,
    pub ephemeris: Ephemeris,
    pub outlet: Outlet,
    pub cameras_ended: Arc<AtomicBool>,
    pub desk: Shared<MoonDesk>,
    pub tally: Shared<MoonTally>,
}

/// Where the ephemeris has Moon and Sun, and whether the Moon can be seen.
struct Heavens {
    moon: MoonPosition,
    hidden: Option<Rejected>,
    is_night: bool,
}

impl MoonSolver {
    /// Solves until the camera ends, or another thread has taken over.
    pub fn run(mut self, frames: &Receiver<UnsolvedFrame>, life: &Life) {
        while let Some(mut frame) = UnsolvedFrame::next(frames, &self.cameras_ended, life) {
            let began = frame.began();
            let snapshot = self.outlet.controls.snapshot();
            let asked_from = self.desk.lock().asked_from;
            let info = &mut frame.exposure.frame.info;
            // The platform knows best; the file tells the place that its answer rests on.
            info.place = asked_from.or(info.place).or(snapshot.place);
            let utc = info.mid_exposure;
            let start = Instant::now();
            let heavens = utc
                .zip(info.place)
                .and_then(|(utc, place)| self.heavens(utc, place, &snapshot));
            let found = self.solve(&frame.exposure.frame, heavens.as_ref());
            let solve_time = start.elapsed();
            if life.is_over() {
                return;
            }
            let is_night = heavens.map(|heavens| heavens.is_night);
            self.desk.lock().seen = Some(SeenMoon {
                began,
                sight: self.sight(&found, utc.unwrap_or_else(Timestamp::now)),
                is_night,
            });
            self.note(&found);
            let (levels, brightness) = light(&frame.exposure.frame, &found);
            let direction = found.as_ref().ok().and_then(|disc| self.direction(disc));
            let answer = Answer {
                station: Arc::clone(&self.station),
                exposure: Arc::new(frame.exposure),
                solution: Arc::new(aspect::Solution {
                    levels,
                    ..aspect::Solution::none()
                }),
                offset: None,
                horizon: None,
                moon: Some(Arc::new(SolvedMoon { found, direction })),
                roll_deg: None,
                roll_arrived: None,
                target: snapshot.target,
                solve_time,
                to_be_stored: self.outlet.stores(&self.station),
            };
            self.outlet.hand_on(answer, brightness);
        }
    }

    /// `None` for dates that the ephemeris does not know.
    fn heavens(&mut self, utc: Timestamp, place: Place, snapshot: &Snapshot) -> Option<Heavens> {
        let moon = self.ephemeris.moon(utc, place).ok()?;
        let sun = self.ephemeris.sun(utc, place).ok()?;
        let clear_deg = snapshot.moon.clear_of_sun_deg;
        let near_sun = || moon::near_sun(&moon, &sun, place, clear_deg);
        Some(Heavens {
            hidden: moon::below_horizon(&moon, place).or_else(near_sun),
            is_night: moon::is_night(&sun, place),
            moon,
        })
    }

    /// The Moon in a frame. One of another size than the camera's, or taken while the Moon cannot be seen, is stored and not searched.
    fn solve(&self, frame: &Frame, heavens: Option<&Heavens>) -> Result<Disc, Stopped> {
        if let Err(wrong) = self.camera.check(frame) {
            return Err(at(Stage::Light)(Rejected {
                reason: reasons::WRONG_SIZE,
                measured: wrong.width as f64,
                limit: wrong.expected_width as f64,
            }));
        }
        if let Some(hidden) = heavens.and_then(|heavens| heavens.hidden) {
            return Err(at(Stage::Sky)(hidden));
        }
        let settings = Settings {
            shading: Shading::LommelSeeliger,
            optics: Optics::Camera(self.camera.lens),
        };
        let expected = heavens.map_or(Expected::default(), |heavens| Expected::of(&heavens.moon));
        moon::solve(&settings, frame, &expected)
    }

    fn direction(&self, disc: &Disc) -> Option<crate::geometry::attitude::Direction> {
        self.camera.lens.direction(&disc.centre)
    }

    /// What a request is told.
    fn sight(&self, found: &Result<Disc, Stopped>, time: Timestamp) -> MoonSight {
        match found {
            Ok(disc) => match self.direction(disc) {
                Some(direction) => {
                    let (centre, covariance) = (disc.centre.position, disc.centre.covariance);
                    MoonSight::Found(MoonFix {
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
                (Stage::Sky, reasons::NEAR_SUN) => MoonSight::NotVisible { code: NEAR_SUN },
                (Stage::Sky, _) => MoonSight::NotVisible {
                    code: BELOW_HORIZON,
                },
                (_, reasons::WRONG_SIZE) => MoonSight::NotFound { code: WRONG_SIZE },
                _ => not_found(*stage),
            },
        }
    }

    fn note(&self, found: &Result<Disc, Stopped>) {
        let mut tally = self.tally.lock();
        let Stopped { stage, rejected } = match found {
            Ok(disc) => {
                *tally.solved.entry(disc.quality).or_default() += 1;
                return;
            }
            Err(stopped) => stopped,
        };
        let count = tally.reasons.entry((*stage, rejected.reason)).or_default();
        *count += 1;
        if worth_a_line(*count) {
            let (reason, frames) = (rejected.reason.sentence, *count);
            let (measured, limit) = (rejected.measured, rejected.limit);
            match stage {
                Stage::Sky => {
                    tracing::info!(reason, measured, limit, frames, "the Moon cannot be seen");
                }
                _ => {
                    let stage = stage.name();
                    tracing::warn!(stage, reason, measured, limit, frames, "no Moon");
                }
            }
        }
    }
}

fn not_found(stage: Stage) -> MoonSight {
    let after = match stage {
        Stage::Sky | Stage::Light => 0,
        Stage::Detection => 1,
        Stage::Limb => 2,
        Stage::Checks => 3,
    };
    MoonSight::NotFound {
        code: FIRST_STAGE + after,
    }
}

/// A frame's levels for the logs, and the Moon's light for the exposure that follows it. While the Moon cannot be seen, no light is its own.
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
    let told = frame::Levels {
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
    (Some(told), brightness)
}

fn disc_region(frame: &Frame, disc: &Disc) -> Option<Region> {
    let reach = disc.radius_px.value * disc.aspect.max(1.0);
    frame.around(disc.centre.position, reach)
}
