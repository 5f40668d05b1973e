//! Frames on their way to a solver, and the stations of the cameras that take them.

use super::messages::{MidExposure, Station, UnsolvedFrame};
use crate::archive::Flown;
use crate::camera::{Camera, Exposure};
use crate::frame::FrameInfo;
use crate::instrument::Role;
use std::sync::Arc;
use std::time::Instant;

/// The stations of cameras that fly together; `configuration` is that of their flight.
pub fn stations(cameras: &[&Camera], configuration: &str) -> Vec<Arc<Station>> {
    let roles: Vec<Role> = cameras.iter().map(|camera| camera.role).collect();
    let numbers = Role::numbers(&roles);
    let station = |(index, camera): (usize, &&Camera)| {
        let same = roles[..index].iter().filter(|role| **role == camera.role);
        Arc::new(Station {
            camera: (*camera).clone(),
            index,
            ordinal: same.count() + 1,
            number: numbers[index],
            flown: Arc::new(Flown::new(configuration.into(), camera.toml.clone())),
        })
    };
    cameras.iter().enumerate().map(station).collect()
}

impl Station {
    /// The station of a camera that is used alone.
    pub fn single(camera: &Camera) -> Self {
        Self {
            index: 0,
            ordinal: 1,
            number: camera.role.number(),
            flown: Arc::new(Flown::new(String::new(), camera.toml.clone())),
            camera: camera.clone(),
        }
    }
}

impl UnsolvedFrame {
    /// A frame that has just come.
    pub fn arrived(exposure: Exposure) -> Self {
        let arrived = Instant::now();
        Self {
            middle: MidExposure::of(&exposure.frame.info, arrived),
            exposure,
            arrived,
        }
    }

    /// Start of the exposure.
    pub fn began(&self) -> Instant {
        let exposure = self.exposure.frame.info.exposure.unwrap_or_default();
        self.arrived.checked_sub(exposure).unwrap_or(self.arrived)
    }
}

impl MidExposure {
    /// Longest plausible delay of a frame; a longer one means that the clock has stepped.
    const LONGEST_DELAY_S: f64 = 2.0;

    fn of(info: &FrameInfo, arrived: Instant) -> Self {
        let half = info.exposure.unwrap_or_default() / 2;
        Self {
            utc: info.mid_exposure,
            by_arrival: arrived.checked_sub(half).unwrap_or(arrived),
        }
    }

    /// Time from this exposure to another, s; negative if the other was earlier.
    pub fn until(&self, other: &Self) -> f64 {
        let (from, to) = (self.by_arrival, other.by_arrival);
        let by_arrival = match to.checked_duration_since(from) {
            Some(after) => after.as_secs_f64(),
            None => -from.saturating_duration_since(to).as_secs_f64(),
        };
        let by_utc = self.utc.zip(other.utc);
        let by_utc = by_utc.map(|(from, to)| to.duration_since(from).as_secs_f64());
        let agrees = |by_utc: &f64| (by_utc - by_arrival).abs() < Self::LONGEST_DELAY_S;
        by_utc.filter(agrees).unwrap_or(by_arrival)
    }
}
