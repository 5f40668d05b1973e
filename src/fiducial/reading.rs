//! A reading: one way to give the marks their ids, and how well it explains what is seen.
//!
//! # The model
//! The Sun is round on the plate, so its outline turns a position on the sensor into an offset from the Sun's centre on
//! the plate, in mil, but for a rotation; the arms give that to a quarter turn. A reading then says where on the plate
//! the Sun's centre lies, and by how much rotation and scale differ from what arms and ephemeris say. Its score is the
//! logarithm of the evidence: how much likelier the detections are under it than if all were false, every place of the
//! Sun, rotation and scale being weighed as far as it was likely beforehand. It is summed mark by mark, each held
//! against the place that the marks before it foretell, the nearest to the first mark first.

use super::fit::{Arm, Fit, GATE_SIGMAS, Printed};
use super::identify::Sight;
use super::{Detection, Lighting};
use crate::plate::{Cross, MarkId};
use crate::units::{PlateMil, SensorPx};
use nalgebra::{Matrix2, Vector2};
use std::f64::consts::{PI, TAU};

/// Scatter of a mark about its place, 1 sigma per axis: print (1 mil rms) and what keystone leaves over the disc.
const SCATTER_MIL: f64 = 1.3;
/// The limb pulls a mark that it cuts inwards: 1 sigma at the limb itself, from where it falls to none for a mark that
/// is fully lit. Measured on simulated frames it falls faster: 12, 4, 1.5 and 0.4 mil at depths of 0, 15, 27 and 45 mil.
const PULL_MIL: f64 = 12.0;
/// Depth at which a mark is fully lit, in half lengths from tip to tip; the limb's blur included.
const LIT_HALF_LENGTHS: f64 = 1.4;
/// Farthest that a mark with an id is seen from its place, mil: one that the limb pulls farther has no position to give.
const NAMED_WITHIN_MIL: f64 = 9.0;
/// The same where the limb cuts more than a mark may lose.
const CUT_FOUND_SHARE: f64 = 0.5;
/// False detections on a disc.
const FALSE_ON_DISC: f64 = 1.0;
/// Contrasts of a print scatter by this, 1 sigma of the logarithm.
const CONTRAST_SCATTER: f64 = 0.12;
/// Part of the marks whose contrast is another: a scratch or a spot lies on them.
const ODD_MARKS: f64 = 0.02;
/// Part of the false detections that looks like marks; the contrast of the others is any from 0.12 to 1.2.
const LIKE_MARKS: f64 = 0.4;
const ANY_CONTRAST: f64 = 2.3;

/// Ids given to detections (by index).
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Reading {
    /// Every detection that the reading explains.
    pub ids: Vec<(usize, MarkId)>,
    /// Those of them that lie elsewhere than they should.
    displaced: Vec<usize>,
    /// Fully lit marks among them.
    pub full: usize,
    /// Where the reading puts the plate's centre, and how well the marks on the disc tell it, px.
    pub plate_centre: SensorPx,
    pub centre_sigma_px: f64,
    /// Logarithm of how much likelier the detections are under the reading than if all were false.
    pub score: f64,
}

impl Reading {
    /// The detections that lie where they should.
    pub(super) fn named(&self) -> Vec<(usize, MarkId)> {
        let in_place = |(n, _): &&(usize, MarkId)| !self.displaced.contains(n);
        self.ids.iter().filter(in_place).copied().collect()
    }

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

/// What all readings share.
pub(super) struct Seen<'a> {
    sight: &'a Sight,
    detections: &'a [Detection],
    /// Of the detections' positions, were they fully lit marks, mil^2.
    variances: Vec<f64>,
    /// Logarithms of the detections' contrasts.
    contrasts: Vec<f64>,
    by_contrast: Vec<usize>,
    /// Depth inside the limb at which a mark is fully lit, mil.
    lit_depth_mil: f64,
    /// Distance from the Sun's centre within which a mark must have been found, mil.
    sure_reach_mil: f64,
    /// Whether all of the disc so near to its centre is far enough from the sensor's edge.
    sure_on_sensor: bool,
    /// Logarithms of the shares of marks that are found, found where the limb cuts too much, and missed.
    found: f64,
    cut_found: f64,
    missed: f64,
    /// False detections per mil^2, logarithm.
    false_density: f64,
}

