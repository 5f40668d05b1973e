//! The configuration: plain structs for the program, one table of parameters for everyone else.
//!
//! The table in `table` declares each parameter once: key, unit, allowed values, command number and
//! documentation. Reading TOML, the shipped example, the page of parameters and the commands that set
//! parameters in flight all come from it. Defaults live in the structs' `Default`, where rooms that are used
//! without a configuration find them too.
//!
//! To add a parameter: a field in a struct that [`Config`] holds, its default, and one row in the table.

mod documents;
mod host;
mod parameter;
mod table;
mod value;

pub use documents::{example, parameters_page};
pub use host::{Host, Memory};
pub use parameter::{Allowed, Parameter, Refused};
pub use table::{by_command, by_key, parameters};
pub use value::Value;

use crate::archive::{Overflow, Sharing, SpaceLimits};
use crate::camera::{self, AutoExposureSettings, PixelFormat, Source};
use crate::fits::Compression;
use crate::frame::Region;
use crate::instrument::TomlError;
use crate::instrument::toml_file::{parse_strict, read_text, unknown_key};
use crate::units::Place;
use crate::{aspect, fiducial, limb, registration};
use jiff::Timestamp;
use std::path::{Path, PathBuf};

/// Everything that a flight may set. `Config::default()` is a valid configuration.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Config {
    pub site: Site,
    pub sky: Sky,
    pub target: Target,
    pub camera: Camera,
    pub second_camera: Camera,
    pub roll_camera: Camera,
    pub link: Link,
    pub archive: Archive,
    pub host: Host,
    pub preflight: Preflight,
    pub simulation: Simulation,
    pub limb: limb::Settings,
    pub fiducial: fiducial::Settings,
    pub registration: registration::Settings,
}

/// Where the observer is, unless a frame says so itself: all three or none.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Site {
    pub latitude_deg: Option<f64>,
    pub longitude_deg: Option<f64>,
    pub height_m: Option<f64>,
}

impl Site {
    /// The place, where all of it is known.
    pub fn place(&self) -> Option<Place> {
        Place::new(self.latitude_deg?, self.longitude_deg?, self.height_m?).ok()
    }

    fn is_complete_or_empty(&self) -> bool {
        let known = [self.latitude_deg, self.longitude_deg, self.height_m];
        known.iter().all(Option::is_some) || known.iter().all(Option::is_none)
    }
}

/// What the positions of Sun and Moon rest on.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Sky {
    pub earth_orientation: Option<PathBuf>,
}

/// Where the telescope should point, helioprojective; with an epoch, what stood there then.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Target {
    pub x_arcsec: f64,
    pub y_arcsec: f64,
    pub epoch_utc: Option<Timestamp>,
}

/// Which camera plays a role, and how it is run.
#[derive(Debug, Clone, PartialEq)]
pub struct Camera {
    /// `None` where nobody plays the role.
    pub source: Option<Source>,
    /// The instrument's file, for a camera that sees the plate.
    pub instrument: Option<PathBuf>,
    pub rate_hz: f64,
    pub exposure_us: u32,
    pub analogue_gain: Option<f64>,
    pub preamp_gain: Option<f64>,
    pub region_px: Option<Region>,
    pub pixel_format: PixelFormat,
    pub auto_exposure: Switch,
    pub auto_exposure_target: f64,
    pub auto_exposure_band: f64,
    pub auto_exposure_max_factor: f64,
    pub auto_exposure_hold_frames: u32,
    pub auto_exposure_min_us: u32,
    pub auto_exposure_max_us: u32,
}

/// Whether something is done.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Switch {
    Off,
    On,
}

impl Switch {
    pub const KINDS: [Self; 2] = [Self::Off, Self::On];

    /// As the configuration gives it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Off => "off",
            Self::On => "on",
        }
    }
}

impl Camera {
    /// What the camera is told.
    pub fn settings(&self) -> camera::Settings {
        camera::Settings {
            rate_hz: self.rate_hz,
            exposure_us: self.exposure_us,
            analogue_gain: self.analogue_gain,
            preamp_gain: self.preamp_gain,
            region: self.region_px,
            pixel_format: self.pixel_format,
        }
    }

