//! From frames to plate, lens and poses.

use super::judged::{errors, lens_difference, seen_often};
use super::scenes::{K1, calibrate, generator, near, pose_folder, similarity, truth};
use solaspect::calibrate::plate;
use solaspect::calibrate::revision::Revision;
use solaspect::fits::{self, Compression};
use solaspect::instrument::{Instrument, builtin, builtin_text};
use solaspect::plate::{MarkId, MarkPlace, heroes};
use solaspect::provenance::PROGRAM;
use solaspect::simulate::{Conditions, RandomScenes, Sun};
use solaspect::units::PlateMil;
use std::path::{Path, PathBuf};

#[test]
fn displaced_marks_and_a_distorting_lens_are_recovered_from_four_poses() {
    let (folder, truth) = (tempfile::tempdir().unwrap(), truth(1.0, K1, 1));
    let given: Vec<PathBuf> = (0..4)
        .map(|pose| pose_folder(folder.path(), pose, 15, &truth, near, |_, _| ()))
        .collect();
    let start = builtin("demo").unwrap();
    let calibration = calibrate(&given, &start).unwrap();
    let often = seen_often(&calibration, 5);
    assert!(often.len() > 15, "{}", often.len());
    let (rms, ratio) = errors(&often, &truth);
    assert!(rms < 0.06, "{rms} mil");
    let (_, of_all) = errors(&seen_often(&calibration, 1), &truth);
    assert!((0.8..1.25).contains(&of_all), "{of_all}, {ratio}");
    let fit = &calibration.fit;
    assert_eq!(fit.choice.lens, [true, false, false, false]);
    assert_eq!(fit.choice.kind.name(), "similarity");
    assert!(fit.separation.by_data());
    // Within 500 px of the sensor's middle, which the four poses cover.
    let lens = lens_difference(&fit.distortion, &truth.camera.distortion);
    assert!(lens < 0.03, "{lens} px");

    // The written file contains the measured values.
    let text = builtin_text("demo").unwrap();
    let mut revision = Revision::of(Path::new("demo"), text).unwrap();
    calibration.revise(&mut revision);
    let (written, _) = revision.finish().unwrap();
    let path = folder.path().join("b.toml");
    std::fs::write(&path, &written).unwrap();
    let read = Instrument::read(&path).unwrap();
    for mark in &fit.marks {
        let place = read.plate.place(mark.id).unwrap();
        assert!(place.at.distance(mark.position) < 1e-4);
        assert!((place.sigma_mil[0] - mark.sigma_mil[0]).abs() < 1e-4);
    }
    let unseen = MarkId { i: -7, j: -7 };
    let drawn = MarkPlace::new(heroes::position(unseen), 1.0);
    assert_eq!(read.plate.place(unseen), Some(drawn));
    let rounded = read.camera.distortion.radial[0] - fit.distortion.radial[0];
    assert!(rounded.abs() < 0.1 * fit.distortion_sigma[0]);
    assert!(written.contains("frames_sha256"));

    // Marks that a later set of few frames does not show keep their values in the file.
    let few = calibrate(&given[..1], &read).unwrap();
    assert!(few.fit.marks.len() < fit.marks.len());
    let mut revision = Revision::of(&path, &written).unwrap();
    few.revise(&mut revision);
    let (_, renewed) = revision.finish().unwrap();
    for mark in &fit.marks {
        assert!(renewed.plate.measured(mark.id).is_some(), "{}", mark.id);
        let seen_again = few.fit.marks.iter().any(|other| other.id == mark.id);
        let same = renewed.plate.position(mark.id) == read.plate.position(mark.id);
        assert!(seen_again || same, "{}", mark.id);
    }

    // The same files give the same result, whatever the order of the folders.
    let mut turned = given.clone();
    turned.reverse();
    let again = calibrate(&turned, &start).unwrap();
    assert_eq!(again.frames_sha256, calibration.frames_sha256);
    for (a, b) in again.fit.marks.iter().zip(&fit.marks) {
        assert!(a.id == b.id && a.position.distance(b.position) < 1e-3);
    }

    let page = plate::html(&calibration, "0123abcd").unwrap();
    assert_eq!(page.matches("<svg").count(), 9);
    // The page names the instrument, the program and the frames.
    let program = PROGRAM;
    for stated in [
        start.name.as_str(),
        program,
        &calibration.frames_sha256,
        "0123abcd",
    ] {
        assert!(page.contains(stated), "{stated}");
    }
    for heading in ["Suspect marks", "Correlations"] {
        assert!(page.contains(&format!("<h2>{heading}")), "{heading}");
    }
    assert!(!page.contains("http://") || !page.contains("<script"));
}

