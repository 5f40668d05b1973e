//! Images of photons: the number from each pixel of the sky, the exposure of each pixel, and, separately, the invalid photons.

mod grid;
mod live_time;

pub use grid::{Field, Grid};

use super::detectors::Detectors;
use super::good_times::Good;
use super::photons::{Photon, PhotonRow};
use crate::archive::observer_cards;
use crate::fits::{
    Card, Image, Problem, Samples, encode_images, format_time, keyword, place_cards,
};
use crate::geometry::earth::geodetic;
use crate::pointing_history::PointingHistory;
use crate::sky::Ephemeris;
use jiff::{Timestamp, Unit};
use live_time::{Corners, LiveTime};
use std::fmt;
use std::path::PathBuf;

/// Settings of the image.
#[derive(Debug, Clone, PartialEq)]
pub struct ImageRequest {
    /// FITS file; an existing one is replaced.
    pub path: PathBuf,
    pub pixel_arcsec: f64,
    pub field: Field,
    /// Energies of the photons that count; all without it.
    pub energies: Option<Energies>,
}

/// A range of energies.
#[derive(Debug, Clone, PartialEq)]
pub struct Energies {
    /// The column of the photons' table with an energy or a channel.
    pub column: String,
    /// Lowest and highest value, both included.
    pub range: [f64; 2],
}

impl fmt::Display for Energies {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [low, high] = self.range;
        write!(f, "photons with {} from {low} to {high}", self.column)
    }
}

/// Content of an image.
#[derive(Debug, Clone, PartialEq)]
pub struct Imaged {
    pub width_px: usize,
    pub height_px: usize,
    /// Photons in the image.
    pub photons: u64,
    /// Invalid photons in the image.
    pub invalid: u64,
    /// Photons elsewhere in the sky.
    pub outside: u64,
    /// Photons whose position is not known.
    pub unplaced: u64,
    /// Photons of other energies, at any position.
    pub other_energies: u64,
    /// The live time with a valid pointing, mean of the detectors, s.
    pub live_s: f64,
}

/// Contribution of each detector.
struct ImagedDetector<'a> {
    /// Ranges of the measured x and y.
    field: [[f64; 2]; 2],
    corners: Corners,
    /// Times at which it counts with a valid pointing; `None` if the list has no good times.
    good: Option<&'a Good>,
}

impl ImagedDetector<'_> {
    /// Whether a photon was measured within the field and times of the exposure.
    fn contains(&self, row: &PhotonRow, photon: &Photon) -> bool {
        let within = |(at, [low, high]): (&f64, &[f64; 2])| (*low..=*high).contains(at);
        let is_good = |good: &Good| photon.unix_s.is_some_and(|at| good.holds(at));
        row.position.iter().zip(&self.field).all(within) && self.good.is_none_or(is_good)
    }
}

/// An image under construction.
pub struct Picture<'a> {
    request: &'a ImageRequest,
    grid: Grid,
    detectors: Vec<ImagedDetector<'a>>,
    counts: Vec<i32>,
    invalid: Vec<i32>,
    imaged: Imaged,
}

impl<'a> Picture<'a> {
    /// An image without photons; `fields` are those of the detectors, `good` their good times, if the list has them.
    ///
    /// # Errors
    /// If good times cannot be assigned to a detector.
    pub fn new(
        request: &'a ImageRequest,
        grid: Grid,
        detectors: &Detectors,
        fields: &[[[f64; 2]; 2]],
        good: &'a [Good],
    ) -> Result<Self, Problem> {
        let imaged = detectors.iter().zip(fields).map(|(detector, [x, y])| {
            let corners = [[x[0], y[0]], [x[1], y[0]], [x[1], y[1]], [x[0], y[1]]];
            Ok(ImagedDetector {
                field: [*x, *y],
                corners: corners.map(|corner| detector.locate(corner.into())),
                good: detector.good_times(good)?,
            })
        });
        Ok(Self {
            request,
            grid,
            detectors: imaged.collect::<Result<_, Problem>>()?,
            counts: vec![0; grid.pixels()],
            invalid: vec![0; grid.pixels()],
            imaged: Imaged {
                width_px: grid.width_px,
                height_px: grid.height_px,
                photons: 0,
                invalid: 0,
                outside: 0,
                unplaced: 0,
                other_energies: 0,
                live_s: 0.0,
            },
        })
    }

    /// Counts a photon measured by a detector, given by its index in DET.toml.
    pub fn count(&mut self, row: &PhotonRow, photon: &Photon, detector: usize) {
        let is_wanted = |energies: &Energies| {
            let [low, high] = energies.range;
            row.energy
                .is_some_and(|energy| (low..=high).contains(&energy))
        };
        if !self.request.energies.as_ref().is_none_or(is_wanted) {
            self.imaged.other_energies += 1;
            return;
        }
        let Some(place) = photon.place else {
            self.imaged.unplaced += 1;
            return;
        };
        let towards = place.helioprojective_arcsec.direction();
        let pixel = self
            .grid
            .place_px(&towards)
            .and_then(|at| self.grid.pixel(at));
        let Some(pixel) = pixel else {
            self.imaged.outside += 1;
            return;
        };
        let is_usable = photon.invalid.is_none() && self.detectors[detector].contains(row, photon);
        if is_usable {
            self.counts[pixel] += 1;
            self.imaged.photons += 1;
        } else {
            self.invalid[pixel] += 1;
            self.imaged.invalid += 1;
        }
    }

