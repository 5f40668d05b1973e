//! Compares the truth with an independent integrator, and the errors with the plans.

use super::*;
use crate::simulate::navigation::imu::true_means;
use crate::simulate::navigation::motion::Motion;
use crate::units::ARCSEC_PER_RAD;
use nalgebra::Quaternion;

const VEHICLES: [Vehicle; 2] = [Vehicle::Rocket, Vehicle::Balloon];

fn plan(vehicle: Vehicle) -> FlightPlan {
    match vehicle {
        Vehicle::Rocket => FlightPlan::rocket(),
        Vehicle::Balloon => FlightPlan::balloon(),
    }
}

/// RMS of many numbers whose mean is 0.
fn rms(values: impl IntoIterator<Item = f64>) -> f64 {
    let (mut count, mut sum) = (0.0, 0.0);
    for value in values {
        count += 1.0;
        sum += value * value;
    }
    f64::sqrt(sum / count)
}

fn assert_near(found: f64, stated: f64, relative: f64, what: &str) {
    assert!(
        (found / stated - 1.0).abs() < relative,
        "{what}: {found:e} instead of {stated:e}"
    );
}

mod strapdown {
    //! Strapdown navigation from the IMU's measurements, independent of the motion's formulas.

    use super::*;

    const EARTH_RATE_RAD_S: f64 = 7.292_115e-5;
    const STEPS: usize = 4;

    #[derive(Debug, Clone, Copy)]
    pub struct Pose {
        pub attitude: Quaternion<f64>,
        pub position_m: Vector3<f64>,
        pub velocity_m_s: Vector3<f64>,
    }

    /// Gravitational potential from the zonal harmonics of WGS 84 (NIMA TR8350.2): its derivatives are computed numerically.
    fn potential(at: &Vector3<f64>) -> f64 {
        const HARMONICS: [f64; 3] = [1.082_629_821_3e-3, -2.370_911_2e-6, 6.083_46e-9];
        let (mass, radius) = (3.986_004_418e14, 6_378_137.0);
        let distance = at.norm();
        let s2 = (at.z / distance).powi(2);
        let legendre = [
            (3.0 * s2 - 1.0) / 2.0,
            (35.0 * s2.powi(2) - 30.0 * s2 + 3.0) / 8.0,
            (231.0 * s2.powi(3) - 315.0 * s2.powi(2) + 105.0 * s2 - 5.0) / 16.0,
        ];
        let terms = HARMONICS.iter().zip(legendre).zip(1..);
        let flattened = terms.map(|((j, p), n)| j * p * (radius / distance).powi(2 * n));
        mass / distance * (1.0 - flattened.sum::<f64>())
    }

    fn gravitation(at: &Vector3<f64>) -> Vector3<f64> {
        let step_m = 3000.0;
        Vector3::from_fn(|axis, _| {
            let mut moved = Vector3::zeros();
            moved[axis] = step_m;
            let difference =
                |steps: f64| potential(&(at + moved * steps)) - potential(&(at - moved * steps));
            (8.0 * difference(1.0) - difference(2.0)) / (12.0 * step_m)
        })
    }

    impl Pose {
        fn derivative(&self, force: &Vector3<f64>, rate: &Vector3<f64>) -> Pose {
            let earth = Vector3::new(0.0, 0.0, EARTH_RATE_RAD_S);
            let pure = |vector: Vector3<f64>| Quaternion::from_imag(vector);
            let q = self.attitude;
            let turned = (q * pure(*force) * q.conjugate()).imag();
            let carried = earth.cross(&(2.0 * self.velocity_m_s + earth.cross(&self.position_m)));
            Pose {
                attitude: (q * pure(*rate) - pure(earth) * q) * 0.5,
                position_m: self.velocity_m_s,
                velocity_m_s: turned + gravitation(&self.position_m) - carried,
            }
        }

