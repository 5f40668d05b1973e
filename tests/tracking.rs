//! Effect of a prior on a frame's solution: it saves work, but does not change the result.

use nalgebra::{Matrix2, Vector2};
use solaspect::aspect::{Adopted, Expected, Mark, Quality, Solution, Track, solve};
use solaspect::calibrate::check::{CalibrationCheck, Quantity, contradictions};
use solaspect::frame::Frame;
use solaspect::instrument::{Instrument, Mounting, builtin};
use solaspect::registration::{self, Pair};
use solaspect::report::overlay;
use solaspect::simulate::{Conditions, RandomScenes, SUN_RADIUS_ARCSEC, Strengths, SunInView};
use solaspect::units::{PlateMil, SensorPx};

const EXPECTED: Option<Expected> = Some(Expected {
    radius_arcsec: SUN_RADIUS_ARCSEC,
});

struct Flight {
    instrument: Instrument,
    frames: Vec<Frame>,
    /// Position of the Sun's centre on the plate in each frame.
    truth: Vec<PlateMil>,
}

/// A flight in which the Sun moves back and forth over the sensor by 20 px per frame.
fn flight(frames: u64) -> Flight {
    flight_within([260.0, 190.0], frames)
}

/// The same, with the Sun within this distance of the plate's centre.
fn flight_within(reach_px: [f64; 2], frames: u64) -> Flight {
    let instrument = builtin("demo").unwrap();
    let conditions = Conditions {
        sun: SunInView::Whole,
        ..Conditions::of(&instrument)
    };
    let scenes = RandomScenes::new(&instrument, &conditions, 5).unwrap();
    let picture = |n: u64| {
        let mut scene = scenes.scene(n).unwrap();
        let along = n as f64 * 0.07;
        let at = SensorPx::new(
            648.0 + reach_px[0] * along.sin(),
            483.0 + reach_px[1] * (1.7 * along).cos(),
        );
        let centre = scene.mapping.to_plate(at);
        scene.sun.as_mut().unwrap().centre = centre;
        (scene.frame().unwrap(), centre)
    };
    let (frames, truth) = (0..frames).map(picture).unzip();
    Flight {
        instrument,
        frames,
        truth,
    }
}

impl Flight {
    fn solve(&self, frame: &Frame, prior: Option<&Track>) -> Solution {
        solve(frame, &self.instrument, EXPECTED, prior)
    }