    /// How the exposure is held; `None` where it is not.
    pub fn auto_exposure(&self) -> Option<AutoExposureSettings> {
        (self.auto_exposure == Switch::On).then_some(AutoExposureSettings {
            target: self.auto_exposure_target,
            band: self.auto_exposure_band,
            max_factor: self.auto_exposure_max_factor,
            hold_frames: self.auto_exposure_hold_frames,
            min_us: self.auto_exposure_min_us,
            max_us: self.auto_exposure_max_us,
        })
    }
}

impl Default for Camera {
    fn default() -> Self {
        let settings = camera::Settings::default();
        let auto = AutoExposureSettings::default();
        Self {
            source: None,
            instrument: None,
            rate_hz: settings.rate_hz,
            exposure_us: settings.exposure_us,
            analogue_gain: settings.analogue_gain,
            preamp_gain: settings.preamp_gain,
            region_px: settings.region,
            pixel_format: settings.pixel_format,
            auto_exposure: Switch::Off,
            auto_exposure_target: auto.target,
            auto_exposure_band: auto.band,
            auto_exposure_max_factor: auto.max_factor,
            auto_exposure_hold_frames: auto.hold_frames,
            auto_exposure_min_us: auto.min_us,
            auto_exposure_max_us: auto.max_us,
        }
    }
}

/// How the controller is spoken to.
#[derive(Debug, Clone, PartialEq)]
pub struct Link {
    pub port: Option<String>,
    pub baud: u32,
    pub udp_local_port: u32,
    pub computer: u32,
    pub sending_camera: u32,
    pub solution_divisor: u32,
    pub max_solution_age_ms: u32,
    pub saved_values: Option<PathBuf>,
}

impl Default for Link {
    fn default() -> Self {
        Self {
            port: None,
            baud: 115_200,
            udp_local_port: 2000,
            computer: 1,
            sending_camera: 1,
            solution_divisor: 1,
            max_solution_age_ms: 500,
            saved_values: None,
        }
    }
}

/// Where and how frames are kept.
#[derive(Debug, Clone, PartialEq)]
pub struct Archive {
    pub directory: Option<PathBuf>,
    pub second_directory: Option<PathBuf>,
    pub compression: Compression,
    pub sharing: Sharing,
    pub queue_frames: usize,
    pub overflow: Overflow,
    pub store_every: u64,
    pub warn_free_percent: f64,
    pub thin_free_percent: f64,
    pub stop_free_percent: f64,
}

impl Default for Archive {
    fn default() -> Self {
        Self {
            directory: None,
            second_directory: None,
            compression: Compression::Rice,
            sharing: Sharing::Alternate,
            queue_frames: 64,
            overflow: Overflow::DropOldest,
            store_every: 4,
            warn_free_percent: 10.0,
            thin_free_percent: 3.0,
            stop_free_percent: 1.0,
        }
    }
}

impl Archive {
    /// How much free space calls for what.
    pub fn space_limits(&self) -> SpaceLimits {
        SpaceLimits {
            warn_percent: self.warn_free_percent,
            thin_percent: self.thin_free_percent,
            stop_percent: self.stop_free_percent,
        }
    }
}

/// What is demanded before the flight.
#[derive(Debug, Clone, PartialEq)]
pub struct Preflight {
    pub max_clock_error_ms: f64,
    pub max_calibration_age_days: f64,
}

impl Default for Preflight {
    fn default() -> Self {
        Self {
            max_clock_error_ms: 100.0,
            max_calibration_age_days: 365.0,
        }
    }
}

/// How scenes are simulated.
#[derive(Debug, Clone, PartialEq)]
pub struct Simulation {
    pub seed: u64,
}

impl Default for Simulation {
    fn default() -> Self {
        Self { seed: 1 }
    }
}

impl Config {
    /// The tunable parts of the solver.
    pub fn solver(&self) -> aspect::Settings {
        aspect::Settings {
            limb: self.limb,
            fiducial: self.fiducial,
            registration: self.registration,
        }
    }

    /// Reads a configuration; what the file leaves out keeps its default.
    ///
    /// # Errors
    /// A file that cannot be read, an unknown key (named with the nearest known one), a value of the wrong type
    /// or out of range, an incomplete site.
    pub fn read(path: &Path) -> Result<Self, TomlError> {
        Self::parse(path, &read_text(path)?)
    }

