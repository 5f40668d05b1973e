//! The pixels near the limb, sector by sector.

use crate::frame::{Cutout, Mask};
use crate::geometry::Ellipse;
use crate::kernels::ring::{MOST_SECTORS, Ring, Run, locate};
use crate::kernels::{LANES, zeros};
use nalgebra::Vector2;

/// Range of a band on either side of its ellipse, px.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Reach {
    pub inside_px: f64,
    pub outside_px: f64,
}

/// Pixels within reach of an ellipse, ordered by sector of azimuth.
pub(super) struct Band {
    /// Distance outwards from the ellipse.
    distance_px: Vec<f32>,
    light_dn: Vec<f32>,
    /// Index of the first pixel of each sector, and the end of the last sector.
    begins: Vec<usize>,
}

/// Selection of the pixels of a band.
pub(super) struct Wanted<'a> {
    pub cutout: &'a Cutout,
    /// Mask of the cutout's region; masked pixels are excluded.
    pub mask: &'a Mask,
    pub ellipse: &'a Ellipse,
    pub reach: Reach,
    pub sectors: usize,
    /// Row stride: every `every_row`-th row is read.
    pub every_row: usize,
}

/// The pixels of one sector, or of all sectors.
#[derive(Clone, Copy)]
pub(super) struct SectorPixels<'a> {
    pub distance_px: &'a [f32],
    pub light_dn: &'a [f32],
}

impl Band {
    pub(super) fn of(wanted: &Wanted<'_>) -> Self {
        let (sectors, reach) = (wanted.sectors, &wanted.reach);
        let inverse = wanted.ellipse.inverse();
        let ring = Ring {
            inverse: [inverse.m11, inverse.m12, inverse.m22].map(|v| v as f32),
            inside_px: reach.inside_px as f32,
            outside_px: reach.outside_px as f32,
            sectors,
        };
        let runs = wanted.runs();
        let groups = |run: &Run<'_>| run.light_dn.len().div_ceil(LANES);
        let mut located = Vec::with_capacity(runs.iter().map(groups).sum());
        locate(&ring, &runs, &mut located);
        // Unwanted pixels come last, in a sector of their own.
        let mut ends = [0_u32; MOST_SECTORS];
        for group in &located {
            for sector in &group.sector {
                ends[*sector as usize % MOST_SECTORS] += 1;
            }
        }
        let mut begin = 0;
        for end in &mut ends[..=sectors] {
            begin += std::mem::replace(end, begin);
        }
        let begin = begin as usize;
        let begins = ends[..=sectors]
            .iter()
            .map(|begin| *begin as usize)
            .collect();
        let [mut distance_px, mut light_dn] = [(); 2].map(|()| zeros(begin));
        let (distances, lights) = (&mut distance_px[..begin], &mut light_dn[..begin]);
        let mut groups = located.iter();
        for run in &runs {
            for (light_dn, group) in run.light_dn.chunks(LANES).zip(&mut groups) {
                let found = group.sector.iter().zip(&group.away_px);
                for ((sector, away_px), light_dn) in found.zip(light_dn) {
                    let end = &mut ends[*sector as usize % MOST_SECTORS];
                    let place = *end as usize;
                    (distances[place], lights[place]) = (*away_px, *light_dn);
                    *end += 1;
                }
            }
        }
        Self {
            distance_px,
            light_dn,
            begins,
        }
    }

    /// Shifts the distances to refer to another ellipse nearby; the assignment to sectors is kept.
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

    /// The pixels of all sectors.
    pub(super) fn pixels(&self) -> SectorPixels<'_> {
        let count = self.begins.last().copied().unwrap_or(0);
        SectorPixels {
            distance_px: &self.distance_px[..count],
            light_dn: &self.light_dn[..count],
        }
    }

    pub(super) fn sectors(&self) -> impl Iterator<Item = SectorPixels<'_>> + Clone {
        self.begins.windows(2).map(|ends| SectorPixels {
            distance_px: &self.distance_px[ends[0]..ends[1]],
            light_dn: &self.light_dn[ends[0]..ends[1]],
        })
    }
}

impl<'a> Wanted<'a> {
    /// Runs of the rows around the ellipse, with a small margin.
    fn runs(&self) -> Vec<Run<'a>> {
        let (region, root, centre) = (
            self.cutout.region(),
            self.ellipse.root(),
            self.ellipse.centre,
        );
        // Distances are first-order approximations.
        const SPARE_PX: f64 = 0.2;
        let uneven = ((root.m11 - root.m22) / 2.0).hypot(root.m12) + SPARE_PX;
        let outer = self.ellipse.mean_radius() + self.reach.outside_px + uneven;
        let inner = (self.ellipse.mean_radius() - self.reach.inside_px - uneven).max(0.0);
        let rows = (region.y0..region.y1).step_by(self.every_row);
        let mut runs = Vec::with_capacity(2 * rows.len());
        for y in rows {
            let dy = y as f64 - centre.y;
            let half = |radius: f64| (radius * radius - dy * dy).max(0.0).sqrt();
            let (from, to) = (half(inner), half(outer));
            // A row crosses the band twice, or along its top or bottom once.
            let spans = match from > 0.0 {
                true => [(-to, -from), (from, to)],
                false => [(-to, to), (0.0, 0.0)],
            };
            for (start, end) in spans {
                // The next column; an error of one column is covered by the margin.
                let column =
                    |x: f64| ((centre.x + x + 1.0).max(region.x0 as f64) as usize).min(region.x1);
                let (start, end) = (column(start), column(end));
                if start < end {
                    let columns = start - region.x0..end - region.x0;
                    runs.push(Run {
                        x: (start as f64 - centre.x) as f32,
                        y: dy as f32,
                        light_dn: &self.cutout.row(y)[columns.clone()],
                        masked: &self.mask.row(y)[columns],
                    });
                }
            }
        }
        runs
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
            let ring = Ring {
                inverse: [1.0 / 80.0, 0.0, 1.0 / 80.0],
                inside_px: 1.0,
                outside_px: 1.0,
                sectors: SECTORS,
            };
            let run = Run {
                x: middle.x,
                y: middle.y,
                light_dn: &[0.0],
                masked: &[false],
            };
            let mut found = Vec::new();
            locate(&ring, &[run], &mut found);
            assert_eq!(found[0].sector[0] as usize, n);
            assert!(found[0].away_px[0].abs() < 1e-3);
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
            // Distances are first-order: a shift of 0.4 px on a radius of 80 px leaves 0.002 px.
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
