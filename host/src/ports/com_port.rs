//! A serial port of a server, as a remote master uses it: the COM port control option of Telnet (RFC 2217, HOST-24).
//!
//! [`ComPort`] knows no socket and no bench. It takes the bytes of a connection, and returns [`Event`]s for the line and
//! answers for the peer.

use drivetwin_firmware::device::Line;
use drivetwin_protocol::line::Parity;
use drivetwin_sim::line::faults::BAUDS;
use drivetwin_sim::line::{PortParity, Sender};

use super::telnet::{
    BINARY, COM_PORT, Item, Options, Parser, Verb, is_telnet, write_data, write_subnegotiation,
};

/// Commands of a client. The answer of the server has the number of its command plus [`ANSWER`].
mod command {
    pub(super) const SIGNATURE: u8 = 0;
    pub(super) const SET_BAUDRATE: u8 = 1;
    pub(super) const SET_DATASIZE: u8 = 2;
    pub(super) const SET_PARITY: u8 = 3;
    pub(super) const SET_STOPSIZE: u8 = 4;
    pub(super) const SET_CONTROL: u8 = 5;
    pub(super) const NOTIFY_LINESTATE: u8 = 6;
    pub(super) const NOTIFY_MODEMSTATE: u8 = 7;
    pub(super) const FLOWCONTROL_SUSPEND: u8 = 8;
    pub(super) const FLOWCONTROL_RESUME: u8 = 9;
    pub(super) const SET_LINESTATE_MASK: u8 = 10;
    pub(super) const SET_MODEMSTATE_MASK: u8 = 11;
    pub(super) const PURGE_DATA: u8 = 12;
}

const ANSWER: u8 = 100;

/// Text that the server calls itself.
const NAME: &[u8] = b"drivetwin";

/// State of the line: nothing waits to be sent.
const LINE_STATE: u8 = 0x60;

/// State of the modem lines: carrier, DSR and CTS are on. No drive has these lines, and a client that waits for one of
/// them would wait forever.
const MODEM_STATE: u8 = 0xB0;

/// What a peer does to the line of a drive.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) enum Event {
    /// Sends bytes, with the present settings.
    Data(Vec<u8>),
    /// Opens the port: it controls the port from now on, and DTR is on.
    Open,
    /// Sends bytes without Telnet.
    NoTelnet,
    /// Speaks Telnet, and does not control the port.
    Refuse,
    /// Changes the settings of the port.
    Settings(Sender),
    /// Switches DTR.
    Dtr(bool),
    /// Drops the characters that the drives have sent and that are not on their way to the peer.
    DropReceived,
    /// Drops its bytes that are not on the line yet.
    DropUnsent,
}

/// Language of a connection. Its first bytes decide.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Language {
    Unknown,
    /// Bytes as they are.
    Raw,
    Telnet,
}

/// The port of one connection.
pub(super) struct ComPort {
    language: Language,
    /// First bytes, while they do not decide the language.
    beginning: Vec<u8>,
    parser: Parser,
    options: Options,
    /// True while the peer controls the port.
    is_open: bool,
    /// Settings of the peer, as far as it has set them.
    settings: Sender,
    dtr: bool,
    rts: bool,
    /// While the peer holds the line in a break, its bytes are lost.
    has_break: bool,
    /// Flow control in both directions, as values of `SET_CONTROL`. It has no effect: no drive has these lines, and
    /// XON and XOFF are data for a drive.
    outbound_flow: u8,
    inbound_flow: u8,
    /// True while the peer wants no characters.
    is_suspended: bool,
}

impl ComPort {
    /// The port of a new connection.
    pub(super) fn new() -> Self {
        Self {
            language: Language::Unknown,
            beginning: Vec::new(),
            parser: Parser::default(),
            options: Options::default(),
            is_open: false,
            settings: Sender::default(),
            dtr: true,
            rts: true,
            has_break: false,
            outbound_flow: 1,
            inbound_flow: 14,
            is_suspended: false,
        }
    }

