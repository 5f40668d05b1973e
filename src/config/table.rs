//! The parameter table.
//!
//! A row has the field in [`Config`](super::Config), its unit, the allowed values, its command number, if any, and its
//! meaning (with the effect of raising it, if that is not obvious). An optional field shows a sample in
//! the example. Command numbers are for parameters that have no command of their own; a number once given is
//! never given again.

use super::Memory;
use super::parameter::{Allowed, Parameter, Sample};
use super::value::Field;
use crate::archive::{Overflow, Sharing};
use crate::camera::PixelFormat;
use crate::fits::Compression;
use crate::output::Format;
use Allowed::{Name, Number, Text, Utc, Whole};
use std::sync::LazyLock;

/// A row of a field of the configuration, `table.field`, of one of the configured cameras, `[table].field`, or of one of the outputs, `{table}.field`.
macro_rules! row {
    ($home:tt . $field:ident, $unit:literal, $allowed:expr, command $command:literal, $documentation:expr) => {
        row!(@ $home.$field, ($unit, $allowed, Some($command), None, $documentation))
    };
    ($home:tt . $field:ident, $unit:literal, $allowed:expr, sample $sample:expr, $documentation:expr) => {
        row!(@ $home.$field, ($unit, $allowed, None, Some($sample), $documentation))
    };
    ($home:tt . $field:ident, $unit:literal, $allowed:expr, $documentation:expr) => {
        row!(@ $home.$field, ($unit, $allowed, None, None, $documentation))
    };
    (@ [$table:ident] . $field:ident, $entry:tt) => {
        row!(= $table.$field, $entry,
            |config, table| config.cameras.named(table)?.$field.value(),
            |config, table, value| {
                config.cameras.named_mut(table)?.$field = Field::from_value(value)?;
                Some(())
            }
        )
    };
    (@ {$table:ident} . $field:ident, $entry:tt) => {
        row!(= $table.$field, $entry,
            |config, table| config.outputs.named(table)?.$field.value(),
            |config, table, value| {
                config.outputs.named_mut(table)?.$field = Field::from_value(value)?;
                Some(())
            }
        )
    };
    (@ $table:ident . $field:ident, $entry:tt) => {
        row!(= $table.$field, $entry,
            |config, _| config.$table.$field.value(),
            |config, _, value| {
                config.$table.$field = Field::from_value(value)?;
                Some(())
            }
        )
    };
    (= $table:ident . $field:ident, ($unit:literal, $allowed:expr, $command:expr, $sample:expr, $documentation:expr), $get:expr, $set:expr) => {
        Parameter {
            key: concat!(stringify!($table), ".", stringify!($field)),
            unit: $unit,
            allowed: $allowed,
            command: $command,
            documentation: $documentation,
            sample: $sample,
            get: $get,
            set: $set,
        }
    };
}

