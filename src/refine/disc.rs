//! The disc on the plate, from a frame's limb and a mapping that is known: the circle through its points.

use super::record::PackedPoint;
use crate::geometry::Mapping;
use crate::units::{Estimate, Measured, PlateMil, SensorPx};
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

/// A disc on the plate; the mapping's own uncertainty is not in it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlateDisc {
    pub centre: Estimate<PlateMil>,
    pub radius_mil: Measured,
    /// Scatter of the points over their sigmas.
    pub scatter: f64,
    pub points: usize,
}

const STEPS: usize = 8;
const SETTLED_MIL: f64 = 1e-6;
/// Points so many sigma off count nothing (Tukey).
const TUKEY_SIGMAS: f64 = 5.0;
/// Fewer points make no circle.
const LEAST_POINTS: usize = 6;

/// Fits the circle; `centre_px` is its centre's picture, from which the points are told, and `radius_mil` is what is known of
/// its radius. `None` where too few points agree.
pub fn on_plate(
    centre_px: [f64; 2],
    limb: &[PackedPoint],
    mapping: &Mapping,
    radius_mil: Measured,
) -> Option<PlateDisc> {
    let centre = SensorPx::new(centre_px[0], centre_px[1]);
    let start = mapping.to_plate(centre).vector();
    let points: Vec<_> = limb
        .iter()
        .map(|point| {
            let (at, sigma_px) = point.unpack(centre_px);
            let on_plate = mapping.to_plate(at).vector();
            let outward = (on_plate - start).normalize();
            let across = mapping.plate_jacobian(at).transpose() * outward;
            (on_plate, sigma_px * across.norm())
        })
        .collect();
    let mut circle = Vector3::new(start.x, start.y, radius_mil.value);
    let mut sums = Sums::of(&points, &circle, radius_mil, None);
    for step in 0..STEPS {
        if step > 0 {
            let far = TUKEY_SIGMAS * sums.scatter();
            sums = Sums::of(&points, &circle, radius_mil, Some(far));
        }
        if sums.counted < LEAST_POINTS {
            return None;
        }
        let moved = sums.information.cholesky()?.solve(&sums.gradient);
        circle += moved;
        if step > 1 && moved.norm() < SETTLED_MIL {
            break;
        }
    }
    // Of the pulls before the step, so only of the last ones.
    let scatter = sums.scatter();
    let covariance = sums.information.cholesky()?.inverse() * scatter.powi(2);
    let on_plate: Matrix2<f64> = covariance.fixed_view::<2, 2>(0, 0).into_owned();
    circle.iter().all(|v| v.is_finite()).then(|| PlateDisc {
        centre: Estimate {
            position: circle.xy().into(),
            covariance: on_plate,
        },
        radius_mil: Measured::new(circle.z, covariance.m33.max(0.0).sqrt()),
        scatter,
        points: sums.counted,
    })
}

/// What the points, each with its sigma, and the known radius say of a circle: centre and radius.
struct Sums {
    information: Matrix3<f64>,
    gradient: Vector3<f64>,
    counted: usize,
    weights: f64,
    /// Of the pulls, weighted.
    squares: f64,
}

impl Sums {
    /// `far_sigmas` off a point counts nothing; all count in full where there is no outline yet to be off from.
    fn of(
        points: &[(Vector2<f64>, f64)],
        circle: &Vector3<f64>,
        radius_mil: Measured,
        far_sigmas: Option<f64>,
    ) -> Self {
        let prior = radius_mil.sigma.powi(-2);
        let mut sums = Self {
            information: Matrix3::from_diagonal(&Vector3::new(0.0, 0.0, prior)),
            gradient: Vector3::new(0.0, 0.0, (radius_mil.value - circle.z) * prior),
            counted: 0,
            weights: 0.0,
            squares: 0.0,
        };
        for (at, sigma_mil) in points {
            let from_centre = at - circle.xy();
            let distance = from_centre.norm();
            let pull = (distance - circle.z) / sigma_mil;
            let off = far_sigmas.map_or(0.0, |far| pull / far);
            let weight = (1.0 - off.powi(2).min(1.0)).powi(2);
            if weight > 0.0 {
                sums.add(
                    (from_centre / distance).push(1.0) / *sigma_mil,
                    pull,
                    weight,
                );
            }
        }
        sums
    }

    fn add(&mut self, row: Vector3<f64>, pull: f64, weight: f64) {
        self.counted += 1;
        self.squares += weight * pull.powi(2);
        self.weights += weight;
        self.information += row * row.transpose() * weight;
        self.gradient += row * (pull * weight);
    }

    /// Scatter of the points over their sigmas, not below 1.
    fn scatter(&self) -> f64 {
        let freedom = (self.weights - 3.0).max(1.0);
        (self.squares / freedom).sqrt().max(1.0)
    }
}
