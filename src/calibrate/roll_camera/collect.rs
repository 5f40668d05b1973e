//! Makes observations from frames.

use super::observation::{Horizon, HorizonObservation, Known};
use crate::calibrate::mounting::{AttitudeLog, SunObservation};
use crate::config;
use crate::frame::Frame;
use crate::horizon::{self, EdgeHeight, HorizonSettings, Sphere};
use crate::instrument::{DirectionCamera, Instrument};
use crate::observe::{InputError, RejectedFrame, Watch, each_frame};
use crate::pointing::{body_nadir, sun_in_telescope};
use crate::units::{Measured, Place};
use jiff::Timestamp;
use nalgebra::UnitVector3;
use std::path::{Path, PathBuf};

/// Frames of the Sun further apart are not interpolated, s.
const LONGEST_STEP_S: f64 = 1.5;

/// Camera and observer's position with which frames of the horizon are solved.
#[derive(Debug, Clone)]
pub struct Horizons<'a> {
    pub camera: &'a DirectionCamera,
    pub settings: config::Roll,
    /// Position used for frames that do not state theirs.
    pub place: Option<Place>,
}

impl Horizons<'_> {
    /// The sphere below the camera, and the solution of a frame.
    ///
    /// # Errors
    /// If a frame is of another size, or has no height.
    pub fn solved(
        &self,
        frame: &Frame,
        height: EdgeHeight,
    ) -> Result<(Sphere, horizon::Solution), String> {
        let size = self.camera.check(frame);
        size.map_err(|error| error.to_string())?;
        let place = frame.info.place.or(self.place);
        let sphere = self.settings.sphere(place.map(|place| place.height_m));
        let sphere = sphere.ok_or(
            "no height above the limb's edge: expected OBSGEO-H, or --place LAT,LON,HEIGHT_M",
        )?;
        let settings = HorizonSettings {
            height,
            ..HorizonSettings::default()
        };
        let solution = horizon::solve(&settings, frame, self.camera, &sphere, None);
        Ok((sphere, solution))
    }

    fn solve(&self, file: &Path, frame: &Frame) -> Result<Horizon, String> {
        let utc = frame.info.mid_exposure.ok_or("no time")?;
        let (_, solution) = self.solved(frame, EdgeHeight::Given)?;
        match solution.nadir {
            Ok(nadir) => Ok(Horizon {
                file: file.into(),
                utc,
                nadir: nadir.direction,
            }),
            Err(stopped) => Err(stopped.to_string()),
        }
    }
}

/// Solves frames of the horizon: returns those that show one, in the order of time, and the others.
///
/// # Errors
/// [`InputError::Cancelled`].
pub fn collect(
    files: &[PathBuf],
    horizons: &Horizons<'_>,
    watch: &dyn Watch,
) -> Result<(Vec<Horizon>, Vec<RejectedFrame>), InputError> {
    let size_px = horizons.camera.size_px();
    let observed = each_frame(files.to_vec(), size_px, watch, |file, frame| {
        horizons.solve(file, &frame)
    })?;
    let (mut seen, rejected) = observed.split();
    seen.sort_by_key(|horizon| horizon.utc);
    Ok((seen, rejected))
}

/// Observations at moments at which the body's attitude is known.
pub fn with_attitude(
    horizons: Vec<Horizon>,
    log: &AttitudeLog,
) -> (Vec<HorizonObservation>, Vec<RejectedFrame>) {
    let known = |utc: Timestamp| {
        let [roll_deg, pitch_deg] = log.at(utc)?.map(|deg| Measured::new(deg, 0.0));
        Ok(Known::Nadir(body_nadir(roll_deg, pitch_deg).unit))
    };
    observations(horizons, known)
}

/// Observations at moments at which a telescope on the same body saw the Sun; `suns` in the order of time.
pub fn with_sun(
    horizons: Vec<Horizon>,
    suns: &[SunObservation],
    telescope: &Instrument,
) -> (Vec<HorizonObservation>, Vec<RejectedFrame>) {
    let unit =
        |sun: &SunObservation| sun_in_telescope(sun.sun_plate.position, telescope).into_inner();
    let known = |utc: Timestamp| {
        let next = suns.partition_point(|sun| sun.utc < utc);
        let after = suns.get(next).ok_or("no frame of the Sun after it")?;
        let before = suns.get(next.saturating_sub(1));
        let before = before.filter(|sun| sun.utc <= utc).unwrap_or(after);
        let step_s = after.utc.duration_since(before.utc).as_secs_f64();
        let since_s = utc.duration_since(before.utc).as_secs_f64();
        if step_s > LONGEST_STEP_S || since_s < 0.0 {
            return Err("no frames of the Sun about it".into());
        }
        let part = if step_s > 0.0 { since_s / step_s } else { 0.0 };
        let between = unit(before) * (1.0 - part) + unit(after) * part;
        let elevations = [before, after].map(|sun| sun.sun.elevation_deg);
        Ok(Known::Sun {
            unit: UnitVector3::new_normalize(between),
            elevation_deg: elevations[0] * (1.0 - part) + elevations[1] * part,
        })
    };
    observations(horizons, known)
}

fn observations(
    horizons: Vec<Horizon>,
    known: impl Fn(Timestamp) -> Result<Known, String>,
) -> (Vec<HorizonObservation>, Vec<RejectedFrame>) {
    let observation = |horizon: Horizon| match known(horizon.utc) {
        Ok(known) => Ok(HorizonObservation { horizon, known }),
        Err(reason) => Err(RejectedFrame::new(horizon.file, reason)),
    };
    split(horizons.into_iter().map(observation).collect())
}

fn split<T>(all: Vec<Result<T, RejectedFrame>>) -> (Vec<T>, Vec<RejectedFrame>) {
    let (mut good, mut bad) = (Vec::new(), Vec::new());
    for one in all {
        match one {
            Ok(one) => good.push(one),
            Err(one) => bad.push(one),
        }
    }
    (good, bad)
}