    /// Returns true while the peer wants no characters.
    pub(super) fn is_suspended(&self) -> bool {
        self.is_suspended
    }

    /// Handles the end of the peer's bytes. Returns bytes for the line that did not decide the language.
    pub(super) fn end(&mut self) -> Vec<u8> {
        self.is_suspended = false;
        std::mem::take(&mut self.beginning)
    }

    /// Handles bytes of the peer, and appends the answers. `line` is the present serial settings of the drive. The port
    /// uses them until the peer sets others.
    pub(super) fn receive(&mut self, bytes: &[u8], line: Line, answers: &mut Vec<u8>) -> Vec<Event> {
        let mut events = Vec::new();
        let beginning;
        let bytes = if self.language == Language::Unknown {
            self.beginning.extend_from_slice(bytes);
            let Some(is_telnet) = is_telnet(&self.beginning) else { return events };
            beginning = std::mem::take(&mut self.beginning);
            if is_telnet {
                self.language = Language::Telnet;
                self.propose(answers);
            } else {
                self.language = Language::Raw;
                events.push(Event::NoTelnet);
            }
            &beginning
        } else {
            bytes
        };
        if self.language == Language::Raw {
            events.push(Event::Data(bytes.to_vec()));
            return events;
        }
        for item in self.parser.parse(bytes) {
            match item {
                Item::Data(_) if self.has_break => {}
                Item::Data(bytes) => events.push(Event::Data(bytes)),
                Item::Negotiation(verb, option) => {
                    self.options.handle(verb, option, answers);
                    if option == COM_PORT {
                        self.open_or_refuse(verb, answers, &mut events);
                    }
                }
                Item::Subnegotiation(parameters) => {
                    if let &[COM_PORT, command, ref values @ ..] = parameters.as_slice() {
                        self.open(answers, &mut events);
                        self.command(command, values, line, answers, &mut events);
                    }
                }
            }
        }
        events
    }

    /// Appends characters of the drives as the peer expects them.
    pub(super) fn write(&self, characters: &[u8], into: &mut Vec<u8>) {
        if self.language == Language::Telnet {
            write_data(characters, into);
        } else {
            into.extend_from_slice(characters);
        }
    }

    /// Proposes what a serial port needs, to a peer that speaks Telnet.
    fn propose(&mut self, answers: &mut Vec<u8>) {
        self.options.propose(Verb::Do, COM_PORT, answers);
        self.options.propose(Verb::Do, BINARY, answers);
        self.options.propose(Verb::Will, BINARY, answers);
    }

    fn open_or_refuse(&mut self, verb: Verb, answers: &mut Vec<u8>, events: &mut Vec<Event>) {
        if self.options.is_on(COM_PORT) {
            self.open(answers, events);
        } else if self.is_open || verb == Verb::Wont {
            (self.is_open, self.has_break, self.is_suspended) = (false, false, false);
            self.settings = Sender::default();
            events.push(Event::Refuse);
        }
    }

    fn open(&mut self, answers: &mut Vec<u8>, events: &mut Vec<Event>) {
        if !std::mem::replace(&mut self.is_open, true) {
            (self.dtr, self.rts) = (true, true);
            events.push(Event::Open);
            answer(command::NOTIFY_MODEMSTATE, &[MODEM_STATE], answers);
        }
    }

