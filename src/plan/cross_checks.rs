//! Contradictions and implausible values of a configuration. Of other files it only reads the key of the line.

use super::Remarks;
use crate::camera::{Backlog, Source};
use crate::config::{self, Config, ConfiguredCamera, Output, Outputs};
use crate::instrument::Role;
use crate::output::Destination;
use std::path::{Path, PathBuf};

pub(super) fn check(config: &Config, remarks: &mut Remarks) {
    for fault in config.faults() {
        remarks.error(&fault.key, fault.expected, fault.found);
    }
    for camera in config.cameras.flying() {
        exposure(camera, remarks);
        let first = config.cameras.flying().find(|one| one.role == camera.role);
        if first.is_some_and(|first| first.name == camera.name) {
            waits(camera, config, remarks);
        }
        if let Some(source @ Source::Device(_)) = &camera.source
            && cfg!(not(feature = "gige"))
        {
            remarks.not_built(&format!("{}.source", camera.name), source.to_string());
        }
    }
    same_sources(config, remarks);
    followed(config, remarks);
    archive(&config.archive, remarks);
    link(config, remarks);
    navigation(&config.navigation, remarks);
    outputs(config, remarks);
    if config.site.place().is_none() {
        remarks.warn(
            "site",
            "a place, for offsets where neither frames nor GPS give one",
            "none",
        );
    }
}

/// Warns if the first camera of its role is too slow: a roll becomes too old for the frames of the Sun before the next frame of the
/// horizon, or a request for the Moon, which must wait for the current exposure, the next one, and its readout, expires.
fn waits(camera: &ConfiguredCamera, config: &Config, remarks: &mut Remarks) {
    let period_s = 1.0 / camera.rate_hz;
    let rate = format!("{}.rate_hz", camera.name);
    let (roll_s, moon_s) = (config.roll.max_age_s, config.moon.answer_within_s);
    match camera.role {
        Role::Roll if camera.instrument.is_some() && roll_s < period_s => {
            let expected = format!("{period_s:.3} s or more, as from frame to frame at {rate}");
            remarks.warn("roll.max_age_s", expected, roll_s.to_string());
        }
        Role::Moon if moon_s < 2.0 * period_s => {
            let least_s = 2.0 * period_s;
            let expected = format!("{least_s:.3} s or more, two periods of {rate}");
            remarks.warn("moon.answer_within_s", expected, moon_s.to_string());
        }
        _ => {}
    }
}

fn exposure(camera: &ConfiguredCamera, remarks: &mut Remarks) {
    let (shortest, longest) = (camera.auto_exposure_min_us, camera.auto_exposure_max_us);
    let period_us = 1e6 / camera.rate_hz;
    let key = |name: &str| format!("{}.{name}", camera.name);
    if camera.auto_exposure().is_none() || shortest >= longest {
        return;
    }
    if !(shortest..=longest).contains(&camera.exposure_us) {
        let expected =
            format!("one that automatic exposure may choose, {shortest} to {longest} us");
        remarks.warn(
            &key("exposure_us"),
            expected,
            camera.exposure_us.to_string(),
        );
    }
    if f64::from(longest) > period_us {
        let expected = format!("less than the {period_us:.0} us from frame to frame at rate_hz");
        remarks.warn(&key("auto_exposure_max_us"), expected, longest.to_string());
    }
}

/// A camera can be opened once; a folder or the simulator may be used twice intentionally.
fn same_sources(config: &Config, remarks: &mut Remarks) {
    let cameras: Vec<&ConfiguredCamera> = config.cameras.flying().collect();
    for (n, camera) in cameras.iter().enumerate() {
        let is_same = |other: &&&ConfiguredCamera| other.source == camera.source;
        let Some(other) = cameras[..n].iter().find(is_same) else {
            continue;
        };
        let key = format!("{}.source", camera.name);
        let expected = format!("another source than that of {}", other.name);
        let sees_sky = camera.role != Role::PitchYaw && camera.instrument.is_some();
        match &camera.source {
            None => {}
            // The simulator then draws the horizon or the Moon.
            Some(Source::Simulated(_)) if sees_sky => {}
            // Each camera supplies its own.
            Some(Source::Own) => {}
            Some(source) if source.is_real() => remarks.error(&key, expected, source.to_string()),
            Some(source) => remarks.warn(&key, expected, source.to_string()),
        }
    }
}

