//! A thread that is started again when it panics or hangs.
//!
//! A thread cannot be ended from outside. One that hangs is abandoned: another one takes its place with the same
//! channels, and the old one ends if it ever continues. A thread that hangs keeps its memory, so only a few may hang; after
//! that only a new process helps.

use crate::backoff::Backoff;
use crate::log;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// A thread that panics sooner than this after its start is not started again at once.
const SOON: Duration = Duration::from_secs(1);
/// Largest number of replaced threads that still hang; the next one is not replaced.
const MOST_ABANDONED: usize = 3;

/// Heartbeat of a started thread, and whether another has taken its place.
#[derive(Debug)]
pub(super) struct Heartbeat {
    begin: Instant,
    /// Time of the last heartbeat, ms since `begin`.
    beat_ms: AtomicU64,
    replaced: AtomicBool,
}

impl Heartbeat {
    pub fn new() -> Self {
        Self {
            begin: Instant::now(),
            beat_ms: AtomicU64::new(0),
            replaced: AtomicBool::new(false),
        }
    }

    /// Notes that the thread works, or waits for work.
    pub fn beat(&self) {
        let now = self.begin.elapsed().as_millis() as u64;
        self.beat_ms.store(now, Ordering::Relaxed);
    }

    /// Whether another thread has taken over; this one must not touch anything any more.
    pub fn is_replaced(&self) -> bool {
        self.replaced.load(Ordering::Relaxed)
    }

    fn silence(&self, now: Instant) -> Duration {
        let beat = Duration::from_millis(self.beat_ms.load(Ordering::Relaxed));
        now.saturating_duration_since(self.begin + beat)
    }
}

/// Work of a thread between two restarts. It returns when no work is left.
pub(super) type Job = Box<dyn FnOnce(&Heartbeat) + Send>;
type Make = Box<dyn FnMut() -> Job + Send>;

/// A thread under watch.
pub(super) struct Worker {
    name: String,
    /// Silence beyond which another thread takes over; `None` if none may: it would wait for the same disk or
    /// port.
    timeout: Option<Duration>,
    /// Makes the job of the next start; `None` once the work is done, so that its channels close.
    make: Option<Make>,
    running: Option<Running>,
    due: Instant,
    backoff: Backoff,
    panics: u64,
    takeovers: u64,
    /// Threads that were replaced and still hang.
    abandoned: Vec<JoinHandle<()>>,
}

struct Running {
    heartbeat: Arc<Heartbeat>,
    thread: JoinHandle<()>,
}

impl Worker {
    /// Starts the thread. `make` gives the job of its first start and of every restart.
    pub fn start(
        name: impl Into<String>,
        timeout: Option<Duration>,
        make: impl FnMut() -> Job + Send + 'static,
    ) -> std::io::Result<Self> {
        let mut worker = Self {
            name: name.into(),
            timeout,
            make: Some(Box::new(make)),
            running: None,
            due: Instant::now(),
            backoff: Backoff::DEVICE,
            panics: 0,
            takeovers: 0,
            abandoned: Vec::new(),
        };
        worker.start_thread()?;
        Ok(worker)
    }

    /// Number of restarts of the thread, after a panic or a hang.
    pub fn restarts(&self) -> u64 {
        self.panics + self.takeovers
    }

    /// Number of times that a thread that hung was replaced.
    pub fn takeovers(&self) -> u64 {
        self.takeovers
    }

    /// Whether at `now` the thread had shown no sign of life for longer than `timeout`.
    pub fn is_silent_for(&self, timeout: Duration, now: Instant) -> bool {
        let running = self.running.as_ref();
        running.is_some_and(|running| running.heartbeat.silence(now) > timeout)
    }

    /// Whether the thread hangs and is not replaced, because too many before it hang.
    pub fn is_unrecoverable(&self, now: Instant) -> bool {
        let hangs = |timeout| self.is_silent_for(timeout, now);
        self.abandoned.len() >= MOST_ABANDONED && self.timeout.is_some_and(hangs)
    }

