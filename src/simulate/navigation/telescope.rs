//! IMU and GPS of the telescope whose camera a simulated flight shows: the Sun's position on the plate gives the telescope's attitude.
//!
//! The telescope is above a fixed place and swings with its gondola.

use super::earth::{earth_rate_rad_s, ecef_from_north_east_down, gravitation_m_s2, position_m};
use super::imu::{Imu, RATE_HZ};
use super::{Drawn, ImuErrors, ImuRow, random};
use crate::instrument::Instrument;
use crate::link::ImuPacket;
use crate::navigation::nmea::summed;
use crate::pointing::{self, Difference, Horizontal, PointingError};
use crate::simulate::Generator;
use crate::simulate::flight::Course;
use crate::simulate::gondola::Gondola;
use crate::sky::sphere::direction;
use crate::sky::{Ephemeris, SkyError, SunPosition};
use crate::units::{Place, PlateMil};
use jiff::{SignedDuration, Timestamp};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use rand::RngExt;
use rand_distr::StandardNormal;
use std::time::Duration;

const KNOT_M_S: f64 = 1852.0 / 3600.0;
/// Errors of the GPS receiver, 1 sigma per axis.
const POSITION_SIGMA_M: f64 = 5.0;
const VELOCITY_SIGMA_M_S: f64 = 0.05;
/// Interval of the evaluations of the ephemeris: linear interpolation between them is accurate to 0.001 arcsec.
const SAMPLE_EVERY_S: i64 = 1;

/// Reason why a flight cannot be simulated.
#[derive(Debug, thiserror::Error)]
pub enum NoFlight {
    #[error(transparent)]
    Sky(#[from] SkyError),
    #[error(transparent)]
    Pointing(#[from] PointingError),
    #[error("a time that no calendar has")]
    Time,
}

/// True pointing of a telescope.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TelescopeTruth {
    pub elevation_deg: f64,
    pub offset: Difference,
}

/// The telescope of a simulated flight.
pub struct TelescopeFlight {
    course: Course,
    gondola: Gondola,
    instrument: Instrument,
    place: Place,
    start: Timestamp,
    ephemeris: Ephemeris,
    /// The Sun at a second since the start, and at the next evaluation.
    evaluated: Option<(i64, [SunPosition; 2])>,
    imu: Imu,
    gps: Generator,
    /// Attitude of the telescope at the end of the last sample.
    last: Option<(u64, UnitQuaternion<f64>)>,
}

impl TelescopeFlight {
    /// A flight that begins at `start`, with a fixed gondola; the errors depend on the seed.
    pub fn new(
        course: impl Into<Course>,
        instrument: &Instrument,
        place: Place,
        start: Timestamp,
        seed: u64,
    ) -> Self {
        Self {
            course: course.into(),
            gondola: Gondola::default(),
            instrument: instrument.clone(),
            place,
            start,
            ephemeris: Ephemeris::default(),
            evaluated: None,
            imu: Imu::drawn(&ImuErrors::balloon(), seed),
            gps: random(seed, Drawn::Gps),
            last: None,
        }
    }

    /// The same telescope on a gondola.
    pub fn on(self, gondola: Gondola) -> Self {
        Self { gondola, ..self }
    }

    pub fn start(&self) -> Timestamp {
        self.start
    }

    /// Number of samples per second.
    pub fn rate_hz(&self) -> u64 {
        RATE_HZ
    }

    /// The n-th sample of the IMU, whose interval ends n hundredths of a second after the start; from 1 on.
    ///
    /// # Errors
    /// If the telescope's attitude is not known at this time.
    pub fn sample(&mut self, n: u64) -> Result<ImuPacket, NoFlight> {
        let interval_s = 1.0 / RATE_HZ as f64;
        let at = |n: u64| Duration::from_nanos(n * 1_000_000_000 / RATE_HZ);
        let before = match self.last.filter(|(last, _)| *last + 1 == n) {
            Some((_, before)) => before,
            None => self.attitude(at(n.saturating_sub(1)))?,
        };
        let after = self.attitude(at(n))?;
        self.last = Some((n, after));
        let turn = (before.inverse() * after).scaled_axis();
        let middle = before * UnitQuaternion::new(turn / 2.0);
        let to_body = |v: Vector3<f64>| middle.inverse_transform_vector(&v);
        let at_m = position_m(&self.place);
        let spin = earth_rate_rad_s();
        let felt_m_s2 = spin.cross(&spin.cross(&at_m)) - gravitation_m_s2(&at_m);
        let row = self.imu.measured(&ImuRow {
            t_s: at(n).as_secs_f64(),
            specific_force_m_s2: to_body(felt_m_s2),
            rate_rad_s: turn / interval_s + to_body(spin),
        });
        Ok(ImuPacket {
            time: self.utc(at(n))?,
            counter: n as u16,
            force_m_s2: row.specific_force_m_s2.cast::<f32>().into(),
            rate_rad_s: row.rate_rad_s.cast::<f32>().into(),
        })
    }

