//! Simulated pictures agree with their truth. The test computes it from moments, brute force and hand arithmetic, never
//! from the renderer.

use nalgebra::Vector2;
use solaspect::frame::{Frame, Pixels};
use solaspect::geometry::{Distortion, Handedness, Mapping, SimilarityParameters};
use solaspect::instrument::{Instrument, builtin};
use solaspect::plate::heroes;
use solaspect::simulate::{
    Blemishes, Coma, Conditions, Counts, Depth, Dust, Extent, Ghost, Gradient, HotPixel, Leak,
    Noise, RandomScenes, Readout, Scene, Scratch, StrayLight, Sun, SunInView, Sunspot, Surface,
    keystoned, render_exact, render_oversampled, scattered,
};
use solaspect::units::{PlateMil, SensorPx};

const RADIUS_MIL: f64 = 547.19;

fn demo() -> Instrument {
    builtin("demo").unwrap()
}

fn view(centre: SensorPx, rotation_deg: f64) -> SimilarityParameters {
    SimilarityParameters {
        plate_centre: centre,
        scale_mil_per_px: 5.75,
        rotation_deg,
        handedness: Handedness::Mirrored,
    }
}

/// A noise-free scene of `side` x `side` px.
fn small_scene(side: usize, parameters: SimilarityParameters) -> Scene {
    Scene {
        width_px: side,
        height_px: side,
        ..Scene::new(
            &demo(),
            Mapping::similarity(parameters, Distortion::NONE).unwrap(),
        )
    }
}

/// Centroid of weights given per pixel, and their sum.
fn centroid(width: usize, weights: impl Iterator<Item = f64>) -> (SensorPx, f64) {
    let (mut sum, mut x, mut y) = (0.0, 0.0, 0.0);
    for (n, weight) in weights.enumerate() {
        sum += weight;
        x += weight * (n % width) as f64;
        y += weight * (n / width) as f64;
    }
    (SensorPx::new(x / sum, y / sum), sum)
}

/// The rendered scene minus the background, DN per pixel.
fn light(scene: &Scene) -> impl Iterator<Item = f64> {
    let background = scene.background_dn;
    render_exact(scene)
        .into_iter()
        .map(move |dn| f64::from(dn) - background)
}

fn phases() -> impl Iterator<Item = (f64, f64)> {
    (0..25).map(|k| {
        (
            f64::from(k % 5) * 0.2 + 0.013,
            f64::from(k / 5) * 0.2 - 0.031,
        )
    })
}

#[test]
fn the_disc_stands_where_the_truth_says_to_a_thousandth_of_a_pixel() {
    let mut worst = 0.0_f64;
    for (n, (dx, dy)) in phases().enumerate() {
        let centre = SensorPx::new(120.0 + dx, 119.0 + dy);
        let mut scene = small_scene(240, view(centre, 17.0));
        let sun = Sun::new(PlateMil::new(30.0, -20.0), RADIUS_MIL);
        scene.mark_contrast = 0.0;
        scene.sun = Some(Sun {
            smear_mil: Vector2::new(7.5, -2.0) * (n % 2) as f64,
            ..sun
        });
        let truth = scene.truth().sun.unwrap();
        let (found, _) = centroid(240, light(&scene));
        worst = worst.max(found.distance(truth.px));
    }
    println!("disc: worst error {worst:.6} px");
    assert!(worst < 1e-3, "{worst} px");
}

#[test]
fn a_mark_stands_where_the_truth_says_to_a_thousandth_of_a_pixel() {
    let mut worst = 0.0_f64;
    for rotation_deg in [0.0, 7.0, 33.0] {
        for (dx, dy) in phases() {
            let centre = SensorPx::new(26.0 + dx, 26.0 + dy);
            let mut scene = small_scene(54, view(centre, rotation_deg));
            // The Sun is so large that it illuminates the field evenly; no other mark reaches into the field.
            scene.sun = Some(Sun {
                limb_darkening: 0.0,
                ..Sun::new(PlateMil::new(0.0, 0.0), 2000.0)
            });
            let (found, dark) = centroid(54, light(&scene).map(|l| 205.0 - l));
            worst = worst.max(found.distance(centre));
            // The area of two crossed arms, each 90 x 12 mil; their overlap of 12 x 12 mil counts once.
            let area_px = (2.0 * 90.0 * 12.0 - 12.0 * 12.0) / 5.75_f64.powi(2);
            assert!((dark / (0.8 * 205.0 * area_px) - 1.0).abs() < 1e-3);
        }
    }
    println!("mark: worst error {worst:.6} px");
    assert!(worst < 1e-3, "{worst} px");
}

