//! The calibration as one self-contained page of HTML.

use super::calibration::CameraCalibration;
use crate::calibrate::quantity::CalibratedQuantity;
use crate::observe::RejectedFrame;
use crate::report::html::Page;
use crate::report::plot::{self, PlotError};

impl CameraCalibration {
    /// Every quantity and the hot pixels, one per line.
    pub fn summary(&self) -> String {
        let quantities = self.quantities.iter().map(ToString::to_string);
        let hot = match &self.hot_pixels {
            Some(hot) => hot.len().to_string(),
            None => {
                "not determined: at least 3 frames are needed; keeps the instrument's list".into()
            }
        };
        let lines = quantities.chain([format!("hot pixels: {hot}")]);
        lines.collect::<Vec<_>>().join("\n")
    }
}

/// The page: the results, their figures, and the rejected frames.
///
/// # Errors
/// If a figure cannot be drawn.
pub fn page(
    calibration: &CameraCalibration,
    name: &str,
    source: &str,
    rejected: &[RejectedFrame],
) -> Result<String, PlotError> {
    let mut page = Page::default();
    page.note(source);
    CalibratedQuantity::table(&mut page, &calibration.quantities);
    page.note(&match &calibration.hot_pixels {
        Some(hot) => format!("Hot pixels: {}", hot.len()),
        None => "Hot pixels: not determined, at least 3 frames are needed".into(),
    });
    for figure in &calibration.figures {
        page.figure(&plot::series(&figure.labels, &figure.series)?, source);
    }
    RejectedFrame::section(&mut page, rejected);
    Ok(page.finish(&format!("Camera of {name}")))
}
