//! Cost of archiving a frame: time, processor time, instructions and bytes, compared with `fpack` on the same frames.
//!
//! `cargo bench --bench archive` prints a table for each kind of frame. All tasks take turns over the same frames, so that
//! other load on the machine affects all of them.

#[path = "../callgrind.rs"]
mod callgrind;
mod cost;
mod counts;
mod frames;
mod work;

use clap::Parser;
use cost::Cost;
use frames::{CONDITIONS, Conditions, Solved};
use solaspect::fits::{Compression, Packing};
use std::path::{Path, PathBuf};
use work::Work;

const FRAMES: u64 = 12;
const PASSES: usize = 9;

/// Measures what archiving a frame costs.
#[derive(Parser)]
struct Arguments {
    /// Folder on the disk that is measured
    #[arg(long, default_value = env!("CARGO_TARGET_TMPDIR"))]
    dir: PathBuf,
    /// Do not count instructions, which takes a minute
    #[arg(long)]
    times_only: bool,
    /// What cargo passes to every bench
    #[arg(long, hide = true)]
    bench: bool,
}

fn main() -> anyhow::Result<()> {
    // callgrind runs this same program.
    if let Ok(counted_as) = std::env::var(counts::COUNTED_VARIABLE) {
        return counts::work_through(&counted_as);
    }
    let arguments = Arguments::parse();
    let fpack = work::fpack_version();
    let noted = fpack.as_deref();
    println!(
        "fpack: {}\n",
        noted.unwrap_or("not found, so not measured (Debian: libcfitsio-bin)")
    );
    for (n, conditions) in CONDITIONS.iter().enumerate() {
        let frames = frames::solved(conditions, FRAMES)?;
        let works = Work::ALL
            .into_iter()
            .filter(|work| fpack.is_some() || !work.is_foreign());
        let costs = measure(&frames, works.collect(), &arguments.dir)?;
        print_table(n, conditions, &frames, &costs, arguments.times_only);
    }
    Ok(())
}

fn measure(
    frames: &[Solved],
    works: Vec<Work>,
    folder: &Path,
) -> anyhow::Result<Vec<(Work, Cost)>> {
    let mut costs: Vec<_> = works
        .into_iter()
        .map(|work| (work, Cost::default()))
        .collect();
    for _ in 0..PASSES {
        for (work, cost) in &mut costs {
            work.pass(frames, folder, cost)?;
        }
    }
    Ok(costs)
}

fn print_table(
    n: usize,
    conditions: &Conditions,
    frames: &[Solved],
    costs: &[(Work, Cost)],
    times_only: bool,
) {
    let pixel_bytes: usize = frames.iter().map(Solved::pixel_bytes).sum();
    let megabytes = pixel_bytes as f64 / frames.len() as f64 / 1e6;
    let plain = costs
        .iter()
        .find(|(work, _)| work.name() == "encode" && work.compression() == Compression::None)
        .map_or(0, |(_, cost)| cost.file_bytes);
    println!("### {}, {megabytes:.2} MB of pixels\n", conditions.name);
    println!("| work | compression | frames/s | MB/s | ms | CPU ms | ratio | 10^6 instructions |");
    println!("|---|---|---:|---:|---:|---:|---:|---:|");
    for (place, (work, cost)) in costs.iter().enumerate() {
        let seconds = cost.wall().as_secs_f64();
        let instructions = match work {
            Work::Encode(Packing { threads: 1, .. }) | Work::Decode(_) if !times_only => {
                instructions(n, place)
            }
            _ => String::new(),
        };
        println!(
            "| {} | {} | {:.0} | {:.0} | {:.2} | {:.2} | {:.2} | {instructions} |",
            work.name(),
            work.compression().name(),
            1.0 / seconds,
            megabytes / seconds,
            1e3 * seconds,
            1e3 * cost.processor().as_secs_f64(),
            plain as f64 / cost.file_bytes as f64,
        );
    }
    println!();
}

fn instructions(n: usize, work: usize) -> String {
    match counts::count(n, work) {
        Ok(count) => format!("{:.1}", count as f64 / 1e6),
        Err(error) => format!("not counted: {error}"),
    }
}
