//! The disc is found in poor frames, whole or cut by the sensor's edge, and nothing else is mistaken for it. The truth is
//! the simulator's. `DISC_SEARCH_FRAMES=2000` sets the number of frames of each kind.

use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use rayon::prelude::*;
use solaspect::frame::{Frame, FrameInfo, Levels, Pixels, Region};
use solaspect::geometry::{Circle, Mapping};
use solaspect::instrument::{Instrument, builtin};
use solaspect::limb::{self, DiscSearch, LimbSettings};
use solaspect::simulate::{
    Conditions, Depth, Noise, RandomScenes, SUN_RADIUS_ARCSEC, Scene, Sun, SunInView,
};
use solaspect::units::SensorPx;
use std::f64::consts::TAU;
use std::ops::Range;

/// A disc farther than this from the truth counts as wrong.
const WRONG_PX: f64 = 4.0;

fn demo() -> Instrument {
    builtin("demo").unwrap()
}

fn frames(in_ci: u64) -> u64 {
    let asked = std::env::var("DISC_SEARCH_FRAMES").ok();
    asked.map_or(in_ci, |n| n.parse().unwrap())
}

fn find(frame: &Frame, radius_px: f64) -> Option<Circle> {
    let settings = LimbSettings::default();
    let levels = limb::levels(frame, &settings).ok()?;
    let search = search(frame, &levels, radius_px, &settings);
    search.anywhere(frame.region()).ok()
}

fn search<'a>(
    frame: &'a Frame,
    levels: &'a Levels,
    radius_px: f64,
    settings: &'a LimbSettings,
) -> DiscSearch<'a> {
    let instrument = demo();
    let scale = instrument.mounting.scale_mil_per_px.value;
    DiscSearch {
        frame,
        levels,
        radius_px,
        mark_length_px: instrument.plate.shape.size_mil() / scale,
        settings,
    }
}

/// The fraction of the Sun's limb on the sensor.
fn limb_on_sensor(sun: &Sun, mapping: &Mapping, scene: &Scene) -> f64 {
    const POINTS: u32 = 720;
    let seen = (0..POINTS).filter(|k| {
        let angle = f64::from(*k) / f64::from(POINTS) * TAU;
        let mut edge = sun.centre;
        edge.x += sun.radius_mil * angle.cos();
        edge.y += sun.radius_mil * angle.sin();
        let at = mapping.to_sensor(edge);
        let within = |v: f64, size: usize| (-0.5..size as f64 - 0.5).contains(&v);
        within(at.x, scene.width_px) && within(at.y, scene.height_px)
    });
    seen.count() as f64 / f64::from(POINTS)
}

/// The part of the sensor that cuts the Sun.
#[derive(Clone, Copy)]
enum Cut {
    Edge,
    Corner,
}

/// Moves the Sun out over an edge or a corner of the sensor until only this fraction of its limb is left.
fn cut(scene: &mut Scene, at: Cut, share: f64, rng: &mut Xoshiro256PlusPlus) {
    const MARGIN_PX: f64 = 110.0;
    let (width, height) = (scene.width_px as f64, scene.height_px as f64);
    let mut inside = || {
        let x = rng.random_range(MARGIN_PX..width - MARGIN_PX);
        [x, rng.random_range(MARGIN_PX..height - MARGIN_PX)]
    };
    let [x, y] = inside();
    let (first, second): (bool, bool) = (rng.random(), rng.random());
    let side = |high: bool, size: f64| if high { size - MARGIN_PX } else { MARGIN_PX };
    let outwards = |high: bool| if high { 1.0 } else { -1.0 };
    let (start, way) = match at {
        Cut::Edge if first => ([side(second, width), y], [outwards(second), 0.0]),
        Cut::Edge => ([x, side(second, height)], [0.0, outwards(second)]),
        Cut::Corner => {
            let angle: f64 = rng.random_range(0.15..TAU / 4.0 - 0.15);
            let way = [
                outwards(first) * angle.cos(),
                outwards(second) * angle.sin(),
            ];
            ([side(first, width), side(second, height)], way)
        }
    };
    let mapping = scene.mapping;
    let mut sun = scene.sun.clone().unwrap();
    let mut moved = |by: f64| {
        sun.centre = mapping.to_plate(SensorPx::new(
            start[0] + by * way[0],
            start[1] + by * way[1],
        ));
        sun.clone()
    };
    let (mut near, mut far) = (0.0, 400.0);
    for _ in 0..40 {
        let middle = (near + far) / 2.0;
        if limb_on_sensor(&moved(middle), &mapping, scene) > share {
            near = middle;
        } else {
            far = middle;
        }
    }
    scene.sun = Some(moved(near));
}