        fn plus(&self, change: &Pose, dt_s: f64) -> Pose {
            Pose {
                attitude: self.attitude + change.attitude * dt_s,
                position_m: self.position_m + change.position_m * dt_s,
                velocity_m_s: self.velocity_m_s + change.velocity_m_s * dt_s,
            }
        }

        /// Fourth-order Runge-Kutta step; force and rate are functions of time within the step.
        fn stepped(&self, dt_s: f64, felt: impl Fn(f64) -> (Vector3<f64>, Vector3<f64>)) -> Pose {
            let slope = |pose: &Pose, at_s| {
                let (force, rate) = felt(at_s);
                pose.derivative(&force, &rate)
            };
            let first = slope(self, 0.0);
            let second = slope(&self.plus(&first, dt_s / 2.0), dt_s / 2.0);
            let third = slope(&self.plus(&second, dt_s / 2.0), dt_s / 2.0);
            let fourth = slope(&self.plus(&third, dt_s), dt_s);
            [(first, 1.0), (second, 2.0), (third, 2.0), (fourth, 1.0)]
                .iter()
                .fold(*self, |sum, (slope, weight)| {
                    sum.plus(slope, weight * dt_s / 6.0)
                })
        }
    }

    /// Integrates all rows except the first and the last: within an interval force and rate are linear through the means of the neighbours.
    pub fn flown(mut pose: Pose, rows: &[ImuRow]) -> Pose {
        for three in rows.windows(3) {
            let dt_s = three[1].t_s - three[0].t_s;
            let along =
                |before: Vector3<f64>, mean: Vector3<f64>, after: Vector3<f64>, at_s: f64| {
                    mean + (after - before) * ((at_s / dt_s - 0.5) / 2.0)
                };
            let felt = |at_s| {
                let [a, b, c] = [three[0], three[1], three[2]];
                (
                    along(
                        a.specific_force_m_s2,
                        b.specific_force_m_s2,
                        c.specific_force_m_s2,
                        at_s,
                    ),
                    along(a.rate_rad_s, b.rate_rad_s, c.rate_rad_s, at_s),
                )
            };
            let step_s = dt_s / STEPS as f64;
            for step in 0..STEPS {
                let start_s = step as f64 * step_s;
                pose = pose.stepped(step_s, |at_s| felt(start_s + at_s));
            }
        }
        pose
    }
}

/// The IMU's rows without errors over a number of seconds from a time on, with the truth.
fn perfect(motion: &dyn Motion, start_s: u64, seconds: u64) -> Vec<(ImuRow, strapdown::Pose)> {
    let ticks = start_s * 100 + 1..=(start_s + seconds) * 100;
    let row = |tick| {
        let t_s = tick as f64 / 100.0;
        let state = motion.at(t_s);
        let pose = strapdown::Pose {
            attitude: state.attitude.rotation.into_inner(),
            position_m: state.path.position_m,
            velocity_m_s: state.path.velocity_m_s,
        };
        (true_means(motion, t_s), pose)
    };
    ticks.map(row).collect()
}

#[test]
fn integrating_the_perfect_rows_leads_along_the_truth() {
    for (vehicle, start_s) in [
        (Vehicle::Rocket, 60),
        (Vehicle::Rocket, 370),
        (Vehicle::Balloon, 0),
        (Vehicle::Balloon, 10_000),
    ] {
        let flight = perfect(&*vehicle.motion(3), start_s, 60);
        let rows: Vec<ImuRow> = flight.iter().map(|(row, _)| *row).collect();
        let found = strapdown::flown(flight[0].1, &rows);
        let truth = flight[flight.len() - 2].1;
        let turn = truth.attitude.conjugate() * found.attitude;
        let turn_rad = 2.0 * turn.imag().norm();
        let apart_m = (found.position_m - truth.position_m).norm();
        let apart_m_s = (found.velocity_m_s - truth.velocity_m_s).norm();
        println!(
            "{vehicle:?} from {start_s} s: {turn_rad:e} rad, {apart_m:e} m, {apart_m_s:e} m/s"
        );
        assert!(turn_rad < 1e-9 && apart_m < 1e-3 && apart_m_s < 1e-4);
    }
}

