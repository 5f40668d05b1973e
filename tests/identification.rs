//! A mark never gets another mark's name. The truth is the drawing, seen through mappings of the test's own making;
//! no pixels are involved, so thousands of plates can be read in seconds.

use nalgebra::Vector2;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_xoshiro::Xoshiro256PlusPlus;
use solaspect::fiducial::{Detection, Identification, Lighting, Settings, Sight, identify};
use solaspect::geometry::{Circle, Distortion, Handedness, Mapping, SimilarityParameters};
use solaspect::instrument::builtin;
use solaspect::plate::{MarkId, Plate};
use solaspect::simulate::keystoned;
use solaspect::units::{Measured, PlateMil, SensorPx};
use std::f64::consts::TAU;

const SUN_RADIUS_MIL: f64 = 547.19;
const SCALE_MIL_PER_PX: f64 = 5.75;
/// Half of a cross from tip to tip.
const HALF_MARK_PX: f64 = 45.0 / SCALE_MIL_PER_PX;
/// Depth inside the limb at which a whole cross is lit, the limb's blur included.
const FULLY_LIT_PX: f64 = HALF_MARK_PX + 3.0;
/// Depth at which a cross that the limb cuts may still be found.
const PARTLY_LIT_PX: f64 = 2.0;

/// A camera's look at the plate and the Sun.
#[derive(Clone, Copy)]
struct Look {
    mapping: Mapping,
    /// What the instrument states.
    plate_centre: SensorPx,
    sun: SensorPx,
    /// The scale that the disc's radius tells, over the true one.
    scale_error: f64,
    rotation_error_deg: f64,
    sensor_px: [f64; 2],
}

impl Look {
    fn sight(&self) -> Sight {
        let scale = self.mapping.scale_mil_per_px(self.sun) * self.scale_error;
        let rotation = self.mapping.rotation_deg(self.sun) + self.rotation_error_deg;
        Sight {
            scale_mil_per_px: Measured::new(scale, 0.007 * scale),
            quarter_rotation_deg: rotation.rem_euclid(90.0),
            handedness: Handedness::Mirrored,
            plate_centre: self.plate_centre,
            disc: Circle {
                centre: self.sun.vector(),
                radius: SUN_RADIUS_MIL / scale,
            },
            sure_depth_px: HALF_MARK_PX + 4.0,
            sensor_px: self.sensor_px,
        }
    }

    /// Marks that a camera would see whole or in part, with their depth inside the limb.
    fn lit(&self, plate: &Plate) -> Vec<(MarkId, SensorPx, f64)> {
        let disc = self.sight().disc;
        let [width, height] = self.sensor_px;
        let inside = |v: f64, size: f64| v > HALF_MARK_PX && v < size - 1.0 - HALF_MARK_PX;
        plate
            .marks()
            .map(|(id, at)| (id, self.mapping.to_sensor(at)))
            .filter(|(_, px)| inside(px.x, width) && inside(px.y, height))
            .map(|(id, px)| (id, px, -disc.excess(px.vector())))
            .filter(|(_, _, depth)| *depth > PARTLY_LIT_PX)
            .collect()
    }
}

fn detection(at: SensorPx, depth_px: f64) -> Detection {
    Detection {
        at,
        sigma_px: 0.05,
        contrast: 0.7,
        likeness: 0.9,
        lighting: if depth_px > FULLY_LIT_PX {
            Lighting::Full
        } else {
            Lighting::Cut
        },
    }
}

/// A detection and the mark it is in truth; none for a false one.
type Labelled = (Detection, Option<MarkId>);

fn read(look: &Look, list: &[Labelled], plate: &Plate) -> Option<Identification> {
    let detections: Vec<Detection> = list.iter().map(|(detection, _)| *detection).collect();
    identify(&detections, &look.sight(), plate, &Settings::default()).ok()
}

