//! The disc's light without marks: how it falls towards the limb, and how it leans across the disc.
//!
//! Limb darkening is nearly straight in mu, the cosine of the angle to the Sun's vertical. Medians over rings that are equally
//! wide in mu, which marks are too small to move, give it; towards the limb, where its blur bends the light, such rings
//! become narrow by themselves. Between them run straight lines.

use crate::frame::{Levels, Region, Sample, View};
use crate::geometry::Ellipse;
use crate::lanes::{LANES, Scratch, larger, smaller};
use crate::statistics::{SIGMA_PER_MEDIAN, median_size};
use multiversion::multiversion;
use nalgebra::Vector2;

/// Rings that make the profile.
pub(super) const RINGS: usize = 16;
/// The rings at whose middles the straight lines meet: near the limb all of them.
const KNOTS: [usize; 8] = [0, 1, 2, 3, 4, 7, 11, 15];
/// Only every so many columns and rows make the profile.
const STRIDE_PX: usize = 4;
/// Fewest pixels that make a ring's median.
const MIN_RING_PIXELS: usize = 12;
/// Brighter or darker than this is a mark or a blemish and tells nothing of the light's tilt.
const MOST_TILT: f32 = 0.2;
/// Nearer to the limb than this nothing is judged: its blur takes over there.
const LIMB_MARGIN_PX: f64 = 1.0;
/// Pixels brighter than this many sigma are taken for that bright: scratches and hot pixels.
const BRIGHTEST_SIGMA: f32 = 3.0;

/// What the disc looks like without marks.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Darkening {
    pub background_dn: f32,
    /// How the light changes over the disc's radius, as a fraction.
    pub tilt: Vector2<f32>,
    /// 1 sigma of the darkness by ring.
    pub noise: [f32; RINGS],
    /// Light at the limb, DN above background, and where in mu it bends by how much, DN.
    edge_dn: f32,
    bends: [(f32, f32); KNOTS.len()],
    /// Pixels of a smaller mu^2 are not judged.
    least_mu2: f32,
    /// Most that a pixel is let to outshine the light, DN.
    most_excess_dn: f32,
}

impl Darkening {
    pub(super) fn measure<T: Sample>(
        view: &View<'_, T>,
        region: Region,
        outline: &Ellipse,
        levels: &Levels,
    ) -> Self {
        let background_dn = levels.background_dn as f32;
        let taken = Taken::of(view, region, outline, background_dn);
        let lights = taken.ring_lights(levels);
        let usable = 1.0 - LIMB_MARGIN_PX / outline.mean_radius();
        let mut darkening = Self {
            background_dn,
            tilt: Vector2::zeros(),
            noise: [0.0; RINGS],
            edge_dn: lights[0],
            bends: bends(&lights),
            least_mu2: (1.0 - usable * usable) as f32,
            most_excess_dn: f32::INFINITY,
        };
        let mut darkness = Scratch::of_length(taken.light.len());
        darken(&darkening, &taken, &mut darkness);
        darkening.tilt = measure_tilt(&taken, &darkness);
        darken(&darkening, &taken, &mut darkness);
        darkening.measure_noise(&taken, &darkness, &lights, levels.noise_dn as f32);
        darkening
    }

    /// The noise of every ring, and what brightness it allows.
    fn measure_noise(
        &mut self,
        taken: &Taken,
        darkness: &[f32],
        lights: &[f32; RINGS],
        background_noise_dn: f32,
    ) {
        let mut last = 0.0;
        for n in (0..RINGS).rev() {
            let sizes = darkness[taken.ring(n)].iter().map(|d| d.abs());
            last = median(sizes).map_or(last, |spread| SIGMA_PER_MEDIAN as f32 * spread);
            self.noise[n] = last.max(0.5 * background_noise_dn / lights[n]);
        }
        let noises_dn = self
            .noise
            .iter()
            .zip(lights)
            .map(|(noise, light)| noise * light);
        let usual_dn = median_size(noises_dn).unwrap_or(background_noise_dn);
        self.most_excess_dn = BRIGHTEST_SIGMA * usual_dn;
    }

