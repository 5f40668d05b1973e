//! The table POINTING: the pointing at a constant rate.

use super::evaluate::Pointed;
use super::{LineOfSight, PointingHistory};
use crate::columns::{Column, float, logical, text};
use crate::fits::{Card, format_time, keyword, place_cards, zero_cards};
use crate::geometry::earth::geodetic;
use jiff::{Timestamp, Unit};

/// The extension with the pointing.
pub const POINTING: &str = "POINTING";

/// Length of the longest word in the table, "extrapolated".
pub const LONGEST_WORD: usize = 12;

/// The pointing at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointingRow {
    pub unix_s: f64,
    /// Time since MJDREF.
    pub time_s: f64,
    pub pointed: Pointed,
}

fn line_of_sight(row: &PointingRow, value: fn(&LineOfSight) -> f64) -> Option<f64> {
    row.pointed.line_of_sight.as_ref().map(value)
}

/// The columns of [`POINTING`].
#[rustfmt::skip]
pub const POINTING_COLUMNS: &[Column<PointingRow>] = &[
    float("TIME", "s", "time, UTC, since MJDREF", |r| Some(r.time_s)),
    float("UNIX_S", "s", "time, UTC, since 1970-01-01", |r| Some(r.unix_s)),
    float("HPLN", "arcsec", "helioprojective longitude of the boresight, to solar west", |r| line_of_sight(r, |s| s.helioprojective_arcsec.x)),
    float("HPLT", "arcsec", "helioprojective latitude of the boresight, to solar north", |r| line_of_sight(r, |s| s.helioprojective_arcsec.y)),
    float("NORTH_ANGLE", "deg", "from the telescope's up to solar north, counter-clockwise as seen looking out", |r| line_of_sight(r, |s| s.north_angle_deg)),
    float("AZIMUTH", "deg", "azimuth of the boresight, from north through east", |r| line_of_sight(r, |s| s.horizontal.azimuth_deg)),
    float("ELEVATION", "deg", "elevation of the boresight, without refraction", |r| line_of_sight(r, |s| s.horizontal.elevation_deg)),
    float("ROLL", "deg", "roll about the boresight, right side low positive", |r| line_of_sight(r, |s| s.roll_deg)),
    float("VAR_RIGHT", "arcsec2", "variance of the boresight to the telescope's right, random part", |r| line_of_sight(r, |s| s.random_arcsec2.m11)),
    float("VAR_UP", "arcsec2", "variance up, random part", |r| line_of_sight(r, |s| s.random_arcsec2.m22)),
    float("VAR_ROLL", "arcsec2", "variance of the turn about the boresight, random part", |r| line_of_sight(r, |s| s.random_arcsec2.m33)),
    float("COV_RIGHT_UP", "arcsec2", "covariance, random part", |r| line_of_sight(r, |s| s.random_arcsec2.m12)),
    float("COV_RIGHT_ROLL", "arcsec2", "covariance, random part", |r| line_of_sight(r, |s| s.random_arcsec2.m13)),
    float("COV_UP_ROLL", "arcsec2", "covariance, random part", |r| line_of_sight(r, |s| s.random_arcsec2.m23)),
    float("SYS_VAR_RIGHT", "arcsec2", "variance to the right, of the calibration", |r| line_of_sight(r, |s| s.systematic_arcsec2.m11)),
    float("SYS_VAR_UP", "arcsec2", "variance up, of the calibration", |r| line_of_sight(r, |s| s.systematic_arcsec2.m22)),
    float("SYS_VAR_ROLL", "arcsec2", "variance of the turn about the boresight, of the calibration", |r| line_of_sight(r, |s| s.systematic_arcsec2.m33)),
    float("SYS_COV_RIGHT_UP", "arcsec2", "covariance, of the calibration", |r| line_of_sight(r, |s| s.systematic_arcsec2.m12)),
    float("SYS_COV_RIGHT_ROLL", "arcsec2", "covariance, of the calibration", |r| line_of_sight(r, |s| s.systematic_arcsec2.m13)),
    float("SYS_COV_UP_ROLL", "arcsec2", "covariance, of the calibration", |r| line_of_sight(r, |s| s.systematic_arcsec2.m23)),
    logical("VALID", "whether the pointing may be used", |r| r.pointed.is_valid()),
    text("INVALID", "why not: gap, extrapolated, contradicted, slew or uncertain", |r| r.pointed.invalid.map_or("", |why| why.name()).into()),
    text("SOURCE", "what it rests on: sun, gyros or both", |r| r.pointed.line_of_sight.map_or("", |line_of_sight| line_of_sight.basis.name()).into()),
];

impl PointingHistory {
    /// Midnight before the first state: the origin of the table's times.
    pub fn reference(&self) -> Option<Timestamp> {
        const DAY_S: i64 = 86_400;
        let first_s = self.ends_s()?[0].floor() as i64;
        Timestamp::from_second(first_s - first_s.rem_euclid(DAY_S)).ok()
    }

    /// The pointing at the multiples of 1 / `rate_hz`, s since 1970, from the first state to the last.
    pub fn rows(&self, rate_hz: f64) -> impl Iterator<Item = PointingRow> {
        let [first, last] = self.ends_s().unwrap_or([0.0, -1.0]);
        let (first, last) = ((first * rate_hz).ceil(), (last * rate_hz).floor());
        let zero_s = self.reference().map_or(0, Timestamp::as_second) as f64;
        let count = (last - first + 1.0).max(0.0) as u64;
        (0..count).map(move |n| {
            let unix_s = (first + n as f64) / rate_hz;
            PointingRow {
                unix_s,
                time_s: unix_s - zero_s,
                pointed: self.at(unix_s),
            }
        })
    }
}

/// Header cards of the table: its times, and the telescope's position in their middle.
pub fn pointing_cards(history: &PointingHistory) -> Vec<Card> {
    let (Some(zero), Some(ends_s)) = (history.reference(), history.ends_s()) else {
        return Vec::new();
    };
    let utc = |unix_s: f64| Timestamp::from_nanosecond((unix_s * 1e9) as i128).ok();
    let [from, to] =
        ends_s.map(|time_s| utc(time_s).and_then(|utc| utc.round(Unit::Microsecond).ok()));
    let zero_s = zero.as_second() as f64;
    let mut cards = zero_cards(zero);
    cards.extend([
        Card::new(&keyword::TSTART, ends_s[0] - zero_s),
        Card::new(&keyword::TSTOP, ends_s[1] - zero_s),
    ]);
    for (keyword, time) in [(&keyword::DATE_BEG, from), (&keyword::DATE_END, to)] {
        cards.extend(time.map(|time| Card::new(keyword, format_time(time))));
    }
    let middle_m = history.position_m((ends_s[0] + ends_s[1]) / 2.0);
    let place = middle_m.and_then(|middle_m| geodetic(&middle_m));
    cards.extend(place.into_iter().flat_map(place_cards));
    cards
}
