//! Matched filters: weights for the pixels around a position of the flattened disc.

use super::FlatDisc;
use crate::kernels::{LANES, correlate, weighted_squares};

/// The pixels within a radius of a central one: a square around it, row by row, each row padded to whole lanes.
#[derive(Debug, Clone)]
pub(super) struct Window {
    /// Pixels from the centre to the edge, along both axes.
    reach: usize,
    /// Pixels of a row, padding included.
    width: usize,
    /// Offsets from the centre, px.
    pub x: Vec<f32>,
    pub y: Vec<f32>,
    /// Index of the ring about the centre, one pixel wide, that each pixel lies in. Those outside the radius share the last
    /// one.
    ring: Vec<usize>,
    /// Number of pixels of each ring.
    ring_pixels: Vec<f32>,
    /// 1 within the radius, else 0.
    inside: Vec<f32>,
}

impl Window {
    pub(super) fn within(radius_px: f64) -> Self {
        let reach = radius_px as usize;
        let width = (2 * reach + 1).next_multiple_of(LANES);
        let offset = |n: usize| n as f32 - reach as f32;
        let places = (0..=2 * reach).flat_map(|row| (0..width).map(move |column| (column, row)));
        let (x, y): (Vec<f32>, Vec<f32>) = places.map(|(x, y)| (offset(x), offset(y))).unzip();
        let ring = |(x, y): (&f32, &f32)| match x.hypot(*y) {
            distance if f64::from(distance) <= radius_px => distance as usize,
            _ => reach + 1,
        };
        let ring: Vec<usize> = x.iter().zip(&y).map(ring).collect();
        let mut ring_pixels = vec![0.0; reach + 2];
        ring.iter().for_each(|ring| ring_pixels[*ring] += 1.0);
        let inside = ring.iter().map(|ring| f32::from(u8::from(*ring <= reach)));
        Self {
            inside: inside.collect(),
            reach,
            width,
            x,
            y,
            ring,
            ring_pixels,
        }
    }

    /// Number of pixels within the radius.
    pub(super) fn pixels(&self) -> usize {
        self.ring
            .iter()
            .filter(|ring| self.is_inside(**ring))
            .count()
    }

    fn is_inside(&self, ring: usize) -> bool {
        ring <= self.reach
    }

    /// A list's values minus their mean over their ring: the part that is round about the centre is removed. 0 outside the
    /// radius.
    pub(super) fn without_round_part(&self, values: &[f32]) -> Vec<f32> {
        let mut sums = vec![0.0; self.reach + 2];
        for (value, ring) in values.iter().zip(&self.ring) {
            sums[*ring] += value;
        }
        let less_mean = |(value, ring): (&f32, &usize)| match self.is_inside(*ring) {
            true => value - sums[*ring] / self.ring_pixels[*ring],
            false => 0.0,
        };
        values.iter().zip(&self.ring).map(less_mean).collect()
    }

    /// Sum of the squared values within the radius of a position at which the window [`fits`](Self::fits).
    pub(super) fn squares(&self, flat: &FlatDisc, index: usize) -> f32 {
        let (values, side) = (self.values(flat, index), flat.side());
        weighted_squares(&self.inside, self.width, values, side)
    }

    /// The same for the part that is round about the centre.
    pub(super) fn round_squares(&self, flat: &FlatDisc, index: usize) -> f32 {
        /// Farther rings count as the last.
        const MOST_RINGS: usize = 128;
        let last = self.reach.min(MOST_RINGS - 2) + 1;
        let mut sums = [0.0; MOST_RINGS];
        let rows = self.values(flat, index).chunks(flat.side());
        for (row, rings) in rows.zip(self.ring.chunks_exact(self.width)) {
            for (value, ring) in row.iter().zip(rings) {
                sums[(*ring).min(last)] += value;
            }
        }
        let rings = sums[..last].iter().zip(&self.ring_pixels);
        rings.map(|(sum, pixels)| sum * sum / pixels.max(1.0)).sum()
    }

    /// Sum of the values within the radius of a position at which the window [`fits`](Self::fits).
    pub(super) fn sum(&self, flat: &FlatDisc, index: usize) -> f32 {
        self.correlate(&self.inside, flat, index)
    }

    /// Whether the pixels around a value of the flattened disc, plus a margin of one, are all in its square.
    pub(super) fn fits(&self, flat: &FlatDisc, index: usize) -> bool {
        let inner = self.reach + 1..flat.side().saturating_sub(self.width - self.reach);
        inner.contains(&(index / flat.side())) && inner.contains(&(index % flat.side()))
    }

    /// The flattened disc's values from the first pixel of the window at a position.
    fn values<'f>(&self, flat: &'f FlatDisc, index: usize) -> &'f [f32] {
        &flat.values()[index - self.reach * (flat.side() + 1)..]
    }

    /// Sum of the products of weights and the values around a position at which the window [`fits`](Self::fits).
    pub(super) fn correlate(&self, weights: &[f32], flat: &FlatDisc, index: usize) -> f32 {
        correlate(weights, self.width, self.values(flat, index), flat.side())
    }
}

/// A zero-mean filter, so that it does not respond to a constant. Its response is the contrast of the picture it was made
/// from.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Template {
    weights: Vec<f32>,
    /// Sum of the squared weights: the contribution of a picture of contrast 1 to the sum of squares.
    pub energy: f64,
}

