//! Photons are drawn from a known picture of the Sun during an hour of slews and swings: the reconstructed image agrees
//! with it, and its exposure map is the time for which the field covered each pixel.

use super::flight::{ARCSEC, START_S, level};
use super::lists::*;
use crate::common::sun_picture::{SunImage, SunPicture};
use nalgebra::{UnitQuaternion, Vector3};
use rand::RngExt;
use solaspect::pointing_history::{Basis, PointingHistory, Second, State};
use std::f64::consts::TAU;
use std::path::Path;

const HOUR_S: f64 = 3600.0;
const STATE_HZ: usize = 10;
/// Solar radius by the ephemeris on that day.
const RADIUS_ARCSEC: f64 = 955.6;

/// A rotated detector with pixels of 2 arcsec and a field of 1600 arcsec a side.
const TILTED: &str = "[[detector]]\nscale_arcsec = 2.0\ncentre = [400.0, 400.0]\nrotation_deg = 33.3\noffset_arcsec = [12.0, -8.0]\n\
                      field = [[0, 800], [0, 800]]\n";
/// Side of the field, px.
const FIELD: f64 = 800.0;

/// Six positions on and near the disc, ten minutes each; a slew takes the last 2 s.
fn boresight_arcsec(s: f64) -> [f64; 2] {
    const PLACES: [[f64; 2]; 7] = [
        [0.0, 0.0],
        [500.0, 300.0],
        [-450.0, 380.0],
        [-500.0, -400.0],
        [480.0, -420.0],
        [30.0, 550.0],
        [0.0, 0.0],
    ];
    let place = ((s / 600.0).max(0.0) as usize).min(5);
    let part = ((s - 600.0 * place as f64 - 598.0) / 2.0).clamp(0.0, 1.0);
    let part = (1.0 - (part * TAU / 2.0).cos()) / 2.0;
    let swing = [
        60.0 * (s * TAU / 17.0).sin(),
        45.0 * (s * TAU / 21.0 + 1.0).sin(),
    ];
    [0, 1].map(|axis| {
        let [from, to] = [PLACES[place][axis], PLACES[place + 1][axis]];
        from + (to - from) * part + swing[axis]
    })
}

/// The attitude, with west along -y and north along z: the telescope rolls slowly and swings about its boresight.
fn attitude(s: f64) -> UnitQuaternion<f64> {
    let [x, y] = boresight_arcsec(s).map(|arcsec| arcsec * ARCSEC);
    let towards = Vector3::new(x.cos() * y.cos(), -x.sin() * y.cos(), y.sin());
    let point = UnitQuaternion::rotation_between(&Vector3::x(), &towards).unwrap();
    let roll_rad = 0.3 + 2e-5 * s + 0.01 * (s * TAU / 13.0).sin();
    point * level() * UnitQuaternion::from_scaled_axis(Vector3::x() * roll_rad)
}

fn history() -> PointingHistory {
    let mut random = random(7);
    let state = |n: usize| {
        let s = n as f64 / STATE_HZ as f64;
        let turned = attitude(s - 1e-3).inverse() * attitude(s + 1e-3);
        // Each state has a random error of its stated sigma.
        let error = Vector3::from_fn(|_, _| 0.2 * ARCSEC * normal(&mut random));
        State {
            unix_s: START_S + s,
            attitude: attitude(s) * UnitQuaternion::from_scaled_axis(error),
            rate_rad_s: turned.scaled_axis() / 2e-3,
            covariance_rad2: nalgebra::Matrix3::identity() * (0.2 * ARCSEC).powi(2),
            basis: Basis::Both,
            is_contradicted: false,
        }
    };
    let states = (0..=HOUR_S as usize * STATE_HZ).map(state).collect();
    let second = |n: i64| Second {
        unix_s: START_S as i64 + n,
        position_m: Vector3::new(6.4e6, 0.0, 0.0),
        to_sun: Vector3::x_axis(),
        north: Vector3::z_axis(),
        systematic_rad2: nalgebra::Matrix3::zeros(),
    };
    PointingHistory::new(states, (-1..=HOUR_S as i64 + 1).map(second).collect())
}

