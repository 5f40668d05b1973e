//! Conversion of times from other programs to UTC; and the synchronisation of the computer's clock: whether it is held to UTC, its largest error, and
//! its time service.
//!
//! The kernel reports it (adjtimex(2), read only, no privilege needed): at every correction the time service states
//! the largest error of the clock, and the kernel increases it by 0.5 ms/s until the next one. After an error of 16 s,
//! about nine hours, the kernel considers the clock free-running.

mod flight;
mod utc;

pub use flight::FlightClock;
use std::io;
use std::path::Path;
pub use utc::{Scale, Utc, parse_utc, read_utc, utc_microseconds, utc_of_mjd, utc_text};

/// Files that exist while a time service runs.
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
    /// Lead of the clock over UTC that the kernel has yet to correct; services that correct only by frequency
    /// leave 0 here.
    pub offset_us: f64,
    /// The largest error, as last stated by the time service, and increased since.
    pub max_error_us: f64,
    /// The time service that runs on this computer; `None` if no known one runs.
    pub source: Option<&'static str>,
}

impl ClockStatus {
    /// Asks the kernel; this takes a few microseconds.
    ///
    /// # Errors
    /// If the kernel does not answer, as in some containers.
    pub fn read() -> io::Result<Self> {
        // SAFETY: all of its fields are integers, for which zero is valid; no `modes` means that nothing is set.
        let mut kernel: libc::timex = unsafe { std::mem::zeroed() };
        // SAFETY: the pointer is to a complete timex that outlives the call.
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
            // The kernel states the correction, which has the opposite sign.
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
