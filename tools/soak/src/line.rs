//! The gondola's end of the line: the simulated controller at a pseudo-terminal that misbehaves on command.

use crate::navigation::{Judge, NavigationRun};
use solaspect::commands::order;
use solaspect::link::{
    AnyPort, AspectCommand, BytePort, Computer, Connection, GpsFix, Message, PortError, SerialPort,
    id,
};
use solaspect::simulate::controller::{Controller, Faults};
use solaspect::simulate::sensors::Sensors;
use std::io;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// Pause of the thread while it does not listen.
const PAUSE: Duration = Duration::from_millis(10);
/// Time limit for the answer to "stop tracking".
const TIMEOUT: Duration = Duration::from_secs(1);
const WRITE_TIMEOUT: Duration = Duration::from_millis(100);
/// Number of items between two polls of a flood: about 400 commands or 20,000 bytes of garbage per second.
const COMMANDS: usize = 8;
const GARBAGE_BYTES: usize = 400;
/// Every n-th packet from the service is garbled.
const GARBLED: u64 = 4;
/// Key of a solution, and its position in a packet.
const SOLUTION: [u8; 2] = 0x1102_u16.to_le_bytes();
const KEY_AT: std::ops::Range<usize> = 8..10;

/// Behaviour of the gondola's end.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub enum Habit {
    #[default]
    Good,
    /// Reads nothing.
    Deaf,
    /// Closes the line, which cannot be opened again, for this reason.
    Closed(io::ErrorKind),
    /// Sends random bytes.
    Garbage,
    /// Sends commands as fast as they are read.
    Commands,
    /// Sends commands with wrong checksums.
    WrongChecksums,
    /// Sends places, of which every other one is on the far side of the Earth.
    Jumps,
    /// Changes bytes of the received packets.
    Garbled,
    /// Requests no tracking.
    NoTracking,
    /// Sends commands that would leave the flight without a Sun or a line.
    Hostile,
}

/// Packets received by the controller, and packets sent in addition to the tracking requests.
#[derive(Debug, Clone, Copy, Default)]
pub struct Heard {
    pub solutions: u64,
    pub housekeeping: u64,
    pub offsets: NavigationRun,
    pub results: u64,
    pub faults: Faults,
    /// Number of commands, and of packets with wrong checksums, that were sent.
    pub commands: u64,
    pub wrong_checksums: u64,
}

/// The gondola's interface for the rest of the soak test.
pub struct Gondola {
    shared: Arc<Shared>,
    thread: JoinHandle<Option<SerialPort>>,
}

#[derive(Default)]
struct Shared {
    habit: Mutex<Habit>,
    heard: Mutex<Heard>,
    /// The far end of a line that the service has just opened.
    opened: Mutex<Option<SerialPort>>,
    /// A message to send once.
    message: Mutex<Option<Message>>,
    garbled_solutions: AtomicU64,
    over: AtomicBool,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Gondola {
    /// Starts the controller, and returns the service's connection to it.
    pub fn start(sensors: Option<Sensors>, judge: Option<Judge>) -> (Self, Connection) {
        let shared = Arc::<Shared>::default();
        let opens = Arc::clone(&shared);
        let connection = Connection::new(move || opens.open());
        let runs = Arc::clone(&shared);
        let thread = thread::spawn(move || End::new(runs, sensors, judge).run());
        (Self { shared, thread }, connection)
    }

    pub fn behave(&self, habit: Habit) {
        *lock(&self.shared.habit) = habit;
    }

    /// Sets, by command, the age beyond which a solution is outdated.
    pub fn set_max_solution_age(&self, age: Duration) {
        *lock(&self.shared.message) = set("3", &age.as_millis().to_string());
    }

    pub fn heard(&self) -> Heard {
        *lock(&self.shared.heard)
    }

    /// Number of solutions that were garbled in transit.
    pub fn garbled_solutions(&self) -> u64 {
        self.shared.garbled_solutions.load(Ordering::Relaxed)
    }

    /// Ends the controller. The port is returned: the service must close it first.
    pub fn end(self) -> (Heard, Option<SerialPort>) {
        self.shared.over.store(true, Ordering::Relaxed);
        let port = self.thread.join().unwrap_or_default();
        (*lock(&self.shared.heard), port)
    }
}

impl Shared {
    fn habit(&self) -> Habit {
        *lock(&self.habit)
    }

    fn open(self: &Arc<Self>) -> Result<AnyPort, PortError> {
        if let Habit::Closed(reason) = self.habit() {
            return Err(PortError::Lost {
                name: "soak".into(),
                cause: reason.into(),
            });
        }
        let (near, far) = SerialPort::pair()?;
        *lock(&self.opened) = Some(far);
        let shared = Arc::clone(self);
        Ok(Box::new(NearEnd {
            port: near,
            shared,
            packets: 0,
        }))
    }
}

/// The service's end, on which bytes are changed.
struct NearEnd {
    port: SerialPort,
    shared: Arc<Shared>,
    packets: u64,
}

impl BytePort for NearEnd {
    fn read(&mut self, buffer: &mut [u8], timeout: Duration) -> Result<usize, PortError> {
        self.port.read(buffer, timeout)
    }

    fn write(&mut self, bytes: &[u8], timeout: Duration) -> Result<(), PortError> {
        self.packets += 1;
        if self.shared.habit() != Habit::Garbled || !self.packets.is_multiple_of(GARBLED) {
            return self.port.write(bytes, timeout);
        }
        let mut wrong = bytes.to_vec();
        if let Some(last) = wrong.last_mut() {
            *last ^= 0x10;
        }
        self.port.write(&wrong, timeout)?;
        if bytes.get(KEY_AT) == Some(&SOLUTION) {
            let count = &self.shared.garbled_solutions;
            count.fetch_add(1, Ordering::Relaxed);
        }
        Ok(())
    }

