//! `solaspect moon`: determines the Moon's centre and direction from frames.

mod record;

use super::frames::{FramesArgs, Outcome, bad_file};
use super::options;
use crate::clock::parse_utc;
use crate::frame::Frame;
use crate::instrument::DirectionCamera;
use crate::moon::{self, Disc, Expected, MoonSettings, Optics, Radius, Stopped, local_from_camera};
use crate::sky::{Ephemeris, MoonPosition};
use crate::units::{Measured, Place};
use anyhow::{Context, ensure};
use clap::{Args, ValueEnum};
use jiff::Timestamp;
use nalgebra::Rotation3;
use record::{Found, Record};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

/// Relative sigma of a stated radius.
const RADIUS_SIGMA: f64 = 2e-4;

/// Find the Moon in frames: the centre of its whole disc at any phase, and its direction
///
/// Reads what `solve` reads. One answer per frame, in the order of the arguments. With the time and a place, the ephemeris says what size and phase
/// the Moon must have, and what is not like that is refused. A frame without the Moon is no failure; a file that cannot be read gives an error on its
/// line, the rest go on, and the exit code is 1.
#[derive(Debug, Args)]
#[command(allow_negative_numbers = true)]
pub struct MoonArgs {
    #[command(flatten)]
    frames: FramesArgs,
    /// The camera's TOML file: size, principal point, focal lengths, distortion [default: square pixels, and no direction]
    #[arg(long, value_name = "CAM.toml")]
    instrument: Option<PathBuf>,
    /// The disc's radius, of an oval one its vertical half axis [default: with --instrument and a place, the ephemeris's; else it is
    /// found]
    #[arg(long, value_name = "PX")]
    radius_px: Option<f64>,
    /// The instant of all frames, ISO 8601 [default: each frame's own time]
    #[arg(long, value_name = "UTC", value_parser = parse_utc, requires = "place")]
    at: Option<Timestamp>,
    /// The camera's place: geodetic latitude and longitude (deg, east positive) and height (m)
    #[arg(long, value_name = "LAT,LON,HEIGHT_M", allow_hyphen_values = true)]
    place: Option<Place>,
    /// How the camera points: azimuth (from north over east) and elevation of its axis, and its roll (right side low positive). Gives
    /// the direction east, north, up
    #[arg(long, value_name = "AZ,EL,ROLL_DEG", allow_hyphen_values = true, value_parser = parse_attitude, requires = "instrument")]
    attitude: Option<Attitude>,
    /// How the ground scatters light
    #[arg(long, value_enum, default_value_t = Shading::LommelSeeliger)]
    shading: Shading,
    /// How the centre is found
    #[arg(long, value_enum, default_value_t = Method::Limb)]
    method: Method,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum Shading {
    /// As dark ground does
    LommelSeeliger,
    /// As chalk does
    Lambert,
}

impl From<Shading> for moon::Shading {
    fn from(shading: Shading) -> Self {
        match shading {
            Shading::LommelSeeliger => Self::LommelSeeliger,
            Shading::Lambert => Self::Lambert,
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Method {
    /// Least squares of the light across the lit limb
    Limb,
    /// The circle through three of the light's eight extremities, fast and coarse
    Extremities,
}

/// Pointing of a camera.
#[derive(Debug, Clone, Copy)]
struct Attitude {
    local_from_camera: Rotation3<f64>,
}

fn parse_attitude(text: &str) -> Result<Attitude, String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[azimuth, elevation, roll])
            if azimuth.abs() <= 360.0 && elevation.abs() <= 90.0 && roll.abs() <= 360.0 =>
        {
            Ok(Attitude {
                local_from_camera: local_from_camera(azimuth, elevation, roll),
            })
        }
        _ => Err(format!(
            "expected AZ,EL,ROLL within 360, 90 and 360 deg, found \"{text}\""
        )),
    }
}

pub fn run(mut args: MoonArgs) -> anyhow::Result<ExitCode> {
    if let Some(radius_px) = args.radius_px {
        ensure!(
            (4.0..=1e5).contains(&radius_px),
            "--radius-px: expected a number from 4 to 100000 px, found {radius_px}"
        );
    }
    ensure!(
        args.method == Method::Limb || args.frames.overlay.is_none(),
        "--overlay: expected --method limb; the circle of extremities is not drawn"
    );
    let camera = args
        .instrument
        .as_deref()
        .map(DirectionCamera::read)
        .transpose()?;
    args.frames.prepare()?;
    let batch = Batch {
        settings: MoonSettings {
            shading: args.shading.into(),
            optics: camera
                .as_ref()
                .map_or(Optics::Aspect(1.0), |camera| Optics::Camera(camera.lens)),
        },
        camera,
        ephemeris: options::ephemeris(&options::config(None)?)?,
        args: &args,
    };
    let frames = &args.frames;
    frames.print::<Record>(|take| {
        frames.in_order(&frames.frames, |path: &PathBuf| batch.outcome(path), take)
    })
}

/// Shared inputs of all frames.
struct Batch<'a> {
    settings: MoonSettings,
    camera: Option<DirectionCamera>,
    ephemeris: Ephemeris,
    args: &'a MoonArgs,
}

