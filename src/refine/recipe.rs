//! Recipe for the frames of a camera that sees the plate.

use super::record::FrameRecord;
use crate::archive::{ArchiveReader, Flown, FlownFiles, StoredFile};
use crate::aspect::{self, Expected};
use crate::config::Config;
use crate::instrument::Instrument;
use crate::observe::{Observer, Span, Unsolved, hash_of, with_frame};

/// Recipe of a run: everything that a frame's own record depends on.
#[derive(Debug, Clone)]
pub struct Recipe {
    pub instrument: Instrument,
    pub settings: aspect::SolverSettings,
    /// The effective configuration and the instrument's file.
    pub flown: Flown,
    /// Instruments that frames may name, if instrument and configuration are the archive's.
    pub archived: FlownFiles,
    /// Text of the instrument, and of the solver's part of the configuration.
    stated: [String; 2],
}

impl Recipe {
    /// Makes a recipe from an instrument, the text that it was read from, and a configuration, of which only the solver's part is used.
    pub fn new(
        (instrument, text): (Instrument, String),
        config: &Config,
        archived: FlownFiles,
    ) -> Self {
        let solver = Config {
            limb: config.limb,
            fiducial: config.fiducial,
            registration: config.registration,
            ..Config::default()
        };
        Self {
            instrument,
            settings: config.solver(),
            stated: [plain_toml(&text), plain_toml(&solver.to_toml())],
            flown: Flown::new(config.to_toml(), Some(text)),
            archived,
        }
    }

    /// Hashes of the instrument and of the solver's settings as stated.
    pub fn stated_hashes(&self) -> [u64; 2] {
        self.stated.each_ref().map(|text| hash_of(text.as_bytes()))
    }
}

/// The values of a TOML text in the order of their keys: independent of the layout of the text.
pub(super) fn plain_toml(text: &str) -> String {
    let table: Option<toml::Table> = toml::from_str(text).ok();
    table.map_or_else(|| text.to_owned(), |table| table.to_string())
}

impl Observer for Recipe {
    type Output = FrameRecord;

    fn stated(&self) -> String {
        self.stated.join("\n")
    }

    fn observe(
        &self,
        archive: &ArchiveReader,
        input: &StoredFile,
        span: &Span,
    ) -> Result<Option<FrameRecord>, Unsolved> {
        let (instrument, archived) = (&self.instrument, &self.archived);
        let size_px = instrument.camera.size_px();
        with_frame(archive, input, span, size_px, archived, |frame, header| {
            let size = instrument.check_size(frame);
            size.map_err(|wrong| wrong.to_string())?;
            let expected = frame.info.mid_exposure.and_then(Expected::at);
            let solution = aspect::solve_with(&self.settings, frame, instrument, expected, None);
            Ok(FrameRecord::new(&frame.info, header, &solution, instrument))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::instrument::builtin_text;
    use std::path::Path;

    fn recipe(text: &str, change: impl FnOnce(&mut Config)) -> Recipe {
        let mut config = Config::default();
        change(&mut config);
        let instrument = Instrument::parse(Path::new("demo.toml"), text).unwrap();
        Recipe::new(
            (instrument, text.to_owned()),
            &config,
            FlownFiles::default(),
        )
    }

    #[test]
    fn records_are_those_of_the_values_that_were_stated_however_they_were_written() {
        let demo = builtin_text("demo").unwrap();
        let default_name = recipe(demo, |_| {}).journal_name();
        let commented = format!("# a remark\n{demo}\n\n# another one\n");
        assert_eq!(recipe(&commented, |_| {}).journal_name(), default_name);
        let aimed = recipe(demo, |config| config.link.baud += 1);
        assert_eq!(aimed.journal_name(), default_name);
        let other = demo.replacen("name = \"demo\"", "name = \"other\"", 1);
        assert_ne!(recipe(&other, |_| {}).journal_name(), default_name);
        let finer = recipe(demo, |config| config.limb.limb_points += 1);
        assert_ne!(finer.journal_name(), default_name);
    }
}
