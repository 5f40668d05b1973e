//! Tables of an attitude: attitude.csv, attitude.fits, attitude.aem.

use crate::columns::{self, Column, Widths, float, text};
use crate::fits::zero_cards;
use crate::navigation::aem::{Aem, Head, Stretches};
use crate::navigation::{NavigationRow, PropagatedOffset, Status};
use anyhow::Context;
use jiff::Timestamp;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

/// The columns of the table ATTITUDE.
#[rustfmt::skip]
const COLUMNS: &[Column<NavigationRow>] = &[
    float("t_s", "s", "time since the epoch", |r| Some(r.t_s)),
    float("q0", "", "scalar: v_ecef = R(q) v_body", |r| Some(numbers(r)?[0])),
    float("q1", "", "x", |r| Some(numbers(r)?[1])),
    float("q2", "", "y", |r| Some(numbers(r)?[2])),
    float("q3", "", "z", |r| Some(numbers(r)?[3])),
    float("sx_rad", "rad", "1 sigma about the ECEF x axis", |r| Some(numbers(r)?[4])),
    float("sy_rad", "rad", "1 sigma about the ECEF y axis", |r| Some(numbers(r)?[5])),
    float("sz_rad", "rad", "1 sigma about the ECEF z axis", |r| Some(numbers(r)?[6])),
    float("pxy_rad2", "rad2", "covariance", |r| Some(numbers(r)?[7])),
    float("pxz_rad2", "rad2", "covariance", |r| Some(numbers(r)?[8])),
    float("pyz_rad2", "rad2", "covariance", |r| Some(numbers(r)?[9])),
    float("x_m", "m", "ECEF", |r| Some(numbers(r)?[10])),
    float("y_m", "m", "ECEF", |r| Some(numbers(r)?[11])),
    float("z_m", "m", "ECEF", |r| Some(numbers(r)?[12])),
    float("vx_m_s", "m/s", "against the turning Earth", |r| Some(numbers(r)?[13])),
    float("vy_m_s", "m/s", "against the turning Earth", |r| Some(numbers(r)?[14])),
    float("vz_m_s", "m/s", "against the turning Earth", |r| Some(numbers(r)?[15])),
    text("status", "docs/navigation.md", |r| r.status.name().into()),
];

/// The numbers of a row after its time; `None` before the filter has started.
fn numbers(row: &NavigationRow) -> Option<[f64; 16]> {
    let (motion, covariance) = row.attitude.as_ref()?;
    let [w, i, j, k] = motion.quaternion();
    let sigma = |n: usize| covariance[(n, n)].max(0.0).sqrt();
    let (at, v) = (&motion.position_m, &motion.velocity_m_s);
    #[rustfmt::skip]
    let numbers = [
        w, i, j, k,
        sigma(0), sigma(1), sigma(2),
        covariance[(0, 1)], covariance[(0, 2)], covariance[(1, 2)],
        at.x, at.y, at.z, v.x, v.y, v.z,
    ];
    Some(numbers)
}

/// Writes `attitude.csv`.
pub fn write_csv(
    path: &Path,
    mut rows: impl Iterator<Item = std::io::Result<NavigationRow>>,
) -> anyhow::Result<()> {
    write_file(path, |file| {
        let names: Vec<&str> = COLUMNS.iter().map(|column| column.name).collect();
        writeln!(file, "{}", names.join(","))?;
        rows.try_for_each(|row| write_row(file, &row?))
    })
}

/// Writes `offsets.csv`.
pub fn write_offsets(
    path: &Path,
    mut rows: impl Iterator<Item = std::io::Result<NavigationRow>>,
    mut offset: impl FnMut(&NavigationRow) -> Option<PropagatedOffset>,
) -> anyhow::Result<()> {
    write_file(path, |file| {
        let names = PropagatedOffset::COLUMNS.join(",");
        writeln!(file, "t_s,{names},status")?;
        rows.try_for_each(|row| {
            let row = row?;
            let cells = offset(&row).map_or_else(Default::default, |offset| offset.cells());
            let status = row.status.name();
            writeln!(file, "{},{},{status}", row.t_s, cells.join(","))
        })
    })
}

fn write_row(file: &mut impl Write, row: &NavigationRow) -> std::io::Result<()> {
    write!(file, "{}", row.t_s)?;
    let Some(numbers) = numbers(row) else {
        return writeln!(file, ",,,,,,,,,,,,,,,,,{}", row.status.name());
    };
    for value in &numbers[..4] {
        write!(file, ",{value:.15}")?;
    }
    for value in &numbers[4..10] {
        write!(file, ",{value:.14e}")?;
    }
    for value in &numbers[10..13] {
        write!(file, ",{value:.4}")?;
    }
    for value in &numbers[13..] {
        write!(file, ",{value:.6}")?;
    }
    writeln!(file, ",{}", row.status.name())
}

/// Writes `attitude.fits`: the table ATTITUDE.
pub fn write_fits(
    path: &Path,
    epoch: Option<Timestamp>,
    rows: impl Iterator<Item = std::io::Result<NavigationRow>>,
) -> anyhow::Result<()> {
    let cards = epoch.map(zero_cards).unwrap_or_default();
    let longest = Status::ALL
        .map(|status| status.name().len())
        .into_iter()
        .max();
    let widths = Widths::of(COLUMNS, longest.unwrap_or(1));
    columns::write_tables(path, &cards, |file| {
        let rows = rows.map(|row| row.map_err(|cause| columns::refused(path, cause)));
        columns::write_fits(file, "ATTITUDE", COLUMNS, &widths, rows)
    })?;
    Ok(())
}

/// Writes `attitude.aem`.
pub fn write_aem(
    path: &Path,
    epoch: Timestamp,
    stretches: Stretches,
    mut rows: impl Iterator<Item = std::io::Result<NavigationRow>>,
) -> anyhow::Result<()> {
    let head = Head {
        epoch,
        created: Timestamp::now(),
        object: "SOLASPECT",
    };
    write_file(path, |file| {
        let mut message = Aem::begin(file, head, stretches)?;
        rows.try_for_each(|row| message.add(&row?))?;
        message.finish()
    })
}

/// Writes a file through a buffer.
fn write_file(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> std::io::Result<()>,
) -> anyhow::Result<()> {
    let written = File::create(path).and_then(|file| {
        let mut file = BufWriter::with_capacity(1 << 20, file);
        write(&mut file)?;
        file.flush()
    });
    written.with_context(|| format!("{}: cannot write", path.display()))
}
