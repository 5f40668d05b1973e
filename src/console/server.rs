//! The web server: which address answers what. See `docs/console.md`.

use super::access::{Access, COOKIE, Refused, SESSION};
use super::commands;
use super::frames;
use super::ground::Ground;
use super::live::{self, Replay, Wish};
use super::orders::Refusal;
use super::pages;
use super::plots::{self, FieldName, Numbers};
use super::receive::Outgoing;
use super::shared::Shared;
use super::source::Source;
use super::view::{self, View, utc};
use crate::clock::parse_utc;
use crate::console::ground::SunOnPlate;
use crate::console::history::{Nanoseconds, nanoseconds};
use crate::console::pictures::camera_name;
use crate::provenance::LONG_VERSION;
use crate::units::PlateMil;
use axum::extract::{ConnectInfo, DefaultBodyLimit, Query, Request, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::sse::{KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Json, Router};
use crossbeam_channel::Sender;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder, RgbImage};
use jiff::Timestamp;
use serde::Deserialize;
use serde_json::{Value, json};
use std::net::SocketAddr;
use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio::sync::Semaphore;

/// The largest request, bytes.
const LARGEST_REQUEST: usize = 16 * 1024;
/// Viewers of the live stream at a time.
const MOST_VIEWERS: usize = 100;
/// Drawings that are made at a time, and how long another waits for its turn.
const DRAWINGS: usize = 2;
const DRAWING_TURN: Duration = Duration::from_secs(10);

/// A viewer's browser loads nothing but what this console sends, and shows it in no other site's frame.
const CONTENT_POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; \
                              connect-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'";

/// What every answer needs.
#[derive(Clone)]
pub struct Console(Arc<Parts>);

/// The parts of a console.
pub struct Parts {
    pub shared: Arc<Shared>,
    pub source: Source,
    pub access: Access,
    pub ground: Ground,
    /// Where commands go; `None` where they cannot.
    pub outbox: Option<Sender<Outgoing>>,
    pub recording: Option<PathBuf>,
}

/// Why a request has no answer: shown as `{"error": ...}`.
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
        Self(Arc::new(parts))
    }

    pub fn parts(&self) -> &Parts {
        &self.0
    }

    pub fn shared(&self) -> &Arc<Shared> {
        &self.0.shared
    }

    /// Whether silence is a fault: what is received comes each second.
    pub fn is_live(&self) -> bool {
        self.0.source.is_line()
    }

    /// Whether commands may be sent by somebody who has logged in.
    pub fn takes_commands(&self) -> bool {
        self.0.outbox.is_some() && self.0.access.has_token()
    }

    /// Looks at the flight at a time, or at its newest.
    pub fn view<T>(&self, at: Option<Nanoseconds>, look: impl FnOnce(&View) -> T) -> T {
        let history = self.0.shared.history();
        look(&View {
            history: &history,
            at,
            now: Timestamp::now(),
            is_live: self.is_live(),
        })
    }

    /// The routes; `drawings` are the turns at drawing.
    pub fn router(self) -> Router {
        let drawings = Arc::new(Semaphore::new(DRAWINGS));
        let drawn = Router::new()
            .route("/api/picture.png", get(picture))
            .route("/api/plate.svg", get(plate))
            .route("/api/plot.svg", get(plot))
            .route("/api/spectrum.svg", get(spectrum))
            .route("/api/table.csv", get(table))
            .route("/api/frame.png", get(frames::picture))
            .route("/api/frame.fits", get(frames::file))
            .layer(middleware::from_fn_with_state(drawings, take_turn));
        Router::new()
            .route("/api/flight", get(flight))
            .route("/api/now", get(now))
            .route("/api/live", get(stream))
            .route("/api/frames", get(frames::list))
            .route("/api/recording", get(recording))
            .route("/api/login", post(log_in))
            .route("/api/logout", post(log_out))
            .route("/api/commands", get(commands::table))
            .route("/api/commands/log", get(commands::log))
            .route("/api/commands/compose", post(commands::compose))
            .route("/api/commands/arm", post(commands::arm))
            .route("/api/commands/send", post(commands::send))
            .merge(drawn)
            .fallback(get(pages::page))
            .layer(DefaultBodyLimit::max(LARGEST_REQUEST))
            .layer(middleware::from_fn_with_state(self.clone(), guard))
            .with_state(self)
    }
}

