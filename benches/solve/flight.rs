//! The frames to solve: a Sun that moves over the sensor, each frame with the tracking prior from the previous one.

use solaspect::aspect::{self, Expected, Track};
use solaspect::frame::Frame;
use solaspect::instrument::{Instrument, builtin};
use solaspect::simulate::{self, Depth, Noise, RandomScenes, SUN_RADIUS_ARCSEC};
use solaspect::units::SensorPx;

/// Number of frames of a flight: with 1.25 MB each they exceed the caches, which a single frame does not. There are fewer
/// large ones, because rendering them under callgrind is slow.
const FRAMES: u64 = 8;
const LARGE_FRAMES: u64 = 3;
/// Number of conditions that are compared with the committed counts: those of the real camera.
pub const CHECKED: usize = 3;
/// Motion from frame to frame: 0.25 deg/s at 4 frames/s.
const STEP_PX: [f64; 2] = [19.3, 10.7];

pub struct Conditions {
    pub name: &'static str,
    noise_dn: f64,
    depth: Depth,
    /// Initial position of the Sun, px.
    start_px: [f64; 2],
    camera: Camera,
}

/// Difference of the camera from the demo instrument's.
#[derive(Clone, Copy)]
enum Camera {
    Standard,
    /// Twice as wide and high, with the same scale.
    Wider,
    /// The same with a lens of twice the focal length: the disc's diameter is doubled, the marks keep their size.
    Telephoto,
    /// Twice as wide and high, with everything twice as large in pixels.
    Finer,
}

const STANDARD: Conditions = Conditions {
    name: "8 bit, noise 5 DN",
    noise_dn: 5.0,
    depth: Depth::Eight,
    start_px: [500.0, 370.0],
    camera: Camera::Standard,
};

pub const CONDITIONS: [Conditions; 6] = [
    STANDARD,
    Conditions {
        name: "8 bit, noise 15 DN, 12 marks",
        noise_dn: 15.0,
        start_px: [565.0, 435.0],
        ..STANDARD
    },
    Conditions {
        name: "12 bit, noise 5 DN of 8 bit",
        depth: Depth::Twelve,
        ..STANDARD
    },
    Conditions {
        name: "sensor x 4",
        camera: Camera::Wider,
        ..STANDARD
    },
    Conditions {
        name: "sensor x 4, disc and marks x 4",
        camera: Camera::Telephoto,
        start_px: [1060.0, 780.0],
        ..STANDARD
    },
    Conditions {
        name: "sensor x 4, everything x 4",
        camera: Camera::Finer,
        start_px: [1000.0, 740.0],
        ..STANDARD
    },
];

impl Camera {
    fn instrument(self) -> Instrument {
        let mut instrument = builtin("demo").expect("the demo instrument is built in");
        let (optics, mounting) = (&mut instrument.optics, &mut instrument.mounting);
        if matches!(self, Self::Standard) {
            return instrument;
        }
        instrument.camera.width_px *= 2;
        instrument.camera.height_px *= 2;
        let wide = self.centred();
        if wide {
            let centre = mounting.plate_centre_px;
            mounting.plate_centre_px = SensorPx::new(2.0 * centre.x, 2.0 * centre.y);
        }
        match self {
            Self::Standard | Self::Wider => {}
            Self::Telephoto => {
                optics.plate_distance_mm.value *= 2.0;
                optics.focal_length_mm.value *= 2.0;
            }
            Self::Finer => {
                mounting.scale_mil_per_px.value /= 2.0;
                mounting.scale_mil_per_px.sigma /= 2.0;
                optics.blur_px.value *= 2.0;
            }
        }
        instrument
    }

    /// Whether the plate's centre moves to the larger sensor's centre.
    fn centred(self) -> bool {
        matches!(self, Self::Telephoto | Self::Finer)
    }
}

pub struct Exposure {
    pub frame: Frame,
    /// Tracking prior from the previous frame.
    pub prior: Track,
}

pub struct Flight {
    pub instrument: Instrument,
    pub expected: Option<Expected>,
    pub exposures: Vec<Exposure>,
}

impl Flight {
    pub fn under(conditions: &Conditions) -> Self {
        let instrument = conditions.camera.instrument();
        let start_px = conditions.start_px;
        let frames = match conditions.camera {
            Camera::Standard => FRAMES,
            _ => LARGE_FRAMES,
        };
        let expected = Some(Expected {
            radius_arcsec: SUN_RADIUS_ARCSEC,
        });
        let conditions = simulate::Conditions {
            noise: Noise::read(conditions.noise_dn),
            depth: conditions.depth,
            ..simulate::Conditions::of(&instrument)
        };
        let scenes =
            RandomScenes::new(&instrument, &conditions, 1).expect("the demo is large enough");
        let frame = |n: u64| {
            let mut scene = scenes.scene(n).expect("the demo is large enough");
            let at: [f64; 2] = std::array::from_fn(|k| start_px[k] + STEP_PX[k] * n as f64);
            if let Some(sun) = &mut scene.sun {
                sun.centre = scene.mapping.to_plate(SensorPx::new(at[0], at[1]));
            }
            scene.frame().expect("the scene fits its sensor")
        };
        let mut before = frame(0);
        let exposures = (1..=frames).map(|n| {
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
