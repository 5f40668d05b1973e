//! The second pass: the flight as a whole.
//!
//! The first pass gave each frame's marks and limb. Here the mapping comes from the marks of all frames, and each frame's Sun
//! from its own limb through that mapping; what does not fit the frames about it is told, and what it spoils refused.
//! Frames that were refused or coarse get a [second look](super::look): mapping and path are known now.

use super::disc::{self, PlateDisc};
use super::drift::MarkObservation;
use super::first_pass::{Done, Recipe, Span};
use super::follow::Followed;
use super::journal::JournalError;
use super::load::{Entry, load};
use super::look::{Known, Look};
use super::mapping::{FlightMapping, MappingFacts};
use super::motion;
use super::oddities::note;
use super::record::{Grade, Input};
use super::row::{Oddity, Row};
use crate::estimation::median_and_scatter;
use crate::fits::read_frame;
use crate::geometry::Mapping;
use crate::units::{Estimate, Measured, Place, PlateMil, SensorPx};
use rayon::prelude::*;
use std::path::Path;

/// The limb's part that makes a fine solution.
const LEAST_FINE_LIMB: f64 = 0.4;
/// The limb's part that tells its own radius.
const TELLING_LIMB: f64 = 0.7;
/// A mapping known less well than this makes no fine frame, 1 sigma.
const MOST_FINE_SIGMA_MIL: f64 = 1.0;
/// What is known of a radius before the flight has told it, over the expected one.
const LOOSE_RADIUS: Measured = Measured::new(1.0, 0.02);
/// The flight's radius is this good at least, relative.
const TIGHT_RADIUS: f64 = 1e-4;
/// Where a disc is known worse than this, 1 sigma, a second look is of no use.
const MOST_LOOK_SIGMA_MIL: f64 = 200.0;
/// How far a frame's own disc may be from the one of the second look, 1 sigma.
const OWN_DISC_SIGMA_MIL: f64 = 5.0;
/// A frame's own disc is another thing if it is so many sigma off the path.
const OTHER_THING_SIGMAS: f64 = 8.0;

/// The flight as a whole.
pub struct Flight {
    /// In the order of time; frames without a time and files that could not be read come last, by name.
    pub rows: Vec<Row>,
    pub mapping: Option<MappingFacts>,
    pub path: Option<motion::Path>,
    /// The flight's radius over the expected one.
    pub radius_ratio: Option<Measured>,
    /// How many rows have a time: the first ones, and those that `mapping` knows.
    pub dated: usize,
    /// Of each point of `path`, s since 1970.
    pub path_times_s: Vec<f64>,
    /// Where each row's frame was taken, as its file says.
    pub places: Vec<Option<Place>>,
}

/// Looks at the flight as a whole, and a second time at some frames of the archive.
///
/// # Errors
/// A journal that cannot be read.
pub fn second_pass(
    done: &Done,
    archive: &Path,
    inputs: &[Input],
    recipe: &Recipe,
    span: &Span,
) -> Result<Flight, JournalError> {
    let loaded = load(done, inputs, &recipe.instrument, span)?;
    let unread = loaded.unread;
    let mut work = Work::new(done, recipe, loaded.entries, loaded.marks);
    let ratio = work.place_discs()?;
    work.look_for_oddities(|_| true);
    let mut followed = work.follow_path();
    let seen = work.look_again(archive, &followed, ratio);
    if !seen.is_empty() {
        work.look_for_oddities(|n| seen.binary_search(&n).is_ok());
        followed = work.follow_path();
    }
    let Work {
        mut rows,
        mut places,
        ..
    } = work;
    rows.extend(unread);
    places.resize(rows.len(), None);
    Ok(Flight {
        rows,
        mapping: work.mapping.map(|mapping| mapping.facts),
        path: followed.path,
        radius_ratio: work.radius_ratio,
        dated: work.dated,
        path_times_s: followed.times_s,
        places,
    })
}

/// The second pass in the making.
pub(super) struct Work<'a> {
    done: &'a Done,
    pub recipe: &'a Recipe,
    /// Of each row.
    keys: Vec<u64>,
    places: Vec<Option<Place>>,
    pub dated: usize,
    pub mapping: Option<FlightMapping>,
    pub rows: Vec<Row>,
    pub radius_ratio: Option<Measured>,
}

