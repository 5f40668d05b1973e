//! World coordinates of a frame's pixels on the sky (Thompson 2006), and keywords of the observer.
//!
//! The transformation between plate and sky is not defined here: [`pointing`](crate::pointing) maps a place on the Sun to the plate,
//! and also gives the offsets. Steps of a solar radius in all four directions determine the matrix. So
//! coordinates and offsets are consistent: the pixel on which the boresight falls has the coordinates at which the
//! telescope points.

use crate::aspect::{Aspect, Solution};
use crate::fits::{Card, keyword};
use crate::frame::FrameInfo;
use crate::geometry::Mapping;
use crate::instrument::Instrument;
use crate::log::Seldom;
use crate::pointing::{self, HelioprojectiveArcsec, PointingError, Roll, Target};
use crate::sky::{AU_KM, Disc, Ephemeris, SUN_RADIUS_KM, SunPosition};
use crate::units::{EARTH_RADIUS_M, Place, SensorPx};
use nalgebra::Matrix2;

const AU_M: f64 = AU_KM * 1e3;

/// The helioprojective coordinates of a frame's pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Helioprojection {
    /// Position of the Sun's centre in the picture: the origin.
    pub centre_px: SensorPx,
    /// First row: to solar west; second: to solar north. First column: a step along x; second: along y.
    pub arcsec_per_px: Matrix2<f64>,
}

impl Helioprojection {
    /// The coordinates of a frame that has a Sun. `None` if the mapping has no inverse there.
    ///
    /// # Errors
    /// [`PointingError::NoBoresight`] if no pointing near the zenith puts the Sun at its observed position.
    pub fn new(
        aspect: &Aspect,
        mapping: &Mapping,
        roll: Roll,
        instrument: &Instrument,
        sun: &SunPosition,
    ) -> Result<Option<Self>, PointingError> {
        let step = Disc::from(sun).radius_arcsec();
        let sun_plate = aspect.sun_plate.position;
        let seen = |x, y| {
            let place = HelioprojectiveArcsec { x, y };
            let at = pointing::place_on_plate(place, sun_plate, roll, instrument, sun)?;
            Ok(mapping.to_sensor(at).vector())
        };
        let px_per_arcsec = Matrix2::from_columns(&[
            (seen(step, 0.0)? - seen(-step, 0.0)?) / (2.0 * step),
            (seen(0.0, step)? - seen(0.0, -step)?) / (2.0 * step),
        ]);
        Ok(px_per_arcsec.try_inverse().map(|arcsec_per_px| Self {
            centre_px: aspect.sun_px.position,
            arcsec_per_px,
        }))
    }

    /// Side of a square with the area of a pixel.
    pub fn scale_arcsec_per_px(&self) -> f64 {
        self.arcsec_per_px.determinant().abs().sqrt()
    }

    /// The keywords of the coordinates.
    pub fn cards(&self) -> Vec<Card> {
        let scale = self.scale_arcsec_per_px();
        let turn = self.arcsec_per_px / scale;
        vec![
            Card::new(&keyword::WCSAXES, 2),
            Card::new(&keyword::WCSNAME, "Helioprojective-cartesian"),
            Card::new(&keyword::CTYPE1, "HPLN-TAN"),
            Card::new(&keyword::CTYPE2, "HPLT-TAN"),
            Card::new(&keyword::CNAME1, "helioprojective longitude"),
            Card::new(&keyword::CNAME2, "helioprojective latitude"),
            Card::new(&keyword::CUNIT1, "arcsec"),
            Card::new(&keyword::CUNIT2, "arcsec"),
            // FITS counts pixels from 1.
            Card::new(&keyword::CRPIX1, self.centre_px.x + 1.0),
            Card::new(&keyword::CRPIX2, self.centre_px.y + 1.0),
            Card::new(&keyword::CRVAL1, 0.0),
            Card::new(&keyword::CRVAL2, 0.0),
            Card::new(&keyword::CDELT1, scale),
            Card::new(&keyword::CDELT2, scale),
            Card::new(&keyword::PC1_1, turn.m11),
            Card::new(&keyword::PC1_2, turn.m12),
            Card::new(&keyword::PC2_1, turn.m21),
            Card::new(&keyword::PC2_2, turn.m22),
            Card::new(&keyword::LONPOLE, 180.0),
            Card::new(&keyword::LATPOLE, 0.0),
        ]
    }
}

