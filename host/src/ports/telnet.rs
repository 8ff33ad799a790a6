//! Telnet (RFC 854): commands and options in a stream of bytes.
//!
//! The state machines here know no socket. The longest subnegotiation that is kept has [`MOST`] bytes; this length and
//! the bytes of one call bound all memory.

/// "Interpret as command": begins every command. As a data byte it is sent twice.
pub(super) const IAC: u8 = 255;

/// End and begin of a subnegotiation.
const SE: u8 = 240;
const SB: u8 = 250;

/// The least byte that is a command of Telnet. All greater bytes are commands, too.
const FIRST_COMMAND: u8 = 240;

/// Maximum length of a subnegotiation. A longer one is ignored.
const MOST: usize = 64;

/// Transmit binary (RFC 856): bytes are not characters of a terminal.
pub(super) const BINARY: u8 = 0;
/// Suppress go ahead (RFC 858): both ends send at any time.
pub(super) const SUPPRESS_GO_AHEAD: u8 = 3;
/// Settings and modem lines of a serial port (RFC 2217).
pub(super) const COM_PORT: u8 = 44;

/// A request to enable or disable an option, or the answer to one.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Verb {
    /// The sender wants to use the option, or uses it.
    Will,
    /// The sender does not use the option.
    Wont,
    /// The receiver is to use the option.
    Do,
    /// The receiver is not to use the option.
    Dont,
}

impl Verb {
    fn of(command: u8) -> Option<Self> {
        match command {
            251 => Some(Self::Will),
            252 => Some(Self::Wont),
            253 => Some(Self::Do),
            254 => Some(Self::Dont),
            _ => None,
        }
    }

    fn command(self) -> u8 {
        match self {
            Self::Will => 251,
            Self::Wont => 252,
            Self::Do => 253,
            Self::Dont => 254,
        }
    }
}

/// Something in a stream.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) enum Item {
    /// Data bytes, at least one.
    Data(Vec<u8>),
    /// A verb about an option.
    Negotiation(Verb, u8),
    /// A subnegotiation: the option, and its parameters.
    Subnegotiation(Vec<u8>),
}

/// Finds commands in the bytes of a peer. Other commands than those of options are ignored.
#[derive(Default)]
pub(super) struct Parser {
    state: State,
    /// Bytes of the present subnegotiation, one more than [`MOST`] at most.
    parameters: Vec<u8>,
}

#[derive(Clone, Copy, Default)]
enum State {
    #[default]
    Data,
    Command,
    Negotiation(Verb),
    Subnegotiation,
    /// A command in a subnegotiation.
    SubnegotiationCommand,
}

impl Parser {
    /// Returns what is complete now.
    pub(super) fn parse(&mut self, bytes: &[u8]) -> Vec<Item> {
        let mut items = Vec::new();
        for &byte in bytes {
            self.state = self.step(byte, &mut items);
        }
        items
    }

    fn step(&mut self, byte: u8, items: &mut Vec<Item>) -> State {
        match self.state {
            State::Data if byte == IAC => State::Command,
            State::Data => data(byte, items),
            State::Command if byte == IAC => data(IAC, items),
            State::Command => self.command(byte),
            State::Negotiation(verb) => {
                items.push(Item::Negotiation(verb, byte));
                State::Data
            }
            State::Subnegotiation if byte == IAC => State::SubnegotiationCommand,
            State::Subnegotiation => self.parameter(byte),
            State::SubnegotiationCommand if byte == IAC => self.parameter(IAC),
            State::SubnegotiationCommand if byte == SE => {
                let parameters = std::mem::take(&mut self.parameters);
                if (1..=MOST).contains(&parameters.len()) {
                    items.push(Item::Subnegotiation(parameters));
                }
                State::Data
            }
            // The end of the subnegotiation is missing.
            State::SubnegotiationCommand => self.command(byte),
        }
    }

    fn command(&mut self, command: u8) -> State {
        self.parameters.clear();
        match Verb::of(command) {
            Some(verb) => State::Negotiation(verb),
            None if command == SB => State::Subnegotiation,
            None => State::Data,
        }
    }

    fn parameter(&mut self, byte: u8) -> State {
        if self.parameters.len() <= MOST {
            self.parameters.push(byte);
        }
        State::Subnegotiation
    }
}

fn data(byte: u8, items: &mut Vec<Item>) -> State {
    match items.last_mut() {
        Some(Item::Data(bytes)) => bytes.push(byte),
        _ => items.push(Item::Data(vec![byte])),
    }
    State::Data
}