fn wrong_ids(found: &Identification, list: &[Labelled]) -> usize {
    let wrong = |(n, id): &&(usize, MarkId)| list[*n].1 != Some(*id);
    found.ids.iter().filter(wrong).count()
}

fn fully_lit(list: &[Labelled]) -> Vec<MarkId> {
    list.iter()
        .filter(|(detection, _)| detection.lighting == Lighting::Full)
        .filter_map(|(_, id)| *id)
        .collect()
}

/// Whether neighbours in both directions are among the marks: what it takes to read both halves of an id.
fn shows_both_codes(marks: &[MarkId]) -> bool {
    let has = |di: i32, dj: i32| {
        let neighbour = |m: &MarkId| MarkId::new(m.i + di, m.j + dj);
        marks
            .iter()
            .filter_map(neighbour)
            .any(|n| marks.contains(&n))
    };
    marks.len() >= 3 && has(1, 0) && has(0, 1)
}

fn demo_plate() -> Plate {
    builtin("demo").unwrap().plate
}

#[test]
fn every_mark_of_the_pattern_is_read_and_never_misread() {
    // So large a sensor shows the outermost marks at any rotation.
    const SIDE_PX: f64 = 1600.0;
    let plate = demo_plate();
    let middle = SensorPx::new(SIDE_PX / 2.0 - 0.5, SIDE_PX / 2.0 - 0.5);
    let (mut tried, mut accepted) = (0, 0);
    for (id, printed) in plate.marks() {
        let mut read_here = 0;
        for rotation_deg in [0.0, 37.0, 141.0, 270.0] {
            let parameters = SimilarityParameters {
                plate_centre: middle,
                scale_mil_per_px: SCALE_MIL_PER_PX,
                rotation_deg,
                handedness: Handedness::Mirrored,
            };
            let mapping = Mapping::similarity(parameters, Distortion::NONE).unwrap();
            for step in 0..6 {
                let angle = f64::from(step) / 6.0 * TAU;
                let offset = Vector2::new(angle.cos(), angle.sin()) * 430.0;
                let look = Look {
                    mapping,
                    plate_centre: middle,
                    sun: mapping.to_sensor(PlateMil::from(printed.vector() + offset)),
                    scale_error: 1.0,
                    rotation_error_deg: 0.0,
                    sensor_px: [SIDE_PX; 2],
                };
                let list: Vec<Labelled> = look
                    .lit(&plate)
                    .into_iter()
                    .filter(|(_, _, depth)| *depth > FULLY_LIT_PX)
                    .map(|(id, px, depth)| (detection(px, depth), Some(id)))
                    .collect();
                let found = read(&look, &list, &plate);
                let marks = fully_lit(&list);
                if marks.len() < Settings::default().min_marks {
                    assert!(found.is_none(), "{id}: {} marks are too few", marks.len());
                }
                if !marks.contains(&id) || !shows_both_codes(&marks) {
                    continue;
                }
                tried += 1;
                if let Some(found) = found {
                    accepted += 1;
                    assert_eq!(wrong_ids(&found, &list), 0, "{id} at {rotation_deg} deg");
                    read_here += usize::from(found.ids.iter().any(|(_, named)| *named == id));
                }
            }
        }
        assert!(read_here > 0, "mark {id} was never read");
    }
    println!("every mark: {accepted} of {tried} lists with both codes read");
    assert!(accepted as f64 > 0.95 * f64::from(tried));
}

/// Draws looks and lists of detections as a camera in flight might give.
struct Draw {
    rng: Xoshiro256PlusPlus,
    plate: Plate,
}

impl Draw {
    fn within(&mut self, radius: f64) -> Vector2<f64> {
        let angle = self.rng.random_range(0.0..TAU);
        let distance = radius * self.rng.random_range(0.0_f64..1.0).sqrt();
        Vector2::new(angle.cos(), angle.sin()) * distance
    }

