//! The report's section on jitter: spectrum, cumulative jitter and Allan deviation.

use super::allan;
use super::report::{Drawn, Part};
use crate::estimation::median;
use crate::estimation::spectrum;
use crate::report::plot::{self, Curve, Labels, Stroke};

/// Frames further apart than this multiple of the median step end a run.
const GAP_STEPS: f64 = 1.5;

/// The colour of series without an axis.
const GREY: usize = 5;

/// A motion along one axis, arcsec, at times in s.
struct Motion {
    name: &'static str,
    points: Vec<(f64, f64)>,
    /// 1 sigma of a frame along the axis, the median of all, arcsec; none if it is not known or is shown with another motion.
    frame_sigma: Option<f64>,
    /// Name of the line for this noise.
    noise: &'static str,
    noise_hue: usize,
    hue: usize,
}

impl Part<'_> {
    pub(super) fn jitter(&mut self) {
        self.heading("Jitter");
        let (what, motions) = self.motions();
        let density = self.density(what, &motions);
        let cumulative = cumulative(what, &motions);
        let allan = allan_figure(what, &motions);
        self.figure(density);
        self.figure(cumulative);
        self.page.note(
            "Integrated from the highest frequency down: what is left at a frequency f is the rms of all motion faster than f, about what an \
             exposure of 1/f is smeared by. Where it meets the dashed line, it is the frames' own noise and not motion.",
        );
        self.figure(allan);
        self.page.note(
            "Allan deviation: how far means over successive spans of time are apart, over the square root of 2. Frames' noise falls with the \
             square root of the time (dashed); where the curve rises above, the gondola or the pointing moves.",
        );
    }

    /// The offsets from the target where known, else the Sun's positions on the plate.
    fn motions(&self) -> (&'static str, [Motion; 2]) {
        let frame_sigma = |axis: usize| {
            let sigmas = self.over_time(|row| Some(row.sigma_mil[axis]));
            Some(median(sigmas.iter().map(|(_, sigma)| sigma))? * self.arcsec_per_mil)
        };
        // Across and elevation mix the plate's axes: use their mean variance.
        let both = frame_sigma(0).zip(frame_sigma(1));
        let mean = both.map(|(x, y)| (x.hypot(y)) / 2_f64.sqrt());
        let offset = |hue: usize, name| Motion {
            name,
            points: self.over_time(|row| Some(row.offset_arcsec?[hue])),
            frame_sigma: mean.filter(|_| hue == 0),
            noise: "noise of the frames",
            noise_hue: GREY,
            hue,
        };
        let offsets = [offset(0, "across"), offset(1, "elevation")];
        if !offsets[0].points.is_empty() {
            return ("the offset from the target", offsets);
        }
        let place =
            |row: &Drawn, axis: usize| Some(f64::from(row.sun_mil[axis]) * self.arcsec_per_mil);
        let on_plate = |hue: usize, name| Motion {
            name,
            points: self.over_time(|row| place(row, hue)),
            frame_sigma: frame_sigma(hue),
            noise: ["noise of the frames, x", "noise of the frames, y"][hue],
            noise_hue: hue,
            hue,
        };
        (
            "the Sun's place on the plate",
            [on_plate(0, "x"), on_plate(1, "y")],
        )
    }

    fn density(&self, what: &str, motions: &[Motion]) -> Result<String, plot::PlotError> {
        let mut curves: Vec<Curve> = motions
            .iter()
            .map(|motion| {
                let points = motion.spectrum().map_or(Vec::new(), |(points, _)| points);
                Curve::new(motion.name, Stroke::Known, points).in_hue(motion.hue)
            })
            .collect();
        curves.extend(motions.iter().filter_map(|motion| {
            let (points, step_s) = motion.spectrum()?;
            let floor = spectrum::floor(motion.frame_sigma?, step_s);
            let points = points.iter().map(|(hertz, _)| (*hertz, floor));
            Some(Curve::new(motion.noise, Stroke::Limit, points).in_hue(motion.noise_hue))
        }));
        let title = format!("Spectrum of {what}");
        let labels = Labels::new(title, "frequency, Hz", "arcsec\u{b2}/Hz");
        plot::curves(&labels, &curves)
    }
}

fn cumulative(what: &str, motions: &[Motion]) -> Result<String, plot::PlotError> {
    let curves = motions.iter().flat_map(|motion| {
        let (points, step_s) = motion.spectrum()?;
        let measured = spectrum::rms_above(&points);
        let floor = motion.frame_sigma.map(|sigma| {
            let floor = spectrum::floor(sigma, step_s);
            let floor: Vec<(f64, f64)> = points.iter().map(|(hertz, _)| (*hertz, floor)).collect();
            Curve::new(motion.noise, Stroke::Limit, spectrum::rms_above(&floor))
                .in_hue(motion.noise_hue)
        });
        let measured = Curve::new(motion.name, Stroke::Known, measured).in_hue(motion.hue);
        Some([Some(measured), floor].into_iter().flatten())
    });
    let curves: Vec<Curve> = curves.flatten().collect();
    let title = format!("Cumulative jitter of {what}");
    let labels = Labels::new(title, "frequency, Hz", "rms of all that is faster, arcsec");
    plot::curves(&labels, &curves)
}

fn allan_figure(what: &str, motions: &[Motion]) -> Result<String, plot::PlotError> {
    let curves = motions.iter().flat_map(|motion| {
        let (runs, step_s) = runs(&motion.points)?;
        let found = allan::deviation(&runs, step_s);
        let white = motion.frame_sigma.map(|sigma| {
            let at = |time_s: f64| sigma * (step_s / time_s).sqrt();
            let points = found.iter().map(|(time_s, _)| (*time_s, at(*time_s)));
            Curve::new(motion.noise, Stroke::Limit, points).in_hue(motion.noise_hue)
        });
        let found = Curve::new(motion.name, Stroke::Measured, found.clone()).in_hue(motion.hue);
        Some([Some(found), white].into_iter().flatten())
    });
    let curves: Vec<Curve> = curves.flatten().collect();
    let title = format!("Allan deviation of {what}");
    let labels = Labels::new(title, "averaging time, s", "arcsec");
    plot::curves(&labels, &curves)
}

impl Motion {
    /// The spectrum, and the median step between frames, s.
    fn spectrum(&self) -> Option<(Vec<(f64, f64)>, f64)> {
        let (runs, step_s) = runs(&self.points)?;
        let points = spectrum::density(&runs, step_s);
        (!points.is_empty()).then_some((points, step_s))
    }
}

/// Runs without gaps, and their median step.
fn runs(points: &[(f64, f64)]) -> Option<(Vec<Vec<f64>>, f64)> {
    let steps = points.windows(2).map(|pair| pair[1].0 - pair[0].0);
    let step_s = median(steps).filter(|step_s| *step_s > 0.0)?;
    let runs = points.chunk_by(|a, b| b.0 - a.0 < GAP_STEPS * step_s);
    let values = |run: &[(f64, f64)]| run.iter().map(|(_, value)| *value).collect();
    Some((runs.map(values).collect(), step_s))
}
