//! Changes from one instrument to another, in arcsec on the sky; those of a rotation or a scale in arcsec at the plate's edge.

mod sensor;

pub use sensor::{Renewed, SensorChange};

use crate::calibrate::numbers::median;
use crate::instrument::Instrument;
use crate::plate::MarkId;
use crate::units::{PlateMil, SensorPx};
use nalgebra::Vector2;
use serde::Serialize;
use std::fmt;

/// A change of position.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Shift {
    /// Shift along x and y, in the unit of the quantity.
    pub by: [f64; 2],
    pub arcsec: f64,
}

/// A rotation or a stretch about the plate's centre.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Turn {
    pub before: f64,
    pub after: f64,
    /// Displacement at the plate's edge.
    pub edge_arcsec: f64,
}

/// The marks' displacements.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MarksMoved {
    /// Marks whose position differs from the drawing.
    pub measured_before: usize,
    pub measured_after: usize,
    /// Marks whose position changed.
    pub moved: usize,
    /// Root mean square displacement of these per axis.
    pub rms_mil: f64,
    pub rms_arcsec: f64,
    pub largest: Option<LargestMove>,
    /// Median of the marks' sigmas.
    pub sigma_before_mil: f64,
    pub sigma_after_mil: f64,
}

/// The mark that moved most.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct LargestMove {
    pub id: [i32; 2],
    pub mil: f64,
    pub arcsec: f64,
}

/// Change of the lens's displacement of positions on the sensor.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct LensChange {
    /// The largest change at a corner of the sensor.
    pub corner_px: f64,
    /// Root mean square change over the whole sensor, per axis.
    pub rms_px: f64,
    pub corner_arcsec: f64,
}

/// Changes from one instrument to another.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    pub from: String,
    pub to: String,
    /// Distance of the plate's edge from its centre; see [`Plate::edge_mil`](crate::plate::Plate::edge_mil).
    pub edge_mil: f64,
    pub marks: MarksMoved,
    pub lens: LensChange,
    /// Sensor position of the plate's centre, px.
    pub plate_centre_px: Shift,
    pub scale_mil_per_px: Turn,
    pub rotation_deg: Turn,
    pub boresight_mil: Shift,
    pub clocking_deg: Turn,
    pub roll_deg: Turn,
    /// Conventions for directions on the plate.
    pub directions: [&'static str; 2],
    /// A plate farther away makes every offset smaller.
    pub plate_distance_mm: Turn,
    pub blur_px: [f64; 2],
    pub sensor: SensorChange,
}

/// Compares instrument `b` with its predecessor `a`.
pub fn compare(a: &Instrument, b: &Instrument) -> Comparison {
    let edge_mil = b.plate.edge_mil();
    let arcsec_per_mil = b.optics.arcsec_per_mil();
    let edge_arcsec = edge_mil * arcsec_per_mil;
    let arcsec_per_px = b.mounting.scale_mil_per_px.value * arcsec_per_mil;
    let (ma, mb) = (&a.mounting, &b.mounting);
    let stretched = |before: f64, after: f64| Turn {
        before,
        after,
        edge_arcsec: (after / before - 1.0).abs() * edge_arcsec,
    };
    let turned = |before: f64, after: f64| {
        let turn = (after - before + 180.0).rem_euclid(360.0) - 180.0;
        Turn {
            before,
            after,
            edge_arcsec: 2.0 * (turn.to_radians() / 2.0).sin().abs() * edge_arcsec,
        }
    };
    let shifted = |by: Vector2<f64>, arcsec: f64| Shift {
        by: by.into(),
        arcsec: by.norm() * arcsec,
    };
    Comparison {
        from: a.name.clone(),
        to: b.name.clone(),
        edge_mil,
        marks: marks_moved(a, b, arcsec_per_mil),
        lens: lens_change(a, b, arcsec_per_px),
        plate_centre_px: shifted(
            mb.plate_centre_px.vector() - ma.plate_centre_px.vector(),
            arcsec_per_px,
        ),
        scale_mil_per_px: stretched(ma.scale_mil_per_px.value, mb.scale_mil_per_px.value),
        rotation_deg: turned(ma.rotation_deg.value, mb.rotation_deg.value),
        boresight_mil: shifted(
            mb.boresight_mil.vector() - ma.boresight_mil.vector(),
            arcsec_per_mil,
        ),
        clocking_deg: turned(ma.clocking_deg.value, mb.clocking_deg.value),
        roll_deg: turned(ma.roll_deg.value, mb.roll_deg.value),
        directions: [ma.directions.name(), mb.directions.name()],
        plate_distance_mm: stretched(
            a.optics.plate_distance_mm.value,
            b.optics.plate_distance_mm.value,
        ),
        blur_px: [a.optics.blur_px.value, b.optics.blur_px.value],
        sensor: sensor::change(a, b),
    }
}

