//! Axes: range and ticks.

use jiff::Timestamp;
use jiff::tz::TimeZone;

/// Scale of an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scale {
    Linear,
    Logarithmic,
    /// Seconds since 1970-01-01, UTC.
    Utc,
}

/// An axis from its lowest value to its highest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Axis {
    pub scale: Scale,
    pub low: f64,
    pub high: f64,
}

/// A tick with its label, and the date below it where a new day begins.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Tick {
    pub at: f64,
    pub label: String,
    pub date: Option<String>,
}

const MINUTE_S: f64 = 60.0;
const HOUR_S: f64 = 3600.0;
const DAY_S: f64 = 86_400.0;

/// The smallest and the largest of the finite values.
pub(super) fn extent(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    let finite = values.filter(|value| value.is_finite());
    finite.fold(None, |extent, v| {
        let (low, high) = extent.unwrap_or((v, v));
        Some((low.min(v), high.max(v)))
    })
}

impl Axis {
    /// An axis with exactly this range.
    pub(super) fn exact(low: f64, high: f64) -> Self {
        Self {
            scale: Scale::Linear,
            low,
            high,
        }
    }

    /// Spans values with some space at both ends; a single value is centred.
    pub(super) fn linear((low, high): (f64, f64)) -> Self {
        let space = match high - low {
            span if span > 1e-9 * high.abs().max(low.abs()) => 0.04 * span,
            _ if high != 0.0 => 0.05 * high.abs(),
            _ => 1.0,
        };
        Self::exact(low - space, high + space)
    }

    /// Spans times, at least one second.
    pub(super) fn utc((low, high): (f64, f64)) -> Self {
        let space = (0.01 * (high - low)).max(0.5);
        Self {
            scale: Scale::Utc,
            low: low - space,
            high: high + space,
        }
    }

    /// An axis of times with exactly this range, s since 1970.
    pub(super) fn exact_utc(low: f64, high: f64) -> Self {
        let scale = Scale::Utc;
        Self { scale, low, high }
    }

    /// Spans positive values on a logarithmic scale.
    pub(super) fn logarithmic((low, high): (f64, f64)) -> Self {
        Self {
            scale: Scale::Logarithmic,
            low: low / 1.15,
            high: high * 1.15,
        }
    }

    /// Position of a value: 0 at the low end, 1 at the high one.
    pub(super) fn fraction(&self, value: f64) -> f64 {
        match self.scale {
            Scale::Logarithmic => (value / self.low).ln() / (self.high / self.low).ln(),
            Scale::Linear | Scale::Utc => (value - self.low) / (self.high - self.low),
        }
    }

    /// The power of ten omitted in labels of very large or small values.
    pub(super) fn exponent(&self) -> i32 {
        let largest = self.low.abs().max(self.high.abs());
        let is_plain = (1e-2..1e5).contains(&largest);
        match self.scale {
            Scale::Linear if !is_plain && largest > 0.0 => {
                3 * (largest.log10() / 3.0).floor() as i32
            }
            _ => 0,
        }
    }

    /// Approximately `about` ticks, at least two.
    pub(super) fn ticks(&self, about: usize) -> Vec<Tick> {
        match self.scale {
            Scale::Linear => self.linear_ticks(about),
            Scale::Logarithmic => self.logarithmic_ticks(about),
            Scale::Utc => self.utc_ticks(about),
        }
    }

    fn linear_ticks(&self, about: usize) -> Vec<Tick> {
        let unit = 10_f64.powi(self.exponent());
        let step = step(self.high - self.low, about);
        let decimals = decimals(step / unit);
        let tick = |at: f64| Tick {
            at,
            label: fixed(at / unit, decimals),
            date: None,
        };
        multiples(self.low, self.high, step).map(tick).collect()
    }

    /// Ticks at 1, 2 and 5 of each decade, or for many decades at each or every few; if these are too few, evenly spaced ones.
    fn logarithmic_ticks(&self, about: usize) -> Vec<Tick> {
        let decades = self.low.log10().floor() as i32..=self.high.log10().ceil() as i32;
        let span = (self.high / self.low).log10();
        let digits: &[f64] = match span {
            s if 3.0 * s <= about as f64 + 1.0 => &[1.0, 2.0, 5.0],
            _ => &[1.0],
        };
        let every = (span / about as f64).ceil().max(1.0) as i32;
        let decades = decades.filter(|decade| decade % every == 0);
        let values = decades.flat_map(|decade| digits.iter().map(move |d| (*d, decade)));
        let within = |(digit, decade): (f64, i32)| {
            let at = digit * 10_f64.powi(decade);
            let inside = (self.low..=self.high).contains(&at);
            inside.then(|| Tick {
                at,
                label: power_text(digit, decade),
                date: None,
            })
        };
        let ticks: Vec<Tick> = values.filter_map(within).collect();
        match ticks.len() {
            0..3 => self.linear_ticks(about.min(4)),
            _ => ticks,
        }
    }

