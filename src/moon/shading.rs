//! Scattering of the Sun's light by the Moon's ground.

use nalgebra::Vector3;
use std::f64::consts::PI;

/// Law by which a surface scatters light.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Shading {
    /// Dark ground: mu0 / (mu0 + mu). The full Moon is as bright at its limb as in its centre, half as bright as a thin
    /// crescent's limb.
    #[default]
    LommelSeeliger,
    /// A diffuse white surface such as chalk: mu0.
    Lambert,
}

impl Shading {
    /// Brightness of a place whose normal makes angles with these cosines to the Sun and to the observer; at most 1.
    pub fn light(self, to_sun: f64, to_observer: f64) -> f64 {
        let to_sun = to_sun.max(0.0);
        match self {
            Self::LommelSeeliger => {
                let sum = to_sun + to_observer.max(0.0);
                if sum > 0.0 { to_sun / sum } else { 0.0 }
            }
            Self::Lambert => to_sun,
        }
    }
}

/// The phase of the thinnest crescent that can be determined from a light's centroid.
const MOST_PHASE_RAD: f64 = 3.12;

/// A smooth sphere illuminated by the Sun. Lengths are in its radius.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sphere {
    shading: Shading,
    phase_rad: f64,
    /// Sine and cosine of the phase angle.
    phase: (f64, f64),
}

impl Sphere {
    /// A sphere at a phase angle: 0 at full, pi at new.
    pub fn new(shading: Shading, phase_rad: f64) -> Self {
        Self {
            shading,
            phase_rad,
            phase: phase_rad.sin_cos(),
        }
    }

    pub fn phase_rad(&self) -> f64 {
        self.phase_rad
    }

    /// The sunlit fraction of its disc.
    pub fn lit(&self) -> f64 {
        lit(self.phase_rad.to_degrees())
    }

    /// Brightness of the disc at a distance from its centre and an angle from the middle of the bright limb; 0 outside the
    /// disc.
    pub fn light(&self, distance: f64, angle_rad: f64) -> f64 {
        self.light_along(distance, angle_rad.cos())
    }

    /// The same for a given cosine of the angle.
    pub fn light_along(&self, distance: f64, cos_angle: f64) -> f64 {
        if distance >= 1.0 {
            return 0.0;
        }
        self.light_at(distance * cos_angle, (1.0 - distance * distance).sqrt())
    }

    /// Brightness of a place on the disc at a distance from its centre towards the bright limb; `to_observer` is the cosine
    /// of the angle between its normal and the observer.
    pub fn light_at(&self, along: f64, to_observer: f64) -> f64 {
        let (sin, cos) = self.phase;
        self.shading
            .light(along * sin + to_observer * cos, to_observer)
    }

    /// Distance of the light's centroid from the disc's centre, towards the bright limb.
    pub fn offset_of_light(&self) -> f64 {
        const RINGS: usize = 8;
        const ANGLES: usize = 12;
        let (mut sum, mut moment) = (0.0, 0.0);
        for n in 0..ANGLES {
            let cos = ((n as f64 + 0.5) / ANGLES as f64 * PI).cos();
            for ring in 0..RINGS {
                // Rings of equal area.
                let distance = ((ring as f64 + 0.5) / RINGS as f64).sqrt();
                let light = self.light_along(distance, cos);
                sum += light;
                moment += light * distance * cos;
            }
        }
        if sum > 0.0 { moment / sum } else { 1.0 }
    }

    /// The sphere whose light's centroid has the given distance from its disc's centre.
    pub fn of_offset(shading: Shading, offset: f64) -> Self {
        let at = |phase_rad| Self::new(shading, phase_rad);
        let (mut low, mut high) = (0.0, MOST_PHASE_RAD);
        for _ in 0..10 {
            let middle = (low + high) / 2.0;
            match at(middle).offset_of_light() < offset {
                true => low = middle,
                false => high = middle,
            }
        }
        at((low + high) / 2.0)
    }
}

/// The sunlit fraction of a sphere's disc.
pub(super) fn lit(phase_angle_deg: f64) -> f64 {
    (1.0 + phase_angle_deg.to_radians().cos()) / 2.0
}

/// The phase angle for a sunlit fraction of a sphere's disc.
pub(super) fn phase_rad_of_lit(lit: f64) -> f64 {
    (2.0 * lit - 1.0).clamp(-1.0, 1.0).acos()
}

/// The direction to the Sun from a sphere: x to the right, y down, z to the observer; the middle of the bright limb is at
/// an angle from +x towards +y.
pub fn towards_sun(phase_angle_deg: f64, bright_limb_deg: f64) -> Vector3<f64> {
    let (sin, cos) = phase_angle_deg.to_radians().sin_cos();
    let (sin_limb, cos_limb) = bright_limb_deg.to_radians().sin_cos();
    Vector3::new(sin * cos_limb, sin * sin_limb, cos)
}
