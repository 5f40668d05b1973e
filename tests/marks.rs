//! Marks are found at their positions: every fully lit one, no false ones, with errors at the level of the noise. The truth
//! is the simulator's, which `tests/simulation.rs` compares with independent arithmetic.

use nalgebra::{Matrix2, Vector2};
use rayon::prelude::*;
use solaspect::fiducial::{
    Detections, FiducialSettings, FlatDisc, Lighting, MarkImage, RefinedMark, Refiner, detect,
};
use solaspect::frame::{Background, Cutout, Frame, PixelNoise, ROUNDING_NOISE_DN};
use solaspect::geometry::{Circle, Distortion, Ellipse, Handedness, Mapping, SimilarityParameters};
use solaspect::instrument::{Instrument, builtin};
use solaspect::limb::{self, Profile};
use solaspect::plate::MarkId;
use solaspect::simulate::{
    Conditions, Counts, Depth, HotPixel, Noise, Picture, RandomScenes, SUN_RADIUS_ARCSEC, Scene,
    Scratch, Sun, SunInView, render_exact,
};
use solaspect::units::{PlateMil, SensorPx};

const SCALE_MIL_PER_PX: f64 = 5.75;
/// 0.55 arcsec at 10.04 arcsec/px, px.
const HALF_ARCSEC_PX: f64 = 0.0548;
const ROTATIONS_DEG: [f64; 4] = [0.0, 7.0, 30.0, 45.0];

fn demo() -> Instrument {
    builtin("demo").unwrap()
}

/// A small picture with one mark near its middle, and the brightness there as a limb fit would give it.
struct Close {
    scene: Scene,
    /// Brightness without the mark, row by row, DN above background.
    light: Vec<f32>,
    jacobian: Matrix2<f64>,
    mark: SensorPx,
}

impl Close {
    const SIDE: usize = 48;

    /// Mark (0, 0) at this depth inside the limb; the Sun's centre is in this direction on the plate.
    fn new(phase: [f64; 2], rotation_deg: f64, depth_px: f64, sun_direction_deg: f64) -> Self {
        let instrument = demo();
        let middle = Self::SIDE as f64 / 2.0;
        let mark = SensorPx::new(middle + phase[0], middle + phase[1]);
        let similarity = SimilarityParameters {
            plate_centre: mark,
            scale_mil_per_px: SCALE_MIL_PER_PX,
            rotation_deg,
            handedness: Handedness::Mirrored,
        };
        let mapping = Mapping::similarity(similarity, Distortion::NONE).unwrap();
        let radius_mil = instrument.optics.radius_mil(SUN_RADIUS_ARCSEC);
        let distance = radius_mil - depth_px * SCALE_MIL_PER_PX;
        let (sin, cos) = sun_direction_deg.to_radians().sin_cos();
        let sun = Sun::new(PlateMil::new(distance * cos, distance * sin), radius_mil);
        let scene = Scene {
            width_px: Self::SIDE,
            height_px: Self::SIDE,
            sun: Some(sun),
            ..Scene::new(&instrument, mapping)
        };
        Self {
            light: light_without_marks(&scene),
            jacobian: mapping.sensor_jacobian(PlateMil::new(0.0, 0.0)),
            mark,
            scene,
        }
    }

    /// The same with a larger blur.
    fn hazy(self, blur_px: f64) -> Self {
        let scene = Scene {
            blur_px,
            ..self.scene
        };
        Self {
            light: light_without_marks(&scene),
            scene,
            ..self
        }
    }

    /// Sixteen sub-pixel phases for each rotation.
    fn phases(depth_px: f64, sun_direction_deg: f64) -> Vec<Self> {
        let phase = |n: i32| f64::from(n) / 4.0 - 0.375;
        ROTATIONS_DEG
            .iter()
            .flat_map(|rotation| (0..16).map(move |n| (*rotation, [phase(n % 4), phase(n / 4)])))
            .map(|(rotation, phase)| Self::new(phase, rotation, depth_px, sun_direction_deg))
            .collect()
    }

    fn frame(&self, noise_dn: f64, seed: u64) -> Frame {
        let scene = Scene {
            noise: Noise::read(noise_dn),
            seed,
            ..self.scene.clone()
        };
        scene.frame().unwrap()
    }

    /// The mark refined from a start 0.3 px away. The camera has `steps_per_dn` DN per DN of the 8-bit camera.
    fn refined(
        &self,
        frame: &Frame,
        noise_dn: f64,
        steps_per_dn: f64,
        blur_error: f64,
    ) -> Option<RefinedMark> {
        let background_dn = self.scene.background_dn * steps_per_dn;
        let cutout = whole(frame, background_dn, noise_dn * steps_per_dn);
        let light = |x: f64, y: f64| {
            let inside = |v: f64| v.max(0.0).min(Self::SIDE as f64 - 1.0) as usize;
            steps_per_dn * f64::from(self.light[inside(y) * Self::SIDE + inside(x)])
        };
        let blur = self.scene.blur_px * blur_error;
        let mut refiner = Refiner::new(&demo().plate.shape, SCALE_MIL_PER_PX, blur, cutout.noise);
        let start = SensorPx::new(self.mark.x + 0.24, self.mark.y - 0.18);
        refiner.refine(&cutout, &light, &self.jacobian, start)
    }