/// A tilted view through a distorting lens, with a sunspot and a scratch.
fn tilted_scene() -> Scene {
    let lens = Distortion {
        centre: SensorPx::new(647.5, 482.5),
        radial: [8e-9, 0.0],
        decentring: [1e-7, 0.0],
    };
    let mapping = keystoned(view(SensorPx::new(650.3, 481.1), 11.0), 3.0, 1296, lens).unwrap();
    let mut scene = Scene::new(&demo(), mapping);
    scene.sun = Some(Sun {
        spots: vec![Sunspot {
            offset_mil: Vector2::new(-100.0, 150.0),
            radius_mil: 12.0,
            contrast: 0.5,
        }],
        ..Sun::new(PlateMil::new(-900.0, 700.0), RADIUS_MIL)
    });
    scene.blemishes.scratches.push(Scratch {
        start: PlateMil::new(-700.0, 500.0),
        end: PlateMil::new(-1600.0, 620.0),
        width_mil: 9.0,
        brightness: 1.3,
    });
    scene
}

/// Brightness of the plate at a point, DN, directly from the formulas.
fn light_at(scene: &Scene, near: &[PlateMil], at: PlateMil) -> f64 {
    let sun = scene.sun.as_ref().unwrap();
    let r = at.distance(sun.centre) / sun.radius_mil;
    if r >= 1.0 {
        return 0.0;
    }
    let mut light = sun.peak_dn * (1.0 - sun.limb_darkening * (1.0 - (1.0 - r * r).sqrt()));
    for spot in &sun.spots {
        if (at.vector() - sun.centre.vector() - spot.offset_mil).norm() < spot.radius_mil {
            light *= 1.0 - spot.contrast;
        }
    }
    let on_a_mark = near.iter().any(|mark| {
        let (dx, dy) = ((at.x - mark.x).abs(), (at.y - mark.y).abs());
        dx.max(dy) < 45.0 && dx.min(dy) < 6.0
    });
    if on_a_mark {
        light *= 1.0 - scene.mark_contrast;
    }
    for scratch in &scene.blemishes.scratches {
        let run = scratch.end.vector() - scratch.start.vector();
        let from_start = at.vector() - scratch.start.vector();
        let along = from_start.dot(&run.normalize());
        let across = from_start.perp(&run.normalize()).abs();
        if (0.0..run.norm()).contains(&along) && across < scratch.width_mil / 2.0 {
            light *= scratch.brightness;
        }
    }
    light
}

/// A pixel by brute force: brightness at points 1/40 px apart, weighted by the blur and the pixel's square.
fn pixel_by_brute_force(scene: &Scene, x: usize, y: usize) -> f64 {
    const PER_PX: i32 = 40;
    let reach = 5 * PER_PX;
    let weights: Vec<f64> = (-reach..=reach)
        .map(|t| {
            (0..PER_PX)
                .map(|k| f64::from(t) + f64::from(k) - f64::from(PER_PX - 1) / 2.0)
                .map(|d| (-0.5 * (d / f64::from(PER_PX) / scene.blur_px).powi(2)).exp())
                .sum()
        })
        .collect();
    let total: f64 = weights.iter().sum();
    let middle = scene.mapping.to_plate(SensorPx::new(x as f64, y as f64));
    let marks = scene.plate.marks().map(|(_, mark)| mark);
    let near: Vec<PlateMil> = marks.filter(|m| m.distance(middle) < 200.0).collect();
    let mut sum = 0.0;
    for (wy, v) in weights.iter().zip(-reach..=reach) {
        for (wx, u) in weights.iter().zip(-reach..=reach) {
            let seen = SensorPx::new(
                x as f64 + f64::from(u) / f64::from(PER_PX),
                y as f64 + f64::from(v) / f64::from(PER_PX),
            );
            sum += wx * wy * light_at(scene, &near, scene.mapping.to_plate(seen));
        }
    }
    sum / (total * total)
}

