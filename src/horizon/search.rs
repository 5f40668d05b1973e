//! The search for a sphere's edge in a frame: guesses from sharp edges, each refined by the brightness across its edge to a
//! nadir, and checks of its quality.

use super::consensus::{Guess, consensus};
use super::light::Raster;
use super::nadir::{NadirError, is_part, nadir};
use super::places::Light;
use super::profile::Profiles;
use super::scan::Scan;
use super::{
    Departure, EdgeHeight, EdgeRay, EdgeRays, HorizonSettings, Levels, Nadir, Solution, Sphere,
    Stage, Stopped, inside, limb,
};
use crate::estimation::FitError;
use crate::frame::{Frame, Sample, View};
use crate::instrument::DirectionCamera;
use crate::reasons::{at, horizon as reasons};
use crate::units::Rejected;
use nalgebra::UnitVector3;
use std::ops::Range;
use std::slice::from_ref;

/// Upper bound of the scatter of an edge's points on lines of the picture.
const EDGE_TOLERANCE_PX: f64 = 3.0;
/// Minimum number of points of a guess; maximum number of guesses that are tried, and the share of the best one's points
/// that they need.
const LEAST_POINTS: usize = 8;
const MOST_GUESSES: usize = 3;
const RIVAL_SHARE: f64 = 0.3;
/// Tolerance of the edge's height if it is fitted, m.
const FITTED_TOLERANCE_M: f64 = 15_000.0;
/// Spacing of places along the edge: for the first rough alignment of the cone, for a second one, and for the final fit,
/// where closer places would reduce the noise no further.
const ROUGH_SPACING_PX: f64 = 96.0;
const ALIGNING_SPACING_PX: f64 = 48.0;
const SPACING_PX: f64 = 12.0;
/// The profiles are read again while the nadir moves by more than this, at most `MOST_ROUNDS` times. In front of clouds,
/// the profiles' ends affect the result.
const SETTLED_PX: f64 = 0.3;
const SETTLED_CLOUDED_PX: f64 = 0.2;
const MOST_ROUNDS: usize = 8;
/// Minimum brightness of an edge above the sky, as a share of the frame's contrast, and in sigmas of a pixel's noise.
const LEAST_CONTRAST: f64 = 0.1;
const LEAST_CONTRAST_SIGMAS: f64 = 4.0;
/// Maximum deviation of a place of the limb from the others, beyond noise, relative to its brightness.
const MOST_UNLIKE: f64 = 0.1;
/// Minimum number of places that show the edge, and their minimum share of those that show light.
pub(super) const LEAST_PLACES: usize = 12;
const LEAST_SHARE: f64 = 0.4;
/// A fine nadir needs these shares of the lit places and of all places in view; also a minimum number of places, or most of
/// those in a small picture, because a short edge may be a flare's.
const FINE_SHARE: f64 = 0.66;
const FINE_PLACES: f64 = 0.25;
const FINE_LEAST: f64 = 20.0;
const FINE_MOST: f64 = 0.9;
/// Largest sigma of a fine nadir, deg.
const MOST_SIGMA_DEG: f64 = 0.9;
/// Largest departure of a limb from its sphere, m, 1 sigma.
const MOST_DEPARTURE_M: f64 = 4_500.0;
/// Possible heights of the air's edge, m.
const EDGE_HEIGHTS_M: Range<f64> = 0.0..60_000.0;

/// Inputs of the search in a frame.
pub(super) struct Search<'a> {
    pub settings: &'a HorizonSettings,
    pub camera: &'a DirectionCamera,
    pub sphere: &'a Sphere,
}

