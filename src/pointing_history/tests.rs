use super::*;
use crate::units::ARCSEC_PER_RAD;
use nalgebra::{Matrix3, UnitQuaternion, UnitVector3, Vector3};
use std::f64::consts::TAU;

const AT_M: [f64; 3] = [-1_302_000.0, -5_137_000.0, 3_617_000.0];
const SUN: [f64; 3] = [-0.31, -0.62, 0.72];

/// A telescope that swings by 100 arcsec with periods of about a second in pitch and yaw, and by a degree within ten seconds in roll.
fn attitude(unix_s: f64) -> UnitQuaternion<f64> {
    let swing = |period_s: f64, phase: f64| (TAU * unix_s / period_s + phase).sin();
    let arcsec = 100.0 / ARCSEC_PER_RAD;
    UnitQuaternion::from_euler_angles(0.3, 0.4, 0.5)
        * UnitQuaternion::from_scaled_axis(Vector3::new(
            1f64.to_radians() * swing(10.0, 0.0),
            arcsec * swing(1.0, 1.0),
            arcsec * swing(1.3, 2.0),
        ))
}

fn state(unix_s: f64) -> State {
    let instant_s = 1e-4;
    let turned = attitude(unix_s - instant_s).inverse() * attitude(unix_s + instant_s);
    State {
        unix_s,
        attitude: attitude(unix_s),
        rate_rad_s: turned.scaled_axis() / (2.0 * instant_s),
        covariance_rad2: Matrix3::identity() * 1e-12,
        basis: Basis::Both,
        is_contradicted: false,
    }
}

fn second(unix_s: i64) -> Second {
    let to_sun = UnitVector3::new_normalize(Vector3::from(SUN));
    let north = Vector3::z() - to_sun.into_inner() * to_sun.z;
    Second {
        unix_s,
        position_m: AT_M.into(),
        to_sun,
        north: UnitVector3::new_normalize(north),
        systematic_rad2: Matrix3::zeros(),
    }
}

fn history(states: impl Iterator<Item = f64>) -> PointingHistory {
    PointingHistory::new(states.map(state).collect(), (0..20).map(second).collect())
}

/// The angle between the found attitude and the true one, arcsec.
fn off_arcsec(history: &PointingHistory, unix_s: f64) -> f64 {
    let line_of_sight = history.at(unix_s).line_of_sight.unwrap();
    let axes = history.seconds.at(unix_s).unwrap().sun;
    let found = axes * line_of_sight.sun_from_telescope;
    let truth = attitude(unix_s).to_rotation_matrix();
    // For a small rotation the angle is the norm of the difference over the square root of 2.
    (found - truth.matrix()).norm() / 2f64.sqrt() * ARCSEC_PER_RAD
}

#[test]
fn between_states_a_swing_of_a_second_is_followed_to_a_twentieth_of_an_arcsecond() {
    let history = history((0..150).map(|n| f64::from(n) * 0.1));
    for n in 0..1000 {
        let off = off_arcsec(&history, 0.0123 + f64::from(n) * 0.0131);
        assert!(off < 0.05, "{off}");
    }
    // At a state it equals the state's.
    assert!(off_arcsec(&history, 0.7) < 1e-6);
    assert!(history.at(14.9).line_of_sight.is_some());
}

#[test]
fn where_nothing_is_known_it_says_why() {
    let before_gap = (0..50).map(|n| f64::from(n) * 0.1);
    let behind_gap = (80..120).map(|n| f64::from(n) * 0.1);
    let mut history = history(before_gap.chain(behind_gap));
    let why = |history: &PointingHistory, unix_s: f64| history.at(unix_s).invalid;
    assert_eq!(why(&history, -0.1), Some(Invalid::Extrapolated));
    assert_eq!(why(&history, 11.91), Some(Invalid::Extrapolated));
    assert_eq!(why(&history, f64::NAN), Some(Invalid::Extrapolated));
    assert_eq!(why(&history, 6.0), Some(Invalid::Gap));
    assert_eq!(why(&history, 4.0), Some(Invalid::Slew));
    history.limits.fastest_arcsec_per_s = 1e4;
    assert_eq!(why(&history, 4.0), None);
    history.limits.most_sigma_arcsec = 0.1;
    assert_eq!(why(&history, 4.0), Some(Invalid::Uncertain));
    history.contradict([3.95, 4.05]);
    assert_eq!(why(&history, 4.0), Some(Invalid::Contradicted));
    assert!(history.at(4.0).line_of_sight.is_some());
}

#[test]
fn what_is_stored_comes_back_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    let mut stored = history((0..100).map(|n| f64::from(n) * 0.1));
    stored.contradict([2.0, 3.0]);
    stored.write(folder.path(), &[]).unwrap();
    let read = PointingHistory::read(folder.path()).unwrap();
    for n in 0..990 {
        let unix_s = f64::from(n) * 0.01;
        let [a, b] = [&stored, &read].map(|history| history.at(unix_s));
        let angle = |pointed: Pointed| pointed.line_of_sight.unwrap().helioprojective_arcsec;
        // Reading normalises the quaternions again.
        assert!((angle(a).x - angle(b).x).abs() < 1e-8, "{a:?} {b:?}");
        assert_eq!(a.invalid, b.invalid);
    }
    let missing = PointingHistory::read(&folder.path().join("none")).unwrap_err();
    assert!(missing.to_string().contains("pointing.fits"), "{missing}");
}