    /// Sentences of the GPS receiver for a whole second after the start: GGA and RMC.
    ///
    /// # Errors
    /// If the time is out of range of the calendar.
    pub fn sentences(&mut self, second: u64) -> Result<String, NoFlight> {
        let utc = self.utc(Duration::from_secs(second))?;
        let mut normal = |sigma: f64| sigma * self.gps.sample::<f64, _>(StandardNormal);
        let axes = ecef_from_north_east_down(&self.place);
        let [north_m, east_m, up_m] = [(); 3].map(|()| normal(POSITION_SIGMA_M));
        let metres_per_deg = position_m(&self.place).norm().to_radians();
        let level = axes.matrix().column(2).xy().norm().max(0.01);
        let latitude_deg = self.place.latitude_deg + north_m / metres_per_deg;
        let longitude_deg = self.place.longitude_deg + east_m / (metres_per_deg * level);
        let height_m = self.place.height_m + up_m;
        let (north_m_s, east_m_s) = (normal(VELOCITY_SIGMA_M_S), normal(VELOCITY_SIGMA_M_S));
        let speed = north_m_s.hypot(east_m_s) / KNOT_M_S;
        let course_deg = east_m_s.atan2(north_m_s).to_degrees().rem_euclid(360.0);
        let time = utc.strftime("%H%M%S.00");
        let at = format!(
            "{},{}",
            degrees_and_minutes(latitude_deg, 2, ["N", "S"]),
            degrees_and_minutes(longitude_deg, 3, ["E", "W"])
        );
        let date = utc.strftime("%d%m%y");
        Ok(summed(&format!(
            "GPGGA,{time},{at},1,09,0.9,{height_m:.2},M,0.0,M,,"
        )) + &summed(&format!(
            "GPRMC,{time},A,{at},{speed:.4},{course_deg:.2},{date},,,A"
        )))
    }

    /// Attitude of the telescope: the rotation from its axes - forward, right, down - to Earth-fixed ones.
    ///
    /// # Errors
    /// If the ephemeris does not cover the time, or the pointing is impossible.
    pub fn attitude(&mut self, since: Duration) -> Result<UnitQuaternion<f64>, NoFlight> {
        let (towards, roll_deg) = self.towards(since)?;
        let (sin, cos) = towards.azimuth_deg.to_radians().sin_cos();
        let (sin_up, cos_up) = towards.elevation_deg.to_radians().sin_cos();
        // Components: north, east and down.
        let forward = Vector3::new(cos_up * cos, cos_up * sin, -sin_up);
        let right = Vector3::new(-sin, cos, 0.0);
        let axes = Matrix3::from_columns(&[forward, right, forward.cross(&right)]);
        let roll = Rotation3::from_axis_angle(&Vector3::x_axis(), roll_deg.to_radians());
        let local = Rotation3::from_matrix_unchecked(axes) * roll;
        let turned = ecef_from_north_east_down(&self.place) * local;
        Ok(UnitQuaternion::from_rotation_matrix(&turned))
    }

    /// Pointing of the telescope, and its roll about the boresight, deg.
    fn towards(&mut self, since: Duration) -> Result<(Horizontal, f64), NoFlight> {
        let (at, sun) = (self.sun_on_plate(since), self.sun(since)?);
        let roll = pointing::roll_by_nadir(&self.gondola.nadir(since), at, &self.instrument, &sun);
        let towards = pointing::pointing(at, roll, &self.instrument, &sun)?;
        Ok((towards, roll.about_boresight_deg(&self.instrument).value))
    }

    /// Pointing of the telescope minus the Sun's centre.
    ///
    /// # Errors
    /// As [`attitude`](Self::attitude).
    pub fn truth(&mut self, since: Duration) -> Result<TelescopeTruth, NoFlight> {
        let sun = self.sun(since)?;
        let (towards, _) = self.towards(since)?;
        let boresight = direction(towards.azimuth_deg, towards.elevation_deg);
        let centre = direction(sun.azimuth_deg, sun.elevation_deg);
        Ok(TelescopeTruth {
            elevation_deg: towards.elevation_deg,
            offset: pointing::difference(&boresight, &centre)?,
        })
    }

