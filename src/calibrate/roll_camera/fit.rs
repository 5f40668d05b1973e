//! Least-squares fit of the rotation from the camera's axes to the body's.

use super::observation::{HorizonObservation, Known};
use crate::calibrate::mounting::correlation_of;
use crate::estimation::{
    FitError, Fitted, LeastSquares, Linearised, Loss, Prior, Scale, TUKEY_SIGMAS,
};
use crate::geometry::attitude::Direction;
use nalgebra::{Matrix3, Rotation3, RowVector3, Vector1, Vector3};

/// An axis whose rotation has a larger sigma, without the error shared by all frames, is not determined, 1 sigma.
pub const LIMIT_DEG: f64 = 0.1;
/// Fewer observations do not show outliers.
const LEAST_OBSERVATIONS: usize = 20;
/// Number of iterations; the fit converges well before.
const ROUNDS: usize = 6;
/// Least robust weight of an observation that counts as accepted.
const LEAST_WEIGHT: f64 = 0.1;

/// The fitted rotation.
#[derive(Debug, Clone, PartialEq)]
pub struct Turn {
    pub body_from_camera: Rotation3<f64>,
    /// Covariance of a small rotation about the body's axes.
    pub covariance_rad2: Matrix3<f64>,
    /// Rms residual of the accepted observations, per angle.
    pub scatter_deg: f64,
    /// Accepted observations, and all.
    pub taken: usize,
    pub observations: usize,
    /// Factor by which correlation increases the variance of the residuals' mean.
    pub correlation: f64,
}

/// Reasons for which there is no rotation.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TurnError {
    #[error(
        "too few observations: expected at least {LEAST_OBSERVATIONS} frames of the horizon at moments of which {wanted}, found {found}"
    )]
    TooFew { found: usize, wanted: &'static str },
    #[error(
        "the turn about the body's {axis} axis is not determined: expected a sigma of {LIMIT_DEG} deg at most, found {found_deg:.2} deg; {advice}"
    )]
    NotDetermined {
        axis: &'static str,
        found_deg: f64,
        advice: &'static str,
    },
    #[error(
        "the turn is not determined: expected frames that determine it about every axis, found an axis that they do not determine; {advice}"
    )]
    Undetermined { advice: &'static str },
    #[error("no turn fits the frames: {0}; check times, place and camera")]
    NoFit(FitError),
}

impl TurnError {
    fn of(error: FitError, by_sun: bool) -> Self {
        match error {
            FitError::Undetermined => Self::Undetermined {
                advice: advice(by_sun),
            },
            FitError::NotConverged => Self::NoFit(error),
        }
    }
}

impl Turn {
    /// 1 sigma about the body's forward, right and down axes.
    pub fn sigmas_deg(&self) -> [f64; 3] {
        sigmas_deg(&self.covariance_rad2)
    }
}

/// Fits the rotation from an approximate one.
///
/// # Errors
/// If the observations do not determine the rotation; see [`TurnError`].
pub fn fit(observations: &[HorizonObservation], start: &Rotation3<f64>) -> Result<Turn, TurnError> {
    let by_sun = matches!(
        observations.first().map(|s| s.known),
        Some(Known::Sun { .. })
    );
    if observations.len() < LEAST_OBSERVATIONS {
        let wanted = match by_sun {
            true => "the Sun was seen, too",
            false => "the attitude or the Sun is known",
        };
        let found = observations.len();
        return Err(TurnError::TooFew { found, wanted });
    }
    let (turn, fitted) =
        converged(observations, start).map_err(|error| TurnError::of(error, by_sun))?;
    let correlation = correlation(observations, &turn, &fitted.weights);
    let own_rad2 = fitted.covariance * correlation;
    check_determined(&own_rad2, by_sun)?;
    let is_taken = |weight: &&f64| **weight > LEAST_WEIGHT;
    let taken = fitted.weights.iter().filter(is_taken).count();
    Ok(Turn {
        body_from_camera: turn,
        covariance_rad2: own_rad2 + shared(observations, &turn),
        scatter_deg: scatter_deg(observations, &turn, &fitted.weights),
        taken: taken * observations.len() / fitted.weights.len(),
        observations: observations.len(),
        correlation,
    })
}

