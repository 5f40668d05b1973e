//! Decides which quantities the observations determine.

use super::fit::{DISTINGUISHED, MountingFit, Pointings, Unknown};
use super::observation::MountingError;
use crate::calibrate::numbers::sigma_text;
use crate::calibrate::quantity::{CalibratedQuantity, Verdict};
use crate::instrument::{Directions, Instrument};
use crate::units::{ARCSEC_PER_RAD, MIL_MM, Measured};

/// A quantity with a larger sigma is not determined; the distance's sigma is relative.
const MOST_CENTRE_MIL: f64 = 5.0;
const MOST_CLOCKING_DEG: f64 = 0.3;
const MOST_DISTANCE: f64 = 0.005;
/// A stated value that differs from the found one by this many sigmas is wrong, however small its sigma.
const CONTRADICTED_SIGMAS: f64 = 4.0;

/// Whether the observations distinguish the plate from its mirror image.
///
/// # Errors
/// If they agree with the mirror image only.
pub(super) fn mirror(
    straight: &MountingFit,
    mirrored: Option<&MountingFit>,
) -> Result<CalibratedQuantity, MountingError> {
    const NAME: &str = "mirror (side of the plate)";
    let determined = |why: String| {
        let remark = format!("determined: as stated; mirrored, {why}");
        CalibratedQuantity::without_value(NAME, Verdict::Determined, remark)
    };
    let Some(mirrored) = mirrored else {
        return Ok(determined("the observations agree with no mounting".into()));
    };
    let difference = straight.chi2_gain(mirrored);
    if difference < -DISTINGUISHED {
        return Err(MountingError::Mirrored {
            for_it: format!("{:.2}", mirrored.scatter_mil),
            against: format!("{:.2}", straight.scatter_mil),
        });
    }
    if difference < DISTINGUISHED {
        let remark = "not determined: the Sun's path is too straight to distinguish it from its mirror image; keeps the \
                      instrument's. Scan at another hour or in another season, or take frames with known pointing all over \
                      the plate";
        return Ok(CalibratedQuantity::without_value(
            NAME,
            Verdict::Kept,
            remark,
        ));
    }
    let times = mirrored.scatter_mil / straight.scatter_mil;
    Ok(determined(format!(
        "the observations would scatter {times:.1} times as much"
    )))
}

/// Every quantity with its verdict.
pub(super) fn quantities(
    fit: &MountingFit,
    distinguished: [CalibratedQuantity; 2],
    stated: &Instrument,
) -> Vec<CalibratedQuantity> {
    let fitted = [
        centre(fit, stated),
        clocking(fit, stated),
        distance(fit, stated),
    ];
    fitted
        .into_iter()
        .chain(distinguished)
        .chain(pointing(fit))
        .collect()
}

fn centre(fit: &MountingFit, stated: &Instrument) -> CalibratedQuantity {
    let mounting = &stated.mounting;
    let at = mounting.boresight_mil;
    let sigma = (fit.centre_covariance().trace() / 2.0).max(0.0).sqrt();
    let found = vec![fit.values[0], fit.values[1]];
    let apart = (found[0] - at.x).hypot(found[1] - at.y);
    let (verdict, remark) = match fit.pointings {
        Pointings::Fixed => (Verdict::Kept, scan_remark(fit, apart, sigma)),
        Pointings::Known => {
            let arcsec = sigma * stated.optics.arcsec_per_mil();
            let to = format!("{} mil ({} arcsec)", sigma_text(sigma), sigma_text(arcsec));
            let apart = Measured::new(apart, mounting.boresight_sigma_mil);
            judge(sigma, MOST_CENTRE_MIL, apart, &to)
        }
    };
    CalibratedQuantity {
        key: Some("mounting.boresight_mil"),
        unit: "mil",
        stated: vec![at.x, at.y],
        found,
        sigma,
        ..CalibratedQuantity::without_value("centre (boresight on the plate)", verdict, remark)
    }
}

/// The reason why a scan does not determine the centre.
fn scan_remark(fit: &MountingFit, apart_mil: f64, sigma_mil: f64) -> String {
    let why = "not determined: with the pointing unknown, a shift of the centre and a turn of the telescope are degenerate; keeps \
               the instrument's value. Take frames with known pointing to measure it";
    match fit.directions {
        Directions::Telescope => why.into(),
        Directions::Sun2013 => format!(
            "{why}. (Only how the zenith's direction turns along the scan distinguishes them, and that puts the centre \
             {apart_mil:.1} mil from the stated one, with a sigma of {sigma_mil:.1} mil)"
        ),
    }
}