    /// Position of the Sun on the plate.
    pub fn sun_on_plate(&self, since: Duration) -> PlateMil {
        self.course.position(since)
    }

    /// Position of the Sun in the sky.
    ///
    /// # Errors
    /// If the ephemeris does not cover the time.
    pub fn sun(&mut self, since: Duration) -> Result<SunPosition, NoFlight> {
        let second = since.as_secs() as i64 / SAMPLE_EVERY_S * SAMPLE_EVERY_S;
        let [from, to] = match self.evaluated {
            Some((evaluated, suns)) if evaluated == second => suns,
            _ => {
                let mut at = |second: i64| {
                    let utc = self.utc(Duration::from_secs(second as u64))?;
                    Ok::<_, NoFlight>(self.ephemeris.sun(utc, self.place)?)
                };
                let suns = [at(second)?, at(second + SAMPLE_EVERY_S)?];
                self.evaluated = Some((second, suns));
                suns
            }
        };
        let share = (since.as_secs_f64() - second as f64) / SAMPLE_EVERY_S as f64;
        let moved = (to.azimuth_deg - from.azimuth_deg + 180.0).rem_euclid(360.0) - 180.0;
        Ok(SunPosition {
            azimuth_deg: from.azimuth_deg + share * moved,
            elevation_deg: from.elevation_deg + share * (to.elevation_deg - from.elevation_deg),
            ..from
        })
    }

    fn utc(&self, since: Duration) -> Result<Timestamp, NoFlight> {
        let since = SignedDuration::try_from(since).map_err(|_| NoFlight::Time)?;
        self.start.checked_add(since).map_err(|_| NoFlight::Time)
    }
}

/// An angle in the format of NMEA: integer degrees with `digits` digits, then minutes, then the hemisphere.
fn degrees_and_minutes(angle_deg: f64, digits: usize, [plus, minus]: [&str; 2]) -> String {
    // In integer units, so that rounding never gives 60 minutes.
    const PARTS: f64 = 1e6;
    let parts = (angle_deg.abs() * 60.0 * PARTS).round();
    let (degrees, minutes) = (
        (parts / (60.0 * PARTS)).floor(),
        parts % (60.0 * PARTS) / PARTS,
    );
    let half = if angle_deg < 0.0 { minus } else { plus };
    format!("{degrees:0digits$.0}{minutes:09.6},{half}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::instrument::builtin;
    use crate::pointing::sun_in_telescope;
    use crate::simulate::{FORT_SUMNER, Trajectory};

    #[test]
    fn the_sun_is_where_the_plate_has_it_however_the_gondola_swings() {
        let demo = builtin("demo").unwrap();
        let start: Timestamp = "2013-09-21T18:00:00Z".parse().unwrap();
        for gondola in [Gondola::Still, Gondola::Swinging] {
            let course = Trajectory::flight(&demo, 92.0, 1).unwrap();
            let flight = TelescopeFlight::new(course, &demo, FORT_SUMNER, start, 1);
            let mut flight = flight.on(gondola);
            for second in [3, 40, 101] {
                let since = Duration::from_secs(second);
                let attitude = flight.attitude(since).unwrap();
                let sun = flight.sun(since).unwrap();
                let centre = direction(sun.azimuth_deg, sun.elevation_deg);
                // North, east and up to down.
                let centre = Vector3::new(centre.x, centre.y, -centre.z);
                let fixed = ecef_from_north_east_down(&FORT_SUMNER) * centre;
                let seen = attitude.inverse_transform_vector(&fixed);
                let plate = sun_in_telescope(flight.sun_on_plate(since), &demo);
                assert!(
                    (seen - plate.into_inner()).norm() < 1e-9,
                    "{gondola:?} {seen} {plate:?}"
                );
                let down = ecef_from_north_east_down(&FORT_SUMNER) * Vector3::z();
                let low = attitude.inverse_transform_vector(&down).y;
                let [roll, pitch] = [gondola.roll_deg(since), gondola.pitch_deg(since)];
                let body = roll.to_radians().sin() * pitch.to_radians().cos();
                assert!((low - body).abs() < 1e-9, "{gondola:?} {low} {body}");
            }
        }
    }
}
