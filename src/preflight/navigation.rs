//! Check of the IMU: whether it sends samples, measures gravity and has the right signs.

use super::Finding;
use super::bounded::within;
use super::polarity::Operator;
use crate::geometry::earth::gravity_m_s2;
use crate::link::{Direction, ImuPacket, LocalEnd, Packet, Parser, PortError};
use crate::plan::Plan;
use jiff::Timestamp;
use nalgebra::{Rotation3, Vector3};
use std::time::{Duration, Instant};

/// Observation time of the IMU at rest, and for a tilt.
const REST_TIME: Duration = Duration::from_secs(3);
const TILT_TIME: Duration = Duration::from_secs(15);
/// Time limit for opening a port.
const TIMEOUT: Duration = Duration::from_secs(10);
/// Minimum number of samples that determine a rate.
const LEAST_SAMPLES: usize = 20;
/// Minimum rate of samples for offsets by the gyros.
const LEAST_HZ: f64 = 50.0;
/// Standard gravity, if no site is known; it differs by 0.25 % over the ground.
const GRAVITY_M_S2: f64 = 9.806_65;
/// Relative difference of the mean force at rest from gravity: beyond the first the operator should know, beyond the second a scale is wrong.
const GOOD_SCALE: f64 = 0.005;
const POSSIBLE_SCALE: f64 = 0.05;
/// Rate, rad/s, beyond which the IMU is not at rest.
const REST_RAD_S: f64 = 0.02;
/// Smallest angle that counts as a tilt; and the fraction of it by which gyros and accelerometers may disagree.
const TILT_RAD: f64 = 0.05;
const TILT_AGREES: f64 = 0.2;

const IMU_PORT: &str = "is the IMU on, does the controller send telemetry of type 0x71 (docs/protocol.md), is navigation.imu_port its line?";
const AXES: &str = "check the IMU's axes and signs, and how body_from_camera of NAV.toml has the telescope lie in them";

pub(super) fn check(plan: &Plan) -> Vec<Finding> {
    if plan.navigation.is_none() {
        return Vec::new();
    }
    let mut findings = at_rest(plan);
    findings.push(super::gps::check(plan));
    findings
}

/// Checks of the axes by manual tilts.
pub(super) fn check_axes(plan: &Plan, operator: &mut dyn Operator) -> Vec<Finding> {
    if plan.navigation.is_none() {
        return Vec::new();
    }
    let tilts = [Tilt::ForwardUp, Tilt::RightLow];
    tilts.map(|tilt| tilt.check(plan, operator)).into()
}

/// Samples of the IMU over some time, in the telescope's axes.
#[derive(Debug, Clone, Default, PartialEq)]
struct ImuSamples {
    samples: Vec<ImuPacket>,
    unreadable: usize,
}

impl ImuSamples {
    fn mean(&self, of: impl Fn(&ImuPacket) -> [f32; 3]) -> Vector3<f64> {
        let vectors = self
            .samples
            .iter()
            .map(|sample| Vector3::from(of(sample)).cast::<f64>());
        vectors.sum::<Vector3<f64>>() / self.samples.len().max(1) as f64
    }

    fn force_m_s2(&self) -> Vector3<f64> {
        self.mean(|sample| sample.force_m_s2)
    }

    /// Rate of the samples by their own times; `None` if there are too few.
    fn rate_hz(&self) -> Option<f64> {
        let (first, last) = (self.samples.first()?, self.samples.last()?);
        let time_s = last.time.duration_since(first.time).as_secs_f64();
        let count = self.samples.len();
        (count >= LEAST_SAMPLES && time_s > 0.0).then(|| (count - 1) as f64 / time_s)
    }

    fn missing(&self) -> u64 {
        let pairs = self.samples.windows(2);
        pairs.map(|pair| pair[0].missing_before(&pair[1])).sum()
    }