/// Position on the detector, px, of a direction given in arcsec from the Sun's centre.
fn on_detector(attitude: &UnitQuaternion<f64>, [x, y]: [f64; 2]) -> [f64; 2] {
    let [x, y] = [x, y].map(|arcsec| arcsec * ARCSEC);
    let towards = Vector3::new(x.cos() * y.cos(), -x.sin() * y.cos(), y.sin());
    let seen = attitude.inverse_transform_vector(&towards);
    let (right, up) = (
        seen.y / seen.x / ARCSEC - 12.0,
        -seen.z / seen.x / ARCSEC + 8.0,
    );
    let (sin, cos) = 33.3_f64.to_radians().sin_cos();
    [
        (right * cos + up * sin) / 2.0 + 400.0,
        (up * cos - right * sin) / 2.0 + 400.0,
    ]
}

fn is_in_field(place: [f64; 2]) -> bool {
    place.iter().all(|along| (0.0..FIELD).contains(along))
}

pub fn read(path: &Path) -> SunImage {
    let number = |keyword| read_number(path, "COUNTS", keyword);
    assert_eq!([number("CRVAL1"), number("CRVAL2")], [0.0; 2]);
    SunImage {
        width: number("NAXIS1") as usize,
        pixel_arcsec: number("CDELT1"),
        centre_px: [number("CRPIX1") - 1.0, number("CRPIX2") - 1.0],
        counts: read_image(path, "COUNTS"),
        exposure_s: read_image(path, "EXPOSURE"),
    }
}

#[test]
fn a_known_picture_of_the_sun_comes_back_where_it_was() {
    const PHOTONS: usize = 2_000_000;
    let picture = SunPicture::of_radius(RADIUS_ARCSEC);
    let mut random = random(11);
    let mut photons = Vec::with_capacity(PHOTONS);
    while photons.len() < PHOTONS {
        let s = random.random_range(0.0..HOUR_S);
        let at = on_detector(&attitude(s), picture.draw(&mut random));
        if is_in_field(at) {
            photons.push([s, at[0], at[1], 1.0]);
        }
    }
    let bench = Bench::new(&history());
    let good = good_times("GTI", &[[100.0, 1800.0], [1801.0, 3500.0]]);
    let placed = bench
        .image(TILTED, &[event_table(&photons), good], &bench.request())
        .unwrap();
    let imaged = placed.image.unwrap();
    let is_good = |s: f64| (100.0..=1800.0).contains(&s) || (1801.0..=3500.0).contains(&s);
    let good = photons.iter().filter(|[s, ..]| is_good(*s)).count() as u64;
    // The five slews of 2 s have less than 10 s in which the telescope moves too fast.
    assert!(
        imaged.photons < good && good - imaged.photons < PHOTONS as u64 / 300,
        "{good}, {imaged:?}"
    );
    assert!((imaged.live_s - 3390.0).abs() < 5.0, "{imaged:?}");
    assert_eq!(
        imaged.photons + imaged.invalid + imaged.outside + imaged.unplaced,
        PHOTONS as u64
    );
    assert_sums(&bench.at("image.fits"));
    let found = read(&bench.at("image.fits")).registered(&picture);
    println!("{found:?}");
    found.assert_close();
}

#[test]
fn exposure_is_the_live_time_for_which_the_field_was_there() {
    let history = history();
    let bench = Bench::new(&history);
    let good = good_times("GTI", &[[50.0, 700.0]]).with("DEADC", Key::Number(0.8));
    bench
        .image(
            TILTED,
            &[event_table(&[[60.0, 1.0, 1.0, 1.0]]), good],
            &bench.request(),
        )
        .unwrap();
    let image = read(&bench.at("image.fits"));
    let valid = history.valid_intervals();
    let step_s = 0.01;
    let mut random = random(3);
    for _ in 0..40 {
        let n = random.random_range(0..image.exposure_s.len());
        let px = [(n % image.width) as f64, (n / image.width) as f64];
        let place = [0, 1].map(|axis| (px[axis] - image.centre_px[axis]) * image.pixel_arcsec);
        let seen = (5000..70_000).filter(|n| {
            let s = f64::from(*n) * step_s;
            is_in_field(on_detector(&attitude(s), place))
                && valid
                    .iter()
                    .any(|[from, to]| (*from..=*to).contains(&(START_S + s)))
        });
        let expected_s = 0.8 * step_s * seen.count() as f64;
        let found_s = image.exposure_s[n];
        // A pixel crossed by the field's edge has the mean exposure of both sides.
        assert!(
            (found_s - expected_s).abs() < 0.02 * expected_s + 2.0,
            "{place:?}: {found_s}, expected {expected_s}"
        );
    }
}
