//! The filter by gyros in the soak: the telescope follows the Sun, which rests on the plate, and its sensors speak in time.

use solaspect::config::FlightClock;
use solaspect::instrument::{DEMO_NAVIGATION, Instrument};
use solaspect::link::{Connection, Propagated, SerialPort};
use solaspect::navigation::Settings;
use solaspect::service::Navigation;
use solaspect::service::demo::JudgedOffset;
use solaspect::simulate::navigation::TelescopeFlight;
use solaspect::simulate::sensors::Sensors;
use solaspect::simulate::{Course, FORT_SUMNER, Piece, Pieces, Trajectory};
use solaspect::sky;
use std::path::Path;
use std::time::Duration;

const SEED: u64 = 1;
/// The filter has found the roll after so long.
const SETTLED: Duration = Duration::from_secs(10);
const MOST_SIGMAS: f64 = 3.0;

/// The Sun at one place of the plate.
pub fn resting() -> Course {
    let piece = Piece {
        start_s: 0.0,
        sun_mil: [300.0, -200.0],
        slew_mil_per_s: [0.0; 2],
        roll_deg: 0.0,
        cloud: 0.0,
    };
    Course::from(Pieces {
        repeat_s: None,
        pieces: vec![piece],
    })
}

/// The Sun on a path of rests, slews and sway.
pub fn swaying(instrument: &Instrument, now: jiff::Timestamp) -> anyhow::Result<Course> {
    let radius_mil = instrument.optics.radius_mil(sky::sun_angular_radius(now)?);
    Ok(Trajectory::flight(instrument, radius_mil, SEED)?.into())
}

/// The telescope that the resting Sun is seen from.
pub fn telescope(instrument: &Instrument, start: jiff::Timestamp) -> TelescopeFlight {
    TelescopeFlight::new(resting(), instrument, FORT_SUMNER, start, SEED)
}

/// What flies, and what speaks to it.
pub struct Parts {
    pub flies: Navigation,
    pub sensors: Sensors,
}

impl Parts {
    pub fn new(instrument: &Instrument, start: jiff::Timestamp) -> anyhow::Result<Self> {
        let (near, far) = SerialPort::pair()?;
        let path = Path::new("demo-nav");
        let ahead = jiff::Timestamp::now().duration_since(start);
        Ok(Self {
            flies: Navigation {
                settings: Settings::parse(path, DEMO_NAVIGATION)?.for_flight(path)?,
                settings_toml: DEMO_NAVIGATION.into(),
                imu: None,
                gps: Some(Connection::over(near)),
                clock: FlightClock::starting(start),
            },
            sensors: Sensors::new(
                telescope(instrument, start),
                Some(Box::new(far)),
                Duration::try_from(ahead)?,
            ),
        })
    }
}

/// What the offsets by the gyros came to.
pub struct NavigationRun {
    pub received: u64,
    pub judged: u64,
    /// Of all errors of an axis.
    pub beyond_3_sigma: f64,
    pub rms_arcsec: f64,
}

impl NavigationRun {
    pub fn of(
        propagated: &[Propagated],
        mut telescope: TelescopeFlight,
        start: jiff::Timestamp,
    ) -> Self {
        let first = propagated.first().map(|one| one.solution.time);
        let is_settled = |one: &&Propagated| {
            first.is_some_and(|first| {
                one.solution.time.duration_since(first).unsigned_abs() > SETTLED
            })
        };
        let judged = propagated.iter().filter(is_settled);
        let judged: Vec<JudgedOffset> = judged
            .filter_map(|one| JudgedOffset::of(one, &mut telescope, start))
            .collect();
        let errors = || {
            judged
                .iter()
                .flat_map(|one| one.error_arcsec.map(|error| (error, one.sigma_arcsec)))
        };
        let count = errors().count().max(1) as f64;
        let beyond = errors()
            .filter(|(error, sigma)| error.abs() > MOST_SIGMAS * sigma)
            .count();
        Self {
            received: propagated.len() as u64,
            judged: judged.len() as u64,
            beyond_3_sigma: beyond as f64 / count,
            rms_arcsec: (errors().map(|(error, _)| error * error).sum::<f64>() / count).sqrt(),
        }
    }
}
