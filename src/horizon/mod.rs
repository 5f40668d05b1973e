//! The direction of a sphere by its edge: the Earth's horizon, seen by a camera.
//!
//! Rays from the camera to the edge of a sphere make a cone about the direction of its centre, the nadir (Braun and Barf 2022,
//! "Image processing based horizon sensor for estimating the orientation of sounding rockets, launch vehicles and spacecraft", section 2.4).
//! The distance tells the cone's half-angle; points of the edge tell its axis, however long or short the arc is that they lie on.
//!
//! Directions are in the camera frame: x to the right, y down, z forward.
//!
//! # The way of a frame
//! 1. [`Levels`]: the light of a raster of pixels. A frame that is dark or bright all over is refused.
//! 2. Borders of what is bright are followed, and RANSAC finds the nadir that most of their points agree with. Where the last frame's nadir
//!    is known, it stands for both.
//! 3. The light across the edge is read in profiles all along the cone, and these tell the edge to a part of a pixel.
//! 4. [`nadir()`] fits the direction, with the covariance of noise, limb and height.

mod border;
mod consensus;
mod light;
mod nadir;
mod overlay;
mod profile;

pub use light::Levels;
pub use nadir::{Conic, EdgeCorrelation, EdgePoint, Nadir, NadirError, nadir};
pub use overlay::overlay;

use crate::estimation::{FitError, median};
use crate::frame::{Frame, Sample, View};
use crate::instrument::DirectionCamera;
use crate::units::{EARTH_RADIUS_M, Measured, Rejected, SensorPx};
use crate::with_view;
use border::Binary;
use consensus::consensus;
use nadir::EdgeRay;
use nalgebra::{Matrix3x2, UnitVector3, Vector2};
use profile::Profiles;

/// The light of the Earth's limb falls off over these heights about its edge, m. Inside, clouds follow; outside, the sky is dark.
const LIMB_INSIDE_M: f64 = 20_000.0;
const LIMB_OUTSIDE_M: f64 = 60_000.0;
/// By how much the border of what is bright may stand above or below the edge, m.
const BORDER_HEIGHT_M: f64 = 4_000.0;
/// Beyond the limb's light by so much, the sky is as dark as it is, rad.
const FAR_RAD: f64 = 0.05;
/// Points of a border scatter by less.
const BORDER_TOLERANCE_PX: f64 = 3.0;
/// Profiles are read anew while the nadir moves by more, so often at most.
const SETTLED_PX: f64 = 0.2;
const MOST_ROUNDS: usize = 4;
/// An edge is brighter than the sky by this share of the frame's contrast, and by so many sigmas of a pixel's noise.
const LEAST_CONTRAST: f64 = 0.1;
const LEAST_CONTRAST_SIGMAS: f64 = 4.0;
/// A sphere shows its edge at so many places and this share of those in view.
const LEAST_PLACES: usize = 12;
const LEAST_SHARE: f64 = 0.3;
/// Of a raster's pixels within the sphere so many are bright, and of those of the sky at most so many. It takes some of each to tell.
const LEAST_INSIDE: f64 = 0.1;
const MOST_OUTSIDE: f64 = 0.4;
const LEAST_PIXELS: usize = 40;
/// A point of less weight is no part of the edge.
const LEAST_WEIGHT: f64 = 0.1;
/// The limb does alike over so many places.
const SHARED_PLACES: usize = 3;
/// An arc is worth as many free stretches as this, however long its neighbours do alike.
const LEAST_STRETCHES: f64 = 6.0;
/// A find is fine with so much of the edge seen, coarse below.
const FINE_SHARE: f64 = 0.6;

/// Whether air bends the rays to the limb.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refraction {
    /// Rays are straight.
    None,
    /// Air whose refractivity falls off exponentially with height.
    StandardAir,
}

