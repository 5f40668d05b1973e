//! Matching of the frames of two cameras.

use crate::fits;
use anyhow::ensure;
use jiff::Timestamp;
use std::collections::VecDeque;
use std::path::{Path, PathBuf};

/// Largest difference in time between the frames of a pair.
const TOGETHER_S: f64 = 0.010;

/// The frames of each camera: those whose name begins like its file's; without such names, the first half belong to the first camera.
pub(super) fn by_camera(
    frames: &[PathBuf],
    cameras: &[PathBuf],
) -> anyhow::Result<[Vec<PathBuf>; 2]> {
    // If several names match, the longest one counts.
    let camera_of = |frame: &PathBuf| {
        let name = frame.file_name()?.to_string_lossy().into_owned();
        let stem = |n: &usize| cameras[*n].file_stem().map(|stem| stem.to_string_lossy());
        let begins = |n: &usize| stem(n).is_some_and(|stem| name.starts_with(&*stem));
        (0..cameras.len())
            .filter(begins)
            .max_by_key(|n| stem(n).map(|stem| stem.len()))
    };
    let owners: Vec<Option<usize>> = frames.iter().map(camera_of).collect();
    if owners.iter().any(Option::is_some) {
        if let Some(stray) = owners.iter().position(Option::is_none) {
            anyhow::bail!(
                "{}: expected a name that begins as one camera's file does, as others do",
                frames[stray].display()
            );
        }
        let of = |camera: usize| {
            let own = frames
                .iter()
                .zip(&owners)
                .filter(|(_, owner)| **owner == Some(camera));
            own.map(|(frame, _)| frame.clone()).collect()
        };
        return Ok([0, 1].map(of));
    }
    ensure!(
        frames.len().is_multiple_of(2),
        "--pair: expected as many frames of the first camera as of the second after them, or names that begin with their camera's, \
         found {} frames",
        frames.len()
    );
    let (first, second) = frames.split_at(frames.len() / 2);
    Ok([first.to_vec(), second.to_vec()])
}

/// The frames of two cameras by moments, with each camera's frame at its index.
pub(super) fn matched(frames: [&[PathBuf]; 2]) -> Vec<[Option<PathBuf>; 2]> {
    let [first, second] = frames;
    let times = |frames: &[PathBuf]| -> Vec<Option<Timestamp>> {
        frames.iter().map(|path| time(path)).collect()
    };
    let (one, other) = (times(first), times(second));
    let has_times = |times: &[Option<Timestamp>]| times.iter().any(Option::is_some);
    let pairs = match has_times(&one) && has_times(&other) {
        true => by_time(&one, &other),
        false => by_order(first.len(), second.len()),
    };
    let frame = |frames: &[PathBuf], n: Option<usize>| n.map(|n| frames[n].clone());
    pairs
        .into_iter()
        .map(|[one, other]| [frame(first, one), frame(second, other)])
        .collect()
}

/// Time of a frame; `None` for a file that cannot be read, and for a picture without a time.
fn time(path: &Path) -> Option<Timestamp> {
    fits::read_info(path).ok()?.0.mid_exposure
}

fn by_order(first: usize, second: usize) -> Vec<[Option<usize>; 2]> {
    let has = |n: usize, count: usize| (n < count).then_some(n);
    (0..first.max(second))
        .map(|n| [has(n, first), has(n, second)])
        .collect()
}

/// The moments in order; then the frames without a time, each alone.
fn by_time(first: &[Option<Timestamp>], second: &[Option<Timestamp>]) -> Vec<[Option<usize>; 2]> {
    let timed = |times: &[Option<Timestamp>]| {
        let with_time = |(n, time): (usize, &Option<Timestamp>)| Some(((*time)?, n));
        let mut timed: VecDeque<(Timestamp, usize)> =
            times.iter().enumerate().filter_map(with_time).collect();
        timed.make_contiguous().sort();
        timed
    };
    let (mut ones, mut others) = (timed(first), timed(second));
    let mut pairs: Vec<[Option<usize>; 2]> = Vec::new();
    while let (Some((one, n)), Some((other, m))) = (ones.front(), others.front()) {
        let (n, m) = (*n, *m);
        let after_s = other.duration_since(*one).as_secs_f64();
        let takes = [after_s >= -TOGETHER_S, after_s <= TOGETHER_S];
        pairs.push([takes[0].then_some(n), takes[1].then_some(m)]);
        if takes[0] {
            ones.pop_front();
        }
        if takes[1] {
            others.pop_front();
        }
    }
    let untimed = |times: &[Option<Timestamp>]| {
        let without = |n: &usize| times[*n].is_none();
        (0..times.len()).filter(without).collect::<Vec<_>>()
    };
    let alone = ones.into_iter().map(|(_, n)| n).chain(untimed(first));
    pairs.extend(alone.map(|n| [Some(n), None]));
    let alone = others.into_iter().map(|(_, m)| m).chain(untimed(second));
    pairs.extend(alone.map(|m| [None, Some(m)]));
    pairs
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: &[i64]) -> Vec<Option<Timestamp>> {
        ms.iter()
            .map(|ms| Some(Timestamp::from_millisecond(*ms).unwrap()))
            .collect()
    }

    #[test]
    fn frames_within_ten_milliseconds_are_a_pair_and_others_stand_alone() {
        let pairs = by_time(&at(&[0, 100, 200]), &at(&[8, 111, 199]));
        assert_eq!(
            pairs,
            [
                [Some(0), Some(0)],
                [Some(1), None],
                [None, Some(1)],
                [Some(2), Some(2)],
            ]
        );
    }

    #[test]
    fn frames_belong_to_the_camera_that_their_names_begin_with_or_come_in_halves() {
        let paths = |names: &[&str]| -> Vec<PathBuf> { names.iter().map(PathBuf::from).collect() };
        let cameras = paths(&["x/left.toml", "x/right.toml"]);
        let named = paths(&["right_0.png", "left_0.png", "left_1.png"]);
        let by_name = by_camera(&named, &cameras).unwrap();
        assert_eq!(
            by_name,
            [
                paths(&["left_0.png", "left_1.png"]),
                paths(&["right_0.png"])
            ]
        );
        let halves = by_camera(&paths(&["a", "b", "c", "d"]), &cameras).unwrap();
        assert_eq!(halves, [paths(&["a", "b"]), paths(&["c", "d"])]);
        let alike = paths(&["cam.toml", "cam2.toml"]);
        let by_name = by_camera(&paths(&["cam2_0.png", "cam_0.png"]), &alike).unwrap();
        assert_eq!(by_name, [paths(&["cam_0.png"]), paths(&["cam2_0.png"])]);
        assert!(by_camera(&paths(&["left_0.png", "stray.png"]), &cameras).is_err());
        let untimed = [None, at(&[100])[0]];
        assert_eq!(
            by_time(&untimed, &at(&[101])),
            [[Some(1), Some(0)], [Some(0), None]]
        );
        assert!(by_camera(&paths(&["a", "b", "c"]), &cameras).is_err());
    }
}