fn marks_moved(a: &Instrument, b: &Instrument, arcsec_per_mil: f64) -> MarksMoved {
    let measured = |i: &Instrument| {
        let drawn = i.plate.drawn_marks().zip(i.plate.marks());
        drawn.filter(|(drawn, is)| drawn != is).count()
    };
    let moves = || {
        let moved = |(id, at): (MarkId, PlateMil)| Some((id, a.plate.position(id)?.distance(at)));
        let moves = b.plate.marks().filter_map(moved);
        moves.filter(|(_, mil)| *mil > 0.0)
    };
    let moved = moves().count();
    // Start from 0: an empty sum is -0.
    let squares = moves().fold(0.0, |sum, (_, mil)| sum + mil * mil);
    let rms_mil = (squares / (2 * moved).max(1) as f64).sqrt();
    let largest = moves().max_by(|x, y| x.1.total_cmp(&y.1));
    MarksMoved {
        measured_before: measured(a),
        measured_after: measured(b),
        moved,
        rms_mil,
        rms_arcsec: rms_mil * arcsec_per_mil,
        largest: largest.map(|(id, mil)| LargestMove {
            id: [id.i, id.j],
            mil,
            arcsec: mil * arcsec_per_mil,
        }),
        sigma_before_mil: median_sigma(a),
        sigma_after_mil: median_sigma(b),
    }
}

fn median_sigma(instrument: &Instrument) -> f64 {
    let plate = &instrument.plate;
    let places = plate.marks().filter_map(|(id, _)| plate.place(id));
    median(places.flat_map(|place| place.sigma_mil))
}

fn lens_change(a: &Instrument, b: &Instrument, arcsec_per_px: f64) -> LensChange {
    const PLACES: i32 = 16;
    let right = (b.camera.width_px - 1) as f64;
    let bottom = (b.camera.height_px - 1) as f64;
    let change = |x: f64, y: f64| {
        let at = SensorPx::new(x * right, y * bottom);
        let moved = |i: &Instrument| i.camera.distortion.distort(at);
        moved(a).distance(moved(b))
    };
    let part = |n: i32| f64::from(n) / f64::from(PLACES);
    let corners = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)];
    let corner_px = corners
        .iter()
        .fold(0.0_f64, |most, (x, y)| most.max(change(*x, *y)));
    let places = (0..=PLACES).flat_map(|n| (0..=PLACES).map(move |m| (n, m)));
    let squares: f64 = places.map(|(n, m)| change(part(n), part(m)).powi(2)).sum();
    LensChange {
        corner_px,
        rms_px: (squares / f64::from(2 * (PLACES + 1).pow(2))).sqrt(),
        corner_arcsec: corner_px * arcsec_per_px,
    }
}

