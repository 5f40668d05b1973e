//! Cost of solving a frame: instructions, counted by callgrind, and time compared with that of copying the frame.
//!
//! `cargo bench --bench solve` prints one table. Instructions are the same in every run of one build and hardly differ
//! between machines of the same kind; times depend on the machine and its load, so the copy is timed in the same run. With
//! `-- --check` the counts are compared with the committed ones, which `-- --renew` writes.

mod baseline;
mod counts;
mod flight;
mod times;

use baseline::Baseline;
use clap::Parser;
use counts::Instructions;
use flight::{CHECKED, CONDITIONS, Flight};
use std::process::ExitCode;

/// Counts what solving a frame costs.
#[derive(Parser)]
struct Arguments {
    /// Refuse counts that have grown by more than 5 %
    #[arg(long, conflicts_with = "renew")]
    check: bool,
    /// Write the counts for later checks
    #[arg(long)]
    renew: bool,
    /// What cargo passes to every bench
    #[arg(long, hide = true)]
    bench: bool,
}

fn main() -> anyhow::Result<ExitCode> {
    // The same allocator settings as in the program.
    solaspect::memory::keep_freed();
    // callgrind runs this same program with the number of the conditions.
    let counted = std::env::var(counts::CONDITIONS_VARIABLE).ok();
    match counted.map(|n| n.parse().map(|n: usize| CONDITIONS.get(n))) {
        None => run(&Arguments::parse())?,
        Some(Ok(Some(conditions))) => counts::work_through(&Flight::under(conditions)),
        Some(_) => {
            eprintln!(
                "{} is not one of the conditions",
                counts::CONDITIONS_VARIABLE
            );
            return Ok(ExitCode::from(2));
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn run(arguments: &Arguments) -> anyhow::Result<()> {
    println!("instructions of a frame, thousands");
    print!("{:<32}", "");
    counts::WORKS
        .iter()
        .for_each(|work| print!("{:>11}", work.name));
    println!();
    let known = match arguments.check {
        true => Some(Baseline::read()?),
        false => None,
    };
    let mut counted = Baseline::empty();
    let mut grown = Vec::new();
    let shown = if arguments.check {
        CHECKED
    } else {
        CONDITIONS.len()
    };
    for (n, conditions) in CONDITIONS.iter().enumerate().take(shown) {
        let instructions = Instructions::count(n)?;
        println!("{:<32}{instructions}", conditions.name);
        counted.add(conditions.name, &instructions);
        let checked = known
            .as_ref()
            .map(|b| b.check(conditions.name, &instructions));
        grown.extend(checked.and_then(Result::err));
    }
    if arguments.renew {
        counted.write()?;
    }
    if let Some(grown) = grown.into_iter().next() {
        return Err(grown);
    }
    if !arguments.check {
        print_times();
    }
    Ok(())
}

fn print_times() {
    println!("\ntime of a frame, us, and its ratio to copying the frame");
    println!(
        "{:<32}{:>12}{:>20}{:>20}",
        "", "copying", "acquiring", "tracking"
    );
    for conditions in &CONDITIONS {
        println!(
            "{:<32}{}",
            conditions.name,
            times::measure(&Flight::under(conditions))
        );
    }
}
