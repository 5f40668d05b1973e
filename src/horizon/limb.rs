//! The sub-pixel edge of the limb, from profiles of its brightness.
//!
//! The edge is where the limb has half of its brightness above the sky. Brightness varies along the limb, and clouds lie
//! beside it, so that this point is found in two steps: the mean profile gives the half-brightness point, and each place is
//! compared with that profile above any cloud, with a darkness, a brightness and a shift of its own.
//!
//! An edge is not necessarily a limb: see [`Shape::check`].

use super::edge::EdgePoint;
use super::places::{Light, OfPlaces, is_limb, mean_profile, unlike};
use super::profile::{INTERPOLATED_NOISE, Profiles, mean_dn};
use super::shape::Shape;
use super::sphere::Sphere;
use super::template::{CLOUDED_SHARE, Limb, LimbFits};
use crate::estimation::median;
use crate::reasons::horizon as reasons;
use crate::units::Rejected;

/// Number of iterations of the profiles and their mean.
const ROUNDS: usize = 2;
/// A place whose shift has a larger sigma shows no edge.
const MOST_SIGMA_STEPS: f64 = 2.0;
/// Minimum brightness of a place relative to the median one: near the terminator the limb is darker.
const LEAST_BRIGHTNESS: f64 = 0.15;

/// Where the limb is darker than the brightest place, twilight shifts its half-brightness point: by so many scale heights
/// per factor of e. A difference of the logarithm up to `LIKE_BRIGHT` may be due to weather and does not count.
const LIKE_BRIGHT: f64 = 0.2;
const TWILIGHT_SCALES: f64 = 0.3;
/// Maximum median deviation of the places from the mean profile, beyond noise, relative to their brightness.
const MOST_UNEVEN: f64 = 0.015;
/// A limb that fades into night is darker than this fraction of the brightest place at so many places before.
const FADED: f64 = 0.7;
const FADING_PLACES: usize = 4;
/// Above clouds, the edge of a place that is brighter by a factor of e may be farther out by so many scale heights.
const CLOUDED_SCALES: f64 = 0.5;
/// Relative uncertainty of the noise.
const NOISE_SIGMA: f64 = 0.7;

/// The edge measured from the profiles.
pub(super) struct Edge {
    pub points: Vec<EdgePoint>,
    /// Whether it is a limb's edge. Before the cone is aligned with the edge, the edge looks blurred.
    pub likeness: Result<(), Rejected>,
    /// Uncertainty of the half-brightness point, common to all places.
    pub sigma_rad: f64,
    /// Share of the places with clouds.
    pub clouded: f64,
    /// No cloud is visible, and all light follows the model of the air.
    pub is_clear: bool,
    /// Number of places with light of any kind.
    pub lit: usize,
}