    /// Executes a command of the client. A value that is not possible has no effect; the answer has the value that the
    /// port has. A command without its value, and an unknown one, are ignored.
    fn command(
        &mut self,
        command: u8,
        values: &[u8],
        line: Line,
        answers: &mut Vec<u8>,
        events: &mut Vec<Event>,
    ) {
        let before = self.settings;
        match (command, values) {
            (command::SIGNATURE, []) => answer(command, NAME, answers),
            (command::SET_BAUDRATE, &[a, b, c, d, ..]) => {
                let baud = u32::from_be_bytes([a, b, c, d]);
                if BAUDS.contains(&baud) {
                    self.settings.baud = Some(baud);
                }
                answer(command, &self.settings.or(line).baud.to_be_bytes(), answers);
            }
            (command::SET_DATASIZE, &[data, ..]) => {
                if (5..=8).contains(&data) {
                    self.settings.data = Some(data);
                }
                answer(command, &[self.settings.or(line).data], answers);
            }
            (command::SET_PARITY, &[number, ..]) => {
                if let Some((parity, _)) = PARITIES.into_iter().find(|(_, other)| *other == number) {
                    self.settings.parity = PortParity::Known(parity);
                }
                let parity = self.settings.or(line).parity;
                let number = PARITIES.into_iter().find(|(other, _)| *other == parity);
                answer(command, &[number.map_or(0, |(_, number)| number)], answers);
            }
            (command::SET_STOPSIZE, &[stop, ..]) => {
                if (1..=2).contains(&stop) {
                    self.settings.stop = Some(stop);
                }
                answer(command, &[self.settings.or(line).stop], answers);
            }
            (command::SET_CONTROL, &[value, ..]) => {
                if let Some(value) = self.control(value, events) {
                    answer(command, &[value], answers);
                }
            }
            (command::NOTIFY_LINESTATE, _) => answer(command, &[LINE_STATE], answers),
            (command::NOTIFY_MODEMSTATE, _) => answer(command, &[MODEM_STATE], answers),
            // The state of the lines never changes, so the masks of changes have no effect.
            (command::SET_LINESTATE_MASK | command::SET_MODEMSTATE_MASK, &[mask, ..]) => {
                answer(command, &[mask], answers);
            }
            (command::FLOWCONTROL_SUSPEND, _) => self.is_suspended = true,
            (command::FLOWCONTROL_RESUME, _) => self.is_suspended = false,
            (command::PURGE_DATA, &[which @ 1..=3, ..]) => {
                events.extend((which != 2).then_some(Event::DropReceived));
                events.extend((which != 1).then_some(Event::DropUnsent));
                answer(command, &[which], answers);
            }
            _ => {}
        }
        if self.settings != before {
            events.push(Event::Settings(self.settings));
        }
    }

    /// Executes `SET_CONTROL`. Returns the value of the answer.
    ///
    /// | value | meaning |
    /// |---|---|
    /// | 0, 4, 7, 10, 13 | asks for flow control, break, DTR, RTS, inbound flow control |
    /// | 1, 2, 3 | flow control: none, XON/XOFF, RTS/CTS; 17 DCD, 19 DSR |
    /// | 5, 6 | break on, off |
    /// | 8, 9 | DTR on, off |
    /// | 11, 12 | RTS on, off |
    /// | 14, 15, 16 | inbound flow control: none, XON/XOFF, RTS/CTS; 18 DTR |
    fn control(&mut self, value: u8, events: &mut Vec<Event>) -> Option<u8> {
        let switched = |on: bool, value: u8| if on { value } else { value + 1 };
        match value {
            // Flow control of both directions.
            1..=3 => (self.outbound_flow, self.inbound_flow) = (value, value + 13),
            17 | 19 => self.outbound_flow = value,
            14..=16 | 18 => self.inbound_flow = value,
            5 | 6 => self.has_break = value == 5,
            8 | 9 => {
                let dtr = value == 8;
                if std::mem::replace(&mut self.dtr, dtr) != dtr {
                    events.push(Event::Dtr(dtr));
                }
            }
            11 | 12 => self.rts = value == 11,
            _ => {}
        }
        match value {
            0..=3 | 17 | 19 => Some(self.outbound_flow),
            4..=6 => Some(switched(self.has_break, 5)),
            7..=9 => Some(switched(self.dtr, 8)),
            10..=12 => Some(switched(self.rts, 11)),
            13..=16 | 18 => Some(self.inbound_flow),
            _ => None,
        }
    }
}

