//! Detection of frames in a set that are copies of others: from the other disk of a mirroring flight, renamed, or
//! compressed differently. A copy is not an independent measurement.

use super::{Frame, FrameInfo, Sample, TakenBy};
use crate::with_view;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::ffi::OsStr;
use std::hash::Hash;
use std::path::Path;

/// A frame in which fewer than this fraction of the pixels differ from the most frequent value has no structure by which it
/// could be recognised.
const LEAST_STRUCTURE: f64 = 1e-3;
/// In larger groups all frames are compared, without first selecting possible copies.
const MOST_PAIRED: usize = 16;

/// A frame's time and source according to its file.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Identity {
    pub taken_by: TakenBy,
    pub number: Option<u64>,
    /// Mid-exposure, ns since 1970.
    pub utc_ns: Option<i64>,
    /// Exposure (s), analogue and pre-amplifier gain.
    setting: [Option<f64>; 3],
    /// SHA-256 of the configuration and of the instrument's file used in flight, if the reader knows them.
    pub flown_sha256: [Option<String>; 2],
}

impl Identity {
    pub fn of(info: &FrameInfo) -> Self {
        let utc_ns = info.mid_exposure.map(|utc| utc.as_nanosecond());
        Self {
            taken_by: info.taken_by(),
            number: info.number,
            utc_ns: utc_ns.and_then(|utc_ns| i64::try_from(utc_ns).ok()),
            setting: [
                info.exposure.map(|exposure| exposure.as_secs_f64()),
                info.analogue_gain,
                info.preamp_gain,
            ],
            flown_sha256: [None, None],
        }
    }

    pub fn utc(&self) -> Option<Timestamp> {
        Timestamp::from_nanosecond(self.utc_ns?.into()).ok()
    }

    /// Whether no value that both state differs.
    fn agrees(&self, other: &Self) -> bool {
        fn same<T: PartialEq>(a: &Option<T>, b: &Option<T>) -> bool {
            a.as_ref().zip(b.as_ref()).is_none_or(|(a, b)| a == b)
        }
        let (taken_by, other_by) = (&self.taken_by, &other.taken_by);
        same(&self.number, &other.number)
            && same(&self.utc_ns, &other.utc_ns)
            && same(&taken_by.instrument, &other_by.instrument)
            && same(&taken_by.camera, &other_by.camera)
            && (self.setting.iter().zip(&other.setting)).all(|(a, b)| same(a, b))
            && (self.flown_sha256.iter().zip(&other.flown_sha256)).all(|(a, b)| same(a, b))
    }

    fn number_and_time(&self) -> Option<(u64, i64)> {
        self.number.zip(self.utc_ns)
    }

    /// Whether the files state that both are the same frame: same camera, number and time.
    fn is_stated_same(&self, other: &Self) -> bool {
        let stated = self.number_and_time();
        stated.is_some() && stated == other.number_and_time() && self.agrees(other)
    }
}

/// A hash of a frame's pixels, independent of how its file stores them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct PixelDigest {
    hash: u64,
    /// Whether the frame has no structure.
    is_blank: bool,
}

impl PixelDigest {
    pub fn of(frame: &Frame) -> Self {
        let shape = mixed(mixed(0, frame.width() as u64), frame.height() as u64);
        with_view!(frame, view => {
            let rows = || (0..frame.height()).map(|y| view.row(y));
            Self {
                hash: rows().fold(shape, hash_of_row),
                is_blank: is_blank(rows),
            }
        })
    }
}

/// A row's hash, chained to the hash of the previous rows.
fn hash_of_row<T: Sample>(before: u64, row: &[T]) -> u64 {
    let (fours, rest) = row.as_chunks::<4>();
    let word = |four: &[T]| {
        four.iter().fold(0, |word, pixel| {
            let value: u32 = (*pixel).into();
            word << 16 | u64::from(value)
        })
    };
    let hash = fours
        .iter()
        .fold(before, |hash, four| mixed(hash, word(four)));
    mixed(hash, word(rest))
}

/// Whether most pixels of a sparse sample have one value, the median.
fn is_blank<'a, T: Sample, R: ExactSizeIterator<Item = &'a [T]>>(rows: impl Fn() -> R) -> bool {
    const STEP: usize = 37;
    let sample = rows()
        .step_by(STEP)
        .flat_map(|row| row.iter().step_by(STEP));
    let mut sample: Vec<T> = sample.copied().collect();
    let middle = sample.len() / 2;
    sample.sort_unstable();
    let others = |row: &[T]| row.iter().filter(|pixel| **pixel != sample[middle]).count();
    let (mut pixels, mut different) = (0, 0);
    for row in rows() {
        pixels += row.len();
        different += others(row);
    }
    (different as f64) < LEAST_STRUCTURE * pixels as f64
}

