//! The gain that `calibrate camera` determines from evenly lit frames is unbiased, and its sigma is calibrated.

use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Poisson, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use rayon::prelude::*;
use solaspect::calibrate::camera::{Inputs, Shot, Shots, calibrate};
use solaspect::frame::{Frame, FrameInfo, Pixels};
use solaspect::instrument::builtin;
use std::time::Duration;

/// Side of a frame, px.
const SIDE: usize = 160;
const LEVEL_DN: f64 = 250.0;
const READ_DN: f64 = 8.0;
const GAIN_DN_PER_ELECTRON: f64 = 0.4;

/// A frame with Poisson-distributed photons.
fn shot(electrons: f64, rng: &mut Xoshiro256PlusPlus) -> Shot {
    let photons = (electrons > 0.0).then(|| Poisson::new(electrons).unwrap());
    let mut pixel = || {
        let electrons = photons.map_or(0.0, |photons| photons.sample(rng));
        let noise: f64 = rng.sample(StandardNormal);
        let dn = LEVEL_DN + GAIN_DN_PER_ELECTRON * electrons + READ_DN * noise;
        dn.round().clamp(0.0, 4095.0) as u16
    };
    let pixels = Pixels::U16((0..SIDE * SIDE).map(|_| pixel()).collect());
    let info = FrameInfo {
        exposure: Some(Duration::from_micros(10 + electrons as u64)),
        ..FrameInfo::default()
    };
    Shot {
        file: "simulated".into(),
        frame: Frame::new(SIDE, SIDE, pixels, 4095, info).unwrap(),
        disc: None,
        marks: Vec::new(),
    }
}

/// Normalised error of the gain from one set: four dark frames and two flat ones at each exposure.
fn normalised_error(exposures: &[f64], seed: u64) -> f64 {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut shots = |electrons: &[f64]| Shots {
        frames: electrons.iter().map(|e| shot(*e, &mut rng)).collect(),
    };
    let twice: Vec<f64> = exposures.iter().flat_map(|e| [*e; 2]).collect();
    let inputs = Inputs {
        dark: shots(&[0.0; 4]),
        flat: shots(&twice),
        ..Inputs::default()
    };
    let calibration = calibrate(&inputs, &builtin("demo").unwrap()).unwrap();
    let mut quantities = calibration.quantities.iter();
    let gain = quantities.find(|q| q.name == "gain").unwrap();
    assert!(gain.sigma < 0.03 * gain.found[0], "{gain:?}");
    (gain.found[0] - GAIN_DN_PER_ELECTRON) / gain.sigma
}

/// Mean and rms of the normalised errors over this many sets.
fn errors(exposures: &[f64], sets: u64) -> (f64, f64) {
    let all = (0..sets).into_par_iter();
    let all: Vec<f64> = all.map(|seed| normalised_error(exposures, seed)).collect();
    let mean = |of: fn(f64) -> f64| all.iter().map(|e| of(*e)).sum::<f64>() / sets as f64;
    (mean(|e| e), mean(|e| e * e).sqrt())
}

#[test]
fn the_gain_by_photon_transfer_is_unbiased() {
    const SETS: u64 = 300;
    let chance = 3.0 / (SETS as f64).sqrt();
    for exposures in [
        &[500.0, 2000.0, 4000.0, 8000.0][..],
        &[300.0, 900.0],
        &[3000.0, 7000.0],
    ] {
        let (mean, rms) = errors(exposures, SETS);
        println!("{exposures:?} electrons: mean {mean:+.3}, rms {rms:.3} sigma over {SETS} sets");
        assert!(mean.abs() < chance, "{exposures:?}: {mean} of {chance}");
        assert!((0.8..1.25).contains(&rms), "{exposures:?}: {rms}");
    }
}
