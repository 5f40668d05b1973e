//! What the ground is told each second, put together from the counts and the latest answer.

use super::answer::{Answer, Recent};
use super::counts::Counts;
use super::moon::MoonDesk;
use super::navigation::NavigationTally;
use super::shared::Shared;
use super::tally::{FlightTally, quantile};
use crate::aspect::{Adopted, Quality};
use crate::clock::ClockStatus;
use crate::commands::CameraRole;
use crate::commands::controls::Controls;
use crate::geometry::MappingKind;
use crate::horizon;
use crate::link::housekeeping::{Digits, MarkIds};
use crate::link::{Housekeeping, MoonSight};
use crate::log;
use crate::navigation::nmea::{GpsCounts, Refusal};
use crate::provenance::COMMIT;
use crate::reasons::horizon as reasons;
use crossbeam_channel::Receiver;
use jiff::{SignedDuration, Timestamp};
use std::time::{Duration, Instant};

/// Where Linux tells how warm the computer is, in thousandths of a degree.
const COMPUTER_TEMPERATURE: &str = "/sys/class/thermal/thermal_zone0/temp";

/// Frames whose time differs from the computer's by more are those of another time.
const ANOTHER_TIME: Duration = Duration::from_secs(60);

/// How often threads were started again.
#[derive(Debug, Clone, Copy)]
pub(super) struct Restarts {
    pub all: u64,
    /// Of them, those that hung.
    pub takeovers: u64,
}

/// Makes the second's housekeeping.
pub(super) struct HousekeepingSource {
    controls: Controls,
    /// Of each pitch-yaw camera.
    recent: Vec<Shared<Recent>>,
    moon_desk: Shared<MoonDesk>,
    /// SHA-256 of the flight's configuration.
    configuration: Digits,
    start: Instant,
    /// By how much the frames of a simulated flight are ahead of the computer's clock.
    ahead: SignedDuration,
    before: FlightTally,
}

impl HousekeepingSource {
    pub fn new(
        controls: Controls,
        recent: Vec<Shared<Recent>>,
        moon_desk: Shared<MoonDesk>,
        configuration_sha256: &str,
    ) -> Self {
        Self {
            controls,
            recent,
            moon_desk,
            configuration: Digits::of(configuration_sha256),
            start: Instant::now(),
            ahead: SignedDuration::ZERO,
            before: FlightTally::default(),
        }
    }

    /// `events` wait for the line.
    pub fn next(
        &mut self,
        counts: &Counts,
        restarts: Restarts,
        events: usize,
    ) -> (Timestamp, Box<Housekeeping>) {
        let tally = counts.brief();
        let mut told = Box::<Housekeeping>::default();
        let clock = ClockStatus::read().ok();
        let offset_us = clock.map(|clock| clock.offset_us.round() as i64);
        self.controls.note_clock_offset(offset_us);
        told.uptime_s = small(self.start.elapsed().as_secs());
        told.restarts = small(restarts.all);
        told.takeovers = small(restarts.takeovers);
        told.log_lines_lost = small(log::lost_lines());
        told.commit = Digits::of(COMMIT.unwrap_or_default());
        told.modified = COMMIT.is_some_and(|commit| commit.ends_with("-dirty"));
        told.configuration = self.configuration;
        self.tell_settings(&mut told);
        tell_counts(&mut told, &tally);
        told.clock_stepped = tally.camera.utc_steps > self.before.camera.utc_steps;
        told.camera_c = tally.camera.health.temperature_c.map(|c| c as f32);
        told.computer_c = computer_c();
        let disks = counts.archive.disks();
        let used = |disk: usize| Some((100.0 - disks.get(disk)?.free_percent?) as u8);
        told.disks = [used(0), used(1)];
        let refused = |disk: usize| disks.get(disk).map_or(0, |d| d.refused + d.rows_refused);
        told.disk_refusals = [small(refused(0)), small(refused(1))];
        let frames: usize = counts.unsolved.iter().map(Receiver::len).sum();
        told.queued_frames = small(frames as u64);
        told.queued_events = small(events as u64);
        told.queued_pictures = small(counts.archive.waiting() as u64);
        told.queued_rows = small(counts.archive.waiting_rows() as u64);
        let sent = tally
            .line
            .solutions
            .saturating_sub(self.before.line.solutions);
        let latest = tally.line.latencies.iter().rev().take(sent as usize);
        let mut latencies: Vec<Duration> = latest.copied().collect();
        told.latency_ms = quantile(&mut latencies, 0.5).map(milliseconds);
        told.latency_99_ms = quantile(&mut latencies, 0.99).map(milliseconds);
        self.tell_answer(&mut told);
        self.tell_moon(&mut told);
        self.tell_values(&mut told);
        self.before = tally;
        (Timestamp::now() + self.ahead, told)
    }