/// A followed folder must be separate from the archive: a flight would otherwise take its own frames for the camera's, and an archive
/// contain another's.
fn followed(config: &Config, remarks: &mut Remarks) {
    let archive = &config.archive;
    let archives: Vec<PathBuf> = [&archive.directory, &archive.second_directory]
        .into_iter()
        .flatten()
        .cloned()
        .collect();
    for camera in config.cameras.flying() {
        let Some(Source::Followed(folder, backlog)) = &camera.source else {
            continue;
        };
        let key = format!("{}.source", camera.name);
        let (paths, followed) = (archives.clone(), folder.clone());
        let shared = move || {
            let followed = real(&followed);
            let is_shared = |archive: &PathBuf| {
                let archive = real(archive);
                archive.starts_with(&followed) || followed.starts_with(&archive)
            };
            paths.into_iter().find(is_shared)
        };
        if let Some(Some(archive)) = remarks.answered(&key, shared) {
            let expected = "a folder apart from the archive, whose frames would be followed, too";
            let found = format!("{folder:?}, and the archive is {archive:?}");
            remarks.error(&key, expected, found);
        }
        if archives.is_empty() && *backlog == Backlog::Taken {
            let expected = "an archive, to know after a restart which files were taken";
            remarks.warn(&key, expected, "none: all would be taken again");
        }
    }
}

/// A path without links and dots; for one that does not exist, as far as it exists.
fn real(path: &Path) -> PathBuf {
    let path = std::path::absolute(path).unwrap_or_else(|_| path.into());
    let there = path.ancestors().find_map(|above| {
        let rest = path.strip_prefix(above).ok()?;
        Some(above.canonicalize().ok()?.join(rest))
    });
    there.unwrap_or(path)
}

fn archive(archive: &config::Archive, remarks: &mut Remarks) {
    match (&archive.directory, &archive.second_directory) {
        (None, None) => remarks.warn("archive.directory", "a folder, to keep frames", "none"),
        (Some(first), Some(second)) if first == second => {
            let found = second.display().to_string();
            remarks.error(
                "archive.second_directory",
                "another folder than the first",
                found,
            );
        }
        _ => {}
    }
}

fn link(config: &Config, remarks: &mut Remarks) {
    let link = &config.link;
    match link.address() {
        Ok(None) => remarks.warn(
            "link.port",
            "the controller's port",
            "none: nothing is sent",
        ),
        Ok(Some(_)) => {
            let rest = [link.local_end().map(drop), link.guard().map(drop)];
            for refused in rest.into_iter().filter_map(Result::err) {
                remarks.error(&refused.key, refused.expected, refused.found);
            }
        }
        Err(refused) => remarks.error(&refused.key, refused.expected, refused.found),
    }
}

fn navigation(own: &config::Navigation, remarks: &mut Remarks) {
    for address in [own.imu_address(), own.gps_address()] {
        if let Err(refused) = address {
            remarks.error(&refused.key, refused.expected, refused.found);
        }
    }
    if own.is_enabled() && own.settings.is_some() && own.gps_port.is_none() {
        let expected = "a GPS receiver: without a fix the filter never begins";
        remarks.warn("navigation.gps_port", expected, "none");
    }
}

fn outputs(config: &Config, remarks: &mut Remarks) {
    for (name, output) in config.outputs.iter() {
        // The file configures the output, but not its destination.
        if output.to.is_none() && (name != Outputs::TABLE || *output != Output::default()) {
            let expected = Destination::EXPECTED;
            remarks.warn(
                &format!("{name}.to"),
                expected,
                "none: there is no such output",
            );
        }
    }
}
