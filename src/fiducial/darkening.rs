//! The disc's light without marks: how it falls towards the limb, and how it leans across the disc.
//!
//! Limb darkening is nearly straight in mu, the cosine of the angle to the Sun's vertical. Medians over rings, which marks are
//! too small to move, give it; towards the limb, where its blur bends the light, the rings are narrow. Between them run
//! straight lines.

use crate::estimation::{SIGMA_PER_MEDIAN, median_size};
use crate::frame::{Levels, Region, Sample, View};
use crate::geometry::Ellipse;
use crate::lanes::{LANES, Scratch, groups, larger, smaller};
use multiversion::multiversion;
use nalgebra::Vector2;
use std::ops::Range;

/// Rings that make the profile.
pub(super) const RINGS: usize = 7;
/// The mu that bound them; nearer to the limb nothing is judged.
const EDGES: [f32; RINGS + 1] = [0.0625, 0.125, 0.1875, 0.25, 0.3125, 0.5625, 0.8125, 1.0];
/// Only every so many columns and rows make the profile.
const STRIDE_PX: usize = 5;
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
    profile: CentreToLimb,
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
            profile: CentreToLimb::through(&lights),
            least_mu2: larger((1.0 - usable * usable) as f32, EDGES[0] * EDGES[0]),
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
            let sizes = taken.ring(n, darkness).map(f32::abs);
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

    /// The darkness of a pixel by its light without the tilt, DN above background: 0 on the clean disc and where nothing is
    /// judged, 1 where no light is left.
    #[inline(always)]
    pub(super) fn darkness(&self, light: f32, mu2: f32) -> f32 {
        let expected = self.profile.light(larger(mu2, 0.0).sqrt());
        let dark = 1.0 - smaller(light, expected + self.most_excess_dn) / expected;
        if mu2 >= self.least_mu2 { dark } else { 0.0 }
    }
}

/// The light between the rings' middles, DN above background: a straight line in mu that bends at those within.
#[derive(Debug, Clone, PartialEq)]
struct CentreToLimb {
    start_dn: f32,
    slope_dn: f32,
    /// Where in mu, and by how much, DN.
    bends: [(f32, f32); RINGS - 2],
}

impl CentreToLimb {
    fn through(lights: &[f32; RINGS]) -> Self {
        // Half the ring's area lies on either side, so half its light is brighter.
        let mu = |n: usize| ((EDGES[n].powi(2) + EDGES[n + 1].powi(2)) / 2.0).sqrt();
        let slope = |n: usize| (lights[n + 1] - lights[n]) / (mu(n + 1) - mu(n));
        let bends = std::array::from_fn(|n| (mu(n + 1), slope(n + 1) - slope(n)));
        // Each bend adds its own part from the start on, as far as where it lies.
        let bent: f32 = bends.iter().map(|(at, bend)| at * bend).sum();
        Self {
            start_dn: lights[0] - slope(0) * mu(0) - bent,
            slope_dn: slope(0),
            bends,
        }
    }

    #[inline(always)]
    fn light(&self, mu: f32) -> f32 {
        let straight = self.start_dn + self.slope_dn * mu;
        let bent = |light, (at, bend): &(f32, f32)| light + bend * larger(mu, *at);
        self.bends.iter().fold(straight, bent)
    }
}

/// The ring of a mu^2; nearer to the limb than all of them the first.
#[inline(always)]
pub(super) fn ring(mu2: f32) -> u32 {
    let edges = EDGES[1..RINGS].iter();
    edges.map(|edge| u32::from(mu2 >= edge * edge)).sum()
}

/// A row of the sensor across the disc; places along it count from its first pixel.
pub(super) struct Row {
    /// The first pixel in disc units, and the step to the next one.
    pub first: Vector2<f32>,
    pub step: Vector2<f32>,
    /// Along the row mu^2 = bend (half^2 - (x - middle)^2): middle, half^2, bend.
    pub parabola: [f32; 3],
    /// The pixels in the disc.
    pub inside: Range<usize>,
}

impl Row {
    /// So many pixels from column `x0` on; `None` where they pass the disc by.
    pub(super) fn new(outline: &Ellipse, x0: usize, y: usize, count: usize) -> Option<Self> {
        let first = outline.to_disc(Vector2::new(x0 as f64, y as f64));
        let step = outline.inverse().column(0).into_owned();
        // The row's part in the disc lies between the parabola's roots.
        let (bend, slope) = (step.norm_squared(), step.dot(&first));
        let middle = -slope / bend;
        let half2 = middle * middle - (first.norm_squared() - 1.0) / bend;
        if half2 <= 0.0 {
            return None;
        }
        let half = half2.sqrt();
        let [from, to] = [middle - half, middle + half].map(|v| (v + 1.0) as u32 as usize);
        let to = to.min(count);
        (from < to).then(|| Self {
            first: first.cast(),
            step: step.cast(),
            parabola: [middle, half2, bend].map(|v| v as f32),
            inside: from..to,
        })
    }
}

