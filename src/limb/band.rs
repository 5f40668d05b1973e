//! The pixels about an outline, one list for each quantity, as the processor's wide instructions like it.

use super::hidden::{Hidden, pixels_within};
use crate::frame::{Frame, Sample, View};
use crate::geometry::Ellipse;
use crate::lanes::{LANES, Scratch, counted_lanes, first_lanes, split};
use crate::with_view;
use multiversion::multiversion;
use nalgebra::{Matrix2, Vector2};
use std::ops::Range;

/// How far a band reaches from its outline, px.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Reach {
    pub inside_px: f64,
    pub outside_px: f64,
}

/// The pixels about an outline, one entry a pixel.
pub(super) struct Band {
    pub reach: Reach,
    /// Outwards from the outline.
    pub distance_px: Scratch<f32>,
    /// Sector of the direction from the disc's centre.
    pub sector: Scratch<u16>,
    /// Brightness; [`HIDDEN_DN`](super::hidden::HIDDEN_DN) where it is hidden.
    pub dn: Scratch<f32>,
}

impl Band {
    pub(super) fn about(
        frame: &Frame,
        outline: &Ellipse,
        reach: Reach,
        hidden: &Hidden,
        sectors: usize,
    ) -> Self {
        let sectors = sectors.max(1);
        let spans = Spans::new(outline, reach);
        let mut pixels = Places::new();
        with_view!(frame, view => gather(&mut pixels, &view, outline, &spans, hidden));
        let count = pixels.dn.len();
        let mut band = Self {
            reach,
            distance_px: Scratch::of_length(count),
            sector: Scratch::of_length(count),
            dn: pixels.dn,
        };
        let inverse = outline.inverse().cast();
        locate(
            &pixels.x,
            &pixels.y,
            [inverse.m11, inverse.m12, inverse.m22],
            sectors as f32,
            &mut band.distance_px,
            &mut band.sector,
        );
        band
    }
}

/// Where pixels are, px from the outline's centre, and how bright.
struct Places {
    x: Scratch<f32>,
    y: Scratch<f32>,
    dn: Scratch<f32>,
    /// Entries of the lists that are pixels.
    count: usize,
}

/// Pixels of a band about the Sun, and some more.
const USUAL_PIXELS: usize = 7_168;

impl Places {
    fn new() -> Self {
        let [x, y, dn] = std::array::from_fn(|_| Scratch::of_length(USUAL_PIXELS));
        Self { x, y, dn, count: 0 }
    }

    /// Takes the first pixels of a row's rest: whole groups, of which the next row's overwrite what is too much.
    #[inline(always)]
    fn take<T: Sample>(&mut self, rest: &[T], count: usize, x: f32, y: f32) {
        let begin = self.count;
        self.count += count;
        let room = self.count + LANES;
        if room > self.dn.len() {
            for list in [&mut self.x, &mut self.y, &mut self.dn] {
                list.resize(2 * room, 0.0);
            }
        }
        for group in (0..count).step_by(LANES) {
            let lanes = begin + group..begin + group + LANES;
            self.x[lanes.clone()].copy_from_slice(&counted_lanes(x + group as f32));
            self.y[lanes.clone()].copy_from_slice(&[y; LANES]);
            self.dn[lanes].copy_from_slice(&first_lanes(&rest[group..]));
        }
    }
}

/// Takes the pixels of a band.
#[multiversion(targets("x86_64+avx2"))]
fn gather<T: Sample>(
    pixels: &mut Places,
    view: &View<'_, T>,
    outline: &Ellipse,
    spans: &Spans,
    hidden: &Hidden,
) {
    let centre = outline.centre;
    let reach = spans.most * (outline.root().m11.max(outline.root().m22) + 1.0);
    for y in pixels_within(centre.y - reach..centre.y + reach, view.height) {
        let dy = y as f64 - centre.y;
        let row = &view.pixels[y * view.width..][..view.width];
        for span in spans.of_row(dy) {
            let columns = pixels_within(span.start + centre.x..span.end + centre.x, view.width);
            let first = pixels.count;
            let from_centre = (columns.start as f64 - centre.x) as f32;
            pixels.take(&row[columns.start..], columns.len(), from_centre, dy as f32);
            hidden.raise(y, columns.start, &mut pixels.dn[first..pixels.count]);
        }
    }
    for list in [&mut pixels.x, &mut pixels.y, &mut pixels.dn] {
        list.truncate(pixels.count);
    }
}

/// Where rows cross the band, in columns from the outline's centre.
struct Spans {
    /// The outline's inverse root.
    inverse: Matrix2<f64>,
    /// The band's edges in units of the disc's radius.
    least: f64,
    most: f64,
}

impl Spans {
    fn new(outline: &Ellipse, reach: Reach) -> Self {
        let radius = outline.mean_radius();
        Self {
            inverse: *outline.inverse(),
            least: (1.0 - reach.inside_px / radius).max(0.0),
            most: 1.0 + reach.outside_px / radius,
        }
    }

