//! Where the Sun is on the plate: each frame's limb through the flight's mapping.

use super::disc::{self, PlateDisc};
use super::frames::Frame;
use super::mapping::FlightMapping;
use super::oddity::{Oddities, Oddity};
use super::recipe::Recipe;
use super::record::{FrameRecord, Grade, PackedPoint};
use super::timeline::Timeline;
use crate::estimation::{median, median_and_scatter};
use crate::observe::JournalError;
use crate::units::{Estimate, Measured, PlateMil};
use nalgebra::Matrix2;
use rayon::prelude::*;

/// The limb's part that makes a fine solution.
const LEAST_FINE_LIMB: f64 = 0.4;
/// The limb's part that determines its own radius.
pub(super) const TELLING_LIMB: f64 = 0.7;
/// A mapping known less well than this makes no fine frame, 1 sigma.
const MOST_FINE_SIGMA_MIL: f64 = 1.0;
/// What is known of a radius before the flight has determined it, over the expected one.
pub(super) const LOOSE_RADIUS: Measured = Measured::new(1.0, 0.02);
/// The flight's radius is this good at least, relative.
const TIGHT_RADIUS: f64 = 1e-4;

/// Fewer discs have no usual scatter.
const LEAST_DISCS: usize = 10;
/// What the points of a limb do not show of their errors, since they share it, beside what they show: the same pixels and scratches. Seen
/// were 0.065 in 48 rests of 50 frames, simulated with hot pixels, scratches and leaks; some of them have much more.
const SHARED_LIMB: f64 = 0.1;

/// What the Suns of a flight are found with.
pub(super) struct Flight {
    pub recipe: Recipe,
    pub timeline: Timeline<FrameRecord>,
    /// The dated ones.
    pub frames: Vec<Frame>,
    pub mapping: Option<FlightMapping>,
}

/// A frame's disc through the flight's mapping.
#[derive(Debug, Clone, Copy)]
pub(super) struct Seen {
    pub disc: PlateDisc,
    /// What the mapping adds to the covariance of its place, mil^2.
    by_mapping: Matrix2<f64>,
    pub limb_part: f64,
    pub quality: Grade,
}

impl Seen {
    /// The Sun, by limb and mapping together.
    pub fn sun(&self) -> Estimate<PlateMil> {
        let centre = self.disc.centre;
        Estimate {
            covariance: centre.covariance * (1.0 + SHARED_LIMB) + self.by_mapping,
            ..centre
        }
    }
}

impl Flight {
    /// A disc as the flight's mapping has it: its quality is that of limb and mapping. `None` without a mapping.
    pub fn seen(&self, n: usize, disc: PlateDisc, limb_part: f64) -> Option<Seen> {
        let mapping = self.mapping.as_ref()?;
        let by_mapping = mapping.covariance_mil2(n, disc.centre.position, &mapping.at(n)?);
        let known = by_mapping.trace() < 2.0 * MOST_FINE_SIGMA_MIL.powi(2);
        let fine = limb_part >= LEAST_FINE_LIMB && (known || mapping.own_jump(n).is_some());
        Some(Seen {
            disc,
            by_mapping,
            limb_part,
            quality: if fine { Grade::Fine } else { Grade::Coarse },
        })
    }

    /// The discs of the dated frames that show a part of the limb that is `wanted`; `ratio` is what is known of their radius, over the
    /// expected one.
    fn discs(
        &self,
        wanted: impl Fn(f64) -> bool + Sync,
        ratio: Measured,
    ) -> Result<Vec<(usize, PlateDisc)>, JournalError> {
        let found = self.frames.par_iter().enumerate().map(|(n, frame)| {
            let Some((own, expected)) = frame.disc.zip(frame.expected_radius_mil) else {
                return Ok(None);
            };
            if !wanted(own.limb_part) {
                return Ok(None);
            }
            let record = self.timeline.frame(n)?;
            let limb = record.map_or(Vec::new(), |record| record.limb);
            let centre_px = [own.centre_px.x, own.centre_px.y];
            let disc = self.on_plate(n, centre_px, &limb, ratio.scaled(expected));
            Ok(disc.map(|disc| (n, disc)))
        });
        let found: Vec<_> = found.collect::<Result<_, JournalError>>()?;
        Ok(found.into_iter().flatten().collect())
    }

    fn on_plate(
        &self,
        n: usize,
        centre_px: [f64; 2],
        limb: &[PackedPoint],
        radius_mil: Measured,
    ) -> Option<PlateDisc> {
        let mapping = self.mapping.as_ref()?.at(n)?;
        disc::on_plate(centre_px, limb, &mapping, radius_mil)
    }
}