/// Numbers of parities. There are also mark (4) and space (5), which no drive has and the port refuses.
const PARITIES: [(Parity, u8); 3] = [(Parity::None, 1), (Parity::Odd, 2), (Parity::Even, 3)];

/// Appends the answer to a command.
fn answer(command: u8, values: &[u8], answers: &mut Vec<u8>) {
    write_subnegotiation(&[&[COM_PORT, command + ANSWER], values].concat(), answers);
}

#[cfg(test)]
mod tests {
    use proptest::collection::vec;
    use proptest::prelude::*;

    use super::super::telnet::tests::{segments, some_bytes};
    use super::*;

    const LINE: Line = Line::new(9_600, 8, Parity::Even, 1);

    /// Bytes of a peer that opens the port.
    const WILL_COM_PORT: [u8; 3] = [255, 251, 44];

    /// `DO COM-PORT-OPTION`, `DO` and `WILL TRANSMIT-BINARY`.
    const PROPOSALS: [u8; 9] = [255, 253, 44, 255, 253, 0, 255, 251, 0];

    /// A port that a peer has opened.
    fn opened() -> ComPort {
        let mut port = ComPort::new();
        let (events, answers) = say(&mut port, &WILL_COM_PORT);
        assert_eq!(events, [Event::Open]);
        // 107, NOTIFY-MODEMSTATE: carrier, DSR, CTS.
        assert_eq!(answers, [&PROPOSALS[..], &[255, 250, 44, 107, 0xB0, 255, 240]].concat());
        port
    }

    fn say(port: &mut ComPort, bytes: &[u8]) -> (Vec<Event>, Vec<u8>) {
        let mut answers = Vec::new();
        let events = port.receive(bytes, LINE, &mut answers);
        (events, answers)
    }

    /// A command of a client, and the values of the answer. The answer has the number of the command plus 100.
    fn ask(port: &mut ComPort, command: u8, values: &[u8]) -> (Vec<Event>, Vec<u8>) {
        let (events, answers) = say(port, &[&[255, 250, 44, command], values, &[255, 240]].concat());
        let values = match answers.as_slice() {
            [] => Vec::new(),
            [255, 250, 44, answered, values @ .., 255, 240] if *answered == command + 100 => values.to_vec(),
            _ => panic!("{answers:?}"),
        };
        (events, values)
    }

    fn settings(baud: Option<u32>, data: Option<u8>, parity: PortParity, stop: Option<u8>) -> Event {
        Event::Settings(Sender { baud, data, parity, stop })
    }

    /// RFC 2217, section 3: a value of 0 asks; the answer has the value that the port has.
    #[test]
    fn settings_are_answered_with_what_holds() {
        let mut port = opened();
        // Before the peer has set anything, the port has the settings of the drive's line.
        assert_eq!(ask(&mut port, 1, &[0, 0, 0, 0]), (vec![], vec![0, 0, 0x25, 0x80]));
        assert_eq!(ask(&mut port, 2, &[0]), (vec![], vec![8]));
        assert_eq!(ask(&mut port, 3, &[0]), (vec![], vec![3]));
        assert_eq!(ask(&mut port, 4, &[0]), (vec![], vec![1]));
        let unknown = PortParity::Unknown;
        // 65,280 baud: 00 00 FF 00, in which 255 is sent twice.
        let (events, answer) = ask(&mut port, 1, &[0, 0, 255, 255, 0]);
        assert_eq!(events, [settings(Some(65_280), None, unknown, None)]);
        assert_eq!(answer, [0, 0, 255, 255, 0]);
        let (events, answer) = ask(&mut port, 2, &[7]);
        assert_eq!((events, answer), (vec![settings(Some(65_280), Some(7), unknown, None)], vec![7]));
        let parity = |number| ask(&mut opened(), 3, &[number]);
        for (number, parity_of) in [(1, Parity::None), (2, Parity::Odd), (3, Parity::Even)] {
            let expected = settings(None, None, PortParity::Known(parity_of), None);
            assert_eq!(parity(number), (vec![expected], vec![number]));
        }
        // Mark and space parity, one and a half stop bits, 9 data bits, 4,000,001 baud: the old value holds.
        assert_eq!(parity(4), (vec![], vec![3]));
        assert_eq!(parity(5), (vec![], vec![3]));
        assert_eq!(ask(&mut opened(), 4, &[3]), (vec![], vec![1]));
        assert_eq!(ask(&mut opened(), 2, &[9]), (vec![], vec![8]));
        assert_eq!(ask(&mut port, 1, &[0, 0x3D, 0x09, 0x01]), (vec![], vec![0, 0, 255, 255, 0]));
        assert_eq!(ask(&mut opened(), 4, &[2]), (vec![settings(None, None, unknown, Some(2))], vec![2]));
        // A value that is not complete is no value.
        assert_eq!(ask(&mut port, 1, &[0, 0, 1]), (vec![], vec![]));
        assert_eq!(ask(&mut port, 2, &[]), (vec![], vec![]));
    }