    /// The two parts of a row that lie in the band; empty where it passes by. Along a row the square of the distance in
    /// disc units is a parabola.
    fn of_row(&self, dy: f64) -> [Range<f64>; 2] {
        let step = self.inverse.column(0);
        let first = self.inverse.column(1) * dy;
        let (bend, slope) = (step.norm_squared(), step.dot(&first));
        let middle = -slope / bend;
        let half = |edge: f64| {
            let square = middle * middle - (first.norm_squared() - edge * edge) / bend;
            square.max(0.0).sqrt()
        };
        let (end, hole) = (half(self.most), half(self.least));
        [middle - end..middle - hole, middle + hole..middle + end]
    }
}

/// A place about an outline's centre in disc units, and its distance outwards from the outline to first order, like
/// [`Ellipse::excess`]; the outline's inverse root is given by m11, m12, m22.
#[inline(always)]
pub(super) fn outwards([a, b, c]: [f32; 3], x: f32, y: f32) -> ([f32; 2], f32) {
    let (wx, wy) = (a * x + b * y, b * x + c * y);
    let r2 = wx * wx + wy * wy;
    let (nx, ny) = (a * wx + b * wy, b * wx + c * wy);
    // The very centre has no direction outwards.
    let per_disc = (nx * nx + ny * ny + f32::MIN_POSITIVE).sqrt();
    ([wx, wy], (r2 - r2.sqrt()) / per_disc)
}

/// Distance outwards from the outline, and sector, of places about its centre; `inverse` as for [`outwards`].
#[multiversion(targets("x86_64+avx2"))]
fn locate(
    x: &[f32],
    y: &[f32],
    inverse: [f32; 3],
    sectors: f32,
    distance_px: &mut [f32],
    sector: &mut [u16],
) {
    let count = distance_px.len();
    let (x, y, sector) = (&x[..count], &y[..count], &mut sector[..count]);
    // A number that stands just below the next sector may be taken for it.
    let (per_quarter, last) = (sectors / 4.0, sectors - 0.51);
    for n in 0..count {
        let ([wx, wy], distance) = outwards(inverse, x[n], y[n]);
        distance_px[n] = distance;
        let along = wy / (wx.abs() + wy.abs() + f32::MIN_POSITIVE);
        let quarters = if wx >= 0.0 { 1.0 + along } else { 3.0 - along };
        sector[n] = split((quarters * per_quarter).clamp(0.0, last)).0 as u16;
    }
}

/// The direction of the middle of one of so many sectors: the inverse of what [`locate`] does.
pub(super) fn middle_of_sector(sector: usize, sectors: usize) -> Vector2<f64> {
    let quarters = 4.0 * (sector as f64 + 0.5) / sectors as f64;
    let (along, side) = if quarters < 2.0 {
        (quarters - 1.0, 1.0)
    } else {
        (3.0 - quarters, -1.0)
    };
    Vector2::new(side * (1.0 - along.abs()), along).normalize()
}

#[cfg(test)]
mod tests {
    use super::super::hidden::HIDDEN_DN;
    use super::*;
    use crate::frame::{FrameInfo, Pixels, Region};
    use crate::units::SensorPx;

    fn outline() -> Ellipse {
        Ellipse::new(Vector2::new(60.3, 48.8), Matrix2::new(40.4, 0.2, 0.2, 39.7)).unwrap()
    }

    fn band(hidden: &Hidden) -> Band {
        let pixels = (0..120 * 100).map(|n| (n % 251) as u8).collect();
        let frame = Frame::new(120, 100, Pixels::U8(pixels), 255, FrameInfo::default()).unwrap();
        let reach = Reach {
            inside_px: 6.0,
            outside_px: 4.0,
        };
        Band::about(&frame, &outline(), reach, hidden, 96)
    }

    #[test]
    fn a_band_holds_the_pixels_about_its_outline_and_no_others() {
        let nothing = Hidden::nothing(Region::sized(0, 0, 120, 100));
        let band = band(&nothing);
        let within = |n: usize| {
            let at = Vector2::new((n % 120) as f64, (n / 120) as f64);
            (-5.9..3.9).contains(&outline().excess(at))
        };
        let expected = (0..120 * 100).filter(|n| within(*n)).count();
        let held = band.distance_px.iter().filter(|d| (-5.9..3.9).contains(*d));
        assert_eq!(held.count(), expected);
        assert!(band.distance_px.iter().all(|d| (-6.2..4.2).contains(d)));
    }

    #[test]
    fn hidden_pixels_and_only_they_are_raised() {
        let mut hidden = Hidden::nothing(Region::sized(10, 5, 100, 90));
        let at = SensorPx::new(100.0, 49.0);
        hidden.hide(at, 3.0, |place| place.distance(at) < 2.5);
        let raised = band(&hidden)
            .dn
            .iter()
            .filter(|dn| **dn == HIDDEN_DN)
            .count();
        assert_eq!(raised, 21);
    }

    #[test]
    fn a_sector_s_middle_lies_in_it() {
        for sector in 0..96 {
            let middle = middle_of_sector(sector, 96) * 40.0;
            let (mut distance, mut found) = ([0.0], [0]);
            let unit = [1.0 / 40.0, 0.0, 1.0 / 40.0];
            locate(
                &[middle.x as f32],
                &[middle.y as f32],
                unit,
                96.0,
                &mut distance,
                &mut found,
            );
            assert_eq!(usize::from(found[0]), sector);
            assert!(distance[0].abs() < 1e-4);
        }
    }
}