impl Refraction {
    /// The refractive index at a height, m.
    fn index(self, height_m: f64) -> f64 {
        // Of visible light at 15 deg C and 1013 hPa (Edlen 1966); the scale height is that of the stratosphere, where the limb's edge is.
        const REFRACTIVITY: f64 = 2.77e-4;
        const SCALE_M: f64 = 7_000.0;
        match self {
            Self::None => 1.0,
            Self::StandardAir => 1.0 + REFRACTIVITY * (-height_m / SCALE_M).exp(),
        }
    }
}

/// A sphere whose edge is looked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sphere {
    /// Half-angle of the cone of rays to its edge.
    pub half_angle_rad: Measured,
    /// Over which angles about its edge its light falls off.
    pub inside_rad: f64,
    pub outside_rad: f64,
    /// By how much the border of what is bright may lie off the edge.
    pub tolerance_rad: f64,
}

impl Sphere {
    /// The Earth, with its limb: see [`half_angle_rad`].
    pub fn earth(height_m: Measured, edge_m: Measured, refraction: Refraction) -> Option<Self> {
        let half_angle_rad = half_angle_rad(height_m, edge_m, refraction)?;
        let rad_per_m = 1.0 / ((EARTH_RADIUS_M + height_m.value) * half_angle_rad.value.cos());
        Some(Self {
            half_angle_rad,
            inside_rad: (LIMB_INSIDE_M * rad_per_m).min(half_angle_rad.value / 2.0),
            outside_rad: LIMB_OUTSIDE_M * rad_per_m,
            tolerance_rad: BORDER_HEIGHT_M * rad_per_m,
        })
    }

    /// A sphere with a sharp edge, as the Sun and the Moon are.
    pub fn disc(angular_radius_rad: Measured) -> Self {
        Self {
            half_angle_rad: angular_radius_rad,
            inside_rad: 0.0,
            outside_rad: 0.0,
            tolerance_rad: 0.0,
        }
    }
}

/// How a frame is looked at.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Settings {
    /// Pixels of at least this are bright, DN; by the frame's own light where it is not stated.
    pub threshold_dn: Option<f64>,
    /// How the limb departs from a sphere; by the frame's own residuals where it is not stated.
    pub limb: Option<EdgeCorrelation>,
}

/// Where the solution of a frame may end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    Light,
    Detection,
    Edge,
    Fit,
}

impl Stage {
    pub fn name(self) -> &'static str {
        match self {
            Self::Light => "light",
            Self::Detection => "detection",
            Self::Edge => "edge",
            Self::Fit => "fit",
        }
    }
}

/// How good a nadir is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quality {
    /// Most of the edge in view is seen.
    Fine,
    /// A smaller part.
    Coarse,
    None,
}

impl Quality {
    pub fn name(self) -> &'static str {
        match self {
            Self::Fine => "fine",
            Self::Coarse => "coarse",
            Self::None => "none",
        }
    }
}

/// What a frame says of the sphere, as far as it got.
#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    pub levels: Option<Levels>,
    /// Places of the edge that are in view.
    pub places: usize,
    /// The edge where it is seen.
    pub edge: Vec<EdgePoint>,
    pub nadir: Result<Nadir, (Stage, Rejected)>,
}

impl Solution {
    /// Points that are part of the edge.
    pub fn agreeing(&self) -> usize {
        let weights = self.nadir.iter().flat_map(|nadir| &nadir.weights);
        weights.filter(|weight| **weight > LEAST_WEIGHT).count()
    }

    pub fn quality(&self) -> Quality {
        match &self.nadir {
            Ok(_) if self.agreeing() as f64 >= FINE_SHARE * self.places as f64 => Quality::Fine,
            Ok(_) => Quality::Coarse,
            Err(_) => Quality::None,
        }
    }
}

/// Finds a sphere in a frame; near the last frame's nadir first, where there is one.
pub fn solve(
    settings: &Settings,
    frame: &Frame,
    camera: &DirectionCamera,
    sphere: &Sphere,
    last: Option<&UnitVector3<f64>>,
) -> Solution {
    let search = Search {
        settings,
        camera,
        sphere,
    };
    with_view!(frame, view => {
        let near = last.map(|nadir| search.find(frame, &view, Some(*nadir)));
        match near {
            Some(found) if found.nadir.is_ok() => found,
            _ => search.find(frame, &view, None),
        }
    })
}

