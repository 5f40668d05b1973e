//! The pages and what belongs to them: part of the program, sent compressed.

use super::server::Failure;
use axum::http::{HeaderMap, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use flate2::Compression;
use flate2::write::GzEncoder;
use std::io::Write;
use std::sync::LazyLock;

const HTML: &str = "text/html; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const MODULE: &str = "text/javascript; charset=utf-8";

/// Address, type and text.
const FILES: &[(&str, &str, &str)] = &[
    ("/", HTML, include_str!("pages/now.html")),
    ("/plots", HTML, include_str!("pages/plots.html")),
    ("/commands", HTML, include_str!("pages/commands.html")),
    ("/frames", HTML, include_str!("pages/frames.html")),
    ("/style.css", CSS, include_str!("pages/style.css")),
    ("/alarms.js", MODULE, include_str!("pages/alarms.js")),
    ("/api.js", MODULE, include_str!("pages/api.js")),
    ("/chart.js", MODULE, include_str!("pages/chart.js")),
    ("/commands.js", MODULE, include_str!("pages/commands.js")),
    ("/dom.js", MODULE, include_str!("pages/dom.js")),
    ("/frames.js", MODULE, include_str!("pages/frames.js")),
    ("/header.js", MODULE, include_str!("pages/header.js")),
    ("/now.js", MODULE, include_str!("pages/now.js")),
    ("/plots.js", MODULE, include_str!("pages/plots.js")),
    ("/view.js", MODULE, include_str!("pages/view.js")),
];

/// The files, each compressed once.
static COMPRESSED: LazyLock<Vec<Vec<u8>>> = LazyLock::new(|| {
    let compressed = |text: &str| {
        let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
        let written = encoder.write_all(text.as_bytes());
        written.and_then(|()| encoder.finish()).unwrap_or_default()
    };
    FILES.iter().map(|(.., text)| compressed(text)).collect()
});

/// A page, or a part of one.
pub async fn page(uri: Uri, headers: HeaderMap) -> Response {
    if uri.path() == "/favicon.ico" {
        return StatusCode::NO_CONTENT.into_response();
    }
    let place = FILES.iter().position(|(path, ..)| *path == uri.path());
    let Some(place) = place else {
        return Failure::missing("there is no such page").into_response();
    };
    let (_, kind, text) = FILES[place];
    let accepted = headers
        .get(header::ACCEPT_ENCODING)
        .and_then(|value| value.to_str().ok());
    let kind = (header::CONTENT_TYPE, kind);
    // Asked for again with every start of a page: another program may be behind the address now.
    let cache = (header::CACHE_CONTROL, "no-cache");
    match COMPRESSED.get(place) {
        Some(bytes)
            if !bytes.is_empty() && accepted.is_some_and(|accepted| accepted.contains("gzip")) =>
        {
            (
                [kind, cache, (header::CONTENT_ENCODING, "gzip")],
                bytes.as_slice(),
            )
                .into_response()
        }
        _ => ([kind, cache], text).into_response(),
    }
}
