//! The disc without its own brightness.

use crate::frame::{Frame, Levels, Region, Sample, View};
use crate::geometry::Ellipse;
use crate::units::SensorPx;
use crate::with_view;
use nalgebra::Vector2;

/// Rings that make the profile, equally wide in mu, the cosine of the angle to the Sun's vertical: limb darkening is nearly
/// straight in mu, and towards the limb, where light falls steeply, such rings become narrow by themselves.
const RINGS: usize = 16;
/// Entries of the table of expected light, equally wide in mu^2, which needs no root for every pixel: 0.05 px at the limb.
const TABLE: usize = 1024;
/// Nearer to the limb than this nothing is judged: its blur takes over there.
const LIMB_MARGIN_PX: f64 = 1.0;
/// Only every so many columns and rows make the profile.
const STRIDE_PX: usize = 3;
/// Fewest pixels that make a ring's median.
const MIN_RING_PIXELS: usize = 12;
/// Brighter or darker than this is a mark or a blemish and tells nothing of the light's tilt.
const MOST_TILT: f32 = 0.2;
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
        let mut darkness = vec![0.0_f32; side * side];
        for y in region.y0..region.y1 {
            let row = &mut darkness[(y as isize - top) as usize * side..][..side];
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

/// One of the pixels that make the profile.
struct Taken {
    w: Vector2<f32>,
    ring: usize,
    /// Above background, DN.
    light: f32,
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
    table: Vec<Expected>,
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
        let taken = take(view, region, outline, background_dn);
        let mut profile = Self {
            background_dn,
            light: [(levels.disc_dn - levels.background_dn) as f32; RINGS],
            tilt: Vector2::zeros(),
            noise: [0.0; RINGS],
            table: Vec::new(),
        };
        let least = levels.noise_dn as f32;
        let lights = by_ring(taken.iter().map(|t| (t.ring, t.light)));
        // From the middle outwards; a ring of which too little is in view is taken to be like the one within.
        let mut last = profile.light[RINGS - 1];
        for (n, mut ring) in lights.into_iter().enumerate().rev() {
            last = median(&mut ring).unwrap_or(last).max(least);
            profile.light[n] = last;
        }
        profile.table = profile.tabulate(outline);
        profile.tilt = profile.measure_tilt(&taken);
        profile.measure_noise(&taken, levels.noise_dn as f32);
        profile
    }

    /// The noise of every ring, and what brightness it allows.
    fn measure_noise(&mut self, taken: &[Taken], background_noise_dn: f32) {
        let off = |t: &Taken| (t.ring, self.darkness(t.light, t.w).abs());
        let mut spreads = by_ring(taken.iter().map(off));
        let mut last = 0.0;
        for (n, ring) in spreads.iter_mut().enumerate().rev() {
            last = median(ring).map_or(last, |spread| 1.4826 * spread);
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

    fn tabulate(&self, outline: &Ellipse) -> Vec<Expected> {
        let usable = 1.0 - LIMB_MARGIN_PX / outline.mean_radius();
        let least_mu2 = (1.0 - usable * usable) as f32;
        let at = |n: usize| (n as f32 + 0.5) / TABLE as f32;
        let expected = |mu2: f32| Expected {
            inverse_light: 1.0 / self.light_at(mu2.sqrt()),
            ..Expected::JUDGED
        };
        (0..TABLE)
            .map(|n| {
                if at(n) < least_mu2 {
                    Expected::NOT_JUDGED
                } else {
                    expected(at(n))
                }
            })
            .collect()
    }

    fn darkness(&self, light: f32, w: Vector2<f32>) -> f32 {
        let expected = &self.table[entry(1.0 - w.norm_squared())];
        // To first order in the tilt, which is small.
        expected.darkness(light * (1.0 - self.tilt.dot(&w)))
    }

    /// The slope of the light across the disc, by least squares on what is neither mark nor blemish.
    fn measure_tilt(&self, taken: &[Taken]) -> Vector2<f32> {
        let (mut moment, mut inertia) = (Vector2::zeros(), 0.0);
        for t in taken {
            let darkness = self.darkness(t.light, t.w);
            if darkness.abs() < MOST_TILT {
                moment -= t.w * darkness;
                inertia += t.w.norm_squared() / 2.0;
            }
        }
        if inertia > 0.0 {
            moment / inertia
        } else {
            moment
        }
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
        let [middle, half2, bend] = [middle, half2, bend].map(|v| v as f32);
        let (tilt, tilt_step) = (self.tilt.dot(&first.cast()), self.tilt.dot(&step.cast()));
        let pixels = seen[inside.clone()]
            .iter()
            .zip(&mut darkness[inside.clone()]);
        for ((seen, darkness), n) in pixels.zip(inside) {
            let along = n as i32 as f32;
            let mu2 = bend * (half2 - (along - middle) * (along - middle));
            let tilted = 1.0 - tilt - tilt_step * along;
            let light = (seen.dn() - self.background_dn) * tilted;
            *darkness = self.table[entry(mu2)].darkness(light);
        }
    }
}

/// The ring of a mu^2.
fn ring(mu2: f32) -> usize {
    ((mu2.sqrt() * RINGS as f32) as usize).min(RINGS - 1)
}

/// The place of a mu^2 in the table.
fn entry(mu2: f32) -> usize {
    ((mu2 * TABLE as f32) as i32 as usize).min(TABLE - 1)
}

/// Pixels of the disc, some rows and columns apart.
fn take<T: Sample>(
    view: &View<'_, T>,
    region: Region,
    outline: &Ellipse,
    background_dn: f32,
) -> Vec<Taken> {
    let mut taken = Vec::new();
    for y in (region.y0..region.y1).step_by(STRIDE_PX) {
        // Neighbouring rows look at other columns.
        let x0 = region.x0 + y / STRIDE_PX % STRIDE_PX;
        for x in (x0..region.x1).step_by(STRIDE_PX) {
            let w = outline
                .to_disc(Vector2::new(x as f64, y as f64))
                .cast::<f32>();
            let mu2 = 1.0 - w.norm_squared();
            if mu2 > 0.0 {
                let light = view.dn(x, y) - background_dn;
                taken.push(Taken {
                    w,
                    ring: ring(mu2),
                    light,
                });
            }
        }
    }
    taken
}

fn by_ring(values: impl Iterator<Item = (usize, f32)>) -> [Vec<f32>; RINGS] {
    let mut rings: [Vec<f32>; RINGS] = std::array::from_fn(|_| Vec::new());
    values.for_each(|(ring, value)| rings[ring].push(value));
    rings
}

/// `None` when there are too few values.
fn median(values: &mut [f32]) -> Option<f32> {
    if values.len() < MIN_RING_PIXELS {
        return None;
    }
    let middle = values.len() / 2;
    Some(*values.select_nth_unstable_by(middle, f32::total_cmp).1)
}