/// Checks every request, and says with every answer what a browser may do with it.
async fn guard(
    State(console): State<Console>,
    ConnectInfo(peer): ConnectInfo<SocketAddr>,
    request: Request,
    next: Next,
) -> Response {
    let access = &console.parts().access;
    let (method, headers) = (request.method().clone(), request.headers());
    let path = request.uri().path();
    // The pages themselves are the login's.
    let needs_login = access.guards_reading()
        && path.starts_with("/api/")
        && !matches!(path, "/api/login" | "/api/flight");
    let refused = match access.check(&method, headers, peer.ip()) {
        Err(refused) => Some(refused),
        Ok(()) if needs_login && !access.is_logged_in(headers) => Some(Refused::Login),
        Ok(()) => None,
    };
    let mut response = match refused {
        Some(refused) => Failure::from(refused).into_response(),
        None => next.run(request).await,
    };
    let headers = response.headers_mut();
    for (name, value) in [
        (header::CONTENT_SECURITY_POLICY, CONTENT_POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    let no_store = HeaderValue::from_static("no-store");
    headers.entry(header::CACHE_CONTROL).or_insert(no_store);
    response
}

/// Drawings take turns, so that no number of viewers takes the whole machine.
async fn take_turn(
    State(drawings): State<Arc<Semaphore>>,
    request: Request,
    next: Next,
) -> Response {
    match tokio::time::timeout(DRAWING_TURN, drawings.acquire()).await {
        Ok(Ok(_turn)) => next.run(request).await,
        _ => Failure(
            StatusCode::SERVICE_UNAVAILABLE,
            "too many drawings at a time: try again".into(),
        )
        .into_response(),
    }
}

/// Does work that takes longer than an answer may beside the answers.
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

async fn flight(State(console): State<Console>, headers: HeaderMap) -> Json<Value> {
    let parts = console.parts();
    let logged_in = parts.access.is_logged_in(&headers);
    let needs_login = parts.access.guards_reading() && !logged_in;
    let mut flight = json!({
        "version": LONG_VERSION,
        "live": parts.source.is_live(),
        "frames": parts.ground.archive.is_some(),
        "commands": console.takes_commands(),
        "logged_in": logged_in,
        "needs_login": needs_login,
        "login": parts.access.has_token(),
    });
    if !needs_login {
        let history = console.shared().history();
        let span = history.span();
        flight["source"] = json!(parts.source.to_string());
        flight["instrument"] = json!(parts.ground.instrument.name);
        flight["begins"] = json!(span.map(|(first, _)| utc(first)));
        flight["ends"] = json!(span.map(|(_, last)| utc(last)));
        flight["fields"] = json!(view::fields(&history));
        flight["recording"] = json!(
            parts
                .recording
                .as_ref()
                .map(|path| path.display().to_string())
        );
    }
    Json(flight)
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct At {
    at: Option<String>,
}

async fn now(State(console): State<Console>, query: Asked<At>) -> Answer<Json<Value>> {
    let at = time("at", query.0.at.as_ref())?;
    let viewers = console.shared().viewers.load(Ordering::Relaxed);
    Ok(Json(console.view(at, |view| {
        let mut pictures = view.pictures();
        if pictures.is_empty() {
            pictures.extend(view.frame());
        }
        json!({
            "state": view.state(0, viewers, false),
            "housekeeping": view.housekeeping(false),
            "solution": view.solution(),
            "propagated": view.gyros(),
            "pictures": pictures,
        })
    })))
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct StreamQuery {
    bits_per_s: Option<f64>,
    at: Option<String>,
    speed: Option<f64>,
}

async fn stream(State(console): State<Console>, query: Asked<StreamQuery>) -> Answer<Response> {
    const SPEEDS: std::ops::RangeInclusive<f64> = 0.01..=10_000.0;
    const RATES: std::ops::RangeInclusive<f64> = 300.0..=1e9;
    let StreamQuery {
        bits_per_s,
        at,
        speed,
    } = query.0;
    let speed = speed.unwrap_or(1.0);
    if !SPEEDS.contains(&speed) {
        return Err(Failure::bad(format!(
            "speed: expected 0.01 to 10000, found {speed}"
        )));
    }
    if let Some(rate) = bits_per_s.filter(|rate| !RATES.contains(rate)) {
        return Err(Failure::bad(format!(
            "bits_per_s: expected 300 or more, found {rate}"
        )));
    }
    if console.shared().viewers.load(Ordering::Relaxed) >= MOST_VIEWERS {
        let words = format!("{MOST_VIEWERS} viewers look already");
        return Err(Failure(StatusCode::SERVICE_UNAVAILABLE, words));
    }
    let replay = time("at", at.as_ref())?.map(|at| Replay { at, speed });
    let wish = Wish { bits_per_s, replay };
    let keep_alive = KeepAlive::new().interval(Duration::from_secs(15));
    Ok(Sse::new(live::stream(console, wish))
        .keep_alive(keep_alive)
        .into_response())
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct PictureQuery {
    camera: u8,
    at: Option<String>,
    overlay: Option<u8>,
    /// Tells a browser's cache one from another.
    #[serde(rename = "version")]
    _version: Option<String>,
}

async fn picture(State(console): State<Console>, query: Asked<PictureQuery>) -> Answer<Response> {
    let PictureQuery {
        camera,
        at,
        overlay,
        ..
    } = query.0;
    let at = time("at", at.as_ref())?;
    let with_overlay = overlay == Some(1);
    let (picture, file) = {
        let history = console.shared().history();
        (
            history.picture(camera, at).cloned(),
            frames::latest(&history, at),
        )
    };
    let name = camera_name(camera);
    beside(move || {
        let ground = &console.parts().ground;
        let drawn = match (picture, file) {
            (Some(picture), _) if !with_overlay => Ok(picture.image()),
            (Some(picture), _) => {
                let frame = picture.frame().ok_or_else(|| {
                    Failure(
                        StatusCode::CONFLICT,
                        format!("the {name}: pixels of its picture are missing"),
                    )
                })?;
                ground.overlay(&frame, &format!("{name}, solved on the ground"))
            }
            (None, Some(file)) if camera == 1 => ground.frame(&file, with_overlay),
            _ => return Err(Failure::missing(format!("the {name}: no picture has come"))),
        };
        png(&drawn.map_err(|error| Failure(StatusCode::CONFLICT, format!("{error:#}")))?)
    })
    .await
}

/// A picture as PNG: fast, for it is looked at once.
pub fn png(image: &RgbImage) -> Answer<Response> {
    let mut bytes = Vec::new();
    let encoder = PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Sub);
    let (width, height) = image.dimensions();
    let written = encoder.write_image(image, width, height, ExtendedColorType::Rgb8);
    written.map_err(|error| Failure(StatusCode::INTERNAL_SERVER_ERROR, error.to_string()))?;
    Ok(([(header::CONTENT_TYPE, "image/png")], bytes).into_response())
}

fn svg(drawing: String) -> Response {
    ([(header::CONTENT_TYPE, "image/svg+xml")], drawing).into_response()
}

async fn plate(State(console): State<Console>, query: Asked<At>) -> Answer<Response> {
    let at = time("at", query.0.at.as_ref())?;
    let sun = console.view(at, |view| sun_on_plate(view));
    let sun = sun.ok_or_else(|| Failure::missing("where the Sun is on the plate is not known"))?;
    beside(move || Ok(svg(console.parts().ground.plate(&sun)))).await
}

/// By the housekeeping, else by the log of an archive.
fn sun_on_plate(view: &View) -> Option<SunOnPlate> {
    let history = view.history;
    let told = history.row(view.at).and_then(|row| {
        let told = history.housekeeping.told(row)?;
        let (x, y) = told.plate_x_mil.zip(told.plate_y_mil)?;
        Some(SunOnPlate {
            time: history.housekeeping.times[row],
            at: PlateMil::new(x.into(), y.into()),
            sigma_mil: told.plate_sigma_mil.map(f64::from),
        })
    });
    told.or_else(|| {
        let table = history.tables.get("solutions")?;
        let row = super::table::row_at(table.times(), view.at.unwrap_or(Nanoseconds::MAX))?;
        let number = |name| table.value(row, name);
        Some(SunOnPlate {
            time: table.times()[row],
            at: PlateMil::new(number("sun_plate_x_mil")?, number("sun_plate_y_mil")?),
            sigma_mil: number("sun_plate_sigma_x_mil"),
        })
    })
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct PlotQuery {
    fields: Option<String>,
    from: Option<String>,
    to: Option<String>,
}

impl PlotQuery {
    /// The range of times: all there is where nothing else is asked for.
    fn range(&self, console: &Console) -> Answer<Range<Nanoseconds>> {
        let (from, to) = (
            time("from", self.from.as_ref())?,
            time("to", self.to.as_ref())?,
        );
        let span = console.shared().history().span();
        let (first, last) = span.ok_or_else(|| Failure::missing("nothing has come yet"))?;
        let range = from.unwrap_or(first)..to.unwrap_or(last.saturating_add(1));
        match range.is_empty() {
            true => Err(Failure::bad(
                "from, to: expected a range of times, found none",
            )),
            false => Ok(range),
        }
    }

    fn fields(&self) -> Answer<Vec<FieldName>> {
        let names: Vec<&str> = self
            .fields
            .as_deref()
            .unwrap_or_default()
            .split(',')
            .collect();
        if names.len() > plots::MOST_FIELDS {
            let words = format!(
                "fields: expected {} at most, found {}",
                plots::MOST_FIELDS,
                names.len()
            );
            return Err(Failure::bad(words));
        }
        let field = |name: &&str| {
            let unknown = || Failure::bad(format!("fields: expected TABLE.NAME, found \"{name}\""));
            FieldName::parse(name).ok_or_else(unknown)
        };
        names.iter().map(field).collect()
    }

    fn numbers(&self, console: &Console, range: &Range<Nanoseconds>) -> Answer<Vec<Numbers>> {
        let history = console.shared().history();
        let numbers = |field: &FieldName| {
            let found = plots::numbers(&history, field, range);
            found.ok_or_else(|| {
                Failure::missing(format!(
                    "fields: expected a known one, found \"{}.{}\"",
                    field.table, field.name
                ))
            })
        };
        self.fields()?.iter().map(numbers).collect()
    }
}

async fn plot(State(console): State<Console>, query: Asked<PlotQuery>) -> Answer<Response> {
    beside(move || {
        let range = query.0.range(&console)?;
        let fields = query.0.numbers(&console, &range)?;
        let stack = plots::panels(fields, &range);
        // The page finds a time by where it is pointed at.
        let root = format!(
            "<svg data-from=\"{}\" data-to=\"{}\"",
            utc(range.start),
            utc(range.end)
        );
        Ok(svg(stack.svg.replacen("<svg", &root, 1)))
    })
    .await
}

async fn spectrum(State(console): State<Console>, query: Asked<PlotQuery>) -> Answer<Response> {
    beside(move || {
        let range = query.0.range(&console)?;
        let runs = plots::offset_runs(&console.shared().history(), &range);
        let runs = runs.ok_or_else(|| Failure::missing("no offsets within these times"))?;
        let drawn = plots::offset_spectrum(&runs);
        Ok(svg(drawn.map_err(|_| {
            Failure::missing("no run of offsets is long enough for a spectrum")
        })?))
    })
    .await
}

async fn table(State(console): State<Console>, query: Asked<PlotQuery>) -> Answer<Response> {
    beside(move || {
        let fields = query.0.fields()?;
        if let Some(other) = fields.iter().find(|field| field.table != fields[0].table) {
            let words = format!(
                "fields: expected those of one table, found {} and {}",
                fields[0].table, other.table
            );
            return Err(Failure::bad(words));
        }
        let range = query.0.range(&console)?;
        let text = plots::csv(&query.0.numbers(&console, &range)?, &range);
        let name = fields[0].table.replace('/', "_");
        Ok(attachment(
            "text/csv",
            &format!("{name}.csv"),
            text.into_bytes(),
        ))
    })
    .await
}

/// A file for the viewer's disk. Its name is of letters, digits, dots, dashes and underscores alone.
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

async fn recording(State(console): State<Console>) -> Answer<Response> {
    let path = console.parts().recording.clone();
    let path = path.ok_or_else(|| Failure::missing("nothing is recorded: see --record"))?;
    beside(move || {
        let bytes = std::fs::read(&path).map_err(Failure::missing)?;
        let name = path
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        Ok(attachment("text/plain", &name, bytes))
    })
    .await
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Login {
    token: String,
}

async fn log_in(
    State(console): State<Console>,
    ConnectInfo(peer): ConnectInfo<SocketAddr>,
    login: Body<Login>,
) -> Answer<Response> {
    let access = &console.parts().access;
    let session = access.log_in(&login.0.token, peer.ip());
    let session = session.inspect_err(|_| tracing::warn!(%peer, "a login failed"))?;
    tracing::info!(%peer, "somebody has logged in");
    let secure = if access.is_behind_tls() {
        "; Secure"
    } else {
        ""
    };
    let cookie = format!(
        "{COOKIE}={session}; Path=/; Max-Age={}; HttpOnly; SameSite=Strict{secure}",
        SESSION.as_secs()
    );
    Ok((StatusCode::NO_CONTENT, [(header::SET_COOKIE, cookie)]).into_response())
}

async fn log_out(State(console): State<Console>, headers: HeaderMap) -> Response {
    console.parts().access.log_out(&headers);
    let cookie = format!("{COOKIE}=; Path=/; Max-Age=0; HttpOnly; SameSite=Strict");
    (StatusCode::NO_CONTENT, [(header::SET_COOKIE, cookie)]).into_response()
}

/// What stands behind the question mark, with words where it cannot be read.
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

/// A body of JSON, with words where it cannot be read.
pub struct Body<T>(pub T);

impl<T: serde::de::DeserializeOwned, S: Send + Sync> axum::extract::FromRequest<S> for Body<T> {
    type Rejection = Failure;

    async fn from_request(request: Request, state: &S) -> Answer<Self> {
        let body = Json::<T>::from_request(request, state).await;
        body.map(|body| Self(body.0))
            .map_err(|error| Failure(error.status(), error.body_text()))
    }
}
