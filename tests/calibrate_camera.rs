//! `solaspect calibrate camera` determines noise, gain, hot pixels, vignetting and blur, and reports what it cannot
//! determine.

use solaspect::aspect::{self, Expected, Quality};
use solaspect::calibrate::revision::Revision;
use solaspect::fits::{self, Compression};
use solaspect::frame::{Frame, FrameInfo, Pixels};
use solaspect::instrument::{Instrument, builtin, builtin_text};
use solaspect::observe::{self, RejectedFrame};
use solaspect::simulate::{
    Conditions, Counts, Depth, HotPixel, Noise, RandomScenes, SUN_RADIUS_ARCSEC, Scene, Sun,
};
use solaspect::units::PlateMil;
use std::path::Path;
use std::process::{Command, Output};
use std::time::Duration;

const READ_DN: f64 = 2.0;
const ELECTRONS_PER_DN: f64 = 40.0;
const LEVEL_DN: f64 = 16.0;
const CORNER_LOSS: f64 = 0.3;

fn solaspect(arguments: &[&str]) -> Output {
    let program = env!("CARGO_BIN_EXE_solaspect");
    Command::new(program).args(arguments).output().unwrap()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn save(folder: &Path, number: usize, frame: &Frame) {
    std::fs::create_dir_all(folder).unwrap();
    let file = folder.join(format!("frame_{number:05}.fits"));
    fits::write_frame(&file, frame, &[], &[], Compression::Rice).unwrap();
}

fn hot_pixels() -> Vec<HotPixel> {
    let at = |n: usize| HotPixel {
        x: 37 + 97 * n % 1200,
        y: 11 + 61 * n % 900,
    };
    (0..25).map(at).collect()
}

/// A dark scene of a camera with known noise, gain, hot pixels and vignetting.
fn covered(seed: u64) -> Scene {
    let demo = builtin("demo").unwrap();
    let mut scene = Scene::new(&demo, demo.nominal_mapping().unwrap());
    scene.background_dn = LEVEL_DN;
    scene.noise = Noise {
        read_dn: READ_DN,
        electrons_per_dn: Some(ELECTRONS_PER_DN),
    };
    scene.depth = Depth::Twelve;
    scene.blemishes.hot_pixels = hot_pixels();
    scene.blemishes.vignetting = CORNER_LOSS;
    scene.seed = seed;
    scene.info = FrameInfo {
        exposure: Some(Duration::from_millis(15)),
        ..FrameInfo::default()
    };
    scene
}

/// The same camera, uniformly illuminated.
fn lit(peak_dn: f64, seed: u64) -> Scene {
    let mut scene = covered(seed);
    let even = Sun::new(PlateMil::new(0.0, 0.0), 1e5);
    scene.sun = Some(Sun {
        peak_dn,
        limb_darkening: 0.0,
        ..even
    });
    scene.mark_contrast = 0.0;
    scene.info.exposure = Some(Duration::from_micros((peak_dn * 100.0) as u64));
    scene
}

/// Loss of light at the sensor's corner by the found vignetting; the truth is `CORNER_LOSS`.
fn corner_loss(instrument: &Instrument) -> f64 {
    let vignetting = instrument.sensor.vignetting.unwrap();
    1.0 - vignetting.share(solaspect::units::SensorPx::new(0.0, 0.0))
}

#[test]
fn dark_and_flat_frames_determine_noise_gain_hot_pixels_and_vignetting() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    for n in 0..6 {
        save(&at("dark"), n, &covered(n as u64).frame().unwrap());
    }
    for (k, peak) in [40.0, 100.0, 180.0].into_iter().enumerate() {
        for n in 2 * k..2 * k + 2 {
            save(&at("flat"), n, &lit(peak, 100 + n as u64).frame().unwrap());
        }
    }
    let new = at("new.toml");
    let done = solaspect(&[
        "calibrate",
        "camera",
        "--dark",
        text(&at("dark")),
        "--flat",
        text(&at("flat")),
        "--out",
        text(&new),
        "--report",
        text(&at("report")),
    ]);
    assert!(done.status.success(), "{done:?}");
    let said = String::from_utf8_lossy(&done.stdout);
    let found = Instrument::read(&new).unwrap();
    let noise = found.sensor.noise.unwrap();
    // With 12 bits, one DN of the simulator is 16 DN.
    assert_eq!(noise.saturation_dn, 4095);
    let near = |value: f64, wanted: f64, part: f64| (value / wanted - 1.0).abs() < part;
    assert!(near(noise.dark_dn.value, 16.0 * LEVEL_DN, 0.002), "{said}");
    let without_light = (READ_DN.powi(2) + LEVEL_DN / ELECTRONS_PER_DN).sqrt();
    assert!(
        near(noise.read_noise_dn.value, 16.0 * without_light, 0.005),
        "{said}"
    );
    let gain = noise.gain_dn_per_electron.unwrap();
    let normalised = (gain.value - 16.0 / ELECTRONS_PER_DN) / gain.sigma;
    assert!(
        normalised.abs() < 4.0 && gain.sigma < 0.02 * gain.value,
        "{said}"
    );
    let mut wanted: Vec<_> = hot_pixels().iter().map(|hot| (hot.x, hot.y)).collect();
    let mut listed = found.sensor.hot_pixels.clone();
    wanted.sort_unstable();
    wanted.dedup();
    listed.sort_unstable();
    assert_eq!(listed, wanted);
    assert!(
        (corner_loss(&found) - CORNER_LOSS).abs() < 0.005,
        "{}",
        corner_loss(&found)
    );
    assert!(said.contains("blur: not determined"), "{said}");
    let html = std::fs::read_to_string(at("report").join("camera.html")).unwrap();
    assert!(html.contains("Photon transfer") && html.contains("<svg"));
}

