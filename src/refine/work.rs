//! Each frame's disc through the flight's mapping: the second pass's first step.

use super::disc::{self, PlateDisc};
use super::drift::MarkObservation;
use super::first_pass::{Done, Recipe};
use super::journal::JournalError;
use super::load::Entry;
use super::mapping::FlightMapping;
use super::record::{FrameRecord, Grade};
use super::row::Row;
use crate::estimation::{median, median_and_scatter};
use crate::units::{Estimate, Measured, Place};
use rayon::prelude::*;

/// The limb's part that makes a fine solution.
const LEAST_FINE_LIMB: f64 = 0.4;
/// The limb's part that tells its own radius.
pub(super) const TELLING_LIMB: f64 = 0.7;
/// A mapping known less well than this makes no fine frame, 1 sigma.
const MOST_FINE_SIGMA_MIL: f64 = 1.0;
/// What is known of a radius before the flight has told it, over the expected one.
pub(super) const LOOSE_RADIUS: Measured = Measured::new(1.0, 0.02);
/// The flight's radius is this good at least, relative.
const TIGHT_RADIUS: f64 = 1e-4;

/// Fewer discs tell no usual scatter.
const LEAST_DISCS: usize = 10;
/// What the points of a limb do not show of their errors, since they share it, beside what they show: the same pixels and scratches. Seen
/// were 0.065 in 48 rests of 50 frames, simulated with hot pixels, scratches and leaks; some of them have much more.
const SHARED_LIMB: f64 = 0.1;

/// The flight as far as the second pass has got.
pub(super) struct Work<'a> {
    done: &'a Done<FrameRecord>,
    pub recipe: &'a Recipe,
    /// Of each row.
    keys: Vec<u64>,
    pub places: Vec<Option<Place>>,
    pub dated: usize,
    pub mapping: Option<FlightMapping>,
    pub rows: Vec<Row>,
    pub radius_ratio: Option<Measured>,
}

impl<'a> Work<'a> {
    pub(super) fn new(
        done: &'a Done<FrameRecord>,
        recipe: &'a Recipe,
        entries: Vec<Entry>,
        marks: Vec<MarkObservation>,
    ) -> Self {
        let dated = entries.partition_point(|entry| entry.row.utc_ns.is_some());
        let mapping = FlightMapping::estimate(&entries[..dated], marks, &recipe.instrument);
        if mapping.is_none() {
            tracing::warn!("the marks tell no mapping of the flight: each frame stands by itself");
        }
        let mut work = Self {
            done,
            recipe,
            keys: Vec::with_capacity(entries.len()),
            places: Vec::with_capacity(entries.len()),
            dated,
            mapping,
            rows: Vec::with_capacity(entries.len()),
            radius_ratio: None,
        };
        for entry in entries {
            work.keys.push(entry.key);
            work.places.push(entry.place);
            work.rows.push(entry.row);
        }
        work
    }

    /// Each frame's disc through the flight's mapping: whole limbs first, which tell the flight's radius, then the others. What
    /// is known of the radius then, over the expected one.
    pub(super) fn place_discs(&mut self) -> Result<Measured, JournalError> {
        let Some(mapping) = &self.mapping else {
            return Ok(LOOSE_RADIUS);
        };
        let whole = |row: &Row| row.limb_part.is_some_and(|part| part >= TELLING_LIMB);
        let mut found = self.discs(mapping, whole, LOOSE_RADIUS)?;
        hold_to_usual_scatter(found.iter_mut().map(|(_, disc)| disc));
        let ratios = found.iter().filter_map(|(n, disc)| {
            Some(disc.radius_mil.value / self.rows[*n].expected_radius_mil?)
        });
        let ratios: Vec<f64> = ratios.collect();
        let ratio = median_and_scatter(&ratios);
        self.radius_ratio = ratio.map(|(value, sigma)| Measured::new(value, sigma));
        let ratio = self
            .radius_ratio
            .unwrap_or(Measured::new(1.0, LOOSE_RADIUS.sigma / 4.0));
        let ratio = Measured::new(ratio.value, ratio.sigma.max(TIGHT_RADIUS));
        let partial = self.discs(mapping, |row| !whole(row), ratio)?;
        for (n, disc) in found.into_iter().chain(partial) {
            self.adopt(n, disc);
        }
        Ok(ratio)
    }

    /// The discs of some of the dated frames.
    fn discs(
        &self,
        mapping: &FlightMapping,
        wanted: impl Fn(&Row) -> bool + Sync,
        ratio: Measured,
    ) -> Result<Vec<(usize, PlateDisc)>, JournalError> {
        let found = (0..self.dated).into_par_iter().map(|n| {
            let row = &self.rows[n];
            let Some((expected, at)) = row.expected_radius_mil.zip(mapping.at(n)) else {
                return Ok(None);
            };
            if row.own.sun_px.is_none() || !wanted(row) {
                return Ok(None);
            }
            let record = self.done.record_of(self.keys[n])?;
            let Some(Ok(frame)) = record.map(|record| record.outcome) else {
                return Ok(None);
            };
            let Some(own) = &frame.disc else {
                return Ok(None);
            };
            let radius = Measured::new(expected * ratio.value, expected * ratio.sigma);
            let disc = disc::on_plate(own.centre_px, &frame.limb, &at, radius);
            Ok(disc.map(|disc| (n, disc)))
        });
        let found: Vec<_> = found.collect::<Result<_, JournalError>>()?;
        Ok(found.into_iter().flatten().collect())
    }

    /// Puts a disc into its row; its quality is that of limb and mapping.
    pub(super) fn adopt(&mut self, n: usize, disc: PlateDisc) {
        let Some((mapping, at)) = self.mapping.as_ref().and_then(|m| Some((m, m.at(n)?))) else {
            return;
        };
        let by_mapping = mapping.covariance_mil2(n, disc.centre.position, &at);
        let row = &mut self.rows[n];
        row.mapping = mapping.numbers(n);
        row.jump_px = mapping.own_jump(n);
        row.sun = Some(Estimate {
            position: disc.centre.position,
            covariance: disc.centre.covariance * (1.0 + SHARED_LIMB) + by_mapping,
        });
        row.disc = Some(disc);
        let known = by_mapping.trace() < 2.0 * MOST_FINE_SIGMA_MIL.powi(2);
        let limb = row.limb_part.is_some_and(|part| part >= LEAST_FINE_LIMB);
        row.quality = match (limb, known || row.jump_px.is_some()) {
            (true, true) => Grade::Fine,
            _ => Grade::Coarse,
        };
        if row.quality == Grade::Fine {
            row.own_reason.clear();
        }
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