#[test]
fn a_third_of_bad_frames_is_rejected_and_changes_nothing() {
    let (folder, truth) = (tempfile::tempdir().unwrap(), truth(1.0, K1, 1));
    // Two fifths of each pose are bad: blurred, Sun far too small, no Sun, or marks far from their positions.
    let corrupt = {
        let mut corrupt = truth.clone();
        let mut normal = generator(9);
        for id in heroes::ids() {
            let at = truth.plate.position(id).unwrap();
            let off = PlateMil::new(at.x + 40.0 * normal(), at.y + 40.0 * normal());
            corrupt.plate.set(id, off, [1.0; 2]);
        }
        corrupt
    };
    let (clean, mixed) = (folder.path().join("clean"), folder.path().join("mixed"));
    let mut bad_frames = Vec::new();
    for pose in 0..4 {
        pose_folder(&clean, pose, 12, &truth, near, |_, _| ());
        let good = pose_folder(&mixed, pose, 12, &truth, near, |_, _| ());
        let bad = folder.path().join("bad");
        let blur = |n: usize, c: &mut Conditions| match n {
            0 | 1 => c.blur_px = 3.0,
            2 | 3 => c.sun_radius_arcsec = 900.0,
            _ => c.peak_dn = 5.0,
        };
        let optical = pose_folder(&bad, pose, 5, &truth, near, blur);
        let misread = pose_folder(&bad.join("ids"), pose, 3, &corrupt, near, |_, _| ());
        for (kind, from) in [("optical", &optical), ("misread", &misread)] {
            for entry in std::fs::read_dir(from).unwrap() {
                let entry = entry.unwrap();
                let name = format!("{kind}_{}", entry.file_name().to_string_lossy());
                std::fs::copy(entry.path(), good.join(&name)).unwrap();
                bad_frames.push(good.join(name));
            }
        }
    }
    let start = builtin("demo").unwrap();
    let poses = |root: &Path| -> Vec<PathBuf> {
        (0..4)
            .map(|pose| root.join(format!("pose_{pose}")))
            .collect()
    };
    let clean = calibrate(&poses(&clean), &start).unwrap();
    let mixed = calibrate(&poses(&mixed), &start).unwrap();
    for name in &bad_frames {
        let listed = mixed.rejected.iter().any(|rejected| rejected.file == *name);
        assert!(listed, "{} is not listed", name.display());
    }
    for mark in &clean.fit.marks {
        let Some(same) = mixed.fit.marks.iter().find(|m| m.id == mark.id) else {
            panic!("mark {} is lost", mark.id);
        };
        let off = same.position.distance(mark.position);
        assert!(off < 2.0 * mark.sigma_mil[0], "{}: {off}", mark.id);
    }
}

#[test]
fn frames_of_a_displaced_plate_are_identified_in_a_later_pass() {
    let (folder, truth) = (tempfile::tempdir().unwrap(), truth(4.0, K1, 12));
    let given: Vec<PathBuf> = (0..4)
        .map(|pose| pose_folder(folder.path(), pose, 15, &truth, near, |_, _| ()))
        .collect();
    let calibration = calibrate(&given, &builtin("demo").unwrap()).unwrap();
    assert!(calibration.read_later > 5, "{}", calibration.read_later);
    let used: usize = calibration.fit.poses.iter().map(|pose| pose.frames).sum();
    assert!(used >= 55, "{used}");
    let (rms, ratio) = errors(&seen_often(&calibration, 5), &truth);
    assert!(rms < 0.06, "{rms} mil, {ratio}");
}

#[test]
fn a_camera_that_never_moved_is_said_not_to_separate_plate_and_lens() {
    let (folder, truth) = (tempfile::tempdir().unwrap(), truth(1.0, K1, 2));
    let given = pose_folder(folder.path(), 0, 40, &truth, |_| true, |_, _| ());
    let calibration = calibrate(&[given], &builtin("demo").unwrap()).unwrap();
    assert!(!calibration.fit.separation.by_data());
    let text = plate::summary(&calibration);
    assert!(
        text.contains("do not separate the plate's errors from"),
        "{text}"
    );
    assert!(text.contains("Shift and turn the camera"), "{text}");
    // The split by priors is still within its sigma.
    let off = lens_difference(&calibration.fit.distortion, &truth.camera.distortion);
    assert!(off < 3.0 * calibration.fit.separation.lens_sigma_px);
}

