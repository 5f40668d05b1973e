//! Times as other programs write them, to UTC; and the computer's clock: whether it is held to UTC, how far it may be off, and by whom it is held.
//!
//! The kernel itself knows (adjtimex(2), read only, no privilege needed): whoever holds the clock reports to it at every
//! correction how far off the clock may be, and the kernel lets that grow by 0.5 ms a second until the next one. After 16 s of
//! it, about nine hours, it takes the clock for free-running.

mod flight;
mod utc;

pub use flight::FlightClock;
use std::io;
use std::path::Path;
pub use utc::{Scale, Utc, parse_utc, read_utc, utc_microseconds, utc_of_mjd, utc_text};

/// Files that are there while a time service runs.
const SERVICES: [(&str, &str); 5] = [
    ("chrony", "/run/chrony/chronyd.pid"),
    ("chrony", "/run/chronyd.pid"),
    ("ntpd", "/run/ntpd.pid"),
    ("ntpd", "/run/ntpd/ntpd.pid"),
    ("systemd-timesyncd", "/run/systemd/timesync"),
];

/// Status of the clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClockStatus {
    /// Whether a time service holds it to UTC.
    pub synchronised: bool,
    /// By how much it is ahead of UTC, as far as the kernel has yet to correct it; services that correct by frequency alone
    /// leave 0 here.
    pub offset_us: f64,
    /// The largest error, as the time service last stated it, grown since.
    pub max_error_us: f64,
    /// The time service that runs on this computer; `None` where none is known to.
    pub source: Option<&'static str>,
}

impl ClockStatus {
    /// Asks the kernel, in a few microseconds.
    ///
    /// # Errors
    /// Where the kernel does not answer, as in some containers.
    pub fn read() -> io::Result<Self> {
        // SAFETY: all of its fields are integers, for which zeros are values; no `modes` means that nothing is set.
        let mut kernel: libc::timex = unsafe { std::mem::zeroed() };
        // SAFETY: the pointer is to a whole timex that outlives the call.
        let state = unsafe { libc::adjtimex(&raw mut kernel) };
        if state < 0 {
            return Err(io::Error::last_os_error());
        }
        let running = |(_, file): &&(&str, &str)| Path::new(file).exists();
        let source = SERVICES.iter().find(running).map(|(name, _)| *name);
        Ok(Self::of(state, &kernel, source))
    }

    fn of(state: libc::c_int, kernel: &libc::timex, source: Option<&'static str>) -> Self {
        let per_us = match kernel.status & libc::STA_NANO {
            0 => 1.0,
            _ => 1e3,
        };
        Self {
            synchronised: state != libc::TIME_ERROR && kernel.status & libc::STA_UNSYNC == 0,
            // The kernel has the correction.
            offset_us: 0.0 - kernel.offset as f64 / per_us,
            max_error_us: kernel.maxerror as f64,
            source,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kernel(status: libc::c_int, offset: libc::c_long) -> libc::timex {
        // SAFETY: as above.
        let mut kernel: libc::timex = unsafe { std::mem::zeroed() };
        (kernel.status, kernel.offset, kernel.maxerror) = (status, offset, 1500);
        kernel
    }

    #[test]
    fn the_kernels_answer_is_read_in_microseconds_whatever_its_unit() {
        let fine = ClockStatus::of(libc::TIME_OK, &kernel(libc::STA_NANO, -2500), None);
        assert_eq!((fine.offset_us, fine.max_error_us), (2.5, 1500.0));
        let coarse = ClockStatus::of(libc::TIME_OK, &kernel(0, -2500), None);
        assert_eq!(coarse.offset_us, 2500.0);
    }

    #[test]
    fn a_clock_is_free_running_if_the_kernel_says_so_in_either_way() {
        let held = |state, status| ClockStatus::of(state, &kernel(status, 0), None).synchronised;
        assert!(held(libc::TIME_OK, libc::STA_PLL));
        assert!(held(libc::TIME_INS, 0), "a leap second is near");
        assert!(!held(libc::TIME_ERROR, 0));
        assert!(!held(libc::TIME_OK, libc::STA_UNSYNC));
    }
}
