//! The web server and its routes. See `docs/console.md`.

use super::access::{COOKIE, Refused, SESSION};
use super::live::{self, Replay, Wish};
use super::request::{Answer, Asked, At, Body, Console, Failure, attachment, beside, time};
use super::view::{self, Detail, utc};
use super::{commands, drawings, frames, pages, training};
use crate::provenance::LONG_VERSION;
use axum::extract::{ConnectInfo, Request, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::sse::{KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Json, Router};
use serde::Deserialize;
use serde_json::{Value, json};
use std::net::SocketAddr;
use std::sync::atomic::Ordering;
use std::time::Duration;
use tower_http::compression::CompressionLayer;

/// Maximum number of viewers of the live stream.
const MOST_VIEWERS: usize = 100;

/// A viewer's browser loads only content from this console, and does not show it in another site's frame.
const CONTENT_POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; \
                              connect-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'";

/// The routes.
pub fn router(console: Console) -> Router {
    let drawn = Router::new()
        .route("/api/plate.svg", get(drawings::plate))
        .route("/api/plot.svg", get(drawings::plot))
        .route("/api/spectrum.svg", get(drawings::spectrum))
        .route("/api/table.csv", get(drawings::table))
        .layer(middleware::from_fn_with_state(console.clone(), take_turn));
    Router::new()
        .route("/api/flight", get(flight))
        .route("/api/now", get(now))
        .route("/api/live", get(stream))
        .route("/api/frames", get(frames::list))
        // Their files are read before they wait for a turn at drawing.
        .route("/api/picture.png", get(drawings::picture))
        .route("/api/frame.png", get(frames::picture))
        .route("/api/frame.fits", get(frames::file))
        .route("/api/recording", get(recording))
        .route("/api/login", post(log_in))
        .route("/api/logout", post(log_out))
        .route("/api/commands", get(commands::table))
        .route("/api/commands/log", get(commands::log))
        .route("/api/commands/compose", post(commands::compose))
        .route("/api/commands/arm", post(commands::arm))
        .route("/api/commands/send", post(commands::send))
        .route("/api/training", post(training::switch))
        .merge(drawn)
        .fallback(get(pages::page))
        // The stream of events and pictures are not compressed.
        .layer(CompressionLayer::new())
        .layer(middleware::from_fn_with_state(console.clone(), guard))
        .with_state(console)
}

/// Checks every request, and adds the security headers to every answer.
async fn guard(
    State(console): State<Console>,
    ConnectInfo(peer): ConnectInfo<SocketAddr>,
    request: Request,
    next: Next,
) -> Response {
    let access = &console.parts().access;
    let (method, headers) = (request.method().clone(), request.headers());
    let path = request.uri().path();
    // The pages themselves contain the login.
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

async fn take_turn(State(console): State<Console>, request: Request, next: Next) -> Response {
    match console.turn().await {
        Ok(_turn) => next.run(request).await,
        Err(failure) => failure.into_response(),
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
        let words = format!("{MOST_VIEWERS} viewers are connected already");
        return Err(Failure(StatusCode::SERVICE_UNAVAILABLE, words));
    }
    let replay = time("at", at.as_ref())?.map(|at| Replay { at, speed });
    let wish = Wish { bits_per_s, replay };
    let keep_alive = KeepAlive::new().interval(Duration::from_secs(15));
    Ok(Sse::new(live::stream(console, wish))
        .keep_alive(keep_alive)
        .into_response())
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
    tracing::info!(%peer, "a viewer has logged in");
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
