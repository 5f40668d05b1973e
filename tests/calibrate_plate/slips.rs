//! A camera that moves within a pose: it slips, or drifts.

use super::judged::{errors, worst};
use super::scenes::{K1, sun_frames, truth};
use jiff::{SignedDuration, Timestamp};
use solaspect::calibrate::plate::{self, FrameObservation, MeasuredMark, PlateFit, Pose};
use solaspect::instrument::{Instrument, builtin};
use solaspect::units::SensorPx;

/// Displacement of the plate's image (px) by the elapsed fraction of the pose's duration.
type Motion = dyn Fn(f64) -> (f64, f64);

/// Frames of one pose, taken in an hour.
fn moving(truth: &Instrument, frames: usize, seed: u64, motion: &Motion) -> Vec<FrameObservation> {
    let first: Timestamp = "2013-09-21T15:00:00Z".parse().unwrap();
    let mut frames = sun_frames(truth, (frames, 1), 0.0, seed);
    let count = frames.len() as f64;
    for (n, frame) in frames.iter_mut().enumerate() {
        let part = n as f64 / count;
        frame.utc = Some(first + SignedDuration::from_secs_f64(3600.0 * part));
        let (x, y) = motion(part);
        for mark in &mut frame.marks {
            mark.at = SensorPx::new(mark.at.x + x, mark.at.y + y);
        }
    }
    frames
}

/// Result of 120 frames in one folder.
struct Found {
    poses: Vec<Pose>,
    fit: PlateFit,
    honesty: f64,
    worst: f64,
}

fn found(seed: u64, motion: &Motion) -> Found {
    let truth = truth(1.0, K1, 2000 + seed);
    let frames = moving(&truth, 120, seed, motion);
    let demo = builtin("demo").unwrap();
    let (posed, fit) = plate::fit_frames(&frames, &demo).unwrap();
    let marks: Vec<&MeasuredMark> = fit.marks.iter().collect();
    let (honesty, worst) = (errors(&marks, &truth).1, worst(&marks, &truth));
    Found {
        poses: posed.poses,
        fit,
        honesty,
        worst,
    }
}

/// A slip of `size_px` in the middle of the pose.
fn slip(size_px: f64) -> impl Fn(f64) -> (f64, f64) {
    move |at| match at < 0.5 {
        true => (0.0, 0.0),
        false => (0.8 * size_px, -0.6 * size_px),
    }
}

/// A slip after a third and another, perpendicular to it, after two thirds.
fn two_slips(size_px: f64) -> impl Fn(f64) -> (f64, f64) {
    move |at| match (3.0 * at) as u32 {
        0 => (0.0, 0.0),
        1 => (size_px, 0.0),
        _ => (size_px, size_px),
    }
}

fn drift(px_per_h: f64) -> impl Fn(f64) -> (f64, f64) {
    move |at| (0.6 * px_per_h * at, -0.8 * px_per_h * at)
}

/// A drift whose rate grows linearly from 0 to 1 px/h in an hour.
fn growing(at: f64) -> (f64, f64) {
    (0.5 * at * at, 0.0)
}

/// Prints a row of the table: error over sigma of all seeds, and the worst mark's; whether both meet the limits.
fn row(name: &str, seeds: u64, motion: &Motion) -> bool {
    let all: Vec<Found> = (1..=seeds).map(|seed| found(seed, motion)).collect();
    let squares: f64 = all.iter().map(|found| found.honesty.powi(2)).sum();
    let honesty = (squares / seeds as f64).sqrt();
    let worst = all.iter().map(|found| found.worst).fold(0.0, f64::max);
    let poses: Vec<usize> = all.iter().map(|found| found.poses.len()).collect();
    println!("| {name} | {honesty:.2} | {worst:.1} | {poses:?} |");
    let rigid = all
        .iter()
        .all(|found| found.fit.choice.kind.name() == "similarity");
    (0.8..1.25).contains(&honesty) && worst < 6.0 && rigid
}

