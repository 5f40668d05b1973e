//! The calibration as one page of HTML that needs nothing else.

use super::CameraCalibration;
use crate::calibrate::frames::LeftOut;
use crate::calibrate::html;
use crate::calibrate::numbers::{sigma_text, value_text};
use crate::report::html::escaped;
use crate::report::plot::{self, Labels, PlotError};
use std::fmt::Write;

/// The page: what was found, the figures behind it, and what was left out.
///
/// # Errors
/// Where a figure cannot be drawn.
pub fn page(
    calibration: &CameraCalibration,
    name: &str,
    source: &str,
    left_out: &[LeftOut],
) -> Result<String, PlotError> {
    let mut text = html::head(&format!("Camera of {name}"), source);
    text += "<table><tr><th>quantity</th><th>found</th><th>1 sigma</th><th></th></tr>\n";
    for finding in &calibration.findings {
        let (class, value, sigma, remark) = match &finding.found {
            Ok(found) => (
                "determined",
                format!("{} {}", value_text(*found), finding.unit),
                sigma_text(found.sigma),
                &finding.remark,
            ),
            Err(why) => ("kept", String::new(), String::new(), why),
        };
        let _ = writeln!(
            text,
            "<tr><td>{}</td><td>{value}</td><td>{sigma}</td><td class=\"{class}\">{}</td></tr>",
            finding.name,
            escaped(remark)
        );
    }
    let hot = match &calibration.hot_pixels {
        Some(hot) => format!("{} pixels", hot.len()),
        None => "not determined: at least 3 frames are needed".into(),
    };
    let _ = writeln!(
        text,
        "<tr><td>hot pixels</td><td>{hot}</td><td></td><td></td></tr></table>"
    );
    for figure in &calibration.figures {
        let labels = Labels {
            title: figure.title.into(),
            x: figure.x.into(),
            y: figure.y.into(),
        };
        text += &plot::scatter(&labels, &figure.series)?;
    }
    text += &html::left_out(left_out);
    text += "</html>\n";
    Ok(text)
}
