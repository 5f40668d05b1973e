//! The fit of a labelling: from what the outline and the arms tell to what the marks say.

use super::prior::IdentificationPrior;
use crate::plate::MarkId;
use crate::units::{Measured, PlateMil};
use nalgebra::Vector2;
use std::f64::consts::{PI, TAU};

/// Error of the rotation that the arms tell, 1 sigma; three noisy marks tell it to a degree.
const ARMS_SIGMA_RAD: f64 = 0.6 * PI / 180.0;
/// A detection farther from a mark's predicted place is not that mark, in sigma.
pub(super) const GATE_SIGMAS: f64 = 4.0;
/// Its square.
const GATE: f64 = GATE_SIGMAS * GATE_SIGMAS;

/// From offsets to the plate: shift, and small changes of scale and rotation, from the marks so far. Least squares with
/// what is known of scale and rotation beforehand, in sums that grow by a mark at a time.
#[derive(Debug, Clone, Copy)]
pub(super) struct LocalSimilarity {
    weight: f64,
    /// Weighted means of the offsets and of what leads from them to the printed places, mil.
    offset: Vector2<f64>,
    step: Vector2<f64>,
    /// Information on scale and rotation, and its products with them.
    scale_weight: f64,
    rotation_weight: f64,
    stretch: f64,
    twist: f64,
    /// What they come to.
    scale: f64,
    rotation: f64,
}

impl LocalSimilarity {
    pub(super) fn new(prior: &IdentificationPrior) -> Self {
        let scale_sigma = prior.radius_mil.sigma / prior.radius_mil.value;
        Self {
            weight: 0.0,
            offset: Vector2::zeros(),
            step: Vector2::zeros(),
            scale_weight: scale_sigma.powi(-2),
            rotation_weight: ARMS_SIGMA_RAD.powi(-2),
            stretch: 0.0,
            twist: 0.0,
            scale: 0.0,
            rotation: 0.0,
        }
    }

    pub(super) fn add(&mut self, offset: Vector2<f64>, printed: PlateMil, variance: f64) {
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
        self.scale = self.stretch / self.scale_weight;
        self.rotation = self.twist / self.rotation_weight;
    }

    /// Where on the plate an offset leads.
    pub(super) fn place(&self, offset: Vector2<f64>) -> PlateMil {
        let arm = offset - self.offset;
        let turn = Vector2::new(-arm.y, arm.x);
        (offset + self.step + self.scale * arm + self.rotation * turn).into()
    }

    /// How much longer a way on the plate is than the offset that leads along it, squared.
    pub(super) fn stretch2(&self) -> f64 {
        (1.0 + self.scale).powi(2) + self.rotation.powi(2)
    }

    /// By how much it turns offsets on the plate.
    pub(super) fn rotation_deg(&self) -> Measured {
        let sigma = self.rotation_weight.powf(-0.5);
        Measured::new(self.rotation.to_degrees(), sigma.to_degrees())
    }

    /// Scale where the offsets' own is as given, both in mil/px.
    pub(super) fn scale(&self, of_offsets: f64) -> Measured {
        let sigma = self.scale_weight.powf(-0.5);
        Measured::new(of_offsets * (1.0 + self.scale), of_offsets * sigma)
    }

    /// The inverse of [`place`](Self::place).
    pub(super) fn offset(&self, printed: PlateMil) -> Vector2<f64> {
        let arm = printed.vector() - self.offset - self.step;
        let (along, across) = (1.0 + self.scale, self.rotation);
        let turned = Vector2::new(
            along * arm.x + across * arm.y,
            along * arm.y - across * arm.x,
        );
        self.offset + turned / (along * along + across * across)
    }

    /// Variance of a place in the worse direction, mil^2.
    pub(super) fn variance(&self, offset: Vector2<f64>) -> f64 {
        let least = self.scale_weight.min(self.rotation_weight);
        1.0 / self.weight + (offset - self.offset).norm_squared() / least
    }

    /// How likely the mark that is printed at a place is seen at an offset, per mil^2, logarithm; `variance` (mil^2) tells
    /// how far it may be seen from its place. `None` when it is not that mark.
    pub(super) fn likelihood(
        &self,
        offset: Vector2<f64>,
        printed: PlateMil,
        variance: f64,
    ) -> Option<f64> {
        let arm = offset - self.offset;
        let reach = arm.norm_squared();
        let common = variance + 1.0 / self.weight;
        let along = common + reach / self.scale_weight;
        let across = common + reach / self.rotation_weight;
        let residual = printed.vector() - self.place(offset).vector();
        let (stretch, twist) = (arm.dot(&residual), arm.perp(&residual));
        let off =
            (stretch * stretch / along + twist * twist / across) / reach.max(f64::MIN_POSITIVE);
        (off < GATE).then(|| -0.5 * off - TAU.ln() - 0.5 * (along * across).ln())
    }
}

/// Where a detection is, as an offset from the Sun's centre on the plate.
#[derive(Debug, Clone, Copy)]
pub(super) struct Candidate {
    /// Index of the detection.
    pub detection: usize,
    pub offset: Vector2<f64>,
    /// Of its position, were it a fully lit mark, mil^2.
    pub variance: f64,
}

/// A candidate with the mark that it is.
#[derive(Debug, Clone, Copy)]
pub(super) struct Explained {
    pub candidate: Candidate,
    pub id: MarkId,
    /// Where the mark is printed.
    pub at: PlateMil,
    /// How likely it is seen where it is, per mil^2, logarithm.
    pub likelihood: f64,
}

/// Printed marks.
pub(super) struct Printed {
    pub marks: Vec<(MarkId, PlateMil)>,
}

impl Printed {
    /// Those of some marks that lie about a place.
    pub(super) fn about(place: PlateMil, reach_mil: f64, marks: &[(MarkId, PlateMil)]) -> Self {
        let near = |(_, at): &&(MarkId, PlateMil)| at.distance(place) < reach_mil;
        Self {
            marks: marks.iter().filter(near).copied().collect(),
        }
    }

    /// The first of some candidates that is a mark, `variance` (mil^2) telling how far it may be seen from the place of one, with
    /// the candidates after it; `None` when none is.
    pub(super) fn explain<'s>(
        &self,
        candidates: &'s [Candidate],
        fit: &LocalSimilarity,
        variance: impl Fn(&Candidate, PlateMil) -> f64,
    ) -> Option<(Explained, &'s [Candidate])> {
        candidates.iter().enumerate().find_map(|(n, candidate)| {
            let (id, at) = self.nearest(fit.place(candidate.offset))?;
            let likelihood = fit.likelihood(candidate.offset, at, variance(candidate, at))?;
            let explained = Explained {
                candidate: *candidate,
                id,
                at,
                likelihood,
            };
            Some((explained, &candidates[n + 1..]))
        })
    }

    fn nearest(&self, place: PlateMil) -> Option<(MarkId, PlateMil)> {
        let place = place.vector();
        let (mut nearest, mut least) = (None, f64::INFINITY);
        for mark in &self.marks {
            let square = (mark.1.vector() - place).norm_squared();
            if square < least {
                (nearest, least) = (Some(*mark), square);
            }
        }
        nearest
    }
}
