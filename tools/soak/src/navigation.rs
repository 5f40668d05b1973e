//! The navigation filter in the soak test: the telescope follows the Sun, which rests on the plate, and its sensors send in
//! real time.

use crate::report::say;
use jiff::Timestamp;
use solaspect::clock::FlightClock;
use solaspect::demo::JudgedOffset;
use solaspect::instrument::{DEMO_NAVIGATION, Instrument, Role};
use solaspect::link::{Connection, ImuPacket, Propagated, SerialPort};
use solaspect::navigation::NavigationSettings;
use solaspect::service::Navigation;
use solaspect::simulate::navigation::{FaultyImu, IMU_FAULTS, ImuFault, TelescopeFlight};
use solaspect::simulate::sensors::{Corrupt, Sensors};
use solaspect::simulate::{Course, FORT_SUMNER, Piece, Pieces, Trajectory};
use solaspect::sky;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

const SEED: u64 = 1;
/// Time after which the filter has determined the roll.
const SETTLED: Duration = Duration::from_secs(10);
/// Errors above the first limit must be rare; errors above the second are wrong.
const RARE_SIGMAS: f64 = 3.0;
const WRONG_SIGMAS: f64 = 6.0;
/// Time after the beginning or end of an IMU fault during which offsets may be wrong: until the next frame, plus half a
/// second.
const MENDED: Duration = Duration::from_millis(550);

/// The Sun at a fixed position of the plate.
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
pub fn swaying(instrument: &Instrument, now: Timestamp) -> anyhow::Result<Course> {
    let radius_mil = instrument.optics.radius_mil(sky::sun_angular_radius(now)?);
    Ok(Trajectory::flight(instrument, radius_mil, SEED)?.into())
}

/// The telescope from which the resting Sun is observed.
pub fn telescope(instrument: &Instrument, start: Timestamp) -> TelescopeFlight {
    TelescopeFlight::new(resting(), instrument, FORT_SUMNER, start, SEED)
}

/// The flying parts, and their sources of data.
pub struct Parts {
    pub flies: Navigation,
    pub sensors: Sensors,
    pub imu: ImuBench,
    pub judge: Judge,
}

impl Parts {
    pub fn new(instrument: &Instrument, start: Timestamp) -> anyhow::Result<Self> {
        let (near, far) = SerialPort::pair()?;
        let path = Path::new("demo-nav");
        let imu = ImuBench::default();
        Ok(Self {
            flies: Navigation {
                settings: NavigationSettings::parse(path, DEMO_NAVIGATION)?
                    .for_flight(path, &Role::table_names())?,
                settings_toml: DEMO_NAVIGATION.into(),
                imu: None,
                gps: Some(Connection::over(near)),
                clock: FlightClock::starting(start),
            },
            sensors: Sensors::new(telescope(instrument, start), Some(Box::new(far)))
                .corrupted(imu.corrupt()),
            judge: Judge::new(telescope(instrument, start), start, imu.clone()),
            imu,
        })
    }
}

/// Applies faults to the IMU, the simulator's kinds one after the other.
#[derive(Clone, Default)]
pub struct ImuBench {
    shared: Arc<Mutex<Bench>>,
}

#[derive(Default)]
struct Bench {
    begun: usize,
    last: Option<Lasting>,
}

/// A fault of the IMU with its period.
#[derive(Clone, Copy)]
struct Lasting {
    fault: &'static ImuFault,
    /// Times of the first and the last affected sample.
    met: Option<[Timestamp; 2]>,
    is_over: bool,
}

impl ImuBench {
    fn state(&self) -> MutexGuard<'_, Bench> {
        self.shared.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Begins the next kind of fault.
    pub fn begin(&self) {
        let mut bench = self.state();
        bench.last = Some(Lasting {
            fault: &IMU_FAULTS[bench.begun % IMU_FAULTS.len()],
            met: None,
            is_over: false,
        });
        bench.begun += 1;
    }

    pub fn end(&self) {
        if let Some(last) = &mut self.state().last {
            last.is_over = true;
        }
    }

