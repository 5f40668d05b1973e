//! The Sun's path by the frames, and the frames that lie off it.
//!
//! If a frame's limb determines its own radius, and this is the flight's, the disc is the Sun: the frame defines the path,
//! wherever it is. A frame that shows less of the limb is compared with the path of those.

use super::suns::{Flight, Suns};
use crate::estimation::median;
use crate::geometry::view::UNIT_MIL;
use crate::smoothing::{self, Measurement, Moment, Path, PathPoint, SharedErrors};
use crate::units::{Estimate, PlateMil};
use nalgebra::{Matrix2, Vector2};

/// Threshold of a frame off the path, chi^2 of two degrees of freedom.
pub(super) const UNUSUAL_PATH_CHI2: f64 = 100.0;

/// Above this the path is too uncertain, 1 sigma.
const MOST_SIGMA_MIL: f64 = 100.0;

/// Whether the path is sufficiently certain at a point.
pub(super) fn is_known(point: &PathPoint) -> bool {
    let sigma = point.variance.map(f64::sqrt);
    sigma.iter().all(|sigma| *sigma < MOST_SIGMA_MIL)
}

/// Covariance that the uncertainty of the time adds to a moving position, mil^2.
pub(super) fn timing_mil2(speed_mil_per_s: [f64; 2], time_sigma_s: f64) -> Matrix2<f64> {
    let moved = Vector2::from(speed_mil_per_s) * time_sigma_s;
    moved * moved.transpose()
}

/// The Sun's path, with one more point between two frames.
pub(super) struct SunPath {
    pub path: Option<Path>,
    /// Time of the first dated frame, s since 1970: the origin of the path's times.
    pub first_s: f64,
    /// Time of each point, s.
    times_s: Vec<f64>,
    points: Vec<PathPoint>,
    /// The point of each dated frame.
    at: Vec<u32>,
}

impl SunPath {
    /// Follows the path of the fine frames; also returns the frames that lie off it.
    pub fn follow(flight: &Flight, suns: &Suns) -> (Self, Vec<usize>) {
        let is_sure = |n: usize| suns.is_sure(&flight.frames[n], n);
        let path = Self::through(flight, suns, is_sure);
        let doubtful: Vec<(usize, Estimate<PlateMil>)> = (0..flight.frames.len())
            .filter(|n| !is_sure(*n))
            .filter_map(|n| Some((n, suns.fine(flight, n)?)))
            .collect();
        if doubtful.is_empty() {
            return (path, Vec::new());
        }
        let is_off = |(n, sun): &(usize, Estimate<PlateMil>)| {
            let sigma_s = flight.timeline.timing(*n).sigma_s.unwrap_or(0.0);
            path.point(*n)
                .is_some_and(|point| is_off(sun, sigma_s, point))
        };
        let off: Vec<usize> = doubtful.iter().filter(|d| is_off(d)).map(|d| d.0).collect();
        drop(path);
        let counts = |n: usize| off.binary_search(&n).is_err();
        (Self::through(flight, suns, counts), off)
    }

    /// The path of a selection of the fine frames.
    fn through(flight: &Flight, suns: &Suns, counts: impl Fn(usize) -> bool) -> Self {
        let timeline = &flight.timeline;
        let first_s = timeline.unix_s(0).unwrap_or(0.0);
        let since_first = |n: usize| timeline.unix_s(n).map_or(0.0, |time_s| time_s - first_s);
        let moments = (0..flight.frames.len()).filter(|n| counts(*n) && timeline.is_timed(*n));
        let moments = moments.map(|n| Moment {
            time_s: since_first(n),
            time_sigma_s: timeline.timing(n).sigma_s.unwrap_or(0.0),
            measured: suns
                .fine(flight, n)
                .map(|sun| measurements(flight, suns, n, &sun)),
        });
        let path = smoothing::path(moments, shared_errors(flight, suns, first_s));
        let (mut times_s, mut at) = (Vec::new(), Vec::new());
        for time_s in (0..flight.frames.len()).map(since_first) {
            let before = times_s.last().filter(|before| time_s > **before);
            times_s.extend(before.map(|before| (before + time_s) / 2.0));
            at.push(times_s.len() as u32);
            times_s.push(time_s);
        }
        Self {
            points: path
                .as_ref()
                .and_then(|path| path.anywhere(&times_s))
                .unwrap_or_default(),
            path,
            first_s,
            times_s,
            at,
        }
    }

