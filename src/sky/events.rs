//! Times at which a quantity of the Sun changes sign: rise, transit, set, and time spans in a range of elevations.

use super::SkyError;
use crate::units::{EARTH_RADIUS_M, Place};
use jiff::{SignedDuration, Timestamp};

/// Interval of the search: two crossings within it may be missed.
const GRID: SignedDuration = SignedDuration::from_mins(5);
/// Precision of a crossing.
const PRECISION: SignedDuration = SignedDuration::from_millis(50);

/// Direction of a zero crossing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rising {
    Up,
    Down,
}

/// A zero crossing of a value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Crossing {
    pub utc: Timestamp,
    pub rising: Rising,
}

/// Elevation of the Sun's centre at rise and set for an observer at a height, deg, without refraction: the upper limb (16 arcmin) is on
/// the horizon of a smooth Earth, lifted by the 34 arcmin of the almanacs.
///
/// From a height the horizon is lower by acos(R / (R + h)), 6.3 deg at 38.4 km. The ray that grazes it is refracted again on its way up
/// to the observer, by up to another 34 arcmin. This is neglected: a balloon sees the Sun some minutes longer.
pub fn horizon_deg(place: Place) -> f64 {
    const LIMB_AND_REFRACTION_DEG: f64 = 50.0 / 60.0;
    -horizon_dip_deg(place.height_m) - LIMB_AND_REFRACTION_DEG
}

/// Angle of the limb of a smooth Earth without atmosphere below the horizontal, from a height, deg.
pub fn horizon_dip_deg(height_m: f64) -> f64 {
    let dip = (EARTH_RADIUS_M / (EARTH_RADIUS_M + height_m.max(0.0))).acos();
    dip.to_degrees()
}

/// Zero crossings of a value between two instants, in order.
///
/// # Errors
/// Those of the value.
pub fn crossings(
    from: Timestamp,
    to: Timestamp,
    mut value: impl FnMut(Timestamp) -> Result<f64, SkyError>,
) -> Result<Vec<Crossing>, SkyError> {
    let mut found = Vec::new();
    let mut start = (from, value(from)?);
    while start.0 < to {
        let utc = later(start.0, GRID).min(to);
        let end = (utc, value(utc)?);
        if (start.1 < 0.0) != (end.1 < 0.0) {
            let rising = if start.1 < 0.0 {
                Rising::Up
            } else {
                Rising::Down
            };
            let utc = between(start, end, &mut value)?;
            found.push(Crossing { utc, rising });
        }
        start = end;
    }
    Ok(found)
}

/// Time spans between two instants in which a value is within limits.
///
/// # Errors
/// Those of the value.
pub fn spells(
    from: Timestamp,
    to: Timestamp,
    [low, high]: [f64; 2],
    mut value: impl FnMut(Timestamp) -> Result<f64, SkyError>,
) -> Result<Vec<[Timestamp; 2]>, SkyError> {
    let mut cuts = vec![from, to];
    for limit in [low, high] {
        let found = crossings(from, to, |utc| Ok(value(utc)? - limit))?;
        cuts.extend(found.iter().map(|crossing| crossing.utc));
    }
    cuts.sort();
    let mut spells: Vec<[Timestamp; 2]> = Vec::new();
    for pair in cuts.windows(2) {
        let middle = later(pair[0], pair[1].duration_since(pair[0]) / 2);
        if !(low..=high).contains(&value(middle)?) {
            continue;
        }
        match spells.last_mut() {
            Some(last) if last[1] == pair[0] => last[1] = pair[1],
            _ => spells.push([pair[0], pair[1]]),
        }
    }
    Ok(spells)
}

/// Finds a crossing by bisection.
fn between(
    mut start: (Timestamp, f64),
    mut end: (Timestamp, f64),
    value: &mut impl FnMut(Timestamp) -> Result<f64, SkyError>,
) -> Result<Timestamp, SkyError> {
    while end.0.duration_since(start.0) > PRECISION {
        let utc = later(start.0, end.0.duration_since(start.0) / 2);
        let middle = (utc, value(utc)?);
        if (middle.1 < 0.0) == (start.1 < 0.0) {
            start = middle;
        } else {
            end = middle;
        }
    }
    Ok(end.0)
}

fn later(utc: Timestamp, time: SignedDuration) -> Timestamp {
    utc.saturating_add(time).unwrap_or(Timestamp::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    const DAY_S: i64 = 86_400;

    fn at(second: i64) -> Timestamp {
        Timestamp::from_second(second).unwrap()
    }

    /// A sine with a period of one day, zero and rising at the beginning.
    fn wave(utc: Timestamp) -> Result<f64, SkyError> {
        Ok((utc.as_duration().as_secs_f64() / DAY_S as f64 * std::f64::consts::TAU).sin())
    }

    #[test]
    fn a_wave_goes_through_zero_where_it_does() {
        let found = crossings(at(100), at(DAY_S + 100), wave).unwrap();
        let expected = [(DAY_S / 2, Rising::Down), (DAY_S, Rising::Up)];
        assert_eq!(found.len(), 2);
        for (crossing, (second, rising)) in found.iter().zip(expected) {
            assert_eq!(crossing.rising, rising);
            assert!(crossing.utc.duration_since(at(second)).abs() <= PRECISION);
        }
    }

    #[test]
    fn a_wave_is_in_a_band_twice_and_above_it_once() {
        // sin 30 deg = 0.5: above it from 2 h to 10 h.
        let spells = |low, high| spells(at(0), at(DAY_S), [low, high], wave).unwrap();
        let hours =
            |spell: &[Timestamp; 2]| spell[1].duration_since(spell[0]).as_secs_f64() / 3600.0;
        let above = spells(0.5, 2.0);
        assert_eq!(above.len(), 1);
        assert!((hours(&above[0]) - 8.0).abs() < 1e-4);
        let within = spells(0.0, 0.5);
        assert_eq!(within.len(), 2);
        assert!(within.iter().all(|spell| (hours(spell) - 2.0).abs() < 1e-4));
        assert!(spells(1.5, 2.0).is_empty());
    }

    #[test]
    fn the_horizon_sinks_with_the_height() {
        let horizon = |height_m| horizon_deg(Place::new(34.49, -104.2218, height_m).unwrap());
        assert!((horizon(0.0) + 50.0 / 60.0).abs() < 1e-12);
        assert!((horizon(38_405.0) + 50.0 / 60.0 + 6.27).abs() < 0.02);
    }
}
