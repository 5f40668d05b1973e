//! The second pass: a frame in which the first pass did not find the disc or the marks is solved again. The flight has now determined the
//! mapping, and the frames before and after predict the disc's position.
//!
//! 1. The predicted outline of the disc: from the frame's own disc, else from the path. Where the position is uncertain, the disc
//!    is searched for around it.
//! 2. Brightness levels of the disc and its surroundings there: haze changes them.
//! 3. The limb, with every mark of the plate masked, whether it was found or not.

use super::disc::{self, PlateDisc};
use super::flags::FrameFlag;
use super::path::SunPath;
use super::record::{Grade, PackedPoint};
use super::suns::{Flight, LEAST_LIMB, LOOSE_RADIUS, MappedDisc, Suns};
use crate::archive::ArchiveReader;
use crate::aspect::{self, SolverSettings};
use crate::estimation::{median, median_and_scatter};
use crate::fiducial::MarkImage;
use crate::frame::{Frame, Levels, ROUNDING_NOISE_DN, Region};
use crate::geometry::{Circle, Ellipse, Mapping};
use crate::instrument::Instrument;
use crate::limb::{self, DiscSearch, KnownOutline, Limb, LimbFit, OutlinePrior};
use crate::observe::Pass;
use crate::units::{Measured, PlateMil};
use crate::with_view;
use nalgebra::Vector2;
use rayon::prelude::*;

/// Position uncertainty above which the disc is searched for, 1 sigma, px.
const VAGUE_PX: f64 = 2.0;
/// The search extends over this many sigmas plus a margin, px.
const SEARCHED_SIGMAS: f64 = 4.0;
const SEARCHED_PX: f64 = 10.0;
/// Parts of the radius within which the disc's level is measured, and between which that of its surroundings.
const INSIDE: f64 = 0.9;
const AROUND: [f64; 2] = [1.15, 1.6];
/// Quantile of the pixels inside that gives the disc's level: above the marks.
const DISC_QUANTILE: f64 = 0.9;
/// Fewer pixels do not determine a level.
const LEAST_PIXELS: usize = 100;
/// Least contrast of the disc with its surroundings, in sigmas of a pixel's noise.
const LEAST_CONTRAST: f64 = 2.0;
/// Sigma of a limb point (px) at a contrast of one, with 180 points on the limb; and the largest sigma accepted: fewer points are used to
/// reach it, because less accurate points cannot be distinguished from noise.
const SIGMA_AT_180_PX: f64 = 2.7;
const SURE_SIGMA_PX: f64 = 0.25;
/// Fewer points leave parts of the limb unmeasured.
const LEAST_POINTS: usize = 36;
/// Priors of the outline: sigma of its radius (px), and its relative deviation from a circle.
const POSSIBLE: (f64, f64) = (1.0, 0.002);
const STATED: (f64, f64) = (0.1, 0.001);
/// Requirements of a limb: least part of its points on the outline, and their greatest scatter, px.
const LEAST_ON_OUTLINE: f64 = 0.6;
const MAX_SCATTER_PX: f64 = 1.0;

/// Position uncertainty of the disc above which there is no second pass, 1 sigma.
const MOST_PLACE_SIGMA_MIL: f64 = 200.0;
/// Distance between a frame's own disc and the disc of the second pass, 1 sigma.
const OWN_DISC_SIGMA_MIL: f64 = 5.0;
/// A frame's own disc is another object if it is this many sigma off the path.
const OTHER_OBJECT_SIGMAS: f64 = 8.0;

/// Solves again the frames in which disc and marks were not found, or were identified wrongly. Returns in order those that now have another
/// disc.
pub(super) fn solve_again(
    flight: &Flight,
    suns: &Suns,
    path: &SunPath,
    pass: &Pass<'_>,
) -> Vec<(usize, MappedDisc)> {
    let wants = |n: &usize| {
        let own = flight.frames[*n].quality;
        own != Grade::Fine || suns.flags[*n].contains(FrameFlag::WrongIds)
    };
    let wanted: Vec<usize> = (0..flight.frames.len()).filter(wants).collect();
    pass.watch.begin(wanted.len(), "frames seen again");
    let places = path.places(&wanted);
    let wanted = wanted.par_iter().zip(places);
    let solved = wanted.filter(|_| !pass.watch.is_cancelled());
    let solved = solved.filter_map(|(n, by_path)| {
        let mapped = solve(flight, suns, by_path, pass.archive, *n);
        pass.watch.step();
        Some((*n, mapped?))
    });
    let solved = solved.collect();
    pass.watch.end();
    solved
}

