//! Borders of bright regions.
//!
//! A border runs between pixels, along the cracks between a bright one on its left and a dark one on its right. Following
//! it takes two reads of a pixel per step, so that a horizon costs thousands of pixels and not the millions of the picture.
//! It is first detected at the picture's edge or on one of a few rows (Braun and Barf 2022, sections 3.1 and 5).

use super::edge::EdgePoint;
use crate::frame::{Region, Sample, View};
use crate::units::SensorPx;
use nalgebra::Vector2;
use std::collections::HashSet;

/// Maximum number of border steps per pixel of the picture's width plus height. More steps indicate clutter.
const MOST_STEPS: usize = 16;
/// Number of steps per point; its direction is determined over as many steps on both sides.
const STEPS_PER_POINT: usize = 8;
/// 1 sigma of a point: pixels are discrete, and noise frays a soft edge.
const SIGMA_PX: f64 = 1.0;

/// Threshold that separates bright pixels from dark ones, with the mask of unused pixels.
pub(super) struct Binary<'a, T> {
    view: View<'a, T>,
    threshold_dn: f64,
    /// Pixels of the vehicle's own parts, which count as dark.
    mask: &'a [Region],
}

/// The direction of a step along the cracks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Heading {
    Right,
    Down,
    Left,
    Up,
}

impl Heading {
    fn step(self) -> (isize, isize) {
        match self {
            Self::Right => (1, 0),
            Self::Down => (0, 1),
            Self::Left => (-1, 0),
            Self::Up => (0, -1),
        }
    }

    fn turned_left(self) -> Self {
        match self {
            Self::Right => Self::Up,
            Self::Up => Self::Left,
            Self::Left => Self::Down,
            Self::Down => Self::Right,
        }
    }

    fn turned_right(self) -> Self {
        self.turned_left().turned_left().turned_left()
    }

    /// The pixels to the left and to the right of the crack that begins at a corner. Corner (0, 0) is the picture's corner.
    fn sides(self, (x, y): Corner) -> [(isize, isize); 2] {
        match self {
            Self::Right => [(x, y - 1), (x, y)],
            Self::Down => [(x, y), (x - 1, y)],
            Self::Left => [(x - 1, y), (x - 1, y - 1)],
            Self::Up => [(x - 1, y - 1), (x, y - 1)],
        }
    }
}

/// A corner of pixels.
type Corner = (isize, isize);

/// A border as a list of cracks: the corner where each begins, and its heading.
type Border = Vec<(Corner, Heading)>;

impl<'a, T: Sample> Binary<'a, T> {
    pub fn new(view: &View<'a, T>, threshold_dn: f64, mask: &'a [Region]) -> Self {
        Self {
            view: *view,
            threshold_dn,
            mask,
        }
    }

    /// Whether a pixel is bright; `None` outside the picture.
    fn is_bright(&self, (x, y): (isize, isize)) -> Option<bool> {
        let (x, y) = (usize::try_from(x).ok()?, usize::try_from(y).ok()?);
        if x >= self.view.width || y >= self.view.height {
            return None;
        }
        let dn: u32 = self.view.row(y)[x].into();
        Some(f64::from(dn) >= self.threshold_dn && !self.is_masked(x, y))
    }

    fn is_masked(&self, x: usize, y: usize) -> bool {
        self.mask.iter().any(|region| region.contains(x, y))
    }

    /// Whether a crack is part of a border.
    fn is_border(&self, corner: Corner, heading: Heading) -> bool {
        heading.sides(corner).map(|pixel| self.is_bright(pixel)) == [Some(true), Some(false)]
    }

    /// The border from a crack on: to the picture's edge, or back to its start. `None` if it has more than `most` steps.
    fn follow(&self, first: (Corner, Heading), most: usize) -> Option<Border> {
        let (mut corner, mut heading) = first;
        let mut border = vec![first];
        while border.len() < most {
            let (dx, dy) = heading.step();
            corner = (corner.0 + dx, corner.1 + dy);
            let [left, right] = heading.sides(corner).map(|pixel| self.is_bright(pixel));
            match (left, right) {
                (None, _) | (_, None) => return Some(border),
                (Some(false), _) => heading = heading.turned_left(),
                (_, Some(true)) => heading = heading.turned_right(),
                _ => {}
            }
            if (corner, heading) == first {
                return Some(border);
            }
            border.push((corner, heading));
        }
        None
    }

