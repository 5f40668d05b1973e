//! Consistency check of the telescope's pointing: the directions from its cameras compared with the attitude by gyros.
//!
//! Directions that the filter uses are compared by its innovations ([`navigation`](crate::navigation)). A roll camera that it does not use
//! is compared by the dip of the telescope's second axis, which is the body's: the horizon gives the roll in this form at any elevation.

use super::roll::RollRow;
use crate::clock::utc_microseconds;
use crate::navigation::{Axis, LASTING_S, MOST_SIGMAS};
use crate::pointing_history::{Basis, LineOfSight, PointingHistory};
use crate::report::plot::{Labels, PlotError, Series, series};
use crate::units::{ARCSEC_PER_RAD, Measured};
use jiff::Timestamp;
use serde::Serialize;
use std::fmt;

/// A difference between camera and gyros.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Difference {
    pub unix_s: f64,
    pub axis: Axis,
    /// The difference over its 1 sigma.
    pub sigmas: f64,
}

/// Dip of the telescope's second axis, measured by the roll camera.
#[derive(Clone, Copy)]
struct Dip {
    unix_s: f64,
    rad: Measured,
}

/// Dips measured by the roll camera of a flight.
#[derive(Default)]
pub(super) struct Dips(Vec<Dip>);

impl Dips {
    /// Records the horizon of a frame.
    pub fn add(&mut self, row: &RollRow) {
        if let Some((unix_s, nadir)) = row.unix_s().zip(row.nadir_at_time()) {
            let sigma = nadir.covariance_rad2.m22.max(0.0).sqrt();
            let rad = Measured::new(nadir.unit.y, sigma);
            self.0.push(Dip { unix_s, rad });
        }
    }

    /// Differences from the pointing, where that is based on gyros.
    fn differences(&self, pointing: &PointingHistory) -> impl Iterator<Item = Difference> {
        self.0.iter().filter_map(|dip| {
            let line_of_sight = pointing.at(dip.unix_s).line_of_sight?;
            (line_of_sight.basis != Basis::Sun).then(|| dip.difference(&line_of_sight))
        })
    }
}

impl Dip {
    /// Measured minus predicted by the gyros.
    fn difference(&self, line_of_sight: &LineOfSight) -> Difference {
        // A roll changes the second axis's height by the vertical component of the third axis.
        let up = line_of_sight.horizon_from_telescope.row(2);
        let variance_rad2 =
            line_of_sight.random_arcsec2.m33 / ARCSEC_PER_RAD.powi(2) * up[2].powi(2);
        let sigma_rad = self.rad.sigma.hypot(variance_rad2.max(0.0).sqrt());
        Difference {
            unix_s: self.unix_s,
            axis: Axis::Roll,
            sigmas: (self.rad.value + up[1]) / sigma_rad,
        }
    }
}

/// Cameras against gyros, axis by axis.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Compared {
    pub axes: Vec<ComparedAxis>,
    /// Times at which they contradict each other.
    pub findings: Vec<Contradiction>,
    #[serde(skip)]
    pub(super) differences: [Vec<Difference>; 3],
}

/// Comparison of one axis over a flight.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ComparedAxis {
    pub axis: Axis,
    pub frames: usize,
    /// Rms and maximum of the differences over their sigma.
    pub rms_over_sigma: f64,
    pub most_over_sigma: f64,
}

/// A time span in which camera and gyros contradict each other.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Contradiction {
    pub axis: Axis,
    pub first_utc: String,
    pub last_utc: String,
    pub most_over_sigma: f64,
    #[serde(skip)]
    pub during_s: [f64; 2],
}

impl Compared {
    /// Compares the directions that the filter used, and the roll camera where it used none. `None` if there is nothing to compare.
    pub(super) fn of(
        by_filter: &[Difference],
        dips: &Dips,
        pointing: &PointingHistory,
    ) -> Option<Self> {
        let differences = Axis::ALL.map(|axis| {
            let own = by_filter.iter().filter(|one| one.axis == axis);
            let own: Vec<Difference> = own.copied().collect();
            match axis {
                Axis::Roll if own.is_empty() => dips.differences(pointing).collect(),
                _ => own,
            }
        });
        let of_axis = || Axis::ALL.into_iter().zip(&differences);
        let seen = of_axis().filter(|(_, all)| !all.is_empty());
        let axes: Vec<ComparedAxis> = seen
            .map(|(axis, all)| ComparedAxis::of(axis, all))
            .collect();
        let findings = of_axis()
            .flat_map(|(axis, all)| contradictions(axis, all))
            .collect();
        (!axes.is_empty()).then_some(Self {
            axes,
            findings,
            differences,
        })
    }

