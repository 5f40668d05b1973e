//! The report's section on the pointing: position on the Sun, dwell time, and distance from the target.

use super::output::Summary;
use super::report::Part;
use super::solar_path::{SolarPath, SolarStep};
use crate::clock::utc_microseconds;
use crate::pointing::HelioprojectiveArcsec;
use crate::report::plot::{self, Ellipse, Labels, MapField, PathPosition, PlotError, Series};
use crate::report::{graticule, limb};
use jiff::Timestamp;
use nalgebra::SymmetricEigen;
use std::ops::Range;

/// Spacing of the circles of the heliographic grid, deg.
const GRID_DEG: u32 = 15;
/// Half side of the map of the whole Sun, in solar radii, at least.
const REACH_RADII: f64 = 1.1;
/// The map of the path alone spans the path without this fraction at each end, times this margin.
const TRIMMED: f64 = 0.01;
const MARGIN: f64 = 1.3;
/// It is drawn where its side is below this fraction of the first map's; its side is at least this many sigmas of the boresight, and at
/// least this many arcsec.
const CLOSE_PART: f64 = 0.4;
const LEAST_SIGMAS: f64 = 10.0;
const LEAST_SIDE_ARCSEC: f64 = 4.0;
/// Bins of the histogram of distances.
const BINS: usize = 60;

const WEST: &str = "to solar west, arcsec";
const NORTH: &str = "to solar north, arcsec";

fn point(at: &HelioprojectiveArcsec) -> (f64, f64) {
    (at.x, at.y)
}

impl Part<'_> {
    pub(super) fn pointing(&mut self, summary: &Summary, path: &SolarPath) {
        self.heading("Where the telescope pointed on the Sun");
        if path.steps.is_empty() {
            return self
                .page
                .note("The pointing is not known: no frame shows the Sun, or no place is known.");
        }
        self.on_target(summary);
        self.maps(path);
        self.distances(path);
        self.offsets();
    }

    fn on_target(&mut self, summary: &Summary) {
        let Some(on_target) = &summary.pointing.on_target else {
            return self
                .page
                .note("The pointing was never valid with the target in view.");
        };
        let row = |(limit, share): (&str, String)| vec![limit.to_owned(), share];
        let heads = ["within", "time, and part of the valid time"];
        self.page.table(&heads, &on_target.within().map(row));
        self.page.note(&format!(
            "The true angle from the target to the boresight, over the {:.1} s in which the pointing is valid; its median is {:.1} arcsec.",
            on_target.valid_s, on_target.median_arcsec
        ));
    }

    fn maps(&mut self, path: &SolarPath) {
        let full = full_disc(path);
        let close = close_up(path, &full);
        let caption = caption(path);
        let map = |title: &str, field: &MapField| {
            let labels = Labels::new(title, WEST, NORTH);
            plot::path_map(&labels, field, &positions(path), ellipse(path).as_ref())
        };
        self.figure_with(map("The boresight on the Sun", &full), &caption);
        if let Some(close) = &close {
            self.figure_with(map("The same, closer", close), &caption);
        }
        let field = close.as_ref().unwrap_or(&full);
        let (figure, caption) = dwell(path, field);
        self.figure_with(figure, &caption);
    }

    fn distances(&mut self, path: &SolarPath) {
        let labels = Labels::new(
            "Distance from the target",
            "angle from target to boresight, arcsec",
            "time, s",
        );
        let lines = [("20 arcsec", 20.0), ("1 arcmin", 60.0)];
        let each_s = 1.0 / path.rate_hz;
        let distances = path.distances_arcsec();
        let figure = plot::histogram(&labels, &distances, each_s, BINS, &lines, None);
        self.figure(figure);
    }

    fn offsets(&mut self) {
        let offsets = [0, 1].map(|axis| self.over_time(|row| Some(row.offset_arcsec?[axis])));
        let named = ["across", "elevation"].into_iter().zip(offsets);
        let series: Vec<Series> = named.map(|(name, axis)| Series::dots(name, axis)).collect();
        let labels = Labels::over_utc("Offset from the target at the fine frames", "arcsec");
        self.figure(plot::series(&labels, &series));
    }
}

