//! The nadir from a circle through a border, by the method of HORACE (2014, sections 2.2.4 to 2.2.6), and the local
//! vertical of two cameras from their circles (Lomaka, Belokonov and Ustugov 2016, section 2.1).
//!
//! Both approximate the horizon by a circle in the picture, which is valid for a narrow field. In the stereographic plane,
//! where a ray at an angle from the axis lies at tan(angle / 2), every cone of rays is a circle, so the border is
//! transformed to that plane first.

use super::border::Binary;
use super::edge::EdgeRay;
use super::light::Levels;
use super::search::{LEAST_PLACES, no_horizon};
use super::{HorizonSettings, Sphere, Stage, Stopped};
use crate::estimation::{median, regression};
use crate::frame::{Frame, Region};
use crate::instrument::DirectionCamera;
use crate::reasons::horizon as reasons;
use crate::units::EARTH_RADIUS_M;
use crate::with_view;
use nalgebra::{Rotation3, UnitVector3, Vector2, Vector3};
use std::f64::consts::PI;

/// A part of the picture is divided while its halves are at least this long (HORACE, table 3.1).
const LEAST_DIVIDED_PX: usize = 400;
/// Ratio of the radius of the sphere's picture to that expected from the height: success by HORACE's definition (section
/// 1.3.5).
const RADIUS_RATIO: std::ops::Range<f64> = 0.9..1.1;
/// Distance of the fitted centre from the true one relative to the sphere's radius, by the same definition.
const MOST_CENTRE_ERROR: f64 = 0.1;
/// Planes with a smaller angle between them, rad, have no usable line of intersection.
const LEAST_CROSSING_RAD: f64 = 0.02;

/// Circle fitted to the border.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Circle {
    pub nadir: UnitVector3<f64>,
    /// Direction in the picture, from the axis to the nadir.
    pub towards: Vector2<f64>,
    /// Half-angle of the cone of rays on the circle.
    pub half_angle_rad: f64,
}

impl Circle {
    /// The camera's height from the circle's radius (eq. 2.38), for a sphere whose edge is at the height `edge_m`, m.
    pub fn height_m(&self, edge_m: f64) -> f64 {
        (EARTH_RADIUS_M + edge_m) / self.half_angle_rad.sin() - EARTH_RADIUS_M
    }

    /// Whether it is a success by HORACE's definition: radius and centre of the sphere within a tenth of its radius.
    pub fn succeeds(&self, sphere: &Sphere, truth: &UnitVector3<f64>) -> bool {
        let half_angle_rad = sphere.half_angle_rad.value;
        // The centre is 1 / sin(half-angle) radii away from the camera.
        let centre_error = 2.0 * (self.nadir.angle(truth) / 2.0).sin() / half_angle_rad.sin();
        RADIUS_RATIO.contains(&(self.half_angle_rad.tan() / half_angle_rad.tan()))
            && centre_error < MOST_CENTRE_ERROR
    }
}

/// The circle through the longest border of a frame; if that is no circle, the median of the circles of the frame's halves,
/// or of their halves.
///
/// # Errors
/// The reason why the whole frame shows none, if no part does.
pub fn circle(
    settings: &HorizonSettings,
    frame: &Frame,
    camera: &DirectionCamera,
    sphere: &Sphere,
) -> Result<Circle, Stopped> {
    let part = |region| in_part(settings, frame, camera, sphere, region);
    part(frame.region()).or_else(|stopped| {
        let circles = divided(frame.region(), &part);
        middle(&circles).ok_or(stopped)
    })
}

/// The circles of the halves of a region; halves without a circle are divided further.
fn divided(region: Region, part: &impl Fn(Region) -> Result<Circle, Stopped>) -> Vec<Circle> {
    let Region { x0, y0, x1, y1 } = region;
    if region.width().max(region.height()) < 2 * LEAST_DIVIDED_PX {
        return Vec::new();
    }
    let halves = if region.height() < region.width() {
        let middle = x0.midpoint(x1);
        [
            Region {
                x1: middle,
                ..region
            },
            Region {
                x0: middle,
                ..region
            },
        ]
    } else {
        let middle = y0.midpoint(y1);
        [
            Region {
                y1: middle,
                ..region
            },
            Region {
                y0: middle,
                ..region
            },
        ]
    };
    halves
        .into_iter()
        .flat_map(|half| match part(half) {
            Ok(circle) => vec![circle],
            Err(_) => divided(half, part),
        })
        .collect()
}

/// The median of each parameter of some circles; `None` if there are none.
fn middle(circles: &[Circle]) -> Option<Circle> {
    let of = |value: &dyn Fn(&Circle) -> f64| median(circles.iter().map(value));
    let nadir = [0, 1, 2].map(|axis| of(&|circle| circle.nadir[axis]));
    let nadir = Vector3::new(nadir[0]?, nadir[1]?, nadir[2]?);
    let towards = Vector2::new(of(&|c| c.towards.x)?, of(&|c| c.towards.y)?);
    Some(Circle {
        nadir: UnitVector3::try_new(nadir, 0.0)?,
        towards: towards.try_normalize(0.0)?,
        half_angle_rad: of(&|circle| circle.half_angle_rad)?,
    })
}

