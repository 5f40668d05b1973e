//! Access control for viewing and commanding: token, sessions, origin, and rate limits per address.
//!
//! Reading is free on this machine's own addresses; elsewhere, and always for commands, a viewer logs in with the token
//! from a file and holds a session by a cookie. Requests that change anything must come from a page of the console itself.

use super::origin::Origin;
use axum::http::{HeaderMap, Method, header};
use sha2::{Digest, Sha256};
use std::collections::HashMap;
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use subtle::ConstantTimeEq;

/// Name of the session's cookie.
pub const COOKIE: &str = "solaspect_session";
/// Duration of a session.
pub const SESSION: Duration = Duration::from_secs(12 * 3600);
const MOST_SESSIONS: usize = 100;
/// Minimum size of the token's file, bytes.
const SHORTEST: usize = 16;
/// Maximum number of failed logins per address and minute.
const MOST_FAILURES: u32 = 5;
const MINUTE: Duration = Duration::from_secs(60);
/// Maximum burst of requests of one address, and the number that is added each second.
const BURST: f64 = 1000.0;
const PER_SECOND: f64 = 200.0;
const MOST_ADDRESSES: usize = 10_000;

/// Why a file is not a valid token.
#[derive(Debug, thiserror::Error)]
pub enum TokenError {
    #[error("{}: token: cannot be read: {cause}", .path.display())]
    File { path: PathBuf, cause: io::Error },
    #[error("{}: token: expected {SHORTEST} characters or more, found {found}", .path.display())]
    Short { path: PathBuf, found: usize },
}

/// The hash of a secret: two hashes are compared in constant time, independent of the lengths of the secrets.
#[derive(Clone, Copy)]
pub struct Secret([u8; 32]);

impl Secret {
    pub fn of(text: &str) -> Self {
        Self(Sha256::digest(text.as_bytes()).into())
    }

    /// Reads a token: the whole file except white space at its end.
    ///
    /// # Errors
    /// If the file cannot be read, or has less than 16 characters.
    pub fn read(path: &Path) -> Result<Self, TokenError> {
        let text = std::fs::read_to_string(path).map_err(|cause| {
            let path = path.into();
            TokenError::File { path, cause }
        })?;
        match text.trim_end() {
            token if token.len() >= SHORTEST => Ok(Self::of(token)),
            token => Err(TokenError::Short {
                path: path.into(),
                found: token.len(),
            }),
        }
    }

    fn is(&self, other: &Self) -> bool {
        self.0.ct_eq(&other.0).into()
    }
}

/// Why a request is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refused {
    /// Too many requests.
    Rate,
    /// The request names a host other than this one.
    Host,
    /// It comes from a foreign page.
    Origin,
    /// It needs a login.
    Login,
    /// The token is wrong.
    Token,
    /// Too many logins have failed.
    Failures,
}

/// The rules of one console.
pub struct Access {
    token: Option<Secret>,
    /// Whether it is reachable from this machine only.
    is_local: bool,
    /// Public origin of a reverse proxy.
    public_origin: Option<Origin>,
    sessions: Mutex<Vec<(Secret, Instant)>>,
    addresses: Mutex<HashMap<IpAddr, Address>>,
}

/// State of an address.
struct Address {
    /// Number of requests that it may still make.
    left: f64,
    since: Instant,
    failures: u32,
    failed: Instant,
}

impl Access {
    pub fn new(token: Option<Secret>, listen: SocketAddr, public_origin: Option<Origin>) -> Self {
        Self {
            token,
            is_local: listen.ip().is_loopback(),
            public_origin,
            sessions: Mutex::default(),
            addresses: Mutex::default(),
        }
    }

    /// Whether there is a token for logging in.
    pub fn has_token(&self) -> bool {
        self.token.is_some()
    }

    /// Whether viewing requires a login as well.
    pub fn guards_reading(&self) -> bool {
        !self.is_local || self.public_origin.is_some()
    }

    /// Whether the session's cookie may be sent over TLS only.
    pub fn is_behind_tls(&self) -> bool {
        self.public_origin.as_ref().is_some_and(Origin::is_secure)
    }

