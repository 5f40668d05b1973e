//! The columns of the history: `aspect.fits`, `aspect.csv`, `stabilisation.fits` and the manual's page are made from these tables.

use super::row::{RefinedRow, SkyRow};
use super::stabilisation::{StabilisationRow, StableOffset};
use super::times::TIME_SIGMA;
use crate::clock::utc_microseconds;
use crate::columns::{Column, float, integer, logical, text};
use crate::pointing::body_roll_deg;
use crate::smoothing::PathPoint;
use crate::units::{Estimate, Measured, PlateMil};

fn sky(row: &RefinedRow, value: fn(&SkyRow) -> Option<f64>) -> Option<f64> {
    row.sky.as_ref().and_then(value)
}

fn own_sun(row: &RefinedRow) -> Option<Estimate<PlateMil>> {
    Some(row.own.as_ref()?.disc.as_ref()?.on_plate())
}

fn own_px(row: &RefinedRow) -> Option<[f64; 2]> {
    Some(row.own.as_ref()?.disc.as_ref()?.centre_px)
}

/// Sensor position of the plate's centre along an axis.
fn centre(row: &RefinedRow, axis: usize) -> Option<Measured> {
    Some(row.mapping?.centre_px[axis])
}

fn body_roll(row: &RefinedRow) -> Option<Measured> {
    Some(body_roll_deg(row.body_nadir.as_ref()?))
}

/// The extension with a row for every input file.
pub const ASPECT: &str = "ASPECT";

