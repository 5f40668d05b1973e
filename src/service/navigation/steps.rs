//! Steps of the clock: whether the times of samples advance as their counter does.

use crate::link::ImuPacket;

/// Deviation in samples beyond which the clock has stepped; a smaller one is time-stamp jitter.
const SAMPLES: f64 = 2.0;
/// Largest relative difference of two intervals that agree.
const AGREES: f64 = 0.2;
const SHARE: f64 = 0.01;
/// Change of the clock beyond which it was set, s: the filter is restarted.
const SET_S: f64 = 1.0;

/// The times of samples so far.
#[derive(Debug, Default)]
pub(super) struct Steps {
    last: Option<ImuPacket>,
    /// Last interval between samples, s.
    before_s: Option<f64>,
    usual_s: Option<f64>,
}

impl Steps {
    /// Step of the clock before a sample, s; 0 if it advanced as the samples did.
    pub fn step_s(&mut self, sample: &ImuPacket) -> f64 {
        let Some(last) = self.last else {
            self.last = Some(*sample);
            return 0.0;
        };
        let samples = sample.counter.wrapping_sub(last.counter);
        let since_s = sample.time.duration_since(last.time).as_secs_f64();
        if samples == 0 || (-SET_S..=0.0).contains(&since_s) {
            return 0.0;
        }
        self.last = Some(*sample);
        if samples >= 0x8000 || since_s.abs() > SET_S {
            return 0.0;
        }
        let each_s = since_s / f64::from(samples);
        let near = |other: f64| (each_s - other).abs() < AGREES * other;
        let agrees = self.before_s.replace(each_s).is_some_and(near);
        let Some(usual_s) = &mut self.usual_s else {
            self.usual_s = Some(each_s).filter(|_| agrees);
            return 0.0;
        };
        let step_s = since_s - f64::from(samples) * *usual_s;
        let is_step = step_s.abs() > SAMPLES * *usual_s;
        match (near(*usual_s), agrees) {
            (true, _) => *usual_s += SHARE * (each_s - *usual_s),
            // The IMU continues at another rate.
            (false, true) => *usual_s = each_s,
            (false, false) => {}
        }
        if is_step { step_s } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use jiff::{SignedDuration, Timestamp};

    fn sample(counter: u16, ms: i64) -> ImuPacket {
        ImuPacket {
            time: Timestamp::UNIX_EPOCH + SignedDuration::from_millis(ms),
            counter,
            force_m_s2: [0.0; 3],
            rate_rad_s: [0.0; 3],
        }
    }

    #[test]
    fn a_clock_that_steps_is_distinguished_from_samples_that_are_lost() {
        let mut steps = Steps::default();
        let mut step = |counter: u16, ms| steps.step_s(&sample(counter, ms));
        for n in 1..20 {
            assert_eq!(step(n, 10 * i64::from(n)), 0.0);
        }
        // Ten are lost, one comes twice, one is stamped a little late.
        assert_eq!(step(30, 300), 0.0);
        assert_eq!(step(30, 300), 0.0);
        assert_eq!(step(31, 315), 0.0);
        assert!((step(32, 620) - 0.3).abs() < 0.01);
        // Back by 0.05 s: samples that are not later than the last are ignored.
        for n in 33..38 {
            assert_eq!(step(n, 580 + 10 * (i64::from(n) - 33)), 0.0);
        }
        assert!((step(38, 630) + 0.05).abs() < 0.01);
        // The IMU restarts, and its clock is set.
        assert_eq!(step(0, 640), 0.0);
        assert_eq!(step(1, 90_000), 0.0);
    }
}