#[test]
fn a_camera_that_slips_or_drifts_within_a_pose_leaves_the_sigmas_honest() {
    assert!(row("rest", 1, &|_| (0.0, 0.0)));
    assert!(row("slip 0.3 px", 1, &slip(0.3)));
    assert!(row("slip 1 px", 1, &slip(1.0)));
    assert!(row("two slips 0.45 px", 1, &two_slips(0.45)));
    assert!(row("drift 0.5 px/h", 1, &drift(0.5)));
    assert!(row("drift growing to 1 px/h", 1, &growing));
}

/// `cargo test --release --test promises calibrate_plate::slips -- --ignored --nocapture` prints the table of docs/calibration.md.
#[test]
#[ignore = "200 adjustments: minutes"]
fn slips_and_drifts_of_all_sizes_leave_the_sigmas_honest() {
    const SEEDS: u64 = 8;
    println!(
        "| one pose of 120 frames in an hour | error / sigma, {SEEDS} plates | worst mark | poses found |"
    );
    println!("|---|---|---|---|");
    let mut promised = vec![row("rest", SEEDS, &|_| (0.0, 0.0))];
    for size_px in [0.05, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8, 1.0, 2.0, 5.0] {
        promised.push(row(&format!("slip {size_px} px"), SEEDS, &slip(size_px)));
    }
    for size_px in [0.05, 0.1, 0.3, 0.45, 1.0, 5.0] {
        let name = format!("two slips {size_px} px");
        promised.push(row(&name, SEEDS, &two_slips(size_px)));
    }
    for px_per_h in [0.1, 0.5, 2.0] {
        let name = format!("drift {px_per_h} px/h");
        promised.push(row(&name, SEEDS, &drift(px_per_h)));
    }
    let both = |at: f64| {
        let ((x, y), (slipped_x, slipped_y)) = (drift(0.5)(at), slip(0.3)(at));
        (x + slipped_x, y + slipped_y)
    };
    promised.push(row("drift 0.5 px/h, slip 0.3 px", SEEDS, &both));
    promised.push(row("drift growing to 1 px/h", SEEDS, &growing));
    assert!(promised.iter().all(|kept| *kept), "{promised:?}");
}

#[test]
fn a_drift_is_reported_with_its_speed() {
    let found = found(7, &drift(0.5));
    assert!(found.fit.choice.drift == 1 && found.poses.len() == 1);
    let [x, y] = found.fit.poses[0].drift_px_per_h.unwrap();
    for (found, true_px_per_h) in [(x, 0.3), (y, -0.4)] {
        assert!((found.value - true_px_per_h).abs() < 4.0 * found.sigma);
        assert!(found.sigma < 0.02, "{}", found.sigma);
    }
}

#[test]
fn a_slip_is_found_to_the_frame() {
    let found = found(3, &slip(0.3));
    let frames: Vec<usize> = found.fit.poses.iter().map(|pose| pose.frames).collect();
    assert_eq!(found.poses.len(), 2);
    let all: usize = frames.iter().sum();
    assert!(frames[0].abs_diff(all / 2) <= 1, "{frames:?}");
}

#[test]
fn few_frames_added_to_a_good_file_make_no_mark_worse() {
    let (truth, mut known) = (truth(1.0, K1, 2100), builtin("demo").unwrap());
    let (_, good) = plate::fit_frames(&sun_frames(&truth, (240, 4), 0.0, 11), &known).unwrap();
    for mark in &good.marks {
        known.plate.set(mark.id, mark.position, mark.sigma_mil);
    }
    known.camera.distortion = good.distortion;
    let more = moving(&truth, 60, 12, &|_| (0.0, 0.0));
    let (_, again) = plate::fit_frames(&more, &known).unwrap();
    let of = |fit: &PlateFit| {
        let seen_again = |m: &&MeasuredMark| again.marks.iter().any(|other| other.id == m.id);
        let marks: Vec<&MeasuredMark> = fit.marks.iter().filter(seen_again).collect();
        errors(&marks, &truth)
    };
    let (before, after) = (of(&good).0, of(&again));
    assert!(after.0 < before, "{} mil, before {before}", after.0);
    assert!((0.8..1.25).contains(&after.1), "{}", after.1);
}
