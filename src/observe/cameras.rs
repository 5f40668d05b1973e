//! Assigns the frames of an archive to cameras by their headers.

use super::copies::{CopiedFrame, Distinct, PixelDigests, distinct, may_be_copied};
use super::headers::{CameraHeader, CameraHeaders};
use super::journal::JournalError;
use super::pass::{Pass, PassError, Recorded};
use crate::archive::{StoredFile, plain};
use crate::frame::TakenBy;
use crate::instrument::Role;
use crate::units::counted;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet, HashMap};

/// The cameras of an archive.
#[derive(Debug, Default)]
pub struct Cameras {
    /// Cameras that see the plate.
    pub plate: Vec<CameraFrames>,
    /// The first camera that sees the horizon.
    pub roll: Option<CameraFrames>,
    /// Other cameras that do not see the plate.
    pub others: Vec<CameraFrames>,
}

/// The cameras of an archive by the headers of its frames, without copies of frames.
///
/// # Errors
/// If a pass ends early.
pub fn cameras(pass: &Pass<'_>, frames: Vec<StoredFile>) -> Result<Cameras, PassError> {
    let frames = match pass.shard {
        Some(shard) => shard.part(frames),
        None => frames,
    };
    let headers = pass.run(&CameraHeaders, "headers", &frames)?;
    let frames = by_camera(&headers, each_once(pass, &headers, frames)?)?;
    let mut plate = Vec::new();
    let mut taken: BTreeMap<(Role, usize), Vec<CameraFrames>> = BTreeMap::new();
    for camera in frames {
        match camera.named_role() {
            Some(named) => taken.entry(named).or_default().push(camera),
            None => plate.push(camera),
        }
    }
    let mut others: Vec<CameraFrames> = taken
        .into_values()
        .filter_map(CameraFrames::together)
        .collect();
    let is_roll = |camera: &CameraFrames| {
        camera
            .named_role()
            .is_some_and(|(role, _)| role == Role::Roll)
    };
    let roll = others.iter().position(is_roll);
    Ok(Cameras {
        roll: roll.map(|n| others.remove(n)),
        others,
        plate,
    })
}

/// The files without copies. A shard does not search for copies: other shards may have the originals.
fn each_once(
    pass: &Pass<'_>,
    headers: &Recorded<CameraHeader>,
    inputs: Vec<StoredFile>,
) -> Result<Distinct, PassError> {
    let alike = match pass.shard {
        Some(_) => Vec::new(),
        None => may_be_copied(headers, &inputs)?,
    };
    if alike.is_empty() {
        return Ok(Distinct {
            inputs,
            ..Distinct::default()
        });
    }
    let digests = pass.run(&PixelDigests, "frames compared", &alike)?;
    let distinct = distinct(headers, &digests, inputs)?;
    if let Some([first, other]) = distinct.contradicting.first() {
        tracing::warn!(
            "{other}: expected another number or time than that of {first}, found the same and other pixels ({})",
            counted(distinct.contradicting.len() as u64, "such frame")
        );
    }
    Ok(distinct)
}

/// The frames of one camera.
#[derive(Debug, Clone, Default)]
pub struct CameraFrames {
    pub taken_by: TakenBy,
    /// Label that distinguishes it from the archive's other cameras, usable in names of files and folders.
    pub label: String,
    /// Files in the order of their paths. A file whose header cannot be read is assigned to the camera of the previous file.
    pub inputs: Vec<StoredFile>,
    /// Files with copies of frames in `inputs`.
    pub copies: Vec<CopiedFrame>,
    /// SHA-256 of the instrument's files that the frames name.
    pub instruments_sha256: BTreeSet<String>,
}

impl CameraFrames {
    /// The role and the ordinal in its name; `None` for a camera that sees a plate.
    pub fn named_role(&self) -> Option<(Role, usize)> {
        Role::labelled(self.taken_by.instrument.as_deref()?)
    }

    /// Merges the frames of several cameras; `None` if there are none.
    pub fn together(cameras: Vec<Self>) -> Option<Self> {
        cameras.into_iter().reduce(|mut all, camera| {
            all.inputs.extend(camera.inputs);
            all.copies.extend(camera.copies);
            all.instruments_sha256.extend(camera.instruments_sha256);
            all
        })
    }
}