    /// Any rotation, the plate's centre within 100 px of the instrument's, the scale within 2 % of what the disc says,
    /// up to 3 deg of keystone, the Sun's centre anywhere on the sensor.
    fn look(&mut self) -> Look {
        let nominal = SensorPx::new(647.5, 482.5);
        let parameters = SimilarityParameters {
            plate_centre: SensorPx::from(nominal.vector() + self.within(100.0)),
            scale_mil_per_px: SCALE_MIL_PER_PX,
            rotation_deg: self.rng.random_range(0.0..360.0),
            handedness: Handedness::Mirrored,
        };
        let keystone_deg = self.rng.random_range(-3.0..3.0);
        Look {
            mapping: keystoned(parameters, keystone_deg, 1296, Distortion::NONE).unwrap(),
            plate_centre: nominal,
            sun: SensorPx::new(
                self.rng.random_range(0.0..1295.0),
                self.rng.random_range(0.0..965.0),
            ),
            scale_error: self.rng.random_range(0.98..1.02),
            rotation_error_deg: 0.3 * self.rng.sample::<f64, _>(StandardNormal),
            sensor_px: [1296.0, 966.0],
        }
    }

    /// The lit marks with 0.05 px of noise, a tenth of them missed; those that the limb cuts pulled inwards by up to
    /// 4 px and found half the time; up to two spots that are no marks.
    fn list(&mut self, look: &Look) -> Vec<Labelled> {
        let disc = look.sight().disc;
        let mut list: Vec<Labelled> = Vec::new();
        for (id, px, depth) in look.lit(&self.plate) {
            let noise = Vector2::from_fn(|_, _| 0.05 * self.rng.sample::<f64, _>(StandardNormal));
            let seen = px.vector() + noise;
            if depth > FULLY_LIT_PX {
                if self.rng.random_bool(0.9) {
                    list.push((detection(seen.into(), depth), Some(id)));
                }
            } else if self.rng.random_bool(0.5) {
                let pull = self.rng.random_range(0.0..4.0);
                let inwards = (disc.centre - seen).normalize();
                let found = detection((seen + inwards * pull).into(), depth);
                list.push((found, Some(id)));
            }
        }
        for _ in 0..self.rng.random_range(0..=2) {
            let at = SensorPx::from(disc.centre + self.within(disc.radius - PARTLY_LIT_PX));
            // One detection per mark length; a spot on a mark is that mark.
            let apart = 2.0 * HALF_MARK_PX;
            let far = |(_, printed)| look.mapping.to_sensor(printed).distance(at) > apart;
            let free = self.plate.marks().all(far)
                && list.iter().all(|(other, _)| other.at.distance(at) > apart);
            if free {
                list.push((detection(at, -disc.excess(at.vector())), None));
            }
        }
        list
    }
}

#[test]
fn no_list_of_marks_is_ever_misread_whatever_is_missing_or_false() {
    const LISTS: usize = 6_000;
    let mut draw = Draw {
        rng: Xoshiro256PlusPlus::seed_from_u64(20130921),
        plate: demo_plate(),
    };
    let (mut readable, mut readable_accepted, mut accepted, mut misread) = (0, 0, 0, 0);
    for _ in 0..LISTS {
        let look = draw.look();
        let list = draw.list(&look);
        let readable_here = shows_both_codes(&fully_lit(&list));
        readable += usize::from(readable_here);
        if let Some(found) = read(&look, &list, &draw.plate) {
            accepted += 1;
            readable_accepted += usize::from(readable_here);
            misread += usize::from(wrong_ids(&found, &list) > 0);
        }
    }
    let share = readable_accepted as f64 / readable as f64;
    println!(
        "{LISTS} random lists: {accepted} read, {misread} misread; of {readable} with three fully lit marks and both \
         codes {:.1} % read",
        100.0 * share
    );
    assert_eq!(misread, 0);
    assert!(share > 0.75, "{share}");
}