impl Template {
    /// From the darkness expected around the centre of a window.
    pub(super) fn new(window: &Window, darkness: &[f32]) -> Self {
        let inside = |n: &usize| window.is_inside(window.ring[*n]);
        let sum: f32 = (0..darkness.len())
            .filter(inside)
            .map(|n| darkness[n])
            .sum();
        let mean = sum / window.pixels() as f32;
        let weight = |n: usize| if inside(&n) { darkness[n] - mean } else { 0.0 };
        let weights: Vec<f32> = (0..darkness.len()).map(weight).collect();
        let energy = weights.iter().map(|w| f64::from(w * w)).sum();
        Self { weights, energy }
    }

    /// Contrast of the pattern around a value, at which the window must fit.
    pub(super) fn response(&self, window: &Window, flat: &FlatDisc, index: usize) -> f64 {
        f64::from(window.correlate(&self.weights, flat, index)) / self.energy
    }

    /// 1 sigma of a response; `values` is the noise of the values.
    pub(super) fn noise(&self, values: f64) -> f64 {
        values / self.energy.sqrt()
    }

    /// Climbs to the highest response within `most_steps` of a position, one pixel at a time. `None` if it is farther off,
    /// or outside the square.
    pub(super) fn climb(
        &self,
        window: &Window,
        flat: &FlatDisc,
        start: usize,
        most_steps: usize,
    ) -> Option<Peak> {
        let mut index = start;
        for _ in 0..=most_steps {
            if !window.fits(flat, index) {
                return None;
            }
            let side = flat.side();
            let beside = [index - 1, index + 1, index - side, index + side];
            let peak = Peak {
                index,
                response: self.response(window, flat, index),
                beside: beside.map(|n| self.response(window, flat, n)),
            };
            let highest = (0..4).max_by(|a, b| peak.beside[*a].total_cmp(&peak.beside[*b]))?;
            if peak.beside[highest] <= peak.response {
                return Some(peak);
            }
            index = beside[highest];
        }
        None
    }
}

/// A pixel whose response is not exceeded by any neighbour.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Peak {
    /// Index into the flattened disc's values.
    pub index: usize,
    pub response: f64,
    /// Responses to the left, to the right, above and below.
    beside: [f64; 4],
}

impl Peak {
    /// The vertex of the response relative to the pixel's centre, px, by a parabola along each axis: a cross is invariant
    /// under a quarter turn, so its response has no other axes. `None` if it is flat.
    pub(super) fn top(&self) -> Option<[f64; 2]> {
        let [left, right, above, below] = self.beside;
        let top = |before: f64, after: f64| {
            let bend = 2.0 * self.response - before - after;
            (bend > 0.0).then(|| (after - before) / (2.0 * bend))
        };
        Some([top(left, right)?, top(above, below)?])
    }
}

#[cfg(test)]
mod tests {
    use super::super::mark_image::{USUAL_CROSS, turned};
    use super::*;

    fn window_and_shares(rotation_deg: f64) -> (Window, Vec<f32>) {
        let window = Window::within(USUAL_CROSS.reach_px());
        let coverage = USUAL_CROSS.coverage(&window.x, &window.y, &turned(rotation_deg));
        (window, coverage.share)
    }

    #[test]
    fn a_cross_is_the_same_after_a_quarter_turn() {
        let [a, b] = [7.0, 97.0].map(|turn| {
            let (window, shares) = window_and_shares(turn);
            Template::new(&window, &shares)
        });
        for (a, b) in a.weights.iter().zip(&b.weights) {
            assert!((a - b).abs() < 1e-5);
        }
    }

    #[test]
    fn what_is_round_does_not_answer_to_a_template_without_round_part() {
        let (window, shares) = window_and_shares(30.0);
        let template = Template::new(&window, &window.without_round_part(&shares));
        for sigma in [1.5_f32, 2.5, 4.0] {
            let places = window.x.iter().zip(&window.y).zip(&template.weights);
            let sum: f32 = places
                .map(|((x, y), weight)| weight * (-(x * x + y * y) / (2.0 * sigma * sigma)).exp())
                .sum();
            // A cross must show a fifth of its contrast to this template: a response of a fifth of that to something round
            // is harmless.
            assert!(
                f64::from(sum.abs()) < 0.04 * template.energy,
                "{sum} of {} at {sigma}",
                template.energy
            );
        }
    }

    #[test]
    fn even_ground_does_not_answer() {
        let (window, shares) = window_and_shares(30.0);
        let template = Template::new(&window, &shares);
        assert!(template.weights.iter().sum::<f32>().abs() < 1e-3);
    }

    #[test]
    fn the_top_of_a_parabola_is_found_where_it_is_and_even_ground_has_none() {
        let at = |x: f64, y: f64| 1.0 - 0.1 * (x - 0.3).powi(2) - 0.2 * (y + 0.2).powi(2);
        let peak = Peak {
            index: 0,
            response: at(0.0, 0.0),
            beside: [at(-1.0, 0.0), at(1.0, 0.0), at(0.0, -1.0), at(0.0, 1.0)],
        };
        let [x, y] = peak.top().unwrap();
        assert!((x - 0.3).abs() < 1e-9 && (y + 0.2).abs() < 1e-9);
        let even = Peak {
            response: 1.0,
            beside: [1.0; 4],
            ..peak
        };
        assert_eq!(even.top(), None);
    }
}
