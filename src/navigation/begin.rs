//! Initial alignment: the filter waits for a fix and two directions observed at about the same time; one of them may be
//! straight down as measured by the accelerometers.

use super::doubts::CorrelatedError;
use super::estimate::Estimate;
use super::filter::{Filter, MOST_DRIFT_M_S, Trust, towards};
use super::measurement::{DirectionObservation, Fix, Towards};
use super::model::Model;
use super::motion::{Interval, Motion};
use super::settings::{Imu, NavigationSettings};
use super::states::Layout;
use crate::geometry::attitude::{Direction, Observation, attitude};
use crate::geometry::earth;
use nalgebra::{UnitQuaternion, UnitVector3, Vector3};
use std::sync::Arc;

/// Maximum age of directions for the alignment, s.
const FRESH_S: f64 = 1.5;
/// Minimum sine of the angle between the two directions.
const LEAST_SINE: f64 = 0.05;
/// Minimum white share of a direction's error: no error is fully correlated.
const LEAST_WHITE: f64 = 0.01;

/// The accelerometers' mean over this time, s, is used as straight down if it equals gravity to within this share.
const PLUMB_S: f64 = 2.0;
const PLUMB_SHARE: f64 = 0.05;

/// The last direction of each target in each camera, in the body's axes, propagated with the body's rotation.
#[derive(Debug, Clone, Default)]
pub(super) struct Waiting {
    directions: Vec<PastDirection>,
    felt: Felt,
    /// The body's last angular rate.
    rate_rad_s: Vector3<f64>,
}

/// Mean specific force of the last seconds, in the body's axes, propagated with the body's rotation.
#[derive(Debug, Clone, Copy, Default)]
struct Felt {
    sum_m_s: Vector3<f64>,
    time_s: f64,
}

impl Felt {
    fn advance(&mut self, turn: &UnitQuaternion<f64>, said: &Interval) {
        let kept = 1.0 - (said.length_s() / PLUMB_S).min(1.0) * f64::from(self.is_whole());
        self.sum_m_s = turn * self.sum_m_s * kept + said.force_m_s2 * said.length_s();
        self.time_s = self.time_s * kept + said.length_s();
    }

    fn is_whole(&self) -> bool {
        self.time_s >= PLUMB_S
    }

    /// Straight down, if the measured force is gravity.
    fn down(&self, gravity_m_s2: f64) -> Option<UnitVector3<f64>> {
        let force = self.sum_m_s / self.time_s;
        let is_gravity = (force.norm() / gravity_m_s2 - 1.0).abs() < PLUMB_SHARE;
        (self.is_whole() && is_gravity).then(|| UnitVector3::new_normalize(-force))
    }
}

#[derive(Debug, Clone)]
struct PastDirection {
    observation: DirectionObservation,
    /// Direction in the body's axes at the current time.
    body: UnitVector3<f64>,
    age_s: f64,
}

impl PastDirection {
    /// Error accumulated since the observation, from the gyro and from the motion of the target.
    fn added_rad(&self, settings: &NavigationSettings, fix: &Fix) -> f64 {
        let walk = settings.imu.angular_random_walk * self.age_s.sqrt();
        let moves = match self.observation.towards {
            Towards::Known(_) => earth::TURN_RAD_PER_S,
            Towards::Down => {
                let speed_m_s = fix.velocity_m_s.map_or(MOST_DRIFT_M_S, |v| v.norm());
                speed_m_s / fix.position_m.norm()
            }
        };
        walk.hypot(settings.imu.gyro_bias_sigma_rad_s.hypot(moves) * self.age_s)
    }
}

impl Waiting {
    pub fn advance(&mut self, said: &Interval, imu: &Imu) {
        let said = &Interval {
            force_m_s2: said.force_m_s2 - imu.accelerometer_bias_m_s2,
            rate_rad_s: said.rate_rad_s - imu.gyro_bias_rad_s,
            ..*said
        };
        self.rate_rad_s = said.rate_rad_s;
        let turn = UnitQuaternion::new(-said.rate_rad_s * said.length_s());
        for direction in &mut self.directions {
            direction.body = turn * direction.body;
            direction.age_s += said.length_s();
        }
        self.felt.advance(&turn, said);
        self.directions
            .retain(|direction| direction.age_s <= FRESH_S);
    }

    pub fn note(&mut self, settings: &NavigationSettings, observation: &DirectionObservation) {
        let same = |direction: &PastDirection| {
            (direction.observation.camera, direction.observation.target)
                == (observation.camera, observation.target)
        };
        self.directions.retain(|direction| !same(direction));
        let camera = &settings.cameras[observation.camera];
        self.directions.push(PastDirection {
            observation: *observation,
            body: camera.body_from_camera * observation.unit,
            age_s: 0.0,
        });
    }