/// The columns of [`ASPECT`].
#[rustfmt::skip]
pub const ASPECT_COLUMNS: &[Column<RefinedRow>] = &[
    text("FILE", "the frame's file, relative to the archive", |r| r.file.as_str().into()),
    text("UTC", "mid-exposure, UTC, ISO 8601", |r| r.utc().map_or(String::new(), utc_microseconds).into()),
    float("UNIX_S", "s", "mid-exposure, UTC, since 1970-01-01", |r| r.unix_s()),
    float("UTC_CORRECTION_S", "s", "correction that was added to the header's time, if any", |r| Some(r.timing.correction_s?.value)),
    float("UTC_CORRECTION_SIGMA_S", "s", "1 sigma of UTC_CORRECTION_S", |r| Some(r.timing.correction_s?.sigma)),
    float("UTC_SIGMA_S", "s", TIME_SIGMA, |r| r.timing.sigma_s),
    float("MONO_S", "s", "mid-exposure on the monotonic clock", |r| r.own.as_ref()?.facts.monotonic_s),
    integer("FRAMENUM", "number of the frame", |r| r.own.as_ref()?.facts.number.map(|number| number as i64)),
    float("SUN_X_MIL", "mil", "the Sun's centre on the plate, unsmoothed", |r| Some(r.sun?.position.x)),
    float("SUN_Y_MIL", "mil", "the Sun's centre on the plate, unsmoothed", |r| Some(r.sun?.position.y)),
    float("SIGMA_X_MIL", "mil", "1 sigma of SUN_X_MIL, of limb and mapping together", |r| Some(r.sun?.sigma()[0])),
    float("SIGMA_Y_MIL", "mil", "1 sigma of SUN_Y_MIL, of limb and mapping together", |r| Some(r.sun?.sigma()[1])),
    float("COV_XY_MIL2", "mil2", "covariance of SUN_X_MIL and SUN_Y_MIL", |r| Some(r.sun?.covariance.m12)),
    text("QUALITY", "fine, coarse or none", |r| r.quality.name().into()),
    text("REASON", "why the frame is not fine, or why it is flagged; empty for the others", |r| r.reason().into()),
    integer("NMARKS", "marks that were read", |r| Some(r.own.as_ref()?.marks.len() as i64)),
    float("LIMB_PART", "", "visible part of the limb, 0 to 1", |r| r.limb_part),
    float("RADIUS_MIL", "mil", "the disc's radius on the plate", |r| Some(r.disc?.radius_mil.value)),
    float("RADIUS_SIGMA_MIL", "mil", "1 sigma of RADIUS_MIL, by the points of the limb", |r| Some(r.disc?.radius_mil.sigma)),
    float("RADIUS_EXPECTED_MIL", "mil", "the radius by ephemeris and plate distance", |r| r.expected_radius_mil),
    float("OFFSET_AZ_DEG", "deg", "azimuth, pointing minus target", |r| sky(r, |s| Some(s.offset_deg?[0]))),
    float("OFFSET_EL_DEG", "deg", "elevation, pointing minus target", |r| sky(r, |s| Some(s.offset_deg?[1]))),
    float("OFFSET_XEL_DEG", "deg", "true angle across, pointing from target, to larger azimuth", |r| sky(r, |s| Some(s.offset_deg?[2]))),
    float("OFFSET_SIGMA_DEG", "deg", "1 sigma per axis of true angle, of this frame", |r| sky(r, |s| Some(s.sigma_deg?[0]))),
    float("OFFSET_CAL_SIGMA_DEG", "deg", "the same of the calibration, alike in all frames", |r| sky(r, |s| Some(s.sigma_deg?[1]))),
    float("POINTING_AZ_DEG", "deg", "azimuth of the telescope, from north through east", |r| sky(r, |s| Some(s.azimuth_deg))),
    float("POINTING_EL_DEG", "deg", "elevation of the telescope, without refraction", |r| sky(r, |s| Some(s.elevation_deg))),
    float("BORESIGHT_HPLN_ARCSEC", "arcsec", "helioprojective longitude of the boresight, to solar west", |r| sky(r, |s| Some(s.helioprojective_arcsec[0]))),
    float("BORESIGHT_HPLT_ARCSEC", "arcsec", "helioprojective latitude of the boresight, to solar north", |r| sky(r, |s| Some(s.helioprojective_arcsec[1]))),
    float("TELESCOPE_ROLL_DEG", "deg", "roll about the boresight that the offsets rest on: by the horizon where it was seen, else as stated", |r| sky(r, |s| Some(s.roll_deg.value))),
    float("TELESCOPE_ROLL_SIGMA_DEG", "deg", "1 sigma of TELESCOPE_ROLL_DEG", |r| sky(r, |s| Some(s.roll_deg.sigma))),
    float("BODY_ROLL_DEG", "deg", "roll of the body by the horizon, smoothed, right side low positive", |r| Some(body_roll(r)?.value)),
    float("BODY_ROLL_SIGMA_DEG", "deg", "1 sigma of BODY_ROLL_DEG", |r| Some(body_roll(r)?.sigma)),
    float("SUN_AZ_DEG", "deg", "azimuth of the Sun", |r| sky(r, |s| Some(s.sun_azimuth_deg))),
    float("SUN_EL_DEG", "deg", "elevation of the Sun, without refraction", |r| sky(r, |s| Some(s.sun_elevation_deg))),
    float("CENTRE_X_PX", "pixel", "the plate's centre by the flight's mapping, first pixel is 0", |r| Some(centre(r, 0)?.value)),
    float("CENTRE_SIGMA_X_PX", "pixel", "1 sigma of CENTRE_X_PX", |r| Some(centre(r, 0)?.sigma)),
    float("CENTRE_Y_PX", "pixel", "the plate's centre by the flight's mapping, first pixel is 0", |r| Some(centre(r, 1)?.value)),
    float("CENTRE_SIGMA_Y_PX", "pixel", "1 sigma of CENTRE_Y_PX", |r| Some(centre(r, 1)?.sigma)),
    float("ROTATION_DEG", "deg", "rotation of the flight's mapping at the plate's centre, from +x towards +y", |r| Some(r.mapping?.there.rotation_deg.value)),
    float("ROTATION_SIGMA_DEG", "deg", "1 sigma of ROTATION_DEG", |r| Some(r.mapping?.there.rotation_deg.sigma)),
    float("SCALE_MIL_PER_PX", "mil/pixel", "scale of the flight's mapping at the plate's centre", |r| Some(r.mapping?.there.scale_mil_per_px.value)),
    float("SCALE_SIGMA_MIL_PER_PX", "mil/pixel", "1 sigma of SCALE_MIL_PER_PX", |r| Some(r.mapping?.there.scale_mil_per_px.sigma)),
    float("JUMP_PX", "pixel", "size of the mapping's jump at this frame", |r| r.jump_px),
    float("TEMPERATURE_C", "degC", "temperature of the camera", |r| r.own.as_ref()?.facts.temperature_c),
    text("OWN_QUALITY", "quality of the frame by itself: fine, coarse or none", |r| r.own_quality().name().into()),
    float("OWN_X_MIL", "mil", "the Sun on the plate by this frame alone", |r| Some(own_sun(r)?.position.x)),
    float("OWN_Y_MIL", "mil", "the Sun on the plate by this frame alone", |r| Some(own_sun(r)?.position.y)),
    float("OWN_SIGMA_X_MIL", "mil", "1 sigma of OWN_X_MIL", |r| Some(own_sun(r)?.sigma()[0])),
    float("OWN_SIGMA_Y_MIL", "mil", "1 sigma of OWN_Y_MIL", |r| Some(own_sun(r)?.sigma()[1])),
    float("SUN_X_PX", "pixel", "the disc's centre on the sensor by this frame alone, first pixel is 0", |r| Some(own_px(r)?[0])),
    float("SUN_Y_PX", "pixel", "the disc's centre on the sensor by this frame alone, first pixel is 0", |r| Some(own_px(r)?[1])),
    float("FLIGHT_X_MIL", "mil", "SUNMIL-X of the header: the solution in flight", |r| Some(r.own.as_ref()?.in_flight.sun_mil?[0])),
    float("FLIGHT_Y_MIL", "mil", "SUNMIL-Y of the header: the solution in flight", |r| Some(r.own.as_ref()?.in_flight.sun_mil?[1])),
    float("FLIGHT_SIGMA_X_MIL", "mil", "SUNMILSX of the header", |r| Some(r.own.as_ref()?.in_flight.sigma_mil?[0])),
    float("FLIGHT_SIGMA_Y_MIL", "mil", "SUNMILSY of the header", |r| Some(r.own.as_ref()?.in_flight.sigma_mil?[1])),
    float("FLIGHT_OFFSET_AZ_DEG", "deg", "OFFSETAZ of the header, or CTL_AZIM of HEROES", |r| Some(r.own.as_ref()?.in_flight.offset_deg?[0])),
    float("FLIGHT_OFFSET_EL_DEG", "deg", "OFFSETEL of the header, or CTL_ELEV of HEROES", |r| Some(r.own.as_ref()?.in_flight.offset_deg?[1])),
    float("FLIGHT_ROLL_DEG", "deg", "BODYROLL of the header: the body's roll in flight", |r| Some(r.own.as_ref()?.in_flight.roll_deg?[0])),
    float("FLIGHT_ROLL_SIGMA_DEG", "deg", "BODYRLSG of the header", |r| Some(r.own.as_ref()?.in_flight.roll_deg?[1])),
    text("FLIGHT_QUALITY", "QUALITY of the header", |r| r.own.as_ref().and_then(|own| own.in_flight.quality.as_deref()).unwrap_or_default().into()),
];