    /// Each point with its time, s since 1970; none where the path is too uncertain.
    pub fn points(&self) -> impl Iterator<Item = (f64, Option<&PathPoint>)> {
        let times = self.times_s.iter().map(|time_s| self.first_s + time_s);
        let points = self.points.iter();
        times.zip(points.map(|point| is_known(point).then_some(point)))
    }

    /// The times of the first and the last dated frame, s since 1970.
    pub fn ends_s(&self) -> Option<[f64; 2]> {
        let ends = [self.times_s.first()?, self.times_s.last()?];
        Some(ends.map(|time_s| self.first_s + time_s))
    }

    fn point(&self, n: usize) -> Option<&PathPoint> {
        self.points.get(self.at[n] as usize)
    }

    /// Most likely position of the disc at each of some dated frames, in order, and 1 sigma, mil.
    pub fn places(&self, of: &[usize]) -> Vec<Option<(PlateMil, f64)>> {
        let path = self.path.as_ref().filter(|_| !of.is_empty());
        // Evaluate at all times, though few are requested: in a gap of the Suns the frames between support the path.
        let Some(points) = path.and_then(|path| path.likeliest(&self.times_s)) else {
            return vec![None; of.len()];
        };
        let place = |n: &usize| {
            let PathPoint {
                place: [x, y],
                variance,
                ..
            } = points[self.at[*n] as usize];
            let sigma = ((variance[0] + variance[1]) / 2.0).sqrt();
            Some((PlateMil::new(x, y), sigma))
        };
        of.iter().map(place).collect()
    }

    /// Speed of the Sun over the plate at a dated frame, mil/s; `None` where the path is too uncertain.
    pub fn speed(&self, n: usize) -> Option<[f64; 2]> {
        let point = self.point(n)?;
        is_known(point).then_some(point.speed)
    }
}

/// Correlation time of the mapping's errors. For a smoothed random walk it is twice the variance of the error over the
/// density of the walk's process noise; a jump starts new errors.
fn shared_errors(flight: &Flight, suns: &Suns, first_s: f64) -> SharedErrors {
    let Some(mapping) = &flight.mapping else {
        return SharedErrors::default();
    };
    let facts = &mapping.facts;
    let time = |n: usize| {
        let sun = suns.fine(flight, n)?;
        suns.discs[n]?;
        let scale = mapping.numbers(n)?.there.scale_mil_per_px.value;
        let [shift, turn] = facts.process_noise_px.map(|px| (px * scale).powi(2));
        let [x, y] = measurements(flight, suns, n, &sun);
        let away = sun.position.vector().norm_squared() / UNIT_MIL.powi(2);
        Some((x.shared_variance + y.shared_variance) / (shift + turn * away))
    };
    let jumps = facts.jumps.iter();
    SharedErrors {
        correlation_s: median((0..flight.frames.len()).filter_map(time)).unwrap_or(0.0),
        jumps_s: jumps
            .filter_map(|jump| Some(flight.timeline.unix_s(jump.after)? - first_s))
            .collect(),
    }
}

/// Measurement of a frame: its own errors are those of the limb's points; at a jump of the mapping all errors are its own.
fn measurements(
    flight: &Flight,
    suns: &Suns,
    n: usize,
    sun: &Estimate<PlateMil>,
) -> [Measurement; 2] {
    let jump_px = flight.mapping.as_ref().and_then(|m| m.own_jump(n));
    let (place, all) = (sun.position.vector(), sun.variance());
    let mapped = suns.discs[n].filter(|_| jump_px.is_none());
    let own = mapped.map_or(all, |mapped| mapped.disc.centre.variance());
    [0, 1].map(|axis| Measurement {
        place: place[axis],
        variance: own[axis],
        shared_variance: (all[axis] - own[axis]).max(0.0),
    })
}

/// Whether a position that is not part of the path lies off it.
fn is_off(sun: &Estimate<PlateMil>, time_sigma_s: f64, point: &PathPoint) -> bool {
    let off = sun.position.vector() - Vector2::from(point.place);
    let sun = Estimate {
        covariance: sun.covariance + timing_mil2(point.speed, time_sigma_s),
        ..*sun
    };
    let [x, y] = sun.variance();
    let chi2 = off.x.powi(2) / (x + point.variance[0]) + off.y.powi(2) / (y + point.variance[1]);
    chi2 > UNUSUAL_PATH_CHI2
}
