//! Assignment of photons to positions on the Sun: the event list of a telescope, with each photon's helioprojective position by the
//! pointing of a refined flight, and an image of the photons.
//!
//! Event lists are FITS files in the format of X-ray astronomy (OGIP): a table EVENTS with a row for each photon, and tables of good time
//! intervals. [`place_photons`] copies such a file. In the copy the photons' table has more columns ([`PHOTON_COLUMNS`]), the good time
//! intervals are restricted to valid pointing, and all else is identical, byte for byte. An [image](ImageRequest) counts the photons in
//! pixels of the sky, with the exposure of each.
//!
//! A detector measures a photon at (x, y). With its mounting ([`Detectors`]) this gives two angles from the boresight, to the telescope's
//! right R and up U in the tangent plane of the sky there: the photon came from the direction forward + R right + U up. The pointing at
//! the photon's time rotates this to axes about the Sun.

mod detectors;
mod good_times;
mod imaging;
mod list;
mod photons;
mod run;
mod times;

pub use detectors::{Detectors, FromBoresight, PhotonColumns};
pub use imaging::{Energies, Field, ImageRequest, Imaged};
pub use photons::{PHOTON_COLUMNS, Photon, Place};
pub use run::place_photons;

use crate::fits::FileError;
use crate::instrument::TomlError;
use crate::pointing_history::StoreError;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The files of a run.
#[derive(Debug, Clone, Copy)]
pub struct Files<'a> {
    /// The folder of a refined flight.
    pub refined: &'a Path,
    /// The event list, plain or gzipped.
    pub events: &'a Path,
    /// DET.toml.
    pub detectors: &'a Path,
    /// The copy; an existing file is replaced.
    pub out: Option<&'a Path>,
    pub image: Option<&'a ImageRequest>,
}

/// Result of a run.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Placed {
    pub photons: u64,
    pub valid: u64,
    /// Number of invalid photons by the reason.
    pub invalid: BTreeMap<&'static str, u64>,
    pub exposures: Vec<Exposure>,
    pub image: Option<Imaged>,
}

/// The length of the good time intervals of an extension, before the cut and with a valid pointing.
#[derive(Debug, Clone, PartialEq)]
pub struct Exposure {
    pub extension: String,
    pub before_s: f64,
    pub after_s: f64,
}

/// Reasons for which photons cannot be assigned to positions on the Sun.
#[derive(Debug, thiserror::Error)]
pub enum EventsError {
    #[error(transparent)]
    Detectors(#[from] TomlError),
    #[error(transparent)]
    Pointing(#[from] StoreError),
    /// The event list, the copy or the image.
    #[error(transparent)]
    File(#[from] FileError),
    #[error("{}: expected a file other than those that are read or written, found {}", .out.display(), .other.display())]
    Overwrites { out: PathBuf, other: PathBuf },
    #[error("cancelled: {} is not written", .out.display())]
    Cancelled { out: PathBuf },
}

impl Placed {
    fn count(&mut self, photon: &Photon) {
        self.photons += 1;
        match photon.invalid {
            None => self.valid += 1,
            Some(why) => *self.invalid.entry(why).or_default() += 1,
        }
    }
}
