//! Tables as written by flights, people and interrupted by power cuts.

use super::*;
use crate::instrument::DEMO_NAVIGATION;
use crate::navigation::ImuSample;
use std::fs;

fn settings() -> NavigationSettings {
    NavigationSettings::parse(Path::new("NAV.toml"), DEMO_NAVIGATION).unwrap()
}

/// Writes IMU logs with these times, one file each, and reads them: for each run the first and last time, and the number of
/// samples.
fn imu(files: &[&[f64]]) -> Vec<(f64, f64, usize)> {
    let folder = tempfile::tempdir().unwrap();
    let write = |(n, times): (usize, &&[f64])| {
        let row = |t_s: &f64| format!("{t_s:.6},0,0,-9.8,0,0,0\n");
        let rows: String = times.iter().map(row).collect();
        let path = folder.path().join(format!("imu_{n}.csv"));
        fs::write(&path, IMU.join(",") + "\n" + &rows).unwrap();
        path
    };
    let paths: Vec<PathBuf> = files.iter().enumerate().map(write).collect();
    let runs = read_imu(&paths, &settings()).unwrap();
    let whole = |run: &Vec<ImuSample>| {
        assert!(run.is_sorted_by(|a, b| a.t_s < b.t_s));
        let micros = |sample: &ImuSample| (sample.t_s * 1e6).round() / 1e6;
        (micros(&run[0]), micros(&run[run.len() - 1]), run.len())
    };
    runs.iter().map(whole).collect()
}

/// Times at 100 Hz, given in hundredths of a second, the last one excluded.
fn times(hundredths: std::ops::Range<u32>) -> Vec<f64> {
    hundredths.map(|n| f64::from(n) / 100.0).collect()
}

#[test]
fn a_gap_begins_a_run_and_lost_samples_do_not() {
    let flight = [times(0..500), times(505..900), times(1100..1500)].concat();
    assert_eq!(imu(&[&flight]), [(0.0, 8.99, 895), (11.0, 14.99, 400)]);
    // A gap of more than 0.1 s ends a run.
    let flight = [times(0..500), times(520..900)].concat();
    assert_eq!(imu(&[&flight]), [(0.0, 4.99, 500), (5.2, 8.99, 380)]);
}

#[test]
fn rows_that_are_doubled_or_early_cost_themselves_alone() {
    let mut flight = times(0..1000);
    flight.insert(300, 2.99);
    flight.insert(600, 5.5);
    flight.swap(800, 801);
    assert_eq!(imu(&[&flight]), [(0.0, 9.99, 999)]);
    // A file that was appended to itself.
    assert_eq!(imu(&[&times(0..500).repeat(2)]), [(0.0, 4.99, 500)]);
}

#[test]
fn a_clock_of_another_time_for_a_sample_or_a_while_costs_no_other_rows() {
    for other in [-86_400.0, 86_400.0, 1e9] {
        for until in [401, 600] {
            let mut flight = times(0..1000);
            flight[400..until].iter_mut().for_each(|t_s| *t_s += other);
            let runs = imu(&[&flight]);
            let near = runs.iter().filter(|run| (0.0..20.0).contains(&run.0));
            let lost = until - 400;
            match lost {
                1 => assert_eq!(runs, [(0.0, 9.99, 999)]),
                _ => assert_eq!(near.map(|run| run.2).sum::<usize>(), 1000 - lost),
            }
        }
        let mut flight = times(0..1000);
        flight[0] += other;
        assert_eq!(imu(&[&flight]), [(0.01, 9.99, 999)]);
    }
}

#[test]
fn of_two_parts_that_cover_the_same_time_the_longer_one_is_kept() {
    // The clock is set back by one minute after two minutes, and by five minutes after ten.
    let back = [times(0..12_000), times(6_000..72_000)].concat();
    assert_eq!(imu(&[&back]), [(0.0, 59.99, 6_000), (60.0, 719.99, 66_000)]);
    let back = [times(30_000..90_000), times(60_000..61_000)].concat();
    assert_eq!(imu(&[&back]), [(300.0, 899.99, 60_000)]);
}

#[test]
fn files_of_a_flight_are_joined_in_the_order_of_time() {
    let [first, second] = [times(0..500), times(500..900)];
    assert_eq!(imu(&[&second, &first]), [(0.0, 8.99, 900)]);
    let late = times(490..900);
    assert_eq!(imu(&[&late, &first]), [(0.0, 4.99, 500), (5.0, 8.99, 400)]);
    // The same log from both disks of a flight.
    assert_eq!(imu(&[&first, &first]), [(0.0, 4.99, 500)]);
    // A log without rows after a power cut.
    assert_eq!(imu(&[&[], &first]), [(0.0, 4.99, 500)]);
}

#[test]
fn fixes_are_in_the_order_of_time_and_one_may_have_no_velocity() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("gps.csv");
    let heading = GPS.join(",") + ",climb\n";
    let row = |t_s: f64| format!("{t_s},-1300000,-5100000,3600000,,,,unknown\n");
    // Late fixes, an hour without any, a fix of another year, and fixes at long intervals.
    let times = [
        1.0, 2.0, 4.0, 3.0, 5.0, 3605.0, 3606.0, 9e8, 3607.0, 3700.0, 3800.0,
    ];
    let rows: String = times.into_iter().map(row).collect();
    fs::write(
        &path,
        heading + &rows + "3900,-1300000,-5100000,3600000,1,2,3,measured\n",
    )
    .unwrap();
    let fixes = read_gps(std::slice::from_ref(&path), &settings()).unwrap();
    let found: Vec<f64> = fixes.iter().map(|fix| fix.t_s).collect();
    let wanted = [
        1.0, 2.0, 3.0, 4.0, 5.0, 3605.0, 3606.0, 3607.0, 3700.0, 3800.0, 3900.0,
    ];
    assert_eq!(found, wanted);
    assert_eq!(fixes[0].velocity_m_s, None);
    assert_eq!(fixes[10].velocity_m_s, Some(Vector3::new(1.0, 2.0, 3.0)));
}

#[test]
fn what_the_flight_writes_is_read_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("gps.csv");
    let at = Vector3::new(-1_298_000.125, -5_105_000.5, 3_619_000.75);
    for velocity_m_s in [Some(Vector3::new(1.5, -2.25, 0.125)), None] {
        let cells = |vector: Vector3<f64>| vector.iter().map(f64::to_string).collect::<Vec<_>>();
        let velocity = velocity_m_s.map_or(vec![String::new(); 3], cells);
        let row = [vec!["7.5".into()], cells(at), velocity].concat().join(",");
        fs::write(&path, format!("{},climb\n{row},unknown\n", GPS.join(","))).unwrap();
        let fixes = read_gps(std::slice::from_ref(&path), &settings()).unwrap();
        let fix = Fix {
            t_s: 7.5,
            position_m: at,
            velocity_m_s,
            climb: Climb::Unknown,
        };
        assert_eq!(fixes, [fix]);
    }
}
