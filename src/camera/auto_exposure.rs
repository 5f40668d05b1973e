//! Automatic exposure: it follows the Sun's brightness and is held under clouds.

use crate::frame::Levels;

/// Settings of the automatic exposure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AutoExposureSettings {
    /// Set point of the disc's 99th percentile, as a fraction of full scale.
    pub target: f64,
    /// Relative deviation from the best exposure beyond which it is changed.
    pub band: f64,
    /// The largest factor from one frame to the next.
    pub max_factor: f64,
    /// Number of frames for which the exposure is held when the disc grows dim or is lost.
    pub hold_frames: u32,
    pub min_us: u32,
    pub max_us: u32,
}

impl Default for AutoExposureSettings {
    fn default() -> Self {
        Self {
            target: 0.8,
            band: 0.1,
            max_factor: 2.0,
            hold_frames: 40,
            min_us: 100,
            max_us: 100_000,
        }
    }
}

/// Levels of a frame, in fractions of full scale.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Brightness {
    /// The disc's 99th percentile, and the background.
    Disc {
        level: f64,
        background: f64,
    },
    NoDisc,
}

impl Brightness {
    /// The brightness of a frame whose pixels saturate at `saturation_dn`; without levels there is no disc.
    pub fn of(levels: Option<&Levels>, saturation_dn: u16) -> Self {
        let full_dn = f64::from(saturation_dn);
        levels.map_or(Self::NoDisc, |levels| Self::Disc {
            level: levels.disc_dn / full_dn,
            background: levels.background_dn / full_dn,
        })
    }
}

/// Level from which the disc is saturated: it only shows that the exposure is too long.
const SATURATED: f64 = 0.985;
/// Fraction of its brightness below which a disc, from one frame to the next, is behind a cloud.
const CLOUD: f64 = 0.7;
/// Factor per frame while a cloud persists.
const CREEP: f64 = 1.02;
/// Largest factor between the exposure without a disc and that of the last clear frame.
const FURTHEST: f64 = 4.0;

/// Holds the disc at a set brightness.
///
/// From each frame and its own exposure it computes the right exposure; so it does not matter after how many
/// frames a change takes effect. A cloud is a sudden loss of light: the exposure is held for a while, then it changes slowly. If the disc is
/// saturated, the exposure is reduced at once.
#[derive(Debug, Clone)]
pub struct AutoExposure {
    settings: AutoExposureSettings,
    /// The last exposure returned.
    set_us: Option<f64>,
    clear: Option<Clear>,
    /// Number of successive frames behind a cloud.
    clouded: u32,
}

/// Result of the last clear frame.
#[derive(Debug, Clone, Copy)]
struct Clear {
    /// Brightness of the disc per microsecond of exposure, as a fraction of full scale.
    light_per_us: f64,
    exposure_us: f64,
}

impl AutoExposure {
    pub fn new(settings: AutoExposureSettings) -> Self {
        Self {
            settings,
            set_us: None,
            clear: None,
            clouded: 0,
        }
    }

    /// The exposure for the frames to come, us, after a frame of `exposure_us`.
    pub fn next(&mut self, measured: Brightness, exposure_us: u32) -> u32 {
        let taken_us = f64::from(exposure_us.max(1));
        let set_us = self.set_us.unwrap_or(taken_us);
        let wanted_us = match measured {
            Brightness::Disc { level, .. } if level >= SATURATED => {
                self.clouded = 0;
                set_us.min(taken_us / self.settings.max_factor)
            }
            Brightness::Disc { level, background } => {
                self.after_disc(level, background, taken_us, set_us)
            }
            Brightness::NoDisc => self.after_nothing(set_us),
        };
        let (low, high) = (
            f64::from(self.settings.min_us),
            f64::from(self.settings.max_us),
        );
        let wanted_us = wanted_us.clamp(low, high.max(low));
        self.set_us = Some(wanted_us);
        wanted_us.round() as u32
    }

    fn after_disc(&mut self, level: f64, background: f64, taken_us: f64, set_us: f64) -> f64 {
        let AutoExposureSettings {
            target,
            band,
            max_factor,
            hold_frames,
            ..
        } = self.settings;
        let light_per_us = (level - background).max(1e-6) / taken_us;
        let best_us = (target - background).max(1e-6) / light_per_us;
        let is_near = (best_us / set_us - 1.0).abs() <= band;
        let is_dim = |clear: Clear| light_per_us < CLOUD * clear.light_per_us;
        if self.clear.is_some_and(is_dim) && !is_near {
            self.clouded += 1;
            if self.clouded <= hold_frames {
                return set_us;
            }
            return best_us.clamp(set_us / CREEP, set_us * CREEP);
        }
        self.clouded = 0;
        self.clear = Some(Clear {
            light_per_us,
            exposure_us: best_us,
        });
        if is_near {
            return set_us;
        }
        best_us.clamp(taken_us / max_factor, taken_us * max_factor)
    }

