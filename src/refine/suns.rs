//! The Sun's position on the plate: each frame's limb, transformed by the flight's mapping.

use super::disc::{self, PlateDisc};
use super::flags::{FrameFlag, FrameFlags};
use super::frames::Frame;
use super::mapping::FlightMapping;
use super::recipe::Recipe;
use super::record::{FrameRecord, Grade};
use super::timeline::Timeline;
use crate::estimation::{median, median_and_scatter};
use crate::limb::motion_variance_px2;
use crate::observe::JournalError;
use crate::units::{Estimate, Measured, PlateMil};
use nalgebra::Matrix2;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Visible part of the limb required for a fine solution.
const LEAST_FINE_LIMB: f64 = 0.4;
/// Visible part of the limb required to determine its own radius.
pub(super) const LEAST_LIMB: f64 = 0.7;
/// Largest uncertainty of the mapping for a fine frame, 1 sigma.
const MOST_FINE_SIGMA_MIL: f64 = 1.0;
/// Prior of the radius before the flight has determined it, over the expected one.
pub(super) const LOOSE_RADIUS: Measured = Measured::new(1.0, 0.02);
/// Least sigma assumed for the flight's radius, relative.
const TIGHT_RADIUS: f64 = 1e-4;

/// Fewer discs do not determine a median scatter.
const LEAST_DISCS: usize = 10;
/// Common errors of the points of a limb, which their scatter does not show: the same pixels and scratches. The value seen was
/// 0.065 in 48 residuals of 50 frames, simulated with hot pixels, scratches and leaks; some of them have much more.
const SHARED_LIMB: f64 = 0.1;

/// Inputs for the Suns of a flight.
pub(super) struct Flight {
    pub recipe: Recipe,
    pub timeline: Timeline<FrameRecord>,
    /// The dated frames.
    pub frames: Vec<Frame>,
    pub mapping: Option<FlightMapping>,
}

/// A frame's disc, transformed by the flight's mapping.
#[derive(Debug, Clone, Copy)]
pub(super) struct MappedDisc {
    pub disc: PlateDisc,
    pub limb_part: f64,
    pub quality: Grade,
}

impl Flight {
    /// Covariance that the mapping of a frame adds to a position, mil^2.
    fn by_mapping(&self, n: usize, place: PlateMil) -> Option<Matrix2<f64>> {
        let mapping = self.mapping.as_ref()?;
        Some(mapping.covariance_mil2(n, place, &mapping.at(n)?))
    }

    /// Covariance that a long motion during the exposure adds to a disc, as in the solution of the frame alone, mil^2. `None` if the
    /// motion is within the limit of the limb fit.
    fn by_motion(&self, n: usize) -> Option<Matrix2<f64>> {
        let own = self.frames[n].disc?;
        let to_plate = self.mapping.as_ref()?.at(n)?.plate_jacobian(own.centre_px);
        Some(to_plate * to_plate.transpose() * motion_variance_px2(own.motion_px?))
    }

    /// The Sun of a frame, with the covariances of limb and mapping.
    fn sun(&self, n: usize, mapped: &MappedDisc) -> Option<Estimate<PlateMil>> {
        let centre = mapped.disc.centre;
        let by_mapping = self.by_mapping(n, centre.position)?;
        Some(Estimate {
            covariance: centre.covariance * (1.0 + SHARED_LIMB) + by_mapping,
            ..centre
        })
    }

    /// A disc with its quality by limb, mapping and motion. `None` without a mapping.
    pub fn mapped(&self, n: usize, disc: PlateDisc, limb_part: f64) -> Option<MappedDisc> {
        let by_mapping = self.by_mapping(n, disc.centre.position)?;
        let known = by_mapping.trace() < 2.0 * MOST_FINE_SIGMA_MIL.powi(2);
        let jumps = self.mapping.as_ref().and_then(|m| m.own_jump(n)).is_some();
        let by_motion = self.by_motion(n);
        let fine = limb_part >= LEAST_FINE_LIMB && (known || jumps) && by_motion.is_none();
        Some(MappedDisc {
            disc: disc.with_motion(by_motion.unwrap_or_default()),
            limb_part,
            quality: if fine { Grade::Fine } else { Grade::Coarse },
        })
    }

    /// Discs of the dated frames whose visible part of the limb is `wanted`; `ratio` is the prior of their radius, relative to the
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
            let Some(at) = self.mapping.as_ref().and_then(|mapping| mapping.at(n)) else {
                return Ok(None);
            };
            let record = self.timeline.frame(n)?;
            let limb = record.map_or(Vec::new(), |record| record.limb);
            let centre_px = [own.centre_px.x, own.centre_px.y];
            let disc = disc::on_plate(centre_px, &limb, &at, ratio.scaled(expected));
            Ok(disc.map(|disc| (n, disc)))
        });
        let found: Vec<_> = found.collect::<Result<_, JournalError>>()?;
        Ok(found.into_iter().flatten().collect())
    }
}