    /// A simulated flight has the time of its frames, which may begin on any day: its housekeeping belongs beside them.
    fn note_simulated_time(&mut self, answer: &Answer) {
        let info = &answer.exposure.frame.info;
        if let Some(utc) = info.mid_exposure.filter(|_| info.is_simulated()) {
            let ahead = utc.duration_since(Timestamp::now());
            if (ahead - self.ahead).unsigned_abs() > ANOTHER_TIME {
                self.ahead = ahead;
            }
        }
    }

    fn tell_settings(&self, told: &mut Housekeeping) {
        let link = self.controls.config().link;
        told.computer = link.computer as u8;
        told.storing = self.controls.stores(CameraRole::PitchYaw);
        told.gps_refused = small(self.controls.gps_refused());
        told.clock_offset_us = self.controls.clock_offset_us().map(|us| us as f32);
    }

    fn tell_moon(&self, told: &mut Housekeeping) {
        let Some(seen) = self.moon_desk.lock().seen else {
            return;
        };
        told.night = seen.is_night.map(u8::from);
        if let MoonSight::Found(fix) = seen.sight {
            (told.moon_x_px, told.moon_y_px) = (Some(fix.x_px as f32), Some(fix.y_px as f32));
        }
    }

    fn tell_values(&self, told: &mut Housekeeping) {
        told.values_set = small(self.controls.differences().len() as u64);
    }

    fn tell_answer(&mut self, told: &mut Housekeeping) {
        let camera = self.controls.config().link.sending_camera as usize;
        let Some(recent) = self.recent.get(camera.saturating_sub(1)) else {
            return;
        };
        let (answer, mut solve_times) = {
            let mut recent = recent.lock();
            let solve_times = std::mem::take(&mut recent.solve_times);
            (recent.answer.take(), solve_times)
        };
        told.solve_ms = quantile(&mut solve_times, 0.5).map(milliseconds);
        if let Some(answer) = answer {
            self.note_simulated_time(&answer);
            tell_frame(told, &answer);
            tell_solution(told, &answer);
        }
    }
}

fn tell_counts(told: &mut Housekeeping, tally: &FlightTally) {
    let FlightTally {
        camera,
        solver,
        roll,
        moon,
        navigation,
        archive,
        line,
        ..
    } = tally;
    tell_navigation(told, navigation);
    told.propagated = small(line.propagated);
    told.taken = small(camera.taken);
    told.lost = small(camera.lost + camera.failed + solver.misfits);
    told.silent_s = small(camera.silent.as_secs());
    told.incomplete = small(camera.health.incomplete);
    told.reconnects = small(camera.health.reconnects);
    told.fine = small(solver.of(Quality::Fine));
    told.coarse = small(solver.of(Quality::Coarse));
    told.none = small(solver.of(Quality::None));
    for ((stage, _), count) in &solver.reasons {
        let stopped = &mut told.stopped[*stage as usize];
        // The layout wants these to begin again after 65535.
        *stopped = stopped.wrapping_add(*count as u16);
    }
    told.roll_fine = small(roll.of(horizon::Quality::Fine));
    told.roll_coarse = small(roll.of(horizon::Quality::Coarse));
    told.roll_none = small(roll.of(horizon::Quality::None));
    told.roll_reasons =
        [reasons::TOO_BRIGHT, reasons::TOO_DARK].map(|reason| small(roll.because(reason)));
    told.moon_found = small(moon.solved.values().sum::<u64>());
    told.moon_none = small(moon.none());
    told.moon_hidden = small(moon.hidden());
    told.calibration_contradicted = solver.contradicted;
    told.stored = small(archive.stored);
    told.unstored = small(archive.unstored);
    told.rows_refused = small(archive.rows_refused);
    told.tracking = line.conversation.tracking;
    told.sending = line.conversation.sending;
    told.announced = small(line.announced);
    told.solutions = small(line.solutions);
    told.errors = small(line.errors);
    told.outdated = small(line.outdated);
    told.unsent = small(line.failed + line.unannounced);
    told.reopened = small(line.reopened);
    told.rejected = small(line.rejected.packets);
    told.datagrams_refused = small(line.datagrams_refused);
}

