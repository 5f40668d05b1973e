//! From the Sun on the plate to the sky, for every row.

use super::row::{Row, SkyRow};
use crate::instrument::Instrument;
use crate::pointing::{self, Roll, Target};
use crate::sky::Ephemeris;
use crate::units::Place;
use rayon::prelude::*;

/// What the sky takes beside the rows.
#[derive(Debug, Clone)]
pub struct Sky {
    pub target: Target,
    /// For frames that do not say where they were taken.
    pub place: Option<Place>,
    pub ephemeris: Ephemeris,
}

/// Rows that share an ephemeris, whose costly part is done once a second.
const TOGETHER: usize = 256;

impl Sky {
    /// Fills in where the telescope pointed; `places` tells where each row's frame was taken, if it does.
    pub fn fill(&self, instrument: &Instrument, rows: &mut [Row], places: &[Option<Place>]) {
        let chunks = rows.par_chunks_mut(TOGETHER);
        chunks
            .zip(places.par_chunks(TOGETHER))
            .for_each(|(rows, places)| {
                let mut ephemeris = self.ephemeris.clone();
                for (row, place) in rows.iter_mut().zip(places) {
                    row.sky = self.row(row, instrument, place.or(self.place), &mut ephemeris);
                }
            });
    }

    fn row(
        &self,
        row: &Row,
        instrument: &Instrument,
        place: Option<Place>,
        ephemeris: &mut Ephemeris,
    ) -> Option<SkyRow> {
        let (sun_on_plate, utc) = (row.sun?, row.utc()?);
        let sun = ephemeris.sun(utc, place?).ok()?;
        let at = sun_on_plate.position;
        let roll = match &row.body_nadir {
            Some(nadir) => pointing::roll_by_nadir(nadir, at, instrument, &sun),
            None => Roll::Stated,
        };
        let towards = pointing::pointing(at, roll, instrument, &sun).ok()?;
        let boresight = pointing::helioprojective(at, roll, instrument, &sun).ok()?;
        let target = self.target.at(utc, &sun).ok();
        let offset = target
            .and_then(|target| pointing::offset(sun_on_plate, roll, instrument, &sun, target).ok());
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
}
