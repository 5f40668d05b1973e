//! Documents made from the parameter table: the shipped example and the page of parameters.

use super::parameter::Parameter;
use super::table::parameters;
use super::{Config, Outputs, Value};
use crate::instrument::Role;
use std::fmt::Write;

const WIDTH: usize = 100;

/// A commented configuration file that sets every parameter to its default.
pub fn example() -> String {
    let mut text = String::from(
        "# The configuration of solaspect: every parameter with its default. A file may leave out any of them;\n\
         # those that are commented out here are unset by default.\n\
         # Further cameras have tables of their own, [NAME_camera], whose role is \"pitch_yaw\", \"roll\" or \"moon\". There may be any number\n\
         # of tables [[output]].\n",
    );
    for (table, rows) in tables() {
        text += &head(table);
        for row in rows {
            text += &entry(row);
        }
    }
    text
}

impl Config {
    /// The configuration as a file that reproduces it: every parameter that is set.
    pub fn to_toml(&self) -> String {
        let mut text = String::new();
        for (table, rows) in tables() {
            if table == Outputs::TABLE {
                for (name, _) in self.outputs.iter() {
                    text += &self.table_toml(&head(table), &name, None, rows);
                }
                continue;
            }
            let standard = Role::tables().find(|(name, _)| *name == table);
            let camera = self.cameras.named(table).map(|camera| camera.role);
            let role = camera.filter(|role| standard.is_some_and(|(_, its)| its != *role));
            text += &self.table_toml(&head(table), table, role, rows);
        }
        let (first, names) = (self.cameras.first(), Role::table_names());
        for camera in self.cameras.iter() {
            if !names.contains(&&*camera.name) {
                let rows = tables().find(|(table, _)| *table == first.name);
                let rows = rows.map_or(&[][..], |(_, rows)| rows);
                text +=
                    &self.table_toml(&head(&camera.name), &camera.name, Some(camera.role), rows);
            }
        }
        text
    }

    /// A table with the values set in it, and the role of a camera whose name does not imply it.
    fn table_toml(
        &self,
        head: &str,
        table: &str,
        role: Option<Role>,
        rows: &[Parameter],
    ) -> String {
        let role = role.map(|role| format!("role = \"{}\"\n", role.name()));
        let set = |row: &Parameter| {
            let value = match row.get_of(self, table)? {
                // Rust escapes some characters in a form that TOML does not read.
                Value::Text(text) => toml::Value::from(text).to_string(),
                number => number.to_string(),
            };
            Some(format!("{} = {value}\n", row.name()))
        };
        let lines = rows.iter().filter_map(set);
        let head = std::iter::once(head.to_owned());
        head.chain(role).chain(lines).collect()
    }
}

/// The line at which a table begins.
fn head(table: &str) -> String {
    match table {
        Outputs::TABLE => format!("\n[[{table}]]\n"),
        table => format!("\n[{table}]\n"),
    }
}

/// The page of parameters, in Markdown.
pub fn parameters_page() -> String {
    let mut text = String::from(
        "# Parameters\n\n\
         Every key of the configuration file. The number is the one by which aspect commands 0x0712 (whole\n\
         numbers) and 0x0722 (others) set a parameter in flight. This page is made from the program's own table.\n\n\
         Further cameras have tables of their own, `[NAME_camera]`, with the keys of `[camera]` and with `role`, which is `\"pitch_yaw\"`,\n\
         `\"roll\"` or `\"moon\"`. Their frames have folders of their own, and they are reported to the ground by telemetry of type 0x72.\n\n\
         There may be any number of tables `[[output]]`; errors call them `output`, `output-2` and so on.\n",
    );
    for (table, rows) in tables() {
        text += &format!(
            "\n## {table}\n\n| key | unit | range | default | number | meaning |\n|---|---|---|---|---|---|\n"
        );
        for row in rows {
            text += &line(row);
        }
    }
    text
}

