//! The pixels about the limb, sector by sector.

use crate::frame::{Cutout, Mask};
use crate::geometry::Ellipse;
use crate::kernels::{LANES, groups, smaller};
use multiversion::multiversion;
use nalgebra::Vector2;
use std::f64::consts::PI;

/// How far a band reaches from its ellipse, px.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Reach {
    pub inside_px: f64,
    pub outside_px: f64,
}

/// Pixels within reach of an ellipse, those of a sector of azimuth side by side.
#[derive(Default)]
pub(super) struct Band {
    /// Outwards from the ellipse.
    distance_px: Vec<f32>,
    light_dn: Vec<f32>,
    /// Where each sector begins, and where the last one ends.
    begins: Vec<usize>,
    unsorted: Unsorted,
}

/// Which pixels a band is to hold.
pub(super) struct Wanted<'a> {
    pub cutout: &'a Cutout,
    /// Of the cutout's region; masked pixels are left out.
    pub mask: &'a Mask,
    pub ellipse: &'a Ellipse,
    pub reach: Reach,
    pub sectors: usize,
    /// Every so many rows are read.
    pub every_row: usize,
}

/// The pixels of one sector.
#[derive(Clone, Copy)]
pub(super) struct SectorPixels<'a> {
    pub distance_px: &'a [f32],
    pub light_dn: &'a [f32],
}

impl Band {
    pub(super) fn of(wanted: &Wanted<'_>) -> Self {
        let mut band = Self::default();
        band.take(wanted);
        band
    }

    /// Takes these pixels in instead of those that it has.
    pub(super) fn take(&mut self, wanted: &Wanted<'_>) {
        self.unsorted.take(wanted);
        let Unsorted {
            distance_px,
            light_dn,
            sector,
            ..
        } = &self.unsorted;
        // What is not wanted comes last, in a sector of its own, and is left out.
        self.begins.clear();
        self.begins.resize(wanted.sectors + 2, 0);
        let counts = &mut self.begins[1..];
        for sector in sector {
            counts[*sector as usize] += 1;
        }
        for n in 0..=wanted.sectors {
            self.begins[n + 1] += self.begins[n];
        }
        self.distance_px.resize(sector.len(), 0.0);
        self.light_dn.resize(sector.len(), 0.0);
        let begins = self.begins.as_mut_slice();
        let (distances, lights) = (
            &mut self.distance_px[..],
            &mut self.light_dn[..sector.len()],
        );
        for ((sector, distance_px), light_dn) in sector.iter().zip(distance_px).zip(light_dn) {
            let begin = &mut begins[*sector as usize];
            let place = *begin;
            *begin = place + 1;
            distances[place] = *distance_px;
            lights[place] = *light_dn;
        }
        // Each begin has moved to the next one's place.
        self.begins.truncate(wanted.sectors);
        self.begins.insert(0, 0);
    }

    /// Counts the distances from another ellipse near by, about which the sectors are as good as the same.
    pub(super) fn follow(&mut self, from: &Ellipse, to: &Ellipse) {
        let sectors = self.begins.len() - 1;
        let (shift, grown) = (to.centre - from.centre, to.root() - from.root());
        for n in 0..sectors {
            let w = middle_of_sector(n, sectors);
            let outwards_px = from.normal(w).dot(&(shift + grown * w)) as f32;
            for distance_px in &mut self.distance_px[self.begins[n]..self.begins[n + 1]] {
                *distance_px -= outwards_px;
            }
        }
    }

    pub(super) fn pixels(&self) -> usize {
        self.begins.last().copied().unwrap_or(0)
    }

    pub(super) fn sectors(&self) -> impl Iterator<Item = SectorPixels<'_>> + Clone {
        self.begins.windows(2).map(|ends| SectorPixels {
            distance_px: &self.distance_px[ends[0]..ends[1]],
            light_dn: &self.light_dn[ends[0]..ends[1]],
        })
    }
}

/// Pixels in the order of the rows.
#[derive(Default)]
struct Unsorted {
    /// Places from the ellipse's centre, px.
    x: Vec<f32>,
    y: Vec<f32>,
    light_dn: Vec<f32>,
    masked: Vec<bool>,
    distance_px: Vec<f32>,
    /// Of pixels that are not wanted the number of sectors.
    sector: Vec<i32>,
}

