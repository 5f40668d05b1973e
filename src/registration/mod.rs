//! Fits mappings to pairs of sensor and plate positions, independent of what they represent.
//!
//! # Method
//! Errors are on the sensor, so the projection of the plate onto the sensor is fitted, a [`View`], by weighted least
//! squares; lens distortion is removed from the sensor positions first.
//!
//! In addition to the pairs there may be the outline of a disc: points on the sensor that lie on one circle of the plate. Its centre
//! and radius are adjusted together with the mapping. If it is observed at all azimuths, its roundness determines the mapping's
//! stretch and shear three times as well as half a dozen marks do.
//!
//! # Kind of mapping
//! The simplest that the data support: similarity, keystone, affine, homography. A richer kind is chosen if it decreases
//! chi^2 by more than [`RegistrationSettings::min_gain`] for every parameter it adds. The outline's gain counts in full. The
//! pairs' gain is computed with the sigmas from the richer kind's residuals, and reduced if these are few (the F test); with
//! too few residuals it does not count, because one bad pair would dominate the fit.
//!
//! If pairs that fit a similarity contradict the outline, the outline's sigmas are inflated until both agree: it is then not
//! the image of a circle.
//!
//! Cameras are aligned by hand: with an outline, their tilt has a prior of 0 +- 3 deg per axis. A tilt mainly changes angles
//! far from the plate's centre. It also determines a quantity that a few marks do not: the distance from the centre of the disc's
//! ellipse to the image of the disc's centre, 0.1 px at 3 deg.
//!
//! # Uncertainty
//! The covariance follows from the sigmas of pairs and outline. If the pairs' residuals are larger than their sigmas
//! allow, these are inflated to fit (variance components after Förstner). A few redundant coordinates are weak evidence: they are
//! averaged with the stated sigmas as if those had [`RegistrationSettings::prior_freedom`] degrees of freedom.
//!
//! With an outline, the covariance of a mapping without tilt is averaged with that of a tilted one, weighted by the posterior
//! probability of a tilt. If there are too few pairs to identify an outlier, their sigmas allow for one.

mod adjust;
mod choice;

use crate::geometry::view::{PARAMETERS, ParameterCovariance, UNIT_MIL, View, propagated_sigma};
use crate::geometry::{
    Circle, Distortion, Ellipse, Handedness, LocalSimilarity, Mapping, MappingKind, unit,
};
use crate::units::{Estimate, Measured, PlateMil, SensorPx};
use adjust::{Adjusted, CIRCLE, Problem, UNKNOWNS};
use nalgebra::{Matrix2, RowSVector, SMatrix, Vector2};
use serde::{Deserialize, Serialize};

/// One point, observed on the sensor and printed on the plate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pair {
    pub observed: SensorPx,
    pub printed: PlateMil,
    /// Covariance of the observed position, px^2.
    pub covariance_px2: Matrix2<f64>,
}

/// Points of the sensor that lie on one circle of the plate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outline<'a> {
    /// An ellipse close to it.
    pub ellipse: Ellipse,
    /// Points, and 1 sigma across the outline, px.
    pub points: &'a [(SensorPx, f64)],
    /// Prior of the circle's radius.
    pub radius_mil: Measured,
}

/// Criteria for the choice of a mapping.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RegistrationSettings {
    /// Least gain in chi^2, per added parameter.
    pub min_gain: f64,
    /// Weight of the stated sigmas against the residuals, in degrees of freedom.
    pub prior_freedom: f64,
}

impl Default for RegistrationSettings {
    fn default() -> Self {
        Self {
            min_gain: 9.0,
            prior_freedom: 6.0,
        }
    }
}

/// The disc of an outline.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Disc {
    /// Its centre on the plate, with the mapping's uncertainty included.
    pub on_plate: Estimate<PlateMil>,
    /// Its centre on the sensor.
    pub on_sensor: Estimate<SensorPx>,
    pub radius_mil: Measured,
    /// The radius at the mapping's scale at the centre. Its sigma is smaller than those of radius and scale, whose errors are correlated.
    pub radius_px: Measured,
}

