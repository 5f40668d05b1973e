//! What the sights determine, and what they do not.

use super::chain::Chain;
use super::fit::{DISTINGUISHED, MountingFit, Pointings, Unknown};
use super::observation::MountingError;
use crate::calibrate::numbers::sigma_text;
use crate::calibrate::revision::{Provenance, Revision};
use crate::instrument::Instrument;
use crate::units::{ARCSEC_PER_RAD, MIL_MM, Measured};

/// Sigmas beyond which a quantity counts as not determined.
const MOST_CENTRE_MIL: f64 = 5.0;
const MOST_CLOCKING_DEG: f64 = 0.3;
const MOST_DISTANCE: f64 = 0.005;
/// A stated value that is so many sigmas away from the found one is wrong, however small its sigma.
const CONTRADICTED_SIGMAS: f64 = 4.0;

/// Whether a quantity is determined.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// The new instrument takes the found value.
    Determined,
    /// The new instrument keeps the stated value.
    Kept,
}

/// One quantity: what was stated, what was found, what holds from now on.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    pub name: &'static str,
    /// Dotted key of the instrument's file; none for what is no value there.
    pub key: Option<&'static str>,
    pub unit: &'static str,
    pub stated: Vec<f64>,
    pub stated_sigma: f64,
    pub found: Vec<f64>,
    pub sigma: f64,
    pub verdict: Verdict,
    /// For people, in one sentence.
    pub remark: String,
}

impl Finding {
    pub(super) fn revise(&self, revision: &mut Revision, provenance: &Provenance) {
        let (Some(key), Verdict::Determined) = (self.key, self.verdict) else {
            return;
        };
        match self.found[..] {
            [value] => revision.set_measured(key, Measured::new(value, self.sigma), provenance),
            [x, y] => revision.set_pair(key, [x, y], self.sigma, provenance),
            _ => {}
        }
    }
}

/// What the comparison with the mirrored plate says.
pub(super) enum Mirror {
    Told { times: f64 },
    NotTold,
}

/// Whether the sights know the plate from its mirror image.
pub(super) fn mirror(
    straight: &MountingFit,
    mirrored: Option<&MountingFit>,
) -> Result<Mirror, MountingError> {
    let Some(mirrored) = mirrored else {
        return Ok(Mirror::Told {
            times: f64::INFINITY,
        });
    };
    let difference = straight.advantage(mirrored);
    if difference < -DISTINGUISHED {
        return Err(MountingError::Mirrored {
            for_it: format!("{:.2}", mirrored.scatter_mil),
            against: format!("{:.2}", straight.scatter_mil),
        });
    }
    if difference < DISTINGUISHED {
        return Ok(Mirror::NotTold);
    }
    let times = mirrored.scatter_mil / straight.scatter_mil;
    Ok(Mirror::Told { times })
}

/// Every quantity's finding.
pub(super) fn findings(fit: &MountingFit, mirror: Mirror, stated: &Instrument) -> Vec<Finding> {
    let mut findings = vec![
        centre(fit, stated),
        clocking(fit, stated),
        distance(fit, stated),
    ];
    findings.push(mirror_finding(mirror));
    findings.extend(pointing(fit));
    findings.extend(chain(fit));
    findings
}

fn centre(fit: &MountingFit, stated: &Instrument) -> Finding {
    let mounting = &stated.mounting;
    let at = mounting.boresight_mil;
    let sigma = (fit.centre_covariance().trace() / 2.0).max(0.0).sqrt();
    let found = vec![fit.values[0], fit.values[1]];
    let apart = (found[0] - at.x).hypot(found[1] - at.y);
    let arcsec = |mil: f64| mil * stated.optics.arcsec_per_mil();
    let (verdict, remark) = match fit.pointings {
        Pointings::Fixed => (Verdict::Kept, scan_remark(fit, apart, sigma)),
        Pointings::Known => judge(
            sigma,
            MOST_CENTRE_MIL,
            Measured::new(apart, mounting.boresight_sigma_mil),
            &format!(
                "{} mil ({} arcsec)",
                sigma_text(sigma),
                sigma_text(arcsec(sigma))
            ),
        ),
    };
    Finding {
        name: "centre (boresight on the plate)",
        key: Some("mounting.boresight_mil"),
        unit: "mil",
        stated: vec![at.x, at.y],
        stated_sigma: mounting.boresight_sigma_mil,
        found,
        sigma,
        verdict,
        remark,
    }
}