/// The extension with the smoothed path: at every frame that has a time, and half-way between two.
pub const SMOOTHED: &str = "SMOOTHED";

/// A moment of the smoothed path: s since 1970, and its point, none where the gap between frames is too long.
type Smoothed<'a> = (f64, Option<&'a PathPoint>);

/// The columns of [`SMOOTHED`].
#[rustfmt::skip]
pub const fn smoothed_columns<'a>() -> [Column<Smoothed<'a>>; 7] {
    [
        float("UNIX_S", "s", "time, UTC, since 1970-01-01", |r| Some(r.0)),
        float("SUN_X_MIL", "mil", "the Sun's centre on the plate, smoothed", |r| Some(r.1?.place[0])),
        float("SUN_Y_MIL", "mil", "the Sun's centre on the plate, smoothed", |r| Some(r.1?.place[1])),
        float("SIGMA_X_MIL", "mil", "1 sigma of SUN_X_MIL", |r| Some(r.1?.variance[0].sqrt())),
        float("SIGMA_Y_MIL", "mil", "1 sigma of SUN_Y_MIL", |r| Some(r.1?.variance[1].sqrt())),
        float("SPEED_X_MIL_PER_S", "mil/s", "speed of the Sun's centre on the plate", |r| Some(r.1?.speed[0])),
        float("SPEED_Y_MIL_PER_S", "mil/s", "speed of the Sun's centre on the plate", |r| Some(r.1?.speed[1])),
    ]
}

