//! Check of the instrument's calibration: its age and its uncertainties.

use super::Finding;
use crate::instrument::Instrument;
use crate::plan::{Plan, PlannedCamera};
use jiff::{Timestamp, tz::Offset};

/// Quantities that a knock or a transport changes.
const TRANSPORT_SENSITIVE: [&str; 5] = [
    "mounting.boresight_mil",
    "mounting.clocking_deg",
    "mounting.scale_mil_per_px",
    "mounting.rotation_deg",
    "mounting.plate_centre_px",
];

pub(super) fn check(plan: &Plan, camera: &PlannedCamera) -> Vec<Finding> {
    match camera.camera.sees.plate() {
        Some(instrument) => vec![
            age(plan, camera, Timestamp::now()),
            sigmas(&camera.camera.name, instrument),
        ],
        None => Vec::new(),
    }
}

fn age(plan: &Plan, camera: &PlannedCamera, now: Timestamp) -> Finding {
    let check = format!("{} calibration", camera.camera.name);
    let name = &camera.camera.label;
    let is_sensitive = |key: &str| TRANSPORT_SENSITIVE.contains(&key);
    let dates = camera.dates.iter().filter(|dated| is_sensitive(&dated.key));
    let Some(oldest) = dates.min_by_key(|dated| dated.date) else {
        return Finding::warn(
            check,
            format!("\"{name}\" has no dates"),
            "state them in its file",
        );
    };
    let today = Offset::UTC.to_datetime(now).date();
    let age_days = (today - oldest.date).get_days();
    let limit_days = plan.config.preflight.max_calibration_age_days;
    let found = format!(
        "\"{name}\": {} is of {}, {age_days} days ago",
        oldest.key, oldest.date
    );
    if age_days < 0 {
        return Finding::warn(
            check,
            format!("{found}: it lies ahead"),
            "set the clock, or the date",
        );
    }
    if f64::from(age_days) > limit_days {
        let found = format!("{found}; the limit is {limit_days} days");
        return Finding::warn(
            check,
            found,
            "measure boresight, clocking and plate again, or accept",
        );
    }
    Finding::pass(check, found)
}

fn sigmas(camera: &str, instrument: &Instrument) -> Finding {
    let check = format!("{camera} boresight");
    let mounting = &instrument.mounting;
    let boresight_arcsec = mounting.boresight_sigma_mil * instrument.optics.arcsec_per_mil();
    let (clocking_deg, roll_deg) = (mounting.clocking_deg.sigma, mounting.roll_deg.sigma);
    let found = format!(
        "1 sigma of the boresight {boresight_arcsec:.1} arcsec, of the clocking {clocking_deg} deg, of the roll {roll_deg} deg"
    );
    match boresight_arcsec > 0.0 && clocking_deg > 0.0 && roll_deg > 0.0 {
        true => Finding::pass(check, found),
        false => Finding::warn(
            check,
            format!("{found}: not stated"),
            "state their sigma in the instrument's file: offsets claim too much without",
        ),
    }
}
