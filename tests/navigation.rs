//! Attitude by gyros: what goes in is checked, what comes out is as good as it says.

use std::path::Path;
use std::process::{Command, Output};

const NAV: &str = "[imu]\nangular_random_walk = 1e-5\nvelocity_random_walk = 1e-4\n\
    [gps]\nposition_sigma_m = 5\nvelocity_sigma_m_s = 0.05\n\
    [nadir]\ncorrelated_sigma_deg = 0.04\n\
    [[camera]]\nname = \"pyas\"\nbody_from_camera = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]\ncorrelation_time_s = 20\n";
const IMU: &str = "t_s,fx_m_s2,fy_m_s2,fz_m_s2,wx_rad_s,wy_rad_s,wz_rad_s\n\
    0.01,0,0,-9.7,0,0,0\n0.02,0,0,-9.7,0,0,0\n0.03,0,0,-9.7,0,0,0\n";
const GPS: &str = "t_s,x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s\n0,6400000,0,0,0,0,0\n";
const VECTORS: &str =
    "t_s,camera,target,x,y,z,sigma_rad\n0,pyas,nadir,0,1,0,0.001\n0,pyas,sun,0,0,1,1e-6\n";
const SUN: &str = "t_s,x,y,z\n-1,0,1,0\n1,0,1,0\n";

/// A flight's files, some of them changed.
fn navigate(change: &[(&str, &str)], more: &[&str]) -> (Output, tempfile::TempDir) {
    let folder = tempfile::tempdir().unwrap();
    for (name, text) in [
        ("NAV.toml", NAV),
        ("imu.csv", IMU),
        ("gps.csv", GPS),
        ("vectors.csv", VECTORS),
        ("sun.csv", SUN),
    ] {
        let changed = change.iter().find(|(changed, _)| *changed == name);
        let text = changed.map_or(text, |(_, text)| text);
        std::fs::write(folder.path().join(name), text).unwrap();
    }
    let output = command(folder.path(), more);
    (output, folder)
}

fn command(folder: &Path, more: &[&str]) -> Output {
    let file = |name: &str| folder.join(name);
    Command::new(env!("CARGO_BIN_EXE_solaspect"))
        .arg("navigate")
        .arg("--config")
        .arg(file("NAV.toml"))
        .arg("--imu")
        .arg(file("imu.csv"))
        .arg("--gps")
        .arg(file("gps.csv"))
        .arg("--vectors")
        .arg(file("vectors.csv"))
        .arg("--out")
        .arg(file("out"))
        .args(more)
        .output()
        .unwrap()
}

fn with_sun(folder: &tempfile::TempDir) -> String {
    folder.path().join("sun.csv").display().to_string()
}

#[test]
fn what_is_wrong_with_a_flights_files_is_named_with_file_line_and_column() {
    let late = "t_s,x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s\n9,6400000,0,0,0,0,0\n1,6400000,0,0,0,0,0\n";
    let long = format!("{IMU}0.04,0,0,-9.7,0,0,0\n0.9,0,0,-9.7,0,0,0\n");
    for (file, text, wanted) in [
        (
            "imu.csv",
            IMU.replace("0.03,", "0.02,"),
            vec!["imu.csv, line 4: t_s", "0.02"],
        ),
        (
            "imu.csv",
            IMU.replace("-9.7,0,0,0\n0.03", "NaN,0,0,0\n0.03"),
            vec!["line 3: fz_m_s2", "NaN"],
        ),
        (
            "imu.csv",
            IMU.replace("0.03,0,0,-9.7", "0.03,0,0,-9700"),
            vec!["line 4: specific force", "m/s^2"],
        ),
        (
            "imu.csv",
            IMU.replace("fx_m_s2", "ax"),
            vec!["line 1: columns", "fx_m_s2", "ax"],
        ),
        ("imu.csv", long, vec!["line 6: t_s", "0.9"]),
        (
            "imu.csv",
            "t_s,fx_m_s2,fy_m_s2,fz_m_s2,wx_rad_s,wy_rad_s,wz_rad_s\n".into(),
            vec!["two rows"],
        ),
        (
            "gps.csv",
            late.into(),
            vec!["gps.csv, line 3: t_s", "2 s before"],
        ),
        (
            "gps.csv",
            GPS.replace("6400000", "6400"),
            vec!["line 2: x_m, y_m, z_m", "6400 m"],
        ),
        (
            "vectors.csv",
            VECTORS.replace("pyas,sun", "pyass,sun"),
            vec!["line 3: camera", "pyas", "\"pyass\""],
        ),
        (
            "vectors.csv",
            VECTORS.replace("nadir", "mars"),
            vec!["line 2: target", "\"mars\""],
        ),
        (
            "vectors.csv",
            VECTORS.replace("0,1,0,0.001", "0,2,0,0.001"),
            vec!["line 2: x, y, z", "2"],
        ),
        (
            "vectors.csv",
            VECTORS.replace("0.001", "0.0001"),
            vec!["line 2: sigma_rad", "[nadir] correlated_sigma_deg"],
        ),
        (
            "vectors.csv",
            VECTORS.replace("0,pyas,sun", "7,pyas,sun"),
            vec!["line 3: sun", "does not reach"],
        ),
        (
            "vectors.csv",
            VECTORS.replace("sun", "moon"),
            vec!["line 3: moon", "epoch_utc"],
        ),
        (
            "sun.csv",
            SUN.replace("-1,", "2,"),
            vec!["sun.csv, line 3: t_s"],
        ),
        (
            "NAV.toml",
            NAV.replace("angular_random", "angel_random"),
            vec!["NAV.toml", "angel_random_walk", "nearest"],
        ),
        (
            "NAV.toml",
            NAV.replace("[0, 1, 0]]", "[0, 2, 0]]"),
            vec!["camera \"pyas\": body_from_camera"],
        ),
        (
            "NAV.toml",
            NAV.replace("= 5\n", "= -5\n"),
            vec!["gps.position_sigma_m", "-5"],
        ),
        (
            "NAV.toml",
            format!("{NAV}[filter]\nconsidered = [\"gyros\"]\n"),
            vec!["filter.considered", "gyros"],
        ),
    ] {
        let folder = tempfile::tempdir().unwrap();
        for (name, text_of) in [
            ("NAV.toml", NAV),
            ("imu.csv", IMU),
            ("gps.csv", GPS),
            ("vectors.csv", VECTORS),
            ("sun.csv", SUN),
        ] {
            let text = if name == file { text.as_str() } else { text_of };
            std::fs::write(folder.path().join(name), text).unwrap();
        }
        let output = command(folder.path(), &["--sun", &with_sun(&folder)]);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success(), "{file}: {said}");
        for word in wanted {
            assert!(said.contains(word), "{said} lacks {word}");
        }
        assert!(!folder.path().join("out/attitude.csv").exists(), "{said}");
    }
}

#[test]
fn a_flight_that_never_begins_has_empty_rows_and_says_so() {
    let (_, folder) = navigate(
        &[("vectors.csv", "t_s,camera,target,x,y,z,sigma_rad\n")],
        &[],
    );
    let output = command(folder.path(), &[]);
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("3 waiting"), "{said}");
    let rows = std::fs::read_to_string(folder.path().join("out/attitude.csv")).unwrap();
    assert_eq!(rows.lines().nth(1), Some("0.01,,,,,,,,,,,,,,,,,waiting"));
    assert!(folder.path().join("out/report.html").exists());
}
