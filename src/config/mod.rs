//! The configuration: plain structs for the program, one table of parameters for everyone else.
//!
//! The table in `table` declares each parameter once: key, unit, allowed values, command number and
//! documentation. Reading TOML, the shipped example, the page of parameters and the commands that set
//! parameters in flight all come from it. Defaults live in the structs' `Default`, where modules that are used
//! without a configuration find them too.
//!
//! To add a parameter: a field in a struct that [`Config`] holds, its default, and one row in the table.

mod camera;
mod clock;
mod contradictions;
mod documents;
mod host;
mod link;
mod navigation;
mod parameter;
mod read;
pub mod saved;
mod table;
mod value;

pub use camera::{Cameras, ConfiguredCamera, Switch};
pub use clock::FlightClock;
pub use documents::{example, parameters_page};
pub use host::{Host, Memory};
pub use navigation::Navigation;
pub use parameter::{Allowed, Parameter, Refused};
pub use table::{by_command, by_key, parameters};
pub use value::Value;

use crate::archive::{Overflow, Sharing, SpaceLimits};
use crate::fits::{Compression, Packing};
use crate::horizon::{Refraction, Sphere};
use crate::units::{Measured, Place};
use crate::{aspect, fiducial, limb, registration};
use jiff::Timestamp;
use std::path::PathBuf;
use std::time::Duration;

/// Everything that a flight may set. `Config::default()` is a valid configuration.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Config {
    pub site: Site,
    pub sky: Sky,
    pub target: Target,
    pub cameras: Cameras,
    pub roll: Roll,
    pub moon: Moon,
    pub link: Link,
    pub navigation: Navigation,
    pub archive: Archive,
    pub host: Host,
    pub preflight: Preflight,
    pub simulation: Simulation,
    pub limb: limb::LimbSettings,
    pub fiducial: fiducial::FiducialSettings,
    pub registration: registration::RegistrationSettings,
}

impl Config {
    /// The tunable parts of the solver.
    pub fn solver(&self) -> aspect::SolverSettings {
        aspect::SolverSettings {
            limb: self.limb,
            fiducial: self.fiducial,
            registration: self.registration,
        }
    }
}

/// Where the observer is, unless a frame says so itself: all three or none.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Site {
    pub latitude_deg: Option<f64>,
    pub longitude_deg: Option<f64>,
    pub height_m: Option<f64>,
}

impl From<Place> for Site {
    fn from(place: Place) -> Self {
        Self {
            latitude_deg: Some(place.latitude_deg),
            longitude_deg: Some(place.longitude_deg),
            height_m: Some(place.height_m),
        }
    }
}

impl Site {
    /// The place, where all of it is known.
    pub fn place(&self) -> Option<Place> {
        Place::new(self.latitude_deg?, self.longitude_deg?, self.height_m?).ok()
    }

    fn is_complete_or_empty(&self) -> bool {
        let known = [self.latitude_deg, self.longitude_deg, self.height_m];
        known.iter().all(Option::is_some) || known.iter().all(Option::is_none)
    }
}

/// What the positions of Sun and Moon rest on.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Sky {
    pub earth_orientation: Option<PathBuf>,
}

/// Where the telescope should point, helioprojective; with an epoch, what stood there then.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Target {
    pub x_arcsec: f64,
    pub y_arcsec: f64,
    pub epoch_utc: Option<Timestamp>,
}

/// How the roll camera's horizon is solved and used.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Roll {
    pub max_age_s: f64,
    pub height_m: Option<f64>,
    pub height_sigma_m: f64,
    pub atmosphere_m: f64,
    pub edge_sigma_m: f64,
}

impl Default for Roll {
    fn default() -> Self {
        Self {
            max_age_s: 1.0,
            height_m: None,
            height_sigma_m: 500.0,
            atmosphere_m: 20_000.0,
            edge_sigma_m: 1_000.0,
        }
    }
}

impl Roll {
    pub fn max_age(&self) -> Duration {
        Duration::from_secs_f64(self.max_age_s)
    }