    fn backlog(&mut self) -> usize {
        self.port.backlog()
    }

    fn discard_backlog(&mut self) {
        self.port.discard_backlog();
    }
}

/// The controller's end.
struct End {
    shared: Arc<Shared>,
    controller: Controller,
    judge: Option<Judge>,
    port: Option<SerialPort>,
    start: Instant,
    heard: Heard,
    /// State of the generator of garbage.
    random: u64,
}

impl End {
    fn new(shared: Arc<Shared>, sensors: Option<Sensors>, judge: Option<Judge>) -> Self {
        let controller = Controller::new();
        Self {
            shared,
            controller: match sensors {
                Some(sensors) => controller.with_sensors(sensors),
                None => controller,
            },
            judge,
            port: None,
            start: Instant::now(),
            heard: Heard::default(),
            random: 1,
        }
    }

    fn run(mut self) -> Option<SerialPort> {
        let mut habit = Habit::Good;
        while !self.shared.over.load(Ordering::Relaxed) {
            let before = std::mem::replace(&mut habit, self.shared.habit());
            match (before == Habit::NoTracking, habit == Habit::NoTracking) {
                (false, true) => self.controller.stop_tracking(),
                (true, false) => self.controller.start_tracking(),
                _ => {}
            }
            self.step(habit);
        }
        self.controller.stop_tracking();
        let end = Instant::now() + TIMEOUT;
        while !self.controller.is_obeyed() && Instant::now() < end {
            self.step(Habit::Good);
        }
        self.port
    }

    fn step(&mut self, habit: Habit) {
        if let Some(port) = lock(&self.shared.opened).take() {
            self.port = Some(port);
        }
        if matches!(habit, Habit::Closed(_)) {
            self.port = None;
        }
        if habit == Habit::Deaf {
            return thread::sleep(PAUSE);
        }
        let Some(mut port) = self.port.take() else {
            return thread::sleep(PAUSE);
        };
        // A lost line returns as a new one.
        if self.talk(&mut port, habit).is_ok() {
            self.port = Some(port);
        }
        let report = self.controller.report();
        self.heard.housekeeping = report.other_telemetry;
        self.heard.results = report.results;
        self.heard.faults = report.faults;
        let propagated = self.controller.take_propagated();
        if let Some(judge) = &mut self.judge {
            propagated.iter().for_each(|one| judge.note(one));
            self.heard.offsets = judge.run();
        }
        self.heard.solutions += self.controller.take_solutions().len() as u64;
        *lock(&self.shared.heard) = self.heard;
    }

    fn talk(&mut self, port: &mut SerialPort, habit: Habit) -> Result<(), PortError> {
        let message = lock(&self.shared.message).take();
        if let Some(message) = message {
            self.controller.send(port, &message)?;
            self.heard.commands += 1;
        }
        match habit {
            Habit::Garbage => {
                let bytes: Vec<u8> = (0..GARBAGE_BYTES).map(|_| self.random_byte()).collect();
                ignore_stall(port.write(&bytes, WRITE_TIMEOUT))?;
            }
            Habit::Commands => {
                if let Some(command) = no_op() {
                    self.send_all(port, &vec![command; COMMANDS])?;
                }
            }
            Habit::Hostile => self.send_all(port, &hostile())?,
            Habit::Jumps => self.send_all(port, &[place(34.47, -104.24), place(-34.47, 75.8)])?,
            Habit::WrongChecksums => self.send_wrong(port)?,
            _ => {}
        }
        self.controller.poll(port, self.start.elapsed())?;
        Ok(())
    }

    fn send_all(&mut self, port: &mut SerialPort, messages: &[Message]) -> Result<(), PortError> {
        for message in messages {
            self.controller.send(port, message)?;
            self.heard.commands += 1;
        }
        Ok(())
    }

    fn send_wrong(&mut self, port: &mut SerialPort) -> Result<(), PortError> {
        let packet = no_op().and_then(|command| command.packet(id::ASPECT, 0).ok());
        let Some(mut bytes) = packet.map(|packet| packet.encode()) else {
            return Ok(());
        };
        if let Some(last) = bytes.last_mut() {
            *last ^= 0x01;
        }
        port.write(&bytes, WRITE_TIMEOUT)?;
        self.heard.wrong_checksums += 1;
        Ok(())
    }

    fn random_byte(&mut self) -> u8 {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        (self.random >> 32) as u8
    }
}

fn no_op() -> Option<Message> {
    // Addressed to computer 1.
    AspectCommand::new(0x1000, Vec::new())
        .ok()
        .map(Message::Aspect)
}

/// Values that are each allowed: a camera that does not exist, thresholds that no Sun reaches.
fn hostile() -> Vec<Message> {
    let float = order("set_float", &["22", "1"].map(str::to_owned), Computer::One);
    let whole = [("4", "2"), ("24", "225"), ("17", "720")];
    let whole = whole
        .iter()
        .filter_map(|(parameter, value)| set(parameter, value));
    whole.chain(float.ok()).collect()
}

/// The command that sets a whole number.
fn set(parameter: &str, value: &str) -> Option<Message> {
    order(
        "set_integer",
        &[parameter, value].map(str::to_owned),
        Computer::One,
    )
    .ok()
}

fn place(latitude_deg: f32, longitude_deg: f32) -> Message {
    Message::Gps(GpsFix {
        latitude_deg,
        longitude_deg,
    })
}

/// Garbage that is not accepted is not a loss.
fn ignore_stall(written: Result<(), PortError>) -> Result<(), PortError> {
    match written {
        Err(PortError::Stalled { .. }) => Ok(()),
        written => written,
    }
}
