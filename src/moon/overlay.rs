//! A picture of a frame that shows the detected Moon.

use super::{Agreement, Disc, Levels, Quality, Stopped};
use crate::frame::Frame;
use crate::report::{Canvas, Colour};
use crate::units::SensorPx;
use image::RgbImage;
use std::f64::consts::TAU;

/// The caption is followed by two lines of legend.
const CAPTION_LINES: u32 = 3;
const STRIP_LINES: u32 = CAPTION_LINES + 2;
const LEGEND: [(&str, Colour); 4] = [
    ("limb as seen", Colour::YELLOW),
    ("does not agree", Colour::RED),
    ("disc", Colour::GREEN),
    ("centre, bright limb", Colour::MAGENTA),
];

/// The whole frame with the observed limb (yellow; red where it does not agree), the whole disc (green), its centre, and an
/// arrow to the middle of the bright limb (magenta).
pub fn overlay(frame: &Frame, found: &Result<Disc, Stopped>, title: &str) -> RgbImage {
    let saturated = f64::from(frame.saturation_dn());
    let dark = Levels::of(frame).map_or(0.0, |levels| levels.dark_dn);
    let mut canvas = Canvas::of_frame(frame, frame.region(), 1, (dark, saturated), STRIP_LINES);
    if let Ok(disc) = found {
        draw(&mut canvas, disc);
    }
    for (line, text) in captions(found, title).iter().enumerate() {
        canvas.caption(line as u32, text, Colour::WHITE);
    }
    canvas.legend(CAPTION_LINES, &LEGEND);
    canvas.into_image()
}

fn draw(canvas: &mut Canvas, disc: &Disc) {
    const STEPS: u32 = 180;
    let centre = disc.centre.position;
    let at = |angle: f64, radii: f64| {
        let (sin, cos) = angle.sin_cos();
        let radius = radii * disc.radius_px.value;
        SensorPx::new(
            centre.x + cos * radius * disc.aspect,
            centre.y + sin * radius,
        )
    };
    let around = |n: u32| at(f64::from(n) / f64::from(STEPS) * TAU, 1.0);
    for n in 0..STEPS {
        canvas.line(around(n), around(n + 1), Colour::GREEN);
    }
    for (point, agreement) in &disc.limb {
        let colour = match agreement {
            Agreement::Agrees => Colour::YELLOW,
            Agreement::Departs => Colour::RED,
        };
        canvas.dot(*point, colour);
    }
    canvas.dot(centre, Colour::MAGENTA);
    let bright = disc.bright_limb_deg.to_radians();
    canvas.arrow(at(bright, 1.3), at(bright, 1.8), Colour::MAGENTA);
}

fn captions(found: &Result<Disc, Stopped>, title: &str) -> Vec<String> {
    let mut lines = vec![title.to_owned()];
    match found {
        Ok(disc) => {
            let [x, y] = disc.centre.sigma();
            lines.push(format!(
                "{}   centre {:.3}, {:.3}   sigma {x:.3}, {y:.3} px   radius {:.3}",
                Quality::name(disc.quality),
                disc.centre.position.x,
                disc.centre.position.y,
                disc.radius_px.value,
            ));
            lines.push(format!(
                "lit {:.2}   bright limb at {:.1} deg",
                disc.lit().value,
                disc.bright_limb_deg
            ));
        }
        Err(stopped) => lines.push(stopped.in_full()),
    }
    lines
}