#[test]
fn the_rocket_coasts_as_the_paper_says() {
    for seed in 0..5 {
        let motion = Vehicle::Rocket.motion(seed);
        let height_m = |t_s: f64| {
            let position_m = motion.at(t_s).path.position_m;
            // The ellipsoid at its latitude, to some tens of metres.
            let sine = position_m.z / position_m.norm();
            position_m.norm() - 6_378_137.0 * (1.0 - sine * sine / 298.257)
        };
        assert!(
            (height_m(250.0) - 238_000.0).abs() < 100.0,
            "{}",
            height_m(250.0)
        );
        assert!((60_000.0..80_000.0).contains(&height_m(60.0)));
        assert!((60_000.0..100_000.0).contains(&height_m(430.0)));
        for t_s in (60..=430).map(f64::from) {
            let state = motion.at(t_s);
            let rate_deg_s = state.inertial_rate_rad_s().amax().to_degrees();
            assert!(rate_deg_s < 0.9, "{rate_deg_s} deg/s");
            assert!(state.specific_force_m_s2().norm() < 0.004);
        }
    }
}

#[test]
fn the_balloon_hangs_at_its_height_and_points_at_the_sun() {
    let sun = FlightPlan::balloon().sky().sun;
    for (seed, t_s) in [(1, 0.0), (2, 700.0), (3, 21_600.0)] {
        let state = Vehicle::Balloon.motion(seed).at(t_s);
        let up = state.path.position_m.normalize();
        let force = state.attitude.rotation * state.specific_force_m_s2();
        assert!((force.norm() - 9.68).abs() < 0.02, "{}", force.norm());
        let tilt_deg = force.angle(&up).to_degrees();
        // Angle between geodetic and geocentric nadir.
        assert!((tilt_deg - 0.18).abs() < 0.05, "{tilt_deg}");
        let axis = state.attitude.rotation * Vector3::x();
        let off_deg = axis.angle(&sun.direction(t_s)).to_degrees();
        assert!(off_deg < 1.3, "{off_deg}");
        let speed = state.path.velocity_m_s.norm();
        assert!((speed - 10.0).abs() < 0.3, "{speed}");
    }
    let start = earth::ecef_from_north_east_down(&crate::units::Place {
        latitude_deg: 34.49,
        longitude_deg: -104.22,
        height_m: 0.0,
    });
    let elevation_deg = (-(start.inverse() * sun.direction(0.0)).z)
        .asin()
        .to_degrees();
    assert!((elevation_deg - 54.0).abs() < 1e-9);
    let moved = sun.direction(0.0).angle(&sun.direction(1.0)) * ARCSEC_PER_RAD;
    assert!((moved - 15.04).abs() < 0.01, "{moved}");
}

#[test]
fn the_same_seed_gives_the_same_flight_and_another_one_another() {
    for vehicle in VEHICLES {
        let plan = FlightPlan {
            duration_s: 2.0,
            ..plan(vehicle)
        };
        assert_eq!(plan.fly(4), plan.fly(4));
        assert_ne!(plan.fly(4).truth, plan.fly(5).truth);
        // Errors belong to their instruments: without the IMU's, all others are the same.
        let quiet = FlightPlan {
            imu: ImuErrors::default(),
            ..plan.clone()
        };
        let (with, without) = (plan.fly(4), quiet.fly(4));
        assert_ne!(with.imu, without.imu);
        assert_eq!(
            (with.gps, with.vectors, with.truth),
            (without.gps, without.vectors, without.truth)
        );
    }
}