/// The rows of one camera. `$rate` is the command number of its rate, if any; the texts after it state the commands by which
/// exposure, analogue gain and pre-amplifier gain are set in flight.
macro_rules! camera_rows {
    ($table:ident, instrument $file:literal, $instrument:literal, rate ($($rate:literal)?), exposure $exposure:literal, analogue $analogue:literal, preamp $preamp:literal) => {[
        row!([$table].source, "", Allowed::Source, sample Sample::Text("gige:192.168.1.20"),
            "Where the camera's frames come from: a GigE Vision camera by IP address or serial number, any GenICam camera (USB3 Vision, too) by its id in Aravis, the frames of a folder (with ?follow those that another program writes into it from then on, with ?follow=all also those that lie there), the simulator, or \"own\" for one that a program of your own brings (docs/own-gondola.md). Unset, there is no such camera; [camera] must be set, \"simulated\" for the simulator."),
        row!([$table].instrument, "", Text, sample Sample::Text($file), $instrument),
        row!([$table].rate_hz, "Hz", Number(0.01, 100.0), $(command $rate,)?
            "Frames per second. The 2013 camera gives up to 26. A higher rate increases the load on solver and disks."),
        row!([$table].exposure_us, "us", Whole(1, 1_000_000),
            concat!("Exposure time. ", $exposure, "A longer one raises the signal until the disc saturates, and the smear while slewing.")),
        row!([$table].analogue_gain, "", Number(-1e6, 1e6), sample Sample::Number(400.0),
            concat!("Analogue gain in the camera's own scale; unset, the camera keeps its own.", $analogue)),
        row!([$table].preamp_gain, "", Number(-1e6, 1e6), sample Sample::Number(-3.0),
            concat!("Pre-amplifier gain in the camera's own scale; unset, the camera keeps its own.", $preamp)),
        row!([$table].region_px, "px", Allowed::Region, sample Sample::Text("100,50,640,480"),
            "Part of the sensor that is read; unset, all of it. Positions on the sensor then count from its corner."),
        row!([$table].pixel_format, "", Name(&PixelFormat::NAMES),
            "How the camera digitises: 8 bits, or 10, 12 or 16 bits in two bytes, which double the files and, unless the camera packs its pixels, the traffic."),
        row!([$table].auto_exposure, "", Name(&["off", "on"]),
            "Whether the exposure is controlled by the brightness; it then starts at exposure_us."),
        row!([$table].auto_exposure_target, "", Number(0.1, 0.95),
            "Target level of the disc's 99th percentile, or of the limb for a horizon camera, or of the Moon, as a fraction of full scale. A higher value lowers the noise and leaves less margin for glints."),
        row!([$table].auto_exposure_band, "", Number(0.01, 0.5),
            "Largest relative difference from the best exposure before it is changed."),
        row!([$table].auto_exposure_max_factor, "", Number(1.05, 10.0),
            "The largest factor by which the exposure changes from one frame to the next."),
        row!([$table].auto_exposure_hold_frames, "", Whole(0, 100_000),
            "Frames for which the exposure is held when the disc or the limb suddenly dims or is lost; then it increases slowly. A higher value bridges longer clouds."),
        row!([$table].auto_exposure_min_us, "us", Whole(1, 1_000_000),
            "Shortest automatic exposure."),
        row!([$table].auto_exposure_max_us, "us", Whole(1, 1_000_000),
            "Longest automatic exposure. A higher value allows more smear."),
    ]};
}

/// The standard cameras: two that see a plate, one for roll, and one that sees the Moon, unless a file gives them another role.
fn cameras() -> impl Iterator<Item = Parameter> {
    let camera = camera_rows!(
        camera,
        instrument "calibration/heroes-pyas-f.toml", "The instrument's file; unset, the built-in \"demo\", except for a real camera or a folder that is followed, which needs one.",
        rate (1),
        exposure "Aspect command 0x0451 sets it in flight. ",
        analogue " Aspect command 0x0481 sets it in flight.",
        preamp " Aspect command 0x0491 sets it in flight."
    );
    let second = camera_rows!(
        second_camera,
        instrument "calibration/heroes-pyas-f.toml", "The instrument's file; unset, the built-in \"demo\", except for a real camera or a folder that is followed, which needs one.",
        rate (),
        exposure "",
        analogue "",
        preamp ""
    );
    let roll = camera_rows!(
        roll_camera,
        instrument "calibration/roll.toml", "The file of a camera that sees the horizon (docs/horizon.md), with body_from_camera; unset, its frames are stored and not solved.",
        rate (),
        exposure "Aspect command 0x0551 sets it in flight. ",
        analogue " Aspect command 0x0581 sets it in flight.",
        preamp " Aspect command 0x0591 sets it in flight."
    );
    let moon = camera_rows!(
        moon_camera,
        instrument "calibration/moon.toml", "The file of a camera that sees the Moon (docs/moon.md).",
        rate (),
        exposure "Aspect command 0x05B1 sets it in flight. ",
        analogue "",
        preamp ""
    );
    camera.into_iter().chain(second).chain(roll).chain(moon)
}

