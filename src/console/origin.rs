//! Scheme, host and port of a web page, in the format of browsers.

use std::fmt;
use std::str::FromStr;
use url::{Host, Url};

/// An origin: `https://host` or `http://host:8080`, in lower case, an international name in its ASCII form, without the
/// scheme's usual port.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Origin {
    /// A URL with only these three parts.
    url: Url,
}

/// Why a text is not an origin.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("expected https://HOST or https://HOST:PORT (or http) {problem}; found \"{found}\"")]
pub struct NoOrigin {
    problem: String,
    found: String,
}

impl FromStr for Origin {
    type Err = NoOrigin;

    fn from_str(text: &str) -> Result<Self, NoOrigin> {
        let refused = |problem: &str| NoOrigin {
            problem: problem.into(),
            found: text.into(),
        };
        let url = match Url::parse(text) {
            Ok(url) => url,
            Err(url::ParseError::RelativeUrlWithoutBase) => {
                return Err(refused("with its scheme"));
            }
            Err(error) => return Err(refused(&format!("({error})"))),
        };
        let is_web = matches!(url.scheme(), "http" | "https") && text.contains("://");
        let has_user = !url.username().is_empty() || url.password().is_some();
        match () {
            () if !is_web => Err(refused("with its scheme")),
            () if has_user => Err(refused("without a user")),
            () if url.path() != "/" || url.query().is_some() || url.fragment().is_some() => {
                Err(refused("without a path: the console has a host to itself"))
            }
            () => Ok(Self { url }),
        }
    }
}

impl fmt::Display for Origin {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(&self.url.origin().ascii_serialization())
    }
}

impl Origin {
    /// Origin of a page requested over plain HTTP, from the request's Host header.
    pub fn of_host(host: &str) -> Option<Self> {
        format!("http://{host}").parse().ok()
    }

    pub fn is_secure(&self) -> bool {
        self.url.scheme() == "https"
    }

    /// Whether the host is an address, or this machine's own name.
    pub fn is_bare(&self) -> bool {
        match self.url.host() {
            Some(Host::Domain(name)) => name == "localhost",
            other => other.is_some(),
        }
    }

    /// Whether a request's Host header names this host. A proxy may omit the port, or state the usual one.
    pub fn is_named_by(&self, host: &str) -> bool {
        let scheme = self.url.scheme();
        let Ok(named) = format!("{scheme}://{host}").parse::<Self>() else {
            return false;
        };
        let is_usual = named.url.port().is_none();
        named.url.host() == self.url.host() && (is_usual || named == *self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `Origin` as sent by Chromium and Firefox for pages at these addresses (WHATWG URL, section 4.5).
    #[test]
    fn an_origin_is_written_as_browsers_write_it() {
        for (text, browser) in [
            ("HTTPS://Host.Example", "https://host.example"),
            ("https://host.example/", "https://host.example"),
            ("https://host.example:443", "https://host.example"),
            ("http://host.example:80/", "http://host.example"),
            ("https://host.example:80", "https://host.example:80"),
            ("https://Host.Example:8443/", "https://host.example:8443"),
            ("https://[FD00:0:0::1]:443", "https://[fd00::1]"),
            ("https://Bücher.example", "https://xn--bcher-kva.example"),
            ("https://10.0.0.1", "https://10.0.0.1"),
        ] {
            let origin: Origin = text.parse().unwrap();
            assert_eq!(origin.to_string(), browser);
            assert_eq!(origin, browser.parse().unwrap());
        }
    }

    #[test]
    fn what_is_more_or_less_than_an_origin_is_refused_with_the_reason() {
        for (text, problem) in [
            ("host.example", "with its scheme"),
            ("host.example:8443", "with its scheme"),
            ("ftp://host.example", "with its scheme"),
            ("https:host.example", "with its scheme"),
            ("https://host.example/console", "without a path"),
            ("https://host.example/?a", "without a path"),
            ("https://host.example#a", "without a path"),
            ("https://user:word@host.example", "without a user"),
            ("https://", "empty host"),
            ("https://host.example:99999", "invalid port"),
            ("https://ho st", "invalid"),
            ("null", "with its scheme"),
            ("", "with its scheme"),
        ] {
            let error = text.parse::<Origin>().unwrap_err().to_string();
            assert!(error.starts_with("expected https://HOST"), "{error}");
            assert!(
                error.contains(problem) && error.ends_with(&format!("found \"{text}\"")),
                "{error}"
            );
        }
    }

    #[test]
    fn a_request_names_the_host_with_its_port_the_usual_one_or_none() {
        let named = |origin: &str, host: &str| origin.parse::<Origin>().unwrap().is_named_by(host);
        for (origin, host) in [
            ("https://host.example", "host.example"),
            ("https://host.example", "Host.Example:443"),
            ("http://host.example", "host.example:80"),
            ("https://host.example:8443", "host.example:8443"),
            ("https://host.example:8443", "host.example"),
            ("https://[fd00::1]", "[fd00::1]:443"),
        ] {
            assert!(named(origin, host), "{origin} {host}");
        }
        for host in [
            "",
            "evil.example",
            "host.example:80",
            "user@host.example",
            "host.example/a",
            "host.example.evil",
        ] {
            assert!(!named("https://host.example", host), "{host}");
        }
    }
}
