//! Selection of the points that lie on one sphere's edge: RANSAC (Fischler and Bolles 1981; Braun and Barf 2022, section
//! 3.6) with a known half-angle of the cone, so that two points and their bright sides determine the nadir.

use super::edge::EdgeRay;
use nalgebra::UnitVector3;

/// Number of pairs of points from which nadirs are computed.
const PAIRS: usize = 500;
/// Steps of the pairs through the points, by the plastic number: evenly distributed for any number of points (Roberts 2018,
/// the sequence R2).
const STEPS: [f64; 2] = [0.754_877_666_246_693, 0.569_840_290_998_053];
/// Maximum number of points that are used to judge a guess.
const MOST_JUDGES: usize = 120;
/// Minimum cosine of the angle between the bright side and the direction to the nadir.
const LEAST_SAME_SIDE: f64 = 0.8;

/// A nadir, and the number of points that agree with it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Guess {
    pub nadir: UnitVector3<f64>,
    pub agreeing: usize,
}

/// The nadir with which most points agree; then the one with which most of the remaining points agree, and so on, at most
/// `most`.
pub(super) fn consensus(
    edge: &[EdgeRay],
    half_angle_rad: f64,
    tolerance_rad: f64,
    most: usize,
) -> Vec<Guess> {
    let cone = Cone::new(half_angle_rad, tolerance_rad);
    let every = edge.len().div_ceil(MOST_JUDGES).max(1);
    let mut judges: Vec<EdgeRay> = edge.iter().step_by(every).copied().collect();
    let guesses = guesses(edge, &cone);
    let mut found = Vec::new();
    while found.len() < most {
        let agreeing =
            |nadir: &UnitVector3<f64>| judges.iter().filter(|ray| cone.has(nadir, ray)).count();
        let counted = guesses.iter().map(|nadir| Guess {
            nadir: *nadir,
            agreeing: agreeing(nadir),
        });
        let Some(best) = counted
            .max_by_key(|guess| guess.agreeing)
            .filter(|guess| guess.agreeing > 0)
        else {
            break;
        };
        judges.retain(|ray| !cone.has(&best.nadir, ray));
        found.push(best);
    }
    found
}

/// A cone about an unknown nadir.
struct Cone {
    cosine: f64,
    sine: f64,
    /// Tolerance of a ray's cosine.
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

    /// Whether a ray lies on the cone of a nadir, with its bright side towards the nadir.
    fn has(&self, nadir: &UnitVector3<f64>, ray: &EdgeRay) -> bool {
        (ray.unit.dot(nadir) - self.cosine).abs() < self.tolerance
            && ray.inward.dot(nadir) > LEAST_SAME_SIDE * self.sine
    }

    /// The nadirs whose cone contains two rays.
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

/// The nadirs from pairs of points.
fn guesses(edge: &[EdgeRay], cone: &Cone) -> Vec<UnitVector3<f64>> {
    let pair = |n: usize| {
        STEPS.map(|step| &edge[((n as f64 * step).fract() * edge.len() as f64) as usize])
    };
    let pairs = (0..if edge.is_empty() { 0 } else { PAIRS }).map(pair);
    pairs
        .flat_map(|[one, other]| {
            let both = cone.through(one, other).into_iter().flatten();
            both.filter(|nadir| cone.has(nadir, one) && cone.has(nadir, other))
        })
        .collect()
}