#[rustfmt::skip]
static BEFORE_CAMERAS: &[Parameter] = &[
    row!(site.latitude_deg, "deg", Number(-90.0, 90.0), sample Sample::Number(34.49),
        "Geodetic latitude (WGS 84), north positive. The site is used for frames that do not state their own place; give all three of its values or none."),
    row!(site.longitude_deg, "deg", Number(-180.0, 360.0), sample Sample::Number(-104.2218),
        "Longitude, east positive."),
    row!(site.height_m, "m", Number(-1000.0, 100_000.0), sample Sample::Number(38_405.0),
        "Height above the WGS 84 ellipsoid."),

    row!(sky.earth_orientation, "", Text, sample Sample::Text("/data/earth_orientation.csv"),
        "A newer table of leap seconds, UT1 - UTC and the pole, as tools/iers makes it. The built-in one ends with the predictions of the day it was made; after its end UT1 is extrapolated, with a growing sigma, and before its beginning there are no offsets."),

    row!(target.x_arcsec, "arcsec", Number(-32_767.0, 32_767.0),
        "Where the telescope should point: helioprojective x from the disc's centre, towards solar west. Aspect command 0x0412 sets both axes in flight."),
    row!(target.y_arcsec, "arcsec", Number(-32_767.0, 32_767.0),
        "Helioprojective y from the disc's centre, towards solar north."),
    row!(target.epoch_utc, "UTC", Utc, sample Sample::Text("2013-09-21T18:00:00Z"),
        "When the target was at x and y; it rotates with the Sun (differential rotation, Howard et al. 1990). Unset, the target keeps its place on the disc, as one set by command does."),

    // The cameras are inserted here: see `parameters`.
];