/// Returns whether a connection that begins like this speaks Telnet; `None` if the next byte decides.
pub(super) fn is_telnet(beginning: &[u8]) -> Option<bool> {
    match beginning {
        [] | [IAC] => None,
        [IAC, second, ..] => Some(*second >= FIRST_COMMAND),
        _ => Some(false),
    }
}

/// Appends data, in which [`IAC`] is sent twice.
pub(super) fn write_data(data: &[u8], into: &mut Vec<u8>) {
    for &byte in data {
        into.push(byte);
        if byte == IAC {
            into.push(IAC);
        }
    }
}

/// Appends a verb about an option.
fn write_verb(verb: Verb, option: u8, into: &mut Vec<u8>) {
    into.extend([IAC, verb.command(), option]);
}

/// Appends a subnegotiation.
pub(super) fn write_subnegotiation(parameters: &[u8], into: &mut Vec<u8>) {
    into.extend([IAC, SB]);
    write_data(parameters, into);
    into.extend([IAC, SE]);
}

/// An option of one end.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
enum Use {
    #[default]
    Off,
    /// This process has proposed it, and the answer is missing.
    Proposed,
    On,
}

/// Options that an end may use.
const KNOWN: [u8; 3] = [BINARY, SUPPRESS_GO_AHEAD, COM_PORT];

/// Negotiation of options. A verb that changes nothing is not answered, so two peers never answer each other's answers
/// forever (RFC 1143).
#[derive(Default)]
pub(super) struct Options {
    ours: [Use; KNOWN.len()],
    theirs: [Use; KNOWN.len()],
}

impl Options {
    /// Proposes an option with `Will` (for this process) or `Do` (for the peer), if it is not in use.
    pub(super) fn propose(&mut self, verb: Verb, option: u8, into: &mut Vec<u8>) {
        let ours = verb == Verb::Will;
        if let Some(state) = self.state(ours, option)
            && *state == Use::Off
        {
            *state = Use::Proposed;
            write_verb(verb, option, into);
        }
    }

    /// Handles a verb of the peer, and appends the answer, if there is one.
    pub(super) fn handle(&mut self, verb: Verb, option: u8, into: &mut Vec<u8>) {
        // `Do` and `Dont` are about the options of this process.
        let (ours, enable, yes, no) = match verb {
            Verb::Do => (true, true, Verb::Will, Verb::Wont),
            Verb::Dont => (true, false, Verb::Will, Verb::Wont),
            Verb::Will => (false, true, Verb::Do, Verb::Dont),
            Verb::Wont => (false, false, Verb::Do, Verb::Dont),
        };
        let Some(state) = self.state(ours, option) else {
            if enable {
                write_verb(no, option, into);
            }
            return;
        };
        let before = std::mem::replace(state, if enable { Use::On } else { Use::Off });
        match (before, enable) {
            (Use::Off, true) => write_verb(yes, option, into),
            (Use::On, false) => write_verb(no, option, into),
            _ => {}
        }
    }

    /// Returns whether either end uses an option.
    pub(super) fn is_on(&self, option: u8) -> bool {
        let ends = KNOWN.iter().zip(self.ours.iter().zip(&self.theirs));
        ends.into_iter()
            .any(|(known, (ours, theirs))| *known == option && (*ours == Use::On || *theirs == Use::On))
    }

    fn state(&mut self, ours: bool, option: u8) -> Option<&mut Use> {
        let place = KNOWN.iter().position(|known| *known == option)?;
        Some(if ours { &mut self.ours[place] } else { &mut self.theirs[place] })
    }
}

#[cfg(test)]
pub(super) mod tests {
    use proptest::collection::vec;
    use proptest::prelude::*;

    use super::*;

    /// Any bytes, among them many that belong to commands.
    pub(in super::super) fn some_bytes() -> impl Strategy<Value = Vec<u8>> {
        let byte = prop_oneof![
            4 => any::<u8>(),
            4 => Just(IAC),
            3 => FIRST_COMMAND..=255,
            2 => Just(COM_PORT),
            3 => 0..=20_u8,
        ];
        let command = (251..=254_u8, prop_oneof![Just(COM_PORT), Just(BINARY), Just(1), any::<u8>()])
            .prop_map(|(verb, option)| vec![IAC, verb, option]);
        let subnegotiation = (0..=13_u8, vec(0..=20_u8, 0..6)).prop_map(|(command, values)| {
            let mut bytes = Vec::new();
            write_subnegotiation(&[&[COM_PORT, command], values.as_slice()].concat(), &mut bytes);
            bytes
        });
        let piece = prop_oneof![3 => vec(byte, 0..8), 2 => command, 3 => subnegotiation];
        vec(piece, 0..30).prop_map(|pieces| pieces.concat())
    }

