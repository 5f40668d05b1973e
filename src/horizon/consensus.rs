//! Which points lie on one sphere's edge: RANSAC (Fischler and Bolles 1981; Braun and Barf 2022, section 3.6) with the cone's half-angle
//! known, so that two points and their bright sides tell the nadir.

use super::edge::{EdgePoint, EdgeRay};
use crate::geometry::camera::Camera;
use nalgebra::UnitVector3;

/// Arcs from which guesses are made, the longest first.
const MOST_ARCS: usize = 6;
/// Pairs of each arc: at so many places, the ends of a pair apart by these parts of the arc.
const PAIRS: usize = 12;
const APART: [f64; 4] = [1.0, 0.5, 0.25, 0.12];
/// Guesses are judged by no more points than this.
const MOST_JUDGES: usize = 200;
/// Cosine of the angle by which the bright side may lie off the direction to the nadir.
const LEAST_SAME_SIDE: f64 = 0.8;

/// The nadir with which most of some points of all arcs agree, and how many these are. Arcs anywhere in the picture are of one cone.
pub(super) fn consensus(
    arcs: &[Vec<EdgePoint>],
    camera: &Camera,
    half_angle_rad: f64,
    tolerance_rad: f64,
) -> Option<(UnitVector3<f64>, usize)> {
    let mut rays: Vec<Vec<EdgeRay>> = arcs
        .iter()
        .map(|arc| arc.iter().filter_map(|p| EdgeRay::of(p, camera)).collect())
        .collect();
    rays.sort_by_key(|arc| std::cmp::Reverse(arc.len()));
    let total: usize = rays.iter().map(Vec::len).sum();
    let judges: Vec<EdgeRay> = rays
        .iter()
        .flatten()
        .step_by(total.div_ceil(MOST_JUDGES).max(1))
        .copied()
        .collect();
    let cone = Cone::new(half_angle_rad, tolerance_rad);
    let guesses = rays
        .iter()
        .take(MOST_ARCS)
        .flat_map(|arc| guesses(arc, &cone));
    let agreeing =
        |nadir: &UnitVector3<f64>| judges.iter().filter(|ray| cone.has(nadir, ray)).count();
    guesses
        .map(|nadir| (nadir, agreeing(&nadir)))
        .max_by_key(|(_, count)| *count)
}

/// A cone about an unknown nadir.
struct Cone {
    cosine: f64,
    sine: f64,
    /// Of a ray's cosine.
    tolerance: f64,
}

impl Cone {
    fn new(half_angle_rad: f64, tolerance_rad: f64) -> Self {
        let (sine, cosine) = half_angle_rad.sin_cos();
        Self {
            cosine,
            sine,
            tolerance: tolerance_rad * sine,
        }
    }

    /// Whether a ray lies on the cone of a nadir, with the bright side towards it.
    fn has(&self, nadir: &UnitVector3<f64>, ray: &EdgeRay) -> bool {
        (ray.unit.dot(nadir) - self.cosine).abs() < self.tolerance
            && ray.inward.dot(nadir) > LEAST_SAME_SIDE * self.sine
    }

    /// The nadirs whose cone has two rays.
    fn through(&self, one: &EdgeRay, other: &EdgeRay) -> Option<[UnitVector3<f64>; 2]> {
        let (p, q) = (one.unit.into_inner(), other.unit.into_inner());
        let (along, across) = (p + q, p.cross(&q));
        let part = along * (self.cosine / (1.0 + p.dot(&q)));
        let square = across.norm_squared();
        let rest = (1.0 - part.norm_squared()) / square;
        (square > 0.0 && rest >= 0.0).then(|| {
            [1.0, -1.0].map(|side| UnitVector3::new_normalize(part + across * (side * rest.sqrt())))
        })
    }
}

/// The nadirs by pairs of points of an arc.
fn guesses(arc: &[EdgeRay], cone: &Cone) -> Vec<UnitVector3<f64>> {
    let mut guesses = Vec::new();
    for apart in APART {
        let step = ((arc.len() as f64 - 1.0) * apart) as usize;
        if step == 0 {
            continue;
        }
        let places = arc.len() - step;
        let starts = (0..places).step_by(places.div_ceil(PAIRS));
        for (one, other) in starts.map(|n| (&arc[n], &arc[n + step])) {
            let both = cone.through(one, other).into_iter().flatten();
            guesses.extend(both.filter(|nadir| cone.has(nadir, one) && cone.has(nadir, other)));
        }
    }
    guesses
}
