//! The web server: which address answers what. See `docs/console.md`.

use super::access::{COOKIE, Refused, SESSION};
use super::ground::SunOnPlate;
use super::live::{self, Replay, Wish};
use super::pictures::camera_name;
use super::plots::{self, FieldName, Numbers};
use super::request::{Answer, Asked, Body, Console, Failure, attachment, beside, png, svg, time};
use super::table::{Nanoseconds, row_at};
use super::view::{self, Detail, View, utc};
use super::{commands, frames, pages};
use crate::provenance::LONG_VERSION;
use crate::units::PlateMil;
use axum::extract::{ConnectInfo, DefaultBodyLimit, Request, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::sse::{KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Json, Router};
use serde::Deserialize;
use serde_json::{Value, json};
use std::net::SocketAddr;
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio::sync::Semaphore;
use tower_http::compression::CompressionLayer;

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

/// The routes; `drawings` are the turns at drawing.
pub fn router(console: Console) -> Router {
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
        // Not the stream of events, nor pictures.
        .layer(CompressionLayer::new())
        .layer(middleware::from_fn_with_state(console.clone(), guard))
        .with_state(console)
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

async fn flight(State(console): State<Console>, headers: HeaderMap) -> Json<Value> {
    let parts = console.parts();
    let logged_in = parts.access.is_logged_in(&headers);
    let needs_login = parts.access.guards_reading() && !logged_in;
    let mut flight = json!({
        "version": LONG_VERSION,
        "live": console.grows(),
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
            "state": view.state(0, viewers, Detail::All),
            "housekeeping": view.housekeeping(Detail::All),
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
            (Some(picture), _) if picture.width == 0 => {
                return Err(Failure::missing(format!("the {name}: no pixels have come")));
            }
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

async fn plate(State(console): State<Console>, query: Asked<At>) -> Answer<Response> {
    let at = time("at", query.0.at.as_ref())?;
    let sun = console.view(at, sun_on_plate);
    let Some(sun) = sun else {
        return Ok(StatusCode::NO_CONTENT.into_response());
    };
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
        let row = row_at(table.times(), view.at.unwrap_or(Nanoseconds::MAX))?;
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