/// What a frame is searched with.
struct Search<'a> {
    settings: &'a Settings,
    camera: &'a DirectionCamera,
    sphere: &'a Sphere,
}

impl Search<'_> {
    fn find<T: Sample>(
        &self,
        frame: &Frame,
        view: &View<'_, T>,
        near: Option<UnitVector3<f64>>,
    ) -> Solution {
        let mut solution = Solution {
            levels: None,
            places: 0,
            edge: Vec::new(),
            nadir: Err((Stage::Light, rejected("no_light", 0.0, 0.0))),
        };
        solution.nadir = self.stages(frame, view, near, &mut solution);
        solution
    }

    fn stages<T: Sample>(
        &self,
        frame: &Frame,
        view: &View<'_, T>,
        near: Option<UnitVector3<f64>>,
        solution: &mut Solution,
    ) -> Result<Nadir, (Stage, Rejected)> {
        let levels = Levels::of(frame).map_err(|rejected| (Stage::Light, rejected))?;
        solution.levels = Some(levels);
        let start = match near {
            Some(near) => near,
            None => self.detect(view, &levels)?,
        };
        let contrast_dn = LEAST_CONTRAST * (levels.bright_dn - levels.dark_dn);
        let least_dn = contrast_dn.max(LEAST_CONTRAST_SIGMAS * levels.noise_dn);
        let angle = self.sphere.half_angle_rad;
        let crossings = self.profiles(view, &start).crossings(least_dn);
        let mut calm = self.fit(&crossings, angle, CALM)?;
        let mut level_sigma_rad = 0.0;
        for _ in 0..MOST_ROUNDS {
            let last = calm.direction.unit;
            let profiles = self.profiles(view, &last);
            solution.places = profiles.len();
            let far_sky_dn = self.far_sky_dn(view, &last);
            let Some(edge) = profiles.edge(least_dn, levels.noise_dn, far_sky_dn) else {
                return Err((Stage::Edge, rejected("no_limb", 0.0, 0.0)));
            };
            (solution.edge, level_sigma_rad) = (edge.points, edge.sigma_rad);
            self.enough(solution.edge.len(), solution.places)?;
            calm = self.fit(&solution.edge, angle, CALM)?;
            let moved_rad = calm.direction.unit.angle(&last);
            if moved_rad * self.camera.lens.mean_focal_px() < SETTLED_PX {
                break;
            }
        }
        let stated = self.settings.limb;
        let limb = stated.unwrap_or_else(|| self.limb(&solution.edge, &calm));
        let angle = Measured::new(angle.value, angle.sigma.hypot(level_sigma_rad));
        let nadir = self.fit(&solution.edge, angle, limb)?;
        let agreeing = nadir.weights.iter().filter(|w| **w > LEAST_WEIGHT).count();
        self.enough(agreeing, solution.places)?;
        self.fills(view, &nadir.direction.unit, &levels)?;
        Ok(nadir)
    }

    /// The nadir that most points of bright borders agree with.
    fn detect<T: Sample>(
        &self,
        view: &View<'_, T>,
        levels: &Levels,
    ) -> Result<UnitVector3<f64>, (Stage, Rejected)> {
        let binary = Binary {
            view: *view,
            threshold_dn: self.settings.threshold_dn.unwrap_or(levels.border_dn()),
            mask: &self.camera.mask,
        };
        let angle = self.sphere.half_angle_rad.value;
        // Braun and Barf 2022, section 5: no ellipse of the cone lies between rows this far apart.
        let focal_px = self.camera.lens.mean_focal_px();
        let between = (2.0 * focal_px * angle.tan()).clamp(2.0, view.height as f64);
        let arcs = binary.arcs(between as usize);
        let tolerance = self.sphere.tolerance_rad + BORDER_TOLERANCE_PX / focal_px;
        let agreed = consensus(&arcs, &self.camera.lens, angle, tolerance);
        if agreed.len() < LEAST_PLACES {
            let found = rejected("no_horizon", agreed.len() as f64, LEAST_PLACES as f64);
            return Err((Stage::Detection, found));
        }
        let nadir = self.fit(&agreed, self.sphere.half_angle_rad, CALM)?;
        Ok(nadir.direction.unit)
    }

    fn profiles<T: Sample>(&self, view: &View<'_, T>, nadir: &UnitVector3<f64>) -> Profiles {
        let camera = self.camera;
        Profiles::of(view, &camera.mask, &camera.lens, self.sphere, nadir)
    }

    /// A raster of pixels that are not masked: the cosine of the angle to a nadir, and the light, DN.
    fn raster<T: Sample>(&self, view: &View<'_, T>, nadir: &UnitVector3<f64>) -> Vec<(f64, f64)> {
        const SPACING_PX: usize = 32;
        let rows = (0..view.height).step_by(SPACING_PX);
        let raster = rows.flat_map(|y| (0..view.width).step_by(SPACING_PX).map(move |x| (x, y)));
        let is_seen = |(x, y): &(usize, usize)| {
            !self
                .camera
                .mask
                .iter()
                .any(|region| region.contains(*x, *y))
        };
        let light = |(x, y): (usize, usize)| {
            let ray = self.camera.lens.ray(SensorPx::new(x as f64, y as f64))?;
            Some((ray.dot(nadir), f64::from(view.dn(x, y))))
        };
        raster.filter(is_seen).filter_map(light).collect()
    }

    /// What a pixel of the sky far from the limb holds, DN; `None` where too little of it is in view.
    fn far_sky_dn<T: Sample>(&self, view: &View<'_, T>, nadir: &UnitVector3<f64>) -> Option<f64> {
        let angle = self.sphere.half_angle_rad.value + self.sphere.outside_rad + FAR_RAD;
        let raster = self.raster(view, nadir);
        let far = raster.iter().filter(|(cosine, _)| *cosine < angle.cos());
        let sky: Vec<f64> = far.map(|(_, dn)| *dn).collect();
        (sky.len() >= LEAST_PIXELS).then(|| median(&sky)).flatten()
    }

    /// Whether light fills the sphere, as far as it is day there, and not the sky. Flares have edges, too.
    fn fills<T: Sample>(
        &self,
        view: &View<'_, T>,
        nadir: &UnitVector3<f64>,
        levels: &Levels,
    ) -> Result<(), (Stage, Rejected)> {
        let angle = self.sphere.half_angle_rad.value;
        let raster = self.raster(view, nadir);
        let bright_share = |is_part: &dyn Fn(f64) -> bool| {
            let part = raster.iter().filter(|(cosine, _)| is_part(*cosine));
            let light: Vec<f64> = part.map(|(_, dn)| *dn).collect();
            let bright = light.iter().filter(|dn| **dn > levels.border_dn()).count();
            (light.len() >= LEAST_PIXELS).then(|| bright as f64 / light.len() as f64)
        };
        let inside = bright_share(&|cosine| cosine > angle.cos()).unwrap_or(1.0);
        let outside_cosine = (angle + self.sphere.outside_rad).cos();
        let outside = bright_share(&|cosine| cosine < outside_cosine).unwrap_or(0.0);
        if inside < LEAST_INSIDE {
            return Err((Stage::Fit, rejected("dark_inside", inside, LEAST_INSIDE)));
        }
        if outside > MOST_OUTSIDE {
            return Err((
                Stage::Fit,
                rejected("bright_outside", outside, MOST_OUTSIDE),
            ));
        }
        Ok(())
    }

    fn enough(&self, seen: usize, places: usize) -> Result<(), (Stage, Rejected)> {
        let least = LEAST_PLACES.max((LEAST_SHARE * places as f64) as usize);
        match seen >= least {
            true => Ok(()),
            false => Err((
                Stage::Edge,
                rejected("little_edge", seen as f64, least as f64),
            )),
        }
    }

    fn fit(
        &self,
        edge: &[EdgePoint],
        angle: Measured,
        limb: EdgeCorrelation,
    ) -> Result<Nadir, (Stage, Rejected)> {
        nadir(edge, &self.camera.lens, angle, limb).map_err(|error| {
            let found = match error {
                NadirError::Points(points) => {
                    rejected("little_edge", points as f64, LEAST_PLACES as f64)
                }
                NadirError::Fit(FitError::Undetermined) => rejected("undetermined", 0.0, 0.0),
                NadirError::Fit(FitError::NotConverged) => rejected("not_converged", 0.0, 0.0),
            };
            (Stage::Fit, found)
        })
    }

    /// How the limb departs from the sphere, by what the fit leaves beyond noise: how far, and over which distance neighbours do alike.
    fn limb(&self, edge: &[EdgePoint], nadir: &Nadir) -> EdgeCorrelation {
        let angle = self.sphere.half_angle_rad.value;
        let rays = edge.iter().zip(&nadir.weights);
        let left: Vec<(EdgeRay, f64)> = rays
            .filter(|(_, weight)| **weight > LEAST_WEIGHT)
            .filter_map(|(point, _)| EdgeRay::of(point, &self.camera.lens))
            .map(|ray| (ray, ray.angle_from(&nadir.direction.unit).0 - angle))
            .collect();
        let together = |lag: usize| {
            let pairs = left.iter().zip(left.iter().skip(lag));
            pairs.map(|((_, one), (_, other))| one * other).sum::<f64>() / left.len() as f64
        };
        // Noise differs from one place to the next; what neighbours share is the limb's.
        let variance = (1..=SHARED_PLACES).map(together).sum::<f64>() / SHARED_PLACES as f64;
        let variance = variance.max(0.0);
        let spacing_px = median(
            left.windows(2)
                .map(|pair| pair[0].0.at.distance(pair[1].0.at)),
        );
        let fallen = (1..left.len()).find(|lag| together(*lag) < variance / std::f64::consts::E);
        let lag = fallen.unwrap_or(1) as f64;
        // Of so many stretches that are free of each other, the nadir's two parameters take two; and a variance of few is itself so
        // uncertain (Student's t) that it counts as if two more were missing.
        let stretches = (left.len() as f64 / (2.0 * lag)).max(LEAST_STRETCHES);
        let variance = variance * stretches / (stretches - 4.0);
        EdgeCorrelation {
            sigma_rad: variance.sqrt(),
            length_px: lag * spacing_px.unwrap_or(1.0),
        }
    }
}