    fn utc_ticks(&self, about: usize) -> Vec<Tick> {
        let step = time_step(self.high - self.low, about);
        let mut day = None;
        let tick = |at: f64| {
            let date = date(at);
            if step >= DAY_S {
                return Tick {
                    at,
                    label: date,
                    date: None,
                };
            }
            let label = time_of_day(at, step);
            let new = (day.as_ref() != Some(&date)).then(|| date.clone());
            day = Some(date);
            Tick {
                at,
                label,
                date: new,
            }
        };
        multiples(self.low, self.high, step).map(tick).collect()
    }
}

/// The multiples of a step within a range.
fn multiples(low: f64, high: f64, step: f64) -> impl Iterator<Item = f64> {
    // Tolerate rounding, so that a tick at the end is kept.
    let (first, last) = ((low / step - 1e-9).ceil(), (high / step + 1e-9).floor());
    (0..=(last - first).max(0.0) as usize).map(move |n| (first + n as f64) * step)
}

/// 1, 2 or 5 times a power of ten that divides a span into approximately `about` parts, never fewer than two.
fn step(span: f64, about: usize) -> f64 {
    let raw = span / about.max(2) as f64;
    let decade = 10_f64.powf(raw.log10().floor());
    let factors = [1.0, 2.0, 5.0, 10.0];
    let found = factors
        .iter()
        .find(|factor| *factor * decade >= raw * 0.999);
    let step = found.unwrap_or(&10.0) * decade;
    // Three parts contain at least two ticks.
    if step * 3.0 > span { step / 2.5 } else { step }
}

/// A step of time in conventional units, s.
fn time_step(span_s: f64, about: usize) -> f64 {
    const STEPS_S: [f64; 19] = [
        1.0, 2.0, 5.0, 10.0, 15.0, 30.0, 60.0, 120.0, 300.0, 600.0, 900.0, 1800.0, 3600.0, 7200.0,
        10_800.0, 21_600.0, 43_200.0, 86_400.0, 172_800.0,
    ];
    let raw = span_s / about.max(2) as f64;
    if raw < STEPS_S[0] / 2.0 {
        return step(span_s, about);
    }
    let found = STEPS_S.iter().find(|step| **step >= raw * 0.999);
    found
        .copied()
        .unwrap_or_else(|| DAY_S * step(span_s / DAY_S, about).ceil())
}

/// The decimals needed to distinguish multiples of a step.
pub(super) fn decimals(step: f64) -> usize {
    (0..12)
        .find(|decimals| {
            let scaled = step * 10_f64.powi(*decimals);
            (scaled - scaled.round()).abs() < 1e-6 * scaled.max(1.0) && scaled > 0.5
        })
        .unwrap_or(12) as usize
}

/// A number with a number of decimals; never "-0".
pub(super) fn fixed(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    match text.strip_prefix('-') {
        Some(rest) if rest.chars().all(|c| c == '0' || c == '.') => rest.into(),
        _ => text,
    }
}

/// A value to a number of significant digits, in its shortest form.
pub(super) fn short(value: f64, digits: i32) -> String {
    if value == 0.0 || !value.is_finite() {
        return fixed(value, 0);
    }
    let decade = value.abs().log10().floor() as i32;
    match decade {
        -4..6 => fixed(value, (digits - 1 - decade).max(0) as usize),
        _ => format!("{value:.*e}", (digits - 1).max(0) as usize),
    }
}

/// A digit times a power of ten, written in full if that is short.
fn power_text(digit: f64, decade: i32) -> String {
    match decade {
        -3..0 => fixed(digit * 10_f64.powi(decade), decade.unsigned_abs() as usize),
        0..4 => fixed(digit * 10_f64.powi(decade), 0),
        _ if digit == 1.0 => format!("10{}", superscript(decade)),
        _ => format!("{digit}\u{b7}10{}", superscript(decade)),
    }
}

/// An exponent in superscript digits.
pub(super) fn superscript(exponent: i32) -> String {
    const SUPERSCRIPTS: [char; 10] = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'];
    let superscript = |c: char| {
        c.to_digit(10)
            .map_or('⁻', |digit| SUPERSCRIPTS[digit as usize])
    };
    exponent.to_string().chars().map(superscript).collect()
}