/// FNV-1a of words; the rotation mixes high bits into low ones.
fn mixed(hash: u64, word: u64) -> u64 {
    let mixed = (hash ^ word ^ 0xcbf2_9ce4_8422_2325).wrapping_mul(0x0100_0000_01b3);
    mixed.rotate_left(29)
}

/// A frame that is compared with others.
#[derive(Debug, Clone, Copy)]
pub struct Compared<'a> {
    pub path: &'a Path,
    pub identity: &'a Identity,
    /// None if the pixels cannot be read, or need not be.
    pub digest: Option<PixelDigest>,
}

impl Compared<'_> {
    /// Whether one of two frames is a copy of the other: no stated value differs, and the pixels are the same. Frames
    /// without structure all look alike: their files must state that they are the same frame.
    fn is_copy(&self, other: &Self) -> bool {
        let Some((digest, others)) = self.digest.zip(other.digest) else {
            return false;
        };
        let (a, b) = (self.identity, other.identity);
        digest == others && a.agrees(b) && (!digest.is_blank || a.is_stated_same(b))
    }

    /// Of copies, the first one in this order is kept as the frame: frames with a time before those without, then by folder
    /// and name. The extension is compared after the name, so that `a.fits` precedes `a (1).fits`.
    fn order(&self) -> impl Ord {
        let path = self.path;
        let name = |part: Option<&OsStr>| part.map(OsStr::to_owned);
        (
            self.identity.utc_ns.is_none(),
            self.identity.number.is_none(),
            path.parent().map(Path::to_owned),
            name(path.file_stem()),
            name(path.extension()),
        )
    }
}

/// Result of a comparison of frames.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Copies {
    /// For each frame, the frame that it is a copy of.
    pub of: Vec<Option<usize>>,
    /// Frames with the same camera, number and time whose pixels differ: the later ones, each with the first.
    pub contradicting: Vec<[usize; 2]>,
}