impl<'a> Seen<'a> {
    pub(super) fn new(sight: &'a Sight, detections: &'a [Detection], cross: &Cross) -> Self {
        let radius_mil = sight.radius_mil.value;
        let variance =
            |seen: &Detection| SCATTER_MIL.powi(2) + (seen.sigma_px * sight.mil_per_px()).powi(2);
        let sure_reach_mil = radius_mil - sight.sure_depth_px * sight.mil_per_px();
        let sure_reach_mil = sure_reach_mil.max(0.0);
        let corner =
            sight.outline.root().map(f64::abs).column_sum() * (sure_reach_mil / radius_mil);
        let on_sensor = |at: Vector2<f64>| sight.on_sensor(at.into());
        let contrasts: Vec<f64> = detections.iter().map(|seen| seen.contrast.ln()).collect();
        let mut by_contrast: Vec<usize> = (0..detections.len()).collect();
        by_contrast.sort_by(|a, b| contrasts[*a].total_cmp(&contrasts[*b]));
        Self {
            sight,
            detections,
            variances: detections.iter().map(variance).collect(),
            contrasts,
            by_contrast,
            lit_depth_mil: LIT_HALF_LENGTHS * cross.arm_length_mil / 2.0,
            sure_reach_mil,
            sure_on_sensor: on_sensor(sight.outline.centre - corner)
                && on_sensor(sight.outline.centre + corner),
            found: sight.found_share().ln(),
            cut_found: CUT_FOUND_SHARE.ln(),
            missed: sight.missed_share.ln(),
            false_density: (FALSE_ON_DISC / (PI * radius_mil.powi(2))).ln(),
        }
    }

    fn is_full(&self, n: usize) -> bool {
        self.detections[n].lighting == Lighting::Full
    }

    /// The detections that the limb cuts.
    fn cut(&self) -> impl Iterator<Item = usize> {
        (0..self.detections.len()).filter(|n| !self.is_full(*n))
    }

    /// How far the limb may pull a mark inwards, 1 sigma, mil.
    fn pull_mil(&self, offset: Vector2<f64>) -> f64 {
        let depth = self.sight.radius_mil.value - offset.norm();
        PULL_MIL * (1.0 - depth / self.lit_depth_mil).clamp(0.0, 1.0)
    }

    /// Whether a printed place is on the disc or near it, as seen from where the Sun's centre is on the plate.
    fn on_disc(&self, printed: PlateMil, sun: Vector2<f64>) -> bool {
        let reach = self.sight.radius_mil.value + GATE_SIGMAS * PULL_MIL;
        (printed.vector() - sun).norm_squared() < reach * reach
    }

    /// How much likelier the contrasts are as those of one print than as false ones'; the first tells nothing, since
    /// the print's contrast is not known beforehand.
    fn looks(&self, ids: &[(usize, MarkId)]) -> f64 {
        let named = |n: &&usize| ids.iter().any(|(named, _)| named == *n);
        let mut ordered = self.by_contrast.iter().filter(named);
        let usual = ordered
            .nth(ids.len() / 2)
            .map_or(0.0, |n| self.contrasts[*n]);
        let gains = ids.iter().map(|(n, _)| gain(self.contrasts[*n] - usual));
        gains.sum::<f64>() - gain(0.0)
    }
}

/// How much likelier a contrast so far from the usual one is as a mark's than as a false detection's; all of them logarithms.
fn gain(off: f64) -> f64 {
    let off = off / CONTRAST_SCATTER;
    let print = (-0.5 * off * off).exp() / (CONTRAST_SCATTER * TAU.sqrt());
    let mark = (1.0 - ODD_MARKS) * print + ODD_MARKS / ANY_CONTRAST;
    let other = LIKE_MARKS * print + (1.0 - LIKE_MARKS) / ANY_CONTRAST;
    (mark / other).ln()
}

/// The picture at one quarter turn, as offsets from the Sun's centre on the plate.
pub(super) struct Turned<'a> {
    seen: &'a Seen<'a>,
    /// From offsets on the plate, mil, to the unit disc.
    from_plate: Matrix2<f64>,
    /// Of the detections, mil.
    offsets: Vec<Vector2<f64>>,
    /// Offset of the place where the instrument says the plate's centre is seen, mil.
    centre: Vector2<f64>,
}

impl<'a> Turned<'a> {
    /// `None` when the outline has no size.
    pub(super) fn new(seen: &'a Seen<'a>, to_plate: Matrix2<f64>) -> Option<Self> {
        let offset = |at: SensorPx| to_plate * seen.sight.outline.to_disc(at.vector());
        Some(Self {
            seen,
            from_plate: to_plate.try_inverse()?,
            offsets: seen.detections.iter().map(|d| offset(d.at)).collect(),
            centre: offset(seen.sight.plate_centre),
        })
    }

    pub(super) fn offset(&self, detection: usize) -> Vector2<f64> {
        self.offsets[detection]
    }

