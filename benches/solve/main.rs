//! What solving a frame costs: instructions, counted by callgrind, and time beside that of copying the frame.
//!
//! `cargo bench` prints one table. Instructions are the same in every run of one build and hardly differ between
//! machines of one kind; times are this machine's, now, which is why the copy is timed in the same run.

mod counts;
mod flight;
mod times;

use counts::Instructions;
use flight::{CONDITIONS, Flight};
use std::process::ExitCode;

fn main() -> ExitCode {
    // callgrind runs this very program with the number of the conditions.
    let counted = std::env::var(counts::CONDITIONS_VARIABLE).ok();
    match counted.map(|n| n.parse().map(|n: usize| CONDITIONS.get(n))) {
        None => table(),
        Some(Ok(Some(conditions))) => counts::work_through(&Flight::under(conditions)),
        Some(_) => {
            eprintln!(
                "{} is not one of the conditions",
                counts::CONDITIONS_VARIABLE
            );
            return ExitCode::from(2);
        }
    }
    ExitCode::SUCCESS
}

fn table() {
    println!("instructions of a frame, thousands");
    print!("{:<28}", "");
    counts::WORKS
        .iter()
        .for_each(|work| print!("{:>12}", work.name));
    println!();
    for (n, conditions) in CONDITIONS.iter().enumerate() {
        match Instructions::count(n) {
            Ok(instructions) => println!("{:<28}{instructions}", conditions.name),
            Err(error) => println!("{:<28}not counted: {error}", conditions.name),
        }
    }
    println!("\ntime of a frame, us, and its ratio to copying the frame");
    println!(
        "{:<28}{:>12}{:>20}{:>20}",
        "", "copying", "acquiring", "tracking"
    );
    for conditions in &CONDITIONS {
        println!(
            "{:<28}{}",
            conditions.name,
            times::measure(&Flight::under(conditions))
        );
    }
}
