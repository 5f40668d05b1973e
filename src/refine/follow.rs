//! The Sun's path as the rows tell it, and the frames that lie off it.
//!
//! A frame whose limb tells its own radius, which is the flight's, is of the Sun: it makes the path, wherever it is. One that shows
//! less of the limb is held against the path of those.

use crate::smoothing::{self, Measurement, Moment, Path, PathPoint, SharedErrors};
use super::oddity::Oddity;
use super::row::Row;
use super::work::{TELLING_LIMB, Work};
use crate::estimation::median;
use crate::geometry::view::UNIT_MIL;
use crate::units::{Estimate, PlateMil};
use nalgebra::Vector2;

/// Off the path, chi^2 of two.
pub(super) const ODD_PATH_CHI2: f64 = 100.0;

/// Beyond this the path is a guess, 1 sigma.
const MOST_SIGMA_MIL: f64 = 100.0;

/// Whether the path is no guess at a point.
pub(super) fn is_known(point: &PathPoint) -> bool {
    let sigma = point.variance.map(f64::sqrt);
    sigma.iter().all(|sigma| *sigma < MOST_SIGMA_MIL)
}

/// The Sun's path.
pub(super) struct Followed {
    pub path: Option<Path>,
    /// Of each point, s since 1970.
    pub times_s: Vec<f64>,
    /// The point of each dated row.
    at: Vec<usize>,
}

impl Followed {
    /// Where the path most likely has the disc at a row, and 1 sigma, mil.
    pub fn place(&self, row: usize) -> Option<(PlateMil, f64)> {
        let point = self.path.as_ref()?.likeliest[self.at[row]];
        let ([x, y], variance) = (point.place, point.variance);
        let sigma = ((variance[0] + variance[1]) / 2.0).sqrt();
        Some((PlateMil::new(x, y), sigma))
    }

    /// How fast the Sun moves at the dated row, mil/s; `None` where the path is a guess.
    pub fn speed(&self, row: usize) -> Option<[f64; 2]> {
        let point = &self.path.as_ref()?.points[*self.at.get(row)?];
        is_known(point).then_some(point.speed)
    }
}

impl Work<'_> {
    /// The Sun's path, without the frames that lie off it; between two frames one more point.
    pub(super) fn follow_path(&mut self) -> Followed {
        let mut followed = self.path_of(Row::is_sure);
        let is_doubtful = |row: &Row| row.is_fine() && !row.is_sure();
        let doubtful: Vec<usize> = (0..self.dated)
            .filter(|n| is_doubtful(&self.rows[*n]))
            .collect();
        for n in &doubtful {
            let point = followed
                .path
                .as_ref()
                .map(|path| &path.points[followed.at[*n]]);
            if point.is_some_and(|point| is_off(&self.rows[*n], point)) {
                self.rows[*n].note(Oddity::Path);
            }
        }
        if !doubtful.is_empty() {
            followed = self.path_of(Row::is_fine);
        }
        followed
    }

    /// The path of some of the dated rows.
    fn path_of(&self, counts: impl Fn(&Row) -> bool) -> Followed {
        let first = self.rows.first().and_then(Row::unix_s).unwrap_or(0.0);
        let (mut moments, mut at) = (Vec::new(), Vec::new());
        let mut before: Option<f64> = None;
        for row in &self.rows[..self.dated] {
            let time_s = row.unix_s().unwrap_or(first) - first;
            if let Some(before) = before.filter(|before| time_s > *before) {
                moments.push(Moment {
                    time_s: (before + time_s) / 2.0,
                    time_sigma_s: 0.0,
                    measured: None,
                });
            }
            let measured = measurements(row).filter(|_| counts(row) && row.is_timed());
            at.push(moments.len());
            moments.push(Moment {
                time_s,
                time_sigma_s: row.time_sigma_s.unwrap_or(0.0),
                measured,
            });
            before = Some(time_s);
        }
        Followed {
            path: smoothing::path(&moments, &self.shared_errors(first)),
            times_s: moments.iter().map(|moment| first + moment.time_s).collect(),
            at,
        }
    }

    /// How long the mapping's errors last. Those of a smoothed random walk are correlated over twice their variance over the density of the
    /// walk; jumps draw them anew.
    fn shared_errors(&self, first_s: f64) -> SharedErrors {
        let dated = &self.rows[..self.dated];
        let Some(facts) = self.mapping.as_ref().map(|mapping| &mapping.facts) else {
            return SharedErrors::default();
        };
        let time = |row: &Row| {
            let scale = row.mapping?.there.scale_mil_per_px.value;
            let [shift, turn] = facts.process_noise_px.map(|px| (px * scale).powi(2));
            let [x, y] = measurements(row)?;
            let away = row.sun?.position.vector().norm_squared() / UNIT_MIL.powi(2);
            Some((x.shared_variance + y.shared_variance) / (shift + turn * away))
        };
        let fine = dated.iter().filter(|row| row.is_fine());
        let jumps = facts.jumps.iter();
        SharedErrors {
            correlation_s: median(fine.filter_map(time)).unwrap_or(0.0),
            jumps_s: jumps
                .filter_map(|jump| Some(dated.get(jump.after)?.unix_s()? - first_s))
                .collect(),
        }
    }
}

/// What a row measures: its own errors are what the limb's points show; at a jump of the mapping all of them are.
fn measurements(row: &Row) -> Option<[Measurement; 2]> {
    let sun = row.sun?;
    let (place, all) = (sun.position.vector(), sun.variance());
    let disc = row.disc.filter(|_| row.jump_px.is_none());
    let own = disc.map_or(all, |disc| disc.centre.variance());
    Some([0, 1].map(|axis| Measurement {
        place: place[axis],
        variance: own[axis],
        shared_variance: (all[axis] - own[axis]).max(0.0),
    }))
}

/// Whether a row's place, which is not of the path, lies off it.
fn is_off(row: &Row, point: &PathPoint) -> bool {
    let Some(sun) = row.sun else {
        return false;
    };
    let off = sun.position.vector() - Vector2::from(point.place);
    let sun = Estimate {
        covariance: sun.covariance + row.moved_mil2(point.speed),
        ..sun
    };
    let [x, y] = sun.variance();
    let chi2 = off.x.powi(2) / (x + point.variance[0]) + off.y.powi(2) / (y + point.variance[1]);
    chi2 > ODD_PATH_CHI2
}

impl Row {
    /// Whether nothing but another Sun could be where the row has its Sun: most of the limb was seen, and its radius is not odd.
    fn is_sure(&self) -> bool {
        self.is_fine() && self.limb_part.is_some_and(|part| part >= TELLING_LIMB)
    }
}
