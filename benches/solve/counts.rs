//! Instructions of a frame, by callgrind.

use crate::flight::{Exposure, Flight};
use anyhow::{Context, bail};
use solaspect::aspect::{self, Mark, MarkScene, Pipeline, Settings, Solution};
use solaspect::fiducial::Detections;
use solaspect::frame::{Cutout, Levels, Mask};
use solaspect::geometry::{Circle, Ellipse};
use solaspect::limb::Limb;
use std::fmt;
use std::fs;
use std::hint::black_box;
use std::process::{Command, Stdio};

/// Tells this program that it is being counted, and under which conditions.
pub const CONDITIONS_VARIABLE: &str = "SOLASPECT_COUNTED_CONDITIONS";

/// What is counted.
pub struct Work {
    pub name: &'static str,
    /// The function that callgrind looks for.
    function: &'static str,
}

/// The pipeline's stages, and the whole frame without and with a prior.
pub const WORKS: [Work; 8] = [
    Work::new("levels", "counted_levels"),
    Work::new("disc", "counted_disc_search"),
    Work::new("limb", "counted_limb"),
    Work::new("cutout", "counted_cutout"),
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
fn counted_levels(pipeline: &Pipeline<'_>) -> Option<Levels> {
    pipeline.levels().ok()
}

#[inline(never)]
fn counted_disc_search(pipeline: &Pipeline<'_>, levels: &Levels) -> Option<Circle> {
    pipeline.find_disc(levels).ok()
}

#[inline(never)]
fn counted_cutout(pipeline: &Pipeline<'_>, levels: &Levels, disc: &Circle) -> Cutout {
    pipeline.cutout(levels, disc)
}

#[inline(never)]
fn counted_limb(
    pipeline: &Pipeline<'_>,
    levels: &Levels,
    cutout: &Cutout,
    disc: &Circle,
) -> Option<Limb> {
    let fit = pipeline.limb_fit(levels, cutout);
    fit.near(&Ellipse::from(*disc), &Mask::none(cutout.region()))
        .ok()
}

#[inline(never)]
fn counted_detection(pipeline: &Pipeline<'_>, cutout: &Cutout, limb: &Limb) -> Detections {
    pipeline.detect(cutout, limb)
}

#[inline(never)]
fn counted_refinement(
    pipeline: &Pipeline<'_>,
    scene: &MarkScene<'_>,
    solution: &Solution,
) -> Vec<Mark> {
    pipeline.place(scene, &solution.marks)
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

/// Does every work on every frame, for callgrind to count: each once before, since what is made once a run is no frame's.
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

/// `None` where a stage fails.
fn by_stages(exposure: &Exposure, flight: &Flight, acquired: &Solution) -> Option<()> {
    let settings = Settings::default();
    let (frame, instrument) = (&exposure.frame, &flight.instrument);
    let pipeline = Pipeline::new(&settings, frame, instrument, flight.expected, None);
    let levels = black_box(counted_levels(&pipeline))?;
    let disc = black_box(counted_disc_search(&pipeline, &levels))?;
    let cutout = black_box(counted_cutout(&pipeline, &levels, &disc));
    let limb = black_box(counted_limb(&pipeline, &levels, &cutout, &disc))?;
    black_box(counted_detection(&pipeline, &cutout, &limb));
    let scene = MarkScene {
        cutout: &cutout,
        limb: &limb,
        mapping: &acquired.mapping.as_ref()?.mapping,
    };
    black_box(counted_refinement(&pipeline, &scene, acquired));
    Some(())
}

/// Mean instructions of a frame, in the order of [`WORKS`].
pub struct Instructions(pub [u64; WORKS.len()]);

impl Instructions {
    /// Runs this program under callgrind, which writes its counts whenever it leaves one of the works' functions.
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

/// The work after which callgrind wrote a dump, by its number, and the dump's total.
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
