//! The Sun's path as the rows tell it, and the frames that lie off it.

use super::motion::{self, Path};
use super::row::{Oddity, Row};
use super::work::Work;
use crate::units::PlateMil;

/// Off the path, chi^2 of two.
const ODD_PATH_CHI2: f64 = 100.0;
/// A frame off the path pulls its neighbours off, so many to each side: in each round the worst of them goes, and the others are
/// held against the path without it.
const PULLED: usize = 8;
const PATH_ROUNDS: usize = 10;

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
                self.rows[n].note(Oddity::Path);
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

/// The rows that lie off a path, and farther than their neighbours.
fn off(path: &Path, moments: &[motion::Moment], at: &[usize]) -> Vec<usize> {
    let chi2 = |moment: &usize| {
        let measured = moments[*moment].measured;
        measured.map_or(0.0, |m| motion::residual_chi2(&path.points[*moment], &m))
    };
    let chi2: Vec<f64> = at.iter().map(chi2).collect();
    let worst = |n: usize| {
        let near = &chi2[n.saturating_sub(PULLED)..chi2.len().min(n + PULLED + 1)];
        near.iter().all(|other| *other <= chi2[n])
    };
    (0..chi2.len())
        .filter(|n| chi2[*n] > ODD_PATH_CHI2 && worst(*n))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_neighbours_off_the_path_the_worst_goes_first() {
        let moment = |n: usize| motion::Moment {
            time_s: n as f64 / 4.0,
            measured: Some([(if n == 30 { 500.0 } else { 0.1 * (n % 3) as f64 }, 0.01); 2]),
        };
        let moments: Vec<motion::Moment> = (0..60).map(moment).collect();
        let path = motion::path(&moments).unwrap();
        let at: Vec<usize> = (0..60).collect();
        assert_eq!(off(&path, &moments, &at), [30]);
        let neighbour = moments[31].measured.unwrap();
        assert!(motion::residual_chi2(&path.points[31], &neighbour) > ODD_PATH_CHI2);
    }
}
