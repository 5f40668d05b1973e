//! The whole service at full rate: frames drawn beforehand, the real solver, archive and line, a controller at the other
//! end of a pseudo-terminal. Exit code 0 only if nothing was lost, and memory stayed below its limit and flat.

mod camera;
mod machine;

use camera::RingCamera;
use clap::Parser;
use machine::MemoryLog;
use solaspect::archive::Store;
use solaspect::fits::Compression;
use solaspect::instrument;
use solaspect::link::{Connection, SerialPort};
use solaspect::service::{Camera, Flight, FlightTally, Service};
use solaspect::simulate::Depth;
use solaspect::simulate::controller::{Controller, Report};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// Resident memory that the service may take, beside the frames that its camera has drawn.
const MOST_BYTES: f64 = 200e6;
/// Growth per frame that is taken for a leak.
const LEAK_BYTES_PER_FRAME: f64 = 500.0;
/// Runs shorter than this do not tell a leak from the rest.
const LEAK_SHOWS: Duration = Duration::from_secs(240);
/// Files that stay on each disk unless all are to be kept.
const KEPT_FILES: usize = 500;

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
    /// The archive's folders [default: one temporary folder]
    #[arg(long, value_delimiter = ',')]
    archive: Vec<PathBuf>,
    /// Keep every file; otherwise older ones are removed as the run goes on
    #[arg(long)]
    keep: bool,
}

fn main() -> anyhow::Result<ExitCode> {
    let args = Args::parse();
    let temporary = tempfile::tempdir()?;
    let roots = match args.archive.is_empty() {
        true => vec![temporary.path().to_path_buf()],
        false => args.archive.clone(),
    };
    let run = fly(&args, &roots)?;
    Ok(match report(&args, &run) {
        0 => ExitCode::SUCCESS,
        _ => ExitCode::FAILURE,
    })
}

struct Run {
    tally: FlightTally,
    heard: Report,
    memory: MemoryLog,
    drawn_bytes: f64,
    processor: Duration,
}

fn fly(args: &Args, roots: &[PathBuf]) -> anyhow::Result<Run> {
    let instrument = instrument::builtin("demo")?;
    let depth = match args.bits.as_str() {
        "12" => Depth::Twelve,
        _ => Depth::Eight,
    };
    let duration = Duration::from_secs(args.seconds);
    let camera = RingCamera::new(&instrument, depth, args.rate, duration)?;
    let drawn_bytes = camera.drawn_bytes();
    let stores = roots
        .iter()
        .map(|root| Store::open(root, &instrument.name, Compression::Rice))
        .collect::<Result<_, _>>()?;
    let (near, mut far) = SerialPort::pair()?;
    let over = Arc::new(AtomicBool::new(false));
    let ends = Arc::clone(&over);
    let controller = thread::spawn(move || {
        let mut controller = Controller::new();
        let report = controller.run(&mut far, || ends.load(Ordering::Relaxed), |_| {});
        // The port goes back with the report: hanging up first is the service's part.
        report.cloned().map(|report| (report, far))
    });
    let flight = Flight {
        line: Connection::over(near),
        stores,
        ..Flight::of(Camera::new(instrument, camera))
    };
    let before = machine::processor_time()?;
    let service = Service::start(flight)?;
    let (mut memory, mut processor) = (MemoryLog::new(), Duration::ZERO);
    let mut noted = Instant::now();
    while !service.is_finished() {
        thread::sleep(Duration::from_millis(20));
        if noted.elapsed() >= Duration::from_secs(1) {
            noted = Instant::now();
            memory.note()?;
            processor = machine::processor_time()?.saturating_sub(before);
            if !args.keep {
                roots.iter().try_for_each(|root| clear(root))?;
            }
        }
    }
    over.store(true, Ordering::Relaxed);
    let controller = controller.join();
    let tally = service.join()?;
    let (heard, _far) = controller.map_err(|_| anyhow::anyhow!("the controller failed"))??;
    Ok(Run {
        tally,
        heard,
        memory,
        drawn_bytes,
        processor,
    })
}

/// Removes all but the newest files of an archive.
fn clear(root: &Path) -> anyhow::Result<()> {
    let mut files = Vec::new();
    for folder in fs::read_dir(root)? {
        let folder = folder?.path();
        let is_hour = folder.is_dir() && !folder.join("format").exists();
        if is_hour {
            for file in fs::read_dir(folder)? {
                let file = file?.path();
                files.extend(
                    file.extension()
                        .is_some_and(|e| e == "fits")
                        .then_some(file),
                );
            }
        }
    }
    files.sort();
    let old = files.len().saturating_sub(KEPT_FILES);
    Ok(files[..old].iter().try_for_each(fs::remove_file)?)
}

/// Prints what the run came to, and returns how many things were wrong.
fn report(args: &Args, run: &Run) -> u64 {
    let tally = &run.tally;
    println!("{tally}");
    let frames = tally.camera.taken;
    let expected = (args.seconds as f64 * args.rate).round() as u64;
    let heard = &run.heard;
    println!(
        "received   {} solutions, {} faults",
        heard.solutions.len(),
        heard.faults.total()
    );
    let cpu_ms = 1e3 * run.processor.as_secs_f64() / frames as f64;
    println!("processor  {cpu_ms:.2} ms a frame, camera and controller included");
    let largest = run.memory.largest_bytes() - run.drawn_bytes;
    println!(
        "memory     {:.1} MB at most, beside the {:.1} MB of drawn frames",
        largest / 1e6,
        run.drawn_bytes / 1e6
    );
    let growth = run.memory.growth_bytes_per_s().map(|g| g / args.rate);
    if let Some(growth) = growth {
        println!("           {growth:.0} bytes more with every frame");
    }
    let long = args.seconds >= LEAK_SHOWS.as_secs();
    let leaks = long && growth.is_none_or(|growth| growth > LEAK_BYTES_PER_FRAME);
    let wrong = [
        ("frames not taken", expected.abs_diff(frames)),
        ("lost", tally.lost()),
        ("not stored", frames.abs_diff(tally.archive.stored)),
        ("faults of the line", heard.faults.total()),
        (
            "solutions not received",
            tally.line.solutions.abs_diff(heard.solutions.len() as u64),
        ),
        ("no solutions", u64::from(heard.solutions.is_empty())),
        ("too much memory", u64::from(largest > MOST_BYTES)),
        ("a leak", u64::from(leaks)),
    ];
    for (what, count) in wrong.iter().filter(|(_, count)| *count > 0) {
        println!("WRONG      {what}: {count}");
    }
    wrong.iter().map(|(_, count)| count).sum()
}
