//! Answer for a frame of the horizon.

use crate::cli::frames::{OutputRow, REMARKS};
use crate::geometry::attitude::Direction;
use crate::horizon::circle::Circle;
use crate::horizon::{Conic, Flag, Quality, Solution, Sphere, Stopped, pitch_deg, roll_deg};
use crate::record::Reason;
use nalgebra::UnitVector3;
use serde::Serialize;
use std::time::Duration;

/// Answer for a frame.
#[derive(Serialize)]
pub(super) struct Record {
    file: String,
    quality: &'static str,
    reason: Option<Reason>,
    nadir: Option<[f64; 3]>,
    sigma_deg: Option<f64>,
    covariance: Option<[[f64; 3]; 3]>,
    roll_deg: Option<f64>,
    pitch_deg: Option<f64>,
    conic: Option<&'static str>,
    flags: Vec<&'static str>,
    /// Height of the edge, if it was determined with the nadir.
    edge_m: Option<f64>,
    edge_sigma_m: Option<f64>,
    /// The camera's height from the circle.
    height_m: Option<f64>,
    #[serde(flatten)]
    pub body: InBody,
    /// Number of points of the edge.
    edge_points: usize,
    agreeing_points: usize,
    solve_us: u64,
}

/// The nadir in the axes of the vehicle's body.
#[derive(Clone, Default, Serialize)]
pub(super) struct InBody {
    nadir_body: Option<[f64; 3]>,
    sigma_body_deg: Option<f64>,
    covariance_body: Option<[[f64; 3]; 3]>,
}

impl InBody {
    pub fn of(direction: &Direction) -> Self {
        Self {
            nadir_body: Some(direction.unit.into_inner().into()),
            sigma_body_deg: Some(direction.sigma_rad().to_degrees()),
            covariance_body: Some(direction.covariance_rad2.transpose().into()),
        }
    }

    /// The nadir from circles, whose errors are not known.
    pub fn of_circles(unit: &UnitVector3<f64>) -> Self {
        Self {
            nadir_body: Some(unit.into_inner().into()),
            ..Self::default()
        }
    }
}

impl Record {
    /// Takes the body's attitude from both cameras of a pair; the frame's own remains if they disagree.
    pub fn join(&mut self, body: Option<&InBody>) {
        match body {
            Some(body) => self.body = body.clone(),
            None => self.flags.push(Flag::CamerasDisagree.name()),
        }
    }

    /// Record of a frame without a result.
    fn none(file: &str, stopped: Option<&Stopped>, time: Duration) -> Self {
        Self {
            file: file.into(),
            quality: Quality::None.name(),
            reason: stopped.map(Reason::of),
            nadir: None,
            sigma_deg: None,
            covariance: None,
            roll_deg: None,
            pitch_deg: None,
            conic: None,
            flags: Vec::new(),
            edge_m: None,
            edge_sigma_m: None,
            height_m: None,
            body: InBody::default(),
            edge_points: 0,
            agreeing_points: 0,
            solve_us: time.as_micros() as u64,
        }
    }

    /// Answer for a direction in the camera frame.
    fn pointing(self, unit: &UnitVector3<f64>, half_angle_rad: f64) -> Self {
        Self {
            nadir: Some(unit.into_inner().into()),
            roll_deg: Some(roll_deg(unit)),
            pitch_deg: Some(pitch_deg(unit)),
            conic: Some(Conic::of(unit, half_angle_rad).name()),
            ..self
        }
    }

    pub fn of(file: &str, solution: &Solution, sphere: &Sphere, time: Duration) -> Self {
        let record = Self {
            quality: solution.quality().name(),
            edge_points: solution.edge.rays.len(),
            agreeing_points: solution.agreeing(),
            ..Self::none(file, solution.reason(), time)
        };
        let Ok(nadir) = &solution.nadir else {
            return record;
        };
        let edge = nadir.edge_m(sphere);
        Self {
            sigma_deg: Some(nadir.direction.sigma_rad().to_degrees()),
            covariance: Some(nadir.direction.covariance_rad2.transpose().into()),
            flags: solution.flags().into_iter().map(Flag::name).collect(),
            edge_m: edge.map(|edge| edge.value),
            edge_sigma_m: edge.map(|edge| edge.sigma),
            ..record.pointing(&nadir.direction.unit, nadir.half_angle_rad.value)
        }
    }

