//! The faults, each with its allowed cost.

use crate::camera::{CameraFault, HANG};
use crate::line::Habit;
use crate::rig::Rig;
use clap::ValueEnum;
use solaspect::archive::faulty::{ALL_IN_TURN, DiskFault};
use std::fs;
use std::io::ErrorKind;
use std::process::Command;
use std::time::{Duration, Instant};

/// What goes wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Fault {
    /// Disk 1 takes no byte, and reports that none is free
    DiskFull,
    /// Each operation of disk 1 fails for half a second, one after the other
    DiskFailing,
    /// Disk 1 can make no further file
    DiskInodes,
    /// No call to disk 1 returns
    DiskStuck,
    /// The folder of disk 1 is gone, with every file that was open
    DiskGone,
    /// Both disks refuse
    DisksRefuse,
    /// The camera gives errors
    CameraErrors,
    /// The camera gives nothing, and says nothing
    CameraSilent,
    /// The camera's thread panics
    CameraPanic,
    /// A call to the camera does not return for 12 s
    CameraHangs,
    /// Frames of another size than the instrument's
    FrameSize,
    /// Frames without a time
    FrameTime,
    /// Frames with the time of a clock that was never set, in 1970
    Clock1970,
    /// The peer stops reading
    LineDeaf,
    /// The line is closed, and cannot be opened until the fault ends
    LineClosed,
    /// The line is closed, and another program has its port until the fault ends
    PortTaken,
    /// Random bytes come
    LineGarbage,
    /// Valid commands come as fast as they are answered
    LineCommands,
    /// Commands with wrong checksums come
    LineChecksums,
    /// Every fourth packet reaches the peer with a wrong byte
    LineGarbled,
    /// GPS fixes come that jump to the far side of the Earth and back
    GpsJumps,
    /// Commands come with allowed values that would leave the flight without a Sun
    LineHostile,
    /// A second flight is started on the same archive and saved values: it must be refused
    SecondFlight,
    /// The controller stops the tracking, and starts it again
    TrackingStopped,
    /// The folder of the saved values is gone while a command changes one
    ValuesGone,
    /// Nobody reads standard error, and it is full
    StderrStalled,
    /// Standard error is a pipe without a reader
    StderrClosed,
    /// The IMU is at fault, each time in another of the simulator's kinds; needs --navigation
    Imu,
    /// The whole process is stopped (SIGSTOP), and goes on
    Stopped,
}

/// Allowed cost of a fault. Anything not listed here must not be affected.
#[derive(Debug, Clone, PartialEq)]
pub struct Cost {
    /// Minimum and maximum number of due frames that are not taken.
    pub not_taken: [u64; 2],
    /// Number of frames that the camera could not give.
    pub failed: u64,
    /// Number of frames of another size.
    pub misfits: u64,
    /// Number of thread restarts.
    pub restarts: u64,
    /// Number of times the line is reopened.
    pub reopened: u64,
    /// Whether packets may be lost or refused on the line.
    pub packets: bool,
}

/// Duration for which the process is stopped.
const STOP: Duration = Duration::from_secs(12);
/// Time that the watch waits for a hanging thread.
const TIMEOUT_S: f64 = 10.0;
/// Delays up to this number of frames are absorbed by a camera's buffers.
const BUFFERED: f64 = 18.0;

impl Fault {
    /// Every fault of a flight, the IMU's after each of the others: it has many kinds.
    pub fn all(navigates: bool) -> Vec<Self> {
        let others = Self::value_variants()
            .iter()
            .filter(|fault| **fault != Self::Imu);
        let imu = navigates.then_some(Self::Imu);
        others
            .flat_map(|fault| [*fault].into_iter().chain(imu))
            .collect()
    }

    pub fn name(self) -> String {
        let value = self.to_possible_value();
        value.map_or(String::new(), |value| value.get_name().to_owned())
    }

    /// Duration of the fault.
    pub fn length(self) -> Duration {
        use Fault::*;
        match self {
            DiskFailing => ALL_IN_TURN,
            CameraHangs => HANG,
            Stopped => STOP,
            StderrStalled => Duration::from_secs(10),
            DiskStuck | DiskGone | LineDeaf | Imu => Duration::from_secs(5),
            DiskFull | DiskInodes | ValuesGone => Duration::from_secs(3),
            CameraPanic | FrameSize | FrameTime | Clock1970 => Duration::from_secs(1),
            DisksRefuse | CameraErrors | CameraSilent | LineClosed | PortTaken | LineGarbage
            | LineCommands | LineChecksums | LineGarbled | LineHostile | SecondFlight
            | GpsJumps | TrackingStopped | StderrClosed => Duration::from_secs(2),
        }
    }

    /// Number of frames in the fault's duration, for faults of the camera.
    fn frames(self, rate_hz: f64) -> u64 {
        match self {
            Self::CameraPanic | Self::CameraHangs => 1,
            _ => (self.length().as_secs_f64() * rate_hz) as u64,
        }
    }

