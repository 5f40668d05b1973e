//! The housekeeping of each second, made from the counts and the latest answer.

use super::messages::{MoonState, Recent, SolvedFrame, SolvedSun};
use super::shared::Shared;
use super::tallies::{CameraTallies, Tallies};
use super::tally::{FlightTally, SolverTally, quantile};
use crate::aspect::{Adopted, Quality, Stage};
use crate::clock::ClockStatus;
use crate::commands::controls::Controls;
use crate::geometry::MappingKind;
use crate::instrument::Role;
use crate::link::housekeeping::{
    ArchiveStatus, CamerasStatus, Digits, FrameStatus, GpsStatus, LineStatus, MarkIds,
    NavigationStatus, Parts, SystemStatus, saturated,
};
use crate::link::{CameraCounts, FrameMarks, Housekeeping, MoonOutcome};
use crate::moon;
use crate::navigation::nmea::Refusal;
use crate::plate::Pattern;
use crate::provenance::COMMIT;
use crate::reasons::horizon as reasons;
use jiff::{SignedDuration, Timestamp};
use std::time::{Duration, Instant};

/// File in which Linux gives the computer's temperature, in thousandths of a degree.
const COMPUTER_TEMPERATURE: &str = "/sys/class/thermal/thermal_zone0/temp";

/// Largest difference between a frame's time and the computer's; beyond it the frame belongs to another time.
const ANOTHER_TIME: Duration = Duration::from_secs(60);

/// Number of thread restarts.
#[derive(Debug, Clone, Copy)]
pub(super) struct Restarts {
    pub all: u64,
    /// Restarts of threads that hung.
    pub takeovers: u64,
}

/// Packets to the ground for one second.
pub(super) struct SecondPackets {
    pub time: Timestamp,
    pub housekeeping: Box<Housekeeping>,
    /// Counts of cameras that have no fields in the housekeeping.
    pub counts: Vec<CameraCounts>,
    /// Ids of marks on plates whose ids do not fit into the housekeeping.
    pub marks: Vec<FrameMarks>,
}

/// Makes the second's housekeeping.
pub(super) struct HousekeepingSource {
    controls: Controls,
    moon_state: Shared<MoonState>,
    /// SHA-256 of the flight's configuration.
    configuration: Digits,
    start: Instant,
    /// Lead of a simulated flight's frames over the computer's clock.
    ahead: SignedDuration,
    before: FlightTally,
}

impl HousekeepingSource {
    pub fn new(
        controls: Controls,
        moon_state: Shared<MoonState>,
        configuration_sha256: &str,
    ) -> Self {
        Self {
            controls,
            moon_state,
            configuration: Digits::of(configuration_sha256),
            start: Instant::now(),
            ahead: SignedDuration::ZERO,
            before: FlightTally::default(),
        }
    }

    /// The packets of the next second; `events` is the number of events waiting for the line.
    pub fn next(&mut self, tallies: &Tallies, restarts: Restarts, events: usize) -> SecondPackets {
        let tally = tallies.brief();
        let recents = take_recents(tallies);
        let marks = recents.iter().filter_map(frame_marks).collect();
        let number = self.controls.config().link.sending_camera;
        let mut recents = recents.into_iter();
        let sending = recents.find(|(camera, _)| u32::from(*camera) == number);
        let (_, Recent { frame, solve_times }) = sending.unwrap_or_default();
        if let Some(frame) = &frame {
            self.note_simulated_time(frame);
        }
        let housekeeping = Housekeeping::from(Parts {
            count: tally.counts,
            frame: frame.as_ref().map_or(FrameStatus::default(), frame_status),
            cameras: self.cameras(tallies, &tally, solve_ms(solve_times, frame.as_ref())),
            line: self.line(&tally, events),
            archive: archive_status(tallies, &tally),
            navigation: navigation_status(&tally),
            gps: gps_status(&tally),
            system: self.system(&tally, restarts),
        });
        self.before = tally;
        SecondPackets {
            time: Timestamp::now() + self.ahead,
            housekeeping: Box::new(housekeeping),
            counts: tallies.cameras.iter().filter_map(further).collect(),
            marks,
        }
    }

    /// A simulated flight takes the time of its frames, which may begin on any day; its housekeeping uses the same time.
    fn note_simulated_time(&mut self, frame: &SolvedFrame) {
        let info = &frame.exposure.frame.info;
        if let Some(utc) = info.mid_exposure.filter(|_| info.is_simulated()) {
            let ahead = utc.duration_since(Timestamp::now());
            if (ahead - self.ahead).unsigned_abs() > ANOTHER_TIME {
                self.ahead = ahead;
            }
        }
    }