impl<'a> Work<'a> {
    fn new(
        done: &'a Done,
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
    fn place_discs(&mut self) -> Result<Measured, JournalError> {
        let Some(mapping) = &self.mapping else {
            return Ok(LOOSE_RADIUS);
        };
        let whole = |row: &Row| row.limb_part.is_some_and(|part| part >= TELLING_LIMB);
        let found = self.discs(mapping, whole, LOOSE_RADIUS)?;
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
    fn adopt(&mut self, n: usize, disc: PlateDisc) {
        let Some((mapping, at)) = self.mapping.as_ref().and_then(|m| Some((m, m.at(n)?))) else {
            return;
        };
        let by_mapping = mapping.covariance_mil2(n, disc.centre.position, &at);
        let row = &mut self.rows[n];
        row.mapping = mapping.numbers(n);
        row.jump_px = mapping.own_jump(n);
        row.sun = Some(Estimate {
            position: disc.centre.position,
            covariance: disc.centre.covariance + by_mapping,
        });
        row.disc = Some(disc);
        let known = by_mapping.trace() < 2.0 * MOST_FINE_SIGMA_MIL.powi(2);
        let limb = row.limb_part.is_some_and(|part| part >= LEAST_FINE_LIMB);
        row.quality = match (limb, known || row.jump_px.is_some()) {
            (true, true) => Grade::Fine,
            _ => Grade::Coarse,
        };
        if row.quality == Grade::Fine {
            row.reason.clear();
        }
    }

    /// Looks again at the frames that did not give disc and marks by themselves, or read them wrongly; `ratio` is what is
    /// known of the radius. The rows, in order, that have another disc now.
    fn look_again(&mut self, archive: &Path, path: &Followed, ratio: Measured) -> Vec<usize> {
        let found: Vec<(usize, Look, PlateDisc)> = (0..self.dated)
            .into_par_iter()
            .filter_map(|n| {
                let (look, disc) = self.look(n, archive, path, ratio)?;
                Some((n, look, disc))
            })
            .collect();
        let seen = found.iter().map(|(n, ..)| *n).collect();
        for (n, look, disc) in found {
            let row = &mut self.rows[n];
            row.limb_part = Some(look.limb_part);
            row.oddities.clear();
            row.reason.clone_from(&row.own.reason);
            self.adopt(n, disc);
            let row = &mut self.rows[n];
            if row.own.sun_px.is_none() {
                row.quality = Grade::Coarse;
                row.reason.clone_from(&row.own.reason);
                note(row, Oddity::SecondLook);
            }
        }
        seen
    }

    fn look(
        &self,
        n: usize,
        archive: &Path,
        path: &Followed,
        ratio: Measured,
    ) -> Option<(Look, PlateDisc)> {
        let row = &self.rows[n];
        if row.own.quality == Grade::Fine && !row.oddities.contains(&Oddity::Misread) {
            return None;
        }
        let mapping = self.mapping.as_ref()?.at(n)?;
        let (centre, sigma_mil) = self.whereabouts(n, path, &mapping)?;
        let expected = row.expected_radius_mil?;
        let known = Known {
            instrument: &self.recipe.instrument,
            settings: &self.recipe.settings,
            mapping,
            centre,
            sigma_mil,
            radius_mil: expected * ratio.value,
        };
        let look = known.look(&read_frame(&archive.join(&row.file)).ok()?)?;
        // A limb of which little is seen does not tell its radius.
        let sigma = match look.limb_part >= TELLING_LIMB {
            true => LOOSE_RADIUS.sigma,
            false => ratio.sigma,
        };
        let radius = Measured::new(known.radius_mil, expected * sigma);
        let disc = disc::on_plate(look.centre_px, &look.limb, &mapping, radius)?;
        let sigma = sigma_mil.hypot(disc.centre.covariance.trace().sqrt());
        let near = centre.distance(disc.centre.position) < OTHER_THING_SIGMAS * sigma;
        near.then_some((look, disc))
    }

    /// Where a frame's disc must be, and 1 sigma, mil: where the frame itself has it, unless the path says that this is another
    /// thing.
    fn whereabouts(&self, n: usize, path: &Followed, at: &Mapping) -> Option<(PlateMil, f64)> {
        let by_path = path.place(n);
        let by_path = by_path.filter(|(_, sigma)| *sigma < MOST_LOOK_SIGMA_MIL);
        let Some([x, y]) = self.rows[n].own.sun_px else {
            return by_path;
        };
        let own = at.to_plate(SensorPx::new(x, y));
        let other = by_path.filter(|(place, sigma)| {
            place.distance(own) > OTHER_THING_SIGMAS * sigma.hypot(OWN_DISC_SIGMA_MIL)
        });
        // The same disc again would be as odd.
        let spoiled = self.rows[n].oddities.iter().any(|odd| odd.spoils());
        other.or((!spoiled).then_some((own, OWN_DISC_SIGMA_MIL)))
    }
}
