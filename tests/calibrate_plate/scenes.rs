//! Simulated frames and observations of a known plate.

use nalgebra::Matrix2;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_xoshiro::Xoshiro256PlusPlus;
use solaspect::calibrate::plate::{
    self, Calibration, FrameObservation, MarkObservation, Refusal, UsedFrames,
};
use solaspect::fits::{self, Compression};
use solaspect::geometry::{Distortion, Handedness, Mapping, SimilarityParameters};
use solaspect::instrument::{Instrument, builtin};
use solaspect::plate::{MarkId, heroes};
use solaspect::simulate::{Conditions, RandomScenes, keystoned};
use solaspect::units::{PlateMil, SensorPx};
use std::path::{Path, PathBuf};

/// Poses of one camera: centre of the plate (px), rotation (deg), scale (mil/px).
pub const POSES: [(f64, f64, f64, f64); 4] = [
    (647.5, 482.5, 0.0, 5.75),
    (690.0, 450.0, 40.0, 5.70),
    (600.0, 520.0, -35.0, 5.80),
    (670.0, 530.0, 80.0, 5.77),
];
/// Distortion of 1 px at 600 px from the sensor's middle.
pub const K1: f64 = 1.0 / (600.0 * 600.0 * 600.0);

pub fn generator(seed: u64) -> impl FnMut() -> f64 {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    move || rng.sample(StandardNormal)
}

/// The demo instrument with every mark displaced at random and a distorting lens.
pub fn truth(rms_mil: f64, k1: f64, seed: u64) -> Instrument {
    let mut instrument = builtin("demo").unwrap();
    let mut normal = generator(seed);
    for id in heroes::ids() {
        let at = heroes::position(id);
        let moved = PlateMil::new(at.x + rms_mil * normal(), at.y + rms_mil * normal());
        instrument.plate.set(id, moved, [0.01; 2]);
    }
    instrument.camera.distortion = Distortion {
        centre: SensorPx::new(647.5, 482.5),
        radial: [k1, 0.0],
        decentring: [0.0; 2],
    };
    instrument
}

pub fn similarity(pose: usize) -> SimilarityParameters {
    let (x, y, rotation_deg, scale_mil_per_px) = POSES[pose];
    SimilarityParameters {
        plate_centre: SensorPx::new(x, y),
        scale_mil_per_px,
        rotation_deg,
        handedness: Handedness::Mirrored,
    }
}

/// Region of the Sun's centres, so small that a few frames show each mark several times.
pub fn near(plate: PlateMil) -> bool {
    plate.x.abs() < 1300.0 && plate.y.abs() < 1300.0
}

/// Writes frames of a pose, with the Sun's centre where `wanted` allows it, and returns their folder.
pub fn pose_folder(
    root: &Path,
    pose: usize,
    frames: usize,
    truth: &Instrument,
    wanted: fn(PlateMil) -> bool,
    change: impl Fn(usize, &mut Conditions),
) -> PathBuf {
    let folder = root.join(format!("pose_{pose}"));
    std::fs::create_dir_all(&folder).unwrap();
    let mut written = 0;
    for number in 0.. {
        let mut conditions = Conditions {
            similarity: similarity(pose),
            ..Conditions::of(truth)
        };
        change(written, &mut conditions);
        let scenes = RandomScenes::new(truth, &conditions, 100 + pose as u64).unwrap();
        let mut scene = scenes.scene(number).unwrap();
        if !scene.sun.as_ref().is_some_and(|sun| wanted(sun.centre)) {
            continue;
        }
        scene.info.mid_exposure = Some("2013-09-21T18:00:00Z".parse().unwrap());
        let file = folder.join(format!("frame_{written:03}.fits"));
        fits::write_frame(&file, &scene.frame().unwrap(), &[], &[], Compression::Rice).unwrap();
        written += 1;
        if written == frames {
            break;
        }
    }
    folder
}

pub fn calibrate(given: &[PathBuf], start: &Instrument) -> Result<Calibration, Refusal> {
    plate::calibrate(given, start, &UsedFrames::default(), &())
}

/// 1 sigma of a generated observation, px.
pub const NOISE_PX: f64 = 0.02;

/// A generated frame: the illuminated marks, observed with noise.
pub fn observed(
    (number, pose): (usize, usize),
    (truth, mapping): (&Instrument, Mapping),
    lit: impl Fn(SensorPx) -> bool,
    normal: &mut impl FnMut() -> f64,
) -> FrameObservation {
    let seen = truth
        .plate
        .marks()
        .map(|(id, at)| (id, mapping.to_sensor(at)));
    let observation = |(id, seen): (MarkId, SensorPx)| MarkObservation {
        id,
        at: SensorPx::new(seen.x + NOISE_PX * normal(), seen.y + NOISE_PX * normal()),
        covariance_px2: Matrix2::identity() * NOISE_PX.powi(2),
    };
    FrameObservation {
        file: format!("pose_{pose}/{number}").into(),
        utc: None,
        mapping,
        sun: Some(PlateMil::new(0.0, 0.0)),
        marks: seen.filter(|(_, at)| lit(*at)).map(observation).collect(),
    }
}

/// The n-th generated frame of the Sun, whose positions cover the sensor over many frames.
pub fn sun_frame(
    (n, pose): (usize, usize),
    seen_by: (&Instrument, Mapping),
    normal: &mut impl FnMut() -> f64,
) -> FrameObservation {
    /// A mark this close to the Sun's centre is illuminated as a whole.
    const LIT_PX: f64 = 87.0;
    // Irrational steps cover the sensor without a period.
    let (x, y) = (0.618_034 * n as f64 % 1.0, 0.754_878 * n as f64 % 1.0);
    let sun = SensorPx::new(96.0 + 1103.0 * x, 96.0 + 773.0 * y);
    observed((n, pose), seen_by, |at| at.distance(sun) < LIT_PX, normal)
}

/// Generated frames with the Sun all over the sensor; the poses take turns.
pub fn sun_frames(
    truth: &Instrument,
    (frames, poses): (usize, usize),
    keystone_deg: f64,
    seed: u64,
) -> Vec<FrameObservation> {
    let mut normal = generator(seed);
    let distortion = truth.camera.distortion;
    let frame = |n: usize| {
        let pose = n % poses;
        let mapping = keystoned(similarity(pose), keystone_deg, 1296, distortion).unwrap();
        sun_frame((n, pose), (truth, mapping), &mut normal)
    };
    let frames = (0..frames).map(frame);
    frames.filter(|frame| frame.marks.len() > 2).collect()
}