    /// Restarts the count of its silence: the whole program was stopped for a while.
    pub fn reset_silence(&self) {
        if let Some(running) = &self.running {
            running.heartbeat.beat();
        }
    }

    /// Checks the thread as it was at `now`; returns whether its work goes on.
    pub fn check(&mut self, now: Instant) -> bool {
        self.abandoned.retain(|thread| !thread.is_finished());
        match &self.running {
            Some(running) if running.thread.is_finished() => self.conclude(),
            Some(running) => {
                let silence = running.heartbeat.silence(now);
                if self.abandoned.len() < MOST_ABANDONED
                    && self.timeout.is_some_and(|timeout| silence > timeout)
                {
                    self.abandon(silence);
                }
            }
            None if self.make.is_some() && now >= self.due => {
                if let Err(error) = self.start_thread() {
                    tracing::error!(thread = self.name, %error, "a thread cannot be started");
                    self.due = now + self.backoff.wait();
                }
            }
            None => {}
        }
        self.running.is_some() || self.make.is_some()
    }

    fn start_thread(&mut self) -> std::io::Result<()> {
        let Some(make) = &mut self.make else {
            return Ok(());
        };
        let job = make();
        let heartbeat = Arc::new(Heartbeat::new());
        let own = Arc::clone(&heartbeat);
        let thread = thread::Builder::new()
            .name(self.name.clone())
            .spawn(move || job(&own))?;
        self.running = Some(Running { heartbeat, thread });
        Ok(())
    }

    fn conclude(&mut self) {
        let Some(Running { heartbeat, thread }) = self.running.take() else {
            return;
        };
        match thread.join() {
            Ok(()) => self.make = None,
            Err(panic) => {
                self.panics += 1;
                // The payload of a panic may itself panic when it is dropped.
                let said = log::panic_message(&*panic);
                let _ = std::panic::catch_unwind(AssertUnwindSafe(|| drop(panic)));
                let restarts = self.restarts();
                tracing::error!(thread = self.name, said, restarts, "a thread panicked");
                self.due = Instant::now();
                match heartbeat.begin.elapsed() < SOON {
                    true => self.due += self.backoff.wait(),
                    false => self.backoff.reset(),
                }
            }
        }
    }

    fn abandon(&mut self, silence: Duration) {
        self.takeovers += 1;
        let (silent_ms, takeovers) = (silence.as_millis() as u64, self.takeovers);
        tracing::error!(thread = self.name, silent_ms, takeovers, "a thread hangs");
        if let Some(running) = self.running.take() {
            running.heartbeat.replaced.store(true, Ordering::Relaxed);
            self.abandoned.push(running.thread);
        }
        self.due = Instant::now();
    }
}

