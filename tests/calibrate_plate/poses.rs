//! Unnamed poses: all frames are in one folder.

use super::scenes::{K1, calibrate, near, pose_folder, truth};
use solaspect::calibrate::plate;
use solaspect::instrument::builtin;
use std::path::PathBuf;

#[test]
fn poses_in_one_folder_are_found_and_give_the_same_marks() {
    let (root, truth) = (tempfile::tempdir().unwrap(), truth(1.0, K1, 1));
    let given: Vec<PathBuf> = (0..4)
        .map(|pose| pose_folder(root.path(), pose, 12, &truth, near, |_, _| ()))
        .collect();
    let (together, other) = (root.path().join("all"), root.path().join("other"));
    std::fs::create_dir(&together).unwrap();
    for (pose, folder) in given.iter().enumerate() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let entry = entry.unwrap();
            // The names interleave the poses.
            let name = format!("{}_{pose}.fits", entry.file_name().to_string_lossy());
            std::fs::copy(entry.path(), together.join(name)).unwrap();
        }
    }
    // A single frame in another pose.
    let elsewhere = |_: usize, c: &mut solaspect::simulate::Conditions| {
        c.similarity.rotation_deg = 20.0;
    };
    let folder = pose_folder(&other, 0, 1, &truth, near, elsewhere);
    let lonely = together.join("lonely.fits");
    std::fs::copy(folder.join("frame_000.fits"), &lonely).unwrap();

    let start = builtin("demo").unwrap();
    let by_folder = calibrate(&given, &start).unwrap();
    let found = calibrate(std::slice::from_ref(&together), &start).unwrap();
    assert_eq!(by_folder.poses.len(), 4);
    assert!(by_folder.poses.iter().all(|pose| pose.number.is_none()));
    let numbers: Vec<_> = found.poses.iter().map(|pose| pose.number).collect();
    assert_eq!(numbers, [Some(1), Some(2), Some(3), Some(4)]);
    let text = plate::summary(&found);
    let line = format!("found      {}: 4 poses", together.display());
    assert!(text.contains(&line), "{text}");
    assert!(
        found
            .rejected
            .iter()
            .any(|rejected| rejected.file == lonely)
    );
    for mark in &by_folder.fit.marks {
        let same = found.fit.marks.iter().find(|m| m.id == mark.id).unwrap();
        let off = same.position.distance(mark.position);
        assert!(off < 2.0 * mark.sigma_mil[0], "{}: {off}", mark.id);
    }
}