/// Writes frames of the Sun by a camera with known blemishes; each is 1.5 degC warmer, with a larger blur and scale.
fn sun_frames(folder: &Path, count: u64, conditions: &Conditions) {
    let demo = builtin("demo").unwrap();
    for n in 0..count {
        let warmer_c = 1.5 * n as f64;
        let mut now = conditions.clone();
        now.blur_px += 0.01 * warmer_c;
        now.similarity.scale_mil_per_px *= 1.0 + 2e-5 * warmer_c;
        let mut scene = RandomScenes::new(&demo, &now, 4).unwrap().scene(n).unwrap();
        scene.info.camera_temperature_c = Some(10.0 + warmer_c);
        scene.info.mid_exposure = Some("2013-09-21T18:00:00Z".parse().unwrap());
        save(folder, n as usize, &scene.frame().unwrap());
    }
}

fn conditions() -> Conditions {
    Conditions {
        background_dn: LEVEL_DN,
        noise: Noise {
            read_dn: READ_DN,
            electrons_per_dn: Some(ELECTRONS_PER_DN),
        },
        blemishes: Counts {
            hot_pixels: 30,
            vignetting: CORNER_LOSS,
            ..Counts::default()
        },
        peak_dn: 180.0,
        ..Conditions::of(&builtin("demo").unwrap())
    }
}

#[test]
fn frames_of_the_sun_alone_determine_most_of_it_and_the_dependence_on_temperature() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    sun_frames(&at("sun"), 24, &conditions());
    let new = at("new.toml");
    let done = solaspect(&["calibrate", "camera", "--out", text(&new), text(&at("sun"))]);
    assert!(done.status.success(), "{done:?}");
    let said = String::from_utf8_lossy(&done.stdout);
    let found = Instrument::read(&new).unwrap();
    let noise = found.sensor.noise.unwrap();
    assert!((noise.dark_dn.value - LEVEL_DN).abs() < 0.1, "{said}");
    let without_light = (READ_DN.powi(2) + LEVEL_DN / ELECTRONS_PER_DN).sqrt();
    assert!(
        (noise.read_noise_dn.value - without_light).abs() < 0.06,
        "{said}"
    );
    let gain = noise.gain_dn_per_electron.unwrap().value;
    assert!((gain * ELECTRONS_PER_DN - 1.0).abs() < 0.15, "{said}");
    assert!((corner_loss(&found) - CORNER_LOSS).abs() < 0.03, "{said}");
    assert_eq!(found.sensor.hot_pixels.len(), 30, "{said}");
    let thermal = found.optics.thermal.unwrap();
    assert!((thermal.reference_c - 27.25).abs() < 4.0, "{said}");
    let blur = thermal.blur_px_per_c.unwrap();
    assert!((blur.value - 0.01).abs() < 0.002, "{said}");
    let scale = thermal.scale_per_c.unwrap();
    assert!(
        (scale.value - 2e-5).abs() < 4.0 * scale.sigma && scale.sigma < 1e-5,
        "{said}"
    );
    let blur_px = 0.9 + 0.01 * (thermal.reference_c - 10.0);
    assert!(
        (found.optics.blur_px.value - blur_px).abs() < 0.04,
        "{said}"
    );
}

