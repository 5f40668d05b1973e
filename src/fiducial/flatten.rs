//! The disc without its own brightness profile.

use crate::frame::{Frame, Levels, Region, Sample, View};
use crate::geometry::Circle;
use crate::units::SensorPx;
use crate::with_view;

/// Rings of equal area that make the profile.
const RINGS: usize = 24;
/// Where the limb's blur begins, px inside the limb: nearer to it nothing is judged.
const LIMB_MARGIN_PX: f64 = 2.0;
/// Fewest pixels that make a ring's median.
const MIN_RING_PIXELS: usize = 20;

/// The darkness of every pixel about the disc: 0 on the clean disc and outside it, 1 where no light is left.
#[derive(Debug, Clone, PartialEq)]
pub struct FlatDisc {
    pub circle: Circle,
    /// The sensor's pixel that the first value belongs to; the square about the disc may reach over the sensor.
    left: isize,
    top: isize,
    side: usize,
    darkness: Vec<f32>,
    /// 1 sigma of the darkness by ring.
    noise: [f32; RINGS],
}

impl FlatDisc {
    /// Flattens a disc by the medians of its rings, which marks are too small to move, with a margin of darkness 0
    /// about it. Pixels brighter than the noise allows (scratches, hot pixels) are clipped. `None` when the disc is
    /// not on the sensor.
    pub fn new(frame: &Frame, circle: Circle, levels: &Levels, margin_px: f64) -> Option<Self> {
        let centre = SensorPx::from(circle.centre);
        let region = Region::around(centre, circle.radius, frame.width(), frame.height())?;
        with_view!(frame, view => Some(Self::of(&view, region, circle, levels, margin_px)))
    }

    fn of<T: Sample>(
        view: &View<'_, T>,
        region: Region,
        circle: Circle,
        levels: &Levels,
        margin_px: f64,
    ) -> Self {
        let profile = Profile::measure(view, region, circle, levels);
        let reach = circle.radius + margin_px;
        let left = (circle.centre.x - reach).floor() as isize;
        let top = (circle.centre.y - reach).floor() as isize;
        let side = (2.0 * reach).ceil() as usize + 2;
        let mut darkness = vec![0.0_f32; side * side];
        for y in region.y0..region.y1 {
            let row = &mut darkness[(y as isize - top) as usize * side..][..side];
            for x in region.x0..region.x1 {
                if let Some(place) = profile.place(x, y) {
                    let light = view.dn(x, y) - levels.background_dn as f32;
                    let (expected, noise) = profile.at(place);
                    row[(x as isize - left) as usize] = (1.0 - light / expected).max(-3.0 * noise);
                }
            }
        }
        Self {
            circle,
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

    /// 1 sigma of the darkness at a position.
    pub fn noise(&self, at: SensorPx) -> f64 {
        let usable = self.circle.radius - LIMB_MARGIN_PX;
        let place = (at.vector() - self.circle.centre).norm_squared() / usable.powi(2);
        let ring = ((place * RINGS as f64) as usize).min(RINGS - 1);
        f64::from(self.noise[ring])
    }

    /// Distance of a position inwards from where the limb's blur begins, px.
    pub fn depth_px(&self, at: SensorPx) -> f64 {
        -self.circle.excess(at.vector()) - LIMB_MARGIN_PX
    }
}

/// Light above background on the clean disc, by ring from the centre.
struct Profile {
    circle: Circle,
    light: [f32; RINGS],
    noise: [f32; RINGS],
}

impl Profile {
    fn measure<T: Sample>(
        view: &View<'_, T>,
        region: Region,
        circle: Circle,
        levels: &Levels,
    ) -> Self {
        let mut profile = Self {
            circle,
            light: [1.0; RINGS],
            noise: [1.0; RINGS],
        };
        let mut rings: [Vec<f32>; RINGS] = std::array::from_fn(|_| Vec::new());
        for y in region.y0..region.y1 {
            for x in region.x0..region.x1 {
                if let Some(place) = profile.place(x, y) {
                    let light = view.dn(x, y) - levels.background_dn as f32;
                    rings[((place * RINGS as f32) as usize).min(RINGS - 1)].push(light);
                }
            }
        }
        let least_light = levels.noise_dn as f32;
        let mut last = ((levels.disc_dn - levels.background_dn) as f32, 1.0);
        for (n, ring) in rings.iter_mut().enumerate() {
            if ring.len() >= MIN_RING_PIXELS {
                let light = median(ring).max(least_light);
                ring.iter_mut().for_each(|v| *v = (*v - light).abs());
                let noise = (1.4826 * median(ring)).max(levels.noise_dn as f32 * 0.5) / light;
                last = (light, noise);
            }
            (profile.light[n], profile.noise[n]) = last;
        }
        profile
    }

    /// Where a pixel lies on the disc: 0 at the centre, 1 where the limb's blur begins, in equal areas.
    fn place(&self, x: usize, y: usize) -> Option<f32> {
        let dx = x as f32 - self.circle.centre.x as f32;
        let dy = y as f32 - self.circle.centre.y as f32;
        let usable = (self.circle.radius - LIMB_MARGIN_PX) as f32;
        let place = (dx * dx + dy * dy) / (usable * usable);
        (place < 1.0).then_some(place)
    }

    /// Light and noise at a place, interpolated between the middles of the rings.
    fn at(&self, place: f32) -> (f32, f32) {
        let along = (place * RINGS as f32 - 0.5).clamp(0.0, (RINGS - 1) as f32);
        let ring = (along as usize).min(RINGS - 2);
        let part = along - ring as f32;
        let mix = |values: &[f32; RINGS]| values[ring] * (1.0 - part) + values[ring + 1] * part;
        (mix(&self.light), mix(&self.noise))
    }
}

fn median(values: &mut [f32]) -> f32 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f32::total_cmp).1
}
