//! Reads the configuration from its TOML file and reports all of its errors, each with the file, the key and the expected value.

use super::value::{self, Field, Value};
use super::{Config, ConfiguredCamera, Outputs, Parameter, by_key, parameters};
use crate::instrument::toml_file::{parse_loosely, read_text, unknown_key};
use crate::instrument::{Role, TomlError};
use std::path::Path;

impl Config {
    /// Reads a configuration; parameters that the file omits keep their defaults.
    ///
    /// # Errors
    /// If the file cannot be read, a key is unknown (the nearest known one is named), a value has the wrong type
    /// or is out of range, or the site is incomplete.
    pub fn read(path: &Path) -> Result<Self, TomlError> {
        Self::parse(path, &read_text(path)?)
    }

    /// As [`read`](Self::read), from a text; `path` is for the errors.
    pub fn parse(path: &Path, text: &str) -> Result<Self, TomlError> {
        let (config, errors) = Self::parse_all(path, text);
        errors.into_iter().next().map_or(Ok(config), Err)
    }

    /// As [`parse`](Self::parse), but with every error of the text, and with the values that are valid.
    pub fn parse_all(path: &Path, text: &str) -> (Self, Vec<TomlError>) {
        let mut config = Self::default();
        let mut errors = Vec::new();
        let document = parse_loosely(path, text, &[]).unwrap_or_else(|error| {
            errors.push(error);
            toml::Table::new()
        });
        for (table, content) in document {
            match &*table {
                Outputs::TABLE => config.read_outputs(path, &content, &mut errors),
                table => config.read_table(path, table, content, &mut errors),
            }
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
            toml::Value::Table(mut values) if is_known || !values.is_empty() => {
                let role = self.read_role(path, table, values.remove("role"));
                let is_camera = is_known || !is_camera_name(table);
                if let Err(wrong) = role {
                    errors.push(wrong);
                    if !is_camera {
                        // Its keys are those of a camera without a role.
                        return;
                    }
                }
                self.read_values(path, table, &values, errors);
            }
            _ if !is_known => errors.push(unknown(path, table)),
            other => {
                errors.push(TomlError::new(path, table, "a table", value::found(&other)));
            }
        }
    }

    fn read_outputs(&mut self, path: &Path, content: &toml::Value, errors: &mut Vec<TomlError>) {
        let tables = content.as_array().map(|tables| {
            let tables = tables.iter().map(toml::Value::as_table);
            tables.collect::<Option<Vec<_>>>()
        });
        let Some(Some(tables)) = tables else {
            let (expected, found) = ("tables [[output]]", value::found(content));
            errors.push(TomlError::new(path, Outputs::TABLE, expected, found));
            return;
        };
        for (n, values) in tables.into_iter().enumerate() {
            let name = self.outputs.of_table(n);
            self.read_values(path, &name, values, errors);
        }
    }

    fn read_values(
        &mut self,
        path: &Path,
        table: &str,
        values: &toml::Table,
        errors: &mut Vec<TomlError>,
    ) {
        let mut keyed =
            |(name, value): (&String, &toml::Value)| self.read_value(path, table, name, value);
        errors.extend(values.iter().filter_map(|pair| keyed(pair).err()));
    }

    /// Reads the role of a camera's table: a table whose name implies no role, ending in `_camera`, adds a camera.
    fn read_role(
        &mut self,
        path: &Path,
        table: &str,
        role: Option<toml::Value>,
    ) -> Result<(), TomlError> {
        let key = format!("{table}.role");
        let is_known = self.cameras.named(table).is_some();
        let is_camera =
            is_known || (is_camera_name(table) && (role.is_some() || !is_misspelled(table)));
        let stated = match (&role, is_camera) {
            (Some(_), false) => return Err(unknown(path, &key)),
            (None, false) => return Ok(()),
            (None, true) if is_known => return Ok(()),
            (stated, true) => stated.as_ref().and_then(Value::from_toml),
        };
        let role = Role::from_value(stated).ok_or_else(|| {
            let expected = format!("the camera's purpose, one of {}", Role::NAMES.join(", "));
            let found = role.as_ref().map_or("none".into(), value::found);
            TomlError::new(path, &key, expected, found)
        })?;
        match self.cameras.named_mut(table) {
            Some(camera) => camera.role = role,
            None => self.cameras.push(ConfiguredCamera::new(table, role)),
        }
        Ok(())
    }