#[test]
fn frames_that_determine_nothing_or_do_not_belong_together_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let mut scene = covered(1);
    scene.noise = Noise::read(2.0);
    scene.depth = Depth::Eight;
    save(&at("mixed"), 0, &covered(2).frame().unwrap());
    save(&at("mixed"), 1, &scene.frame().unwrap());
    scene.info.analogue_gain = Some(100.0);
    save(&at("gains"), 0, &scene.frame().unwrap());
    scene.info.analogue_gain = Some(200.0);
    save(&at("gains"), 1, &scene.frame().unwrap());
    let small = scene.frame().unwrap();
    let part = solaspect::frame::Region::sized(0, 0, 640, 480);
    save(&at("small"), 0, &small.cropped(part).unwrap());
    std::fs::create_dir(at("empty")).unwrap();
    let new = at("new.toml");
    for (name, wanted) in [
        ("mixed", "saturate at 4095 DN"),
        ("gains", "analogue gain"),
        ("small", "whole sensor"),
        ("empty", "found none"),
        ("absent", "cannot read"),
    ] {
        let done = solaspect(&[
            "calibrate",
            "camera",
            "--out",
            text(&new),
            "--dark",
            text(&at(name)),
        ]);
        let said = String::from_utf8_lossy(&done.stderr);
        assert_eq!(done.status.code(), Some(1), "{name}: {done:?}");
        assert!(said.contains(wanted), "{name}: {said}");
        assert!(!new.exists());
    }
}

/// Runs the commands of docs/calibration-camera.md.
#[test]
fn a_camera_is_simulated_calibrated_and_compared_with_its_truth() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| text(&folder.path().join(name)).to_owned();
    let camera = "--seed 4 --bits 12 --noise 2 --electrons 40 --background 16 --hot-pixels 25 --vignetting 0.3";
    let run = |command: &str| {
        let done = solaspect(&command.split_whitespace().collect::<Vec<_>>());
        assert!(done.status.success(), "{command}: {done:?}");
        String::from_utf8(done.stdout).unwrap()
    };
    let (darks, flats, new) = (at("darks"), at("flats"), at("new.toml"));
    run(&format!(
        "simulate --dark --out {darks} --frames 4 {camera}"
    ));
    run(&format!(
        "simulate --flat --out {flats} --frames 6 {camera}"
    ));
    run(&format!(
        "calibrate camera --out {new} --dark {darks} --flat {flats}"
    ));
    let compared = run(&format!(
        "calibrate compare {flats}/truth.toml {new} --json"
    ));
    let compared: serde_json::Value = serde_json::from_str(&compared).unwrap();
    let sensor = &compared["sensor"];
    for (name, most_sigma) in [
        ("dark_dn", 0.003),
        ("read_noise_dn", 0.01),
        ("gain_dn_per_electron", 0.005),
    ] {
        let number = |side: usize, n: usize| sensor[name][side][n].as_f64().unwrap();
        let (truth, found, sigma) = (number(0, 0), number(1, 0), number(1, 1));
        assert!(sigma < most_sigma * truth, "{name}: {sensor}");
        assert!((found - truth).abs() < 4.0 * sigma, "{name}: {sensor}");
    }
    let loss = |side: usize| sensor["corner_loss"][side].as_f64().unwrap();
    assert!((loss(1) - loss(0)).abs() < 0.005, "{sensor}");
    assert_eq!(sensor["hot_pixels_before"], 25);
    assert_eq!(sensor["hot_pixels_in_both"], 25);
    assert_eq!(sensor["hot_pixels_after"], 25);
    let truth = std::fs::read_to_string(format!("{flats}/truth.csv")).unwrap();
    assert_eq!(truth.lines().next(), Some("n,exposure_s,light_dn"));
    assert_eq!(truth.lines().last(), Some("5,0.015000000,3280.000000"));
    let mixed = solaspect(&["simulate", "--out", &at("no"), "--flat", "--moon"]);
    assert_eq!(mixed.status.code(), Some(2), "{mixed:?}");
}

/// Each frame's row is on disk before the next frame begins, however the program ends.
#[test]
fn an_interrupted_simulation_leaves_a_row_for_each_frame() {
    let folder = tempfile::tempdir().unwrap();
    let scenes: [&[&str]; 4] = [&[], &["--flat"], &["--horizon"], &["--moon"]];
    for (n, scene) in scenes.into_iter().enumerate() {
        let out = folder.path().join(n.to_string());
        let mut command = Command::new(env!("CARGO_BIN_EXE_solaspect"));
        command.args(["simulate", "--frames", "100000", "--out", text(&out)]);
        let mut program = command.args(scene).spawn().unwrap();
        let frames = || {
            let files = std::fs::read_dir(&out).into_iter().flatten().flatten();
            let is_frame = |name: &str| name.ends_with(".fits");
            files
                .filter(|f| is_frame(&f.file_name().to_string_lossy()))
                .count()
        };
        while frames() < 3 {
            assert!(program.try_wait().unwrap().is_none(), "{scene:?}");
            std::thread::sleep(Duration::from_millis(5));
        }
        program.kill().unwrap();
        program.wait().unwrap();
        let truth = std::fs::read_to_string(out.join("truth.csv")).unwrap();
        let rows = truth.lines().count() - 1;
        // The row of the last frame may still be missing.
        assert!(
            truth.ends_with('\n') && (frames() - 1..=frames()).contains(&rows),
            "{scene:?}: {rows}"
        );
    }
}