impl Unsorted {
    fn take(&mut self, wanted: &Wanted<'_>) {
        let Wanted {
            cutout,
            mask,
            ellipse,
            reach,
            ..
        } = wanted;
        let (region, root, centre) = (cutout.region(), ellipse.root(), ellipse.centre);
        let uneven = ((root.m11 - root.m22) / 2.0).hypot(root.m12) + 1.0;
        let outer = ellipse.mean_radius() + reach.outside_px + uneven;
        let inner = (ellipse.mean_radius() - reach.inside_px - uneven).max(0.0);
        // A row's two spans may have a pixel more each than they are long.
        let rows = (region.y1 - region.y0).div_ceil(wanted.every_row);
        let area = PI * (outer * outer - inner * inner) / wanted.every_row as f64;
        self.clear(area as usize + 2 * rows + LANES);
        for y in (region.y0..region.y1).step_by(wanted.every_row) {
            let dy = y as f64 - centre.y;
            let half = |radius: f64| (radius * radius - dy * dy).max(0.0).sqrt();
            let (from, to) = (half(inner), half(outer));
            // A row crosses the band twice, or along its top or bottom once.
            let spans = match from > 0.0 {
                true => [(-to, -from), (from, to)],
                false => [(-to, to), (0.0, 0.0)],
            };
            for (start, end) in spans {
                let column = |x: f64| (x.ceil().max(region.x0 as f64) as usize).min(region.x1);
                let (start, end) = (column(centre.x + start), column(centre.x + end));
                let columns = start - region.x0..end.max(start) - region.x0;
                let first = (start as f64 - centre.x) as f32;
                let along = 0..columns.len() as i32;
                self.x.extend(along.map(|n| first + n as f32));
                self.y.resize(self.x.len(), dy as f32);
                self.light_dn
                    .extend_from_slice(&cutout.row(y)[columns.clone()]);
                self.masked.extend_from_slice(&mask.row(y)[columns]);
            }
        }
        // What fills the last group up is not wanted.
        let whole = self.light_dn.len().next_multiple_of(LANES);
        for list in [&mut self.x, &mut self.y, &mut self.light_dn] {
            list.resize(whole, 0.0);
        }
        self.masked.resize(whole, true);
        locate(ellipse, reach, wanted.sectors, self);
    }

    fn clear(&mut self, room: usize) {
        let Self {
            x,
            y,
            light_dn,
            masked,
            distance_px,
            sector,
        } = self;
        for list in [x, y, light_dn, distance_px] {
            list.clear();
            list.reserve(room);
        }
        masked.clear();
        masked.reserve(room);
        sector.clear();
        sector.reserve(room);
    }
}

/// Finds the pixels' distances outwards from an ellipse, to first order as [`Ellipse::excess`] gives them, and their sectors; that
/// of pixels which are masked or out of reach is the number of sectors.
///
/// Directions are counted by y / (|x| + |y|), which grows with the angle as evenly as sectors need and costs no arctangent.
#[multiversion(targets("x86_64+avx2"))]
fn locate(ellipse: &Ellipse, reach: &Reach, sectors: usize, pixels: &mut Unsorted) {
    let [inside_px, outside_px] = [reach.inside_px, reach.outside_px].map(|px| px as f32);
    let not_wanted = sectors as i32 as f32;
    let inverse = ellipse.inverse().cast::<f32>();
    let (a, b, c) = (inverse.m11, inverse.m12, inverse.m22);
    let (masked, _) = pixels.masked.as_chunks::<LANES>();
    let places = groups(&pixels.x).iter().zip(groups(&pixels.y));
    for ((x, y), masked) in places.zip(masked) {
        let (mut distance_px, mut sector) = ([0.0; LANES], [0; LANES]);
        for k in 0..LANES {
            let (u, v) = (a * x[k] + b * y[k], b * x[k] + c * y[k]);
            let r2 = u * u + v * v;
            let (nx, ny) = (a * u + b * v, b * u + c * v);
            let per_normal = 1.0 / (nx * nx + ny * ny + f32::MIN_POSITIVE).sqrt();
            let along = v / (u.abs() + v.abs() + f32::MIN_POSITIVE);
            let quarters = if u >= 0.0 { 1.0 + along } else { 3.0 - along };
            let away_px = (r2 - r2.sqrt()) * per_normal;
            let is_wanted = (away_px >= -inside_px) & (away_px < outside_px) & !masked[k];
            let found = smaller(quarters * (0.25 * not_wanted), not_wanted - 0.5);
            sector[k] = (if is_wanted { found } else { not_wanted }) as i32;
            distance_px[k] = away_px;
        }
        pixels.distance_px.extend(distance_px);
        pixels.sector.extend(sector);
    }
}

