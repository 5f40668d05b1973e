//! Profiles of brightness across the edge of a cone.

use super::edge::EdgePoint;
use super::sphere::{Cone, ConeEdge, Sphere};
use crate::frame::{Region, Sample, View};
use crate::geometry::camera::CameraModel;
use crate::instrument::DirectionCamera;
use crate::kernels::paths::{COLUMNS, OnPath, follow_path, light_on_path};
use crate::kernels::{LANES, larger};
use crate::units::SensorPx;
use nalgebra::{UnitComplex, UnitVector3, Vector2};
use std::f64::consts::TAU;
use std::iter;
use std::ops::Range;

/// Range of the number of places around the edge.
const LEAST_PLACES: usize = 96;
const MOST_PLACES: usize = 960;
/// Range of the number of samples of a profile on each side of the edge.
const LEAST_SAMPLES: usize = 6;
const MOST_SAMPLES: usize = 42;
/// If the picture's scale outwards is less than this fraction of the scale at its axis, as near the limit of a lens, it
/// shows no profile.
const LEAST_GROWTH: f64 = 0.3;
/// The outer fraction of a profile that shows the dark sky.
const SKY_SHARE: f64 = 0.15;
/// Noise of a value interpolated between four pixels relative to that of one, on average.
pub(super) const INTERPOLATED_NOISE: f64 = 2.0 / 3.0;

/// A place of the edge: its path in the picture, the position c0 + c1 t + c2 t^2, px, at t steps outside of the edge.
#[derive(Debug, Clone, Copy)]
pub(super) struct Place {
    path: [Vector2<f64>; 3],
}

impl Place {
    fn at(&self, steps: f64) -> SensorPx {
        let [c0, c1, c2] = self.path;
        (c0 + (c1 + c2 * steps) * steps).into()
    }

    /// Parameters at which the path turns back along x or y, if it does.
    fn turns(&self) -> impl Iterator<Item = f64> + use<> {
        let [_, c1, c2] = self.path;
        let turns = [0, 1].map(|axis| -c1[axis] / (2.0 * c2[axis]));
        turns.into_iter().filter(|t| t.is_finite())
    }

    pub fn point(&self, steps: f64, sigma_steps: f64) -> EdgePoint {
        let per_step = self.path[1] + self.path[2] * (2.0 * steps);
        EdgePoint {
            at: self.at(steps),
            inward: -per_step.normalize(),
            sigma_px: sigma_steps * per_step.norm(),
            of_brightness_px: 0.0,
        }
    }
}

/// Profiles of brightness across the edge of a cone at places along it, DN, from the inside outwards.
pub(super) struct Profiles {
    pub places: Vec<Place>,
    /// The values of the first place, then those of the next, each padded with meaningless values.
    light_dn: Vec<f32>,
    /// Distance between the beginnings of successive profiles: whole [`COLUMNS`].
    pub stride: usize,
    /// Number of samples of each, and the index of the sample on the edge.
    pub length: usize,
    pub edge: usize,
    pub step_rad: f64,
    pub step_px: f64,
}

/// Steps of the profiles across the edge.
#[derive(Debug, Clone, Copy)]
struct Steps {
    step_rad: f64,
    inside: usize,
    outside: usize,
    /// Sine and cosine of the angle from the edge to the first and to the last sample.
    first: (f64, f64),
    last: (f64, f64),
}

impl Steps {
    fn of(sphere: &Sphere, camera: &CameraModel) -> Self {
        let reach = sphere.inside_rad.max(sphere.outside_rad);
        let step_rad = (1.0 / camera.mean_focal_px()).max(reach / MOST_SAMPLES as f64);
        let samples = |reach_rad: f64| ((reach_rad / step_rad) as usize).max(LEAST_SAMPLES);
        let (inside, outside) = (samples(sphere.inside_rad), samples(sphere.outside_rad));
        Self {
            step_rad,
            inside,
            outside,
            first: (-(inside as f64) * step_rad).sin_cos(),
            last: (outside as f64 * step_rad).sin_cos(),
        }
    }
}

impl Profiles {
    /// Profiles at places of a cone's edge with the given spacing, if the whole profile is in view and not masked.
    pub fn of<T: Sample>(
        view: &View<'_, T>,
        camera: &DirectionCamera,
        sphere: &Sphere,
        nadir: &UnitVector3<f64>,
        spacing_px: f64,
    ) -> Self {
        let DirectionCamera {
            lens: camera, mask, ..
        } = camera;
        let steps = Steps::of(sphere, camera);
        let length = steps.inside + 1 + steps.outside;
        let around = TAU * camera.mean_focal_px() * sphere.half_angle_rad.value.sin();
        let count = ((around / spacing_px) as usize).clamp(LEAST_PLACES, MOST_PLACES);
        let cone = Cone::new(sphere, nadir);
        let is_seen = |at: SensorPx| is_inside(view, mask, at);
        let turn = UnitComplex::new(TAU / count as f64);
        let around = iter::successors(Some(Vector2::x()), |last| Some(turn * last));
        let places: Vec<Place> = around
            .take(count)
            .filter_map(|around| place(&cone.edge(&around), camera, &steps, is_seen))
            .collect();
        let stride = length.next_multiple_of(COLUMNS);
        let mut groups = vec![OnPath::default(); length.div_ceil(LANES)];
        let mut light = vec![0.0; stride];
        let mut light_dn = Vec::with_capacity(places.len() * stride);
        for place in &places {
            let first = -(steps.inside as f32);
            read_along(view, &place.path, first, &mut groups, &mut light);
            light_dn.extend_from_slice(&light);
        }
        Self {
            places,
            light_dn,
            stride,
            length,
            edge: steps.inside,
            step_rad: steps.step_rad,
            step_px: steps.step_rad * camera.mean_focal_px(),
        }
    }