impl Copies {
    /// Finds the copies; the result does not depend on the order of the frames.
    pub fn among(frames: &[Compared<'_>]) -> Self {
        let mut order: Vec<usize> = (0..frames.len()).collect();
        order.sort_by_cached_key(|n| frames[*n].order());
        let mut found = Self {
            of: vec![None; frames.len()],
            ..Self::default()
        };
        let mut by_pixels: HashMap<u64, Vec<usize>> = HashMap::new();
        let mut stated: HashMap<(u64, i64), Vec<usize>> = HashMap::new();
        for n in order {
            let frame = &frames[n];
            let Some(digest) = frame.digest else {
                continue;
            };
            let alike = by_pixels.entry(digest.hash).or_default();
            found.of[n] = alike
                .iter()
                .copied()
                .find(|first| frame.is_copy(&frames[*first]));
            if found.of[n].is_some() {
                continue;
            }
            alike.push(n);
            if let Some(key) = frame.identity.number_and_time() {
                let same = stated.entry(key).or_default();
                let is_other = |first: &&usize| {
                    let first = &frames[**first];
                    frame.identity.agrees(first.identity) && first.digest != frame.digest
                };
                let other = same.iter().find(is_other);
                found.contradicting.extend(other.map(|first| [*first, n]));
                same.push(n);
            }
        }
        found
    }
}

/// Which frames may be copies of one another according to their files: only their pixels need to be compared.
pub fn may_be_copies(frames: &[Option<&Identity>]) -> Vec<bool> {
    let mut marked = vec![false; frames.len()];
    let known = || {
        let all = frames.iter().enumerate();
        all.filter_map(|(n, identity)| Some((n, (*identity)?)))
    };
    if known().any(|(_, id)| id.number.is_none() && id.utc_ns.is_none()) {
        known().for_each(|(n, _)| marked[n] = true);
        return marked;
    }
    let mut mark = |groups: Vec<Vec<usize>>| {
        for group in groups {
            let agrees = |n: usize| {
                let others = group.iter().filter(|other| **other != n);
                let mut others = others.filter_map(|other| frames[*other].zip(frames[n]));
                others.any(|(a, b)| a.agrees(b))
            };
            for n in &group {
                marked[*n] |= group.len() > MOST_PAIRED || agrees(*n);
            }
        }
    };
    mark(grouped(known(), |id| id.number_and_time(), |_| true));
    mark(grouped(known(), |id| id.number, |id| id.utc_ns.is_none()));
    mark(grouped(known(), |id| id.utc_ns, |id| id.number.is_none()));
    marked
}

/// Groups of at least two frames with the same key, of which `wanted` holds for at least one.
fn grouped<'a, K: Eq + Hash>(
    frames: impl Iterator<Item = (usize, &'a Identity)>,
    key: impl Fn(&Identity) -> Option<K>,
    wanted: impl Fn(&Identity) -> bool,
) -> Vec<Vec<usize>> {
    let mut groups: HashMap<K, (bool, Vec<usize>)> = HashMap::new();
    for (n, identity) in frames {
        if let Some(key) = key(identity) {
            let (is_wanted, group) = groups.entry(key).or_default();
            *is_wanted |= wanted(identity);
            group.push(n);
        }
    }
    let groups = groups.into_values();
    groups
        .filter(|(is_wanted, group)| *is_wanted && group.len() > 1)
        .map(|(_, group)| group)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Pixels;

    fn identity(camera: Option<&str>, number: Option<u64>, utc_ns: Option<i64>) -> Identity {
        let taken_by = TakenBy {
            camera: camera.map(str::to_owned),
            instrument: None,
        };
        Identity {
            taken_by,
            number,
            utc_ns,
            ..Identity::default()
        }
    }

    fn digest(pixels: Pixels) -> PixelDigest {
        let frame = Frame::new(8, 8, pixels, 255, FrameInfo::default());
        PixelDigest::of(&frame.unwrap())
    }

    fn noise(seed: u8) -> PixelDigest {
        let pixels = (0..64_u8).map(|n| n.wrapping_mul(37).wrapping_add(seed));
        digest(Pixels::U8(pixels.collect()))
    }

    /// For each file, the file that it is a copy of.
    fn copies(frames: &[(&str, Identity, PixelDigest)]) -> Vec<Option<usize>> {
        found(frames).of
    }

    fn found(frames: &[(&str, Identity, PixelDigest)]) -> Copies {
        let compared = frames.iter().map(|(path, identity, digest)| Compared {
            path: Path::new(path),
            identity,
            digest: Some(*digest),
        });
        Copies::among(&compared.collect::<Vec<_>>())
    }

    #[test]
    fn the_digest_is_of_the_values_and_the_shape_alone() {
        let values: Vec<u8> = (0..64).collect();
        let wide = values.iter().map(|v| u16::from(*v)).collect();
        let narrow = digest(Pixels::U8(values.clone()));
        assert_eq!(narrow, digest(Pixels::U16(wide)));
        let frame = Frame::new(16, 4, Pixels::U8(values), 255, FrameInfo::default());
        assert_ne!(narrow, PixelDigest::of(&frame.unwrap()));
        assert!(!narrow.is_blank && digest(Pixels::U8(vec![7; 64])).is_blank);
    }

    #[test]
    fn what_a_file_does_not_state_keeps_no_copy_from_being_one() {
        let whole = identity(Some("a"), Some(3), Some(5));
        let bare = Identity::default();
        let other_time = identity(Some("a"), Some(3), Some(6));
        let other_camera = identity(Some("b"), Some(3), Some(5));
        let frames = [
            ("d/x.png", bare, noise(1)),
            ("e/x (1).fits", whole.clone(), noise(1)),
            ("e/x.fits", whole.clone(), noise(1)),
            ("f/x.fits", other_time, noise(1)),
            ("f/y.fits", other_camera, noise(1)),
            ("f/z.fits", whole, noise(2)),
        ];
        let found = found(&frames);
        assert_eq!(found.of, [Some(2), Some(2), None, None, None, None]);
        assert_eq!(found.contradicting, [[2, 5]]);
    }

    #[test]
    fn blank_frames_are_copies_only_where_their_files_say_so() {
        let blank = digest(Pixels::U8(vec![0; 64]));
        let stated = identity(None, Some(3), Some(5));
        let unnumbered = identity(None, None, Some(5));
        let frames = [
            ("a.fits", unnumbered.clone(), blank),
            ("b.fits", unnumbered, blank),
            ("c.fits", stated.clone(), blank),
            ("d.fits", stated, blank),
        ];
        assert_eq!(copies(&frames), [None, None, None, Some(2)]);
    }

    #[test]
    fn only_frames_that_may_be_copies_are_to_be_decoded() {
        let at = |number, utc_ns| identity(Some("a"), Some(number), Some(utc_ns));
        let all = [at(1, 1), at(2, 2), at(2, 3), at(3, 2), at(1, 1)];
        let marks = |all: &[Identity]| may_be_copies(&all.iter().map(Some).collect::<Vec<_>>());
        assert_eq!(marks(&all), [true, false, false, false, true]);
        let other_camera = identity(Some("b"), Some(2), Some(2));
        assert_eq!(marks(&[at(2, 2), other_camera]), [false, false]);
        let timeless = identity(None, Some(2), None);
        assert_eq!(marks(&[at(2, 2), timeless, at(3, 3)]), [true, true, false]);
        assert_eq!(marks(&[at(2, 2), Identity::default()]), [true, true]);
    }
}