    /// Status of all cameras, and of the first one of each role.
    fn cameras(
        &self,
        tallies: &Tallies,
        tally: &FlightTally,
        solve_ms: Option<f32>,
    ) -> CamerasStatus {
        let first = |role| {
            let mut of_role = tally.solvers.iter().filter(move |one| one.role == role);
            of_role
                .next()
                .map_or(SolverTally::default(), |one| one.solver.clone())
        };
        let [sun, roll, moon] = [Role::PitchYaw, Role::Roll, Role::Moon].map(first);
        let count = |solver: &SolverTally, quality| saturated(solver.of(quality));
        let result = self.moon_state.lock().result;
        let fix = result.and_then(|result| match result.outcome {
            MoonOutcome::Found(fix) => Some(fix),
            _ => None,
        });
        let hidden = moon.stopped_at(moon::Stage::Sky);
        let camera = &tally.camera;
        let misfits: u64 = tally.solvers.iter().map(|one| one.solver.misfits).sum();
        let waiting: usize = tallies.cameras.iter().map(|one| one.unsolved.len()).sum();
        // The count wraps to 0 after 65535.
        let stopped = |stage| sun.stopped_at(stage) as u16;
        CamerasStatus {
            clock_stepped: camera.utc_steps > self.before.camera.utc_steps,
            lost: saturated(camera.lost + camera.failed + misfits),
            incomplete: saturated(camera.health.incomplete),
            reconnects: saturated(camera.health.reconnects),
            fine: count(&sun, Quality::Fine),
            coarse: count(&sun, Quality::Coarse),
            none: count(&sun, Quality::None),
            stopped_levels: stopped(Stage::Levels),
            stopped_limb: stopped(Stage::Limb),
            stopped_marks: stopped(Stage::Marks),
            stopped_identification: stopped(Stage::Identification),
            stopped_registration: stopped(Stage::Registration),
            stopped_aspect: stopped(Stage::Aspect),
            stopped_pointing: stopped(Stage::Pointing),
            camera_c: camera.health.temperature_c.map(|c| c as f32),
            solve_ms,
            calibration_contradicted: tally.solvers.iter().any(|one| one.solver.contradicted),
            silent_s: saturated(camera.silent.as_secs()),
            queued_frames: saturated(waiting as u64),
            roll_fine: count(&roll, Quality::Fine),
            roll_coarse: count(&roll, Quality::Coarse),
            roll_none: count(&roll, Quality::None),
            roll_too_bright: saturated(roll.because(reasons::TOO_BRIGHT)),
            roll_too_dark: saturated(roll.because(reasons::TOO_DARK)),
            night: result.and_then(|result| result.is_night).map(u8::from),
            moon_found: saturated(moon.frames() - moon.of(Quality::None)),
            moon_none: saturated(moon.of(Quality::None).saturating_sub(hidden)),
            moon_hidden: saturated(hidden),
            moon_x_px: fix.map(|fix| fix.x_px as f32),
            moon_y_px: fix.map(|fix| fix.y_px as f32),
        }
    }

    fn line(&self, tally: &FlightTally, events: usize) -> LineStatus {
        let line = &tally.line;
        let [latency_ms, latency_99_ms] = self.latencies(tally);
        LineStatus {
            tracking: line.conversation.tracking,
            sending: line.conversation.sending,
            unsent: saturated(line.failed + line.unannounced),
            reopened: saturated(line.reopened),
            rejected: saturated(line.rejected.packets),
            latency_ms,
            latency_99_ms,
            queued_events: saturated(events as u64),
        }
    }

    fn system(&self, tally: &FlightTally, restarts: Restarts) -> SystemStatus {
        let offset_us = ClockStatus::read()
            .ok()
            .map(|clock| clock.offset_us.round() as i64);
        self.controls.note_clock_offset(offset_us);
        SystemStatus {
            computer: self.controls.config().link.computer as u8,
            storing: self.controls.stores(Role::PitchYaw),
            uptime_s: saturated(self.start.elapsed().as_secs()),
            computer_c: computer_c(),
            clock_offset_us: offset_us.map(|us| us as f32),
            restarts: saturated(restarts.all),
            takeovers: saturated(restarts.takeovers),
            gps_refused: saturated(self.controls.gps_refused()),
            log_lines_lost: saturated(tally.log_lines_lost),
            commit: Digits::of(COMMIT.unwrap_or_default()),
            modified: COMMIT.is_some_and(|commit| commit.ends_with("-dirty")),
            configuration: self.configuration,
            values_set: saturated(self.controls.differences().len() as u64),
        }
    }

