//! Photons are put on the Sun where the telescope's rotation says, as exactly as their sigmas say, and what else an event list holds stays.
//!
//! The pointing is made by hand: the telescope turns at a constant rate before a Sun that stands still, so that the truth is a product of
//! rotations. Event lists are written and read by cfitsio.

use fitsio::{FileOpenMode, FitsFile, sys};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, UnitVector3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use solaspect::events::{EventsError, Exposure, Files, Placed, place_photons};
use solaspect::fits::open_disk_file;
use solaspect::observe::Watch;
use solaspect::pointing_history::{Basis, PointingHistory, Second, State};
use std::ffi::CString;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;
use tempfile::TempDir;

/// 2013-09-21T18:00:00Z, and midnight before it.
const START_S: f64 = 1_379_786_400.0;
const MIDNIGHT_S: f64 = START_S - 64_800.0;
const MJD_OF_MIDNIGHT: f64 = 56_556.0;
const SECONDS: usize = 60;
const STATE_HZ: usize = 4;
const ARCSEC: f64 = std::f64::consts::PI / 180.0 / 3600.0;

// ---------------------------------------------------------------------------------------------- the flight

/// Telescope at the start, its axes as columns: forward to the Sun (x), right to solar west (-y), down against north (-z).
fn level() -> UnitQuaternion<f64> {
    let axes = Matrix3::new(1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0);
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes))
}

/// In the telescope's axes.
fn rate_rad_s() -> Vector3<f64> {
    Vector3::new(300.0, 20.0, -30.0) * ARCSEC
}

fn attitude(unix_s: f64) -> UnitQuaternion<f64> {
    let turned = UnitQuaternion::from_scaled_axis(rate_rad_s() * (unix_s - START_S));
    let begun = UnitQuaternion::from_scaled_axis(Vector3::new(0.4, 200.0 * ARCSEC, -90.0 * ARCSEC));
    level() * begun * turned
}

/// Where a photon comes from that is so far to the right and up of the boresight: HPX and HPY, arcsec.
fn truth_arcsec(attitude: &UnitQuaternion<f64>, [right, up]: [f64; 2]) -> [f64; 2] {
    let v = attitude * Vector3::new(1.0, right * ARCSEC, -up * ARCSEC).normalize();
    [(-v.y).atan2(v.x), v.z.atan2(v.x.hypot(v.y))].map(|rad| rad / ARCSEC)
}

fn random_rad2() -> Matrix3<f64> {
    Matrix3::new(4.0, 1.0, 90.0, 1.0, 2.0, -60.0, 90.0, -60.0, 40_000.0) * (ARCSEC * ARCSEC)
}

fn systematic_rad2() -> Matrix3<f64> {
    Matrix3::from_diagonal(&Vector3::new(9.0, 16.0, 2500.0)) * (ARCSEC * ARCSEC)
}

fn states() -> Vec<State> {
    let state = |n: usize| {
        let unix_s = START_S + n as f64 / STATE_HZ as f64;
        State {
            unix_s,
            attitude: attitude(unix_s),
            rate_rad_s: rate_rad_s(),
            covariance_rad2: random_rad2(),
            basis: Basis::Both,
            is_contradicted: false,
        }
    };
    (0..=SECONDS * STATE_HZ).map(state).collect()
}

fn seconds() -> Vec<Second> {
    let second = |n: i64| Second {
        unix_s: START_S as i64 + n,
        position_m: Vector3::new(6.4e6, 0.0, 0.0),
        to_sun: Vector3::x_axis(),
        north: Vector3::z_axis(),
        systematic_rad2: systematic_rad2(),
    };
    (-1..=SECONDS as i64 + 1).map(second).collect()
}

/// A flight with a gap, a contradiction, a slew and uncertain states.
fn troubled() -> PointingHistory {
    let mut states = states();
    for (n, state) in states.iter_mut().enumerate() {
        match n {
            80..=83 => state.is_contradicted = true,
            120..=131 => state.covariance_rad2 *= 40.0 * (n - 119) as f64,
            160..=167 => state.rate_rad_s.y += 900.0 * ARCSEC * (n - 159) as f64,
            _ => {}
        }
    }
    states.drain(30..40);
    let mut seconds = seconds();
    seconds.remove(53);
    PointingHistory::new(states, seconds)
}

// ---------------------------------------------------------------------------------------------- files