fn positions(path: &SolarPath) -> Vec<PathPosition> {
    let position = |step: &SolarStep| PathPosition {
        unix_s: step.unix_s,
        at: point(&step.at),
        is_valid: step.is_valid,
    };
    path.steps.iter().map(position).collect()
}

/// The whole disc, and any valid path beyond it.
fn full_disc(path: &SolarPath) -> MapField {
    let far = |step: &SolarStep| step.at.x.abs().max(step.at.y.abs());
    let farthest = path.valid().map(far).fold(0.0, f64::max);
    let disc = path.disc.as_ref().map(|(_, disc)| disc);
    let radius = disc.map_or(1000.0, |disc| disc.radius_arcsec());
    let reach = (REACH_RADII * radius).max(1.05 * farthest);
    let lines = |disc| {
        let lines = graticule(disc, GRID_DEG);
        lines
            .iter()
            .map(|line| line.iter().map(point).collect())
            .collect()
    };
    MapField {
        outline: disc.map_or_else(Vec::new, |disc| limb(disc).iter().map(point).collect()),
        grid: disc.map_or_else(Vec::new, lines),
        target: path.target.iter().map(point).collect(),
        ..MapField::about_zero(reach)
    }
}

/// The path alone, with the target where that is near; none where the path extends over much of the Sun.
fn close_up(path: &SolarPath, full: &MapField) -> Option<MapField> {
    let full_side = full.x.end - full.x.start;
    let [x, y] = [middle_part(path, |at| at.x)?, middle_part(path, |at| at.y)?];
    let with = |span: &Range<f64>, value: fn(&(f64, f64)) -> f64| {
        let aims = full.target.iter().map(value);
        aims.fold(span.clone(), |span, v| span.start.min(v)..span.end.max(v))
    };
    let sigma = ellipse(path).map_or(0.0, |ellipse| ellipse.semi_axes[0]);
    let least = LEAST_SIDE_ARCSEC.max(LEAST_SIGMAS * sigma);
    let square = |[x, y]: [Range<f64>; 2]| {
        let longer = (x.end - x.start).max(y.end - y.start);
        let half = (MARGIN * longer).max(least) / 2.0;
        let about = |span: &Range<f64>| {
            let middle = f64::midpoint(span.start, span.end);
            middle - half..middle + half
        };
        MapField {
            x: about(&x),
            y: about(&y),
            ..full.clone()
        }
    };
    let with_target = [with(&x, |at| at.0), with(&y, |at| at.1)];
    let mut squares = [with_target, [x, y]].into_iter().map(square);
    squares.find(|field| field.x.end - field.x.start < CLOSE_PART * full_side)
}

/// Span of the valid path along an axis, without the outermost fraction `TRIMMED` at each end.
fn middle_part(path: &SolarPath, axis: fn(&HelioprojectiveArcsec) -> f64) -> Option<Range<f64>> {
    let mut values: Vec<f64> = path.valid().map(|step| axis(&step.at)).collect();
    values.sort_by(f64::total_cmp);
    let last = values.len().checked_sub(1)?;
    let rest = (TRIMMED * last as f64).floor() as usize;
    Some(values[rest]..values[last - rest])
}

/// 1 sigma ellipse of the random part of the boresight's error.
fn ellipse(path: &SolarPath) -> Option<Ellipse> {
    let of = SymmetricEigen::new(path.covariance_arcsec2?);
    let longer = of.eigenvalues.imax();
    let semi_axes = [longer, 1 - longer].map(|n| of.eigenvalues[n].max(0.0).sqrt());
    let along = of.eigenvectors.column(longer);
    let [long, short] = semi_axes;
    Some(Ellipse {
        name: format!("1 sigma, {long:.2} by {short:.2} arcsec"),
        semi_axes,
        turn_rad: along[1].atan2(along[0]),
    })
}