#[test]
fn every_kind_of_pixel_agrees_with_brute_force() {
    let scene = tilted_scene();
    let sun = scene.sun.as_ref().unwrap();
    let on_limb = |k: u32| {
        let angle = f64::from(k) * 0.7;
        sun.centre.vector() + Vector2::new(angle.cos(), angle.sin()) * RADIUS_MIL
    };
    let mark = scene
        .truth()
        .marks
        .iter()
        .find(|m| m.depth_mil > 100.0)
        .unwrap()
        .plate;
    let around_mark = [
        (0.0, 0.0),
        (43.0, 3.0),
        (-44.0, -5.0),
        (8.0, 8.0),
        (2.0, -45.0),
    ]
    .map(|(x, y)| mark.vector() + Vector2::new(x, y));
    let spot = sun.centre.vector() + sun.spots[0].offset_mil;
    let scratch = Vector2::new(-1000.0, 540.0);
    let places = (0..9)
        .map(on_limb)
        .chain(around_mark)
        .chain([spot, scratch]);
    let picture = render_exact(&scene);
    let mut worst = 0.0_f64;
    for place in places {
        let seen = scene.mapping.to_sensor(place.into());
        let (x, y) = (seen.x.round() as usize, seen.y.round() as usize);
        let rendered = f64::from(picture[y * scene.width_px + x]) - scene.background_dn;
        worst = worst.max((rendered - pixel_by_brute_force(&scene, x, y)).abs());
    }
    println!("brute force: worst difference {worst:.4} DN");
    assert!(worst < 0.2, "{worst} DN");
}

#[test]
fn finer_sampling_changes_no_pixel_by_a_digital_number() {
    let scene = tilted_scene();
    let (usual, fine) = (render_exact(&scene), render_oversampled(&scene, 9));
    let differences = usual.iter().zip(&fine).map(|(a, b)| (a - b).abs());
    let worst = differences.fold(0.0, f32::max);
    println!("3 against 9 samples per px: worst difference {worst:.4} DN");
    // The worst pixels are those where an arm of a mark runs along the limb.
    assert!(worst < 0.7, "{worst} DN");
    let scene = Scene {
        mark_contrast: 0.0,
        ..scene
    };
    let (usual, fine) = (render_exact(&scene), render_oversampled(&scene, 9));
    let differences = usual.iter().zip(&fine).map(|(a, b)| (a - b).abs());
    let worst = differences.fold(0.0, f32::max);
    println!("the same without marks: {worst:.4} DN");
    assert!(worst < 0.3, "{worst} DN");
}

#[test]
fn motion_widens_the_disc_along_itself_only() {
    let variance = |smear_px: f64| {
        let mut scene = small_scene(240, view(SensorPx::new(120.3, 119.6), 0.0));
        scene.mark_contrast = 0.0;
        scene.sun = Some(Sun {
            smear_mil: Vector2::new(smear_px * 5.75, 0.0),
            ..Sun::new(PlateMil::new(0.0, 0.0), RADIUS_MIL)
        });
        let picture: Vec<f64> = light(&scene).collect();
        let (middle, sum) = centroid(240, picture.iter().copied());
        let moment = |of: &dyn Fn(usize) -> f64| {
            let all = picture.iter().enumerate().map(|(n, l)| l * of(n).powi(2));
            all.sum::<f64>() / sum
        };
        let x = moment(&|n| (n % 240) as f64 - middle.x);
        let y = moment(&|n| (n / 240) as f64 - middle.y);
        (x, y)
    };
    let (still, moving) = (variance(0.0), variance(6.0));
    // A uniform motion of length L adds L^2 / 12 to the variance.
    assert!(
        (moving.0 - still.0 - 3.0).abs() < 0.03,
        "{}",
        moving.0 - still.0
    );
    assert!((moving.1 - still.1).abs() < 0.02);
}