/// A fitted mapping with its uncertainty.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Registration {
    pub mapping: Mapping,
    /// Root mean square distance between observed and predicted positions, per axis.
    pub residual_px: f64,
    /// The disc, if an outline was fitted.
    pub disc: Option<Disc>,
    view: View,
    covariance: ParameterCovariance,
}

impl Registration {
    /// Covariance, from the mapping alone, of a plate position computed with it; mil^2.
    pub fn covariance_mil2(&self, at: PlateMil) -> Matrix2<f64> {
        self.view
            .covariance_mil2(at, &self.mapping, &self.covariance)
    }

    /// Rotation (deg), scale (mil/px) and position (x, y, px) of the plate's centre on the sensor, with the sigmas of pairs and
    /// outline.
    pub fn at_plate_centre(&self) -> [Measured; 4] {
        let middle = PlateMil::new(0.0, 0.0);
        let slopes = self.view.similarity_slopes(middle);
        let turn_rad = propagated_sigma(&slopes.rotation_rad, &self.covariance);
        let stretch = propagated_sigma(&slopes.log_scale, &self.covariance);
        let scale = UNIT_MIL / self.view.unit_px();
        let centre = self.mapping.to_sensor(middle);
        let shift_px = |axis: usize| self.covariance[(axis, axis)].max(0.0).sqrt();
        [
            Measured::new(self.view.rotation_deg(), turn_rad.to_degrees()),
            Measured::new(scale, scale * stretch),
            Measured::new(centre.x, shift_px(0)),
            Measured::new(centre.y, shift_px(1)),
        ]
    }

    /// Scale and rotation of the mapping at a sensor position, with the sigmas of pairs and outline.
    pub fn local_similarity(&self, seen: SensorPx) -> LocalSimilarity {
        self.view
            .local_similarity(seen, &self.mapping, &self.covariance)
    }

    /// The least and the largest plate length per pixel at a plate position, over all directions, mil/px, with the sigmas of pairs
    /// and outline.
    pub fn principal_scales(&self, at: PlateMil) -> [Measured; 2] {
        let jacobian = self.view.jacobian(at);
        // The direction on the plate that is magnified most, and the perpendicular one.
        let square = jacobian.tr_mul(&jacobian);
        let angle = 0.5 * (2.0 * square.m12).atan2(square.m11 - square.m22);
        let along = unit(angle);
        [along, Vector2::new(-along.y, along.x)].map(|along| {
            let picture = jacobian * along;
            let px_per_mil = picture.norm();
            let slopes = self.view.parameter_jacobian_along(at, along);
            let slopes = (picture / px_per_mil).tr_mul(&slopes);
            let scale = 1.0 / px_per_mil;
            let sigma = scale * scale * propagated_sigma(&slopes, &self.covariance);
            Measured::new(scale, sigma)
        })
    }
}

/// Fits the simplest mapping that the pairs and the outline support. `None` if they do not determine one.
pub fn register(
    pairs: &[Pair],
    outline: Option<&Outline<'_>>,
    handedness: Handedness,
    distortion: Distortion,
    settings: &RegistrationSettings,
) -> Option<Registration> {
    let mut problem = Problem::new(pairs, outline, handedness, distortion)?;
    let chosen = choice::choose(&mut problem, settings)?;
    registration(&problem, &chosen, distortion)
}

/// Fits a mapping of one kind. `None` if the pairs do not determine it.
pub fn fit(
    pairs: &[Pair],
    kind: MappingKind,
    handedness: Handedness,
    distortion: Distortion,
    settings: &RegistrationSettings,
) -> Option<Registration> {
    let problem = Problem::new(pairs, None, handedness, distortion)?;
    let fitted = choice::fit_kind(&problem, &problem.similarity()?, kind, settings)?;
    registration(&problem, &fitted, distortion)
}

fn registration(
    problem: &Problem,
    adjusted: &Adjusted,
    distortion: Distortion,
) -> Option<Registration> {
    let view = adjusted.model.view;
    let residuals = problem.residuals(&view);
    let squares: f64 = residuals.map(|(_, px)| px.norm_squared()).sum();
    let circle = adjusted.model.circle;
    let mapping = view.mapping(adjusted.terms.kind, distortion)?;
    Some(Registration {
        mapping,
        residual_px: (squares / (2 * problem.pairs()) as f64).sqrt(),
        disc: circle.map(|circle| disc(&circle, adjusted, &mapping)),
        view,
        covariance: adjusted
            .covariance
            .fixed_view::<PARAMETERS, PARAMETERS>(0, 0)
            .into_owned(),
    })
}