    /// The headings and the rows of a table of the axes.
    pub(super) fn table(&self) -> ([&'static str; 4], Vec<Vec<String>>) {
        let row = |axis: &ComparedAxis| {
            vec![
                axis.axis.name().to_owned(),
                axis.frames.to_string(),
                format!("{:.2}", axis.rms_over_sigma),
                format!("{:.1}", axis.most_over_sigma),
            ]
        };
        let heads = ["axis", "frames", "rms, sigma", "most, sigma"];
        (heads, self.axes.iter().map(row).collect())
    }

    /// The differences over their sigma with time.
    pub(super) fn figure(&self) -> Result<String, PlotError> {
        let drawn = Axis::ALL.into_iter().zip(&self.differences);
        let drawn = drawn.filter(|(_, differences)| !differences.is_empty());
        let dots = |(axis, all): (Axis, &Vec<Difference>)| {
            let dots = all.iter().map(|one| (one.unix_s, one.sigmas));
            Series::dots(axis.name(), dots)
        };
        let title = "Cameras minus gyros";
        let labels = Labels::over_utc(title, "over its sigma");
        series(&labels, &drawn.map(dots).collect::<Vec<_>>())
    }
}

impl ComparedAxis {
    fn of(axis: Axis, all: &[Difference]) -> Self {
        let squares: f64 = all.iter().map(|one| one.sigmas.powi(2)).sum();
        Self {
            axis,
            frames: all.len(),
            rms_over_sigma: (squares / all.len() as f64).sqrt(),
            most_over_sigma: most(all),
        }
    }
}

fn most(all: &[Difference]) -> f64 {
    all.iter().fold(0.0, |most, one| one.sigmas.abs().max(most))
}

/// The stretches in which all differences of an axis are too large.
fn contradictions(axis: Axis, all: &[Difference]) -> Vec<Contradiction> {
    let is_beyond = |one: &Difference| one.sigmas.abs() > MOST_SIGMAS;
    let stretches = all.chunk_by(|a, b| is_beyond(a) == is_beyond(b));
    let utc = |unix_s: f64| {
        let utc = Timestamp::from_microsecond((unix_s * 1e6).round() as i64);
        utc.map_or(String::new(), utc_microseconds)
    };
    let finding = |stretch: &[Difference]| {
        let (first, last) = stretch.first().zip(stretch.last())?;
        let during_s = [first.unix_s, last.unix_s];
        (is_beyond(first) && during_s[1] - during_s[0] >= LASTING_S).then(|| Contradiction {
            axis,
            first_utc: utc(during_s[0]),
            last_utc: utc(during_s[1]),
            most_over_sigma: most(stretch),
            during_s,
        })
    };
    stretches.filter_map(finding).collect()
}

/// One line, for people.
impl fmt::Display for Compared {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let axis = |axis: &ComparedAxis| {
            let (name, rms, most) = (axis.axis.name(), axis.rms_over_sigma, axis.most_over_sigma);
            format!("{name} {rms:.2} sigma rms, at most {most:.1}")
        };
        let axes: Vec<String> = self.axes.iter().map(axis).collect();
        write!(out, "gyros against Sun and horizon: {}", axes.join("; "))
    }
}

impl fmt::Display for Contradiction {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let sensor = match self.axis {
            Axis::Right | Axis::Up => "the Sun",
            Axis::Roll => "the horizon",
        };
        let (axis, first, last) = (self.axis.name(), &self.first_utc, &self.last_utc);
        write!(
            out,
            "{sensor} contradicts the gyros in {axis} from {first} to {last}: by up to {:.1} sigma",
            self.most_over_sigma
        )
    }
}
