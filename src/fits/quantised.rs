//! Floating-point pixels that were quantised before compression (FITS 4.0, section 10.2 and appendix I).

use super::Problem;
use super::header::Header;
use std::sync::OnceLock;

/// Number of a pixel that was exactly zero, under the second method of dithering.
const EXACT_ZERO: i32 = -2_147_483_646;
/// Largest number that means no value.
const NO_VALUE: i32 = -2_147_483_647;

/// Conversion of the numbers of each tile to values.
pub(super) struct Quantised {
    /// For each tile, the step and the value of number 0.
    pub steps: Vec<[f64; 2]>,
    dither: Option<Dither>,
}

/// The dither offsets that were added before rounding, less than one step each.
struct Dither {
    /// Index of the random number with which the first tile begins, from 1.
    seed: usize,
    keeps_zeros: bool,
}

impl Quantised {
    pub fn new(header: &Header, steps: Vec<[f64; 2]>) -> Result<Self, Problem> {
        let method = header.text("ZQUANTIZ")?.unwrap_or_default();
        let seed = || header.size("ZDITHER0", 1..=RANDOM as i64);
        let dither = |keeps_zeros| {
            Ok(Some(Dither {
                seed: seed()? as usize,
                keeps_zeros,
            }))
        };
        Ok(Self {
            steps,
            dither: match method.as_str() {
                "" | "NONE" | "NO_DITHER" => None,
                "SUBTRACTIVE_DITHER_1" => dither(false)?,
                "SUBTRACTIVE_DITHER_2" => dither(true)?,
                _ => {
                    let expected = "NO_DITHER, SUBTRACTIVE_DITHER_1 or _2";
                    return Err(Problem::field("ZQUANTIZ", expected, format!("'{method}'")));
                }
            },
        })
    }

    /// The values of a tile's numbers; tiles count from 0.
    pub fn fill(&self, tile: usize, numbers: &[i32], values: &mut [f32]) {
        let [step, zero] = self.steps[tile];
        let mut offsets = self
            .dither
            .as_ref()
            .map(|dither| Offsets::new(dither.seed + tile));
        let keeps_zeros = self
            .dither
            .as_ref()
            .is_some_and(|dither| dither.keeps_zeros);
        for (number, value) in numbers.iter().zip(values) {
            let offset = offsets.as_mut().map_or(0.0, Offsets::next);
            *value = match *number {
                ..=NO_VALUE => f32::NAN,
                EXACT_ZERO if keeps_zeros => 0.0,
                number => ((f64::from(number) - offset) * step + zero) as f32,
            };
        }
    }
}

/// Number of random numbers.
const RANDOM: usize = 10_000;

/// The random numbers that all programs use: Park and Miller's generator.
fn random() -> &'static [f64] {
    static NUMBERS: OnceLock<Vec<f64>> = OnceLock::new();
    NUMBERS.get_or_init(|| {
        const MODULUS: u64 = 2_147_483_647;
        let next = |seed: &u64| Some(16_807 * seed % MODULUS);
        let seeds = std::iter::successors(next(&1), next).take(RANDOM);
        // Programs store them in single precision.
        seeds
            .map(|seed| f64::from((seed as f64 / MODULUS as f64) as f32))
            .collect()
    })
}

/// The dither offsets of a tile's pixels: successive random numbers, from a start that is itself random.
struct Offsets {
    drawn: usize,
    at: usize,
}

impl Offsets {
    /// The offsets of a tile, counted from 1.
    fn new(tile: usize) -> Self {
        let drawn = (tile - 1) % RANDOM;
        Self {
            drawn,
            at: Self::start(drawn),
        }
    }

    fn start(drawn: usize) -> usize {
        (random()[drawn] * 500.0) as usize
    }

    fn next(&mut self) -> f64 {
        let offset = random()[self.at] - 0.5;
        self.at += 1;
        if self.at == RANDOM {
            self.drawn = (self.drawn + 1) % RANDOM;
            self.at = Self::start(self.drawn);
        }
        offset
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_seed_is_the_one_that_the_standard_names() {
        let last = random()[RANDOM - 1];
        assert_eq!(last as f32, (1_043_618_065_f64 / 2_147_483_647.0) as f32);
    }
}
