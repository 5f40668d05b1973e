//! The boresight's path on the Sun in equal steps of time, and its distance from the target.

use super::sky::Sky;
use crate::estimation::median;
use crate::pointing::{HelioprojectiveArcsec, Target};
use crate::pointing_history::{LineOfSight, PointingHistory};
use crate::sky::sphere::separation_rad;
use crate::sky::{Disc, Ephemeris};
use crate::units::ARCSEC_PER_RAD;
use jiff::Timestamp;
use nalgebra::{Matrix2, Vector2};
use serde::Serialize;
use std::fmt;

/// Steps a second, and the greatest number of steps: longer flights have longer steps.
const RATE_HZ: f64 = 10.0;
const MOST_STEPS: f64 = 1e6;
/// A target that rotates with the Sun is computed once in this time, s: it moves by less than 0.2 arcsec.
const TARGET_EVERY_S: f64 = 60.0;

/// Position of the boresight at a moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SolarStep {
    /// UTC, s since 1970-01-01.
    pub unix_s: f64,
    pub at: HelioprojectiveArcsec,
    pub is_valid: bool,
    /// True angle from the target; none where the target is behind the limb.
    pub from_target_arcsec: Option<f64>,
}

/// The boresight's positions on the Sun, at the times at which they are known.
#[derive(Debug, Clone, PartialEq)]
pub struct SolarPath {
    pub steps: Vec<SolarStep>,
    /// Steps a second.
    pub rate_hz: f64,
    /// The target's positions over the flight: a single one if it is fixed.
    pub target: Vec<HelioprojectiveArcsec>,
    /// The middle of the flight, and the Sun's orientation then.
    pub disc: Option<(Timestamp, Disc)>,
    /// Covariance of the boresight to solar west and north, random part: the mean over the valid steps.
    pub covariance_arcsec2: Option<Matrix2<f64>>,
}

impl SolarPath {
    /// Evaluates the pointing of a flight.
    pub fn of(pointing: &PointingHistory, sky: &Sky) -> Self {
        let ends_s = pointing.ends_s().unwrap_or([0.0; 2]);
        let duration_s = ends_s[1] - ends_s[0];
        let rate_hz = RATE_HZ.min(MOST_STEPS / duration_s.max(1.0));
        let mut ephemeris = sky.ephemeris.clone();
        let middle = utc(f64::midpoint(ends_s[0], ends_s[1]));
        let disc = middle.and_then(|utc| Some((utc, ephemeris.disc(utc).ok()?)));
        let (mut target, mut steps) = (TargetWay::default(), Vec::new());
        let (mut covariance, mut valid) = (Matrix2::zeros(), 0.0);
        for row in pointing.rows(rate_hz) {
            let Some(line_of_sight) = row.pointed.line_of_sight else {
                continue;
            };
            let aim = target.at(row.unix_s, &sky.target, &mut ephemeris);
            let boresight = line_of_sight.sun_from_telescope.column(0).into_owned();
            let from = |aim: HelioprojectiveArcsec| separation_rad(&boresight, &aim.direction());
            let is_valid = row.pointed.is_valid();
            if is_valid {
                covariance += on_the_sun(&line_of_sight);
                valid += 1.0;
            }
            steps.push(SolarStep {
                unix_s: row.unix_s,
                at: line_of_sight.helioprojective_arcsec,
                is_valid,
                from_target_arcsec: aim.map(|aim| from(aim) * ARCSEC_PER_RAD),
            });
        }
        Self {
            steps,
            rate_hz,
            target: target.places,
            disc,
            covariance_arcsec2: (valid > 0.0).then(|| covariance / valid),
        }
    }

    pub fn valid(&self) -> impl Iterator<Item = &SolarStep> + Clone {
        self.steps.iter().filter(|step| step.is_valid)
    }

    /// Distances from the target over the valid time, arcsec.
    pub fn distances_arcsec(&self) -> Vec<f64> {
        let distances = self.valid().map(|step| step.from_target_arcsec);
        distances.flatten().collect()
    }

    /// Statistics of the distance from the target; none where the pointing is never valid, or the target never in view.
    pub fn on_target(&self) -> Option<OnTarget> {
        let distances = self.distances_arcsec();
        let seconds = |steps: usize| steps as f64 / self.rate_hz;
        let within_s = |limit_arcsec: f64| {
            let within = distances.iter().filter(|far| **far <= limit_arcsec);
            seconds(within.count())
        };
        Some(OnTarget {
            valid_s: seconds(self.valid().count()),
            within_20_arcsec_s: within_s(20.0),
            within_60_arcsec_s: within_s(60.0),
            median_arcsec: median(&distances)?,
        })
    }
}

