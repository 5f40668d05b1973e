//! The whole service at full rate: frames drawn in advance, the real solver, archive and line, a controller at the other
//! end of a pseudo-terminal, and optionally a series of faults. Exit code 0 only if the losses are within the faults'
//! allowed cost, and memory stayed constant and below its limit.

mod camera;
mod faults;
mod files;
mod judge;
mod line;
mod machine;
mod navigation;
mod outputs;
mod report;
mod rig;
mod schedule;
mod stderr;

use camera::Ring;
use clap::Parser;
use faults::Fault;
use jiff::Timestamp;
use judge::Trial;
use report::{RollRun, Run, Trials};
use rig::{Parts, Rig, RollParts};
use schedule::{REST, Schedule};
use solaspect::config::{Config, Outputs};
use solaspect::instrument::{self, MountedCamera};
use solaspect::log;
use solaspect::simulate::Depth;
use std::fs;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::{Duration, Instant};
use stderr::Stderr;

/// Fly the whole service at full rate, and judge what was lost and what memory grew
#[derive(Debug, Parser)]
struct Args {
    /// Length of the run, s
    #[arg(long, default_value_t = 600)]
    seconds: u64,
    /// Frames per second
    #[arg(long, default_value_t = 26.0)]
    rate: f64,
    /// Bits of a pixel
    #[arg(long, default_value = "8", value_parser = ["8", "12"])]
    bits: String,
    /// The archive's folders; each run makes its own in them [default: one temporary folder, two with --faults]
    #[arg(long, value_delimiter = ',')]
    archive: Vec<PathBuf>,
    /// Keep every file; otherwise older ones are removed as the run goes on
    #[arg(long)]
    keep: bool,
    /// A second camera of the same rate, 1920 x 1080 px, that sees the horizon
    #[arg(long)]
    roll: bool,
    /// The navigation filter flies, too: IMU at 100 Hz on the controller's line, GPS, offsets by the gyros at 20 Hz; the Sun rests on the plate
    #[arg(long)]
    navigation: bool,
    /// Measure what outputs of all kinds cost the controller's line: short flights with and without them in turns
    #[arg(long, conflicts_with_all = ["archive", "keep", "roll", "navigation", "faults", "log"])]
    outputs: bool,
    /// Real-time priority of the real-time threads; needs CAP_SYS_NICE
    #[arg(long)]
    realtime: Option<u8>,
    /// Inject faults, one after the other: all, or those named
    #[arg(long, value_enum, value_name = "FAULT", value_delimiter = ',', num_args = 0.., require_equals = true)]
    faults: Option<Vec<Fault>>,
    /// With --faults, the file that the program's log goes to
    #[arg(long)]
    log: Option<PathBuf>,
}

fn main() -> anyhow::Result<ExitCode> {
    let args = Args::parse();
    if args.outputs {
        return compare_outputs(&args);
    }
    let faults = match &args.faults {
        None => Vec::new(),
        Some(named) if named.is_empty() => Fault::all(args.navigation),
        Some(named) => named.clone(),
    };
    let schedule = Schedule::new(faults, Duration::from_secs(args.seconds))?;
    let temporary = tempfile::tempdir()?;
    let start = Timestamp::now().strftime("soak-%Y%m%dT%H%M%S");
    let mut roots = args.archive.clone();
    if roots.is_empty() {
        let disks = 1 + usize::from(args.faults.is_some());
        roots = (1..=disks)
            .map(|n| temporary.path().join(format!("disk-{n}")))
            .collect();
    }
    // A flight does not create folders above its archive, which could be on the wrong disk.
    roots.iter().try_for_each(fs::create_dir_all)?;
    let roots = roots
        .iter()
        .map(|root| root.join(start.to_string()))
        .collect();
    let values = temporary.path().join("values");
    fs::create_dir(&values)?;
    let run = fly(&args, &schedule, roots, values)?;
    Ok(match run.report() {
        0 => ExitCode::SUCCESS,
        _ => ExitCode::FAILURE,
    })
}

impl Args {
    fn depth(&self) -> Depth {
        match self.bits.as_str() {
            "12" => Depth::Twelve,
            _ => Depth::Eight,
        }
    }
}

fn compare_outputs(args: &Args) -> anyhow::Result<ExitCode> {
    let instrument = instrument::builtin("demo")?;
    let course = navigation::swaying(&instrument, Timestamp::now())?;
    let ring = Ring::new(&instrument, course, args.depth(), args.rate, outputs::LEG)?;
    let flights = outputs::Flights {
        instrument,
        ring,
        rate_hz: args.rate,
        realtime: args.realtime,
    };
    Ok(match flights.compare(Duration::from_secs(args.seconds))? {
        true => ExitCode::SUCCESS,
        false => ExitCode::FAILURE,
    })
}

