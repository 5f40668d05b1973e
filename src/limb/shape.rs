//! Departures of the limb from one common profile round the disc: smooth courses of illumination, background, blur and
//! coma.

use super::band::{Band, middle_of_sector};
use super::profile::Profile;
use crate::estimation::clipped_sigma;
use crate::frame::{PixelNoise, ROUNDING_NOISE_DN};
use crate::kernels::sums::SECTOR;
use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

/// Quantities of a sector, by index: the limb's shift outwards (px), excess illumination (a fraction), background (DN),
/// excess of the blur's variance (px^2), the displaced fraction of the light times its displacement (px).
pub(super) const SHIFT: usize = 0;
pub(super) const ILLUMINATION: usize = 1;
pub(super) const BACKGROUND: usize = 2;
pub(super) const BLUR: usize = 3;
pub(super) const COMA_SHIFT: usize = 4;
/// The blur of the light that coma displaces, in blurs. With this value the marks' shift follows from the limb's to 3 % for
/// any true value from 1.1 to 3.7.
pub const COMA_BLURS: f64 = 2.1;

/// Coefficients of the smooth courses: illumination 1, x, y; background 1, x, y, cos 2 phi, sin 2 phi; variance of the blur 1,
/// cos 2 phi, sin 2 phi; coma x, y.
pub(super) const SMOOTH: usize = 13;
pub(super) const UNEVEN_BACKGROUND: std::ops::Range<usize> = 4..8;
pub(super) const MOTION: std::ops::Range<usize> = 9..11;
pub(super) const COMA: std::ops::Range<usize> = 11..13;

/// Departures of the limb from one common profile round the disc.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Shape {
    pub(super) coefficients: SVector<f64, SMOOTH>,
}

impl Shape {
    pub(super) const NONE: Self = Self {
        coefficients: SVector::<f64, SMOOTH>::from_array_storage(nalgebra::ArrayStorage([
            [0.0; SMOOTH]
        ])),
    };

    /// Quantities of a sector in a direction.
    pub(super) fn at(&self, w: Vector2<f64>) -> SVector<f64, SECTOR> {
        course(&smooth_terms(w), &self.coefficients)
    }

    /// Whether motion and coma are so similar that a fit converges from one to the other in one step.
    pub(super) fn is_near(&self, other: &Self) -> bool {
        const MOTION_PX2: f64 = 0.05;
        const COMA_PX: f64 = 0.01;
        let change = (self.coefficients - other.coefficients).abs();
        let most = |effect: std::ops::Range<usize>| change.rows_range(effect).max();
        most(MOTION) < MOTION_PX2 && most(COMA) < COMA_PX
    }

    /// The harmonics of the blur's variance at twice the azimuth, px^2: along x and along the diagonal.
    pub(super) fn motion_px2(&self) -> Vector2<f64> {
        self.coefficients.fixed_rows::<2>(MOTION.start).into_owned()
    }

    /// Excess of the blur's variance, mean over azimuth, px^2.
    pub(super) fn blur_px2(&self) -> f64 {
        self.coefficients[MOTION.start - 1]
    }
}

/// The quantity of a sector to which each coefficient belongs.
pub(super) const QUANTITY: [usize; SMOOTH] = [
    ILLUMINATION,
    ILLUMINATION,
    ILLUMINATION,
    BACKGROUND,
    BACKGROUND,
    BACKGROUND,
    BACKGROUND,
    BACKGROUND,
    BLUR,
    BLUR,
    BLUR,
    COMA_SHIFT,
    COMA_SHIFT,
];

/// The factor of each coefficient in a direction.
pub(super) fn smooth_terms(w: Vector2<f64>) -> SVector<f64, SMOOTH> {
    let w = w.normalize();
    let (c2, s2) = (w.x * w.x - w.y * w.y, 2.0 * w.x * w.y);
    SVector::from([1.0, w.x, w.y, 1.0, w.x, w.y, c2, s2, 1.0, c2, s2, w.x, w.y])
}

