//! Frames for `calibrate camera`: without light and evenly lit, by the camera of random scenes; and the true properties of that camera.

use super::scene::{Scene, Sun};
use super::{EXPOSURE, Purpose, RandomScenes};
use crate::instrument::{Noise, Sensor, Vignetting};
use crate::units::{Measured, PlateMil, SensorPx};

impl RandomScenes {
    /// The scene of a frame under a covered lens.
    pub fn covered(&self, number: u64) -> Scene {
        self.without_sun(Purpose::Covered, number)
    }

    /// The scene of a frame of an even lamp, without the plate: `share` is the lamp's light in the middle relative to the brightness of
    /// the Sun's disc, at an exposure proportional to it.
    pub fn evenly_lit(&self, number: u64, share: f64) -> Scene {
        /// Radius of a disc that is uniform over the whole sensor.
        const RADIUS_MIL: f64 = 1e5;
        let mut scene = self.without_sun(Purpose::EvenLamp, number);
        scene.sun = Some(Sun {
            peak_dn: self.peak_dn() * share,
            limb_darkening: 0.0,
            ..Sun::new(PlateMil::new(0.0, 0.0), RADIUS_MIL)
        });
        scene.mark_contrast = 0.0;
        scene.info.exposure = Some(EXPOSURE.mul_f64(share));
        scene
    }
}

impl Scene {
    /// The true properties of the camera, in its own DN: all sigmas are 0.
    pub fn sensor(&self) -> Sensor {
        let exact = |value: f64| Measured::new(value, 0.0);
        let steps = f64::from(self.depth.steps_per_dn());
        let electrons = self.noise.electrons_per_dn;
        let photons = electrons.map_or(0.0, |electrons| self.background_dn.max(0.0) / electrons);
        // Rounding to integers has the variance 1/12.
        let variance = steps.powi(2) * (self.noise.read_dn.powi(2) + photons) + 1.0 / 12.0;
        let mut hot_pixels: Vec<_> = self
            .blemishes
            .hot_pixels
            .iter()
            .map(|h| (h.x, h.y))
            .collect();
        hot_pixels.sort_unstable();
        hot_pixels.dedup();
        Sensor {
            noise: Some(Noise {
                saturation_dn: self.depth.saturation_dn(),
                dark_dn: exact(self.background_dn * steps),
                read_noise_dn: exact(variance.sqrt()),
                gain_dn_per_electron: electrons.map(|electrons| exact(steps / electrons)),
            }),
            vignetting: Some(self.vignetting()),
            hot_pixels,
        }
    }

    fn vignetting(&self) -> Vignetting {
        let centre = SensorPx::new(
            (self.width_px as f64 - 1.0) / 2.0,
            (self.height_px as f64 - 1.0) / 2.0,
        );
        let square = -self.blemishes.vignetting / centre.vector().norm_squared();
        Vignetting {
            centre,
            radial: [Measured::new(square, 0.0), Measured::new(0.0, 0.0)],
        }
    }
}
