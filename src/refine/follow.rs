//! The Sun's path as the rows tell it, and the frames that lie off it.

use super::flight::Work;
use super::motion::{self, Path};
use super::oddities::note;
use super::row::{Oddity, Row};
use crate::units::PlateMil;

/// Off the path, chi^2 of two.
const ODD_PATH_CHI2: f64 = 100.0;
/// Rounds in which frames off the path are taken off it.
const PATH_ROUNDS: usize = 3;

/// The Sun's path.
pub(super) struct Followed {
    pub path: Option<Path>,
    /// Of each point, s since 1970.
    pub times_s: Vec<f64>,
    /// The point of each dated row.
    at: Vec<usize>,
}

impl Followed {
    /// Where the path has the disc at a row, and 1 sigma, mil.
    pub fn place(&self, row: usize) -> Option<(PlateMil, f64)> {
        let point = self.path.as_ref()?.points[self.at[row]];
        let ([x, y], variance) = (point.place_mil, point.variance_mil2);
        let sigma = ((variance[0] + variance[1]) / 2.0).sqrt();
        Some((PlateMil::new(x, y), sigma))
    }
}

impl Work<'_> {
    /// The Sun's path, without the frames that lie off it; between two frames one more point.
    pub(super) fn follow_path(&mut self) -> Followed {
        let first = self.rows.first().and_then(Row::unix_s).unwrap_or(0.0);
        let (mut moments, mut at) = self.moments(first);
        let mut path = motion::path(&moments);
        for _ in 1..PATH_ROUNDS {
            let off = path
                .as_ref()
                .map_or(Vec::new(), |path| off(path, &moments, &at));
            if off.is_empty() {
                break;
            }
            for n in off {
                note(&mut self.rows[n], Oddity::Path);
            }
            (moments, at) = self.moments(first);
            path = motion::path(&moments);
        }
        let times_s = moments.iter().map(|moment| first + moment.time_s).collect();
        Followed { path, times_s, at }
    }

    /// Moments of the path, and the one of each dated row.
    fn moments(&self, first: f64) -> (Vec<motion::Moment>, Vec<usize>) {
        let (mut moments, mut at) = (Vec::new(), Vec::new());
        let mut before: Option<f64> = None;
        for row in &self.rows[..self.dated] {
            let time_s = row.unix_s().unwrap_or(first) - first;
            if let Some(before) = before.filter(|before| time_s > *before) {
                moments.push(motion::Moment {
                    time_s: (before + time_s) / 2.0,
                    measured: None,
                });
            }
            let sun = row.sun.filter(|_| row.is_fine());
            let measured = sun.map(|sun| {
                let (at, c) = (sun.position, sun.covariance);
                [(at.x, c.m11), (at.y, c.m22)]
            });
            at.push(moments.len());
            moments.push(motion::Moment { time_s, measured });
            before = Some(time_s);
        }
        (moments, at)
    }
}

/// The rows that lie off a path.
fn off(path: &Path, moments: &[motion::Moment], at: &[usize]) -> Vec<usize> {
    let pull = |moment: usize| {
        let measured = moments[moment].measured?;
        Some(motion::pull_chi2(&path.points[moment], &measured))
    };
    let odd = |moment: usize| pull(moment).is_some_and(|pull| pull > ODD_PATH_CHI2);
    let rows = at.iter().enumerate();
    rows.filter_map(|(n, moment)| odd(*moment).then_some(n))
        .collect()
}
