//! The fit of a reading: from what the outline and the arms tell to what the marks say.

use super::identify::Sight;
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

/// From offsets to the plate: shift, and small changes of scale and rotation, from the marks so far. Least squares with
/// what is known of scale and rotation beforehand, in sums that grow by a mark at a time.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fit {
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

impl Fit {
    pub(super) fn new(sight: &Sight) -> Self {
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
    pub(super) fn place(&self, offset: Vector2<f64>) -> PlateMil {
        let arm = offset - self.offset;
        let turn = Vector2::new(-arm.y, arm.x);
        (offset + self.step + self.scale * arm + self.rotation * turn).into()
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

    /// Square of the distance, mil^2, from where an offset leads to the farthest mark that may be seen there, when `variance`
    /// (mil^2) tells how far a mark may be seen from its place: along the worse direction.
    pub(super) fn gate_mil2(&self, offset: Vector2<f64>, variance: f64) -> f64 {
        GATE_SIGMAS * GATE_SIGMAS * (variance + self.variance(offset))
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
        let gate = GATE_SIGMAS * GATE_SIGMAS;
        (off < gate).then(|| -0.5 * off - TAU.ln() - 0.5 * (along * across).ln())
    }
}

/// What leads from one detection to another.
pub(super) struct Arm {
    pub to: Vector2<f64>,
    /// Square of the distance from a mark at which the other may be seen to be that mark, mil^2.
    pub gate_mil2: f64,
}

/// Printed marks.
pub(super) struct Printed {
    pub marks: Vec<(MarkId, PlateMil)>,
    /// Their places, mil, to be compared side by side; filled up with places at infinity.
    x: Scratch<f32>,
    y: Scratch<f32>,
}

/// What rounding to single precision may change in a square of a distance on the plate: a share, and mil^2.
const ROUNDING: (f64, f64) = (0.001, 0.01);

impl Printed {
    /// Those that lie about a place.
    pub(super) fn about(place: PlateMil, reach_mil: f64, marks: &[(MarkId, PlateMil)]) -> Self {
        let place = place.vector();
        let near = |at: PlateMil| (at.vector() - place).norm_squared() < reach_mil * reach_mil;
        let marks = marks.iter().filter(|(_, at)| near(*at)).copied();
        let marks: Vec<_> = marks.collect();
        let filled = marks.len().next_multiple_of(LANES);
        let side_by_side = |coordinate: fn(&PlateMil) -> f64| {
            let mut list = Scratch::empty(filled);
            list.extend(marks.iter().map(|(_, at)| coordinate(at) as f32));
            list.resize(filled, f32::INFINITY);
            list
        };
        let (x, y) = (side_by_side(|at| at.x), side_by_side(|at| at.y));
        Self { marks, x, y }
    }

    /// Whether from a mark at a place some arm may lead to another: where it says no, none does.
    pub(super) fn lead_on(&self, from: PlateMil, arms: &[Arm]) -> bool {
        let from = from.vector();
        arms.iter().any(|arm| {
            let at = from + arm.to;
            let gate_mil2 = rounded_up(arm.gate_mil2);
            any_within(&self.x, &self.y, [at.x as f32, at.y as f32], gate_mil2)
        })
    }

    /// The mark nearest to a place, if it may be so near.
    pub(super) fn nearest(
        &self,
        place: Vector2<f64>,
        within_mil2: f64,
    ) -> Option<(MarkId, PlateMil)> {
        let (n, mil2) = nearest(&self.x, &self.y, [place.x as f32, place.y as f32]);
        let mark = self.marks.get(n)?;
        (mil2 < rounded_up(within_mil2)).then_some(*mark)
    }
}

/// The square of a distance, to be compared with such as are rounded.
fn rounded_up(mil2: f64) -> f32 {
    ((1.0 + ROUNDING.0) * mil2 + ROUNDING.1) as f32
}

/// Whether any of many places lies so near to another.
#[multiversion(targets("x86_64+avx2"))]
fn any_within(xs: &[f32], ys: &[f32], [x, y]: [f32; 2], mil2: f32) -> bool {
    let mut least = [f32::INFINITY; LANES];
    let (xs, ys) = (xs.as_chunks::<LANES>().0, ys.as_chunks::<LANES>().0);
    for (xs, ys) in xs.iter().zip(ys) {
        for k in 0..LANES {
            let square = (xs[k] - x) * (xs[k] - x) + (ys[k] - y) * (ys[k] - y);
            least[k] = if square < least[k] { square } else { least[k] };
        }
    }
    least
        .iter()
        .fold(false, |any, square| any | (*square < mil2))
}

/// The one of many places that is nearest to another, and its distance's square.
#[multiversion(targets("x86_64+avx2"))]
fn nearest(xs: &[f32], ys: &[f32], [x, y]: [f32; 2]) -> (usize, f32) {
    let mut least = [f32::INFINITY; LANES];
    let mut group_of = [0_u32; LANES];
    let (xs, ys) = (xs.as_chunks::<LANES>().0, ys.as_chunks::<LANES>().0);
    for (group, (xs, ys)) in (0_u32..).zip(xs.iter().zip(ys)) {
        for k in 0..LANES {
            let square = (xs[k] - x) * (xs[k] - x) + (ys[k] - y) * (ys[k] - y);
            group_of[k] = if square < least[k] {
                group
            } else {
                group_of[k]
            };
            least[k] = if square < least[k] { square } else { least[k] };
        }
    }
    let mut lane = 0;
    for k in 1..LANES {
        lane = if least[k] < least[lane] { k } else { lane };
    }
    (group_of[lane] as usize * LANES + lane, least[lane])
}
