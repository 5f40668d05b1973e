//! The second pass: the flight as a whole.
//!
//! The first pass gave each frame's marks and limb. Here the mapping comes from the marks of all frames, and each frame's Sun
//! from its own limb through that mapping; what does not fit the frames about it is told, and what it spoils refused.
//! Frames that were refused or coarse for want of marks are fine where the limb is good, for the mapping is known now.

use super::disc::{self, PlateDisc};
use super::first_pass::{Done, Span};
use super::journal::JournalError;
use super::mapping::{FlightMapping, MappingFacts, Standing, median};
use super::motion::{self, Path};
use super::record::{FrameRecord, Grade, Input, Record};
use super::row::{Oddity, Row};
use crate::instrument::Instrument;
use crate::sky::sun_angular_radius;
use crate::units::{Estimate, Measured, Place};
use rayon::prelude::*;

/// The limb's part that makes a fine solution.
const LEAST_FINE_LIMB: f64 = 0.4;
/// The limb's part that tells its own radius.
const TELLING_LIMB: f64 = 0.7;
/// A mapping known less well than this makes no fine frame, 1 sigma.
const MOST_FINE_SIGMA_MIL: f64 = 1.0;
/// What is known of a radius before the flight has told it, relative.
const LOOSE_RADIUS: f64 = 0.02;
/// The flight's radius is this good at least, relative.
const TIGHT_RADIUS: f64 = 1e-4;
/// So many times the flight's usual scatter is odd.
const ODD_SIGMAS: f64 = 8.0;
/// Smaller deviations of the radius are none, relative.
const LEAST_ODD_RADIUS: f64 = 1e-3;
/// A limb that scatters so many times more than usual is odd.
const ODD_SCATTER: f64 = 2.0;
/// Light or noise that differs by more than this factor from the frames about it is odd.
const ODD_LIGHT: f64 = 1.3;
const ODD_NOISE: f64 = 1.6;
/// Frames to each side that tell what is usual.
const ABOUT: usize = 20;
/// Fewer marks than this part of those that are lit is odd.
const ODD_MARKS: f64 = 0.5;
/// Off the path, chi^2 of two.
const ODD_PATH_CHI2: f64 = 100.0;
/// Rounds in which frames off the path are taken off it.
const PATH_ROUNDS: usize = 3;

/// The flight as a whole.
pub struct Flight {
    /// In the order of time; frames without a time and files that could not be read come last, by name.
    pub rows: Vec<Row>,
    pub mapping: Option<MappingFacts>,
    pub path: Option<Path>,
    /// The flight's radius over the expected one.
    pub radius_ratio: Option<Measured>,
    /// How many rows have a time: the first ones, and those that `mapping` knows.
    pub dated: usize,
    /// Of each point of `path`, s since 1970.
    pub path_times_s: Vec<f64>,
    /// Where each row's frame was taken, as its file says.
    pub places: Vec<Option<Place>>,
}

/// Records that are read together.
const TOGETHER: usize = 4096;

/// A frame without its limb.
struct Entry {
    input: Input,
    frame: FrameRecord,
}

/// Looks at the flight as a whole.
///
/// # Errors
/// A journal that cannot be read.
pub fn second_pass(
    done: &Done,
    inputs: &[Input],
    instrument: &Instrument,
    span: &Span,
) -> Result<Flight, JournalError> {
    let (mut entries, mut unread) = (Vec::new(), Vec::new());
    for some in inputs.chunks(TOGETHER) {
        let records = some.par_iter().map(|input| {
            let mut record = done.record(input)?;
            if let Some(Ok(frame)) = record.as_mut().map(|record| &mut record.outcome) {
                frame.limb = Vec::new();
            }
            Ok(record)
        });
        let records: Vec<Option<Record>> = records.collect::<Result<_, JournalError>>()?;
        for record in records.into_iter().flatten() {
            let input = record.input;
            match record.outcome {
                Ok(frame) if !span.holds(frame.utc()) => {}
                Ok(frame) => entries.push(Entry { input, frame }),
                Err(error) => unread.push(Row::unread(input, error)),
            }
        }
    }
    entries.sort_by(|a, b| {
        let key = |e: &Entry| (e.frame.utc_ns.is_none(), e.frame.utc_ns);
        key(a)
            .cmp(&key(b))
            .then_with(|| a.input.file.cmp(&b.input.file))
    });
    let dated = entries.partition_point(|entry| entry.frame.utc_ns.is_some());
    let mut work = Work::new(done, instrument, entries, dated);
    work.place_discs()?;
    work.look_for_oddities();
    let (path, path_times_s) = work.follow_path();
    let Work {
        mut rows,
        mut places,
        mapping,
        radius_ratio,
        ..
    } = work;
    rows.extend(unread);
    places.resize(rows.len(), None);
    Ok(Flight {
        rows,
        mapping: mapping.map(|mapping| mapping.facts),
        path,
        radius_ratio,
        dated,
        path_times_s,
        places,
    })
}