/// A limb that is a sphere's.
const CALM: EdgeCorrelation = EdgeCorrelation {
    sigma_rad: 0.0,
    length_px: 1.0,
};

fn rejected(reason: &'static str, measured: f64, limit: f64) -> Rejected {
    Rejected {
        reason,
        measured,
        limit,
    }
}

/// A cone of rays about a nadir.
struct Cone {
    nadir: UnitVector3<f64>,
    across: Matrix3x2<f64>,
    half_angle_rad: f64,
}

impl Cone {
    fn new(nadir: &UnitVector3<f64>, half_angle_rad: f64) -> Self {
        Self {
            nadir: *nadir,
            across: across(nadir),
            half_angle_rad,
        }
    }

    /// A ray at an angle around the nadir, and another one outside of the cone.
    fn ray(&self, around_rad: f64, outside_rad: f64) -> UnitVector3<f64> {
        let (sine, cosine) = around_rad.sin_cos();
        let outward = self.across * Vector2::new(cosine, sine);
        let (sine, cosine) = (self.half_angle_rad + outside_rad).sin_cos();
        UnitVector3::new_unchecked(self.nadir.into_inner() * cosine + outward * sine)
    }
}

/// Two unit vectors across a direction and each other.
fn across(unit: &UnitVector3<f64>) -> Matrix3x2<f64> {
    let first = match unit.x.abs() < 0.5 {
        true => unit.cross(&nalgebra::Vector3::x()).normalize(),
        false => unit.cross(&nalgebra::Vector3::y()).normalize(),
    };
    Matrix3x2::from_columns(&[first, unit.cross(&first)])
}

