//! Dates at which the numbers of an instrument were measured: for people and for the check before a flight, not for the
//! solver.

use super::toml_file::{TomlError, Utc};
use super::{Instrument, raw};
use jiff::civil::Date;
use jiff::tz::Offset;
use std::path::Path;

/// Date of one number of an instrument.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Dated {
    /// Its dotted key in the instrument's file.
    pub key: String,
    pub date: Date,
}

impl Instrument {
    /// Checks an instrument's text, and returns the dates of its mounting in the order of the file.
    ///
    /// # Errors
    /// As [`Instrument::read`].
    pub fn parse_with_dates(path: &Path, text: &str) -> Result<(Self, Vec<Dated>), TomlError> {
        Ok((raw::parse(path, text)?, dates(text, "mounting")))
    }
}

/// The dates in one table of a file that has been validated.
fn dates(text: &str, table: &str) -> Vec<Dated> {
    let document: toml::Table = text.parse().unwrap_or_default();
    let entries = document.get(table).and_then(toml::Value::as_table);
    let dated = |(name, entry): (&String, &toml::Value)| {
        let Utc(instant) = entry.get("date")?.clone().try_into().ok()?;
        Some(Dated {
            key: format!("{table}.{name}"),
            date: Offset::UTC.to_datetime(instant).date(),
        })
    };
    entries.into_iter().flatten().filter_map(dated).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_date_is_that_of_utc_in_quotes_or_not() {
        let text = "[mounting]\na = { date = 2013-09-21T20:00:00-06:00 }\nb = { date = \"2013-09-22\" }\nc = { date = 2013-09-22 }\n";
        let dates = dates(text, "mounting");
        assert_eq!(dates.len(), 3);
        assert!(
            dates
                .iter()
                .all(|dated| dated.date.to_string() == "2013-09-22")
        );
    }

    #[test]
    fn every_number_of_a_mounting_has_its_date() {
        let text = include_str!("../../calibration/heroes-pyas-f.toml");
        let found = dates(text, "mounting");
        let dated = |key: &str| found.iter().find(|dated| dated.key == key);
        for key in ["boresight_mil", "clocking_deg", "scale_mil_per_px"] {
            let dated = dated(&format!("mounting.{key}")).unwrap();
            assert_eq!(dated.date.year(), 2013, "{dated:?}");
        }
    }
}