    /// Checks a request before it is processed.
    pub fn check(&self, method: &Method, headers: &HeaderMap, peer: IpAddr) -> Result<(), Refused> {
        if !self.take_turn(peer) {
            return Err(Refused::Rate);
        }
        let host = text(headers, header::HOST).unwrap_or_default();
        let plain = Origin::of_host(host);
        // A foreign name for this address (DNS rebinding) is rejected; a bare address cannot be one.
        let is_own = plain.as_ref().is_some_and(Origin::is_bare) || self.is_public(host);
        if !is_own {
            return Err(Refused::Host);
        }
        let is_reading = matches!(*method, Method::GET | Method::HEAD);
        if !is_reading && !self.is_own_origin(headers, plain.as_ref()) {
            return Err(Refused::Origin);
        }
        Ok(())
    }

    fn is_public(&self, host: &str) -> bool {
        let public = self.public_origin.as_ref();
        public.is_some_and(|public| public.is_named_by(host))
    }

    fn is_own_origin(&self, headers: &HeaderMap, plain: Option<&Origin>) -> bool {
        let origin = text(headers, header::ORIGIN).and_then(|origin| origin.parse().ok());
        origin.is_some_and(|origin| {
            self.public_origin.as_ref() == Some(&origin) || plain == Some(&origin)
        })
    }

    fn addresses(&self) -> MutexGuard<'_, HashMap<IpAddr, Address>> {
        self.addresses
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }

    /// Counts a request against the rate limit of an address; whether it is allowed.
    fn take_turn(&self, peer: IpAddr) -> bool {
        let now = Instant::now();
        let mut addresses = self.addresses();
        if addresses.len() >= MOST_ADDRESSES {
            addresses.retain(|_, known| now.duration_since(known.since) < MINUTE);
            // All are from the last minute: the one with the oldest request is dropped.
            if addresses.len() >= MOST_ADDRESSES {
                let oldest = addresses.iter().min_by_key(|(_, known)| known.since);
                let oldest = oldest.map(|(address, _)| *address);
                oldest.and_then(|oldest| addresses.remove(&oldest));
            }
        }
        let known = addresses.entry(peer).or_insert(Address {
            left: BURST,
            since: now,
            failures: 0,
            failed: now,
        });
        let earned = PER_SECOND * now.duration_since(known.since).as_secs_f64();
        known.left = (known.left + earned).min(BURST) - 1.0;
        known.since = now;
        let may = known.left >= 0.0;
        known.left = known.left.max(0.0);
        may
    }

    /// Opens a session by the token; returns the text of its cookie.
    pub fn log_in(&self, token: &str, peer: IpAddr) -> Result<String, Refused> {
        let now = Instant::now();
        let mut addresses = self.addresses();
        if let Some(known) = addresses.get_mut(&peer) {
            if now.duration_since(known.failed) > MINUTE {
                known.failures = 0;
            }
            if known.failures >= MOST_FAILURES {
                return Err(Refused::Failures);
            }
        }
        let is_right = self.token.is_some_and(|own| own.is(&Secret::of(token)));
        if !is_right {
            if let Some(known) = addresses.get_mut(&peer) {
                known.failures += 1;
                known.failed = now;
            }
            return Err(Refused::Token);
        }
        let session = unguessable();
        let mut sessions = self.sessions();
        sessions.push((Secret::of(&session), now));
        let surplus = sessions.len().saturating_sub(MOST_SESSIONS);
        sessions.drain(..surplus);
        Ok(session)
    }

    pub fn log_out(&self, headers: &HeaderMap) {
        if let Some(session) = session(headers) {
            let hash = Secret::of(session);
            self.sessions().retain(|(known, _)| !known.is(&hash));
        }
    }

    /// Whether a request comes from a logged-in user.
    pub fn is_logged_in(&self, headers: &HeaderMap) -> bool {
        let Some(session) = session(headers) else {
            return false;
        };
        let hash = Secret::of(session);
        let mut sessions = self.sessions();
        sessions.retain(|(_, since)| since.elapsed() < SESSION);
        sessions.iter().any(|(known, _)| known.is(&hash))
    }

    fn sessions(&self) -> MutexGuard<'_, Vec<(Secret, Instant)>> {
        self.sessions.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// 256 random bits of the system's generator, as hexadecimal digits.
