//! How near the truth the pipeline comes, condition by condition, and that what it says of its own error is so. The
//! truth is the simulator's, which `tests/simulation.rs` holds against independent arithmetic.

use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StudentT};
use rand_xoshiro::Xoshiro256PlusPlus;
use rayon::prelude::*;
use solaspect::aspect::{Expected, Quality, Solution, Track, solve};
use solaspect::fits;
use solaspect::frame::{Frame, FrameInfo, Pixels};
use solaspect::instrument::{Instrument, builtin};
use solaspect::simulate::{
    Conditions, Counts, Depth, Noise, RandomScenes, SUN_RADIUS_ARCSEC, SunInView,
};
use solaspect::units::PlateMil;
use std::path::Path;

const EXPECTED: Option<Expected> = Some(Expected {
    radius_arcsec: SUN_RADIUS_ARCSEC,
});
const FRAMES: u64 = 36;

fn demo() -> Instrument {
    builtin("demo").unwrap()
}

/// What a frame's solution is, beside the truth.
struct Outcome {
    quality: Quality,
    reason: Option<String>,
    error_arcsec: f64,
    /// Error over stated sigma, by axis.
    pulls: [f64; 2],
}

impl Outcome {
    fn new(solution: &Solution, truth: Option<PlateMil>, instrument: &Instrument) -> Self {
        let (mut error_arcsec, mut pulls) = (f64::NAN, [f64::NAN; 2]);
        if let (Some(aspect), Some(truth)) = (&solution.aspect, truth) {
            let found = aspect.sun_plate;
            let sigma = found.sigma();
            error_arcsec = found.position.distance(truth) * instrument.optics.arcsec_per_mil();
            pulls = [
                (found.position.x - truth.x) / sigma[0],
                (found.position.y - truth.y) / sigma[1],
            ];
        }
        Self {
            quality: solution.quality,
            reason: solution.stopped.map(|stopped| stopped.to_string()),
            error_arcsec,
            pulls,
        }
    }
}

/// Frames under one set of conditions, each solved on its own.
struct Series {
    name: &'static str,
    outcomes: Vec<Outcome>,
}

impl Series {
    /// The same conditions for all frames, but for where the Sun stands.
    fn of(name: &'static str, change: impl Fn(&mut Conditions) + Sync) -> Self {
        Self::varied(name, |conditions, _| change(conditions))
    }

    /// Conditions that change from frame to frame by numbers drawn at random.
    fn varied(
        name: &'static str,
        change: impl Fn(&mut Conditions, &mut Xoshiro256PlusPlus) + Sync,
    ) -> Self {
        let instrument = demo();
        let outcome = |n: u64| {
            let mut conditions = Conditions::of(&instrument);
            change(&mut conditions, &mut Xoshiro256PlusPlus::seed_from_u64(n));
            let scenes = RandomScenes::new(&instrument, &conditions, n).unwrap();
            let picture = scenes.scene(n).unwrap().picture().unwrap();
            let solution = solve(&picture.frame, &instrument, EXPECTED, None);
            let truth = picture.truth.sun.map(|sun| sun.plate);
            Outcome::new(&solution, truth, &instrument)
        };
        let outcomes = (0..FRAMES).into_par_iter().map(outcome).collect();
        Self { name, outcomes }
    }

    fn fine(&self) -> impl Iterator<Item = &Outcome> {
        self.outcomes.iter().filter(|o| o.quality == Quality::Fine)
    }

    fn fine_share(&self) -> f64 {
        self.fine().count() as f64 / self.outcomes.len() as f64
    }

    /// Quantiles of the fine frames' errors, arcsec.
    fn quantiles<const N: usize>(&self, parts: [f64; N]) -> [f64; N] {
        let mut errors: Vec<f64> = self.fine().map(|o| o.error_arcsec).collect();
        errors.sort_by(f64::total_cmp);
        parts.map(|part| {
            let last = errors.len().saturating_sub(1);
            errors
                .get((part * last as f64).round() as usize)
                .copied()
                .unwrap_or(f64::NAN)
        })
    }

    /// Root mean square of error over stated sigma, by axis.
    fn rms_pulls(&self) -> [f64; 2] {
        [0, 1].map(|axis| {
            let squares: f64 = self.fine().map(|o| o.pulls[axis].powi(2)).sum();
            (squares / self.fine().count() as f64).sqrt()
        })
    }

    fn print(&self) {
        let [median, most, worst] = self.quantiles([0.5, 0.95, 1.0]);
        let [x, y] = self.rms_pulls();
        println!(
            "{:<34} {:>3.0} % fine  median {median:.3}  95 % {most:.3}  max {worst:.3} arcsec  error/sigma {x:.2} {y:.2}",
            self.name,
            100.0 * self.fine_share(),
        );
    }

