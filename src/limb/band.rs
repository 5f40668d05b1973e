//! The pixels about an outline, one list for each quantity, as the processor's wide instructions like it.

use super::hidden::{HIDDEN_DN, Hidden, pixels_within};
use crate::frame::{Frame, Sample, View};
use crate::geometry::Ellipse;
use crate::lanes::{LANES, Scratch, counted_lanes, first_lanes, larger, split};
use crate::with_view;
use multiversion::multiversion;
use nalgebra::Vector2;
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
        let mut places = Places::new(sectors.max(1));
        let ring = Ring::new(outline, reach);
        let inverse = outline.inverse().cast();
        with_view!(frame, view => gather(&mut places, &view, &ring, Lanes::AlongRow, hidden));
        let above_and_below = places.dn.len();
        with_view!(frame, view => gather(&mut places, &view, &ring, Lanes::AlongColumn, hidden));
        let mut distance_px = Scratch::of_length(places.dn.len());
        let (first, last) = distance_px.split_at_mut(above_and_below);
        for (inverse, from, distance_px) in [
            ([inverse.m11, inverse.m12, inverse.m22], 0, first),
            ([inverse.m22, inverse.m12, inverse.m11], above_and_below, last),
        ] {
            let (along, away) = (&places.along[from..], &places.away[from..]);
            locate(along, away, inverse, reach, distance_px, &mut places.dn[from..]);
        }
        Self {
            reach,
            distance_px,
            dn: places.dn,
            strips: places.strips,
        }
    }
}

/// Whether the pixels of a strip that lie side by side do so along a row of the sensor or along a column.
#[derive(Clone, Copy)]
enum Lanes {
    AlongRow,
    AlongColumn,
}

/// Where pixels are, px from the outline's centre along a strip's lanes and away from them, and how bright.
struct Places {
    along: Scratch<f32>,
    away: Scratch<f32>,
    dn: Scratch<f32>,
    strips: Vec<Strip>,
    sectors: usize,
}

/// Entries of a band about the Sun, and some more.
const USUAL_ENTRIES: usize = 12_000;

impl Places {
    fn new(sectors: usize) -> Self {
        let [along, away, dn] = std::array::from_fn(|_| Scratch::empty(USUAL_ENTRIES));
        Self {
            along,
            away,
            dn,
            strips: Vec::with_capacity(USUAL_ENTRIES / 128),
            sectors,
        }
    }
}

/// Takes the strips of a band whose lanes lie along rows, or along columns.
#[multiversion(targets("x86_64+avx2"))]
fn gather<T: Sample>(
    places: &mut Places,
    view: &View<'_, T>,
    ring: &Ring,
    lanes: Lanes,
    hidden: &Hidden,
) {
    let (x, y) = (ring.centre.x, ring.centre.y);
    let ((middle, length), (centre, depth)) = match lanes {
        Lanes::AlongRow => ((x, view.width), (y, view.height)),
        Lanes::AlongColumn => ((y, view.height), (x, view.width)),
    };
    let half = ring.most * std::f64::consts::FRAC_1_SQRT_2 + 1.0;
    for side in [-1.0, 1.0] {
        let columns = pixels_within(middle - half..middle + half, length);
        for first in columns.clone().step_by(LANES) {
            let columns = first..columns.end.min(first + LANES);
            let from_middle = first as f64 - middle;
            let away = ring.crossed_by(from_middle, side);
            let rows = pixels_within(centre + away.start..centre + away.end, depth);
            let begin = places.dn.len();
            let along = counted_lanes(from_middle as f32);
            for row in rows.clone() {
                places.along.extend_from_slice(&along);
                places.away.extend_from_slice(&[(row as f64 - centre) as f32; LANES]);
                places.dn.extend_from_slice(&match lanes {
                    Lanes::AlongRow => first_lanes(&view.pixels[row * view.width..][columns.clone()]),
                    Lanes::AlongColumn => lanes_down(view, row, columns.clone()),
                });
            }
            let dn = &mut places.dn[begin..];
            hide(dn, hidden, lanes, &columns, &rows);
            places.strips.push(Strip {
                entries: begin..begin + dn.len(),
                sectors: along.map(|along| {
                    let away = side as f32 * ring.limb_away(along);
                    let sectors = places.sectors as f32;
                    match lanes {
                        Lanes::AlongRow => sector_of([along, away], sectors),
                        Lanes::AlongColumn => sector_of([away, along], sectors),
                    }
                }),
            });
        }
    }
}

