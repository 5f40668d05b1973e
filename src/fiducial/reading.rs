//! A reading: one way to give the marks their ids, and how well it explains what is seen.
//!
//! # The model
//! The Sun is round on the plate, so its outline turns a position on the sensor into an offset from the Sun's centre on
//! the plate, in mil, but for a rotation; the arms give that to a quarter turn. A reading then says where on the plate
//! the Sun's centre lies, and by how much rotation and scale differ from what arms and ephemeris say. Its score is the
//! logarithm of the evidence: how much likelier the detections are under it than if all were false, every place of the
//! Sun, rotation and scale being weighed as far as it was likely beforehand. It is summed mark by mark, each held
//! against the place that the marks before it foretell, the nearest to the first mark first.

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
/// Error of the rotation that the arms tell, 1 sigma; three noisy marks tell it to a degree.
const ARMS_SIGMA_RAD: f64 = 0.6 * PI / 180.0;
/// A detection farther from a mark's foretold place is not that mark, in sigma.
const GATE_SIGMAS: f64 = 4.0;
/// Farthest that a mark with an id is seen from its place, mil: one that the limb pulls farther has no position to give.
const NAMED_WITHIN_MIL: f64 = 9.0;
/// Part of the fully lit marks that is found; in flight-like frames it is more.
const FOUND_SHARE: f64 = 0.9;
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
    /// Those of them that lie where they should.
    pub named: Vec<(usize, MarkId)>,
    /// Fully lit marks among them.
    pub full: usize,
    /// Where the reading puts the plate's centre, and how well the marks on the disc tell it, px.
    pub plate_centre: SensorPx,
    pub centre_sigma_px: f64,
    /// Logarithm of how much likelier the detections are under the reading than if all were false.
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

/// The picture at one quarter turn, as offsets from the Sun's centre on the plate.
pub(super) struct Turned<'a> {
    sight: &'a Sight,
    detections: &'a [Detection],
    /// Depth inside the limb at which a mark is fully lit, mil.
    lit_depth_mil: f64,
    /// From offsets on the plate, mil, to the unit disc.
    from_plate: Matrix2<f64>,
    /// Of the detections, mil.
    offsets: Vec<Vector2<f64>>,
    /// Offset of the place where the instrument says the plate's centre is seen, mil.
    centre: Vector2<f64>,
}