    /// The darkness of pixels by their light without the tilt, DN above background: 0 on the clean disc and where nothing is
    /// judged, 1 where no light is left.
    #[inline(always)]
    pub(super) fn darkness(&self, light: &[f32; LANES], mu2: &[f32; LANES]) -> [f32; LANES] {
        let mut mu = [0.0; LANES];
        let mut expected = [self.edge_dn; LANES];
        for k in 0..LANES {
            mu[k] = larger(mu2[k], 0.0).sqrt();
        }
        for (at, bend) in &self.bends {
            for k in 0..LANES {
                expected[k] += bend * larger(mu[k] - at, 0.0);
            }
        }
        let mut darkness = [0.0; LANES];
        for k in 0..LANES {
            let seen = smaller(light[k], expected[k] + self.most_excess_dn);
            let dark = 1.0 - seen / expected[k];
            darkness[k] = if mu2[k] >= self.least_mu2 { dark } else { 0.0 };
        }
        darkness
    }
}

/// Where the straight lines between the knots bend, in mu, and by how much. Beyond the first and the last the light is even.
fn bends(lights: &[f32; RINGS]) -> [(f32, f32); KNOTS.len()] {
    let mu = |ring: usize| (ring as f32 + 0.5) / RINGS as f32;
    // Within the disc neighbours on both sides are as good as the ring itself.
    let light = |ring: usize| match ring {
        5..15 => lights[ring - 1..=ring + 1].iter().sum::<f32>() / 3.0,
        _ => lights[ring],
    };
    let slope_after = |n: usize| match KNOTS.get(n + 1) {
        Some(next) => (light(*next) - light(KNOTS[n])) / (mu(*next) - mu(KNOTS[n])),
        None => 0.0,
    };
    std::array::from_fn(|n| {
        let before = n.checked_sub(1).map_or(0.0, slope_after);
        (mu(KNOTS[n]), slope_after(n) - before)
    })
}

/// The ring of a mu^2.
pub(super) fn ring(mu2: f32) -> usize {
    ((mu2.sqrt() * RINGS as f32) as usize).min(RINGS - 1)
}

/// The pixels that make the profile, one list for each quantity, ring by ring.
struct Taken {
    /// Position in disc units.
    x: Scratch<f32>,
    y: Scratch<f32>,
    /// Above background, DN.
    light: Scratch<f32>,
    /// The first pixel of every ring, and the one after the last.
    rings: [usize; RINGS + 1],
}

/// Pixels of the Sun's disc that make the profile, and some more.
const USUAL_PIXELS: usize = 2048;

impl Taken {
    /// Pixels of the disc, some rows and columns apart.
    fn of<T: Sample>(
        view: &View<'_, T>,
        region: Region,
        outline: &Ellipse,
        background_dn: f32,
    ) -> Self {
        let mut found: [Scratch<f32>; 3] = std::array::from_fn(|_| Scratch::empty(USUAL_PIXELS));
        let mut ring_of = Scratch::<u16>::empty(USUAL_PIXELS);
        let inverse = outline.inverse().cast::<f32>();
        for y in (region.y0..region.y1).step_by(STRIDE_PX) {
            let row = &view.pixels[y * view.width..][region.x0..region.x1];
            // Neighbouring rows look at other columns.
            let x0 = y / STRIDE_PX % STRIDE_PX;
            let dy = (y as f64 - outline.centre.y) as f32;
            let from = ((region.x0 + x0) as f64 - outline.centre.x) as f32;
            for (n, pixel) in row.iter().skip(x0).step_by(STRIDE_PX).enumerate() {
                let dx = from + (STRIDE_PX * n) as f32;
                let (wx, wy) = (
                    inverse.m11 * dx + inverse.m12 * dy,
                    inverse.m12 * dx + inverse.m22 * dy,
                );
                let mu2 = 1.0 - wx * wx - wy * wy;
                if mu2 > 0.0 {
                    let values = [wx, wy, pixel.dn() - background_dn];
                    found
                        .iter_mut()
                        .zip(values)
                        .for_each(|(list, v)| list.push(v));
                    ring_of.push(ring(mu2) as u16);
                }
            }
        }
        Self::sorted(&found, &ring_of)
    }

