//! The archive's rows of the navigation: the sensors' data as `solaspect navigate` and `refine` read them, and the offsets by the gyros.

use crate::link::ImuPacket;
use crate::navigation::{Fix, PropagatedOffset, Status};
use jiff::Timestamp;

pub(super) fn imu_row(sample: &ImuPacket) -> Vec<String> {
    let numbers = sample.force_m_s2.iter().chain(&sample.rate_rad_s);
    let mut row = vec![since_1970(sample.time)];
    row.extend(numbers.map(f32::to_string));
    row
}

pub(super) fn gps_row(utc: Timestamp, fix: &Fix) -> Vec<String> {
    let mut row = vec![since_1970(utc)];
    row.extend(fix.position_m.iter().map(|m| format!("{m:.3}")));
    row.extend(match fix.velocity_m_s {
        Some(velocity) => [0, 1, 2].map(|axis| format!("{:.4}", velocity[axis])),
        None => Default::default(),
    });
    row.push(fix.climb.name().into());
    row
}

pub(super) fn propagated_row(
    utc: Timestamp,
    offset: &PropagatedOffset,
    age_s: f64,
    status: Status,
) -> Vec<String> {
    let mut row = vec![since_1970(utc)];
    row.extend(offset.cells());
    row.extend([format!("{age_s:.3}"), status.name().into()]);
    row
}

fn since_1970(time: Timestamp) -> String {
    let micros = time.as_microsecond();
    format!("{}.{:06}", micros / 1_000_000, micros % 1_000_000)
}