/// Why a scan does not tell the centre.
fn scan_remark(fit: &MountingFit, apart_mil: f64, sigma_mil: f64) -> String {
    let why = "not determined: with the pointing unknown, moving the centre and turning the telescope look alike; keeps the \
               instrument's value. Take frames with known pointing to measure it";
    match fit.chain {
        Chain::AtTelescope => why.into(),
        Chain::AtSun => format!(
            "{why}. (Only how the zenith's direction turns along the scan tells them apart, and that puts the centre \
             {apart_mil:.1} mil from the stated one, with a sigma of {sigma_mil:.1} mil)"
        ),
    }
}

/// Where the sights contradict the chain that the pointing uses.
fn chain(fit: &MountingFit) -> Option<Finding> {
    let remark = match fit.chain {
        Chain::AtSun => return None,
        Chain::AtTelescope => {
            "the sights are those of a plate rigid in the gondola: directions count from the zenith at the telescope. The \
             pointing counts them at the Sun; the two agree at the boresight, and at an angle a beside it differ by about \
             a^2 tan(elevation). The quantities above hold for both"
        }
    };
    Some(Finding {
        name: "directions on the plate",
        key: None,
        unit: "",
        stated: Vec::new(),
        stated_sigma: 0.0,
        found: Vec::new(),
        sigma: 0.0,
        verdict: Verdict::Kept,
        remark: remark.into(),
    })
}

fn clocking(fit: &MountingFit, stated: &Instrument) -> Finding {
    let of = stated.mounting.clocking_deg;
    single(
        fit,
        Unknown::Clocking,
        ("clocking", "mounting.clocking_deg", "deg"),
        of,
        MOST_CLOCKING_DEG,
    )
}

fn distance(fit: &MountingFit, stated: &Instrument) -> Finding {
    let of = stated.optics.plate_distance_mm;
    let limit = MOST_DISTANCE * of.value;
    let key = "optics.plate_distance_mm";
    let mut finding = single(
        fit,
        Unknown::Distance,
        ("plate's distance from the lens", key, "mm"),
        of,
        limit,
    );
    if let Some(found) = finding.found.first() {
        let scale = MIL_MM / found * ARCSEC_PER_RAD;
        finding.remark += &format!(" ({scale:.5} arcsec per mil)");
    }
    finding
}

fn single(
    fit: &MountingFit,
    unknown: Unknown,
    (name, key, unit): (&'static str, &'static str, &'static str),
    stated: Measured,
    limit: f64,
) -> Finding {
    let found = fit
        .measured(unknown)
        .unwrap_or(Measured::new(stated.value, f64::INFINITY));
    let apart = Measured::new((found.value - stated.value).abs(), stated.sigma);
    let (verdict, remark) = judge(
        found.sigma,
        limit,
        apart,
        &format!("{} {unit}", sigma_text(found.sigma)),
    );
    Finding {
        name,
        key: Some(key),
        unit,
        stated: vec![stated.value],
        stated_sigma: stated.sigma,
        found: vec![found.value],
        sigma: found.sigma,
        verdict,
        remark,
    }
}

/// A quantity is taken over where its sigma is within the limit, and either below what is stated or in contradiction to it.
/// `apart` is how far found and stated values are, with the stated sigma.
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

fn mirror_finding(mirror: Mirror) -> Finding {
    let (verdict, remark) = match mirror {
        Mirror::Told { times } if times.is_finite() => (
            Verdict::Determined,
            format!("determined: as stated; mirrored, the sights would scatter {times:.1} times as much"),
        ),
        Mirror::Told { .. } => (
            Verdict::Determined,
            "determined: as stated; mirrored, the sights fit nothing".into(),
        ),
        Mirror::NotTold => (
            Verdict::Kept,
            "not determined: the Sun's path is too straight to know it from its mirror image; keeps the instrument's. \
             Scan at another hour or in another season, or take frames with known pointing all over the plate"
                .into(),
        ),
    };
    Finding {
        name: "mirror (side of the plate)",
        key: None,
        unit: "",
        stated: Vec::new(),
        stated_sigma: 0.0,
        found: Vec::new(),
        sigma: 0.0,
        verdict,
        remark,
    }
}

/// A fixed telescope's direction goes with the centre that was fitted; it is told, and stands in no file.
fn pointing(fit: &MountingFit) -> Option<Finding> {
    let azimuth = fit.measured(Unknown::Azimuth)?;
    let elevation = fit.measured(Unknown::Elevation)?;
    Some(Finding {
        name: "telescope's azimuth and elevation",
        key: None,
        unit: "deg",
        stated: Vec::new(),
        stated_sigma: 0.0,
        found: vec![azimuth.value, elevation.value],
        sigma: azimuth.sigma.max(elevation.sigma),
        verdict: Verdict::Kept,
        remark: "fitted beside the centre, with which it moves".into(),
    })
}
