//! The Sun's path as the rows tell it, and the frames that lie off it.
//!
//! A frame whose limb tells its own radius, which is the flight's, is of the Sun: it makes the path, wherever it is. One that shows
//! less of the limb is held against the path of those.

use super::motion::{self, Moment, Path, PathPoint};
use super::row::{Oddity, Row};
use super::work::{TELLING_LIMB, Work};
use crate::units::PlateMil;
use nalgebra::Vector2;

/// Off the path, chi^2 of two.
pub(super) const ODD_PATH_CHI2: f64 = 100.0;

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
        self.add_shared_errors(&mut followed);
        followed
    }

    /// The path of some of the dated rows. It knows nothing of the errors that neighbours share.
    fn path_of(&self, counts: impl Fn(&Row) -> bool) -> Followed {
        let first = self.rows.first().and_then(Row::unix_s).unwrap_or(0.0);
        let (mut moments, mut at) = (Vec::new(), Vec::new());
        let mut before: Option<f64> = None;
        for row in &self.rows[..self.dated] {
            let time_s = row.unix_s().unwrap_or(first) - first;
            if let Some(before) = before.filter(|before| time_s > *before) {
                moments.push(Moment {
                    time_s: (before + time_s) / 2.0,
                    measured: None,
                });
            }
            let sun = row.sun.filter(|_| counts(row));
            let measured = sun.map(|sun| {
                let [x, y] = row.own_variance_mil2().unwrap_or(sun.variance());
                [(sun.position.x, x), (sun.position.y, y)]
            });
            at.push(moments.len());
            moments.push(Moment { time_s, measured });
            before = Some(time_s);
        }
        Followed {
            path: motion::path(&moments),
            times_s: moments.iter().map(|moment| first + moment.time_s).collect(),
            at,
        }
    }

    /// Errors that are alike in neighbours are not smoothed away, above all the mapping's: each point has those of the last fine row.
    fn add_shared_errors(&self, followed: &mut Followed) {
        let Some(path) = &mut followed.path else {
            return;
        };
        let rows = self.rows[..self.dated].iter();
        let mut of_rows = rows.zip(&followed.at).filter_map(|(row, at)| {
            let all = row.sun.filter(|_| row.is_fine())?.variance();
            let own = row.own_variance_mil2()?;
            Some((*at, [all[0] - own[0], all[1] - own[1]]))
        });
        let mut next = of_rows.next();
        let mut variance = next.map_or([0.0; 2], |(_, variance)| variance);
        for (n, point) in path.points.iter_mut().enumerate() {
            if let Some((_, found)) = next.filter(|(at, _)| *at == n) {
                variance = found;
                next = of_rows.next();
            }
            for (of_point, shared) in point.variance.iter_mut().zip(variance) {
                *of_point += shared.max(0.0);
            }
        }
    }
}

/// Whether a row's place, which is not of the path, lies off it.
fn is_off(row: &Row, point: &PathPoint) -> bool {
    let Some(sun) = row.sun else {
        return false;
    };
    let off = sun.position.vector() - Vector2::from(point.place);
    let [x, y] = sun.variance();
    let chi2 = off.x.powi(2) / (x + point.variance[0]) + off.y.powi(2) / (y + point.variance[1]);
    chi2 > ODD_PATH_CHI2
}

impl Row {
    /// Whether nothing but another Sun could be where the row has its Sun: most of the limb was seen, and its radius is not odd.
    fn is_sure(&self) -> bool {
        self.is_fine() && self.limb_part.is_some_and(|part| part >= TELLING_LIMB)
    }

    /// Variance of the place by what the limb's points show, which is the frame's own. At a jump of the mapping all of it is.
    fn own_variance_mil2(&self) -> Option<[f64; 2]> {
        let disc = self.disc.filter(|_| self.jump_px.is_none())?;
        Some(disc.centre.variance())
    }
}