#[test]
fn frames_of_the_sun_are_refused_as_flat_and_as_dark_frames() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    for n in 0..3 {
        save(&at("dark"), n, &covered(n as u64).frame().unwrap());
    }
    let mut sun = lit(150.0, 7);
    sun.sun = Some(Sun::new(PlateMil::new(300.0, -200.0), 550.0));
    sun.mark_contrast = 0.8;
    save(&at("sun"), 3, &sun.frame().unwrap());
    let (dark, sun, new) = (at("dark"), at("sun"), at("new.toml"));
    for (options, wanted) in [
        (
            vec!["--flat", text(&sun)],
            "expected an evenly lit frame (--flat)",
        ),
        (
            vec!["--dark", text(&dark), "--flat", text(&sun)],
            "expected an evenly lit frame (--flat)",
        ),
        (
            vec!["--dark", text(&sun)],
            "expected a frame without light (--dark)",
        ),
    ] {
        let done =
            solaspect(&[&["calibrate", "camera", "--out", text(&new)], &options[..]].concat());
        let said = String::from_utf8_lossy(&done.stderr);
        assert_eq!(done.status.code(), Some(1), "{done:?}");
        assert!(
            said.contains(wanted) && said.contains("frame_00003.fits"),
            "{said}"
        );
        assert!(!new.exists());
    }
}

#[test]
fn an_instrument_that_states_its_pixels_is_read_strictly() {
    let demo = builtin_text("demo").unwrap();
    let read = |more: &str| Instrument::parse(Path::new("a.toml"), &format!("{demo}\n{more}"));
    let refused = |more: &str| read(more).unwrap_err().to_string();
    let noise = "[camera.noise]\nread_noise = { value = 5, source = \"a\", date = 2013-09-21 }\n";
    assert!(
        refused(noise).contains("camera.noise.read_noise_dn"),
        "{}",
        refused(noise)
    );
    let hot = "[camera.hot_pixels_px]\nvalue = [[1296, 3]]\nsource = \"a\"\ndate = 2013-09-21\n";
    assert!(refused(hot).contains("1296 x 966"), "{}", refused(hot));
    assert!(read("").unwrap().sensor == Default::default());
    assert!(Revision::of(Path::new("a.toml"), "name = ").is_err());
}

#[test]
fn sigmas_stay_honest_under_the_noise_of_photons() {
    let demo = builtin("demo").unwrap();
    let conditions = Conditions {
        noise: Noise {
            read_dn: 1.0,
            electrons_per_dn: Some(8.0),
        },
        ..Conditions::of(&demo)
    };
    let scenes = RandomScenes::new(&demo, &conditions, 9).unwrap();
    let expected = Some(Expected {
        radius_arcsec: SUN_RADIUS_ARCSEC,
    });
    let (mut squares, mut count) = (0.0, 0.0);
    for n in 0..80 {
        let picture = scenes.scene(n).unwrap().picture().unwrap();
        let solution = aspect::solve(&picture.frame, &demo, expected, None);
        if solution.quality != Quality::Fine {
            continue;
        }
        let found = solution.aspect.unwrap().sun_plate;
        let off = found.position.vector() - picture.truth.sun.unwrap().plate.vector();
        let inverse = found.covariance.try_inverse().unwrap();
        squares += off.dot(&(inverse * off));
        count += 2.0;
    }
    let normalised = f64::sqrt(squares / count);
    assert!(
        count > 140.0 && (0.75..1.25).contains(&normalised),
        "{normalised} of {count}"
    );
}