/// The direction convention with its verdict. `other` is the fit with the other convention.
pub(super) fn directions(fit: &MountingFit, other: Option<&MountingFit>) -> CalibratedQuantity {
    const NAME: &str = "directions on the plate";
    let rule = fit.directions.name();
    let determined = |why: String| {
        let remark = format!("determined: counted by the rule \"{rule}\"; by the other, {why}");
        CalibratedQuantity::without_value(NAME, Verdict::Determined, remark)
    };
    let Some(other) = other else {
        return determined("the observations agree with no mounting".into());
    };
    if fit.chi2_gain(other) <= DISTINGUISHED {
        let remark = format!(
            "not determined: the rules \"telescope\" and \"sun-2013\" fit the observations equally well; keeps the instrument's, \"{rule}\". Take \
             frames with known pointing half a degree and more to each side of the Sun"
        );
        return CalibratedQuantity::without_value(NAME, Verdict::Kept, remark);
    }
    let times = other.scatter_mil / fit.scatter_mil;
    determined(format!(
        "the observations would scatter {times:.1} times as much"
    ))
}

fn clocking(fit: &MountingFit, stated: &Instrument) -> CalibratedQuantity {
    let name = ("clocking", "mounting.clocking_deg", "deg");
    let mounting = &stated.mounting;
    let mut clocking = single(
        fit,
        Unknown::Clocking,
        name,
        mounting.clocking_deg,
        MOST_CLOCKING_DEG,
    );
    if fit.directions == Directions::Telescope {
        let roll_deg = mounting.roll_deg.value;
        clocking.remark += &format!(
            "; it holds for the stated roll of {roll_deg} deg, whose error enters it one to one"
        );
    }
    clocking
}

fn distance(fit: &MountingFit, stated: &Instrument) -> CalibratedQuantity {
    let key = "optics.plate_distance_mm";
    let name = ("plate's distance from the lens", key, "mm");
    let stated = stated.optics.plate_distance_mm;
    let limit = MOST_DISTANCE * stated.value;
    let mut distance = single(fit, Unknown::Distance, name, stated, limit);
    let scale = MIL_MM / distance.found[0] * ARCSEC_PER_RAD;
    distance.remark += &format!(" ({scale:.5} arcsec per mil)");
    distance
}

fn single(
    fit: &MountingFit,
    unknown: Unknown,
    (name, key, unit): (&'static str, &'static str, &'static str),
    stated: Measured,
    limit: f64,
) -> CalibratedQuantity {
    let found = fit.measured(unknown);
    let found = found.unwrap_or(Measured::new(stated.value, f64::INFINITY));
    let apart = Measured::new((found.value - stated.value).abs(), stated.sigma);
    let to = format!("{} {unit}", sigma_text(found.sigma));
    let (verdict, remark) = judge(found.sigma, limit, apart, &to);
    CalibratedQuantity {
        key: Some(key),
        unit,
        stated: vec![stated.value],
        found: vec![found.value],
        sigma: found.sigma,
        ..CalibratedQuantity::without_value(name, verdict, remark)
    }
}

/// The found value is adopted if its sigma is within the limit, and is below the stated sigma or the two values contradict each other.
/// `apart` is the distance of found and stated values, with the stated sigma.
fn judge(sigma: f64, limit: f64, apart: Measured, to: &str) -> (Verdict, String) {
    if sigma.is_nan() || sigma > limit {
        let remark = format!("not determined (only to {to}): keeps the instrument's value");
        return (Verdict::Kept, remark);
    }
    let contradicts = apart.value > CONTRADICTED_SIGMAS * sigma.hypot(apart.sigma);
    if apart.sigma > 0.0 && sigma > apart.sigma && !contradicts {
        let remark =
            format!("determined to {to}, no better than is stated: keeps the instrument's value");
        return (Verdict::Kept, remark);
    }
    (Verdict::Determined, format!("determined to {to}"))
}

/// A fixed telescope's direction for the fitted centre; it is not written to the file.
fn pointing(fit: &MountingFit) -> Option<CalibratedQuantity> {
    let azimuth = fit.measured(Unknown::Azimuth)?;
    let elevation = fit.measured(Unknown::Elevation)?;
    let remark = "fitted beside the centre, with which it moves";
    Some(CalibratedQuantity {
        unit: "deg",
        found: vec![azimuth.value, elevation.value],
        sigma: azimuth.sigma.max(elevation.sigma),
        ..CalibratedQuantity::without_value(
            "telescope's azimuth and elevation",
            Verdict::Kept,
            remark,
        )
    })
}