/// The Suns of the dated frames, and their flags.
pub(super) struct Suns {
    pub discs: Vec<Option<MappedDisc>>,
    /// Suns of frames without a disc through the flight's mapping, from the frame alone.
    own: BTreeMap<usize, Estimate<PlateMil>>,
    pub flags: Vec<FrameFlags>,
    /// The flight's radius relative to the expected one, where its discs determine it.
    pub radius_ratio: Option<Measured>,
    /// Its estimate, or the prior where it is not determined.
    pub known_ratio: Measured,
}

impl Suns {
    /// Fits whole limbs first, which determine the flight's radius, then the others.
    ///
    /// # Errors
    /// If a journal cannot be read.
    pub fn find(flight: &Flight) -> Result<Self, JournalError> {
        let is_whole = |part: f64| part >= LEAST_LIMB;
        let mut found = flight.discs(is_whole, LOOSE_RADIUS)?;
        scale_to_median_scatter(found.iter_mut().map(|(_, disc)| disc));
        let ratios = found.iter().filter_map(|(n, disc)| {
            Some(disc.radius_mil.value / flight.frames[*n].expected_radius_mil?)
        });
        let ratio = median_and_scatter(&ratios.collect::<Vec<f64>>());
        let radius_ratio = ratio.map(|(value, sigma)| Measured::new(value, sigma));
        let known = radius_ratio.unwrap_or(Measured::new(1.0, LOOSE_RADIUS.sigma / 4.0));
        let known_ratio = Measured::new(known.value, known.sigma.max(TIGHT_RADIUS));
        found.extend(flight.discs(|part| !is_whole(part), known_ratio)?);
        let count = flight.frames.len();
        let mut discs = vec![None; count];
        for (n, disc) in found {
            let own = flight.frames[n].disc;
            discs[n] = own.and_then(|own| flight.mapped(n, disc, own.limb_part));
        }
        let mut own = BTreeMap::new();
        for n in (0..count).filter(|n| discs[*n].is_none() && flight.frames[*n].disc.is_some()) {
            let disc = flight.timeline.frame(n)?.and_then(|frame| frame.disc);
            own.extend(disc.map(|disc| (n, disc.on_plate())));
        }
        Ok(Self {
            own,
            discs,
            flags: vec![FrameFlags::default(); count],
            radius_ratio,
            known_ratio,
        })
    }

    /// A frame's quality: none where a flag rejects it.
    pub fn quality(&self, frame: &Frame, n: usize) -> Grade {
        match &self.discs[n] {
            _ if self.flags[n].reject() => Grade::None,
            Some(_) if self.flags[n].contains(FrameFlag::SecondPass) => Grade::Coarse,
            Some(mapped) => mapped.quality,
            None => frame.quality,
        }
    }

    /// The Sun of a frame; none where a flag rejects it.
    pub fn sun(&self, flight: &Flight, n: usize) -> Option<Estimate<PlateMil>> {
        match &self.discs[n] {
            _ if self.flags[n].reject() => None,
            Some(mapped) => flight.sun(n, mapped),
            None => self.own.get(&n).copied(),
        }
    }

    /// The Sun of a fine frame, which may define the flight's path.
    pub fn fine(&self, flight: &Flight, n: usize) -> Option<Estimate<PlateMil>> {
        match self.quality(&flight.frames[n], n) {
            Grade::Fine => self.sun(flight, n),
            Grade::Coarse | Grade::None => None,
        }
    }

    /// Visible part of the limb, 0 to 1.
    pub fn limb_part(&self, frame: &Frame, n: usize) -> Option<f64> {
        let part = self.discs[n].map(|mapped| mapped.limb_part);
        part.or(frame.disc.map(|disc| disc.limb_part))
    }

    /// Whether the disc of a fine frame is certainly the Sun: most of the limb was seen, and its radius is not flagged.
    pub fn is_sure(&self, frame: &Frame, n: usize) -> bool {
        self.limb_part(frame, n)
            .is_some_and(|part| part >= LEAST_LIMB)
    }
}

/// Scales the discs' sigmas down. The points' sigmas are conservative: where a flight's limbs scatter less, its discs are less uncertain by
/// the same factor.
fn scale_to_median_scatter<'a>(discs: impl Iterator<Item = &'a mut PlateDisc>) {
    let discs: Vec<&mut PlateDisc> = discs.collect();
    let median_scatter = median(discs.iter().map(|disc| disc.scatter));
    let Some(median_scatter) = median_scatter.filter(|_| discs.len() >= LEAST_DISCS) else {
        return;
    };
    for disc in discs.into_iter().filter(|disc| disc.scatter < 1.0) {
        let scatter = disc.scatter.max(median_scatter).min(1.0);
        disc.centre.covariance *= scatter.powi(2);
        disc.radius_mil.sigma *= scatter;
    }
}
