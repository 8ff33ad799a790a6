//! Protection of the bench against requests of web pages (HOST-6).
//!
//! A web page may send "simple" requests to any address, and may resolve its own host name to a loopback
//! address. Therefore the `Host` of a request must be a loopback name, the listening address of the API, or a
//! name that the user allows. A request that changes something must have a media type that needs a CORS
//! preflight, and the API never grants a preflight. Requests with the origin of another page are refused.

use std::error::Error as _;
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;

use axum::body::Bytes;
use axum::extract::{FromRequest, FromRequestParts, Query, Request, State};
use axum::http::request::Parts;
use axum::http::uri::Authority;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use serde::de::DeserializeOwned;

use super::problem::Problem;

/// Longest body of a request, in bytes.
pub(super) const BODY_BYTES: usize = 64 << 10;

/// Media type of the content of a memory.
pub(super) const MEMORY: &str = "application/octet-stream";

/// Longest time in which a body must arrive.
const BODY_TIME: Duration = Duration::from_secs(5);

/// Hosts that requests may name.
#[derive(Clone, Debug)]
pub(super) struct Hosts {
    /// The address of the API.
    pub(super) here: SocketAddr,
    /// Further names, without a port.
    pub(super) allowed: Arc<[String]>,
}

impl Hosts {
    /// Returns whether `host`, as given in the header, is a loopback name, the API's own address, or an
    /// allowed name.
    fn accept(&self, host: &str) -> bool {
        let Some(name) = name_of(host) else { return false };
        let is_ours = |address: IpAddr| address.is_loopback() || address == self.here.ip();
        let is_name = |other: &str| name.eq_ignore_ascii_case(other);
        is_name("localhost")
            || name.parse().is_ok_and(is_ours)
            || self.allowed.iter().any(|other| is_name(other))
    }
}

/// The name or address in `NAME`, `NAME:PORT`, `[ADDRESS]` or `[ADDRESS]:PORT`.
fn name_of(host: &str) -> Option<&str> {
    let (name, port) = match host.strip_prefix('[') {
        Some(rest) => rest.split_once(']')?,
        None => host.split_at(host.rfind(':').unwrap_or(host.len())),
    };
    let is_port = |port: &str| port.strip_prefix(':').is_some_and(|digits| digits.parse::<u16>().is_ok());
    (port.is_empty() || is_port(port)).then_some(name)
}

/// Refuses requests that may come from a web page.
pub(super) async fn check(State(hosts): State<Hosts>, request: Request, next: Next) -> Response {
    match page(&request, &hosts) {
        None => next.run(request).await,
        Some(sentence) => Problem::forbidden(sentence).into_response(),
    }
}

/// The reason why a request may come from a web page, in one sentence; `None` if it cannot.
fn page(request: &Request, known: &Hosts) -> Option<&'static str> {
    let headers = request.headers();
    let mut hosts = headers.get_all(header::HOST).iter().map(|host| host.to_str().unwrap_or(""));
    let host = hosts.next().unwrap_or("");
    // The request target may contain a host, too.
    let targets = request.uri().authority().map(Authority::as_str);
    if !targets.into_iter().chain(hosts).chain([host]).all(|host| known.accept(host)) {
        return Some("the Host of a request must be a loopback address, or a name of --allow-host");
    }
    let origin = headers.get(header::ORIGIN).map(|origin| origin.to_str().unwrap_or(""));
    // A person may follow a link to the page. Nothing else of the API opens in a browser's window.
    let opens_page = request.uri().path() == "/" && is_opened(request);
    let is_own =
        |origin: &str| origin.strip_prefix("http://").is_some_and(|of| of.eq_ignore_ascii_case(host));
    let site = headers.get("sec-fetch-site").map(|site| site.to_str().unwrap_or(""));
    let is_allowed = |site| matches!(site, "same-origin" | "none") || opens_page;
    if !origin.is_none_or(is_own) || !site.is_none_or(is_allowed) {
        return Some("a web page of another origin may not use the API");
    }
    if !request.method().is_safe() || has_body(headers) {
        let path = request.uri().path();
        if path.ends_with("/memory") && path.starts_with("/api/drives/") {
            if !is_media(headers, MEMORY) {
                return Some("the Content-Type of a memory must be application/octet-stream");
            }
        } else if !is_media(headers, "application/json") {
            return Some("the Content-Type of a request that changes something must be application/json");
        }
    }
    None
}

/// Returns true if a browser asks for what it shows in a window of its own, and not in a frame of another page.
fn is_opened(request: &Request) -> bool {
    let is = |name, value| request.headers().get(name).is_some_and(|is: &HeaderValue| is == value);
    request.method().is_safe() && is("sec-fetch-mode", "navigate") && is("sec-fetch-dest", "document")
}

