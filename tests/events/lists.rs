//! Event lists, written and read by cfitsio, and the lists derived from them.

use super::flight::{
    MIDNIGHT_S, MJD_OF_MIDNIGHT, SECONDS, START_S, attitude, seconds, states, truth_arcsec,
};
use Key::{Number, Text, Whole};
use fitsio::{FileOpenMode, FitsFile, sys};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use solaspect::events::{EventsError, Field, Files, ImageRequest, Placed, place_photons};
use solaspect::fits::open_disk_file;
use solaspect::observe::Watch;
use solaspect::pointing_history::PointingHistory;
use std::ffi::CString;
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// Keywords and their values.
pub type Keys = Vec<(String, Key)>;

/// Name, form, unit and values of a column.
pub type Values = (&'static str, &'static str, &'static str, Vec<f64>);

/// A table to be written by cfitsio.
#[derive(Clone)]
pub struct Table {
    pub name: &'static str,
    pub keys: Keys,
    pub columns: Vec<Values>,
}

#[derive(Clone, Copy)]
pub enum Key {
    Number(f64),
    Whole(i64),
    Text(&'static str),
}
pub fn c(text: &str) -> CString {
    CString::new(text).unwrap()
}

pub fn put_keys(file: &mut FitsFile, keys: &[(String, Key)]) {
    let mut status = 0;
    for (name, value) in keys {
        let (name, comment) = (c(name), c("as the test says"));
        unsafe {
            match value {
                Number(number) => sys::ffukyd(
                    file.as_raw(),
                    name.as_ptr(),
                    *number,
                    -17,
                    comment.as_ptr(),
                    &mut status,
                ),
                Whole(number) => sys::ffukyj(
                    file.as_raw(),
                    name.as_ptr(),
                    *number,
                    comment.as_ptr(),
                    &mut status,
                ),
                Text(text) => sys::ffukys(
                    file.as_raw(),
                    name.as_ptr(),
                    c(text).as_ptr(),
                    comment.as_ptr(),
                    &mut status,
                ),
            }
        };
    }
    assert_eq!(status, 0);
}

impl Table {
    pub fn with(mut self, key: &str, value: Key) -> Self {
        self.keys.push((key.into(), value));
        self
    }

    pub fn without(mut self, key: &str) -> Self {
        self.keys.retain(|(name, _)| name != key);
        self
    }

    pub fn column(&mut self, name: &str) -> &mut Values {
        self.columns
            .iter_mut()
            .find(|column| column.0 == name)
            .unwrap()
    }

    pub fn put(&self, file: &mut FitsFile) {
        let text = |part: fn(&Values) -> &'static str| {
            self.columns
                .iter()
                .map(|column| c(part(column)))
                .collect::<Vec<_>>()
        };
        let (names, forms, units) = (text(|c| c.0), text(|c| c.1), text(|c| c.2));
        let pointers = |texts: &[CString]| {
            texts
                .iter()
                .map(|text| text.as_ptr().cast_mut())
                .collect::<Vec<_>>()
        };
        let mut status = 0;
        unsafe {
            sys::ffcrtb(
                file.as_raw(),
                2,
                0,
                self.columns.len() as i32,
                pointers(&names).as_mut_ptr(),
                pointers(&forms).as_mut_ptr(),
                pointers(&units).as_mut_ptr(),
                c(self.name).as_ptr(),
                &mut status,
            );
        }
        put_keys(file, &self.keys);
        unsafe { sys::ffrdef(file.as_raw(), &mut status) };
        for (n, (.., values)) in (1..).zip(&self.columns) {
            let mut values = values.clone();
            let count = values.len() as i64;
            unsafe {
                sys::ffpcld(
                    file.as_raw(),
                    n,
                    1,
                    1,
                    count,
                    values.as_mut_ptr(),
                    &mut status,
                )
            };
        }
        unsafe { sys::ffpcks(file.as_raw(), &mut status) };
        assert_eq!(status, 0, "{}", self.name);
    }
}

pub fn write(path: &Path, primary: &[(String, Key)], tables: &[Table]) {
    let mut file = FitsFile::create(path).overwrite().open().unwrap();
    put_keys(&mut file, primary);
    tables.iter().for_each(|table| table.put(&mut file));
}

/// A table of photons, each given as time since the start (s), x, y and detector id.
pub fn event_table(photons: &[[f64; 4]]) -> Table {
    let values = |n: usize| photons.iter().map(|photon| photon[n]).collect::<Vec<f64>>();
    let times = values(0)
        .into_iter()
        .map(|s| s + START_S - MIDNIGHT_S)
        .collect();
    Table {
        name: "EVENTS",
        keys: vec![
            ("MJDREF".into(), Number(MJD_OF_MIDNIGHT)),
            ("TIMESYS".into(), Text("UTC")),
        ],
        columns: vec![
            ("TIME", "1D", "s", times),
            (
                "PI",
                "1I",
                "chan",
                (0..photons.len()).map(|n| (n % 4096) as f64).collect(),
            ),
            ("X", "1D", "pixel", values(1)),
            ("Y", "1D", "pixel", values(2)),
            ("DET_ID", "1B", "", values(3)),
        ],
    }
}

pub fn good_times(name: &'static str, intervals: &[[f64; 2]]) -> Table {
    let ends = |n: usize| {
        intervals
            .iter()
            .map(|ends| ends[n] + START_S - MIDNIGHT_S)
            .collect()
    };
    Table {
        name,
        keys: vec![("MJDREF".into(), Number(MJD_OF_MIDNIGHT))],
        columns: vec![
            ("START", "1D", "s", ends(0)),
            ("STOP", "1D", "s", ends(1)),
            (
                "WEIGHT",
                "1J",
                "",
                (0..intervals.len()).map(|n| 100.0 + n as f64).collect(),
            ),
        ],
    }
}

/// A detector whose coordinates are arcsec right and up of the boresight.
pub const PLAIN: &str = "[[detector]]\nscale_arcsec = 1.0\ncentre = [0, 0]\nrotation_deg = 0\n";

/// A folder with the output of a refinement, and the results made from it.
pub struct Bench {
    pub folder: TempDir,
}

impl Bench {
    pub fn new(history: &PointingHistory) -> Self {
        let folder = tempfile::tempdir().unwrap();
        history.write(folder.path(), &[]).unwrap();
        Self { folder }
    }

    pub fn plain() -> Self {
        Self::new(&PointingHistory::new(states(), seconds()))
    }

    pub fn at(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn place(
        &self,
        events: &str,
        detectors: &str,
        watch: &dyn Watch,
    ) -> Result<Placed, EventsError> {
        fs::write(self.at("det.toml"), detectors).unwrap();
        let files = Files {
            refined: self.folder.path(),
            events: &self.at(events),
            detectors: &self.at("det.toml"),
            out: Some(&self.at("out.fits")),
            image: None,
        };
        place_photons(files, watch)
    }

    /// Writes a list and makes only its image.
    pub fn image(
        &self,
        detectors: &str,
        tables: &[Table],
        request: &ImageRequest,
    ) -> Result<Placed, EventsError> {
        write(&self.at("in.fits"), &[], tables);
        fs::write(self.at("det.toml"), detectors).unwrap();
        let files = Files {
            refined: self.folder.path(),
            events: &self.at("in.fits"),
            detectors: &self.at("det.toml"),
            out: None,
            image: Some(request),
        };
        place_photons(files, &())
    }

    pub fn request(&self) -> ImageRequest {
        ImageRequest {
            path: self.at("image.fits"),
            pixel_arcsec: 5.0,
            field: Field::default(),
            energies: None,
        }
    }

    /// Writes a list, traces its photons to the Sun, and reads the new columns.
    pub fn placed(
        &self,
        detectors: &str,
        primary: &[(String, Key)],
        tables: &[Table],
    ) -> (Placed, Columns) {
        write(&self.at("in.fits"), primary, tables);
        let placed = self.place("in.fits", detectors, &()).unwrap();
        (placed, Columns::read(&self.at("out.fits")))
    }

    pub fn refusal(&self, detectors: &str, tables: &[Table]) -> String {
        write(&self.at("in.fits"), &[], tables);
        let error = self
            .place("in.fits", detectors, &())
            .unwrap_err()
            .to_string();
        assert!(!self.at("out.fits").exists(), "{error}");
        let left = fs::read_dir(self.folder.path()).unwrap();
        let names: Vec<_> = left.map(|entry| entry.unwrap().file_name()).collect();
        assert!(
            names
                .iter()
                .all(|name| !name.to_str().unwrap().starts_with('.')),
            "{names:?}"
        );
        error
    }
}

/// The new columns as cfitsio reads them.
pub struct Columns {
    pub hp: Vec<[f64; 2]>,
    pub sigma: Vec<f64>,
    pub systematic: Vec<f64>,
    pub valid: Vec<bool>,
}

pub fn column(path: &Path, table: &str, name: &str) -> Vec<f64> {
    let mut file = open_disk_file(path, FileOpenMode::READONLY).unwrap();
    let hdu = file.hdu(table).unwrap();
    hdu.read_col(&mut file, name).unwrap()
}

impl Columns {
    pub fn read(path: &Path) -> Self {
        assert_sums(path);
        let column = |name| column(path, "EVENTS", name);
        let mut file = open_disk_file(path, FileOpenMode::READONLY).unwrap();
        let hdu = file.hdu("EVENTS").unwrap();
        Self {
            hp: column("HPX")
                .into_iter()
                .zip(column("HPY"))
                .map(|(x, y)| [x, y])
                .collect(),
            sigma: column("HP_SIGMA"),
            systematic: column("HP_SYS"),
            valid: hdu.read_col(&mut file, "HP_VALID").unwrap(),
        }
    }
}

/// An image of a file, read by cfitsio: the primary HDU or an extension.
pub fn read_image(path: &Path, name: &str) -> Vec<f64> {
    let mut file = open_disk_file(path, FileOpenMode::READONLY).unwrap();
    let hdu = file.hdu(name).unwrap();
    hdu.read_image(&mut file).unwrap()
}

/// A numeric keyword of an image's header.
pub fn read_number(path: &Path, name: &str, keyword: &str) -> f64 {
    let mut file = open_disk_file(path, FileOpenMode::READONLY).unwrap();
    let hdu = file.hdu(name).unwrap();
    hdu.read_key(&mut file, keyword).unwrap()
}

/// Asserts with cfitsio that the checksums of all HDUs are right.
pub fn assert_sums(path: &Path) {
    let mut file = open_disk_file(path, FileOpenMode::READONLY).unwrap();
    let (mut count, mut status) = (0, 0);
    unsafe { sys::ffthdu(file.as_raw(), &mut count, &mut status) };
    for n in 2..=count {
        let (mut data, mut hdu, mut kind) = (0, 0, 0);
        unsafe {
            sys::ffmahd(file.as_raw(), n, &mut kind, &mut status);
            sys::ffvcks(file.as_raw(), &mut data, &mut hdu, &mut status);
        }
        assert_eq!((data, hdu, status), (1, 1, 0), "HDU {n}");
    }
}

pub fn random(seed: u64) -> Xoshiro256PlusPlus {
    Xoshiro256PlusPlus::seed_from_u64(seed)
}

pub fn normal(random: &mut Xoshiro256PlusPlus) -> f64 {
    StandardNormal.sample(random)
}

pub fn some_photons(count: usize, detectors: u64) -> Vec<[f64; 4]> {
    let mut random = random(1);
    let photon = |n: u64| {
        [
            random.random_range(0.0..SECONDS as f64),
            random.random_range(-300.0..300.0),
            random.random_range(-300.0..300.0),
            (n % detectors + 1) as f64,
        ]
    };
    (0..count as u64).map(photon).collect()
}

pub fn assert_close(found: [f64; 2], expected: [f64; 2], arcsec: f64, what: &str) {
    let distance = (found[0] - expected[0]).hypot(found[1] - expected[1]);
    assert!(
        distance < arcsec,
        "{what}: {found:?}, expected {expected:?}"
    );
}

/// The true origins of photons on the detector `PLAIN`.
pub fn plain_truth(photons: &[[f64; 4]]) -> Vec<[f64; 2]> {
    let truth = |[s, x, y, _]: &[f64; 4]| truth_arcsec(&attitude(START_S + s), [*x, *y]);
    photons.iter().map(truth).collect()
}

/// A column of times, s since the start.
pub fn since_start(path: &Path, table: &str, name: &str) -> Vec<f64> {
    let times = column(path, table, name).into_iter();
    times.map(|time| time + MIDNIGHT_S - START_S).collect()
}
