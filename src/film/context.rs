//! A solar image on which the path is drawn.
//!
//! It was taken at another time and from another position than the flight. Its scale is matched to the flight's by the Sun's radius;
//! effects of rotation and the observer's position are not corrected, but reported.

use super::wcs::WorldCoordinates;
use crate::fits::{FileError, FitsFile, Header, Problem};
use crate::pointing::HelioprojectiveArcsec;
use crate::sky::sphere::{direction, separation_rad};
use crate::sky::{Disc, Ephemeris, solar_radius_arcsec};
use jiff::{SignedDuration, Timestamp};
use nalgebra::Vector2;
use std::path::{Path, PathBuf};

/// Age above which there is a warning: the Sun rotates by 7 deg in this time.
const OLD: SignedDuration = SignedDuration::from_hours(12);
/// Angle of an observer from the Earth, as seen from the Sun: above the first value there is a warning, above the second no map.
const OFF_EARTH_DEG: f64 = 5.0;
const FAR_DEG: f64 = 20.0;
/// Greatest relative difference of the radius from that seen from the Earth, if no other observer is named.
const RADIUS_DIFFERENCE: f64 = 0.05;
/// Approximate number of pixels per row of the image that are sampled for the disc's brightness.
const SAMPLES: usize = 256;
/// Fractions of the disc's pixels that are darker than black and brighter than white.
const OUTSIDE: f64 = 0.005;
/// Distance of black below the darkest part of the disc, as a part of its range, so that the limb is visible.
const BLACK_MARGIN: f64 = 0.25;

/// A solar image with its coordinates.
#[derive(Debug, Clone)]
pub struct Context {
    path: PathBuf,
    size_px: [usize; 2],
    /// Pixel values row by row, the lowest row first.
    values: Vec<f32>,
    world: WorldCoordinates,
    /// The Sun's radius as seen by the image's observer.
    radius_arcsec: f64,
    taken: Option<Timestamp>,
    /// Angle between the observer and the Earth, as seen from the Sun; `None` if the header does not state it.
    off_earth_deg: Option<f64>,
    stretch: Stretch,
}

/// Conversion from a value to a brightness.
#[derive(Debug, Clone, Copy)]
struct Stretch {
    black: f32,
    white: f32,
    /// The exponent that maps a darker median of the disc to half the brightness.
    power: f32,
}

impl Context {
    /// Reads a FITS image.
    ///
    /// # Errors
    /// If the file cannot be read, is no image, has no helioprojective coordinates, or has an observer far from the Earth.
    pub fn read(path: &Path) -> Result<Self, FileError> {
        let file = FitsFile::open(path)?;
        let taken = file.info()?.0.mid_exposure;
        let header = file.keywords()?;
        let (size_px, values) = file.values()?;
        let read = || {
            let earth = taken.and_then(|utc| Ephemeris::default().disc(utc).ok());
            let off_earth_deg = off_earth_deg(&header, earth.as_ref())?;
            let radius_arcsec = radius_arcsec(&header, earth.as_ref(), off_earth_deg)?;
            let world = WorldCoordinates::read(&header)?;
            let stretch = Stretch::of_disc(&values, size_px, &world, radius_arcsec)?;
            Ok((off_earth_deg, radius_arcsec, world, stretch))
        };
        let facts = read().map_err(|problem: Problem| problem.in_file(path))?;
        let (off_earth_deg, radius_arcsec, world, stretch) = facts;
        Ok(Self {
            path: path.into(),
            size_px,
            values,
            world,
            radius_arcsec,
            taken,
            off_earth_deg,
            stretch,
        })
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The size of a pixel for this radius of the Sun.
    pub fn arcsec_per_px(&self, radius_arcsec: f64) -> f64 {
        self.world.arcsec_per_px() * radius_arcsec / self.radius_arcsec
    }

    /// Brightness from 0 to 1 at a position, for a Sun of this radius; `None` outside the image.
    pub fn brightness(&self, place: HelioprojectiveArcsec, radius_arcsec: f64) -> Option<f32> {
        let scale = self.radius_arcsec / radius_arcsec;
        let (x, y) = (place.x * scale, place.y * scale);
        let value = self.value(self.world.pixel(HelioprojectiveArcsec { x, y })?)?;
        Some(self.stretch.brightness(value))
    }

    /// Interpolates between the four pixels around a position in the image.
    fn value(&self, at: Vector2<f64>) -> Option<f32> {
        let corner = at.map(f64::floor);
        let [width, height] = self.size_px;
        let is_inside = corner.x >= 0.0 && corner.y >= 0.0;
        let (x, y) = (corner.x as usize, corner.y as usize);
        if !is_inside || x + 1 >= width || y + 1 >= height {
            return None;
        }
        let part = (at - corner).cast::<f32>();
        let row = |y: usize| {
            let from = self.values[y * width + x];
            from + (self.values[y * width + x + 1] - from) * part.x
        };
        let value = row(y) + (row(y + 1) - row(y)) * part.y;
        value.is_finite().then_some(value)
    }

    /// Age of the image at a time of the flight, and warnings.
    pub fn words(&self, utc: Timestamp) -> Words {
        let Some(taken) = self.taken else {
            let text = "context, date unknown".to_owned();
            return self.with_observer(text, true);
        };
        let later = taken.duration_since(utc);
        let hours = later.abs().as_secs_f64() / 3600.0;
        let length = match hours < 48.0 {
            true => format!("{hours:.1} h"),
            false => format!("{:.0} days", hours / 24.0),
        };
        let side = if later.is_positive() {
            "after"
        } else {
            "before"
        };
        let date = taken.strftime("%Y-%m-%d %H:%M");
        let text = format!("context {date} UTC, {length} {side} the flight");
        self.with_observer(text, later.abs() > OLD)
    }

    fn with_observer(&self, text: String, is_old: bool) -> Words {
        match self.off_earth_deg.filter(|deg| *deg > OFF_EARTH_DEG) {
            Some(deg) => Words {
                text: format!("{text}, seen {deg:.0} deg aside"),
                is_warning: true,
            },
            None => Words {
                text,
                is_warning: is_old,
            },
        }
    }
}

/// Description of a context, in words.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Words {
    pub text: String,
    /// Whether features may be elsewhere than shown.
    pub is_warning: bool,
}

