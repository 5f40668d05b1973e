//! Page of an attitude.

use super::Counts;
use crate::clock::utc_microseconds;
use crate::navigation::{NavigationSettings, SensorErrors, Source, Status, Summary, Verdict};
use crate::report::html::Page;
use crate::report::plot::{Labels, Series, series};
use crate::units::ARCSEC_PER_RAD;
use jiff::Timestamp;
use nalgebra::Vector3;
use std::collections::{BTreeMap, BTreeSet};

const AXES: [&str; 3] = ["x", "y", "z"];
/// The colour of limits, grey.
const LIMIT_HUE: usize = 5;

/// Adds the figures and tables of an attitude.
pub fn add_attitude(
    page: &mut Page,
    settings: &NavigationSettings,
    summary: &Summary,
    counts: &Counts,
) -> anyhow::Result<()> {
    page.heading("Rows of the attitude");
    let row = |status: Status| vec![status.name().to_owned(), counts.of(status).to_string()];
    page.table(&["status", "rows"], &Status::ALL.map(row));
    let clock = Clock::of(settings);
    sigmas(page, clock, summary)?;
    gaps(page, clock, summary);
    innovations(page, clock, settings, summary)?;
    sensors(page, clock, settings, &summary.errors)
}

/// Zero of a time axis.
#[derive(Clone, Copy)]
struct Clock {
    /// Time at t_s = 0, s since 1970-01-01; none where the epoch is not known.
    epoch_unix_s: Option<f64>,
}

impl Clock {
    fn of(settings: &NavigationSettings) -> Self {
        let unix_s = |epoch: Timestamp| epoch.as_nanosecond() as f64 / 1e9;
        Self {
            epoch_unix_s: settings.epoch_utc.map(unix_s),
        }
    }

    fn labels(self, title: impl Into<String>, y: &str) -> Labels {
        match self.epoch_unix_s {
            Some(_) => Labels::over_utc(title, y),
            None => Labels::new(title, "t, s", y),
        }
    }

    /// A time on the axis.
    fn at(self, t_s: f64) -> f64 {
        self.epoch_unix_s.unwrap_or(0.0) + t_s
    }

    /// Unit of the time axis.
    fn unit(self) -> &'static str {
        self.epoch_unix_s.map_or("s", |_| "UTC")
    }

    /// A time as text for a table.
    fn text(self, t_s: f64) -> String {
        let utc =
            || Timestamp::from_microsecond(((self.epoch_unix_s? + t_s) * 1e6).round() as i64).ok();
        utc().map_or_else(|| format!("{t_s:.2}"), utc_microseconds)
    }
}

fn sigmas(page: &mut Page, clock: Clock, summary: &Summary) -> anyhow::Result<()> {
    page.heading("Attitude");
    let sigmas = &summary.attitude_sigmas;
    let along = |axis: usize| {
        let point = move |(t_s, sigma): &(f64, Vector3<f64>)| {
            (clock.at(*t_s), sigma[axis] * ARCSEC_PER_RAD)
        };
        Series::line(AXES[axis], sigmas.iter().map(point)).up_to_five_medians()
    };
    if !sigmas.is_empty() {
        let title = "1 sigma about the axes of ECEF, by the measurements up to each time, up to five times the median";
        let drawn = [0, 1, 2].map(along);
        page.figure(&series(&clock.labels(title, "arcsec"), &drawn)?, "");
    }
    Ok(())
}

fn gaps(page: &mut Page, clock: Clock, summary: &Summary) {
    page.heading("Gaps");
    if summary.gaps.is_empty() {
        return page.note("Directions were never missing for longer than 10 s.");
    }
    let rows: Vec<Vec<String>> = summary
        .gaps
        .iter()
        .map(|(from_s, to_s)| {
            let without_s = format!("{:.2}", to_s - from_s);
            vec![clock.text(*from_s), clock.text(*to_s), without_s]
        })
        .collect();
    let [last, next] = ["last direction", "next one"].map(|of| format!("{of}, {}", clock.unit()));
    page.table(&[&last, &next, "without, s"], &rows);
}

