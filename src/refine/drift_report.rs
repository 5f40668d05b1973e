//! The report's section on the mapping: its drift over time and with the camera's temperature.

use super::mapping::TemperatureDependence;
use super::output::Summary;
use super::report::{Drawn, Part};
use crate::report::plot::{self, Labels, Series};
use crate::units::Measured;

impl Part<'_> {
    pub(super) fn mapping(&mut self, summary: &Summary) {
        self.heading("Drift of the mapping");
        let Some(facts) = summary.mapping.as_ref().map(|mapping| &mapping.facts) else {
            return self.page.note("No marks were read.");
        };
        self.page.note(&format!(
            "Its process noise is {:.4} px after a second, and the marks' sigmas were inflated {:.2} times.",
            facts.process_noise_px[0], facts.inflation
        ));
        let centre = |axis: usize| move |row: &Drawn| Some(row.centre_px?[axis]);
        let [x, y] = [0, 1].map(|axis| self.over_time(centre(axis)));
        let title = "The plate's centre on the sensor";
        let labels = Labels::over_utc(title, "px since the first frame");
        let series = [relative_to_first("x", &x), relative_to_first("y", &y)];
        self.figure(plot::series(&labels, &series));
        self.temperature(facts.temperature);
    }

    fn temperature(&mut self, dependence: TemperatureDependence) {
        let [(slope_x, x), (slope_y, y)] = [self.by_temperature(0), self.by_temperature(1)];
        let Some((slope_x, slope_y)) = slope_x.zip(slope_y) else {
            return self
                .page
                .note("The headers hold no temperature of the camera, or only one.");
        };
        match dependence {
            TemperatureDependence::Linear { px_per_degc, .. } => {
                self.degrees(px_per_degc);
                self.page.note(&format!(
                    "The slopes of the figure, without jumps: {slope_x:.3} px/degC in x and {slope_y:.3} px/degC in y."
                ));
            }
            // Undetermined values are not printed.
            TemperatureDependence::Insignificant { .. } => self.page.note(
                "How the mapping depends on the camera's temperature is not determined: temperature explains the marks no better than process noise does.",
            ),
            TemperatureDependence::NotObservable => self.page.note(
                "How the mapping depends on the camera's temperature is not determined: too few headers hold it.",
            ),
        }
        let title = "The plate's centre over the camera's temperature";
        let labels = Labels::new(
            title,
            "camera's temperature, degC",
            "px since the first frame",
        );
        let series = [relative_to_first("x", &x), relative_to_first("y", &y)];
        self.figure(plot::series(&labels, &series));
    }

    /// Change per degC, as estimated together with process noise and jumps.
    fn degrees(&mut self, px_per_degc: [Measured; 4]) {
        let names = [
            "shift in x",
            "shift in y",
            "stretch, 1000 mil from the plate's centre",
            "turn, 1000 mil from the plate's centre",
        ];
        let line = |(name, Measured { value, sigma }): (&str, Measured)| {
            vec![name.to_owned(), format!("{value:.4} \u{b1} {sigma:.4}")]
        };
        let lines: Vec<Vec<String>> = names.into_iter().zip(px_per_degc).map(line).collect();
        self.page
            .table(&["with the camera's temperature", "px per degC"], &lines);
    }

    /// The plate's centre on one axis against temperature, and its slope between the jumps.
    fn by_temperature(&self, axis: usize) -> (Option<f64>, Vec<(f64, f64)>) {
        let point = |row: &Drawn| {
            let (degc, px) = (row.temperature_c?, row.centre_px?[axis]);
            Some((f64::from(degc), f64::from(px)))
        };
        let steady = self.rows.chunk_by(|row, next| row.jumps == next.jumps);
        let parts: Vec<Vec<(f64, f64)>> = steady
            .map(|rows| rows.iter().filter_map(point).collect())
            .collect();
        (slope(&parts), parts.concat())
    }
}

fn relative_to_first(name: &str, points: &[(f64, f64)]) -> Series {
    let first = points.first().map_or(0.0, |point| point.1);
    Series::dots(name, points.iter().map(|(at, v)| (*at, v - first)))
}

/// The common slope of straight lines, one for each part's points; none if x does not vary.
fn slope(parts: &[Vec<(f64, f64)>]) -> Option<f64> {
    let (mut spread, mut both, mut all) = (0.0, 0.0, 0.0);
    for points in parts.iter().filter(|points| !points.is_empty()) {
        let count = points.len() as f64;
        let mean = |axis: fn(&(f64, f64)) -> f64| points.iter().map(axis).sum::<f64>() / count;
        let (x, y) = (mean(|p| p.0), mean(|p| p.1));
        spread += points.iter().map(|p| (p.0 - x).powi(2)).sum::<f64>();
        both += points.iter().map(|p| (p.0 - x) * (p.1 - y)).sum::<f64>();
        all += count;
    }
    (spread > 1e-6 * all).then(|| both / spread)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slope_is_common_to_both_sides_of_a_jump() {
        let part = |from: i32, jump: f64| {
            let points = from..from + 10;
            points
                .map(|x| (f64::from(x), 2.0 * f64::from(x) + jump))
                .collect()
        };
        let found = slope(&[part(0, 0.0), part(10, 50.0)]).unwrap();
        assert!((found - 2.0).abs() < 1e-12);
        assert_eq!(slope(&[vec![(1.0, 2.0); 5], Vec::new()]), None);
    }
}
