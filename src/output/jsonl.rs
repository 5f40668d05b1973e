//! A solved frame as a JSON object on one line: that of `solaspect solve`, with the camera and the frame's number.

use super::Report;
use crate::record::Record;
use serde::Serialize;

#[derive(Serialize)]
struct Line<'a> {
    camera: &'a str,
    /// Number of the frame in its sequence, if the camera counts frames.
    frame: Option<u64>,
    #[serde(flatten)]
    record: &'a Record,
}

/// The line, including its end.
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
