//! Instructions of a frame, by callgrind.

use crate::flight::{Exposure, Flight};
use crate::stages::Stages;
use anyhow::{Context, bail};
use solaspect::aspect::{self, Solution};
use solaspect::fiducial::{Detections, FlatDisc};
use solaspect::frame::{Cutout, Levels};
use solaspect::geometry::Ellipse;
use solaspect::limb::{self, CoarseDisc, Limb};
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

/// Stages, each on its own with what it needs from the others, and the whole frame without and with a prior.
pub const WORKS: [Work; 8] = [
    Work::new("levels", "counted_levels"),
    Work::new("disc", "counted_disc_search"),
    Work::new("limb", "counted_limb"),
    Work::new("flatten", "counted_flattening"),
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
fn counted_levels(exposure: &Exposure) -> Option<Levels> {
    limb::levels(&exposure.frame, &limb::Settings::default()).ok()
}

#[inline(never)]
fn counted_disc_search(stages: &Stages<'_>) -> Option<CoarseDisc> {
    stages.disc()
}

#[inline(never)]
fn counted_limb(stages: &Stages<'_>, start: &Ellipse) -> Option<Limb> {
    stages.limb(start)
}

#[inline(never)]
fn counted_flattening(stages: &Stages<'_>, cutout: &Cutout, limb: &Limb) -> Option<FlatDisc> {
    stages.flat(cutout, limb)
}

#[inline(never)]
fn counted_detection(stages: &Stages<'_>, flat: &FlatDisc) -> Detections {
    stages.detections(flat)
}

#[inline(never)]
fn counted_refinement(
    stages: &Stages<'_>,
    cutout: &Cutout,
    limb: &Limb,
    solution: &Solution,
) -> usize {
    stages.refined(cutout, limb, solution)
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
    let levels = black_box(counted_levels(exposure))?;
    let stages = Stages {
        frame: &exposure.frame,
        flight,
        levels,
    };
    let disc = black_box(counted_disc_search(&stages))?;
    let start = Ellipse::from(disc.circle());
    let limb = black_box(counted_limb(&stages, &start))?;
    let cutout = stages.cutout(&limb)?;
    let flat = black_box(counted_flattening(&stages, &cutout, &limb))?;
    black_box(counted_detection(&stages, &flat));
    black_box(counted_refinement(&stages, &cutout, &limb, acquired));
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
