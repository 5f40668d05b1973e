//! A picture of a frame on which a person sees what was taken for the horizon.

use super::nadir::LEAST_WEIGHT;
use super::sphere::Cone;
use super::{Nadir, Solution, Sphere};
use crate::frame::Frame;
use crate::instrument::DirectionCamera;
use crate::report::{Canvas, Colour};
use crate::units::SensorPx;
use image::RgbImage;
use std::f64::consts::TAU;

/// Below them two lines of legend.
const CAPTION_LINES: u32 = 3;
const STRIP_LINES: u32 = CAPTION_LINES + 2;
const LEGEND: [(&str, Colour); 5] = [
    ("edge as seen", Colour::YELLOW),
    ("does not agree", Colour::RED),
    ("edge of the sphere", Colour::GREEN),
    ("down", Colour::MAGENTA),
    ("own parts", Colour::BLUE),
];
const ARROW_PX: f64 = 120.0;

/// The whole frame with the edge as it was seen (yellow; red where it does not agree), the edge of the sphere that was found (green), the
/// direction down (magenta) and the vehicle's own parts (blue).
pub fn overlay(
    frame: &Frame,
    solution: &Solution,
    camera: &DirectionCamera,
    sphere: &Sphere,
    title: &str,
) -> RgbImage {
    let stretch = solution
        .levels
        .map_or((0.0, f64::from(frame.saturation_dn())), |levels| {
            (levels.dark_dn, levels.bright_dn)
        });
    let mut canvas = Canvas::of_frame(frame, frame.region(), 1, stretch, STRIP_LINES);
    for region in &camera.mask {
        let [x0, x1, y0, y1] = [region.x0, region.x1, region.y0, region.y1].map(|v| v as f64);
        let corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)];
        for pair in corners.map(|(x, y)| SensorPx::new(x, y)).windows(2) {
            canvas.line(pair[0], pair[1], Colour::BLUE);
        }
    }
    if let Ok(nadir) = &solution.nadir {
        draw_sphere(&mut canvas, frame, nadir, camera, sphere);
    }
    let weights = solution.nadir.iter().flat_map(|nadir| &nadir.weights);
    let weights = weights.copied().chain(std::iter::repeat(0.0));
    for (point, weight) in solution.edge.rays.iter().zip(weights) {
        let colour = if weight > LEAST_WEIGHT {
            Colour::YELLOW
        } else {
            Colour::RED
        };
        canvas.dot(point.at, colour);
    }
    for (line, text) in captions(solution, title).iter().enumerate() {
        canvas.caption(line as u32, text, Colour::WHITE);
    }
    canvas.legend(CAPTION_LINES, &LEGEND);
    canvas.into_image()
}

fn draw_sphere(
    canvas: &mut Canvas,
    frame: &Frame,
    nadir: &Nadir,
    camera: &DirectionCamera,
    sphere: &Sphere,
) {
    const STEPS: u32 = 720;
    let sphere = Sphere {
        half_angle_rad: nadir.half_angle_rad,
        ..*sphere
    };
    let cone = Cone::new(&sphere, &nadir.direction.unit);
    let (width, height) = (frame.width() as f64, frame.height() as f64);
    let at = |n: u32| {
        let seen = camera
            .lens
            .pixel(&cone.ray(f64::from(n) / f64::from(STEPS) * TAU, 0.0))?;
        let near =
            (-width..2.0 * width).contains(&seen.x) && (-height..2.0 * height).contains(&seen.y);
        near.then_some(seen)
    };
    for n in 0..STEPS {
        if let (Some(from), Some(to)) = (at(n), at(n + 1)) {
            canvas.line(from, to, Colour::GREEN);
        }
    }
    let middle = SensorPx::new(width / 2.0, height / 2.0);
    if let Some(down) = nadir.direction.unit.xy().try_normalize(0.0) {
        let tip = middle.vector() + down * ARROW_PX;
        canvas.arrow(middle, tip.into(), Colour::MAGENTA);
        canvas.label(tip.into(), "down", Colour::MAGENTA);
    }
}

fn captions(solution: &Solution, title: &str) -> Vec<String> {
    let quality = solution.quality().name();
    let mut lines = vec![title.to_owned()];
    match &solution.nadir {
        Ok(nadir) => {
            lines.push(format!(
                "{quality}   roll {:.4}   pitch {:.4}   sigma {:.4} deg   {}",
                nadir.roll_deg(),
                nadir.pitch_deg(),
                nadir.sigma_deg(),
                nadir.conic.name(),
            ));
            lines.push(format!(
                "{} of {} points of the edge agree, {} places in view",
                solution.agreeing(),
                solution.edge.rays.len(),
                solution.places,
            ));
        }
        Err(stopped) => lines.push(stopped.in_full()),
    }
    lines
}