    /// Splits bytes at places.
    pub(in super::super) fn segments(bytes: &[u8], places: &[prop::sample::Index]) -> Vec<Vec<u8>> {
        let mut ends: Vec<usize> = places.iter().map(|place| place.index(bytes.len() + 1)).collect();
        ends.extend([0, bytes.len()]);
        ends.sort_unstable();
        ends.windows(2).map(|ends| bytes[ends[0]..ends[1]].to_vec()).collect()
    }

    /// The items, but adjacent data are joined to one item.
    fn joined(items: impl IntoIterator<Item = Item>) -> Vec<Item> {
        let mut joined: Vec<Item> = Vec::new();
        for item in items {
            match (joined.last_mut(), item) {
                (Some(Item::Data(bytes)), Item::Data(more)) => bytes.extend(more),
                (_, item) => joined.push(item),
            }
        }
        joined
    }

    proptest! {
        #[test]
        fn any_segmentation_gives_the_same(
            bytes in some_bytes(),
            places in vec(any::<prop::sample::Index>(), 0..20),
        ) {
            let mut parser = Parser::default();
            let segments = segments(&bytes, &places);
            let mut items = Vec::new();
            for segment in &segments {
                items.extend(parser.parse(segment));
                prop_assert!(parser.parameters.len() <= MOST + 1);
            }
            prop_assert_eq!(joined(items), Parser::default().parse(&bytes));
        }

        #[test]
        fn data_arrive_as_they_were_sent(data: Vec<u8>, parameters in vec(any::<u8>(), 1..=MOST)) {
            let mut sent = Vec::new();
            write_data(&data, &mut sent);
            write_subnegotiation(&parameters, &mut sent);
            write_data(&data, &mut sent);
            let data = (!data.is_empty()).then_some(Item::Data(data));
            let expected: Vec<Item> =
                data.iter().cloned().chain([Item::Subnegotiation(parameters)]).chain(data.clone()).collect();
            prop_assert_eq!(Parser::default().parse(&sent), expected);
        }

        /// Two ends that answer each other's answers stop.
        #[test]
        fn a_negotiation_ends(proposals in vec((any::<bool>(), any::<bool>(), 0..50_u8), 0..10)) {
            let mut ends = [Options::default(), Options::default()];
            let mut sent = [Vec::new(), Vec::new()];
            for (end, ours, option) in proposals {
                let verb = if ours { Verb::Will } else { Verb::Do };
                ends[usize::from(end)].propose(verb, option, &mut sent[usize::from(end)]);
            }
            for _ in 0..3 {
                sent = [1, 0].map(|from| {
                    let mut answers = Vec::new();
                    for item in Parser::default().parse(&sent[from]) {
                        let Item::Negotiation(verb, option) = item else { panic!("{item:?}") };
                        ends[1 - from].handle(verb, option, &mut answers);
                    }
                    answers
                });
            }
            prop_assert!(sent.iter().all(Vec::is_empty), "{sent:?}");
        }
    }

    #[test]
    fn a_subnegotiation_without_an_end_is_ignored() {
        let mut parser = Parser::default();
        let long = [&[IAC, SB, COM_PORT][..], &[7; 100_000]].concat();
        assert_eq!(parser.parse(&long), []);
        assert_eq!(parser.parse(&[IAC, SE, b'a']), [Item::Data(vec![b'a'])]);
        // Another command, or another subnegotiation, in place of the end.
        assert_eq!(
            parser.parse(&[IAC, SB, COM_PORT, 1, IAC, 253, 3, b'b']),
            [Item::Negotiation(Verb::Do, 3), Item::Data(vec![b'b'])]
        );
        assert_eq!(
            parser.parse(&[IAC, SB, COM_PORT, 1, IAC, SB, COM_PORT, 7, IAC, SE, IAC, SE, IAC, 241, b'c']),
            [Item::Subnegotiation(vec![COM_PORT, 7]), Item::Data(vec![b'c'])]
        );
    }

    #[test]
    fn the_first_two_bytes_decide() {
        for (beginning, decision) in [
            (&[][..], None),
            (&[IAC], None),
            (&[IAC, 251], Some(true)),
            (&[IAC, IAC], Some(true)),
            // A frame to address 255, which no drive has.
            (&[IAC, 3, 0], Some(false)),
            (&[1], Some(false)),
            (&[1, IAC, 251], Some(false)),
        ] {
            assert_eq!(is_telnet(beginning), decision, "{beginning:?}");
        }
    }
}