    /// Rotation of the body about its axes, rad, with its earlier mean rate subtracted.
    fn turned_rad(&self, rate_before_rad_s: &Vector3<f64>) -> Vector3<f64> {
        let steps = self.samples.windows(2).map(|pair| {
            let time_s = pair[1].time.duration_since(pair[0].time).as_secs_f64();
            (Vector3::from(pair[1].rate_rad_s).cast::<f64>() - rate_before_rad_s) * time_s
        });
        steps.sum()
    }
}

fn at_rest(plan: &Plan) -> Vec<Finding> {
    let imu = match read_imu(plan, REST_TIME) {
        Ok(imu) => imu,
        Err(why) => return vec![Finding::fail("imu", why, IMU_PORT)],
    };
    let Some(rate_hz) = imu.rate_hz() else {
        let found = format!(
            "{} samples in {:.0} s",
            imu.samples.len(),
            REST_TIME.as_secs_f64()
        );
        return vec![Finding::fail("imu", found, IMU_PORT)];
    };
    let site = plan.config.site.place();
    let gravity_m_s2 = site.map_or(GRAVITY_M_S2, |site| gravity_m_s2(&site));
    let scale = scale(&imu, gravity_m_s2);
    vec![rate(plan, &imu, rate_hz), scale, rest(&imu)]
}

fn rate(plan: &Plan, imu: &ImuSamples, rate_hz: f64) -> Finding {
    let off_s = imu.samples.last().map_or(0.0, |last| {
        Timestamp::now().duration_since(last.time).as_secs_f64()
    });
    let found = format!(
        "{rate_hz:.1} samples a second, {} missing, {} unreadable; their clock is {off_s:+.2} s behind this one",
        imu.missing(),
        imu.unreadable
    );
    let needed = plan.config.navigation.rate_hz.max(LEAST_HZ);
    if rate_hz < needed {
        let expected = format!("expected {needed:.0} samples a second or more");
        return Finding::fail("imu", format!("{found}: {expected}"), IMU_PORT);
    }
    match imu.missing() > 0 || imu.unreadable > 0 || off_s.abs() > 1.0 {
        true => Finding::warn(
            "imu",
            found,
            "a line that loses samples, or clocks that differ, cost accuracy in gaps",
        ),
        false => Finding::pass("imu", found),
    }
}

fn scale(imu: &ImuSamples, gravity_m_s2: f64) -> Finding {
    let force = imu.force_m_s2();
    let off = force.norm() / gravity_m_s2 - 1.0;
    let found = format!(
        "at rest ({:+.3}, {:+.3}, {:+.3}) m/s^2, which is {:+.2} % of gravity off it",
        force.x,
        force.y,
        force.z,
        100.0 * off
    );
    let remedy = "the IMU must rest, and give specific force in m/s^2";
    match off.abs() {
        off if off > POSSIBLE_SCALE => Finding::fail("imu scale", found, remedy),
        _ if force.z > 0.0 => Finding::fail("imu scale", format!("{found}; it points down"), AXES),
        off if off > GOOD_SCALE => Finding::warn("imu scale", found, remedy),
        _ => Finding::pass("imu scale", found),
    }
}

fn rest(imu: &ImuSamples) -> Finding {
    let rate = imu.mean(|sample| sample.rate_rad_s);
    let deg_s = rate.map(f64::to_degrees);
    let found = format!(
        "turns by ({:+.4}, {:+.4}, {:+.4}) deg/s",
        deg_s.x, deg_s.y, deg_s.z
    );
    match rate.norm() > REST_RAD_S {
        true => Finding::warn("imu at rest", found, "let it rest; is its rate in rad/s?"),
        false => Finding::pass("imu at rest", found),
    }
}

/// A manual rotation about one of the body's axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Tilt {
    ForwardUp,
    RightLow,
}

