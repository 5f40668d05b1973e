//! A mark never gets another mark's id. The truth is the drawing, printed with scatter and mapped by the test's own
//! mappings; no pixels are involved, so thousands of plates can be tested in seconds.

use nalgebra::{Matrix2, Matrix3, SymmetricEigen, Vector2, Vector3};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_xoshiro::Xoshiro256PlusPlus;
use solaspect::fiducial::{
    Detection, FiducialSettings, IdentificationPrior, Lighting, Unread, identify,
    identify_with_margin,
};
use solaspect::geometry::{Distortion, Ellipse, Handedness, Mapping, SimilarityParameters};
use solaspect::instrument::builtin;
use solaspect::plate::{MarkId, Plate};
use solaspect::simulate::keystoned;
use solaspect::units::{Measured, PlateMil, SensorPx};
use std::f64::consts::TAU;

const SUN_RADIUS_MIL: f64 = 547.19;
const SCALE_MIL_PER_PX: f64 = 5.75;
/// Half of a cross, from centre to tip.
const HALF_MARK_MIL: f64 = 45.0;
/// Depth inside the limb at which a whole cross is illuminated, including the limb's blur.
const FULLY_LIT_PX: f64 = 3.0;
/// Depths between which crosses cut by the limb are found with increasing probability: 0.16 at 9 mil, 0.7 at 15, 1 from 18 on in
/// simulated frames.
const CUT_FOUND_MIL: [f64; 2] = [5.0, 22.0];
/// Largest displacement of a cross by the limb, at the limb.
const SHIFT_PX: f64 = 4.0;
/// Contrast of the printed marks.
const CONTRAST: f64 = 0.7;

/// Geometry of the plate and the Sun as a camera observes them.
#[derive(Clone, Copy)]
struct View {
    mapping: Mapping,
    scale_mil_per_px: f64,
    /// The plate's centre stated by the instrument.
    plate_centre: SensorPx,
    sun: PlateMil,
    outline: Ellipse,
    /// Expected radius over true radius.
    radius_error: f64,
    rotation_error_deg: f64,
    sensor_px: [f64; 2],
}

impl View {
    fn prior(&self) -> IdentificationPrior {
        let radius = SUN_RADIUS_MIL * self.radius_error;
        IdentificationPrior {
            outline: self.outline,
            radius_mil: Measured::new(radius, 0.006 * radius),
            quarter_rotation_deg: Some(Measured::new(
                (self.rotation_deg() + self.rotation_error_deg).rem_euclid(90.0),
                0.6,
            )),
            handedness: self.mapping.handedness(),
            plate_centre: self.plate_centre,
            // In all lists the camera is displaced.
            plate_centre_sigma_px: 100.0,
            rotation_deg: Measured::new(0.0, 360.0),
            scale_mil_per_px: Measured::new(SCALE_MIL_PER_PX, 0.1 * SCALE_MIL_PER_PX),
            missed_share: 0.1,
            sure_depth_px: 0.75 * self.half_mark_px() + 1.0,
            sure_margin_px: self.half_mark_px() + 4.0,
            sensor_px: self.sensor_px,
        }
    }

    fn half_mark_px(&self) -> f64 {
        HALF_MARK_MIL / self.scale_mil_per_px
    }

    /// Rotation of the plate's axes with respect to the unit disc's.
    fn rotation_deg(&self) -> f64 {
        let to_sensor = self.mapping.sensor_jacobian(self.sun) * SUN_RADIUS_MIL;
        let inverse_root = self.outline.root().try_inverse().unwrap();
        let turn = inverse_root * to_sensor * self.mapping.handedness().axes();
        (turn.m21 - turn.m12)
            .atan2(turn.m11 + turn.m22)
            .to_degrees()
    }

    fn lighting(&self, depth_px: f64) -> Lighting {
        if depth_px > self.half_mark_px() + FULLY_LIT_PX {
            Lighting::Full
        } else {
            Lighting::Cut
        }
    }

    /// Marks that a camera would see completely or partly, with their depth inside the limb.
    fn lit(&self, plate: &Plate) -> Vec<(MarkId, SensorPx, f64)> {
        let [width, height] = self.sensor_px;
        let half = self.half_mark_px();
        let inside = |v: f64, size: f64| v > half && v < size - 1.0 - half;
        plate
            .marks()
            .filter(|(_, at)| at.distance(self.sun) < SUN_RADIUS_MIL)
            .map(|(id, at)| (id, self.mapping.to_sensor(at)))
            .filter(|(_, px)| inside(px.x, width) && inside(px.y, height))
            .map(|(id, px)| (id, px, -self.outline.excess(px.vector())))
            .filter(|(_, _, depth)| *depth > 0.0)
            .collect()
    }
}