fn fly(
    args: &Args,
    schedule: &Schedule,
    roots: Vec<PathBuf>,
    values: PathBuf,
) -> anyhow::Result<Run> {
    let instrument = instrument::builtin("demo")?;
    let duration = Duration::from_secs(args.seconds);
    let now = Timestamp::now();
    let course = match args.navigation {
        true => navigation::resting(),
        false => navigation::swaying(&instrument, now)?,
    };
    let ring = Ring::new(&instrument, course, args.depth(), args.rate, duration)?;
    let roll = args.roll.then(|| roll_parts(args.rate, duration));
    let roll = roll.transpose()?;
    let roll_ring = roll.as_ref().map(|roll| Arc::clone(&roll.ring));
    let rings = [Some(&ring), roll_ring.as_deref()];
    let frame_bytes: f64 = rings.iter().flatten().map(|ring| ring.frame_bytes()).sum();
    let queue_bytes = Config::default().archive.queue_frames as f64 * frame_bytes;
    let roll_drawn_bytes = roll_ring.as_ref().map_or(0.0, |ring| ring.drawn_bytes());
    let (stderr, _log) = match args.faults {
        Some(_) => (
            Some(Stderr::capture(args.log.as_deref())?),
            Some(log::start(2, log::Format::Text)?),
        ),
        None => (None, None),
    };
    let before = machine::processor_times()?;
    let start = Instant::now();
    // The sensors start to send.
    let navigation = args
        .navigation
        .then(|| navigation::Parts::new(&instrument, now));
    let navigation = navigation.transpose()?;
    let rig = Rig::start(Parts {
        ring,
        instrument: instrument.clone(),
        roll,
        navigation,
        realtime: args.realtime,
        outputs: Outputs::default(),
        roots,
        values,
        keep: args.keep,
        rate_hz: args.rate,
        stderr,
    })?;
    let trials = inject(&rig, schedule, start)?;
    let quiet = args.faults.is_none();
    while !rig.service.is_finished() {
        rig.check(quiet)?;
    }
    let mut processor = rig.processor();
    for (thread, used) in &mut processor {
        *used = used.saturating_sub(before.get(thread).copied().unwrap_or_default());
    }
    let (frames, drawn_bytes, due) = (
        rig.ring().frames(),
        rig.ring().drawn_bytes(),
        rig.ring().end(),
    );
    let (heard, _far) = rig.gondola.end();
    let tally = rig.service.join()?;
    let mut files = rig.files.into_inner();
    let roll_in_files = rig.roll_files.into_inner();
    let roll_in_files = roll_in_files.map(|mut files| files.count()).transpose()?;
    let roll = roll_ring
        .zip(roll_in_files)
        .map(|(ring, in_files)| RollRun {
            due: ring.end(),
            frames: ring.frames(),
            in_files,
        });
    let drawn_bytes = drawn_bytes + roll_drawn_bytes;
    Ok(Run {
        roll,
        navigates: args.navigation,
        realtime: args.realtime,
        seconds: args.seconds,
        due,
        frames,
        tally,
        heard,
        trials,
        rows: files.rows()?,
        in_files: files.count()?,
        memory: rig.memory.into_inner(),
        drawn_bytes,
        queue_bytes,
        processor,
    })
}

fn roll_parts(rate_hz: f64, duration: Duration) -> anyhow::Result<RollParts> {
    const CAMERA: &str = include_str!("roll_camera.toml");
    let camera = MountedCamera::parse("roll_camera.toml".as_ref(), CAMERA)?;
    let ring = Ring::of_horizon(&camera, rate_hz, duration)?;
    Ok(RollParts {
        ring: Arc::new(ring),
        camera,
    })
}

/// Injects every fault of the schedule.
fn inject(rig: &Rig, schedule: &Schedule, start: Instant) -> anyhow::Result<Trials> {
    let mut trials = Trials::default();
    for (at, fault) in schedule.times() {
        if trials.injected == 0 {
            trials.head();
        }
        rig.wait_until(start + at)?;
        if rig.service.is_finished() {
            report::say("the service has ended");
            break;
        }
        let trial = Trial::run(rig, fault, REST)?;
        trials.add(at, &trial, rig.rate_hz);
    }
    Ok(trials)
}