/// The converged rotation, and the last step's fit.
fn converged(
    observations: &[HorizonObservation],
    start: &Rotation3<f64>,
) -> Result<(Rotation3<f64>, Fitted<3>), FitError> {
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
        let found = fit.fit(|by: &Vector3<f64>| Some(rows(observations, &rotated(by, &turn))))?;
        turn = rotated(&found.parameters, &turn);
        fitted = Some(found);
    }
    Ok((turn, fitted.ok_or(FitError::NotConverged)?))
}

/// Factor by which correlation increases the variance of the residuals' mean. A persistent error stays in its own axis, so that each axis
/// is evaluated alone; the larger of them.
fn correlation(observations: &[HorizonObservation], turn: &Rotation3<f64>, weights: &[f64]) -> f64 {
    let angles: Vec<(Angle, &f64)> = angles(observations, turn).zip(weights).collect();
    let along = |axis: Axis| {
        let taken = angles
            .iter()
            .filter(|(angle, weight)| angle.axis == axis && **weight > LEAST_WEIGHT);
        let residuals: Vec<f64> = taken
            .map(|(angle, _)| angle.residual / angle.sigma_rad)
            .collect();
        correlation_of(&residuals)
    };
    let axes = [Axis::Right, Axis::Forward, Axis::Sun];
    axes.map(along).into_iter().fold(1.0, f64::max)
}

/// A rotation followed by a small one about the body's axes.
fn rotated(by: &Vector3<f64>, turn: &Rotation3<f64>) -> Rotation3<f64> {
    Rotation3::new(*by) * turn
}

/// Every known angle, linearised at a rotation.
fn rows(observations: &[HorizonObservation], turn: &Rotation3<f64>) -> Vec<Linearised<1, 3>> {
    angles(observations, turn)
        .map(|angle| Linearised {
            residual: Vector1::new(angle.residual / angle.sigma_rad),
            jacobian: angle.by_turn / angle.sigma_rad,
        })
        .collect()
}

/// The axis along which an angle is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Axis {
    Right,
    Forward,
    Sun,
}

/// One known angle, and its derivative by the rotation.
struct Angle {
    axis: Axis,
    /// Known minus found, rad.
    residual: f64,
    sigma_rad: f64,
    by_turn: RowVector3<f64>,
}

fn angles<'a>(
    observations: &'a [HorizonObservation],
    turn: &'a Rotation3<f64>,
) -> impl Iterator<Item = Angle> + 'a {
    observations.iter().flat_map(|observation| {
        let found = observation.horizon.nadir.turned(turn);
        let along = |axis: Axis, unit: Vector3<f64>, known: f64| Angle {
            axis,
            residual: known - unit.dot(&found.unit),
            sigma_rad: unit.dot(&(found.covariance_rad2 * unit)).max(0.0).sqrt(),
            by_turn: found.unit.cross(&unit).transpose(),
        };
        match &observation.known {
            Known::Nadir(known) => {
                let right = known.cross(&Vector3::x()).normalize();
                let forward = right.cross(known);
                vec![
                    along(Axis::Right, right, 0.0),
                    along(Axis::Forward, forward, 0.0),
                ]
            }
            Known::Sun {
                unit,
                elevation_deg,
            } => {
                let known = -elevation_deg.to_radians().sin();
                vec![along(Axis::Sun, unit.into_inner(), known)]
            }
        }
    })
}

fn scatter_deg(observations: &[HorizonObservation], turn: &Rotation3<f64>, weights: &[f64]) -> f64 {
    let angles = angles(observations, turn).zip(weights);
    let taken = angles.filter(|(_, weight)| **weight > LEAST_WEIGHT);
    let (sum, count) = taken.fold((0.0, 0.0), |(sum, count), (angle, _)| {
        (sum + angle.residual.powi(2), count + 1.0)
    });
    (sum / count).sqrt().to_degrees()
}

/// The covariance of the rotation from the error shared by all frames: the median frame's.
fn shared(observations: &[HorizonObservation], turn: &Rotation3<f64>) -> Matrix3<f64> {
    let mut nadirs: Vec<&Direction> = observations.iter().map(|s| &s.horizon.nadir).collect();
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

/// Advice on a rotation that the frames do not determine.
fn advice(by_sun: bool) -> &'static str {
    match by_sun {
        true => {
            "let the telescope sweep over the Sun, half a degree to each side, while the gondola rolls"
        }
        false => "tilt the body by some degrees in roll and in pitch",
    }
}

