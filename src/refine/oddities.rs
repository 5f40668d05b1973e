//! What is odd about a frame beside the others.

use super::disc::PlateDisc;
use super::mapping::Standing;
use super::oddity::Oddity;
use super::row::Row;
use super::work::Work;
use crate::estimation::median;
use crate::units::Measured;
use rayon::prelude::*;

/// So many times the flight's usual scatter is odd.
const ODD_SIGMAS: f64 = 8.0;
/// Smaller deviations of the radius are none, relative.
const LEAST_ODD_RADIUS: f64 = 1e-3;
/// A limb that scatters so many times more than usual is odd.
const ODD_SCATTER: f64 = 2.0;
/// Light or noise that differs by more than this factor from the frames about it is odd.
const ODD_LIGHT: f64 = 1.3;
const ODD_NOISE: f64 = 1.6;
/// Frames to each side that tell what is usual.
const ABOUT: usize = 20;
/// Fewer marks than this part of those that are lit is odd.
const ODD_MARKS: f64 = 0.5;

/// What is usual in a flight.
struct Usual {
    scatter: f64,
    /// Each dated frame's light and noise over those of the frames about it.
    light: Vec<Option<f64>>,
    noise: Vec<Option<f64>>,
}

impl Work<'_> {
    /// Notes what is odd about some of the dated frames.
    pub(super) fn look_for_oddities(&mut self, wanted: impl Fn(usize) -> bool + Sync) {
        if self.mapping.is_none() {
            return;
        }
        let discs = self.rows.iter().filter_map(|row| row.disc.as_ref());
        let scatter = median(discs.map(|disc| disc.scatter));
        let usual = Usual {
            scatter: scatter.map_or(1.0, |scatter| scatter.max(1.0)),
            light: self.about(|levels| levels[2] - levels[0]),
            noise: self.about(|levels| levels[1]),
        };
        let found: Vec<(usize, Vec<Oddity>)> = (0..self.dated)
            .into_par_iter()
            .filter(|n| wanted(*n))
            .map(|n| (n, self.oddities(n, &usual)))
            .filter(|(_, odd)| !odd.is_empty())
            .collect();
        for (n, odd) in found {
            odd.into_iter().for_each(|odd| self.rows[n].note(odd));
        }
    }

    fn oddities(&self, n: usize, usual: &Usual) -> Vec<Oddity> {
        let row = &self.rows[n];
        let of_disc = row.disc.iter().flat_map(|disc| {
            let far = |value: Option<f64>, most: f64| value.is_some_and(|value| value > most);
            let light = usual.light[n].map(|light| light.max(1.0 / light));
            let few = (row.own.marks as f64) < ODD_MARKS * self.lit_marks(disc);
            [
                odd_radius(row, disc, self.radius_ratio).then_some(Oddity::Radius),
                (disc.scatter > ODD_SCATTER * usual.scatter).then_some(Oddity::Limb),
                few.then_some(Oddity::FewMarks),
                far(light, ODD_LIGHT).then_some(Oddity::Light),
                far(usual.noise[n], ODD_NOISE).then_some(Oddity::Noise),
            ]
        });
        let standing = self.mapping.as_ref().map(|mapping| mapping.standing[n]);
        let of_marks = match standing {
            Some(Standing::Alone) => Some(Oddity::Knocked),
            Some(Standing::Misread) => Some(Oddity::Misread),
            Some(Standing::Agrees | Standing::Unmarked) | None => None,
        };
        of_disc.flatten().chain(of_marks).collect()
    }

    /// Something of each dated frame's levels over the median of the frames about it that have a disc.
    fn about(&self, value: impl Fn(&[f64; 3]) -> f64 + Sync) -> Vec<Option<f64>> {
        let lit: Vec<(usize, f64)> = (0..self.dated)
            .filter(|n| self.rows[*n].disc.is_some())
            .filter_map(|n| Some((n, value(self.rows[n].own.levels_dn.as_ref()?))))
            .collect();
        let mut over = vec![None; self.dated];
        for (k, (n, value)) in lit.iter().enumerate() {
            let near = &lit[k.saturating_sub(ABOUT)..lit.len().min(k + ABOUT + 1)];
            let usual = median(near.iter().map(|(_, value)| value));
            over[*n] = usual
                .filter(|usual| *usual > 0.0)
                .map(|usual| value / usual);
        }
        over
    }

    /// How many marks lie well within the disc.
    fn lit_marks(&self, disc: &PlateDisc) -> f64 {
        let plate = &self.recipe.instrument.plate;
        let reach = disc.radius_mil.value - plate.cross.arm_length_mil;
        let lit = plate
            .marks()
            .filter(|(_, at)| at.distance(disc.centre.position) < reach);
        lit.count() as f64
    }
}

fn odd_radius(row: &Row, disc: &PlateDisc, ratio: Option<Measured>) -> bool {
    let Some((expected, ratio)) = row.expected_radius_mil.zip(ratio) else {
        return false;
    };
    let sigma = ratio.sigma.hypot(disc.radius_mil.sigma / expected);
    let away = (disc.radius_mil.value / expected - ratio.value).abs();
    away > (ODD_SIGMAS * sigma).max(LEAST_ODD_RADIUS)
}
