//! The direction of a sphere by its edge: the Earth's horizon, seen by a camera.
//!
//! Rays from the camera to the edge of a sphere make a cone about the direction of its centre, the nadir (Braun and Barf 2022,
//! "Image processing based horizon sensor for estimating the orientation of sounding rockets, launch vehicles and spacecraft", section 2.4).
//! The distance tells the cone's half-angle; points of the edge tell its axis, however long or short the arc is that they lie on.
//!
//! Directions are in the camera frame: x to the right, y down, z forward.

mod nadir;

pub use nadir::{Conic, EdgeCorrelation, EdgePoint, Nadir, NadirError, nadir};

use crate::units::{EARTH_RADIUS_M, Measured};

/// The half-angle, with its 1-sigma, of the cone of rays to the horizon (Braun and Barf 2022, eq. 5), rad: of a sphere of
/// [`EARTH_RADIUS_M`] seen from a height above it. The edge that is seen stands `edge` above the sphere. All heights are in m; `None` for a
/// camera that is not above the edge.
pub fn half_angle_rad(height_m: Measured, edge_m: Measured) -> Option<Measured> {
    let (distance, radius) = (
        EARTH_RADIUS_M + height_m.value,
        EARTH_RADIUS_M + edge_m.value,
    );
    let sine = radius / distance;
    if !(0.0..1.0).contains(&sine) {
        return None;
    }
    let slope_per_m = 1.0 / (distance * (1.0 - sine * sine).sqrt());
    let sigma = slope_per_m * (sine * height_m.sigma).hypot(edge_m.sigma);
    Some(Measured::new(sine.asin(), sigma))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_half_angle_of_known_heights() {
        // asin(6371 / 6601), and so on.
        for (height_m, degrees) in [(230_000.0, 74.830_690), (38_000.0, 83.757_636)] {
            let height = Measured::new(height_m, 100.0);
            let angle = half_angle_rad(height, Measured::new(0.0, 0.0)).unwrap();
            assert!((angle.value.to_degrees() - degrees).abs() < 1e-6);
            let at = |height_m| {
                let height = Measured::new(height_m, 0.0);
                half_angle_rad(height, Measured::new(0.0, 0.0))
                    .unwrap()
                    .value
            };
            let slope = at(height_m + 50.0) - at(height_m - 50.0);
            assert!((angle.sigma + slope).abs() < 1e-6 * angle.sigma);
        }
    }

    #[test]
    fn there_is_no_horizon_at_or_below_the_edge() {
        let exact = |m| Measured::new(m, 0.0);
        assert_eq!(half_angle_rad(exact(0.0), exact(0.0)), None);
        assert_eq!(half_angle_rad(exact(10_000.0), exact(20_000.0)), None);
        assert_eq!(half_angle_rad(exact(f64::NAN), exact(0.0)), None);
    }
}
