//! The housekeeping of a flight, stored row by row as received.

use super::table::{Nanoseconds, keep};
use crate::link::Housekeeping;
use crate::link::housekeeping::{FIELDS, Field};
use std::ops::Range;

/// The housekeeping packets as received, with the findings of the rules.
#[derive(Debug, Default)]
pub struct HousekeepingRows {
    /// Time of each packet by the gondola's clock, and time of arrival by the ground's.
    pub times: Vec<Nanoseconds>,
    pub arrived: Vec<Nanoseconds>,
    /// The rules with findings, one bit each.
    pub flags: Vec<u64>,
    payloads: Vec<u8>,
}

/// Number of bytes of a payload in the present layout.
fn payload_bytes() -> usize {
    1 + FIELDS.iter().map(|field| field.bytes).sum::<usize>()
}

impl HousekeepingRows {
    /// Whether the row before an index has the same time and payload.
    pub fn has(&self, at: usize, time: Nanoseconds, payload: &[u8]) -> bool {
        at.checked_sub(1)
            .is_some_and(|row| self.times[row] == time && self.payload(row) == Some(payload))
    }

    /// Inserts a row at an index, without judging it.
    pub fn insert(&mut self, at: usize, time: Nanoseconds, arrived: Nanoseconds, payload: Vec<u8>) {
        self.times.insert(at, time);
        self.arrived.insert(at, arrived);
        self.flags.insert(at, 0);
        let byte = at * payload.len();
        self.payloads.splice(byte..byte, payload);
    }

    fn payload(&self, row: usize) -> Option<&[u8]> {
        let length = payload_bytes();
        self.payloads.get(row * length..(row + 1) * length)
    }

    pub fn at_row(&self, row: usize) -> Option<Housekeeping> {
        Housekeeping::from_payload(self.payload(row)?)
    }

    /// A field's values in a range of rows.
    pub fn numbers(&self, rows: Range<usize>, name: &str) -> Vec<f32> {
        let mut at = 1;
        let found = FIELDS.iter().find(|field| {
            let is_it = field.name == name;
            at += if is_it { 0 } else { field.bytes };
            is_it
        });
        let number = |row| {
            let field: &Field = found?;
            let bytes = self.payload(row)?.get(at..at + field.bytes)?;
            field.value(bytes)
        };
        rows.map(|row| number(row).map_or(f32::NAN, |value| value as f32))
            .collect()
    }

    /// Drops rows that arrived before a time; for each row, whether it was kept.
    pub fn forget_before(&mut self, arrived: Nanoseconds) -> Vec<bool> {
        let kept: Vec<bool> = self.arrived.iter().map(|own| *own >= arrived).collect();
        keep(&mut self.times, &kept);
        keep(&mut self.arrived, &kept);
        keep(&mut self.flags, &kept);
        let (length, mut byte) = (payload_bytes(), 0);
        self.payloads.retain(|_| {
            let row = byte / length;
            byte += 1;
            kept[row]
        });
        kept
    }
}