    fn read_value(
        &mut self,
        path: &Path,
        table: &str,
        name: &str,
        value: &toml::Value,
    ) -> Result<(), TomlError> {
        let key = format!("{table}.{name}");
        // All cameras have the same parameters, and so do all outputs.
        let parameter = match self.cameras.named(table) {
            Some(_) => by_key(&format!("{}.{name}", self.cameras.first().name)),
            None if self.outputs.named(table).is_some() => {
                by_key(&format!("{}.{name}", Outputs::TABLE))
            }
            None => by_key(&key),
        };
        parameter
            .ok_or_else(|| unknown(path, &key))?
            .set_from_toml(self, table, value)
            .map_err(|refused| TomlError::new(path, &key, refused.expected, refused.found))
    }
}

/// Whether a table's name may be that of a camera; such names need no quotes in a file.
fn is_camera_name(table: &str) -> bool {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    table.ends_with("_camera") && table.chars().all(is_plain)
}

/// Whether a table's name is close to a known one.
fn is_misspelled(table: &str) -> bool {
    Role::table_names()
        .iter()
        .any(|known| strsim::damerau_levenshtein(known, table) <= 2)
}

/// The error for an unknown key or table. A parameter of the same name in another table is suggested first, whatever
/// the edit distance.
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
    use crate::camera::PixelFormat;
    use crate::fits::Compression;
    use crate::frame::Region;
    use crate::output::Format;
    use crate::units::Place;
    use std::path::PathBuf;

    fn parse(text: &str) -> Result<Config, String> {
        Config::parse(Path::new("c.toml"), text).map_err(|error| error.to_string())
    }

    #[test]
    fn what_a_file_leaves_out_keeps_its_default() {
        assert_eq!(parse(""), Ok(Config::default()));
        let config = parse("[camera]\nrate_hz = 10\n").unwrap();
        assert_eq!(config.cameras.first().rate_hz, 10.0);
        assert_eq!(config.cameras.first().exposure_us, 15_000);
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
        assert_eq!(config.cameras.first().source, None);
        assert_eq!(config.cameras.first().settings().exposure_us, 8000);
        assert!(config.cameras.first().auto_exposure().is_some());
        let second = config.cameras.named("second_camera").unwrap();
        assert_eq!(second.source, "gige:192.168.1.21".parse().ok());
        assert_eq!(
            second.settings().region,
            Some(Region::sized(100, 50, 640, 480))
        );
        assert_eq!(second.auto_exposure(), None);
        let roll = config.cameras.named("roll_camera").unwrap().settings();
        assert_eq!(roll.pixel_format, PixelFormat::Mono12);
    }

    #[test]
    fn a_table_of_any_name_adds_a_camera_that_states_its_role() {
        let text = "[camera]\nsource = \"simulated\"\n[port_camera]\nrole = \"roll\"\nrate_hz = 2.5\n[roll_camera]\nrole = \"moon\"\n";
        let config = parse(text).unwrap();
        let role = |name| config.cameras.named(name).map(|camera| camera.role);
        assert_eq!(role("port_camera"), Some(Role::Roll));
        assert_eq!(role("roll_camera"), Some(Role::Moon));
        assert_eq!(role("second_camera"), Some(Role::PitchYaw));
        assert_eq!(config.cameras.named("port_camera").unwrap().rate_hz, 2.5);
        assert_eq!(parse(&config.to_toml()), Ok(config));
        for (text, words) in [
            (
                "[port_camera]\nrate_hz = 2\n",
                "port_camera.role: expected the camera's purpose, one of pitch_yaw, roll, moon, found none",
            ),
            (
                "[port_camera]\nrole = \"rol\"\n",
                "port_camera.role: expected the camera's purpose, one of pitch_yaw, roll, moon, found \"rol\"",
            ),
            (
                "[port_camera]\nrole = \"roll\"\nrate_hertz = 2\n",
                "port_camera.rate_hertz: expected a known key",
            ),
            (
                "[rol_camera]\nrate_hz = 2\n",
                "rol_camera.rate_hz: expected a known key",
            ),
            (
                "[link]\nrole = \"roll\"\n",
                "link.role: expected a known key",
            ),
            (
                "[\"my own_camera\"]\nrole = \"roll\"\n",
                "my own_camera.role: expected a known key",
            ),
        ] {
            let message = parse(text).unwrap_err();
            assert!(message.contains(words), "{message}");
        }
    }

    #[test]
    fn all_errors_of_a_file_are_reported_at_once_and_what_is_right_is_taken() {
        let text = "[camera]\nrate_hz = 1000\nexposre_us = 3\nexposure_us = 700\n[lnk]\n[site]\nheight_m = 3\n";
        let (config, errors) = Config::parse_all(Path::new("c.toml"), text);
        let mut keys: Vec<&str> = errors.iter().map(|error| error.field.as_str()).collect();
        keys.sort_unstable();
        assert_eq!(keys, ["camera.exposre_us", "camera.rate_hz", "lnk", "site"]);
        assert_eq!(config.cameras.first().exposure_us, 700);
    }

    #[test]
    fn times_are_read_in_quotes_and_without_them() {
        let expected = parse("[target]\nepoch_utc = \"2013-09-22T02:00:00Z\"\n").unwrap();
        for text in [
            "2013-09-22T02:00:00Z",
            "2013-09-22 02:00:00",
            "2013-09-21T20:00:00-06:00",
        ] {
            assert_eq!(
                parse(&format!("[target]\nepoch_utc = {text}\n")).unwrap(),
                expected
            );
        }
        let config = parse("[simulation]\nstart_utc = 2013-09-21\n").unwrap();
        let start = config.simulation.start_utc.unwrap();
        assert_eq!(start.to_string(), "2013-09-21T00:00:00Z");
        for (text, key) in [
            ("[target]\nepoch_utc = 18:00:00\n", "target.epoch_utc"),
            ("[link]\nport = 2013-09-21\n", "link.port"),
            ("[camera]\nrate_hz = 2013-09-21\n", "camera.rate_hz"),
        ] {
            let message = parse(text).unwrap_err();
            assert!(message.contains(&format!("{key}: expected a")), "{message}");
        }
    }

    #[test]
    fn there_may_be_any_number_of_outputs() {
        let text = "[[output]]\nto = \"udp:10.0.0.1:5000\"\n[[output]]\nto = \"serial:/dev/ttyS1\"\nformat = \"nmea\"\nbaud = 4800\n";
        let config = parse(text).unwrap();
        let outputs: Vec<_> = config.outputs.flying().collect();
        let [(first, udp), (second, serial)] = &outputs[..] else {
            panic!("{outputs:?}");
        };
        assert_eq!((&**first, &**second), ("output", "output-2"));
        assert_eq!((udp.format, udp.baud), (Format::Jsonl, 115_200));
        assert_eq!((serial.format, serial.baud), (Format::Nmea, 4800));
        assert_eq!(parse("").unwrap().outputs.flying().count(), 0);
    }

    #[test]
    fn an_empty_port_is_none() {
        assert_eq!(parse("[link]\nport = \"\"\n").unwrap().link.port, None);
    }

    /// Invalid files, with their error messages.
    const BAD: &[(&str, &[&str])] = &[
        (
            "[camera]\nrate_hertz = 4\n",
            &["camera.rate_hertz", "\"camera.rate_hz\""],
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
        (
            "[output]\nformat = \"nmea\"\n",
            &["output: expected tables [[output]]", "type table"],
        ),
        ("output = [3]\n", &["output: expected tables [[output]]"]),
        (
            "[[output]]\nto = \"tcp:10.0.0.1:5000\"\n",
            &[
                "output.to: expected udp:HOST:PORT",
                "found \"tcp:10.0.0.1:5000\"",
            ],
        ),
        (
            "[[output]]\n[[output]]\nformat = \"csv\"\n",
            &[
                "output-2.format: expected \"jsonl\", \"nmea\" or \"ccsds\"",
                "found \"csv\"",
            ],
        ),
        (
            "[[output]]\n[[output]]\nfromat = \"nmea\"\n",
            &["output-2.fromat", "\"output.format\""],
        ),
        ("[site]\nlatitude_deg = 3\n", &["site", "height_m"]),
        ("[camera\n", &["valid TOML", "line 1"]),
    ];

    #[test]
    fn a_bad_file_is_refused_on_one_line_that_names_file_field_and_expectation() {
        for (text, words) in BAD {
            let message = parse(text).unwrap_err();
            assert!(message.starts_with("c.toml: "), "{message}");
            assert!(!message.contains('\n'), "{message}");
            for word in *words {
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