/// Angle of the observer from the Earth, from heliographic coordinates: Stonyhurst's, else Carrington's.
fn off_earth_deg(header: &Header, earth: Option<&Disc>) -> Result<Option<f64>, Problem> {
    let carrington = header.number("CRLN_OBS")?.zip(earth);
    let carrington = carrington.map(|(deg, earth)| ("CRLN_OBS", deg - earth.l0_deg));
    let stonyhurst = header.number("HGLN_OBS")?.map(|deg| ("HGLN_OBS", deg));
    let Some((keyword, longitude_deg)) = stonyhurst.or(carrington) else {
        return Ok(None);
    };
    let b0_deg = earth.map_or(0.0, |earth| earth.b0_deg);
    let latitude_deg = match header.number("HGLT_OBS")? {
        Some(deg) => deg,
        None => header.number("CRLT_OBS")?.unwrap_or(b0_deg),
    };
    let observer = direction(longitude_deg, latitude_deg);
    let off_earth_deg = separation_rad(&observer, &direction(0.0, b0_deg)).to_degrees();
    if off_earth_deg > FAR_DEG {
        let expected = format!("an observer within {FAR_DEG} deg of the Earth");
        return Err(Problem::field(
            keyword,
            expected,
            format!("one at {off_earth_deg:.0} deg"),
        ));
    }
    Ok(Some(off_earth_deg))
}

/// The Sun's radius as seen by the observer; as from the Earth if the header does not state it.
fn radius_arcsec(
    header: &Header,
    earth: Option<&Disc>,
    off_earth_deg: Option<f64>,
) -> Result<f64, Problem> {
    let from_earth = earth.map(Disc::radius_arcsec);
    let radius = header.number("RSUN_OBS")?;
    let distance = header
        .number("DSUN_OBS")?
        .map(|m| solar_radius_arcsec(m / 1e3));
    let stated = radius.map(|arcsec| ("RSUN_OBS", arcsec));
    let stated = stated.or(distance.map(|arcsec| ("DSUN_OBS", arcsec)));
    match (stated, from_earth) {
        (Some((keyword, arcsec)), _) if !(100.0..1e4).contains(&arcsec) => {
            let expected = "a radius of the Sun from 100 to 10000 arcsec";
            Err(Problem::field(keyword, expected, arcsec))
        }
        (Some((keyword, arcsec)), Some(earth))
            if off_earth_deg.is_none() && (arcsec / earth - 1.0).abs() > RADIUS_DIFFERENCE =>
        {
            let expected = format!("about {earth:.0} arcsec, the Sun's radius from the Earth");
            Err(Problem::field(keyword, expected, arcsec))
        }
        (Some((_, arcsec)), _) | (None, Some(arcsec)) => Ok(arcsec),
        (None, None) => {
            let expected = "the Sun's radius in arcsec, or DSUN_OBS, or DATE-OBS";
            Err(Problem::field("RSUN_OBS", expected, "none of them"))
        }
    }
}

impl Stretch {
    /// From the pixels of the disc.
    fn of_disc(
        values: &[f32],
        [width, height]: [usize; 2],
        world: &WorldCoordinates,
        radius_arcsec: f64,
    ) -> Result<Self, Problem> {
        let step = (width.max(height) / SAMPLES).max(1);
        let mut disc = Vec::new();
        for y in (0..height).step_by(step) {
            for x in (0..width).step_by(step) {
                let place = world.place(Vector2::new(x as f64, y as f64));
                let value = values[y * width + x];
                if value.is_finite() && place.x.hypot(place.y) < radius_arcsec {
                    disc.push(value);
                }
            }
        }
        disc.sort_by(f32::total_cmp);
        let at =
            |part: f64| Some(*disc.get((part * (disc.len().checked_sub(1)? as f64)) as usize)?);
        let levels = [OUTSIDE, 0.5, 1.0 - OUTSIDE].map(at);
        let [Some(low), Some(median), Some(high)] = levels else {
            return Err(Problem::field("pixels", "values on the Sun's disc", "none"));
        };
        let black = low - BLACK_MARGIN as f32 * (high - low);
        let black = if low >= 0.0 { black.max(0.0) } else { black };
        let white = if high > black { high } else { black + 1.0 };
        let half = ((median - black) / (white - black)).clamp(0.01, 0.5);
        let power = 0.5f32.ln() / half.ln();
        Ok(Self {
            black,
            white,
            power,
        })
    }

    fn brightness(&self, value: f32) -> f32 {
        let part = (value - self.black) / (self.white - self.black);
        part.clamp(0.0, 1.0).powf(self.power)
    }
}