/// The visible part of the Sun in a frame.
#[derive(Clone)]
enum View {
    Whole,
    /// The Sun is cut; the visible fraction of the limb is in a range.
    Part(Cut, Range<f64>),
}

/// Result of the frames of one kind: errors of the centre, px, where a disc was found.
struct Search {
    name: String,
    frames: u64,
    errors_px: Vec<f64>,
}

impl Search {
    fn through(
        name: impl Into<String>,
        frames: u64,
        view: &View,
        change: impl Fn(&mut Conditions, &mut Xoshiro256PlusPlus) + Sync,
    ) -> Self {
        let name = name.into();
        let instrument = demo();
        let error = |n: u64| {
            let rng = &mut Xoshiro256PlusPlus::seed_from_u64(n);
            let mut conditions = Conditions::of(&instrument);
            conditions.similarity.rotation_deg = rng.random_range(0.0..360.0);
            change(&mut conditions, rng);
            let scenes = RandomScenes::new(&instrument, &conditions, n).unwrap();
            let mut scene = scenes.scene(n).unwrap();
            let mut radius_px = instrument.optics.radius_mil(SUN_RADIUS_ARCSEC)
                / instrument.mounting.scale_mil_per_px.value;
            if let View::Part(at, share) = view {
                cut(&mut scene, *at, rng.random_range(share.clone()), rng);
                radius_px += rng.random_range(-0.3..0.3);
            }
            let truth = scene.truth().sun.unwrap();
            let disc = find(&scene.frame().unwrap(), radius_px)?;
            Some(SensorPx::from(disc.centre).distance(truth.px))
        };
        let mut errors_px: Vec<f64> = (0..frames).into_par_iter().filter_map(error).collect();
        errors_px.sort_by(f64::total_cmp);
        Self {
            name,
            frames,
            errors_px,
        }
    }

    fn share_within(&self, px: f64) -> f64 {
        let good = self.errors_px.iter().filter(|error| **error <= px).count();
        good as f64 / self.frames as f64
    }

    /// Asserts that a sufficient fraction is within a distance of the truth, and that no disc is wrong.
    fn keeps(&self, least_share: f64, within_px: f64) {
        let found = self.errors_px.len();
        let quantile = |part: f64| {
            let n = (part * found.saturating_sub(1) as f64).round() as usize;
            self.errors_px.get(n).copied().unwrap_or(f64::NAN)
        };
        let share = self.share_within(within_px);
        println!(
            "{:<44} found {:6.2} %  within {within_px} px {:6.2} %  median {:.2}  95 % {:.2}  max {:.2} px",
            self.name,
            100.0 * found as f64 / self.frames as f64,
            100.0 * share,
            quantile(0.5),
            quantile(0.95),
            quantile(1.0),
        );
        assert!(share >= least_share, "{}: {share}", self.name);
        assert!(self.share_within(WRONG_PX) * self.frames as f64 >= found as f64);
    }
}

#[test]
fn a_disc_cut_by_the_sensor_is_found_with_fifteen_per_cent_of_its_limb() {
    let parts = [0.15..0.16, 0.16..0.3, 0.3..0.6, 0.6..0.97];
    for noise_dn in [1.0, 5.0, 15.0] {
        for (cut, place) in [(Cut::Edge, "edge"), (Cut::Corner, "corner")] {
            for share in &parts {
                let name = format!("{share:?} of the limb at the {place}, {noise_dn} DN");
                let view = View::Part(cut, share.clone());
                let search = Search::through(name, frames(4), &view, |c, _| {
                    c.noise = Noise::read(noise_dn);
                });
                search.keeps(0.97, 1.5);
            }
        }
    }
}

#[test]
fn with_less_of_its_limb_a_disc_is_found_where_it_is_or_not_at_all() {
    for noise_dn in [1.0, 5.0, 15.0] {
        for (cut, place) in [(Cut::Edge, "edge"), (Cut::Corner, "corner")] {
            let name = format!("0.01 to 0.15 of the limb at the {place}, {noise_dn} DN");
            let view = View::Part(cut, 0.01..0.15);
            let search = Search::through(name, frames(8), &view, |c, _| {
                c.noise = Noise::read(noise_dn);
            });
            search.keeps(0.0, 2.0);
        }
    }
}