/// Refuses a query for calls that have none.
pub(super) async fn no_query(request: Request, next: Next) -> Response {
    match request.uri().query() {
        None | Some("") => next.run(request).await,
        Some(_) => Problem::refused("this call takes no query").into_response(),
    }
}

/// The query of a request.
pub(super) struct QueryParameters<T>(pub(super) T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequestParts<S> for QueryParameters<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Problem> {
        let query = Query::try_from_uri(&parts.uri);
        query.map(|Query(query)| Self(query)).map_err(|error| {
            // The source of the error has the reason without the name of the framework.
            let why = error.source().map_or_else(|| error.to_string(), ToString::to_string);
            Problem::refused(of_serde(&why, "the query"))
        })
    }
}

fn has_body(headers: &HeaderMap) -> bool {
    let length = headers.get(header::CONTENT_LENGTH);
    headers.contains_key(header::TRANSFER_ENCODING) || length.is_some_and(|length| length != "0")
}

/// Returns true if a request has this media type. A browser asks before it sends one of those that the API takes.
fn is_media(headers: &HeaderMap, wanted: &str) -> bool {
    let media = headers.get(header::CONTENT_TYPE).and_then(|media| media.to_str().ok()).unwrap_or("");
    media.split(';').next().unwrap_or("").trim().eq_ignore_ascii_case(wanted)
}