struct Work<'a> {
    done: &'a Done,
    instrument: &'a Instrument,
    /// Of each row.
    inputs: Vec<Input>,
    places: Vec<Option<Place>>,
    dated: usize,
    mapping: Option<FlightMapping>,
    rows: Vec<Row>,
    radius_ratio: Option<Measured>,
}

impl<'a> Work<'a> {
    fn new(done: &'a Done, instrument: &'a Instrument, entries: Vec<Entry>, dated: usize) -> Self {
        let frames: Vec<&FrameRecord> = entries[..dated].iter().map(|e| &e.frame).collect();
        let first = frames.first().and_then(|frame| frame.utc_ns).unwrap_or(0);
        let since =
            |frame: &&FrameRecord| frame.utc_ns.map_or(0.0, |utc| (utc - first) as f64 / 1e9);
        let time_s: Vec<f64> = frames.iter().map(since).collect();
        let mapping = FlightMapping::estimate(&frames, &time_s, instrument);
        if mapping.is_none() {
            tracing::warn!("the marks tell no mapping of the flight: each frame stands by itself");
        }
        let row = |entry: &Entry| Row::of(entry.input.clone(), &entry.frame);
        let mut rows: Vec<Row> = entries.par_iter().map(row).collect();
        rows.par_iter_mut().for_each(|row| {
            let angular = row.utc().and_then(|utc| sun_angular_radius(utc).ok());
            row.expected_radius_mil = angular.map(|angular| instrument.optics.radius_mil(angular));
        });
        // What else the records hold is read again where it is needed.
        let places = entries.iter().map(|entry| entry.frame.place()).collect();
        let inputs = entries.into_iter().map(|entry| entry.input).collect();
        Self {
            done,
            instrument,
            inputs,
            places,
            dated,
            mapping,
            rows,
            radius_ratio: None,
        }
    }

    /// Each frame's disc through the flight's mapping: whole limbs first, which tell the flight's radius, then the others.
    fn place_discs(&mut self) -> Result<(), JournalError> {
        let Some(mapping) = &self.mapping else {
            return Ok(());
        };
        let whole = |row: &Row| {
            row.own
                .limb_fraction
                .is_some_and(|part| part >= TELLING_LIMB)
        };
        let found = self.discs(mapping, whole, Measured::new(1.0, LOOSE_RADIUS))?;
        let ratios = found.iter().filter_map(|(n, disc)| {
            Some(disc.radius_mil.value / self.rows[*n].expected_radius_mil?)
        });
        self.radius_ratio = middle(ratios.collect());
        let ratio = self
            .radius_ratio
            .unwrap_or(Measured::new(1.0, LOOSE_RADIUS / 4.0));
        let ratio = Measured::new(ratio.value, ratio.sigma.max(TIGHT_RADIUS));
        let partial = self.discs(mapping, |row| !whole(row), ratio)?;
        for (n, disc) in found.into_iter().chain(partial) {
            self.adopt(n, disc);
        }
        Ok(())
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
            let record = self.done.record(&self.inputs[n])?;
            let Some(Ok(frame)) = record.map(|record| record.outcome) else {
                return Ok(None);
            };
            let Some(own) = &frame.disc else {
                return Ok(None);
            };
            let radius = Measured::new(expected * ratio.value, expected * ratio.sigma);
            Ok(disc::on_plate(own, &frame.limb, &at, radius).map(|disc| (n, disc)))
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
        let limb = row
            .own
            .limb_fraction
            .is_some_and(|part| part >= LEAST_FINE_LIMB);
        row.quality = match (limb, known || row.jump_px.is_some()) {
            (true, true) => Grade::Fine,
            _ => Grade::Coarse,
        };
        if row.quality == Grade::Fine {
            row.reason.clear();
        }
    }

    /// What is odd about a frame beside the others.
    fn look_for_oddities(&mut self) {
        let Some(mapping) = &self.mapping else {
            return;
        };
        let discs = || self.rows.iter().filter_map(|row| row.disc.as_ref());
        let usual_scatter = median(discs().map(|disc| disc.scatter).collect()).unwrap_or(1.0);
        let light = self.about(|levels| levels[2] - levels[0]);
        let noise = self.about(|levels| levels[1]);
        let ratio = self.radius_ratio;
        let found: Vec<Vec<Oddity>> = (0..self.dated)
            .into_par_iter()
            .map(|n| {
                let row = &self.rows[n];
                let mut odd = Vec::new();
                if let Some(disc) = &row.disc {
                    if odd_radius(row, disc, ratio) {
                        odd.push(Oddity::Radius);
                    }
                    if disc.scatter > ODD_SCATTER * usual_scatter {
                        odd.push(Oddity::Limb);
                    }
                    if (row.own.marks as f64) < ODD_MARKS * self.lit_marks(disc) {
                        odd.push(Oddity::FewMarks);
                    }
                    if light[n].is_some_and(|l| l.max(1.0 / l) > ODD_LIGHT) {
                        odd.push(Oddity::Light);
                    }
                    if noise[n].is_some_and(|noise| noise > ODD_NOISE) {
                        odd.push(Oddity::Noise);
                    }
                }
                match mapping.standing[n] {
                    Standing::Alone => odd.push(Oddity::Knocked),
                    Standing::Misread => odd.push(Oddity::Misread),
                    Standing::Agrees | Standing::Unmarked => {}
                }
                odd
            })
            .collect();
        for (row, odd) in self.rows.iter_mut().zip(found) {
            odd.into_iter().for_each(|odd| note(row, odd));
        }
    }

