//! Simulation of a flight from a plan.

use super::config::config_toml;
use super::imu::{self, Imu, true_means};
use super::motion::Motion;
use super::plan::FlightPlan;
use super::{Drawn, Flight, GpsRow, SunRow, TruthRow, cameras, normal, random};
use nalgebra::UnitQuaternion;

/// Margin of the Sun's directions beyond both ends of a flight.
const SUN_MARGIN_S: i64 = 2;

impl FlightPlan {
    /// The flight for a seed.
    pub fn fly(&self, seed: u64) -> Flight {
        let motion = self.vehicle.motion(seed);
        let mut imu = Imu::drawn(&self.imu, seed);
        let times_s = || self.span().ticks_s(imu::RATE_HZ).skip(1);
        let vectors = cameras::measured(&self.cameras, &self.span(), &self.sky(), &*motion, seed);
        Flight {
            biases: imu.biases(),
            misalignments_rad: cameras::misalignments_rad(&self.cameras, seed),
            imu: times_s()
                .map(|t_s| imu.measured(&true_means(&*motion, t_s)))
                .collect(),
            gps: self.gps_rows(&*motion, seed),
            vectors,
            truth: times_s().map(|t_s| truth(&*motion, t_s)).collect(),
            sun: self.sun_rows(),
            config_toml: config_toml(self),
        }
    }

    /// One row per second, from the start on.
    fn gps_rows(&self, motion: &dyn Motion, seed: u64) -> Vec<GpsRow> {
        let mut random = random(seed, Drawn::Gps);
        let row = |t_s| {
            let path = motion.at(t_s).path;
            GpsRow {
                t_s,
                position_m: path.position_m + normal(&mut random, self.gps.position_sigma_m),
                velocity_m_s: path.velocity_m_s + normal(&mut random, self.gps.velocity_sigma_m_s),
            }
        };
        self.span().ticks_s(1).map(row).collect()
    }

    fn sun_rows(&self) -> Vec<SunRow> {
        let sun = self.vehicle.sun();
        let start_s = self.vehicle.start_s() as i64;
        let end_s = start_s + self.duration_s.ceil() as i64;
        let row = |second| {
            let t_s = second as f64;
            let direction = sun.direction(t_s);
            SunRow { t_s, direction }
        };
        let seconds = start_s - SUN_MARGIN_S..=end_s + SUN_MARGIN_S;
        seconds.map(row).collect()
    }
}

fn truth(motion: &dyn Motion, t_s: f64) -> TruthRow {
    let state = motion.at(t_s);
    TruthRow {
        t_s,
        ecef_from_body: with_positive_first(state.attitude.rotation),
        position_m: state.path.position_m,
        velocity_m_s: state.path.velocity_m_s,
    }
}

/// The same attitude with a positive first component: a quaternion and its negative are equivalent.
fn with_positive_first(attitude: UnitQuaternion<f64>) -> UnitQuaternion<f64> {
    match attitude.w < 0.0 {
        true => UnitQuaternion::new_unchecked(-attitude.into_inner()),
        false => attitude,
    }
}
