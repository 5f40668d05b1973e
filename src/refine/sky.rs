//! Converts the Sun on the plate to sky coordinates, for every row.

use super::row::{RefinedRow, SkyRow};
use crate::geometry::attitude::Direction;
use crate::instrument::Instrument;
use crate::pointing::{self, Offset, Roll, Target};
use crate::sky::{Ephemeris, SunPosition};
use crate::units::{Estimate, Place, PlateMil};
use jiff::Timestamp;

/// Inputs of the conversion other than the rows.
#[derive(Debug, Clone)]
pub struct Sky {
    pub target: Target,
    /// Used for frames that do not state their position.
    pub place: Option<Place>,
    pub ephemeris: Ephemeris,
}

impl Sky {
    /// Pointing of the telescope by a row's Sun; `None` where the Sun or the observer's position is not known.
    pub(super) fn row(
        &self,
        row: &RefinedRow,
        instrument: &Instrument,
        ephemeris: &mut Ephemeris,
    ) -> Option<SkyRow> {
        let place = row.own.as_ref().and_then(|own| own.facts.place());
        let place = place.or(self.place);
        let (sun_on_plate, utc) = (row.sun?, row.utc()?);
        let sun = ephemeris.sun(utc, place?).ok()?;
        let at = sun_on_plate.position;
        let roll = roll_by(row.body_nadir.as_ref(), at, instrument, &sun);
        let towards = pointing::pointing(at, roll, instrument, &sun).ok()?;
        let boresight = pointing::helioprojective(at, roll, instrument, &sun).ok()?;
        let at_time = row.sun_at_time();
        let offset =
            at_time.and_then(|sun_then| self.target_offset(sun_then, utc, roll, instrument, &sun));
        Some(SkyRow {
            azimuth_deg: towards.azimuth_deg.rem_euclid(360.0),
            elevation_deg: towards.elevation_deg,
            helioprojective_arcsec: [boresight.x, boresight.y],
            offset_deg: offset.map(|o| [o.azimuth_deg, o.elevation_deg, o.cross_elevation_deg]),
            sigma_deg: offset.map(|o| [o.sigma_deg, o.calibration_sigma_deg()]),
            roll_deg: roll.about_boresight_deg(instrument),
            sun_azimuth_deg: sun.azimuth_deg,
            sun_elevation_deg: sun.elevation_deg,
        })
    }

    fn target_offset(
        &self,
        sun_on_plate: Estimate<PlateMil>,
        utc: Timestamp,
        roll: Roll,
        instrument: &Instrument,
        sun: &SunPosition,
    ) -> Option<Offset> {
        let target = self.target.at(utc, sun).ok()?;
        pointing::offset(sun_on_plate, roll, instrument, sun, target).ok()
    }
}

/// The telescope's roll: from the nadir in the body's axes where that is known, else as stated.
pub(super) fn roll_by(
    body_nadir: Option<&Direction>,
    sun_on_plate: PlateMil,
    instrument: &Instrument,
    sun: &SunPosition,
) -> Roll {
    body_nadir.map_or(Roll::Stated, |nadir| {
        pointing::roll_by_nadir(nadir, sun_on_plate, instrument, sun)
    })
}