impl Tilt {
    fn check_name(self) -> &'static str {
        match self {
            Self::ForwardUp => "imu axes: pitch",
            Self::RightLow => "imu axes: roll",
        }
    }

    fn request(self) -> &'static str {
        match self {
            Self::ForwardUp => {
                "tilt the telescope with the IMU by hand: its forward end UP by about 5 deg, and hold it"
            }
            Self::RightLow => {
                "tilt the telescope with the IMU by hand: its right side LOW by about 5 deg, and hold it"
            }
        }
    }

    /// Rotation of the measured vertical in that direction, rad.
    fn gravity_tilt_rad(self, before: &Vector3<f64>, after: &Vector3<f64>) -> f64 {
        let angle = |force: &Vector3<f64>| match self {
            Self::ForwardUp => force.x.atan2(-force.z),
            Self::RightLow => (-force.y).atan2(-force.z),
        };
        angle(after) - angle(before)
    }

    fn turned_rad(self, turned: &Vector3<f64>) -> f64 {
        match self {
            Self::ForwardUp => turned.y,
            Self::RightLow => turned.x,
        }
    }

    fn check(self, plan: &Plan, operator: &mut dyn Operator) -> Finding {
        let name = self.check_name();
        let before = match read_imu(plan, REST_TIME) {
            Ok(imu) => imu,
            Err(why) => return Finding::fail(name, why, IMU_PORT),
        };
        if !operator.is_ready(self.request()) {
            let remedy = "tilt it when asked, so that the signs are known before the flight";
            return Finding::warn(name, "not tested: it was not tilted", remedy);
        }
        match read_imu(plan, TILT_TIME) {
            Ok(after) => self.judge(&before, &after),
            Err(why) => Finding::fail(name, why, IMU_PORT),
        }
    }

    fn judge(self, before: &ImuSamples, after: &ImuSamples) -> Finding {
        let name = self.check_name();
        let rate = before.mean(|sample| sample.rate_rad_s);
        let turned = self.turned_rad(&after.turned_rad(&rate));
        let last_second = ImuSamples {
            samples: after.samples[after.samples.len().saturating_sub(LEAST_SAMPLES)..].into(),
            unreadable: 0,
        };
        let tilt = self.gravity_tilt_rad(&before.force_m_s2(), &last_second.force_m_s2());
        let found = format!(
            "by the gyros {:+.2} deg, by gravity {:+.2} deg",
            turned.to_degrees(),
            tilt.to_degrees()
        );
        let agree = (turned - tilt).abs() < TILT_AGREES * tilt.abs().max(TILT_RAD);
        match (tilt > TILT_RAD, turned > TILT_RAD) {
            (true, true) if agree => Finding::pass(name, found),
            (false, false) if tilt.abs() < TILT_RAD && turned.abs() < TILT_RAD => Finding::fail(
                name,
                format!("{found}: no tilt beyond doubt"),
                "tilt it further",
            ),
            _ => Finding::fail(
                name,
                format!("{found}: both must be positive and agree"),
                AXES,
            ),
        }
    }
}

/// Listens on the IMU's line for a time.
fn read_imu(plan: &Plan, time: Duration) -> Result<ImuSamples, String> {
    let navigation = plan.navigation.as_ref().ok_or("no navigation is planned")?;
    // From the IMU's axes to the telescope's: forward, right and down.
    let telescope = navigation.settings.body_from_telescope().inverse();
    // The IMU's own line, else the controller's.
    let own = navigation.imu.clone().map(|own| (own, LocalEnd::default()));
    let (address, local) = own
        .or(plan.line.clone())
        .ok_or("neither navigation.imu_port nor link.port is set")?;
    let baud = plan.config.link.baud;
    let tried = within(TIMEOUT + time, move || -> Result<ImuSamples, PortError> {
        let mut port = address.open(baud, local)?;
        let mut parser = Parser::new(Direction::ToAspect);
        let mut imu = ImuSamples::default();
        let mut buffer = [0; 2048];
        let start = Instant::now();
        while start.elapsed() < time {
            let count = port.read(&mut buffer, Duration::from_millis(100))?;
            for packet in parser.feed(&buffer[..count], start.elapsed()) {
                if let Packet::Telemetry(packet) = packet {
                    match ImuPacket::decode(&packet) {
                        Ok(sample) => imu.samples.push(turned(sample, &telescope)),
                        Err(_) => imu.unreadable += 1,
                    }
                }
            }
        }
        Ok(imu)
    });
    match tried {
        Ok(Ok(imu)) => Ok(imu),
        Ok(Err(error)) => Err(error.to_string()),
        Err(no_answer) => Err(no_answer.to_string()),
    }
}