#[rustfmt::skip]
static TABLE: &[Parameter] = &[
    row!(roll.max_age_s, "s", Number(0.01, 3600.0),
        "Largest age of the roll by the roll camera's horizon. A younger one is sent with solutions and used in their offsets; otherwise the packet has 0, and the instrument's roll is used."),
    row!(roll.height_m, "m", Number(0.0, 2e6), sample Sample::Number(38_000.0),
        "The height at which the roll camera flies; unset, that of the frame's place or of the site, which GPS and commands do not set. An error tilts the cone of the horizon: roll is nearly unaffected if the camera points forward, and changes by 0.12 deg per km if it points sideways."),
    row!(roll.height_sigma_m, "m", Number(0.0, 100_000.0),
        "Its 1 sigma."),
    row!(roll.atmosphere_m, "m", Number(0.0, 100_000.0),
        "The height at which the limb has half of its brightness above the dark sky. An error changes pitch, and roll hardly."),
    row!(roll.edge_sigma_m, "m", Number(0.0, 100_000.0),
        "Its 1 sigma."),

    row!(moon.clear_of_sun_deg, "deg", Number(0.0, 180.0),
        "By day the Moon is searched no nearer to the Sun than this; by night, with the Sun below the Earth's limb, anywhere above the limb."),
    row!(moon.answer_within_s, "s", Number(0.05, 3600.0),
        "How long a request for the Moon waits for a picture that was started after it; then the answer is \"not found\"."),

    row!(link.port, "", Text, sample Sample::Text("/dev/serial/by-id/usb-controller"),
        "Where the gondola's controller is: a serial port, best by its by-id name, or udp:HOST:PORT, or udp:HOST:PORT@LOCALPORT with an IP address as HOST (names are not resolved); unset or empty, nothing is sent. A port that is absent or lost is retried until it opens."),
    row!(link.baud, "baud", Whole(300, 4_000_000),
        "Speed of the serial port."),
    row!(link.udp_local_port, "", Whole(0, 65_535),
        "The local port for packets if link.port is UDP and states none. 0 means any free port."),
    row!(link.udp_bind, "", Text, sample Sample::Text("192.168.2.10"),
        "The address of this computer for packets if link.port is UDP; unset, all of them. It excludes commands from other networks."),
    row!(link.udp_peers, "", Text, sample Sample::Text("192.168.2.1, 192.168.2.2:2000"),
        "Senders whose commands are accepted over UDP: IP addresses (any port) or ADDRESS:PORT, separated by commas. Unset, the address of link.port, any port."),
    row!(link.key_file, "", Text, sample Sample::Text("/etc/solaspect.key"),
        "File with a secret of 16 bytes or more that ground and controller share. If set, commands over UDP must be signed with it (docs/protocol.md), as `solaspect link send --key-file` does; unset, they need not be."),
    row!(link.computer, "", Whole(1, 2),
        "Which of the aspect system's two computers this is: commands are addressed to one or both. Computer 1 sends solutions from the start, computer 2 when aspect command 0x0030 says so."),
    row!(link.sending_camera, "", Whole(1, 5), command 4,
        "Which of this computer's pitch-yaw cameras sends to the controller, if there are several: camera, second_camera, then further ones by name."),
    row!(link.solution_divisor, "", Whole(1, 1000), command 2,
        "One solution in this many goes to the controller: 1 sends all, 4 at 4 Hz one a second."),
    row!(link.max_solution_age_ms, "ms", Whole(1, 60_000), command 3,
        "A solution older than this, counted from mid-exposure, is not sent. A higher value lets a slow machine send older solutions."),
    row!(link.saved_values, "", Text, sample Sample::Text("/data/aspect/values.toml"),
        "File that keeps values set by command over a restart; unset or empty, values.toml in archive.directory. Delete it to return to the values of this configuration."),
    row!(link.restore_tracking_s, "s", Whole(0, 86_400),
        "Tracking and the last GPS fix are restored after a restart of the program if the computer was not rebooted, or if they were saved less than this ago: they are saved at each change and each minute. A higher value bridges longer power cuts; a computer that is switched on within it steers at once."),

    row!(navigation.enabled, "", Name(&["off", "on"]),
        "Whether the inertial filter runs: attitude between frames and in gaps by gyros (docs/navigation.md)."),
    row!(navigation.settings, "", Text, sample Sample::Text("/etc/solaspect/nav.toml"),
        "The file that states the errors of IMU, GPS and cameras, their axes and delays (docs/navigation.md). Its cameras have the names of the tables here: camera, second_camera, roll_camera, moon_camera, and those of further ones; cameras that it does not name are not used."),
    row!(navigation.imu_port, "", Text, sample Sample::Text("udp:192.168.2.1:3000@3000"),
        "Where the IMU's samples (telemetry packets of type 0x71, docs/protocol.md) come from; unset, over the controller's line. As link.port; over UDP with the local port that the IMU sends to."),
    row!(navigation.gps_port, "", Text, sample Sample::Text("/dev/serial/by-id/usb-gps"),
        "Port of a GPS receiver with NMEA 0183 (GGA and RMC); its fixes also set the place of frames. As link.port; unset, there is none, and the filter never starts."),
    row!(navigation.gps_baud, "baud", Whole(300, 4_000_000),
        "Speed of the receiver's serial port."),
    row!(navigation.rate_hz, "Hz", Number(0.1, 200.0), command 50,
        "Inertial offsets per second, at most the rate of the IMU."),
    row!(navigation.send, "", Name(&["off", "on"]),
        "Whether they go to the controller, as 0x1105, while solutions do. If off, they are only in log and housekeeping."),
    row!(navigation.max_sigma_arcsec, "arcsec", Number(0.25, 7000.0), command 51,
        "An inertial offset with a larger sigma than this, per axis, is not sent."),

    row!({output}.to, "", Allowed::Destination, sample Sample::Text("udp:192.168.1.30:5000"),
        "Where an output goes that other programs read (docs/outputs.md): datagrams to a peer, a serial device, or the programs that connect by TCP, at most 8; unset, there is no such output. A reader that is away or slow costs messages, which are counted, and never holds up the flight."),
    row!({output}.format, "", Name(Format::NAMES),
        "What the output says: jsonl, a JSON object on a line for each solved frame; nmea, a sentence of NMEA 0183 for each solved frame; ccsds, a CCSDS space packet for each telemetry packet of the controller's line."),
    row!({output}.baud, "baud", Whole(300, 4_000_000),
        "Speed of the output's serial device."),

    row!(host.realtime_priority, "", Whole(1, 99), sample Sample::Number(10.0),
        "Priority of the solvers' threads among the real-time threads of the computer (FIFO); those of cameras, link, filter and sensors, which take microseconds, have one more; unset, they have normal priority. Needs CAP_SYS_NICE or LimitRTPRIO of the unit; without it the flight continues with a warning."),
    row!(host.memory, "", Name(Memory::NAMES),
        "Whether the program's memory may be swapped out: locked, it never is. Needs CAP_IPC_LOCK or LimitMEMLOCK of the unit; without it the flight continues with a warning."),

    row!(archive.directory, "", Text, sample Sample::Text("/data/aspect"),
        "Folder of the archive; unset or empty, frames are not kept."),
    row!(archive.second_directory, "", Text, sample Sample::Text("/data2/aspect"),
        "Folder on another disk, for when the first fails or fills."),
    row!(archive.compression, "", Name(&Compression::NAMES),
        "How pictures are compressed, always without loss. Use none for programs that read only plain images."),
    row!(archive.threads, "", Whole(1, 64),
        "Threads that compress a picture, each some of its rows, at most the number of cores. More threads let gzip (25 to 40 ms of a core per picture) keep up with a fast camera; Rice takes 2 ms."),
    row!(archive.sharing, "", Name(Sharing::NAMES),
        "What two disks do: alternate stores each frame on one of them in turn, mirror on both. A failing disk is retried with back-off (0.25 s, then twice as long each time, at most 5 s) while the other takes all frames; a single disk, after 0.5 s at most."),
    row!(archive.queue_frames, "", Whole(1, 10_000),
        "Frames that may wait for the disk. A longer queue bridges longer pauses of the disk, at 1.3 to 2.5 MB of memory per frame."),
    row!(archive.overflow, "", Name(Overflow::NAMES),
        "What is dropped when the queue is full: drop_oldest, the one that has waited longest; every_nth, all but one in store_every until none waits any more; solutions_only, all pictures until none waits any more. The solution log keeps every frame's row."),
    row!(archive.store_every, "", Whole(1, 10_000), command 40,
        "One frame in this many is stored while frames are thinned, for lack of speed or of space."),
    row!(archive.warn_free_percent, "percent", Number(0.0, 100.0), command 41,
        "Below this free space there is a warning."),
    row!(archive.thin_free_percent, "percent", Number(0.0, 100.0), command 42,
        "If every disk has less free space, one frame in store_every is stored; of two disks, first the emptier one takes all."),
    row!(archive.stop_free_percent, "percent", Number(0.0, 100.0), command 43,
        "If every disk has less free space, no frames are stored; the log continues."),

    row!(preflight.max_clock_error_ms, "ms", Number(0.001, 1e6),
        "`solaspect preflight` fails or warns if the clock may be off by more. A second moves the Sun by 15 arcsec."),
    row!(preflight.max_calibration_age_days, "days", Number(1.0, 36_500.0),
        "`solaspect preflight` warns of an instrument whose boresight, clocking or scale was measured longer ago."),
    row!(preflight.min_archive_hours, "hours", Number(0.0, 10_000.0),
        "`solaspect preflight` warns of a disk with space for less than this, counted in uncompressed frames. Less than a minute always fails."),

    row!(simulation.seed, "", Whole(0, i64::MAX),
        "Seed of the simulator: the same seed gives the same frames, bit for bit."),
    row!(simulation.start_utc, "UTC", Utc, sample Sample::Text("2013-09-21T18:00:00Z"),
        "When the simulated flight begins: its frames carry this time and those after it; unset, they carry the computer's, and the flight begins when its camera is opened. Where it is set, `gondola --config` simulates the IMU and the GPS receiver of the same flight."),

    row!(limb.level_fraction, "", Number(0.05, 0.6), command 10,
        "Level of the limb's threshold between background and disc. Lower values are less affected by marks, higher ones by noise. With a limb darkening of 0.56 and a blur of 0.95 px the disc's true edge is at 0.26."),
    row!(limb.limb_points, "", Whole(16, 720), command 11,
        "Points around the limb at which the edge is fitted. All pixels of the limb are used for any number; more points are each less certain."),
    row!(limb.search_spacing_px, "px", Whole(1, 64), command 12,
        "Distance between the rows searched for the disc over the whole frame."),
    row!(limb.min_run_px, "px", Whole(1, 32), command 13,
        "Bright runs shorter than this count as hot pixels and noise."),
    row!(limb.min_contrast_sigma, "", Number(2.0, 100.0), command 14,
        "The disc must exceed the background by this many sigma of the noise."),
    row!(limb.min_crossings, "", Whole(4, 1000), command 15,
        "Fewest crossings that make a disc."),
    row!(limb.min_limb_points, "", Whole(6, 720), command 17,
        "Fewest points that make a limb."),
    row!(limb.max_radius_deviation, "", Number(0.01, 0.5), command 16,
        "Largest relative deviation of the disc's radius from the expected one."),

    row!(fiducial.detection_sigma, "", Number(2.0, 100.0), command 20,
        "A mark's response must exceed this many sigma of the noise."),
    row!(fiducial.min_contrast, "", Number(0.01, 1.0), command 21,
        "A mark's least contrast, as a fraction of the light around it."),
    row!(fiducial.min_likeness, "", Number(0.0, 1.0), command 22,
        "Least fraction of the structure around a detection that the mark must explain."),
    row!(fiducial.max_detections, "", Whole(3, 256), command 23,
        "Largest number of detections that are identified."),
    row!(fiducial.min_marks, "", Whole(3, 2000), command 24,
        "Smallest number of marks for an identification."),
    row!(fiducial.max_centre_shift_px, "px", Number(1.0, 1000.0), command 25,
        "Largest distance of the plate's centre on the sensor, by an identification, from the instrument's value."),

    row!(registration.min_gain, "", Number(0.0, 1000.0), command 30,
        "Least gain in chi^2, per added parameter, for a richer kind of mapping."),
    row!(registration.prior_freedom, "", Number(0.0, 1000.0), command 31,
        "Weight of the marks' stated sigmas against their residuals, in degrees of freedom."),
];