    /// Record of a circle; the edge has a height if the body is the Earth.
    pub fn of_circle(
        file: &str,
        circle: &Result<Circle, Stopped>,
        edge_m: Option<f64>,
        time: Duration,
    ) -> Self {
        let record = Self::none(file, circle.as_ref().err(), time);
        let Ok(circle) = circle else {
            return record;
        };
        Self {
            quality: Quality::Coarse.name(),
            height_m: edge_m.map(|edge_m| circle.height_m(edge_m)),
            ..record.pointing(&circle.nadir, circle.half_angle_rad)
        }
    }

    /// The reason of a frame without a result, or the flags of one with a result.
    fn remarks(&self) -> String {
        match self.reason {
            Some(_) => self.reason_text(),
            None => self.flags.join(" "),
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
            "nadir_x",
            "nadir_y",
            "nadir_z",
            "sigma_deg",
            "covariance_xx_rad2",
            "covariance_xy_rad2",
            "covariance_xz_rad2",
            "covariance_yy_rad2",
            "covariance_yz_rad2",
            "covariance_zz_rad2",
            "roll_deg",
            "pitch_deg",
            "conic",
            "flags",
            "edge_m",
            "edge_sigma_m",
            "height_m",
            "nadir_body_x",
            "nadir_body_y",
            "nadir_body_z",
            "sigma_body_deg",
            "edge_points",
            "agreeing_points",
            "solve_us",
        ]
    }

    fn csv_row(&self) -> Vec<String> {
        let number = |value: Option<f64>| value.map_or(String::new(), |v| format!("{v:.9}"));
        let small = |value: Option<f64>| value.map_or(String::new(), |v| format!("{v:.6e}"));
        let mut row = vec![self.file.clone(), self.quality.into(), self.reason_text()];
        row.extend((0..3).map(|n| number(self.nadir.map(|nadir| nadir[n]))));
        row.push(number(self.sigma_deg));
        let upper = (0..3).flat_map(|i| (i..3).map(move |j| (i, j)));
        row.extend(upper.map(|(i, j)| small(self.covariance.map(|c| c[i][j]))));
        row.extend([self.roll_deg, self.pitch_deg].map(number));
        row.push(self.conic.unwrap_or_default().into());
        row.push(self.flags.join(" "));
        let metres = |value: Option<f64>| value.map_or(String::new(), |v| format!("{v:.1}"));
        row.extend([self.edge_m, self.edge_sigma_m, self.height_m].map(metres));
        row.extend((0..3).map(|n| number(self.body.nadir_body.map(|nadir| nadir[n]))));
        row.push(number(self.body.sigma_body_deg));
        let counts = [
            self.edge_points as u64,
            self.agreeing_points as u64,
            self.solve_us,
        ];
        row.extend(counts.map(|count| count.to_string()));
        row
    }

    fn table_columns() -> &'static [(&'static str, usize)] {
        &[
            ("", 6),
            ("roll, deg", 9),
            ("pitch, deg", 10),
            ("sigma, deg", 10),
            ("nadir x, y, z", 29),
            ("points", 6),
            ("", REMARKS),
        ]
    }

    fn table_row(&self) -> (&str, Vec<String>) {
        let number = |value: Option<f64>| value.map_or(String::new(), |v| format!("{v:.4}"));
        let nadir = self
            .nadir
            .map_or(String::new(), |[x, y, z]| format!("{x:.5}, {y:.5}, {z:.5}"));
        let fields = vec![
            self.quality.into(),
            number(self.roll_deg),
            number(self.pitch_deg),
            number(self.sigma_deg),
            nadir,
            self.agreeing_points.to_string(),
            self.remarks(),
        ];
        (&self.file, fields)
    }
}
