//! The second pass: the flight as a whole.
//!
//! The first pass gave each frame's marks and limb. Here the mapping comes from the marks of all frames, and each frame's Sun
//! from its own limb through that mapping; what does not fit the frames about it is told, and what it spoils refused.
//! Frames that were refused or coarse get a [second look](super::look): mapping and path are known now.

use super::cameras::CameraFrames;
use super::clock_facts::ClockFacts;
use super::disc::{self, PlateDisc};
use super::first_pass::{Done, Recipe, Span};
use super::follow::Followed;
use super::inputs::InputSummary;
use super::journal::JournalError;
use super::load::{Loaded, load};
use super::look::{Known, Look};
use super::mapping::MappingFacts;
use crate::smoothing;
use super::oddity::Oddity;
use super::radius::RadiusDependence;
use super::record::{FrameRecord, Grade};
use super::row::Row;
use super::work::{LOOSE_RADIUS, TELLING_LIMB, Work};
use crate::archive::ArchiveReader;
use crate::geometry::Mapping;
use crate::units::{Measured, Place, PlateMil, SensorPx};
use rayon::prelude::*;

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
    pub clock: ClockFacts,
    /// What of the files was not used as it stands.
    pub inputs: InputSummary,
    /// What most fine frames say against the instrument, in words: they are not its camera's.
    pub contradiction: Option<String>,
    pub path: Option<smoothing::Path>,
    /// The flight's radius over the expected one.
    pub radius_ratio: Option<Measured>,
    pub radius_by_temperature: RadiusDependence,
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
    done: &Done<FrameRecord>,
    archive: &ArchiveReader,
    camera: &CameraFrames,
    recipe: &Recipe,
    span: &Span,
) -> Result<Flight, JournalError> {
    let Loaded {
        entries,
        marks,
        unread,
        inputs,
        clock,
        contradiction,
    } = load(done, camera, &recipe.instrument, span)?;
    let mut work = Work::new(done, recipe, entries, marks);
    let ratio = work.place_discs()?;
    work.look_for_oddities(|_| true);
    let mut followed = work.follow_path();
    let seen = work.look_again(archive, &followed, ratio);
    if !seen.is_empty() {
        work.look_for_oddities(|n| seen.binary_search(&n).is_ok());
        followed = work.follow_path();
    }
    for (n, row) in work.rows.iter_mut().enumerate() {
        row.speed_mil_per_s = row.time_sigma_s.and_then(|_| followed.speed(n));
    }
    let Work {
        mut rows,
        mut places,
        ..
    } = work;
    let radius_by_temperature = RadiusDependence::of(&rows[..work.dated]);
    rows.extend(unread);
    places.resize(rows.len(), None);
    Ok(Flight {
        rows,
        mapping: work.mapping.map(|mapping| mapping.facts),
        clock,
        contradiction,
        inputs,
        path: followed.path,
        radius_ratio: work.radius_ratio,
        radius_by_temperature,
        dated: work.dated,
        path_times_s: followed.times_s,
        places,
    })
}

impl Work<'_> {
    /// Looks again at the frames that did not give disc and marks by themselves, or read them wrongly; `ratio` is what is
    /// known of the radius. The rows, in order, that have another disc now.
    fn look_again(
        &mut self,
        archive: &ArchiveReader,
        path: &Followed,
        ratio: Measured,
    ) -> Vec<usize> {
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
            row.take_back_oddities();
            row.own_reason.clone_from(&row.own.reason);
            self.adopt(n, disc);
            let row = &mut self.rows[n];
            if row.own.sun_px.is_none() {
                row.quality = Grade::Coarse;
                row.own_reason.clone_from(&row.own.reason);
                row.note(Oddity::SecondLook);
            }
        }
        seen
    }

    fn look(
        &self,
        n: usize,
        archive: &ArchiveReader,
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
        let file = archive.open_file(&row.file).ok()?;
        let file = file.of_size(known.instrument.camera.size_px());
        let look = file.with_frame(|frame| known.look(frame)).ok()??;
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