fn tell_navigation(told: &mut Housekeeping, tally: &NavigationTally) {
    told.navigation = tally.status.map_or(0, |status| status as u8 + 1);
    if let Some(offset) = &tally.latest {
        told.propagated_azimuth_deg = Some(offset.difference.azimuth_deg as f32);
        told.propagated_elevation_deg = Some(offset.difference.elevation_deg as f32);
        told.propagated_sigma_deg = Some(offset.sigma_deg as f32);
        told.propagated_roll_deg = Some(offset.roll_deg.value as f32);
    }
    let [right, up, roll] = tally.differences.map(|sigmas| Some(sigmas? as f32));
    (told.gyro_right_sigmas, told.gyro_up_sigmas) = (right, up);
    told.gyro_roll_sigmas = roll;
    told.gyro_agreement = tally.agreement.map_or(0, |agreement| agreement as u8 + 1);
    told.imu_samples = small(tally.samples);
    told.imu_lost = small(tally.lost_samples + tally.unreadable);
    tell_gps(told, &tally.gps);
    told.navigation_refused = small(tally.refused);
    told.navigation_out_of_time = small(tally.out_of_time);
    told.navigation_lost = small(tally.overflowed);
    told.navigation_restarts = small(tally.restarts);
}

fn tell_gps(told: &mut Housekeeping, gps: &GpsCounts) {
    let refused = |refusal| gps.refused(refusal);
    let stale = refused(Refusal::Repeated) + refused(Refusal::OutOfTime);
    told.gps_fixes = small(gps.fixes);
    told.gps_without_fix = small(refused(Refusal::NoFix) + stale);
    for refusal in Refusal::ALL {
        let field = match refusal {
            Refusal::NoFix => &mut told.gps_no_fix,
            Refusal::Estimated => &mut told.gps_estimated,
            Refusal::Manual => &mut told.gps_manual,
            Refusal::Simulated => &mut told.gps_simulator,
            Refusal::Incomplete => &mut told.gps_incomplete,
            Refusal::WeekRollover => &mut told.gps_week_rollover,
            Refusal::AnotherDay => &mut told.gps_another_day,
            Refusal::Nowhere => &mut told.gps_no_place,
            Refusal::Impossible => &mut told.gps_out_of_range,
            Refusal::Jump => &mut told.gps_jumps,
            Refusal::Repeated => &mut told.gps_repeated,
            Refusal::OutOfTime => &mut told.gps_out_of_time,
        };
        *field = small(refused(refusal));
    }
    told.gps_unreadable = small(gps.unreadable);
    told.gps_noise_bytes = small(gps.noise_bytes);
}

fn tell_frame(told: &mut Housekeeping, answer: &Answer) {
    let info = &answer.exposure.frame.info;
    told.number = small(info.number.unwrap_or_default());
    told.simulated = info.is_simulated();
    told.exposure_us = small(info.exposure.map_or(0, |time| time.as_micros() as u64));
    told.analogue_gain = info.analogue_gain.map(|gain| gain as f32);
    told.preamp_gain = info.preamp_gain.map(|gain| gain as f32);
    told.solve_ms = told.solve_ms.or(Some(milliseconds(answer.solve_time)));
}

