//! The limb of a real Sun is found where its header states it; the softening of a limb is measured.

use solaspect::aspect::{self, Expected, Pipeline, Quality};
use solaspect::fits;
use solaspect::frame::{Background, Cutout, Mask, PixelNoise};
use solaspect::geometry::Ellipse;
use solaspect::instrument::builtin;
use solaspect::limb::{self, DiscSearch, KnownOutline, Limb, LimbFit, LimbSettings, OutlinePrior};
use solaspect::simulate::{Conditions, Noise, RandomScenes, SUN_RADIUS_ARCSEC};
use solaspect::units::Measured;
use std::path::Path;

/// Centre (first pixel 0) and radius by the header of HMI's picture; see tests/data/hmi/README.md.
const CENTRE_PX: (f64, f64) = (255.5, 255.5);
const RADIUS_PX: f64 = 202.910;

#[test]
fn the_sun_of_hmi_is_found_where_its_header_says() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/hmi/continuum.fits");
    let frame = fits::read_frame(&path).unwrap();
    let settings = LimbSettings::default();
    let levels = limb::levels(&frame, &settings).unwrap();
    let search = DiscSearch {
        frame: &frame,
        levels: &levels,
        radius_px: RADIUS_PX,
        mark_length_px: 15.7,
        settings: &settings,
    };
    let found = search.anywhere(frame.region()).unwrap();
    let start = Ellipse::from(found);
    // Radius and flattening are unknown here: sigmas of 3 % and 0.3 % do not constrain the fit.
    let anything = OutlinePrior {
        radius_px: Measured::new(RADIUS_PX, 0.03 * RADIUS_PX),
        flatness: 0.003,
    };
    let known = KnownOutline {
        possible: anything,
        stated: anything,
    };
    let background = Background::even(frame.region(), levels.background_dn);
    let noise = PixelNoise::even(levels.noise_dn);
    let cutout = Cutout::new(&frame, frame.region(), &background, noise);
    let fit = LimbFit {
        cutout: &cutout,
        disc_dn: levels.disc_dn - levels.background_dn,
        blur_px: 0.95,
        known,
        settings: &settings,
    };
    let limb = fit
        .near(&fit.rough(&start).unwrap(), &Mask::none(frame.region()))
        .unwrap();
    let disc = limb.outline.ellipse;
    let (dx, dy) = (disc.centre.x - CENTRE_PX.0, disc.centre.y - CENTRE_PX.1);
    println!(
        "centre off by ({dx:.4}, {dy:.4}) px, radius {:.3} px, root {:?}, blur {:.2} px, scatter {:.2}, {} points, sigma {:.4} px",
        disc.mean_radius(),
        disc.root(),
        limb.light.blur_px(),
        limb.outline.scatter,
        limb.points.len(),
        limb.outline.centre_covariance().m11.sqrt(),
    );
    assert!(dx.hypot(dy) < 0.03);
    assert!((disc.mean_radius() - RADIUS_PX).abs() < 0.3);
}

/// The limb of a simulated frame, measured by the pipeline before any mark is known.
fn limb_under(change: impl Fn(&mut Conditions), seed: u64) -> (Limb, Quality) {
    let instrument = builtin("demo").unwrap();
    let mut conditions = Conditions::of(&instrument);
    change(&mut conditions);
    let scenes = RandomScenes::new(&instrument, &conditions, seed).unwrap();
    let frame = scenes.scene(seed).unwrap().frame().unwrap();
    let expected = Some(Expected {
        radius_arcsec: SUN_RADIUS_ARCSEC,
    });
    let settings = aspect::SolverSettings::default();
    let pipeline = Pipeline::new(&settings, &instrument, expected);
    let levels = pipeline.levels(&frame).unwrap();
    let disc = pipeline.find_disc(&frame, &levels, None).unwrap();
    let image = pipeline.image(&frame, &levels, &disc).unwrap();
    let limb = pipeline.limb(&image, &image.cutout.mask).unwrap();
    (
        limb,
        aspect::solve(&frame, &instrument, expected, None).quality,
    )
}

#[test]
fn the_motion_of_the_sun_during_the_exposure_is_measured() {
    for (seed, motion_px) in [2.0, 2.5, 3.0, 4.0, 5.0].into_iter().enumerate() {
        let (limb, _) = limb_under(|conditions| conditions.smear_px = motion_px, seed as u64);
        let found_px = limb.light.motion_px();
        assert!(
            (found_px - motion_px).abs() < 0.12 * motion_px + 0.2,
            "{motion_px}: {found_px}"
        );
        let lens_px = limb.light.lens_blur_px();
        assert!(
            (lens_px - 0.9).abs() < 0.12 * motion_px,
            "{motion_px}: {lens_px}"
        );
    }
}

#[test]
fn a_sun_that_moved_far_during_the_exposure_is_never_fine() {
    for (seed, motion_px) in [7.0, 12.0, 20.0, 30.0].into_iter().enumerate() {
        let (_, quality) = limb_under(|conditions| conditions.smear_px = motion_px, seed as u64);
        assert_ne!(quality, Quality::Fine, "{motion_px}");
    }
}

#[test]
fn a_soft_picture_is_not_taken_for_motion() {
    for (seed, blur_px) in [1.5, 2.5, 3.5].into_iter().enumerate() {
        let (limb, _) = limb_under(|conditions| conditions.blur_px = blur_px, seed as u64);
        let found_px = limb.light.lens_blur_px();
        assert!(
            (found_px / blur_px - 1.0).abs() < 0.08,
            "{blur_px}: {found_px}"
        );
        assert!(
            limb.light.motion_px() < 0.8 * blur_px,
            "{blur_px}: {}",
            limb.light.motion_px()
        );
    }
}

#[test]
fn the_noise_of_photons_is_separated_from_that_of_reading() {
    let photons = |conditions: &mut Conditions| {
        conditions.noise = Noise {
            read_dn: 1.0,
            electrons_per_dn: Some(8.0),
        };
    };
    let noise = limb_under(photons, 5).0.light.noise();
    assert!(
        (noise.dark_dn2 / (1.0 + 4.0 / 8.0 + 1.0 / 12.0) - 1.0).abs() < 0.2,
        "{noise:?}"
    );
    assert!((noise.per_light_dn * 8.0 - 1.0).abs() < 0.2, "{noise:?}");
}
