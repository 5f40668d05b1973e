//! The command's output, and its speed.

use super::flight::troubled;
use super::image_options::WITH_FIELD;
use super::lists::*;
use solaspect::events::{Files, place_photons};
use std::fs;
use std::time::Instant;

/// Peak memory of this process, MB.
fn peak_mb() -> f64 {
    let status = fs::read_to_string("/proc/self/status").unwrap();
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:"))
        .unwrap();
    line.trim()
        .trim_end_matches(" kB")
        .trim()
        .parse::<f64>()
        .unwrap()
        / 1024.0
}

/// Prints speed and memory: `cargo test --test promises -- --ignored --nocapture ten_million`.
#[test]
#[ignore = "measures ten million photons, which takes a minute"]
fn ten_million_photons_take_less_than_a_minute_and_no_more_memory_than_few() {
    let bench = Bench::new(&troubled());
    let run = |photons: &[[f64; 4]]| {
        write(
            &bench.at("in.fits"),
            &[],
            &[event_table(photons), good_times("GTI", &[[0.0, 60.0]])],
        );
    };
    run(&some_photons(10_000_000, 1));
    fs::write(bench.at("det.toml"), WITH_FIELD).unwrap();
    let request = bench.request();
    let files = Files {
        refined: bench.folder.path(),
        events: &bench.at("in.fits"),
        detectors: &bench.at("det.toml"),
        out: None,
        image: Some(&request),
    };
    let start = Instant::now();
    place_photons(files, &()).unwrap();
    let seconds = start.elapsed().as_secs_f64();
    println!("an image of them in {seconds:.1} s");
    assert!(seconds < 60.0, "{seconds} s");
    // The list was made in this process; reset the peak, so that only the run itself counts.
    fs::write("/proc/self/clear_refs", "5").unwrap();
    let (before_mb, start) = (peak_mb(), Instant::now());
    let placed = bench.place("in.fits", PLAIN, &()).unwrap();
    let (seconds, grown_mb) = (start.elapsed().as_secs_f64(), peak_mb() - before_mb);
    println!(
        "{} photons in {seconds:.1} s, {grown_mb:.1} MB",
        placed.photons
    );
    assert!(
        seconds < 60.0 && grown_mb < 64.0,
        "{seconds} s, {grown_mb} MB"
    );
}

#[test]
fn the_command_says_how_many_photons_are_valid_and_why_the_others_are_not() {
    let bench = Bench::new(&troubled());
    let photons: Vec<[f64; 4]> = (0..60).map(|n| [n as f64 + 0.4, 0.0, 0.0, 1.0]).collect();
    write(
        &bench.at("in.fits"),
        &[],
        &[event_table(&photons), good_times("GTI", &[[0.0, 60.0]])],
    );
    fs::write(bench.at("det.toml"), PLAIN).unwrap();
    let run = |events: &str| {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_solaspect"));
        command.current_dir(bench.folder.path());
        command.args([
            "events",
            ".",
            events,
            "--detectors",
            "det.toml",
            "--out",
            "out.fits",
        ]);
        command.output().unwrap()
    };
    let output = run("in.fits");
    let text = String::from_utf8(output.stdout).unwrap();
    assert_eq!(output.status.code(), Some(0), "{text}");
    for line in [
        "60 photons, ",
        " not valid: gap",
        " not valid: slew",
        "GTI: 60.000 s, ",
    ] {
        assert!(text.contains(line), "{text}");
    }
    let output = run("none.fits");
    assert_eq!(output.status.code(), Some(1));
    assert!(
        String::from_utf8(output.stderr)
            .unwrap()
            .contains("none.fits: expected")
    );
}
