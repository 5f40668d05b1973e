//! The pages with their scripts and styles, embedded in the program.

use super::request::Failure;
use crate::provenance::sha256;
use axum::http::{HeaderMap, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use std::sync::LazyLock;

const HTML: &str = "text/html; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const MODULE: &str = "text/javascript; charset=utf-8";

/// Path, content type and text.
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
    ("/training.js", MODULE, include_str!("pages/training.js")),
    ("/view.js", MODULE, include_str!("pages/view.js")),
];

/// Tags by which a browser detects whether its copy of a file is current.
static TAGS: LazyLock<Vec<String>> = LazyLock::new(|| {
    let tag = |text: &str| format!("\"{}\"", &sha256(text)[..16]);
    FILES.iter().map(|(.., text)| tag(text)).collect()
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
    let tag = TAGS[place].as_str();
    let known = headers
        .get(header::IF_NONE_MATCH)
        .and_then(|value| value.to_str().ok());
    // A file that is compressed in transit has a weak tag.
    if known.is_some_and(|known| known.trim_start_matches("W/") == tag) {
        return (StatusCode::NOT_MODIFIED, [(header::ETAG, tag)]).into_response();
    }
    // Revalidated at every load of a page: another program may be at this address now.
    let headers = [
        (header::ETAG, tag),
        (header::CONTENT_TYPE, kind),
        (header::CACHE_CONTROL, "no-cache"),
    ];
    (headers, text).into_response()
}
