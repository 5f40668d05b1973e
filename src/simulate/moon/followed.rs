//! The Moon in a camera that follows it across the sky.

use super::{MoonConditions, MoonScene, Shown};
use crate::geometry::camera::CameraModel;
use crate::instrument::DirectionCamera;
use crate::sky::{Ephemeris, SkyError, horizon_dip_deg};
use crate::units::{ARCSEC_PER_RAD, Place, SensorPx};
use jiff::Timestamp;
use nalgebra::{UnitVector3, Vector3};
use std::f64::consts::TAU;

/// Amplitude of the Moon's excursions from the camera's axis, as a fraction of the picture's height, and their periods in s.
const SWING: f64 = 0.2;
const PERIODS_S: [f64; 2] = [37.0, 53.0];
/// Number of stars in a picture.
const STARS: usize = 20;

/// The Moon with its phase and size at a place, in a camera that follows it without roll. Below the limb there are only stars.
#[derive(Debug, Clone)]
pub struct FollowedMoon {
    camera: DirectionCamera,
    place: Place,
    ephemeris: Ephemeris,
    seed: u64,
}

impl FollowedMoon {
    pub fn new(camera: &DirectionCamera, place: Place, seed: u64) -> Self {
        Self {
            camera: camera.clone(),
            place,
            ephemeris: Ephemeris::default(),
            seed,
        }
    }

    /// The scene at a time; `brightness` scales that of a picture with the standard exposure.
    ///
    /// # Errors
    /// If the ephemeris does not cover the time.
    pub fn scene(
        &mut self,
        number: u64,
        utc: Timestamp,
        brightness: f64,
    ) -> Result<MoonScene, SkyError> {
        let moon = self.ephemeris.moon(utc, self.place)?;
        let is_up = moon.elevation_deg > -horizon_dip_deg(self.place.height_m);
        let radius_rad = moon.radius_arcsec / ARCSEC_PER_RAD;
        let plain = MoonConditions::clear(vertical_px(&self.camera.lens, radius_rad));
        let conditions = MoonConditions {
            width_px: self.camera.width_px,
            height_px: self.camera.height_px,
            pixel_aspect: self.camera.lens.aspect(),
            shown: match is_up {
                true => Shown::Moon,
                false => Shown::Nothing,
            },
            peak_dn: brightness * plain.peak_dn,
            craters: true,
            stars: STARS,
            ..plain
        };
        let time_s = utc.as_nanosecond() as f64 * 1e-9;
        let half = SWING * self.camera.height_px as f64;
        let [dx, dy] = PERIODS_S.map(|period_s| half * (TAU * (time_s / period_s).fract()).sin());
        let axis = self.camera.lens.pixel(&Vector3::z_axis());
        let axis = axis.unwrap_or(SensorPx::new(0.0, 0.0));
        Ok(MoonScene {
            conditions,
            centre: SensorPx::new(axis.x + dx, axis.y + dy),
            phase_angle_deg: moon.phase_angle_deg,
            // Clockwise from the zenith, which is up in the picture.
            bright_limb_deg: moon.zenith_to_bright_limb_deg - 90.0,
            turn_deg: 0.0,
            seed: self.seed,
            number,
        })
    }
}

/// Distance in the picture for an angle downwards from the camera's axis, px.
fn vertical_px(camera: &CameraModel, angle_rad: f64) -> f64 {
    let (sin, cos) = angle_rad.sin_cos();
    let at = |ray: UnitVector3<f64>| camera.pixel(&ray).map(|at| at.y);
    let edge = at(UnitVector3::new_unchecked(Vector3::new(0.0, sin, cos)));
    let axis = at(Vector3::z_axis());
    edge.zip(axis).map_or(0.0, |(edge, axis)| edge - axis)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::moon::{Expected, MoonSettings, Optics, below_horizon, solve};
    use crate::simulate::FORT_SUMNER;

    const CAMERA: &str = "[camera]\nwidth_px = 720\nheight_px = 578\ncentre_px = [359.5, 288.5]\nfocal_px = [3300, 3300]\n";

    #[test]
    fn the_moon_that_is_followed_is_the_ephemeris_s_and_below_the_limb_there_is_none() {
        let camera = DirectionCamera::parse("cam.toml".as_ref(), CAMERA).unwrap();
        let mut followed = FollowedMoon::new(&camera, FORT_SUMNER, 1);
        let settings = MoonSettings {
            optics: Optics::Camera(camera.lens),
            ..MoonSettings::default()
        };
        let (mut up, mut down) = (0, 0);
        for hours in 0..24 {
            let utc = Timestamp::from_second(1_379_786_400 + 3600 * hours).unwrap();
            let scene = followed.scene(7, utc, 1.0).unwrap();
            let moon = Ephemeris::default().moon(utc, FORT_SUMNER).unwrap();
            let found = solve(&settings, &scene.frame().unwrap(), &Expected::of(&moon));
            match scene.conditions.shown == Shown::Moon {
                true => {
                    let centre = found.unwrap().centre.position;
                    let off = centre.vector() - scene.centre.vector();
                    assert!(off.norm() < 0.5, "{off} px at {utc}");
                    up += 1;
                }
                false => {
                    assert!(found.is_err());
                    down += usize::from(below_horizon(&moon, FORT_SUMNER).is_some());
                }
            }
        }
        assert!(up > 8 && down > 8, "{up} {down}");
    }
}
