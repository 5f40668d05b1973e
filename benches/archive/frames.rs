//! Solved frames with everything that the archive writes in addition to their pixels.

use anyhow::Context;
use jiff::{SignedDuration, Timestamp};
use solaspect::archive::{instrument_cards, sky_cards, tables};
use solaspect::aspect::{self, Expected};
use solaspect::fits::{Card, Table};
use solaspect::frame::{Frame, FrameInfo};
use solaspect::instrument::{Instrument, builtin};
use solaspect::pointing::{Roll, Target, offset_of};
use solaspect::record::Record;
use solaspect::simulate::{self, Depth, Noise, RandomScenes};
use solaspect::sky::Ephemeris;
use solaspect::units::Place;
use std::time::Duration;

pub struct Conditions {
    pub name: &'static str,
    /// In 8-bit DN, for any depth.
    noise_dn: f64,
    depth: Depth,
}

const fn conditions(name: &'static str, noise_dn: f64, depth: Depth) -> Conditions {
    Conditions {
        name,
        noise_dn,
        depth,
    }
}

pub const CONDITIONS: [Conditions; 5] = [
    conditions("8 bit, noise 1 DN", 1.0, Depth::Eight),
    conditions("8 bit, noise 5 DN", 5.0, Depth::Eight),
    conditions("8 bit, noise 15 DN", 15.0, Depth::Eight),
    conditions("12 bit, noise 1 DN of 8 bit", 1.0, Depth::Twelve),
    conditions("12 bit, noise 5 DN of 8 bit", 5.0, Depth::Twelve),
];

/// A frame with its keywords and tables.
pub struct Solved {
    pub frame: Frame,
    pub cards: Vec<Card>,
    pub tables: Vec<Table>,
}

impl Solved {
    pub fn pixel_bytes(&self) -> usize {
        self.frame.pixels().len() * self.frame.pixels().bits() as usize / 8
    }
}

/// Frames at intervals of 0.25 s, each with the Sun at another position.
pub fn solved(conditions: &Conditions, count: u64) -> anyhow::Result<Vec<Solved>> {
    let instrument = builtin("demo").context("the demo instrument is built in")?;
    let conditions = simulate::Conditions {
        noise: Noise::read(conditions.noise_dn),
        depth: conditions.depth,
        ..simulate::Conditions::of(&instrument)
    };
    let scenes = RandomScenes::new(&instrument, &conditions, 1)?;
    let mut ephemeris = Ephemeris::default();
    let frame = |number| {
        let mut scene = scenes.scene(number)?;
        scene.info = info(number)?;
        solve(scene.frame()?, &instrument, &mut ephemeris)
    };
    (0..count).map(frame).collect()
}

fn info(number: u64) -> anyhow::Result<FrameInfo> {
    let first: Timestamp = "2013-09-21T18:00:00Z".parse()?;
    let since = SignedDuration::from_millis(250 * number as i64);
    Ok(FrameInfo {
        number: Some(number),
        mid_exposure: Some(first.checked_add(since)?),
        monotonic: Some(Duration::from_millis(250 * number)),
        exposure: Some(Duration::from_micros(15_000)),
        analogue_gain: Some(1.0),
        preamp_gain: Some(-3.0),
        camera_temperature_c: Some(20.0),
        place: Some(Place::new(34.49, -104.2218, 38_405.0)?),
        camera: Some("simulated".into()),
        ..FrameInfo::default()
    })
}

fn solve(
    frame: Frame,
    instrument: &Instrument,
    ephemeris: &mut Ephemeris,
) -> anyhow::Result<Solved> {
    let (utc, place) = (frame.info.mid_exposure, frame.info.place);
    let target = Target::default();
    let expected = utc.and_then(Expected::at);
    let mut solution = aspect::solve(&frame, instrument, expected, None);
    let offset = offset_of(
        &mut solution,
        utc,
        place,
        &target,
        None,
        instrument,
        ephemeris,
    );
    let mut cards = Record::new("", utc, &solution, offset, None).cards();
    cards.extend(instrument_cards(instrument, Roll::Stated));
    cards.extend(sky_cards(
        &frame.info,
        &solution,
        Roll::Stated,
        instrument,
        &target,
        ephemeris,
    ));
    let tables = tables(&solution);
    Ok(Solved {
        frame,
        cards,
        tables,
    })
}
