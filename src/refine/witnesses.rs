//! Two witnesses of where the telescope points: what its cameras show, held against the attitude by the gyros.
//!
//! The Sun tells the boresight's two axes. Roll is compared by the dip of the telescope's second axis, which is the body's: that is what the
//! horizon shows of it, at any elevation.

use super::roll::RollRow;
use super::row::Row;
use crate::clock::utc_microseconds;
use crate::instrument::Instrument;
use crate::pointing::measured_sun_in_telescope;
use crate::pointing_history::{Basis, PointingHistory, Sight};
use crate::report::plot::{Labels, PlotError, Series, series};
use crate::units::{ARCSEC_PER_RAD, Measured};
use jiff::Timestamp;
use serde::Serialize;
use std::fmt;

/// A difference beyond so many sigma, for so long, is a finding.
const BEYOND_SIGMA: f64 = 5.0;
const FOR_S: f64 = 10.0;

/// About what the witnesses differ.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Axis {
    Right,
    Up,
    Roll,
}

impl Axis {
    const ALL: [Self; 3] = [Self::Right, Self::Up, Self::Roll];

    fn name(self) -> &'static str {
        match self {
            Self::Right => "right",
            Self::Up => "up",
            Self::Roll => "roll",
        }
    }
}

/// What a camera showed at a time, rad: the Sun to the right of the boresight and above it, or how deep the second axis dips.
#[derive(Clone, Copy)]
struct Shown {
    unix_s: f64,
    axis: Axis,
    found: Measured,
}

/// What the cameras of a flight showed.
#[derive(Clone, Default)]
pub(super) struct Witnesses(Vec<Shown>);

impl Witnesses {
    /// Notes the Sun of a refined frame.
    pub fn see_sun(&mut self, row: &Row, instrument: &Instrument) {
        let Some((unix_s, sun)) = row.unix_s().zip(row.sun_at_time()) else {
            return;
        };
        let sun = measured_sun_in_telescope(&sun, instrument);
        let sigma = |n: usize| sun.covariance_rad2[(n, n)].max(0.0).sqrt();
        for (axis, found) in [
            (Axis::Right, Measured::new(sun.unit.y, sigma(1))),
            (Axis::Up, Measured::new(-sun.unit.z, sigma(2))),
        ] {
            self.0.push(Shown {
                unix_s,
                axis,
                found,
            });
        }
    }

    /// Notes the horizon of a frame of the roll camera.
    pub fn see_nadir(&mut self, row: &RollRow) {
        if let Some((unix_s, nadir)) = row.unix_s().zip(row.nadir_at_time()) {
            let sigma = nadir.covariance_rad2.m22.max(0.0).sqrt();
            self.0.push(Shown {
                unix_s,
                axis: Axis::Roll,
                found: Measured::new(nadir.unit.y, sigma),
            });
        }
    }

    /// Holds them against the pointing, where that rests on gyros. `None` where it never does.
    pub fn compare(&self, pointing: &PointingHistory) -> Option<Compared> {
        let difference = |shown: &Shown| {
            let sight = pointing.at(shown.unix_s).sight?;
            (sight.basis != Basis::Sun).then(|| shown.difference(&sight))
        };
        let axes = Axis::ALL.map(|axis| {
            let mut differences: Vec<Difference> = self
                .0
                .iter()
                .filter(|shown| shown.axis == axis)
                .filter_map(difference)
                .collect();
            differences.sort_by(|a, b| a.unix_s.total_cmp(&b.unix_s));
            differences
        });
        let is_empty = axes.iter().all(Vec::is_empty);
        (!is_empty).then(|| Compared::of(axes))
    }
}

impl Shown {
    /// What was seen less what the gyros say.
    fn difference(&self, sight: &Sight) -> Difference {
        let random_rad2 = sight.random_arcsec2 / ARCSEC_PER_RAD.powi(2);
        let to_sun = sight.sun_from_telescope.row(0);
        let level = sight.horizon_from_telescope.row(2);
        let (told, variance_rad2) = match self.axis {
            Axis::Right => (to_sun[1], random_rad2.m11),
            Axis::Up => (-to_sun[2], random_rad2.m22),
            Axis::Roll => (-level[1], random_rad2.m33 * level[2].powi(2)),
        };
        Difference {
            unix_s: self.unix_s,
            rad: self.found.value - told,
            sigma_rad: self.found.sigma.hypot(variance_rad2.max(0.0).sqrt()),
        }
    }
}

/// A difference of the witnesses.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Difference {
    unix_s: f64,
    rad: f64,
    sigma_rad: f64,
}