/// The unit vector to the middle of a sector.
pub(super) fn middle_of_sector(sector: usize, sectors: usize) -> Vector2<f64> {
    let quarters = 4.0 * (sector as f64 + 0.5) / sectors as f64;
    let (along, side) = match quarters < 2.0 {
        true => (quarters - 1.0, 1.0),
        false => (3.0 - quarters, -1.0),
    };
    Vector2::new(side * (1.0 - along.abs()), along).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{Background, Frame, FrameInfo, PixelNoise, Pixels};
    use crate::geometry::Circle;

    const SECTORS: usize = 96;

    fn cutout() -> Cutout {
        let frame = Frame::new(
            300,
            240,
            Pixels::U8(vec![9; 300 * 240]),
            255,
            FrameInfo::default(),
        );
        let region = crate::frame::Region::sized(20, 10, 240, 220);
        let background = Background::even(region, 4.0);
        Cutout::new(&frame.unwrap(), region, &background, PixelNoise::even(1.0))
    }

    fn ellipse() -> Ellipse {
        Circle {
            centre: Vector2::new(150.2, 120.7),
            radius: 80.0,
        }
        .into()
    }

    fn band(cutout: &Cutout, mask: &Mask, reach: Reach) -> Band {
        Band::of(&Wanted {
            cutout,
            mask,
            ellipse: &ellipse(),
            reach,
            sectors: SECTORS,
            every_row: 1,
        })
    }

    #[test]
    fn every_pixel_of_the_ring_is_in_the_band_once() {
        let cutout = cutout();
        let reach = Reach {
            inside_px: 6.0,
            outside_px: 9.0,
        };
        let band = band(&cutout, &cutout.mask, reach);
        let found: usize = band.sectors().map(|pixels| pixels.distance_px.len()).sum();
        let within = |x: usize, y: usize| {
            let away = ellipse().excess(Vector2::new(x as f64, y as f64));
            (-6.0..9.0).contains(&away)
        };
        let expected = (10..230).flat_map(|y| (20..260).map(move |x| (x, y)));
        assert_eq!(found, expected.filter(|(x, y)| within(*x, *y)).count());
        for pixels in band.sectors() {
            assert!(pixels.light_dn.iter().all(|dn| *dn == 5.0));
            assert!(pixels.distance_px.iter().all(|px| (-6.0..9.0).contains(px)));
        }
    }

    #[test]
    fn the_middle_of_a_sector_lies_in_it() {
        for n in 0..SECTORS {
            let middle =
                middle_of_sector(n, SECTORS).cast::<f32>() * ellipse().mean_radius() as f32;
            let reach = Reach {
                inside_px: 1.0,
                outside_px: 1.0,
            };
            let mut pixels = Unsorted {
                x: vec![middle.x; LANES],
                y: vec![middle.y; LANES],
                masked: vec![false; LANES],
                ..Unsorted::default()
            };
            locate(&ellipse(), &reach, SECTORS, &mut pixels);
            assert_eq!(pixels.sector[0] as usize, n);
            assert!(pixels.distance_px[0].abs() < 1e-3);
        }
    }

    #[test]
    fn a_band_that_follows_its_ellipse_is_nearly_the_one_about_the_other() {
        let cutout = cutout();
        let reach = Reach {
            inside_px: 6.0,
            outside_px: 9.0,
        };
        let root = nalgebra::Matrix2::new(80.2, 0.1, 0.1, 79.9);
        let moved = Ellipse::new(ellipse().centre + Vector2::new(0.2, -0.15), root).unwrap();
        let mut band = band(&cutout, &cutout.mask, reach);
        let before = band.distance_px.clone();
        band.follow(&ellipse(), &moved);
        let mean = |list: &[f32]| list.iter().sum::<f32>() / list.len() as f32;
        for n in 0..SECTORS {
            let pixels = band.begins[n]..band.begins[n + 1];
            let shift = mean(&band.distance_px[pixels.clone()]) - mean(&before[pixels]);
            let at = ellipse().from_disc(middle_of_sector(n, SECTORS));
            // Distances are of first order: 0.4 px of 80 leave 0.002 px.
            assert!((f64::from(shift) - moved.excess(at)).abs() < 0.003);
        }
    }

    #[test]
    fn masked_pixels_are_left_out() {
        let cutout = cutout();
        let reach = Reach {
            inside_px: 5.0,
            outside_px: 5.0,
        };
        let count = |mask: &Mask| -> usize {
            let band = band(&cutout, mask, reach);
            band.sectors().map(|pixels| pixels.light_dn.len()).sum()
        };
        let mut mask = Mask::none(cutout.region());
        let all = count(&mask);
        mask.hide(230, 121);
        mask.hide(150, 121);
        assert_eq!(count(&mask), all - 1);
    }
}