#[test]
fn stated_pixels_change_only_the_frames_they_speak_of() {
    let demo = builtin("demo").unwrap();
    let scenes = RandomScenes::new(&demo, &Conditions::of(&demo), 3).unwrap();
    let picture = scenes.scene(0).unwrap().picture().unwrap();
    let sun = picture.truth.sun.unwrap();
    let solve = |frame: &Frame, instrument: &Instrument| {
        let radius_arcsec = SUN_RADIUS_ARCSEC;
        aspect::solve(frame, instrument, Some(Expected { radius_arcsec }), None)
    };
    let plain = solve(&picture.frame, &demo);
    let mut other_depth = demo.clone();
    let stated = |value: f64| solaspect::units::Measured::new(value, 0.1);
    other_depth.sensor.noise = Some(solaspect::instrument::Noise {
        saturation_dn: 4095,
        dark_dn: stated(64.0),
        read_noise_dn: stated(80.0),
        gain_dn_per_electron: None,
    });
    assert_eq!(solve(&picture.frame, &other_depth), plain);

    // A column of hot pixels along the limb, too dim to saturate.
    let (x, y) = ((sun.px.x + sun.radius_px) as usize + 2, sun.px.y as usize);
    let hot: Vec<(usize, usize)> = (y - 30..y + 30).map(|y| (x, y)).collect();
    let solaspect::frame::Pixels::U8(mut pixels) = picture.frame.pixels().clone() else {
        panic!("expected 8 bits");
    };
    for (x, y) in &hot {
        pixels[y * 1296 + x] = 120;
    }
    let info = picture.frame.info.clone();
    let pixels = solaspect::frame::Pixels::U8(pixels);
    let blemished = Frame::new(1296, 966, pixels, 255, info).unwrap();
    let mut listing = demo.clone();
    listing.sensor.hot_pixels = hot;
    let place = |solution: &aspect::Solution| solution.aspect.unwrap().sun_px.position;
    let clean = place(&plain);
    let (unlisted, listed) = (solve(&blemished, &demo), solve(&blemished, &listing));
    assert!(place(&listed).distance(clean) < 0.02);
    // Robust weights at the limb tolerate such a column: listing it costs no accuracy.
    assert!(place(&listed).distance(clean) <= place(&unlisted).distance(clean) + 0.005);
    assert_ne!(listed, unlisted);
}

/// All calibrations read their frames by the same function.
#[test]
fn a_frame_that_several_files_hold_counts_once_in_a_calibration() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let pixels = |frame: &Frame| match frame.pixels() {
        Pixels::U8(pixels) => pixels.clone(),
        Pixels::U16(_) => panic!("8 bit"),
    };
    let frame = |seed: u64| {
        let mut scene = covered(seed);
        scene.depth = Depth::Eight;
        scene.info.number = Some(seed);
        scene.frame().unwrap()
    };
    let picture = |name: &str, (width, height): (usize, usize), pixels: Vec<u8>| {
        let saved = image::GrayImage::from_raw(width as u32, height as u32, pixels);
        saved.unwrap().save(at(name)).unwrap();
    };
    let write = |name: &str, frame: &Frame, compression| {
        fits::write_frame(&at(name), frame, &[], &[], compression).unwrap();
    };
    let (one, two) = (frame(1), frame(2));
    write("dark_1.fits", &one, Compression::Rice);
    write("dark_2.fits", &two, Compression::Rice);
    write("dark_2 (1).fits", &two, Compression::Gzip);
    write("z.fits", &one, Compression::None);
    let size = (one.width(), one.height());
    picture("dark_1.png", size, pixels(&one));
    // Identical frames without structure do not count as copies.
    let dark = vec![0; size.0 * size.1];
    picture("lens_cap_1.png", size, dark.clone());
    picture("lens_cap_2.png", size, dark);
    let files = observe::list(&[folder.path().into()], observe::Depth::All).unwrap();
    let observed = observe::each_frame(files, [size.0, size.1], &(), |_, _| ()).unwrap();
    let (once, copies) = (observed.frames, observed.copies);
    let name = |path: &Path| path.file_name().unwrap().to_str().unwrap().to_owned();
    let once: Vec<String> = once.iter().map(|(path, _)| name(path)).collect();
    assert_eq!(
        once,
        [
            "dark_1.fits",
            "dark_2.fits",
            "lens_cap_1.png",
            "lens_cap_2.png"
        ]
    );
    let first = |copy: &RejectedFrame| {
        let first = copy.reason.strip_prefix("the same frame as ").unwrap();
        (name(&copy.file), name(Path::new(first)))
    };
    let mut firsts: Vec<_> = copies.iter().map(first).collect();
    firsts.sort();
    let pair = |copy: &str, first: &str| (copy.to_owned(), format!("{first}.fits"));
    let expected = [
        pair("dark_1.png", "dark_1"),
        pair("dark_2 (1).fits", "dark_2"),
        pair("z.fits", "dark_1"),
    ];
    assert_eq!(firsts, expected);
}