/// The keywords of the sky behind a frame: the observer and the Sun, if time and place are known, and the pixels'
/// coordinates, if there is a Sun too.
pub fn sky_cards(
    info: &FrameInfo,
    solution: &Solution,
    roll: Roll,
    instrument: &Instrument,
    target: &Target,
    ephemeris: &mut Ephemeris,
) -> Vec<Card> {
    let (Some(utc), Some(place)) = (info.mid_exposure, info.place) else {
        return Vec::new();
    };
    let sun = match ephemeris.sun(utc, place) {
        Ok(sun) => sun,
        Err(error) => {
            static UNKNOWN: Seldom = Seldom::new();
            if let Some(frames) = UNKNOWN.counted() {
                tracing::warn!(%error, frames, "no coordinates: the Sun's position is not known");
            }
            return Vec::new();
        }
    };
    let mut cards = observer_cards(&sun, place);
    // A target behind the limb has no place there; the frame's reason says so.
    if let Ok(target) = target.at(utc, &sun) {
        cards.push(Card::new(&keyword::TARGETX, target.x));
        cards.push(Card::new(&keyword::TARGETY, target.y));
    }
    if let (Some(aspect), Some(adopted)) = (&solution.aspect, &solution.mapping) {
        match Helioprojection::new(aspect, adopted.mapping(), roll, instrument, &sun) {
            Ok(Some(helioprojection)) => {
                let turn_sigma_deg = pointing::turn_sigma_deg(roll, instrument);
                cards.extend(helioprojection.cards());
                cards.extend(error_cards(&helioprojection, aspect, turn_sigma_deg, &sun));
            }
            Ok(None) => tracing::warn!("no coordinates: the mapping has no inverse"),
            Err(error) => {
                static NONE: Seldom = Seldom::new();
                if let Some(frames) = NONE.counted() {
                    tracing::warn!(%error, frames, "no coordinates");
                }
            }
        }
    }
    cards
}

/// Errors of the coordinates: the random one, of the disc's centre; the systematic one, at the limb, of clocking and roll.
fn error_cards(
    helioprojection: &Helioprojection,
    aspect: &Aspect,
    turn_sigma_deg: f64,
    sun: &SunPosition,
) -> Vec<Card> {
    let matrix = helioprojection.arcsec_per_px;
    let covariance = matrix * aspect.sun_px.covariance * matrix.transpose();
    let random = |axis: usize| covariance[(axis, axis)].max(0.0).sqrt();
    let at_limb = turn_sigma_deg.to_radians() * Disc::from(sun).radius_arcsec();
    vec![
        Card::new(&keyword::CRDER1, random(0)),
        Card::new(&keyword::CRDER2, random(1)),
        Card::new(&keyword::CSYER1, at_limb),
        Card::new(&keyword::CSYER2, at_limb),
    ]
}

/// Keywords of the observer: position relative to the Sun, and apparent position of the Sun.
pub fn observer_cards(sun: &SunPosition, place: Place) -> Vec<Card> {
    let (longitude_deg, latitude_deg) = stonyhurst_deg(sun, place);
    let carrington_deg = (sun.l0_deg + longitude_deg).rem_euclid(360.0);
    vec![
        Card::new(&keyword::DSUN_OBS, sun.distance_au * AU_M),
        Card::new(&keyword::HGLN_OBS, longitude_deg),
        Card::new(&keyword::HGLT_OBS, latitude_deg),
        Card::new(&keyword::CRLN_OBS, carrington_deg),
        Card::new(&keyword::CRLT_OBS, latitude_deg),
        Card::new(&keyword::RSUN_REF, SUN_RADIUS_KM * 1e3),
        Card::new(&keyword::RSUN_OBS, Disc::from(sun).radius_arcsec()),
        Card::new(&keyword::SOLAR_P0, sun.p_deg),
        Card::new(&keyword::NORTHANG, sun.zenith_to_north_deg),
        Card::new(&keyword::SUN_AZ, sun.azimuth_deg),
        Card::new(&keyword::SUN_EL, sun.elevation_deg),
    ]
}

/// The observer's heliographic longitude relative to the Earth's centre, and latitude. The observer is displaced from the line between
/// the Sun and the Earth's centre towards the zenith.
fn stonyhurst_deg(sun: &SunPosition, place: Place) -> (f64, f64) {
    // The Earth's flattening moves the observer by 1e-7 of the distance to the Sun.
    let up_m = EARTH_RADIUS_M + place.height_m;
    let aside = up_m * sun.elevation_deg.to_radians().cos() / (sun.distance_au * AU_M);
    let (sin, cos) = sun.zenith_to_north_deg.to_radians().sin_cos();
    let (to_west, to_north) = (-aside * sin, aside * cos);
    let latitude_deg = sun.b0_deg + to_north.to_degrees();
    let longitude_deg = to_west.to_degrees() / latitude_deg.to_radians().cos();
    (longitude_deg, latitude_deg)
}
