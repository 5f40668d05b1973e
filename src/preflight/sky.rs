//! Check of the sky: whether Earth orientation and place are known.

use super::Finding;
use crate::plan::Plan;
use jiff::{Timestamp, ToSpan, tz::Offset};

/// Number of days before the end of the table from which it should be renewed.
const SOON_DAYS: i64 = 30;
const RENEW: &str = "renew it with tools/iers and name it in sky.earth_orientation";

pub(super) fn check(plan: &Plan) -> Vec<Finding> {
    vec![orientation(plan, Timestamp::now()), place(plan)]
}

fn orientation(plan: &Plan, now: Timestamp) -> Finding {
    let check = "Earth orientation";
    let [first, last] = plan.orientation.dates();
    let found = format!("the table goes from {first} to {last}");
    let today = Offset::UTC.to_datetime(now).date();
    let soon = today.checked_add(SOON_DAYS.days()).unwrap_or(today);
    if plan.orientation.at(now).is_err() {
        let found = format!("{found}, and today is {today}: there would be no offsets");
        return Finding::fail(check, found, RENEW);
    }
    if let Some(extrapolated) = plan.orientation.extrapolates(now) {
        return Finding::warn(check, extrapolated.to_string(), RENEW);
    }
    match soon < last {
        true => Finding::pass(check, found),
        false => Finding::warn(check, found, RENEW),
    }
}

fn place(plan: &Plan) -> Finding {
    match plan.config.site.place() {
        Some(place) => Finding::pass(
            "place",
            format!(
                "{} deg north, {} deg east, {} m, unless frames or GPS give another",
                place.latitude_deg, place.longitude_deg, place.height_m
            ),
        ),
        None => Finding::warn(
            "place",
            "the configuration names none: no offsets until GPS or the frames give one",
            "set all of [site]",
        ),
    }
}