/// The pixels that make the profile, one list for each quantity; the last group of lanes is filled up with darkness.
struct Taken {
    /// Position in disc units.
    x: Scratch<f32>,
    y: Scratch<f32>,
    /// Above background, DN.
    light: Scratch<f32>,
    /// The pixels' places in the lists, ring by ring, and where in these the rings begin and the last one ends.
    order: Scratch<u32>,
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
        let [mut x, mut y, mut light] = std::array::from_fn(|_| Scratch::empty(USUAL_PIXELS));
        for at in (region.y0..region.y1).step_by(STRIDE_PX) {
            let Some(row) = Row::new(outline, region.x0, at, region.width()) else {
                continue;
            };
            // Neighbouring rows look at other columns.
            let from = row.inside.start + at / STRIDE_PX % STRIDE_PX;
            let seen = &view.pixels[at * view.width..][region.x0..][..row.inside.end];
            let taken = seen.get(from..).unwrap_or_default().chunks(STRIDE_PX);
            let along = |n: usize| (from + STRIDE_PX * n) as i32 as f32;
            x.extend((0..taken.len()).map(|n| row.first.x + row.step.x * along(n)));
            y.extend((0..taken.len()).map(|n| row.first.y + row.step.y * along(n)));
            light.extend(taken.map(|pixels| pixels[0].dn() - background_dn));
        }
        let count = light.len();
        for list in [&mut x, &mut y, &mut light] {
            list.resize(count.next_multiple_of(LANES), 0.0);
        }
        let (order, rings) = ring_by_ring(&x, &y, count);
        Self {
            x,
            y,
            light,
            order,
            rings,
        }
    }

    /// What belongs to a ring of one value for each pixel.
    fn ring(&self, ring: usize, values: &[f32]) -> impl ExactSizeIterator<Item = f32> {
        let order = &self.order[self.rings[ring]..self.rings[ring + 1]];
        order.iter().map(|n| values[*n as usize])
    }

    /// The light of every ring, DN. From the middle outwards; a ring of which too little is in view is taken to be like the
    /// one within.
    fn ring_lights(&self, levels: &Levels) -> [f32; RINGS] {
        let mut last = (levels.disc_dn - levels.background_dn) as f32;
        let mut lights = [last; RINGS];
        for n in (0..RINGS).rev() {
            let light = median(self.ring(n, &self.light));
            last = light.unwrap_or(last).max(levels.noise_dn as f32);
            lights[n] = last;
        }
        lights
    }
}

/// The first so many places in order of their rings, and where the rings begin and the last one ends.
fn ring_by_ring(x: &[f32], y: &[f32], count: usize) -> (Scratch<u32>, [usize; RINGS + 1]) {
    let mut ring_of = Scratch::of_length(x.len());
    find_rings(x, y, &mut ring_of);
    let ring_of = &ring_of[..count];
    let mut rings = [0; RINGS + 1];
    ring_of
        .iter()
        .for_each(|ring| rings[*ring as usize + 1] += 1);
    for n in 0..RINGS {
        rings[n + 1] += rings[n];
    }
    let mut next = rings;
    let mut order = Scratch::of_length(count);
    for (n, ring) in ring_of.iter().enumerate() {
        let place = &mut next[*ring as usize];
        order[*place] = n as u32;
        *place += 1;
    }
    (order, rings)
}

#[multiversion(targets("x86_64+avx2"))]
fn find_rings(x: &[f32], y: &[f32], rings: &mut [u32]) {
    for ((x, y), found) in x.iter().zip(y).zip(rings) {
        *found = ring(1.0 - x * x - y * y);
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
    let [tilt_x, tilt_y] = [darkening.tilt.x, darkening.tilt.y];
    let places = taken.x.iter().zip(taken.y.iter());
    for (((x, y), light), darkness) in places.zip(taken.light.iter()).zip(darkness) {
        // To first order in the tilt, which is small.
        let level = light * (1.0 - tilt_x * x - tilt_y * y);
        *darkness = darkening.darkness(level, 1.0 - x * x - y * y);
    }
}

/// The slope of the light across the disc, by least squares on what is neither mark nor blemish.
#[multiversion(targets("x86_64+avx2"))]
fn measure_tilt(taken: &Taken, darkness: &[f32]) -> Vector2<f32> {
    let (mut along_x, mut along_y, mut inertia) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
    let places = groups(&taken.x).iter().zip(groups(&taken.y));
    for ((x, y), darkness) in places.zip(groups(darkness)) {
        for k in 0..LANES {
            let weight = if darkness[k].abs() < MOST_TILT {
                1.0
            } else {
                0.0
            };
            let (wx, wy) = (weight * x[k], weight * y[k]);
            along_x[k] -= wx * darkness[k];
            along_y[k] -= wy * darkness[k];
            inertia[k] += wx * x[k] + wy * y[k];
        }
    }
    let [along_x, along_y, inertia] = [along_x, along_y, inertia].map(|sum| sum.iter().sum());
    Vector2::new(along_x, along_y) * (2.0 / larger(inertia, f32::MIN_POSITIVE))
}
