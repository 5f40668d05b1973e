//! The pixels about an outline, one list for each quantity, as the processor's wide instructions like it.

use super::hidden::{HIDDEN_DN, Hidden, pixels_within};
use crate::frame::{Frame, Sample, View};
use crate::geometry::Ellipse;
use crate::lanes::{LANES, Scratch, counted_lanes, larger, smaller, split};
use crate::with_view;
use multiversion::multiversion;
use nalgebra::Vector2;
use std::f64::consts::FRAC_1_SQRT_2;
use std::ops::Range;

/// How far a band reaches from its outline, px.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Reach {
    pub inside_px: f64,
    pub outside_px: f64,
}

/// The pixels about an outline, strip by strip. Entries that are no pixels of the band are [`NO_PIXEL_DN`].
pub(super) struct Band {
    pub reach: Reach,
    /// Outwards from the outline.
    pub distance_px: Scratch<f32>,
    /// Brightness; [`HIDDEN_DN`] where it is hidden.
    pub dn: Scratch<f32>,
    pub strips: Vec<Strip>,
}

/// Neighbouring columns that cross the limb above or below the disc's centre, or rows that do beside it, so that pixels
/// which lie side by side in a list do so along the limb.
pub(super) struct Strip {
    /// Entries of the band, by groups of [`LANES`]: a pixel of each column, or row.
    pub entries: Range<usize>,
    /// The sector of the direction, from the disc's centre, in which each column or row crosses the limb.
    pub sectors: [u16; LANES],
}

/// Brightness of what is no pixel: without weight by itself, like that of a hidden one.
const NO_PIXEL_DN: f32 = 2.0 * HIDDEN_DN;

impl Band {
    pub(super) fn about(
        frame: &Frame,
        outline: &Ellipse,
        reach: Reach,
        hidden: &Hidden,
        sectors: usize,
    ) -> Self {
        let mut band = Self {
            reach,
            distance_px: Scratch::empty(USUAL_ENTRIES),
            dn: Scratch::empty(USUAL_ENTRIES),
            strips: Vec::with_capacity(USUAL_STRIPS),
        };
        for lanes in [Lanes::AlongRow, Lanes::AlongColumn] {
            let ring = Ring::new(outline, reach, lanes);
            for side in [-1.0, 1.0] {
                with_view!(frame, view => band.take_quarter(&view, &ring, side, hidden, sectors));
            }
        }
        band
    }

    /// Strips from all round, as many as tell what is the same everywhere.
    pub(super) fn sample(&self) -> impl Iterator<Item = &Strip> {
        self.strips
            .iter()
            .step_by((self.strips.len() / SAMPLE).max(1))
    }

    /// Takes the strips of the quarter that lies on one side of the middle.
    fn take_quarter<T: Sample>(
        &mut self,
        view: &View<'_, T>,
        ring: &Ring,
        side: f64,
        hidden: &Hidden,
        sectors: usize,
    ) {
        let [width, height] = ring.lanes.swapped([view.width, view.height]);
        let [middle, centre] = ring.centre;
        let half = ring.most * FRAC_1_SQRT_2 + 1.0;
        let all = pixels_within(middle - half..middle + half, width);
        for first in all.clone().step_by(LANES) {
            let columns = first..all.end.min(first + LANES);
            let along = counted_lanes((first as f64 - middle) as f32);
            let rows = ring.crossed_by(along, side, height);
            let begin = self.dn.len();
            let end = begin + rows.count * LANES;
            self.dn.resize(end, 0.0);
            self.distance_px.resize(end, 0.0);
            let (dn, distance_px) = (&mut self.dn[begin..], &mut self.distance_px[begin..]);
            ring.lanes.copy(view, &columns, &rows, dn);
            hide(dn, hidden, ring.lanes, &columns, &rows);
            let across = rows.first.map(|row| (f64::from(row) - centre) as f32);
            locate(ring, self.reach, [along, across], distance_px, dn);
            self.strips.push(Strip {
                entries: begin..end,
                sectors: ring.sectors(along, side as f32, sectors),
            });
        }
    }
}

/// The rows of a strip's columns, as many of each from its own first one on, as the limb slants.
struct Rows {
    first: [u32; LANES],
    count: usize,
}

impl Rows {
    fn of_column(&self, lane: usize) -> Range<usize> {
        let first = self.first[lane] as usize;
        first..first + self.count
    }