/// The body of a request, read from JSON.
pub(super) struct Body<T>(pub(super) T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequest<S> for Body<T> {
    type Rejection = Problem;

    async fn from_request(request: Request, state: &S) -> Result<Self, Problem> {
        let bytes = tokio::time::timeout(BODY_TIME, Bytes::from_request(request, state)).await;
        let bytes = bytes.map_err(|_| Problem::new(StatusCode::REQUEST_TIMEOUT, "the body took too long"))?;
        let bytes = bytes.map_err(|error| {
            let detail = match error.status() {
                StatusCode::PAYLOAD_TOO_LARGE => format!("a body has at most {BODY_BYTES} bytes"),
                _ => "the body cannot be read".into(),
            };
            Problem::new(error.status(), detail)
        })?;
        // Serde would accept an array for a struct. The API's description does not allow that.
        if bytes.trim_ascii_start().starts_with(b"[") {
            return Err(Problem::refused("the body is an array; this call takes an object"));
        }
        serde_json::from_slice(&bytes).map(Self).map_err(|error| {
            let status =
                if error.is_data() { StatusCode::UNPROCESSABLE_ENTITY } else { StatusCode::BAD_REQUEST };
            Problem::new(status, sentence(&error))
        })
    }
}

/// Error of a body, in one sentence.
fn sentence(error: &serde_json::Error) -> String {
    if !error.is_data() {
        return format!("the body is not JSON: line {}, column {}", error.line(), error.column());
    }
    of_serde(&error.to_string(), "the body")
}

/// An error of serde about the body or the query, in one sentence.
fn of_serde(words: &str, place: &str) -> String {
    let words = words.split(" at line ").next().unwrap_or(words);
    let member = if place == "the query" { "parameter" } else { "member" };
    let names = |words: &str| words.replace('`', "'").replace("f64", "a number");
    let whole = |words: &str| {
        let shapes = [
            ("u8", "a whole number from 0 to 255"),
            ("u16", "a whole number from 0 to 65535"),
            ("u32", "a whole number from 0 to 4294967295"),
            ("u64", "a whole number from 0 on"),
            ("i64", "a whole number"),
            ("f64", "a number"),
            ("a boolean", "true or false"),
            ("a string", "a text"),
            ("a map", "an object"),
            ("map", "an object"),
            ("sequence", "a list"),
        ];
        let words = if words.starts_with("struct ") { "a map" } else { words };
        let known = shapes.into_iter().find(|(shape, _)| *shape == words);
        known.map_or_else(|| names(words), |(_, text)| text.to_owned())
    };
    let expected = words.split_once(", expected ");
    if let Some((name, expected)) =
        words.split_once("unknown field ").map(|(_, words)| words).and_then(|words| words.split_once(", "))
    {
        let allowed = expected.trim_start_matches("expected ").trim_start_matches("one of ");
        return format!(
            "{place} has no {member} {}; allowed: {}",
            names(name),
            names(allowed).replace('\'', "")
        );
    }
    let literals = [
        ("invalid float literal", "takes a number"),
        ("invalid digit found in string", "takes a whole number from 0 on"),
        ("number too large to fit in target type", "takes a smaller number"),
        ("cannot parse", "takes another value"),
    ];
    if let Some((literal, allowed)) = literals.into_iter().find(|(literal, _)| words.contains(literal)) {
        let name = words.split_once(literal).map_or("", |(name, _)| name).trim_end_matches([':', ' ']);
        let name = if name.is_empty() { place.to_owned() } else { format!("{name} in {place}") };
        return format!("{name} {allowed}");
    }
    if let Some(name) = words.strip_prefix("missing field ") {
        return format!("{place} needs the {member} {}", names(name));
    }
    if let Some((got, expected)) = expected {
        let got = got.trim_start_matches("invalid type: ").trim_start_matches("invalid value: ");
        let got = ["floating point ", "integer ", "string ", "boolean "]
            .iter()
            .fold(got, |got, prefix| got.trim_start_matches(prefix))
            .trim();
        let got = got.split_once("unknown variant ").map_or(got, |(_, name)| name);
        let expected = expected.trim_start_matches("one of ");
        return format!("{place} has {} where it takes {}", whole(got), whole(expected));
    }
    format!("{place} is not valid: {}", names(words).trim_end_matches(','))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_wrong_with_a_body() {
        #[derive(serde::Deserialize)]
        #[serde(deny_unknown_fields)]
        #[expect(dead_code, reason = "only read")]
        struct Train {
            count: u32,
            hz: f64,
            action: Option<Action>,
        }
        #[derive(serde::Deserialize)]
        #[serde(rename_all = "lowercase")]
        enum Action {
            On,
            Off,
        }
        for (body, expected) in [
            ("{", "the body is not JSON: line 1, column 1"),
            ("{}", "the body needs the member 'count'"),
            (r#"{"count": 1, "hertz": 1}"#, "the body has no member 'hertz'; allowed: count, hz, action"),
            (r#"{"count": 0.5}"#, "the body has '0.5' where it takes a whole number from 0 to 4294967295"),
            (r#"{"count": -1}"#, "the body has '-1' where it takes a whole number from 0 to 4294967295"),
            (r#"{"count": 1, "hz": "fast"}"#, "the body has \"fast\" where it takes a number"),
            (r#"{"count": true}"#, "the body has 'true' where it takes a whole number from 0 to 4294967295"),
            (r#"{"count": {}}"#, "the body has an object where it takes a whole number from 0 to 4294967295"),
            (r#"{"count": []}"#, "the body has a list where it takes a whole number from 0 to 4294967295"),
            ("3", "the body has '3' where it takes an object"),
            (r#"{"action": "up"}"#, "the body has 'up' where it takes 'on' or 'off'"),
        ] {
            let error = serde_json::from_str::<Train>(body).err().unwrap();
            assert_eq!(sentence(&error), expected, "{body}");
        }
        for (words, expected) in [
            ("since: invalid float literal", "since in the query takes a number"),
            (
                "function: invalid digit found in string",
                "function in the query takes a whole number from 0 on",
            ),
            (
                "unknown field `regs`, expected `since` or `register`",
                "the query has no parameter 'regs'; allowed: since or register",
            ),
        ] {
            assert_eq!(of_serde(words, "the query"), expected);
        }
    }

    #[test]
    fn hosts() {
        let allowed: Arc<[String]> = ["rig.lab".into()].into();
        let hosts = Hosts { here: "192.168.1.5:80".parse().unwrap(), allowed };
        for ours in [
            "localhost",
            "LOCALHOST:8080",
            "127.0.0.1",
            "127.1.2.3:1",
            "[::1]",
            "[::1]:8080",
            "192.168.1.5",
            "Rig.Lab",
            "rig.lab:8080",
        ] {
            assert!(hosts.accept(ours), "{ours}");
        }
        for foreign in [
            "",
            ":80",
            "example.com",
            "example.com:80",
            "localhost.example.com",
            "127.0.0.1.nip.io",
            "10.0.0.1",
            "[::1]evil.com",
            "[::1]:evil.com",
            "[::1",
            "localhost:evil.com",
            "127.0.0.1:80:evil.com",
            "evil.rig.lab",
        ] {
            assert!(!hosts.accept(foreign), "{foreign}");
        }
    }

    #[test]
    fn media_types() {
        let json = |media: &'static str| {
            let headers = HeaderMap::from_iter([(header::CONTENT_TYPE, media.parse().unwrap())]);
            is_media(&headers, "application/json")
        };
        assert!(json("application/json"));
        assert!(json("Application/JSON; charset=utf-8"));
        assert!(!json("text/plain"));
        assert!(!json("application/jsonp"));
        assert!(!is_media(&HeaderMap::new(), "application/json"));
    }
}
