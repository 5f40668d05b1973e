//! The fit of a reading: from what the outline and the arms tell to what the marks say.

use super::prior::IdentificationPrior;
use crate::lanes::{LANES, Scratch};
use crate::plate::MarkId;
use crate::units::PlateMil;
use multiversion::multiversion;
use nalgebra::Vector2;
use std::f64::consts::{PI, TAU};

/// Error of the rotation that the arms tell, 1 sigma; three noisy marks tell it to a degree.
const ARMS_SIGMA_RAD: f64 = 0.6 * PI / 180.0;
/// A detection farther from a mark's foretold place is not that mark, in sigma.
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
    pub(super) fn new(sight: &IdentificationPrior) -> Self {
        let scale_sigma = sight.radius_mil.sigma / sight.radius_mil.value;
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
    #[inline(always)]
    pub(super) fn place(&self, offset: Vector2<f64>) -> PlateMil {
        let arm = offset - self.offset;
        let turn = Vector2::new(-arm.y, arm.x);
        (offset + self.step + self.scale * arm + self.rotation * turn).into()
    }

    /// How much longer a way on the plate is than the offset that leads along it, squared.
    pub(super) fn stretch2(&self) -> f64 {
        (1.0 + self.scale).powi(2) + self.rotation.powi(2)
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
    #[inline(always)]
    pub(super) fn variance(&self, offset: Vector2<f64>) -> f64 {
        let least = self.scale_weight.min(self.rotation_weight);
        1.0 / self.weight + (offset - self.offset).norm_squared() / least
    }

    /// Square of the distance, mil^2, from where an offset leads to the farthest mark that may be seen there, when `variance`
    /// (mil^2) tells how far a mark may be seen from its place. The error in the worse direction is taken for both:
    /// whatever is farther, [`likelihood`](Self::likelihood) refuses too.
    #[inline(always)]
    fn gate_mil2(&self, offset: Vector2<f64>, variance: f64) -> f64 {
        GATE * (variance + self.variance(offset))
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
        let miss = printed.vector() - self.place(offset).vector();
        let (stretch, twist) = (arm.dot(&miss), arm.perp(&miss));
        let off =
            (stretch * stretch / along + twist * twist / across) / reach.max(f64::MIN_POSITIVE);
        (off < GATE).then(|| -0.5 * off - TAU.ln() - 0.5 * (along * across).ln())
    }
}

/// Where a detection is, as an offset from the Sun's centre on the plate.
#[derive(Debug, Clone, Copy)]
pub(super) struct Spot {
    /// Index of the detection.
    pub detection: usize,
    pub offset: Vector2<f64>,
    /// How far it may be seen from the mark that it is: most of that, mil^2.
    pub variance: f64,
}

/// A spot with the mark that it is.
#[derive(Debug, Clone, Copy)]
pub(super) struct Explained {
    pub spot: Spot,
    pub id: MarkId,
    /// Where the mark is printed.
    pub at: PlateMil,
    /// How likely it is seen where it is, per mil^2, logarithm.
    pub likelihood: f64,
}

/// Printed marks.
pub(super) struct Printed {
    pub marks: Vec<(MarkId, PlateMil)>,
    /// Their places, mil, to be compared side by side: the x of a group of marks, then the y of them; the last group is
    /// filled up with places at infinity.
    groups: Scratch<f32>,
}

impl Printed {
    /// Those of some marks that lie about a place.
    pub(super) fn about(place: PlateMil, reach_mil: f64, marks: &[(MarkId, PlateMil)]) -> Self {
        let place = place.vector();
        let near = |at: PlateMil| (at.vector() - place).norm_squared() < reach_mil * reach_mil;
        let mut about = Vec::with_capacity(marks.len());
        about.extend(marks.iter().filter(|(_, at)| near(*at)));
        let mut groups = Scratch::empty(2 * about.len().next_multiple_of(LANES));
        for marks in about.chunks(LANES) {
            let mut group = [[f32::INFINITY; LANES]; 2];
            for (k, (_, at)) in marks.iter().enumerate() {
                group[0][k] = at.x as f32;
                group[1][k] = at.y as f32;
            }
            groups.extend(group.as_flattened());
        }
        Self {
            marks: about,
            groups,
        }
    }

    /// The first of some spots that is a mark, `variance` (mil^2) telling how far it may be seen from the place of one, with
    /// the spots after it; `None` when none is.
    pub(super) fn explain<'s>(
        &self,
        mut spots: &'s [Spot],
        fit: &LocalSimilarity,
        variance: impl Fn(&Spot, PlateMil) -> f64,
    ) -> Option<(Explained, &'s [Spot])> {
        loop {
            let (n, mark) = first_near(self.groups.as_chunks().0, spots, fit)?;
            let (spot, (id, at)) = (&spots[n], *self.marks.get(mark)?);
            spots = &spots[n + 1..];
            if let Some(likelihood) = fit.likelihood(spot.offset, at, variance(spot, at)) {
                let explained = Explained {
                    spot: *spot,
                    id,
                    at,
                    likelihood,
                };
                return Some((explained, spots));
            }
        }
    }
}

/// The first spot that a fit puts near one of many places, and the nearest of these. In single precision, whose rounding the
/// gate allows for: what is passed over is near none, what is found may be a little too far.
#[multiversion(targets("x86_64+avx2"))]
fn first_near(
    groups: &[[f32; 2 * LANES]],
    spots: &[Spot],
    fit: &LocalSimilarity,
) -> Option<(usize, usize)> {
    for (n, spot) in spots.iter().enumerate() {
        let place = fit.place(spot.offset);
        let at = [place.x as f32, place.y as f32];
        let mut least = [f32::INFINITY; LANES];
        for group in groups {
            let mil2 = distances_mil2(group, at);
            for k in 0..LANES {
                least[k] = if mil2[k] < least[k] {
                    mil2[k]
                } else {
                    least[k]
                };
            }
        }
        let gate = rounded_up(fit.gate_mil2(spot.offset, spot.variance));
        if least.iter().fold(false, |any, mil2| any | (*mil2 < gate)) {
            let lane = (1..LANES).fold(0, |a, b| if least[b] < least[a] { b } else { a });
            let nearest = |group: &[f32; 2 * LANES]| distances_mil2(group, at)[lane] <= least[lane];
            let group = groups.iter().position(nearest)?;
            return Some((n, group * LANES + lane));
        }
    }
    None
}

/// Squares of the distances of a group's places from another.
#[inline(always)]
fn distances_mil2(group: &[f32; 2 * LANES], [x, y]: [f32; 2]) -> [f32; LANES] {
    let mut mil2 = [0.0; LANES];
    for k in 0..LANES {
        let (across, down) = (group[k] - x, group[LANES + k] - y);
        mil2[k] = across * across + down * down;
    }
    mil2
}

/// The square of a distance, mil^2, and more than single precision may add to that between two places on the plate.
#[inline(always)]
fn rounded_up(mil2: f64) -> f32 {
    (1.001 * mil2 + 0.01) as f32
}