    /// RFC 2217, section 3: SET-CONTROL.
    #[test]
    fn control_lines_are_switched_and_asked() {
        let mut port = opened();
        for (value, events, answer) in [
            (7, vec![], 8),
            (9, vec![Event::Dtr(false)], 9),
            (9, vec![], 9),
            (7, vec![], 9),
            (8, vec![Event::Dtr(true)], 8),
            (10, vec![], 11),
            (12, vec![], 12),
            (10, vec![], 12),
            (11, vec![], 11),
            (0, vec![], 1),
            (3, vec![], 3),
            (13, vec![], 16),
            (14, vec![], 14),
            (0, vec![], 3),
            (19, vec![], 19),
            (0, vec![], 19),
            (2, vec![], 2),
            (13, vec![], 15),
            (4, vec![], 6),
            (5, vec![], 5),
            (4, vec![], 5),
        ] {
            assert_eq!(ask(&mut port, 5, &[value]), (events, vec![answer]), "{value}");
        }
        // During a break, bytes are lost.
        assert_eq!(say(&mut port, b"R0E\r").0, []);
        assert_eq!(ask(&mut port, 5, &[6]), (vec![], vec![6]));
        assert_eq!(say(&mut port, b"R0E\r").0, [Event::Data(b"R0E\r".to_vec())]);
        assert_eq!(ask(&mut port, 5, &[20]), (vec![], vec![]));
    }

    #[test]
    fn other_commands_are_answered() {
        let mut port = opened();
        assert_eq!(ask(&mut port, 0, &[]), (vec![], b"drivetwin".to_vec()));
        assert_eq!(ask(&mut port, 0, b"pyserial"), (vec![], vec![]));
        assert_eq!(ask(&mut port, 6, &[]), (vec![], vec![0x60]));
        assert_eq!(ask(&mut port, 7, &[]), (vec![], vec![0xB0]));
        assert_eq!(ask(&mut port, 10, &[255, 255]), (vec![], vec![255, 255]));
        assert_eq!(ask(&mut port, 11, &[0]), (vec![], vec![0]));
        assert_eq!(ask(&mut port, 12, &[1]), (vec![Event::DropReceived], vec![1]));
        assert_eq!(ask(&mut port, 12, &[2]), (vec![Event::DropUnsent], vec![2]));
        assert_eq!(ask(&mut port, 12, &[3]), (vec![Event::DropReceived, Event::DropUnsent], vec![3]));
        assert_eq!(ask(&mut port, 12, &[4]), (vec![], vec![]));
        for (command, is_suspended) in [(8, true), (9, false), (8, true)] {
            assert_eq!(ask(&mut port, command, &[]), (vec![], vec![]));
            assert_eq!(port.is_suspended(), is_suspended);
        }
        assert_eq!((port.end(), port.is_suspended()), (vec![], false));
        for command in [13, 99, 100, 155] {
            assert_eq!(ask(&mut port, command, &[1]), (vec![], vec![]));
        }
    }