fn zoned(unix_s: f64) -> Option<jiff::Zoned> {
    let ns = (unix_s * 1e6).round() as i128 * 1000;
    let timestamp = Timestamp::from_nanosecond(ns).ok()?;
    Some(timestamp.to_zoned(TimeZone::UTC))
}

/// The date of a time, UTC.
pub(super) fn date(unix_s: f64) -> String {
    zoned(unix_s).map_or_else(String::new, |at| at.date().to_string())
}

/// Hours and minutes, and seconds if a step needs them.
fn time_of_day(unix_s: f64, step_s: f64) -> String {
    let Some(at) = zoned(unix_s) else {
        return String::new();
    };
    let (hour, minute, second) = (at.hour(), at.minute(), at.second());
    if step_s % MINUTE_S == 0.0 || step_s % HOUR_S == 0.0 {
        return format!("{hour:02}:{minute:02}");
    }
    let fraction = match decimals(step_s) {
        0 => String::new(),
        decimals => {
            let text = format!("{:.decimals$}", f64::from(at.subsec_nanosecond()) / 1e9);
            text.trim_start_matches(['0', '1']).to_owned()
        }
    };
    format!("{hour:02}:{minute:02}:{second:02}{fraction}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(axis: Axis, about: usize) -> Vec<String> {
        axis.ticks(about).into_iter().map(|t| t.label).collect()
    }

    #[test]
    fn every_axis_has_two_ticks_at_least_all_different_and_no_minus_zero() {
        for span in [1e-9, 3e-5, 0.004, 0.07, 0.99, 1.0, 1.9, 2.0, 37.0, 1e4, 3e8] {
            for low in [-1.0, -0.5, -0.03, 0.0, 0.4, 7.0] {
                for axis in [
                    Axis::linear((low * span, (low + 1.0) * span)),
                    Axis::utc((1e9 + low * span, 1e9 + (low + 1.0) * span)),
                    Axis::logarithmic((span, span * (1.0 + low.abs()))),
                ] {
                    let labels = labels(axis, 6);
                    assert!((2..=20).contains(&labels.len()), "{axis:?} {labels:?}");
                    assert!(labels.windows(2).all(|w| w[0] != w[1]), "{labels:?}");
                    let minus_zero = |l: &String| l.starts_with('-') && l.parse() == Ok(0.0);
                    assert!(!labels.iter().any(minus_zero), "{labels:?}");
                }
            }
        }
    }

    #[test]
    fn values_below_a_tenth_have_digits_enough() {
        assert_eq!(
            labels(Axis::exact(-0.021, 0.041), 7),
            ["-0.02", "-0.01", "0.00", "0.01", "0.02", "0.03", "0.04"]
        );
        let axis = Axis::exact(0.0, 4e-6);
        assert_eq!(
            (labels(axis, 4), axis.exponent()),
            (
                vec!["0".into(), "1".into(), "2".into(), "3".into(), "4".into()],
                -6
            )
        );
    }

    #[test]
    fn times_are_of_the_clock_and_dates_stand_where_days_begin() {
        // 2013-09-21 22:00 UTC to four hours later.
        let axis = Axis {
            scale: Scale::Utc,
            low: 1_379_800_800.0,
            high: 1_379_815_200.0,
        };
        let ticks = axis.ticks(5);
        let labels: Vec<&str> = ticks.iter().map(|tick| tick.label.as_str()).collect();
        assert_eq!(labels, ["22:00", "23:00", "00:00", "01:00", "02:00"]);
        let dates: Vec<_> = ticks
            .iter()
            .filter_map(|tick| tick.date.as_deref())
            .collect();
        assert_eq!(dates, ["2013-09-21", "2013-09-22"]);
        assert_eq!(time_of_day(1_379_800_801.25, 0.05), "22:00:01.25");
        assert_eq!(time_of_day(1_379_800_801.0, 5.0), "22:00:01");
    }

    #[test]
    fn decades_are_labelled_in_full_or_as_powers() {
        assert_eq!(
            labels(
                Axis {
                    scale: Scale::Logarithmic,
                    low: 0.01,
                    high: 1.0
                },
                6
            ),
            ["0.01", "0.02", "0.05", "0.1", "0.2", "0.5", "1"]
        );
        let wide = labels(
            Axis {
                scale: Scale::Logarithmic,
                low: 1e-6,
                high: 1.0,
            },
            6,
        );
        assert_eq!(wide[0], "10⁻⁶");
    }
}
