//! The samples of an IMU in runs, each on one clock and without gaps.

use super::parts::{Late, Part, parts, usual_step_s, without_overlaps};
use super::{FileRows, IMU, read_files, read_table};
use crate::navigation::measurement::ImuSample;
use crate::navigation::settings::NavigationSettings;
use crate::tables::{BadRow, Kind, LeftOut, TableError};
use std::path::{Path, PathBuf};

/// Maximum number of lost samples within a run.
const MOST_MISSING: f64 = 10.0;

/// The samples of a flight's files, in the order of time, in runs. A run ends where more than ten samples are missing, and
/// where the clock was set.
///
/// # Errors
/// File, line and column, if a file cannot be read, or if it has fewer than two valid samples.
pub fn read_imu(
    paths: &[PathBuf],
    settings: &NavigationSettings,
) -> Result<Vec<Vec<ImuSample>>, TableError> {
    let tables = read_files(paths, |path| read_samples(path, settings))?;
    let (mut all, mut left_out) = (Vec::new(), Vec::new());
    for (file, (rows, mut bad)) in tables.into_iter().enumerate() {
        let of_file = parts(rows, Late::LeftOut, &mut bad).into_iter();
        all.extend(of_file.map(|rows| Part {
            file,
            rows,
            is_trimmed: false,
        }));
        left_out.push(bad);
    }
    // Without a step between two samples the length of an interval is unknown.
    let steps = all.iter().filter_map(|part| usual_step_s(&part.rows));
    let mut steps: Vec<f64> = steps.collect();
    steps.sort_by(f64::total_cmp);
    let all = without_overlaps(all, &mut left_out);
    left_out.iter().for_each(LeftOut::warn);
    let Some(usual_s) = steps.get(steps.len() / 2) else {
        let path = paths.first().map_or(Path::new(""), PathBuf::as_path);
        let rows: usize = all.iter().map(|part| part.rows.len()).sum();
        let error = BadRow::new(Kind::Cut, "table", "two rows or more", rows);
        return Err(error.at(path, 1));
    };
    Ok(runs(all, MOST_MISSING * usual_s))
}

/// Successive parts in different files form one run; a run ends at each gap longer than `most_s`.
fn runs(parts: Vec<Part<ImuSample>>, most_s: f64) -> Vec<Vec<ImuSample>> {
    let mut runs: Vec<Vec<ImuSample>> = Vec::new();
    let mut before: Option<(usize, bool)> = None;
    for part in parts {
        let end_of = |run: &Vec<ImuSample>| run.last().map_or(f64::NEG_INFINITY, |last| last.t_s);
        let last_s = runs.last().map_or(f64::NEG_INFINITY, end_of);
        let first_s = part.rows.first().map_or(f64::INFINITY, |row| row.value.t_s);
        let follows =
            before
                .replace((part.file, part.is_trimmed))
                .is_some_and(|(file, is_trimmed)| {
                    file != part.file
                        && !is_trimmed
                        && !part.is_trimmed
                        && first_s - last_s <= most_s
                });
        let samples: Vec<ImuSample> = part.rows.into_iter().map(|row| row.value).collect();
        match runs.last_mut().filter(|_| follows) {
            Some(run) => run.extend(samples),
            None => runs.push(samples),
        }
    }
    let runs = runs.into_iter().flat_map(|run| at_gaps(run, most_s));
    // A single sample has no interval.
    runs.filter(|run| run.len() > 1).collect()
}

fn at_gaps(mut run: Vec<ImuSample>, most_s: f64) -> Vec<Vec<ImuSample>> {
    let steps = run.windows(2).map(|pair| pair[1].t_s - pair[0].t_s);
    let gaps = steps.enumerate().filter(|(_, step_s)| *step_s > most_s);
    let gaps: Vec<usize> = gaps.map(|(before, _)| before + 1).collect();
    let later = gaps.into_iter().rev().map(|at| run.split_off(at));
    let mut pieces: Vec<Vec<ImuSample>> = later.collect();
    pieces.push(run);
    pieces.reverse();
    pieces
}

fn read_samples(
    path: &Path,
    settings: &NavigationSettings,
) -> Result<FileRows<ImuSample>, TableError> {
    read_table(path, IMU, |row| {
        let sample = ImuSample {
            t_s: row.time_s()? - settings.imu.delay_s,
            force_m_s2: row.vector(1)?,
            rate_rad_s: row.vector(4)?,
            time_step_s: 0.0,
        };
        sample.check(&settings.imu)?;
        Ok(sample)
    })
}