impl<'a> Turned<'a> {
    /// `None` when the outline has no size.
    pub(super) fn new(
        sight: &'a Sight,
        detections: &'a [Detection],
        cross: &Cross,
        to_plate: Matrix2<f64>,
    ) -> Option<Self> {
        let offset = |at: SensorPx| to_plate * sight.outline.to_disc(at.vector());
        Some(Self {
            sight,
            detections,
            lit_depth_mil: LIT_HALF_LENGTHS * cross.arm_length_mil / 2.0,
            from_plate: to_plate.try_inverse()?,
            offsets: detections.iter().map(|d| offset(d.at)).collect(),
            centre: offset(sight.plate_centre),
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
        let outline = &self.sight.outline;
        outline.from_disc(self.from_plate * offset).into()
    }

    /// The reading that follows when detection `order[0]` is the mark `anchor`; the others are tried in the given order.
    /// `None` when it explains fewer than two fully lit marks.
    pub(super) fn follow(
        &self,
        anchor: (MarkId, PlateMil),
        order: &[usize],
        marks: &[(MarkId, PlateMil)],
    ) -> Option<Reading> {
        let first = *order.first()?;
        let near = self.marks_near(anchor.1.vector() - self.offsets[first], marks);
        let mut fit = Fit::new(self.sight);
        fit.add(self.offsets[first], anchor.1, self.variance(first));
        let mut ids = vec![(first, anchor.0)];
        let mut score = FOUND_SHARE.ln();
        for &n in order.iter().skip(1).filter(|n| self.is_full(**n)) {
            let variance = self.variance(n);
            if let Some((id, printed, likelihood)) =
                fit.explain(self.offsets[n], &near, |_| variance)
                && ids.iter().all(|(_, taken)| *taken != id)
            {
                fit.add(self.offsets[n], printed, variance);
                ids.push((n, id));
                score += FOUND_SHARE.ln() + likelihood - self.false_density();
            }
        }
        let full = ids.len();
        if full < 2 {
            return None;
        }
        score += self.looks(&ids);
        let mut named = ids.clone();
        for n in (0..self.detections.len()).filter(|n| !self.is_full(*n)) {
            let pulled = |printed| self.variance(n) + self.pull_mil(fit.offset(printed)).powi(2);
            if let Some((id, printed, likelihood)) = fit.explain(self.offsets[n], &near, pulled)
                && ids.iter().all(|(_, taken)| *taken != id)
            {
                ids.push((n, id));
                if fit.place(self.offsets[n]).distance(printed) < NAMED_WITHIN_MIL {
                    named.push((n, id));
                }
                score +=
                    self.found_share(fit.offset(printed)).ln() + likelihood - self.false_density();
            }
        }
        score += self.absences(&fit, &ids, &near);
        let centre = fit.offset(PlateMil::new(0.0, 0.0));
        Some(Reading {
            ids,
            named,
            full,
            plate_centre: self.to_sensor(centre),
            centre_sigma_px: fit.sigma(centre) / self.sight.mil_per_px(),
            score,
        })
    }

    fn is_full(&self, n: usize) -> bool {
        self.detections[n].lighting == Lighting::Full
    }

    /// Of a fully lit mark's position, mil^2.
    fn variance(&self, n: usize) -> f64 {
        let measured = self.detections[n].sigma_px * self.sight.mil_per_px();
        SCATTER_MIL.powi(2) + measured.powi(2)
    }

    /// How far the limb may pull a mark inwards, 1 sigma, mil.
    fn pull_mil(&self, offset: Vector2<f64>) -> f64 {
        let depth = self.sight.radius_mil.value - offset.norm();
        PULL_MIL * (1.0 - depth / self.lit_depth_mil).clamp(0.0, 1.0)
    }

    /// Part of the marks at an offset that is found.
    fn found_share(&self, offset: Vector2<f64>) -> f64 {
        if self.must_be_found(offset) {
            FOUND_SHARE
        } else {
            CUT_FOUND_SHARE
        }
    }

    fn must_be_found(&self, offset: Vector2<f64>) -> bool {
        let sure_depth_mil = self.sight.sure_depth_px * self.sight.mil_per_px();
        offset.norm() < self.sight.radius_mil.value - sure_depth_mil
            && self.sight.on_sensor(self.to_sensor(offset))
    }

    /// False detections per mil^2, logarithm.
    fn false_density(&self) -> f64 {
        (FALSE_ON_DISC / (PI * self.sight.radius_mil.value.powi(2))).ln()
    }

    /// The printed marks on the disc or near it.
    fn marks_near(
        &self,
        sun: Vector2<f64>,
        marks: &[(MarkId, PlateMil)],
    ) -> Vec<(MarkId, PlateMil)> {
        let reach = self.sight.radius_mil.value + GATE_SIGMAS * PULL_MIL;
        let near = |at: &PlateMil| (at.vector() - sun).norm_squared() < reach * reach;
        let marks = marks.iter().copied();
        marks.filter(|(_, at)| near(at)).collect()
    }

    /// What the marks that must have been found and are not take from the score.
    fn absences(&self, fit: &Fit, ids: &[(usize, MarkId)], near: &[(MarkId, PlateMil)]) -> f64 {
        let absent = near.iter().filter(|(id, printed)| {
            self.must_be_found(fit.offset(*printed)) && ids.iter().all(|(_, found)| found != id)
        });
        absent.count() as f64 * (1.0 - FOUND_SHARE).ln()
    }

    /// How much likelier the contrasts are as those of one print than as false ones'; the first tells nothing, since
    /// the print's contrast is not known beforehand.
    fn looks(&self, ids: &[(usize, MarkId)]) -> f64 {
        let logs = || ids.iter().map(|(n, _)| self.detections[*n].contrast.ln());
        let usual = median(logs());
        let print = |x: f64| {
            let off = (x - usual) / CONTRAST_SCATTER;
            (-0.5 * off * off).exp() / (CONTRAST_SCATTER * TAU.sqrt())
        };
        let gain = |x: f64| {
            let mark = (1.0 - ODD_MARKS) * print(x) + ODD_MARKS / ANY_CONTRAST;
            let other = LIKE_MARKS * print(x) + (1.0 - LIKE_MARKS) / ANY_CONTRAST;
            (mark / other).ln()
        };
        logs().map(gain).sum::<f64>() - gain(usual)
    }
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    sorted[sorted.len() / 2]
}

/// From offsets to the plate: shift, and small changes of scale and rotation, from the marks so far. Least squares with
/// what is known of scale and rotation beforehand, in sums that grow by a mark at a time.
#[derive(Debug, Clone, Copy)]
struct Fit {
    weight: f64,
    /// Weighted means of the offsets and of what leads from them to the printed places, mil.
    offset: Vector2<f64>,
    step: Vector2<f64>,
    /// Information on scale and rotation, and its products with them.
    scale_weight: f64,
    rotation_weight: f64,
    stretch: f64,
    twist: f64,
}

impl Fit {
    fn new(sight: &Sight) -> Self {
        let scale_sigma = sight.radius_mil.sigma / sight.radius_mil.value;
        Self {
            weight: 0.0,
            offset: Vector2::zeros(),
            step: Vector2::zeros(),
            scale_weight: scale_sigma.powi(-2),
            rotation_weight: ARMS_SIGMA_RAD.powi(-2),
            stretch: 0.0,
            twist: 0.0,
        }
    }

    fn add(&mut self, offset: Vector2<f64>, printed: PlateMil, variance: f64) {
        let arm = offset - self.offset;
        let change = printed.vector() - offset - self.step;
        let weight = 1.0 / variance;
        let part = weight / (self.weight + weight);
        let shared = self.weight * part;
        self.stretch += shared * arm.dot(&change);
        self.twist += shared * arm.perp(&change);
        self.scale_weight += shared * arm.norm_squared();
        self.rotation_weight += shared * arm.norm_squared();
        self.weight += weight;
        self.offset += part * arm;
        self.step += part * change;
    }

    fn scale(&self) -> f64 {
        self.stretch / self.scale_weight
    }

    fn rotation(&self) -> f64 {
        self.twist / self.rotation_weight
    }

    /// Where on the plate an offset leads.
    fn place(&self, offset: Vector2<f64>) -> PlateMil {
        let arm = offset - self.offset;
        let turn = Vector2::new(-arm.y, arm.x);
        (offset + self.step + self.scale() * arm + self.rotation() * turn).into()
    }

    /// The inverse of [`place`](Self::place).
    fn offset(&self, printed: PlateMil) -> Vector2<f64> {
        let arm = printed.vector() - self.offset - self.step;
        let (along, across) = (1.0 + self.scale(), self.rotation());
        let turned = Vector2::new(
            along * arm.x + across * arm.y,
            along * arm.y - across * arm.x,
        );
        self.offset + turned / (along * along + across * across)
    }

    /// Error of a place in the worse direction, 1 sigma, mil.
    fn sigma(&self, offset: Vector2<f64>) -> f64 {
        let least = self.scale_weight.min(self.rotation_weight);
        (1.0 / self.weight + (offset - self.offset).norm_squared() / least).sqrt()
    }

    /// The mark that a detection is, of which `variance` (mil^2) tells how far it may be seen from its place, with the logarithm of how likely it is to be seen there, per mil^2. `None` when it
    /// is none.
    fn explain(
        &self,
        offset: Vector2<f64>,
        marks: &[(MarkId, PlateMil)],
        variance: impl Fn(PlateMil) -> f64,
    ) -> Option<(MarkId, PlateMil, f64)> {
        let place = self.place(offset).vector();
        let miss = |(_, printed): &&(MarkId, PlateMil)| (printed.vector() - place).norm_squared();
        let (id, printed) = marks.iter().min_by(|a, b| miss(a).total_cmp(&miss(b)))?;
        let arm = offset - self.offset;
        let reach = arm.norm_squared();
        let common = variance(*printed) + 1.0 / self.weight;
        let along = common + reach / self.scale_weight;
        let across = common + reach / self.rotation_weight;
        let miss = printed.vector() - place;
        let (stretch, twist) = (arm.dot(&miss), arm.perp(&miss));
        let off =
            (stretch * stretch / along + twist * twist / across) / reach.max(f64::MIN_POSITIVE);
        (off < GATE_SIGMAS * GATE_SIGMAS).then(|| {
            (
                *id,
                *printed,
                -0.5 * off - TAU.ln() - 0.5 * (along * across).ln(),
            )
        })
    }
}
