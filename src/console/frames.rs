//! Requests concerning the frames of an archive.

use super::history::{FrameRow, History};
use super::request::{Answer, Asked, Console, Failure, attachment, beside, png, time};
use super::table::Nanoseconds;
use super::view::utc;
use crate::fits;
use crate::frame::Frame;
use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::Response;
use serde::Deserialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;

const COUNT: usize = 50;
const MOST: usize = 500;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ListQuery {
    quality: Option<String>,
    /// Beginning of the reason.
    reason: Option<String>,
    before: Option<String>,
    count: Option<usize>,
}

/// The frames, the latest first, with their numbers by quality and reason.
pub async fn list(State(console): State<Console>, query: Asked<ListQuery>) -> Answer<Json<Value>> {
    let query = query.0;
    let before = time("before", query.before.as_ref())?.unwrap_or(Nanoseconds::MAX);
    let count = query.count.unwrap_or(COUNT).min(MOST);
    beside(move || {
        let history = console.shared().history();
        let reason = |frame: &FrameRow| {
            history
                .reasons
                .get(usize::from(frame.reason?))
                .map(String::as_str)
        };
        let is_asked_for = |frame: &&FrameRow| {
            let quality = query
                .quality
                .as_deref()
                .is_none_or(|quality| quality == frame.quality);
            quality
                && query
                    .reason
                    .as_deref()
                    .is_none_or(|asked| reason(frame).is_some_and(|words| words.starts_with(asked)))
        };
        let asked_for = || history.frames.iter().filter(is_asked_for);
        let shown = asked_for()
            .rev()
            .filter(|frame| frame.time < before)
            .take(count);
        let row = |frame: &FrameRow| {
            json!({
                "file": (!frame.file.is_empty()).then_some(&frame.file),
                "camera": frame.camera,
                "utc": utc(frame.time),
                "quality": frame.quality,
                "reason": reason(frame),
            })
        };
        Ok(Json(json!({
            "total": asked_for().count(),
            "by_quality": by_quality(&history),
            "by_reason": by_reason(&history),
            "frames": shown.map(row).collect::<Vec<_>>(),
        })))
    })
    .await
}

fn by_quality(history: &History) -> Value {
    let count = |quality: &str| {
        history
            .frames
            .iter()
            .filter(|frame| frame.quality == quality)
            .count()
    };
    json!({"fine": count("fine"), "coarse": count("coarse"), "none": count("none")})
}

/// The most frequent reason first.
fn by_reason(history: &History) -> Vec<Value> {
    let mut counts: BTreeMap<u16, u64> = BTreeMap::new();
    for reason in history.frames.iter().filter_map(|frame| frame.reason) {
        *counts.entry(reason).or_default() += 1;
    }
    let mut counts: Vec<(u16, u64)> = counts.into_iter().collect();
    counts.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
    let row = |(reason, count): &(u16, u64)| {
        let words = &history.reasons[usize::from(*reason)];
        let stage = words.split(':').next();
        json!({"reason": words, "stage": stage, "count": count})
    };
    counts.iter().map(row).collect()
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FileQuery {
    file: String,
    overlay: Option<u8>,
}

/// A file named in a log; any other file is rejected.
fn named(console: &Console, file: &str) -> Answer<String> {
    let history = console.shared().history();
    let is_named = !file.is_empty() && history.frames.iter().any(|frame| &*frame.file == file);
    let unknown = || {
        Failure::missing(format!(
            "file: expected one of the solution log, found \"{file}\""
        ))
    };
    is_named.then(|| file.to_owned()).ok_or_else(unknown)
}

/// A frame as a picture.
pub async fn picture(State(console): State<Console>, query: Asked<FileQuery>) -> Answer<Response> {
    let FileQuery { file, overlay } = query.0;
    let file = named(&console, &file)?;
    let frame = console.read(file.clone(), read_frame).await?;
    let _turn = console.turn().await?;
    beside(move || {
        let ground = &console.parts().ground;
        let drawn = ground.frame(&frame, &file, overlay == Some(1));
        png(&drawn.map_err(|error| Failure(StatusCode::CONFLICT, format!("{error:#}")))?)
    })
    .await
}

/// Reads a frame of the archive.
pub fn read_frame(path: &Path) -> anyhow::Result<Frame> {
    Ok(fits::read_frame(path)?)
}

/// A frame's file unchanged.
pub async fn file(State(console): State<Console>, query: Asked<FileQuery>) -> Answer<Response> {
    let file = named(&console, &query.0.file)?;
    let bytes = console.read(file.clone(), |path| Ok(std::fs::read(path)?));
    let bytes = bytes.await?;
    let name = Path::new(&file).file_name().unwrap_or_default();
    Ok(attachment(
        "application/fits",
        &name.to_string_lossy(),
        bytes,
    ))
}
