//! Which frames of two cameras belong together.

use crate::fits;
use anyhow::ensure;
use jiff::Timestamp;
use std::path::{Path, PathBuf};

/// Frames taken within this time of each other make a pair.
const TOGETHER_S: f64 = 0.010;

/// The frames of each camera: those whose name begins as its file's does; else the first half are of the first one.
pub(super) fn by_camera(
    frames: &[PathBuf],
    cameras: &[PathBuf],
) -> anyhow::Result<Vec<Vec<PathBuf>>> {
    let begins = |frame: &Path, camera: &Path| {
        let (frame, camera) = (frame.file_name(), camera.file_stem());
        frame.zip(camera).is_some_and(|(frame, camera)| {
            frame
                .to_string_lossy()
                .starts_with(&*camera.to_string_lossy())
        })
    };
    let is_named = |frame: &PathBuf| {
        cameras
            .iter()
            .filter(|camera| begins(frame, camera))
            .count()
            == 1
    };
    if frames.iter().all(is_named) {
        let of = |camera: &PathBuf| {
            frames
                .iter()
                .filter(|frame| begins(frame, camera))
                .cloned()
                .collect()
        };
        return Ok(cameras.iter().map(of).collect());
    }
    ensure!(
        frames.len().is_multiple_of(2),
        "--pair: expected as many frames of the first camera as of the second after them, or names that begin with their camera's, \
         found {} frames",
        frames.len()
    );
    let (first, second) = frames.split_at(frames.len() / 2);
    Ok(vec![first.to_vec(), second.to_vec()])
}

/// The frames of two cameras by the moments they belong to, each camera's at its place.
pub(super) fn matched(frames: [&[PathBuf]; 2]) -> Vec<[Option<PathBuf>; 2]> {
    let [first, second] = frames;
    let times = |frames: &[PathBuf]| -> Option<Vec<Timestamp>> {
        frames.iter().map(|path| time(path)).collect()
    };
    let pairs = match (times(first), times(second)) {
        (Some(one), Some(other)) => by_time(&one, &other),
        _ => by_order(first.len(), second.len()),
    };
    let frame = |frames: &[PathBuf], n: Option<usize>| n.map(|n| frames[n].clone());
    pairs
        .into_iter()
        .map(|[one, other]| [frame(first, one), frame(second, other)])
        .collect()
}

/// When a frame was taken; of a file that cannot be read, and of a picture, nothing is known.
fn time(path: &Path) -> Option<Timestamp> {
    fits::read_info(path).ok()?.0.mid_exposure
}

fn by_order(first: usize, second: usize) -> Vec<[Option<usize>; 2]> {
    let has = |n: usize, count: usize| (n < count).then_some(n);
    (0..first.max(second))
        .map(|n| [has(n, first), has(n, second)])
        .collect()
}

/// Each frame of the first camera with the nearest one of the second that is still free; then those that are left.
fn by_time(first: &[Timestamp], second: &[Timestamp]) -> Vec<[Option<usize>; 2]> {
    let mut free: Vec<usize> = (0..second.len()).collect();
    let mut pairs: Vec<[Option<usize>; 2]> = Vec::new();
    for (n, time) in first.iter().enumerate() {
        let apart_s = |m: usize| second[m].duration_since(*time).as_secs_f64().abs();
        let nearest =
            (0..free.len()).min_by(|a, b| apart_s(free[*a]).total_cmp(&apart_s(free[*b])));
        let partner = nearest.filter(|at| apart_s(free[*at]) <= TOGETHER_S);
        pairs.push([Some(n), partner.map(|at| free.remove(at))]);
    }
    pairs.extend(free.into_iter().map(|m| [None, Some(m)]));
    pairs
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: &[i64]) -> Vec<Timestamp> {
        ms.iter()
            .map(|ms| Timestamp::from_millisecond(*ms).unwrap())
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
                [Some(2), Some(2)],
                [None, Some(1)]
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
        assert!(by_camera(&paths(&["a", "b", "c"]), &cameras).is_err());
    }
}
