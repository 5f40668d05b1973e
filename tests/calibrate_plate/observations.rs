//! The adjustment alone, from generated observations.

use super::judged::{errors, lens_difference};
use super::scenes::{K1, generator, observed, similarity, sun_frames, truth};
use solaspect::calibrate::plate::{self, FrameObservation, MeasuredMark, PlateFit};
use solaspect::geometry::Mapping;
use solaspect::instrument::{Instrument, builtin};
use std::time::Instant;

/// Fits frames of this many poses; asserts that all poses are found.
fn fit(frames: &[FrameObservation], poses: usize) -> PlateFit {
    let (posed, fit) = plate::fit_frames(frames, &builtin("demo").unwrap()).unwrap();
    assert_eq!(posed.poses.len(), poses);
    fit
}

fn judged(fit: &PlateFit, truth: &Instrument) -> (f64, f64) {
    errors(&fit.marks.iter().collect::<Vec<&MeasuredMark>>(), truth)
}

/// Frames in which every mark is visible; the four poses take turns.
fn full_frames(truth: &Instrument, count: usize, seed: u64) -> Vec<FrameObservation> {
    let mut normal = generator(seed);
    let frame = |n: usize| {
        let pose = n % 4;
        let mapping = Mapping::similarity(similarity(pose), truth.camera.distortion).unwrap();
        observed((n, pose), (truth, mapping), |_| true, &mut normal)
    };
    (0..count).map(frame).collect()
}

#[test]
fn generated_measurements_of_every_mark_in_many_frames_are_solved() {
    let truth = truth(1.0, K1, 5);
    let fit = fit(&full_frames(&truth, 200, 6), 4);
    let (rms, ratio) = judged(&fit, &truth);
    // 200 observations of 0.02 px each.
    assert!(rms < 0.012, "{rms}");
    assert!((0.8..1.25).contains(&ratio), "{ratio}");
    assert!(lens_difference(&fit.distortion, &truth.camera.distortion) < 0.005);
    assert!(fit.separation.by_data());
    assert!((fit.sigma_factor - 1.0).abs() < 0.02);
}

#[test]
fn a_plate_as_drawn_behind_a_straight_lens_is_found_to_be_so() {
    let truth = truth(0.0, 0.0, 6);
    let fit = fit(&sun_frames(&truth, (400, 4), 0.0, 7), 4);
    assert_eq!(fit.choice.lens, [false; 4]);
    assert!(fit.separation.by_data());
    let (rms, ratio) = judged(&fit, &truth);
    assert!(rms < 0.06 && (0.8..1.25).contains(&ratio), "{rms} {ratio}");
}

#[test]
fn a_plate_far_worse_than_its_drawing_states_bends_neither_views_nor_sigmas() {
    let truth = truth(5.0, K1, 8);
    let fit = fit(&sun_frames(&truth, (200, 4), 0.0, 9), 4);
    assert!((3.5..6.5).contains(&fit.prior_factor));
    assert_eq!(fit.choice.kind.name(), "similarity");
    let (rms, ratio) = judged(&fit, &truth);
    assert!(rms < 0.15 && (0.7..1.3).contains(&ratio), "{rms} {ratio}");
}

/// Error over sigma of many plates: root mean square, smallest and largest.
fn honesty(sigma_of_seed: impl Fn(u64) -> f64, seeds: u64) -> (f64, f64, f64) {
    let ratios: Vec<f64> = (1..=seeds).map(sigma_of_seed).collect();
    let mean_square = ratios.iter().map(|r| r * r).sum::<f64>() / ratios.len() as f64;
    let least = ratios.iter().copied().fold(f64::INFINITY, f64::min);
    let most = ratios.iter().copied().fold(0.0, f64::max);
    (mean_square.sqrt(), least, most)
}

/// Error over sigma of one plate with marks and noise drawn for this seed.
fn of_one_plate(seed: u64, k1: f64, (frames, poses): (usize, usize), keystone_deg: f64) -> f64 {
    let truth = truth(1.0, k1, 1000 + seed);
    let frames = sun_frames(&truth, (frames, poses), keystone_deg, seed);
    judged(&fit(&frames, poses), &truth).1
}

#[test]
fn sigmas_are_honest_on_the_mean_of_a_few_plates() {
    let (mean, ..) = honesty(|seed| of_one_plate(seed, K1, (60, 4), 0.0), 3);
    assert!((0.85..1.15).contains(&mean), "{mean}");
}

/// `cargo test --test promises honest -- --ignored --nocapture` prints the table of docs/calibration.md.
#[test]
#[ignore = "hundreds of adjustments: minutes"]
fn sigmas_are_honest_over_many_seeds() {
    const SEEDS: u64 = 24;
    println!("| generated set | error / sigma, {SEEDS} plates | least | most |\n|---|---|---|---|");
    let sets: [(&str, f64, (usize, usize), f64); 7] = [
        ("400 frames, 4 poses", K1, (400, 4), 0.0),
        ("60 frames, 4 poses", K1, (60, 4), 0.0),
        ("400 frames, 4 poses, keystone 3 deg", K1, (400, 4), 3.0),
        ("60 frames, 4 poses, keystone 3 deg", K1, (60, 4), 3.0),
        ("400 frames, 4 poses, no distortion", 0.0, (400, 4), 0.0),
        ("100 frames, 2 poses, keystone 3 deg", 0.0, (100, 2), 3.0),
        ("100 frames, 1 pose", K1, (100, 1), 0.0),
    ];
    for (name, k1, frames, keystone_deg) in sets {
        let one = |seed| of_one_plate(seed, k1, frames, keystone_deg);
        let (mean, least, most) = honesty(one, SEEDS);
        println!("| {name} | {mean:.2} | {least:.2} | {most:.2} |");
        assert!((0.8..1.25).contains(&mean), "{name}: {mean}");
    }
}

/// The solver alone in full size: 225 marks in 5,000 frames.
#[test]
#[ignore = "a million observations: half a minute"]
fn every_mark_in_five_thousand_frames_is_solved() {
    let truth = truth(1.0, K1, 5);
    let frames = full_frames(&truth, 5000, 6);
    let begun = Instant::now();
    let fit = fit(&frames, 4);
    let (rms, ratio) = judged(&fit, &truth);
    println!(
        "5000 frames, {} observations: {:.1} s, {rms:.4} mil rms, error / sigma {ratio:.2}",
        fit.residuals.len(),
        begun.elapsed().as_secs_f64()
    );
    assert!(rms < 0.003 && (0.8..1.25).contains(&ratio));
}