/// Keywords and columns of a table, as cfitsio is to write them.
#[derive(Clone)]
struct Table {
    name: &'static str,
    keys: Vec<(String, Key)>,
    /// Name, form, unit and values.
    columns: Vec<(&'static str, &'static str, &'static str, Vec<f64>)>,
}

#[derive(Clone, Copy)]
enum Key {
    Number(f64),
    Text(&'static str),
}
use Key::{Number, Text};

fn c(text: &str) -> CString {
    CString::new(text).unwrap()
}

fn put_keys(file: &mut FitsFile, keys: &[(String, Key)]) {
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
    fn with(mut self, key: &str, value: Key) -> Self {
        self.keys.push((key.into(), value));
        self
    }

    fn without(mut self, key: &str) -> Self {
        self.keys.retain(|(name, _)| name != key);
        self
    }

    fn column(&mut self, name: &str) -> &mut (&'static str, &'static str, &'static str, Vec<f64>) {
        self.columns
            .iter_mut()
            .find(|column| column.0 == name)
            .unwrap()
    }

    fn put(&self, file: &mut FitsFile) {
        let text =
            |part: fn(&(&'static str, &'static str, &'static str, Vec<f64>)) -> &'static str| {
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

fn write(path: &Path, primary: &[(String, Key)], tables: &[Table]) {
    let mut file = FitsFile::create(path).overwrite().open().unwrap();
    put_keys(&mut file, primary);
    tables.iter().for_each(|table| table.put(&mut file));
}

/// Photons as time since the start, x, y and detector.
fn event_table(photons: &[[f64; 4]]) -> Table {
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

fn good_times(name: &'static str, intervals: &[[f64; 2]]) -> Table {
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

/// A detector whose pixels are arcsec to the right and up of the boresight.
const PLAIN: &str = "[[detector]]\nscale_arcsec = 1.0\ncentre = [0, 0]\nrotation_deg = 0\n";

/// A folder with a refined flight, and what is made of it.
struct Bench {
    folder: TempDir,
}

impl Bench {
    fn new(history: &PointingHistory) -> Self {
        let folder = tempfile::tempdir().unwrap();
        history.write(folder.path(), &[]).unwrap();
        Self { folder }
    }

    fn plain() -> Self {
        Self::new(&PointingHistory::new(states(), seconds()))
    }

    fn at(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn place(
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
            out: &self.at("out.fits"),
        };
        place_photons(files, watch)
    }

    /// Puts the photons of a list on the Sun, and gives the columns.
    fn placed(
        &self,
        detectors: &str,
        primary: &[(String, Key)],
        tables: &[Table],
    ) -> (Placed, Columns) {
        write(&self.at("in.fits"), primary, tables);
        let placed = self.place("in.fits", detectors, &()).unwrap();
        (placed, Columns::read(&self.at("out.fits")))
    }

    fn refusal(&self, detectors: &str, tables: &[Table]) -> String {
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

/// What cfitsio reads of the new columns.
struct Columns {
    hp: Vec<[f64; 2]>,
    sigma: Vec<f64>,
    systematic: Vec<f64>,
    valid: Vec<bool>,
}

fn column(path: &Path, table: &str, name: &str) -> Vec<f64> {
    let mut file = open_disk_file(path, FileOpenMode::READONLY).unwrap();
    let hdu = file.hdu(table).unwrap();
    hdu.read_col(&mut file, name).unwrap()
}

impl Columns {
    fn read(path: &Path) -> Self {
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

/// All HDUs have right checksums, says cfitsio.
fn assert_sums(path: &Path) {
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

fn random(seed: u64) -> Xoshiro256PlusPlus {
    Xoshiro256PlusPlus::seed_from_u64(seed)
}

fn normal(random: &mut Xoshiro256PlusPlus) -> f64 {
    StandardNormal.sample(random)
}

fn some_photons(count: usize, detectors: u64) -> Vec<[f64; 4]> {
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

fn assert_close(found: [f64; 2], expected: [f64; 2], arcsec: f64, what: &str) {
    let distance = (found[0] - expected[0]).hypot(found[1] - expected[1]);
    assert!(
        distance < arcsec,
        "{what}: {found:?}, expected {expected:?}"
    );
}

/// The places of photons whose pixels are arcsec from the boresight.
fn plain_truth(photons: &[[f64; 4]]) -> Vec<[f64; 2]> {
    let truth = |[s, x, y, _]: &[f64; 4]| truth_arcsec(&attitude(START_S + s), [*x, *y]);
    photons.iter().map(truth).collect()
}

// ---------------------------------------------------------------------------------------------- promises

#[test]
fn photons_land_where_the_rotation_says_for_every_turn_mirror_and_offset() {
    let mut text = String::from("x_column = \"X\"\n");
    let mut mounted = Vec::new();
    for (id, turn_deg) in (1_u64..).zip([0.0, 90.0, 180.0, 270.0, 33.3, -123.4]) {
        for mirrored in [false, true] {
            let id = 2 * id + u64::from(mirrored) - 2;
            let offset = [40.0 * id as f64, -25.0 * id as f64];
            text += &format!(
                "[[detector]]\nid = {id}\nscale_arcsec = 1.7\ncentre = [12.5, -7.0]\nrotation_deg = {turn_deg}\n\
                 mirrored = {mirrored}\noffset_arcsec = {offset:?}\n"
            );
            mounted.push((turn_deg, mirrored, offset));
        }
    }
    let mut photons = some_photons(3000, mounted.len() as u64);
    photons.iter_mut().for_each(|photon| photon[3] -= 1.0);
    let (placed, columns) = Bench::plain().placed(&text, &[], &[event_table(&photons)]);
    assert_eq!((placed.photons, placed.valid), (3000, 3000));
    for ([s, x, y, id], found) in photons.iter().zip(&columns.hp) {
        let (turn_deg, mirrored, offset): (f64, bool, [f64; 2]) = mounted[*id as usize];
        // In polar coordinates about the module's axis; to the other side, angles run backward.
        let (dx, dy) = (1.7 * (x - 12.5), 1.7 * (y + 7.0));
        let angle = if mirrored {
            -dy.atan2(dx)
        } else {
            dy.atan2(dx)
        } + turn_deg.to_radians();
        let place = [
            dx.hypot(dy) * angle.cos() + offset[0],
            dx.hypot(dy) * angle.sin() + offset[1],
        ];
        let expected = truth_arcsec(&attitude(START_S + s), place);
        assert_close(*found, expected, 1e-3, &format!("detector {id}"));
    }
}

#[test]
fn sigma_is_the_scatter_over_pointings_drawn_from_the_covariance() {
    let place = [250.0, -170.0];
    let photons = [[10.0, place[0], place[1], 1.0]];
    let detectors = "[[detector]]\nid = 1\nscale_arcsec = 1.0\nscale_sigma_arcsec = 0.02\ncentre = [0, 0]\n\
                     centre_sigma = 2.0\nrotation_deg = 0\nrotation_sigma_deg = 1.0\noffset_sigma_arcsec = 3.0\n";
    let (_, columns) = Bench::plain().placed(detectors, &[], &[event_table(&photons)]);
    let mut random = random(2);
    let at = attitude(START_S + 10.0);
    let mean = truth_arcsec(&at, place);
    let draws = 40_000;
    let mut scatter = |draw: &mut dyn FnMut(&mut Xoshiro256PlusPlus) -> [f64; 2]| {
        let square = |found: [f64; 2]| (found[0] - mean[0]).powi(2) + (found[1] - mean[1]).powi(2);
        let sum: f64 = (0..draws).map(|_| square(draw(&mut random))).sum();
        (sum / f64::from(2 * draws)).sqrt()
    };
    // Moved to the right about down, moved up about right, and turned about forward.
    let moved = |covariance: &Matrix3<f64>, random: &mut Xoshiro256PlusPlus| {
        let factor = covariance.cholesky().unwrap().l();
        let [right, up, roll] = (factor * Vector3::from_fn(|_, _| normal(random))).into();
        at * UnitQuaternion::from_scaled_axis(Vector3::new(roll, up, right))
    };
    let expected = scatter(&mut |random| truth_arcsec(&moved(&random_rad2(), random), place));
    assert!(
        (columns.sigma[0] / expected - 1.0).abs() < 0.02,
        "{} {expected}",
        columns.sigma[0]
    );
    let expected = scatter(&mut |random| {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::z() * normal(random).to_radians());
        let from_axis = Vector3::new(
            place[0] + 2.0 * normal(random),
            place[1] + 2.0 * normal(random),
            0.0,
        );
        let on_sky = turn * from_axis * (1.0 + 0.02 * normal(random));
        let offset = [
            on_sky.x + 3.0 * normal(random),
            on_sky.y + 3.0 * normal(random),
        ];
        truth_arcsec(&moved(&systematic_rad2(), random), offset)
    });
    assert!(
        (columns.systematic[0] / expected - 1.0).abs() < 0.02,
        "{} {expected}",
        columns.systematic[0]
    );
}

#[test]
fn times_of_every_unit_zero_and_scale_give_the_same_places() {
    let photons = some_photons(200, 1);
    let truth = plain_truth(&photons);
    let bench = Bench::plain();
    let plain = event_table(&photons);
    let counted = |unit_s: f64, zero_s: f64, form: &'static str| {
        let mut table = plain.clone().without("MJDREF");
        let column = table.column("TIME");
        (column.1, column.2) = (form, "");
        column.3 = photons
            .iter()
            .map(|photon| (photon[0] + START_S - zero_s) / unit_s)
            .collect();
        table
    };
    let days = 86_400.0;
    // TT is 32.184 s ahead of TAI, TAI 35 s of UTC then (IERS Bulletin C 43).
    let tt_s = 35.0 + 32.184;
    let primary = |keys: &[(&str, Key)]| {
        keys.iter()
            .map(|(key, value)| ((*key).into(), *value))
            .collect()
    };
    let cases: Vec<(&str, Vec<(String, Key)>, Table)> = vec![
        ("seconds", vec![], plain.clone()),
        (
            "days",
            vec![],
            counted(days, MIDNIGHT_S, "1D")
                .with("MJDREF", Number(MJD_OF_MIDNIGHT))
                .with("TIMEUNIT", Text("d")),
        ),
        (
            "milliseconds in integers",
            vec![],
            counted(1e-3, MIDNIGHT_S, "1J")
                .with("MJDREF", Number(MJD_OF_MIDNIGHT))
                .with("TIMEUNIT", Text("ms")),
        ),
        (
            "microseconds in long integers",
            vec![],
            counted(1e-6, MIDNIGHT_S, "1K")
                .with("MJDREF", Number(MJD_OF_MIDNIGHT))
                .with("TIMEUNIT", Text("us")),
        ),
        (
            "seconds in scaled integers",
            vec![],
            counted(1.0, MIDNIGHT_S, "1J")
                .with("MJDREF", Number(MJD_OF_MIDNIGHT))
                .with("TSCAL1", Number(1e-4))
                .with("TZERO1", Number(64_800.0)),
        ),
        (
            "a whole and a fraction in the primary header, and a zero",
            primary(&[
                ("MJDREFI", Number(56_555.0)),
                ("MJDREFF", Number(0.25)),
                ("TIMEUNIT", Text("s")),
            ]),
            counted(1.0, MIDNIGHT_S - 0.75 * days + 1234.5, "1D").with("TIMEZERO", Number(1234.5)),
        ),
        (
            "a zero in days",
            primary(&[
                ("MJDREF", Number(56_000.0)),
                ("TIMEUNIT", Text("d")),
                ("TIMEZERO", Number(556.0)),
            ]),
            counted(days, MIDNIGHT_S, "1D"),
        ),
        (
            "terrestrial time",
            vec![],
            counted(1.0, MIDNIGHT_S - tt_s, "1D")
                .without("TIMESYS")
                .with("MJDREF", Number(MJD_OF_MIDNIGHT))
                .with("TIMESYS", Text("TT")),
        ),
        (
            "atomic time",
            vec![],
            counted(1.0, MIDNIGHT_S - 35.0, "1D")
                .without("TIMESYS")
                .with("MJDREF", Number(MJD_OF_MIDNIGHT))
                .with("TIMESYS", Text("TAI")),
        ),
    ];
    for (what, primary, table) in cases {
        let (placed, columns) = bench.placed(PLAIN, &primary, &[table]);
        assert_eq!(placed.valid, 200, "{what}: {placed:?}");
        for (found, expected) in columns.hp.iter().zip(&truth) {
            // The telescope turns by 36 arcsec/s: half a millisecond is 0.02 arcsec, with the roll 0.2 arcsec at the field's edge.
            assert_close(*found, *expected, 0.4, what);
        }
    }
    let unknown = plain.without("TIMESYS").with("TIMESYS", Text("LOCAL"));
    fs::remove_file(bench.at("out.fits")).unwrap();
    let error = bench.refusal(PLAIN, &[unknown]);
    assert!(
        error.ends_with(
            "in.fits: EVENTS: TIMESYS: expected UTC, TT, TAI, TDB or GPS, found 'LOCAL'"
        ),
        "{error}"
    );
}

#[test]
fn numbers_of_any_form_and_scaling_are_read_as_cfitsio_reads_them() {
    let photons: Vec<[f64; 4]> = (0..40)
        .map(|n| [n as f64, (n % 90) as f64, (n % 7) as f64 * 2.0, 1.0])
        .collect();
    let bench = Bench::plain();
    for form in ["1B", "1I", "1J", "1K", "1E", "1D"] {
        let mut table = event_table(&photons)
            .with("TSCAL3", Number(0.5))
            .with("TZERO3", Number(-3.0))
            .with("TSCAL4", Number(2.0));
        table.column("X").1 = form;
        table.column("Y").1 = form;
        let (_, columns) = bench.placed(PLAIN, &[], &[table]);
        let out = bench.at("out.fits");
        let read = column(&out, "EVENTS", "X")
            .into_iter()
            .zip(column(&out, "EVENTS", "Y"));
        for ((found, (x, y)), [s, ..]) in columns.hp.iter().zip(read).zip(&photons) {
            let expected = truth_arcsec(&attitude(START_S + s), [x, y]);
            assert_close(*found, expected, 1e-3, form);
        }
    }
    // cfitsio writes unsigned integers as signed ones with a zero; a null is no position.
    let mut table = event_table(&photons)
        .with("TZERO3", Number(32_768.0))
        .with("TNULL4", Number(4.0));
    table.column("X").1 = "1I";
    table.column("Y").1 = "1I";
    let (placed, columns) = bench.placed(PLAIN, &[], &[table]);
    let nulls = photons.iter().filter(|photon| photon[2] == 4.0).count() as u64;
    assert_eq!(placed.invalid.get("no position"), Some(&nulls));
    for ((found, expected), photon) in columns.hp.iter().zip(plain_truth(&photons)).zip(&photons) {
        match photon[2] == 4.0 {
            true => assert!(found[0].is_nan()),
            false => assert_close(*found, expected, 1e-3, "unsigned"),
        }
    }
}

#[test]
fn mistakes_are_errors_that_name_file_and_field_and_leave_no_copy() {
    let bench = Bench::plain();
    let photons = [[1.0, 0.0, 0.0, 1.0], [2.0, 0.0, 0.0, 7.0]];
    let plain = event_table(&photons);
    let two = "[[detector]]\nid = 1\nscale_arcsec = 1\ncentre = [0, 0]\nrotation_deg = 0\n\
               [[detector]]\nid = 2\nscale_arcsec = 1\ncentre = [0, 0]\nrotation_deg = 0\n";
    let in_file = |detectors: &str, table: Table, end: &str| {
        let error = bench.refusal(detectors, &[table]);
        assert!(
            error.contains("in.fits: ") && error.ends_with(end),
            "{error}"
        );
    };
    in_file(
        two,
        plain.clone(),
        "EVENTS, row 2: column DET_ID: expected the id of a detector (1, 2), found 7",
    );
    in_file(
        PLAIN,
        plain.clone().without("MJDREF"),
        "EVENTS: MJDREF: expected a day, here or in MJDREFI and MJDREFF, found none",
    );
    in_file(
        PLAIN,
        plain.clone().without("MJDREF").with("MJDREF", Text("soon")),
        "EVENTS: MJDREF: expected a finite number, found 'soon'",
    );
    in_file(
        PLAIN,
        plain.clone().with("TIMEUNIT", Text("weeks")),
        "EVENTS: TIMEUNIT: expected a unit of time (s, d, h, min, ms, us, ns), found 'weeks'",
    );
    for missing in ["TIME", "X", "Y"] {
        let mut table = plain.clone();
        table.column(missing).0 = "OTHER";
        in_file(
            PLAIN,
            table.clone(),
            &format!(
                "EVENTS: column {missing}: expected one of this name, found {} only",
                table
                    .columns
                    .iter()
                    .map(|column| column.0)
                    .collect::<Vec<_>>()
                    .join(", ")
            ),
        );
    }
    let mut vector = plain.clone();
    (vector.column("X").1, vector.column("X").3) = ("2D", vec![0.0; 4]);
    in_file(
        PLAIN,
        vector,
        "EVENTS: column X: expected one number in each row (B, I, J, K, E or D), found '2D'",
    );
    let mut twice = plain.clone();
    twice.columns.push(("hpx", "1D", "", vec![0.0; 2]));
    in_file(
        PLAIN,
        twice,
        "EVENTS: column hpx: expected none of this name, which is added, found one",
    );
    let mut unnamed = plain.clone();
    (unnamed.name, unnamed.column("TIME").0) = ("PHOTONS", "WHEN");
    in_file(
        PLAIN,
        unnamed,
        "in.fits: expected a table EVENTS, or one table with a column TIME, found 0 with one",
    );
    let mut interval = good_times("GTI", &[[0.0, 1.0]]);
    interval.column("STOP").0 = "END";
    write(&bench.at("in.fits"), &[], &[plain.clone(), interval]);
    let error = bench.place("in.fits", PLAIN, &()).unwrap_err().to_string();
    assert!(
        error.ends_with(
            "GTI: column STOP: expected one of this name, found START, END, WEIGHT only"
        ),
        "{error}"
    );

    for (detectors, end) in [
        (
            "",
            "det.toml: detector: expected one [[detector]] or more, found none",
        ),
        (
            &PLAIN.replace("scale_arcsec", "scale_arcsecs"),
            "det.toml: detector.0.scale_arcsecs: expected a known key (the nearest is \"detector.scale_arcsec\"), found an unknown key",
        ),
        (
            &PLAIN.replace("1.0", "-1.0"),
            "det.toml: detector.0.scale_arcsec: expected a number above 0, found -1",
        ),
        (
            &two.replace("id = 2", "id = 1"),
            "det.toml: detector.1.id: expected an id of its own for each detector, found 1 again",
        ),
        (
            &two.replace("id = 2\n", ""),
            "det.toml: detector.1.id: expected an id of its own for each detector, found none",
        ),
    ] {
        let error = bench.refusal(detectors, &[plain.clone()]);
        assert!(error.ends_with(end), "{error}");
    }
    fs::write(bench.at("in.fits"), "no FITS").unwrap();
    let error = bench.place("in.fits", PLAIN, &()).unwrap_err().to_string();
    assert!(
        error.contains("in.fits: expected a FITS file, found a file that begins with \"no FITS\""),
        "{error}"
    );
    let error = bench
        .place("none.fits", PLAIN, &())
        .unwrap_err()
        .to_string();
    assert!(error.contains("none.fits: expected"), "{error}");
    fs::remove_file(bench.at("pointing.fits")).unwrap();
    write(&bench.at("in.fits"), &[], &[plain]);
    let error = bench.place("in.fits", PLAIN, &()).unwrap_err().to_string();
    assert!(
        error.contains("pointing.fits: expected a refined flight's pointing.fits"),
        "{error}"
    );
}

/// The HDUs of a file: cards and data.
fn parts(path: &Path) -> Vec<(Vec<String>, Vec<u8>)> {
    let bytes = fs::read(path).unwrap();
    let mut file = open_disk_file(path, FileOpenMode::READONLY).unwrap();
    let (mut count, mut status) = (0, 0);
    unsafe { sys::ffthdu(file.as_raw(), &mut count, &mut status) };
    let mut part = |n| {
        let (mut kind, mut start, mut data, mut end) = (0, 0, 0, 0);
        unsafe {
            sys::ffmahd(file.as_raw(), n, &mut kind, &mut status);
            sys::ffghadll(file.as_raw(), &mut start, &mut data, &mut end, &mut status);
        }
        assert_eq!(status, 0);
        let cards = bytes[start as usize..data as usize].chunks(80);
        let cards = cards.map(|card| String::from_utf8(card.to_vec()).unwrap());
        let cards = cards.take_while(|card| card.trim_end() != "END");
        (cards.collect(), bytes[data as usize..end as usize].to_vec())
    };
    (1..=count).map(&mut part).collect()
}

/// A list with an image, a table of another kind with a heap, and photons with a heap of their own.
fn rich_file(path: &Path, photons: &[[f64; 4]]) {
    let heap = |name| Table {
        name,
        keys: vec![],
        columns: vec![
            ("N", "1J", "", vec![1.0, 2.0, 3.0]),
            ("V", "1PE", "", vec![]),
        ],
    };
    let mut events = event_table(photons);
    events.columns.insert(2, ("V", "1PI(3)", "", vec![]));
    events.columns.push(("LAST", "3A", "", vec![]));
    write(
        path,
        &[],
        &[
            heap("OTHER"),
            events,
            good_times("STDGTI01", &[[5.0, 25.5], [40.0, 99.0]]),
            heap("MORE"),
        ],
    );
    let mut file = FitsFile::edit(path).unwrap();
    let mut status = 0;
    for (table, column, rows) in [
        ("OTHER", 2, 3),
        ("EVENTS", 3, photons.len() as i64),
        ("MORE", 2, 3),
    ] {
        // fitsio knows no columns of arrays.
        unsafe {
            sys::ffmnhd(
                file.as_raw(),
                2,
                c(table).as_ptr().cast_mut(),
                0,
                &mut status,
            )
        };
        for row in 1..=rows {
            let mut values = vec![row as f64; (row % 4) as usize];
            let count = values.len() as i64;
            unsafe {
                sys::ffpcld(
                    file.as_raw(),
                    column,
                    row,
                    1,
                    count,
                    values.as_mut_ptr(),
                    &mut status,
                )
            };
        }
        unsafe {
            sys::ffphis(
                file.as_raw(),
                c("of the instrument's own program").as_ptr(),
                &mut status,
            );
            sys::ffpcks(file.as_raw(), &mut status);
        }
    }
    assert_eq!(status, 0);
}

#[test]
fn what_is_not_added_stays_byte_for_byte_and_checksums_are_right() {
    let bench = Bench::plain();
    let photons = some_photons(777, 1);
    rich_file(&bench.at("in.fits"), &photons);
    bench.place("in.fits", PLAIN, &()).unwrap();
    assert_sums(&bench.at("out.fits"));
    let (before, after) = (parts(&bench.at("in.fits")), parts(&bench.at("out.fits")));
    assert_eq!(before.len(), after.len());
    for n in [0, 1, 4] {
        assert!(before[n] == after[n], "HDU {n}");
    }
    let structural = |card: &&String| {
        let keyword = card[..8].trim_end();
        ["NAXIS1", "NAXIS2", "TFIELDS", "CHECKSUM", "DATASUM"].contains(&keyword)
    };
    for n in [2, 3] {
        let kept: Vec<&String> = before[n]
            .0
            .iter()
            .filter(|card| !structural(card))
            .collect();
        let mut left = after[n].0.iter();
        for card in kept {
            assert!(left.any(|found| found == card), "HDU {n}: {card}");
        }
    }
    let added: Vec<&String> = after[2]
        .0
        .iter()
        .filter(|card| !before[2].0.contains(card))
        .collect();
    let has = |text: &str| {
        assert!(
            added.iter().any(|card| card.contains(text)),
            "{text}: {added:#?}"
        )
    };
    for text in [
        "'HPX     '",
        "'HP_VALID'",
        "'arcsec  '",
        "HISTORY solaspect ",
        "helioprojective longitude",
    ] {
        has(text);
    }
    has(&solaspect::provenance::sha256_of_file(&bench.at("pointing.fits")).unwrap());

    // Rows are their old bytes with 33 more; the heap follows.
    let row = 8 + 2 + 8 + 8 + 8 + 1 + 3;
    let rows = |data: &[u8], bytes: usize| {
        data.chunks(bytes)
            .take(777)
            .map(|r| r[..row].to_vec())
            .collect::<Vec<_>>()
    };
    assert!(rows(&before[2].1, row) == rows(&after[2].1, row + 33));
    let heap = |data: &[u8], bytes: usize| data[777 * bytes..].to_vec();
    let (old, new) = (heap(&before[2].1, row), heap(&after[2].1, row + 33));
    let common = old.len().min(new.len());
    assert!(old[..common] == new[..common] && common > 1000);
    assert!(
        old.iter()
            .chain(&new)
            .skip(2 * common)
            .all(|byte| *byte == 0)
            || old.len() != new.len()
    );

    // The second interval ends with the flight, and keeps its other column.
    assert_eq!(
        column(&bench.at("out.fits"), "STDGTI01", "WEIGHT"),
        [100.0, 101.0]
    );
    let stops = column(&bench.at("out.fits"), "STDGTI01", "STOP");
    let ends = stops.map(|stop| stop + MIDNIGHT_S - START_S);
    assert!(
        (ends[0] - 25.5).abs() < 1e-6 && (ends[1] - SECONDS as f64).abs() < 1e-3,
        "{ends:?}"
    );
}

trait Map {
    fn map(self, f: impl Fn(f64) -> f64) -> Self;
}
impl Map for Vec<f64> {
    fn map(self, f: impl Fn(f64) -> f64) -> Self {
        self.into_iter().map(f).collect()
    }
}

#[test]
fn intervals_are_those_in_which_the_pointing_is_valid() {
    let history = troubled();
    let intervals = history.valid_intervals();
    assert!(
        intervals.windows(2).all(|pair| pair[0][1] < pair[1][0]),
        "{intervals:?}"
    );
    assert!(intervals.len() >= 5, "{intervals:?}");
    let step_s = 1.0 / 512.0;
    let mut differ_s = 0.0;
    for n in -512..(SECONDS as i64 + 2) * 512 {
        let unix_s = START_S + n as f64 * step_s;
        let is_inside = intervals
            .iter()
            .any(|[from, to]| (*from..=*to).contains(&unix_s));
        let is_valid = history.at(unix_s).is_valid();
        assert!(is_valid || !is_inside, "{}", unix_s - START_S);
        if is_valid && !is_inside {
            differ_s += step_s;
        }
    }
    assert!(differ_s < 0.01 * intervals.len() as f64, "{differ_s}");
}

#[test]
fn good_time_intervals_lie_inside_both_and_exposure_is_their_length() {
    let history = troubled();
    let bench = Bench::new(&history);
    let mut random = random(3);
    let photons: Vec<[f64; 4]> = (0..20_000)
        .map(|_| [random.random_range(-5.0..70.0), 0.0, 0.0, 1.0])
        .collect();
    let own = [[-3.0, 9.3], [12.5, 33.3], [34.0, 34.0], [37.25, 80.0]];
    let integers = |mut table: Table| {
        (table.column("START").1, table.column("STOP").1) = ("1J", "1J");
        table
            .with("TSCAL1", Number(0.25))
            .with("TSCAL2", Number(0.25))
    };
    for table in [
        good_times("GTI", &own),
        integers(good_times("STDGTI", &own)),
        good_times("STDGTI2", &own).without("MJDREF"),
    ] {
        let name = table.name;
        let (placed, columns) = bench.placed(PLAIN, &[], &[event_table(&photons), table]);
        let ends = |name_of: &str| {
            column(&bench.at("out.fits"), name, name_of).map(|time| time + MIDNIGHT_S - START_S)
        };
        let found: Vec<[f64; 2]> = ends("START")
            .into_iter()
            .zip(ends("STOP"))
            .map(|(a, b)| [a, b])
            .collect();
        let after_s: f64 = found.iter().map(|[from, to]| to - from).sum();
        let [
            Exposure {
                extension,
                before_s,
                after_s: stated_s,
            },
        ] = &placed.exposures[..]
        else {
            panic!("{placed:?}");
        };
        assert_eq!(extension, name);
        assert!(
            (before_s - 75.85).abs() < 0.3 && (stated_s - after_s).abs() < 1e-5,
            "{placed:?}"
        );
        let inside =
            |s: f64, all: &[[f64; 2]]| all.iter().any(|[from, to]| (*from..=*to).contains(&s));
        let mut lost = 0;
        for ([s, ..], valid) in photons.iter().zip(&columns.valid) {
            let is_inside = inside(*s, &found);
            assert!(
                !is_inside || (*valid && inside(*s, &own.map(|[a, b]| [a - 0.13, b + 0.13]))),
                "{name}: {s}"
            );
            lost += u32::from(*valid && inside(*s, &own) && !is_inside);
        }
        // Only ends in quarters of a second lose time.
        assert!(
            lost < if name == "STDGTI" { 900 } else { 20 },
            "{name}: {lost}"
        );
    }
}

#[test]
fn a_file_without_good_time_intervals_gets_them() {
    let history = troubled();
    let bench = Bench::new(&history);
    let photons: Vec<[f64; 4]> = (0..700)
        .map(|n| [n as f64 * 0.1 - 5.0, 0.0, 0.0, 1.0])
        .collect();
    let table = event_table(&photons).with("TIMEZERO", Number(0.0));
    let (placed, columns) = bench.placed(PLAIN, &[], &[table.clone()]);
    let starts = column(&bench.at("out.fits"), "GTI", "START");
    let stops = column(&bench.at("out.fits"), "GTI", "STOP");
    for ([s, ..], valid) in photons.iter().zip(&columns.valid) {
        let time = s + START_S - MIDNIGHT_S;
        let is_inside = starts
            .iter()
            .zip(&stops)
            .any(|(from, to)| (*from..=*to).contains(&time));
        assert_eq!(is_inside, *valid, "{s}");
    }
    assert!((placed.exposures[0].before_s - 69.9).abs() < 1e-3);
    let cards = &parts(&bench.at("out.fits"))[2].0;
    for keyword in ["MJDREF  =", "TIMESYS =", "TIMEZERO="] {
        assert!(
            cards.iter().any(|card| card.starts_with(keyword)),
            "{keyword} {cards:#?}"
        );
    }
    let stated = table
        .with("TSTART", Number(64_801.0))
        .with("TSTOP", Number(64_802.5));
    let (placed, _) = bench.placed(PLAIN, &[], &[stated]);
    assert_eq!(placed.exposures[0].before_s, 1.5);
}

#[test]
fn names_with_brackets_and_gzipped_lists_are_files_like_others() {
    let bench = Bench::plain();
    let photons = some_photons(50, 1);
    write(&bench.at("in.fits"), &[], &[event_table(&photons)]);
    bench.place("in.fits", PLAIN, &()).unwrap();
    let expected = fs::read(bench.at("out.fits")).unwrap();
    let plain = fs::read(bench.at("in.fits")).unwrap();
    for name in [
        "a[1].fits",
        "a[col X=1].fits",
        "!in.fits",
        "in.fits(new.fits)",
    ] {
        fs::write(bench.at(name), &plain).unwrap();
        bench.place(name, PLAIN, &()).unwrap();
        assert!(
            fs::read(bench.at("out.fits")).unwrap() == expected,
            "{name}"
        );
    }
    let mut packed = flate2::write::GzEncoder::new(
        fs::File::create(bench.at("in.fits.gz")).unwrap(),
        flate2::Compression::fast(),
    );
    packed.write_all(&plain).unwrap();
    packed.finish().unwrap();
    bench.place("in.fits.gz", PLAIN, &()).unwrap();
    assert!(fs::read(bench.at("out.fits")).unwrap() == expected);
    let whole = fs::read(bench.at("in.fits.gz")).unwrap();
    fs::write(bench.at("cut.fits.gz"), &whole[..whole.len() - 20]).unwrap();
    let error = bench
        .place("cut.fits.gz", PLAIN, &())
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("cut.fits.gz: expected a whole gzip file"),
        "{error}"
    );
    // What stood there stays when a run fails.
    assert!(fs::read(bench.at("out.fits")).unwrap() == expected);
}

#[test]
fn no_file_that_is_read_is_overwritten() {
    let bench = Bench::plain();
    write(
        &bench.at("in.fits"),
        &[],
        &[event_table(&some_photons(5, 1))],
    );
    fs::write(bench.at("det.toml"), PLAIN).unwrap();
    fs::hard_link(bench.at("in.fits"), bench.at("link.fits")).unwrap();
    for out in ["in.fits", "link.fits", "det.toml", "pointing.fits"] {
        let before = fs::read(bench.at(out)).unwrap();
        let files = Files {
            refined: bench.folder.path(),
            events: &bench.at("in.fits"),
            detectors: &bench.at("det.toml"),
            out: &bench.at(out),
        };
        let error = place_photons(files, &()).unwrap_err();
        assert!(matches!(error, EventsError::Overwrites { .. }), "{error}");
        assert!(fs::read(bench.at(out)).unwrap() == before, "{out}");
    }
}

#[test]
fn photons_of_garbage_are_counted_by_reason_and_never_panic() {
    let history = troubled();
    let bench = Bench::new(&history);
    let mut random = random(4);
    let mut garbage = |scale: f64| match random.random_range(0..12) {
        0 => f64::NAN,
        1 => f64::INFINITY,
        2 => f64::NEG_INFINITY,
        3 => 1e300,
        4 => -1e300,
        5 => f64::MIN_POSITIVE,
        6 => f64::from_bits(random.random()),
        _ => random.random_range(-0.2..1.2) * scale,
    };
    let photons: Vec<[f64; 4]> = (0..100_000)
        .map(|_| [garbage(SECONDS as f64), garbage(300.0), garbage(300.0), 1.0])
        .collect();
    for (scale, ahead_s) in [("UTC", 0.0), ("TT", 67.184)] {
        let table = event_table(&photons)
            .without("TIMESYS")
            .with("TIMESYS", Text(scale))
            .with("TIMEZERO", Number(ahead_s));
        let (placed, columns) = bench.placed(
            PLAIN,
            &[],
            &[
                table,
                good_times(
                    "GTI",
                    &[[f64::NAN, 3.0], [f64::NEG_INFINITY, f64::INFINITY]],
                ),
            ],
        );
        let invalid: u64 = placed.invalid.values().sum();
        assert_eq!((placed.photons, placed.valid + invalid), (100_000, 100_000));
        for why in [
            "no time",
            "no position",
            "extrapolated",
            "gap",
            "contradicted",
            "slew",
            "uncertain",
        ] {
            assert!(placed.invalid.get(why) > Some(&100), "{why}: {placed:?}");
        }
        for ((hp, valid), sigma) in columns.hp.iter().zip(&columns.valid).zip(&columns.sigma) {
            let is_known = hp[0].is_finite() && hp[1].is_finite() && sigma.is_finite();
            assert!(is_known || !valid, "{hp:?} {sigma}");
        }
        let counted = columns.valid.iter().filter(|valid| **valid).count() as u64;
        assert_eq!(counted, placed.valid);
    }
}

struct Impatient;

impl Watch for Impatient {
    fn is_cancelled(&self) -> bool {
        true
    }
}

#[test]
fn a_run_that_is_cancelled_leaves_nothing() {
    let bench = Bench::plain();
    write(
        &bench.at("in.fits"),
        &[],
        &[event_table(&some_photons(2000, 1))],
    );
    let error = bench.place("in.fits", PLAIN, &Impatient).unwrap_err();
    assert!(matches!(error, EventsError::Cancelled { .. }), "{error}");
    assert_eq!(
        fs::read_dir(bench.folder.path()).unwrap().count(),
        3,
        "pointing, list and detectors"
    );
}

/// Peak memory of this process, MB.
fn peak_mb() -> f64 {
    let status = fs::read_to_string("/proc/self/status").unwrap();
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:"))
        .unwrap();
    line.trim()
        .trim_end_matches(" kB")
        .trim()
        .parse::<f64>()
        .unwrap()
        / 1024.0
}

/// How fast it is, and how much memory it takes: `cargo test --release --test promises -- --ignored --nocapture ten_million`.
#[test]
#[ignore = "measures ten million photons, which takes a minute"]
fn ten_million_photons_take_less_than_a_minute_and_no_more_memory_than_few() {
    let bench = Bench::new(&troubled());
    let run = |photons: &[[f64; 4]]| {
        write(
            &bench.at("in.fits"),
            &[],
            &[event_table(photons), good_times("GTI", &[[0.0, 60.0]])],
        );
    };
    run(&some_photons(10_000_000, 1));
    // The list was made in memory; what the run itself takes is counted from here on.
    fs::write("/proc/self/clear_refs", "5").unwrap();
    let (before_mb, start) = (peak_mb(), Instant::now());
    let placed = bench.place("in.fits", PLAIN, &()).unwrap();
    let (seconds, grown_mb) = (start.elapsed().as_secs_f64(), peak_mb() - before_mb);
    println!(
        "{} photons in {seconds:.1} s, {grown_mb:.1} MB",
        placed.photons
    );
    assert!(
        seconds < 60.0 && grown_mb < 64.0,
        "{seconds} s, {grown_mb} MB"
    );
}

#[test]
fn the_command_says_how_many_photons_are_valid_and_why_the_others_are_not() {
    let bench = Bench::new(&troubled());
    let photons: Vec<[f64; 4]> = (0..60).map(|n| [n as f64 + 0.4, 0.0, 0.0, 1.0]).collect();
    write(
        &bench.at("in.fits"),
        &[],
        &[event_table(&photons), good_times("GTI", &[[0.0, 60.0]])],
    );
    fs::write(bench.at("det.toml"), PLAIN).unwrap();
    let run = |events: &str| {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_solaspect"));
        command.current_dir(bench.folder.path());
        command.args([
            "events",
            ".",
            events,
            "--detectors",
            "det.toml",
            "--out",
            "out.fits",
        ]);
        command.output().unwrap()
    };
    let output = run("in.fits");
    let text = String::from_utf8(output.stdout).unwrap();
    assert_eq!(output.status.code(), Some(0), "{text}");
    for line in [
        "60 photons, ",
        " not valid: gap",
        " not valid: slew",
        "GTI: 60.000 s, ",
    ] {
        assert!(text.contains(line), "{text}");
    }
    let output = run("none.fits");
    assert_eq!(output.status.code(), Some(1));
    assert!(
        String::from_utf8(output.stderr)
            .unwrap()
            .contains("none.fits: expected")
    );
}

#[test]
fn a_direction_is_taken_in_the_plane_that_touches_the_sky() {
    // Far from the boresight the plane's angle is the tangent's.
    let photons = [[0.0, 20_000.0, 0.0, 1.0]];
    let (_, columns) = Bench::plain().placed(PLAIN, &[], &[event_table(&photons)]);
    let axis = UnitVector3::new_normalize(attitude(START_S) * Vector3::x());
    let [x, y] = columns.hp[0].map(|arcsec| arcsec * ARCSEC);
    let towards = Vector3::new(x.cos() * y.cos(), -x.sin() * y.cos(), y.sin());
    assert!((axis.dot(&towards).acos().tan() - 20_000.0 * ARCSEC).abs() < 1e-9);
}
