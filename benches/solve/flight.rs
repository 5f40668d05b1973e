//! The frames that are solved: a Sun that moves over the sensor, each frame with what the one before it taught.

use solaspect::aspect::{self, Expected, Track};
use solaspect::frame::Frame;
use solaspect::instrument::{Instrument, builtin};
use solaspect::simulate::{self, Depth, Noise, RandomScenes, SUN_RADIUS_ARCSEC};
use solaspect::units::SensorPx;

/// Frames of a flight: at 1.25 MB they outgrow the caches that a frame alone fits.
const FRAMES: u64 = 8;
const START_PX: [f64; 2] = [420.0, 310.0];
/// From frame to frame: 0.25 deg/s at 4 frames/s.
const STEP_PX: [f64; 2] = [19.3, 10.7];

pub struct Conditions {
    pub name: &'static str,
    noise_dn: f64,
    depth: Depth,
}

pub const CONDITIONS: [Conditions; 3] = [
    Conditions {
        name: "8 bit, noise 5 DN",
        noise_dn: 5.0,
        depth: Depth::Eight,
    },
    Conditions {
        name: "8 bit, noise 15 DN",
        noise_dn: 15.0,
        depth: Depth::Eight,
    },
    Conditions {
        name: "12 bit, noise 5 DN of 8 bit",
        noise_dn: 5.0,
        depth: Depth::Twelve,
    },
];

pub struct Exposure {
    pub frame: Frame,
    /// What the frame before it taught.
    pub prior: Track,
}

pub struct Flight {
    pub instrument: Instrument,
    pub expected: Option<Expected>,
    pub exposures: Vec<Exposure>,
}

impl Flight {
    pub fn under(conditions: &Conditions) -> Self {
        let instrument = builtin("demo").expect("the demo instrument is built in");
        let expected = Some(Expected {
            radius_arcsec: SUN_RADIUS_ARCSEC,
        });
        let conditions = simulate::Conditions {
            noise: Noise::read(conditions.noise_dn),
            depth: conditions.depth,
            ..simulate::Conditions::of(&instrument)
        };
        let scenes = RandomScenes::new(&instrument, &conditions, 1).expect("the demo has room");
        let frame = |n: u64| {
            let mut scene = scenes.scene(n).expect("the demo has room");
            let at: [f64; 2] = std::array::from_fn(|k| START_PX[k] + STEP_PX[k] * n as f64);
            if let Some(sun) = &mut scene.sun {
                sun.centre = scene.mapping.to_plate(SensorPx::new(at[0], at[1]));
            }
            scene.frame().expect("the scene fits its sensor")
        };
        let mut before = frame(0);
        let exposures = (1..=FRAMES).map(|n| {
            let frame = frame(n);
            let solution = aspect::solve(&before, &instrument, expected, None);
            before = frame.clone();
            let prior = solution.track.expect("a plain frame teaches");
            Exposure { frame, prior }
        });
        Self {
            exposures: exposures.collect(),
            expected,
            instrument,
        }
    }
}