/// The extension with the telescope's offset at a constant rate.
pub const STABILISATION: &str = "STABILISATION";

fn offset(row: &StabilisationRow, value: fn(&StableOffset) -> f64) -> Option<f64> {
    row.offset.as_ref().map(value)
}

/// The columns of [`STABILISATION`].
#[rustfmt::skip]
pub const STABILISATION_COLUMNS: &[Column<StabilisationRow>] = &[
    float("UNIX_S", "s", "time, UTC, since 1970-01-01", |r| Some(r.unix_s)),
    float("OFFSET_AZ_DEG", "deg", "azimuth, pointing minus target", |r| offset(r, |o| o.difference.azimuth_deg)),
    float("OFFSET_EL_DEG", "deg", "elevation, pointing minus target", |r| offset(r, |o| o.difference.elevation_deg)),
    float("OFFSET_XEL_DEG", "deg", "true angle across, pointing from target, to larger azimuth", |r| offset(r, |o| o.difference.cross_elevation_deg)),
    float("VAR_XEL_DEG2", "deg2", "variance across, random part", |r| offset(r, |o| o.covariance_deg2[(0, 0)])),
    float("VAR_EL_DEG2", "deg2", "variance in elevation, random part", |r| offset(r, |o| o.covariance_deg2[(1, 1)])),
    float("COV_XEL_EL_DEG2", "deg2", "covariance of OFFSET_XEL_DEG and OFFSET_EL_DEG", |r| offset(r, |o| o.covariance_deg2[(0, 1)])),
    logical("VALID", "whether the offset is known, and no camera contradicts the gyros", |r| r.is_valid),
];

#[cfg(test)]
mod tests {
    use super::super::roll::{ROLL, ROLL_COLUMNS};
    use super::*;
    use crate::columns::markdown;
    use crate::pointing_history::{POINTING, POINTING_COLUMNS};

    /// With SOLASPECT_WRITE_DOCS set, writes the page's tables instead.
    #[test]
    fn the_page_of_columns_is_that_of_the_tables() {
        let tables = format!(
            "### {ASPECT}\n\n{}\n### {SMOOTHED}\n\n{}\n### {POINTING}\n\n{}\n### {STABILISATION}\n\n{}\n### {ROLL}\n\n{}",
            markdown(ASPECT_COLUMNS),
            markdown(&smoothed_columns()),
            markdown(POINTING_COLUMNS),
            markdown(STABILISATION_COLUMNS),
            markdown(ROLL_COLUMNS)
        );
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/refine-reference.md");
        let page = std::fs::read_to_string(path).unwrap();
        let (before, rest) = page.split_once(&format!("### {ASPECT}\n")).unwrap();
        let after = rest.find("\n## ").map_or("", |at| &rest[at..]);
        let wanted = format!("{before}{tables}{after}");
        if std::env::var_os("SOLASPECT_WRITE_DOCS").is_some() {
            std::fs::write(path, &wanted).unwrap();
        } else {
            let advice = "docs/refine-reference.md has other columns: run this test with SOLASPECT_WRITE_DOCS=1";
            assert!(page == wanted, "{advice}");
        }
    }

    #[test]
    fn names_differ_and_are_as_fits_wants_them() {
        let names = ASPECT_COLUMNS.iter().map(|column| column.name);
        let mut names: Vec<&str> = names.collect();
        let all = names.len();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), all);
        let legal = |b: u8| b.is_ascii_uppercase() || b.is_ascii_digit() || b == b'_';
        assert!(names.iter().all(|name| name.bytes().all(legal)));
    }
}