    /// A wrong prior: every mark identified in the first frame is displaced on the plate, or on the sensor.
    fn misled(&self, on_plate_mil: [f64; 2], on_sensor_px: [f64; 2]) -> Track {
        let first = self.solve(&self.frames[0], None);
        let plate = &self.instrument.plate;
        let pair = |mark: &Mark| {
            let printed = plate.position(mark.id).unwrap();
            Pair {
                observed: SensorPx::new(mark.at.x + on_sensor_px[0], mark.at.y + on_sensor_px[1]),
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
            &registration::RegistrationSettings::default(),
        );
        Track {
            registration: Some(registration.unwrap()),
            ..first.track.unwrap()
        }
    }
}

/// Distance between two solutions in sigmas of the first.
fn apart_sigmas(a: &Solution, b: &Solution) -> f64 {
    let [a, b] = [a, b].map(|s| s.aspect.as_ref().unwrap().sun_plate);
    let sigma = (a.covariance.trace() / 2.0).sqrt();
    a.position.distance(b.position) / sigma
}

/// Rms of error over sigma, per axis.
fn rms(ratios: &[Vector2<f64>]) -> f64 {
    let squares: f64 = ratios.iter().map(|ratio| ratio.norm_squared()).sum();
    (squares / (2 * ratios.len()) as f64).sqrt()
}

#[test]
fn a_frame_with_a_prior_is_solved_as_well_as_without_and_nearly_the_same() {
    let flight = flight(80);
    let mut track = flight.solve(&flight.frames[0], None).track;
    let (mut ratios, mut errors, mut moved) = (Vec::new(), [0.0; 2], Vec::new());
    let mut short_ways = 0;
    for (frame, truth) in flight.frames.iter().zip(&flight.truth).skip(1) {
        let alone = flight.solve(frame, None);
        let tracked = flight.solve(frame, track.as_ref());
        assert_eq!(tracked.quality, Quality::Fine);
        assert!(matches!(tracked.mapping, Some(Adopted::Own(_))));
        short_ways += u32::from(tracked.track.as_ref().unwrap().predicted > 0);
        let [a, b] = [&alone, &tracked].map(|s| s.aspect.as_ref().unwrap().sun_plate);
        let sigma = (b.covariance.trace() / 2.0).sqrt();
        ratios.push((b.position.vector() - truth.vector()) / sigma);
        moved.push((b.position.vector() - a.position.vector()) / sigma);
        errors[0] += a.position.distance(*truth).powi(2);
        errors[1] += b.position.distance(*truth).powi(2);
        track = tracked.track;
    }
    let worse = (errors[1] / errors[0]).sqrt();
    let (ratio, moved) = (rms(&ratios), rms(&moved));
    println!(
        "error over sigma {ratio:.2}, {worse:.3} of the error without a prior, {moved:.2} sigma apart"
    );
    // From time to time the marks are searched in spite of the prior.
    assert!((60..79).contains(&short_ways), "{short_ways}");
    assert!((0.8..1.25).contains(&ratio), "{ratio}");
    assert!(worse < 1.1, "{worse}");
    assert!(moved < 0.4, "{moved}");
}

#[test]
fn a_prior_whose_ids_are_wrong_is_found_out() {
    let flight = flight(8);
    // As if every mark were its neighbour along X, or along Y.
    for step in [[270.0, 90.0], [-90.0, 270.0]] {
        let misled = flight.misled(step, [0.0, 0.0]);
        for frame in &flight.frames {
            let tracked = flight.solve(frame, Some(&misled));
            let alone = flight.solve(frame, None);
            assert_eq!(tracked.track.as_ref().unwrap().predicted, 0);
            assert!(apart_sigmas(&alone, &tracked) < 0.4);
        }
    }
}

#[test]
fn a_camera_that_moved_is_seen_anew() {
    let flight = flight(8);
    let misled = flight.misled([0.0, 0.0], [2.5, -1.5]);
    for frame in &flight.frames[..3] {
        let tracked = flight.solve(frame, Some(&misled));
        let alone = flight.solve(frame, None);
        assert_eq!(tracked.quality, alone.quality);
        assert!(apart_sigmas(&alone, &tracked) < 0.4);
    }
}

/// Mean position, relative to the Sun's centre, of the marks that both solutions have, for each solution, px.
fn marks_from_sun_px(solutions: [&Solution; 2]) -> [Vector2<f64>; 2] {
    let common = |a: &&Mark| {
        solutions
            .iter()
            .all(|s| s.marks.iter().any(|b| a.id == b.id))
    };
    solutions.map(|solution| {
        let sun = solution.aspect.unwrap().sun_px.position.vector();
        let marks: Vec<&Mark> = solution.marks.iter().filter(common).collect();
        assert!(marks.len() >= 3);
        let sum: Vector2<f64> = marks.iter().map(|mark| mark.at.vector() - sun).sum();
        sum / marks.len() as f64
    })
}

#[test]
fn coma_is_removed_from_predicted_marks_as_from_detected_ones() {
    let instrument = builtin("demo").unwrap();
    let conditions = Conditions {
        stray: Strengths {
            coma: 0.1,
            ..Strengths::default()
        },
        ..Conditions::of(&instrument)
    };
    let scenes = RandomScenes::new(&instrument, &conditions, 1).unwrap();
    let mut compared = 0;
    for number in 0..8 {
        let frame = scenes.scene(number).unwrap().frame().unwrap();
        let acquired = solve(&frame, &instrument, EXPECTED, None);
        let tracked = solve(&frame, &instrument, EXPECTED, acquired.track.as_ref());
        if tracked.track.as_ref().unwrap().predicted == 0 {
            continue;
        }
        compared += 1;
        let [acquired, tracked] = marks_from_sun_px([&acquired, &tracked]);
        let apart_px = (acquired - tracked).norm();
        // Without the correction, coma would shift the predicted marks by 0.05 px.
        assert!(apart_px < 0.02, "frame {number}: {apart_px} px");
    }
    assert!(compared >= 4, "{compared}");
}

#[test]
fn the_picture_of_a_frame_shows_its_marks_though_they_were_predicted() {
    let flight = flight(2);
    let prior = flight.solve(&flight.frames[0], None).track;
    let drawn = |solution: &Solution| {
        let instrument = &flight.instrument;
        let picture = overlay(&flight.frames[1], solution, instrument, "a frame");
        let coloured = |pixel: &&image::Rgb<u8>| pixel.0 == [110, 190, 255];
        picture.pixels().filter(coloured).count()
    };
    let alone = flight.solve(&flight.frames[1], None);
    let predicted = flight.solve(&flight.frames[1], prior.as_ref());
    assert_eq!(
        predicted.track.as_ref().map(|track| track.predicted),
        Some(1)
    );
    let (alone, predicted) = (drawn(&alone), drawn(&predicted));
    assert!(alone > 500, "{alone}");
    assert!(
        alone.abs_diff(predicted) < alone / 5,
        "{alone} and {predicted}"
    );
}

/// Quantities of the mounting that fine frames contradict when one is stated wrongly.
fn contradicted(flight: &Flight, wrongly: fn(&mut Mounting)) -> Vec<Vec<Quantity>> {
    let mut wrong = flight.instrument.clone();
    wrongly(&mut wrong.mounting);
    let found = flight.frames.iter().map(|frame| {
        let solution = flight.solve(frame, None);
        assert_eq!(solution.quality, Quality::Fine);
        let found = contradictions(&solution, &wrong);
        found.into_iter().map(|c| c.quantity).collect()
    });
    found.collect()
}

#[test]
fn fine_frames_contradict_what_is_wrong_in_a_calibration_and_nothing_else() {
    let flight = flight_within([100.0, 60.0], 4);
    type Case = (fn(&mut Mounting), Vec<Quantity>);
    let cases: [Case; 5] = [
        (|_| {}, vec![]),
        (|m| m.rotation_deg.value += 180.0, vec![Quantity::Rotation]),
        (|m| m.scale_mil_per_px.value *= 1.02, vec![Quantity::Scale]),
        (|m| m.plate_centre_px.x -= 60.0, vec![Quantity::CentreX]),
        (|m| m.plate_centre_px.y += 60.0, vec![Quantity::CentreY]),
    ];
    for (wrongly, expected) in cases {
        let found = contradicted(&flight, wrongly);
        assert!(
            found.iter().all(|found| *found == expected),
            "{found:?}, {expected:?}"
        );
    }
}

#[test]
fn a_contradiction_names_key_and_values() {
    let flight = flight_within([0.0, 0.0], 1);
    let mut wrong = flight.instrument.clone();
    wrong.mounting.rotation_deg.value = 180.0;
    let found = contradictions(&flight.solve(&flight.frames[0], None), &wrong);
    let said = found[0].to_string();
    assert!(
        said.starts_with("mounting.rotation_deg: stated 180 +- 1, measured "),
        "{said}"
    );
    assert!(found[0].measured.value.abs() < 5.0 * found[0].measured.sigma);
}

#[test]
fn no_calibration_that_is_right_within_three_sigmas_is_contradicted() {
    let instrument = builtin("demo").unwrap();
    let mounting = &instrument.mounting;
    let mut fine = 0;
    for (seed, keystone_deg) in [(1, 0.0), (2, 3.0), (3, -3.0)] {
        let mut conditions = Conditions {
            sun: SunInView::Whole,
            keystone_deg,
            mark_scatter_mil: 1.0,
            ..Conditions::of(&instrument)
        };
        let way = if seed == 2 { -1.0 } else { 1.0 };
        conditions.similarity.rotation_deg += 3.0 * way * mounting.rotation_deg.sigma;
        conditions.similarity.scale_mil_per_px += 2.0 * way * mounting.scale_mil_per_px.sigma;
        conditions.similarity.plate_centre.x += 2.5 * way * mounting.plate_centre_sigma_px;
        let scenes = RandomScenes::new(&instrument, &conditions, seed).unwrap();
        for number in 0..20 {
            let frame = scenes.scene(number).unwrap().frame().unwrap();
            let solution = solve(&frame, &instrument, EXPECTED, None);
            fine += u32::from(solution.quality == Quality::Fine);
            let found = contradictions(&solution, &instrument);
            assert!(found.is_empty(), "seed {seed}, frame {number}: {found:?}");
        }
    }
    assert!(fine > 30, "{fine}");
}

/// A frame of the same camera with marks too faint to be found.
fn without_marks(flight: &Flight, centre: PlateMil) -> Frame {
    let scenes = RandomScenes::new(&flight.instrument, &Conditions::of(&flight.instrument), 5);
    let mut scene = scenes.unwrap().scene(99).unwrap();
    scene.mark_contrast = 0.0;
    scene.sun.as_mut().unwrap().centre = centre;
    scene.frame().unwrap()
}

#[test]
fn a_frame_without_marks_borrows_what_was_measured_instead_of_what_was_disproved() {
    let flight = flight(6);
    let mut stated = flight.instrument.clone();
    stated.mounting.rotation_deg.value = 180.0;
    let mut check = CalibrationCheck::default();
    let fine: Vec<Solution> = flight
        .frames
        .iter()
        .map(|f| flight.solve(f, None))
        .collect();
    for (n, solution) in fine.iter().enumerate() {
        // Two frames are not sufficient; a proven contradiction is reported once.
        let proven = check.note(solution, &stated).len();
        assert_eq!(proven, usize::from(n == 2), "frame {n}");
        assert_eq!(check.corrected(&stated).is_some(), n >= 2);
    }
    let truth = PlateMil::new(700.0, 500.0);
    let frame = without_marks(&flight, truth);
    let error_sigmas = |instrument: &Instrument| {
        let solution = solve(&frame, instrument, EXPECTED, None);
        assert!(matches!(solution.mapping, Some(Adopted::Calibration(_))));
        let found = solution.aspect.unwrap().sun_plate;
        found.position.distance(truth) / (found.covariance.trace() / 2.0).sqrt()
    };
    assert!(error_sigmas(&stated) > 20.0);
    let corrected = check.corrected(&stated).unwrap();
    assert!(
        error_sigmas(&corrected) < 5.0,
        "{}",
        error_sigmas(&corrected)
    );
    // A corrected file is trusted again.
    for solution in &fine[..3] {
        assert!(check.note(solution, &flight.instrument).is_empty());
    }
    assert_eq!(check.corrected(&flight.instrument), None);
}