#[test]
fn a_cut_disc_is_found_among_blemishes_and_in_haze() {
    for (cut, place) in [(Cut::Edge, "edge"), (Cut::Corner, "corner")] {
        let part = View::Part(cut, 0.15..0.6);
        let named = |what: &str| format!("{what}, cut by the {place}");
        Search::through(named("blemishes"), frames(6), &part, |c, rng| {
            blemish(c, rng);
        })
        .keeps(0.9, 1.5);
        Search::through(named("low contrast"), frames(6), &part, |c, _| {
            c.peak_dn = 60.0;
        })
        .keeps(0.9, 1.5);
        Search::through(named("haze"), frames(6), &part, |c, rng| {
            c.blur_px = rng.random_range(0.5..3.0);
        })
        .keeps(0.9, 2.0);
    }
}

fn blemish(conditions: &mut Conditions, rng: &mut Xoshiro256PlusPlus) {
    let blemishes = &mut conditions.blemishes;
    blemishes.hot_pixels = 60;
    blemishes.scratches_per_disc = rng.random_range(0.6..2.0);
    blemishes.leaks = rng.random_range(4..=8);
}

#[test]
fn a_whole_disc_is_always_found() {
    let whole = |name: &str, change: fn(&mut Conditions, &mut Xoshiro256PlusPlus)| {
        Search::through(name, frames(8), &View::Whole, change).keeps(1.0, 1.0);
    };
    whole("noise 1", |c, _| c.noise = Noise::read(1.0));
    whole("noise 5", |_, _| {});
    whole("noise 15", |c, _| c.noise = Noise::read(15.0));
    whole("12 bit, noise 1", |c, _| {
        c.depth = Depth::Twelve;
        c.noise = Noise::read(1.0);
    });
    whole("any scale within 10 %", |c, rng| {
        c.similarity.scale_mil_per_px *= rng.random_range(0.9..1.1);
    });
    whole("any scale within 10 %, noise 15", |c, rng| {
        c.similarity.scale_mil_per_px *= rng.random_range(0.9..1.1);
        c.noise = Noise::read(15.0);
    });
    whole("keystone to 3 deg", |c, rng| {
        c.keystone_deg = rng.random_range(-3.0..3.0);
    });
    whole("low contrast", |c, _| c.peak_dn = 60.0);
    whole("haze to 3 px", |c, rng| {
        c.blur_px = rng.random_range(0.5..3.0);
    });
    whole("saturated", |c, _| c.peak_dn = 320.0);
    whole("hot pixels, scratches, leaks", blemish);
    whole("vignetting 20 %, spots", |c, _| {
        c.blemishes.vignetting = 0.2;
        c.sunspots = 8;
    });
    whole("all at once, noise 15, any scale", |c, rng| {
        blemish(c, rng);
        c.similarity.scale_mil_per_px *= rng.random_range(0.9..1.1);
        c.keystone_deg = rng.random_range(-3.0..3.0);
        c.blemishes.vignetting = 0.2;
        c.sunspots = 8;
        c.noise = Noise::read(15.0);
    });
}

#[test]
fn a_disc_near_where_it_was_is_found_though_more_crossings_are_asked_for() {
    let frame = frame_of(|x, y| lit((x - 612.0).hypot(y - 431.0) < 95.2));
    let region = Region::sized(480, 300, 280, 280);
    for min_crossings in [8, 48, 120] {
        let settings = LimbSettings {
            min_crossings,
            ..LimbSettings::default()
        };
        let levels = limb::levels(&frame, &settings).unwrap();
        let search = search(&frame, &levels, 95.2, &settings);
        for disc in [search.near(region), search.anywhere(frame.region())] {
            let centre = SensorPx::from(disc.unwrap().centre);
            assert!(centre.distance(SensorPx::new(612.0, 431.0)) < 0.3);
        }
    }
}

