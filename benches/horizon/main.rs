//! Cost of finding the horizon in a frame: instructions, counted by callgrind, and time. Reading the frame is not included.
//!
//! `cargo bench --bench horizon` prints a line for each scene, without and with the last frame's nadir.

#[path = "../callgrind.rs"]
mod callgrind;

use anyhow::{Context, ensure};
use nalgebra::{Rotation3, UnitVector3};
use solaspect::fits::{self, Compression};
use solaspect::frame::Frame;
use solaspect::horizon::{HorizonSettings, Refraction, Solution, Sphere, solve};
use solaspect::instrument::DirectionCamera;
use solaspect::simulate::earth::{Clouds, EarthConditions, EarthScene};
use solaspect::units::Measured;
use std::hint::black_box;
use std::path::Path;
use std::process::ExitCode;
use std::time::Instant;

/// Environment variable that tells this program to run under callgrind, with the scene's number, 1 if the last nadir is
/// known, and the frames' folder.
const COUNTED_VARIABLE: &str = "SOLASPECT_COUNTED_HORIZON";
const SEED: u64 = 1;
/// Number of frames of a scene; when counting, the first is a warm-up.
const FRAMES: u64 = 4;
/// Number of timings of each frame, of which the fastest counts.
const PASSES: usize = 20;
/// Swing of the gondola from one frame to the next, rad.
const SWING_RAD: f64 = 0.005;

fn scenes() -> [(&'static str, EarthConditions); 3] {
    let clear = EarthConditions::clear;
    let clouds = EarthConditions {
        clouds: Some(Clouds::BRIGHT),
        sun: true,
        ..clear(230_000.0)
    };
    [
        ("38 km, clear", clear(38_000.0)),
        ("230 km, clear", clear(230_000.0)),
        ("230 km, clouds, Sun", clouds),
    ]
}

/// A frame with the prior knowledge of it.
struct Exposure {
    frame: Frame,
    camera: DirectionCamera,
    sphere: Sphere,
    last: UnitVector3<f64>,
}

impl Exposure {
    fn read(folder: &Path, scene: &EarthScene) -> anyhow::Result<Self> {
        let conditions = &scene.conditions;
        let truth = scene.truth();
        let exact = |m| Measured::new(m, 0.0);
        let height = exact(conditions.height_m);
        let sphere = Sphere::earth(height, exact(truth.edge_m), Refraction::None);
        Ok(Self {
            frame: fits::read_frame(&folder.join(format!("{}.fits", scene.number)))?,
            camera: DirectionCamera {
                width_px: conditions.width_px,
                height_px: conditions.height_px,
                lens: conditions.camera,
                body_from_camera: None,
                mask: Vec::new(),
            },
            sphere: sphere.context("a camera above the edge")?,
            last: Rotation3::from_euler_angles(SWING_RAD, 0.0, SWING_RAD) * truth.nadir,
        })
    }

    fn all(folder: &Path, conditions: &EarthConditions) -> anyhow::Result<Vec<Self>> {
        (0..FRAMES)
            .map(|number| Self::read(folder, &conditions.scene(SEED, number)))
            .collect()
    }

    fn solve(&self, known: bool) -> Solution {
        let last = known.then_some(&self.last);
        solve(
            &HorizonSettings::default(),
            &self.frame,
            &self.camera,
            &self.sphere,
            last,
        )
    }

    fn time_ms(&self, known: bool) -> f64 {
        let times = (0..PASSES).map(|_| {
            let start = Instant::now();
            black_box(self.solve(known));
            start.elapsed().as_secs_f64() * 1e3
        });
        times.fold(f64::INFINITY, f64::min)
    }
}

#[inline(never)]
fn counted_horizon(exposure: &Exposure, known: bool) -> Solution {
    exposure.solve(known)
}

fn work_through(counted_as: &str) -> anyhow::Result<()> {
    let parts: Vec<&str> = counted_as.splitn(3, ' ').collect();
    let [scene, known, folder] = parts[..] else {
        anyhow::bail!("{COUNTED_VARIABLE}: expected three values, found {counted_as}");
    };
    let (_, conditions) = &scenes()[scene.parse::<usize>()?];
    let (known, exposures) = (known == "1", Exposure::all(Path::new(folder), conditions)?);
    black_box(exposures[0].solve(known));
    for exposure in &exposures[1..] {
        ensure!(
            counted_horizon(exposure, known).nadir.is_ok(),
            "no horizon is found"
        );
    }
    Ok(())
}

fn main() -> anyhow::Result<ExitCode> {
    if let Ok(counted_as) = std::env::var(COUNTED_VARIABLE) {
        work_through(&counted_as)?;
        return Ok(ExitCode::SUCCESS);
    }
    println!("{:<28}{:>24}{:>12}", "", "million instructions", "ms");
    for (n, (name, conditions)) in scenes().iter().enumerate() {
        let folder = tempfile::tempdir()?;
        for number in 0..FRAMES {
            let path = folder.path().join(format!("{number}.fits"));
            let frame = conditions.scene(SEED, number).frame()?;
            fits::write_frame(&path, &frame, &[], &[], Compression::None)?;
        }
        let exposures = Exposure::all(folder.path(), conditions)?;
        for (known, how) in [(false, "first"), (true, "last one known")] {
            let counted_as = format!("{n} {} {}", u8::from(known), folder.path().display());
            let instructions =
                callgrind::instructions("*counted_horizon*", COUNTED_VARIABLE, &counted_as)?;
            let millions = instructions as f64 / (FRAMES - 1) as f64 / 1e6;
            let ms = exposures.iter().map(|e| e.time_ms(known)).sum::<f64>() / FRAMES as f64;
            println!("{:<28}{millions:>24.2}{ms:>12.2}", format!("{name}, {how}"));
        }
    }
    Ok(ExitCode::SUCCESS)
}
