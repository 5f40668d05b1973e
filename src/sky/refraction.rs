//! Refraction for an observer within the atmosphere.
//!
//! SOFA's `refco` gives the two constants of dz = A tan z + B tan^3 z. On the ground it agrees with ray tracing to 0.06 arcsec down to 15
//! deg of elevation and to 0.6 arcsec at 10 deg; lower it fails. Below 3 deg it is constant at the value there (0.18 deg on the ground,
//! where the true value at the horizon is 0.57 deg). At 38 km it is 0.9 arcsec at 15 deg; below the horizontal, where the ray passes
//! through denser air, it is too small.

use sofars::astro::refco;
use std::str::FromStr;

/// Centre of the bandpass.
const WAVELENGTH_UM: f64 = 0.63;
/// The sine of the elevation below which refraction is constant, as in SOFA.
const LOWEST_SINE: f64 = 0.05;

/// The air around the observer, assumed dry.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Air {
    pub pressure_hpa: f64,
    pub temperature_c: f64,
}

/// A layer of the standard atmosphere: geopotential height of its base (m), temperature (K) and pressure (hPa) there, and the temperature
/// gradient (K/m).
struct Layer(f64, f64, f64, f64);

/// US Standard Atmosphere 1976, table 4 and equations 33.
static LAYERS: [Layer; 7] = [
    Layer(0.0, 288.15, 1013.25, -6.5e-3),
    Layer(11_000.0, 216.65, 226.3206, 0.0),
    Layer(20_000.0, 216.65, 54.748_89, 1.0e-3),
    Layer(32_000.0, 228.65, 8.680_187, 2.8e-3),
    Layer(47_000.0, 270.65, 1.109_063, 0.0),
    Layer(51_000.0, 270.65, 0.669_388_7, -2.8e-3),
    Layer(71_000.0, 214.65, 0.039_564_20, -2.0e-3),
];

impl Air {
    /// The standard atmosphere (US 1976) at a height; above its 84.852 km, that of its top.
    pub fn standard(height_m: f64) -> Self {
        const EARTH_RADIUS_M: f64 = 6_356_766.0;
        /// Gravity times molar mass over the gas constant, K/m.
        const HYDROSTATIC: f64 = 0.034_163_195;
        let height = (EARTH_RADIUS_M * height_m / (EARTH_RADIUS_M + height_m)).min(84_852.0);
        let above = LAYERS.partition_point(|layer| layer.0 <= height);
        let Layer(base, temperature, pressure, lapse) = LAYERS[above.saturating_sub(1)];
        let here = temperature + lapse * (height - base);
        let pressure_hpa = if lapse == 0.0 {
            pressure * (-HYDROSTATIC * (height - base) / temperature).exp()
        } else {
            pressure * (temperature / here).powf(HYDROSTATIC / lapse)
        };
        Self {
            pressure_hpa,
            temperature_c: here - 273.15,
        }
    }

    /// Refraction at an elevation given without refraction, deg.
    pub fn lift_deg(&self, elevation_deg: f64) -> f64 {
        let (a, b) = refco(self.pressure_hpa, self.temperature_c, 0.0, WAVELENGTH_UM);
        let (sin, cos) = elevation_deg.to_radians().sin_cos();
        let sin = sin.max(LOWEST_SINE);
        let tan_z = cos / sin;
        let w = b * tan_z * tan_z;
        // One Newton step, because A and B refer to the apparent direction (SOFA's atioq).
        ((a + w) * tan_z / (1.0 + (a + 3.0 * w) / (sin * sin))).to_degrees()
    }
}

impl FromStr for Air {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Option<Vec<f64>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
        match numbers.as_deref() {
            Some(&[pressure_hpa, temperature_c])
                if (0.0..=1200.0).contains(&pressure_hpa)
                    && (-150.0..=60.0).contains(&temperature_c) =>
            {
                Ok(Self {
                    pressure_hpa,
                    temperature_c,
                })
            }
            _ => Err(format!(
                "expected HPA,DEG_C from 0 to 1200 hPa and from -150 to 60 deg C, found \"{text}\""
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_standard_atmosphere_is_that_of_its_table() {
        // US Standard Atmosphere 1976, table 1: geometric height m, K, hPa.
        for (height_m, kelvin, hpa) in [
            (0.0, 288.15, 1013.25),
            (5_000.0, 255.676, 540.48),
            (15_000.0, 216.65, 121.11),
            (38_000.0, 244.818, 3.7713),
            (60_000.0, 247.021, 0.21958),
        ] {
            let air = Air::standard(height_m);
            assert!(
                (air.temperature_c + 273.15 - kelvin).abs() < 0.01,
                "{air:?}"
            );
            assert!((air.pressure_hpa / hpa - 1.0).abs() < 1e-3, "{air:?}");
        }
    }

    #[test]
    fn refraction_on_the_ground_is_that_of_traced_rays() {
        // SOFA's note to refco: observed zenith distance deg, ray tracing arcsec, at 1005 hPa, 7 deg C, 80 % (0.574 um).
        let air = Air {
            pressure_hpa: 1005.0,
            temperature_c: 7.0,
        };
        for (observed_deg, arcsec) in [(10.0, 10.27), (45.0, 58.16), (70.0, 158.63)] {
            let without_air_deg = 90.0 - observed_deg - arcsec / 3600.0;
            let found = air.lift_deg(without_air_deg) * 3600.0;
            assert!((found / arcsec - 1.0).abs() < 3e-3, "{found} for {arcsec}");
        }
    }

    #[test]
    fn at_a_balloons_height_refraction_is_an_arcsec() {
        let lift = Air::standard(38_405.0).lift_deg(15.0) * 3600.0;
        assert!((0.5..1.5).contains(&lift), "{lift}");
        assert_eq!("0,-50".parse::<Air>().unwrap().lift_deg(5.0), 0.0);
        assert!("1013".parse::<Air>().is_err() && "-3,0".parse::<Air>().is_err());
    }
}