/// The cameras by name, each with its frames.
fn by_camera(
    done: &Recorded<CameraHeader>,
    Distinct { inputs, copies, .. }: Distinct,
) -> Result<Vec<CameraFrames>, JournalError> {
    let header = |input: &StoredFile| {
        let record = done.record(input)?;
        Ok(record.and_then(|record| record.outcome.ok()))
    };
    let headers = inputs.par_iter().map(header);
    let headers: Vec<Option<CameraHeader>> = headers.collect::<Result<_, JournalError>>()?;
    let first = headers.iter().flatten().next();
    let mut before = first.map_or(TakenBy::default(), |header| {
        header.identity.taken_by.clone()
    });
    let mut copies_of: HashMap<String, Vec<CopiedFrame>> = HashMap::new();
    for copy in copies {
        copies_of.entry(copy.first.clone()).or_default().push(copy);
    }
    let mut cameras: BTreeMap<TakenBy, CameraFrames> = BTreeMap::new();
    for (input, header) in inputs.into_iter().zip(headers) {
        let (name, sha256) = header.map_or((before.clone(), None), |header| {
            let [_, instrument] = header.identity.flown_sha256;
            (header.identity.taken_by, instrument)
        });
        before.clone_from(&name);
        let camera = cameras.entry(name).or_default();
        camera
            .copies
            .extend(copies_of.remove(&input.file).into_iter().flatten());
        camera.inputs.push(input);
        camera.instruments_sha256.extend(sha256);
    }
    Ok(labelled(cameras))
}

/// Assigns unique labels: the instrument's name; the camera's, if that does not distinguish them; both; and finally a number.
fn labelled(cameras: BTreeMap<TakenBy, CameraFrames>) -> Vec<CameraFrames> {
    let part = |part: &Option<String>| plain(part.as_deref().unwrap_or_default());
    let ways: [&dyn Fn(&TakenBy) -> String; 3] = [
        &|name| part(&name.instrument),
        &|name| part(&name.camera),
        &|name| format!("{}_{}", part(&name.instrument), part(&name.camera)),
    ];
    let distinguishes = |way: &&&dyn Fn(&TakenBy) -> String| {
        let labels: BTreeSet<String> = cameras.keys().map(way).collect();
        labels.len() == cameras.len()
    };
    let way = ways.iter().find(distinguishes);
    let label = |number: usize, name: &TakenBy| match way {
        Some(way) => way(name),
        None => format!("camera-{}", number + 1),
    };
    let all = cameras.into_iter().enumerate();
    all.map(|(number, (name, camera))| CameraFrames {
        label: label(number, &name),
        taken_by: name,
        ..camera
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(names: &[(Option<&str>, Option<&str>)]) -> Vec<String> {
        let name = |(instrument, camera): &(Option<&str>, Option<&str>)| TakenBy {
            instrument: instrument.map(str::to_owned),
            camera: camera.map(str::to_owned),
        };
        let cameras = names.iter().map(|n| (name(n), CameraFrames::default()));
        let labelled = labelled(cameras.collect());
        labelled.into_iter().map(|camera| camera.label).collect()
    }

    #[test]
    fn cameras_are_labelled_by_what_differs() {
        let (f, r) = (Some("pyas-f"), Some("pyas-r"));
        let (a, b) = (Some("GigE a/1"), Some("GigE b/2"));
        assert_eq!(labels(&[(f, a), (r, a)]), ["pyas-f", "pyas-r"]);
        assert_eq!(labels(&[(f, a), (f, b)]), ["GigE-a-1", "GigE-b-2"]);
        let both = labels(&[(f, a), (f, b), (r, a)]);
        assert_eq!(
            both,
            ["pyas-f_GigE-a-1", "pyas-f_GigE-b-2", "pyas-r_GigE-a-1"]
        );
        assert_eq!(labels(&[(None, None), (None, a)]), ["unnamed", "GigE-a-1"]);
        assert_eq!(labels(&[(f, None)]), ["pyas-f"]);
    }
}