/// Time that the boresight spent near its target, by the valid pointing.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct OnTarget {
    /// The valid time, s.
    pub valid_s: f64,
    pub within_20_arcsec_s: f64,
    pub within_60_arcsec_s: f64,
    /// Median distance over the valid time.
    pub median_arcsec: f64,
}

impl OnTarget {
    /// The limits of the requirements by name: the time within each, and its part of the valid time.
    pub fn within(&self) -> [(&'static str, String); 2] {
        [
            ("20 arcsec", self.within_20_arcsec_s),
            ("1 arcmin", self.within_60_arcsec_s),
        ]
        .map(|(limit, time_s)| (limit, self.share(time_s)))
    }

    fn share(&self, time_s: f64) -> String {
        let percent = 100.0 * time_s / self.valid_s;
        format!("{time_s:.1} s ({:.1} min), {percent:.1} %", time_s / 60.0)
    }
}

/// One line, for people.
impl fmt::Display for OnTarget {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [near, wide] = self.within();
        write!(
            out,
            "pointing valid for {:.1} s; within {} of the target for {}; within {} for {}; median {:.1} arcsec",
            self.valid_s, near.0, near.1, wide.0, wide.1, self.median_arcsec
        )
    }
}

fn utc(unix_s: f64) -> Option<Timestamp> {
    Timestamp::from_nanosecond((unix_s * 1e9) as i128).ok()
}

/// Rotates the random covariance of a boresight from the telescope's right and up to solar west and north.
fn on_the_sun(line_of_sight: &LineOfSight) -> Matrix2<f64> {
    let towards = |axis: usize| {
        let column = line_of_sight.sun_from_telescope.column(axis);
        Vector2::new(column[1], column[2])
    };
    // The telescope's third axis is down.
    let turn = Matrix2::from_columns(&[towards(1), -towards(2)]);
    turn * line_of_sight.random_arcsec2.fixed_view::<2, 2>(0, 0) * turn.transpose()
}

/// The target's positions so far.
#[derive(Default)]
struct TargetWay {
    minute: Option<f64>,
    now: Option<HelioprojectiveArcsec>,
    places: Vec<HelioprojectiveArcsec>,
}

impl TargetWay {
    /// Position of the target at a time; times must be in order. None behind the limb.
    fn at(
        &mut self,
        unix_s: f64,
        target: &Target,
        ephemeris: &mut Ephemeris,
    ) -> Option<HelioprojectiveArcsec> {
        let minute = (unix_s / TARGET_EVERY_S).floor();
        if self.minute.replace(minute) != Some(minute) {
            self.now = utc((minute + 0.5) * TARGET_EVERY_S).and_then(|utc| {
                let disc = ephemeris.disc(utc).ok()?;
                target.on_disc(utc, &disc).ok()
            });
            if self.places.last() != self.now.as_ref() {
                self.places.extend(self.now);
            }
        }
        self.now
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pointing::Feature;
    use crate::pointing_history::{Basis, Second, State};
    use nalgebra::{Matrix3, Rotation3, UnitQuaternion, UnitVector3, Vector3};

    const START_S: i64 = 1_379_786_400;
    const TARGET: HelioprojectiveArcsec = HelioprojectiveArcsec {
        x: 300.0,
        y: -200.0,
    };

    fn to_sun() -> Vector3<f64> {
        Vector3::new(-0.31, -0.62, 0.72).normalize()
    }

    fn north() -> Vector3<f64> {
        (Vector3::z() - to_sun() * to_sun().z).normalize()
    }

    /// A telescope that points at a position near the Sun, its up axis towards solar north.
    fn state(since_s: f64, at: HelioprojectiveArcsec) -> State {
        let axes = Matrix3::from_columns(&[to_sun(), to_sun().cross(&north()), north()]);
        let forward = axes * at.direction();
        let right = forward.cross(&north()).normalize();
        let telescope = Matrix3::from_columns(&[forward, right, forward.cross(&right)]);
        let arcsec2 = Matrix3::from_diagonal(&Vector3::new(4.0, 1.0, 1.0));
        State {
            unix_s: START_S as f64 + since_s,
            attitude: UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(
                telescope,
            )),
            rate_rad_s: Vector3::zeros(),
            covariance_rad2: arcsec2 / ARCSEC_PER_RAD.powi(2),
            basis: Basis::Sun,
            is_contradicted: false,
        }
    }