#[test]
fn the_files_are_the_same_bytes_and_hold_every_digit() {
    let plan = FlightPlan {
        duration_s: 1.0,
        ..FlightPlan::balloon()
    };
    let flight = plan.fly(9);
    let [one, two] = [(), ()].map(|()| tempfile::tempdir().unwrap());
    flight.write(one.path()).unwrap();
    plan.fly(9).write(two.path()).unwrap();
    for name in [
        "imu.csv",
        "gps.csv",
        "vectors.csv",
        "sun.csv",
        "truth.csv",
        "NAV.toml",
    ] {
        let [a, b] = [&one, &two].map(|folder| std::fs::read(folder.path().join(name)).unwrap());
        assert_eq!(a, b, "{name}");
    }
    let text = std::fs::read_to_string(one.path().join("imu.csv")).unwrap();
    for (line, row) in text.lines().skip(1).zip(&flight.imu) {
        let read: Vec<f64> = line.split(',').map(|v| v.parse().unwrap()).collect();
        assert_eq!(read[0], row.t_s);
        assert_eq!(&read[1..4], row.specific_force_m_s2.as_slice());
        assert_eq!(&read[4..7], row.rate_rad_s.as_slice());
    }
}

#[test]
fn times_are_those_of_the_grid_and_the_sun_reaches_beyond_both_ends() {
    let plan = FlightPlan {
        duration_s: 0.29,
        ..FlightPlan::rocket()
    };
    let flight = plan.fly(1);
    let times: Vec<f64> = flight.imu.iter().map(|row| row.t_s).collect();
    assert_eq!(times.len(), 29);
    assert_eq!(times[0], 60.01);
    assert_eq!(times[28], 60.29);
    assert!(flight.truth.iter().map(|row| row.t_s).eq(times));
    assert!(flight.truth.iter().all(|row| row.ecef_from_body.w >= 0.0));
    assert_eq!(flight.gps[0].t_s, 60.0);
    let sun: Vec<f64> = flight.sun.iter().map(|row| row.t_s).collect();
    assert_eq!(sun, [58.0, 59.0, 60.0, 61.0, 62.0, 63.0]);
}

/// Over the seeds: rms of one axis' mean error and of the errors' scatter about it, for the rows' forces and rates.
fn imu_errors(errors: &ImuErrors, truth: ImuRow, rows: usize) -> [(f64, f64); 2] {
    let mut means = [Vec::new(), Vec::new()];
    let mut scatter = [Vec::new(), Vec::new()];
    for seed in 0..400 {
        let mut imu = imu::Imu::drawn(errors, seed);
        let taken: Vec<ImuRow> = (0..rows).map(|_| imu.measured(&truth)).collect();
        for axis in 0..3 {
            let force = |row: &ImuRow| (row.specific_force_m_s2 - truth.specific_force_m_s2)[axis];
            let rate = |row: &ImuRow| (row.rate_rad_s - truth.rate_rad_s)[axis];
            for (kind, of) in [&force as &dyn Fn(&ImuRow) -> f64, &rate]
                .into_iter()
                .enumerate()
            {
                let mean = taken.iter().map(of).sum::<f64>() / rows as f64;
                means[kind].push(mean);
                scatter[kind].push(rms(taken.iter().map(|row| of(row) - mean)));
            }
        }
    }
    [0, 1].map(|kind| (rms(means[kind].clone()), rms(scatter[kind].clone())))
}