/// The quantities of a sector with these terms.
pub(super) fn course(
    terms: &SVector<f64, SMOOTH>,
    coefficients: &SVector<f64, SMOOTH>,
) -> SVector<f64, SECTOR> {
    let mut course = SVector::zeros();
    for n in 0..SMOOTH {
        course[QUANTITY[n]] += terms[n] * coefficients[n];
    }
    course
}

/// The model of a frame's limb at all azimuths.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct EdgeModel {
    pub profile: Profile,
    /// Uncertainty of the limb's radial position common to all azimuths, from that of the profile, 1 sigma, px.
    pub place_sigma_px: f64,
    pub shape: Shape,
    /// Covariance of the shape's coefficients; zero where they are held.
    pub covariance: SMatrix<f64, SMOOTH, SMOOTH>,
    pub noise: PixelNoise,
    /// The unit of near and far distances: the profile's blur, but at least the expected one, px.
    pub resolution_px: f64,
    /// Uncertainty of the limb's distance from the ellipse of the band, 1 sigma, px.
    pub shift_sigma_px: f64,
    /// Pixels whose expected value is above this saturate too often to be used, DN.
    pub saturated_dn: f64,
}

impl EdgeModel {
    /// The profile of a sector.
    pub(super) fn profile_at(&self, course: &SVector<f64, SECTOR>) -> Profile {
        let variance = self.profile.blur_px.powi(2) + course[BLUR];
        self.profile.with_blur(variance.max(0.0).sqrt())
    }

    /// The fraction of the light that coma displaces times its displacement, px, and its covariance.
    pub(super) fn coma(&self) -> (Vector2<f64>, Matrix2<f64>) {
        let own = self.covariance.fixed_view::<2, 2>(COMA.start, COMA.start);
        let coefficients = self.shape.coefficients.fixed_rows::<2>(COMA.start);
        (coefficients.into_owned(), own.into_owned())
    }

    /// Light well inside the limb, DN.
    pub(super) fn plateau_dn(&self) -> f64 {
        self.profile.at(-4.0 * self.profile.blur_px) - self.profile.background_dn
    }
}

/// The noise of pixels well away from the limb: outside without the disc's light, inside with it.
pub(super) fn noise(band: &Band, model: &EdgeModel) -> PixelNoise {
    /// Sufficient number of pixels.
    const PIXELS: usize = 1000;
    let clear = (3.0 * model.profile.blur_px) as f32;
    let mut inside_dn = 0.0;
    let sectors = band.sectors().count();
    let pixels = band.pixels().light_dn.len();
    let stride = (pixels / PIXELS).max(1);
    let [mut outside, mut inside] = [0; 2].map(|_| Vec::with_capacity(pixels / stride));
    for (n, pixels) in band.sectors().enumerate() {
        let course = model.shape.at(middle_of_sector(n, sectors));
        let profile = model.profile_at(&course);
        let light_at = profile.light();
        let pixels = pixels
            .distance_px
            .iter()
            .zip(pixels.light_dn)
            .step_by(stride);
        for (distance_px, light_dn) in pixels.filter(|(distance, _)| distance.abs() > clear) {
            // The disc's light is negligible at this distance.
            let light = match *distance_px > clear {
                true => 0.0,
                false => light_at.at(*distance_px).0,
            };
            let expected = light * (1.0 + course[ILLUMINATION] as f32);
            let residual =
                light_dn - expected - (profile.background_dn + course[BACKGROUND]) as f32;
            if *distance_px > clear {
                outside.push(residual);
            } else if f64::from(light) < model.saturated_dn {
                inside.push(residual);
                inside_dn += f64::from(expected);
            }
        }
    }
    let sigma = |residuals: &[f32], start: f64| {
        clipped_sigma(residuals, start as f32, ROUNDING_NOISE_DN).unwrap_or(start)
    };
    let dark_dn = sigma(&outside, model.noise.dark_dn2.sqrt());
    let light_dn = inside_dn / inside.len().max(1) as f64;
    let bright_dn = sigma(&inside, model.noise.sigma_dn(light_dn));
    let per_light_dn = (bright_dn.powi(2) - dark_dn.powi(2)) / light_dn.max(1.0);
    PixelNoise {
        dark_dn2: dark_dn.powi(2),
        per_light_dn: per_light_dn.max(0.0),
    }
}