    /// Every fine frame within the bounds, and as many fine as promised.
    fn keeps(self, least_fine_share: f64, bounds: Bounds) -> Self {
        self.print();
        let [median, most, worst] = self.quantiles([0.5, 0.95, 1.0]);
        let found = Bounds {
            median,
            most,
            worst,
        };
        assert!(
            found.within(&bounds),
            "{}: {found:?} over {bounds:?}",
            self.name
        );
        assert!(self.fine_share() >= least_fine_share, "{}", self.name);
        self
    }

    /// The stated sigmas tell the true errors.
    fn states_its_errors(self) {
        for rms in self.rms_pulls() {
            assert!(
                (0.5..2.0).contains(&rms),
                "{}: error/sigma {rms}",
                self.name
            );
        }
    }
}

/// Errors, arcsec: median, 95 %, largest.
#[derive(Debug)]
struct Bounds {
    median: f64,
    most: f64,
    worst: f64,
}

impl Bounds {
    fn within(&self, limits: &Self) -> bool {
        self.median <= limits.median && self.most <= limits.most && self.worst <= limits.worst
    }
}

const fn bounds(median: f64, most: f64, worst: f64) -> Bounds {
    Bounds {
        median,
        most,
        worst,
    }
}

/// A camera turned and tilted anyhow.
fn turn(conditions: &mut Conditions, rng: &mut Xoshiro256PlusPlus) {
    conditions.similarity.rotation_deg = rng.random_range(0.0..360.0);
    conditions.keystone_deg = rng.random_range(-3.0..3.0);
}

/// The frames under `tests/data/frames`, which an independent generator made, each with its folder and truth.
fn independent_frames() -> Vec<(String, Frame, PlateMil)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/frames");
    let table = std::fs::read_to_string(folder.join("truth.csv")).unwrap();
    let frame = |line: &str| {
        let fields: Vec<&str> = line.split(',').collect();
        let number = |n: usize| fields[n].parse::<f64>().unwrap();
        let name = format!("{}/frame_{:05}.fits", fields[0], number(1));
        let plain = folder.join(&name);
        let zipped = folder.join(format!("{name}.gz"));
        let path = if plain.exists() { plain } else { zipped };
        let frame = fits::read_frame(&path).unwrap();
        (fields[0].into(), frame, PlateMil::new(number(4), number(5)))
    };
    table.lines().skip(1).map(frame).collect()
}

#[test]
fn frames_of_an_independent_generator_are_solved_as_near_as_their_kind_allows() {
    let instrument = demo();
    let frames = independent_frames();
    assert!(frames.len() >= 9, "{} frames", frames.len());
    for (kind, frame, truth) in &frames {
        let solution = solve(frame, &instrument, EXPECTED, None);
        let outcome = Outcome::new(&solution, Some(*truth), &instrument);
        let (quality, error) = (outcome.quality, outcome.error_arcsec);
        println!(
            "{kind:<14} {quality:?} {error:.3} arcsec {:?}",
            outcome.reason
        );
        let fine = quality == Quality::Fine;
        let explained = outcome.reason.is_some();
        let kept = match kind.as_str() {
            "standard" | "heroes-layout" | "twelve-bit" => fine && error < 2.0,
            "rotated" | "disturbed" => fine && error < 4.0,
            "dim" | "saturated" => (fine && error < 4.0) || (!fine && explained),
            "partial" => (fine && error < 5.0) || (!fine && explained),
            "night" => quality == Quality::None && explained,
            other => panic!("{other}: no promise for this kind"),
        };
        assert!(kept, "{kind}: {quality:?}, {error} arcsec");
    }
}

#[test]
fn quiet_frames_are_solved_to_the_noise() {
    let noisy = |dn: f64| move |c: &mut Conditions| c.noise = Noise::read(dn);
    Series::of("noise 1 DN", noisy(1.0))
        .keeps(0.9, bounds(0.11, 0.23, 0.27))
        .states_its_errors();
    Series::of("noise 5 DN", noisy(5.0))
        .keeps(0.9, bounds(0.21, 0.41, 0.6))
        .states_its_errors();
    Series::of("noise 15 DN", noisy(15.0))
        .keeps(0.88, bounds(0.65, 1.25, 1.5))
        .states_its_errors();
    Series::of("12 bit, noise 1 DN of 8 bit", |c| {
        c.depth = Depth::Twelve;
        c.noise = Noise::read(1.0);
    })
    .keeps(0.9, bounds(0.11, 0.23, 0.25))
    .states_its_errors();
}