    /// Where the Sun's centre would be on the plate if the instrument were right about the plate's centre.
    pub(super) fn stated_sun(&self) -> PlateMil {
        (-self.centre).into()
    }

    fn to_sensor(&self, offset: Vector2<f64>) -> SensorPx {
        let outline = &self.seen.sight.outline;
        outline.from_disc(self.from_plate * offset).into()
    }

    /// The fit in which a detection is the mark at a place, and nothing else is known.
    fn fit_of(&self, detection: usize, printed: PlateMil) -> Fit {
        let mut fit = Fit::new(self.seen.sight);
        fit.add(
            self.offsets[detection],
            printed,
            self.seen.variances[detection],
        );
        fit
    }

    /// What leads from the first of some fully lit marks to the others.
    pub(super) fn arms(&self, order: &[usize]) -> Vec<Arm> {
        let (Some(&first), others) = (order.first(), order.iter().skip(1)) else {
            return Vec::new();
        };
        let fit = self.fit_of(first, PlateMil::new(0.0, 0.0));
        let arm = |&n: &usize| Arm {
            to: self.offsets[n] - self.offsets[first],
            gate_mil2: fit.gate_mil2(self.offsets[n], self.seen.variances[n]),
        };
        others.map(arm).collect()
    }

    /// The reading that follows when detection `order[0]` is the mark `anchor`; the other fully lit ones are tried in the
    /// given order. `None` when it explains fewer than two fully lit marks.
    pub(super) fn follow(
        &self,
        anchor: (MarkId, PlateMil),
        order: &[usize],
        printed: &Printed,
    ) -> Option<Reading> {
        let seen = self.seen;
        let first = *order.first()?;
        let sun = anchor.1.vector() - self.offsets[first];
        let mut fit = self.fit_of(first, anchor.1);
        let mut ids = Vec::with_capacity(seen.detections.len());
        ids.push((first, anchor.0));
        let mut score = seen.found;
        let mark_at = |fit: &Fit, n: usize, variance, ids: &[(usize, MarkId)]| {
            let offset = self.offsets[n];
            let gate_mil2 = fit.gate_mil2(offset, variance);
            let (id, at) = printed.nearest(fit.place(offset).vector(), gate_mil2)?;
            let free = ids.iter().all(|(_, taken)| *taken != id);
            (free && seen.on_disc(at, sun)).then_some((id, at))
        };
        for &n in &order[1..] {
            let variance = seen.variances[n];
            if let Some((id, at)) = mark_at(&fit, n, variance, &ids)
                && let Some(likelihood) = fit.likelihood(self.offsets[n], at, variance)
            {
                fit.add(self.offsets[n], at, variance);
                ids.push((n, id));
                score += seen.found + likelihood - seen.false_density;
            }
        }
        let full = ids.len();
        if full < 2 {
            return None;
        }
        score += seen.looks(&ids);
        let mut displaced = Vec::new();
        for n in seen.cut() {
            let variance = seen.variances[n];
            let most = variance + PULL_MIL.powi(2);
            if let Some((id, at)) = mark_at(&fit, n, most, &ids)
                && let pulled = variance + seen.pull_mil(fit.offset(at)).powi(2)
                && let Some(likelihood) = fit.likelihood(self.offsets[n], at, pulled)
            {
                ids.push((n, id));
                if fit.place(self.offsets[n]).distance(at) >= NAMED_WITHIN_MIL {
                    displaced.push(n);
                }
                let found = match self.must_be_found(fit.offset(at)) {
                    true => seen.found,
                    false => seen.cut_found,
                };
                score += found + likelihood - seen.false_density;
            }
        }
        score += self.absences(&fit, &ids, printed);
        let centre = fit.offset(PlateMil::new(0.0, 0.0));
        Some(Reading {
            ids,
            displaced,
            full,
            plate_centre: self.to_sensor(centre),
            centre_sigma_px: fit.variance(centre).sqrt() / seen.sight.mil_per_px(),
            score,
        })
    }

    fn must_be_found(&self, offset: Vector2<f64>) -> bool {
        let seen = self.seen;
        offset.norm_squared() < seen.sure_reach_mil.powi(2)
            && (seen.sure_on_sensor || seen.sight.on_sensor(self.to_sensor(offset)))
    }

    /// What the marks that must have been found and are not take from the score.
    fn absences(&self, fit: &Fit, ids: &[(usize, MarkId)], printed: &Printed) -> f64 {
        let absent = printed.marks.iter().filter(|(id, at)| {
            self.must_be_found(fit.offset(*at)) && ids.iter().all(|(_, found)| found != id)
        });
        absent.count() as f64 * self.seen.missed
    }
}