#[test]
fn a_keystone_is_the_one_that_is_written_down() {
    let (centre, turn) = (SensorPx::new(640.0, 480.0), 30.0_f64);
    let mapping = keystoned(view(centre, turn), 3.0, 1296, Distortion::NONE).unwrap();
    let plate = PlateMil::new(1150.0, -575.0);
    let (sin, cos) = turn.to_radians().sin_cos();
    // Mirrored: x falls with X. 200 and 100 px at 5.75 mil/px, then the turn.
    let (u, v) = (-200.0, -100.0);
    let q = Vector2::new(cos * u - sin * v, sin * u + cos * v);
    let k = 3.0_f64.to_radians().tan() / (4.0 * 1296.0);
    let expected = centre.vector() + q / (1.0 + k * q.x);
    assert!((mapping.to_sensor(plate).vector() - expected).norm() < 1e-9);
    assert!(keystoned(view(centre, f64::NAN), 3.0, 1296, Distortion::NONE).is_none());
}

fn values(frame: &Frame) -> Vec<f64> {
    match frame.pixels() {
        Pixels::U8(pixels) => pixels.iter().map(|&p| f64::from(p)).collect(),
        Pixels::U16(pixels) => pixels.iter().map(|&p| f64::from(p)).collect(),
    }
}

fn mean_and_variance(values: &[f64]) -> (f64, f64) {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let squares = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
    (mean, squares / values.len() as f64)
}

#[test]
fn noise_and_depth_are_as_stated() {
    let mut scene = small_scene(300, view(SensorPx::new(150.0, 150.0), 0.0));
    scene.background_dn = 100.0;
    scene.noise = Noise {
        read_dn: 3.0,
        electrons_per_dn: Some(25.0),
    };
    scene.depth = Depth::Twelve;
    let frame = scene.frame().unwrap();
    let (mean, variance) = mean_and_variance(&values(&frame));
    // 90 000 pixels: 1 sigma of the mean is 0.01 DN, of the variance 0.5 %.
    assert!((mean / 16.0 - 100.0).abs() < 0.05, "{mean}");
    assert!(
        (variance / 256.0 - (9.0 + 100.0 / 25.0)).abs() < 0.3,
        "{variance}"
    );
    assert_eq!(frame.saturation_dn(), 4095);
    scene.depth = Depth::Eight;
    scene.background_dn = 300.0;
    let frame = scene.frame().unwrap();
    assert_eq!(frame.saturation_dn(), 255);
    assert!(values(&frame).iter().all(|&v| v == 255.0));
}

#[test]
fn the_same_scene_gives_the_same_frame_and_another_seed_another() {
    let mut conditions = Conditions::of(&demo());
    conditions.sunspots = 2;
    conditions.blemishes = Counts {
        hot_pixels: 5,
        scratches_per_disc: 2.0,
        leaks: 2,
        dust_per_disc: 3.0,
        vignetting: 0.1,
    };
    let frame = |seed: u64, number: u64| {
        let scenes = RandomScenes::new(&demo(), &conditions, seed).unwrap();
        scenes.scene(number).unwrap().frame().unwrap()
    };
    assert_eq!(frame(7, 3), frame(7, 3));
    assert_ne!(frame(7, 3).pixels(), frame(7, 4).pixels());
    assert_ne!(frame(7, 3).pixels(), frame(8, 3).pixels());
}