#[test]
fn a_turned_and_tilted_camera_is_as_good_as_a_straight_one() {
    Series::varied("any rotation, keystone to 3 deg", turn)
        .keeps(0.88, bounds(0.47, 1.5, 1.9))
        .states_its_errors();
    Series::varied("any rotation, no keystone", |c, rng| {
        turn(c, rng);
        c.keystone_deg = 0.0;
    })
    .keeps(0.88, bounds(0.25, 0.55, 0.62))
    .states_its_errors();
}

#[test]
fn blemishes_do_not_spoil_a_frame() {
    let blemished = |change: fn(&mut Counts)| move |c: &mut Conditions| change(&mut c.blemishes);
    Series::of(
        "hot pixels, scratches, leaks",
        blemished(|b| {
            b.hot_pixels = 60;
            b.scratches_per_disc = 2.0;
            b.leaks = 4;
        }),
    )
    .keeps(0.9, bounds(0.29, 1.0, 1.5));
    Series::of("vignetting 20 %", blemished(|b| b.vignetting = 0.2))
        .keeps(0.9, bounds(0.57, 0.9, 1.05));
    Series::of("dust, 2 on the disc", blemished(|b| b.dust_per_disc = 2.0))
        .keeps(0.9, bounds(0.24, 0.43, 0.55));
    Series::of("8 sunspots", |c| c.sunspots = 8).keeps(0.9, bounds(0.26, 0.75, 1.25));
    Series::of("smear 1.5 px", |c| c.smear_px = 1.5).keeps(0.9, bounds(0.21, 0.42, 0.6));
    // A mark is off by 1.7 arcsec in each axis, a frame with its four to eight marks by 0.6 to 0.9.
    Series::of("marks misprinted by 1 mil rms", |c| {
        c.mark_scatter_mil = 1.0
    })
    .keeps(0.9, bounds(1.6, 3.5, 4.2))
    .states_its_errors();
}

#[test]
fn part_of_a_disc_is_never_taken_for_a_fine_one_that_is_off() {
    let partial = Series::of("disc cut by the sensor", |c| c.sun = SunInView::Partial)
        .keeps(0.05, bounds(0.65, 1.1, 1.5));
    for outcome in &partial.outcomes {
        assert!(outcome.quality == Quality::Fine || outcome.reason.is_some());
    }
}

#[test]
fn a_frame_without_sun_has_no_solution_and_says_why() {
    for (dn, leaks) in [(1.0, 0), (5.0, 4), (15.0, 8)] {
        let night = Series::of("no Sun", |c| {
            c.sun = SunInView::Absent;
            c.noise = Noise::read(dn);
            c.blemishes.leaks = leaks;
            c.blemishes.hot_pixels = 60;
        });
        for outcome in &night.outcomes {
            assert_eq!(outcome.quality, Quality::None);
            assert!(outcome.reason.is_some());
        }
    }
}

/// Two pictures of other parts of the plate.
fn two_frames(depth: Depth) -> [Frame; 2] {
    let instrument = demo();
    let conditions = Conditions {
        depth,
        ..Conditions::of(&instrument)
    };
    let scenes = RandomScenes::new(&instrument, &conditions, 5).unwrap();
    [2, 3].map(|n| scenes.scene(n).unwrap().frame().unwrap())
}

/// A solution to the last bit.
fn exactly(solution: &Solution) -> String {
    format!("{solution:?}")
}

#[test]
fn the_same_frame_and_prior_give_the_same_solution_bit_for_bit() {
    let instrument = demo();
    for depth in [Depth::Eight, Depth::Twelve] {
        let [frame, other] = two_frames(depth);
        let elsewhere = solve(&other, &instrument, EXPECTED, None).track;
        assert!(elsewhere.is_some());
        let priors: [Option<&Track>; 2] = [None, elsewhere.as_ref()];
        for prior in priors {
            let alone = solve(&frame, &instrument, EXPECTED, prior);
            let between = solve(&other, &instrument, EXPECTED, alone.track.as_ref());
            assert_ne!(exactly(&alone), exactly(&between));
            let after = solve(&frame, &instrument, EXPECTED, prior);
            assert_eq!(exactly(&alone), exactly(&after));
        }
    }
}

#[test]
fn the_same_values_in_wider_pixels_give_the_same_solution() {
    let instrument = demo();
    let [narrow, _] = two_frames(Depth::Eight);
    let Pixels::U8(values) = narrow.pixels() else {
        panic!("expected 8-bit pixels");
    };
    let wide = Frame::new(
        narrow.width(),
        narrow.height(),
        Pixels::U16(values.iter().map(|v| u16::from(*v)).collect()),
        narrow.saturation_dn(),
        narrow.info.clone(),
    )
    .unwrap();
    let [a, b] = [narrow, wide].map(|frame| solve(&frame, &instrument, EXPECTED, None));
    assert_eq!(exactly(&a), exactly(&b));
}

