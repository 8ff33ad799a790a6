//! The address of a control API.

use std::fmt;
use std::str::FromStr;

/// Address of a control API: `http://HOST:PORT`, with a path in front of `/api` if it is behind a proxy, and `#/NAME` behind
/// it for a drive, as the page has it in the bar of a browser.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Address {
    /// Host and port.
    authority: String,
    /// Path in front of `/api`, without a slash at its end.
    prefix: String,
    drive: Option<String>,
}

impl Address {
    /// Host and port, as a socket takes them and as the header `Host` has them.
    pub(crate) fn authority(&self) -> &str {
        &self.authority
    }

    /// The drive that is chosen at first.
    pub(crate) fn drive(&self) -> Option<&str> {
        self.drive.as_deref()
    }

    /// The path of a call.
    pub(crate) fn path(&self, call: &str) -> String {
        format!("{}{call}", self.prefix)
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "http://{}{}", self.authority, self.prefix)
    }
}

impl FromStr for Address {
    type Err = String;

    /// Reads `http://HOST:PORT`; the scheme may be left out, and with it the port, which is then 80.
    fn from_str(text: &str) -> Result<Self, String> {
        let example = "http://127.0.0.1:8080 is an address";
        let (is_url, rest) = match text.split_once("://") {
            Some(("http", rest)) => (true, rest),
            Some(("https", _)) => {
                return Err("the control API has no TLS; forward its port with `ssh -L`".to_owned());
            }
            Some(_) => return Err(format!("'{text}' is not an address of a control API; {example}")),
            None => (false, text),
        };
        let (rest, route) = rest.split_once('#').unwrap_or((rest, ""));
        let drive = route.strip_prefix('/').filter(|name| !name.is_empty()).and_then(decoded);
        let (authority, path) = rest.split_once('/').unwrap_or((rest, ""));
        let (host, port) = match authority.rsplit_once(':') {
            Some((host, port)) if !port.ends_with(']') => (host, Some(port)),
            _ => (authority, None),
        };
        let is_name = |c: char| c.is_ascii_alphanumeric() || "-._".contains(c);
        let is_bare = match host.strip_prefix('[').and_then(|host| host.strip_suffix(']')) {
            Some(inside) => inside.parse::<std::net::Ipv6Addr>().is_ok(),
            None => !host.is_empty() && host.chars().all(is_name),
        };
        let is_plain = path.chars().all(|c| c.is_ascii_graphic() && c != '?');
        if !is_bare || !is_plain {
            return Err(format!("'{text}' is not an address of a control API; {example}"));
        }
        let port = match port {
            Some(port) => {
                port.parse::<u16>().map_err(|_| format!("'{port}' is not a port, 0 to 65535; {example}"))?
            }
            None if is_url => 80,
            None => return Err(format!("'{text}' has no port; {example}")),
        };
        let prefix = path.trim_end_matches('/');
        let slash = if prefix.is_empty() { "" } else { "/" };
        Ok(Self { authority: format!("{host}:{port}"), prefix: format!("{slash}{prefix}"), drive })
    }
}

/// A segment of a path as a name; `None` if it is not one.
fn decoded(segment: &str) -> Option<String> {
    let mut parts = segment.split('%');
    let mut name = parts.next()?.as_bytes().to_vec();
    for part in parts {
        let (digits, rest) = part.split_at_checked(2)?;
        name.push(u8::from_str_radix(digits, 16).ok()?);
        name.extend_from_slice(rest.as_bytes());
    }
    String::from_utf8(name).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<(String, String), String> {
        text.parse().map(|address: Address| (address.to_string(), address.path("/api/live")))
    }

    #[test]
    fn addresses() {
        let same = ["http://127.0.0.1:8080", "127.0.0.1:8080", "http://127.0.0.1:8080/"];
        for text in same {
            assert_eq!(read(text), Ok(("http://127.0.0.1:8080".into(), "/api/live".into())));
        }
        assert_eq!(read("http://bench-7"), Ok(("http://bench-7:80".into(), "/api/live".into())));
        assert_eq!(read("[::1]:80"), Ok(("http://[::1]:80".into(), "/api/live".into())));
        let behind = read("http://lab.example:9000/benches/7/");
        assert_eq!(behind, Ok(("http://lab.example:9000/benches/7".into(), "/benches/7/api/live".into())));
    }

    #[test]
    fn addresses_of_the_bar_of_a_browser() {
        let drive = |text: &str| {
            let address: Address = text.parse().expect("an address");
            (address.to_string(), address.drive)
        };
        let bench = || "http://127.0.0.1:8080".to_owned();
        assert_eq!(drive("http://127.0.0.1:8080/#/md3"), (bench(), Some("md3".into())));
        // As the browser writes `Prüfstand 1`.
        let name = drive("127.0.0.1:8080/#/Pr%C3%BCfstand%201");
        assert_eq!(name, (bench(), Some("Prüfstand 1".into())));
        for text in ["/#/", "/#", "/", "/#/%", "/#/%zz", "/#/%C3", "/#md3"] {
            assert_eq!(drive(&format!("{}{text}", bench())), (bench(), None), "{text}");
        }
    }

    #[test]
    fn what_is_no_address_says_so() {
        assert_eq!(
            read("bench-7").unwrap_err(),
            "'bench-7' has no port; http://127.0.0.1:8080 is an address"
        );
        assert_eq!(
            read("https://bench-7:8080").unwrap_err(),
            "the control API has no TLS; forward its port with `ssh -L`"
        );
        assert_eq!(
            read("bench-7:80000").unwrap_err(),
            "'80000' is not a port, 0 to 65535; http://127.0.0.1:8080 is an address"
        );
        for text in ["", "http://", ":80", "ftp://a:21", "a b:80", "me@a:80", "a:80/x y", "[x]:80", "a:80/?q"]
        {
            assert!(read(text).is_err(), "{text}");
        }
    }
}