fn disc(circle: &Circle, adjusted: &Adjusted, mapping: &Mapping) -> Disc {
    let centre = PlateMil::from(circle.centre);
    let (view, covariance) = (&adjusted.model.view, &adjusted.covariance);
    let mut to_sensor = SMatrix::<f64, 2, UNKNOWNS>::zeros();
    to_sensor
        .fixed_columns_mut::<PARAMETERS>(0)
        .copy_from(&view.parameter_jacobian(centre));
    to_sensor
        .fixed_columns_mut::<2>(CIRCLE)
        .copy_from(&view.jacobian(centre));
    let on_sensor = mapping.to_sensor(centre);
    let radius_variance = covariance[(CIRCLE + 2, CIRCLE + 2)];
    let radius_px = circle.radius / mapping.scale_mil_per_px(on_sensor);
    // Derivative of ln radius - ln scale by all unknowns.
    let mut log_radius_px = RowSVector::<f64, UNKNOWNS>::zeros();
    log_radius_px
        .fixed_columns_mut::<PARAMETERS>(0)
        .copy_from(&-view.similarity_slopes(centre).log_scale);
    log_radius_px[CIRCLE + 2] = 1.0 / circle.radius;
    Disc {
        on_plate: Estimate {
            position: centre,
            covariance: covariance.fixed_view::<2, 2>(CIRCLE, CIRCLE).into_owned(),
        },
        on_sensor: Estimate {
            position: on_sensor,
            covariance: to_sensor * covariance * to_sensor.transpose(),
        },
        radius_mil: Measured::new(circle.radius, radius_variance.max(0.0).sqrt()),
        radius_px: Measured::new(
            radius_px,
            radius_px * propagated_sigma(&log_radius_px, covariance),
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Ellipse, SimilarityParameters};
    use crate::plate::{MarkId, heroes};
    use nalgebra::Matrix3;

    fn pairs(mapping: &Mapping, noise_px: f64) -> Vec<Pair> {
        let mut n = 0_i32;
        let mut noise = || {
            n += 1;
            noise_px * f64::from(n * 7919 % 101 - 50) / 29.0
        };
        (-1..=1)
            .flat_map(|i| (-1..=1).map(move |j| MarkId { i, j }))
            .map(|id| {
                let printed = heroes::position(id);
                let seen = mapping.to_sensor(printed);
                Pair {
                    observed: SensorPx::new(seen.x + noise(), seen.y + noise()),
                    printed,
                    covariance_px2: Matrix2::identity() * 0.02_f64.powi(2),
                }
            })
            .collect()
    }

    fn similarity() -> Mapping {
        Mapping::similarity(
            SimilarityParameters {
                plate_centre: SensorPx::new(650.0, 480.0),
                scale_mil_per_px: 5.75,
                rotation_deg: 37.0,
                handedness: Handedness::Mirrored,
            },
            Distortion::NONE,
        )
        .unwrap()
    }

    fn registered(truth: &Mapping, noise_px: f64) -> Registration {
        let pairs = pairs(truth, noise_px);
        register(
            &pairs,
            None,
            Handedness::Mirrored,
            *truth.distortion(),
            &RegistrationSettings::default(),
        )
        .unwrap()
    }

    #[test]
    fn the_simplest_mapping_that_the_pairs_support_is_chosen() {
        let square = similarity();
        let stretch = Matrix3::new(1.0, 0.002, 0.0, 0.0, 1.004, 0.0, 0.0, 0.0, 1.0);
        let keystone = Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 4e-5, 0.0, 1.0);
        let with = |m: Matrix3<f64>, kind| {
            Mapping::new(kind, m * square.matrix(), Distortion::NONE).unwrap()
        };
        for (truth, kind) in [
            (square, MappingKind::Similarity),
            (with(keystone, MappingKind::Keystone), MappingKind::Keystone),
            (with(stretch, MappingKind::Affine), MappingKind::Affine),
            (
                with(keystone * stretch, MappingKind::Homography),
                MappingKind::Homography,
            ),
        ] {
            let registration = registered(&truth, 0.02);
            assert_eq!(registration.mapping.kind(), kind);
            let at = PlateMil::new(50.0, -80.0);
            let seen = truth.to_sensor(at);
            assert!(registration.mapping.to_plate(seen).distance(at) < 0.2);
        }
    }

    #[test]
    fn the_stated_covariance_grows_with_the_residuals_and_away_from_the_pairs() {
        let quiet = registered(&similarity(), 0.02);
        let noisy = registered(&similarity(), 0.2);
        let at = PlateMil::new(0.0, 0.0);
        let trace = |r: &Registration, p| r.covariance_mil2(p).trace();
        assert!(trace(&noisy, at) > 9.0 * trace(&quiet, at));
        assert!(trace(&quiet, PlateMil::new(2000.0, 0.0)) > 4.0 * trace(&quiet, at));
    }

    #[test]
    fn rotation_scale_and_centre_are_measured_as_well_as_stated() {
        for (n, noise_px) in [0.01, 0.03].into_iter().enumerate() {
            let found = registered(&similarity(), noise_px).at_plate_centre();
            for (found, truth) in found.into_iter().zip([37.0, 5.75, 650.0, 480.0]) {
                let off = (found.value - truth).abs();
                assert!(
                    off < 4.0 * found.sigma && found.sigma > 0.0,
                    "{n}: {found:?}"
                );
                assert!(found.sigma < 1e-2 * truth, "{n}: {found:?}");
            }
        }
    }

    #[test]
    fn lens_distortion_is_removed() {
        let lens = Distortion {
            centre: SensorPx::new(647.5, 482.5),
            radial: [5e-9, 0.0],
            decentring: [0.0; 2],
        };
        let truth = Mapping::new(MappingKind::Similarity, *similarity().matrix(), lens).unwrap();
        let registration = registered(&truth, 0.0);
        assert!(registration.residual_px < 1e-6);
    }

    #[test]
    fn an_outline_that_contradicts_pairs_which_agree_loses_weight() {
        let truth = similarity();
        let pairs = pairs(&truth, 0.02);
        let centre = truth.to_sensor(PlateMil::new(120.0, 60.0)).vector();
        let register_about = |stretch_px: f64| {
            let root = Matrix2::new(95.0 - stretch_px, 0.0, 0.0, 95.0);
            let ellipse = Ellipse::new(centre, root).unwrap();
            let on_it = |n: i32| {
                let (sin, cos) = (f64::from(n) * 0.0628).sin_cos();
                (
                    ellipse.from_disc(nalgebra::Vector2::new(cos, sin)).into(),
                    0.03,
                )
            };
            let points: Vec<(SensorPx, f64)> = (0..100).map(on_it).collect();
            let outline = Outline {
                ellipse,
                points: &points,
                radius_mil: Measured::new(95.0 * 5.75, 2.0),
            };
            register(
                &pairs,
                Some(&outline),
                Handedness::Mirrored,
                Distortion::NONE,
                &RegistrationSettings::default(),
            )
            .unwrap()
        };
        let round = register_about(0.0);
        let smeared = register_about(1.5);
        for found in [&round, &smeared] {
            assert_eq!(found.mapping.kind(), MappingKind::Similarity);
            assert!(found.residual_px < 0.03, "{}", found.residual_px);
        }
        let sigma = |found: &Registration| found.disc.unwrap().on_sensor.covariance.trace().sqrt();
        assert!(sigma(&smeared) > 5.0 * sigma(&round));
        assert!((smeared.disc.unwrap().on_sensor.position.vector() - centre).norm() < 0.1);
    }

    #[test]
    fn one_pair_determines_nothing() {
        let pairs = &pairs(&similarity(), 0.0)[..1];
        assert_eq!(
            register(
                pairs,
                None,
                Handedness::Mirrored,
                Distortion::NONE,
                &RegistrationSettings::default()
            ),
            None
        );
    }
}
