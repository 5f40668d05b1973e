//! The disc without its own brightness.

use super::rings::{RINGS, Taken, measure_tilt, median, ring};
use crate::frame::{Frame, Levels, Region, Sample, View};
use crate::geometry::Ellipse;
use crate::lanes::split;
use crate::units::SensorPx;
use crate::with_view;
use multiversion::multiversion;
use nalgebra::Vector2;

/// Entries of the table of expected light, equally wide in mu^2, which needs no root for every pixel: 0.1 px at the limb.
const TABLE: usize = 512;
const LAST_ENTRY: f32 = TABLE as f32 - 0.51;
/// Nearer to the limb than this nothing is judged: its blur takes over there.
const LIMB_MARGIN_PX: f64 = 1.0;
/// Darkness is not let below so many sigma: scratches and hot pixels are brighter than the noise allows.
const BRIGHTEST_SIGMA: f32 = 3.0;

/// The darkness of every pixel about the disc: 0 on the clean disc and outside it, 1 where no light is left.
#[derive(Debug, Clone, PartialEq)]
pub struct FlatDisc {
    pub outline: Ellipse,
    sensor_px: [f64; 2],
    /// The sensor's pixel that the first value belongs to; the square about the disc may reach over the sensor.
    left: isize,
    top: isize,
    side: usize,
    darkness: Vec<f32>,
    /// 1 sigma of the darkness by ring.
    noise: [f32; RINGS],
}

impl FlatDisc {
    /// Flattens a disc by the medians of its rings, which marks are too small to move, and by the light's tilt across it,
    /// with a margin of darkness 0 about it. Pixels brighter than the noise allows (scratches, hot pixels) are clipped.
    /// `None` when the disc is not on the sensor.
    pub fn new(frame: &Frame, outline: Ellipse, levels: &Levels, margin_px: f64) -> Option<Self> {
        let reach = outline.mean_radius() * 1.02;
        let (width, height) = (frame.width(), frame.height());
        let region = Region::around(outline.centre.into(), reach, width, height)?;
        with_view!(frame, view => Some(Self::of(&view, region, outline, levels, margin_px)))
    }

    fn of<T: Sample>(
        view: &View<'_, T>,
        region: Region,
        outline: Ellipse,
        levels: &Levels,
        margin_px: f64,
    ) -> Self {
        let profile = Profile::measure(view, region, &outline, levels);
        let reach = outline.mean_radius() * 1.02 + margin_px;
        let left = (outline.centre.x - reach).floor() as isize;
        let top = (outline.centre.y - reach).floor() as isize;
        let side = (2.0 * reach).ceil() as usize + 2;
        let mut darkness = Vec::with_capacity(side * side);
        for y in top..top + side as isize {
            let first = darkness.len();
            darkness.resize(first + side, 0.0);
            let Some(y) = usize::try_from(y)
                .ok()
                .filter(|y| (region.y0..region.y1).contains(y))
            else {
                continue;
            };
            let row = &mut darkness[first..];
            let values = &mut row[(region.x0 as isize - left) as usize..][..region.width()];
            let seen = &view.pixels[y * view.width..][region.x0..region.x1];
            profile.flatten(&outline, region.x0, y, seen, values);
        }
        Self {
            outline,
            sensor_px: [view.width as f64, view.height as f64],
            left,
            top,
            side,
            darkness,
            noise: profile.noise,
        }
    }

    /// Pixels in a row, and rows.
    pub fn side(&self) -> usize {
        self.side
    }

    /// The darkness, row by row.
    pub(super) fn values(&self) -> &[f32] {
        &self.darkness
    }

    /// The sensor position of a value's index.
    pub(super) fn position(&self, index: usize) -> SensorPx {
        let (row, column) = (index / self.side, index % self.side);
        SensorPx::new(
            (self.left + column as isize) as f64,
            (self.top + row as isize) as f64,
        )
    }

    /// Values of a row about a position's nearest pixel: from `reach` left of it, the `row`-th from `reach` above it.
    pub(super) fn row_from(
        &self,
        at: SensorPx,
        reach: usize,
        row: usize,
        count: usize,
    ) -> Option<&[f32]> {
        let from = |v: f64, first: isize| {
            usize::try_from(v.round() as isize - first - reach as isize).ok()
        };
        let (x, y) = (from(at.x, self.left)?, from(at.y, self.top)? + row);
        (x + count <= self.side && y < self.side)
            .then(|| &self.darkness[y * self.side + x..][..count])
    }