    fn error(&self, mark: &RefinedMark) -> Vector2<f64> {
        mark.place.position.vector() - self.mark.vector()
    }
}

/// A cutout of the whole frame.
fn whole(frame: &Frame, background_dn: f64, noise_dn: f64) -> Cutout {
    let region = frame.region();
    let background = Background::even(region, background_dn);
    let noise = PixelNoise::even(noise_dn.max(ROUNDING_NOISE_DN));
    Cutout::new(frame, region, &background, noise)
}

fn light_without_marks(scene: &Scene) -> Vec<f32> {
    let clean = Scene {
        mark_contrast: 0.0,
        ..scene.clone()
    };
    let background = scene.background_dn as f32;
    let lights = render_exact(&clean);
    lights.iter().map(|light| light - background).collect()
}

/// Distances from the truth, px, and squared errors normalised by the covariance (expectation 2).
fn errors(depth_px: f64, sun_direction_deg: f64, noise_dn: f64, seeds: u64) -> Vec<(f64, f64)> {
    let cases: Vec<(Close, u64)> = Close::phases(depth_px, sun_direction_deg)
        .into_iter()
        .zip((0..).step_by(seeds as usize))
        .collect();
    let of_one = |(close, first): &(Close, u64)| {
        let seeds = *first..first + seeds;
        let measured = seeds.map(|seed| {
            let frame = close.frame(noise_dn, seed);
            let mark = close.refined(&frame, noise_dn, 1.0, 1.0).unwrap();
            let error = close.error(&mark);
            let inverse = mark.place.covariance.try_inverse().unwrap();
            (error.norm(), error.dot(&(inverse * error)))
        });
        measured.collect::<Vec<_>>()
    };
    cases.par_iter().flat_map(of_one).collect()
}

fn quantile(mut values: Vec<f64>, part: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[(part * values.len() as f64) as usize]
}

/// Rms error over sigma, per axis.
fn ratio(errors: &[(f64, f64)]) -> f64 {
    let sum: f64 = errors.iter().map(|e| e.1).sum();
    (sum / 2.0 / errors.len() as f64).sqrt()
}

#[test]
fn no_sub_pixel_phase_moves_a_mark() {
    for blur_error in [0.8, 1.0, 1.2] {
        for mut close in Close::phases(60.0, 17.0) {
            // With 12 bits and no noise only the error of the method remains.
            close.scene.depth = Depth::Twelve;
            let frame = close.frame(0.0, 0);
            let mark = close.refined(&frame, 0.05, 16.0, blur_error).unwrap();
            let off = close.error(&mark).norm();
            assert!(
                off < 0.002,
                "{off} px off at {:?}, blur x {blur_error}",
                close.mark
            );
        }
    }
}

#[test]
fn a_mark_in_noise_is_as_near_as_its_pixels_allow_and_says_so() {
    let errors = errors(90.0, 17.0, 5.0, 48);
    let radial = errors.iter().map(|e| e.0).collect();
    let worst = quantile(radial, 0.997);
    assert!(worst < HALF_ARCSEC_PX, "99.7 % within {worst} px");
    let ratio = ratio(&errors);
    assert!((0.9..1.1).contains(&ratio), "rms error {ratio} sigma");
}

#[test]
fn marks_at_and_across_the_limb_stay_within_their_sigma() {
    // The tips just inside the limb, one arm cut, the centre at the limb.
    for (depth_px, direction_deg) in [(9.0, 0.0), (8.0, 0.0), (6.0, 45.0), (4.0, 0.0), (0.0, 0.0)] {
        for noise_dn in [1.0, 5.0] {
            let errors = errors(depth_px, direction_deg, noise_dn, 6);
            let ratio = ratio(&errors);
            assert!(
                (0.85..1.25).contains(&ratio),
                "{ratio} sigma at {depth_px} px, {noise_dn} DN"
            );
            // 11.8 is 3 sigma in two dimensions.
            let beyond = errors.iter().filter(|e| e.1 > 11.8).count();
            assert!(
                beyond * 50 < errors.len(),
                "{beyond} beyond 3 sigma at {depth_px} px"
            );
        }
    }
}