/// Checks threads; returns whether the work of any goes on.
pub(super) fn check(workers: &mut [Worker], now: Instant) -> bool {
    let at_work = workers
        .iter_mut()
        .filter_map(|worker| worker.check(now).then_some(()));
    at_work.count() > 0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crossbeam_channel::{Receiver, unbounded};

    fn check_until(worker: &mut Worker, done: impl Fn(&Worker, bool) -> bool) {
        let start = Instant::now();
        loop {
            let goes_on = worker.check(Instant::now());
            if done(worker, goes_on) {
                return;
            }
            assert!(start.elapsed() < Duration::from_secs(60), "it never came");
            thread::sleep(Duration::from_millis(1));
        }
    }

    fn ended(_: &Worker, goes_on: bool) -> bool {
        !goes_on
    }

    #[test]
    fn a_thread_that_panics_is_started_again_until_its_work_is_done() {
        let (to_do, work) = unbounded();
        let (report, reports) = unbounded();
        (0..6).for_each(|n| to_do.send(n).unwrap());
        drop(to_do);
        let mut worker = Worker::start("panicking", None, move || {
            let (work, report): (Receiver<u32>, _) = (work.clone(), report.clone());
            Box::new(move |_| {
                for n in work {
                    assert!(n != 2, "two");
                    report.send(n).unwrap();
                }
            })
        })
        .unwrap();
        check_until(&mut worker, ended);
        assert_eq!(worker.restarts(), 1);
        // All ends of the channel are gone with the work.
        assert_eq!(reports.iter().collect::<Vec<_>>(), [0, 1, 3, 4, 5]);
    }

    #[test]
    fn a_thread_that_hangs_is_left_alone_and_another_takes_over() {
        let (report, reports) = unbounded();
        let mut starts = 0;
        let timeout = Some(Duration::from_secs(2));
        let mut worker = Worker::start("hanging", timeout, move || {
            starts += 1;
            let (report, first) = (report.clone(), starts == 1);
            Box::new(move |heartbeat| {
                while first && !heartbeat.is_replaced() {
                    thread::yield_now();
                }
                report.send(heartbeat.is_replaced()).unwrap();
            })
        })
        .unwrap();
        check_until(&mut worker, ended);
        assert_eq!(worker.restarts(), 1);
        let mut both: Vec<bool> = reports.iter().collect();
        both.sort_unstable();
        assert_eq!(both, [false, true], "the old one learns of it");
    }

    #[test]
    fn a_thread_that_hangs_for_a_while_is_replaced_each_time() {
        let (open, gate) = unbounded::<()>();
        let mut worker = Worker::start("slow", Some(Duration::from_millis(1)), move || {
            let gate = gate.clone();
            Box::new(move |heartbeat| {
                while !heartbeat.is_replaced() {
                    thread::yield_now();
                }
                drop(gate);
            })
        })
        .unwrap();
        check_until(&mut worker, |worker, _| worker.takeovers() > 10);
        drop(open);
    }

    #[test]
    fn a_thread_that_always_hangs_is_replaced_three_times_and_then_beyond_help() {
        let (_open, never) = unbounded::<()>();
        let timeout = Duration::from_millis(1);
        let mut worker = Worker::start("hanging", Some(timeout), move || {
            let never = never.clone();
            Box::new(move |_| {
                let _ = never.recv();
            })
        })
        .unwrap();
        check_until(&mut worker, |worker, _| worker.takeovers() == 3);
        check_until(&mut worker, |worker, _| {
            worker.is_unrecoverable(Instant::now())
        });
        let late = Instant::now() + 1000 * timeout;
        assert!(worker.check(late), "the last one is left to its work");
        assert_eq!((worker.takeovers(), worker.restarts()), (3, 3));
    }

    #[test]
    fn a_thread_is_not_blamed_for_the_time_in_which_the_program_was_stopped() {
        let (open, never) = unbounded::<()>();
        let timeout = Duration::from_millis(1);
        let mut worker = Worker::start("stopped", Some(timeout), move || {
            let never = never.clone();
            Box::new(move |_| {
                let _ = never.recv();
            })
        })
        .unwrap();
        thread::sleep(5 * timeout);
        let now = Instant::now();
        assert!(worker.is_silent_for(timeout, now));
        worker.reset_silence();
        assert!(worker.check(now) && worker.takeovers() == 0);
        drop(open);
        check_until(&mut worker, ended);
    }

    #[test]
    fn a_thread_that_beats_is_not_taken_for_one_that_hangs() {
        let timeout = Some(Duration::from_secs(2));
        let mut worker = Worker::start("beating", timeout, || {
            Box::new(|heartbeat| {
                for _ in 0..50 {
                    heartbeat.beat();
                    thread::sleep(Duration::from_millis(50));
                }
            })
        })
        .unwrap();
        check_until(&mut worker, ended);
        assert_eq!(worker.restarts(), 0);
    }
}