/// Image of a circle on the plate: a homography transforms a conic to M^T C M.
fn outline(mapping: &Mapping, centre: PlateMil, radius_mil: f64) -> Ellipse {
    let c = centre.vector();
    let square = c.norm_squared() - radius_mil * radius_mil;
    let circle = Matrix3::new(1.0, 0.0, -c.x, 0.0, 1.0, -c.y, -c.x, -c.y, square);
    let conic = mapping.matrix().transpose() * circle * mapping.matrix();
    let form: Matrix2<f64> = conic.fixed_view::<2, 2>(0, 0).into_owned();
    let slope = Vector2::new(conic.m13, conic.m23);
    let centre = -form.try_inverse().unwrap() * slope;
    let level = -(conic * Vector3::new(centre.x, centre.y, 1.0)).dot(&centre.push(1.0));
    let mut axes = SymmetricEigen::new(form / level);
    axes.eigenvalues.apply(|v| *v = v.powf(-0.5));
    Ellipse::new(centre, axes.recompose()).unwrap()
}

/// A detection and its true mark; `None` for a false detection.
type Labelled = (Detection, Option<MarkId>);

fn read(view: &View, list: &[Labelled], plate: &Plate) -> Result<Vec<(usize, MarkId)>, Unread> {
    let detections: Vec<Detection> = list.iter().map(|(detection, _)| *detection).collect();
    let (prior, settings) = (view.prior(), FiducialSettings::default());
    let found = identify(&detections, &prior, plate, &settings);
    // The early decision agrees with the comparison of all labellings.
    let by_all = identify_with_margin(&detections, &prior, plate, &settings);
    let refused = |unread: Unread| unread.rejected().reason;
    assert_eq!(
        found.clone().map_err(refused),
        by_all.map(|identified| identified.ids).map_err(refused)
    );
    found
}

fn wrong_ids(found: &[(usize, MarkId)], list: &[Labelled]) -> usize {
    let wrong = |(n, id): &&(usize, MarkId)| list[*n].1 != Some(*id);
    found.iter().filter(wrong).count()
}

fn fully_lit(list: &[Labelled]) -> Vec<MarkId> {
    list.iter()
        .filter(|(detection, _)| detection.lighting == Lighting::Full)
        .filter_map(|(_, id)| *id)
        .collect()
}

/// Whether the marks include neighbours in both directions, which both halves of an id need.
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
    // The sensor is large enough to show the outermost marks at any rotation.
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
                let sun = PlateMil::from(printed.vector() + offset);
                let view = View {
                    mapping,
                    scale_mil_per_px: SCALE_MIL_PER_PX,
                    plate_centre: middle,
                    sun,
                    outline: outline(&mapping, sun, SUN_RADIUS_MIL),
                    radius_error: 1.0,
                    rotation_error_deg: 0.0,
                    sensor_px: [SIDE_PX; 2],
                };
                let seen = |(id, at, depth): (MarkId, SensorPx, f64)| {
                    let detection = Detection {
                        at,
                        sigma_px: 0.05,
                        contrast: CONTRAST,
                        likeness: 0.9,
                        lighting: view.lighting(depth),
                    };
                    (detection, Some(id))
                };
                let deep = |(_, _, depth): &(MarkId, SensorPx, f64)| {
                    depth * SCALE_MIL_PER_PX > CUT_FOUND_MIL[1]
                };
                let lit = view.lit(&plate).into_iter().filter(deep);
                let list: Vec<Labelled> = lit.map(seen).collect();
                let found = read(&view, &list, &plate);
                let marks = fully_lit(&list);
                if marks.len() < FiducialSettings::default().min_marks {
                    assert!(found.is_err(), "{id}: {} marks are too few", marks.len());
                }
                if !marks.contains(&id) || !shows_both_codes(&marks) {
                    continue;
                }
                tried += 1;
                if let Ok(found) = found {
                    accepted += 1;
                    assert_eq!(wrong_ids(&found, &list), 0, "{id} at {rotation_deg} deg");
                    read_here += usize::from(found.iter().any(|(_, named)| *named == id));
                }
            }
        }
        assert!(read_here > 0, "mark {id} was never read");
    }
    println!("every mark: {accepted} of {tried} lists with both codes read");
    assert!(accepted as f64 > 0.99 * f64::from(tried));
}

/// Conditions of the lists.
#[derive(Clone, Copy)]
struct World {
    /// Fraction of the marks found away from the limb.
    found: f64,
    /// Largest number of false detections on a disc.
    false_ones: usize,
    /// Whether the whole disc is on the sensor.
    whole_disc: bool,
}