#[test]
fn where_there_is_no_sun_no_disc_is_found() {
    let instrument = demo();
    for noise_dn in [0.3, 1.0, 5.0, 15.0] {
        let found = (0..frames(6)).into_par_iter().filter(|n| {
            let rng = &mut Xoshiro256PlusPlus::seed_from_u64(*n);
            let mut conditions = Conditions {
                sun: SunInView::Absent,
                noise: Noise::read(noise_dn),
                ..Conditions::of(&instrument)
            };
            blemish(&mut conditions, rng);
            let scenes = RandomScenes::new(&instrument, &conditions, *n).unwrap();
            find(&scenes.scene(*n).unwrap().frame().unwrap(), 95.2).is_some()
        });
        assert_eq!(found.count(), 0, "{noise_dn} DN");
    }
}

/// A frame of the demo's size from a function of (x, y), with uniform noise of 0 to 8 DN.
fn frame_of(value: impl Fn(f64, f64) -> f64) -> Frame {
    let (width, height) = (1296, 966);
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(3);
    let mut pixel = |n: usize| {
        let light = value((n % width) as f64, (n / width) as f64);
        (light + rng.random_range(0.0..8.0)).clamp(0.0, 255.0) as u8
    };
    let pixels = (0..width * height).map(&mut pixel).collect();
    Frame::new(width, height, Pixels::U8(pixels), 255, FrameInfo::default()).unwrap()
}

fn lit(inside: bool) -> f64 {
    if inside { 200.0 } else { 0.0 }
}

#[test]
fn what_the_sensor_cuts_and_is_no_sun_is_not_taken_for_one() {
    let away = |x: f64, y: f64, cx: f64, cy: f64| (x - cx).hypot(y - cy);
    for (name, frame) in [
        ("strip at the left edge", frame_of(|x, _| lit(x < 12.0))),
        ("strip at the top", frame_of(|_, y| lit(y < 10.0))),
        (
            "bar on the lower edge",
            frame_of(|x, y| lit(y > 950.0 && (500.0..640.0).contains(&x))),
        ),
        (
            "short bar on the right edge",
            frame_of(|x, y| lit(x > 1284.0 && (500.0..580.0).contains(&y))),
        ),
        ("corner", frame_of(|x, y| lit(x + y < 120.0))),
        ("blunt corner", frame_of(|x, y| lit(x.max(y) < 70.0))),
        (
            "spot half over the edge",
            frame_of(|x, y| lit(away(x, y, 0.0, 480.0) < 25.0)),
        ),
        (
            "small disc cut in half",
            frame_of(|x, y| lit(away(x, y, 700.0, 0.0) < 60.0)),
        ),
        (
            "large disc cut in half",
            frame_of(|x, y| lit(away(x, y, 700.0, 966.0) < 140.0)),
        ),
        ("wedge", frame_of(|x, y| lit(x < 80.0 - (y - 400.0).abs()))),
        (
            "dark disc on a bright strip",
            frame_of(|x, y| lit(x < 60.0 && away(x, y, 90.0, 400.0) > 95.0)),
        ),
    ] {
        assert_eq!(find(&frame, 95.2), None, "{name}");
    }
}

#[test]
fn levels_are_the_frames_own_though_little_of_the_disc_is_seen() {
    let instrument = demo();
    for noise_dn in [1.0, 5.0, 15.0] {
        for n in 0..frames(2) {
            let rng = &mut Xoshiro256PlusPlus::seed_from_u64(n);
            let conditions = Conditions {
                noise: Noise::read(noise_dn),
                ..Conditions::of(&instrument)
            };
            let scenes = RandomScenes::new(&instrument, &conditions, n).unwrap();
            let whole = scenes.scene(n).unwrap();
            let mut part = whole.clone();
            cut(&mut part, Cut::Edge, 0.15, rng);
            for (scene, disc_dn) in [(whole, 160.0..235.0), (part, 90.0..190.0)] {
                let frame = scene.frame().unwrap();
                let levels = limb::levels(&frame, &LimbSettings::default()).unwrap();
                // Quantisation adds a variance of 1/12.
                let noise = noise_dn.hypot(0.2887);
                // Noise comparable to the quantisation step is less well determined.
                let tolerance = 0.04 + 0.1 / noise_dn;
                assert!(
                    (levels.background_dn - 4.0).abs() < 0.04 * noise,
                    "{levels:?}"
                );
                assert!(
                    (levels.noise_dn / noise - 1.0).abs() < tolerance,
                    "{levels:?}"
                );
                assert!(disc_dn.contains(&levels.disc_dn), "{levels:?}");
            }
        }
    }
}
