//! With which files an archive is refined: its own configuration and cameras, unless others are named.

use super::RefineArgs;
use crate::archive::{CONFIGURATION, Flown, FlownFile, FlownFiles, INSTRUMENT};
use crate::cli::options;
use crate::config::Config;
use crate::instrument::{Instrument, MountedCamera, SECOND, builtin_text, text_of};
use crate::refine::{CameraFrames, Recipe, RollRecipe};
use anyhow::{Context, bail, ensure};
use std::path::Path;

impl RefineArgs {
    /// The configuration of `--config`, else what the archive's say of solver, place and target, else the defaults.
    pub(super) fn configuration(&self, archived: &FlownFiles) -> anyhow::Result<Config> {
        let mut config = match &self.config {
            Some(path) => Config::read(path)?,
            None => self.archived_configuration(archived)?,
        };
        if let Some(place) = self.place {
            config.site = place.into();
        }
        Ok(config)
    }

    fn archived_configuration(&self, archived: &FlownFiles) -> anyhow::Result<Config> {
        let mut found: Vec<Config> = Vec::new();
        for file in archived.of(CONFIGURATION) {
            let flown = Config::parse(&file.path, &file.text)
                .context("the archive's configuration cannot be used: name one with --config")?;
            // The rest is of the flight's computer alone.
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

    /// What a camera's frames are refined with.
    pub(super) fn recipe(
        &self,
        camera: &CameraFrames,
        archived: &FlownFiles,
        config: &Config,
    ) -> anyhow::Result<Recipe> {
        let (instrument, text) = self.instrument(archived, camera)?;
        Ok(Recipe {
            instrument,
            settings: config.solver(),
            flown: Flown::new(config.to_toml(), Some(text)),
            archived: self.authority(archived.clone()),
        })
    }

    /// A camera's instrument, with its text: the one of `--instrument` that is its own, else the archive's, else the built-in one
    /// that its frames name, else the demo.
    fn instrument(
        &self,
        archived: &FlownFiles,
        camera: &CameraFrames,
    ) -> anyhow::Result<(Instrument, String)> {
        let flown = flown_with(archived, camera);
        if !self.instrument.is_empty() {
            let (instrument, text) = self.told_instrument(camera)?;
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

    /// The first of `--instrument` that a camera's frames do not contradict.
    fn told_instrument(&self, camera: &CameraFrames) -> anyhow::Result<(Instrument, String)> {
        let mut refused = None;
        for path in &self.instrument {
            let (instrument, text) = options::instrument_with_text(Some(path))?;
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

    /// What frames may name: of what was told instead, anything.
    fn authority(&self, mut archived: FlownFiles) -> FlownFiles {
        let told = [
            (self.config.is_some(), CONFIGURATION),
            (!self.instrument.is_empty(), INSTRUMENT),
        ];
        for (_, kind) in told.iter().filter(|(is_told, _)| *is_told) {
            archived = archived.without(*kind);
        }
        archived
    }

    /// What the roll camera's frames are refined with; `None` where neither the archive nor `--roll-camera` holds the camera's file.
    pub(super) fn roll_recipe(
        &self,
        camera: &CameraFrames,
        archived: &FlownFiles,
        config: &Config,
    ) -> anyhow::Result<Option<RollRecipe>> {
        let Some((mounted, text)) = self.roll_camera(camera, archived)? else {
            return Ok(None);
        };
        let mut authority = self.authority(archived.clone());
        if self.roll_camera.is_some() {
            authority = authority.without(INSTRUMENT);
        }
        Ok(Some(RollRecipe {
            camera: mounted,
            settings: config.roll,
            place: config.site.place(),
            flown: Flown::new(config.to_toml(), Some(text)),
            archived: authority,
        }))
    }

    fn roll_camera(
        &self,
        camera: &CameraFrames,
        archived: &FlownFiles,
    ) -> anyhow::Result<Option<(MountedCamera, String)>> {
        if let Some(path) = &self.roll_camera {
            let text = text_of(path)?;
            return Ok(Some((MountedCamera::parse(path, &text)?, text)));
        }
        let named = different(archived).into_iter();
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

/// The archive's instruments, of which none is another's letter by letter.
fn different(archived: &FlownFiles) -> Vec<&FlownFile> {
    let mut different: Vec<&FlownFile> = Vec::new();
    for file in archived.of(INSTRUMENT) {
        if !different.iter().any(|other| other.text == file.text) {
            different.push(file);
        }
    }
    different
}

/// The archive's files of a camera's instrument, of which none is another's letter by letter: those that its frames name by their hash,
/// else those that do not contradict them.
fn flown_with<'a>(archived: &'a FlownFiles, camera: &CameraFrames) -> Vec<&'a FlownFile> {
    let mut different = different(archived);
    let is_named = |file: &&&FlownFile| camera.instruments_sha256.contains(file.sha256());
    if different.iter().any(|file| is_named(&file)) {
        return different.iter().filter(is_named).copied().collect();
    }
    // One that only a newer program can read contradicts nothing.
    different.retain(|file| {
        let instrument = Instrument::parse(&file.path, &file.text);
        instrument.is_ok_and(|instrument| instrument.check_taken_by(&camera.taken_by).is_ok())
    });
    different
}

/// The built-in instrument that a camera's frames name; the demo where they name none.
fn built_in(camera: &CameraFrames) -> anyhow::Result<(Instrument, String)> {
    let Some(named) = camera.taken_by.instrument.as_deref() else {
        return options::instrument_with_text(None);
    };
    let name = named.strip_suffix(SECOND).unwrap_or(named);
    let text = builtin_text(name).with_context(|| {
        format!(
            "expected the file of instrument \"{name}\", which the frames name (OBSRVTRY), found none in the archive and none built in: \
             name it with --instrument"
        )
    })?;
    Ok((Instrument::parse(Path::new(name), text)?, text.into()))
}

/// Refuses an instrument of another camera than those that the archive was flown with.
fn refuse_other_sensor(told: &Instrument, flown: &[&FlownFile]) -> anyhow::Result<()> {
    let size = |instrument: &Instrument| (instrument.camera.width_px, instrument.camera.height_px);
    let flown = flown
        .iter()
        .map(|file| Instrument::parse(&file.path, &file.text));
    // One that only a newer program can read contradicts nothing.
    let sizes: Vec<_> = flown
        .flatten()
        .map(|instrument| size(&instrument))
        .collect();
    ensure!(
        sizes.is_empty() || sizes.contains(&size(told)),
        "instrument \"{}\": expected a sensor of the archive's instrument, {:?} px, found {:?} px",
        told.name,
        sizes[0],
        size(told)
    );
    Ok(())
}
