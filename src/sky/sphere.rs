//! Directions on a sphere as unit vectors: construct, move, and measure them without small-angle approximations.
//!
//! A frame's third axis is its pole; longitude increases from the first axis towards the second. In the horizon's frame (north, east, up)
//! longitude is azimuth and latitude elevation; in an equatorial frame they are right ascension and declination. Bearings are measured
//! from the pole towards increasing longitude: in the horizon's frame clockwise from the zenith as seen looking out, in an equatorial one
//! from north through east.

use nalgebra::Vector3;

/// The unit vector towards a longitude and latitude, deg.
pub fn direction(longitude_deg: f64, latitude_deg: f64) -> Vector3<f64> {
    let (sin_lon, cos_lon) = longitude_deg.to_radians().sin_cos();
    let (sin_lat, cos_lat) = latitude_deg.to_radians().sin_cos();
    Vector3::new(cos_lat * cos_lon, cos_lat * sin_lon, sin_lat)
}

/// Longitude (0 to 360) and latitude of a vector of any length, deg.
pub fn angles_deg(v: &Vector3<f64>) -> (f64, f64) {
    let longitude = v.y.atan2(v.x).to_degrees().rem_euclid(360.0);
    (longitude, v.z.atan2(v.x.hypot(v.y)).to_degrees())
}

/// The unit vectors at a direction towards the pole and towards increasing longitude.
pub fn tangents(at: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
    let (sin_lon, cos_lon) = at.y.atan2(at.x).sin_cos();
    let (sin_lat, cos_lat) = at.z.atan2(at.x.hypot(at.y)).sin_cos();
    (
        Vector3::new(-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat),
        Vector3::new(-sin_lon, cos_lon, 0.0),
    )
}

/// The end point from `start` along a great circle of the given bearing and length, rad.
pub fn travel(start: &Vector3<f64>, bearing_rad: f64, length_rad: f64) -> Vector3<f64> {
    let (poleward, along) = tangents(start);
    let course = poleward * bearing_rad.cos() + along * bearing_rad.sin();
    start * length_rad.cos() + course * length_rad.sin()
}

/// Bearing at `at` of the great circle towards `towards`, -pi to pi.
pub fn bearing_rad(at: &Vector3<f64>, towards: &Vector3<f64>) -> f64 {
    let (poleward, along) = tangents(at);
    towards.dot(&along).atan2(towards.dot(&poleward))
}

/// The angle between two vectors of any length, rad; accurate for small angles too.
pub fn separation_rad(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    a.cross(b).norm().atan2(a.dot(b))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quarter_of_the_horizon_lies_between_north_and_east() {
        let north = direction(0.0, 0.0);
        let east = direction(90.0, 0.0);
        assert!((separation_rad(&north, &east).to_degrees() - 90.0).abs() < 1e-12);
        assert!((bearing_rad(&north, &east).to_degrees() - 90.0).abs() < 1e-12);
        assert!((travel(&north, 90_f64.to_radians(), 90_f64.to_radians()) - east).norm() < 1e-15);
    }

    #[test]
    fn travel_keeps_bearing_and_length_far_and_near() {
        let start = direction(254.6, 71.7);
        for length in [1e-9, 1e-3, 0.4] {
            for bearing in [-3.0, -0.7, 0.2, 2.5] {
                let end = travel(&start, bearing, length);
                assert!((separation_rad(&start, &end) - length).abs() < 1e-15);
                assert!((bearing_rad(&start, &end) - bearing).abs() < 1e-6);
            }
        }
    }
}
