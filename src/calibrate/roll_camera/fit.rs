//! The turn from the camera's axes to the body's by least squares.

use super::sighting::{Known, Sighting};
use crate::calibrate::mounting::correlation_of;
use crate::estimation::{FitError, LeastSquares, Linearised, Loss, Prior, Scale, TUKEY_SIGMAS};
use crate::geometry::attitude::Direction;
use nalgebra::{Matrix3, Rotation3, RowVector3, Vector1, Vector3};

/// An axis whose turn the frames tell less well, beside what all of them share, is not determined, 1 sigma.
pub const LIMIT_DEG: f64 = 0.1;
/// Fewer sightings tell no outliers.
const LEAST_SIGHTINGS: usize = 20;
/// The turn settles well before.
const ROUNDS: usize = 6;
/// What a sighting's robust weight must be to count as taken.
const LEAST_WEIGHT: f64 = 0.1;

/// The turn that was found.
#[derive(Debug, Clone, PartialEq)]
pub struct Turn {
    pub body_from_camera: Rotation3<f64>,
    /// Of a small turn about the body's axes.
    pub covariance_rad2: Matrix3<f64>,
    /// Rms of what is left of the sightings that were taken, per angle.
    pub scatter_deg: f64,
    /// Sightings that took part, and all.
    pub taken: usize,
    pub sightings: usize,
    /// How many times more the residuals' mean varies than if each were on its own.
    pub correlation: f64,
}

/// Why there is no turn.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TurnError {
    #[error(
        "too few sightings: expected at least {LEAST_SIGHTINGS} frames of the horizon at moments of which {wanted}, found {found}"
    )]
    TooFew { found: usize, wanted: &'static str },
    #[error(
        "the turn about the body's {axis} axis is not determined: expected a sigma of {LIMIT_DEG} deg at most, found {found_deg:.2} deg; {instead}"
    )]
    NotDetermined {
        axis: &'static str,
        found_deg: f64,
        instead: &'static str,
    },
    #[error("no turn fits the frames: {0}; check times, place and camera")]
    NoFit(#[from] FitError),
}

impl Turn {
    /// 1 sigma about the body's forward, right and down axes.
    pub fn sigmas_deg(&self) -> [f64; 3] {
        sigmas_deg(&self.covariance_rad2)
    }
}

/// Fits the turn from where it is thought to be.
///
/// # Errors
/// Sightings that do not determine the turn; see [`TurnError`].
pub fn fit(sightings: &[Sighting], start: &Rotation3<f64>) -> Result<Turn, TurnError> {
    let by_sun = matches!(sightings.first().map(|s| s.known), Some(Known::Sun { .. }));
    if sightings.len() < LEAST_SIGHTINGS {
        let wanted = match by_sun {
            true => "the Sun was seen, too",
            false => "the attitude or the Sun is known",
        };
        let found = sightings.len();
        return Err(TurnError::TooFew { found, wanted });
    }
    let mut turn = *start;
    let mut fitted = None;
    for _ in 0..ROUNDS {
        let fit = LeastSquares {
            start: Vector3::zeros(),
            prior: Prior::none(),
            loss: Loss::Tukey(TUKEY_SIGMAS),
            scale: Scale::Median,
            tolerance_sigmas: 1e-3,
        };
        let found = fit.fit(|by: &Vector3<f64>| Some(rows(sightings, &moved(by, &turn))))?;
        turn = moved(&found.parameters, &turn);
        fitted = Some(found);
    }
    let fitted = fitted.ok_or(FitError::NotConverged)?;
    let left = rows(sightings, &turn);
    let taken: Vec<&Linearised<1, 3>> = left
        .iter()
        .zip(&fitted.weights)
        .filter(|(_, weight)| **weight > LEAST_WEIGHT)
        .map(|(row, _)| row)
        .collect();
    let residuals: Vec<f64> = taken.iter().map(|row| row.residual[0]).collect();
    let correlation = correlation_of(&residuals);
    let own_rad2 = fitted.covariance * correlation;
    check_determined(&own_rad2, by_sun)?;
    Ok(Turn {
        body_from_camera: turn,
        covariance_rad2: own_rad2 + shared(sightings, &turn),
        scatter_deg: scatter_deg(sightings, &turn, &fitted.weights),
        taken: taken.len() * sightings.len() / left.len(),
        sightings: sightings.len(),
        correlation,
    })
}

