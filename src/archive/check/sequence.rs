//! Files as a sequence: times that decrease, and gaps.
//!
//! A sequence is the files of one instrument: their names have the same beginning, up to the time. A bad file still represents its
//! frame, so it makes no gap; nor does a frame that is on another disk, nor a file that exists twice. Frames may be numbered from the start again, as
//! after a power cut.

use super::BadFile;
use super::logged::Elsewhere;
use jiff::Timestamp;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;

/// Ratio of a step between frames to the median step beyond which it is a gap.
const LONGEST_STEP: f64 = 1.5;

/// Frames that are missing between two files.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Gap {
    /// The file before the gap.
    pub after: String,
    /// The file after the gap.
    pub before: String,
    pub step_s: f64,
    pub median_step_s: f64,
    /// Number of missing frames by their numbers, if frames have them.
    pub missing_frames: u64,
}

/// A file in its sequence.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Dated {
    file: String,
    /// The name without folder and ending, by which files are sorted.
    stem: String,
    /// Time and number of the frame; `None` for a bad file.
    taken: Option<(Timestamp, Option<u64>)>,
    /// Whether the file itself was read, rather than only its row of the log.
    is_here: bool,
}

impl Dated {
    pub fn sound(path: &Path, utc: Timestamp, number: Option<u64>) -> Self {
        Self {
            taken: Some((utc, number)),
            ..Self::bad(path)
        }
    }

    /// A frame on a disk that is not available.
    pub fn elsewhere(frame: &Elsewhere) -> Option<Self> {
        Some(Self {
            taken: Some((frame.utc?, frame.number)),
            is_here: false,
            ..Self::bad(&frame.file)
        })
    }

    pub fn bad(path: &Path) -> Self {
        Self {
            file: path.display().to_string(),
            stem: path
                .file_stem()
                .unwrap_or_default()
                .to_string_lossy()
                .into(),
            taken: None,
            is_here: true,
        }
    }

    /// The name up to the time.
    fn series(&self) -> &str {
        self.stem.split('_').next().unwrap_or_default()
    }
}

/// Findings about the sequences of an archive.
#[derive(Debug, Default)]
pub(super) struct Sequence {
    pub backward: Vec<BadFile>,
    pub gaps: Vec<Gap>,
    pub first: Option<Timestamp>,
    pub last: Option<Timestamp>,
}

/// Examines the files of all sequences, in any order.
pub(super) fn examine(files: Vec<Dated>) -> Sequence {
    let mut all: BTreeMap<String, Vec<Dated>> = BTreeMap::new();
    for file in files {
        all.entry(file.series().into()).or_default().push(file);
    }
    let mut found = Sequence::default();
    for files in all.values_mut() {
        // If a frame is on two disks, a sound file represents both.
        files.sort_by(|a, b| (&a.stem, a.taken.is_none()).cmp(&(&b.stem, b.taken.is_none())));
        files.dedup_by(|b, a| a.stem == b.stem);
        found.backward.extend(take_backward(files));
        found.gaps.extend(gaps(files));
        let here = || files.iter().filter(|file| file.is_here);
        let times = || here().filter_map(|file| Some(file.taken?.0));
        found.first = found.first.into_iter().chain(times()).min();
        found.last = found.last.into_iter().chain(times()).max();
    }
    found
}

/// The files whose time is before that of the previous file; from here on they count as bad.
fn take_backward(files: &mut [Dated]) -> Vec<BadFile> {
    let mut backward = Vec::new();
    let mut previous: Option<(Timestamp, String)> = None;
    for file in files.iter_mut().filter(|file| file.is_here) {
        let Some((utc, _)) = file.taken else {
            continue;
        };
        if let Some((before, name)) = &previous
            && utc < *before
        {
            backward.push(BadFile {
                file: file.file.clone(),
                error: format!(
                    "DATE-AVG: expected a time not before {before:.3} of {name}, found {utc:.3}"
                ),
            });
            file.taken = None;
        }
        previous = Some((utc, file.stem.clone()));
    }
    backward
}

/// Two successive sound files.
struct Step<'a> {
    from: &'a Dated,
    to: &'a Dated,
    seconds: f64,
    /// Frames from one to the other by their numbers; `None` if unknown or if the numbers restarted.
    frames: Option<u64>,
    /// Bad files between them.
    bad: u32,
}