    /// Name of the kind that began last.
    pub fn name(&self) -> &'static str {
        self.state().last.map_or("", |last| last.fault.name)
    }

    /// The function that modifies the IMU's samples.
    fn corrupt(&self) -> Corrupt {
        let bench = self.clone();
        let mut imu = FaultyImu::new(SEED);
        Box::new(move |sample: ImuPacket| {
            let mut bench = bench.state();
            let lasting = bench.last.as_mut().filter(|last| !last.is_over);
            let lasting = lasting.map(|lasting| {
                let [first, _] = lasting.met.unwrap_or([sample.time; 2]);
                lasting.met = Some([first, sample.time]);
                let since = sample.time.duration_since(first);
                (lasting.fault, since.as_secs_f64())
            });
            imu.sample(sample, lasting)
        })
    }

    /// Whether an offset at that time may be wrong.
    fn excuses(&self, time: Timestamp) -> bool {
        let Some((fault, [first, last])) = self
            .state()
            .last
            .and_then(|one| Some((one.fault, one.met?)))
        else {
            return false;
        };
        let since_s = time.duration_since(first).as_secs_f64();
        let length_s = last.duration_since(first).as_secs_f64();
        let mut begins = fault.begins_s(length_s).chain([0.0, length_s]);
        begins.any(|begin_s| (0.0..=MENDED.as_secs_f64()).contains(&(since_s - begin_s)))
    }
}

/// Compares offsets by the gyros with the truth as they arrive.
pub struct Judge {
    telescope: TelescopeFlight,
    start: Timestamp,
    imu: ImuBench,
    first: Option<Timestamp>,
    run: NavigationRun,
}

/// Statistics of the offsets by the gyros.
#[derive(Debug, Clone, Copy, Default)]
pub struct NavigationRun {
    pub received: u64,
    pub judged: u64,
    /// Number of offsets with an axis wrong by more than 6 sigma without an IMU fault that excuses it; and the largest of
    /// all unexcused errors, in sigmas.
    pub wrong: u64,
    pub most_sigmas: f64,
    /// Statistics over all axes.
    beyond_3_sigma: u64,
    sum_arcsec2: f64,
}

impl Judge {
    fn new(telescope: TelescopeFlight, start: Timestamp, imu: ImuBench) -> Self {
        Self {
            telescope,
            start,
            imu,
            first: None,
            run: NavigationRun::default(),
        }
    }

    pub fn note(&mut self, one: &Propagated) {
        self.run.received += 1;
        let time = one.solution.time;
        let first = *self.first.get_or_insert(time);
        if time.duration_since(first).unsigned_abs() < SETTLED {
            return;
        }
        let Some(offset) = JudgedOffset::of(one, &mut self.telescope, self.start) else {
            return;
        };
        self.run.judged += 1;
        for error in offset.error_arcsec {
            self.run.sum_arcsec2 += error * error;
            let beyond = error.abs() > RARE_SIGMAS * offset.sigma_arcsec;
            self.run.beyond_3_sigma += u64::from(beyond);
        }
        let [across, up] = offset.error_arcsec.map(f64::abs);
        let sigmas = across.max(up) / offset.sigma_arcsec;
        if self.imu.excuses(time) {
            return;
        }
        self.run.most_sigmas = self.run.most_sigmas.max(sigmas);
        if sigmas > WRONG_SIGMAS {
            self.run.wrong += 1;
            say(format_args!(
                "      offset of {time}: wrong by {across:.2} and {up:.2} arcsec at a stated {:.2}, {:.2} s after a direction",
                offset.sigma_arcsec, offset.age_s
            ));
        }
    }

    pub fn run(&self) -> NavigationRun {
        self.run
    }
}

impl NavigationRun {
    fn axes(&self) -> f64 {
        (2 * self.judged).max(1) as f64
    }

    pub fn share_beyond_3_sigma(&self) -> f64 {
        self.beyond_3_sigma as f64 / self.axes()
    }

    pub fn rms_arcsec(&self) -> f64 {
        (self.sum_arcsec2 / self.axes()).sqrt()
    }
}
