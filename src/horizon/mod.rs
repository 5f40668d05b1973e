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
//!
//! [`joint`] does the last step for cameras of one vehicle together. [`circle`] is a plainer way from the borders, for comparison.

mod air;
mod border;
pub mod circle;
mod consensus;
mod departure;
mod edge;
mod inside;
mod light;
mod limb;
mod nadir;
mod overlay;
mod places;
mod profile;
mod scan;
mod shape;
mod sphere;
mod template;

pub use departure::Departure;
pub use edge::{EdgePoint, EdgeRay, EdgeRays};
pub use light::Levels;
pub use nadir::{Conic, EdgeHeight, Nadir, NadirError, nadir, pitch_deg, roll_deg};
pub use overlay::{overlay, overlay_of_circle};
pub use sphere::{Ellipsoid, Refraction, Sphere, Viewpoint};

use crate::estimation::FitError;
use crate::frame::{Frame, Sample, View};
use crate::instrument::DirectionCamera;
use crate::reasons::{at, horizon as reasons};
use crate::units::Rejected;
use crate::with_view;
use consensus::{Guess, consensus};
use light::Raster;
use nadir::LEAST_WEIGHT;
use nalgebra::{Rotation3, UnitVector3};
use places::Light;
use profile::Profiles;
use scan::Scan;
use std::ops::Range;
use std::slice::from_ref;

/// Points of an edge along lines of the picture scatter by less.
const EDGE_TOLERANCE_PX: f64 = 3.0;
/// So many points of one edge are a guess, and so many guesses are tried, if they have that share of the best one's points.
const LEAST_POINTS: usize = 8;
const MOST_GUESSES: usize = 3;
const RIVAL_SHARE: f64 = 0.3;
/// An edge whose height is to be found may stand so far off, m.
const FITTED_TOLERANCE_M: f64 = 15_000.0;
/// Profiles are read anew while the nadir moves by more, so often at most.
const SETTLED_PX: f64 = 0.2;
const MOST_ROUNDS: usize = 4;
/// An edge is brighter than the sky by this share of the frame's contrast, and by so many sigmas of a pixel's noise.
const LEAST_CONTRAST: f64 = 0.1;
const LEAST_CONTRAST_SIGMAS: f64 = 4.0;
/// Beyond noise, a place of the limb differs from the others by this share of its brightness at most.
const MOST_UNLIKE: f64 = 0.1;
/// A sphere shows its edge at so many places and this share of those that show light.
const LEAST_PLACES: usize = 12;
const LEAST_SHARE: f64 = 0.4;
/// A nadir is fine with so much of what is lit, and of all that is in view.
const FINE_SHARE: f64 = 0.6;
const FINE_PLACES: f64 = 0.25;
/// No nadir is fine that is known less well, deg.
const MOST_SIGMA_DEG: f64 = 0.6;
/// A limb departs less from its sphere, m, 1 sigma.
const MOST_DEPARTURE_M: f64 = 4_000.0;
/// Heights that the edge of air can have, m.
const EDGE_HEIGHTS_M: Range<f64> = 0.0..60_000.0;
/// Nadirs that are farther apart than this are two, deg; the second is a rival with such a share of the first one's points.
const APART_DEG: f64 = 2.0;
const RIVAL_POINTS: f64 = 0.5;
/// What more than this share of the places shows is told.
const TOLD_SHARE: f64 = 0.1;

/// How a frame is looked at.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Settings {
    /// Pixels of at least this are bright, DN; by the frame's own light where it is not stated.
    pub threshold_dn: Option<f64>,
    pub height: EdgeHeight,
    /// How the limb departs from a sphere; by the frame's own residuals where it is not stated.
    pub departure: Option<Departure>,
}

/// Where the solution of a frame may end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
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

/// The stage that went no further, and why.
pub type Stopped = crate::reasons::Stopped<Stage>;

impl crate::reasons::Stage for Stage {
    fn name(self) -> &'static str {
        Self::name(self)
    }
}

