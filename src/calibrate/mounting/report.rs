//! The calibration as one self-contained page of HTML.

use super::calibration::Mounting;
use super::fit::{MountingFit, Pointings};
use super::scatter::Residual;
use crate::calibrate::quantity::CalibratedQuantity;
use crate::instrument::Instrument;
use crate::observe::RejectedFrame;
use crate::report::html::Page;
use crate::report::plot::{self, Arrow, Density, Labels, PlotError, Series};

impl Mounting {
    /// The number of observations that agree, and their scatter.
    pub fn agreement(&self, stated: &Instrument) -> String {
        let scatter_mil = self.fit.scatter_mil;
        format!(
            "{} of {} observations agree, scattering by {scatter_mil:.3} mil ({:.2} arcsec) rms per axis",
            self.fit.accepted(),
            self.fit.residuals.len(),
            scatter_mil * stated.optics.arcsec_per_mil(),
        )
    }
}

/// The page: verdicts, residuals over time and on the plate, and the rejected frames.
///
/// # Errors
/// If a figure cannot be drawn.
pub fn page(
    mounting: &Mounting,
    stated: &Instrument,
    source: &str,
    rejected: &[RejectedFrame],
) -> Result<String, PlotError> {
    let fit = &mounting.fit;
    let way = match fit.pointings {
        Pointings::Known => "known pointing",
        Pointings::Fixed => "drift scan: the telescope fixed, the Sun crossing",
    };
    let inflated = match fit.correlation {
        c if c < 1.05 => String::new(),
        c => {
            format!("; successive residuals are correlated, so variances are inflated {c:.1} times")
        }
    };
    let mut page = Page::default();
    page.note(&format!("{way}; {source}"));
    page.note(&format!("{}{inflated}.", mounting.agreement(stated)));
    CalibratedQuantity::table(&mut page, &mounting.quantities);
    page.heading("Residuals: observed less fitted place of the Sun");
    page.figure(&over_time(fit)?, source);
    page.figure(&on_plate(fit)?, source);
    page.figure(&along_the_axes(fit)?, source);
    RejectedFrame::section(&mut page, rejected);
    Ok(page.finish(&format!("Mounting of {}", stated.name)))
}

fn accepted(fit: &MountingFit) -> Vec<&Residual> {
    fit.residuals.iter().filter(|r| r.accepted).collect()
}

fn over_time(fit: &MountingFit) -> Result<String, PlotError> {
    let unix_s = |r: &Residual| r.utc.as_nanosecond() as f64 / 1e9;
    let along = |name, axis: usize| {
        let residuals = accepted(fit).into_iter();
        Series::dots(name, residuals.map(|r| (unix_s(r), r.off[axis])))
    };
    let title = "Residuals over time (observations that agree)";
    let labels = Labels::over_utc(title, "mil");
    plot::series(&labels, &[along("X", 0), along("Y", 1)])
}

fn on_plate(fit: &MountingFit) -> Result<String, PlotError> {
    const MOST_ARROWS: usize = 150;
    let accepted = accepted(fit);
    let reaches = accepted.iter().map(|r| r.at.x.abs().max(r.at.y.abs()));
    let reach = reaches.fold(500.0, f64::max);
    let some = accepted
        .iter()
        .step_by(accepted.len().div_ceil(MOST_ARROWS).max(1));
    let arrow = |r: &&Residual| Arrow {
        at: (r.at.x, r.at.y),
        vector: (r.off.x, r.off.y),
    };
    let arrows: Vec<Arrow> = some.map(arrow).collect();
    let labels = Labels::new("Residuals on the plate", "X, mil", "Y, mil");
    plot::vector_map(&labels, -1.1 * reach..1.1 * reach, &arrows, "mil")
}

fn along_the_axes(fit: &MountingFit) -> Result<String, PlotError> {
    let off: Vec<f64> = accepted(fit)
        .iter()
        .flat_map(|r| [r.off.x, r.off.y])
        .collect();
    let squares: f64 = off.iter().map(|off| off * off).sum();
    let sigma = (squares / off.len().max(1) as f64).sqrt();
    let labels = Labels::new("Residuals along both axes", "mil", "residuals");
    let normal = (sigma > 0.0).then_some(("normal, of the same rms", Density::Normal { sigma }));
    plot::histogram(&labels, &off, 1.0, 40, &[], normal)
}
