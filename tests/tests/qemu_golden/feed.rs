//! Inputs of a trace as inputs of the board.

use std::fmt;

use drivetwin_firmware::device::{Fault, Instant, Spec};
use drivetwin_sim::record::trace::{Event, InputRecord, Power, Trace};

use crate::expected::Expected;
use crate::host::Connection;
use crate::machine::Gpio;

/// An input of the board.
#[derive(Clone)]
pub(crate) enum Act {
    /// The bus receives a character.
    Character(u8),
    /// A client connects.
    Open(Connection),
    /// The client sends bytes.
    Say(Connection, Vec<u8>),
    /// The client closes its connection.
    Close(Connection),
    /// An input pin is driven high (true) or low.
    Drive(&'static str, Gpio, bool),
    /// Power is switched on (true) or off.
    Power(bool),
}

impl fmt::Display for Act {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Character(byte) => write!(f, "the character {byte:02X}"),
            Self::Open(connection) => write!(f, "{connection:?}"),
            Self::Say(connection, bytes) => write!(f, "on {connection:?}: {}", bytes.escape_ascii()),
            Self::Close(connection) => write!(f, "the end of {connection:?}"),
            Self::Drive(name, gpio, high) => {
                write!(f, "{name} ({gpio}) {}", if *high { "high" } else { "low" })
            }
            Self::Power(on) => write!(f, "power {}", if *on { "on" } else { "off" }),
        }
    }
}

/// Inputs of a trace, ordered by time, each character at its own instant.
pub(crate) fn acts(
    trace: &Trace,
    expected: &Expected,
    spec: &'static Spec,
    gpio: &dyn Fn(&str) -> Option<Gpio>,
) -> Vec<(Instant, Act)> {
    let wired = |name: &str| gpio(name).unwrap_or_else(|| panic!("{name} is not wired"));
    let mut acts = Vec::new();
    for entry in trace.events() {
        let Event::Input(fed) = &entry.event else { continue };
        match fed {
            InputRecord::Bytes { bytes, .. } => {
                let character = expected.line(entry.at).character();
                acts.extend(
                    (0..)
                        .zip(bytes.iter())
                        .map(|(n, byte)| (entry.at + character * n, Act::Character(*byte))),
                );
            }
            InputRecord::Opened { port, link } => acts.push((entry.at, Act::Open((*port, *link)))),
            InputRecord::Message { port, link, bytes } => {
                acts.push((entry.at, Act::Say((*port, *link), bytes.clone())));
            }
            InputRecord::Closed { port, link } => acts.push((entry.at, Act::Close((*port, *link)))),
            InputRecord::Edge { pin, high } => {
                let name = spec.pins[usize::from(pin.0)].name;
                acts.push((entry.at, Act::Drive(name, wired(name), *high)));
            }
            InputRecord::Fault { fault: Fault(fault), on } => {
                let name = spec.faults[usize::from(*fault)];
                acts.push((entry.at, Act::Drive(name, wired(name), !on)));
            }
            InputRecord::HostPresence { here, .. } => {
                acts.push((entry.at, Act::Drive("DTR", wired("DTR"), !here)));
            }
            InputRecord::Power(power @ (Power::On | Power::Off)) => {
                acts.push((entry.at, Act::Power(*power == Power::On)));
            }
            other => panic!("the board has no such input: {other:?}"),
        }
    }
    acts.sort_by_key(|(at, _)| *at);
    acts
}