    fn after_nothing(&mut self, set_us: f64) -> f64 {
        self.clouded += 1;
        match self.clear {
            // The Sun has not been seen yet: it may be there, but too dim.
            None => set_us * self.settings.max_factor,
            Some(_) if self.clouded <= self.settings.hold_frames => set_us,
            Some(clear) => (set_us * CREEP).min((FURTHEST * clear.exposure_us).max(set_us)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_xoshiro::Xoshiro256PlusPlus;

    const BACKGROUND: f64 = 0.016;

    /// A camera whose new exposure takes effect one frame late, under a Sun of given brightness, with 1 % of noise.
    struct Loop {
        auto: AutoExposure,
        rng: Xoshiro256PlusPlus,
        /// Exposures of the frame being taken and of the one after it, us.
        exposures_us: [u32; 2],
    }

    impl Loop {
        fn from(exposure_us: u32) -> Self {
            Self {
                auto: AutoExposure::new(AutoExposureSettings::default()),
                rng: Xoshiro256PlusPlus::seed_from_u64(3),
                exposures_us: [exposure_us; 2],
            }
        }

        /// A frame under a light (1: the target at 15 ms); its level, if the disc is seen.
        fn frame(&mut self, light: f64) -> Option<f64> {
            let [taken_us, following_us] = self.exposures_us;
            let signal = 0.784 * light * f64::from(taken_us) / 15_000.0;
            let noisy = BACKGROUND + signal * self.rng.random_range(0.99..1.01);
            let level = (signal > 0.01).then_some(noisy.min(1.0));
            let seen = match level {
                Some(level) => Brightness::Disc {
                    level,
                    background: BACKGROUND,
                },
                None => Brightness::NoDisc,
            };
            let next_us = self.auto.next(seen, taken_us);
            self.exposures_us = [following_us, next_us];
            level
        }

        fn frames(&mut self, count: usize, light: f64) -> Vec<Option<f64>> {
            (0..count).map(|_| self.frame(light)).collect()
        }

        fn exposure_us(&self) -> u32 {
            self.exposures_us[1]
        }
    }

    fn is_good(level: &Option<f64>) -> bool {
        level.is_some_and(|level| (level - 0.8).abs() < 0.09)
    }

    #[test]
    fn it_comes_to_the_target_from_darkness_and_from_saturation_and_rests_there() {
        for start_us in [100, 5_000, 15_000, 100_000] {
            let mut camera = Loop::from(start_us);
            camera.frames(25, 1.0);
            let found_us = camera.exposure_us();
            let levels = camera.frames(200, 1.0);
            assert!(levels.iter().all(is_good), "{start_us}: {levels:?}");
            assert_eq!(camera.exposure_us(), found_us, "from {start_us}: it hunts");
        }
    }

    #[test]
    fn it_follows_slow_changes_of_the_light() {
        let mut camera = Loop::from(15_000);
        for step in 0..400 {
            let level = camera.frame(1.0 - 0.002 * f64::from(step));
            assert!(is_good(&level), "{step}: {level:?}");
        }
    }

    #[test]
    fn a_step_is_never_larger_than_the_factor() {
        let mut camera = Loop::from(400);
        for light in [1.0, 8.0, 0.2, 30.0, 1.0] {
            for _ in 0..60 {
                let [taken_us, _] = camera.exposures_us;
                camera.frame(light);
                let ratio = f64::from(camera.exposure_us()) / f64::from(taken_us);
                assert!((0.49..=2.01).contains(&ratio), "{light}: {ratio}");
            }
        }
    }

    #[test]
    fn passing_clouds_do_not_move_it() {
        let mut camera = Loop::from(15_000);
        camera.frames(20, 1.0);
        let clear_us = camera.exposure_us();
        for (cloud, frames) in [(0.3, 30), (0.0, 35), (0.5, 10), (0.001, 39)] {
            camera.frames(frames, cloud);
            assert_eq!(camera.exposure_us(), clear_us, "light {cloud}");
            let levels = camera.frames(5, 1.0);
            assert!(levels.iter().all(is_good), "{levels:?}");
        }
    }

    #[test]
    fn under_a_cloud_that_stays_it_creeps_and_comes_back_within_a_second() {
        let mut camera = Loop::from(15_000);
        camera.frames(20, 1.0);
        camera.frames(150, 0.5);
        assert!(
            is_good(&camera.frame(0.5)),
            "it never comes to terms with the cloud"
        );
        let back = camera.frames(8, 1.0);
        assert!(back[4..].iter().all(is_good), "{back:?}");
    }

    #[test]
    fn without_a_sun_it_goes_only_so_far() {
        let mut camera = Loop::from(15_000);
        camera.frames(20, 1.0);
        let clear_us = camera.exposure_us();
        camera.frames(2000, 0.0);
        assert!(camera.exposure_us() > clear_us && camera.exposure_us() < 5 * clear_us);
        let back = camera.frames(12, 1.0);
        assert!(back[8..].iter().all(is_good), "{back:?}");
    }

    #[test]
    fn it_keeps_its_limits() {
        let mut camera = Loop::from(15_000);
        camera.frames(100, 1e-9);
        assert_eq!(camera.exposure_us(), 100_000);
        camera.frames(100, 1e6);
        assert_eq!(camera.exposure_us(), 100);
    }
}
