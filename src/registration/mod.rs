//! Fits mappings to pairs of sensor and plate positions. It knows no marks: who made the pairs is not its business.
//!
//! # Method
//! Errors lie on the sensor, so the picture of the plate on the sensor is fitted, p = H(P), by weighted least
//! squares; lens distortion is taken off the sensor positions first.
//!
//! # Which kind of mapping
//! The simplest that the pairs support: similarity, keystone, affine, homography. A richer kind is taken when it lowers
//! chi^2 by more than [`Settings::min_gain`] times the residual variance for every parameter it adds, and leaves about
//! as many degrees of freedom as it takes to judge that by: with fewer, one bad mark bends the mapping to itself.
//!
//! A camera that looks askew shows a keystone, x = t + L P / (1 + g . P), L a similarity. Its tilt shows most in what it
//! does to angles far from the plate's centre, and from there follows what a few marks do not show: how far the centre
//! of the disc's ellipse lies from the picture of the disc's centre, 0.1 px at 3 deg.
//!
//! # Uncertainty
//! The covariance of the parameters comes from the pairs' sigmas, scaled up by the residuals where these are larger
//! than the sigmas allow. With few degrees of freedom the residuals say little; they are weighed against the
//! stated sigmas as if those rested on [`Settings::prior_freedom`] degrees of freedom.

mod model;

use crate::geometry::{Distortion, Handedness, Mapping, MappingKind};
use crate::units::{PlateMil, SensorPx};
use model::{Model, Normalisation};
use nalgebra::{DMatrix, DVector, Matrix2};

/// The same point, seen and printed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pair {
    pub seen: SensorPx,
    pub printed: PlateMil,
    /// 1 sigma per axis of the seen position.
    pub sigma_px: f64,
}

/// What can be tuned in choosing a mapping.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Least gain in chi^2 over residual variance, per added parameter.
    pub min_gain: f64,
    /// Weight of the stated sigmas against the residuals, in degrees of freedom.
    pub prior_freedom: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            min_gain: 9.0,
            prior_freedom: 2.0,
        }
    }
}

/// A fitted mapping with its uncertainty.
#[derive(Debug, Clone, PartialEq)]
pub struct Registration {
    pub mapping: Mapping,
    /// Root mean square distance between seen and predicted positions, per axis.
    pub residual_px: f64,
    /// Degrees of freedom left.
    pub freedom: usize,
    chi2: f64,
    model: Model,
    /// Covariance of the model's parameters.
    covariance: DMatrix<f64>,
}

impl Registration {
    /// Covariance, from the mapping alone, of a plate position got through it; mil^2.
    pub fn covariance_mil2(&self, at: PlateMil) -> Matrix2<f64> {
        let slopes = self.model.parameter_slopes(at);
        let on_sensor = &slopes * &self.covariance * slopes.transpose();
        let on_sensor = Matrix2::new(
            on_sensor[(0, 0)],
            on_sensor[(0, 1)],
            on_sensor[(1, 0)],
            on_sensor[(1, 1)],
        );
        let to_plate = self.mapping.plate_jacobian(self.mapping.to_sensor(at));
        to_plate * on_sensor * to_plate.transpose()
    }

    fn variance(&self) -> f64 {
        self.chi2 / self.freedom.max(1) as f64
    }
}

/// How many fewer degrees of freedom than parameters a mapping richer than a similarity may leave.
const LESS_FREEDOM: usize = 2;

/// Fits the simplest mapping that the pairs support. `None` when they do not determine one.
pub fn register(
    pairs: &[Pair],
    handedness: Handedness,
    distortion: Distortion,
    settings: &Settings,
) -> Option<Registration> {
    let mut best = fit(
        pairs,
        MappingKind::Similarity,
        handedness,
        distortion,
        settings,
    )?;
    for kind in [
        MappingKind::Keystone,
        MappingKind::Affine,
        MappingKind::Homography,
    ] {
        if 2 * pairs.len() + LESS_FREEDOM < 2 * kind.parameters() {
            break;
        }
        let Some(richer) = fit(pairs, kind, handedness, distortion, settings) else {
            continue;
        };
        let added = kind.parameters() - best.mapping.kind().parameters();
        let gain = (best.chi2 - richer.chi2) / added.max(1) as f64;
        if gain > settings.min_gain * richer.variance().max(1.0) {
            best = richer;
        }
    }
    Some(best)
}

/// Fits a mapping of one kind. `None` when the pairs do not determine it.
pub fn fit(
    pairs: &[Pair],
    kind: MappingKind,
    handedness: Handedness,
    distortion: Distortion,
    settings: &Settings,
) -> Option<Registration> {
    let freedom = (2 * pairs.len()).checked_sub(kind.parameters())?;
    let normalisation = Normalisation::of(pairs.iter().map(|pair| pair.printed))?;
    let seen: Vec<SensorPx> = pairs.iter().map(|p| distortion.correct(p.seen)).collect();
    let start = |kind| fit(pairs, kind, handedness, distortion, settings).map(|fit| fit.model);
    // A divisor has no slope at zero, so the kinds that have one start from those that have none.
    let mut model = match kind {
        MappingKind::Keystone => start(MappingKind::Similarity)?.as_keystone(),
        MappingKind::Homography => start(MappingKind::Affine)?.as_homography(),
        _ => Model::zero(kind, handedness, normalisation),
    };
    let mut information = DMatrix::zeros(kind.parameters(), kind.parameters());
    // The first step solves the linear kinds; a divisor needs a few more.
    let steps = match kind {
        MappingKind::Similarity | MappingKind::Affine => 1,
        MappingKind::Keystone | MappingKind::Homography => 8,
    };
    for _ in 0..steps {
        information.fill(0.0);
        let mut gradient = DVector::zeros(kind.parameters());
        for (pair, seen) in pairs.iter().zip(&seen) {
            let slopes = model.parameter_slopes(pair.printed);
            let miss = seen.vector() - model.picture(pair.printed);
            let weight = pair.sigma_px.powi(-2);
            information += slopes.transpose() * &slopes * weight;
            gradient += slopes.transpose() * miss * weight;
        }
        model.advance(&(information.clone().cholesky()?.solve(&gradient)));
    }
    let mut chi2 = 0.0;
    let mut squares = 0.0;
    for (pair, seen) in pairs.iter().zip(&seen) {
        let miss = (seen.vector() - model.picture(pair.printed)).norm_squared();
        chi2 += miss / pair.sigma_px.powi(2);
        squares += miss;
    }
    let prior = settings.prior_freedom;
    let excess = ((prior + chi2) / (prior + freedom as f64)).max(1.0);
    Some(Registration {
        mapping: Mapping::new(kind, model.homography().try_inverse()?, distortion)?,
        residual_px: (squares / (2 * pairs.len()) as f64).sqrt(),
        freedom,
        chi2,
        covariance: information.cholesky()?.inverse() * excess,
        model,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::SimilarityParameters;
    use crate::plate::{MarkId, drawn_position};
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
                let printed = drawn_position(id);
                let seen = mapping.to_sensor(printed);
                Pair {
                    seen: SensorPx::new(seen.x + noise(), seen.y + noise()),
                    printed,
                    sigma_px: 0.02,
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
            Handedness::Mirrored,
            *truth.distortion(),
            &Settings::default(),
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
    fn lens_distortion_is_taken_off() {
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
    fn one_pair_determines_nothing() {
        let pairs = &pairs(&similarity(), 0.0)[..1];
        assert_eq!(
            register(
                pairs,
                Handedness::Mirrored,
                Distortion::NONE,
                &Settings::default()
            ),
            None
        );
    }
}