#[test]
fn keystone_is_freed_where_the_data_demand_it() {
    let truth = truth(1.0, 0.0, 3);
    let folder = tempfile::tempdir().unwrap();
    let given: Vec<PathBuf> = (0..2)
        .map(|pose| {
            pose_folder(
                folder.path(),
                pose,
                20,
                &truth,
                |_| true,
                |_, c| c.keystone_deg = 3.0,
            )
        })
        .collect();
    let calibration = calibrate(&given, &builtin("demo").unwrap()).unwrap();
    assert_eq!(calibration.fit.choice.kind.name(), "keystone");
    let (rms, ratio) = errors(&seen_often(&calibration, 3), &truth);
    assert!(rms < 0.15, "{rms} mil, {ratio}");
}

#[test]
fn a_frame_of_the_lit_plate_measures_all_marks_at_once() {
    let truth = truth(1.0, K1, 4);
    let folder = tempfile::tempdir().unwrap();
    let given: Vec<PathBuf> = (0..4)
        .map(|pose| {
            let conditions = Conditions {
                similarity: similarity(pose),
                ..Conditions::of(&truth)
            };
            let scenes = RandomScenes::new(&truth, &conditions, 7).unwrap();
            let mut scene = scenes.scene(0).unwrap();
            scene.info.mid_exposure = None;
            scene.sun = Some(Sun {
                limb_darkening: 0.0,
                peak_dn: 180.0,
                ..Sun::new(PlateMil::new(0.0, 0.0), 20_000.0)
            });
            let pose = folder.path().join(format!("pose_{pose}"));
            std::fs::create_dir(&pose).unwrap();
            let file = pose.join("lit.fits");
            fits::write_frame(&file, &scene.frame().unwrap(), &[], &[], Compression::Rice).unwrap();
            pose
        })
        .collect();
    let calibration = calibrate(&given, &builtin("demo").unwrap()).unwrap();
    assert!(
        calibration.fit.marks.len() > 190,
        "{}",
        calibration.fit.marks.len()
    );
    let (rms, ratio) = errors(&seen_often(&calibration, 3), &truth);
    assert!(rms < 0.15, "{rms} mil");
    assert!((0.7..1.4).contains(&ratio), "{ratio}");

    // The frames have no times, so the file has no date.
    let mut revision = Revision::of(Path::new("demo"), builtin_text("demo").unwrap()).unwrap();
    calibration.revise(&mut revision);
    let (written, _) = revision.finish().unwrap();
    let written: toml_edit::DocumentMut = written.parse().unwrap();
    assert!(written["calibration"]["plate"].get("date").is_none());
    assert!(written["mounting"]["plate_centre_px"].get("date").is_none());
}

#[test]
fn marks_that_are_lit_and_never_read_are_listed_as_suspect() {
    let (folder, mut truth) = (tempfile::tempdir().unwrap(), truth(1.0, 0.0, 14));
    let displaced = [(0, 0), (3, -2), (-2, 1), (2, 2)].map(|(i, j)| MarkId { i, j });
    for id in displaced {
        let at = truth.plate.position(id).unwrap();
        let moved = PlateMil::new(at.x + 45.0, at.y - 10.0);
        truth.plate.set(id, moved, [0.01; 2]);
    }
    let given: Vec<PathBuf> = (0..2)
        .map(|pose| pose_folder(folder.path(), pose, 42, &truth, near, |_, _| ()))
        .collect();
    let start = builtin("demo").unwrap();
    let calibration = calibrate(&given, &start).unwrap();
    let suspects: Vec<MarkId> = calibration.suspects.iter().map(|mark| mark.id).collect();
    assert!(!suspects.is_empty());
    assert!(
        suspects.iter().all(|id| displaced.contains(id)),
        "{suspects:?}"
    );
    // Marks that a later pass could identify are measured at their true positions.
    for id in displaced.iter().filter(|id| !suspects.contains(id)) {
        let mark = calibration.fit.marks.iter().find(|mark| mark.id == *id);
        let mark = mark.unwrap_or_else(|| panic!("{id} is neither measured nor suspect"));
        let off = mark.position.distance(truth.plate.position(*id).unwrap());
        assert!(off < 0.5, "{id}: {off} mil");
    }
    let text = plate::summary(&calibration);
    assert!(
        text.contains(&format!("suspect    {} lit in", suspects[0])),
        "{text}"
    );
    let mut revision = Revision::of(Path::new("demo"), builtin_text("demo").unwrap()).unwrap();
    calibration.revise(&mut revision);
    let (written, _) = revision.finish().unwrap();
    assert!(
        written.contains("suspect_marks = [[-2, 1], [0, 0], "),
        "{written}"
    );
}