    /// A filter that starts at a fix; `None` until two directions of different targets, or one direction and straight down,
    /// are available.
    pub fn begin(&self, model: &Arc<Model>, fix: &Fix) -> Option<Filter> {
        let Model { settings, layout } = &**model;
        let observation = |direction: &PastDirection| {
            let camera = &settings.cameras[direction.observation.camera];
            let own = direction
                .observation
                .sigma_rad
                .hypot(camera.misalignment_rad);
            let sigma_rad = own.hypot(direction.added_rad(settings, fix));
            let towards = towards(
                &direction.observation.towards,
                &fix.position_m,
                settings.vertical,
            );
            Observation {
                body: Direction::new(direction.body, sigma_rad.max(f64::EPSILON)),
                reference: Direction::new(towards, 0.0),
            }
        };
        let begun_by = self.pair(settings, fix)?;
        let (first, second) = match &begun_by {
            Pair::Measured(first, second) => (observation(first), observation(second)),
            Pair::WithPlumb(direction, plumb) => (observation(direction), *plumb),
        };
        let found = attitude(&[first, second])?.inverse();
        let motion = Motion {
            position_m: fix.position_m - found.rotation * settings.gps.antenna_m,
            velocity_m_s: fix.velocity_m_s.unwrap_or_default(),
            attitude: found.rotation,
        };
        let estimate = Estimate::new(motion, model);
        let mut filter = Filter::new(Arc::clone(model), estimate, fix);
        filter.rate_rad_s = self.rate_rad_s;
        for direction in begun_by.directions() {
            let camera = &settings.cameras[direction.observation.camera];
            let now = DirectionObservation {
                t_s: fix.t_s,
                unit: camera.body_from_camera.inverse() * direction.body,
                ..direction.observation
            };
            let white = white_rad(settings, layout, &direction.observation);
            filter.take_direction(
                &now,
                white.hypot(direction.added_rad(settings, fix)),
                Trust::Blind,
            )?;
        }
        if let Pair::WithPlumb(_, plumb) = &begun_by {
            filter.take_plumb(fix.t_s, &plumb.body.unit, settings.plumb_rad)?;
        }
        Some(filter)
    }

    /// The two directions that determine the attitude best: two observed ones, or else one and straight down from the
    /// accelerometers.
    fn pair(&self, settings: &NavigationSettings, fix: &Fix) -> Option<Pair<'_>> {
        if let Some((first, second)) = self.measured_pair() {
            return Some(Pair::Measured(first, second));
        }
        let gravity = earth::acceleration(&fix.position_m, &Vector3::zeros());
        let down = self.felt.down(gravity.norm());
        let down = down.filter(|_| settings.plumb_rad > 0.0)?;
        let plumb = Observation {
            body: Direction::new(down, settings.plumb_rad),
            reference: Direction::new(earth::plumb(&fix.position_m), 0.0),
        };
        let sine = |direction: &&PastDirection| direction.body.cross(&down).norm();
        let directions = self
            .directions
            .iter()
            .filter(|direction| sine(direction) > LEAST_SINE);
        let best = directions.max_by(|a, b| sine(a).total_cmp(&sine(b)))?;
        Some(Pair::WithPlumb(best, plumb))
    }

    fn measured_pair(&self) -> Option<(&PastDirection, &PastDirection)> {
        let pairs = self.directions.iter().enumerate().flat_map(|(n, first)| {
            let rest = self.directions[n + 1..].iter();
            rest.map(move |second| (first, second))
        });
        let sine = |(a, b): &(&PastDirection, &PastDirection)| a.body.cross(&b.body).norm();
        pairs
            .filter(|(a, b)| a.observation.target != b.observation.target)
            .filter(|pair| sine(pair) > LEAST_SINE)
            .max_by(|a, b| sine(a).total_cmp(&sine(b)))
    }
}

/// The pair of directions of an alignment.
enum Pair<'a> {
    Measured(&'a PastDirection, &'a PastDirection),
    WithPlumb(&'a PastDirection, Observation),
}

impl<'a> Pair<'a> {
    fn directions(&self) -> impl Iterator<Item = &'a PastDirection> + use<'a> {
        let (first, second) = match *self {
            Self::Measured(first, second) => (first, Some(second)),
            Self::WithPlumb(direction, _) => (direction, None),
        };
        std::iter::once(first).chain(second)
    }
}

/// The part of a direction's error that is white, 1 sigma of each angle.
pub(super) fn white_rad(
    settings: &NavigationSettings,
    layout: &Layout,
    observation: &DirectionObservation,
) -> f64 {
    let target = observation.target as usize;
    let correlated_rad = match layout.correlated[observation.camera][target] {
        Some(_) => settings.correlated_rad[target],
        None => 0.0,
    };
    let white2 = observation.sigma_rad.powi(2) - correlated_rad.powi(2);
    white2.sqrt().max(LEAST_WHITE * observation.sigma_rad)
}

/// The part of a direction's error that is correlated in time, if the filter models it.
pub(super) fn correlated_error(
    settings: &NavigationSettings,
    layout: &Layout,
    observation: &DirectionObservation,
) -> Option<CorrelatedError> {
    let target = observation.target as usize;
    let modelled = layout.correlated[observation.camera][target].as_ref()?;
    let white_rad = white_rad(settings, layout, observation);
    Some(CorrelatedError {
        variance_rad2: observation.sigma_rad.powi(2) - white_rad.powi(2),
        time_s: modelled.time_s,
    })
}
