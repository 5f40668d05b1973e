//! Flags of frames that differ from the others.

use super::disc::PlateDisc;
use super::flags::{FrameFlag, FrameFlags};
use super::frames::Frame;
use super::mapping::Standing;
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
const ABOUT: usize = 20;
/// Frames with fewer marks than this part of the illuminated ones are flagged.
const UNUSUAL_MARKS: f64 = 0.5;

/// Median values of a flight.
struct Usual {
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
    let discs = suns.seen.iter().flatten();
    let scatter = median(discs.map(|seen| seen.disc.scatter));
    let usual = Usual {
        scatter: scatter.map_or(1.0, |scatter| scatter.max(1.0)),
        light: about(flight, suns, |levels| levels[2] - levels[0]),
        noise: about(flight, suns, |levels| levels[1]),
    };
    of.par_iter()
        .map(|n| flags(flight, suns, *n, &usual))
        .collect()
}

fn flags(flight: &Flight, suns: &Suns, n: usize, usual: &Usual) -> FrameFlags {
    let frame = &flight.frames[n];
    let of_disc = suns.seen[n].iter().flat_map(|seen| {
        let disc = &seen.disc;
        let far = |value: Option<f64>, most: f64| value.is_some_and(|value| value > most);
        let light = usual.light[n].map(|light| light.max(1.0 / light));
        let few = f64::from(frame.marks) < UNUSUAL_MARKS * lit_marks(flight, disc);
        [
            is_unusual_radius(frame, disc, suns.radius_ratio).then_some(FrameFlag::Radius),
            (disc.scatter > UNUSUAL_SCATTER * usual.scatter).then_some(FrameFlag::Limb),
            few.then_some(FrameFlag::FewMarks),
            far(light, UNUSUAL_LIGHT).then_some(FrameFlag::Light),
            far(usual.noise[n], UNUSUAL_NOISE).then_some(FrameFlag::Noise),
        ]
    });
    let standing = flight.mapping.as_ref().map(|mapping| mapping.standing[n]);
    let of_marks = match standing {
        Some(Standing::Alone) => Some(FrameFlag::Knocked),
        Some(Standing::Misread) => Some(FrameFlag::Misread),
        Some(Standing::Agrees | Standing::Unmarked) | None => None,
    };
    of_disc.flatten().chain(of_marks).collect()
}

/// A quantity of each dated frame's levels, relative to its median over the neighbouring frames that have a disc.
fn about(flight: &Flight, suns: &Suns, value: impl Fn(&[f64; 3]) -> f64) -> Vec<Option<f64>> {
    let lit: Vec<(usize, f64)> = (0..flight.frames.len())
        .filter(|n| suns.seen[*n].is_some())
        .filter_map(|n| Some((n, value(&flight.frames[n].levels_dn?.map(f64::from)))))
        .collect();
    let mut over = vec![None; flight.frames.len()];
    for (k, (n, value)) in lit.iter().enumerate() {
        let near = &lit[k.saturating_sub(ABOUT)..lit.len().min(k + ABOUT + 1)];
        let usual = median(near.iter().map(|(_, value)| value));
        over[*n] = usual
            .filter(|usual| *usual > 0.0)
            .map(|usual| value / usual);
    }
    over
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
