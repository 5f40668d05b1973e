//! Plans of simulated flights: vehicle, duration and errors.

use super::balloon::{self, Balloon};
use super::cameras::{DirectionErrors, Sky, Target, TargetCamera, Visibility};
use super::earth::FixedSun;
use super::imu::ImuErrors;
use super::motion::Motion;
use super::rocket::{self, Rocket};
use super::span::Span;

/// Correlation time of every camera's errors.
const CORRELATION_TIME_S: f64 = 20.0;

/// The vehicle. Each seed draws the phases of its swings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Vehicle {
    /// The coast of a sounding rocket to 238 km.
    Rocket,
    /// A telescope at 38 km that follows the Sun.
    Balloon,
}

impl Vehicle {
    /// Time at which the flight begins: the rocket's motor has separated, the balloon is at float.
    pub fn start_s(self) -> u64 {
        match self {
            Self::Rocket => 60,
            Self::Balloon => 0,
        }
    }

    /// Longest duration: until the rocket meets air, or until the Sun is low for the balloon.
    pub fn longest_s(self) -> f64 {
        match self {
            Self::Rocket => 370.0,
            Self::Balloon => 21_600.0,
        }
    }

    pub(super) fn sun(self) -> FixedSun {
        match self {
            Self::Rocket => rocket::SUN,
            Self::Balloon => balloon::sun(),
        }
    }

    pub(super) fn motion(self, seed: u64) -> Box<dyn Motion> {
        match self {
            Self::Rocket => Box::new(Rocket::drawn(seed)),
            Self::Balloon => Box::new(Balloon::drawn(seed)),
        }
    }
}

/// White errors in each axis of position and velocity, once per second.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GpsErrors {
    pub position_sigma_m: f64,
    pub velocity_sigma_m_s: f64,
}

/// Plan of a simulated flight.
#[derive(Debug, Clone, PartialEq)]
pub struct FlightPlan {
    pub vehicle: Vehicle,
    pub duration_s: f64,
    pub imu: ImuErrors,
    pub gps: GpsErrors,
    pub sun: DirectionErrors,
    pub nadir: DirectionErrors,
    pub cameras: Vec<TargetCamera>,
}

impl FlightPlan {
    /// The coast of Braun and Barf 2022 (section 7) and its sensors, T+60 s to T+430 s. Two cameras on opposite sides point 20 deg downwards; both
    /// give Sun and nadir from T+171 s to T+300 s, once per second.
    pub fn rocket() -> Self {
        let camera = |name, side| TargetCamera {
            name,
            body_from_camera: rocket::camera_axes(side),
            misalignment_sigma_deg: 0.5,
            correlation_time_s: CORRELATION_TIME_S,
            rate_hz: 1,
            targets: vec![Target::Sun, Target::Nadir],
            visibility: Visibility::Between {
                from_s: 171.0,
                to_s: 300.0,
            },
        };
        let errors = |correlated_sigma_deg| DirectionErrors {
            white_sigma_deg: 0.02,
            correlated_sigma_deg,
        };
        Self {
            vehicle: Vehicle::Rocket,
            duration_s: Vehicle::Rocket.longest_s(),
            imu: ImuErrors::rocket(),
            gps: GPS,
            sun: errors(0.1),
            nadir: errors(0.2),
            cameras: vec![camera("camA", 1.0), camera("camB", -1.0)],
        }
    }

    /// Twenty minutes of a telescope whose camera `pyas` gives the Sun to 0.11 arcsec, except for one minute in three, and whose camera
    /// `roll` gives the nadir; both at 4 Hz.
    pub fn balloon() -> Self {
        let pyas = TargetCamera {
            name: "pyas",
            body_from_camera: balloon::ALONG_FIRST,
            // It defines the body's axes.
            misalignment_sigma_deg: 0.0,
            correlation_time_s: CORRELATION_TIME_S,
            rate_hz: 4,
            targets: vec![Target::Sun],
            visibility: Visibility::WithGaps {
                period_s: 180.0,
                gap_s: 60.0,
            },
        };
        let roll = TargetCamera {
            name: "roll",
            body_from_camera: balloon::ALONG_SECOND,
            misalignment_sigma_deg: 0.3,
            targets: vec![Target::Nadir],
            visibility: Visibility::Always,
            ..pyas.clone()
        };
        Self {
            vehicle: Vehicle::Balloon,
            duration_s: 1200.0,
            imu: ImuErrors::balloon(),
            gps: GPS,
            sun: DirectionErrors {
                white_sigma_deg: 0.11 / 3600.0,
                correlated_sigma_deg: 0.0,
            },
            nadir: DirectionErrors {
                white_sigma_deg: 0.0,
                correlated_sigma_deg: 0.04,
            },
            cameras: vec![pyas, roll],
        }
    }

    pub(super) fn span(&self) -> Span {
        Span {
            start_s: self.vehicle.start_s(),
            duration_s: self.duration_s,
        }
    }

    pub(super) fn sky(&self) -> Sky {
        Sky {
            sun: self.vehicle.sun(),
            sun_errors: self.sun,
            nadir_errors: self.nadir,
        }
    }
}

/// GPS errors of both vehicles.
const GPS: GpsErrors = GpsErrors {
    position_sigma_m: 5.0,
    velocity_sigma_m_s: 0.05,
};
