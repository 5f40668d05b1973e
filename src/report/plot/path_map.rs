//! Maps of a path, coloured by time.

use super::axis::{Axis, extent};
use super::clip;
use super::field::{MapField, Scale, Shades};
use super::labels::{Labels, PlotError};
use super::sheet::{Entry, Sheet, Stroke, Swatch, px};
use super::thin::{PIECE_PX, Piece, longest_step, uncovered};
use std::fmt::Write;

/// A position of a path at a time, UTC, s since 1970-01-01.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PathPosition {
    pub unix_s: f64,
    pub at: (f64, f64),
    /// Invalid positions are drawn grey.
    pub is_valid: bool,
}

/// An error ellipse in the units of the axes, with its name.
#[derive(Debug, Clone, PartialEq)]
pub struct Ellipse {
    pub name: String,
    /// Semi-axes, the longer one first.
    pub semi_axes: [f64; 2],
    /// Angle of the first semi-axis, from x towards y.
    pub turn_rad: f64,
}

/// From dark blue over red to orange (matplotlib's plasma without its yellow, which is too light on white).
const TIMES: Shades = Shades(&[
    [13, 8, 135],
    [106, 0, 168],
    [177, 42, 144],
    [225, 100, 98],
    [252, 166, 54],
]);
/// Number of colours.
const SHADES: usize = 64;
const INVALID: &str = "#aaaaaa";
/// The path is drawn in steps of at least this, px.
const FINEST_PX: f64 = 0.5;
/// Least diameter of a visible ellipse.
const LEAST_ELLIPSE_PX: f64 = 2.0;
const ELLIPSE: &str = "#009e73";
/// Distance from the panel's edges.
const MARGIN_PX: f64 = 10.0;

/// A path in the order of time over a field, with a colour scale of its times. Where it crosses itself, the later part is above. It is
/// interrupted where steps are missing. The ellipse is in the lower left corner; if it is too small to be visible, the legend states it.
///
/// # Errors
/// If there is nothing to draw.
pub fn path_map(
    labels: &Labels,
    field: &MapField,
    path: &[PathPosition],
    ellipse: Option<&Ellipse>,
) -> Result<String, PlotError> {
    let times = extent(path.iter().map(|p| p.unix_s)).ok_or_else(|| labels.empty())?;
    let scale = Scale {
        axis: match times {
            (first, last) if first < last => Axis::exact_utc(first, last),
            one => Axis::utc(one),
        },
        shades: &TIMES,
        name: "UTC",
    };
    let px_per_unit = field.px_per_unit();
    let is_shown = |e: &&Ellipse| 2.0 * e.semi_axes[0] * px_per_unit >= LEAST_ELLIPSE_PX;
    let legend = legend(path, ellipse.map(|one| (one, is_shown(&one))));
    let mut sheet = field.sheet(labels, legend, Some(&scale));
    field.draw_lines(&mut sheet);
    draw_path(&mut sheet, path, scale.axis);
    field.draw_target(&mut sheet);
    if let Some(ellipse) = ellipse.filter(is_shown) {
        draw_ellipse(&mut sheet, ellipse, px_per_unit);
    }
    Ok(sheet.finish())
}

fn legend(path: &[PathPosition], ellipse: Option<(&Ellipse, bool)>) -> Vec<Entry> {
    let line = |name: String, colour| Entry {
        name,
        swatch: Swatch::Line,
        colour,
    };
    let invalid = path.iter().any(|position| !position.is_valid);
    let invalid = invalid.then(|| line("not valid".into(), INVALID));
    let ellipse = ellipse.map(|(Ellipse { name, .. }, is_shown)| match is_shown {
        true => line(format!("{name} (lower left)"), ELLIPSE),
        false => line(format!("{name}: too small to show"), ELLIPSE),
    });
    invalid.into_iter().chain(ellipse).collect()
}