/// A turn, turned on by a small one about the body's axes.
fn moved(by: &Vector3<f64>, turn: &Rotation3<f64>) -> Rotation3<f64> {
    Rotation3::new(*by) * turn
}

/// Every angle that is known, near a turn.
fn rows(sightings: &[Sighting], turn: &Rotation3<f64>) -> Vec<Linearised<1, 3>> {
    angles(sightings, turn)
        .map(|angle| Linearised {
            residual: Vector1::new(angle.left / angle.sigma_rad),
            jacobian: angle.by_turn / angle.sigma_rad,
        })
        .collect()
}

/// One angle that is known, and what a turn makes of it.
struct Angle {
    /// Known less found, rad.
    left: f64,
    sigma_rad: f64,
    by_turn: RowVector3<f64>,
}

fn angles<'a>(
    sightings: &'a [Sighting],
    turn: &'a Rotation3<f64>,
) -> impl Iterator<Item = Angle> + 'a {
    sightings.iter().flat_map(|sighting| {
        let found = sighting.horizon.nadir.turned(turn);
        let along = |axis: Vector3<f64>, known: f64| Angle {
            left: known - axis.dot(&found.unit),
            sigma_rad: axis.dot(&(found.covariance_rad2 * axis)).max(0.0).sqrt(),
            by_turn: found.unit.cross(&axis).transpose(),
        };
        match &sighting.known {
            Known::Nadir(known) => {
                let right = known.cross(&Vector3::x()).normalize();
                let forward = right.cross(known);
                vec![along(right, 0.0), along(forward, 0.0)]
            }
            Known::Sun {
                unit,
                elevation_deg,
            } => {
                vec![along(unit.into_inner(), -elevation_deg.to_radians().sin())]
            }
        }
    })
}

fn scatter_deg(sightings: &[Sighting], turn: &Rotation3<f64>, weights: &[f64]) -> f64 {
    let angles = angles(sightings, turn).zip(weights);
    let taken = angles.filter(|(_, weight)| **weight > LEAST_WEIGHT);
    let (sum, count) = taken.fold((0.0, 0.0), |(sum, count), (angle, _)| {
        (sum + angle.left.powi(2), count + 1.0)
    });
    (sum / count).sqrt().to_degrees()
}

/// What all frames have alike of their error turns the camera with it: the median frame's.
fn shared(sightings: &[Sighting], turn: &Rotation3<f64>) -> Matrix3<f64> {
    let mut nadirs: Vec<&Direction> = sightings.iter().map(|s| &s.horizon.nadir).collect();
    nadirs.sort_by(|a, b| {
        a.covariance_rad2
            .trace()
            .total_cmp(&b.covariance_rad2.trace())
    });
    let nadir = nadirs[nadirs.len() / 2].turned(turn);
    let cross = nadir.unit.cross_matrix();
    cross * nadir.covariance_rad2 * cross.transpose()
}

fn sigmas_deg(covariance_rad2: &Matrix3<f64>) -> [f64; 3] {
    let variances = covariance_rad2.diagonal();
    variances.map(|v| v.max(0.0).sqrt().to_degrees()).into()
}

fn check_determined(covariance_rad2: &Matrix3<f64>, by_sun: bool) -> Result<(), TurnError> {
    let instead = match by_sun {
        true => {
            "let the telescope sweep over the Sun, half a degree to each side, while the gondola rolls"
        }
        false => "tilt the body by some degrees in roll and in pitch",
    };
    let sigmas_deg = sigmas_deg(covariance_rad2);
    let axes = ["forward", "right", "down"].into_iter().zip(sigmas_deg);
    let worst = axes.max_by(|a, b| a.1.total_cmp(&b.1));
    match worst {
        Some((axis, found_deg)) if found_deg > LIMIT_DEG => Err(TurnError::NotDetermined {
            axis,
            found_deg,
            instead,
        }),
        _ => Ok(()),
    }
}
