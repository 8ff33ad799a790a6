//! The client of a board, against boards that behave badly.

use std::io::{ErrorKind, Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::sync::mpsc::{self, Receiver};
use std::thread::JoinHandle;
use std::time::Duration;

use drivetwin_control::{
    Answer, Call, Decoder, Event, Events, FRAME, Hello, Message, Refused, Reply, Request, State, Statistics,
    VERSION, encode, fingerprint,
};
use drivetwin_sim::bench::PowerAction;
use drivetwin_sim::catalog;
use drivetwin_sim::commands::{Drive as _, Refusal};
use drivetwin_sim::record::trace::{Event as Entry, InputRecord};

use super::{Board, Report, Sink, Target, Wanted};
use crate::options::BoardPlace;

/// Longer than anything here takes.
const LONG: Duration = Duration::from_secs(20);

/// Reaction of a board to a request.
pub(crate) enum Act {
    /// Sends these bytes, and serves on.
    Send(Vec<u8>),
    /// Ends the connection.
    Hang,
}

/// The frame of an answer.
pub(crate) fn answer(number: u16, answer: Result<Answer<'_>, Refused>) -> Vec<u8> {
    let mut frame = [0; FRAME];
    encode(&Message::Reply(Reply { number, answer }), &mut frame).unwrap().to_vec()
}

/// The frame of events.
fn events(number: u32, at: u64, of: &[(i64, Event<'_>)]) -> Vec<u8> {
    let (mut bytes, mut frame) = (Vec::new(), [0; FRAME]);
    for event in of {
        let mut room = [0; 128];
        bytes.extend_from_slice(postcard::to_slice(event, &mut room).unwrap());
    }
    encode(&Message::Events(Events { number, at, bytes: &bytes }), &mut frame).unwrap().to_vec()
}

pub(crate) fn hello(kind: &str) -> Hello<'_> {
    let spec = catalog::make(kind).unwrap().spec();
    let tables = fingerprint(spec);
    Hello { version: VERSION, kind: spec.kind, image: "0.1.0", tables, fast_boot: true, board: "pico" }
}

fn state(at: u64) -> State {
    State { at, powered: true, high: 0, open: 0, driven: 0, faults: 0, motion: None }
}

/// The answer of a board that does what it should.
fn usual(number: u16, call: Call<'_>, at: u64) -> Vec<u8> {
    answer(
        number,
        Ok(match call {
            Call::Hello => Answer::Hello(hello("md3")),
            Call::State => Answer::State(state(at)),
            Call::Statistics => Answer::Statistics(Statistics::default()),
            Call::Read { .. } => Answer::Value(9_000),
            _ => Answer::Done,
        }),
    )
}

/// Attaches a board that may be of any kind.
fn attach(place: &BoardPlace, sink: Sink) -> Result<Board, String> {
    Board::attach(Target::find(place)?, "board", Wanted::Any, sink)
}

/// A board on a TCP port, whose answers a function makes.
pub(crate) struct Fake {
    pub(crate) place: BoardPlace,
    thread: Option<JoinHandle<()>>,
}

impl Fake {
    /// Serves one connection after the other, until `serve` returns `None` for the number of a connection.
    pub(crate) fn new(
        mut act: impl FnMut(usize, u16, Call<'_>) -> Act + Send + 'static,
        connections: usize,
    ) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let place = BoardPlace::Tcp(listener.local_addr().unwrap().to_string());
        let thread = std::thread::spawn(move || {
            for connection in 0..connections {
                let (stream, _) = listener.accept().unwrap();
                serve(stream, |number, call| act(connection, number, call));
            }
        });
        Self { place, thread: Some(thread) }
    }

    fn attach(&self) -> (Result<Board, String>, Receiver<Report>) {
        let (to, reports) = mpsc::channel();
        let sink = move |report| {
            // The test may have heard enough.
            let _ = to.send(report);
        };
        (attach(&self.place, Box::new(sink)), reports)
    }

    fn attached(&self) -> (Board, Receiver<Report>) {
        let (board, reports) = self.attach();
        (board.unwrap(), reports)
    }
}

impl Drop for Fake {
    fn drop(&mut self) {
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn serve(mut stream: TcpStream, mut act: impl FnMut(u16, Call<'_>) -> Act) {
    stream.set_nodelay(true).unwrap();
    let (mut decoder, mut bytes) = (Decoder::new(), [0; 512]);
    loop {
        let count = match stream.read(&mut bytes) {
            Ok(0) => return,
            Ok(count) => count,
            Err(error) if error.kind() == ErrorKind::Interrupted => continue,
            Err(_) => return,
        };
        for byte in &bytes[..count] {
            let Some(Request { number, call }) = decoder.push(*byte) else { continue };
            match act(number, call) {
                Act::Send(bytes) => {
                    if stream.write_all(&bytes).is_err() {
                        return;
                    }
                }
                Act::Hang => return,
            }
        }
    }
}

fn away<T: std::fmt::Debug>(result: Result<T, Refusal>) -> String {
    match result {
        Err(Refusal::Away(sentence)) => sentence,
        other => panic!("the board is not away: {other:?}"),
    }
}

#[test]
fn garbage_and_answers_with_wrong_numbers_are_ignored() {
    let fake = Fake::new(
        |_, number, call| {
            let mut bytes = b"garbage\0\x05\x01\x02\0".to_vec();
            bytes.extend(answer(number.wrapping_add(7), Ok(Answer::Value(1))));
            // A frame that is cut, and one with a wrong bit.
            let right = usual(number, call, 16_000_000);
            bytes.extend(&right[..right.len() / 2]);
            bytes.push(0);
            let mut wrong = right.clone();
            wrong[2] ^= 0x40;
            bytes.extend(wrong);
            bytes.push(0);
            bytes.extend(right);
            Act::Send(bytes)
        },
        1,
    );
    let (board, _reports) = fake.attached();
    let mut drive = board.drive().unwrap();
    assert_eq!((drive.peek(3).unwrap(), drive.spec().kind), (9_000, "md3"));
    drive.power(PowerAction::Cycle).unwrap();
    drop((drive, board));
}

#[test]
fn a_board_of_another_version_must_be_flashed_again() {
    for (of, expected) in [
        (Hello { version: 9, ..hello("md3") }, "has version 9 of the control protocol"),
        (Hello { tables: 1, ..hello("md3") }, "has the tables of another version of drivetwin"),
        (
            Hello { kind: "md9", ..hello("md3") },
            "is a drive of a kind that this drivetwin does not know, md9",
        ),
    ] {
        for (board, again) in [
            ("pico", ": flash it again with `drivetwin flash pico`"),
            ("pico2", ": flash it again with `drivetwin flash pico2`"),
            ("black-pill", ": flash it again"),
            ("", ": flash it again with `drivetwin flash`"),
        ] {
            let of = Hello { board, ..of };
            let fake = Fake::new(move |_, number, _| Act::Send(answer(number, Ok(Answer::Hello(of)))), 1);
            let sentence = fake.attach().0.err().unwrap();
            assert!(sentence.contains(expected), "{sentence}");
            assert!(sentence.ends_with(again), "{sentence}");
        }
    }
}

#[test]
fn what_is_no_board_is_said_in_one_sentence() {
    // A server that has a client already lets the second one wait, or closes its connection.
    for (act, expected) in [
        (Act::Send as fn(_) -> _, " is in use by another program, or there is none: it does not answer"),
        (|_| Act::Hang, " is in use by another program, or there is none: it closes the connection"),
    ] {
        let busy = Fake::new(move |_, _, _| act(Vec::new()), 1);
        let sentence = busy.attach().0.err().unwrap();
        assert!(sentence.starts_with("the board at tcp:127.0.0.1:"), "{sentence}");
        assert!(sentence.ends_with(expected), "{sentence}");
    }
    let echo = Fake::new(|_, number, _| Act::Send(answer(number, Ok(Answer::Done))), 1);
    let sentence = echo.attach().0.err().unwrap();
    assert!(sentence.ends_with(": it answers something else"), "{sentence}");
    let gone = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().to_string();
    let sentence = attach(&BoardPlace::Tcp(gone), Box::new(|_| {})).err().unwrap();
    assert!(sentence.contains("cannot be opened: Connection refused"), "{sentence}");
}

#[test]
fn a_board_that_stops_answering_is_connected_again() {
    // The first connection is deaf to reads; the second one is well.
    let fake = Fake::new(
        |connection, number, call| match call {
            Call::Read { .. } if connection == 0 => Act::Send(Vec::new()),
            _ => Act::Send(usual(number, call, 16_000_000)),
        },
        2,
    );
    let (board, _reports) = fake.attached();
    let mut drive = board.drive().unwrap();
    let sentence = away(drive.peek(3));
    assert!(sentence.contains("cannot be reached: it does not answer"), "{sentence}");
    let first = drive.session_number();
    board.wait_for_session_after(first, LONG).unwrap();
    assert_eq!(board.drive().unwrap().peek(3).unwrap(), 9_000);
    // What the drive was before is not known to be what it is.
    assert!(away(drive.peek(3)).contains("has started again meanwhile"), "{:?}", drive.peek(3));
}

#[test]
fn the_last_question_to_a_silent_board_ends_soon() {
    let (asks, asked) = mpsc::channel();
    let mut states = 0;
    let fake = Fake::new(
        move |_, number, call| {
            states += usize::from(matches!(call, Call::State));
            // The first one is that of the attachment.
            if states < 2 {
                return Act::Send(usual(number, call, 16_000_000));
            }
            let _ = asks.send(());
            Act::Send(Vec::new())
        },
        1,
    );
    let (board, _reports) = fake.attached();
    let drive = board.drive().unwrap();
    // The board is silent from its next question on.
    asked.recv_timeout(LONG).unwrap();
    assert_eq!(away(drive.now_within(Duration::ZERO)), "the board does not answer in time");
    // The thread does not wait for its answer either, or this test waits for the thread.
    drop((drive, board));
}

#[test]
fn a_board_that_goes_away_is_reported_once_with_its_last_time() {
    let fake = Fake::new(
        |_, number, call| match call {
            Call::Preset { .. } => Act::Hang,
            _ => Act::Send(usual(number, call, 16_000_000)),
        },
        1,
    );
    let (board, reports) = fake.attached();
    assert!(away(board.drive().unwrap().poke(3, "Speed", 5)).contains("cannot be reached"));
    // The report is there before the call fails.
    let gone = |report| match report {
        Report::Gone { last, .. } => Some(last.ticks()),
        _ => None,
    };
    assert_eq!(reports.try_iter().filter_map(gone).collect::<Vec<_>>(), [16_000_000]);
    drop(board);
    assert_eq!(reports.iter().filter_map(gone).count(), 0);
}

#[test]
fn a_pulled_cable_fails_the_call_and_time_goes_on_when_the_board_is_back() {
    let fake = Fake::new(
        |connection, number, call| match call {
            Call::Preset { .. } if connection == 0 => Act::Hang,
            // The board has started again: its clock begins with 0.
            _ => Act::Send(usual(number, call, if connection == 0 { 160_000_000 } else { 16_000 })),
        },
        2,
    );
    let (board, reports) = fake.attached();
    let mut drive = board.drive().unwrap();
    let sentence = away(drive.poke(3, "Speed", 5));
    assert!(sentence.contains("cannot be reached: it is gone"), "{sentence}");
    board.wait_for_session_after(drive.session_number(), LONG).unwrap();
    let begun = |report| match report {
        Report::Begun(session, ..) => Some(session.began.ticks()),
        _ => None,
    };
    drop((drive, board));
    let begun: Vec<u64> = reports.iter().filter_map(begun).collect();
    assert_eq!(begun, [160_000_000, 160_016_000]);
}

#[test]
fn missing_messages_and_lost_events_are_reported() {
    let fake = Fake::new(
        |_, number, call| {
            let mut bytes = Vec::new();
            if let Call::Fault { .. } = call {
                bytes.extend(events(
                    0,
                    32_000_000,
                    &[(0, Event::Edge(0, false)), (16, Event::Edge(0, true))],
                ));
                // The message with the events 2 to 6 is lost on its way.
                bytes.extend(events(7, 32_001_000, &[(0, Event::Lost(3)), (0, Event::Edge(200, true))]));
                // An hour that has not passed.
                bytes.extend(events(9, 3_600 * 16_000_000, &[(0, Event::Edge(0, false))]));
            }
            bytes.extend(usual(number, call, 32_002_000));
            Act::Send(bytes)
        },
        1,
    );
    let (board, reports) = fake.attached();
    board.drive().unwrap().set_fault(drivetwin_firmware::device::Fault(0), true).unwrap();
    drop(board);
    let all = reports.iter().filter_map(|report| match report {
        Report::Events(events, _) => Some(events),
        _ => None,
    });
    let all: Vec<(u64, Entry)> = all.flatten().map(|(at, event)| (at.ticks(), event)).collect();
    let edge = |high| Entry::Input(InputRecord::Edge { pin: drivetwin_firmware::device::Pin(0), high });
    let missing = |events| Entry::Missing { events: Some(events) };
    let (wrong, all) = all.split_last().unwrap();
    assert_eq!(wrong.1, missing(1));
    assert!(wrong.0 < 60 * 16_000_000, "the clock does not follow it");
    let expected = [
        (32_000_000, edge(false)),
        (32_000_016, edge(true)),
        (32_001_000, missing(5)),
        (32_001_000, missing(3)),
        // The drive has no such pin.
        (32_001_000, missing(1)),
    ];
    assert_eq!(all, expected);
}

#[test]
fn no_event_behind_the_first_state_is_lost() {
    let mut is_first = true;
    let fake = Fake::new(
        move |_, number, call| {
            let mut bytes = usual(number, call, 16_000_000);
            if matches!(call, Call::State) && std::mem::take(&mut is_first) {
                // The computer gets both at once.
                bytes.extend(events(0, 16_000_016, &[(0, Event::Edge(0, false))]));
            }
            Act::Send(bytes)
        },
        1,
    );
    let (board, reports) = fake.attached();
    let event = reports.iter().find_map(|report| match report {
        Report::Events(events, _) => events.into_iter().next(),
        _ => None,
    });
    let edge = InputRecord::Edge { pin: drivetwin_firmware::device::Pin(0), high: false };
    assert_eq!(event.unwrap().1, Entry::Input(edge));
    drop(board);
}

#[test]
fn refusals_are_sentences() {
    let fake = Fake::new(
        |_, number, call| {
            let refused = match call {
                Call::Pulse { .. } => Refused::Driven,
                Call::Preset { .. } => Refused::Busy,
                Call::WriteMemory { .. } => Refused::HasPower,
                Call::Become(_) => Refused::NotHere,
                Call::Kind(_) => return Act::Send(answer(number, Ok(Answer::Kind(None)))),
                _ => return Act::Send(usual(number, call, 1)),
            };
            Act::Send(answer(number, Err(refused)))
        },
        1,
    );
    let (board, _reports) = fake.attached();
    let mut drive = board.drive().unwrap();
    let pulse = drive.pulse(drivetwin_firmware::device::Pin(0), 1, 10.0, 0.5).unwrap_err();
    assert_eq!(pulse, Refusal::Conflict("a pulse train or an encoder drives that pin already".into()));
    let poke = drive.poke(3, "Speed", 5).unwrap_err().to_string();
    assert!(poke.starts_with("Speed cannot be preset: other settings"), "{poke}");
    let memory = drive.set_memory(&[0xFF; 8]).unwrap_err().to_string();
    assert_eq!(memory, "board has power; switch it off first");
    let unknown = drive.choose("mdd3").unwrap_err();
    assert!(matches!(&unknown, Refusal::Unknown(sentence) if sentence.contains("md3")), "{unknown}");
    let kind = drive.choose("qsb-d").unwrap_err().to_string();
    assert_eq!(kind, "the image of this board is one kind only, md3; flash another image");
    assert_eq!(drive.choose("md3"), Ok(()), "the board is one already");
}