fn solve(
    flight: &Flight,
    suns: &Suns,
    by_path: Option<(PlateMil, f64)>,
    archive: &ArchiveReader,
    n: usize,
) -> Option<MappedDisc> {
    let mapping = flight.mapping.as_ref()?.at(n)?;
    let (centre, sigma_mil) = predicted_disc(flight, suns, by_path, n, &mapping)?;
    let expected = flight.frames[n].expected_radius_mil?;
    let ratio = suns.known_ratio;
    let known = Known {
        instrument: &flight.recipe.instrument,
        settings: &flight.recipe.settings,
        mapping,
        centre,
        sigma_mil,
        radius_mil: expected * ratio.value,
    };
    let file = archive.open_file(&flight.timeline.file(n).ok()?).ok()?;
    let file = file.of_size(known.instrument.camera.size_px());
    let found = file.with_frame(|frame| known.find(frame)).ok()??;
    // A limb that is seen only in part does not determine its radius.
    let sigma = match found.limb_part >= LEAST_LIMB {
        true => LOOSE_RADIUS.sigma,
        false => ratio.sigma,
    };
    let radius = Measured::new(known.radius_mil, expected * sigma);
    let disc: PlateDisc = disc::on_plate(found.centre_px, &found.limb, &mapping, radius)?;
    let sigma = sigma_mil.hypot(disc.centre.covariance.trace().sqrt());
    let near = centre.distance(disc.centre.position) < OTHER_OBJECT_SIGMAS * sigma;
    flight.mapped(n, disc, found.limb_part).filter(|_| near)
}

/// Predicted position of a frame's disc, and 1 sigma, mil: from the frame itself, unless the path shows that its disc is another object.
fn predicted_disc(
    flight: &Flight,
    suns: &Suns,
    by_path: Option<(PlateMil, f64)>,
    n: usize,
    at: &Mapping,
) -> Option<(PlateMil, f64)> {
    let by_path = by_path.filter(|(_, sigma)| *sigma < MOST_PLACE_SIGMA_MIL);
    let Some(own) = &flight.frames[n].disc else {
        return by_path;
    };
    let own = at.to_plate(own.centre_px);
    let other = by_path.filter(|(place, sigma)| {
        place.distance(own) > OTHER_OBJECT_SIGMAS * sigma.hypot(OWN_DISC_SIGMA_MIL)
    });
    // A disc that was rejected would be flagged again.
    other.or((!suns.flags[n].reject()).then_some((own, OWN_DISC_SIGMA_MIL)))
}

/// Priors of a frame before its second pass.
struct Known<'a> {
    pub instrument: &'a Instrument,
    pub settings: &'a SolverSettings,
    pub mapping: Mapping,
    /// Predicted position of the disc, with its 1 sigma below.
    pub centre: PlateMil,
    pub sigma_mil: f64,
    pub radius_mil: f64,
}

/// Result of the second pass.
struct Found {
    pub centre_px: [f64; 2],
    pub limb_part: f64,
    pub limb: Vec<PackedPoint>,
}