#[test]
fn the_errors_of_the_imu_are_as_large_as_stated() {
    let still = ImuRow {
        t_s: 1.0,
        specific_force_m_s2: Vector3::zeros(),
        rate_rad_s: Vector3::zeros(),
    };
    for errors in [ImuErrors::rocket(), ImuErrors::balloon()] {
        let [force, rate] = imu_errors(&errors, still, 100);
        // The mean of 100 rows is that of one second: the white noise adds its random walk.
        let bias = errors
            .accelerometer_bias_sigma_m_s2
            .hypot(errors.velocity_random_walk);
        assert_near(force.0, bias, 0.06, "bias of force");
        assert_near(
            force.1,
            10.0 * errors.velocity_random_walk,
            0.02,
            "white force",
        );
        let bias = errors
            .gyro_bias_sigma_rad_s
            .hypot(errors.angular_random_walk);
        assert_near(rate.0, bias, 0.06, "bias of rate");
        assert_near(
            rate.1,
            10.0 * errors.angular_random_walk,
            0.02,
            "white rate",
        );
    }
    let turned_and_scaled = ImuErrors {
        misalignment_sigma_rad: 2e-3,
        accelerometer_scale_sigma_ppm: 300.0,
        gyro_scale_sigma_ppm: 2000.0,
        ..ImuErrors::default()
    };
    // Equal components: two misalignments and a scale factor affect every axis.
    let moving = ImuRow {
        specific_force_m_s2: Vector3::repeat(10.0),
        rate_rad_s: Vector3::repeat(0.1),
        ..still
    };
    let [force, rate] = imu_errors(&turned_and_scaled, moving, 1);
    assert_near(
        force.0,
        10.0 * f64::hypot(2e-3 * 2_f64.sqrt(), 300e-6),
        0.06,
        "force",
    );
    assert_near(
        rate.0,
        0.1 * f64::hypot(2e-3 * 2_f64.sqrt(), 2e-3),
        0.06,
        "rate",
    );
}

#[test]
fn the_errors_of_gps_are_as_large_as_stated() {
    let plan = FlightPlan {
        duration_s: 5.0,
        ..FlightPlan::balloon()
    };
    let mut position_m = Vec::new();
    let mut velocity_m_s = Vec::new();
    for seed in 0..100 {
        let flight = plan.fly(seed);
        for (gps, second) in flight.gps[1..].iter().zip(1..) {
            let truth = &flight.truth[second * 100 - 1];
            assert_eq!(gps.t_s, truth.t_s);
            position_m.extend((gps.position_m - truth.position_m).iter().copied());
            velocity_m_s.extend((gps.velocity_m_s - truth.velocity_m_s).iter().copied());
        }
    }
    assert_near(rms(position_m), 5.0, 0.06, "position");
    assert_near(rms(velocity_m_s), 0.05, 0.06, "velocity");
}

/// The errors of one camera's directions to one target, in the camera's axes, rad, with their times.
fn errors_of(
    plan: &FlightPlan,
    seed: u64,
    camera: usize,
    target: Target,
) -> Vec<(f64, Vector3<f64>)> {
    let motion = plan.vehicle.motion(seed);
    let (sky, camera) = (plan.sky(), &plan.cameras[camera]);
    let rows = cameras::measured(&plan.cameras, &plan.span(), &sky, &*motion, seed);
    let ours = rows
        .iter()
        .filter(|row| row.camera == camera.name && row.target == target);
    ours.map(|row| {
        let state = motion.at(row.t_s);
        let direction = match target {
            Target::Sun => sky.sun.direction(row.t_s),
            Target::Nadir => -state.path.position_m.normalize(),
        };
        let body = state.attitude.rotation.inverse() * direction;
        let seen = camera.body_from_camera.transpose() * body;
        (row.t_s, row.direction - seen)
    })
    .collect()
}

#[test]
fn the_errors_of_directions_are_as_large_and_as_long_as_stated() {
    let mut plan = FlightPlan::rocket();
    for camera in &mut plan.cameras {
        camera.misalignment_sigma_deg = 0.0;
    }
    for (camera, target, errors) in [(0, Target::Sun, plan.sun), (1, Target::Nadir, plan.nadir)] {
        let (mut all, mut together, mut neighbours) = (Vec::new(), Vec::new(), Vec::new());
        for seed in 0..150 {
            let rows = errors_of(&plan, seed, camera, target);
            assert_eq!(rows.len(), 130);
            assert_eq!((rows[0].0, rows[129].0), (171.0, 300.0));
            // Two angles across: the sum of squares is that of both.
            all.extend(rows.iter().map(|(_, error)| error.norm_squared() / 2.0));
            together.extend(rows.windows(21).map(|w| w[0].1.dot(&w[20].1) / 2.0));
            neighbours.extend(
                rows.windows(2)
                    .map(|w| (w[1].1 - w[0].1).norm_squared() / 2.0),
            );
        }
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        let correlated = errors.correlated_sigma_deg.to_radians().powi(2);
        let white = errors.white_sigma_deg.to_radians().powi(2);
        assert_near(mean(&all), errors.sigma_rad().powi(2), 0.08, "variance");
        let step = 2.0 * (white + correlated * (1.0 - f64::exp(-1.0 / 20.0)));
        assert_near(mean(&neighbours), step, 0.05, "change in a second");
        // The rotation of the direction in the camera reduces the correlation.
        assert_near(
            mean(&together),
            correlated * f64::exp(-1.0),
            0.2,
            "covariance over 20 s",
        );
    }
}

