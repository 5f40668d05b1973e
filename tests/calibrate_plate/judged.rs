//! Measurements compared with the truth.

use nalgebra::Vector2;
use solaspect::calibrate::plate::{Calibration, MeasuredMark};
use solaspect::geometry::Distortion;
use solaspect::instrument::Instrument;
use solaspect::units::SensorPx;

/// Root mean square error per axis (mil) and error over sigma, after removal of the common shift, rotation and scale.
pub fn errors(marks: &[&MeasuredMark], truth: &Instrument) -> (f64, f64) {
    let axes = 2.0 * marks.len() as f64;
    let left = own_errors(marks, truth);
    let squares: f64 = left.iter().map(|error| error.norm_squared()).sum();
    let normalised: f64 = sigmas_off(marks, &left).map(|sigmas| sigmas.powi(2)).sum();
    ((squares / axes).sqrt(), (normalised / axes).sqrt())
}

/// The largest error of a mark in an axis over its sigma, after removal of the common shift, rotation and scale.
pub fn worst(marks: &[&MeasuredMark], truth: &Instrument) -> f64 {
    let left = own_errors(marks, truth);
    sigmas_off(marks, &left).fold(0.0, |worst, sigmas| worst.max(sigmas.abs()))
}

/// Errors in both axes over their sigmas.
fn sigmas_off(marks: &[&MeasuredMark], errors: &[Vector2<f64>]) -> impl Iterator<Item = f64> {
    let pairs = marks.iter().zip(errors);
    pairs.flat_map(|(mark, error)| [error.x / mark.sigma_mil[0], error.y / mark.sigma_mil[1]])
}

/// Error of each mark, mil, after removal of the common shift, rotation and scale.
fn own_errors(marks: &[&MeasuredMark], truth: &Instrument) -> Vec<Vector2<f64>> {
    let n = marks.len() as f64;
    let middle = marks
        .iter()
        .map(|m| m.position.vector())
        .sum::<Vector2<f64>>()
        / n;
    let place = |m: &MeasuredMark| truth.plate.position(m.id).unwrap();
    let error = |m: &MeasuredMark| m.position.vector() - place(m).vector();
    let shift = marks.iter().map(|m| error(m)).sum::<Vector2<f64>>() / n;
    let (mut size, mut scale, mut turn) = (0.0, 0.0, 0.0);
    for mark in marks {
        let (from, e) = (mark.position.vector() - middle, error(mark));
        size += from.norm_squared();
        scale += from.dot(&e);
        turn += from.x * e.y - from.y * e.x;
    }
    let (scale, turn) = (scale / size, turn / size);
    let left = marks.iter().map(|mark| {
        let from = mark.position.vector() - middle;
        let across = Vector2::new(-from.y, from.x);
        error(mark) - shift - from * scale - across * turn
    });
    left.collect()
}

pub fn seen_often(calibration: &Calibration, least: usize) -> Vec<&MeasuredMark> {
    let marks = calibration.fit.marks.iter();
    marks.filter(|mark| mark.observations >= least).collect()
}

/// Root mean square difference of two lenses within 500 px of the sensor's middle, px per axis.
pub fn lens_difference(a: &Distortion, b: &Distortion) -> f64 {
    let places = (-5..=5).flat_map(|x| (-5..=5).map(move |y| (x, y)));
    let places: Vec<SensorPx> = places
        .map(|(x, y)| SensorPx::new(647.5 + 70.0 * f64::from(x), 482.5 + 70.0 * f64::from(y)))
        .collect();
    let squares = places
        .iter()
        .map(|p| a.distort(*p).distance(b.distort(*p)).powi(2));
    (squares.sum::<f64>() / (2 * places.len()) as f64).sqrt()
}