/// How good a nadir is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Quality {
    /// Nothing speaks against it.
    Fine,
    /// Something does: see [`Solution::doubt`].
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

/// What stands beside the edge, or hides it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Flag {
    /// Clouds reach into the limb: where they do, the air above them tells the edge.
    Clouds,
    /// Places whose edge is none of the sphere's: of a cloud's top, of the ground, of a flare.
    OtherEdges,
    /// Places that show no edge: night, or glare.
    NoEdge,
    /// Cameras of one vehicle that see no common cone: each answers for itself.
    CamerasDisagree,
}

impl Flag {
    pub fn name(self) -> &'static str {
        match self {
            Self::Clouds => "clouds",
            Self::OtherEdges => "other_edges",
            Self::NoEdge => "no_edge",
            Self::CamerasDisagree => "cameras_disagree",
        }
    }
}

/// What a frame says of the sphere, as far as it got.
#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    pub levels: Option<Levels>,
    /// Places of the edge that are in view.
    pub places: usize,
    /// Those of them that show light of any kind.
    pub lit: usize,
    /// The edge where it is seen.
    pub edge: EdgeRays,
    /// Share of the places with clouds in the limb.
    pub clouded: f64,
    pub nadir: Result<Nadir, Stopped>,
    /// Why a nadir is not fine; none of one that is.
    pub doubt: Option<Stopped>,
}

impl Solution {
    /// Of a frame that shows nothing.
    pub fn none(stopped: Stopped) -> Self {
        Self {
            levels: None,
            places: 0,
            lit: 0,
            edge: EdgeRays::default(),
            clouded: 0.0,
            nadir: Err(stopped),
            doubt: None,
        }
    }

    /// Points that are part of the edge.
    pub fn agreeing(&self) -> usize {
        self.nadir.as_ref().map_or(0, Nadir::agreeing)
    }

    pub fn quality(&self) -> Quality {
        match (&self.nadir, &self.doubt) {
            (Ok(_), None) => Quality::Fine,
            (Ok(_), Some(_)) => Quality::Coarse,
            (Err(_), _) => Quality::None,
        }
    }

    /// Why there is no nadir, or no fine one.
    pub fn reason(&self) -> Option<&Stopped> {
        self.nadir.as_ref().err().or(self.doubt.as_ref())
    }

    /// The better one of two, in doubt where the other is nearly as good.
    fn or_rival(self, other: Self) -> Self {
        let worth = |solution: &Self| (std::cmp::Reverse(solution.quality()), solution.agreeing());
        let (best, rival) = match worth(&other) > worth(&self) {
            true => (other, self),
            false => (self, other),
        };
        let (Ok(one), Ok(two)) = (&best.nadir, &rival.nadir) else {
            return best;
        };
        let apart_deg = one.direction.unit.angle(&two.direction.unit).to_degrees();
        let (share, limit) = (
            rival.agreeing() as f64 / best.agreeing() as f64,
            RIVAL_POINTS,
        );
        let is_rival = apart_deg > APART_DEG && share > limit && rival.doubt.is_none();
        let doubt = is_rival.then(|| Stopped::new(Stage::Fit, reasons::RIVAL, share, limit));
        Self {
            doubt: best.doubt.or(doubt),
            ..best
        }
    }

    /// What a reader of the nadir should know; nothing of a frame that shows none.
    pub fn flags(&self) -> Vec<Flag> {
        let (places, seen) = (self.places as f64, self.edge.rays.len() as f64);
        let told = [
            (Flag::Clouds, self.clouded),
            (Flag::OtherEdges, (seen - self.agreeing() as f64) / seen),
            (Flag::NoEdge, (places - seen) / places),
        ];
        let is_told = |(_, share): &(Flag, f64)| self.nadir.is_ok() && *share > TOLD_SHARE;
        told.into_iter()
            .filter(is_told)
            .map(|(flag, _)| flag)
            .collect()
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
            Some(found) if found.quality() == Quality::Fine => found,
            _ => search.find(frame, &view, None),
        }
    })
}

