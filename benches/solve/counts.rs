//! Instructions of a frame, by callgrind.

use crate::flight::{Exposure, Flight};
use anyhow::{Context, bail};
use solaspect::aspect::{self, Solution};
use solaspect::frame::Levels;
use solaspect::limb::{self, CoarseDisc};
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

pub const WORKS: [Work; 4] = [
    Work {
        name: "levels",
        function: "counted_levels",
    },
    Work {
        name: "disc search",
        function: "counted_disc_search",
    },
    Work {
        name: "acquiring",
        function: "counted_acquiring",
    },
    Work {
        name: "tracking",
        function: "counted_tracking",
    },
];

#[inline(never)]
fn counted_levels(exposure: &Exposure) -> Option<Levels> {
    limb::levels(&exposure.frame, &limb::Settings::default()).ok()
}

#[inline(never)]
fn counted_disc_search(
    exposure: &Exposure,
    levels: &Levels,
    radius_px: f64,
    mark_px: f64,
) -> Option<CoarseDisc> {
    let (frame, settings) = (&exposure.frame, limb::Settings::default());
    limb::find_disc(frame, frame.region(), levels, radius_px, mark_px, &settings).ok()
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

/// Does every work on every frame, for callgrind to count.
pub fn work_through(flight: &Flight) {
    let instrument = &flight.instrument;
    let scale = instrument.mounting.scale_mil_per_px.value;
    let radius_arcsec = flight.expected.map_or(0.0, |e| e.radius_arcsec);
    let radius_px = instrument.optics.radius_mil(radius_arcsec) / scale;
    let mark_px = instrument.plate.cross.arm_length_mil / scale;
    for exposure in &flight.exposures {
        if let Some(levels) = black_box(counted_levels(exposure)) {
            black_box(counted_disc_search(exposure, &levels, radius_px, mark_px));
        }
        black_box(counted_acquiring(exposure, flight));
        black_box(counted_tracking(exposure, flight));
    }
}

/// Mean instructions of a frame, in the order of [`WORKS`].
pub struct Instructions([u64; WORKS.len()]);

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
            .try_for_each(|count| write!(out, "{:>12.0}", *count as f64 / 1e3))
    }
}