#[test]
fn blemishes_do_what_their_names_say() {
    let mut scene = small_scene(256, view(SensorPx::new(128.0, 128.0), 0.0));
    scene.mark_contrast = 0.0;
    scene.sun = Some(Sun {
        limb_darkening: 0.0,
        ..Sun::new(PlateMil::new(0.0, 0.0), 400.0)
    });
    scene.blemishes = Blemishes {
        hot_pixels: vec![HotPixel { x: 3, y: 250 }],
        // A scratch across the whole picture, 20 px below the middle; illuminated where |x - 128| < 66.
        scratches: vec![Scratch {
            start: PlateMil::new(-700.0, 115.0),
            end: PlateMil::new(700.0, 115.0),
            width_mil: 11.5,
            brightness: 1.2,
        }],
        leaks: vec![Leak {
            centre: PlateMil::new(-575.0, -575.0),
            sigma_px: 4.0,
            peak_dn: 30.0,
        }],
        dust: vec![Dust {
            centre: SensorPx::new(128.0, 90.0),
            sigma_px: 3.0,
            depth: 0.25,
        }],
        vignetting: 0.0,
    };
    let at = |scene: &Scene, x: usize, y: usize| values(&scene.frame().unwrap())[y * 256 + x];
    assert_eq!(at(&scene, 3, 250), 255.0);
    assert_eq!(at(&scene, 20, 148), 4.0);
    assert!(at(&scene, 128, 148) > 225.0);
    assert_eq!(at(&scene, 128, 128), 209.0);
    assert_eq!(at(&scene, 228, 28), 34.0);
    assert_eq!(at(&scene, 128, 90), (4.0_f64 + 0.75 * 205.0).round());
    scene.blemishes.vignetting = 0.5;
    // At 40 px of 180.3 px from the middle, the loss is 0.5 (40 / 180.3)^2.
    assert!((at(&scene, 167, 127) - (4.0 + 205.0 * (1.0 - 0.5 * 0.0482))).abs() < 1.0);
}

#[test]
fn marks_scatter_by_the_stated_rms_and_the_truth_follows_them() {
    let plate = scattered(&demo().plate, 1.0, 4);
    let squares = heroes::ids().map(|id| {
        let off = plate.position(id).unwrap().vector() - heroes::position(id).vector();
        off.norm_squared() / 2.0
    });
    // 450 coordinates: 1 sigma of the rms is 3.3 %.
    let rms = (squares.sum::<f64>() / 225.0).sqrt();
    assert!((rms - 1.0).abs() < 0.15, "{rms}");
    let mut scene = small_scene(240, view(SensorPx::new(120.0, 120.0), 0.0));
    scene.sun = Some(Sun::new(PlateMil::new(0.0, 0.0), RADIUS_MIL));
    scene.plate = plate.clone();
    let marks = scene.truth().marks;
    assert!(marks.len() >= 5);
    for mark in marks {
        assert_eq!(Some(mark.plate), plate.position(mark.id));
        assert!(mark.depth_mil > -45.0);
    }
}

#[test]
fn random_suns_stand_where_the_conditions_want_them() {
    for in_view in [SunInView::Whole, SunInView::Partial, SunInView::Absent] {
        let conditions = Conditions {
            sun: in_view,
            keystone_deg: 3.0,
            ..Conditions::of(&demo())
        };
        let scenes = RandomScenes::new(&demo(), &conditions, 5).unwrap();
        for number in 0..200 {
            let Some(sun) = scenes.scene(number).unwrap().truth().sun else {
                assert_eq!(in_view, SunInView::Absent);
                continue;
            };
            let x = sun.px.x.min(1295.0 - sun.px.x);
            let y = sun.px.y.min(965.0 - sun.px.y);
            let depth = x.min(y) / sun.radius_px;
            match in_view {
                SunInView::Whole => assert!(depth > 1.0, "{depth}"),
                SunInView::Partial => assert!((-0.7..1.1).contains(&depth), "{depth}"),
                SunInView::Absent => panic!("a Sun where none was wanted"),
            }
        }
    }
}

/// The tilted camera's whole Sun on a sensor of 1296 x 966 px.
fn with_stray(stray: StrayLight) -> Scene {
    Scene {
        stray,
        ..tilted_scene()
    }
}

#[test]
fn a_ghost_holds_its_share_of_the_light_where_it_is_shifted_to() {
    let plain = tilted_scene();
    let offset_px = Vector2::new(300.0, -200.0);
    let ghost = Ghost {
        share: 0.02,
        offset_px,
        blur_px: 5.0,
    };
    let scene = with_stray(StrayLight {
        ghost: Some(ghost),
        ..StrayLight::default()
    });
    assert_eq!(scene.truth(), plain.truth());
    let (centre, total) = centroid(1296, light(&plain));
    let added = light(&scene)
        .zip(light(&plain))
        .map(|(with, without)| with - without);
    let (at, ghost_total) = centroid(1296, added);
    assert!(
        (ghost_total / total - 0.02).abs() < 2e-5,
        "{}",
        ghost_total / total
    );
    // Pixels have single precision: errors of 1e-5 DN over a million pixels.
    let error = (at.vector() - centre.vector() - offset_px).norm();
    assert!(error < 0.1, "{error} px");
}