/// The nadir by what several cameras of one vehicle see at a time, each with the turn from its own frame to the vehicle's body. `sphere` is
/// that of the body's frame.
///
/// # Errors
/// No camera that sees the edge, or a camera whose edge agrees too little with the nadir of all.
pub fn joint(
    settings: &Settings,
    sphere: &Sphere,
    cameras: &[(&Solution, Rotation3<f64>)],
) -> Result<Nadir, Stopped> {
    let seen = || {
        cameras
            .iter()
            .filter(|(solution, _)| solution.nadir.is_ok())
    };
    let edges: Vec<EdgeRays> = seen()
        .map(|(solution, turn)| solution.edge.turned(turn))
        .collect();
    let plain = nadir(&edges, sphere, settings.height, Departure::NONE).map_err(unfitted)?;
    let nadir = fitted(settings, sphere, &edges, &plain)?;
    let mut weights = &nadir.weights[..];
    for (solution, _) in seen() {
        let (own, others) = weights.split_at(solution.edge.rays.len());
        enough(nadir::agreeing(own), solution)?;
        weights = others;
    }
    Ok(nadir)
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
        let levels = match Levels::of(frame, self.radius_px()) {
            Ok(levels) => levels,
            Err(rejected) => return Solution::none(at(Stage::Light)(rejected)),
        };
        let guesses = match near {
            Some(nadir) => vec![Guess { nadir, agreeing: 0 }],
            None => self.detect(view, &levels),
        };
        let most = guesses.first().map_or(0, |guess| guess.agreeing);
        let none = Solution {
            levels: Some(levels),
            ..Solution::none(no_horizon(most))
        };
        let raster = Raster::of(view, self.camera);
        let mut best: Option<Solution> = None;
        for guess in guesses
            .iter()
            .filter(|guess| near.is_some() || guess.agreeing >= LEAST_POINTS)
        {
            if best.as_ref().is_some_and(|best| best.nadir.is_ok())
                && (guess.agreeing as f64) < RIVAL_SHARE * most as f64
            {
                break;
            }
            let mut found = none.clone();
            found.nadir = self.stages(view, &levels, &raster, guess.nadir, &mut found);
            best = Some(match best {
                Some(best) => best.or_rival(found),
                None => found,
            });
        }
        best.unwrap_or(none)
    }

    fn stages<T: Sample>(
        &self,
        view: &View<'_, T>,
        levels: &Levels,
        raster: &Raster,
        start: UnitVector3<f64>,
        solution: &mut Solution,
    ) -> Result<Nadir, Stopped> {
        let (sphere, plain) = self.edge(view, levels, raster, start, solution)?;
        let nadir = fitted(self.settings, &sphere, from_ref(&solution.edge), &plain)?;
        enough(nadir.agreeing(), solution)?;
        raster
            .is_filled(self.sphere, &nadir.direction.unit, levels)
            .map_err(at(Stage::Fit))?;
        solution.doubt = self.doubt(solution, &nadir);
        Ok(nadir)
    }

    /// The nadirs that most sharp edges agree with, the best one first.
    fn detect<T: Sample>(&self, view: &View<'_, T>, levels: &Levels) -> Vec<Guess> {
        let lens = &self.camera.lens;
        let scan = Scan::new(
            view,
            self.scale_px(),
            self.radius_px(),
            self.least_dn(levels),
        );
        let points = scan.edges(view, &self.camera.mask);
        let rays: Vec<EdgeRay> = points
            .iter()
            .filter_map(|point| EdgeRay::of(point, lens))
            .collect();
        let tolerance_rad = self.tolerance_rad() + EDGE_TOLERANCE_PX / lens.mean_focal_px();
        let half_angle_rad = self.sphere.half_angle_rad.value;
        consensus(&rays, half_angle_rad, tolerance_rad, MOST_GUESSES)
    }

    /// By how much the limb is brighter than the sky at the least, DN.
    fn least_dn(&self, levels: &Levels) -> f64 {
        let contrast_dn = LEAST_CONTRAST * (levels.bright_dn - levels.dark_dn);
        contrast_dn.max(LEAST_CONTRAST_SIGMAS * levels.noise_dn)
    }

    /// The smallest radius of the sphere in the picture, wherever it is.
    fn radius_px(&self) -> f64 {
        self.camera.lens.mean_focal_px() * self.sphere.half_angle_rad.value.tan()
    }

    /// By how much the border of what is bright may lie off the edge.
    fn tolerance_rad(&self) -> f64 {
        let height_rad = self.sphere.rad_per_m * FITTED_TOLERANCE_M;
        match self.settings.height {
            EdgeHeight::Given => self.sphere.tolerance_rad,
            EdgeHeight::Fitted => self.sphere.tolerance_rad.max(height_rad),
        }
    }

    /// Reads the light across the edge until the nadir moves no more. Returns that nadir, as of an edge that does not depart from its sphere,
    /// and the sphere it was fitted with.
    fn edge<T: Sample>(
        &self,
        view: &View<'_, T>,
        levels: &Levels,
        raster: &Raster,
        start: UnitVector3<f64>,
        solution: &mut Solution,
    ) -> Result<(Sphere, Nadir), Stopped> {
        let least_dn = self.least_dn(levels);
        let lens = &self.camera.lens;
        let profiles = |sphere: &Sphere, nadir: &UnitVector3<f64>| {
            Profiles::of(view, &self.camera.mask, lens, sphere, nadir)
        };
        let rays = |points: &[EdgePoint], sigma_rad: f64| EdgeRays {
            rays: points
                .iter()
                .filter_map(|point| EdgeRay::of(point, lens))
                .collect(),
            sigma_rad,
        };
        let crossings = rays(&profiles(self.sphere, &start).crossings(least_dn), 0.0);
        let mut nadir = self.fit_as_sphere(self.sphere, &crossings)?;
        let mut sphere = *self.sphere;
        let (mut points, mut likeness) = (Vec::new(), Ok(()));
        for _ in 0..MOST_ROUNDS {
            let last = nadir;
            sphere.half_angle_rad.value = last.half_angle_rad.value;
            let profiles = profiles(&sphere, &last.direction.unit);
            let light = Light {
                least_dn,
                noise_dn: levels.noise_dn,
                // Of a sharp edge, where pixels begin makes the profiles differ.
                most_unlike: self.sphere.viewpoint.map_or(f64::INFINITY, |_| MOST_UNLIKE),
                far_sky_dn: raster.far_sky_dn(&sphere, &last.direction.unit),
            };
            solution.places = profiles.places.len();
            let edge = limb::edge(&profiles, &sphere, &light).map_err(at(Stage::Edge))?;
            (points, likeness) = (edge.points, edge.likeness);
            solution.edge = rays(&points, edge.sigma_rad);
            solution.clouded = edge.clouded;
            solution.lit = edge.lit;
            enough(solution.edge.rays.len(), solution)?;
            nadir = self.fit_as_sphere(&sphere, &solution.edge)?;
            let turned_rad = nadir.direction.unit.angle(&last.direction.unit);
            let raised_rad = nadir.half_angle_rad.value - last.half_angle_rad.value;
            if turned_rad.max(raised_rad.abs()) * lens.mean_focal_px() < SETTLED_PX {
                break;
            }
        }
        if self.sphere.viewpoint.is_some() {
            likeness.map_err(at(Stage::Edge))?;
            inside::goes_on(view, &self.camera.mask, &points, self.scale_px())
                .map_err(at(Stage::Edge))?;
        }
        Ok((sphere, nadir))
    }

    /// Over so many pixels the limb's light falls to 1/e.
    fn scale_px(&self) -> f64 {
        self.sphere.scale_rad() * self.camera.lens.mean_focal_px()
    }

    /// Why a nadir is not fine.
    fn doubt(&self, solution: &Solution, nadir: &Nadir) -> Option<Stopped> {
        let agreeing = nadir.agreeing() as f64;
        let least = (FINE_SHARE * solution.lit as f64).max(FINE_PLACES * solution.places as f64);
        let most_rad = MOST_DEPARTURE_M * self.sphere.rad_per_m;
        let checks = || {
            Rejected::at_least(least, agreeing, reasons::LITTLE_EDGE)?;
            Rejected::at_most(MOST_SIGMA_DEG, nadir.sigma_deg(), reasons::UNCERTAIN)?;
            if self.sphere.viewpoint.is_some() {
                Rejected::at_most(most_rad, nadir.departure.sigma_rad, reasons::NO_CONE)?;
            }
            if let Some(edge) = nadir.edge_m(self.sphere) {
                Rejected::at_least(EDGE_HEIGHTS_M.start, edge.value, reasons::EDGE_HEIGHT)?;
                Rejected::at_most(EDGE_HEIGHTS_M.end, edge.value, reasons::EDGE_HEIGHT)?;
            }
            Ok(())
        };
        checks().map_err(at(Stage::Fit)).err()
    }

    /// The nadir of an edge that does not depart from its sphere.
    fn fit_as_sphere(&self, sphere: &Sphere, edge: &EdgeRays) -> Result<Nadir, Stopped> {
        nadir(
            from_ref(edge),
            sphere,
            self.settings.height,
            Departure::NONE,
        )
        .map_err(unfitted)
    }
}

