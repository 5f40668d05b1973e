//! Checks the illumination of frames: dark frames must be dark, flat frames evenly illuminated. Frames of the Sun are neither.

use super::dark::{Dark, dn};
use super::shots::{Shot, Shots, TILE_PX, inside, tiles};
use crate::calibrate::numbers::median;
use std::path::PathBuf;

/// Every n-th pixel of a square, in both axes, is used for its light.
const STRIDE_PX: usize = 3;
/// In an evenly illuminated frame all but the darkest tenth have at least this share of the brightest light: lenses leave more in the
/// corners, the Sun leaves nothing beside its disc.
const LEAST_SHARE: f64 = 0.25;
/// Differences below this multiple of the read noise are not significant.
const LEAST_NOISE: f64 = 5.0;
/// Greatest glow of a covered camera, as a share of saturation.
const MOST_GLOW: f64 = 0.05;

/// A frame with wrong illumination.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum WrongLight {
    #[error(
        "{}: expected a frame without light (--dark), found {light_dn:.0} DN more about column {column}, row {row} than in the darkest tenth of the frame; give frames of the Sun without --dark", .file.display()
    )]
    Lit {
        file: PathBuf,
        light_dn: f64,
        column: usize,
        row: usize,
    },
    #[error(
        "{}: expected an evenly lit frame (--flat), all but the darkest tenth with at least {:.0} % of the brightest light, found {brightest_dn:.0} DN about column {column}, row {row} and {darkest_dn:.0} DN in the darkest tenth; give frames of the Sun without --flat", .file.display(), 100.0 * LEAST_SHARE
    )]
    Uneven {
        file: PathBuf,
        brightest_dn: f64,
        darkest_dn: f64,
        column: usize,
        row: usize,
    },
}

/// The brightest square of a frame, its middle, and the upper limit of the darkest tenth of the squares, DN.
struct Extremes {
    brightest_dn: f64,
    column: usize,
    row: usize,
    darkest_dn: f64,
}

fn extremes(shot: &Shot) -> Option<Extremes> {
    let light = |corner| {
        let values = inside(corner, STRIDE_PX).map(|(x, y)| dn(shot, x, y));
        (median(values), corner)
    };
    let mut lights: Vec<(f64, (usize, usize))> = tiles(&shot.frame).map(light).collect();
    lights.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (brightest_dn, (x, y)) = *lights.last()?;
    Some(Extremes {
        brightest_dn,
        column: x + TILE_PX / 2,
        row: y + TILE_PX / 2,
        darkest_dn: lights[lights.len() / 10].0,
    })
}

/// Checks that dark frames are dark.
///
/// # Errors
/// The first frame with an illuminated part.
pub(super) fn check_dark(darks: &Shots) -> Result<(), WrongLight> {
    for shot in &darks.frames {
        let Some(found) = extremes(shot) else {
            continue;
        };
        let light_dn = found.brightest_dn - found.darkest_dn;
        if light_dn > MOST_GLOW * f64::from(shot.frame.saturation_dn()) {
            return Err(WrongLight::Lit {
                file: shot.file.clone(),
                light_dn,
                column: found.column,
                row: found.row,
            });
        }
    }
    Ok(())
}

/// Checks that flat frames are evenly illuminated.
///
/// # Errors
/// The first frame that is not.
pub(super) fn check_even(flats: &Shots, dark: &Dark) -> Result<(), WrongLight> {
    for shot in &flats.frames {
        let Some(found) = extremes(shot) else {
            continue;
        };
        let above = |seen_dn: f64| (seen_dn - dark.level_dn()).max(0.0);
        let (brightest_dn, darkest_dn) = (above(found.brightest_dn), above(found.darkest_dn));
        let differs = brightest_dn - darkest_dn > LEAST_NOISE * dark.noise_dn();
        if differs && darkest_dn < LEAST_SHARE * brightest_dn {
            return Err(WrongLight::Uneven {
                file: shot.file.clone(),
                brightest_dn,
                darkest_dn,
                column: found.column,
                row: found.row,
            });
        }
    }
    Ok(())
}