    /// The values within a radius of a position, as far as there are any, and where they are on the sensor.
    pub(super) fn around(
        &self,
        middle: SensorPx,
        radius_px: f64,
    ) -> impl Iterator<Item = (Vector2<f64>, f32)> {
        let span = |from_first: f64| {
            let low = (from_first - radius_px).ceil().max(0.0) as usize;
            let high = (from_first + radius_px).floor() + 1.0;
            low..(high.max(0.0) as usize).min(self.side)
        };
        let (left, top) = (self.left as f64, self.top as f64);
        let columns = span(middle.x - left);
        let squares =
            span(middle.y - top).flat_map(move |row| columns.clone().map(move |c| (c, row)));
        squares.filter_map(move |(column, row)| {
            let at = Vector2::new(left + column as f64, top + row as f64);
            let near = (at - middle.vector()).norm_squared() <= radius_px * radius_px;
            near.then(|| (at, self.darkness[row * self.side + column]))
        })
    }

    /// 1 sigma of the darkness at a position.
    pub fn noise(&self, at: SensorPx) -> f64 {
        let w = self.outline.to_disc(at.vector());
        f64::from(self.noise[ring((1.0 - w.norm_squared()).max(0.0) as f32)])
    }

    /// Whether a position is lit: inside the limb and on the sensor, by a margin.
    pub fn is_lit(&self, at: SensorPx, margin_px: f64) -> bool {
        let within = |v: f64, size: f64| v >= margin_px && v <= size - 1.0 - margin_px;
        self.outline.excess(at.vector()) < -margin_px
            && within(at.x, self.sensor_px[0])
            && within(at.y, self.sensor_px[1])
    }
}

/// What the disc looks like without marks.
struct Profile {
    background_dn: f32,
    /// Light at the rings' middles, DN above background.
    light: [f32; RINGS],
    /// How the light changes over the disc's radius, as a fraction.
    tilt: Vector2<f32>,
    /// 1 sigma of the darkness by ring.
    noise: [f32; RINGS],
    /// By mu^2.
    table: Box<[Expected; TABLE]>,
}

/// What is expected at a place of the disc.
#[derive(Debug, Clone, Copy)]
struct Expected {
    /// Darkness without light: 1, or 0 where nothing is judged.
    full: f32,
    /// 1 / light, 1/DN; 0 where nothing is judged.
    inverse_light: f32,
    /// Darkness is not let below this.
    least: f32,
}

impl Expected {
    const NOT_JUDGED: Self = Self {
        full: 0.0,
        inverse_light: 0.0,
        least: 0.0,
    };
    const JUDGED: Self = Self {
        full: 1.0,
        least: f32::NEG_INFINITY,
        ..Self::NOT_JUDGED
    };

    fn darkness(&self, light: f32) -> f32 {
        (self.full - light * self.inverse_light).max(self.least)
    }
}

impl Profile {
    fn measure<T: Sample>(
        view: &View<'_, T>,
        region: Region,
        outline: &Ellipse,
        levels: &Levels,
    ) -> Self {
        let background_dn = levels.background_dn as f32;
        let taken = Taken::of(view, region, outline, background_dn);
        let mut profile = Self {
            background_dn,
            light: [(levels.disc_dn - levels.background_dn) as f32; RINGS],
            tilt: Vector2::zeros(),
            noise: [0.0; RINGS],
            table: Box::new([Expected::NOT_JUDGED; TABLE]),
        };
        let least = levels.noise_dn as f32;
        // From the middle outwards; a ring of which too little is in view is taken to be like the one within.
        let mut last = profile.light[RINGS - 1];
        let mut lights = taken.light.clone();
        for n in (0..RINGS).rev() {
            last = median(&mut lights[taken.ring(n)])
                .unwrap_or(last)
                .max(least);
            profile.light[n] = last;
        }
        profile.table = profile.tabulate(outline);
        let mut darkness = profile.darkness(&taken);
        profile.tilt = measure_tilt(&taken, &darkness);
        darkness = profile.darkness(&taken);
        profile.measure_noise(&taken, darkness, levels.noise_dn as f32);
        profile
    }

    /// The noise of every ring, and what brightness it allows.
    fn measure_noise(&mut self, taken: &Taken, darkness: Vec<f32>, background_noise_dn: f32) {
        let mut sizes: Vec<f32> = darkness.into_iter().map(f32::abs).collect();
        let mut last = 0.0;
        for n in (0..RINGS).rev() {
            last = median(&mut sizes[taken.ring(n)]).map_or(last, |spread| 1.4826 * spread);
            self.noise[n] = last.max(0.5 * background_noise_dn / self.light[n]);
        }
        for (n, expected) in self.table.iter_mut().enumerate() {
            let noise = self.noise[ring(n as f32 / TABLE as f32)];
            expected.least = expected.least.max(-BRIGHTEST_SIGMA * noise);
        }
    }

    /// Expected light at a mu, interpolated between the middles of the rings.
    fn light_at(&self, mu: f32) -> f32 {
        let along = (mu * RINGS as f32 - 0.5).clamp(0.0, (RINGS - 1) as f32);
        let ring = (along as usize).min(RINGS - 2);
        let part = along - ring as f32;
        self.light[ring] * (1.0 - part) + self.light[ring + 1] * part
    }

