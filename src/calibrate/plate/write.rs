//! Writes the calibrated instrument as TOML: measured values replace those in the start's file.

use super::calibration::Calibration;
use super::fit::PoseFit;
use crate::calibrate::revision::{Provenance, Revision, number};
use crate::geometry::Distortion;
use crate::instrument::Instrument;
use crate::plate::{MarkId, MarkPlace, Pattern};
use crate::units::{Measured, PlateMil};
use jiff::Timestamp;
use jiff::tz::TimeZone;
use std::collections::BTreeMap;
use toml_edit::{Array, ArrayOfTables, Item, Table, Value, value};

impl Calibration {
    /// Writes marks, lens and mounting, with their provenance, into the file of the start instrument; all other values stay.
    pub fn revise(&self, revision: &mut Revision) {
        let (fit, start) = (&self.fit, &self.start);
        let provenance = provenance(self);
        if fit.distortion != Distortion::NONE || start.camera.distortion != Distortion::NONE {
            distortion(revision, self, &provenance);
        }
        mounting(revision, start, self, &provenance);
        revision.put("plate.mark", Item::ArrayOfTables(marks(self, start)));
        let note = match fit.separation.by_data() {
            true => "the frames separate the plate's errors from the lens's distortion",
            false => {
                "the frames do not separate the plate's errors from the lens's distortion: the split rests on stated priors"
            }
        };
        revision.sign(&provenance.with_source(note));
        let poses = i64::try_from(self.poses.len()).unwrap_or(i64::MAX);
        revision.put("calibration.plate.poses", value(poses));
        self.used_frames.list(revision);
        if !self.suspects.is_empty() {
            let ids = self.suspects.iter().map(|mark| id_value(mark.id));
            revision.put(
                "calibration.plate.suspect_marks",
                value(Array::from_iter(ids)),
            );
        }
    }
}

/// Comment beside every value; the number of frames is stated once, in `[calibration.plate]`.
fn provenance(calibration: &Calibration) -> Provenance {
    // Use the date of the frames, so that the same frames give the same file.
    let day = |last: Timestamp| last.to_zoned(TimeZone::UTC).date();
    Provenance {
        name: "plate",
        source: "solaspect calibrate plate".into(),
        date: calibration.span().map(|[_, last]| day(last)),
        frames: calibration.fit.poses.iter().map(|pose| pose.frames).sum(),
        frames_sha256: calibration.frames_sha256.clone(),
        camera: calibration.camera.clone(),
    }
}

impl Provenance {
    fn with_source(&self, source: &str) -> Self {
        Self {
            source: source.into(),
            ..self.clone()
        }
    }

    fn remarked(&self, remark: &str) -> Self {
        self.with_source(&format!("{}{remark}", self.source))
    }
}

fn distortion(revision: &mut Revision, calibration: &Calibration, provenance: &Provenance) {
    let fit = &calibration.fit;
    let lens = &fit.distortion;
    let held = provenance.remarked("; held, the decentring terms move it");
    let centre = Value::Array(Array::from_iter([lens.centre.x, lens.centre.y]));
    revision.set("camera.distortion.centre_px", centre, None, &held);
    let unneeded = provenance.remarked("; not called for by the data");
    let sigma = fit.distortion_sigma;
    let radial = [
        ("2", lens.radial[0], sigma[0]),
        ("4", lens.radial[1], sigma[1]),
    ];
    for (power, value, sigma) in radial {
        let key = format!("camera.distortion.radial_per_px{power}");
        match sigma > 0.0 {
            true => revision.set_measured(&key, Measured::new(value, sigma), provenance),
            false => revision.set(&key, 0.into(), None, &unneeded),
        }
    }
    let key = "camera.distortion.decentring_per_px";
    match sigma[2] > 0.0 {
        true => revision.set_pair(key, lens.decentring, sigma[2].max(sigma[3]), provenance),
        false => revision.set(key, Value::Array(Array::from_iter([0, 0])), None, &unneeded),
    }
}

