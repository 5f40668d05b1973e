//! The disc's radius on the plate compared with the ephemeris, and its dependence on the camera's temperature: plate and
//! focus change with temperature, the Sun does not.
//!
//! The mapping from camera to plate comes from the marks, so changes of the camera's scale do not affect the radius. Two things do: a
//! plate that is farther away makes the disc larger, a plate that expands makes it smaller in the plate's own mil.

use super::suns::{Flight, Suns};
use super::temperature;
use crate::estimation::regression;
use crate::units::Measured;
use nalgebra::Vector2;
use serde::ser::SerializeMap;
use serde::{Serialize, Serializer};

/// Number of blocks of successive discs that are averaged: neighbours share the mapping's error, which the scatter of blocks includes.
const BLOCKS: usize = 40;
/// Fewer discs for each block do not determine a slope.
const LEAST_PER_BLOCK: usize = 2;
/// A slope below this many sigmas is not determined.
const SIGNIFICANT: f64 = 4.0;

/// Relative change of the radius on the plate per degC of the camera's temperature.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum RadiusDependence {
    NoTemperature,
    TooFewDiscs {
        found: usize,
        least: usize,
    },
    /// The slope is not significant against its sigma.
    Insignificant {
        per_degc: Measured,
    },
    Linear {
        per_degc: Measured,
    },
}

/// Slope and sigma, whether the slope is significant, and both in words.
impl Serialize for RadiusDependence {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(3))?;
        map.serialize_entry("per_degc", &self.per_degc())?;
        map.serialize_entry("determined", &matches!(self, Self::Linear { .. }))?;
        map.serialize_entry("text", &self.text())?;
        map.end()
    }
}

impl RadiusDependence {
    /// Determines it from the dated frames of a flight. A change with time that is proportional to the temperature is not separated.
    pub(super) fn of(flight: &Flight, suns: &Suns) -> Self {
        let times_s = (0..flight.frames.len()).filter_map(|n| flight.timeline.unix_s(n));
        let times_s: Vec<f64> = times_s.collect();
        let readings: Vec<Option<f64>> = flight.frames.iter().map(|f| f.temperature_c).collect();
        let Some(temperature_c) = temperature::from_the_middle(&times_s, &readings) else {
            return Self::NoTemperature;
        };
        let discs = temperature_c.into_iter().enumerate();
        let discs: Vec<(f64, f64)> = discs
            .filter_map(|(n, c)| Some((c, ratio(flight, suns, n)?)))
            .collect();
        Self::through(&discs)
    }

    /// Fits temperatures and radii relative to the expected ones, in the order of time.
    fn through(discs: &[(f64, f64)]) -> Self {
        let least = LEAST_PER_BLOCK * BLOCKS;
        let few = Self::TooFewDiscs {
            found: discs.len(),
            least,
        };
        if discs.len() < least {
            return few;
        }
        let Some(per_degc) = slope(discs) else {
            return few;
        };
        match per_degc.value.abs() > SIGNIFICANT * per_degc.sigma {
            true => Self::Linear { per_degc },
            false => Self::Insignificant { per_degc },
        }
    }

    /// The slope, if there is one, significant or not.
    pub fn per_degc(&self) -> Option<Measured> {
        match self {
            Self::Insignificant { per_degc } | Self::Linear { per_degc } => Some(*per_degc),
            Self::NoTemperature | Self::TooFewDiscs { .. } => None,
        }
    }

    /// For people.
    pub fn text(&self) -> String {
        match self {
            Self::NoTemperature => {
                "not determined: the headers hold no temperature of the camera that changes".into()
            }
            Self::TooFewDiscs { found, least } => {
                format!("not determined: expected at least {least} whole discs, found {found}")
            }
            Self::Insignificant {
                per_degc: Measured { value, sigma },
            } => format!(
                "not determined: less than {:.1} parts in a million per degC",
                1e6 * (value.abs() + SIGNIFICANT * sigma)
            ),
            Self::Linear {
                per_degc: Measured { value, sigma },
            } => format!(
                "{:+.1} \u{b1} {:.1} parts in a million per degC",
                1e6 * value,
                1e6 * sigma
            ),
        }
    }
}

