//! Settings that the ground changes in flight, in one place: every thread reads them, only commands change them.
//!
//! Commands and files of saved values set the same [settings](super::setting). Both are checked in the same place, against the parameter
//! table, and take effect completely or not at all.

mod gps;
mod orders;
mod proof;
mod saved;

pub use proof::Proof;
pub use saved::{SavedError, SavedValues, ValueSaver, differences, restore};

use super::note::CommandNote;
use super::setting::{CommandOnly, KEPT, LATITUDE, LONGITUDE, SENDING, STAMP, Setting, TRACKING};
use crate::aspect;
use crate::camera::Camera;
use crate::config::{self, Config, ConfiguredCamera, Value, by_key};
use crate::instrument::{Instrument, Mounting, Role};
use crate::link::{CommandResult, GpsFix};
use crate::pointing::{HelioprojectiveArcsec, Target};
use crate::units::Place;
use crossbeam_channel::{Receiver, Sender, bounded};
use gps::Gps;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Rows that may wait for the command log.
const NOTES: usize = 1024;

/// Groups of settings that may change in flight.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Topic {
    /// Target and place.
    Aim,
    /// Clocking and twist.
    Mounting,
    /// The solver's settings.
    Solver,
    /// Rate, exposure and gains of any camera.
    Cameras,
    /// Roles whose frames are stored.
    Storing,
    /// Divisor, age limit and sending camera.
    Link,
    /// All others, such as whether GPS is accepted.
    Other,
}

impl Topic {
    const COUNT: usize = 7;

    fn of(key: &str) -> Self {
        match key.split_once('.').map_or(key, |(table, _)| table) {
            "target" | "site" | "gps" => Self::Aim,
            "mounting" => Self::Mounting,
            "limb" | "fiducial" | "registration" => Self::Solver,
            table if table == "camera" || table.ends_with("_camera") => Self::Cameras,
            "store" => Self::Storing,
            "link" => Self::Link,
            _ => Self::Other,
        }
    }
}

/// The settings that the solver uses for a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Snapshot {
    pub target: Target,
    /// The place for frames that do not state theirs.
    pub place: Option<Place>,
    /// Value set by the ground; if `None`, the instrument's own applies.
    pub clocking_deg: Option<f64>,
    pub twist_deg: Option<f64>,
    pub solver: aspect::SolverSettings,
    pub roll: config::Roll,
    pub moon: config::Moon,
}

impl Snapshot {
    /// The mounting with the values set by the ground; `stated` is the instrument's own.
    pub fn mounting(&self, stated: &Mounting) -> Mounting {
        let mut mounting = *stated;
        if let Some(clocking_deg) = self.clocking_deg {
            mounting.clocking_deg.value = clocking_deg;
        }
        if let Some(twist_deg) = self.twist_deg {
            mounting = mounting.twisted_to(twist_deg);
        }
        mounting
    }
}

/// Whether a call has changed any setting.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Changed {
    Yes,
    No,
}

/// The settings in flight. Clones share them.
#[derive(Debug, Clone)]
pub struct Controls(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    state: Mutex<State>,
    versions: [AtomicU64; Topic::COUNT],
    quit_requested: AtomicBool,
    pictures: [AtomicBool; Role::COUNT],
    /// Wakes the thread that saves values after a change; one message is enough.
    changed: (Sender<()>, Receiver<()>),
    /// Rows for the command log.
    notes: (Sender<CommandNote>, Receiver<CommandNote>),
    notes_lost: AtomicU64,
}

#[derive(Debug, Clone)]
struct State {
    config: Config,
    target: Target,
    place: Option<Place>,
    own: CommandOnly,
    gps: Gps,
    /// The instrument's own mounting; `None` if no camera sees a plate.
    stated: Option<Mounting>,
    /// All values set by commands, by key: these are saved.
    commanded: BTreeMap<String, Value>,
    disks: Vec<Option<u8>>,
    clock_offset_us: Option<i64>,
    cameras: Vec<Role>,
    /// Configuration and target before any command.
    origin: Arc<(Config, Target)>,
    /// Frame with which the solver's settings are tested.
    proof: Option<Arc<Proof>>,
    /// Number of refused values, by key.
    refusals: BTreeMap<String, u64>,
    /// Reason why the last command was refused.
    reason: Option<String>,
}