/// Writes scale, rotation and centre of the pose nearest to the stated one. A camera that was moved may be moved again, so that after
/// several poses the start's sigmas are added to the fit's.
fn mounting(
    revision: &mut Revision,
    start: &Instrument,
    calibration: &Calibration,
    provenance: &Provenance,
) {
    let PoseFit {
        scale_mil_per_px: scale,
        rotation_deg: rotation,
        plate_centre_px: centre,
        plate_centre_sigma_px: centre_sigma,
        ..
    } = calibration.fit.poses[calibration.mounted_pose];
    let stated = &start.mounting;
    let moved = calibration.poses.len() > 1;
    let sigma = |fit: f64, stated: f64| if moved { fit.hypot(stated) } else { fit };
    let provenance = match moved {
        true => provenance.remarked(", the pose nearest to the stated one"),
        false => provenance.clone(),
    };
    // Round to the fit's digits, whatever the start's sigma adds.
    let mut set = |key: &str, value: Value, of_fit: f64, stated: f64| {
        revision.set(key, value, Some(sigma(of_fit, stated)), &provenance);
    };
    set(
        "mounting.scale_mil_per_px",
        number(scale.value, scale.sigma),
        scale.sigma,
        stated.scale_mil_per_px.sigma,
    );
    let turns = ((stated.rotation_deg.value - rotation.value) / 360.0).round();
    set(
        "mounting.rotation_deg",
        number(rotation.value + 360.0 * turns, rotation.sigma),
        rotation.sigma,
        stated.rotation_deg.sigma,
    );
    let centre = [centre.x, centre.y].map(|v| number(v, centre_sigma));
    set(
        "mounting.plate_centre_px",
        Value::Array(Array::from_iter(centre)),
        centre_sigma,
        stated.plate_centre_sigma_px,
    );
}

fn id_value(id: MarkId) -> Value {
    Value::Array(Array::from_iter([i64::from(id.i), i64::from(id.j)]))
}

/// The measured marks, and of the others those already measured in the file.
fn marks(calibration: &Calibration, start: &Instrument) -> ArrayOfTables {
    const LEAST_SIGMA_MIL: f64 = 0.0001;
    // Sorts the long list to the file's end.
    const AFTER_ALL_ELSE: isize = 1_000_000;
    let fixed = |v: f64| format!("{v:.4}");
    let pair = |pair: [f64; 2]| {
        let numbers = pair.map(|v| fixed(v).parse().unwrap_or_else(|_| Value::from(v)));
        value(Array::from_iter(numbers))
    };
    let found = calibration.fit.marks.iter();
    let found: BTreeMap<MarkId, (PlateMil, [f64; 2])> = found
        .map(|mark| (mark.id, (mark.position, mark.sigma_mil)))
        .collect();
    let plate = &start.plate;
    // If the drawing is the list itself every mark stays, with its drawn position.
    let is_drawing = plate.pattern() == Pattern::Listed;
    let before = |id: MarkId| {
        let stays = if is_drawing {
            plate.place(id)
        } else {
            plate.measured(id)
        };
        stays.map(|MarkPlace { at, sigma_mil }| (at, sigma_mil))
    };
    let mut marks = ArrayOfTables::new();
    for (id, drawn) in plate.drawn_marks() {
        let Some((position, sigma_mil)) = found.get(&id).copied().or_else(|| before(id)) else {
            continue;
        };
        let mut table = Table::new();
        table.set_position(Some(AFTER_ALL_ELSE));
        table["id"] = value(id_value(id));
        table["position_mil"] = pair([position.x, position.y]);
        if is_drawing {
            table["drawn_mil"] = value(Array::from_iter([drawn.x, drawn.y]));
        }
        table["sigma_mil"] = pair(sigma_mil.map(|sigma| sigma.max(LEAST_SIGMA_MIL)));
        marks.push(table);
    }
    marks
}
