//! The configuration: plain structs for the program, and one table of parameters for all other uses.
//!
//! The table in `table` declares each parameter once: key, unit, allowed values, command number and
//! documentation. Reading TOML, the shipped example, the page of parameters and the commands that set
//! parameters in flight are all derived from it. Defaults are in the structs' `Default`, where modules that are used
//! without a configuration find them too.
//!
//! To add a parameter: a field in a struct that [`Config`] holds, its default, and one row in the table.

/// A table of the configuration: each field with its default.
macro_rules! defaults {
    ($(#[$about:meta])* $name:ident { $($(#[$note:meta])* $field:ident: $type:ty = $default:expr,)* }) => {
        $(#[$about])*
        #[derive(Debug, Clone, PartialEq)]
        pub struct $name {
            $($(#[$note])* pub $field: $type,)*
        }

        impl Default for $name {
            fn default() -> Self {
                Self { $($field: $default,)* }
            }
        }
    };
}

mod camera;
mod contradictions;
mod documents;
mod host;
mod link;
mod navigation;
mod output;
mod parameter;
mod read;
pub mod saved;
mod table;
mod value;

pub use camera::{Cameras, ConfiguredCamera, Switch};
pub use documents::{example, parameters_page};
pub use host::{Host, Memory};
pub use navigation::Navigation;
pub use output::{Output, Outputs};
pub use parameter::{Allowed, Parameter, Refused};
pub use table::{by_command, by_key, parameters};
pub use value::Value;

use crate::archive::{Overflow, Sharing, SpaceLimits};
use crate::camera::Source;
use crate::clock::FlightClock;
use crate::fits::{Compression, Packing};
use crate::horizon::{Refraction, Sphere};
use crate::units::{Measured, Place};
use crate::{aspect, fiducial, limb, registration};
use jiff::Timestamp;
use std::path::PathBuf;
use std::time::Duration;

/// All settings of a flight. `Config::default()` is a valid configuration.
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
    pub outputs: Outputs,
    pub archive: Archive,
    pub host: Host,
    pub preflight: Preflight,
    pub simulation: Simulation,
    pub limb: limb::LimbSettings,
    pub fiducial: fiducial::FiducialSettings,
    pub registration: registration::RegistrationSettings,
}

impl Config {
    /// The clock of a flight that begins now.
    pub fn clock(&self) -> FlightClock {
        let is_simulated = matches!(self.cameras.first().source, Some(Source::Simulated(_)));
        let start = self.simulation.start_utc.filter(|_| is_simulated);
        start.map_or_else(FlightClock::default, FlightClock::starting)
    }

    /// The configurable settings of the solver.
    pub fn solver(&self) -> aspect::SolverSettings {
        aspect::SolverSettings {
            limb: self.limb,
            fiducial: self.fiducial,
            registration: self.registration,
        }
    }
}

/// Place of the observer, unless a frame states its own: all three values or none.
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
    /// The place, if all of it is known.
    pub fn place(&self) -> Option<Place> {
        Place::new(self.latitude_deg?, self.longitude_deg?, self.height_m?).ok()
    }

    fn is_complete_or_empty(&self) -> bool {
        let known = [self.latitude_deg, self.longitude_deg, self.height_m];
        known.iter().all(Option::is_some) || known.iter().all(Option::is_none)
    }
}

/// Source of the positions of Sun and Moon.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Sky {
    pub earth_orientation: Option<PathBuf>,
}

/// Target of the telescope, helioprojective; with an epoch, the feature that was there at that time.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Target {
    pub x_arcsec: f64,
    pub y_arcsec: f64,
    pub epoch_utc: Option<Timestamp>,
}

defaults! {
    /// Solution and use of the roll camera's horizon.
    #[derive(Copy)]
    Roll {
        max_age_s: f64 = 1.0,
        height_m: Option<f64> = None,
        height_sigma_m: f64 = 500.0,
        atmosphere_m: f64 = 20_000.0,
        edge_sigma_m: f64 = 1_000.0,
    }
}

impl Roll {
    pub fn max_age(&self) -> Duration {
        Duration::from_secs_f64(self.max_age_s)
    }

    /// The Earth as seen by a camera, at the stated height or else that of its place; `None` below the limb's edge. The Earth's ellipsoid changes the
    /// roll by at most 0.01 deg.
    pub fn sphere(&self, height_m: Option<f64>) -> Option<Sphere> {
        let height = Measured::new(self.height_m.or(height_m)?, self.height_sigma_m);
        let edge_m = Measured::new(self.atmosphere_m, self.edge_sigma_m);
        let air = Refraction::StandardAir;
        Sphere::earth(height, edge_m, air)
    }
}

defaults! {
    /// Conditions for solving the Moon camera's frames, and for answering requests for the Moon.
    #[derive(Copy)]
    Moon {
        clear_of_sun_deg: f64 = 15.0,
        answer_within_s: f64 = 5.0,
    }
}

impl Moon {
    pub fn answer_within(&self) -> Duration {
        Duration::from_secs_f64(self.answer_within_s)
    }
}

defaults! {
    /// Settings of the controller's line.
    Link {
        port: Option<String> = None,
        baud: u32 = 115_200,
        udp_local_port: u32 = 2000,
        udp_bind: Option<String> = None,
        udp_peers: Option<String> = None,
        key_file: Option<PathBuf> = None,
        computer: u32 = 1,
        sending_camera: u32 = 1,
        solution_divisor: u32 = 1,
        max_solution_age_ms: u32 = 500,
        saved_values: Option<PathBuf> = None,
        restore_tracking_s: u32 = 600,
    }
}

defaults! {
    /// Storage of frames.
    Archive {
        directory: Option<PathBuf> = None,
        second_directory: Option<PathBuf> = None,
        compression: Compression = Compression::Rice,
        threads: usize = 1,
        sharing: Sharing = Sharing::Alternate,
        queue_frames: usize = 64,
        overflow: Overflow = Overflow::DropOldest,
        store_every: u64 = 4,
        warn_free_percent: f64 = 10.0,
        thin_free_percent: f64 = 3.0,
        stop_free_percent: f64 = 1.0,
    }
}

impl Archive {
    /// Compression of pictures.
    pub fn packing(&self) -> Packing {
        Packing {
            compression: self.compression,
            threads: self.threads,
        }
    }

    /// Limits of the free space.
    pub fn space_limits(&self) -> SpaceLimits {
        SpaceLimits {
            warn_percent: self.warn_free_percent,
            thin_percent: self.thin_free_percent,
            stop_percent: self.stop_free_percent,
        }
    }
}

defaults! {
    /// Requirements before the flight.
    Preflight {
        max_clock_error_ms: f64 = 100.0,
        max_calibration_age_days: f64 = 365.0,
        min_archive_hours: f64 = 12.0,
    }
}

defaults! {
    /// Settings of simulated scenes.
    Simulation {
        seed: u64 = 1,
        start_utc: Option<Timestamp> = None,
    }
}
