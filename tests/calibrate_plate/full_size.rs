//! The numbers stated in the documentation, in full size.

use super::judged::{errors, lens_difference, seen_often};
use super::scenes::{K1, calibrate, pose_folder, truth};
use solaspect::instrument::builtin;
use solaspect::simulate::Conditions;
use std::path::PathBuf;

/// A set of frames of the full-size program.
struct Set {
    name: &'static str,
    rms_mil: f64,
    k1: f64,
    poses: usize,
    frames: usize,
    keystone_deg: f64,
}

/// `cargo test --release --test promises calibrate_plate -- --ignored --nocapture` prints the table of docs/calibration.md.
#[test]
#[ignore = "400 frames a set: minutes"]
fn full_size_sets_meet_the_numbers_that_the_documentation_states() {
    const STANDARD: Set = Set {
        name: "1 mil, 1 px at 600 px, 4 poses",
        rms_mil: 1.0,
        k1: K1,
        poses: 4,
        frames: 400,
        keystone_deg: 0.0,
    };
    let sets = [
        Set {
            name: "60 frames",
            frames: 60,
            ..STANDARD
        },
        Set {
            name: "keystone 3 deg",
            keystone_deg: 3.0,
            ..STANDARD
        },
        Set {
            name: "3 mil",
            rms_mil: 3.0,
            ..STANDARD
        },
        Set {
            name: "as drawn, no distortion",
            rms_mil: 0.0,
            k1: 0.0,
            ..STANDARD
        },
        Set {
            name: "one pose",
            poses: 1,
            frames: 100,
            ..STANDARD
        },
        STANDARD,
    ];
    println!(
        "| set | frames used | marks seen | of 10 observations: rms, mil | error / sigma | all: rms, mil | error / sigma | lens rms, px | mapping | apart |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    for set in &sets {
        let (truth, folder) = (truth(set.rms_mil, set.k1, 11), tempfile::tempdir().unwrap());
        let tilt = |_: usize, c: &mut Conditions| c.keystone_deg = set.keystone_deg;
        let given: Vec<PathBuf> = (0..set.poses)
            .map(|pose| {
                let frames = set.frames / set.poses;
                pose_folder(folder.path(), pose, frames, &truth, |_| true, tilt)
            })
            .collect();
        let calibration = calibrate(&given, &builtin("demo").unwrap()).unwrap();
        let fit = &calibration.fit;
        let used: usize = fit.poses.iter().map(|pose| pose.frames).sum();
        let often = seen_often(&calibration, 10);
        let (rms, ratio) = match often.is_empty() {
            true => (0.0, 0.0),
            false => errors(&often, &truth),
        };
        let (all_rms, all_ratio) = errors(&seen_often(&calibration, 1), &truth);
        let lens = lens_difference(&fit.distortion, &truth.camera.distortion);
        println!(
            "| {} | {used} of {} | {} ({}) | {rms:.3} | {ratio:.2} | {all_rms:.3} | {all_ratio:.2} | {lens:.4} | {} | {} |",
            set.name,
            set.frames,
            fit.marks.len(),
            often.len(),
            fit.choice.kind.name(),
            fit.separation.by_data()
        );
        if set.frames == 400 {
            let tilted = set.keystone_deg > 0.0;
            let limit = if tilted { 0.12 } else { 0.05 };
            assert!(rms < limit, "{}: {rms} mil", set.name);
            // A keystone of the plate as a whole is nearly degenerate with that of the views: two random numbers determine the ratio.
            let calibrated = tilted || (0.8..1.25).contains(&all_ratio);
            assert!(calibrated, "{}: {all_ratio}", set.name);
            assert!(lens < 0.02, "{}: {lens} px", set.name);
        }
    }
}
