//! Selects the files with which an archive is refined: its own configuration and cameras, unless others are named.

use super::recipe::Recipe;
use super::roll::RollRecipe;
use crate::archive::{CONFIGURATION, FlownFile, FlownFiles, INSTRUMENT};
use crate::config::Config;
use crate::instrument::role::one_of_several;
use crate::instrument::{Instrument, MountedCamera, builtin_text, text_of};
use crate::observe::CameraFrames;
use crate::units::Place;
use anyhow::{Context, bail, ensure};
use std::path::{Path, PathBuf};

/// Files that are named instead of the archive's own.
#[derive(Debug, Clone, Default)]
pub struct Overrides {
    /// Instruments, TOML files or names of built-in ones; each camera takes its own.
    pub instruments: Vec<PathBuf>,
    pub roll_camera: Option<PathBuf>,
    pub configuration: Option<PathBuf>,
    /// Position used for frames that do not state theirs.
    pub place: Option<Place>,
}

/// An archive's name, the files stored in it, and the files named instead.
pub(super) struct Files<'a> {
    pub archive: &'a Path,
    pub archived: FlownFiles,
    pub overrides: &'a Overrides,
}

impl Files<'_> {
    /// The configuration that is named, else the archive's sections on solver, place and target, else the defaults.
    pub fn configuration(&self) -> anyhow::Result<Config> {
        let mut config = match &self.overrides.configuration {
            Some(path) => Config::read(path)?,
            None => self.archived_configuration()?,
        };
        if let Some(place) = self.overrides.place {
            config.site = place.into();
        }
        Ok(config)
    }

    fn archived_configuration(&self) -> anyhow::Result<Config> {
        let mut found: Vec<Config> = Vec::new();
        for file in self.archived.of(CONFIGURATION) {
            let flown = Config::parse(&file.path, &file.text)
                .context("the archive's configuration cannot be used: name one with --config")?;
            // The other sections concern the flight computer only.
            let config = Config {
                site: flown.site,
                target: flown.target,
                limb: flown.limb,
                fiducial: flown.fiducial,
                registration: flown.registration,
                roll: flown.roll,
                ..Config::default()
            };
            if !found.contains(&config) {
                found.push(config);
            }
        }
        ensure!(
            found.len() <= 1,
            "{}: expected one [site], [target], [limb], [fiducial], [registration] and [roll], found {} in its configuration_*.toml: \
             name a configuration with --config",
            self.archive.display(),
            found.len()
        );
        Ok(found.pop().unwrap_or_default())
    }

    /// Instrument and settings for a camera's frames.
    pub fn recipe(&self, camera: &CameraFrames, config: &Config) -> anyhow::Result<Recipe> {
        let authority = self.authority();
        Ok(Recipe::new(self.instrument(camera)?, config, authority))
    }

    /// A camera's instrument, with its text: the named one that matches the camera, else the archive's, else the built-in one that its
    /// frames name, else the demo.
    fn instrument(&self, camera: &CameraFrames) -> anyhow::Result<(Instrument, String)> {
        let flown = flown_with(&self.archived, camera);
        if !self.overrides.instruments.is_empty() {
            let (instrument, text) = self.given_instrument(camera)?;
            refuse_other_sensor(&instrument, &flown)?;
            return Ok((instrument, text));
        }
        match flown.as_slice() {
            [one] => {
                let instrument = Instrument::parse(&one.path, &one.text).context(
                    "the archive's instrument cannot be used: name one with --instrument",
                )?;
                Ok((instrument, one.text.clone()))
            }
            [] => built_in(camera).with_context(|| self.archive.display().to_string()),
            several => bail!(
                "{}: expected one instrument, found {} that differ in its instrument_*.toml: name one with --instrument",
                self.archive.display(),
                several.len()
            ),
        }
    }

    /// The first named instrument that a camera's frames do not contradict.
    fn given_instrument(&self, camera: &CameraFrames) -> anyhow::Result<(Instrument, String)> {
        let mut refused = None;
        for path in &self.overrides.instruments {
            let text = text_of(path)?;
            let instrument = Instrument::parse(path, &text)?;
            match instrument.check_taken_by(&camera.taken_by) {
                Ok(()) => return Ok((instrument, text)),
                Err(wrong) => refused = Some((path, wrong)),
            }
        }
        let (path, wrong) = refused.context("expected a file of --instrument, found none")?;
        let frame = camera.inputs.first().map_or("", |input| &input.file);
        bail!(
            "{}: {frame}: {wrong}: {} is not of the camera that took these frames",
            self.archive.display(),
            path.display()
        )
    }

    /// Instruments and configurations that frames may name; kinds of files that were named instead are not checked.
    fn authority(&self) -> FlownFiles {
        let mut archived = self.archived.clone();
        let named = [
            (self.overrides.configuration.is_some(), CONFIGURATION),
            (!self.overrides.instruments.is_empty(), INSTRUMENT),
        ];
        for (_, kind) in named.iter().filter(|(is_named, _)| *is_named) {
            archived = archived.without(*kind);
        }
        archived
    }

    /// Camera and settings for the roll camera's frames; `None` where neither the archive nor the caller names the camera's file.
    pub fn roll_recipe(
        &self,
        camera: &CameraFrames,
        config: &Config,
    ) -> anyhow::Result<Option<RollRecipe>> {
        let mut authority = self.authority();
        if self.overrides.roll_camera.is_some() {
            authority = authority.without(INSTRUMENT);
        }
        let mounted = self.roll_camera(camera)?;
        Ok(mounted.map(|mounted| RollRecipe::new(mounted, config, authority)))
    }

    fn roll_camera(
        &self,
        camera: &CameraFrames,
    ) -> anyhow::Result<Option<(MountedCamera, String)>> {
        if let Some(path) = &self.overrides.roll_camera {
            let text = text_of(path)?;
            return Ok(Some((MountedCamera::parse(path, &text)?, text)));
        }
        let named = different(&self.archived).into_iter();
        let named = named.filter(|file| camera.instruments_sha256.contains(file.sha256()));
        match named.collect::<Vec<_>>().as_slice() {
            [] => Ok(None),
            [one] => {
                let mounted = MountedCamera::parse(&one.path, &one.text).context(
                    "the archive's roll camera cannot be used: name one with --roll-camera",
                )?;
                Ok(Some((mounted, one.text.clone())))
            }
            several => bail!(
                "{}: expected one file of the roll camera, found {} that differ in its instrument_*.toml: name one with --roll-camera",
                self.archive.display(),
                several.len()
            ),
        }
    }
}

