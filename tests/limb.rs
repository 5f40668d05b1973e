//! The limb of a real Sun is found where its own header says it is.

use solaspect::fits;
use solaspect::frame::{Background, Cutout, Mask, PixelNoise};
use solaspect::geometry::Ellipse;
use solaspect::limb::{self, DiscSearch, KnownOutline, LimbFit, OutlinePrior, Settings};
use solaspect::units::Measured;
use std::path::Path;

/// Centre (first pixel 0) and radius as the header of HMI's picture states them; see tests/data/hmi/README.md.
const CENTRE_PX: (f64, f64) = (255.5, 255.5);
const RADIUS_PX: f64 = 202.910;

#[test]
fn the_sun_of_hmi_is_found_where_its_header_says() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/hmi/continuum.fits");
    let frame = fits::read_frame(&path).unwrap();
    let settings = Settings::default();
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
    // Neither radius nor roundness is given: 3 % and 0.3 % decide nothing here.
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
    let limb = fit.near(&start, &Mask::none(frame.region())).unwrap();
    let disc = limb.outline.ellipse;
    let (dx, dy) = (disc.centre.x - CENTRE_PX.0, disc.centre.y - CENTRE_PX.1);
    println!(
        "centre off by ({dx:.4}, {dy:.4}) px, radius {:.3} px, root {:?}, blur {:.2} px, scatter {:.2}, {} points, sigma {:.4} px",
        disc.mean_radius(),
        disc.root(),
        limb.blur_px(),
        limb.outline.scatter,
        limb.points.len(),
        limb.outline.centre_covariance().m11.sqrt(),
    );
    assert!(dx.hypot(dy) < 0.03);
    assert!((disc.mean_radius() - RADIUS_PX).abs() < 0.3);
}
