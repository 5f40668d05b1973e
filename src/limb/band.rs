//! The pixels about the limb, sector by sector.

use crate::frame::{Cutout, Mask};
use crate::geometry::Ellipse;
use crate::kernels::smaller;
use multiversion::multiversion;
use nalgebra::Vector2;

/// How far a band reaches from its ellipse, px.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Reach {
    pub inside_px: f64,
    pub outside_px: f64,
}

/// Pixels within reach of an ellipse, those of a sector of azimuth side by side.
pub(super) struct Band {
    pub reach: Reach,
    /// Outwards from the ellipse.
    distance_px: Vec<f32>,
    light_dn: Vec<f32>,
    /// Where each sector begins, and where the last one ends.
    begins: Vec<usize>,
}

/// The pixels of one sector.
#[derive(Clone, Copy)]
pub(super) struct SectorPixels<'a> {
    pub distance_px: &'a [f32],
    pub light_dn: &'a [f32],
}

impl Band {
    /// Masked pixels, of the cutout or of `mask`, are not among them. Both must be of the same region.
    pub(super) fn about(
        cutout: &Cutout,
        mask: &Mask,
        ellipse: &Ellipse,
        reach: Reach,
        sectors: usize,
    ) -> Self {
        let region = cutout.region();
        let root = ellipse.root();
        let uneven = ((root.m11 - root.m22) / 2.0).hypot(root.m12) + 1.0;
        let mut found = Unsorted::new(ellipse, reach, sectors);
        let outer = ellipse.mean_radius() + reach.outside_px + uneven;
        let inner = (ellipse.mean_radius() - reach.inside_px - uneven).max(0.0);
        let centre = ellipse.centre;
        for y in region.y0..region.y1 {
            let dy2 = (y as f64 - centre.y).powi(2);
            let [from, to] = [inner, outer].map(|radius| (radius.powi(2) - dy2).max(0.0).sqrt());
            // A row crosses the band twice, or along its top or bottom once.
            let spans = match from > 0.0 {
                true => [(-to, -from), (from, to)],
                false => [(-to, to), (0.0, 0.0)],
            };
            for (start, end) in spans {
                let column = |x: f64| (x.ceil().max(region.x0 as f64) as usize).min(region.x1);
                let (start, end) = (column(centre.x + start), column(centre.x + end));
                let columns = start - region.x0..end.max(start) - region.x0;
                let row = Row {
                    light_dn: &cutout.row(y)[columns.clone()],
                    bad: &cutout.mask.row(y)[columns.clone()],
                    masked: &mask.row(y)[columns],
                };
                found.take(&row, Vector2::new(start as f64, y as f64));
            }
        }
        found.sorted()
    }

    pub(super) fn sector(&self, n: usize) -> SectorPixels<'_> {
        let pixels = self.begins[n]..self.begins[n + 1];
        SectorPixels {
            distance_px: &self.distance_px[pixels.clone()],
            light_dn: &self.light_dn[pixels],
        }
    }

    /// Counts the distances from a line so far outwards instead.
    pub(super) fn shift(&mut self, outwards_px: f64) {
        for distance_px in &mut self.distance_px {
            *distance_px -= outwards_px as f32;
        }
    }

    pub(super) fn sectors(&self) -> impl Iterator<Item = SectorPixels<'_>> {
        (1..self.begins.len()).map(|n| self.sector(n - 1))
    }
}

/// A part of a row that crosses the band.
struct Row<'a> {
    light_dn: &'a [f32],
    bad: &'a [bool],
    masked: &'a [bool],
}

/// Pixels in the order of the rows.
struct Unsorted<'a> {
    ellipse: &'a Ellipse,
    reach: Reach,
    sectors: usize,
    distance_px: Vec<f32>,
    light_dn: Vec<f32>,
    sector: Vec<u16>,
    /// Distance and sector of every pixel of a row, within reach or not.
    places: Vec<(f32, f32)>,
}