#[test]
fn a_ghost_from_beyond_the_sensor_reaches_it() {
    let mut scene = small_scene(100, view(SensorPx::new(300.0, 50.0), 0.0));
    scene.mark_contrast = 0.0;
    scene.sun = Some(Sun {
        limb_darkening: 0.0,
        ..Sun::new(PlateMil::new(0.0, 0.0), 575.0)
    });
    scene.stray.ghost = Some(Ghost {
        share: 0.02,
        offset_px: Vector2::new(-250.0, 0.0),
        blur_px: 2.0,
    });
    assert!((render_exact(&scene)[50 * 100 + 50] - (4.0 + 0.02 * 205.0)).abs() < 1e-3);
}

#[test]
fn coma_displaces_its_share_and_keeps_the_centroid_and_the_light() {
    let plain = tilted_scene();
    let scene = with_stray(StrayLight {
        coma: Some(Coma {
            share: 0.1,
            offset_px: Vector2::new(1.5, 0.0),
            blur_px: 2.5,
        }),
        ..StrayLight::default()
    });
    assert_eq!(scene.truth(), plain.truth());
    let moments = |scene: &Scene| {
        let (centre, total) = centroid(1296, light(scene));
        let third: f64 = light(scene)
            .enumerate()
            .map(|(n, l)| l * ((n % 1296) as f64 - centre.x).powi(3))
            .sum();
        (centre, total, third / total)
    };
    let ((at, total, third), (before, plain_total, plain_third)) =
        (moments(&scene), moments(&plain));
    assert!(at.distance(before) < 1e-3, "{}", at.distance(before));
    assert!((total / plain_total - 1.0).abs() < 1e-5);
    // Third moment, the sum of w (d^3 + 3 d s^2): weight 0.9 at -0.15 px, and 0.1 at 1.35 px with an added variance of 2.5^2 px^2.
    let expected = 0.9 * (-0.15_f64).powi(3) + 0.1 * (1.35_f64.powi(3) + 3.0 * 1.35 * 6.25);
    assert!(
        (third - plain_third - expected).abs() < 0.1,
        "{} {expected}",
        third - plain_third
    );
}

#[test]
fn gradients_rise_as_far_as_they_say() {
    for (direction_rad, dark, bright) in [
        (0.3_f64, (0, 0), (1295, 965)),
        (2.5, (1295, 0), (0, 965)),
        (-2.0, (1295, 965), (0, 0)),
    ] {
        let sensor = Gradient {
            rise_dn: 13.0,
            direction_rad,
            across: Extent::Sensor,
        };
        let scene = Scene {
            sun: None,
            ..with_stray(StrayLight {
                gradients: vec![sensor],
                ..StrayLight::default()
            })
        };
        let pixels = render_exact(&scene);
        let at = |(x, y): (usize, usize)| f64::from(pixels[y * 1296 + x]);
        assert!((at(dark) - 4.0).abs() < 1e-3, "{}", at(dark));
        assert!((at(bright) - 17.0).abs() < 1e-3, "{}", at(bright));
    }
    let disc = Gradient {
        rise_dn: 5.0,
        direction_rad: 0.7,
        across: Extent::Disc,
    };
    let scene = with_stray(StrayLight {
        gradients: vec![disc],
        ..StrayLight::default()
    });
    let sun = scene.truth().sun.unwrap();
    let (with, without) = (render_exact(&scene), render_exact(&tilted_scene()));
    for reach in [-3.0, -1.0, 0.0, 1.0] {
        let along = Vector2::new(0.7_f64.cos(), 0.7_f64.sin()) * reach * sun.radius_px;
        let (x, y) = ((sun.px.x + along.x).round(), (sun.px.y + along.y).round());
        let n = y as usize * 1296 + x as usize;
        let added = f64::from(with[n] - without[n]);
        let expected = (5.0 + 2.5 * reach).max(0.0);
        // The nearest pixel is up to 0.7 px from the point.
        assert!((added - expected).abs() < 0.02, "{reach}: {added}");
    }
}