    fn history(states: Vec<State>) -> PointingHistory {
        let second = |n: i64| Second {
            unix_s: START_S + n,
            position_m: Vector3::new(-1_302_000.0, -5_137_000.0, 3_617_000.0),
            to_sun: UnitVector3::new_normalize(to_sun()),
            north: UnitVector3::new_normalize(north()),
            systematic_rad2: Matrix3::zeros(),
        };
        PointingHistory::new(states, (0..200).map(second).collect())
    }

    fn sky() -> Sky {
        Sky {
            target: Target::Fixed(TARGET),
            place: None,
            ephemeris: Ephemeris::default(),
        }
    }

    fn off(west_arcsec: f64, north_arcsec: f64) -> HelioprojectiveArcsec {
        HelioprojectiveArcsec {
            x: TARGET.x + west_arcsec,
            y: TARGET.y + north_arcsec,
        }
    }

    /// 30 s at 10 arcsec from the target, 10 s at 40, then a gap of 20 s, then 10 s at 500 that are contradicted.
    fn flown() -> SolarPath {
        let at = |n: u32| f64::from(n) / 10.0;
        let mut states: Vec<State> = (0..=300).map(|n| state(at(n), off(6.0, 8.0))).collect();
        states.extend((301..=400).map(|n| state(at(n), off(0.0, 40.0))));
        states.extend((600..=700).map(|n| state(at(n), off(500.0, 0.0))));
        let mut history = history(states);
        history.contradict([60.0, 70.0].map(|s| START_S as f64 + s));
        SolarPath::of(&history, &sky())
    }

    #[test]
    fn time_near_the_target_is_of_the_valid_pointing_in_equal_steps() {
        let found = flown().on_target().unwrap();
        for (found, truth) in [
            (found.valid_s, 40.0),
            (found.within_20_arcsec_s, 30.0),
            (found.within_60_arcsec_s, 40.0),
        ] {
            assert!((found - truth).abs() < 0.25, "{found} {truth}");
        }
        assert!((found.median_arcsec - 10.0).abs() < 1e-3, "{found:?}");
        let [near, wide] = found.within();
        assert!(near.1.contains("s (0.5 min), 75."), "{near:?}");
        assert!(wide.1.ends_with("100.0 %"), "{wide:?}");
    }

    #[test]
    fn steps_in_a_gap_are_none_and_contradicted_ones_are_not_valid() {
        let path = flown();
        let since = |step: &SolarStep| step.unix_s - START_S as f64;
        assert!(
            !path
                .steps
                .iter()
                .any(|step| (40.2..59.8).contains(&since(step)))
        );
        let late = path.steps.iter().filter(|step| since(step) > 59.9);
        assert!(late.clone().count() > 90 && late.clone().all(|step| !step.is_valid));
        assert_eq!(path.target, [TARGET]);
    }

    #[test]
    fn the_larger_error_to_the_right_is_one_to_solar_west() {
        let covariance = flown().covariance_arcsec2.unwrap();
        assert!((covariance.m11 - 4.0).abs() < 0.01, "{covariance}");
        assert!((covariance.m22 - 1.0).abs() < 0.01, "{covariance}");
    }

    #[test]
    fn nothing_is_said_of_a_flight_without_a_pointing() {
        let path = SolarPath::of(&history(Vec::new()), &sky());
        assert!(path.steps.is_empty() && path.on_target().is_none());
    }

    #[test]
    fn a_feature_of_the_surface_moves_to_the_west_by_the_hour() {
        let mut ephemeris = Ephemeris::default();
        let utc = utc(START_S as f64).unwrap();
        let disc = ephemeris.disc(utc).unwrap();
        let feature = Feature::seen(TARGET, utc, &disc).unwrap();
        let mut way = TargetWay::default();
        for minute in 0..60 {
            let unix_s = START_S as f64 + 60.0 * f64::from(minute);
            way.at(unix_s, &Target::Feature(feature), &mut ephemeris);
        }
        let [first, last] = [way.places[0], way.places[59]];
        // At the equator 10 arcsec an hour; less towards limb and pole.
        assert!(
            (5.0..10.0).contains(&(last.x - first.x)),
            "{first:?} {last:?}"
        );
    }
}
