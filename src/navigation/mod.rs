//! Attitude without Sun and horizon: gyros and accelerometers propagate it between and beyond the cameras' directions (Braun and Barf
//! 2022, sections 6 and 7).
//!
//! # Processing of a flight
//! 1. `begin`: the filter waits for a GPS fix and two directions observed at about the same time.
//! 2. `motion`: position, velocity and attitude are propagated in ECEF from sample to sample of the IMU
//!    ([`earth`](crate::geometry::earth): WGS 84, its gravity and rotation); the intervals are split at measurements.
//! 3. `transition`: growth of the errors of motion and IMU in between; `states` lists them all.
//! 4. `filter`: at a measurement the covariance is propagated, the innovation tested, and the estimated errors are
//!    corrected. Some states are only considered (Schmidt): their errors count, but no measurement changes them.
//! 5. `soundness`: faults that the IMU's values reveal by themselves; `doubts`: the additional uncertainty when directions
//!    contradict the filter. Both increase its covariance. `comparison`: whether cameras and gyros agree, and how long they
//!    have not.
//! 6. `run`: after many rejected measurements in a row, the filter restarts.
//! 7. `live` takes samples and measurements as they arrive in flight, and processes late ones at their own time.
//! 8. `offset` computes the telescope's offset from its target from the attitude.
//! 9. `solve` gives the attitude at each sample from all measurements up to then, `smooth` from those of the whole flight;
//!    `spool` keeps the rows on disk meanwhile, and `aem` writes them in an exchange format.
//! 10. `suspected`: other units that the IMU's numbers may be in.
//! 11. `constants`: the constant errors of the sensors, results of one flight for the next.

pub mod aem;
mod begin;
mod comparison;
mod constants;
mod doubts;
mod due;
mod estimate;
pub mod files;
mod filter;
mod live;
mod measurement;
mod model;
mod motion;
pub mod nmea;
mod offset;
mod run;
mod settings;
mod smooth;
mod solve;
mod soundness;
mod spool;
mod states;
mod suspected;
mod targets;
mod transition;

pub use comparison::{Agreement, Axis, Comparison, Difference, LASTING_S, MOST_SIGMAS};
pub use constants::{Constant, ConstantErrors};
pub use due::Due;
pub use live::{Counts, Live};
pub use measurement::{
    Climb, DirectionObservation, Fix, Implausible, ImuSample, Innovation, Measurement, Source,
    Towards, Verdict,
};
pub use motion::Motion;
pub use offset::{PropagatedOffset, offset};
pub use run::Flight;
pub use settings::{Gps, Group, Imu, NavigationCamera, NavigationSettings, Target, Vertical};
pub use smooth::smooth;
pub use solve::{NavigationRow, SensorErrors, Status, Summary, solve};
pub use soundness::Unsound;
pub use spool::Spool;
pub use suspected::suspected_units;
pub use targets::{NoDirection, Sky, Targets};