    /// Something of each dated frame's levels over the median of the frames about it that have a disc.
    fn about(&self, value: impl Fn(&[f64; 3]) -> f64 + Sync) -> Vec<Option<f64>> {
        let lit: Vec<(usize, f64)> = (0..self.dated)
            .filter(|n| self.rows[*n].disc.is_some())
            .filter_map(|n| Some((n, value(self.rows[n].own.levels_dn.as_ref()?))))
            .collect();
        let mut over = vec![None; self.dated];
        for (k, (n, value)) in lit.iter().enumerate() {
            let near = &lit[k.saturating_sub(ABOUT)..lit.len().min(k + ABOUT + 1)];
            let usual = median(near.iter().map(|(_, value)| *value).collect());
            over[*n] = usual
                .filter(|usual| *usual > 0.0)
                .map(|usual| value / usual);
        }
        over
    }

    /// How many marks lie well within the disc.
    fn lit_marks(&self, disc: &PlateDisc) -> f64 {
        let plate = &self.instrument.plate;
        let reach = disc.radius_mil.value - plate.cross.arm_length_mil;
        let lit = plate
            .marks()
            .filter(|(_, at)| at.distance(disc.centre.position) < reach);
        lit.count() as f64
    }

    /// The Sun's path, without the frames that lie off it; between two frames one more point.
    fn follow_path(&mut self) -> (Option<Path>, Vec<f64>) {
        let first = self.rows.first().and_then(Row::unix_s).unwrap_or(0.0);
        let mut on_path = Vec::new();
        let mut path = None;
        let mut moments = Vec::new();
        for _ in 0..PATH_ROUNDS {
            (moments, on_path) = self.moments(first);
            path = motion::path(&moments);
            let Some(path) = &path else { break };
            let mut off = Vec::new();
            for (point, moment) in on_path.iter().zip(0..) {
                let Some(n) = *point else { continue };
                let measured = moments[moment].measured;
                let odd = measured.is_some_and(|measured| {
                    motion::pull_chi2(&path.points[moment], &measured) > ODD_PATH_CHI2
                });
                if odd {
                    off.push(n);
                }
            }
            if off.is_empty() {
                break;
            }
            off.into_iter()
                .for_each(|n| note(&mut self.rows[n], Oddity::Path));
        }
        drop(on_path);
        let times = moments.iter().map(|moment| first + moment.time_s).collect();
        (path, times)
    }

    /// Moments of the path, and the row that each is measured by.
    fn moments(&self, first: f64) -> (Vec<motion::Moment>, Vec<Option<usize>>) {
        let (mut moments, mut rows) = (Vec::new(), Vec::new());
        let mut before: Option<f64> = None;
        for (n, row) in self.rows[..self.dated].iter().enumerate() {
            let Some(time_s) = row.unix_s().map(|unix_s| unix_s - first) else {
                continue;
            };
            if let Some(before) = before.filter(|before| time_s > *before) {
                let time_s = (before + time_s) / 2.0;
                moments.push(motion::Moment {
                    time_s,
                    measured: None,
                });
                rows.push(None);
            }
            let sun = row.sun.filter(|_| row.is_fine());
            let measured = sun.map(|sun| {
                let (at, c) = (sun.position, sun.covariance);
                [(at.x, c.m11), (at.y, c.m22)]
            });
            moments.push(motion::Moment { time_s, measured });
            rows.push(measured.map(|_| n));
            before = Some(time_s);
        }
        (moments, rows)
    }
}

/// Notes an oddity; one that spoils the frame takes its place away.
fn note(row: &mut Row, odd: Oddity) {
    if row.oddities.contains(&odd) {
        return;
    }
    row.oddities.push(odd);
    let text = format!("refine: {odd}");
    row.reason = match row.reason.as_str() {
        "" => text,
        before => format!("{before}; {text}"),
    };
    if odd.spoils() {
        row.quality = Grade::None;
        row.sun = None;
    }
}

fn odd_radius(row: &Row, disc: &PlateDisc, ratio: Option<Measured>) -> bool {
    let Some((expected, ratio)) = row.expected_radius_mil.zip(ratio) else {
        return false;
    };
    let sigma = ratio.sigma.hypot(disc.radius_mil.sigma / expected);
    let away = (disc.radius_mil.value / expected - ratio.value).abs();
    away > (ODD_SIGMAS * sigma).max(LEAST_ODD_RADIUS)
}

/// The median of some values with their usual scatter.
fn middle(values: Vec<f64>) -> Option<Measured> {
    let middle = median(values.clone())?;
    let away = values.iter().map(|value| (value - middle).abs()).collect();
    Some(Measured::new(middle, 1.4826 * median(away)?))
}