/// A tenth of the marks are missing, up to two detections are false, and the Sun is anywhere on the sensor.
const HARSH: World = World {
    found: 0.9,
    false_ones: 2,
    whole_disc: false,
};
/// No mark is missing, no detection is false, and the whole disc is in view.
const CLEAN: World = World {
    found: 1.0,
    false_ones: 0,
    whole_disc: true,
};

/// Draws geometries and lists of detections as a camera in flight might produce.
struct Draw {
    rng: Xoshiro256PlusPlus,
    plate: Plate,
    world: World,
}

impl Draw {
    fn new(seed: u64, world: World) -> Self {
        Self {
            rng: Xoshiro256PlusPlus::seed_from_u64(seed),
            plate: demo_plate(),
            world,
        }
    }

    fn normal(&mut self, sigma: f64) -> f64 {
        sigma * self.rng.sample::<f64, _>(StandardNormal)
    }

    fn scatter(&mut self, sigma: f64) -> Vector2<f64> {
        Vector2::from_fn(|_, _| self.normal(sigma))
    }

    fn within(&mut self, radius: f64) -> Vector2<f64> {
        let angle = self.rng.random_range(0.0..TAU);
        let distance = radius * self.rng.random_range(0.0_f64..1.0).sqrt();
        Vector2::new(angle.cos(), angle.sin()) * distance
    }

    /// Any rotation, either handedness, the plate's centre within 100 px of the instrument's, the scale within 10 % of the
    /// nominal, up to 3 deg of keystone; the Sun's radius known to 1 %, its outline to 0.05 px, the arms' rotation to
    /// 0.3 deg, or in one of five cases only to 1 deg.
    fn view(&mut self) -> View {
        let nominal = SensorPx::new(647.5, 482.5);
        let scale_mil_per_px = SCALE_MIL_PER_PX * self.rng.random_range(0.9..1.1);
        let mirrored = self.rng.random_bool(0.5);
        let parameters = SimilarityParameters {
            plate_centre: SensorPx::from(nominal.vector() + self.within(100.0)),
            scale_mil_per_px,
            rotation_deg: self.rng.random_range(0.0..360.0),
            handedness: if mirrored {
                Handedness::Mirrored
            } else {
                Handedness::Direct
            },
        };
        let keystone_deg = self.rng.random_range(-3.0..3.0);
        let mapping = keystoned(parameters, keystone_deg, 1296, Distortion::NONE).unwrap();
        let margin = if self.world.whole_disc { 110.0 } else { 0.0 };
        let sun = mapping.to_plate(SensorPx::new(
            self.rng.random_range(margin..1295.0 - margin),
            self.rng.random_range(margin..965.0 - margin),
        ));
        let exact = outline(&mapping, sun, SUN_RADIUS_MIL);
        let rotation_error_deg = if self.rng.random_bool(0.2) {
            self.rng.random_range(-1.0..1.0)
        } else {
            self.normal(0.3)
        };
        View {
            mapping,
            scale_mil_per_px,
            plate_centre: nominal,
            sun,
            outline: Ellipse::new(exact.centre + self.scatter(0.05), *exact.root()).unwrap(),
            radius_error: self.rng.random_range(0.99..1.01),
            rotation_error_deg,
            sensor_px: [1296.0, 966.0],
        }
    }

    /// A plate whose marks deviate by 1 mil rms from the drawing.
    fn printed(&mut self) -> Plate {
        let mut printed = self.plate.clone();
        for (id, drawn) in self.plate.clone().marks() {
            let at = drawn.vector() + self.scatter(1.0);
            printed.set(id, at.into(), [1.0; 2]);
        }
        printed
    }

    fn seen(&mut self, view: &View, at: Vector2<f64>, depth: f64, noise_px: f64) -> Detection {
        Detection {
            at: (at + self.scatter(noise_px)).into(),
            sigma_px: noise_px,
            contrast: CONTRAST * (1.0 + self.normal(0.06)),
            likeness: 0.9 + self.rng.random_range(-0.1..0.1),
            lighting: view.lighting(depth),
        }
    }

