//! The direction of a sphere from its edge: the Earth's horizon in a camera's picture.
//!
//! Rays from the camera to the edge of a sphere form a cone about the direction of its centre, the nadir (Braun and Barf
//! 2022, "Image processing based horizon sensor for estimating the orientation of sounding rockets, launch vehicles and
//! spacecraft", section 2.4). The distance gives the cone's half-angle; points of the edge determine its axis, for any
//! length of the arc that they lie on.
//!
//! Directions are in the camera frame: x to the right, y down, z forward.
//!
//! # Processing of a frame
//! 1. [`Levels`]: the brightness of a raster of pixels. A frame that is dark or bright all over is rejected.
//! 2. `scan`: sharp edges along rows and columns. `consensus`: RANSAC finds the nadirs that most of them agree with. If the
//!    last frame's nadir is known, it replaces both.
//! 3. `profile`: the brightness across the edge all along the cone. `limb`: the point with half of the limb's own
//!    brightness, and whether it is a limb at all: as sharp as the air (`shape`), the same from place to place, and with
//!    light that continues inside (`inside`). The profiles are read again until the edge converges.
//! 4. [`nadir()`] fits the direction, with its covariance from noise, limb, height and shifts of the edge. If several
//!    guesses get this far, the best one is kept, in doubt if another is nearly as good ([`Solution`]).
//!
//! [`joint`] does the last step for all cameras of one vehicle together. [`circle`] is a simpler method that follows the
//! border of the bright area, for comparison.

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
mod search;
mod shape;
mod sphere;
mod template;

pub use departure::Departure;
pub use edge::{EdgePoint, EdgeRay, EdgeRays};
pub use light::Levels;
pub use nadir::{Conic, EdgeHeight, Nadir, NadirError, nadir, pitch_deg, roll_deg};
pub use overlay::{overlay, overlay_of_circle};
pub(crate) use sphere::across;
pub use sphere::{Ellipsoid, Refraction, Sphere, Viewpoint};

use crate::frame::Frame;
use crate::instrument::DirectionCamera;
use crate::reasons::horizon as reasons;
use crate::with_view;
use nalgebra::{Rotation3, UnitVector3};
use search::{Search, enough, fitted, unfitted};

/// Nadirs farther apart than this, deg, are different; the second one is a rival if it has this share of the first one's
/// points.
const APART_DEG: f64 = 2.0;
const RIVAL_POINTS: f64 = 0.5;
/// Minimum share of the places for a flag.
const LEAST_SHARE: f64 = 0.1;

/// Settings for the solution of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct HorizonSettings {
    /// For [`circle`], pixels of at least this value are bright, DN; if not stated, derived from the frame's own levels.
    pub threshold_dn: Option<f64>,
    pub height: EdgeHeight,
    /// Departure of the limb from a sphere; if not stated, derived from the frame's own residuals.
    pub departure: Option<Departure>,
}

/// Stage at which the solution of a frame may end.
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

/// The stage at which processing stopped, and the reason.
pub type Stopped = crate::reasons::Stopped<Stage>;

impl crate::reasons::Stage for Stage {
    fn name(self) -> &'static str {
        Self::name(self)
    }
}

/// Quality of a nadir.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Quality {
    /// No check contradicts it.
    Fine,
    /// A check contradicts it: see [`Solution::doubt`].
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

/// Features near the edge, or that cover it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Flag {
    /// Clouds reach into the limb: there the air above them determines the edge.
    Clouds,
    /// Places whose edge is not the sphere's, but that of a cloud top, of the ground, or of a flare.
    OtherEdges,
    /// Places that show no edge: night, or glare.
    NoEdge,
    /// Cameras of one vehicle without a common cone: each camera has its own nadir.
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

/// Solution of a frame, as far as processing got.
#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    pub levels: Option<Levels>,
    /// Number of places of the edge that are in view.
    pub places: usize,
    /// Number of these with light of any kind.
    pub lit: usize,
    /// The edge where it is visible.
    pub edge: EdgeRays,
    /// Share of the places with clouds in the limb.
    pub clouded: f64,
    pub nadir: Result<Nadir, Stopped>,
    /// Why a nadir is not fine; none if it is.
    pub doubt: Option<Stopped>,
}

impl Solution {
    /// Solution of a frame that shows nothing.
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

    /// Number of points that are part of the edge.
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

    /// The better one of two, in doubt if the other is nearly as good.
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

    /// Flags for the user of the nadir; empty for a frame without one.
    pub fn flags(&self) -> Vec<Flag> {
        let (places, seen) = (self.places as f64, self.edge.rays.len() as f64);
        let flags = [
            (Flag::Clouds, self.clouded),
            (Flag::OtherEdges, (seen - self.agreeing() as f64) / seen),
            (Flag::NoEdge, (places - seen) / places),
        ];
        let is_flagged = |(_, share): &(Flag, f64)| self.nadir.is_ok() && *share > LEAST_SHARE;
        flags
            .into_iter()
            .filter(is_flagged)
            .map(|(flag, _)| flag)
            .collect()
    }
}

/// Finds a sphere in a frame; first near the last frame's nadir, if there is one.
pub fn solve(
    settings: &HorizonSettings,
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

/// The nadir from simultaneous pictures of several cameras of one vehicle, each with the rotation from its own frame to the
/// vehicle's body. `sphere` is in the body's frame.
///
/// # Errors
/// If no camera sees the edge, or if a camera's edge agrees too little with the common nadir.
pub fn joint(
    settings: &HorizonSettings,
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