/// The nadir by the edge in one picture or more. How it departs from a sphere is found in what a plain fit leaves, unless it is stated.
fn fitted(
    settings: &Settings,
    sphere: &Sphere,
    edges: &[EdgeRays],
    plain: &Nadir,
) -> Result<Nadir, Stopped> {
    let found = || departure(edges, sphere, plain);
    let departure = settings.departure.unwrap_or_else(found);
    nadir(edges, sphere, settings.height, departure).map_err(unfitted)
}

fn departure(edges: &[EdgeRays], sphere: &Sphere, nadir: &Nadir) -> Departure {
    let down = &nadir.direction.unit;
    let raised_rad = nadir.half_angle_rad.value - sphere.half_angle_rad.value;
    let left = |ray: &EdgeRay| {
        ray.angle_from(down).0 - sphere.half_angle_towards(&ray.unit, down) - raised_rad
    };
    let rays = edges.iter().flat_map(|edge| &edge.rays).zip(&nadir.weights);
    let agreeing = rays.filter(|(_, weight)| **weight > LEAST_WEIGHT);
    let left: Vec<(&EdgeRay, f64)> = agreeing.map(|(ray, _)| (ray, left(ray))).collect();
    Departure::of_residuals(&left)
}

/// Whether so many places show the edge, of those that show light.
fn enough(seen: usize, solution: &Solution) -> Result<(), Stopped> {
    let least = (LEAST_SHARE * solution.lit as f64).max(LEAST_PLACES as f64);
    Rejected::at_least(least, seen as f64, reasons::LITTLE_EDGE).map_err(at(Stage::Edge))
}

/// Too few sharp edges agree.
fn no_horizon(points: usize) -> Stopped {
    let limit = LEAST_POINTS as f64;
    Stopped::new(Stage::Detection, reasons::NO_HORIZON, points as f64, limit)
}

fn unfitted(error: NadirError) -> Stopped {
    match error {
        NadirError::Rays(rays) => Stopped::new(
            Stage::Fit,
            reasons::LITTLE_EDGE,
            rays as f64,
            LEAST_PLACES as f64,
        ),
        NadirError::Fit(FitError::Undetermined) => {
            Stopped::new(Stage::Fit, reasons::UNDETERMINED, 0.0, 0.0)
        }
        NadirError::Fit(FitError::NotConverged) => {
            Stopped::new(Stage::Fit, reasons::NOT_CONVERGED, 0.0, 0.0)
        }
    }
}
