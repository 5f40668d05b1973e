//! Sharp falls of the brightness along rows and columns of a picture: the limb in front of dark space, and anything else
//! with such an edge.
//!
//! A terminator, a glow or a gradient falls off over degrees, the limb over the scale height of the air (or a sharp sphere
//! over the camera's blur). A fall counts if it takes place within this reach, and not beyond it.

use super::edge::EdgePoint;
use super::profile::{interpolated, is_inside};
use crate::frame::{Region, Sample, View};
use crate::units::SensorPx;
use nalgebra::Vector2;

/// Largest spacing of rows and columns, and minimum number of lines across a small sphere or a small picture.
const MOST_SPACING_PX: f64 = 54.0;
const LINES_ACROSS_SPHERE: f64 = 8.0;
const LINES_ACROSS_PICTURE: f64 = 20.0;
/// The reach in scale heights, and its limits in px.
const REACH_SCALES: f64 = 2.0;
const REACH_PX: std::ops::Range<f64> = 3.0..60.0;
/// Maximum reach, relative to the radius of a small sphere.
const MOST_REACH: f64 = 0.25;
/// Samples of a line on each side of an edge.
const SAMPLES: usize = 2;
/// An edge that crosses a line at a smaller sine is found by the lines of the other direction.
const LEAST_ACROSS: f64 = 0.6;
/// Distances from the edge at which the brightness is read, in reaches: near it, and where it falls off no more.
const NEAR: [f64; 3] = [0.5, 1.0, 1.5];
const FAR: [f64; 2] = [2.4, 3.0];
/// Relative to the fall itself: maximum further fall outside and inside, and minimum brightness there.
const MOST_FALL_OUTSIDE: f64 = 0.5;
const MOST_FALL_INSIDE: f64 = 0.6;
const LEAST_INSIDE: f64 = 0.4;
/// 1 sigma of a point.
const SIGMA_PX: f64 = 1.0;

/// Parameters of a scan.
#[derive(Debug, Clone, Copy)]
pub(super) struct Scan {
    spacing: usize,
    /// Pixels between successive samples of a line.
    stride: usize,
    /// Distance on each side over which the light of an edge falls off.
    reach_px: f64,
    least_dn: f64,
}

impl Scan {
    /// For edges whose light falls to 1/e over `scale_px`, of a sphere with the given radius in the picture; they must be
    /// brighter than the outside by `least_dn`.
    pub fn new<T>(view: &View<'_, T>, scale_px: f64, radius_px: f64, least_dn: f64) -> Self {
        let shorter_px = view.width.min(view.height) as f64;
        let spacing_px = (2.0 * radius_px / LINES_ACROSS_SPHERE)
            .min(shorter_px / LINES_ACROSS_PICTURE)
            .clamp(1.0, MOST_SPACING_PX);
        let reach_px = (REACH_SCALES * scale_px).clamp(REACH_PX.start, REACH_PX.end);
        let reach_px = reach_px.min((MOST_REACH * radius_px).max(1.0));
        Self {
            spacing: spacing_px as usize,
            stride: ((reach_px / SAMPLES as f64) as usize).max(1),
            reach_px,
            least_dn,
        }
    }

    /// The sharp edges along all lines.
    pub fn edges<T: Sample>(&self, view: &View<'_, T>, mask: &[Region]) -> Vec<EdgePoint> {
        let (mut points, mut light) = (Vec::new(), Vec::new());
        let first = self.spacing / 2;
        for y in (first..view.height).step_by(self.spacing) {
            light.clear();
            light.extend(view.row(y).chunks(self.stride).map(|some| some[0].dn()));
            for x in self.falls(&light) {
                points.extend(self.edge(view, mask, Vector2::new(x, y as f64), Vector2::x()));
            }
        }
        for x in (first..view.width).step_by(self.spacing) {
            light.clear();
            let rows = (0..view.height).step_by(self.stride);
            light.extend(rows.map(|y| view.dn(x, y)));
            for y in self.falls(&light) {
                points.extend(self.edge(view, mask, Vector2::new(x as f64, y), Vector2::y()));
            }
        }
        points
    }

    /// The positions of a line at which the two sides differ most in brightness, px.
    fn falls(&self, light: &[f32]) -> Vec<f64> {
        const BLOCK: usize = 32;
        let side = ((self.reach_px / self.stride as f64) as usize).max(1);
        // Excess of the first side over the second.
        let mut falls = vec![0.0_f32; light.len().saturating_sub(2 * side - 1)];
        for n in 0..side {
            let sides = light[n..].iter().zip(&light[n + side..]);
            for (fall, (first, second)) in falls.iter_mut().zip(sides) {
                *fall += first - second;
            }
        }
        let least = (self.least_dn * side as f64) as f32;
        let near = side.div_ceil(2);
        let is_most = |n: usize, fall: f32| {
            let before = &falls[n.saturating_sub(near)..n];
            let after = &falls[n + 1..(n + near + 1).min(falls.len())];
            before.iter().all(|other| other.abs() < fall)
                && after.iter().all(|other| other.abs() <= fall)
        };
        let mut places = Vec::new();
        for (some, first) in falls.chunks(BLOCK).zip((0..).step_by(BLOCK)) {
            // Most of a line is flat.
            if !some
                .iter()
                .fold(false, |any, fall| any | (fall.abs() > least))
            {
                continue;
            }
            for (fall, n) in some.iter().map(|fall| fall.abs()).zip(first..) {
                if fall > least && is_most(n, fall) {
                    places.push((n as f64 + side as f64 - 0.5) * self.stride as f64);
                }
            }
        }
        places
    }

    /// The edge at a position of a line, if it is sharp and crosses the line.
    fn edge<T: Sample>(
        &self,
        view: &View<'_, T>,
        mask: &[Region],
        at: Vector2<f64>,
        line: Vector2<f64>,
    ) -> Option<EdgePoint> {
        let light = |at: Vector2<f64>| -> Option<f64> {
            let at = SensorPx::from(at);
            is_inside(view, mask, at).then(|| f64::from(interpolated(view, at)))
        };
        let mean = |towards: Vector2<f64>, places: &[f64]| -> Option<f64> {
            let mut sum = 0.0;
            for n in places {
                sum += light(at + towards * (n * self.reach_px))?;
            }
            Some(sum / places.len() as f64)
        };
        let rise = |axis: Vector2<f64>| Some(mean(axis, &NEAR)? - mean(-axis, &NEAR)?);
        let inward = Vector2::new(rise(Vector2::x())?, rise(Vector2::y())?).try_normalize(0.0)?;
        if inward.dot(&line).abs() <= LEAST_ACROSS {
            return None;
        }
        let (inside, outside) = (mean(inward, &NEAR)?, mean(-inward, &NEAR)?);
        let (deep, far) = (mean(inward, &FAR)?, mean(-inward, &FAR)?);
        let fall = inside - outside;
        let is_sharp = fall > self.least_dn
            && outside - far < MOST_FALL_OUTSIDE * fall
            && deep - inside < MOST_FALL_INSIDE * fall
            && deep - outside > LEAST_INSIDE * fall;
        is_sharp.then(|| EdgePoint {
            at: at.into(),
            inward,
            sigma_px: SIGMA_PX,
            of_brightness_px: 0.0,
        })
    }
}