/// Every parameter, in the order of the example.
pub fn parameters() -> &'static [Parameter] {
    static ALL: LazyLock<Vec<Parameter>> = LazyLock::new(|| {
        let before = BEFORE_CAMERAS.iter().cloned();
        let after = TABLE.iter().cloned();
        before.chain(cameras()).chain(after).collect()
    });
    &ALL
}

/// The parameter of a dotted key.
pub fn by_key(key: &str) -> Option<&'static Parameter> {
    parameters().iter().find(|parameter| parameter.key == key)
}

/// The parameter with this number in commands of the ground.
pub fn by_command(number: u16) -> Option<&'static Parameter> {
    parameters()
        .iter()
        .find(|parameter| parameter.command == Some(number))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Config, Value};
    use std::collections::HashSet;

    /// Values at the limits of the allowed range, and one between.
    fn probes(parameter: &Parameter) -> Vec<Value> {
        match parameter.allowed {
            Number(low, high) => [low, 0.3 * low + 0.7 * high, high]
                .map(Value::Number)
                .into(),
            Whole(low, high) => [low, low + (high - low) / 3, high].map(Value::Whole).into(),
            Name(names) => names
                .iter()
                .map(|name| Value::Text((*name).into()))
                .collect(),
            Text => vec![Value::Text("somewhere/else".into())],
            Allowed::Source => vec![Value::Text("gige:BOBCAT7".into())],
            Allowed::Region => vec![Value::Text("0,10,640,480".into())],
            Allowed::Destination => vec![Value::Text("tcp-listen:0.0.0.0:5000".into())],
            Utc => vec![Value::Text("2016-01-19T02:00:00.5Z".into())],
        }
    }

    /// Values just outside the allowed range, and of other types.
    fn outside(parameter: &Parameter) -> Vec<Value> {
        let mut values = match parameter.allowed {
            Number(low, high) => [low - 1e-3, high * 1.001 + 1e-3, f64::NAN, f64::INFINITY]
                .map(Value::Number)
                .into(),
            Whole(low, _) => vec![Value::Whole(low - 1), Value::Number(low as f64 + 0.5)],
            Name(_) => vec![Value::Text("no such name".into()), Value::Whole(0)],
            Text => vec![Value::Whole(0), Value::Number(0.5)],
            Allowed::Source => vec![Value::Text("gige:".into()), Value::Whole(7)],
            Allowed::Region => vec![Value::Text("0,10,0,480".into()), Value::Whole(7)],
            Allowed::Destination => vec![Value::Text("/dev/ttyS0".into()), Value::Whole(7)],
            Utc => vec![Value::Text("yesterday".into()), Value::Whole(2013)],
        };
        if let Whole(_, high) = parameter.allowed {
            values.extend(high.checked_add(1).map(Value::Whole));
        }
        values
    }

    #[test]
    fn what_is_set_is_what_is_got_and_nothing_else_changes() {
        for parameter in parameters() {
            for value in probes(parameter) {
                let mut config = Config::default();
                parameter.set(&mut config, Some(value.clone())).unwrap();
                assert_eq!(parameter.get(&config), Some(value), "{}", parameter.key);
                for other in parameters().iter().filter(|p| p.key != parameter.key) {
                    assert_eq!(other.get(&config), other.default(), "{}", other.key);
                }
            }
        }
    }

    #[test]
    fn a_value_outside_its_range_is_refused_and_changes_nothing() {
        for parameter in parameters() {
            for value in outside(parameter) {
                let mut config = Config::default();
                let refused = parameter.set(&mut config, Some(value.clone()));
                assert!(refused.is_err(), "{} took {value}", parameter.key);
                assert_eq!(config, Config::default());
            }
        }
    }

    #[test]
    fn nothing_unsets_what_is_unset_by_default_and_only_that() {
        for parameter in parameters() {
            let mut config = Config::default();
            let optional = parameter.default().is_none();
            assert_eq!(
                parameter.set(&mut config, None).is_ok(),
                optional,
                "{}",
                parameter.key
            );
            assert_eq!(parameter.sample.is_some(), optional, "{}", parameter.key);
        }
    }

    #[test]
    fn every_default_is_allowed() {
        for parameter in parameters() {
            if let Some(value) = parameter.default() {
                parameter.set(&mut Config::default(), Some(value)).unwrap();
            }
        }
    }

    #[test]
    fn no_key_and_no_command_number_occurs_twice() {
        let keys: HashSet<_> = parameters().iter().map(|p| p.key).collect();
        assert_eq!(keys.len(), parameters().len());
        let numbers: Vec<_> = parameters().iter().filter_map(|p| p.command).collect();
        let different: HashSet<_> = numbers.iter().collect();
        assert_eq!(different.len(), numbers.len());
    }

    #[test]
    fn a_command_carries_every_value_it_may_set() {
        for parameter in parameters().iter().filter(|p| p.command.is_some()) {
            let fits = match parameter.allowed {
                Whole(low, high) => low >= 0 && high <= i64::from(u16::MAX),
                Number(low, high) => low >= -1024.0 && high <= f64::from(u16::MAX) / 8.0 - 1024.0,
                _ => false,
            };
            assert!(fits, "{}", parameter.key);
            let number = parameter.command.unwrap();
            assert_eq!(by_command(number).unwrap().key, parameter.key);
        }
    }

    #[test]
    fn the_unit_is_in_the_keys_name() {
        for parameter in parameters().iter().filter(|p| !p.unit.is_empty()) {
            let named = parameter.name() == parameter.unit
                || parameter
                    .name()
                    .ends_with(&format!("_{}", parameter.unit.to_lowercase()));
            assert!(named, "{} is in {}", parameter.key, parameter.unit);
        }
    }
}