    /// The profile of each place.
    pub fn light(&self) -> impl Iterator<Item = &[f32]> {
        self.filled_up().map(|light| &light[..self.length])
    }

    /// The same including the padding.
    pub fn filled_up(&self) -> impl Iterator<Item = &[f32]> {
        self.light_dn.chunks_exact(self.stride)
    }

    /// The samples that show the sky.
    pub fn sky(&self) -> Range<usize> {
        let outside = self.length - self.edge;
        let sky = ((outside as f64 * SKY_SHARE) as usize).max(2);
        self.length - sky..self.length
    }

    /// The position where each profile falls through the middle of its own range: the edge while nothing is known of the
    /// profile.
    pub fn crossings(&self, least_contrast_dn: f64) -> Vec<EdgePoint> {
        const SIGMA_STEPS: f64 = 1.0;
        // Because of noise the brightest sample is brighter than the limb.
        const AVERAGED: usize = 5;
        let crossing = |(place, light): (&Place, &[f32])| {
            let dark = mean_dn(&light[self.sky()]);
            let sums = light.windows(AVERAGED).map(|some| some.iter().sum());
            let bright = f64::from(sums.fold(f32::MIN, larger)) / AVERAGED as f64;
            if bright - dark < least_contrast_dn {
                return None;
            }
            let steps = falls_through(light, (dark + bright) / 2.0)? - self.edge as f64;
            Some(place.point(steps, SIGMA_STEPS))
        };
        self.places
            .iter()
            .zip(self.light())
            .filter_map(crossing)
            .collect()
    }
}

/// The place at a cone's edge; `None` if its profile is not in view (its ends, its centre and its turning points), or too
/// near the lens's limit.
fn place(
    edge: &ConeEdge,
    camera: &CameraModel,
    steps: &Steps,
    is_seen: impl Fn(SensorPx) -> bool,
) -> Option<Place> {
    let seen = |ray: UnitVector3<f64>| {
        let at = camera.pixel(&ray)?;
        is_seen(at).then(|| at.vector())
    };
    // The parabola through three pixels of the profile. Most places of a wide cone fail at the first.
    let on = seen(edge.ray())?;
    let (below, above) = (
        seen(edge.outside(steps.first))?,
        seen(edge.outside(steps.last))?,
    );
    let (low, high) = (-(steps.inside as f64), steps.outside as f64);
    if camera.growth(&edge.ray()) < LEAST_GROWTH {
        return None;
    }
    let (to_low, to_high) = ((below - on) / low, (above - on) / high);
    let curvature = (to_high - to_low) / (high - low);
    let place = Place {
        path: [on, to_low - curvature * low, curvature],
    };
    // Between the three pixels a curved path may leave the picture, farthest at its turning points.
    place
        .turns()
        .filter(|t| (low..high).contains(t))
        .all(|t| is_seen(place.at(t)))
        .then_some(place)
}

/// Whether all pixels around a position are in the picture and not masked.
pub(super) fn is_inside<T>(view: &View<'_, T>, mask: &[Region], at: SensorPx) -> bool {
    let within = |v: f64, size: usize| (0.0..size as f64 - 1.0).contains(&v);
    within(at.x, view.width) && within(at.y, view.height) && (mask.is_empty() || is_seen(mask, at))
}

fn is_seen(mask: &[Region], at: SensorPx) -> bool {
    let (x, y) = (at.x.round() as usize, at.y.round() as usize);
    !mask.iter().any(|region| region.contains(x, y))
}

/// Reads the brightness at the steps of a path, as in `Place`, from `first` on, in whole groups. Steps that count must be
/// inside the picture; the values of the others are meaningless.
pub(super) fn read_along<T: Sample>(
    view: &View<'_, T>,
    path: &[Vector2<f64>; 3],
    first: f32,
    groups: &mut [OnPath],
    light: &mut [f32],
) {
    let path = [0, 1].map(|axis| path.map(|c| c[axis] as f32));
    follow_path(path, first, [view.width, view.height], groups);
    for group in &mut *groups {
        for k in 0..LANES {
            let square = view.square(group.column[k] as usize, group.row[k] as usize);
            for (pixels, dn) in group.pixels.iter_mut().zip(square) {
                pixels[k] = dn.into();
            }
        }
    }
    light_on_path(groups, light);
}

/// The brightness interpolated between four pixels, DN. The position must be inside the picture.
#[inline(always)]
pub(super) fn interpolated<T: Sample>(view: &View<'_, T>, at: SensorPx) -> f32 {
    // Small integers are converted more quickly.
    let (x, y) = (at.x as u32, at.y as u32);
    let (right, below) = ((at.x - f64::from(x)) as f32, (at.y - f64::from(y)) as f32);
    let [left, at_right, under, diagonal] = view.square(x as usize, y as usize).map(Sample::dn);
    let above = left + (at_right - left) * right;
    let under = under + (diagonal - under) * right;
    above + (under - above) * below
}

pub(super) fn mean_dn(light: &[f32]) -> f64 {
    light.iter().map(|dn| f64::from(*dn)).sum::<f64>() / light.len() as f64
}

/// The last position, in samples, at which the brightness falls below a level.
pub(super) fn falls_through(light: &[f32], level: f64) -> Option<f64> {
    let level = level as f32;
    let n = light
        .windows(2)
        .rposition(|pair| pair[0] >= level && pair[1] < level)?;
    Some(n as f64 + f64::from((light[n] - level) / (light[n] - light[n + 1])))
}
