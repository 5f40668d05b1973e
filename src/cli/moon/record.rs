//! Answer for a frame of the Moon.

use crate::cli::frames::{OutputRow, REMARKS};
use crate::geometry::camera::CameraModel;
use crate::moon::{Disc, Quality, Stopped};
use crate::record::Reason;
use crate::units::SensorPx;
use nalgebra::Rotation3;
use serde::Serialize;
use std::time::Duration;

/// Result for a frame.
pub(super) enum Found {
    Disc(Box<Disc>),
    /// Centre and vertical half axis, px, of the circle through the extremities.
    Circle(SensorPx, f64),
    None(Stopped),
}

impl Found {
    /// Content of an overlay.
    pub fn drawn(&self) -> Option<Result<Disc, Stopped>> {
        match self {
            Self::Disc(disc) => Some(Ok((**disc).clone())),
            Self::None(stopped) => Some(Err(*stopped)),
            Self::Circle(..) => None,
        }
    }
}

/// Answer for a frame.
#[derive(Serialize)]
pub(super) struct Record {
    file: String,
    quality: &'static str,
    reason: Option<Reason>,
    centre_px: Option<[f64; 2]>,
    radius_px: Option<f64>,
    centre_sigma_px: Option<[f64; 2]>,
    covariance_px2: Option<[[f64; 2]; 2]>,
    radius_sigma_px: Option<f64>,
    direction: Option<[f64; 3]>,
    direction_sigma_deg: Option<f64>,
    direction_local: Option<[f64; 3]>,
    phase_angle_deg: Option<f64>,
    phase_angle_sigma_deg: Option<f64>,
    lit: Option<f64>,
    lit_sigma: Option<f64>,
    bright_limb_deg: Option<f64>,
    solve_us: u64,
}

impl Record {
    pub fn of(
        file: &str,
        found: &Found,
        lens: Option<&CameraModel>,
        local_from_camera: Option<&Rotation3<f64>>,
        time: Duration,
    ) -> Self {
        let record = Self::none(file, time);
        match found {
            Found::None(stopped) => Self {
                reason: Some(Reason::of(stopped)),
                ..record
            },
            Found::Circle(centre, radius_px) => Self {
                quality: Quality::Coarse.name(),
                radius_px: Some(*radius_px),
                ..record.towards(*centre, lens, local_from_camera)
            },
            Found::Disc(disc) => Self::of_disc(disc, lens, record).towards(
                disc.centre.position,
                lens,
                local_from_camera,
            ),
        }
    }

    fn of_disc(disc: &Disc, lens: Option<&CameraModel>, record: Self) -> Self {
        let covariance = &disc.centre.covariance;
        let direction = lens.and_then(|lens| lens.direction(&disc.centre));
        Self {
            quality: disc.quality.name(),
            radius_px: Some(disc.radius_px.value),
            radius_sigma_px: Some(disc.radius_px.sigma),
            centre_sigma_px: Some(disc.centre.sigma()),
            covariance_px2: Some(covariance.transpose().into()),
            direction_sigma_deg: direction.map(|direction| direction.sigma_rad().to_degrees()),
            phase_angle_deg: Some(disc.phase_angle_deg.value),
            phase_angle_sigma_deg: Some(disc.phase_angle_deg.sigma),
            lit: Some(disc.lit().value),
            lit_sigma: Some(disc.lit().sigma),
            bright_limb_deg: Some(disc.bright_limb_deg),
            ..record
        }
    }

    /// The record with the centre and the directions to it.
    fn towards(
        self,
        centre: SensorPx,
        lens: Option<&CameraModel>,
        local_from_camera: Option<&Rotation3<f64>>,
    ) -> Self {
        let ray = lens.and_then(|lens| lens.ray(centre));
        let local = ray.zip(local_from_camera).map(|(ray, turn)| turn * ray);
        Self {
            centre_px: Some([centre.x, centre.y]),
            direction: ray.map(|ray| ray.into_inner().into()),
            direction_local: local.map(|local| local.into_inner().into()),
            ..self
        }
    }

    /// Record of a frame of which nothing is known.
    fn none(file: &str, time: Duration) -> Self {
        Self {
            file: file.into(),
            quality: "none",
            reason: None,
            centre_px: None,
            radius_px: None,
            centre_sigma_px: None,
            covariance_px2: None,
            radius_sigma_px: None,
            direction: None,
            direction_sigma_deg: None,
            direction_local: None,
            phase_angle_deg: None,
            phase_angle_sigma_deg: None,
            lit: None,
            lit_sigma: None,
            bright_limb_deg: None,
            solve_us: time.as_micros() as u64,
        }
    }

    fn reason_text(&self) -> String {
        let reason = self.reason.as_ref();
        reason.map_or(String::new(), |r| format!("{}: {}", r.stage, r.reason))
    }
}

impl OutputRow for Record {
    fn csv_columns() -> Vec<&'static str> {
        vec![
            "file",
            "quality",
            "reason",
            "centre_x_px",
            "centre_y_px",
            "radius_px",
            "centre_sigma_x_px",
            "centre_sigma_y_px",
            "covariance_xy_px2",
            "radius_sigma_px",
            "direction_x",
            "direction_y",
            "direction_z",
            "direction_sigma_deg",
            "direction_east",
            "direction_north",
            "direction_up",
            "phase_angle_deg",
            "phase_angle_sigma_deg",
            "lit",
            "lit_sigma",
            "bright_limb_deg",
            "solve_us",
        ]
    }

    fn csv_row(&self) -> Vec<String> {
        let number = |value: Option<f64>| value.map_or(String::new(), |v| format!("{v:.9}"));
        let mut row = vec![self.file.clone(), self.quality.into(), self.reason_text()];
        row.extend((0..2).map(|n| number(self.centre_px.map(|c| c[n]))));
        row.push(number(self.radius_px));
        row.extend((0..2).map(|n| number(self.centre_sigma_px.map(|c| c[n]))));
        row.push(number(self.covariance_px2.map(|c| c[0][1])));
        row.push(number(self.radius_sigma_px));
        row.extend((0..3).map(|n| number(self.direction.map(|d| d[n]))));
        row.push(number(self.direction_sigma_deg));
        row.extend((0..3).map(|n| number(self.direction_local.map(|d| d[n]))));
        row.extend([self.phase_angle_deg, self.phase_angle_sigma_deg].map(number));
        row.extend([self.lit, self.lit_sigma, self.bright_limb_deg].map(number));
        row.push(self.solve_us.to_string());
        row
    }

    fn table_columns() -> &'static [(&'static str, usize)] {
        &[
            ("", 6),
            ("centre, px", 20),
            ("sigma, px", 13),
            ("radius, px", 10),
            ("lit", 5),
            ("bright limb, deg", 16),
            ("", REMARKS),
        ]
    }

    fn table_row(&self) -> (&str, Vec<String>) {
        let number = |value: Option<f64>, digits: usize| {
            value.map_or(String::new(), |v| format!("{v:.digits$}"))
        };
        let pair =
            |pair: Option<[f64; 2]>| pair.map_or(String::new(), |[x, y]| format!("{x:.3}, {y:.3}"));
        let fields = vec![
            self.quality.into(),
            pair(self.centre_px),
            pair(self.centre_sigma_px),
            number(self.radius_px, 3),
            number(self.lit, 2),
            number(self.bright_limb_deg, 1),
            self.reason_text(),
        ];
        (&self.file, fields)
    }
}