#[test]
fn cameras_are_turned_by_as_much_as_stated() {
    let mut plan = FlightPlan::rocket();
    plan.sun = DirectionErrors::default();
    plan.nadir = DirectionErrors::default();
    plan.duration_s = 112.0;
    let turns = (0..400).flat_map(|seed| {
        let [sun, nadir] = [Target::Sun, Target::Nadir].map(|t| errors_of(&plan, seed, 1, t)[0].1);
        [sun.norm() / 2_f64.sqrt(), nadir.norm() / 2_f64.sqrt()]
    });
    assert_near(rms(turns), 0.5_f64.to_radians(), 0.06, "misalignment");
}

#[test]
fn the_sense_of_a_cameras_turn_is_the_stated_one() {
    let turn = Vector3::new(1e-3, -2e-3, 3e-3);
    let camera = Vector3::new(0.48, 0.6, 0.64);
    let body = camera + turn.cross(&camera);
    assert!((cameras::unturned(&body, &turn) - camera).norm() < 1e-15);
}

#[test]
fn the_balloons_sun_has_gaps_and_its_nadir_none() {
    let plan = FlightPlan {
        duration_s: 360.0,
        ..FlightPlan::balloon()
    };
    let sun = errors_of(&plan, 1, 0, Target::Sun);
    let hidden = |t_s: f64| t_s % 180.0 >= 120.0;
    assert!(sun.iter().all(|(t_s, _)| !hidden(*t_s)));
    // From 0.25 s to 119.75 s, 180 s to 299.75 s, and 360 s.
    assert_eq!(sun.len(), 479 + 480 + 1);
    let arcsec = sun
        .iter()
        .map(|(_, error)| error.norm() / 2_f64.sqrt() * ARCSEC_PER_RAD);
    assert_near(rms(arcsec), 0.11, 0.08, "Sun");
    assert_eq!(errors_of(&plan, 1, 1, Target::Nadir).len(), 1440);
}

#[test]
fn the_configuration_states_the_errors_that_were_drawn() {
    for vehicle in VEHICLES {
        let plan = plan(vehicle);
        let toml: toml::Table = config::config_toml(&plan).parse().unwrap();
        let number = |table: &str, key: &str| toml[table][key].as_float().unwrap();
        assert_eq!(
            number("imu", "velocity_random_walk"),
            plan.imu.velocity_random_walk
        );
        assert_eq!(
            number("imu", "gyro_bias_sigma"),
            plan.imu.gyro_bias_sigma_rad_s
        );
        assert_eq!(number("gps", "velocity_sigma_m_s"), 0.05);
        assert_eq!(
            number("nadir", "correlated_sigma_deg"),
            plan.nadir.correlated_sigma_deg
        );
        let cameras = toml["camera"].as_array().unwrap();
        assert_eq!(cameras.len(), 2);
        for (camera, stated) in plan.cameras.iter().zip(cameras) {
            assert_eq!(stated["name"].as_str(), Some(camera.name));
            let matrix = &camera.body_from_camera;
            assert_eq!(
                stated["body_from_camera"][1][2].as_float(),
                Some(matrix[(1, 2)])
            );
            assert!((matrix.transpose() * matrix - nalgebra::Matrix3::identity()).amax() < 1e-15);
            assert!((matrix.determinant() - 1.0).abs() < 1e-15);
        }
    }
}