/// Pixels of a column in neighbouring rows; zeros where these end.
#[inline(always)]
fn lanes_down<T: Sample>(view: &View<'_, T>, column: usize, rows: Range<usize>) -> [f32; LANES] {
    let mut lanes = [0.0; LANES];
    let pixels = view.pixels[rows.start * view.width..].iter().skip(column).step_by(view.width);
    for (lane, pixel) in lanes.iter_mut().zip(pixels).take(rows.len()) {
        *lane = pixel.dn();
    }
    lanes
}

/// Raises what marks hide of a strip, and what is beyond the sensor's edge.
fn hide(dn: &mut [f32], hidden: &Hidden, lanes: Lanes, columns: &Range<usize>, rows: &Range<usize>) {
    if columns.len() < LANES {
        for group in dn.chunks_exact_mut(LANES) {
            group[columns.len()..].fill(NO_PIXEL_DN);
        }
    }
    match lanes {
        Lanes::AlongRow => {
            for (group, y) in dn.chunks_exact_mut(LANES).zip(rows.clone()) {
                hidden.each(y, columns.clone(), |n| group[n] = HIDDEN_DN);
            }
        }
        Lanes::AlongColumn => {
            for (lane, y) in columns.clone().enumerate() {
                hidden.each(y, rows.clone(), |n| dn[n * LANES + lane] = HIDDEN_DN);
            }
        }
    }
}

/// The ring about a disc's centre that holds the band, px.
struct Ring {
    centre: Vector2<f64>,
    radius: f64,
    least: f64,
    most: f64,
}

impl Ring {
    fn new(outline: &Ellipse, reach: Reach) -> Self {
        let radius = outline.mean_radius();
        let root = outline.root();
        let uneven = ((root.m11 - root.m22) / 2.0).hypot(root.m12);
        Self {
            centre: outline.centre,
            radius,
            least: radius - uneven - reach.inside_px,
            most: radius + uneven + reach.outside_px,
        }
    }

    /// Where the lanes from one so far from the middle on cross the quarter of the ring that lies on a side.
    fn crossed_by(&self, first: f64, side: f64) -> Range<f64> {
        let last = first + (LANES - 1) as f64;
        let nearest = if first * last < 0.0 { 0.0 } else { first.abs().min(last.abs()) };
        let farthest = first.abs().max(last.abs());
        let height = |radius: f64, along: f64| (radius * radius - along * along).max(0.0).sqrt();
        let inner = height(self.least.max(0.0), farthest).max(nearest - 1.0);
        let outer = height(self.most, nearest) + 1.0;
        if side < 0.0 { -outer..-inner } else { inner..outer }
    }

    /// How far away the limb crosses a lane, or the quarter's end.
    #[inline(always)]
    fn limb_away(&self, along: f32) -> f32 {
        let radius = self.radius as f32;
        larger(radius * radius - along * along, along * along).sqrt()
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

/// Distance outwards from the outline of places about its centre, `inverse` as for [`outwards`]. What is nearer to the other
/// axis, and what is out of reach, is no pixel.
#[multiversion(targets("x86_64+avx2"))]
fn locate(
    along: &[f32],
    away: &[f32],
    inverse: [f32; 3],
    reach: Reach,
    distance_px: &mut [f32],
    dn: &mut [f32],
) {
    let count = distance_px.len();
    let (along, away, dn) = (&along[..count], &away[..count], &mut dn[..count]);
    let (inside, outside) = (reach.inside_px as f32, reach.outside_px as f32);
    for n in 0..count {
        let ([u, v], distance) = outwards(inverse, along[n], away[n]);
        let belongs = (distance > -inside) & (distance < outside) & (u.abs() <= v.abs());
        distance_px[n] = if belongs { distance } else { outside };
        dn[n] = if belongs { dn[n] } else { NO_PIXEL_DN };
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