    /// Latencies from frame to packet, of the solutions since the last packet: median and 99 %, ms.
    fn latencies(&self, tally: &FlightTally) -> [Option<f32>; 2] {
        let sent = tally
            .counts
            .solutions
            .saturating_sub(self.before.counts.solutions);
        let latest = tally.line.latencies.iter().rev().take(sent as usize);
        let mut latencies: Vec<Duration> = latest.copied().collect();
        [0.5, 0.99].map(|fraction| quantile(&mut latencies, fraction).map(milliseconds))
    }
}

/// Latest contributions of each camera's solver since the last packet, by the camera's number.
fn take_recents(tallies: &Tallies) -> Vec<(u8, Recent)> {
    let take = |camera: &CameraTallies| {
        let recent = std::mem::take(&mut *camera.recent.lock());
        (camera.station.number, recent)
    };
    tallies.cameras.iter().map(take).collect()
}

/// The marks of a camera's latest frame, if their ids do not fit into the housekeeping.
fn frame_marks((camera, recent): &(u8, Recent)) -> Option<FrameMarks> {
    let frame = recent.frame.as_ref()?;
    let sun = frame.sun().filter(|sun| !has_plate_of_2013(sun))?;
    let ids: Vec<[i32; 2]> = mark_ids(sun).collect();
    FrameMarks::new((*camera).into(), frame_number(frame), &ids)
}

fn has_plate_of_2013(sun: &SolvedSun) -> bool {
    sun.instrument.plate.pattern() == Pattern::Heroes
}

fn mark_ids(sun: &SolvedSun) -> impl Iterator<Item = [i32; 2]> {
    let marks = sun.solution.marks.iter();
    marks.map(|mark| [mark.id.i, mark.id.j])
}

fn frame_number(frame: &SolvedFrame) -> u32 {
    saturated(frame.exposure.frame.info.number.unwrap_or_default())
}

/// The counts of a camera that has no fields in the housekeeping; `None` for the first one of a role, which has.
fn further(camera: &CameraTallies) -> Option<CameraCounts> {
    let station = &camera.station;
    if station.ordinal == 1 {
        return None;
    }
    let (taken, solver) = (camera.camera.copy(), camera.solver.copy());
    Some(CameraCounts {
        camera: station.number.into(),
        role: station.camera.role as u16,
        fine: saturated(solver.of(Quality::Fine)),
        coarse: saturated(solver.of(Quality::Coarse)),
        none: saturated(solver.of(Quality::None)),
        lost: saturated(taken.lost + taken.failed + solver.misfits),
    })
}

fn archive_status(tallies: &Tallies, tally: &FlightTally) -> ArchiveStatus {
    let disks = tallies.archive.disks();
    let used = |disk: usize| Some((100.0 - disks.get(disk)?.free_percent?) as u8);
    let refused = |disk: usize| disks.get(disk).map_or(0, |d| d.refused + d.rows_refused);
    ArchiveStatus {
        disk_1: used(0),
        disk_2: used(1),
        queued_pictures: saturated(tallies.archive.waiting() as u64),
        queued_rows: saturated(tallies.archive.waiting_rows() as u64),
        disk_1_refusals: saturated(refused(0)),
        disk_2_refusals: saturated(refused(1)),
        rows_refused: saturated(tally.archive.rows_refused),
    }
}

fn navigation_status(tally: &FlightTally) -> NavigationStatus {
    let navigation = &tally.navigation;
    let offset = navigation.latest.as_ref();
    let [right, up, roll_sigmas] = navigation.differences.map(|sigmas| Some(sigmas? as f32));
    NavigationStatus {
        navigation: navigation.status.map_or(0, |status| status as u8 + 1),
        propagated_azimuth_deg: offset.map(|o| o.difference.azimuth_deg as f32),
        propagated_elevation_deg: offset.map(|o| o.difference.elevation_deg as f32),
        propagated_sigma_deg: offset.map(|o| o.sigma_deg as f32),
        propagated_roll_deg: offset.map(|o| o.roll_deg.value as f32),
        imu_lost: saturated(navigation.lost_samples + navigation.unreadable),
        navigation_refused: saturated(navigation.refused),
        navigation_out_of_time: saturated(navigation.out_of_time),
        navigation_restarts: saturated(navigation.restarts),
        gyro_right_sigmas: right,
        gyro_up_sigmas: up,
        gyro_roll_sigmas: roll_sigmas,
        gyro_agreement: navigation
            .agreement
            .map_or(0, |agreement| agreement as u8 + 1),
    }
}