fn check_determined(covariance_rad2: &Matrix3<f64>, by_sun: bool) -> Result<(), TurnError> {
    let sigmas_deg = sigmas_deg(covariance_rad2);
    let axes = ["forward", "right", "down"].into_iter().zip(sigmas_deg);
    let worst = axes.max_by(|a, b| a.1.total_cmp(&b.1));
    match worst {
        Some((axis, found_deg)) if found_deg > LIMIT_DEG => Err(TurnError::NotDetermined {
            axis,
            found_deg,
            advice: advice(by_sun),
        }),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::super::observation::Horizon;
    use super::*;
    use crate::pointing::body_nadir;
    use crate::units::Measured;
    use jiff::{SignedDuration, Timestamp};
    use nalgebra::UnitVector3;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};
    use rand_xoshiro::Xoshiro256PlusPlus;

    const OWN_RAD: f64 = 1e-4;

    /// Five minutes of a body that tilts slowly, seen by a camera aligned with it; each error keeps a part of the previous one.
    fn observations(seed: u64, kept: f64) -> Vec<HorizonObservation> {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
        let mut error = Vector3::zeros();
        let observation = |n: u32| {
            let time_s = f64::from(n) * 0.25;
            let roll_deg = 5.0 * (time_s / 9.0).sin();
            let pitch_deg = 3.0 * (time_s / 7.0).sin();
            let down = body_nadir(Measured::new(roll_deg, 0.0), Measured::new(pitch_deg, 0.0));
            let parts: [f64; 3] = std::array::from_fn(|_| StandardNormal.sample(&mut random));
            let fresh_rad = OWN_RAD * (1.0 - kept.powi(2)).sqrt();
            error = error * kept + Vector3::from(parts) * fresh_rad;
            let seen = UnitVector3::new_normalize(down.unit.into_inner() + error);
            HorizonObservation {
                horizon: Horizon {
                    file: format!("{n}").into(),
                    utc: Timestamp::UNIX_EPOCH + SignedDuration::from_secs_f64(time_s),
                    nadir: Direction::new(seen, OWN_RAD),
                },
                known: Known::Nadir(down.unit),
            }
        };
        (0..1200).map(observation).collect()
    }

    /// Error of the heading over its sigma, rms of some flights, and the mean correlation. The frames' sigma counts as common to all of
    /// them, but does not affect the heading of a level body.
    fn heading_and_correlation(kept: f64) -> (f64, f64) {
        const FLIGHTS: u64 = 24;
        let (mut squares, mut correlation) = (0.0, 0.0);
        for seed in 0..FLIGHTS {
            let turn = fit(&observations(seed, kept), &Rotation3::identity()).unwrap();
            let error_deg = turn.body_from_camera.scaled_axis().z.to_degrees();
            squares += (error_deg / turn.sigmas_deg()[2]).powi(2);
            correlation += turn.correlation;
        }
        let flights = FLIGHTS as f64;
        ((squares / flights).sqrt(), correlation / flights)
    }

    #[test]
    fn errors_that_last_over_frames_make_the_sigma_larger() {
        let (ratio, correlation) = heading_and_correlation(0.0);
        assert!((0.7..1.4).contains(&ratio), "{ratio}");
        assert!(correlation < 1.3, "{correlation}");
        let (ratio, correlation) = heading_and_correlation(0.9);
        assert!((0.6..1.6).contains(&ratio), "{ratio}");
        assert!(correlation > 8.0, "{correlation}");
    }

    #[test]
    fn a_body_that_never_tilts_is_asked_to_tilt() {
        let mut still = observations(1, 0.0);
        for observation in &mut still {
            observation.known = Known::Nadir(Vector3::z_axis());
            observation.horizon.nadir = Direction::new(Vector3::z_axis(), OWN_RAD);
        }
        let error = fit(&still, &Rotation3::identity()).unwrap_err().to_string();
        assert!(error.contains("not determined"), "{error}");
        assert!(error.contains("tilt the body"), "{error}");
    }
}
