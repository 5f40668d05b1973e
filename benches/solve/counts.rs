//! Instructions of a frame, counted by callgrind.

use crate::flight::{Exposure, Flight};
use anyhow::{Context, bail};
use solaspect::aspect::{self, DiscImage, Pipeline, Solution, SolverSettings};
use solaspect::fiducial::{Detections, RefinedMark};
use solaspect::frame::{Frame, Levels};
use solaspect::geometry::Circle;
use solaspect::limb::Limb;
use std::fmt;
use std::fs;
use std::hint::black_box;
use std::process::{Command, Stdio};

/// Environment variable that tells this program to run under callgrind, with the number of the conditions.
pub const CONDITIONS_VARIABLE: &str = "SOLASPECT_COUNTED_CONDITIONS";

/// A task whose instructions are counted.
pub struct Work {
    pub name: &'static str,
    /// Name of the function for callgrind.
    function: &'static str,
}

/// The pipeline's stages, and the whole frame without and with a prior.
pub const WORKS: [Work; 8] = [
    Work::new("levels", "counted_levels"),
    Work::new("disc", "counted_disc_search"),
    Work::new("limb", "counted_limb"),
    Work::new("image", "counted_image"),
    Work::new("detect", "counted_detection"),
    Work::new("refine", "counted_refinement"),
    Work::new("acquiring", "counted_acquiring"),
    Work::new("tracking", "counted_tracking"),
];

impl Work {
    const fn new(name: &'static str, function: &'static str) -> Self {
        Self { name, function }
    }
}

#[inline(never)]
fn counted_levels(pipeline: &Pipeline<'_>, frame: &Frame) -> Option<Levels> {
    pipeline.levels(frame).ok()
}

#[inline(never)]
fn counted_disc_search(pipeline: &Pipeline<'_>, frame: &Frame, levels: &Levels) -> Option<Circle> {
    pipeline.find_disc(frame, levels, None).ok()
}

#[inline(never)]
fn counted_image(
    pipeline: &Pipeline<'_>,
    frame: &Frame,
    levels: &Levels,
    disc: &Circle,
) -> Option<DiscImage> {
    pipeline.image(frame, levels, disc).ok()
}

#[inline(never)]
fn counted_limb(pipeline: &Pipeline<'_>, image: &DiscImage) -> Option<Limb> {
    pipeline.limb(image, &image.cutout.mask).ok()
}

#[inline(never)]
fn counted_detection(pipeline: &Pipeline<'_>, image: &DiscImage) -> Detections {
    pipeline.detect(image)
}

#[inline(never)]
fn counted_refinement(
    pipeline: &Pipeline<'_>,
    image: &DiscImage,
    limb: &Limb,
    solution: &Solution,
) -> Option<Vec<Option<RefinedMark>>> {
    let mapping = solution.mapping.as_ref()?.mapping();
    Some(pipeline.refine(&image.cutout, limb, mapping, &solution.marks))
}

#[inline(never)]
fn counted_acquiring(exposure: &Exposure, flight: &Flight) -> Solution {
    aspect::solve(&exposure.frame, &flight.instrument, flight.expected, None)
}

#[inline(never)]
fn counted_tracking(exposure: &Exposure, flight: &Flight) -> Solution {
    let (frame, prior) = (&exposure.frame, Some(&exposure.prior));
    aspect::solve(frame, &flight.instrument, flight.expected, prior)
}

/// Runs every task on every frame, for callgrind to count. Each task is run once before, so that initialisation is not
/// counted for a frame.
pub fn work_through(flight: &Flight) {
    for exposure in flight.exposures.iter().take(1) {
        let prior = Some(&exposure.prior);
        let (frame, instrument) = (&exposure.frame, &flight.instrument);
        black_box(aspect::solve(frame, instrument, flight.expected, None));
        black_box(aspect::solve(frame, instrument, flight.expected, prior));
    }
    for exposure in &flight.exposures {
        let acquired = black_box(counted_acquiring(exposure, flight));
        black_box(counted_tracking(exposure, flight));
        by_stages(exposure, flight, &acquired);
    }
}

/// `None` if a stage fails.
fn by_stages(exposure: &Exposure, flight: &Flight, acquired: &Solution) -> Option<()> {
    let settings = SolverSettings::default();
    let (frame, instrument) = (&exposure.frame, &flight.instrument);
    let pipeline = Pipeline::new(&settings, instrument, flight.expected);
    let levels = black_box(counted_levels(&pipeline, frame))?;
    let disc = black_box(counted_disc_search(&pipeline, frame, &levels))?;
    let image = black_box(counted_image(&pipeline, frame, &levels, &disc))?;
    let limb = black_box(counted_limb(&pipeline, &image))?;
    black_box(counted_detection(&pipeline, &image));
    black_box(counted_refinement(&pipeline, &image, &limb, acquired));
    Some(())
}

/// Mean instructions of a frame, in the order of [`WORKS`].
pub struct Instructions(pub [u64; WORKS.len()]);

impl Instructions {
    /// Runs this program under callgrind, which writes its counts each time a task's function returns.
    pub fn count(conditions: usize) -> anyhow::Result<Self> {
        let folder = tempfile::tempdir()?;
        let status = Command::new("valgrind")
            .arg("--tool=callgrind")
            .arg("--toggle-collect=*counted_*")
            .args(WORKS.map(|work| format!("--dump-after=*{}*", work.function)))
            .arg(format!(
                "--callgrind-out-file={}/counts",
                folder.path().display()
            ))
            .arg(std::env::current_exe()?)
            .env(CONDITIONS_VARIABLE, conditions.to_string())
            .stderr(Stdio::null())
            .status()
            .context("valgrind does not start")?;
        if !status.success() {
            bail!("valgrind ended with {status}");
        }
        let mut sums = [(0, 0); WORKS.len()];
        for entry in fs::read_dir(folder.path())? {
            let dump = fs::read_to_string(entry?.path())?;
            if let Some((work, instructions)) = work_and_total(&dump) {
                sums[work].0 += instructions;
                sums[work].1 += 1;
            }
        }
        if sums.iter().any(|(_, frames)| *frames == 0) {
            bail!("callgrind did not find every function");
        }
        Ok(Self(sums.map(|(sum, frames)| sum / frames)))
    }
}

/// The number of the task after which callgrind wrote a dump, and the dump's total.
fn work_and_total(dump: &str) -> Option<(usize, u64)> {
    let after = |key: &str| dump.lines().find_map(|line| line.strip_prefix(key));
    let trigger = after("desc: Trigger: --dump-after=")?;
    let work = WORKS
        .iter()
        .position(|work| trigger.contains(work.function))?;
    Some((work, after("totals: ")?.trim().parse().ok()?))
}

impl fmt::Display for Instructions {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0
            .iter()
            .try_for_each(|count| write!(out, "{:>11.0}", *count as f64 / 1e3))
    }
}