fn gps_status(tally: &FlightTally) -> GpsStatus {
    let gps = &tally.navigation.gps;
    let refused = |refusal| saturated(gps.refused(refusal));
    let stale = [Refusal::NoFix, Refusal::Repeated, Refusal::OutOfTime];
    GpsStatus {
        gps_fixes: saturated(gps.fixes),
        gps_without_fix: saturated(stale.iter().map(|why| gps.refused(*why)).sum()),
        gps_no_fix: refused(Refusal::NoFix),
        gps_estimated: refused(Refusal::Estimated),
        gps_manual: refused(Refusal::Manual),
        gps_simulator: refused(Refusal::Simulated),
        gps_incomplete: refused(Refusal::Incomplete),
        gps_week_rollover: refused(Refusal::WeekRollover),
        gps_another_day: refused(Refusal::AnotherDay),
        gps_no_place: refused(Refusal::Nowhere),
        gps_out_of_range: refused(Refusal::Impossible),
        gps_jumps: refused(Refusal::Jump),
        gps_repeated: refused(Refusal::Repeated),
        gps_out_of_time: refused(Refusal::OutOfTime),
        gps_unreadable: saturated(gps.unreadable),
        gps_noise_bytes: saturated(gps.noise_bytes),
    }
}

/// Median solve time since the last packet, ms; that of the latest frame if there was none since.
fn solve_ms(mut solve_times: Vec<Duration>, frame: Option<&SolvedFrame>) -> Option<f32> {
    let latest = frame.map(|frame| frame.solved.solve_time);
    quantile(&mut solve_times, 0.5).or(latest).map(milliseconds)
}

fn frame_status(frame: &SolvedFrame) -> FrameStatus {
    let (info, sun) = (&frame.exposure.frame.info, frame.sun());
    let of_2013 = sun.filter(|sun| has_plate_of_2013(sun));
    let (solution, levels) = (sun.map(|sun| &sun.solution), frame.solved.levels);
    let offset = sun.and_then(|sun| sun.offset.as_ref());
    let marks = solution.map_or(&[][..], |solution| &solution.marks);
    // Aspect and mapping are those of this frame only if both are present.
    let placed = solution.and_then(|one| one.aspect.as_ref().zip(one.mapping.as_ref()));
    let aspect = placed.map(|(aspect, _)| aspect);
    let adopted = placed.map(|(_, adopted)| adopted);
    let sun = aspect.map(|aspect| aspect.sun_px.position);
    let plate = aspect.map(|aspect| aspect.sun_plate.position);
    let mapping = adopted
        .zip(sun)
        .map(|(adopted, sun)| (adopted.mapping(), sun));
    let one = |[x, y]: [f64; 2]| ((x * x + y * y) / 2.0).sqrt() as f32;
    FrameStatus {
        number: frame_number(frame),
        quality: frame.solved.quality as u8,
        background_dn: levels.map(|levels| levels.background_dn as f32),
        disc_dn: levels.map(|levels| levels.disc_dn as f32),
        noise_dn: levels.map(|levels| levels.noise_dn as f32),
        sun_x_px: sun.map(|sun| sun.x as f32),
        sun_y_px: sun.map(|sun| sun.y as f32),
        sun_sigma_px: aspect.map(|aspect| one(aspect.sun_px.sigma())),
        plate_x_mil: plate.map(|plate| plate.x as f32),
        plate_y_mil: plate.map(|plate| plate.y as f32),
        plate_sigma_mil: aspect.map(|aspect| one(aspect.sun_plate.sigma())),
        limb_points: saturated(solution.map_or(0, |one| one.limb.len()) as u64),
        marks: saturated(marks.len() as u64),
        ids: MarkIds::new(of_2013.into_iter().flat_map(mark_ids)),
        mapping: adopted.map_or(0, mapping_code),
        scale_mil_per_px: mapping.map(|(mapping, sun)| mapping.scale_mil_per_px(sun) as f32),
        rotation_deg: mapping.map(|(mapping, sun)| mapping.rotation_deg(sun) as f32),
        residual_px: adopted.and_then(|adopted| Some(adopted.residual_px()? as f32)),
        azimuth_deg: offset.map(|offset| offset.azimuth_deg as f32),
        elevation_deg: offset.map(|offset| offset.elevation_deg as f32),
        offset_sigma_deg: offset.map(|offset| offset.sigma_deg as f32),
        exposure_us: saturated(info.exposure.map_or(0, |time| time.as_micros() as u64)),
        analogue_gain: info.analogue_gain.map(|gain| gain as f32),
        preamp_gain: info.preamp_gain.map(|gain| gain as f32),
        simulated: info.is_simulated(),
        roll_deg: frame.solved.roll.map(|roll| roll.deg.value as f32),
        roll_sigma_deg: frame.solved.roll.map(|roll| roll.deg.sigma as f32),
    }
}

