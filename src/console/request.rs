//! Shared parts of all requests: the data for answers, parsing, and the format of answers and failures.

use super::access::{Access, Refused};
use super::disk::{Reads, Unread};
use super::ground::Ground;
use super::orders::Refusal;
use super::receive::Outgoing;
use super::shared::Shared;
use super::source::Source;
use super::table::{Nanoseconds, nanoseconds};
use super::view::View;
use crate::clock::parse_utc;
use crate::demo::Faults;
use axum::Json;
use axum::extract::{Query, Request};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use crossbeam_channel::Sender;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder, RgbImage};
use jiff::Timestamp;
use serde::Deserialize;
use serde_json::json;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// Inputs of every answer.
#[derive(Clone)]
pub struct Console {
    parts: Arc<Parts>,
    reads: Reads,
    turns: Arc<Semaphore>,
}

/// Maximum number of simultaneous drawings, and maximum time that another one waits.
const DRAWINGS: usize = 2;
const DRAWING_TURN: Duration = Duration::from_secs(10);

/// The parts of a console.
pub struct Parts {
    pub shared: Arc<Shared>,
    pub source: Source,
    pub access: Access,
    pub ground: Ground,
    /// Channel for commands; `None` if none can be sent.
    pub outbox: Option<Sender<Outgoing>>,
    pub recording: Option<PathBuf>,
    /// The faults of the demo.
    pub training: Option<Faults>,
}

/// Failure of a request: shown as `{"error": ...}`.
pub struct Failure(pub StatusCode, pub String);

impl Failure {
    pub fn bad(words: impl ToString) -> Self {
        Self(StatusCode::BAD_REQUEST, words.to_string())
    }

    pub fn missing(words: impl ToString) -> Self {
        Self(StatusCode::NOT_FOUND, words.to_string())
    }
}

impl IntoResponse for Failure {
    fn into_response(self) -> Response {
        (self.0, Json(json!({"error": self.1}))).into_response()
    }
}

impl From<Refused> for Failure {
    fn from(refused: Refused) -> Self {
        let (status, words) = match refused {
            Refused::Rate => (
                StatusCode::TOO_MANY_REQUESTS,
                "too many requests: wait a little",
            ),
            Refused::Host => (
                StatusCode::MISDIRECTED_REQUEST,
                "the Host header is not of this console: see --public-origin",
            ),
            Refused::Origin => (
                StatusCode::FORBIDDEN,
                "the request comes from another site's page",
            ),
            Refused::Login => (StatusCode::UNAUTHORIZED, "log in first"),
            Refused::Token => (StatusCode::UNAUTHORIZED, "this is not the token"),
            Refused::Failures => (
                StatusCode::TOO_MANY_REQUESTS,
                "too many wrong tokens: wait a minute",
            ),
        };
        Self(status, words.into())
    }
}

impl From<Unread> for Failure {
    fn from(unread: Unread) -> Self {
        let status = match unread {
            Unread::Busy(..) => StatusCode::SERVICE_UNAVAILABLE,
            Unread::Hangs(_) => StatusCode::GATEWAY_TIMEOUT,
            Unread::Failed(..) => StatusCode::NOT_FOUND,
        };
        Self(status, unread.to_string())
    }
}

impl From<Refusal> for Failure {
    fn from(refusal: Refusal) -> Self {
        let status = match refusal {
            Refusal::NotArmed | Refusal::NotConfirmed(_) => StatusCode::CONFLICT,
            Refusal::Log { .. } => StatusCode::INTERNAL_SERVER_ERROR,
            Refusal::Order(_) | Refusal::Computer(_) => StatusCode::BAD_REQUEST,
        };
        Self(status, refusal.to_string())
    }
}

pub type Answer<T> = Result<T, Failure>;

impl Console {
    pub fn new(parts: Parts) -> Self {
        Self {
            parts: Arc::new(parts),
            reads: Reads::default(),
            turns: Arc::new(Semaphore::new(DRAWINGS)),
        }
    }

    pub fn parts(&self) -> &Parts {
        &self.parts
    }

    pub fn shared(&self) -> &Arc<Shared> {
        &self.parts.shared
    }

