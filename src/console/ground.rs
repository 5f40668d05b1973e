//! The ground's own data beside the flight, and the drawings made from them: the instrument, the target, frames and
//! pictures solved on the ground.

use super::table::{Nanoseconds, timestamp};
use crate::aspect::{self, Expected};
use crate::frame::Frame;
use crate::instrument::Instrument;
use crate::pointing::{self, Offset, Roll, Target};
use crate::report::plot::{Labels, Series, square};
use crate::report::{self, Canvas};
use crate::sky::Ephemeris;
use crate::units::{Place, PlateMil};
use image::RgbImage;
use nalgebra::Matrix2;
use std::path::PathBuf;

/// Half width of the drawn plate, relative to the extent of its marks.
const REACH: f64 = 1.06;
/// The Sun's radius at 1 AU, if the ephemeris does not give the day's.
const RADIUS_ARCSEC: f64 = 959.23;
/// Half size of the crosses at the Sun's centre and the target, relative to the same extent.
const CROSS: f64 = 0.045;

/// Data on the ground.
#[derive(Clone)]
pub struct Ground {
    pub instrument: Instrument,
    pub settings: aspect::SolverSettings,
    pub target: Target,
    /// The gondola's place, for the target's position on the plate.
    pub place: Option<Place>,
    pub ephemeris: Ephemeris,
    /// The flight's archive, if it is available.
    pub archive: Option<PathBuf>,
}

/// The Sun on the plate according to the housekeeping.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SunOnPlate {
    pub time: Nanoseconds,
    pub at: PlateMil,
    pub sigma_mil: Option<f64>,
}

impl Ground {
    /// A frame solved here, with the result drawn over it.
    ///
    /// # Errors
    /// If the frame is not from the instrument's camera.
    pub fn overlay(&self, frame: &Frame, title: &str) -> anyhow::Result<RgbImage> {
        let instrument = self.instrument.seen_by(frame)?;
        let expected = frame.info.mid_exposure.and_then(Expected::at);
        let solution = aspect::solve_with(&self.settings, frame, &instrument, expected, None);
        Ok(report::overlay(frame, &solution, &instrument, title))
    }

    /// A frame of the archive as a picture, with or without the result drawn over it.
    ///
    /// # Errors
    /// If it is not from the instrument's camera.
    pub fn frame(&self, frame: &Frame, file: &str, with_overlay: bool) -> anyhow::Result<RgbImage> {
        if with_overlay {
            return self.overlay(frame, file);
        }
        let stretch = (0.0, frame.saturation_dn().into());
        Ok(Canvas::of_frame(frame, frame.region(), 1, stretch, 0).into_image())
    }

    /// Position of the Sun on the plate while the telescope is on its target. Without a place it is known for the Sun's
    /// centre only.
    fn on_target(&self, time: Nanoseconds) -> Option<PlateMil> {
        let utc = timestamp(time);
        let centre = self.instrument.mounting.boresight_mil;
        let Some(place) = self.place else {
            return (self.target == Target::default()).then_some(centre);
        };
        let sun = self.ephemeris.clone().sun(utc, place).ok()?;
        let target = self.target.at(utc, &sun).ok()?;
        let on_target = Offset {
            azimuth_deg: 0.0,
            elevation_deg: 0.0,
            cross_elevation_deg: 0.0,
            sigma_deg: 0.0,
            covariance_deg2: Matrix2::zeros(),
            calibration_deg2: Matrix2::zeros(),
            roll: Roll::Stated,
        };
        pointing::sun_on_plate_for(&on_target, Roll::Stated, &self.instrument, &sun, target).ok()
    }

    /// The plate with its marks, the Sun's disc and the target position of its centre.
    pub fn plate(&self, sun: &SunOnPlate) -> String {
        let optics = &self.instrument.optics;
        let radius_arcsec =
            Expected::at(timestamp(sun.time)).map(|expected| expected.radius_arcsec);
        let radius_mil = optics.radius_mil(radius_arcsec.unwrap_or(RADIUS_ARCSEC));
        let circle = |n: i32| {
            let (sin, cos) = f64::from(3 * n).to_radians().sin_cos();
            (sun.at.x + radius_mil * cos, sun.at.y + radius_mil * sin)
        };
        let plate = &self.instrument.plate;
        let [reach, size] = [REACH, CROSS].map(|part| part * plate.reach_mil());
        let cross = |at: PlateMil| {
            let gap = (f64::NAN, f64::NAN);
            [
                (at.x - size, at.y),
                (at.x + size, at.y),
                gap,
                (at.x, at.y - size),
                (at.x, at.y + size),
            ]
        };
        let marks = plate.marks().map(|(_, at)| (at.x, at.y));
        let mut series = vec![
            Series::dots("marks", marks).in_hue(5),
            Series::curve("Sun's limb", (0..=120).map(circle)).in_hue(4),
            Series::line("Sun's centre", cross(sun.at)).in_hue(1),
        ];
        let target = self.on_target(sun.time);
        series.extend(target.map(|at| Series::line("target", cross(at)).in_hue(0)));
        let sigma = sun.sigma_mil.map_or(String::new(), |sigma| {
            format!(
                " \u{b1} {sigma:.3} mil = {:.3} arcsec",
                sigma * optics.arcsec_per_mil()
            )
        });
        let title = format!("Sun at {:.2}, {:.2} mil{sigma}", sun.at.x, sun.at.y);
        square(
            &Labels::new(title, "X, mil", "Y, mil"),
            -reach..reach,
            &series,
        )
    }
}
