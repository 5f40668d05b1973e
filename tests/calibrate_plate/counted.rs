//! Frames that an existing file is already based on.

use super::scenes::{K1, near, pose_folder, similarity, truth};
use solaspect::calibrate::plate::{self, StartFrom, UsedFrames};
use solaspect::calibrate::revision::Revision;
use solaspect::geometry::SimilarityParameters;
use solaspect::instrument::{Instrument, builtin_text};
use std::path::{Path, PathBuf};

#[test]
fn no_frame_counts_twice_in_a_file() {
    let (root, truth) = (tempfile::tempdir().unwrap(), truth(1.0, K1, 21));
    // The camera moves so little that the mounting of one pose serves for all.
    let folders: Vec<PathBuf> = [0.0, 0.01, 0.02]
        .into_iter()
        .enumerate()
        .map(|(pose, turn_deg)| {
            pose_folder(root.path(), pose, 14, &truth, near, |_, conditions| {
                conditions.similarity = SimilarityParameters {
                    rotation_deg: turn_deg,
                    ..similarity(0)
                };
            })
        })
        .collect();
    let next = |text: &str, given: &[PathBuf]| {
        let mut revision = Revision::of(Path::new("a.toml"), text).unwrap();
        let start = Instrument::parse(Path::new("a.toml"), text).unwrap();
        let used_frames = UsedFrames::of(&revision);
        let calibration = plate::calibrate(given, &start, &used_frames, &()).unwrap();
        calibration.revise(&mut revision);
        (calibration, revision.finish().unwrap().0)
    };
    let (first, text) = next(builtin_text("demo").unwrap(), &folders[..2]);
    assert_eq!((first.start_from, first.poses.len()), (StartFrom::File, 2));

    // One known pose and one new one.
    let (second, text) = next(&text, &folders[1..]);
    assert_eq!(
        (second.start_from, second.poses.len()),
        (StartFrom::File, 1)
    );
    let set_aside = second
        .rejected
        .iter()
        .filter(|r| r.reason.contains("rests on it already"));
    assert_eq!(set_aside.count(), 14);
    assert!(
        second
            .frames()
            .all(|frame| frame.file.starts_with(&folders[2]))
    );

    // All folders, then one of them: the marks begin with the drawing, and the file rests on the given frames alone.
    let (third, all) = next(&text, &folders);
    assert_eq!(
        (third.start_from, third.poses.len()),
        (StartFrom::Drawing, 3)
    );
    let (fourth, some) = next(&text, &folders[..1]);
    assert_eq!(fourth.start_from, StartFrom::Drawing);
    let hashes = |text: &str| {
        let (_, list) = text.split_once("frame_hashes = \"").unwrap();
        list.split('"').next().unwrap().split(' ').count()
    };
    assert_eq!([&text, &all, &some].map(|text| hashes(text)), [42, 42, 14]);
}