impl Difference {
    fn over_sigma(&self) -> f64 {
        self.rad / self.sigma_rad
    }
}

/// Cameras against gyros, axis by axis.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Compared {
    pub axes: Vec<ComparedAxis>,
    /// Where they contradict each other.
    pub findings: Vec<Contradiction>,
    #[serde(skip)]
    differences: [Vec<Difference>; 3],
}

/// One axis of a flight.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ComparedAxis {
    pub axis: Axis,
    pub frames: usize,
    pub rms_arcsec: f64,
    /// Of the differences over their sigma.
    pub rms_over_sigma: f64,
    pub most_over_sigma: f64,
}

/// From when to when two witnesses contradict each other.
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
    fn of(differences: [Vec<Difference>; 3]) -> Self {
        let of_axis = || Axis::ALL.into_iter().zip(&differences);
        let seen = of_axis().filter(|(_, differences)| !differences.is_empty());
        Self {
            axes: seen
                .map(|(axis, all)| ComparedAxis::of(axis, all))
                .collect(),
            findings: of_axis()
                .flat_map(|(axis, all)| contradictions(axis, all))
                .collect(),
            differences,
        }
    }

    /// The heads and the rows of a table of the axes.
    pub(super) fn table(&self) -> ([&'static str; 5], Vec<Vec<String>>) {
        let row = |axis: &ComparedAxis| {
            vec![
                axis.axis.name().to_owned(),
                axis.frames.to_string(),
                format!("{:.3}", axis.rms_arcsec),
                format!("{:.2}", axis.rms_over_sigma),
                format!("{:.1}", axis.most_over_sigma),
            ]
        };
        let heads = ["axis", "frames", "rms, arcsec", "rms, sigma", "most, sigma"];
        (heads, self.axes.iter().map(row).collect())
    }

    /// The differences over their sigma with time.
    pub(super) fn figure(&self) -> Result<String, PlotError> {
        let drawn = Axis::ALL.into_iter().zip(&self.differences);
        let drawn = drawn.filter(|(_, differences)| !differences.is_empty());
        let dots = |(axis, all): (Axis, &Vec<Difference>)| {
            let dots = all.iter().map(|one| (one.unix_s, one.over_sigma()));
            Series::dots(axis.name(), dots)
        };
        let title = "What cameras show less what the gyros say";
        let labels = Labels::over_utc(title, "over its sigma");
        series(&labels, &drawn.map(dots).collect::<Vec<_>>())
    }
}

impl ComparedAxis {
    fn of(axis: Axis, all: &[Difference]) -> Self {
        let rms = |value: fn(&Difference) -> f64| {
            let squares: f64 = all.iter().map(|one| value(one).powi(2)).sum();
            (squares / all.len() as f64).sqrt()
        };
        Self {
            axis,
            frames: all.len(),
            rms_arcsec: rms(|one| one.rad) * ARCSEC_PER_RAD,
            rms_over_sigma: rms(Difference::over_sigma),
            most_over_sigma: most(all),
        }
    }
}

fn most(all: &[Difference]) -> f64 {
    let sigmas = all.iter().map(|one| one.over_sigma().abs());
    sigmas.fold(0.0, f64::max)
}

/// The stretches in which all differences of an axis are too large.
fn contradictions(axis: Axis, all: &[Difference]) -> Vec<Contradiction> {
    let is_beyond = |one: &Difference| one.over_sigma().abs() > BEYOND_SIGMA;
    let stretches = all.chunk_by(|a, b| is_beyond(a) == is_beyond(b));
    let utc = |unix_s: f64| {
        let utc = Timestamp::from_microsecond((unix_s * 1e6).round() as i64);
        utc.map_or(String::new(), utc_microseconds)
    };
    let finding = |stretch: &[Difference]| {
        let (first, last) = stretch.first().zip(stretch.last())?;
        let during_s = [first.unix_s, last.unix_s];
        (is_beyond(first) && during_s[1] - during_s[0] >= FOR_S).then(|| Contradiction {
            axis,
            first_utc: utc(during_s[0]),
            last_utc: utc(during_s[1]),
            most_over_sigma: most(stretch),
            during_s,
        })
    };
    stretches.filter_map(finding).collect()
}

/// In a line, for people.
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
        let witness = match self.axis {
            Axis::Right | Axis::Up => "the Sun",
            Axis::Roll => "the horizon",
        };
        let (axis, first, last) = (self.axis.name(), &self.first_utc, &self.last_utc);
        write!(
            out,
            "{witness} contradicts the gyros in {axis} from {first} to {last}: by up to {:.1} sigma",
            self.most_over_sigma
        )
    }
}