    /// Allowed cost at a frame rate, frames/s.
    pub fn cost(self, rate_hz: f64) -> Cost {
        use Fault::*;
        let frames = self.frames(rate_hz);
        let between = |low_s: f64, high_s: f64| {
            let low = (low_s * rate_hz - BUFFERED).max(0.0);
            [low as u64, (high_s * rate_hz) as u64 + 1]
        };
        let only = |fault: Fault| if self == fault { frames } else { 0 };
        Cost {
            not_taken: match self {
                CameraSilent | CameraPanic => [frames; 2],
                // The watch replaces the thread after ten seconds.
                CameraHangs => between(TIMEOUT_S, TIMEOUT_S + 1.0),
                Stopped => between(STOP.as_secs_f64(), STOP.as_secs_f64() + 1.0),
                _ => [0; 2],
            },
            failed: only(CameraErrors),
            misfits: only(FrameSize),
            restarts: u64::from(matches!(self, CameraPanic | CameraHangs)),
            reopened: u64::from(matches!(self, LineClosed | PortTaken)),
            packets: matches!(
                self,
                LineDeaf
                    | LineClosed
                    | PortTaken
                    | LineGarbage
                    | LineCommands
                    | LineGarbled
                    | LineHostile
                    | GpsJumps
            ) || self == Stopped,
        }
    }

    /// Begins the fault. If that takes the fault's whole duration, it returns at its end.
    pub fn begin(self, rig: &Rig) -> anyhow::Result<()> {
        use Fault::*;
        let now = Instant::now();
        match self {
            DiskFull => rig.disk(0).set(Some(DiskFault::Full)),
            DiskFailing => rig.disk(0).set(Some(DiskFault::Failing(now))),
            DiskInodes => rig.disk(0).set(Some(DiskFault::NoInodes)),
            DiskStuck => rig.disk(0).set(Some(DiskFault::Stuck)),
            DiskGone => {
                rig.disk(0).drop_files();
                fs::rename(rig.root(0), rig.root(0).with_extension("away"))?;
            }
            DisksRefuse => {
                for n in 0..rig.disks() {
                    rig.disk(n).set(Some(DiskFault::Refusing));
                }
            }
            CameraErrors => rig.fail(CameraFault::Error, self.frames(rig.rate_hz)),
            CameraSilent => rig.fail(CameraFault::Silence, self.frames(rig.rate_hz)),
            CameraPanic => rig.fail(CameraFault::Panic, 1),
            CameraHangs => rig.fail(CameraFault::Hang, 1),
            FrameSize => rig.fail(CameraFault::WrongSize, self.frames(rig.rate_hz)),
            FrameTime => rig.fail(CameraFault::NoTime, self.frames(rig.rate_hz)),
            Clock1970 => rig.fail(CameraFault::UnsetClock, self.frames(rig.rate_hz)),
            LineDeaf => rig.gondola.behave(Habit::Deaf),
            LineClosed => rig.gondola.behave(Habit::Closed(ErrorKind::NotFound)),
            PortTaken => rig.gondola.behave(Habit::Closed(ErrorKind::ResourceBusy)),
            LineGarbage => rig.gondola.behave(Habit::Garbage),
            LineCommands => rig.gondola.behave(Habit::Commands),
            LineChecksums => rig.gondola.behave(Habit::WrongChecksums),
            LineGarbled => rig.gondola.behave(Habit::Garbled),
            LineHostile => rig.gondola.behave(Habit::Hostile),
            SecondFlight => rig.start_second()?,
            GpsJumps => rig.gondola.behave(Habit::Jumps),
            TrackingStopped => rig.gondola.behave(Habit::NoTracking),
            ValuesGone => {
                fs::rename(&rig.values, rig.values.with_extension("away"))?;
                let more = Duration::from_millis(rig.next_number().into());
                rig.gondola
                    .set_max_solution_age(Duration::from_secs(1) + more);
            }
            StderrStalled => rig.stderr()?.stall(true),
            StderrClosed => rig.stderr()?.close()?,
            Imu => rig.imu()?.begin(),
            Stopped => stop_process(STOP)?,
        }
        Ok(())
    }

    pub fn end(self, rig: &Rig) -> anyhow::Result<()> {
        use Fault::*;
        match self {
            DiskFull | DiskFailing | DiskInodes | DiskStuck => rig.disk(0).set(None),
            DisksRefuse => (0..rig.disks()).for_each(|n| rig.disk(n).set(None)),
            DiskGone => fs::rename(rig.root(0).with_extension("away"), rig.root(0))?,
            CameraErrors | CameraSilent | CameraPanic | CameraHangs | FrameSize | FrameTime
            | Clock1970 | SecondFlight | Stopped => {}
            LineDeaf | LineClosed | PortTaken | LineGarbage | LineCommands | LineChecksums
            | LineGarbled | LineHostile | GpsJumps | TrackingStopped => {
                rig.gondola.behave(Habit::Good)
            }
            ValuesGone => fs::rename(rig.values.with_extension("away"), &rig.values)?,
            Imu => rig.imu()?.end(),
            StderrStalled => rig.stderr()?.stall(false),
            StderrClosed => rig.stderr()?.read()?,
        }
        Ok(())
    }
}

/// Stops this whole process; a child process resumes it.
fn stop_process(time: Duration) -> anyhow::Result<()> {
    let script = "kill -STOP $1; sleep $2; kill -CONT $1";
    let own = std::process::id().to_string();
    let status = Command::new("sh")
        .args(["-c", script, "sh", &own, &time.as_secs().to_string()])
        .status()?;
    anyhow::ensure!(
        status.success(),
        "sh: expected to stop and continue the process"
    );
    Ok(())
}