fn mapping_code(adopted: &Adopted) -> u8 {
    match adopted {
        Adopted::Prior(_) => 4,
        Adopted::Calibration(_) => 5,
        Adopted::Own(own) => match own.mapping.kind() {
            MappingKind::Similarity => 1,
            MappingKind::Affine => 2,
            MappingKind::Homography => 3,
            MappingKind::Keystone => 6,
        },
    }
}

fn milliseconds(time: Duration) -> f32 {
    1e3 * time.as_secs_f32()
}

fn computer_c() -> Option<f32> {
    let text = std::fs::read_to_string(COMPUTER_TEMPERATURE).ok()?;
    let thousandths: f32 = text.trim().parse().ok()?;
    Some(thousandths / 1000.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use crate::link::housekeeping::FIELDS;
    use crate::navigation::nmea::{Received, Refused};
    use crate::navigation::{Agreement, Axis};
    use crate::pointing::Target;
    use crate::service::tally::NavigationTally;

    fn packet(tallies: &Tallies) -> Housekeeping {
        let mounting = crate::instrument::builtin("demo").unwrap().mounting;
        let controls = Controls::new(Config::default(), Target::default(), mounting);
        let mut source = HousekeepingSource::new(controls, Shared::default(), "");
        let restarts = Restarts {
            all: 2,
            takeovers: 1,
        };
        *source.next(tallies, restarts, 3).housekeeping
    }

    /// The housekeeping that is sent for these counts.
    fn housekeeping(navigation: NavigationTally) -> Housekeeping {
        let tallies = Tallies::default();
        *tallies.navigation.lock() = navigation;
        packet(&tallies)
    }

    #[test]
    fn each_axis_of_cameras_against_gyros_has_a_field_of_its_own() {
        let mut tally = NavigationTally::default();
        for (axis, sigmas) in [(Axis::Right, 1.5), (Axis::Up, -7.25)] {
            tally.differences[axis as usize] = Some(sigmas);
        }
        for (agreement, number) in [
            (None, 0),
            (Some(Agreement::Within), 1),
            (Some(Agreement::Beyond), 2),
            (Some(Agreement::LastingContradiction), 3),
        ] {
            tally.agreement = agreement;
            let housekeeping = housekeeping(tally.clone());
            assert_eq!(housekeeping.gyro_agreement, number);
            assert_eq!(housekeeping.gyro_right_sigmas, Some(1.5));
            assert_eq!(housekeeping.gyro_up_sigmas, Some(-7.25));
            assert_eq!(housekeeping.gyro_roll_sigmas, None);
        }
    }

    #[test]
    fn each_reason_of_a_refused_fix_has_a_field_of_its_own() {
        let mut tally = NavigationTally::default();
        for (n, refusal) in Refusal::ALL.into_iter().enumerate() {
            let refused = Received::Refused(Refused::new(refusal, "why"));
            (0..=n).for_each(|_| _ = tally.gps.note(&refused));
        }
        let housekeeping = housekeeping(tally);
        let counts = housekeeping.csv_row();
        let fields = FIELDS.iter().zip(&counts);
        let fields = fields.skip_while(|(field, _)| field.name != "gps_no_fix");
        let counts: Vec<&str> = fields.map(|(_, count)| count.as_str()).collect();
        let reasons = [
            "1", "2", "3", "4", "5", "6", "7", "8", "9", "10", "11", "12",
        ];
        assert_eq!(counts[..12], reasons);
        assert_eq!(counts[12..14], ["0", "0"], "unreadable, noise");
        // No fix, repeated, and out of time.
        assert_eq!(housekeeping.gps_without_fix, 1 + 11 + 12);
    }

    #[test]
    fn what_threads_count_is_in_the_packet() {
        let tallies = Tallies::default();
        tallies.counters.taken.add(7);
        tallies.counters.errors.add(1 << 40);
        let housekeeping = packet(&tallies);
        assert_eq!((housekeeping.taken, housekeeping.errors), (7, u32::MAX));
        assert_eq!((housekeeping.restarts, housekeeping.takeovers), (2, 1));
        assert_eq!(housekeeping.queued_events, 3);
    }
}