/// The edge at every place where it is visible.
///
/// # Errors
/// If nothing is brighter than the sky.
pub(super) fn edge(profiles: &Profiles, sphere: &Sphere, light: &Light) -> Result<Edge, Rejected> {
    let mut limbs: Vec<Limb> = profiles
        .light()
        .map(|place| seen(profiles, place))
        .collect();
    let brightnesses = limbs.iter().map(|limb| limb.brightness_dn);
    let most_dn = brightnesses.fold(0.0, f64::max);
    let no_limb = || Rejected::new(reasons::NO_LIMB, most_dn, light.least_dn);
    let mut clouded = 0.0;
    let mut last = None;
    for _ in 0..ROUNDS {
        let mean = mean_profile(profiles, &limbs, light);
        let fits = LimbFits::new(&mean, profiles, light.noise_dn).ok_or_else(no_limb)?;
        (limbs, clouded) = fits.limbs(profiles);
        last = Some((mean, fits));
    }
    let (mean, fits) = last.ok_or_else(no_limb)?;
    let of_places = OfPlaces::new(profiles, &limbs, light).ok_or_else(no_limb)?;
    let shape = Shape::new(profiles, sphere, mean);
    let half = shape.half(&of_places, clouded, light).ok_or_else(no_limb)?;
    if !half.is_clear && clouded <= CLOUDED_SHARE {
        limbs = fits.above_clouds(profiles);
    }
    let least_dn = LEAST_BRIGHTNESS * of_places.limb_dn;
    let shows_edge = |limb: &&Limb| {
        is_limb(limb, light)
            && limb.shift_sigma_steps < MOST_SIGMA_STEPS
            && limb.brightness_dn > least_dn
    };
    let alike = || check_alike(limbs.iter().filter(shows_edge), light.noise_dn);
    let likeness = shape.check(&half).and_then(|()| alike());
    let moved_scales = |limb: &Limb| {
        let darker = |than_dn: f64| (than_dn / limb.brightness_dn).ln();
        let twilight = (darker(of_places.brightest_dn) - LIKE_BRIGHT).max(0.0);
        let clouds = match clouded > CLOUDED_SHARE {
            true => darker(of_places.limb_dn),
            false => 0.0,
        };
        TWILIGHT_SCALES * twilight + CLOUDED_SCALES * clouds
    };
    let all = profiles.places.iter().zip(&limbs);
    let seen = all.filter(|(_, limb)| shows_edge(limb));
    let points = seen.map(|(place, limb)| EdgePoint {
        of_brightness_px: moved_scales(limb) * shape.scale * profiles.step_px,
        ..place.point(half.steps.value + limb.shift_steps, limb.shift_sigma_steps)
    });
    Ok(Edge {
        points: points.collect(),
        likeness,
        sigma_rad: half.steps.sigma * profiles.step_rad,
        clouded,
        is_clear: half.is_clear,
        lit: lit(profiles, &limbs, light.least_dn, of_places.brightest_dn),
    })
}

/// Checks that the light falls off in the same way at half of the places or more.
fn check_alike<'a>(
    limbs: impl Iterator<Item = &'a Limb> + Clone,
    noise_dn: f64,
) -> Result<(), Rejected> {
    let uneven = median(limbs.clone().map(|limb| unlike(limb, noise_dn))).unwrap_or_default();
    let noise = median(limbs.map(|limb| INTERPOLATED_NOISE * noise_dn / limb.brightness_dn));
    let most = MOST_UNEVEN + NOISE_SIGMA * noise.unwrap_or_default();
    Rejected::at_most(most, uneven, reasons::UNEVEN_EDGE)
}

/// Number of places that show light, or should: a limb may fade into night, but where it ends while it is bright, something
/// covers it, or it is no limb.
fn lit(profiles: &Profiles, limbs: &[Limb], least_dn: f64, brightest_dn: f64) -> usize {
    let is_lit = |light: &[f32]| {
        let limit_dn = mean_dn(&light[profiles.sky()]) + least_dn;
        light.iter().any(|dn| f64::from(*dn) > limit_dn)
    };
    // The brightness of the places with light; none for the others.
    let bright: Vec<Option<f64>> = profiles
        .light()
        .zip(limbs)
        .map(|(light, limb)| is_lit(light).then_some(limb.brightness_dn))
        .collect();
    let runs = bright.chunk_by(|one, next| one.is_some() == next.is_some());
    let (mut count, mut from) = (0, 0);
    for run in runs {
        let (before, after) = (&bright[..from], &bright[from + run.len()..]);
        from += run.len();
        let beside = [
            median(before.iter().rev().flatten().take(FADING_PLACES)),
            median(after.iter().flatten().take(FADING_PLACES)),
        ];
        let mut beside = beside.into_iter().flatten().peekable();
        let fades = |dn: f64| dn < FADED * brightest_dn;
        let is_night = run[0].is_none() && (beside.peek().is_none() || beside.any(fades));
        count += if is_night { 0 } else { run.len() };
    }
    count
}

/// The brightness of a place from the ends of its profile.
fn seen(profiles: &Profiles, light: &[f32]) -> Limb {
    let dark_dn = mean_dn(&light[profiles.sky()]);
    Limb {
        dark_dn,
        brightness_dn: mean_dn(&light[..=profiles.edge]) - dark_dn,
        shift_steps: 0.0,
        shift_sigma_steps: 0.0,
        scatter_dn: 0.0,
    }
}