/// Mean error over some seeds with low noise.
fn mean_error(close: &Close) -> Vector2<f64> {
    const SEEDS: u64 = 40;
    let seen = (0..SEEDS).map(|seed| {
        let frame = close.frame(2.0, seed);
        close.error(&close.refined(&frame, 2.0, 1.0, 1.0).unwrap())
    });
    seen.sum::<Vector2<f64>>() / SEEDS as f64
}

#[test]
fn hot_pixels_do_not_bias_a_mark() {
    let mut close = Close::new([0.1, -0.3], 7.0, 60.0, 0.0);
    close.scene.blemishes.hot_pixels = [(25, 22), (28, 24), (21, 18)]
        .map(|(x, y)| HotPixel { x, y })
        .to_vec();
    let off = mean_error(&close).norm();
    assert!(off < 0.005, "{off} px");
}

#[test]
fn a_scratch_through_a_mark_biases_it_by_less_than_half_an_arc_second() {
    for (width_mil, brightness) in [(8.0, 1.4), (12.0, 1.4), (12.0, 1.25), (12.0, 1.15)] {
        let mut close = Close::new([0.1, -0.3], 7.0, 60.0, 0.0);
        close.scene.blemishes.scratches = vec![Scratch {
            start: PlateMil::new(-90.0, 40.0),
            end: PlateMil::new(90.0, 15.0),
            width_mil,
            brightness,
        }];
        let off = mean_error(&close).norm();
        assert!(
            off < HALF_ARCSEC_PX,
            "{off} px by a scratch of {width_mil} mil"
        );
    }
}

#[test]
fn a_scratch_in_noise_and_haze_does_not_lose_a_mark() {
    let mut close = Close::new([0.1, -0.3], 7.0, 60.0, 0.0).hazy(2.3);
    for offset_mil in [-30.0, 10.0, 30.0] {
        close.scene.blemishes.scratches = vec![Scratch {
            start: PlateMil::new(-90.0, offset_mil + 15.0),
            end: PlateMil::new(90.0, offset_mil - 15.0),
            width_mil: 10.0,
            brightness: 1.6,
        }];
        let lost = (0..100).filter(|seed| {
            let frame = close.frame(12.0, *seed);
            close.refined(&frame, 12.0, 1.0, 1.0).is_none()
        });
        assert_eq!(lost.count(), 0, "a scratch {offset_mil} mil off");
    }
}

#[test]
fn a_place_without_a_mark_gives_none_or_no_contrast() {
    let close = Close::new([0.0, 0.0], 0.0, 60.0, 0.0);
    let empty = Scene {
        mark_contrast: 0.0,
        noise: Noise::read(5.0),
        ..close.scene.clone()
    };
    if let Some(mark) = close.refined(&empty.frame().unwrap(), 5.0, 1.0, 1.0) {
        assert!(mark.contrast < 0.05, "{mark:?}");
    }
}

/// Comparison of detections with the truth.
#[derive(Default)]
struct Tally {
    fully_lit: usize,
    missed: Vec<(u64, MarkId)>,
    /// Fully lit marks reported as cut.
    called_cut: usize,
    false_marks: usize,
    rotation_errors_deg: Vec<f64>,
    position_errors_px: Vec<f64>,
}

/// Detections in frames with different rotations, each with its own plate and blemishes.
fn tally(frames: u64, change: impl Fn(&mut Conditions) + Sync) -> Tally {
    let outcomes: Vec<_> = (0..frames)
        .into_par_iter()
        .map(|number| {
            let instrument = demo();
            let mut conditions = Conditions::of(&instrument);
            conditions.similarity.rotation_deg = (number as f64 * 37.3) % 360.0;
            change(&mut conditions);
            let scenes = RandomScenes::new(&instrument, &conditions, 900 + number).unwrap();
            let picture = scenes.scene(number).unwrap().picture().unwrap();
            let found = found(&picture, &instrument, conditions.blur_px);
            (number, picture, found)
        })
        .collect();
    let mut tally = Tally::default();
    for (number, picture, found) in &outcomes {
        tally.add(*number, picture, found);
    }
    tally
}

/// Detects marks on the true disc, displaced by the error of a first limb fit, with the fit's brightness and blur.
fn found(picture: &Picture, instrument: &Instrument, lens_blur_px: f64) -> Detections {
    let sun = picture.truth.sun.unwrap();
    let levels = limb::levels(&picture.frame, &limb::LimbSettings::default()).unwrap();
    let cutout = whole(&picture.frame, levels.background_dn, levels.noise_dn);
    let circle = Circle {
        centre: sun.px.vector() + Vector2::new(0.1, -0.1),
        radius: sun.radius_px + 0.1,
    };
    let peak_dn = levels.disc_dn - levels.background_dn;
    let profile = Profile {
        background_dn: 0.0,
        even_dn: 0.44 * peak_dn,
        darkened_dn: 0.56 * peak_dn,
        blur_px: lens_blur_px,
        radius_px: circle.radius,
    };
    let light =
        |x: f64, y: f64| profile.at((Vector2::new(x, y) - circle.centre).norm() - circle.radius);
    let scale = picture.truth.mapping.scale_mil_per_px(sun.px);
    let shape = MarkImage::new(&instrument.plate.shape, scale, lens_blur_px);
    let flat = FlatDisc::new(&cutout, Ellipse::from(circle), &light, &shape).unwrap();
    detect(&flat, &shape, &FiducialSettings::default())
}