    /// As [`read`](Self::read), from a text; `path` is for the errors.
    pub fn parse(path: &Path, text: &str) -> Result<Self, TomlError> {
        let (config, errors) = Self::parse_all(path, text);
        errors.into_iter().next().map_or(Ok(config), Err)
    }

    /// As [`parse`](Self::parse), but with every error that the text has, and with what was right beside them.
    pub fn parse_all(path: &Path, text: &str) -> (Self, Vec<TomlError>) {
        let mut config = Self::default();
        let mut errors = Vec::new();
        let document = parse_strict(path, text, &[]).unwrap_or_else(|error| {
            errors.push(error);
            toml::Table::new()
        });
        for (table, content) in document {
            config.read_table(path, &table, content, &mut errors);
        }
        if !config.site.is_complete_or_empty() {
            let expected = "latitude_deg, longitude_deg and height_m together or none of them";
            errors.push(TomlError::new(path, "site", expected, "only some"));
        }
        (config, errors)
    }

    fn read_table(
        &mut self,
        path: &Path,
        table: &str,
        content: toml::Value,
        errors: &mut Vec<TomlError>,
    ) {
        let is_known = parameters().iter().any(|p| p.table() == table);
        match content {
            toml::Value::Table(values) if is_known || !values.is_empty() => {
                let mut keyed = |(name, value): (&String, &toml::Value)| {
                    self.read_value(path, &format!("{table}.{name}"), value)
                };
                errors.extend(values.iter().filter_map(|pair| keyed(pair).err()));
            }
            _ if !is_known => errors.push(unknown(path, table)),
            other => {
                errors.push(TomlError::new(path, table, "a table", value::found(&other)));
            }
        }
    }

    fn read_value(&mut self, path: &Path, key: &str, value: &toml::Value) -> Result<(), TomlError> {
        let parameter = by_key(key).ok_or_else(|| unknown(path, key))?;
        parameter
            .set_from_toml(self, value)
            .map_err(|refused| TomlError::new(path, key, refused.expected, refused.found))
    }
}

