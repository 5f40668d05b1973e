//! Whether the roll camera sees a horizon.

use super::{DIM, Finding, Plan, SATURATED};
use crate::frame::Frame;
use crate::horizon::{self, Quality, Settings, Solution};
use crate::instrument::MountedCamera;
use crate::pointing::body_roll_deg;

/// No gondola hangs so much askew.
const MOST_ROLL_DEG: f64 = 15.0;

/// Solves a frame, and judges its light.
pub(super) fn solves(
    plan: &Plan,
    table: &str,
    camera: &MountedCamera,
    frame: &Frame,
) -> Vec<Finding> {
    if let Err(wrong) = camera.optics.check(frame) {
        let remedy = "give the camera its own file (roll_camera.instrument)";
        return vec![Finding::fail(table, wrong.to_string(), remedy)];
    }
    let place = frame.info.place.or(plan.config.site.place());
    let sphere = plan.config.roll.sphere(place.map(|place| place.height_m));
    let Some(sphere) = sphere else {
        let found = "the camera is not above the limb, or its height is not known";
        let remedy = "no matter on the ground; else set roll.height_m";
        return vec![Finding::warn(format!("{table} solves"), found, remedy)];
    };
    let settings = Settings::default();
    let solution = horizon::solve(&settings, frame, &camera.optics, &sphere, None);
    let mut findings = vec![nadir(table, camera, &solution)];
    findings.extend(light(table, &solution, frame.saturation_dn()));
    findings
}

fn nadir(table: &str, camera: &MountedCamera, solution: &Solution) -> Finding {
    let check = format!("{table} solves");
    let nadir = match &solution.nadir {
        Ok(nadir) => nadir,
        Err(stopped) => {
            let found = format!("no horizon ({})", stopped.in_full());
            let remedy = "no matter on the ground; else look at the frame with `solaspect horizon --overlay`";
            return Finding::warn(check, found, remedy);
        }
    };
    let roll = body_roll_deg(&nadir.direction.turned(&camera.body_from_camera));
    let found = format!(
        "{}: roll {:.3} +- {:.3} deg, {} of {} places of the limb",
        solution.quality().name(),
        roll.value,
        roll.sigma,
        solution.agreeing(),
        solution.places
    );
    match solution.quality() {
        _ if roll.value.abs() > MOST_ROLL_DEG => {
            Finding::warn(check, found, "is body_from_camera right?")
        }
        Quality::Fine => Finding::pass(check, found),
        _ => Finding::warn(check, found, "is the limb in view, and mask_px right?"),
    }
}

fn light(table: &str, solution: &Solution, saturation_dn: u16) -> Option<Finding> {
    let bright = solution.levels?.bright_dn / f64::from(saturation_dn);
    let check = format!("{table} light");
    let found = format!("limb and clouds at {:.0} % of full scale", 100.0 * bright);
    Some(match bright {
        _ if bright >= SATURATED => {
            let remedy = "shorten exposure_us, or set auto_exposure";
            Finding::warn(check, format!("{found}: saturated"), remedy)
        }
        _ if bright < DIM => {
            let remedy = "lengthen exposure_us, or set auto_exposure";
            Finding::warn(check, format!("{found}: dim"), remedy)
        }
        _ => Finding::pass(check, found),
    })
}
