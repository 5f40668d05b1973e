//! The disc on the plate, from a frame's limb and a known mapping: a circle fitted to its points.

use super::record::PackedPoint;
use crate::estimation::{LeastSquares, Linearised, Loss, Prior, Scale, TUKEY_SIGMAS};
use crate::geometry::Mapping;
use crate::units::{Estimate, Measured, PlateMil, SensorPx};
use nalgebra::{Matrix2, Vector1, Vector2, Vector3};

/// A disc on the plate, without the mapping's own uncertainty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlateDisc {
    pub centre: Estimate<PlateMil>,
    pub radius_mil: Measured,
    /// Scatter of the points over their sigmas. The covariance includes it where it is more than 1.
    pub scatter: f64,
    pub points: usize,
}

impl PlateDisc {
    /// The disc with the covariance of a motion during the exposure, mil^2, added.
    pub fn with_motion(mut self, by_motion_mil2: Matrix2<f64>) -> Self {
        self.centre.covariance += by_motion_mil2;
        self.radius_mil.sigma = self
            .radius_mil
            .sigma
            .hypot((by_motion_mil2.trace() / 2.0).sqrt());
        self
    }
}

/// Fewer points do not determine a circle.
const LEAST_POINTS: usize = 6;
/// The rms of normally distributed residuals with the weights of Tukey's loss, which suppresses their tails.
const TUKEY_RMS: f64 = 0.91;

/// A point of the limb on the plate, with its sigma across the limb, mil.
type LimbPoint = (Vector2<f64>, f64);

/// Fits the circle; `centre_px` is the sensor position relative to which the points are stored, and `radius_mil` is the prior of
/// the radius. `None` where too few points agree.
pub fn on_plate(
    centre_px: [f64; 2],
    limb: &[PackedPoint],
    mapping: &Mapping,
    radius_mil: Measured,
) -> Option<PlateDisc> {
    let centre = SensorPx::new(centre_px[0], centre_px[1]);
    let start = mapping.to_plate(centre).vector();
    let points: Vec<LimbPoint> = limb
        .iter()
        .map(|point| {
            let (at, sigma_px) = point.unpack(centre_px);
            let on_plate = mapping.to_plate(at).vector();
            let outward = (on_plate - start).normalize();
            let across = mapping.plate_jacobian(at).transpose() * outward;
            (on_plate, sigma_px * across.norm())
        })
        .collect();
    if points.len() < LEAST_POINTS {
        return None;
    }
    let start = start.push(radius_mil.value);
    let circle = LeastSquares {
        start,
        prior: Prior {
            mean: start,
            information: Vector3::new(0.0, 0.0, radius_mil.sigma.powi(-2)),
        },
        loss: Loss::Tukey(TUKEY_SIGMAS),
        scale: Scale::Inflated,
        tolerance_sigmas: 1e-6,
    };
    let fitted = circle
        .fit_after_plain(|circle| Some(linearised(&points, circle)))
        .ok()?;
    let rows = linearised(&points, &fitted.parameters);
    let weighted = rows.iter().zip(&fitted.weights);
    let squares: f64 = weighted
        .map(|(row, weight)| weight * row.residual.x.powi(2))
        .sum();
    let freedom = fitted.weights.iter().sum::<f64>() - fitted.parameters.len() as f64;
    let counted = fitted.weights.iter().filter(|weight| **weight > 0.0);
    let counted = counted.count();
    let covariance: Matrix2<f64> = fitted.covariance.fixed_view::<2, 2>(0, 0).into_owned();
    (counted >= LEAST_POINTS && freedom > 0.0).then(|| PlateDisc {
        centre: Estimate {
            position: fitted.parameters.xy().into(),
            covariance,
        },
        radius_mil: fitted.measured(2),
        scatter: (squares / freedom).sqrt() / TUKEY_RMS,
        points: counted,
    })
}

/// Distances of the points outside a circle (centre x, y and radius), in their sigmas.
fn linearised(points: &[LimbPoint], circle: &Vector3<f64>) -> Vec<Linearised<1, 3>> {
    let linearised = |(at, sigma_mil): &LimbPoint| {
        let from_centre = at - circle.xy();
        let distance = from_centre.norm();
        Linearised {
            residual: Vector1::new((distance - circle.z) / sigma_mil),
            jacobian: (from_centre / distance).push(1.0).transpose() / *sigma_mil,
        }
    };
    points.iter().map(linearised).collect()
}