    /// The Earth about a camera, at the stated height or else that of its place; `None` below the limb's edge. Its ellipsoid moves the roll by a
    /// hundredth of a degree at most.
    pub fn sphere(&self, height_m: Option<f64>) -> Option<Sphere> {
        let height = Measured::new(self.height_m.or(height_m)?, self.height_sigma_m);
        let edge_m = Measured::new(self.atmosphere_m, self.edge_sigma_m);
        let air = Refraction::StandardAir;
        Sphere::earth(height, edge_m, air)
    }
}

/// When the Moon camera's frames are solved, and how requests for the Moon are answered.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moon {
    pub clear_of_sun_deg: f64,
    pub answer_within_s: f64,
}

impl Default for Moon {
    fn default() -> Self {
        Self {
            clear_of_sun_deg: 15.0,
            answer_within_s: 5.0,
        }
    }
}

impl Moon {
    pub fn answer_within(&self) -> Duration {
        Duration::from_secs_f64(self.answer_within_s)
    }
}

/// How the controller is spoken to.
#[derive(Debug, Clone, PartialEq)]
pub struct Link {
    pub port: Option<String>,
    pub baud: u32,
    pub udp_local_port: u32,
    pub udp_bind: Option<String>,
    pub udp_peers: Option<String>,
    pub key_file: Option<PathBuf>,
    pub computer: u32,
    pub sending_camera: u32,
    pub solution_divisor: u32,
    pub max_solution_age_ms: u32,
    pub saved_values: Option<PathBuf>,
    pub restore_tracking_s: u32,
}

impl Default for Link {
    fn default() -> Self {
        Self {
            port: None,
            baud: 115_200,
            udp_local_port: 2000,
            udp_bind: None,
            udp_peers: None,
            key_file: None,
            computer: 1,
            sending_camera: 1,
            solution_divisor: 1,
            max_solution_age_ms: 500,
            saved_values: None,
            restore_tracking_s: 600,
        }
    }
}

/// Where and how frames are kept.
#[derive(Debug, Clone, PartialEq)]
pub struct Archive {
    pub directory: Option<PathBuf>,
    pub second_directory: Option<PathBuf>,
    pub compression: Compression,
    pub threads: usize,
    pub sharing: Sharing,
    pub queue_frames: usize,
    pub overflow: Overflow,
    pub store_every: u64,
    pub warn_free_percent: f64,
    pub thin_free_percent: f64,
    pub stop_free_percent: f64,
}

impl Default for Archive {
    fn default() -> Self {
        Self {
            directory: None,
            second_directory: None,
            compression: Compression::Rice,
            threads: 1,
            sharing: Sharing::Alternate,
            queue_frames: 64,
            overflow: Overflow::DropOldest,
            store_every: 4,
            warn_free_percent: 10.0,
            thin_free_percent: 3.0,
            stop_free_percent: 1.0,
        }
    }
}

impl Archive {
    /// How pictures are packed.
    pub fn packing(&self) -> Packing {
        Packing {
            compression: self.compression,
            threads: self.threads,
        }
    }

    /// How much free space calls for what.
    pub fn space_limits(&self) -> SpaceLimits {
        SpaceLimits {
            warn_percent: self.warn_free_percent,
            thin_percent: self.thin_free_percent,
            stop_percent: self.stop_free_percent,
        }
    }
}

/// What is demanded before the flight.
#[derive(Debug, Clone, PartialEq)]
pub struct Preflight {
    pub max_clock_error_ms: f64,
    pub max_calibration_age_days: f64,
    pub min_archive_hours: f64,
}

impl Default for Preflight {
    fn default() -> Self {
        Self {
            max_clock_error_ms: 100.0,
            max_calibration_age_days: 365.0,
            min_archive_hours: 12.0,
        }
    }
}

/// How scenes are simulated.
#[derive(Debug, Clone, PartialEq)]
pub struct Simulation {
    pub seed: u64,
    pub start_utc: Option<Timestamp>,
}

impl Default for Simulation {
    fn default() -> Self {
        Self {
            seed: 1,
            start_utc: None,
        }
    }
}
