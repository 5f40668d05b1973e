//! Real-time scheduling and locked memory, if the configuration asks for them and the computer grants them.

use super::worker::{Heartbeat, Job};
use crate::config::{Host, Memory};
use nix::sys::mman::{MlockAllFlags, mlockall};
use nix::sys::resource::{RLIM_INFINITY, Resource, getrlimit};
use thread_priority::{
    RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id,
};

/// Reason why the computer does not grant a request.
#[derive(Debug, thiserror::Error)]
pub enum NotGranted {
    #[error("host.realtime_priority = {priority}: needs CAP_SYS_NICE or LimitRTPRIO: {cause}")]
    Realtime { priority: u8, cause: String },
    #[error("host.memory = \"locked\": needs CAP_IPC_LOCK or LimitMEMLOCK: {0}")]
    Memory(nix::Error),
    #[error("host.memory = \"locked\": expected LimitMEMLOCK=infinity, found {bytes} bytes")]
    Limit { bytes: u64 },
}

/// Puts the calling thread among the real-time threads.
///
/// # Errors
/// If the operating system does not allow it.
pub fn run_in_real_time(priority: u8) -> Result<(), NotGranted> {
    let refused = |cause: String| NotGranted::Realtime { priority, cause };
    let value = ThreadPriorityValue::try_from(priority).map_err(|e| refused(e.to_string()))?;
    let fifo = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
    let thread = thread_native_id();
    set_thread_priority_and_policy(thread, ThreadPriority::Crossplatform(value), fifo)
        .map_err(|error| refused(format!("{error:?}")))
}

/// Keeps the memory that the program has now and later from being swapped out.
///
/// # Errors
/// If the operating system does not allow it, or sets a limit: a program that reaches it later gets no more memory at all.
pub fn lock_memory() -> Result<(), NotGranted> {
    let (limit, _) = getrlimit(Resource::RLIMIT_MEMLOCK).map_err(NotGranted::Memory)?;
    if limit != RLIM_INFINITY {
        return Err(NotGranted::Limit { bytes: limit });
    }
    mlockall(MlockAllFlags::MCL_CURRENT | MlockAllFlags::MCL_FUTURE).map_err(NotGranted::Memory)
}

/// Work for a thread of lower priority than all others (nice 10), whatever the configuration asks for.
pub(super) fn normal_priority(work: impl FnOnce(&Heartbeat) + Send + 'static) -> Job {
    Box::new(move |heartbeat| {
        const NICE: libc::c_int = 10;
        // SAFETY: it takes three numbers. On Linux 0 is the calling thread, and each thread has its own priority.
        if unsafe { libc::setpriority(libc::PRIO_PROCESS, 0, NICE) } != 0 {
            tracing::warn!("the thread is scheduled like all others");
        }
        work(heartbeat);
    })
}

/// Order of the real-time threads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Rank {
    /// Solvers, which take milliseconds.
    Solver,
    /// Cameras, link, filter and sensors, which take microseconds and hand on.
    Higher,
}

impl Rank {
    fn above(self, priority: u8) -> u8 {
        const MOST: u8 = 99;
        match self {
            Self::Solver => priority,
            Self::Higher => (priority + 1).min(MOST),
        }
    }
}

impl Host {
    /// Work for a thread that is scheduled as the configuration asks; a refused request is logged.
    pub(super) fn realtime(self, rank: Rank, run: impl FnOnce(&Heartbeat) + Send + 'static) -> Job {
        Box::new(move |heartbeat| {
            let priority = self.realtime_priority.map(|own| rank.above(own));
            if let Some(Err(error)) = priority.map(run_in_real_time) {
                tracing::warn!(%error, "the thread is scheduled like all others");
            }
            run(heartbeat);
        })
    }

    /// Requests of the configuration for the whole program; refusals are logged.
    pub(super) fn hold(&self) {
        if self.memory == Memory::Locked
            && let Err(error) = lock_memory()
        {
            tracing::warn!(%error, "memory may be swapped out");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::thread;
    use thread_priority::thread_schedule_policy;

    #[test]
    fn a_thread_runs_in_real_time_or_reports_what_that_needs() {
        let run = || match run_in_real_time(3) {
            Ok(()) => {
                let policy = thread_schedule_policy().unwrap();
                let fifo = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
                assert_eq!(policy, fifo);
            }
            Err(error) => assert!(error.to_string().contains("LimitRTPRIO"), "{error}"),
        };
        thread::spawn(run).join().unwrap();
    }

    #[test]
    fn a_priority_that_there_is_none_of_is_refused() {
        assert!(run_in_real_time(200).is_err());
    }
}
