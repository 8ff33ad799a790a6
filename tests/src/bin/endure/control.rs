//! The control API, as a client of HTTP.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::time::Duration;

/// Longest wait for an answer.
const PATIENCE: Duration = Duration::from_secs(30);

/// Address of the control API.
#[derive(Clone)]
pub(crate) struct Control(pub(crate) String);

impl Control {
    /// Sends a request on a connection of its own; returns status and body.
    pub(crate) fn call(&self, method: &str, path: &str, body: &str) -> Result<(u16, String), String> {
        let mut stream = self.request(method, path, body)?;
        let mut answer = String::new();
        stream
            .read_to_string(&mut answer)
            .map_err(|error| format!("{method} {path} of the control API has no answer: {error}"))?;
        let status = answer.split(' ').nth(1).and_then(|status| status.parse().ok());
        let status = status.ok_or_else(|| {
            format!("{method} {path} of the control API answers {answer:?}, which is no HTTP")
        })?;
        let body = answer.split_once("\r\n\r\n").map_or("", |(_, body)| body);
        Ok((status, body.to_owned()))
    }

    /// Begins a request on a connection of its own.
    pub(crate) fn request(&self, method: &str, path: &str, body: &str) -> Result<TcpStream, String> {
        let text = format!(
            "{method} {path} HTTP/1.1\r\nHost: {0}\r\nConnection: close\r\nContent-Type: application/json\r\nContent-Length: {1}\r\n\r\n{body}",
            self.0,
            body.len()
        );
        let begin = || {
            let mut stream = TcpStream::connect(&self.0)?;
            stream.set_nodelay(true)?;
            stream.set_read_timeout(Some(PATIENCE))?;
            stream.write_all(text.as_bytes())?;
            Ok(stream)
        };
        begin()
            .map_err(|error: std::io::Error| format!("the control API cannot be reached for {path}: {error}"))
    }

    /// Sends a request that must succeed.
    pub(crate) fn expect(&self, method: &str, path: &str, body: &str) -> Result<String, String> {
        match self.call(method, path, body)? {
            (200..300, answer) => Ok(answer),
            (status, answer) => {
                Err(format!("{method} {path} {body} of the control API has status {status}: {answer}"))
            }
        }
    }

    /// Bench time in seconds.
    pub(crate) fn seconds(&self) -> Result<f64, String> {
        let answer = self.expect("GET", "/api/bench", "")?;
        let seconds = answer.rsplit("\"seconds\":").next().and_then(|rest| rest.split(['}', ',']).next());
        let seconds = seconds.and_then(|seconds| seconds.parse().ok());
        seconds.ok_or_else(|| format!("GET /api/bench has no bench time: {answer}"))
    }
}
