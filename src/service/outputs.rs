//! Outputs for other programs: each has a thread and a queue of its own. No thread waits for one: messages that do not fit into its queue, or
//! that its reader does not take, are dropped and counted.

use super::messages::{Found, ReceivesFrames, ReceivesTelemetry, SolvedFrame};
use super::priority::normal_priority;
use super::tally::OutputTally;
use super::worker::{Heartbeat, Worker};
use crate::config;
use crate::link::TelemetryPacket;
use crate::log::worth_a_line;
use crate::output::{Destination, Encoder, Endpoint, Format, Message, Report};
use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Messages that may wait for an output: 10 s of one camera at 26 frames/s.
const WAITING: usize = 256;
/// How long a thread waits for a message before it checks its readers.
const TIMEOUT: Duration = Duration::from_millis(50);
/// Time after the end for which messages may still wait; then they are dropped.
const FLUSH_TIMEOUT: Duration = Duration::from_millis(200);

/// The outputs, as a receiver of messages.
#[derive(Clone, Default)]
pub(super) struct Outputs(Arc<[Output]>);

/// An output as seen by other threads.
struct Output {
    format: Format,
    queue: Sender<Message>,
    counts: Arc<Counts>,
}

/// Counts of an output, without a lock: its thread may be preempted for long, and no other thread may wait for it.
struct Counts {
    to: Destination,
    format: Format,
    sent: AtomicU64,
    dropped: AtomicU64,
}

/// Counts of all outputs.
#[derive(Clone, Default)]
pub(super) struct Gauges(Vec<Arc<Counts>>);

impl Gauges {
    pub fn tally(&self) -> Vec<OutputTally> {
        let tally = |counts: &Arc<Counts>| OutputTally {
            to: counts.to.to_string(),
            format: counts.format.name(),
            sent: counts.sent.load(Ordering::Relaxed),
            dropped: counts.dropped.load(Ordering::Relaxed),
        };
        self.0.iter().map(tally).collect()
    }
}

impl Counts {
    fn note_dropped(&self, messages: u64) {
        let dropped = self.dropped.fetch_add(messages, Ordering::Relaxed) + messages;
        if messages > 0 && worth_a_line(dropped) {
            let (to, format) = (&self.to, self.format.name());
            tracing::warn!(%to, format, dropped, "an output's reader is too slow");
        }
    }
}

/// Starts the threads of the outputs. They end when `closing` is set and they have written the messages that wait.
pub(super) fn start(
    outputs: &config::Outputs,
    closing: &Arc<AtomicBool>,
) -> std::io::Result<(Outputs, Gauges, Vec<Worker>)> {
    let (mut ends, mut gauges, mut workers) = (Vec::new(), Gauges::default(), Vec::new());
    for (number, (_, output)) in (1..).zip(outputs.flying()) {
        let Some(to) = output.to.clone() else {
            continue;
        };
        let (queue, messages) = bounded(WAITING);
        let (format, baud) = (output.format, output.baud);
        let counts = Arc::new(Counts {
            to,
            format,
            sent: AtomicU64::new(0),
            dropped: AtomicU64::new(0),
        });
        gauges.0.push(Arc::clone(&counts));
        let own = Arc::clone(&counts);
        let closing = Arc::clone(closing);
        // No other thread can take over its work if it blocks.
        workers.push(Worker::start(
            format!("output-{number}"),
            None,
            move || {
                let (messages, closing) = (messages.clone(), Arc::clone(&closing));
                let mut writing = OutputThread {
                    endpoint: Endpoint::new(&own.to, baud),
                    encoder: Encoder::new(own.format),
                    counts: Arc::clone(&own),
                    start: Instant::now(),
                };
                normal_priority(move |heartbeat| writing.run(&messages, &closing, heartbeat))
            },
        )?);
        ends.push(Output {
            format,
            queue,
            counts,
        });
    }
    Ok((Outputs(ends.into()), gauges, workers))
}

impl Outputs {
    /// Hands a message to the outputs that carry it. The message is made only if one does.
    fn pass_on(&self, carries: impl Fn(Format) -> bool, message: impl FnOnce() -> Message) {
        if !self.0.iter().any(|output| carries(output.format)) {
            return;
        }
        let message = message();
        for output in self.0.iter().filter(|output| carries(output.format)) {
            if output.queue.try_send(message.clone()).is_err() {
                output.counts.note_dropped(1);
            }
        }
    }
}

impl ReceivesFrames for Outputs {
    fn receive(&self, frame: &SolvedFrame) {
        if matches!(frame.solved.found, Found::Nothing) {
            return;
        }
        self.pass_on(Format::carries_solutions, || {
            Message::Solution(Arc::new(Report {
                camera: frame.station.camera.name.clone(),
                number: frame.station.number,
                row: frame.row(),
            }))
        });
    }
}

impl ReceivesTelemetry for Outputs {
    fn receive_telemetry(&self, packet: &TelemetryPacket) {
        self.pass_on(Format::carries_telemetry, || {
            Message::Telemetry(Arc::new(packet.clone()))
        });
    }
}

/// State of an output's thread until its next restart.
struct OutputThread {
    endpoint: Endpoint,
    encoder: Encoder,
    counts: Arc<Counts>,
    start: Instant,
}

impl OutputThread {
    fn run(&mut self, messages: &Receiver<Message>, closing: &AtomicBool, heartbeat: &Heartbeat) {
        let mut ended = None;
        self.endpoint.poll(self.start.elapsed());
        loop {
            heartbeat.beat();
            let message = messages.recv_timeout(TIMEOUT);
            // Readers that have connected by now get the message, too.
            self.endpoint.poll(self.start.elapsed());
            if closing.load(Ordering::Relaxed) {
                ended.get_or_insert_with(Instant::now);
            }
            let is_late = ended.is_some_and(|ended: Instant| ended.elapsed() > FLUSH_TIMEOUT);
            match message {
                Ok(_) if is_late => self.counts.note_dropped(1),
                Ok(message) => self.write(&message),
                Err(_) if ended.is_some() => return,
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => std::thread::sleep(TIMEOUT),
            }
        }
    }

    fn write(&mut self, message: &Message) {
        let Some(bytes) = self.encoder.encode(message) else {
            return self.counts.note_dropped(1);
        };
        let result = self.endpoint.send(&bytes, self.start.elapsed());
        self.counts.sent.fetch_add(result.sent, Ordering::Relaxed);
        self.counts.note_dropped(result.dropped);
    }
}
