//! Build a pipeline of your own from the stages: here a guider, for a camera that sees the Sun without fiducial marks. It
//! needs only the Sun's centre on the sensor, and stops after the limb.
//!
//! `cargo run --release --example own_pipeline`

use anyhow::anyhow;
use solaspect::aspect::{Pipeline, SolverSettings, Stopped};
use solaspect::frame::Frame;
use solaspect::instrument::{self, Instrument};
use solaspect::limb::Limb;
use solaspect::simulate::{Conditions, RandomScenes};
use solaspect::units::Rejected;

/// The limb of the Sun in a frame, without a search for marks.
///
/// # Errors
/// The first stage that rejects the frame, with its reason.
fn guide(frame: &Frame, instrument: &Instrument) -> anyhow::Result<Limb> {
    let rejected = |r: Rejected| anyhow!("{}: {} against {}", r.reason, r.measured, r.limit);
    let settings = SolverSettings::default();
    let stages = Pipeline::new(&settings, instrument, None);
    let stopped = |stopped: Stopped| anyhow!("{stopped}");
    let levels = stages.levels(frame).map_err(stopped)?; // background and disc
    let disc = stages.find_disc(frame, &levels, None).map_err(stopped)?; // to a pixel, by chords
    let image = stages.image(frame, &levels, &disc).map_err(stopped)?; // background subtracted, hot pixels masked
    let mask = &image.cutout.mask;
    stages.limb(&image, mask).map_err(rejected) // to a hundredth of a pixel, from the whole limb
}

fn main() -> anyhow::Result<()> {
    let instrument = instrument::builtin("demo")?;
    let without_marks = Conditions {
        mark_contrast: 0.0,
        ..Conditions::of(&instrument)
    };
    let scenes = RandomScenes::new(&instrument, &without_marks, 1)?;
    for number in 0..4 {
        let picture = scenes.scene(number)?.picture()?;
        let outline = guide(&picture.frame, &instrument)?.outline;
        let centre = outline.ellipse.centre;
        let sigma_px = outline.centre_covariance().trace().sqrt();
        println!(
            "centre {:.3}, {:.3} px, 1 sigma {sigma_px:.3} px, {} limb points",
            centre.x,
            centre.y,
            outline
                .accepted
                .iter()
                .filter(|accepted| **accepted)
                .count()
        );
        if let Some(sun) = picture.truth.sun {
            let error_px = (centre.x - sun.px.x).hypot(centre.y - sun.px.y);
            println!("  error {error_px:.3} px");
        }
    }
    Ok(())
}