fn turned(sample: ImuPacket, telescope: &Rotation3<f64>) -> ImuPacket {
    let turn = |v: [f32; 3]| {
        (telescope * Vector3::from(v).cast::<f64>())
            .cast::<f32>()
            .into()
    };
    ImuPacket {
        force_m_s2: turn(sample.force_m_s2),
        rate_rad_s: turn(sample.rate_rad_s),
        ..sample
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::preflight::Verdict;
    use jiff::SignedDuration;

    /// Samples of 1.5 s from a body that rotates about an axis by an angle, from rest.
    fn imu(axis: Vector3<f64>, turned_rad: f64) -> ImuSamples {
        let start: Timestamp = "2026-06-01T12:00:00Z".parse().unwrap();
        let up = Vector3::new(0.0, 0.0, -1.0);
        let samples = (0..150).map(|n| {
            let done = (f64::from(n) / 100.0).min(1.0);
            let turn = nalgebra::Rotation3::new(axis * turned_rad * done);
            let rate = if n > 0 && n <= 100 { turned_rad } else { 0.0 };
            ImuPacket {
                time: start + SignedDuration::from_millis(10 * i64::from(n)),
                counter: n as u16,
                force_m_s2: (turn.inverse() * up * GRAVITY_M_S2).cast::<f32>().into(),
                rate_rad_s: (axis * rate).cast::<f32>().into(),
            }
        });
        ImuSamples {
            samples: samples.collect(),
            unreadable: 0,
        }
    }

    #[test]
    fn a_tilt_by_hand_shows_axes_and_signs() {
        let rest = imu(Vector3::x(), 0.0);
        for (tilt, axis) in [
            (Tilt::ForwardUp, Vector3::y()),
            (Tilt::RightLow, Vector3::x()),
        ] {
            let verdict = |after: &ImuSamples| tilt.judge(&rest, after).verdict;
            let good = imu(axis, 0.09);
            assert_eq!(
                verdict(&good),
                Verdict::Pass,
                "{:?}",
                tilt.judge(&rest, &good)
            );
            assert_eq!(verdict(&imu(-axis, 0.09)), Verdict::Fail, "the other way");
            assert_eq!(verdict(&imu(axis, 0.01)), Verdict::Fail, "hardly");
            // Gyros with the wrong sign.
            let mut wrong = good.clone();
            wrong
                .samples
                .iter_mut()
                .for_each(|s| s.rate_rad_s = s.rate_rad_s.map(|rate| -rate));
            assert_eq!(verdict(&wrong), Verdict::Fail);
        }
    }

    #[test]
    fn gravity_shows_scale_and_sign_of_the_accelerometers() {
        let scaled = |by: f32| {
            let mut imu = imu(Vector3::x(), 0.0);
            let forces = imu.samples.iter_mut();
            forces.for_each(|s| s.force_m_s2 = s.force_m_s2.map(|force| by * force));
            scale(&imu, GRAVITY_M_S2).verdict
        };
        assert_eq!(scaled(1.0), Verdict::Pass);
        assert_eq!(scaled(1.01), Verdict::Warn);
        assert_eq!(scaled(1.0 / 9.80665), Verdict::Fail, "in g");
        assert_eq!(scaled(-1.0), Verdict::Fail, "down instead of up");
    }

    #[test]
    fn missing_samples_are_counted_by_their_numbers() {
        let mut imu = imu(Vector3::x(), 0.0);
        imu.samples.drain(40..45);
        assert_eq!(imu.missing(), 5);
        assert!((imu.rate_hz().unwrap() - 96.6).abs() < 0.1);
    }
}
