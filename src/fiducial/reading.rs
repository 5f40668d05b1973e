//! A reading: one way to give the marks their ids, and how well it explains what is seen.
//!
//! # The model
//! The Sun is round on the plate, so its outline turns a position on the sensor into an offset from the Sun's centre on
//! the plate, in mil, but for a rotation; the arms give that to a quarter turn. A reading then says where on the plate
//! the Sun's centre lies, and by how much rotation and scale differ from what arms and ephemeris say. Its score is the
//! logarithm of the evidence: how much likelier the detections are under it than if all were false, every place of the
//! Sun, rotation and scale being weighed as far as it was likely beforehand. It is summed mark by mark, each held
//! against the place that the marks before it foretell, the nearest to the first mark first.

use super::fit::{Fit, GATE_SIGMAS};
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
