//! Solve one frame: the Sun's centre on the plate, and the pointing offset from the centre of the Sun.
//!
//! `cargo run --release --example solve_frame -- FRAME.fits`; without a file, a simulated frame is solved.

use anyhow::Context;
use solaspect::aspect::{self, Expected};
use solaspect::frame::Frame;
use solaspect::instrument::Instrument;
use solaspect::simulate::{Conditions, FORT_SUMNER, RandomScenes};
use solaspect::sky::Ephemeris;
use solaspect::{fits, instrument, pointing};
use std::path::Path;

/// The Sun somewhere on the plate, with the default conditions.
fn simulated(instrument: &Instrument) -> anyhow::Result<Frame> {
    let scenes = RandomScenes::new(instrument, &Conditions::of(instrument), 1)?;
    let mut scene = scenes.scene(0)?;
    scene.info.mid_exposure = Some("2013-09-21T18:00:00Z".parse()?);
    scene.info.place = Some(FORT_SUMNER);
    Ok(scene.frame()?)
}

fn main() -> anyhow::Result<()> {
    // `Instrument::read` reads a calibrated one from its TOML file.
    let instrument = instrument::builtin("demo")?;
    let frame = match std::env::args().nth(1) {
        Some(path) => fits::read_frame(Path::new(&path))?,
        None => simulated(&instrument)?,
    };
    instrument.check_size(&frame)?;

    let utc = frame.info.mid_exposure;
    let mut solution = aspect::solve(&frame, &instrument, utc.and_then(Expected::at), None);
    println!("quality: {}", solution.quality.name());
    if let Some(stopped) = solution.stopped {
        println!("reason: {stopped}");
    }
    let aspect = solution.aspect.context("no Sun in this frame")?;
    let (at, [sigma_x, sigma_y]) = (aspect.sun_plate.position, aspect.sun_plate.sigma());
    println!("Sun on the plate: {:.3}, {:.3} mil", at.x, at.y);
    println!("1 sigma: {sigma_x:.3}, {sigma_y:.3} mil");

    // The offset needs a time and a place; without them there is none.
    let offset = pointing::offset_of(
        &mut solution,
        utc,
        frame.info.place,
        &pointing::Target::default(),
        None,
        &instrument,
        &mut Ephemeris::default(),
    );
    if let Some(offset) = offset {
        println!(
            "offset: azimuth {:.4}, elevation {:.4} deg",
            offset.azimuth_deg, offset.elevation_deg
        );
    }
    Ok(())
}