/// The radius relative to the expected one, of fine frames that show enough of the limb to determine it.
fn ratio(flight: &Flight, suns: &Suns, n: usize) -> Option<f64> {
    let frame = &flight.frames[n];
    suns.fine(flight, n).filter(|_| suns.is_sure(frame, n))?;
    Some(suns.discs[n]?.disc.radius_mil.value / frame.expected_radius_mil?)
}

/// Relative slope of the blocks' means; its sigma is inflated for the correlation of successive blocks.
fn slope(discs: &[(f64, f64)]) -> Option<Measured> {
    let size = discs.len().div_ceil(BLOCKS);
    let blocks: Vec<(Vector2<f64>, f64, f64)> = discs.chunks(size).map(mean_of_block).collect();
    let terms: Vec<_> = blocks.iter().map(|(at, ..)| *at).collect();
    let radii: Vec<f64> = blocks.iter().map(|(_, radius, _)| *radius).collect();
    let sigmas: Vec<f64> = blocks.iter().map(|(.., sigma)| *sigma).collect();
    let fitted = regression(&terms, &radii, &sigmas).ok()?;
    let residuals = terms.iter().zip(&radii).zip(&fitted.weights);
    let residuals: Vec<f64> = residuals
        .map(|((at, radius), weight)| weight * (radius - at.dot(&fitted.parameters)))
        .collect();
    let slope = fitted.measured(1);
    let middle = fitted.parameters[0];
    let inflated = slope.sigma * inflation(&residuals);
    (middle > 0.0).then(|| Measured::new(slope.value / middle, inflated / middle))
}

/// The regressors one and temperature, the radius and its relative sigma.
fn mean_of_block(discs: &[(f64, f64)]) -> (Vector2<f64>, f64, f64) {
    let count = discs.len() as f64;
    let sum = discs.iter().fold((0.0, 0.0), |s, d| (s.0 + d.0, s.1 + d.1));
    let at = Vector2::new(1.0, sum.0 / count);
    (at, sum.1 / count, 1.0 / count.sqrt())
}

/// Factor by which the correlation of successive residuals (a first-order process) increases a sigma, never below 1.
fn inflation(residuals: &[f64]) -> f64 {
    const MOST_ALIKE: f64 = 0.9;
    let squares: f64 = residuals.iter().map(|r| r * r).sum();
    let products: f64 = residuals.windows(2).map(|pair| pair[0] * pair[1]).sum();
    let alike = match squares > 0.0 {
        true => (products / squares).clamp(0.0, MOST_ALIKE),
        false => 0.0,
    };
    ((1.0 + alike) / (1.0 - alike)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;
    use rand_xoshiro::Xoshiro256PlusPlus;

    /// A flight that cools by 15 degC, radii to 2e-4 each; `alike` is the correlation of successive errors.
    fn flight(per_degc: f64, alike: f64, seed: u64) -> Vec<(f64, f64)> {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
        let mut error = 0.0;
        let disc = |n: usize| {
            let fresh: f64 = rng.sample(StandardNormal);
            error = alike * error + (1.0 - alike * alike).sqrt() * fresh;
            let c = 7.5 - 15.0 * n as f64 / 800.0;
            (c, 1.001 * (1.0 + per_degc * c) + 2e-4 * error)
        };
        (0..800).map(disc).collect()
    }

    #[test]
    fn sigmas_of_the_slope_are_honest_though_neighbours_share_errors() {
        for alike in [0.0, 0.9] {
            let error = |seed| {
                let found = RadiusDependence::through(&flight(2.3e-5, alike, seed));
                let found = found.per_degc().unwrap();
                (found.value - 2.3e-5) / found.sigma
            };
            let squares: f64 = (0..200).map(|seed| f64::powi(error(seed), 2)).sum();
            let rms = (squares / 200.0).sqrt();
            assert!((0.8..1.25).contains(&rms), "{alike}: {rms}");
        }
    }

    #[test]
    fn a_radius_that_does_not_follow_the_temperature_is_not_determined() {
        for seed in 0..100 {
            let found = RadiusDependence::through(&flight(0.0, 0.9, seed));
            assert!(
                matches!(found, RadiusDependence::Insignificant { .. }),
                "{seed}: {found:?}"
            );
            assert!(found.text().starts_with("not determined"));
        }
        let few = RadiusDependence::through(&flight(2.3e-5, 0.0, 1)[..79]);
        assert_eq!(
            few,
            RadiusDependence::TooFewDiscs {
                found: 79,
                least: 80
            }
        );
    }
}
