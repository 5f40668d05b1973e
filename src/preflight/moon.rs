//! Whether the Moon camera sees the Moon, where the ephemeris has it above the limb.

use super::{DIM, Finding, Plan, SATURATED};
use crate::frame::Frame;
use crate::instrument::DirectionCamera;
use crate::moon::{self, Disc, Expected, Levels, Optics, Quality, Settings, bright_dn};

/// Solves a frame, and judges its light.
pub(super) fn solves(
    plan: &Plan,
    table: &str,
    camera: &DirectionCamera,
    frame: &Frame,
) -> Vec<Finding> {
    if let Err(wrong) = camera.check(frame) {
        let remedy = "give the camera its own file (moon_camera.instrument)";
        return vec![Finding::fail(table, wrong.to_string(), remedy)];
    }
    let check = format!("{table} solves");
    let place = frame.info.place.or(plan.config.site.place());
    let Some((utc, place)) = frame.info.mid_exposure.zip(place) else {
        let found = "the frame's time or place is not known";
        let remedy = "set the site, unless GPS or requests tell the place";
        return vec![Finding::warn(check, found, remedy)];
    };
    let position = match plan.ephemeris().moon(utc, place) {
        Ok(position) => position,
        Err(error) => return vec![Finding::warn(check, error.to_string(), "set the clock")],
    };
    if moon::below_horizon(&position, place).is_some() {
        let found = format!(
            "the Moon is {:.1} deg below the horizontal: not tried",
            -position.elevation_deg
        );
        return vec![Finding::pass(check, found)];
    }
    let settings = Settings {
        optics: Optics::Camera(camera.lens),
        ..Settings::default()
    };
    let mut findings = vec![
        match moon::solve(&settings, frame, &Expected::of(&position)) {
            Ok(disc) => seen(check, &disc),
            Err(stopped) => {
                let found = format!(
                    "no Moon ({}), which stands at azimuth {:.1}, elevation {:.1} deg",
                    stopped.in_full(),
                    position.azimuth_deg,
                    position.elevation_deg
                );
                let remedy = "no matter indoors; else point at it, and look at the frame with `solaspect moon --overlay`";
                Finding::warn(check, found, remedy)
            }
        },
    ];
    findings.extend(light(table, frame));
    findings
}

fn seen(check: String, disc: &Disc) -> Finding {
    let (centre, sigma) = (disc.centre.position, disc.centre.sigma());
    let found = format!(
        "{}: centre at {:.2}, {:.2} px (+- {:.2}, {:.2}), radius {:.2} px, {:.0} % lit",
        disc.quality.name(),
        centre.x,
        centre.y,
        sigma[0],
        sigma[1],
        disc.radius_px.value,
        100.0 * disc.lit().value
    );
    match disc.quality {
        Quality::Fine => Finding::pass(check, found),
        Quality::Coarse => Finding::warn(check, found, "is the whole disc in view?"),
    }
}

/// The brightest light of the picture, where there is one.
fn light(table: &str, frame: &Frame) -> Option<Finding> {
    let check = format!("{table} light");
    let Ok(levels) = Levels::of(frame) else {
        let remedy = "shorten exposure_us, or set auto_exposure";
        return Some(Finding::warn(check, "bright all over", remedy));
    };
    let bright_dn = bright_dn(frame, frame.region())?;
    let bright = bright_dn / f64::from(frame.saturation_dn());
    let found = format!("brightest light at {:.0} % of full scale", 100.0 * bright);
    let is_lit = bright_dn > levels.dark_dn + levels.least_dn();
    Some(match bright {
        _ if bright >= SATURATED => {
            let remedy = "shorten exposure_us, or set auto_exposure";
            Finding::warn(check, format!("{found}: saturated"), remedy)
        }
        _ if is_lit && bright < DIM => {
            let remedy = "lengthen exposure_us, or set auto_exposure";
            Finding::warn(check, format!("{found}: dim"), remedy)
        }
        _ => Finding::pass(check, found),
    })
}
