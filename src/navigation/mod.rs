//! Attitude without Sun and horizon: gyros and accelerometers propagate it between and beyond the cameras' directions (Braun and Barf
//! 2022, sections 6 and 7).
//!
//! # The way of a flight
//! 1. `begin`: the filter waits for a fix of GPS and two directions that were seen at about the same time.
//! 2. `motion`: from sample to sample of the IMU position, velocity and attitude are carried on in ECEF ([`earth`](crate::geometry::earth): WGS 84, its
//!    gravity and turning), cut where a measurement was taken.
//! 3. `transition`: how errors of motion and IMU grow meanwhile; `states` lists them all.
//! 4. `filter`: at a measurement the covariance is brought up to date, the innovation tested, and the errors that it shows are corrected.
//!    Some states are only considered (Schmidt): their errors count, no measurement changes them.
//! 5. `soundness`: faults that an IMU's values show by themselves; `doubts`: the added uncertainty where directions contradict
//!    the filter. Both grow its covariance. `comparison`: whether cameras and gyros agree, and for how long they have not.
//! 6. `run`: many refused measurements in a row, and the filter restarts.
//! 7. `live` takes samples and measurements as they come in flight, and puts late ones where they belong.
//! 8. `offset` computes from the attitude how far the telescope is from its target.
//! 9. `solve` gives the attitude at each sample by all measurements up to then, `smooth` by those of the whole flight; `spool` keeps the rows
//!    on disk meanwhile, and `aem` writes them for others' programs.
//! 10. `suspected`: which other units the IMU's numbers may be in.
//! 11. `constants`: the constant errors of the sensors, results of a flight for the next one.

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
