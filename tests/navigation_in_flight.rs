//! The filter in flight: frames, an IMU on the controller's line and a separate GPS receiver, with offsets by the gyros
//! while no Sun is visible.

use solaspect::demo::{self, Demo};
use solaspect::navigation::files::{read_gps, read_imu};
use solaspect::navigation::{Climb, NavigationSettings};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The only file in a folder whose name begins with `begins`.
fn only(folder: &Path, begins: &str) -> PathBuf {
    let files = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path());
    let is_one = |path: &PathBuf| {
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        name.starts_with(begins)
    };
    let found: Vec<PathBuf> = files.filter(is_one).collect();
    assert_eq!(found.len(), 1, "{begins}: {found:?}");
    found[0].clone()
}

#[test]
fn offsets_go_on_while_the_sun_is_away_and_the_archive_keeps_what_they_rest_on() {
    let folder = tempfile::tempdir().unwrap();
    let settings = Demo::lasting(Duration::from_secs(14), folder.path(), 3);
    let summary = demo::run(&settings, &mut None, |_| {}, || false).unwrap();
    println!("{summary}");
    assert_eq!(summary.lost(), 0, "{summary}");
    let navigation = &summary.tally.navigation;
    assert!(summary.tally.counts.imu_samples > 1200, "{summary}");
    assert_eq!((navigation.lost_samples, navigation.restarts), (0, 0));
    assert_eq!(navigation.contradicted, 0);
    // Between 60 and 75 % of the run no frame shows the Sun.
    let away = summary.propagated.iter().filter(|one| one.age_s > 0.5);
    assert!(away.count() > 10, "{summary}");
    // Gyros, Sun and horizon observe the same rolling vehicle.
    assert!(summary.by_sun.len() > 20, "{summary}");
    for one in summary.propagated.iter().chain(&summary.by_sun) {
        for error_arcsec in one.error_arcsec {
            let sigmas = error_arcsec / one.sigma_arcsec;
            assert!(sigmas.abs() < 5.0, "{one:?}");
        }
    }

    let root = folder.path();
    let file = only(root, "navigation_");
    let flown = NavigationSettings::read(&file).unwrap();
    let imu = read_imu(&[only(root, "imu_")], &flown).unwrap();
    let samples = imu.iter().map(Vec::len).sum::<usize>();
    assert_eq!(
        (imu.len(), samples as u64),
        (1, summary.tally.counts.imu_samples)
    );
    let fixes = read_gps(&[only(root, "gps_")], &flown).unwrap();
    assert!(fixes.len() > 10 && fixes.iter().all(|fix| fix.climb == Climb::Unknown));
    let offsets = fs::read_to_string(only(root, "propagated_")).unwrap();
    assert_eq!(offsets.lines().count() as u64, navigation.offsets + 1);
    assert!(offsets.starts_with("t_s,azimuth_deg,"), "{offsets}");
}