impl Tally {
    fn add(&mut self, number: u64, picture: &Picture, found: &Detections) {
        let sun = picture.truth.sun.unwrap();
        let scale = picture.truth.mapping.scale_mil_per_px(sun.px);
        let tip = 45.0 / scale;
        let (width, height) = (picture.frame.width() as f64, picture.frame.height() as f64);
        let whole = |p: SensorPx| {
            p.x > tip && p.x < width - 1.0 - tip && p.y > tip && p.y < height - 1.0 - tip
        };
        let mut fully_lit = 0;
        for mark in &picture.truth.marks {
            if mark.depth_mil < 45.0 || !whole(mark.px) {
                continue;
            }
            fully_lit += 1;
            match found.marks.iter().find(|d| d.at.distance(mark.px) < 2.0) {
                None => self.missed.push((number, mark.id)),
                Some(d) if d.lighting == Lighting::Cut => self.called_cut += 1,
                Some(d) => self.position_errors_px.push(d.at.distance(mark.px)),
            }
        }
        self.fully_lit += fully_lit;
        let is_mark = |at: SensorPx| {
            let near = |mark: &SensorPx| mark.distance(at) < tip;
            picture.truth.marks.iter().any(|mark| near(&mark.px))
        };
        self.false_marks += found.marks.iter().filter(|d| !is_mark(d.at)).count();
        if fully_lit >= 4 {
            let off = found.arms_deg.unwrap().value - picture.truth.mapping.rotation_deg(sun.px);
            self.rotation_errors_deg
                .push((off + 45.0).rem_euclid(90.0) - 45.0);
        }
    }

    fn rotation_rms_deg(&self) -> f64 {
        let squares: f64 = self.rotation_errors_deg.iter().map(|e| e * e).sum();
        (squares / self.rotation_errors_deg.len() as f64).sqrt()
    }
}

#[test]
fn every_fully_lit_mark_is_found_and_known_to_be_lit() {
    type Change = fn(&mut Conditions);
    let conditions: [(&str, Change); 8] = [
        ("plain", |_| {}),
        ("noise", |c| c.noise = Noise::read(15.0)),
        ("nearer", |c| c.similarity.scale_mil_per_px /= 1.1),
        ("farther", |c| c.similarity.scale_mil_per_px *= 1.1),
        ("pale marks", |c| c.mark_contrast = 0.25),
        ("part of the disc", |c| c.sun = SunInView::Partial),
        ("vignetting", |c| c.blemishes.vignetting = 0.2),
        ("keystone", |c| c.keystone_deg = 3.0),
    ];
    for (name, change) in conditions {
        let tally = tally(24, change);
        assert!(tally.fully_lit > 20, "{name}");
        assert_eq!(tally.missed, [], "{name}");
        assert_eq!(tally.false_marks, 0, "{name}");
        assert!(
            tally.called_cut * 50 <= tally.fully_lit,
            "{name}: {}",
            tally.called_cut
        );
        let worst = tally.position_errors_px.iter().copied().fold(0.0, f64::max);
        assert!(worst < 0.35, "{name}: {worst} px");
    }
}

#[test]
fn haze_hides_hardly_any_mark() {
    let tally = tally(24, |c| {
        c.blur_px = 2.5;
        c.peak_dn = 150.0;
    });
    assert!(
        tally.missed.len() * 50 <= tally.fully_lit,
        "{:?}",
        tally.missed
    );
    assert_eq!(tally.false_marks, 0);
}

#[test]
fn sunspots_dust_scratches_and_leaks_are_not_taken_for_marks() {
    for noise_dn in [5.0, 15.0] {
        let tally = tally(40, |c| {
            c.noise = Noise::read(noise_dn);
            c.sunspots = 8;
            c.blemishes = Counts {
                hot_pixels: 60,
                scratches_per_disc: 2.0,
                leaks: 4,
                dust_per_disc: 2.0,
                vignetting: 0.1,
            };
        });
        assert_eq!(tally.false_marks, 0, "at {noise_dn} DN");
        assert!(
            tally.missed.len() * 100 <= tally.fully_lit,
            "{:?}",
            tally.missed
        );
    }
}

#[test]
fn the_arms_give_the_rotation() {
    let tally = tally(40, |_| {});
    let rms = tally.rotation_rms_deg();
    assert!(rms < 0.2, "{rms} deg");
}