    pub fn request(&self) -> &'a ImageRequest {
        self.request
    }

    /// The bytes of the file, and a summary of the image. `otherwise` are the good times of detectors whose list has none; `cards` and
    /// `lines` of HISTORY are added to each header.
    ///
    /// # Errors
    /// If no detector counted at any time with a valid pointing.
    pub fn finish(
        self,
        history: &PointingHistory,
        otherwise: Option<&Good>,
        mut cards: Vec<Card>,
        lines: &[String],
    ) -> Result<(Vec<u8>, Imaged), Problem> {
        let mut live_time = LiveTime::new(&self.grid);
        let mut live_s = 0.0;
        for ImagedDetector { corners, good, .. } in &self.detectors {
            let Some(good) = good.or(otherwise) else {
                continue;
            };
            for interval in &good.intervals_s {
                live_time.add(history, corners, *interval, good.live_fraction);
            }
            live_s += good.live_s() / self.detectors.len() as f64;
        }
        let detectors = self.detectors.iter();
        let all = detectors.filter_map(|one| one.good.or(otherwise));
        cards.extend(observation_cards(history, all, live_s)?);
        cards.extend(self.grid.coordinates().cards());
        let image = |name, unit, meaning: &str, samples| {
            let own = [(&keyword::BUNIT, unit), (&keyword::BTYPE, meaning)];
            let own = own.map(|(keyword, text)| Card::new(keyword, text));
            Image {
                name,
                width_px: self.grid.width_px,
                samples,
                cards: [own.as_slice(), &cards].concat(),
            }
        };
        let images = [
            image("COUNTS", "ct", "photons", Samples::Whole(self.counts)),
            image(
                "EXPOSURE",
                "s",
                "live time, of all detectors together",
                Samples::Real(live_time.finish()),
            ),
            image(
                "INVALID",
                "ct",
                "photons that are not to be used",
                Samples::Whole(self.invalid),
            ),
        ];
        let bytes = encode_images(&images, lines)?;
        Ok((
            bytes,
            Imaged {
                live_s,
                ..self.imaged
            },
        ))
    }
}

/// Cards on the times of the observation, its length, and the observer's position in its middle.
fn observation_cards<'a>(
    history: &PointingHistory,
    good: impl Iterator<Item = &'a Good>,
    live_s: f64,
) -> Result<Vec<Card>, Problem> {
    let mut intervals: Vec<[f64; 2]> = good.flat_map(|good| &good.intervals_s).copied().collect();
    intervals.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let ends = intervals.first().zip(intervals.last());
    let Some((first, last)) = ends.filter(|_| live_s > 0.0) else {
        let expected = "a time for which a detector counted with a valid pointing";
        return Err(Problem::field("good time intervals", expected, "none"));
    };
    let middle_s = middle_s(&intervals);
    let utc = |unix_s: f64| {
        let utc = Timestamp::from_nanosecond((unix_s * 1e9) as i128).ok()?;
        // sunpy rounds a map's time to milliseconds: with more digits it would take the map's own observer for another one.
        utc.round(Unit::Millisecond).ok()
    };
    let mut cards = vec![
        Card::new(&keyword::TIMESYS, "UTC"),
        Card::new(&keyword::XPOSURE, live_s),
    ];
    for (keyword, unix_s) in [
        (&keyword::DATE_OBS, first[0]),
        (&keyword::DATE_BEG, first[0]),
        (&keyword::DATE_AVG, middle_s),
        (&keyword::DATE_END, last[1]),
    ] {
        cards.extend(utc(unix_s).map(|utc| Card::new(keyword, format_time(utc))));
    }
    let place = history.position_m(middle_s).and_then(|at| geodetic(&at));
    if let Some((place, utc)) = place.zip(utc(middle_s)) {
        cards.extend(place_cards(place));
        let sun = Ephemeris::default().sun(utc, place);
        cards.extend(sun.iter().flat_map(|sun| observer_cards(sun, place)));
    }
    Ok(cards)
}

/// Middle of the observed time: equal times were observed before and after it.
fn middle_s(intervals: &[[f64; 2]]) -> f64 {
    let all_s: f64 = intervals.iter().map(|[start, stop]| stop - start).sum();
    let mut before_s = all_s / 2.0;
    for [start, stop] in intervals {
        if before_s <= stop - start {
            return start + before_s;
        }
        before_s -= stop - start;
    }
    intervals.last().map_or(0.0, |[_, stop]| *stop)
}
