//! A solved frame as a JSON object on a line of its own: that of `solaspect solve`, with the camera and the frame's number.

use super::Report;
use crate::record::Record;
use serde::Serialize;

#[derive(Serialize)]
struct Line<'a> {
    camera: &'a str,
    /// Number of the frame in its sequence, where the camera counts.
    frame: Option<u64>,
    #[serde(flatten)]
    record: &'a Record,
}

/// The line, with its end.
pub(super) fn line(report: &Report) -> Option<Vec<u8>> {
    let line = Line {
        camera: &report.camera,
        frame: report.row.number,
        record: &report.row.record,
    };
    let mut bytes = serde_json::to_vec(&line).ok()?;
    bytes.push(b'\n');
    Some(bytes)
}
