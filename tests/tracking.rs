//! What a prior does to a frame's solution: it spares work, and decides nothing.

use nalgebra::Matrix2;
use solaspect::aspect::{Expected, Origin, Quality, Solution, Track, solve};
use solaspect::frame::Frame;
use solaspect::instrument::{Instrument, builtin};
use solaspect::registration::{self, Pair};
use solaspect::simulate::{Conditions, RandomScenes, SUN_RADIUS_ARCSEC, SunInView};
use solaspect::units::{PlateMil, SensorPx};

const EXPECTED: Option<Expected> = Some(Expected {
    radius_arcsec: SUN_RADIUS_ARCSEC,
});

struct Flight {
    instrument: Instrument,
    frames: Vec<Frame>,
}

/// A Sun that moves over the sensor by 20 px a frame.
fn flight() -> Flight {
    let instrument = builtin("demo").unwrap();
    let conditions = Conditions {
        sun: SunInView::Whole,
        ..Conditions::of(&instrument)
    };
    let scenes = RandomScenes::new(&instrument, &conditions, 5).unwrap();
    let frame = |n: u64| {
        let mut scene = scenes.scene(n).unwrap();
        let at = SensorPx::new(520.0 + 18.0 * n as f64, 500.0 - 9.0 * n as f64);
        let centre = scene.mapping.to_plate(at);
        scene.sun.as_mut().unwrap().centre = centre;
        scene.frame().unwrap()
    };
    Flight {
        frames: (0..8).map(frame).collect(),
        instrument,
    }
}

impl Flight {
    fn solve(&self, frame: &Frame, prior: Option<&Track>) -> Solution {
        solve(frame, &self.instrument, EXPECTED, prior)
    }

    /// A prior that sees every mark that the first frame names moved on the plate, or on the sensor.
    fn misled(&self, on_plate_mil: [f64; 2], on_sensor_px: [f64; 2]) -> Track {
        let first = self.solve(&self.frames[0], None);
        let plate = &self.instrument.plate;
        let pair = |mark: &solaspect::aspect::Mark| {
            let printed = plate.position(mark.id);
            Pair {
                seen: SensorPx::new(mark.at.x + on_sensor_px[0], mark.at.y + on_sensor_px[1]),
                printed: PlateMil::new(printed.x + on_plate_mil[0], printed.y + on_plate_mil[1]),
                covariance_px2: Matrix2::identity() * 4e-4,
            }
        };
        let pairs: Vec<Pair> = first.marks.iter().map(pair).collect();
        let registration = registration::register(
            &pairs,
            None,
            self.instrument.mounting.handedness,
            self.instrument.camera.distortion,
            &registration::Settings::default(),
        );
        Track {
            registration: Some(registration.unwrap()),
            ..first.track.unwrap()
        }
    }
}

/// How far two solutions are apart, in sigmas of the first.
fn apart_sigmas(a: &Solution, b: &Solution) -> f64 {
    let [a, b] = [a, b].map(|s| s.aspect.as_ref().unwrap().sun_plate);
    let sigma = (a.covariance.trace() / 2.0).sqrt();
    a.position.distance(b.position) / sigma
}

#[test]
fn a_frame_with_a_prior_is_solved_as_it_is_without() {
    let flight = flight();
    let mut track = flight.solve(&flight.frames[0], None).track;
    for frame in &flight.frames[1..] {
        let alone = flight.solve(frame, None);
        let tracked = flight.solve(frame, track.as_ref());
        assert_eq!(tracked.quality, Quality::Fine);
        assert_eq!(tracked.mapping.as_ref().unwrap().origin, Origin::Frame);
        // The short way was taken: nothing was looked for.
        assert!(tracked.detections.marks.is_empty());
        let apart = apart_sigmas(&alone, &tracked);
        assert!(apart < 0.4, "{apart} sigma");
        let id = |m: &solaspect::aspect::Mark| m.id;
        let ids: Vec<_> = alone.marks.iter().map(id).collect();
        let full = tracked
            .marks
            .iter()
            .filter(|m| m.lighting == solaspect::fiducial::Lighting::Full);
        assert!(full.map(id).all(|id| ids.contains(&id)));
        track = tracked.track;
    }
}

#[test]
fn a_prior_whose_ids_are_wrong_is_found_out() {
    let flight = flight();
    // As if every mark were its neighbour along X, or along Y.
    for step in [[270.0, 90.0], [-90.0, 270.0]] {
        let misled = flight.misled(step, [0.0, 0.0]);
        for frame in &flight.frames {
            let tracked = flight.solve(frame, Some(&misled));
            let alone = flight.solve(frame, None);
            assert!(!tracked.detections.marks.is_empty(), "it was looked for");
            assert!(apart_sigmas(&alone, &tracked) < 0.4);
        }
    }
}

#[test]
fn a_camera_that_moved_is_seen_anew() {
    let flight = flight();
    let misled = flight.misled([0.0, 0.0], [2.5, -1.5]);
    for frame in &flight.frames[..3] {
        let tracked = flight.solve(frame, Some(&misled));
        let alone = flight.solve(frame, None);
        assert_eq!(tracked.quality, alone.quality);
        assert!(apart_sigmas(&alone, &tracked) < 0.4);
    }
}
