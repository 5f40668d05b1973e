//! The direction of a sphere by its edge: the Earth's horizon, seen by a camera.
//!
//! Rays from the camera to the edge of a sphere make a cone about the direction of its centre, the nadir (Braun and Barf 2022,
//! "Image processing based horizon sensor for estimating the orientation of sounding rockets, launch vehicles and spacecraft", section 2.4).
//! The distance gives the cone's half-angle; points of the edge determine its axis, however long or short the arc is that they lie on.
//!
//! Directions are in the camera frame: x to the right, y down, z forward.
//!
//! # The way of a frame
//! 1. [`Levels`]: the light of a raster of pixels. A frame that is dark or bright all over is refused.
//! 2. `scan`: sharp edges along rows and columns. `consensus`: RANSAC finds the nadirs that most of them agree with. Where the last
//!    frame's nadir is known, it replaces both.
//! 3. `profile`: the light across the edge all along the cone. `limb`: where it has half of the limb's own brightness, and whether it is
//!    a limb at all: as sharp as the air (`shape`), the same from place to place, and light that continues inside (`inside`). The profiles
//!    are read again until the edge converges.
//! 4. [`nadir()`] fits the direction, with the covariance of noise, limb, height and of what moves the edge. Several guesses may come so far:
//!    the best one counts, in doubt where another is nearly as good ([`Solution`]).
//!
//! [`joint`] does the last step for cameras of one vehicle together. [`circle`] is a simpler method that follows the border of the bright area,
//! for comparison.

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

/// Nadirs that are farther apart than this are two, deg; the second is a rival with such a share of the first one's points.
const APART_DEG: f64 = 2.0;
const RIVAL_POINTS: f64 = 0.5;
/// Share of the places above which an effect is flagged.
const LEAST_SHARE: f64 = 0.1;

/// How a frame is solved.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct HorizonSettings {
    /// For [`circle`], pixels of at least this are bright, DN; by the frame's own light where it is not stated.
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
    /// Nothing contradicts it.
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

/// Things beside the edge, or that hide it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Flag {
    /// Clouds reach into the limb: where they do, the air above them determines the edge.
    Clouds,
    /// Places whose edge is not the sphere's: of a cloud's top, of the ground, of a flare.
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

/// Solution of a frame, as far as it got.
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

    /// Flags for a reader of the nadir; none of a frame without one.
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

/// Finds a sphere in a frame; near the last frame's nadir first, where there is one.
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

/// The nadir by what several cameras of one vehicle see at a time, each with the turn from its own frame to the vehicle's body. `sphere` is
/// that of the body's frame.
///
/// # Errors
/// No camera that sees the edge, or a camera whose edge agrees too little with the nadir of all.
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
