//! `solaspect calibrate`: calibration of the instrument.

mod camera;
mod compare;
mod edition;
mod horizon_camera;
mod mounting;
mod plate;
mod roll_camera;

use super::options::interrupted;
use super::output::Follower;
use clap::{Args, Subcommand};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Measure the instrument from frames and write its new TOML file; report what changed between two calibrations
#[derive(Debug, Args)]
pub struct CalibrateArgs {
    #[command(subcommand)]
    part: Part,
}

#[derive(Debug, Subcommand)]
enum Part {
    Camera(camera::CameraArgs),
    Compare(compare::CompareArgs),
    HorizonCamera(horizon_camera::HorizonCameraArgs),
    Mounting(mounting::MountingArgs),
    Plate(plate::PlateArgs),
}

impl CalibrateArgs {
    /// Calibrates, and prints the result. `cancelled` ends it at the next frame.
    ///
    /// # Errors
    /// If the frames give no calibration, or files cannot be read or written.
    pub fn run(self, cancelled: &Arc<AtomicBool>) -> anyhow::Result<ExitCode> {
        let follower = |command| Follower::new(command, cancelled);
        match self.part {
            Part::Camera(args) => camera::run(args, &follower("calibrate camera")),
            Part::Compare(args) => compare::run(&args),
            Part::HorizonCamera(args) => {
                horizon_camera::run(&args, &follower("calibrate horizon-camera"))
            }
            Part::Mounting(args) => {
                let follower = follower("calibrate mounting");
                match &args.roll_camera {
                    Some(camera) => roll_camera::run(&args, camera, &follower),
                    None => mounting::run(args, &follower),
                }
            }
            Part::Plate(args) => plate::run(&args, &follower("calibrate plate")),
        }
    }
}

pub fn run(args: CalibrateArgs) -> anyhow::Result<ExitCode> {
    args.run(&interrupted()?)
}
