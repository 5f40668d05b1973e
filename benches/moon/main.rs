//! Cost of finding the Moon in a frame: instructions, counted by callgrind, and time. Reading the frame is not included.
//!
//! `cargo bench --bench moon` prints a line for each radius, with radius and phase known and without.

#[path = "../callgrind.rs"]
mod callgrind;

use anyhow::{Context, ensure};
use solaspect::frame::Frame;
use solaspect::moon::{Disc, Expected, MoonSettings, Radius, Stopped, solve};
use solaspect::simulate::moon::MoonConditions;
use solaspect::units::Measured;
use std::hint::black_box;
use std::process::ExitCode;
use std::time::Instant;

/// Environment variable that tells this program to run under callgrind, with the radius, px, and the prior knowledge.
const COUNTED_VARIABLE: &str = "SOLASPECT_COUNTED_MOON";
const KNOWN: &str = "known";
const SEED: u64 = 1;
const FRAMES: u64 = 10;
/// Number of timings of each frame, of which the fastest counts.
const PASSES: usize = 20;

/// Frames of 720 x 578 px, with the prior knowledge of each.
fn exposures(radius_px: f64, known: &str) -> anyhow::Result<Vec<(Frame, Expected)>> {
    let conditions = MoonConditions::clear(radius_px);
    (0..FRAMES)
        .map(|number| {
            let scene = conditions.scene(SEED, number);
            let expected = match known {
                KNOWN => Expected {
                    radius: Some(Radius::Pixels(Measured::new(radius_px, 3e-3 * radius_px))),
                    phase_angle_deg: Some(Measured::new(scene.phase_angle_deg, 0.1)),
                    bright_limb_deg: None,
                },
                _ => Expected::default(),
            };
            Ok((scene.frame()?, expected))
        })
        .collect()
}

#[inline(never)]
fn counted_moon(frame: &Frame, expected: &Expected) -> Result<Disc, Stopped> {
    solve(&MoonSettings::default(), frame, expected)
}

fn time_ms((frame, expected): &(Frame, Expected)) -> f64 {
    let times = (0..PASSES).map(|_| {
        let start = Instant::now();
        let _ = black_box(counted_moon(frame, expected));
        start.elapsed().as_secs_f64() * 1e3
    });
    times.fold(f64::INFINITY, f64::min)
}

fn main() -> anyhow::Result<ExitCode> {
    if let Ok(counted_as) = std::env::var(COUNTED_VARIABLE) {
        let (radius, known) = counted_as
            .split_once(' ')
            .context("a radius and what is known")?;
        for (frame, expected) in exposures(radius.parse()?, known)? {
            ensure!(
                black_box(counted_moon(&frame, &expected)).is_ok(),
                "no Moon is found"
            );
        }
        return Ok(ExitCode::SUCCESS);
    }
    println!("{:<28}{:>24}{:>12}", "", "million instructions", "ms");
    for radius_px in [15.0, 227.0] {
        for known in [KNOWN, "nothing known"] {
            let counted_as = format!("{radius_px} {known}");
            let instructions =
                callgrind::instructions("*counted_moon*", COUNTED_VARIABLE, &counted_as)?;
            let millions = instructions as f64 / FRAMES as f64 / 1e6;
            let ms = exposures(radius_px, known)?
                .iter()
                .map(time_ms)
                .sum::<f64>()
                / FRAMES as f64;
            println!(
                "{:<28}{millions:>24.2}{ms:>12.2}",
                format!("{radius_px} px, {known}")
            );
        }
    }
    Ok(ExitCode::SUCCESS)
}
