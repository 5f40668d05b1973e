//! Solve one frame: the Sun's centre on the plate, and the pointing offset from the centre of the Sun.
//!
//! `cargo run --release --example solve_frame -- FRAME.fits`; without a file, a simulated frame is solved.

use anyhow::Context;
use solaspect::aspect::{self, Expected};
use solaspect::simulate::{Conditions, FORT_SUMNER, RandomScenes};
use solaspect::sky::Ephemeris;
use solaspect::{fits, instrument, pointing};
use std::path::Path;

fn main() -> anyhow::Result<()> {
    // `Instrument::read` takes a calibrated one from its TOML file.
    let instrument = instrument::builtin("demo")?;
    let frame = match std::env::args().nth(1) {
        Some(path) => fits::read_frame(Path::new(&path))?,
        None => RandomScenes::new(&instrument, &Conditions::of(&instrument), 1)?
            .scene(0)?
            .frame()?,
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

    // The offset needs a time and a place; a frame without them has none.
    let place = frame.info.place.or(Some(FORT_SUMNER));
    let offset = pointing::offset_of(
        &mut solution,
        utc,
        place,
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
