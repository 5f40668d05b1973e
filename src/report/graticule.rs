//! The Sun's disc as lines about its centre: its limb, and circles of heliographic latitude and longitude.

use crate::pointing::{Feature, HelioprojectiveArcsec};
use crate::sky::Disc;
use jiff::Timestamp;

/// Spacing of the points of a line, deg.
const STEP_DEG: u32 = 2;

/// The limb, a closed line.
pub fn limb(disc: &Disc) -> Vec<HelioprojectiveArcsec> {
    let radius = disc.radius_arcsec();
    let at = |n: u32| {
        let (sin, cos) = f64::from(n * STEP_DEG).to_radians().sin_cos();
        HelioprojectiveArcsec {
            x: radius * cos,
            y: radius * sin,
        }
    };
    (0..=360 / STEP_DEG).map(at).collect()
}

/// The visible circles of latitude and meridians, every `spacing_deg`, from the equator and the central meridian.
pub fn graticule(disc: &Disc, spacing_deg: u32) -> Vec<Vec<HelioprojectiveArcsec>> {
    let circles = (spacing_deg..180)
        .step_by(spacing_deg as usize)
        .map(|from_pole_deg| {
            let latitude_deg = f64::from(from_pole_deg) - 90.0;
            let around = (0..=360 / STEP_DEG).map(|n| f64::from(n * STEP_DEG));
            visible(
                disc,
                around.map(|longitude_deg| (latitude_deg, longitude_deg)),
            )
        });
    let meridians = (0..360).step_by(spacing_deg as usize).map(|longitude_deg| {
        let up = (0..=180 / STEP_DEG).map(|n| f64::from(n * STEP_DEG) - 90.0);
        visible(
            disc,
            up.map(|latitude_deg| (latitude_deg, f64::from(longitude_deg))),
        )
    });
    circles.chain(meridians).flatten().collect()
}

/// The visible parts of a line on the sphere. Longitudes count from the meridian behind the Sun, so that a circle is one part.
fn visible(disc: &Disc, line: impl Iterator<Item = (f64, f64)>) -> Vec<Vec<HelioprojectiveArcsec>> {
    let epoch = Timestamp::UNIX_EPOCH;
    let places: Vec<Option<HelioprojectiveArcsec>> = line
        .map(|(latitude_deg, longitude_deg)| {
            let feature = Feature {
                latitude_deg,
                longitude_deg: disc.l0_deg + longitude_deg - 180.0,
                epoch,
            };
            feature.at(epoch, disc).ok()
        })
        .collect();
    let parts = places.split(Option::is_none);
    let parts = parts.map(|part| part.iter().flatten().copied().collect::<Vec<_>>());
    parts.filter(|part| part.len() > 1).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_lie_on_the_disc_and_the_equator_bends_by_b0() {
        let disc = Disc {
            b0_deg: 7.0,
            l0_deg: 123.0,
            distance_au: 1.0,
        };
        let lines = graticule(&disc, 15);
        let radius = disc.radius_arcsec();
        // The angle on the sphere is up to 0.001 arcsec less than in the plane.
        let within = |at: &HelioprojectiveArcsec| at.x.hypot(at.y) <= radius + 0.01;
        assert!(lines.iter().flatten().all(within));
        // On the central meridian the equator is south of the centre by B0.
        let south = -radius * 7.0_f64.to_radians().sin();
        let is_there = |at: &HelioprojectiveArcsec| at.x.abs() < 1.0 && (at.y - south).abs() < 1.0;
        assert!(lines.iter().flatten().any(is_there));
    }
}
