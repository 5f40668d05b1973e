//! The stages of a frame as the pipeline runs them, one by one.

use crate::flight::Flight;
use solaspect::aspect::Solution;
use solaspect::fiducial::{self, CrossShape, Detections, FlatDisc, Refiner};
use solaspect::frame::{Background, Cutout, Frame, Levels, PixelNoise, Region};
use solaspect::geometry::Ellipse;
use solaspect::limb::{
    self, CoarseDisc, DiscSearch, Hidden, KnownOutline, Limb, LimbFit, OutlinePrior,
};
use solaspect::units::Measured;

pub struct Stages<'a> {
    pub frame: &'a Frame,
    pub flight: &'a Flight,
    pub levels: Levels,
}

impl Stages<'_> {
    fn radius_mil(&self) -> f64 {
        let radius_arcsec = self.flight.expected.map_or(0.0, |e| e.radius_arcsec);
        self.flight.instrument.optics.radius_mil(radius_arcsec)
    }

    fn shape(&self, scale_mil_per_px: f64) -> CrossShape {
        let instrument = &self.flight.instrument;
        let blur_px = instrument.optics.blur_px.value;
        CrossShape::new(&instrument.plate.cross, scale_mil_per_px, blur_px)
    }

    pub fn disc(&self) -> Option<CoarseDisc> {
        let scale = self.flight.instrument.mounting.scale_mil_per_px.value;
        let search = DiscSearch {
            frame: self.frame,
            levels: &self.levels,
            radius_px: self.radius_mil() / scale,
            mark_length_px: 2.0 * self.shape(scale).half_length_px,
            settings: &limb::Settings::default(),
        };
        search.anywhere(self.frame.region()).ok()
    }

    /// The limb, nothing hidden.
    pub fn limb(&self, start: &Ellipse) -> Option<Limb> {
        let radius_px = start.mean_radius();
        let prior = |sigma_px, flatness| OutlinePrior {
            radius_px: Measured::new(radius_px, sigma_px),
            flatness,
        };
        let scale = self.flight.instrument.mounting.scale_mil_per_px.value;
        let fit = LimbFit {
            frame: self.frame,
            levels: &self.levels,
            blur_px: self.shape(scale).blur_px,
            known: KnownOutline {
                possible: prior(0.03 * radius_px, 0.002),
                stated: prior(0.5, 0.0003),
            },
            settings: &limb::Settings::default(),
        };
        fit.near(start, &Hidden::nothing(self.frame.region())).ok()
    }

    /// The pixels of the disc, and of every mark on it.
    pub fn cutout(&self, limb: &Limb) -> Option<Cutout> {
        let disc = limb.outline.ellipse;
        let reach = disc.mean_radius() + 2.0 * self.disc_shape(limb).reach_px();
        let (width, height) = (self.frame.width(), self.frame.height());
        let region = Region::around(disc.centre.into(), reach, width, height)?;
        let background = Background::even(region, self.levels.background_dn);
        let noise = PixelNoise::even(self.levels.noise_dn);
        Some(Cutout::new(self.frame, region, &background, noise))
    }

    pub fn flat(&self, cutout: &Cutout, limb: &Limb) -> Option<FlatDisc> {
        let (disc, shape) = (limb.outline.ellipse, self.disc_shape(limb));
        FlatDisc::new(cutout, disc, &limb.light(), &shape)
    }

    fn disc_shape(&self, limb: &Limb) -> CrossShape {
        self.shape(self.radius_mil() / limb.outline.ellipse.mean_radius())
    }

    pub fn detections(&self, flat: &FlatDisc) -> Detections {
        let shape = self.shape(self.radius_mil() / flat.outline.mean_radius());
        fiducial::detect(flat, &shape, &fiducial::Settings::default())
    }

    /// How many of a solution's marks their own pixels place.
    pub fn refined(&self, cutout: &Cutout, limb: &Limb, solution: &Solution) -> usize {
        let Some(adopted) = &solution.mapping else {
            return 0;
        };
        let instrument = &self.flight.instrument;
        let scale = self.radius_mil() / limb.outline.ellipse.mean_radius();
        let (plate, blur_px) = (&instrument.plate, instrument.optics.blur_px.value);
        let refiner = Refiner::new(&plate.cross, scale, blur_px);
        let light = limb.light();
        let refined = solution.marks.iter().filter_map(|mark| {
            let jacobian = adopted.mapping.sensor_jacobian(plate.position(mark.id));
            refiner.refine(cutout, &light, &jacobian, mark.at)
        });
        refined.count()
    }
}