/// The half-angle, with its 1-sigma, of the cone of rays to the horizon (Braun and Barf 2022, eq. 5), rad: of a sphere of
/// [`EARTH_RADIUS_M`] seen from a height above it. The edge that is seen stands `edge` above the sphere. All heights are in m; `None` for a
/// camera that is not above the edge.
///
/// Along a bent ray n r sin(angle to the vertical) is the same everywhere (Bouguer's rule); where the ray grazes the edge the sine is 1.
pub fn half_angle_rad(
    height_m: Measured,
    edge_m: Measured,
    refraction: Refraction,
) -> Option<Measured> {
    let (distance, radius) = (
        EARTH_RADIUS_M + height_m.value,
        EARTH_RADIUS_M + edge_m.value,
    );
    let bent = refraction.index(edge_m.value) / refraction.index(height_m.value);
    let sine = bent * radius / distance;
    if radius >= distance || !(0.0..1.0).contains(&sine) {
        return None;
    }
    let slope_per_m = 1.0 / (distance * (1.0 - sine * sine).sqrt());
    let sigma = slope_per_m * (sine * height_m.sigma).hypot(edge_m.sigma);
    Some(Measured::new(sine.asin(), sigma))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_half_angle_of_known_heights() {
        // asin(6371 / 6601), and so on.
        for (height_m, degrees) in [(230_000.0, 74.830_690), (38_000.0, 83.757_636)] {
            let height = Measured::new(height_m, 100.0);
            let angle = half_angle_rad(height, Measured::new(0.0, 0.0), Refraction::None).unwrap();
            assert!((angle.value.to_degrees() - degrees).abs() < 1e-6);
            let at = |height_m| {
                let height = Measured::new(height_m, 0.0);
                half_angle_rad(height, Measured::new(0.0, 0.0), Refraction::None)
                    .unwrap()
                    .value
            };
            let slope = at(height_m + 50.0) - at(height_m - 50.0);
            assert!((angle.sigma + slope).abs() < 1e-6 * angle.sigma);
        }
    }

    #[test]
    fn refraction_raises_the_limb_as_it_bends_a_ray_step_by_step() {
        // From where the ray is level at 20 km: d(n t)/ds is the gradient of n, which points down.
        const STEP_M: f64 = 50.0;
        let (edge_m, camera_m) = (20_000.0, 38_000.0);
        let index = |at: &Vector2<f64>| Refraction::StandardAir.index(at.norm() - EARTH_RADIUS_M);
        let gradient = |at: &Vector2<f64>| -at.normalize() * (index(at) - 1.0) / 7_000.0;
        let mut at = Vector2::new(0.0, EARTH_RADIUS_M + edge_m);
        let mut along = Vector2::x() * index(&at);
        while at.norm() < EARTH_RADIUS_M + camera_m {
            let middle = at + along / index(&at) * (STEP_M / 2.0);
            let along_middle = along + gradient(&at) * (STEP_M / 2.0);
            at += along_middle / index(&middle) * STEP_M;
            along += gradient(&middle) * STEP_M;
        }
        let traced = at.angle(&along);
        let exact = |m| Measured::new(m, 0.0);
        let angle = |refraction| {
            let found = half_angle_rad(exact(camera_m), exact(edge_m), refraction);
            found.unwrap().value
        };
        let (bent, straight) = (angle(Refraction::StandardAir), angle(Refraction::None));
        assert!(bent > straight);
        assert!(
            (bent - traced).abs() < 0.02 * (bent - straight),
            "{bent} {traced} {straight}"
        );
    }

    #[test]
    fn there_is_no_horizon_at_or_below_the_edge() {
        let exact = |m| Measured::new(m, 0.0);
        assert_eq!(
            half_angle_rad(exact(0.0), exact(0.0), Refraction::None),
            None
        );
        assert_eq!(
            half_angle_rad(exact(10_000.0), exact(20_000.0), Refraction::None),
            None
        );
        assert_eq!(
            half_angle_rad(exact(f64::NAN), exact(0.0), Refraction::None),
            None
        );
    }
}
