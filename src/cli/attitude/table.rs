//! The tables that an attitude is written to: attitude.csv, attitude.fits, attitude.aem.

use crate::fits::{Card, Column, Table, Values, encode_tables, format_time};
use crate::navigation::aem::{Aem, Head, Stretches};
use crate::navigation::{PropagatedOffset, Row};
use anyhow::Context;
use jiff::Timestamp;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

/// Name, unit and meaning of the columns; the status follows.
const COLUMNS: [(&str, &str, &str); 17] = [
    ("t_s", "s", "time since the epoch"),
    ("q0", "", "scalar: v_ecef = R(q) v_body"),
    ("q1", "", "x"),
    ("q2", "", "y"),
    ("q3", "", "z"),
    ("sx_rad", "rad", "1 sigma about the ECEF x axis"),
    ("sy_rad", "rad", "1 sigma about the ECEF y axis"),
    ("sz_rad", "rad", "1 sigma about the ECEF z axis"),
    ("pxy_rad2", "rad2", "covariance"),
    ("pxz_rad2", "rad2", "covariance"),
    ("pyz_rad2", "rad2", "covariance"),
    ("x_m", "m", "ECEF"),
    ("y_m", "m", "ECEF"),
    ("z_m", "m", "ECEF"),
    ("vx_m_s", "m/s", "against the turning Earth"),
    ("vy_m_s", "m/s", "against the turning Earth"),
    ("vz_m_s", "m/s", "against the turning Earth"),
];
const STATUS: &str = "status";

/// The numbers of a row after its time; `None` before the start.
fn numbers(row: &Row) -> Option<[f64; 16]> {
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
    mut rows: impl Iterator<Item = std::io::Result<Row>>,
) -> anyhow::Result<()> {
    write_file(path, |file| {
        let names = COLUMNS.map(|(name, ..)| name);
        writeln!(file, "{},{STATUS}", names.join(","))?;
        rows.try_for_each(|row| write_row(file, &row?))
    })
}

/// Writes `offsets.csv`.
pub fn write_offsets(
    path: &Path,
    mut rows: impl Iterator<Item = std::io::Result<Row>>,
    mut offset: impl FnMut(&Row) -> Option<PropagatedOffset>,
) -> anyhow::Result<()> {
    write_file(path, |file| {
        let names = PropagatedOffset::COLUMNS.join(",");
        writeln!(file, "t_s,{names},{STATUS}")?;
        rows.try_for_each(|row| {
            let row = row?;
            let cells = offset(&row).map_or_else(Default::default, |offset| offset.cells());
            let status = row.status.name();
            writeln!(file, "{},{},{status}", row.t_s, cells.join(","))
        })
    })
}

fn write_row(file: &mut impl Write, row: &Row) -> std::io::Result<()> {
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

/// Writes `attitude.fits`: the table ATTITUDE, in memory while it is made.
pub fn write_fits(
    path: &Path,
    epoch: Option<Timestamp>,
    count: u64,
    rows: impl Iterator<Item = std::io::Result<Row>>,
) -> anyhow::Result<()> {
    let mut columns: Vec<Vec<f64>> = Vec::new();
    columns.resize_with(COLUMNS.len(), || Vec::with_capacity(count as usize));
    let mut status = Vec::with_capacity(count as usize);
    for row in rows {
        let row = row.with_context(|| format!("{}: cannot write", path.display()))?;
        let numbers = numbers(&row).unwrap_or([f64::NAN; 16]);
        let cells = std::iter::once(row.t_s).chain(numbers);
        let pairs = columns.iter_mut().zip(cells);
        pairs.for_each(|(column, cell)| column.push(cell));
        status.push(row.status.name().to_owned());
    }
    let column = |(name, unit, meaning): (&str, &str, &str), values: Values| Column {
        name: name.into(),
        unit: unit.into(),
        meaning: meaning.into(),
        values,
    };
    let numbers = COLUMNS.into_iter().zip(columns);
    let numbers = numbers.map(|(head, values)| column(head, Values::Float(values)));
    let status = column((STATUS, "", "docs/navigation.md"), Values::Text(status));
    let table = Table {
        name: "ATTITUDE".into(),
        columns: numbers.chain([status]).collect(),
    };
    let dated = epoch.map(|epoch| Card::new("DATEREF", format_time(epoch)));
    let cards: Vec<Card> = dated.into_iter().collect();
    let bytes = encode_tables(count as usize * 160, &cards, [table])?;
    std::fs::write(path, bytes).with_context(|| format!("{}: cannot write", path.display()))
}

/// Writes `attitude.aem`.
pub fn write_aem(
    path: &Path,
    epoch: Timestamp,
    stretches: Stretches,
    mut rows: impl Iterator<Item = std::io::Result<Row>>,
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
