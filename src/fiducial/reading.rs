//! A reading: one way to give the marks their ids, and how well it explains what is seen.

use super::identify::Sight;
use super::{Detection, Lighting, Settings};
use crate::plate::MarkId;
use crate::units::{PlateMil, SensorPx};
use nalgebra::{Matrix2, Vector2};

/// How far from its printed place a mark may be seen under the first guess, mil, and by which part of the distance
/// from the mark that the guess rests on: the guess's rotation and scale are known to a degree and two percent.
const GUESS_TOLERANCE_MIL: f64 = 8.0;
const GUESS_TOLERANCE_SLOPE: f64 = 0.035;
/// The same once the reading's own marks have been fitted. Neighbouring codes differ by 36 mil.
const FITTED_TOLERANCE_MIL: f64 = 9.0;
/// How far the limb pulls a mark that it cuts, mil.
const CUT_TOLERANCE_MIL: f64 = 30.0;
/// How far a mark of the right reading may be from its place: print, keystone and noise together, 1 sigma per axis.
/// A wrong reading that keeps the scale misses by 5 mil and more.
const MISFIT_MIL: f64 = 2.5;
/// The same for a mark that the limb cuts.
const CUT_MISFIT_MIL: f64 = 12.0;
/// How far the fitted scale and rotation may be from those known beforehand. A reading may not stretch the plate: a
/// wrong one would turn 288 mil into 306 that way.
const SCALE_SIGMAS: f64 = 4.0;
const ROTATION_TOLERANCE_RAD: f64 = 0.05;
/// Part of the fully lit marks that is found; in flight-like frames it is more.
const FOUND_SHARE: f64 = 0.9;

/// Ids given to detections (by index).
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Reading {
    pub ids: Vec<(usize, MarkId)>,
    /// Fully lit marks among them.
    pub full: usize,
    /// Where the reading puts the plate's centre.
    pub plate_centre: SensorPx,
    /// Logarithm of how much better the reading explains the detections than chance does.
    pub score: f64,
}

impl Reading {
    /// Whether two readings cannot both be true: they name a detection differently, or have none in common.
    pub(super) fn contradicts(&self, other: &Self) -> bool {
        let mut shared = self.ids.iter().filter_map(|(n, id)| {
            let elsewhere = other.ids.iter().find(|(m, _)| m == n)?;
            Some(elsewhere.1 == *id)
        });
        match shared.next() {
            None => true,
            Some(first_agrees) => !first_agrees || shared.any(|agrees| !agrees),
        }
    }
}

/// A similarity from plate to sensor; leaner than a mapping, since hundreds are tried on a frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct Placement {
    /// Where the plate's centre is seen, px.
    pub centre: Vector2<f64>,
    /// Scale, rotation and handedness, px per mil.
    turn: Matrix2<f64>,
    /// Its inverse, mil per px.
    back: Matrix2<f64>,
}

impl Placement {
    pub(super) fn new(centre: Vector2<f64>, turn: Matrix2<f64>) -> Option<Self> {
        Some(Self {
            centre,
            turn,
            back: turn.try_inverse()?,
        })
    }

    /// The same shifted until a printed position is seen where it should be.
    pub(super) fn shifted(self, printed: PlateMil, seen: SensorPx) -> Self {
        Self {
            centre: seen.vector() - self.turn * printed.vector(),
            ..self
        }
    }

    /// Least squares through seen and printed positions, in closed form; `axes` are those of the handedness.
    fn fit(
        pairs: impl Iterator<Item = (SensorPx, PlateMil)> + Clone,
        axes: Matrix2<f64>,
    ) -> Option<Self> {
        let points = pairs.map(|(seen, printed)| (seen.vector(), axes * printed.vector()));
        let count = points.clone().count() as f64;
        let (mut seen_mean, mut printed_mean) = (Vector2::zeros(), Vector2::zeros());
        for (seen, printed) in points.clone() {
            seen_mean += seen / count;
            printed_mean += printed / count;
        }
        let (mut along, mut across, mut square) = (0.0, 0.0, 0.0);
        for (seen, printed) in points {
            let (seen, printed) = (seen - seen_mean, printed - printed_mean);
            along += printed.dot(&seen);
            across += printed.perp(&seen);
            square += printed.norm_squared();
        }
        let turn = Matrix2::new(along, -across, across, along) / square;
        Self::new(seen_mean - turn * printed_mean, turn * axes)
    }

    fn to_plate(self, seen: SensorPx) -> PlateMil {
        (self.back * (seen.vector() - self.centre)).into()
    }

    fn to_sensor(self, printed: PlateMil) -> SensorPx {
        (self.centre + self.turn * printed.vector()).into()
    }

    /// Scale (as a ratio) and rotation (rad) from another placement of the same handedness to this one.
    fn relative_to(&self, other: &Self) -> (f64, f64) {
        let ratio = self.turn * other.back;
        let (cos, sin) = (ratio.m11, ratio.m21);
        (cos.hypot(sin), sin.atan2(cos))
    }
}

/// What readings are held against.
pub(super) struct Evidence<'a> {
    pub detections: &'a [Detection],
    pub sight: &'a Sight,
    pub marks: &'a [(MarkId, PlateMil)],
    pub settings: &'a Settings,
}