impl<'a> Unsorted<'a> {
    fn new(ellipse: &'a Ellipse, reach: Reach, sectors: usize) -> Self {
        let width_px = reach.inside_px + reach.outside_px;
        let pixels = (1.1 * std::f64::consts::TAU * ellipse.mean_radius() * width_px) as usize;
        Self {
            ellipse,
            reach,
            sectors,
            distance_px: Vec::with_capacity(pixels),
            light_dn: Vec::with_capacity(pixels),
            sector: Vec::with_capacity(pixels),
            places: Vec::new(),
        }
    }

    fn take(&mut self, row: &Row<'_>, first: Vector2<f64>) {
        let from = (first - self.ellipse.centre).cast::<f32>();
        self.places.clear();
        self.places.resize(row.light_dn.len(), (0.0, 0.0));
        locate(self.ellipse, from, self.sectors as f32, &mut self.places);
        let within = -self.reach.inside_px as f32..self.reach.outside_px as f32;
        for (n, (distance_px, sector)) in self.places.iter().enumerate() {
            if within.contains(distance_px) && !row.bad[n] && !row.masked[n] {
                self.distance_px.push(*distance_px);
                self.light_dn.push(row.light_dn[n]);
                self.sector.push(*sector as u16);
            }
        }
    }

    fn sorted(self) -> Band {
        let sectors = self.sectors;
        let mut begins = vec![0; sectors + 1];
        for sector in &self.sector {
            begins[usize::from(*sector) + 1] += 1;
        }
        for n in 0..sectors {
            begins[n + 1] += begins[n];
        }
        let mut next = begins.clone();
        let mut band = Band {
            reach: self.reach,
            distance_px: vec![0.0; self.sector.len()],
            light_dn: vec![0.0; self.sector.len()],
            begins,
        };
        let pixels = self.distance_px.iter().zip(&self.light_dn);
        for (sector, (distance_px, light_dn)) in self.sector.iter().zip(pixels) {
            let place = &mut next[usize::from(*sector)];
            band.distance_px[*place] = *distance_px;
            band.light_dn[*place] = *light_dn;
            *place += 1;
        }
        band
    }
}

/// Distances outwards from an ellipse, to first order as [`Ellipse::excess`] gives them, and sectors of pixels of a row, of which
/// the first lies `from` its centre.
///
/// Directions are counted by y / (|x| + |y|), which grows with the angle as evenly as sectors need and costs no arctangent.
#[multiversion(targets("x86_64+avx2"))]
fn locate(ellipse: &Ellipse, from: Vector2<f32>, sectors: f32, places: &mut [(f32, f32)]) {
    let inverse = ellipse.inverse().cast::<f32>();
    let (a, b, c) = (inverse.m11, inverse.m12, inverse.m22);
    for (n, place) in places.iter_mut().enumerate() {
        let (x, y) = (from.x + n as i32 as f32, from.y);
        let (u, v) = (a * x + b * y, b * x + c * y);
        let r2 = u * u + v * v;
        let (nx, ny) = (a * u + b * v, b * u + c * v);
        let per_normal = 1.0 / (nx * nx + ny * ny + f32::MIN_POSITIVE).sqrt();
        let along = v / (u.abs() + v.abs() + f32::MIN_POSITIVE);
        let quarters = if u >= 0.0 { 1.0 + along } else { 3.0 - along };
        let sector = smaller(quarters * (0.25 * sectors), sectors - 0.5);
        *place = ((r2 - r2.sqrt()) * per_normal, sector);
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

    #[test]
    fn every_pixel_of_the_ring_is_in_the_band_once() {
        let cutout = cutout();
        let reach = Reach {
            inside_px: 6.0,
            outside_px: 9.0,
        };
        let mask = Mask::none(cutout.region());
        let band = Band::about(&cutout, &mask, &ellipse(), reach, SECTORS);
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
            let mut place = [(0.0, 0.0)];
            locate(&ellipse(), middle, SECTORS as f32, &mut place);
            assert_eq!(place[0].1 as usize, n);
            assert!(place[0].0.abs() < 1e-3);
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
            let band = Band::about(&cutout, mask, &ellipse(), reach, SECTORS);
            band.sectors().map(|pixels| pixels.light_dn.len()).sum()
        };
        let mut mask = Mask::none(cutout.region());
        let all = count(&mask);
        mask.hide(230, 121);
        mask.hide(150, 121);
        assert_eq!(count(&mask), all - 1);
    }
}