/// The error for an unknown key or table. A parameter of the same name in another table is nearest, whatever
/// the letters say.
fn unknown(path: &Path, key: &str) -> TomlError {
    let name = key.rsplit('.').next();
    let namesake = |p: &&Parameter| Some(p.name()) == name;
    let near: Vec<String> = match parameters().iter().find(namesake) {
        Some(parameter) => vec![parameter.key.into()],
        None => parameters()
            .iter()
            .flat_map(|p| [p.table(), p.key])
            .map(str::to_owned)
            .collect(),
    };
    unknown_key(path, key, &near)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Config, String> {
        Config::parse(Path::new("c.toml"), text).map_err(|error| error.to_string())
    }

    #[test]
    fn what_a_file_leaves_out_keeps_its_default() {
        assert_eq!(parse(""), Ok(Config::default()));
        let config = parse("[camera]\nrate_hz = 10\n").unwrap();
        assert_eq!(config.camera.rate_hz, 10.0);
        assert_eq!(config.camera.exposure_us, 15_000);
    }

    #[test]
    fn a_file_reaches_every_kind_of_value() {
        let config = parse(
            "[site]\nlatitude_deg = 34.49\nlongitude_deg = -104.2218\nheight_m = 38405\n\
             [target]\nx_arcsec = -300\n[link]\nport = \"/dev/ttyS0\"\n\
             [archive]\ndirectory = \"/data\"\ncompression = \"gzip\"\n[simulation]\nseed = 7\n",
        )
        .unwrap();
        assert_eq!(
            config.site.place(),
            Place::new(34.49, -104.2218, 38405.0).ok()
        );
        assert_eq!(config.target.x_arcsec, -300.0);
        assert_eq!(config.link.port.as_deref(), Some("/dev/ttyS0"));
        assert_eq!(config.archive.directory, Some(PathBuf::from("/data")));
        assert_eq!(config.archive.compression, Compression::Gzip);
        assert_eq!(config.simulation.seed, 7);
    }

    #[test]
    fn each_role_has_its_own_camera() {
        let config = parse(
            "[camera]\nexposure_us = 8000\nauto_exposure = \"on\"\n\
             [second_camera]\nsource = \"gige:192.168.1.21\"\nregion_px = \"100,50,640,480\"\n\
             [roll_camera]\nsource = \"gige:BOBCAT7\"\npixel_format = \"mono12\"\n",
        )
        .unwrap();
        assert_eq!(config.camera.source, None);
        assert_eq!(config.camera.settings().exposure_us, 8000);
        assert!(config.camera.auto_exposure().is_some());
        let second = &config.second_camera;
        assert_eq!(second.source, Some(Source::Gige("192.168.1.21".into())));
        assert_eq!(
            second.settings().region,
            Some(Region::sized(100, 50, 640, 480))
        );
        assert_eq!(second.auto_exposure(), None);
        let roll = config.roll_camera.settings();
        assert_eq!(roll.pixel_format, PixelFormat::Mono12);
    }

    #[test]
    fn all_errors_of_a_file_are_told_at_once_and_what_is_right_is_taken() {
        let text = "[camera]\nrate_hz = 1000\nexposre_us = 3\nexposure_us = 700\n[lnk]\n[site]\nheight_m = 3\n";
        let (config, errors) = Config::parse_all(Path::new("c.toml"), text);
        let mut keys: Vec<&str> = errors.iter().map(|error| error.field.as_str()).collect();
        keys.sort_unstable();
        assert_eq!(keys, ["camera.exposre_us", "camera.rate_hz", "lnk", "site"]);
        assert_eq!(config.camera.exposure_us, 700);
    }

    #[test]
    fn an_empty_port_is_none() {
        assert_eq!(parse("[link]\nport = \"\"\n").unwrap().link.port, None);
    }

    #[test]
    fn a_bad_file_is_refused_on_one_line_that_names_file_field_and_expectation() {
        for (text, words) in [
            (
                "[camera]\nrate_hertz = 4\n",
                &["camera.rate_hertz", "\"camera.rate_hz\""][..],
            ),
            (
                "[camrea]\nrate_hz = 4\n",
                &["camrea.rate_hz", "\"camera.rate_hz\""],
            ),
            (
                "[link]\nrate_hz = 4\n",
                &["link.rate_hz", "\"camera.rate_hz\""],
            ),
            ("[cammera]\n", &["cammera", "\"camera\""]),
            (
                "rate_hz = 4\n",
                &["rate_hz", "nearest is \"camera.rate_hz\""],
            ),
            (
                "[camera]\nrate_hz = 1000\n",
                &["camera.rate_hz", "from 0.01 to 100 Hz", "1000"],
            ),
            ("[camera]\nrate_hz = nan\n", &["camera.rate_hz", "NaN"]),
            ("[camera]\nrate_hz = = 4\n", &["valid TOML", "line 2"]),
            (
                "[camera]\nrate_hz = \"\"\"fast\nest\"\"\"\n",
                &["camera.rate_hz", "a number from", "fast\\nest"],
            ),
            (
                "[camera]\nexposure_us = 1.5\n",
                &["camera.exposure_us", "a whole number from", "1.5"],
            ),
            (
                "[camera]\nexposure_us = -1\n",
                &["camera.exposure_us", "-1"],
            ),
            (
                "[archive]\ncompression = \"zip\"\n",
                &["archive.compression", "\"rice\", \"none\" or \"gzip\""],
            ),
            (
                "[roll_camera]\nsource = \"usb:1\"\n",
                &["roll_camera.source", "gige:ADDRESS", "usb:1"],
            ),
            (
                "[camera]\nregion_px = \"1,2,3\"\n",
                &["camera.region_px", "width and height", "1,2,3"],
            ),
            ("[link]\nport = 3\n", &["link.port", "a text", "3"]),
            ("[link]\nport = [1]\n", &["link.port", "a text"]),
            ("camera = 3\n", &["camera", "a table", "3"]),
            ("[site]\nlatitude_deg = 3\n", &["site", "height_m"]),
            ("[camera\n", &["valid TOML", "line 1"]),
        ] {
            let message = parse(text).unwrap_err();
            assert!(message.starts_with("c.toml: "), "{message}");
            assert!(!message.contains('\n'), "{message}");
            for word in words {
                assert!(message.contains(word), "{message} lacks {word}");
            }
        }
    }

    #[test]
    fn a_missing_file_is_an_error_that_names_it() {
        let message = Config::read(Path::new("/nowhere/at-all.toml"))
            .unwrap_err()
            .to_string();
        assert!(message.contains("/nowhere/at-all.toml"), "{message}");
    }
}
