//! What the navigation counts, and what it knows now.

use crate::link::Counts;
use crate::navigation::nmea::GpsCounts;
use crate::navigation::{Agreement, Axis, Comparison, PropagatedOffset, Status};
use std::fmt;

/// What the navigation's threads count.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct NavigationTally {
    /// Samples that are missing by their counter.
    pub lost_samples: u64,
    /// Packets of the IMU and datagrams that are no good.
    pub unreadable: u64,
    /// Of the GPS receiver.
    pub gps: GpsCounts,
    /// Directions of cameras.
    pub seen: u64,
    /// Measurements that contradict the filter, and that came too late or too early.
    pub refused: u64,
    pub out_of_time: u64,
    /// Times that the filter began anew.
    pub restarts: u64,
    /// Times that the IMU was unsound, or directions contradicted it.
    pub doubted: u64,
    /// Times that directions contradicted the gyros by more than 5 sigma for 10 s.
    pub contradicted: u64,
    /// Offsets that were made, and of them those that are too uncertain to be sent.
    pub offsets: u64,
    pub uncertain: u64,
    /// Rows for the archive that found no room.
    pub rows_lost: u64,
    /// `None` before the first sample.
    pub status: Option<Status>,
    pub latest: Option<PropagatedOffset>,
    /// The latest differences of cameras from the gyros, in sigmas: right, up and roll of the telescope.
    pub differences: [Option<f64>; 3],
    /// `None` where nothing is compared.
    pub agreement: Option<Agreement>,
}

impl NavigationTally {
    /// Nothing is known of now.
    pub(super) fn forget(&mut self) {
        (self.status, self.latest) = (None, None);
        (self.differences, self.agreement) = Default::default();
    }

    pub(super) fn note_comparison(&mut self, comparison: &Comparison) {
        self.differences = Axis::ALL.map(|axis| comparison.sigmas(axis));
        self.agreement = comparison.agreement();
    }

    pub(in crate::service) fn tell(
        &self,
        counts: &Counts,
        out: &mut fmt::Formatter<'_>,
    ) -> fmt::Result {
        if *self == Self::default() && counts.imu_samples + counts.navigation_lost == 0 {
            return Ok(());
        }
        writeln!(
            out,
            "navigation {} samples ({} lost, {} unreadable), {} fixes ({}), {} directions, \
             {} refused, {} out of time, {} overflowed",
            counts.imu_samples,
            self.lost_samples,
            self.unreadable,
            self.gps.fixes,
            self.gps,
            self.seen,
            self.refused,
            self.out_of_time,
            counts.navigation_lost,
        )?;
        writeln!(
            out,
            "           {} offsets, {} of them too uncertain to be sent, {} times of doubt, {} contradictions of 10 s, {} restarts, {} rows and {} sentences unreadable or lost, at last {}",
            self.offsets,
            self.uncertain,
            self.doubted,
            self.contradicted,
            self.restarts,
            self.rows_lost,
            self.gps.unreadable,
            self.status.map_or("without samples", Status::name),
        )
    }
}
