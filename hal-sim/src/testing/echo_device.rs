//! Test device with two TCP ports. On the Modbus/TCP port it sends each ADU back, on the port for text lines
//! most characters.

use drivetwin_firmware::device::{
    Boot, Context, Device, Duration, Framing, Input, Instant, Link, LogEvent, Output, Port, PortSpec,
    PresetError, Spec,
};

static SPEC: Spec = Spec {
    kind: "echo",
    product: "an echo",
    manual: "this file",
    ports: &[
        PortSpec { name: "modbus", framing: Framing::Mbap, line: None },
        PortSpec { name: "mcode", framing: Framing::Return, line: None },
    ],
    ..Spec::EMPTY
};

/// The Modbus/TCP port.
pub const MODBUS: Port = Port(0);
/// The port for text lines.
pub const MCODE: Port = Port(1);

/// Maximum number of connections of the text port.
const MOST: u8 = 4;

/// A device that echoes. On its text port it greets each client with `>`. `x` closes the connection, `f`
/// sends 1 MiB, and `t` sends `T` at once and then every second until the connection is closed.
#[derive(Debug, Default)]
pub struct EchoDevice {
    /// Interval at which the device sends `T` to connection 0 from power-on, even if that is not open.
    pub ring: Option<Duration>,
    /// Time and connection of the next `T`.
    pub due: Option<(Instant, Link)>,
}

impl EchoDevice {
    fn answer(&mut self, at: Instant, link: Link, text: &[u8], out: &mut dyn Context) {
        for byte in text {
            let say = |bytes: &[u8], out: &mut dyn Context| {
                out.put(at, Output::Message { port: MCODE, link, bytes });
            };
            match byte {
                b'x' => out.put(at, Output::Close { port: MCODE, link }),
                b'f' => say(&vec![b'.'; 1 << 20], out),
                b't' => self.due = Some((at, link)),
                &other => say(&[other], out),
            }
        }
    }
}

impl Device for EchoDevice {
    fn spec(&self) -> &'static Spec {
        &SPEC
    }

    fn power_on(&mut self, at: Instant, _boot: Boot, _out: &mut dyn Context) {
        self.due = self.ring.map(|ring| (at + ring, Link(0)));
    }

    fn input(&mut self, at: Instant, input: Input<'_>, out: &mut dyn Context) {
        match input {
            Input::Opened { port: MCODE, link } if link.0 >= MOST => {
                out.put(at, Output::Close { port: MCODE, link });
            }
            Input::Opened { port: MCODE, link } => {
                out.put(at, Output::Message { port: MCODE, link, bytes: b">" });
            }
            Input::Message { port: MODBUS, link, bytes } => {
                out.put(at, Output::Message { port: MODBUS, link, bytes });
                let &[unit, function, ..] = bytes.get(6..).unwrap_or_default() else { return };
                out.put(at, Output::Log(LogEvent::Request { port: MODBUS, unit, function }));
            }
            Input::Message { link, bytes, .. } => self.answer(at, link, bytes, out),
            Input::Closed { port: MCODE, link } => self.due = self.due.filter(|(_, to)| *to != link),
            _ => {}
        }
    }

    fn deadline(&self) -> Instant {
        self.due.map_or(Instant::NEVER, |(due, _)| due)
    }

    fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        let Some((due, link)) = self.due.filter(|(due, _)| *due <= at) else { return };
        out.put(at, Output::Message { port: MCODE, link, bytes: b"T" });
        self.due = Some((due + self.ring.unwrap_or(Duration::secs(1)), link));
    }

    fn peek(&self, _at: Instant, _row: usize) -> i64 {
        0
    }

    fn poke(&mut self, _: Instant, _row: usize, _: i64, _: &mut dyn Context) -> Result<(), PresetError> {
        Err(PresetError::NoSuchRegister)
    }
}