    fn of_all(&self) -> Range<usize> {
        let (least, most) = self.first.iter().fold((u32::MAX, 0), |(least, most), row| {
            (least.min(*row), most.max(*row))
        });
        least as usize..most as usize + self.count
    }
}

/// So many strips tell the typical brightness and the noise.
const SAMPLE: usize = 20;
/// Entries and strips of a band about the Sun, and some more.
const USUAL_ENTRIES: usize = 12_000;
const USUAL_STRIPS: usize = 90;

/// Whether the pixels of a strip that lie side by side do so along a row of the sensor or along a column.
#[derive(Clone, Copy)]
enum Lanes {
    AlongRow,
    AlongColumn,
}

impl Lanes {
    /// What belongs to x and y, in the order of along the lanes and across them; and back.
    #[inline(always)]
    fn swapped<V>(self, [x, y]: [V; 2]) -> [V; 2] {
        match self {
            Self::AlongRow => [x, y],
            Self::AlongColumn => [y, x],
        }
    }

    /// Copies a strip's pixels.
    fn copy<T: Sample>(
        self,
        view: &View<'_, T>,
        columns: &Range<usize>,
        rows: &Rows,
        dn: &mut [f32],
    ) {
        let [_, step] = self.swapped([1, view.width]);
        let starts = std::array::from_fn(|k| {
            // Beyond the sensor's edge stands the last column once more, until it is hidden.
            let column = (columns.start + k).min(columns.end - 1);
            let [x, y] = self.swapped([column, rows.first[k] as usize]);
            view.pixels.get(y * view.width + x..).unwrap_or(&[])
        });
        copy_lanes(starts, step, dn);
    }
}

/// Copies pixels from where each lane starts on, every `step`-th.
#[multiversion(targets("x86_64+avx2"))]
fn copy_lanes<T: Sample>(starts: [&[T]; LANES], step: usize, dn: &mut [f32]) {
    let shortest = starts
        .iter()
        .fold(usize::MAX, |least, lane| least.min(lane.len()));
    // Of one length, so that all lanes' places are checked at once.
    let mut lanes = starts;
    for lane in &mut lanes {
        *lane = &lane[..shortest];
    }
    for (n, group) in dn.as_chunks_mut::<LANES>().0.iter_mut().enumerate() {
        let at = n * step;
        for k in 0..LANES {
            group[k] = lanes[k][at].dn();
        }
    }
}

/// Raises what marks hide of a strip, and what is beyond the sensor's edge.
fn hide(dn: &mut [f32], hidden: &Hidden, lanes: Lanes, columns: &Range<usize>, rows: &Rows) {
    if columns.len() < LANES {
        for group in dn.as_chunks_mut::<LANES>().0 {
            group[columns.len()..].fill(NO_PIXEL_DN);
        }
    }
    let [x, y] = lanes.swapped([columns.clone(), rows.of_all()]);
    if hidden.is_bare(&x, &y) {
        return;
    }
    match lanes {
        Lanes::AlongRow => {
            for y in y {
                hidden.each(y, &x, |k| {
                    let row = y.wrapping_sub(rows.first[k] as usize);
                    if row < rows.count {
                        dn[row * LANES + k] = HIDDEN_DN;
                    }
                });
            }
        }
        Lanes::AlongColumn => {
            for (k, y) in y.enumerate() {
                hidden.each(y, &rows.of_column(k), |row| dn[row * LANES + k] = HIDDEN_DN);
            }
        }
    }
}

/// The ring about a disc's centre that holds the band, px; coordinates along the strips' lanes and across them.
struct Ring {
    lanes: Lanes,
    centre: [f64; 2],
    /// The outline's inverse root, as [`outwards`] takes it.
    inverse: [f32; 3],
    radius: f64,
    least: f64,
    most: f64,
}

impl Ring {
    fn new(outline: &Ellipse, reach: Reach, lanes: Lanes) -> Self {
        let radius = outline.mean_radius();
        let (root, inverse) = (outline.root(), outline.inverse().cast());
        let uneven = ((root.m11 - root.m22) / 2.0).hypot(root.m12);
        let [along, across] = lanes.swapped([inverse.m11, inverse.m22]);
        Self {
            lanes,
            centre: lanes.swapped(outline.centre.into()),
            inverse: [along, inverse.m12, across],
            radius,
            least: radius - uneven - reach.inside_px,
            most: radius + uneven + reach.outside_px,
        }
    }