    fn sorted(found: &[Scratch<f32>; 3], ring_of: &[u16]) -> Self {
        let mut rings = [0; RINGS + 1];
        ring_of
            .iter()
            .for_each(|ring| rings[usize::from(*ring) + 1] += 1);
        for n in 0..RINGS {
            rings[n + 1] += rings[n];
        }
        let mut next = rings;
        let mut places = Scratch::<u32>::empty(ring_of.len());
        places.extend(ring_of.iter().map(|ring| {
            let place = &mut next[usize::from(*ring)];
            *place += 1;
            (*place - 1) as u32
        }));
        let [x, y, light] = found.each_ref().map(|list| {
            let mut sorted = Scratch::of_length(list.len());
            for (place, value) in places.iter().zip(list.iter()) {
                sorted[*place as usize] = *value;
            }
            sorted
        });
        Self { x, y, light, rings }
    }

    fn ring(&self, ring: usize) -> std::ops::Range<usize> {
        self.rings[ring]..self.rings[ring + 1]
    }

    /// The light of every ring, DN. From the middle outwards; a ring of which too little is in view is taken to be like the
    /// one within.
    fn ring_lights(&self, levels: &Levels) -> [f32; RINGS] {
        let mut last = (levels.disc_dn - levels.background_dn) as f32;
        let mut lights = [last; RINGS];
        for n in (0..RINGS).rev() {
            let light = median(self.light[self.ring(n)].iter().copied());
            last = light.unwrap_or(last).max(levels.noise_dn as f32);
            lights[n] = last;
        }
        lights
    }
}

/// `None` when there are too few values; one that is negative counts as none.
fn median(values: impl ExactSizeIterator<Item = f32>) -> Option<f32> {
    let enough = values.len() >= MIN_RING_PIXELS;
    enough.then(|| median_size(values.map(|v| v.max(0.0))))?
}

/// The darkness of the taken pixels.
#[multiversion(targets("x86_64+avx2"))]
fn darken(darkening: &Darkening, taken: &Taken, darkness: &mut [f32]) {
    let lanes = |list: &[f32], from: usize| -> [f32; LANES] {
        let mut lanes = [0.0; LANES];
        match list[from..].first_chunk::<LANES>() {
            Some(whole) => lanes = *whole,
            None => lanes[..list.len() - from].copy_from_slice(&list[from..]),
        }
        lanes
    };
    let [tilt_x, tilt_y] = [darkening.tilt.x, darkening.tilt.y];
    for (n, darkness) in darkness.chunks_mut(LANES).enumerate() {
        let from = n * LANES;
        let (x, y) = (lanes(&taken.x, from), lanes(&taken.y, from));
        let mut light = lanes(&taken.light, from);
        let mut mu2 = [0.0; LANES];
        for k in 0..LANES {
            // To first order in the tilt, which is small.
            light[k] *= 1.0 - tilt_x * x[k] - tilt_y * y[k];
            mu2[k] = 1.0 - x[k] * x[k] - y[k] * y[k];
        }
        let dark = darkening.darkness(&light, &mu2);
        darkness.copy_from_slice(&dark[..darkness.len()]);
    }
}

/// The slope of the light across the disc, by least squares on what is neither mark nor blemish.
fn measure_tilt(taken: &Taken, darkness: &[f32]) -> Vector2<f32> {
    let (mut moment, mut inertia) = (Vector2::zeros(), 0.0);
    for ((x, y), darkness) in taken.x.iter().zip(taken.y.iter()).zip(darkness) {
        if darkness.abs() < MOST_TILT {
            let w = Vector2::new(*x, *y);
            moment -= w * *darkness;
            inertia += w.norm_squared() / 2.0;
        }
    }
    if inertia > 0.0 {
        moment / inertia
    } else {
        moment
    }
}