impl Batch<'_> {
    fn outcome(&self, path: &Path) -> Outcome<Record> {
        self.solve(path).or_else(|error| bad_file(path, &error))
    }

    fn solve(&self, path: &Path) -> anyhow::Result<Record> {
        let size_px = self.camera.as_ref().map(DirectionCamera::size_px);
        let frame = self.args.frames.read(path, size_px)?;
        if let Some(camera) = &self.camera {
            let size = camera.check(&frame);
            size.with_context(|| path.display().to_string())?;
        }
        let moon = self
            .position(&frame)
            .with_context(|| path.display().to_string())?;
        let start = Instant::now();
        let found = match self.not_up(moon.as_ref()) {
            Some(stopped) => Found::None(stopped),
            None => self.find(&frame, moon.as_ref()),
        };
        let time = start.elapsed();
        if let Some(disc) = found.drawn() {
            self.args
                .frames
                .draw(path, |title| moon::overlay(&frame, &disc, title))?;
        }
        let lens = self.camera.as_ref().map(|camera| &camera.lens);
        let turn = self
            .args
            .attitude
            .as_ref()
            .map(|attitude| &attitude.local_from_camera);
        Ok(Record::of(
            &path.display().to_string(),
            &found,
            lens,
            turn,
            time,
        ))
    }

    /// Position of the Moon by the ephemeris, if time and place are known.
    fn position(&self, frame: &Frame) -> anyhow::Result<Option<MoonPosition>> {
        let Some(place) = self.args.place else {
            return Ok(None);
        };
        let utc = self.args.at.or(frame.info.mid_exposure);
        if utc.is_none() && frame.info.untimed.is_some() {
            return Ok(None);
        }
        let utc = utc.context("expected --at, or a time in the frame's header")?;
        Ok(Some(self.ephemeris.clone().moon(utc, place)?))
    }

    /// The reason for a Moon below the horizon.
    fn not_up(&self, moon: Option<&MoonPosition>) -> Option<Stopped> {
        let below = moon::below_horizon(moon?, self.args.place?);
        below.map(crate::reasons::at(moon::Stage::Sky))
    }

    fn find(&self, frame: &Frame, moon: Option<&MoonPosition>) -> Found {
        match self.args.method {
            Method::Limb => {
                let solved: Result<Disc, Stopped> =
                    moon::solve(&self.settings, frame, &self.expected(moon));
                solved.map_or_else(Found::None, |disc| Found::Disc(Box::new(disc)))
            }
            Method::Extremities => {
                let circle = moon::by_extremities(&self.settings, frame);
                circle.map_or_else(Found::None, |(centre, radius_px)| {
                    Found::Circle(centre, radius_px)
                })
            }
        }
    }

    fn expected(&self, moon: Option<&MoonPosition>) -> Expected {
        let mut expected = moon.map_or(Expected::default(), Expected::of);
        let lens = self.camera.as_ref().map(|camera| &camera.lens);
        if let (Some(moon), Some(lens), Some(attitude)) = (moon, lens, &self.args.attitude) {
            expected = expected.seen_by(moon, lens, &attitude.local_from_camera);
        }
        if let Some(radius_px) = self.args.radius_px {
            let radius = Measured::new(radius_px, RADIUS_SIGMA * radius_px);
            expected.radius = Some(Radius::Pixels(radius));
        } else if lens.is_none() {
            // An angle is not a number of pixels.
            expected.radius = None;
        }
        expected
    }
}