/// The Suns of the dated frames, and what is odd about them.
pub(super) struct Suns {
    pub seen: Vec<Option<Seen>>,
    pub odd: Vec<Oddities>,
    /// The flight's radius over the expected one, where its discs determine it.
    pub radius_ratio: Option<Measured>,
    /// What is known of it.
    pub known_ratio: Measured,
}

impl Suns {
    /// Whole limbs first, which determine the flight's radius, then the others.
    ///
    /// # Errors
    /// A journal that cannot be read.
    pub fn find(flight: &Flight) -> Result<Self, JournalError> {
        let is_whole = |part: f64| part >= TELLING_LIMB;
        let mut found = flight.discs(is_whole, LOOSE_RADIUS)?;
        hold_to_usual_scatter(found.iter_mut().map(|(_, disc)| disc));
        let ratios = found.iter().filter_map(|(n, disc)| {
            Some(disc.radius_mil.value / flight.frames[*n].expected_radius_mil?)
        });
        let ratio = median_and_scatter(&ratios.collect::<Vec<f64>>());
        let radius_ratio = ratio.map(|(value, sigma)| Measured::new(value, sigma));
        let known = radius_ratio.unwrap_or(Measured::new(1.0, LOOSE_RADIUS.sigma / 4.0));
        let known_ratio = Measured::new(known.value, known.sigma.max(TIGHT_RADIUS));
        found.extend(flight.discs(|part| !is_whole(part), known_ratio)?);
        let count = flight.frames.len();
        let mut seen = vec![None; count];
        for (n, disc) in found {
            let own = flight.frames[n].disc;
            seen[n] = own.and_then(|own| flight.seen(n, disc, own.limb_part));
        }
        Ok(Self {
            seen,
            odd: vec![Oddities::default(); count],
            radius_ratio,
            known_ratio,
        })
    }

    /// The Sun of a frame and its quality, whatever is odd about it.
    fn stated(&self, frame: &Frame, n: usize) -> (Grade, Option<Estimate<PlateMil>>) {
        let only_again = self.odd[n].contains(Oddity::SecondLook);
        match &self.seen[n] {
            Some(seen) if only_again => (Grade::Coarse, Some(seen.sun())),
            Some(seen) => (seen.quality, Some(seen.sun())),
            None => (frame.quality, frame.disc.map(|disc| disc.on_plate)),
        }
    }

    /// A frame's quality: none where something spoils it.
    pub fn quality(&self, frame: &Frame, n: usize) -> Grade {
        match self.odd[n].spoil() {
            true => Grade::None,
            false => self.stated(frame, n).0,
        }
    }

    /// The Sun of a frame; none where something spoils it.
    pub fn sun(&self, frame: &Frame, n: usize) -> Option<Estimate<PlateMil>> {
        let (_, sun) = self.stated(frame, n);
        sun.filter(|_| !self.odd[n].spoil())
    }

    /// The Sun of a frame whose place is one of the flight's path.
    pub fn fine(&self, frame: &Frame, n: usize) -> Option<Estimate<PlateMil>> {
        let sun = self.sun(frame, n);
        sun.filter(|_| self.quality(frame, n) == Grade::Fine)
    }

    /// Part of the limb that was seen, 0 to 1.
    pub fn limb_part(&self, frame: &Frame, n: usize) -> Option<f64> {
        let seen = self.seen[n].map(|seen| seen.limb_part);
        seen.or(frame.disc.map(|disc| disc.limb_part))
    }

    /// Whether nothing but another Sun could be where the fine frame has its Sun: most of the limb was seen, and its radius is not odd.
    pub fn is_sure(&self, frame: &Frame, n: usize) -> bool {
        self.limb_part(frame, n)
            .is_some_and(|part| part >= TELLING_LIMB)
    }
}

/// The points' sigmas are stated with caution. Where the limbs of a flight scatter less than those, by so much less are the discs uncertain.
fn hold_to_usual_scatter<'a>(discs: impl Iterator<Item = &'a mut PlateDisc>) {
    let discs: Vec<&mut PlateDisc> = discs.collect();
    let usual = median(discs.iter().map(|disc| disc.scatter));
    let Some(usual) = usual.filter(|_| discs.len() >= LEAST_DISCS) else {
        return;
    };
    for disc in discs.into_iter().filter(|disc| disc.scatter < 1.0) {
        let scatter = disc.scatter.max(usual).min(1.0);
        disc.centre.covariance *= scatter.powi(2);
        disc.radius_mil.sigma *= scatter;
    }
}