/// A frame of the demo's size, pixel by pixel.
fn frame_of(mut value: impl FnMut(f64, f64) -> f64) -> Frame {
    let (width, height) = (1296, 966);
    let pixel = |n: usize| value((n % width) as f64, (n / width) as f64).clamp(0.0, 255.0) as u8;
    let pixels = (0..width * height).map(pixel).collect();
    Frame::new(width, height, Pixels::U8(pixels), 255, FrameInfo::default()).unwrap()
}

fn disc(x: f64, y: f64, [cx, cy]: [f64; 2], radius: f64) -> f64 {
    let inside = radius - (x - cx).hypot(y - cy) + 0.5;
    200.0 * inside.clamp(0.0, 1.0)
}

#[test]
fn what_is_no_sun_is_not_taken_for_one() {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(7);
    let heavy = StudentT::new(1.5).unwrap();
    let mut uniform = || rng.random_range(0.0..256.0);
    let frames = [
        ("uniform noise", frame_of(|_, _| uniform())),
        (
            "salt and pepper",
            frame_of(|_, _| if uniform() < 128.0 { 0.0 } else { 255.0 }),
        ),
        (
            "sparse salt",
            frame_of(|_, _| if uniform() < 8.0 { 255.0 } else { 4.0 }),
        ),
        (
            "gradient",
            frame_of(|x, y| x / 12.0 + y / 8.0 + uniform() / 64.0),
        ),
        ("black", frame_of(|_, _| 0.0)),
        ("white", frame_of(|_, _| 255.0)),
        (
            "bright rectangle",
            frame_of(|x, y| {
                let inside = (500.0..700.0).contains(&x) && (300.0..480.0).contains(&y);
                uniform() / 32.0 + if inside { 200.0 } else { 0.0 }
            }),
        ),
        (
            "bright square",
            frame_of(|x, y| {
                let inside = (500.0..690.0).contains(&x) && (300.0..490.0).contains(&y);
                uniform() / 32.0 + if inside { 200.0 } else { 0.0 }
            }),
        ),
        (
            "small disc",
            frame_of(|x, y| uniform() / 32.0 + disc(x, y, [600.0, 500.0], 60.0)),
        ),
        (
            "large disc",
            frame_of(|x, y| uniform() / 32.0 + disc(x, y, [600.0, 500.0], 140.0)),
        ),
        (
            "stripes",
            frame_of(|x, _| if x % 380.0 < 190.0 { 200.0 } else { 5.0 }),
        ),
        (
            "half bright",
            frame_of(|x, _| if x < 648.0 { 200.0 } else { 5.0 }),
        ),
        (
            "ring",
            frame_of(|x, y| disc(x, y, [600.0, 500.0], 95.0) - disc(x, y, [600.0, 500.0], 70.0)),
        ),
        ("heavy-tailed noise", {
            let mut rng = Xoshiro256PlusPlus::seed_from_u64(8);
            frame_of(|_, _| 20.0 + 5.0 * heavy.sample(&mut rng))
        }),
    ];
    let instrument = demo();
    for (name, frame) in &frames {
        for expected in [EXPECTED, None] {
            let solution = solve(frame, &instrument, expected, None);
            println!(
                "{name:<20} {:?} {:?}",
                solution.quality,
                solution.stopped.map(|s| s.to_string())
            );
            assert_eq!(solution.quality, Quality::None, "{name}");
            assert!(solution.stopped.is_some(), "{name}");
        }
    }
}

#[test]
fn two_suns_are_never_solved_as_one_that_is_neither() {
    let instrument = demo();
    let conditions = Conditions::of(&instrument);
    for seed in 0..12 {
        let scenes = RandomScenes::new(&instrument, &conditions, seed).unwrap();
        let [one, two] = [0, 1].map(|n| scenes.scene(n).unwrap().picture().unwrap());
        let brighter = |a: &Frame, b: &Frame| match (a.pixels(), b.pixels()) {
            (Pixels::U8(a), Pixels::U8(b)) => a.iter().zip(b).map(|(a, b)| *a.max(b)).collect(),
            _ => panic!("expected 8-bit pixels"),
        };
        let both = Frame::new(
            one.frame.width(),
            one.frame.height(),
            Pixels::U8(brighter(&one.frame, &two.frame)),
            255,
            FrameInfo::default(),
        )
        .unwrap();
        let solution = solve(&both, &instrument, EXPECTED, None);
        if solution.quality == Quality::Fine {
            let near = [&one, &two]
                .map(|p| Outcome::new(&solution, p.truth.sun.map(|s| s.plate), &instrument))
                .iter()
                .any(|o| o.error_arcsec < 2.0);
            assert!(near, "seed {seed}");
        }
    }
}
