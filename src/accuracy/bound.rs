//! The Cramer-Rao bound of a scene: the smallest possible error of the Sun's position on the plate from a single frame.
//!
//! # Method
//! The noise-free picture is differentiated numerically with respect to all unknowns of a solver: the Sun's position on the
//! plate, its radius, peak and limb darkening, background and blur, and the camera's view of the plate (shift, scale,
//! rotation; for a tilted camera also its two tilts). The Fisher matrix is the sum over the pixels of products of slopes
//! over the noise's variance; its inverse is the smallest covariance of any unbiased estimate. A shift of the Sun on the
//! plate and a shift of the plate relative to the camera are degenerate on the limb: only the marks separate them, which
//! the inverse includes. A tilted camera's mapping is assumed conformal at the plate's centre, as in
//! [`registration`](crate::registration): its tilts are about that point.
//!
//! # Not included
//! Blemishes, stray light, readout effects, the Sun's surface and its spots: they only reduce the frame's information.
//! Misprint: the marks' positions are assumed to be exact.

use crate::geometry::{Distortion, Mapping, MappingKind};
use crate::simulate::{Blemishes, Readout, Scene, StrayLight, Sun, Surface, render_exact};
use crate::units::{PlateMil, SensorPx};
use nalgebra::{DMatrix, Matrix2, Matrix3};

/// Unknown parameters of a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Unknown {
    SunX,
    SunY,
    Radius,
    Peak,
    LimbDarkening,
    Background,
    Blur,
    ShiftX,
    ShiftY,
    Scale,
    Rotation,
    TiltX,
    TiltY,
}

use Unknown::*;

/// Steps on the plate are 0.1 px; this is the value for the demo.
const STEP_MIL: f64 = 0.6;
const SCALE_MIL_PER_PX: f64 = 5.75;
const STEP_PX: f64 = 0.1;
/// Moves the limb by 0.1 px.
const STEP_RELATIVE: f64 = 1e-3;
/// Per pixel; moves a Sun at the sensor's edge by 0.5 px.
const STEP_TILT: f64 = 1e-6;

/// The unknowns, the Sun's position first, those of a tilted camera last. Each with the step of its numerical derivative:
/// small relative to the blur, large relative to the rounding of the rendered picture.
const UNKNOWNS: [(Unknown, f64); 13] = [
    (SunX, STEP_MIL),
    (SunY, STEP_MIL),
    (Radius, STEP_MIL),
    (Peak, 1.0),
    (LimbDarkening, 0.02),
    (Background, 1.0),
    (Blur, 0.03),
    (ShiftX, STEP_PX),
    (ShiftY, STEP_PX),
    (Scale, STEP_RELATIVE),
    (Rotation, STEP_RELATIVE),
    (TiltX, STEP_TILT),
    (TiltY, STEP_TILT),
];
/// Number of additional unknowns of a tilted camera.
const TILTS: usize = 2;

impl Unknown {
    /// The scene with this unknown changed by an amount.
    fn changed(self, scene: &Scene, sun: &Sun, by: f64) -> Option<Scene> {
        let mut changed = scene.clone();
        let mut moved = sun.clone();
        let one = Matrix3::identity;
        let mut seen_by = one();
        let mil = by * plate_unit(scene);
        match self {
            SunX => moved.centre.x += mil,
            SunY => moved.centre.y += mil,
            Radius => moved.radius_mil += mil,
            Peak => moved.peak_dn += by,
            LimbDarkening => moved.limb_darkening += by,
            Background => changed.background_dn += by,
            Blur => changed.blur_px += by,
            ShiftX => seen_by[(0, 2)] = by,
            ShiftY => seen_by[(1, 2)] = by,
            Scale => seen_by *= Matrix3::new_scaling(1.0 + by),
            Rotation => seen_by = nalgebra::Rotation2::new(by).to_homogeneous(),
            TiltX => seen_by[(2, 0)] = by,
            TiltY => seen_by[(2, 1)] = by,
        }
        if seen_by != one() {
            // A tilted camera's mapping is conformal at the plate's centre: the tilt is about that point.
            let about = match self {
                TiltX | TiltY => PlateMil::new(0.0, 0.0),
                _ => sun.centre,
            };
            let about = scene.mapping.to_sensor(about);
            changed.mapping = seen_through(&scene.mapping, seen_by, about)?;
        }
        changed.sun = Some(moved);
        Some(changed)
    }
}

/// Size of a scene's pixel on the plate relative to that of the demo.
fn plate_unit(scene: &Scene) -> f64 {
    let centre = scene
        .sun
        .as_ref()
        .map_or(PlateMil::new(0.0, 0.0), |sun| sun.centre);
    scene
        .mapping
        .scale_mil_per_px(scene.mapping.to_sensor(centre))
        / SCALE_MIL_PER_PX
}

/// A mapping whose picture on the sensor is changed by a homography about a position.
fn seen_through(mapping: &Mapping, change: Matrix3<f64>, about: SensorPx) -> Option<Mapping> {
    let there = Matrix3::new_translation(&about.vector());
    let back = Matrix3::new_translation(&-about.vector());
    let undone = (there * change * back).try_inverse()?;
    Mapping::new(
        MappingKind::Homography,
        mapping.matrix() * undone,
        *mapping.distortion(),
    )
}