/// The archive's instruments, without identical copies.
fn different(archived: &FlownFiles) -> Vec<&FlownFile> {
    let mut different: Vec<&FlownFile> = Vec::new();
    for file in archived.of(INSTRUMENT) {
        if !different.iter().any(|other| other.text == file.text) {
            different.push(file);
        }
    }
    different
}

/// The archive's files of a camera's instrument, without identical copies: those that its frames name by their hash,
/// else those that do not contradict them.
fn flown_with<'a>(archived: &'a FlownFiles, camera: &CameraFrames) -> Vec<&'a FlownFile> {
    let mut different = different(archived);
    let is_named = |file: &&&FlownFile| camera.instruments_sha256.contains(file.sha256());
    if different.iter().any(|file| is_named(&file)) {
        return different.iter().filter(is_named).copied().collect();
    }
    // A file that only a newer program can read contradicts nothing.
    different.retain(|file| {
        let instrument = Instrument::parse(&file.path, &file.text);
        instrument.is_ok_and(|instrument| instrument.check_taken_by(&camera.taken_by).is_ok())
    });
    different
}

/// The built-in instrument that a camera's frames name; the demo where they name none.
fn built_in(camera: &CameraFrames) -> anyhow::Result<(Instrument, String)> {
    let Some(named) = camera.taken_by.instrument.as_deref() else {
        let text = builtin_text("demo").unwrap_or_default();
        return Ok((Instrument::parse(Path::new("demo"), text)?, text.into()));
    };
    let name = one_of_several(named).0;
    let text = builtin_text(name).with_context(|| {
        format!(
            "expected the file of instrument \"{name}\", which the frames name (OBSRVTRY), found none in the archive and none built in: \
             name it with --instrument"
        )
    })?;
    Ok((Instrument::parse(Path::new(name), text)?, text.into()))
}

/// Refuses an instrument whose sensor differs from those that the archive was flown with.
fn refuse_other_sensor(stated: &Instrument, flown: &[&FlownFile]) -> anyhow::Result<()> {
    let size = |instrument: &Instrument| (instrument.camera.width_px, instrument.camera.height_px);
    let flown = flown
        .iter()
        .map(|file| Instrument::parse(&file.path, &file.text));
    // A file that only a newer program can read contradicts nothing.
    let sizes: Vec<_> = flown
        .flatten()
        .map(|instrument| size(&instrument))
        .collect();
    ensure!(
        sizes.is_empty() || sizes.contains(&size(stated)),
        "instrument \"{}\": expected a sensor of the archive's instrument, {:?} px, found {:?} px",
        stated.name,
        sizes[0],
        size(stated)
    );
    Ok(())
}