#[test]
fn smear_adds_the_share_of_the_columns_light_and_the_tap_step_half_of_the_sensor() {
    let plain = tilted_scene();
    let scene = Scene {
        readout: Readout {
            column_smear: 2e-4,
            tap_step_dn: 2.0,
        },
        ..tilted_scene()
    };
    assert_eq!(scene.truth(), plain.truth());
    let clean: Vec<f64> = light(&plain).collect();
    let found: Vec<f64> = light(&scene).collect();
    for x in 0..1296 {
        let total: f64 = (0..966).map(|y| clean[y * 1296 + x]).sum();
        let step = if x >= 648 { 2.0 } else { 0.0 };
        for y in [0, 500, 965] {
            let added = found[y * 1296 + x] - clean[y * 1296 + x];
            assert!(
                (added - step - 2e-4 * total).abs() < 1e-3,
                "{x}, {y}: {added}"
            );
        }
    }
}

#[test]
fn the_noise_of_photons_has_the_variance_of_signal_over_gain() {
    for light_dn in [20.0, 100.0, 200.0] {
        let mut scene = small_scene(300, view(SensorPx::new(150.0, 150.0), 0.0));
        scene.background_dn = light_dn;
        scene.noise = Noise {
            read_dn: 1.0,
            electrons_per_dn: Some(4.0),
        };
        let (_, variance) = mean_and_variance(&values(&scene.frame().unwrap()));
        // Read noise, photon noise and rounding to 1 DN; 90 000 pixels: 1 sigma of the variance is 0.5 %.
        let expected = 1.0 + light_dn / 4.0 + 1.0 / 12.0;
        assert!((variance / expected - 1.0).abs() < 0.02, "{variance}");
    }
}

#[test]
fn the_surface_of_hmi_leaves_the_limb_and_shows_spots() {
    let mut scene = small_scene(260, view(SensorPx::new(130.3, 129.6), 0.0));
    scene.mark_contrast = 0.0;
    scene.sun = Some(Sun::new(PlateMil::new(0.0, 0.0), RADIUS_MIL));
    let plain = scene.clone();
    for (turn_rad, mirrored) in [(0.0, false), (1.0, false), (1.0, true)] {
        if let Some(sun) = &mut scene.sun {
            sun.surface = Surface::Hmi { turn_rad, mirrored };
        }
        assert_eq!(scene.truth(), plain.truth());
        let (bare, found) = (render_exact(&plain), render_exact(&scene));
        let place = |n: usize| {
            let (x, y) = ((n % 260) as f64 - 130.3, (n / 260) as f64 - 129.6);
            x.hypot(y) / (RADIUS_MIL / 5.75)
        };
        let ratios = |from: f64, to: f64| -> Vec<f32> {
            let within = (0..found.len()).filter(|n| (from..to).contains(&place(*n)));
            let mut ratios: Vec<f32> = within.map(|n| found[n] / bare[n]).collect();
            ratios.sort_by(f32::total_cmp);
            ratios
        };
        let (middle, rim, beyond) = (ratios(0.0, 0.3), ratios(0.9, 0.97), ratios(1.05, 1.2));
        let median = |of: &[f32]| of[of.len() / 2];
        assert!((median(&middle) - 1.0).abs() < 0.02, "{}", median(&middle));
        // The real limb darkening at 617 nm is not linear; the difference is a few per cent.
        assert!((0.97..1.06).contains(&median(&rim)), "{}", median(&rim));
        assert!(beyond.iter().all(|r| (r - 1.0).abs() < 1e-3));
        // The darkest of its small spots, blurred.
        let deepest = ratios(0.0, 0.93)[0];
        assert!((0.86..0.92).contains(&deepest), "{deepest}");
    }
    let turned = |turn_rad: f64, mirrored: bool| {
        let mut scene = plain.clone();
        if let Some(sun) = &mut scene.sun {
            sun.surface = Surface::Hmi { turn_rad, mirrored };
        }
        render_exact(&scene)
    };
    assert_ne!(turned(0.3, false), turned(0.3, true));
}