    /// The cracks at the picture's edge at which borders lead inwards.
    fn at_the_edge(&self) -> impl Iterator<Item = (Corner, Heading)> + '_ {
        let (width, height) = (self.view.width as isize, self.view.height as isize);
        let across =
            (1..width).flat_map(move |x| [((x, 0), Heading::Down), ((x, height), Heading::Up)]);
        let along =
            (1..height).flat_map(move |y| [((0, y), Heading::Right), ((width, y), Heading::Left)]);
        across
            .chain(along)
            .filter(|&(corner, heading)| self.is_border(corner, heading))
    }

    /// Points of the outer borders of bright regions that reach the picture's edge or one of the rows with the given
    /// spacing: one list for each stretch of a border that is not interrupted by a mask or the picture's edge.
    pub fn arcs(&self, row_spacing: usize) -> Vec<Vec<EdgePoint>> {
        let mut left = MOST_STEPS * (self.view.width + self.view.height);
        let rows: Vec<isize> = (row_spacing..self.view.height)
            .step_by(row_spacing.max(1))
            .map(|y| y as isize)
            .collect();
        let mut met: HashSet<Corner> = HashSet::new();
        let mut arcs = Vec::new();
        let mut take = |first: (Corner, Heading), met: &mut HashSet<Corner>| {
            let Some(border) = self.follow(first, left) else {
                left = 0;
                return;
            };
            left -= border.len();
            let on_rows = border
                .iter()
                .filter(|((_, y), heading)| *heading == Heading::Down && rows.contains(y));
            met.extend(on_rows.map(|(corner, _)| *corner));
            arcs.extend(self.stretches(&border));
        };
        for first in self.at_the_edge() {
            take(first, &mut met);
        }
        for &y in &rows {
            for x in 1..self.view.width as isize {
                let corner = (x, y);
                if self.is_border(corner, Heading::Down) && !met.contains(&corner) {
                    take((corner, Heading::Down), &mut met);
                }
            }
        }
        arcs
    }

    /// A border as points, without the cracks beside a mask; the border of a hole gives none.
    fn stretches(&self, border: &Border) -> Vec<Vec<EdgePoint>> {
        if is_hole(border) {
            return Vec::new();
        }
        let is_seen = |(corner, heading): &(Corner, Heading)| {
            self.mask.is_empty()
                || !heading
                    .sides(*corner)
                    .into_iter()
                    .any(|(x, y)| self.is_masked(x as usize, y as usize))
        };
        border
            .split(|crack| !is_seen(crack))
            .map(points)
            .filter(|points| !points.is_empty())
            .collect()
    }
}

/// Whether a border encloses a dark hole: with the bright side on its left, it then has the opposite orientation.
fn is_hole(border: &Border) -> bool {
    let (Some((first, _)), Some((last, heading))) = (border.first(), border.last()) else {
        return true;
    };
    let (dx, dy) = heading.step();
    let is_closed = (last.0 + dx, last.1 + dy) == *first;
    // Twice the area, positive if the border turns from x to y, with its inside on the right.
    let area: isize = border
        .iter()
        .map(|((x, y), heading)| {
            let (dx, dy) = heading.step();
            x * dy - y * dx
        })
        .sum();
    is_closed && area > 0
}

/// A point every few cracks, between its neighbours; the bright side follows from the direction of the border there.
fn points(cracks: &[(Corner, Heading)]) -> Vec<EdgePoint> {
    const REACH: usize = STEPS_PER_POINT;
    let middle = |&((x, y), heading): &(Corner, Heading)| {
        let (dx, dy) = heading.step();
        let half = Vector2::new(dx as f64, dy as f64) / 2.0;
        // A corner is half a pixel from the centres of its pixels.
        Vector2::new(x as f64 - 0.5, y as f64 - 0.5) + half
    };
    let mean = |cracks: &[(Corner, Heading)]| {
        cracks.iter().map(middle).sum::<Vector2<f64>>() / cracks.len() as f64
    };
    let at = (REACH..cracks.len().saturating_sub(REACH)).step_by(STEPS_PER_POINT);
    at.filter_map(|n| {
        let (before, after) = (mean(&cracks[n - REACH..n]), mean(&cracks[n..n + REACH]));
        let along = (after - before).try_normalize(0.0)?;
        Some(EdgePoint {
            at: SensorPx::from((before + after) / 2.0),
            inward: Vector2::new(along.y, -along.x),
            sigma_px: SIGMA_PX,
            of_brightness_px: 0.0,
        })
    })
    .collect()
}
