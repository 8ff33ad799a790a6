//! Listening addresses of ports, as users write them.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

/// Listening address of a port: `[PORT=]URI`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Listen {
    /// Name of the port; `None`: the first port of the drive.
    pub port: Option<String>,
    /// Listening address.
    pub uri: Uri,
}

/// Kind and address of a listening address.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Uri {
    /// A pseudo terminal, and the path of its link, if any.
    Pty(Option<PathBuf>),
    /// `HOST:PORT`, raw bytes.
    Tcp(String),
    /// `HOST:PORT`, a serial port with its settings and modem lines over Telnet (RFC 2217).
    Rfc2217(String),
    /// A serial port of this machine.
    Serial(PathBuf),
    /// Standard input and output of this process.
    Stdio,
}

impl fmt::Display for Uri {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Pty(None) => f.write_str("pty:"),
            Self::Pty(Some(link)) => write!(f, "pty:{}", link.display()),
            Self::Tcp(address) => write!(f, "tcp:{address}"),
            Self::Rfc2217(address) => write!(f, "rfc2217:{address}"),
            Self::Serial(path) => write!(f, "serial:{}", path.display()),
            Self::Stdio => f.write_str("stdio:"),
        }
    }
}

/// Returns true if a text is `HOST:PORT`.
#[must_use]
pub fn is_host_and_port(text: &str) -> bool {
    text.rsplit_once(':').is_some_and(|(host, port)| {
        let is_host = !host.is_empty() && !host.contains('/');
        is_host && port.parse::<u16>().is_ok()
    })
}

impl FromStr for Listen {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        // The name of a port is before the scheme of the URI. The path of a link may contain any character.
        let (port, uri) = match text.split_once('=') {
            Some((port, uri)) if !port.contains(':') => (Some(port.to_owned()), uri),
            _ => (None, text),
        };
        Ok(Self { port, uri: uri.parse()? })
    }
}

impl FromStr for Uri {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let takes = || {
            "it takes pty:, pty:LINK, tcp:HOST:PORT, rfc2217:HOST:PORT, serial:DEVICE or stdio:".to_owned()
        };
        let (scheme, rest) = text.split_once(':').ok_or_else(takes)?;
        match scheme {
            "pty" => Ok(Self::Pty((!rest.is_empty()).then(|| rest.into()))),
            "tcp" if is_host_and_port(rest) => Ok(Self::Tcp(rest.into())),
            "tcp" => Err("tcp: takes HOST:PORT, like tcp:127.0.0.1:5020 (port 0: any free one)".into()),
            "rfc2217" if is_host_and_port(rest) => Ok(Self::Rfc2217(rest.into())),
            "rfc2217" => {
                Err("rfc2217: takes HOST:PORT, like rfc2217:127.0.0.1:5020 (port 0: any free one)".into())
            }
            "serial" if !rest.is_empty() => Ok(Self::Serial(rest.into())),
            "serial" => Err("serial: takes a device, like serial:/dev/ttyUSB0".into()),
            "stdio" if rest.is_empty() => Ok(Self::Stdio),
            _ => Err(takes()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_to_listen() {
        let listen = |text: &str| text.parse::<Listen>();
        let at = |port: Option<&str>, uri| Ok(Listen { port: port.map(Into::into), uri });
        assert_eq!(listen("pty:"), at(None, Uri::Pty(None)));
        assert_eq!(listen("pty:a=b.tty"), at(None, Uri::Pty(Some("a=b.tty".into()))));
        assert_eq!(listen("rs485=tcp:[::1]:0"), at(Some("rs485"), Uri::Tcp("[::1]:0".into())));
        let remote = || Uri::Rfc2217("[::1]:5020".into());
        assert_eq!(listen("rfc2217:[::1]:5020"), at(None, remote()));
        assert_eq!(remote().to_string(), "rfc2217:[::1]:5020");
        assert_eq!(listen("serial:/dev/ttyUSB0"), at(None, Uri::Serial("/dev/ttyUSB0".into())));
        assert_eq!(listen("usb=stdio:"), at(Some("usb"), Uri::Stdio));
        for wrong in [
            "",
            "tcp",
            "tcp:",
            "tcp:5020",
            "tcp::5020",
            "tcp:a:70000",
            "tcp://127.0.0.1:5020",
            "rfc2217:",
            "rfc2217:5020",
            "rfc2217://127.0.0.1:5020",
            "udp:1:2",
            "rs485=",
            "/dev/pts/4",
            "serial:",
            "stdio:x",
        ] {
            assert!(listen(wrong).is_err(), "{wrong}");
        }
    }
}
