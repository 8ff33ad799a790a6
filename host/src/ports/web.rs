//! Browsers that are led to a drive.
//!
//! A web page may send a POST to any port of the machine that shows it, and a drive would carry out the lines or frames
//! in its body. A connection that begins with the first line of an HTTP request is closed before the drive hears a
//! byte. So is one to a TCP port of a drive that begins as TLS does, which a browser may try first: its second byte is
//! Ctrl-C.

/// Methods that a browser sends.
const METHODS: [&[u8]; 9] =
    [b"GET", b"HEAD", b"POST", b"PUT", b"DELETE", b"CONNECT", b"OPTIONS", b"TRACE", b"PATCH"];

/// End of the first line, without the minor version.
const VERSION: &[u8] = b" HTTP/1.";

/// Bytes of a target, at most. A longer one is a browser's, too.
const MOST_TARGET: usize = 8_192;

/// A record of a handshake, and the major version (RFC 8446, 5.1); the minor one is not 0, which a header of Modbus/TCP
/// has there. On a serial line it may be a request to address 22.
const TLS: &[u8] = &[22, 3];

/// The beginning of a connection, as long as it may be that of a browser's.
pub(super) struct Gate {
    beginning: Vec<u8>,
    /// True if TLS is refused, too.
    knows_tls: bool,
}

/// The judgement of a beginning.
#[derive(PartialEq, Eq, Debug)]
pub(super) enum Judged {
    /// The beginning of an HTTP request, so far.
    Unclear,
    /// No browser's: the drive hears these bytes.
    Ordinary(Vec<u8>),
    /// An HTTP request, or a handshake of TLS.
    Web,
}

impl Gate {
    /// The gate of a new connection: to a TCP port of a drive, or to a line.
    pub(super) fn new(is_line: bool) -> Self {
        Self { beginning: Vec::new(), knows_tls: !is_line }
    }

    /// Judges the beginning with these bytes behind it.
    pub(super) fn judge(&mut self, bytes: &[u8]) -> Judged {
        self.beginning.extend_from_slice(bytes);
        let is_web = match self.beginning.strip_prefix(TLS) {
            Some([]) if self.knows_tls => None,
            Some([1..=4, ..]) if self.knows_tls => Some(true),
            None if self.knows_tls && TLS.starts_with(&self.beginning) => None,
            _ => is_request(&self.beginning),
        };
        match is_web {
            None => Judged::Unclear,
            Some(true) => Judged::Web,
            Some(false) => Judged::Ordinary(self.release()),
        }
    }

    /// The bytes of a connection that has ended before they were judged.
    pub(super) fn release(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.beginning)
    }
}

/// Returns whether `beginning` is that of an HTTP request with a whole first line; `None` while it may become one.
fn is_request(beginning: &[u8]) -> Option<bool> {
    let Some(blank) = beginning.iter().position(|&byte| byte == b' ') else {
        return if METHODS.iter().any(|method| method.starts_with(beginning)) { None } else { Some(false) };
    };
    let (method, target) = beginning.split_at(blank);
    if !METHODS.contains(&method) {
        return Some(false);
    }
    let target = &target[1..];
    let length = target.iter().position(|byte| !byte.is_ascii_graphic()).unwrap_or(target.len());
    let version = &target[length..];
    match version.split_at_checked(VERSION.len()) {
        _ if length > MOST_TARGET => Some(true),
        _ if length == 0 && !target.is_empty() => Some(false),
        // A minor version and CR; some leave CR out.
        Some((VERSION, rest)) => match rest {
            [] | [b'0'..=b'9'] => None,
            [b'0'..=b'9', b'\r' | b'\n', ..] => Some(true),
            _ => Some(false),
        },
        Some(_) => Some(false),
        None if VERSION.starts_with(version) => None,
        None => Some(false),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The judgements of a beginning that comes a byte at a time, but for `Unclear`, and at which byte.
    fn first(bytes: &[u8]) -> (usize, Judged) {
        let mut gate = Gate::new(false);
        for (place, byte) in bytes.iter().enumerate() {
            match gate.judge(&[*byte]) {
                Judged::Unclear => {}
                judged => return (place + 1, judged),
            }
        }
        (bytes.len(), Judged::Unclear)
    }

    #[test]
    fn first_lines_of_browsers_are_http() {
        for line in [
            "GET / HTTP/1.1\r\n",
            "POST /x?y=z HTTP/1.1\r\n",
            "OPTIONS * HTTP/1.0\r\n",
            "CONNECT localhost:503 HTTP/1.1\r\n",
            "PUT http://localhost:503/ HTTP/1.1\n",
        ] {
            assert_eq!(first(line.as_bytes()), (line.find(['\r', '\n']).unwrap() + 1, Judged::Web), "{line}");
            assert_eq!(Gate::new(false).judge(line.as_bytes()), Judged::Web);
            let body = format!("{line}Host: localhost:503\r\n\r\nMR 1000\r");
            assert_eq!(Gate::new(false).judge(body.as_bytes()), Judged::Web);
        }
        let long = format!("GET /{} HTTP/1.1\r\n", "a".repeat(10_000));
        assert_eq!(first(long.as_bytes()), (MOST_TARGET + 5, Judged::Web));
    }

    #[test]
    fn other_bytes_pass_at_the_first_that_differs() {
        // MCode; RTU to addresses 71 (G), 80 (P) and 72 (H); Modbus/TCP with transactions 4745 and 504F; a QSB.
        for (bytes, at) in [
            (&b"PR P\r"[..], 2),
            (b"PS\r", 2),
            (b"H 100\r", 2),
            (b"GETS\r", 4),
            (b"GET\r", 4),
            (b"GET \r", 5),
            (b"GET  HTTP/1.1\r", 5),
            (b"GET 1\r", 6),
            (b"GET / HTTP/2.0\r", 12),
            (b"GET / HTTP/1.x\r", 14),
            (b"GET / HTTP/1.10\r", 15),
            (b"get / HTTP/1.1\r", 1),
            (&[71, 3, 0, 1, 0, 1], 2),
            (&[80, 16, 0, 1], 2),
            (&[72, 69, 0], 3),
            (&[0x47, 0x45, 0, 0, 0, 6], 3),
            (&[0x50, 0x4F, 0, 0, 0, 6], 3),
            (b"R0E\r", 1),
            (b"\r", 1),
        ] {
            assert_eq!(first(bytes), (at, Judged::Ordinary(bytes[..at].to_vec())), "{bytes:?}");
            assert_eq!(Gate::new(false).judge(bytes), Judged::Ordinary(bytes.to_vec()));
        }
        // TLS on a TCP port; on a line a request to address 22.
        let hello = [0x16, 3, 1, 2, 0, 1];
        assert_eq!(first(&hello), (3, Judged::Web));
        let transaction = [0x16, 3, 0, 0, 0, 6];
        assert_eq!(first(&transaction), (3, Judged::Ordinary(transaction[..3].to_vec())));
        assert_eq!(Gate::new(true).judge(&hello), Judged::Ordinary(hello.to_vec()));
        let mut gate = Gate::new(false);
        assert_eq!(gate.judge(b"P"), Judged::Unclear);
        assert_eq!(gate.release(), b"P");
    }
}