    /// Where lanes, so far from the middle, cross the quarter of the ring that lies on a side of it.
    fn crossed_by(&self, along: [f32; LANES], side: f64, height: usize) -> Rows {
        let (mut first, mut end) = ([0; LANES], [0; LANES]);
        find_rows(self, along, side < 0.0, height as f32, &mut first, &mut end);
        let counts = first
            .iter()
            .zip(&end)
            .map(|(first, end)| end.saturating_sub(*first));
        let count = counts.fold(0, u32::max);
        let last = (height as u32).saturating_sub(count);
        Rows {
            first: first.map(|row| row.min(last)),
            count: count as usize,
        }
    }

    /// The sectors in which lanes cross the limb, or the quarter's end.
    fn sectors(&self, along: [f32; LANES], side: f32, sectors: usize) -> [u16; LANES] {
        let mut found = [0; LANES];
        find_sectors(self, along, side, sectors as f32, &mut found);
        found
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

/// Distances outwards from the outline of a strip's entries, of which the first ones are `from` the centre. What is nearer to
/// the other axis, and what is out of reach, is no pixel.
#[multiversion(targets("x86_64+avx2"))]
fn locate(
    ring: &Ring,
    reach: Reach,
    from: [[f32; LANES]; 2],
    distance_px: &mut [f32],
    dn: &mut [f32],
) {
    let (inside, outside) = (reach.inside_px as f32, reach.outside_px as f32);
    let [along, first] = from;
    let groups = distance_px.as_chunks_mut::<LANES>().0;
    for (row, (distance_px, dn)) in groups
        .iter_mut()
        .zip(dn.as_chunks_mut::<LANES>().0)
        .enumerate()
    {
        let row = row as i32 as f32;
        for k in 0..LANES {
            let ([u, v], distance) = outwards(ring.inverse, along[k], first[k] + row);
            let belongs = (distance > -inside) & (distance < outside) & (u.abs() <= v.abs());
            distance_px[k] = if belongs { distance } else { outside };
            dn[k] = larger(dn[k], if belongs { 0.0 } else { NO_PIXEL_DN });
        }
    }
}

/// The first row that each lane crosses the ring in, and the one after the last.
#[multiversion(targets("x86_64+avx2"))]
fn find_rows(
    ring: &Ring,
    along: [f32; LANES],
    above: bool,
    height: f32,
    first: &mut [u32; LANES],
    end: &mut [u32; LANES],
) {
    let [least, most] = [ring.least.max(0.0), ring.most].map(|radius| (radius * radius) as f32);
    let centre = ring.centre[1] as f32;
    for k in 0..LANES {
        let square = along[k] * along[k];
        // Half a pixel for an ellipse's quarters, which are not quite those of the sensor.
        let inner = larger(larger(least - square, 0.0).sqrt(), along[k].abs() - 0.5);
        let outer = larger(most - square, 0.0).sqrt();
        let from = centre + if above { -outer } else { inner };
        let to = centre + if above { -inner } else { outer };
        first[k] = split(smaller(larger(from, 0.0), height) + 0.99).0;
        end[k] = split(smaller(larger(to, 0.0), height) + 0.99).0;
    }
}

#[multiversion(targets("x86_64+avx2"))]
fn find_sectors(
    ring: &Ring,
    along: [f32; LANES],
    side: f32,
    sectors: f32,
    found: &mut [u16; LANES],
) {
    let radius2 = (ring.radius * ring.radius) as f32;
    for k in 0..LANES {
        let square = along[k] * along[k];
        let across = side * larger(radius2 - square, square).sqrt();
        found[k] = sector_of(ring.lanes.swapped([along[k], across]), sectors);
    }
}

/// The sector of a direction from the disc's centre.
#[inline(always)]
fn sector_of([x, y]: [f32; 2], sectors: f32) -> u16 {
    let along = y / (x.abs() + y.abs() + f32::MIN_POSITIVE);
    let quarters = if x >= 0.0 { 1.0 + along } else { 3.0 - along };
    // A number that stands just below the next sector may be taken for it.
    split((quarters * sectors / 4.0).clamp(0.0, sectors - 0.51)).0 as u16
}

/// The direction of the middle of one of so many sectors: the inverse of [`sector_of`].
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
    use super::*;
    use crate::frame::{FrameInfo, Pixels, Region};
    use crate::units::SensorPx;
    use nalgebra::Matrix2;

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
            let found = sector_of([middle.x as f32, middle.y as f32], 96.0);
            assert_eq!(usize::from(found), sector);
        }
    }
}
