//! What people read of the parameter table: the shipped example and the page of parameters.

use super::parameter::Parameter;
use super::table::parameters;
use std::fmt::Write;

const WIDTH: usize = 100;

/// A commented configuration file that sets every parameter to its default.
pub fn example() -> String {
    let mut text = String::from(
        "# The configuration of solaspect: every parameter with its default. A file may leave out any of them;\n\
         # those that are commented out here are unset by default.\n",
    );
    for (table, rows) in tables() {
        text += &format!("\n[{table}]\n");
        for row in rows {
            text += &entry(row);
        }
    }
    text
}

/// The page of parameters, in Markdown.
pub fn parameters_page() -> String {
    let mut text = String::from(
        "# Parameters\n\n\
         Every key of the configuration file. The number is the one by which aspect commands 0x0712 (whole\n\
         numbers) and 0x0722 (others) set a parameter in flight. This page is made from the program's own table.\n",
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
    use crate::config::Config;
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