fn in_part(
    settings: &HorizonSettings,
    frame: &Frame,
    camera: &DirectionCamera,
    sphere: &Sphere,
    region: Region,
) -> Result<Circle, Stopped> {
    let part = frame.cropped(region).ok_or_else(|| no_horizon(0))?;
    let radius_px = camera.lens.mean_focal_px() * sphere.half_angle_rad.value.tan();
    let levels = Levels::of(&part, radius_px).map_err(|rejected| Stopped {
        stage: Stage::Light,
        rejected,
    })?;
    let threshold_dn = settings.threshold_dn.unwrap_or(levels.border_dn());
    let mask: Vec<Region> = camera
        .mask
        .iter()
        .filter_map(|m| within(m, &region))
        .collect();
    let arcs = with_view!(&part, view => {
        Binary::new(&view, threshold_dn, &mask).arcs(view.height)
    });
    let longest = arcs.into_iter().max_by_key(Vec::len).unwrap_or_default();
    let corner = Vector2::new(region.x0 as f64, region.y0 as f64);
    let rays: Vec<EdgeRay> = longest
        .into_iter()
        .filter_map(|mut point| {
            point.at = (point.at.vector() + corner).into();
            EdgeRay::of(&point, &camera.lens)
        })
        .collect();
    if rays.len() < LEAST_PLACES {
        return Err(no_horizon(rays.len()));
    }
    let expected = sphere.half_angle_rad.value;
    let circle = through(&rays, expected)
        .ok_or_else(|| Stopped::new(Stage::Fit, reasons::UNDETERMINED, 0.0, 0.0))?;
    let ratio = circle.half_angle_rad.tan() / expected.tan();
    match RADIUS_RATIO.contains(&ratio) {
        true => Ok(circle),
        false => Err(Stopped::new(Stage::Fit, reasons::RADIUS, ratio, 1.0)),
    }
}

/// The part of a mask within a region, in the region's own pixels.
fn within(mask: &Region, region: &Region) -> Option<Region> {
    let part = mask.intersection(region)?;
    Some(Region {
        x0: part.x0 - region.x0,
        y0: part.y0 - region.y0,
        x1: part.x1 - region.x0,
        y1: part.y1 - region.y0,
    })
}

/// The circle x^2 + y^2 = 2 a x + 2 b y + c fitted to rays in the stereographic plane (HORACE, eq. 2.7 to 2.25). The nadir
/// is at the expected half-angle from the circle's point nearest to the axis.
fn through(rays: &[EdgeRay], expected_rad: f64) -> Option<Circle> {
    let points: Vec<Vector2<f64>> = rays.iter().map(|ray| stereographic(&ray.unit)).collect();
    let terms: Vec<Vector3<f64>> = points
        .iter()
        .map(|p| Vector3::new(2.0 * p.x, 2.0 * p.y, 1.0))
        .collect();
    let squares: Vec<f64> = points.iter().map(|p| p.norm_squared()).collect();
    let fitted = regression(&terms, &squares, &vec![1.0; points.len()]).ok()?;
    let centre = fitted.parameters.xy();
    let radius = (fitted.parameters.z + centre.norm_squared()).sqrt();
    let away = centre.try_normalize(0.0)?;
    // Intersections of the circle with the line from the axis to the centre.
    let (near, far) = (centre.norm() - radius, centre.norm() + radius);
    let apart_rad = (far.atan() - near.atan()).abs();
    let inward: f64 = rays
        .iter()
        .zip(&points)
        .map(|(ray, point)| {
            let inside = UnitVector3::new_normalize(ray.unit.into_inner() + ray.inward * 1e-3);
            (stereographic(&inside) - point)
                .dot(&(centre - point))
                .signum()
        })
        .sum();
    let is_inside = inward > 0.0;
    let side = if is_inside { 1.0 } else { -1.0 };
    let from_axis_rad = 2.0 * near.atan() + side * expected_rad;
    let (sine, cosine) = from_axis_rad.sin_cos();
    let nadir = Vector3::new(away.x * sine, away.y * sine, cosine);
    Some(Circle {
        nadir: UnitVector3::try_new(nadir, 0.0)?,
        towards: away * sine.signum(),
        half_angle_rad: if is_inside { apart_rad } else { PI - apart_rad },
    })
}

fn stereographic(ray: &UnitVector3<f64>) -> Vector2<f64> {
    ray.xy() / (1.0 + ray.z)
}

/// The local vertical of two cameras: the line of intersection, downward, of the planes through each camera's axis and the
/// nadir in its picture. `None` if they do not intersect. Each camera comes with the rotation from its own frame to that of
/// the result.
pub fn vertical(cameras: [(&Circle, Rotation3<f64>); 2]) -> Option<UnitVector3<f64>> {
    let [one, other] = cameras.map(|(circle, turn)| {
        let towards = Vector3::new(circle.towards.x, circle.towards.y, 0.0);
        turn * Vector3::z().cross(&towards)
    });
    let line = UnitVector3::try_new(one.cross(&other), LEAST_CROSSING_RAD)?;
    let down: Vector3<f64> = cameras
        .iter()
        .map(|(circle, turn)| turn * circle.nadir.into_inner())
        .sum();
    Some(if line.dot(&down) < 0.0 { -line } else { line })
}
