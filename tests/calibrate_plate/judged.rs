//! What was measured, held against the truth.

use nalgebra::Vector2;
use solaspect::calibrate::plate::{Calibration, MeasuredMark};
use solaspect::geometry::Distortion;
use solaspect::instrument::Instrument;
use solaspect::units::SensorPx;

/// Root mean square error per axis (mil) and error over sigma, the common shift, rotation and scale removed.
pub fn errors(marks: &[&MeasuredMark], truth: &Instrument) -> (f64, f64) {
    let n = marks.len() as f64;
    let middle: Vector2<f64> = marks
        .iter()
        .map(|m| m.position.vector())
        .sum::<Vector2<f64>>()
        / n;
    let error = |m: &MeasuredMark| m.position.vector() - truth.plate.position(m.id).vector();
    let shift = marks.iter().map(|m| error(m)).sum::<Vector2<f64>>() / n;
    let (mut size, mut scale, mut turn) = (0.0, 0.0, 0.0);
    for mark in marks {
        let (from, e) = (mark.position.vector() - middle, error(mark));
        size += from.norm_squared();
        scale += from.dot(&e);
        turn += from.x * e.y - from.y * e.x;
    }
    let (scale, turn) = (scale / size, turn / size);
    let (mut squares, mut normalised) = (0.0, 0.0);
    for mark in marks {
        let from = mark.position.vector() - middle;
        let across = Vector2::new(-from.y, from.x);
        let left = error(mark) - shift - from * scale - across * turn;
        squares += left.norm_squared();
        normalised += (left.x / mark.sigma_mil[0]).powi(2) + (left.y / mark.sigma_mil[1]).powi(2);
    }
    (
        (squares / (2.0 * n)).sqrt(),
        (normalised / (2.0 * n)).sqrt(),
    )
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