/// Colour index of a piece; none for an invalid part of the path, which is drawn below.
type Shade = Option<usize>;

fn draw_path(sheet: &mut Sheet, path: &[PathPosition], times: Axis) {
    let mut pieces = pieces(sheet, path, times);
    pieces.sort_by_key(|piece| piece.shade);
    let left = uncovered(pieces);
    for alike in left.chunk_by(|a, b| a.shade == b.shade) {
        let lines = clip::joined(alike.iter().map(|piece| (piece.from, piece.to)));
        let mut drawn = String::new();
        for ((x, y), others) in lines.iter().filter_map(|line| line.split_first()) {
            let _ = write!(drawn, "M{} {}", px(*x), px(*y));
            for (x, y) in others {
                let _ = write!(drawn, "L{} {}", px(*x), px(*y));
            }
        }
        let colour = alike[0].shade.map_or(INVALID.to_owned(), |shade| {
            TIMES.at(shade as f64 / (SHADES - 1) as f64)
        });
        sheet.path(&drawn, Stroke::solid(&colour, PIECE_PX));
    }
}

/// The path in the panel as short pieces of one colour each, in the order of time.
fn pieces(sheet: &Sheet, path: &[PathPosition], times: Axis) -> Vec<Piece<Shade>> {
    let longest = longest_step(path.iter().map(|position| position.unix_s));
    let runs = path.chunk_by(|a, b| b.unix_s - a.unix_s <= longest);
    let panel = sheet.panel();
    let mut pieces = Vec::new();
    for run in runs {
        let shade = |position: &PathPosition| {
            let part = times.fraction(position.unix_s);
            position
                .is_valid
                .then_some((part * (SHADES - 1) as f64).round() as usize)
        };
        let last = run.len() - 1;
        let mut last_point = (sheet.unclipped(run[0].at), shade(&run[0]));
        for (n, position) in run.iter().enumerate().skip(usize::from(last > 0)) {
            let next = (sheet.unclipped(position.at), shade(position));
            let moved_px = (next.0.0 - last_point.0.0).hypot(next.0.1 - last_point.0.1);
            if moved_px < FINEST_PX && next.1 == last_point.1 && n < last {
                continue;
            }
            let part = clip::segment(last_point.0, next.0, panel);
            pieces.extend(part.map(|(from, to)| Piece {
                from,
                to,
                shade: last_point.1.and(next.1),
            }));
            last_point = next;
        }
    }
    pieces
}