/// As lines of text.
impl fmt::Display for Comparison {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (marks, lens) = (&self.marks, &self.lens);
        let rms = format!(
            "{:.3} mil rms per axis ({:.2} arcsec)",
            marks.rms_mil, marks.rms_arcsec
        );
        let measured = [marks.measured_before, marks.measured_after];
        let mut lines = vec![
            format!("from \"{}\" to \"{}\"", self.from, self.to),
            format!(
                "marks         {} moved, {rms}; off the drawing: {} before, {} after",
                marks.moved, measured[0], measured[1]
            ),
        ];
        lines.extend(marks.largest.map(
            |LargestMove {
                 id: [i, j],
                 mil,
                 arcsec,
             }| {
                format!("              most ({i}, {j}): {mil:.3} mil ({arcsec:.2} arcsec)")
            },
        ));
        lines.push(format!(
            "              known to {:.3} mil before, {:.3} mil after",
            marks.sigma_before_mil, marks.sigma_after_mil
        ));
        lines.push(format!(
            "lens          {:.3} px at the sensor's corner ({:.2} arcsec), {:.3} px rms per axis",
            lens.corner_px, lens.corner_arcsec, lens.rms_px
        ));
        let shifts = [
            ("plate centre", "px", self.plate_centre_px),
            ("boresight", "mil", self.boresight_mil),
        ];
        lines.extend(shifts.map(|(name, unit, Shift { by: [x, y], arcsec })| {
            format!("{name:<13} ({x:+.3}, {y:+.3}) {unit}, {arcsec:.2} arcsec")
        }));
        let turns = [
            ("scale", "mil/px", self.scale_mil_per_px),
            ("rotation", "deg", self.rotation_deg),
            ("clocking", "deg", self.clocking_deg),
            ("roll", "deg", self.roll_deg),
            ("distance", "mm", self.plate_distance_mm),
        ];
        lines.extend(turns.map(|(name, unit, Turn { before, after, edge_arcsec })| {
            format!("{name:<13} {before} -> {after} {unit}, {edge_arcsec:.2} arcsec at the plate's edge")
        }));
        let [before, after] = self.directions;
        if before != after {
            lines.push(format!("directions    {before} -> {after}"));
        }
        let [before, after] = self.blur_px;
        lines.push(format!("blur          {before} -> {after} px"));
        lines.extend(self.sensor.lines());
        out.write_str(&lines.join("\n"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::instrument::builtin;

    #[test]
    fn an_instrument_compared_with_itself_has_not_changed() {
        let demo = builtin("demo").unwrap();
        let same = compare(&demo, &demo);
        assert_eq!((same.marks.moved, same.marks.largest), (0, None));
        let numbers = [
            same.lens.corner_px,
            same.plate_centre_px.arcsec,
            same.rotation_deg.edge_arcsec,
            same.clocking_deg.edge_arcsec,
            same.scale_mil_per_px.edge_arcsec,
        ];
        assert_eq!(numbers, [0.0; 5]);
    }

    #[test]
    fn changes_are_stated_in_arcsec_at_the_plates_edge() {
        let a = builtin("demo").unwrap();
        let mut b = a.clone();
        let id = MarkId { i: 2, j: -3 };
        let at = a.plate.position(id).unwrap();
        b.plate
            .set(id, PlateMil::new(at.x + 3.0, at.y - 4.0), [0.1; 2]);
        b.mounting.clocking_deg.value += 0.1;
        b.mounting.scale_mil_per_px.value *= 1.001;
        b.mounting.boresight_mil.x += 10.0;
        let change = compare(&a, &b);
        let largest = change.marks.largest.unwrap();
        assert_eq!(largest.id, [2, -3]);
        assert!((largest.mil - 5.0).abs() < 1e-9);
        // 1.746 arcsec/mil, the edge 2843 mil from the centre.
        assert!((change.clocking_deg.edge_arcsec - 8.665).abs() < 0.01);
        assert!((change.scale_mil_per_px.edge_arcsec - 4.965).abs() < 0.01);
        assert!((change.boresight_mil.arcsec - 17.46).abs() < 0.01);
        let text = change.to_string();
        assert!(text.contains("most (2, -3): 5.000 mil"), "{text}");
    }
}