fn tell_solution(told: &mut Housekeeping, answer: &Answer) {
    let solution = &answer.solution;
    told.quality = solution.quality as u8;
    if let Some(levels) = solution.levels {
        told.background_dn = Some(levels.background_dn as f32);
        told.disc_dn = Some(levels.disc_dn as f32);
        told.noise_dn = Some(levels.noise_dn as f32);
    }
    told.limb_points = small(solution.limb.len() as u64);
    told.marks = small(solution.marks.len() as u64);
    told.ids = MarkIds::new(solution.marks.iter().map(|mark| [mark.id.i, mark.id.j]));
    if let Some(offset) = &answer.offset {
        told.azimuth_deg = Some(offset.azimuth_deg as f32);
        told.elevation_deg = Some(offset.elevation_deg as f32);
        told.offset_sigma_deg = Some(offset.sigma_deg as f32);
    }
    told.roll_deg = answer.roll_deg.map(|roll| roll.value as f32);
    told.roll_sigma_deg = answer.roll_deg.map(|roll| roll.sigma as f32);
    let Some((aspect, adopted)) = solution.aspect.as_ref().zip(solution.mapping.as_ref()) else {
        return;
    };
    let one = |[x, y]: [f64; 2]| Some(((x * x + y * y) / 2.0).sqrt() as f32);
    let sun = aspect.sun_px.position;
    (told.sun_x_px, told.sun_y_px) = (Some(sun.x as f32), Some(sun.y as f32));
    told.sun_sigma_px = one(aspect.sun_px.sigma());
    let plate = aspect.sun_plate.position;
    (told.plate_x_mil, told.plate_y_mil) = (Some(plate.x as f32), Some(plate.y as f32));
    told.plate_sigma_mil = one(aspect.sun_plate.sigma());
    told.mapping = match adopted {
        Adopted::Prior(_) => 4,
        Adopted::Calibration(_) => 5,
        Adopted::Own(own) => match own.mapping.kind() {
            MappingKind::Similarity => 1,
            MappingKind::Affine => 2,
            MappingKind::Homography => 3,
            MappingKind::Keystone => 6,
        },
    };
    told.scale_mil_per_px = Some(adopted.mapping().scale_mil_per_px(sun) as f32);
    told.rotation_deg = Some(adopted.mapping().rotation_deg(sun) as f32);
    told.residual_px = adopted.residual_px().map(|residual| residual as f32);
}

/// A count as the packet has room for it.
fn small<T: TryFrom<u64> + Bounded>(count: u64) -> T {
    T::try_from(count).unwrap_or(T::MOST)
}

trait Bounded {
    const MOST: Self;
}

impl Bounded for u8 {
    const MOST: Self = Self::MAX;
}

impl Bounded for u16 {
    const MOST: Self = Self::MAX;
}

impl Bounded for u32 {
    const MOST: Self = Self::MAX;
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
    use crate::link::housekeeping::FIELDS;
    use crate::navigation::nmea::{Heard, Refused};
    use crate::navigation::{Agreement, Axis};

    #[test]
    fn each_axis_of_cameras_against_gyros_has_a_field_of_its_own() {
        let mut told = Housekeeping::default();
        tell_navigation(&mut told, &NavigationTally::default());
        assert_eq!(told, Housekeeping::default());
        let mut tally = NavigationTally::default();
        for (axis, sigmas) in [(Axis::Right, 1.5), (Axis::Up, -7.25)] {
            tally.differences[axis as usize] = Some(sigmas);
        }
        for (agreement, number) in [
            (Agreement::Within, 1),
            (Agreement::Beyond, 2),
            (Agreement::LastingContradiction, 3),
        ] {
            tally.agreement = Some(agreement);
            tell_navigation(&mut told, &tally);
            assert_eq!(told.gyro_agreement, number);
        }
        assert_eq!(told.gyro_right_sigmas, Some(1.5));
        assert_eq!(told.gyro_up_sigmas, Some(-7.25));
        assert_eq!(told.gyro_roll_sigmas, None);
    }

    #[test]
    fn each_reason_of_a_refused_fix_has_a_field_of_its_own() {
        let mut gps = GpsCounts::default();
        for (n, refusal) in Refusal::ALL.into_iter().enumerate() {
            let refused = Heard::Refused(Refused::new(refusal, "why"));
            (0..=n).for_each(|_| _ = gps.note(&refused));
        }
        let mut told = Housekeeping::default();
        tell_gps(&mut told, &gps);
        let counts = told.csv_row();
        let fields = FIELDS.iter().zip(&counts);
        let fields = fields.skip_while(|(field, _)| field.name != "gps_no_fix");
        let counts: Vec<&str> = fields.map(|(_, count)| count.as_str()).collect();
        let reasons = [
            "1", "2", "3", "4", "5", "6", "7", "8", "9", "10", "11", "12",
        ];
        assert_eq!(counts[..12], reasons);
        assert_eq!(counts[12..14], ["0", "0"], "unreadable, noise");
        // No fix, the same again, and out of time.
        assert_eq!(told.gps_without_fix, 1 + 11 + 12);
    }
}
