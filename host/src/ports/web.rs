//! Protection of drives against browsers.
//!
//! A web page may make a browser send a POST to any port of its machine, and a drive would execute the text
//! lines or frames in the body. Therefore a connection that begins with the first line of an HTTP request is
//! closed before the drive receives a byte. A connection to a TCP port of a drive is also closed if it begins
//! with a TLS handshake, which a browser may try first: the second byte of a handshake is Ctrl-C.

/// Methods that a browser sends.
const METHODS: [&[u8]; 9] =
    [b"GET", b"HEAD", b"POST", b"PUT", b"DELETE", b"CONNECT", b"OPTIONS", b"TRACE", b"PATCH"];

/// End of the first line of a request, without the minor version.
const VERSION: &[u8] = b" HTTP/1.";

/// Maximum length of a request target in bytes. A connection with a longer target counts as a browser's.
const MOST_TARGET: usize = 8_192;

/// First bytes of TLS: a handshake record and the major version (RFC 8446, 5.1). The minor version follows;
/// it is not 0, while a Modbus/TCP header has 0 there. On a serial line the bytes may be a request to address
/// 22.
const TLS: &[u8] = &[22, 3];

/// The first bytes of a connection, while they may be those of a browser.
pub(super) struct BrowserCheck {
    beginning: Vec<u8>,
    /// True if TLS handshakes are recognized, too.
    knows_tls: bool,
}

/// Result of the check.
#[derive(PartialEq, Eq, Debug)]
pub(super) enum Verdict {
    /// The bytes so far may be the beginning of an HTTP request or a TLS handshake.
    Unclear,
    /// Not a browser. These bytes are for the drive.
    Ordinary(Vec<u8>),
    /// An HTTP request or a TLS handshake.
    Web,
}

impl BrowserCheck {
    /// The check of a new connection to a line (`is_line`) or to a TCP port of a drive.
    pub(super) fn new(is_line: bool) -> Self {
        Self { beginning: Vec::new(), knows_tls: !is_line }
    }

    /// Appends `bytes` to the first bytes of the connection and checks them.
    pub(super) fn inspect(&mut self, bytes: &[u8]) -> Verdict {
        self.beginning.extend_from_slice(bytes);
        let is_web = match self.beginning.strip_prefix(TLS) {
            Some([]) if self.knows_tls => None,
            Some([1..=4, ..]) if self.knows_tls => Some(true),
            None if self.knows_tls && TLS.starts_with(&self.beginning) => None,
            _ => is_request(&self.beginning),
        };
        match is_web {
            None => Verdict::Unclear,
            Some(true) => Verdict::Web,
            Some(false) => Verdict::Ordinary(self.release()),
        }
    }

    /// Takes the bytes of a connection that ended before the check was complete.
    pub(super) fn release(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.beginning)
    }
}

/// Returns true if `beginning` has the whole first line of an HTTP request, and `None` if further bytes may
/// complete one.
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
        // The digit of the minor version and CR LF; some programs send LF only.
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

    /// Checks `bytes` one at a time. Returns the first verdict other than `Unclear`, and the number of bytes
    /// it took.
    fn first(bytes: &[u8]) -> (usize, Verdict) {
        let mut check = BrowserCheck::new(false);
        for (index, byte) in bytes.iter().enumerate() {
            match check.inspect(&[*byte]) {
                Verdict::Unclear => {}
                verdict => return (index + 1, verdict),
            }
        }
        (bytes.len(), Verdict::Unclear)
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
            assert_eq!(
                first(line.as_bytes()),
                (line.find(['\r', '\n']).unwrap() + 1, Verdict::Web),
                "{line}"
            );
            assert_eq!(BrowserCheck::new(false).inspect(line.as_bytes()), Verdict::Web);
            let body = format!("{line}Host: localhost:503\r\n\r\nMR 1000\r");
            assert_eq!(BrowserCheck::new(false).inspect(body.as_bytes()), Verdict::Web);
        }
        let long = format!("GET /{} HTTP/1.1\r\n", "a".repeat(10_000));
        assert_eq!(first(long.as_bytes()), (MOST_TARGET + 5, Verdict::Web));
    }

    #[test]
    fn other_bytes_pass_at_the_first_that_differs() {
        // MCode; RTU to addresses 71 (G), 80 (P) and 72 (H); Modbus/TCP with transactions 0x4745 and 0x504F;
        // a QSB.
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
            assert_eq!(first(bytes), (at, Verdict::Ordinary(bytes[..at].to_vec())), "{bytes:?}");
            assert_eq!(BrowserCheck::new(false).inspect(bytes), Verdict::Ordinary(bytes.to_vec()));
        }
        // A TLS handshake at a TCP port; on a serial line the same bytes are a request to address 22.
        let hello = [0x16, 3, 1, 2, 0, 1];
        assert_eq!(first(&hello), (3, Verdict::Web));
        let transaction = [0x16, 3, 0, 0, 0, 6];
        assert_eq!(first(&transaction), (3, Verdict::Ordinary(transaction[..3].to_vec())));
        assert_eq!(BrowserCheck::new(true).inspect(&hello), Verdict::Ordinary(hello.to_vec()));
        let mut check = BrowserCheck::new(false);
        assert_eq!(check.inspect(b"P"), Verdict::Unclear);
        assert_eq!(check.release(), b"P");
    }
}