/// A detection on a printed mark: index, id and distance in mil.
#[derive(Debug, Clone, Copy)]
struct Match {
    detection: usize,
    id: MarkId,
    printed: PlateMil,
    miss_mil: f64,
}

impl Evidence<'_> {
    /// The reading that follows from a guess that rests on the mark at `anchor`; `None` when it explains fewer than two
    /// fully lit marks, or only by another scale or rotation.
    pub(super) fn follow(&self, guess: &Placement, anchor: PlateMil) -> Option<Reading> {
        let marks = self.marks_on_disc(guess);
        let mut matches = self.matches(guess, &marks, |at, _| {
            GUESS_TOLERANCE_MIL + GUESS_TOLERANCE_SLOPE * at.distance(anchor)
        });
        let mut fitted = *guess;
        for _ in 0..2 {
            fitted = self.fit(&matches)?;
            let (scale, rotation_rad) = fitted.relative_to(guess);
            let known = self.sight.scale_mil_per_px;
            if (scale - 1.0).abs() > SCALE_SIGMAS * known.sigma / known.value
                || rotation_rad.abs() > ROTATION_TOLERANCE_RAD
            {
                return None;
            }
            matches = self.matches(&fitted, &marks, |_, lighting| match lighting {
                Lighting::Full => FITTED_TOLERANCE_MIL,
                Lighting::Cut => CUT_TOLERANCE_MIL,
            });
        }
        Some(self.reading(&fitted, &marks, &matches))
    }

    fn fit(&self, matches: &[Match]) -> Option<Placement> {
        let full = matches.iter().filter(|found| self.is_full(found));
        let pairs = full.map(|found| (self.detections[found.detection].at, found.printed));
        if pairs.clone().count() < 2 {
            return None;
        }
        Placement::fit(pairs, self.sight.handedness.axes())
    }

    fn is_full(&self, found: &Match) -> bool {
        self.detections[found.detection].lighting == Lighting::Full
    }

    /// The printed marks that a placement puts on the disc or near it.
    fn marks_on_disc(&self, placement: &Placement) -> Vec<(MarkId, PlateMil)> {
        let disc = &self.sight.disc;
        let sun = placement.to_plate(disc.centre.into());
        let reach = disc.radius * self.sight.scale_mil_per_px.value + CUT_TOLERANCE_MIL;
        let near = |at: &PlateMil| (at.vector() - sun.vector()).norm_squared() < reach * reach;
        let marks = self.marks.iter().copied();
        marks.filter(|(_, at)| near(at)).collect()
    }

    /// Every detection with the printed mark it falls on, each mark once.
    fn matches(
        &self,
        placement: &Placement,
        marks: &[(MarkId, PlateMil)],
        tolerance_mil: impl Fn(PlateMil, Lighting) -> f64,
    ) -> Vec<Match> {
        let mut matches: Vec<Match> = Vec::new();
        for (detection, seen) in self.detections.iter().enumerate() {
            let at = placement.to_plate(seen.at);
            let on = |(id, printed): &(MarkId, PlateMil)| Match {
                detection,
                id: *id,
                printed: *printed,
                miss_mil: (printed.vector() - at.vector()).norm(),
            };
            let nearest = marks.iter().map(on);
            let Some(nearest) = nearest.min_by(|a, b| a.miss_mil.total_cmp(&b.miss_mil)) else {
                continue;
            };
            if nearest.miss_mil < tolerance_mil(at, seen.lighting) {
                match matches.iter_mut().find(|taken| taken.id == nearest.id) {
                    Some(taken) if nearest.miss_mil < taken.miss_mil => *taken = nearest,
                    Some(_) => {}
                    None => matches.push(nearest),
                }
            }
        }
        matches
    }

    fn reading(
        &self,
        placement: &Placement,
        marks: &[(MarkId, PlateMil)],
        matches: &[Match],
    ) -> Reading {
        let missing = marks.iter().filter(|(id, at)| {
            self.must_be_found(placement.to_sensor(*at))
                && matches.iter().all(|found| found.id != *id)
        });
        let explained: f64 = matches.iter().map(|found| self.gain(found)).sum();
        let sure = |found: &&Match| found.miss_mil < FITTED_TOLERANCE_MIL;
        Reading {
            score: explained + missing.count() as f64 * (1.0 - FOUND_SHARE).ln(),
            ids: matches
                .iter()
                .filter(sure)
                .map(|found| (found.detection, found.id))
                .collect(),
            full: matches.iter().filter(|found| self.is_full(found)).count(),
            plate_centre: placement.centre.into(),
        }
    }

    fn must_be_found(&self, seen: SensorPx) -> bool {
        let inside = -self.sight.disc.excess(seen.vector());
        inside > self.sight.sure_depth_px && self.sight.on_sensor(seen)
    }

    /// How much likelier a detection is as a mark that misses its place by so much than as a false one, of which there
    /// is one anywhere on the disc, logarithm.
    fn gain(&self, found: &Match) -> f64 {
        let sigma = if self.is_full(found) {
            MISFIT_MIL
        } else {
            CUT_MISFIT_MIL
        };
        let radius = self.sight.disc.radius * self.sight.scale_mil_per_px.value;
        let share = 2.0 * (sigma / radius).powi(2);
        FOUND_SHARE.ln() - share.ln() - 0.5 * (found.miss_mil / sigma).powi(2)
    }
}