/// The parameters by table, in their order.
fn tables() -> impl Iterator<Item = (&'static str, &'static [Parameter])> {
    parameters()
        .chunk_by(|a, b| a.table() == b.table())
        .map(|rows| (rows[0].table(), rows))
}

fn entry(row: &Parameter) -> String {
    let mut text = String::new();
    for line in wrapped(row.documentation, WIDTH - 2) {
        text += &format!("# {line}\n");
    }
    let allowed = format!("{} {}", row.range(), row.unit);
    text += &format!("# Allowed: {}.\n", allowed.trim_end());
    match (row.default(), row.sample) {
        (Some(value), _) => text += &format!("{} = {value}\n", row.name()),
        (None, Some(sample)) => text += &format!("# {} = {sample}\n", row.name()),
        (None, None) => {}
    }
    text
}

fn line(row: &Parameter) -> String {
    let default = row.default().map_or("unset".into(), |v| format!("`{v}`"));
    let command = row
        .command
        .map_or(String::new(), |number| number.to_string());
    let mut text = String::new();
    let _ = writeln!(
        text,
        "| `{}` | {} | {} | {default} | {command} | {} |",
        row.key,
        row.unit,
        row.range(),
        row.documentation
    );
    text
}

/// A text in lines of at most `width` characters, broken between words.
fn wrapped(text: &str, width: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if line.len() + 1 + word.len() <= width => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.into()),
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Output;
    use crate::output::Format;
    use std::path::Path;

    const EXAMPLE: &str = include_str!("../../docs/solaspect.example.toml");
    const PAGE: &str = include_str!("../../docs/parameters.md");

    #[test]
    fn the_shipped_example_is_up_to_date() {
        let remedy = "run `solaspect config example > docs/solaspect.example.toml`";
        assert!(EXAMPLE == example(), "{remedy}");
    }

    #[test]
    fn the_page_of_parameters_is_up_to_date() {
        let remedy = "run `solaspect config parameters > docs/parameters.md`";
        assert!(PAGE == parameters_page(), "{remedy}");
    }

    #[test]
    fn a_configuration_as_a_file_gives_the_same_configuration_again() {
        let mut config = Config::default();
        config.site.latitude_deg = Some(-77.85);
        config.site.longitude_deg = Some(1e-7);
        config.site.height_m = Some(38_405.0);
        config.cameras.first_mut().source = "gige:192.168.1.20".parse().ok();
        config.cameras.first_mut().region_px = "100,50,640,480".parse().ok();
        config.target.epoch_utc = "2013-09-21T18:00:00.25Z".parse().ok();
        config.link.port = Some("/dev/serial/a \"quoted\" name\\ \u{7f}".into());
        let to = |to: &str, format| Output {
            to: to.parse().ok(),
            format,
            baud: 9600,
        };
        config.outputs = Outputs::from_iter([
            to("udp:10.0.0.1:5000", Format::Jsonl),
            to("serial:/dev/ttyS1", Format::Nmea),
            Output::default(),
            to("tcp-listen:[::]:5001", Format::Ccsds),
        ]);
        for config in [Config::default(), config] {
            let text = config.to_toml();
            assert_eq!(
                Config::parse(Path::new("again"), &text),
                Ok(config),
                "{text}"
            );
        }
    }

    #[test]
    fn the_shipped_example_gives_exactly_the_defaults() {
        let read = Config::parse(Path::new("example"), EXAMPLE).unwrap();
        assert_eq!(read, Config::default());
    }

    #[test]
    fn the_example_shows_values_that_may_be_set() {
        let is_setting = |line: &&str| line.starts_with('[') || line.contains(" = ");
        let shown: Vec<&str> = EXAMPLE
            .lines()
            .map(|line| line.trim_start_matches("# "))
            .filter(is_setting)
            .collect();
        let shown = shown.join("\n");
        let config = Config::parse(Path::new("example"), &shown).unwrap();
        for row in parameters() {
            assert!(row.get(&config).is_some(), "{} is not shown", row.key);
        }
    }
}
