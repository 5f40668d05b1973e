//! Flags of frames that differ from the others.

use super::disc::PlateDisc;
use super::flags::{FrameFlag, FrameFlags};
use super::frames::Frame;
use super::mapping::MarkUse;
use super::suns::{Flight, Suns};
use crate::estimation::median;
use crate::units::Measured;
use rayon::prelude::*;

/// Deviations beyond this multiple of the flight's median scatter are flagged.
const UNUSUAL_SIGMAS: f64 = 8.0;
/// Smaller deviations of the radius are not flagged, relative.
const LEAST_UNUSUAL_RADIUS: f64 = 1e-3;
/// A limb is flagged if its scatter exceeds the median by this factor.
const UNUSUAL_SCATTER: f64 = 2.0;
/// Light or noise that differs by more than this factor from the frames before and after is flagged.
const UNUSUAL_LIGHT: f64 = 1.3;
const UNUSUAL_NOISE: f64 = 1.6;
/// Frames to each side for that median.
const NEIGHBOURS: usize = 20;
/// Frames with fewer marks than this part of the illuminated ones are flagged.
const UNUSUAL_MARKS: f64 = 0.5;

/// Median values of a flight.
struct Medians {
    scatter: f64,
    /// Each dated frame's light and noise, relative to the frames before and after.
    light: Vec<Option<f64>>,
    noise: Vec<Option<f64>>,
}

/// The flags of each of some dated frames; empty without a mapping of the flight.
pub(super) fn outliers(flight: &Flight, suns: &Suns, of: &[usize]) -> Vec<FrameFlags> {
    if flight.mapping.is_none() {
        return vec![FrameFlags::default(); of.len()];
    }
    let discs = suns.discs.iter().flatten();
    let scatter = median(discs.map(|mapped| mapped.disc.scatter));
    let medians = Medians {
        scatter: scatter.map_or(1.0, |scatter| scatter.max(1.0)),
        light: relative(flight, suns, |levels| levels[2] - levels[0]),
        noise: relative(flight, suns, |levels| levels[1]),
    };
    of.par_iter()
        .map(|n| flags(flight, suns, *n, &medians))
        .collect()
}

fn flags(flight: &Flight, suns: &Suns, n: usize, medians: &Medians) -> FrameFlags {
    let frame = &flight.frames[n];
    let of_disc = suns.discs[n].iter().flat_map(|mapped| {
        let disc = &mapped.disc;
        let exceeds = |value: Option<f64>, most: f64| value.is_some_and(|value| value > most);
        let light = medians.light[n].map(|light| light.max(1.0 / light));
        let few = f64::from(frame.marks) < UNUSUAL_MARKS * lit_marks(flight, disc);
        [
            is_unusual_radius(frame, disc, suns.radius_ratio).then_some(FrameFlag::Radius),
            (disc.scatter > UNUSUAL_SCATTER * medians.scatter).then_some(FrameFlag::Limb),
            few.then_some(FrameFlag::FewMarks),
            exceeds(light, UNUSUAL_LIGHT).then_some(FrameFlag::Light),
            exceeds(medians.noise[n], UNUSUAL_NOISE).then_some(FrameFlag::Noise),
        ]
    });
    let mark_use = flight.mapping.as_ref().map(|mapping| mapping.mark_use[n]);
    let of_marks = match mark_use {
        Some(MarkUse::Displaced) => Some(FrameFlag::PlateMoved),
        Some(MarkUse::WrongIds) => Some(FrameFlag::WrongIds),
        Some(MarkUse::Agrees | MarkUse::Unmarked) | None => None,
    };
    of_disc.flatten().chain(of_marks).collect()
}

/// A quantity of each dated frame's levels, relative to its median over the neighbouring frames that have a disc.
fn relative(flight: &Flight, suns: &Suns, value: impl Fn(&[f64; 3]) -> f64) -> Vec<Option<f64>> {
    let lit: Vec<(usize, f64)> = (0..flight.frames.len())
        .filter(|n| suns.discs[*n].is_some())
        .filter_map(|n| Some((n, value(&flight.frames[n].levels_dn?.map(f64::from)))))
        .collect();
    let mut ratios = vec![None; flight.frames.len()];
    for (k, (n, value)) in lit.iter().enumerate() {
        let near = &lit[k.saturating_sub(NEIGHBOURS)..lit.len().min(k + NEIGHBOURS + 1)];
        let middle = median(near.iter().map(|(_, value)| value));
        ratios[*n] = middle
            .filter(|middle| *middle > 0.0)
            .map(|middle| value / middle);
    }
    ratios
}

/// Number of marks that lie well within the disc.
fn lit_marks(flight: &Flight, disc: &PlateDisc) -> f64 {
    let plate = &flight.recipe.instrument.plate;
    let reach = disc.radius_mil.value - plate.shape.size_mil();
    let lit = plate
        .marks()
        .filter(|(_, at)| at.distance(disc.centre.position) < reach);
    lit.count() as f64
}

fn is_unusual_radius(frame: &Frame, disc: &PlateDisc, ratio: Option<Measured>) -> bool {
    let Some((expected, ratio)) = frame.expected_radius_mil.zip(ratio) else {
        return false;
    };
    let sigma = ratio.sigma.hypot(disc.radius_mil.sigma / expected);
    let away = (disc.radius_mil.value / expected - ratio.value).abs();
    away > (UNUSUAL_SIGMAS * sigma).max(LEAST_UNUSUAL_RADIUS)
}
