//! `solaspect simulate --navigation`: a flight of an inertial navigation system.

use super::{SimulateArgs, Within};
use crate::cli::output::make_folder;
use crate::simulate::navigation::{FlightPlan, Vehicle};
use anyhow::ensure;
use clap::{Args, ValueEnum};

#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Navigation")]
pub struct NavigationArgs {
    /// No frames but a flight of an inertial measurement unit, GPS and cameras that give directions: imu.csv, gps.csv, vectors.csv, sun.csv,
    /// truth.csv and NAV.toml
    #[arg(long, value_enum, value_name = "VEHICLE", conflicts_with_all = NOT_OF_A_FLIGHT)]
    pub navigation: Option<Flies>,
    /// How long the flight lasts [default: 370 for the rocket, which is its longest; 1200 for the balloon]
    #[arg(long, value_name = "T", requires = "navigation", value_parser = Within(1.0, 21_600.0, "s"))]
    duration_s: Option<f64>,
    /// By how much each camera is turned from where NAV.toml says, about each axis, 1 sigma [default: 0.5 on the rocket, on the
    /// balloon 0.3 for "roll"]; a camera that is aligned by definition stays so
    #[arg(long, value_name = "DEG", requires = "navigation", value_parser = Within(0.0, 5.0, "deg"))]
    camera_misalignment_deg: Option<f64>,
}

/// Options of other scenes, and options that only apply to frames.
const NOT_OF_A_FLIGHT: [&str; 10] = [
    "horizon",
    "moon",
    "drift",
    "partial",
    "no_sun",
    "smear",
    "frames",
    "rate",
    "utc",
    "instrument",
];

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Flies {
    /// The coast of a sounding rocket to 238 km, T+60 s to T+430 s
    Rocket,
    /// A telescope under a balloon at 38 km that follows the Sun
    Balloon,
}

/// Draws the flight and writes its files.
pub(super) fn run(args: &SimulateArgs, flies: Flies) -> anyhow::Result<()> {
    let plan = plan(&args.navigation, flies)?;
    make_folder(&args.out)?;
    plan.fly(args.seed).write(&args.out)?;
    Ok(())
}

fn plan(args: &NavigationArgs, flies: Flies) -> anyhow::Result<FlightPlan> {
    let mut plan = match flies {
        Flies::Rocket => FlightPlan::rocket(),
        Flies::Balloon => FlightPlan::balloon(),
    };
    plan.duration_s = args.duration_s.unwrap_or(plan.duration_s);
    let longest_s = plan.vehicle.longest_s();
    ensure!(
        plan.duration_s <= longest_s,
        "--duration-s: expected at most {longest_s} s for {}, found {}",
        match plan.vehicle {
            Vehicle::Rocket => "the rocket",
            Vehicle::Balloon => "the balloon",
        },
        plan.duration_s
    );
    let stated = args.camera_misalignment_deg;
    for camera in &mut plan.cameras {
        // Zero remains zero: such a camera defines the body's axes.
        if camera.misalignment_sigma_deg > 0.0 {
            camera.misalignment_sigma_deg = stated.unwrap_or(camera.misalignment_sigma_deg);
        }
    }
    Ok(plan)
}

#[cfg(test)]
mod tests {
    use super::super::tests::parse;
    use std::fs;

    #[test]
    fn a_flight_is_written_as_six_files_whose_rows_follow_the_duration() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("new");
        let mut args = parse("--out a --navigation balloon --duration-s 3.5 --seed 7").unwrap();
        args.out.clone_from(&out);
        super::super::run(&args).unwrap();
        for (name, header, rows) in [
            (
                "imu.csv",
                "t_s,fx_m_s2,fy_m_s2,fz_m_s2,wx_rad_s,wy_rad_s,wz_rad_s",
                350,
            ),
            ("gps.csv", "t_s,x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s", 4),
            ("vectors.csv", "t_s,camera,target,x,y,z,sigma_rad", 28),
            ("sun.csv", "t_s,x,y,z", 9),
            (
                "truth.csv",
                "t_s,q0,q1,q2,q3,x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s",
                350,
            ),
        ] {
            let text = fs::read_to_string(out.join(name)).unwrap();
            assert_eq!(text.lines().next(), Some(header));
            assert_eq!(text.lines().count(), 1 + rows, "{name}");
        }
        let vectors = fs::read_to_string(out.join("vectors.csv")).unwrap();
        assert!(
            vectors
                .lines()
                .nth(1)
                .unwrap()
                .starts_with("0.25,pyas,sun,")
        );
        assert!(out.join("NAV.toml").exists());
    }

    #[test]
    fn what_does_not_fit_a_flight_is_refused() {
        for (options, wanted) in [
            ("--navigation rocket --moon", "--moon"),
            ("--navigation rocket --frames 3", "--frames"),
            ("--duration-s 20", "required arguments"),
            ("--navigation balloon --duration-s 0", "from 1 to 21600 s"),
        ] {
            let message = parse(&format!("--out a {options}")).unwrap_err();
            assert!(message.contains(wanted), "{options}: {message}");
        }
        let args = parse("--out a --navigation rocket --duration-s 371").unwrap();
        let refused = super::super::run(&args).unwrap_err().to_string();
        assert!(refused.contains("at most 370 s"), "{refused}");
    }

    #[test]
    fn the_misalignment_reaches_the_cameras_that_have_one() {
        let args = parse("--out a --navigation balloon --camera-misalignment-deg 0.05").unwrap();
        let plan = super::plan(&args.navigation, super::Flies::Balloon).unwrap();
        let sigmas_deg = plan.cameras.iter().map(|c| c.misalignment_sigma_deg);
        assert_eq!(sigmas_deg.collect::<Vec<_>>(), [0.0, 0.05]);
    }
}