fn gaps(files: &[Dated]) -> Vec<Gap> {
    let steps = steps(files);
    let mut direct: Vec<f64> = steps
        .iter()
        .filter(|step| step.bad == 0)
        .map(|step| step.seconds)
        .collect();
    let median = median(&mut direct);
    let gap = |step: &Step| {
        let missing = step
            .frames
            .map_or(0, |frames| frames.saturating_sub(1 + u64::from(step.bad)));
        let long = median
            .is_some_and(|median| step.seconds > (f64::from(step.bad) + LONGEST_STEP) * median);
        (long || missing > 0).then(|| Gap {
            after: step.from.file.clone(),
            before: step.to.file.clone(),
            step_s: step.seconds,
            median_step_s: median.unwrap_or(step.seconds),
            missing_frames: missing,
        })
    };
    steps.iter().filter_map(gap).collect()
}

fn steps(files: &[Dated]) -> Vec<Step<'_>> {
    let mut steps = Vec::new();
    let mut bad = 0;
    let mut last: Option<(&Dated, Timestamp, Option<u64>)> = None;
    for to in files {
        let Some((utc, number)) = to.taken else {
            bad += 1;
            continue;
        };
        if let Some((from, before, number_before)) = last {
            steps.push(Step {
                from,
                to,
                seconds: utc.duration_since(before).as_secs_f64(),
                frames: number
                    .zip(number_before)
                    .and_then(|(n, m)| n.checked_sub(m)),
                bad,
            });
        }
        bad = 0;
        last = Some((to, utc, number));
    }
    steps
}

/// The median; for an even number of values, the mean of the two in the middle.
fn median(values: &mut [f64]) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    match values.len() {
        0 => None,
        n if n % 2 == 1 => Some(values[middle]),
        _ => Some((values[middle - 1] + values[middle]) / 2.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Files named by their place in the order, each with its time in s and number; `None` for a bad one.
    fn files(taken: &[Option<(i64, u64)>]) -> Vec<Dated> {
        let file = |(n, taken): (usize, &Option<(i64, u64)>)| {
            let path = format!("pyas_{n:03}.fits");
            match taken {
                Some((second, number)) => {
                    let utc = Timestamp::from_second(*second).unwrap();
                    Dated::sound(Path::new(&path), utc, Some(*number))
                }
                None => Dated::bad(Path::new(&path)),
            }
        };
        taken.iter().enumerate().map(file).collect()
    }

    fn gaps_and_backward(taken: &[Option<(i64, u64)>]) -> (usize, usize) {
        let found = examine(files(taken));
        (found.gaps.len(), found.backward.len())
    }

    #[test]
    fn steady_frames_have_no_gap_and_a_bad_file_makes_none() {
        let mut taken: Vec<_> = (0..6).map(|n| Some((2 * n, n as u64))).collect();
        assert_eq!(gaps_and_backward(&taken), (0, 0));
        taken[3] = None;
        assert_eq!(gaps_and_backward(&taken), (0, 0));
        taken.remove(3);
        assert_eq!(gaps_and_backward(&taken), (1, 0));
    }

    #[test]
    fn a_missing_number_is_a_gap_without_a_long_step_and_a_new_count_is_none() {
        let jumped = [Some((0, 0)), Some((1, 1)), Some((2, 3)), Some((3, 4))];
        let found = examine(files(&jumped));
        assert_eq!(found.gaps.len(), 1);
        assert_eq!(found.gaps[0].missing_frames, 1);
        let again = [Some((0, 7)), Some((1, 8)), Some((2, 0)), Some((3, 1))];
        assert_eq!(gaps_and_backward(&again), (0, 0));
    }

    #[test]
    fn a_long_step_is_one_beyond_one_and_a_half_medians() {
        let at = |last: i64| [Some((0, 0)), Some((2, 1)), Some((4, 2)), Some((last, 3))];
        assert_eq!(gaps_and_backward(&at(7)), (0, 0));
        assert_eq!(gaps_and_backward(&at(8)), (1, 0));
    }

    #[test]
    fn a_time_that_goes_back_is_that_files_fault_and_no_gap() {
        let taken = [
            Some((4, 0)),
            Some((5, 1)),
            Some((1, 2)),
            Some((7, 3)),
            Some((8, 4)),
        ];
        assert_eq!(gaps_and_backward(&taken), (0, 1));
    }
}