    /// Result of `read` on a file of the archive.
    pub async fn read<T: Send + 'static>(
        &self,
        file: String,
        read: impl FnOnce(&Path) -> anyhow::Result<T> + Send + 'static,
    ) -> Answer<T> {
        let archive = self.parts.ground.archive.clone();
        let archive = archive.ok_or_else(|| Failure::missing("no archive is at hand"))?;
        Ok(self.reads.read(archive, file, read).await?)
    }

    /// Waits for a turn at drawing: the number of viewers must not overload the machine.
    pub async fn turn(&self) -> Answer<OwnedSemaphorePermit> {
        let turns = Arc::clone(&self.turns);
        match tokio::time::timeout(DRAWING_TURN, turns.acquire_owned()).await {
            Ok(Ok(turn)) => Ok(turn),
            _ => Err(Failure(
                StatusCode::SERVICE_UNAVAILABLE,
                "too many drawings at a time: try again".into(),
            )),
        }
    }

    /// Whether silence is a fault: received data arrive each second.
    pub fn is_live(&self) -> bool {
        self.parts.source.is_line()
    }

    /// Whether the flight is still growing: a line always is, an archive or a recording if it has grown recently.
    pub fn grows(&self) -> bool {
        self.is_live() || self.parts.shared.has_grown_lately()
    }

    /// Whether commands may be sent by a logged-in user.
    pub fn takes_commands(&self) -> bool {
        self.parts.outbox.is_some() && self.parts.access.has_token()
    }

    /// Reads the flight at a time, or at the newest time.
    pub fn view<T>(&self, at: Option<Nanoseconds>, read: impl FnOnce(&View) -> T) -> T {
        let history = self.parts.shared.history();
        read(&View {
            history: &history,
            at,
            now: Timestamp::now(),
            is_live: self.is_live(),
        })
    }
}

/// Runs long work on another thread.
pub async fn beside<T: Send + 'static>(
    work: impl FnOnce() -> Answer<T> + Send + 'static,
) -> Answer<T> {
    let done = tokio::task::spawn_blocking(work).await;
    done.unwrap_or_else(|_| {
        Err(Failure(
            StatusCode::INTERNAL_SERVER_ERROR,
            "the drawing failed".into(),
        ))
    })
}

pub fn time(name: &str, text: Option<&String>) -> Answer<Option<Nanoseconds>> {
    let read = |text: &String| parse_utc(text).map(nanoseconds);
    let time = text.map(read).transpose();
    time.map_err(|error| Failure::bad(format!("{name}: {error}")))
}

/// A picture as PNG, compressed quickly, because it is viewed only once.
pub fn png(image: &RgbImage) -> Answer<Response> {
    let mut bytes = Vec::new();
    let encoder = PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Sub);
    let (width, height) = image.dimensions();
    let written = encoder.write_image(image, width, height, ExtendedColorType::Rgb8);
    written.map_err(|error| Failure(StatusCode::INTERNAL_SERVER_ERROR, error.to_string()))?;
    Ok(([(header::CONTENT_TYPE, "image/png")], bytes).into_response())
}

pub fn svg(drawing: String) -> Response {
    ([(header::CONTENT_TYPE, "image/svg+xml")], drawing).into_response()
}

/// A file for download. Its name has only letters, digits, dots, dashes and underscores.
pub fn attachment(kind: &'static str, name: &str, bytes: Vec<u8>) -> Response {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "._-".contains(c);
    let name: String = name
        .chars()
        .map(|c| if is_plain(c) { c } else { '_' })
        .collect();
    let disposition = format!("attachment; filename=\"{name}\"");
    let headers = [
        (header::CONTENT_TYPE, kind.to_owned()),
        (header::CONTENT_DISPOSITION, disposition),
    ];
    (headers, bytes).into_response()
}

/// The query string, with an error message if it cannot be parsed.
pub struct Asked<T>(pub T);

impl<T: serde::de::DeserializeOwned, S: Send + Sync> axum::extract::FromRequestParts<S>
    for Asked<T>
{
    type Rejection = Failure;

    async fn from_request_parts(parts: &mut axum::http::request::Parts, state: &S) -> Answer<Self> {
        let query = Query::<T>::from_request_parts(parts, state).await;
        query
            .map(|query| Self(query.0))
            .map_err(|error| Failure::bad(error.body_text()))
    }
}

/// A JSON body, with an error message if it cannot be parsed.
pub struct Body<T>(pub T);

impl<T: serde::de::DeserializeOwned, S: Send + Sync> axum::extract::FromRequest<S> for Body<T> {
    type Rejection = Failure;

    async fn from_request(request: Request, state: &S) -> Answer<Self> {
        let body = Json::<T>::from_request(request, state).await;
        body.map(|body| Self(body.0))
            .map_err(|error| Failure(error.status(), error.body_text()))
    }
}

/// The requested time.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct At {
    pub at: Option<String>,
}