/// The smallest covariance of the Sun's position on the plate, mil^2. `None` without a Sun, or if the frame does not
/// determine it because of too few marks.
pub fn covariance_mil2(scene: &Scene) -> Option<Matrix2<f64>> {
    let scene = surroundings(scene)?;
    let sun = scene.sun.as_ref()?;
    let count = match scene.mapping.kind() {
        MappingKind::Similarity => UNKNOWNS.len() - TILTS,
        _ => UNKNOWNS.len(),
    };
    let weights = weights(&scene);
    let slopes: Option<Vec<Vec<f32>>> = UNKNOWNS[..count]
        .iter()
        .map(|(unknown, step)| difference(*unknown, *step, &scene, sun))
        .collect();
    let slopes = slopes?;
    // Per step, so that all entries have a similar magnitude.
    let fisher = DMatrix::from_fn(count, count, |a, b| {
        let products = slopes[a].iter().zip(&slopes[b]).zip(&weights);
        products
            .map(|((a, b), w)| f64::from(a * b) * w)
            .sum::<f64>()
    });
    let least = fisher.cholesky()?.inverse();
    let place = least.fixed_view::<2, 2>(0, 0) * (STEP_MIL * plate_unit(&scene)).powi(2);
    Some(Matrix2::from(place))
}

/// Change of the picture per step of an unknown.
fn difference(unknown: Unknown, step: f64, scene: &Scene, sun: &Sun) -> Option<Vec<f32>> {
    let more = render_exact(&unknown.changed(scene, sun, step / 2.0)?);
    let less = render_exact(&unknown.changed(scene, sun, -step / 2.0)?);
    let pairs = more.iter().zip(&less);
    Some(pairs.map(|(more, less)| more - less).collect())
}

/// One over the variance of each pixel, 1/DN^2: its noise and its rounding. Saturated pixels have weight 0.
fn weights(scene: &Scene) -> Vec<f64> {
    let steps_per_dn = f64::from(scene.depth.steps_per_dn());
    let rounding = 1.0 / 12.0 / steps_per_dn.powi(2);
    let saturation_dn = f64::from(scene.depth.saturation_dn()) / steps_per_dn;
    let read = scene.noise.read_dn.powi(2);
    let photons = scene.noise.electrons_per_dn.map_or(0.0, |e| 1.0 / e);
    let weight = |light: f32| {
        let light = f64::from(light);
        let variance = read + light.max(0.0) * photons + rounding;
        match light < saturation_dn {
            true => 1.0 / variance,
            false => 0.0,
        }
    };
    render_exact(scene).into_iter().map(weight).collect()
}

/// The part of a scene around its Sun, without blemishes and spots: all that the bound depends on, at a twentieth of the
/// cost.
fn surroundings(scene: &Scene) -> Option<Scene> {
    const MARGIN_PX: f64 = 10.0;
    let sun = scene.sun.as_ref()?;
    let centre = scene.mapping.to_sensor(sun.centre);
    let scale = scene.mapping.scale_mil_per_px(centre);
    let reach = (sun.radius_mil + sun.smear_mil.norm()) / scale + MARGIN_PX;
    let span = |at: f64, pixels: usize| {
        let first = (at - reach).floor().clamp(0.0, pixels as f64);
        let end = (at + reach).ceil().clamp(0.0, pixels as f64);
        (first < end).then_some((first, (end - first) as usize))
    };
    let (x, width_px) = span(centre.x, scene.width_px)?;
    let (y, height_px) = span(centre.y, scene.height_px)?;
    let lens = scene.mapping.distortion();
    let corner = Matrix3::new_translation(&nalgebra::Vector2::new(x, y));
    let mapping = Mapping::new(
        scene.mapping.kind(),
        scene.mapping.matrix() * corner,
        Distortion {
            centre: SensorPx::new(lens.centre.x - x, lens.centre.y - y),
            ..*lens
        },
    )?;
    Some(Scene {
        width_px,
        height_px,
        mapping,
        blemishes: Blemishes::default(),
        stray: StrayLight::default(),
        readout: Readout::default(),
        sun: Some(Sun {
            surface: Surface::Plain,
            spots: Vec::new(),
            ..sun.clone()
        }),
        ..scene.clone()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accuracy::conditions::noise;
    use crate::accuracy::recipe::{ENOUGH_MARKS, Recipe, View};
    use crate::estimation::median;
    use crate::instrument::builtin;

    fn medians_arcsec(noise_dn: f64) -> f64 {
        let demo = builtin("demo").unwrap();
        let mut recipe = Recipe::standard(&demo);
        recipe.view = View::Whole {
            lit_marks: ENOUGH_MARKS,
        };
        noise(&mut recipe, noise_dn);
        let sigmas = (0..15)
            .filter_map(|seed| {
                let scene = recipe.scene(&demo, seed).unwrap();
                covariance_mil2(&scene)
            })
            .map(|covariance| (covariance.trace() / 2.0).sqrt());
        median(sigmas).unwrap() * demo.optics.arcsec_per_mil()
    }

    #[test]
    fn the_bound_is_that_of_independent_arithmetic() {
        // Per axis, for a median scene, from other code and another renderer; scenes differ by a fifth.
        for (noise_dn, known) in [(1.0, 0.0155), (5.0, 0.074), (15.0, 0.22)] {
            let found = medians_arcsec(noise_dn);
            assert!((found / known - 1.0).abs() < 0.2, "{noise_dn} DN: {found}");
        }
    }

    #[test]
    fn a_plate_without_marks_does_not_determine_the_suns_place_on_it() {
        let demo = builtin("demo").unwrap();
        let mut recipe = Recipe::standard(&demo);
        recipe.conditions.mark_contrast = 0.0;
        let scene = recipe.scene(&demo, 1).unwrap();
        let sigma = covariance_mil2(&scene).map(|c| c.trace().sqrt());
        assert!(sigma.is_none_or(|mil| mil > 10.0), "{sigma:?}");
    }
}