fn innovations(
    page: &mut Page,
    clock: Clock,
    settings: &NavigationSettings,
    summary: &Summary,
) -> anyhow::Result<()> {
    page.heading("Innovations");
    page.note(
        "Measured less predicted, in units of the 1 sigma that was expected; of each axis what the axes before it do not say. 3 sigma hold 99.7 % of \
         good ones.",
    );
    let sources: BTreeSet<Source> = summary.innovations.iter().map(|one| one.source).collect();
    let mut rows = Vec::new();
    for source in sources {
        let own = || {
            summary
                .innovations
                .iter()
                .filter(move |one| one.source == source)
        };
        let taken = || own().filter(|one| one.verdict == Verdict::Taken);
        let axes = taken().map(|one| one.axes.len()).sum::<usize>() as f64;
        let squares: f64 = taken().map(|one| one.chi2).sum();
        let name = name(settings, source);
        let per_axis = (axes > 0.0).then(|| format!("{:.3}", squares / axes));
        rows.push(vec![
            name.clone(),
            taken().count().to_string(),
            (own().count() - taken().count()).to_string(),
            per_axis.unwrap_or("not known".into()),
        ]);
        let dots = |axis: usize| {
            let points = taken().filter_map(|one| {
                // The residual over an axis's own sigma is not meaningful where a correlated axis is unknown, such as a receiver's climb.
                let whitened = one.whitened.get(axis)?;
                Some((clock.at(one.t_s), *whitened))
            });
            Series::dots(AXES[axis], points)
        };
        let count = taken().map(|one| one.axes.len()).max().unwrap_or(0);
        let mut drawn: Vec<Series> = (0..count).map(dots).collect();
        let times = || taken().map(|one| one.t_s);
        if let Some((first, last)) = times()
            .min_by(f64::total_cmp)
            .zip(times().max_by(f64::total_cmp))
        {
            let ends = [first, last].map(|t_s| clock.at(t_s));
            drawn.extend([(3.0, "\u{b1} 3 sigma"), (-3.0, "")].map(|(bound, name)| {
                Series::limit(name, ends.map(|at| (at, bound))).in_hue(LIMIT_HUE)
            }));
            let labels = clock.labels(name, "innovation over its sigma");
            page.figure(&series(&labels, &drawn)?, "");
        }
    }
    page.table(
        &[
            "measurement",
            "taken",
            "refused",
            "square over covariance, per axis",
        ],
        &rows,
    );
    Ok(())
}

fn name(settings: &NavigationSettings, source: Source) -> String {
    match source {
        Source::Plumb => "gravity".into(),
        Source::Position => "GPS position".into(),
        Source::Velocity => "GPS velocity".into(),
        Source::Direction { camera, target } => {
            format!("{} ({})", target.name(), settings.cameras[camera].name)
        }
    }
}

/// Three errors, and 1 sigma of each.
type Triad = (Vector3<f64>, Vector3<f64>);
/// A unit, and errors with time.
type Figure = (&'static str, Vec<(f64, Triad)>);

/// The estimated errors of the sensors with time, and their 3 sigma.
fn sensors(
    page: &mut Page,
    clock: Clock,
    settings: &NavigationSettings,
    errors: &[SensorErrors],
) -> anyhow::Result<()> {
    page.heading("Sensors");
    let mut figures: BTreeMap<String, Figure> = BTreeMap::new();
    for one in errors {
        let mut add = |name: String, unit, triad: Option<Triad>, scale: f64| {
            let Some((value, sigma)) = triad else { return };
            let figure = figures.entry(name).or_insert((unit, Vec::new()));
            figure.1.push((one.t_s, (value * scale, sigma * scale)));
        };
        add("Accelerometer bias".into(), "m/s^2", one.biases[0], 1.0);
        add(
            "Gyro bias".into(),
            "arcsec/s",
            one.biases[1],
            ARCSEC_PER_RAD,
        );
        for (camera, triad) in settings.cameras.iter().zip(&one.cameras) {
            let name = format!("Misalignment of camera {}", camera.name);
            add(name, "deg", *triad, 1f64.to_degrees());
        }
    }
    for (name, (unit, points)) in figures {
        let mut drawn = Vec::new();
        for (axis, label) in AXES.iter().enumerate() {
            let of = |value: fn(f64, f64) -> f64| {
                let point =
                    move |(t_s, (v, s)): &(f64, Triad)| (clock.at(*t_s), value(v[axis], s[axis]));
                points.iter().map(point).collect::<Vec<_>>()
            };
            let limits = format!("{label} \u{b1} 3 sigma");
            let series = [
                Series::line(*label, of(|value, _| value)),
                Series::limit(limits, of(|value, sigma| value + 3.0 * sigma)),
                Series::limit("", of(|value, sigma| value - 3.0 * sigma)),
            ];
            drawn.extend(series.map(|series| series.in_hue(axis)));
        }
        page.figure(&series(&clock.labels(name, unit), &drawn)?, "");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_are_in_utc_where_the_epoch_is_known() {
        let summary = Summary {
            gaps: vec![(1_379_786_400.0, 1_379_786_412.5)],
            ..Summary::default()
        };
        let shown = |epoch_unix_s| {
            let mut page = Page::default();
            gaps(&mut page, Clock { epoch_unix_s }, &summary);
            page.finish("")
        };
        let known = shown(Some(0.0));
        for text in [
            "<td>2013-09-21T18:00:00.000000Z</td><td>2013-09-21T18:00:12.500000Z</td><td>12.50</td>",
            "last direction, UTC",
        ] {
            assert!(known.contains(text), "{known}");
        }
        assert!(shown(None).contains("last direction, s"));
    }
}