pub fn unguessable() -> String {
    let bits: [u8; 32] = rand::random();
    bits.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn text(headers: &HeaderMap, name: header::HeaderName) -> Option<&str> {
    headers.get(name)?.to_str().ok()
}

fn session(headers: &HeaderMap) -> Option<&str> {
    let cookies = text(headers, header::COOKIE)?;
    let mut pairs = cookies
        .split(';')
        .filter_map(|cookie| cookie.trim().split_once('='));
    pairs.find_map(|(name, value)| (name == COOKIE).then_some(value))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::Ipv4Addr;

    const PEER: IpAddr = IpAddr::V4(Ipv4Addr::LOCALHOST);
    const TOKEN: &str = "a token of this console";

    fn access(listen: &str, public: Option<&str>) -> Access {
        let token = Some(Secret::of(TOKEN));
        let public = public.map(|origin| origin.parse().unwrap());
        Access::new(token, listen.parse().unwrap(), public)
    }

    fn headers(pairs: &[(&'static str, &str)]) -> HeaderMap {
        let pairs = pairs.iter();
        pairs
            .map(|(name, value)| (name.parse().unwrap(), value.parse().unwrap()))
            .collect()
    }

    #[test]
    fn a_session_is_opened_by_the_token_alone_and_ends_with_the_logout() {
        let access = access("127.0.0.1:8080", None);
        access
            .check(&Method::GET, &headers(&[("host", "localhost:8080")]), PEER)
            .unwrap();
        assert_eq!(access.log_in("another", PEER), Err(Refused::Token));
        let session = access.log_in(TOKEN, PEER).unwrap();
        let with = headers(&[("cookie", &format!("a=b; {COOKIE}={session}"))]);
        assert!(access.is_logged_in(&with));
        assert!(!access.is_logged_in(&headers(&[("cookie", &format!("{COOKIE}={TOKEN}"))])));
        access.log_out(&with);
        assert!(!access.is_logged_in(&with));
    }

    #[test]
    fn an_address_that_guesses_waits_a_minute() {
        let access = access("127.0.0.1:8080", None);
        access
            .check(&Method::GET, &headers(&[("host", "127.0.0.1")]), PEER)
            .unwrap();
        for _ in 0..MOST_FAILURES {
            assert_eq!(access.log_in("guess", PEER), Err(Refused::Token));
        }
        assert_eq!(access.log_in(TOKEN, PEER), Err(Refused::Failures));
    }

    #[test]
    fn what_changes_anything_comes_from_the_consoles_own_pages() {
        let access = access("127.0.0.1:8080", Some("HTTPS://Console.Example.org:443/"));
        let check = |method: Method, pairs: &[(&'static str, &str)]| {
            access.check(&method, &headers(pairs), PEER)
        };
        let local = ("host", "127.0.0.1:8080");
        assert_eq!(check(Method::GET, &[local]), Ok(()));
        assert_eq!(check(Method::POST, &[local]), Err(Refused::Origin));
        assert_eq!(
            check(Method::POST, &[local, ("origin", "http://127.0.0.1:8080")]),
            Ok(())
        );
        for foreign in [
            "http://127.0.0.1:9090",
            "https://127.0.0.1:8080",
            "null",
            "http://evil.example",
        ] {
            assert_eq!(
                check(Method::POST, &[local, ("origin", foreign)]),
                Err(Refused::Origin)
            );
        }
        let public = ("host", "console.example.org");
        assert_eq!(
            check(
                Method::POST,
                &[public, ("origin", "https://console.example.org")]
            ),
            Ok(())
        );
        // A proxy may state the usual port, but no browser sends capitals or that port.
        let stated = ("host", "console.example.org:443");
        let origin = ("origin", "https://console.example.org");
        assert_eq!(check(Method::POST, &[stated, origin]), Ok(()));
        assert_eq!(
            check(Method::GET, &[("host", "evil.example:8080")]),
            Err(Refused::Host)
        );
        assert_eq!(check(Method::GET, &[]), Err(Refused::Host));
    }

    #[test]
    fn an_address_may_ask_so_often_and_another_is_not_kept_from_it() {
        let access = access("127.0.0.1:8080", None);
        let allowed = (0..3000).filter(|_| access.take_turn(PEER)).count();
        assert!((1000..2000).contains(&allowed), "{allowed}");
        assert!(access.take_turn(IpAddr::V4(Ipv4Addr::new(10, 0, 0, 1))));
    }

    #[test]
    fn a_short_token_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("token");
        std::fs::write(&path, "short\n").unwrap();
        let error = Secret::read(&path).err().unwrap().to_string();
        assert!(
            error.contains("expected 16 characters or more, found 5"),
            "{error}"
        );
    }
}