    fn tabulate(&self, outline: &Ellipse) -> Box<[Expected; TABLE]> {
        let usable = 1.0 - LIMB_MARGIN_PX / outline.mean_radius();
        let least_mu2 = (1.0 - usable * usable) as f32;
        let entry = |n: usize| {
            let mu2 = (n as f32 + 0.5) / TABLE as f32;
            if mu2 < least_mu2 {
                return Expected::NOT_JUDGED;
            }
            Expected {
                inverse_light: 1.0 / self.light_at(mu2.sqrt()),
                ..Expected::JUDGED
            }
        };
        Box::new(std::array::from_fn(entry))
    }

    /// Of the taken pixels.
    fn darkness(&self, taken: &Taken) -> Vec<f32> {
        let of = |n: usize| {
            let (x, y) = (taken.x[n], taken.y[n]);
            let expected = &self.table[entry(1.0 - x * x - y * y)];
            // To first order in the tilt, which is small.
            expected.darkness(taken.light[n] * (1.0 - self.tilt.x * x - self.tilt.y * y))
        };
        (0..taken.light.len()).map(of).collect()
    }

    /// The darkness of a row's pixels from column `x0` on; those outside the disc are left as they are.
    fn flatten<T: Sample>(
        &self,
        outline: &Ellipse,
        x0: usize,
        y: usize,
        seen: &[T],
        darkness: &mut [f32],
    ) {
        let first = outline.to_disc(Vector2::new(x0 as f64, y as f64));
        let step = outline.to_disc(Vector2::new(x0 as f64 + 1.0, y as f64)) - first;
        // Along the row mu^2 is a parabola; the row's part in the disc lies between its roots.
        let (bend, slope) = (step.norm_squared(), step.dot(&first));
        let middle = -slope / bend;
        let half2 = middle * middle - (first.norm_squared() - 1.0) / bend;
        if half2 <= 0.0 {
            return;
        }
        let from = (middle - half2.sqrt()).ceil().max(0.0) as usize;
        let to = ((middle + half2.sqrt()).floor() + 1.0).max(0.0) as usize;
        let inside = from..to.min(seen.len());
        if inside.is_empty() {
            return;
        }
        let row = Row {
            parabola: [middle, half2, bend].map(|v| v as f32),
            tilt: [
                1.0 - self.tilt.dot(&first.cast()),
                -self.tilt.dot(&step.cast()),
            ],
            background_dn: self.background_dn,
            first: inside.start as f32,
        };
        let mut entries = [0_u16; GROUP];
        let mut light = [0.0_f32; GROUP];
        let groups = seen[inside.clone()].chunks(GROUP);
        for (n, (seen, darkness)) in groups.zip(darkness[inside].chunks_mut(GROUP)).enumerate() {
            row.find(n * GROUP, seen, &mut entries[..seen.len()], &mut light);
            for ((darkness, entry), light) in darkness.iter_mut().zip(&entries).zip(&light) {
                *darkness = self.table[usize::from(*entry) % TABLE].darkness(*light);
            }
        }
    }
}

/// Pixels of a row that are looked up together.
const GROUP: usize = 64;

/// A row of the sensor across the disc, from the first pixel that lies in it.
struct Row {
    /// Along the row mu^2 = bend (half^2 - (x - middle)^2): middle, half^2, bend.
    parabola: [f32; 3],
    /// What takes the tilt off the light, at column 0 and per column.
    tilt: [f32; 2],
    background_dn: f32,
    first: f32,
}

impl Row {
    /// The table's entries of pixels, and their light without the tilt.
    fn find<T: Sample>(&self, from: usize, seen: &[T], entries: &mut [u16], light: &mut [f32]) {
        let mut dn = [0.0_f32; GROUP];
        for (dn, seen) in dn.iter_mut().zip(seen) {
            *dn = seen.dn();
        }
        find_entries(
            self,
            self.first + from as f32,
            &dn[..seen.len()],
            entries,
            light,
        );
    }
}

#[multiversion(targets("x86_64+avx2"))]
fn find_entries(row: &Row, first: f32, dn: &[f32], entries: &mut [u16], light: &mut [f32]) {
    let [middle, half2, bend] = row.parabola;
    let count = dn.len();
    let (entries, light) = (&mut entries[..count], &mut light[..count]);
    for n in 0..count {
        let along = first + n as i32 as f32;
        let mu2 = bend * (half2 - (along - middle) * (along - middle));
        entries[n] = split((mu2 * TABLE as f32).clamp(0.0, LAST_ENTRY)).0 as u16;
        light[n] = (dn[n] - row.background_dn) * (row.tilt[0] + row.tilt[1] * along);
    }
}

/// The place of a mu^2 in the table.
fn entry(mu2: f32) -> usize {
    split((mu2 * TABLE as f32).clamp(0.0, LAST_ENTRY)).0 as usize
}