impl Search<'_> {
    pub fn find<T: Sample>(
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

    /// The nadirs with which most sharp edges agree, the best one first.
    fn detect<T: Sample>(&self, view: &View<'_, T>, levels: &Levels) -> Vec<Guess> {
        let lens = &self.camera.lens;
        let scan = Scan::new(
            view,
            self.scale_px(),
            self.radius_px(),
            self.least_dn(levels),
        );
        let points = scan.edges(view, &self.camera.mask);
        let edge = EdgeRays::of(&points, lens, 0.0);
        let tolerance_rad = self.tolerance_rad() + EDGE_TOLERANCE_PX / lens.mean_focal_px();
        let half_angle_rad = self.sphere.half_angle_rad.value;
        consensus(&edge.rays, half_angle_rad, tolerance_rad, MOST_GUESSES)
    }

    /// Minimum brightness of the limb above the sky, DN.
    fn least_dn(&self, levels: &Levels) -> f64 {
        let contrast_dn = LEAST_CONTRAST * (levels.bright_dn - levels.dark_dn);
        contrast_dn.max(LEAST_CONTRAST_SIGMAS * levels.noise_dn)
    }

    /// The radius of the sphere in the picture at its smallest.
    fn radius_px(&self) -> f64 {
        self.camera.lens.mean_focal_px() * self.sphere.half_angle_rad.value.tan()
    }

    /// Tolerance of the border of the bright area about the edge.
    fn tolerance_rad(&self) -> f64 {
        let height_rad = self.sphere.rad_per_m * FITTED_TOLERANCE_M;
        match self.settings.height {
            EdgeHeight::Given => self.sphere.tolerance_rad,
            EdgeHeight::Fitted => self.sphere.tolerance_rad.max(height_rad),
        }
    }

    /// Reads the brightness across the edge until the nadir converges. Returns that nadir, fitted without departures from
    /// the sphere, and the sphere it was fitted with.
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
        let aligned = |start: &UnitVector3<f64>, spacing_px| {
            let profiles = Profiles::of(view, self.camera, self.sphere, start, spacing_px);
            let crossings = EdgeRays::of(&profiles.crossings(least_dn), lens, 0.0);
            self.fit_as_sphere(self.sphere, &crossings)
        };
        let roughly = aligned(&start, ROUGH_SPACING_PX)?;
        let mut nadir = aligned(&roughly.direction.unit, ALIGNING_SPACING_PX)?;
        let far_sky_dn = raster.far_sky_dn(self.sphere, &nadir.direction.unit);
        let mut sphere = *self.sphere;
        let (mut points, mut likeness) = (Vec::new(), Ok(()));
        for _ in 0..MOST_ROUNDS {
            let last = nadir;
            sphere.half_angle_rad.value = last.half_angle_rad.value;
            let profiles =
                Profiles::of(view, self.camera, &sphere, &last.direction.unit, SPACING_PX);
            let light = Light {
                least_dn,
                noise_dn: levels.noise_dn,
                // For a sharp edge, the sub-pixel phase makes the profiles differ.
                most_unlike: self.sphere.viewpoint.map_or(f64::INFINITY, |_| MOST_UNLIKE),
                far_sky_dn,
            };
            solution.places = profiles.places.len();
            let edge = limb::edge(&profiles, &sphere, &light).map_err(at(Stage::Edge))?;
            (points, likeness) = (edge.points, edge.likeness);
            solution.edge = EdgeRays::of(&points, lens, edge.sigma_rad);
            solution.clouded = edge.clouded;
            solution.lit = edge.lit;
            enough(solution.edge.rays.len(), solution)?;
            nadir = self.fit_as_sphere(&sphere, &solution.edge)?;
            let turned_rad = nadir.direction.unit.angle(&last.direction.unit);
            let risen_rad = nadir.half_angle_rad.value - last.half_angle_rad.value;
            let settled_px = match edge.is_clear {
                true => SETTLED_PX,
                false => SETTLED_CLOUDED_PX,
            };
            if turned_rad.max(risen_rad.abs()) * lens.mean_focal_px() < settled_px {
                break;
            }
            for ray in &mut solution.edge.rays {
                let angle_rad = |nadir: &Nadir| {
                    ray.angle_from(&nadir.direction.unit).0 - nadir.half_angle_rad.value
                };
                ray.unsettled_rad = angle_rad(&nadir) - angle_rad(&last);
            }
        }
        if self.sphere.viewpoint.is_some() {
            likeness.map_err(at(Stage::Edge))?;
            inside::goes_on(view, &self.camera.mask, &points, self.scale_px())
                .map_err(at(Stage::Edge))?;
        }
        Ok((sphere, nadir))
    }

    /// Number of pixels over which the limb's light falls to 1/e.
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
                let least = FINE_LEAST.min(FINE_MOST * solution.places as f64);
                Rejected::at_least(least, agreeing, reasons::LITTLE_EDGE)?;
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

    /// The nadir of an edge without departures from its sphere.
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

/// The nadir from the edge in one or more pictures. Unless it is stated, the departure from a sphere is estimated from the
/// residuals of a plain fit.
pub(super) fn fitted(
    settings: &HorizonSettings,
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
    let risen_rad = nadir.half_angle_rad.value - sphere.half_angle_rad.value;
    let left = |ray: &EdgeRay| {
        ray.angle_from(down).0 - sphere.half_angle_towards(&ray.unit, down) - risen_rad
    };
    let rays = edges.iter().flat_map(|edge| &edge.rays).zip(&nadir.weights);
    let agreeing = rays.filter(|(_, weight)| is_part(weight));
    let left: Vec<(&EdgeRay, f64)> = agreeing.map(|(ray, _)| (ray, left(ray))).collect();
    Departure::of_residuals(&left)
}

/// Checks that enough of the places with light show the edge.
pub(super) fn enough(seen: usize, solution: &Solution) -> Result<(), Stopped> {
    let least = (LEAST_SHARE * solution.lit as f64).max(LEAST_PLACES as f64);
    Rejected::at_least(least, seen as f64, reasons::LITTLE_EDGE).map_err(at(Stage::Edge))
}

/// The error if too few sharp edges agree.
pub(super) fn no_horizon(points: usize) -> Stopped {
    let limit = LEAST_POINTS as f64;
    Stopped::new(Stage::Detection, reasons::NO_HORIZON, points as f64, limit)
}

pub(super) fn unfitted(error: NadirError) -> Stopped {
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