    #[test]
    fn what_is_not_known_is_refused() {
        // DO ECHO: WONT. WILL LINEMODE (34): DONT. A second WILL COM-PORT changes nothing.
        let (events, answers) = say(&mut opened(), &[255, 253, 1, 255, 251, 34, 255, 251, 44]);
        assert_eq!((events, answers), (vec![], vec![255, 252, 1, 255, 254, 34]));
    }

    #[test]
    fn a_peer_that_refuses_has_unknown_settings() {
        let mut port = ComPort::new();
        let (events, answers) = say(&mut port, &[255, 251, 3, 255, 252, 44, 255, 255]);
        assert_eq!(events, [Event::Refuse, Event::Data(vec![255])]);
        // DO SUPPRESS-GO-AHEAD follows the proposals.
        assert_eq!(answers, [&PROPOSALS[..], &[255, 253, 3]].concat());
        let mut written = Vec::new();
        port.write(&[1, 255], &mut written);
        assert_eq!(written, [1, 255, 255]);
        // A peer that stops using the option.
        let mut port = opened();
        ask(&mut port, 4, &[2]);
        ask(&mut port, 5, &[5]);
        ask(&mut port, 8, &[]);
        assert_eq!(say(&mut port, &[255, 252, 44]), (vec![Event::Refuse], vec![255, 254, 44]));
        assert_eq!((port.settings, port.is_suspended()), (Sender::default(), false));
        assert_eq!(say(&mut port, b"R").0, [Event::Data(b"R".to_vec())]);
        // A command without negotiation opens the port as well.
        assert_eq!(say(&mut port, &[255, 250, 44, 8, 255, 240]).0, [Event::Open]);
    }

    #[test]
    fn bytes_without_telnet_pass_as_they_are() {
        let mut port = ComPort::new();
        let frame = [1, 3, 0, 255, 255, 251, 44];
        assert_eq!(say(&mut port, &frame[..1]), (vec![Event::NoTelnet, Event::Data(vec![1])], vec![]));
        assert_eq!(say(&mut port, &frame[1..]), (vec![Event::Data(frame[1..].to_vec())], vec![]));
        let mut written = Vec::new();
        port.write(&[255], &mut written);
        assert_eq!(written, [255]);
        // A single 255 does not decide.
        let mut port = ComPort::new();
        assert_eq!(say(&mut port, &[255]), (vec![], vec![]));
        assert_eq!(port.end(), [255]);
    }

    /// Events in which adjacent data are one.
    fn joined(events: Vec<Event>) -> Vec<Event> {
        let mut joined: Vec<Event> = Vec::new();
        for event in events {
            match (joined.last_mut(), event) {
                (Some(Event::Data(bytes)), Event::Data(more)) => bytes.extend(more),
                (_, event) => joined.push(event),
            }
        }
        joined
    }

    proptest! {
        #[test]
        fn any_segmentation_gives_the_same(
            begins in prop_oneof![Just(vec![]), Just(WILL_COM_PORT.to_vec())],
            bytes in some_bytes(),
            places in vec(any::<prop::sample::Index>(), 0..20),
        ) {
            let bytes = [begins, bytes].concat();
            let (mut whole, mut split) = (ComPort::new(), ComPort::new());
            let (mut events, mut answers) = (Vec::new(), Vec::new());
            for segment in segments(&bytes, &places) {
                events.extend(split.receive(&segment, LINE, &mut answers));
            }
            let (expected, expected_answers) = say(&mut whole, &bytes);
            prop_assert_eq!(joined(events), joined(expected));
            prop_assert_eq!(&answers, &expected_answers);
            prop_assert_eq!((split.is_suspended(), split.end()), (whole.is_suspended(), whole.end()));
            // An answer is at most three times as long as what it answers: a signature, and the state of the modem.
            prop_assert!(answers.len() <= PROPOSALS.len() + 7 + bytes.len() * 3);
        }
    }
}