impl Known<'_> {
    /// Searches a frame. `None` where no disc is found.
    fn find(&self, frame: &Frame) -> Option<Found> {
        let (start, levels) = self.start(frame)?;
        let limb = self.limb(frame, &start, &levels)?;
        let (centre, at) = (limb.outline.ellipse.centre, |p: &limb::LimbPoint| {
            p.at.vector()
        });
        Some(Found {
            centre_px: centre.into(),
            limb_part: limb::arc_fraction(limb.points.iter().map(at), centre),
            limb: limb
                .points
                .iter()
                .map(|point| PackedPoint::of(point, centre))
                .collect(),
        })
    }

    /// The predicted outline of a disc centred at a plate position.
    fn outline(&self, centre: PlateMil) -> Option<Ellipse> {
        let to_sensor = self.mapping.sensor_jacobian(centre) * self.radius_mil;
        let at = self.mapping.to_sensor(centre).vector();
        Ellipse::of_unit_circle(at, &to_sensor)
    }

    /// The initial outline, and the levels around it.
    fn start(&self, frame: &Frame) -> Option<(Ellipse, Levels)> {
        let outline = self.outline(self.centre)?;
        let scale = self.mapping.scale_mil_per_px(outline.centre.into());
        let sigma_px = self.sigma_mil / scale;
        let found = match sigma_px > VAGUE_PX {
            true => self.search(frame, &outline, sigma_px)?,
            false => outline,
        };
        Some((found, levels_about(frame, &found)?))
    }

    fn search(&self, frame: &Frame, outline: &Ellipse, sigma_px: f64) -> Option<Ellipse> {
        let settings = &self.settings.limb;
        let levels = limb::levels(frame, settings).ok()?;
        let radius = outline.mean_radius();
        let reach = radius + SEARCHED_SIGMAS * sigma_px + SEARCHED_PX;
        let (width, height) = (frame.width(), frame.height());
        let region = Region::around(outline.centre.into(), reach, width, height)?;
        let search = DiscSearch {
            frame,
            levels: &levels,
            radius_px: radius,
            mark_length_px: 2.0 * self.shape(outline).half_length_px,
            settings,
        };
        let disc = search.anywhere(region).ok()?;
        self.outline(self.mapping.to_plate(disc.centre.into()))
    }

    fn shape(&self, outline: &Ellipse) -> MarkImage {
        let scale = self.radius_mil / outline.mean_radius();
        let (plate, optics) = (&self.instrument.plate, &self.instrument.optics);
        MarkImage::new(&plate.shape, scale, optics.blur_px.value)
    }

    fn limb(&self, frame: &Frame, start: &Ellipse, levels: &Levels) -> Option<Limb> {
        let radius_px = start.mean_radius();
        let prior = |(sigma_px, flatness)| OutlinePrior {
            radius_px: Measured::new(radius_px, sigma_px),
            flatness,
        };
        let known = KnownOutline {
            possible: prior(POSSIBLE),
            stated: prior(STATED),
        };
        let disc = Circle {
            centre: start.centre,
            radius: radius_px,
        };
        let cutout = aspect::cutout(frame, self.instrument, levels, &disc);
        let mask = aspect::marks_mask(&cutout, self.instrument, start, &self.mapping);
        let settings = limb::LimbSettings {
            limb_points: self.points(levels),
            ..self.settings.limb
        };
        let fit = LimbFit {
            cutout: &cutout,
            disc_dn: levels.disc_dn - levels.background_dn,
            blur_px: self.shape(start).blur_px,
            known,
            settings: &settings,
        };
        let limb = fit.near(&fit.rough(start).ok()?, &mask).ok()?;
        let round = limb.outline.accepted_share() >= LEAST_ON_OUTLINE
            && limb.outline.scatter_px <= MAX_SCATTER_PX;
        round.then_some(limb)
    }

    /// Number of points on the limb: fewer at lower contrast.
    fn points(&self, levels: &Levels) -> usize {
        let contrast = (levels.disc_dn - levels.background_dn) / levels.noise_dn;
        let points = 180.0 * (SURE_SIGMA_PX * contrast / SIGMA_AT_180_PX).powi(2);
        (points as usize)
            .max(LEAST_POINTS)
            .min(self.settings.limb.limb_points)
    }
}

/// Levels of the disc within an outline and of its surroundings.
fn levels_about(frame: &Frame, outline: &Ellipse) -> Option<Levels> {
    let (mut inside, mut around) = (Vec::new(), Vec::new());
    let reach = AROUND[1] * outline.mean_radius();
    let (width, height) = (frame.width(), frame.height());
    let region = Region::around(outline.centre.into(), reach, width, height)?;
    with_view!(frame, view => {
        for y in region.y0..region.y1 {
            for x in region.x0..region.x1 {
                let part = outline.to_disc(Vector2::new(x as f64, y as f64)).norm();
                if part < INSIDE {
                    inside.push(f64::from(view.dn(x, y)));
                } else if (AROUND[0]..AROUND[1]).contains(&part) {
                    around.push(f64::from(view.dn(x, y)));
                }
            }
        }
    });
    if inside.len().min(around.len()) < LEAST_PIXELS {
        return None;
    }
    let (background_dn, scatter_dn) = median_and_scatter(&around)?;
    let noise_dn = scatter_dn.max(ROUNDING_NOISE_DN);
    let middle_dn = median(&inside)?;
    let contrast = (middle_dn - background_dn) / noise_dn;
    let bright = (DISC_QUANTILE * inside.len() as f64) as usize;
    let bright_dn = *inside.select_nth_unstable_by(bright, f64::total_cmp).1;
    // At a low signal-to-noise ratio noise determines the brightest pixels: limit the level.
    let disc_dn = bright_dn.min(middle_dn + (middle_dn - background_dn) / 2.0);
    (contrast > LEAST_CONTRAST).then_some(Levels {
        background_dn,
        noise_dn,
        disc_dn,
    })
}