fn caption(path: &SolarPath) -> String {
    let utc = |(utc, _): &(Timestamp, _)| {
        format!(
            "Limb, and heliographic grid every {GRID_DEG} deg, at {}. ",
            utc_microseconds(*utc)
        )
    };
    let sun = path.disc.as_ref().map_or(String::new(), utc);
    let grey = match path.steps.iter().all(|step| step.is_valid) {
        true => "",
        false => " Grey where the pointing is not valid.",
    };
    format!(
        "{sun}The path has the colours of its times.{grey} 1 sigma is the random part's, rms over the valid time."
    )
}

/// Map of the boresight's dwell time, and its caption.
fn dwell(path: &SolarPath, field: &MapField) -> (Result<String, PlotError>, String) {
    let cell = plot::cell_of(field);
    let each_s = 1.0 / path.rate_hz;
    let places = || path.valid().map(|step| point(&step.at));
    let cells = plot::binned(places(), cell, each_s);
    let outside = places().filter(|(x, y)| !field.x.contains(x) || !field.y.contains(y));
    let outside_s = outside.count() as f64 * each_s;
    let labels = Labels::new(format!("Dwell in squares of {cell} arcsec"), WEST, NORTH);
    let figure = plot::scalar_map(&labels, field, &cells, cell, "s");
    let caption = format!(
        "The valid time that the boresight spent in each square of {cell} by {cell} arcsec, s. Outside of the map: {outside_s:.1} s."
    );
    (figure, caption)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sky::Ephemeris;
    use nalgebra::Matrix2;

    /// A path of this width around a target, and far off in its first second.
    fn path(width_arcsec: f64) -> SolarPath {
        let step = |n: u32| {
            let (sin, cos) = (f64::from(n) / 30.0).sin_cos();
            let far = if n < 10 { 1500.0 } else { 0.0 };
            SolarStep {
                unix_s: 1_379_786_400.0 + f64::from(n) / 10.0,
                at: HelioprojectiveArcsec {
                    x: 300.0 + width_arcsec / 2.0 * cos + far,
                    y: -200.0 + width_arcsec / 4.0 * sin,
                },
                is_valid: true,
                from_target_arcsec: Some(width_arcsec / 2.0),
            }
        };
        let utc: Timestamp = "2013-09-21T18:01:00Z".parse().unwrap();
        SolarPath {
            steps: (0..2000).map(step).collect(),
            rate_hz: 10.0,
            target: vec![HelioprojectiveArcsec {
                x: 300.0,
                y: -200.0,
            }],
            disc: Some((utc, Ephemeris::default().disc(utc).unwrap())),
            covariance_arcsec2: Some(Matrix2::new(0.04, 0.0, 0.0, 0.09)),
        }
    }

    fn side(field: &MapField) -> f64 {
        field.x.end - field.x.start
    }

    #[test]
    fn the_first_map_has_the_whole_disc_and_the_second_the_path_and_its_target() {
        let small = path(40.0);
        let full = full_disc(&small);
        assert!(
            full.outline
                .iter()
                .all(|(x, y)| full.x.contains(x) && full.y.contains(y))
        );
        assert!(full.x.end > 1800.0, "{:?}", full.x);
        let close = close_up(&small, &full).unwrap();
        assert!((45.0..60.0).contains(&side(&close)), "{close:?}");
        assert!(close.x.contains(&300.0) && close.y.contains(&-200.0));
        assert_eq!(side(&close), close.y.end - close.y.start);
        let wide = path(3000.0);
        assert!(close_up(&wide, &full_disc(&wide)).is_none());
    }

    #[test]
    fn a_dwell_map_states_its_cells_and_what_lies_outside() {
        let path = path(40.0);
        let close = close_up(&path, &full_disc(&path)).unwrap();
        let (figure, caption) = dwell(&path, &close);
        assert!(figure.unwrap().contains("Dwell in squares of 2 arcsec"));
        assert!(caption.ends_with("Outside of the map: 1.0 s."), "{caption}");
    }

    #[test]
    fn the_ellipse_lies_along_its_longer_axis() {
        let ellipse = ellipse(&path(40.0)).unwrap();
        assert_eq!(ellipse.name, "1 sigma, 0.30 by 0.20 arcsec");
        assert!((ellipse.turn_rad.sin().abs() - 1.0).abs() < 1e-9);
    }
}