fn draw_ellipse(sheet: &mut Sheet, ellipse: &Ellipse, px_per_unit: f64) {
    let [long, short] = ellipse.semi_axes.map(|length| length * px_per_unit);
    let (sin, cos) = ellipse.turn_rad.sin_cos();
    let (width, height) = (
        (long * cos).hypot(short * sin),
        (long * sin).hypot(short * cos),
    );
    let [left, _, _, bottom] = sheet.panel();
    let middle = (left + MARGIN_PX + width, bottom - MARGIN_PX - height);
    let point = |n: u32| {
        let (along, across) = (f64::from(n) * 5.0).to_radians().sin_cos();
        let (along, across) = (long * along, short * across);
        let (x, y) = (along * cos - across * sin, along * sin + across * cos);
        (middle.0 + x, middle.1 - y)
    };
    let around: Vec<(f64, f64)> = (0..=72).map(point).collect();
    sheet.line(&around, Stroke::solid(ELLIPSE, 1.4));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::plot::Line;

    fn labels() -> Labels {
        Labels::new("Path", "to solar west, arcsec", "to solar north, arcsec")
    }

    fn position(n: u32, at: (f64, f64)) -> PathPosition {
        PathPosition {
            unix_s: 1_379_786_400.0 + f64::from(n) * 0.1,
            at,
            is_valid: true,
        }
    }

    /// The x of every point of each path of a colour, or of a width, in drawing order.
    fn across(svg: &str, stroke: &str) -> Vec<Vec<f64>> {
        let drawn = svg.lines().filter(|line| line.contains(stroke));
        let across = |line: &str| {
            let path = line.split('"').nth(1).unwrap();
            let points = path
                .split(['M', 'L'])
                .filter_map(|point| point.split(' ').next());
            points.filter_map(|x| x.parse().ok()).collect()
        };
        drawn.map(across).collect()
    }

    #[test]
    fn later_places_have_other_colours_and_west_is_to_the_right() {
        let field = MapField::about_zero(100.0);
        let path: Vec<PathPosition> = (0..100)
            .map(|n| position(n, (f64::from(n) - 50.0, 0.0)))
            .collect();
        let svg = path_map(&labels(), &field, &path, None).unwrap();
        let pieces = across(&svg, "stroke-width=\"2\"");
        assert!(pieces.len() > 50, "{}", pieces.len());
        assert!(pieces.is_sorted_by(|a, b| a[0] < b[0]), "{pieces:?}");
        for text in [
            ">18:00:00<",
            ">2013-09-21<",
            ">UTC<",
            "to solar west, arcsec",
        ] {
            assert!(svg.contains(text), "{text}");
        }
        assert!(!svg.contains("NaN") && !svg.contains("not valid"));
        assert!(path_map(&labels(), &field, &[], None).is_err());
    }

    #[test]
    fn what_is_not_valid_is_grey_and_lines_end_at_the_panel() {
        let limb: Line = (0..=36)
            .map(|n| (f64::from(n) * 10.0).to_radians().sin_cos())
            .map(|(sin, cos)| (500.0 * cos, 500.0 * sin))
            .collect();
        let field = MapField {
            outline: limb,
            target: vec![(3.0, 4.0)],
            ..MapField::over(400.0..600.0, -100.0..100.0)
        };
        let slew = |n: u32| PathPosition {
            is_valid: n < 50,
            ..position(n, (f64::from(n) * 10.0, 0.0))
        };
        let path: Vec<PathPosition> = (0..100).map(slew).collect();
        let svg = path_map(&labels(), &field, &path, None).unwrap();
        assert!(svg.contains("not valid") && !svg.contains(">target<"));
        let grey = across(&svg, &format!("stroke=\"{INVALID}\" stroke-width=\"2\"")).concat();
        assert!(grey.iter().all(|x| (78.0..=600.0).contains(x)), "{grey:?}");
        let limb = across(&svg, "#b5761c").concat();
        assert!(!limb.is_empty() && limb.iter().all(|x| (78.0..=600.0).contains(x)));
    }

    #[test]
    fn an_ellipse_that_does_not_show_is_said() {
        let field = MapField::about_zero(100.0);
        let drawn = |size: f64| {
            let ellipse = Ellipse {
                name: "1 sigma".into(),
                semi_axes: [size, size / 2.0],
                turn_rad: 0.3,
            };
            path_map(
                &labels(),
                &field,
                &[position(0, (0.0, 0.0))],
                Some(&ellipse),
            )
            .unwrap()
        };
        assert!(drawn(0.1).contains("1 sigma: too small to show"));
        assert!(drawn(5.0).contains("1 sigma (lower left)"));
    }

    #[test]
    fn a_day_of_swings_at_ten_hertz_stays_small() {
        let swing = |period_s: f64, n: u32| (f64::from(n) * 0.628 / period_s).sin();
        let path: Vec<PathPosition> = (0..864_000)
            .map(|n| {
                let drift = 300.0 * swing(80_000.0, n);
                let at = (drift + 60.0 * swing(9.1, n), 40.0 * swing(5.3, n));
                position(n, at)
            })
            .collect();
        for reach in [1100.0, 400.0] {
            let svg = path_map(&labels(), &MapField::about_zero(reach), &path, None).unwrap();
            assert!(svg.len() < 1_000_000, "{reach}: {}", svg.len());
        }
    }
}