impl Controls {
    /// The settings at the start of a flight with these cameras. `target` is that of the configuration.
    pub fn of_flight<'c>(
        config: Config,
        target: Target,
        cameras: impl Iterator<Item = &'c Camera> + Clone,
    ) -> Self {
        // Commands about the instrument apply to the first camera's.
        let instrument = cameras.clone().find_map(|camera| camera.sees.plate());
        let mounting = instrument.map(|instrument| instrument.mounting);
        let controls = Self::new(config, target, mounting);
        controls.note_cameras(&cameras.map(|camera| camera.role).collect::<Vec<_>>());
        if let Some(instrument) = instrument {
            controls.note_instrument(instrument);
        }
        controls
    }

    /// The same for one pitch-yaw camera of an instrument with this mounting.
    pub fn new(config: Config, target: Target, mounting: impl Into<Option<Mounting>>) -> Self {
        let state = State {
            place: config.site.place(),
            own: CommandOnly::new(),
            gps: Gps::default(),
            origin: Arc::new((config.clone(), target)),
            proof: None,
            config,
            target,
            stated: mounting.into(),
            commanded: BTreeMap::new(),
            disks: Vec::new(),
            clock_offset_us: None,
            cameras: vec![Role::PitchYaw],
            refusals: BTreeMap::new(),
            reason: None,
        };
        Self(Arc::new(Shared {
            state: Mutex::new(state),
            versions: Default::default(),
            quit_requested: AtomicBool::new(false),
            pictures: Default::default(),
            changed: bounded(1),
            notes: bounded(NOTES),
            notes_lost: AtomicU64::new(0),
        }))
    }

    /// Number of changes of a topic: the holder of a copy compares it and reads again.
    pub fn version(&self, topic: Topic) -> u64 {
        self.0.versions[topic as usize].load(Ordering::Acquire)
    }

    pub fn snapshot(&self) -> Snapshot {
        let state = self.state();
        Snapshot {
            target: state.target,
            place: state.place,
            clocking_deg: state.own.clocking_deg,
            twist_deg: state.own.twist_deg,
            solver: state.config.solver(),
            roll: state.config.roll,
            moon: state.config.moon,
        }
    }

    /// The present configuration.
    pub fn config(&self) -> Config {
        self.state().config.clone()
    }

    /// The present settings of a camera.
    pub fn camera(&self, camera: &Camera) -> ConfiguredCamera {
        let (name, role) = (&camera.name, camera.role);
        let configured = self.state().config.cameras.named(name).cloned();
        configured.unwrap_or_else(|| ConfiguredCamera::new(name, role))
    }

    /// Lead of the host's clock over true time, if it is known.
    pub fn clock_offset_us(&self) -> Option<i64> {
        self.state().clock_offset_us
    }

    /// Whether the frames of a role's cameras are to be stored.
    pub fn stores(&self, role: Role) -> bool {
        self.state().own.stores[role as usize]
    }

    /// Whether this computer sends solutions; `None` if no command has set it.
    pub fn sending(&self) -> Option<bool> {
        self.state().own.sending
    }

    /// Records whether a command has switched sending on or off.
    pub fn note_sending(&self, on: bool) {
        self.keep(SENDING, Value::Whole(on.into()));
    }

    /// Whether the controller requests solutions.
    pub fn tracking(&self) -> bool {
        self.state().own.tracking
    }

    /// Records whether the controller requests solutions.
    pub fn note_tracking(&self, on: bool) {
        self.keep(TRACKING, Value::Whole(on.into()));
    }

    /// The newest stamp of a signed datagram, ns since 1970; 0 without one.
    pub fn stamp_ns(&self) -> i64 {
        self.state().own.stamp_ns
    }

    /// Records the stamp of a signed datagram.
    pub fn note_stamp_ns(&self, stamp: i64) {
        self.keep(STAMP, Value::Whole(stamp));
    }

    /// Whether the ground has ordered the program to end.
    pub fn quit_requested(&self) -> bool {
        self.0.quit_requested.load(Ordering::Relaxed)
    }

    /// Sets the roles of the cameras; before that, there is only a pitch-yaw camera.
    pub fn note_cameras(&self, roles: &[Role]) {
        self.state().cameras = roles.to_vec();
    }

    /// Sets the instrument: settings of the solver with which it would find no Sun are refused.
    pub fn note_instrument(&self, instrument: &Instrument) {
        self.state().proof = Some(Arc::new(Proof::of(instrument)));
    }

    /// Values set by commands that differ from the configuration, each in words.
    pub fn differences(&self) -> Vec<String> {
        self.state().differences()
    }

    /// Resets values set by commands to the configuration; returns their number. The state of the conversation stays: stamp, sending,
    /// tracking and the GPS fix.
    pub fn reset(&self) -> usize {
        let mut state = self.state();
        let before = state.commanded.len();
        state.reset();
        let reset = before - state.commanded.len();
        drop(state);
        for version in &self.0.versions {
            version.fetch_add(1, Ordering::Release);
        }
        let _ = self.0.changed.0.try_send(());
        reset
    }

    /// Whether the ground has requested the next picture of a role's camera; the call removes the request.
    pub fn takes_picture(&self, role: Role) -> bool {
        self.0.pictures[role as usize].swap(false, Ordering::Relaxed)
    }

    /// Sets the used fraction of a disk of the archive, %; disks are counted from 0 here and from 1 by the ground.
    pub fn note_disk_use(&self, disk: usize, percent: Option<u8>) {
        let disks = &mut self.state().disks;
        if disks.len() <= disk {
            disks.resize(disk + 1, None);
        }
        disks[disk] = percent;
    }

    /// Sets the lead of the host's clock over true time.
    pub fn note_clock_offset(&self, microseconds: Option<i64>) {
        self.state().clock_offset_us = microseconds;
    }

    /// Stores a value of the conversation, which is never refused.
    fn keep(&self, setting: Setting, value: Value) {
        let _ = self.set(&[(setting.key(), value)]);
    }

    /// Sets keys to values, all or none of them.
    ///
    /// # Errors
    /// The key that was refused, and the reason.
    pub fn set(&self, settings: &[(&str, Value)]) -> Result<(), config::Refused> {
        if self.apply(settings)? == Changed::Yes {
            // If the last message has not been taken yet, its receiver will see this change, too.
            let _ = self.0.changed.0.try_send(());
        }
        Ok(())
    }

    /// As [`set`](Self::set), but does not trigger saving.
    fn apply(&self, settings: &[(&str, Value)]) -> Result<Changed, config::Refused> {
        let mut state = self.state();
        let mut next = state.clone();
        for (key, value) in settings {
            next.set(key, value)?;
        }
        next.check(settings, &state)?;
        let changed = next.commanded != state.commanded;
        *state = next;
        drop(state);
        for (key, _) in settings {
            self.0.versions[Topic::of(key) as usize].fetch_add(1, Ordering::Release);
        }
        Ok(if changed { Changed::Yes } else { Changed::No })
    }

    /// Queues a row for the command log, without waiting.
    pub fn note_command(&self, note: CommandNote) {
        if self.0.notes.0.try_send(note).is_err() {
            self.0.notes_lost.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Number of rows lost to a full queue since the last call.
    pub fn take_lost_notes(&self) -> u64 {
        self.0.notes_lost.swap(0, Ordering::Relaxed)
    }

    /// The rows that the command log has not received yet.
    pub fn command_notes(&self) -> impl Iterator<Item = CommandNote> {
        self.0.notes.1.try_iter()
    }

    /// Takes the place from our own GPS receiver, if GPS is accepted; `false` if the place is implausible.
    pub fn follow(&self, place: Place) -> bool {
        let fix = GpsFix {
            latitude_deg: place.latitude_deg as f32,
            longitude_deg: place.longitude_deg as f32,
        };
        let accepted = self.accepts(fix);
        if accepted && self.state().own.accepts_gps && self.move_to(fix) == CommandResult::Done {
            self.state().place = Some(place);
        }
        accepted
    }

    /// GPS fixes that were rejected as implausible.
    pub fn gps_refused(&self) -> u64 {
        self.state().gps.refused()
    }

    fn state(&self) -> MutexGuard<'_, State> {
        let state = self.0.state.lock();
        state.unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    fn set(&mut self, key: &str, value: &Value) -> Result<(), config::Refused> {
        match by_key(key) {
            Some(parameter) => parameter.set(&mut self.config, Some(value.clone()))?,
            None => self.own.set(key, value)?,
        }
        self.commanded.insert(key.into(), value.clone());
        match key.split_once('.') {
            Some(("target", _)) => {
                let target = &mut self.config.target;
                target.epoch_utc = None;
                let (x, y) = (target.x_arcsec, target.y_arcsec);
                self.target = Target::Fixed(HelioprojectiveArcsec { x, y });
            }
            Some(("site", _)) => {
                self.config.site.height_m.get_or_insert(0.0);
                self.place = self.config.site.place();
                self.forget_fix();
            }
            Some(("gps", "latitude_deg" | "longitude_deg")) => self.move_to_fix(),
            _ => {}
        }
        Ok(())
    }

    /// Checks the new settings for this flight, by the same rules as a file. `before` is the state until now.
    fn check(&self, settings: &[(&str, Value)], before: &Self) -> Result<(), config::Refused> {
        let known = before.contradictions();
        let is_new = |wrong: &config::Refused| known.iter().all(|known| known.key != wrong.key);
        if let Some(wrong) = self.contradictions().into_iter().find(is_new) {
            return Err(wrong);
        }
        let mut keys = settings.iter().map(|(key, _)| *key);
        match (
            keys.find(|key| Topic::of(key) == Topic::Solver),
            &self.proof,
        ) {
            (Some(key), Some(proof)) => proof.check(key, &self.config),
            _ => Ok(()),
        }
    }

    fn contradictions(&self) -> Vec<config::Refused> {
        let is_pitch_yaw = |role: &&Role| **role == Role::PitchYaw;
        let pitch_yaw = self.cameras.iter().filter(is_pitch_yaw).count();
        self.config.contradictions(pitch_yaw)
    }

    fn differences(&self) -> Vec<String> {
        let (config, _) = &*self.origin;
        let of_parameter = |key: &str, value: &Value| {
            let was = by_key(key)?.get(config);
            (was.as_ref() != Some(value)).then(|| {
                let was = was.map_or("nothing".into(), |was| was.to_string());
                format!("{key} = {value} (configuration: {was})")
            })
        };
        let differs = |(key, value): (&String, &Value)| match by_key(key) {
            Some(_) => of_parameter(key, value),
            None if is_kept(key) => None,
            None if CommandOnly::new().is(key, value) => None,
            None => Some(format!("{key} = {value} (set by command alone)")),
        };
        self.commanded.iter().filter_map(differs).collect()
    }

    fn reset(&mut self) {
        let (config, target) = (*self.origin).clone();
        self.place = config.site.place();
        (self.config, self.target) = (config, target);
        let own = CommandOnly::new();
        self.own = CommandOnly {
            sending: self.own.sending,
            tracking: self.own.tracking,
            stamp_ns: self.own.stamp_ns,
            latitude_deg: self.own.latitude_deg,
            longitude_deg: self.own.longitude_deg,
            ..own
        };
        self.commanded.retain(|key, _| is_kept(key));
        if self.own.latitude_deg.is_some() {
            self.move_to_fix();
        }
    }

    /// GPS gives no height here: that of the last place is kept.
    fn move_to_fix(&mut self) {
        let Some((latitude, longitude)) = self.own.latitude_deg.zip(self.own.longitude_deg) else {
            return;
        };
        let height_m = self.place.map_or(0.0, |place| place.height_m);
        let place = Place::new(latitude, longitude, height_m);
        self.place = place.ok().or(self.place);
        self.gps.resume(GpsFix {
            latitude_deg: latitude as f32,
            longitude_deg: longitude as f32,
        });
    }

    /// The ground has set the place: the next fix is not compared with earlier ones.
    fn forget_fix(&mut self) {
        (self.own.latitude_deg, self.own.longitude_deg) = (None, None);
        self.commanded.remove(LATITUDE.key());
        self.commanded.remove(LONGITUDE.key());
        self.gps.clear();
    }
}

/// Whether a reset keeps the setting of a key.
fn is_kept(key: &str) -> bool {
    KEPT.iter().any(|kept| kept.key() == key)
}

#[cfg(test)]
mod tests;