    /// The illuminated marks with noise of 0.02 to 0.1 px; those cut by the limb are displaced inwards.
    fn list(&mut self, view: &View) -> Vec<Labelled> {
        let printed = self.printed();
        let noise_px = self.rng.random_range(0.02..0.1);
        let mut list: Vec<Labelled> = Vec::new();
        for (id, px, depth) in view.lit(&printed) {
            let lit = (depth / (view.half_mark_px() + FULLY_LIT_PX)).min(1.0);
            let [none, all] = CUT_FOUND_MIL.map(|mil| mil / view.scale_mil_per_px);
            let share = self.world.found * ((depth - none) / (all - none)).clamp(0.0, 1.0);
            let inwards = (view.outline.centre - px.vector()).normalize();
            let shift = self.rng.random_range(0.0..SHIFT_PX) * (1.0 - lit);
            let at = px.vector() + inwards * shift;
            if self.rng.random_bool(share) {
                list.push((self.seen(view, at, depth, noise_px), Some(id)));
            }
        }
        for _ in 0..self.rng.random_range(0..=self.world.false_ones) {
            let w = self.within(1.0 - 2.0 / view.outline.mean_radius());
            let at = view.outline.from_disc(w);
            // There is one detection per mark length; a false one on a mark is that mark.
            let apart = 2.0 * view.half_mark_px();
            let far = |(_, printed)| view.mapping.to_sensor(printed).distance(at.into()) > apart;
            let [width, height] = view.sensor_px;
            let seen = (0.0..width - 1.0).contains(&at.x) && (0.0..height - 1.0).contains(&at.y);
            let free = seen
                && self.plate.marks().all(far)
                && list
                    .iter()
                    .all(|(other, _)| other.at.distance(at.into()) > apart);
            if free {
                let depth = -view.outline.excess(at);
                let mut spot = self.seen(view, at, depth, noise_px);
                // One in three is indistinguishable from a mark.
                if self.rng.random_bool(2.0 / 3.0) {
                    spot.contrast = self.rng.random_range(0.12..1.0);
                    spot.likeness = self.rng.random_range(0.5..1.0);
                }
                list.push((spot, None));
            }
        }
        list.shuffle(&mut self.rng);
        list
    }
}

/// Statistics of many lists.
#[derive(Debug, Default)]
struct Tally {
    lists: usize,
    accepted: usize,
    misread: usize,
    /// Lists with three fully lit marks, those accepted, and the same for lists that show both codes.
    three: usize,
    three_accepted: usize,
    both_codes: usize,
    both_codes_accepted: usize,
}

impl Tally {
    fn of(lists: usize, seed: u64, world: World) -> Self {
        let mut draw = Draw::new(seed, world);
        let mut tally = Self::default();
        for _ in 0..lists {
            let view = draw.view();
            let list = draw.list(&view);
            let found = read(&view, &list, &draw.plate);
            tally.add(&list, found.as_deref().ok());
        }
        println!(
            "{lists} lists: {} read, {} misread; {:.2} % of {} with three fully lit marks read, {:.2} % of {} with \
             both codes",
            tally.accepted,
            tally.misread,
            100.0 * tally.three_share(),
            tally.three,
            100.0 * tally.both_codes_share(),
            tally.both_codes,
        );
        tally
    }

    fn add(&mut self, list: &[Labelled], found: Option<&[(usize, MarkId)]>) {
        let marks = fully_lit(list);
        let accepted = usize::from(found.is_some());
        self.lists += 1;
        self.accepted += accepted;
        self.misread += usize::from(found.is_some_and(|f| wrong_ids(f, list) > 0));
        if marks.len() >= 3 {
            self.three += 1;
            self.three_accepted += accepted;
        }
        if shows_both_codes(&marks) {
            self.both_codes += 1;
            self.both_codes_accepted += accepted;
        }
    }

    fn three_share(&self) -> f64 {
        self.three_accepted as f64 / self.three as f64
    }

    fn both_codes_share(&self) -> f64 {
        self.both_codes_accepted as f64 / self.both_codes as f64
    }
}

#[test]
fn no_list_of_marks_is_ever_misread_whatever_is_missing_or_false() {
    let tally = Tally::of(20_000, 20130921, HARSH);
    assert_eq!(tally.misread, 0);
    assert!(tally.both_codes_share() > 0.91);
}

#[test]
fn lists_with_nothing_missing_and_nothing_false_are_read() {
    let tally = Tally::of(10_000, 1859, CLEAN);
    assert_eq!(tally.misread, 0);
    assert!(tally.both_codes_share() > 0.995);
    // A row of three marks with only one code may occur twice at the pattern's edge.
    assert!(tally.three_share() > 0.945);
}

#[test]
#[ignore = "a minute; cargo test --release --test promises identification -- --ignored --nocapture"]
fn no_list_of_many_seeds_is_ever_misread() {
    for seed in 1..=5 {
        assert_eq!(Tally::of(60_000, seed, HARSH).misread, 0);
        assert_eq!(Tally::of(20_000, seed, CLEAN).misread, 0);
    }
}
