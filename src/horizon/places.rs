//! What the places along an edge say of the limb together.

use super::profile::{INTERPOLATED_NOISE, Profiles};
use super::template::Limb;
use crate::estimation::{median, median_among};

/// Places that are averaged, and the share of them that has no cloud, where the limb's brightness is read. Less, and the places that a flare or the
/// Sun spoils would count.
const AVERAGED_PLACES: usize = 5;
const CLOUDLESS_SHARE: f64 = 0.1;
/// The brightest place is the one that so many are darker than.
const BRIGHTEST: f64 = 0.9;

/// What is known of a frame's light, DN.
#[derive(Debug, Clone, Copy)]
pub(super) struct Light {
    /// The limb is brighter than the sky by so much at the least.
    pub least_dn: f64,
    /// Of a pixel, 1 sigma.
    pub noise_dn: f64,
    /// Beyond noise, a place's profile differs from the mean one by this share of its brightness at most.
    pub most_unlike: f64,
    /// Of a pixel of the sky far from the limb, if any is in view.
    pub far_sky_dn: Option<f64>,
}

/// Whether a place shows what the others do, and not a part of the vehicle.
pub(super) fn is_limb(limb: &Limb, light: &Light) -> bool {
    limb.brightness_dn > light.least_dn && unlike(limb, light.noise_dn) < light.most_unlike
}

/// What a place's profile has beside the mean one and noise, over its brightness.
pub(super) fn unlike(limb: &Limb, noise_dn: f64) -> f64 {
    let noise_dn = INTERPOLATED_NOISE * noise_dn;
    (limb.scatter_dn.powi(2) - noise_dn.powi(2)).max(0.0).sqrt() / limb.brightness_dn
}

/// The light of all places that show the limb, each less its darkness and over its brightness.
struct Normalised {
    places: usize,
    /// The innermost sample of each place, then the next.
    light: Vec<f64>,
}

impl Normalised {
    /// The innermost samples, so many.
    fn of(profiles: &Profiles, samples: usize, limbs: &[Limb], light: &Light) -> Self {
        let all = || limbs.iter().zip(profiles.light());
        let shows_limb = |(limb, _): &(&Limb, &[f32])| is_limb(limb, light);
        let places = all().filter(shows_limb).count();
        let mut normal = vec![0.0; places * samples];
        for (place, (limb, light)) in all().filter(shows_limb).enumerate() {
            let of_place = normal.iter_mut().skip(place).step_by(places);
            for (normal, dn) in of_place.zip(light) {
                *normal = (f64::from(*dn) - limb.dark_dn) / limb.brightness_dn;
            }
        }
        Self {
            places,
            light: normal,
        }
    }

    /// The same sample of all places.
    fn samples(&mut self) -> impl Iterator<Item = &mut [f64]> {
        self.light.chunks_exact_mut(self.places.max(1))
    }
}

/// The middle of all profiles. Nothing of no limb.
pub(super) fn mean_profile(profiles: &Profiles, limbs: &[Limb], light: &Light) -> Vec<f64> {
    let mut normal = Normalised::of(profiles, profiles.length, limbs, light);
    normal.samples().filter_map(median_among).collect()
}

/// What the places of a limb have together.
pub(super) struct OfPlaces {
    /// Brightness of the middle one and of the brightest, DN.
    pub limb_dn: f64,
    pub brightest_dn: f64,
    /// Beyond their profiles.
    pub sky_dn: f64,
    /// Places that were averaged.
    pub averaged: usize,
    /// The limb at its brightest height, over its brightness in the mean profile: of the places without clouds, and of the middle one.
    pub cloudless: f64,
    pub middle: f64,
}

impl OfPlaces {
    /// `None` of no limb.
    pub fn new(profiles: &Profiles, limbs: &[Limb], light: &Light) -> Option<Self> {
        let mut normal = Normalised::of(profiles, profiles.edge + 1, limbs, light);
        let averaged = AVERAGED_PLACES.min(normal.places).max(1);
        let alike = || limbs.iter().filter(|limb| is_limb(limb, light));
        let mut bright: Vec<f64> = alike().map(|limb| limb.brightness_dn).collect();
        bright.sort_by(f64::total_cmp);
        let of_share = |sorted: &[f64], share: f64| {
            let place = (sorted.len() as f64 * share) as usize;
            sorted.get(place).copied()
        };
        let (mut cloudless, mut middle) = (f64::MIN, f64::MIN);
        for light in normal.samples() {
            let means = light.windows(averaged).map(|some| some.iter().sum::<f64>());
            let mut means: Vec<f64> = means.map(|sum| sum / averaged as f64).collect();
            means.sort_unstable_by(f64::total_cmp);
            cloudless = cloudless.max(of_share(&means, CLOUDLESS_SHARE)?);
            middle = middle.max(of_share(&means, 0.5)?);
        }
        Some(Self {
            limb_dn: of_share(&bright, 0.5)?,
            brightest_dn: of_share(&bright, BRIGHTEST)?,
            sky_dn: median(alike().map(|limb| limb.dark_dn))?,
            averaged,
            cloudless,
            middle,
        })
    }
}
