//! The disc on the plate, from a frame's limb and a mapping that is known: the circle through its points.

use super::record::PackedPoint;
use crate::geometry::Mapping;
use crate::units::{Estimate, Measured, PlateMil, SensorPx};
use nalgebra::{Matrix2, Matrix3, Vector3};

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

/// Fits the circle; `centre_px` is its centre's picture, from which the points are told, and `radius_mil` is what is known of its radius. `None` where too few points agree.
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
    let mut scatter = 1.0;
    let mut information = Matrix3::zeros();
    let mut counted = 0;
    for step in 0..STEPS {
        let prior = radius_mil.sigma.powi(-2);
        information = Matrix3::from_diagonal(&Vector3::new(0.0, 0.0, prior));
        let mut gradient = Vector3::new(0.0, 0.0, (radius_mil.value - circle.z) * prior);
        let (mut sum, mut weights) = (0.0, 0.0);
        counted = 0;
        for (at, sigma_mil) in &points {
            let from_centre = at - circle.xy();
            let distance = from_centre.norm();
            let pull = (distance - circle.z) / sigma_mil;
            // The first step has no outline yet to be off from.
            let off = if step == 0 {
                0.0
            } else {
                pull / (TUKEY_SIGMAS * scatter)
            };
            let weight = (1.0 - off.powi(2).min(1.0)).powi(2);
            if weight <= 0.0 {
                continue;
            }
            counted += 1;
            sum += weight * pull.powi(2);
            weights += weight;
            let row = (from_centre / distance).push(1.0) / *sigma_mil;
            information += row * row.transpose() * weight;
            gradient += row * (pull * weight);
        }
        if counted < LEAST_POINTS {
            return None;
        }
        let moved = information.cholesky()?.solve(&gradient);
        circle += moved;
        let freedom = (weights - 3.0).max(1.0);
        // Of the pulls before the step, so only of the last ones.
        scatter = (sum / freedom).sqrt().max(1.0);
        if step > 1 && moved.norm() < SETTLED_MIL {
            break;
        }
    }
    let covariance = information.cholesky()?.inverse() * scatter.powi(2);
    let on_plate: Matrix2<f64> = covariance.fixed_view::<2, 2>(0, 0).into_owned();
    circle.iter().all(|v| v.is_finite()).then(|| PlateDisc {
        centre: Estimate {
            position: circle.xy().into(),
            covariance: on_plate,
        },
        radius_mil: Measured::new(circle.z, covariance.m33.max(0.0).sqrt()),
        scatter,
        points: counted,
    })
}
