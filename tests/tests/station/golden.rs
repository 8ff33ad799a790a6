//! The golden traces on a board with a cable: the computer gives the drive the inputs of a trace, and the board records what
//! the bench records.

use std::fs;
use std::path::Path;

use drivetwin_board::CablePort;
use drivetwin_control::{Call, Course, Event, Level, Line, Power, Stimulus, Stretch};
use drivetwin_firmware::device::{self, Framing, Instant, Pin, Plan, Role, Spec};
use drivetwin_protocol::line::Parity;
use drivetwin_sim::record::trace::{self, InputRecord, OutputRecord, Trace};
use drivetwin_sim::{catalog, replay};
use drivetwin_tests::at_cable::Rig;

/// Time at which the drive of the trace gets its power. The trace of the board begins before.
const START: u64 = 16_000_000;

/// Events with their times in ticks since the drive has power.
type Events = Vec<(u64, String)>;

fn line(line: device::Line) -> Line {
    let parity = match line.parity {
        Parity::None => 0,
        Parity::Odd => 1,
        Parity::Even => 2,
    };
    Line { baud: line.baud, data: line.data, parity, stop: line.stop }
}

fn course(plan: &Plan) -> Course {
    let mut stretches = [None; 3];
    for (place, segment) in stretches.iter_mut().zip(plan.segments()) {
        *place = Some(Stretch {
            ticks: segment.ticks,
            acceleration: segment.acceleration,
            start_speed: segment.start_speed,
            base: segment.base,
            phase_offset: segment.phase_offset,
            reverse: segment.reverse,
        });
    }
    Course { start: START + plan.start().ticks(), stretches }
}

fn level(level: device::Level) -> Level {
    match level {
        device::Level::Low => Level::Low,
        device::Level::High => Level::High,
        device::Level::Float => Level::Open,
    }
}

/// Records of the bench, as events of a board.
fn expected(trace: &Trace) -> Events {
    let mut events = vec![(0, format!("{:?}", Event::Power(true)))];
    let mut character = trace.drives[0].spec.ports[0].line.expect("a serial port").character();
    for entry in trace.events() {
        let at = entry.at.ticks();
        let mut add = |at, event: Event<'_>| events.push((at, format!("{event:?}")));
        match &entry.event {
            trace::Event::Input(input) => match *input {
                InputRecord::Bytes { port, ref bytes } => {
                    for (n, byte) in (0..).zip(bytes.iter()) {
                        add(at + n * character.ticks(), Event::Received(port.0, *byte));
                    }
                }
                InputRecord::RxError { port } => add(at, Event::RxError(port.0)),
                InputRecord::HostPresence { port, here } => add(at, Event::Present(port.0, here)),
                InputRecord::Edge { pin, high } => add(at, Event::Edge(pin.0, high)),
                InputRecord::Open { pin } => add(at, Event::Open(pin.0)),
                InputRecord::Millivolts { pin, mv } => add(at, Event::Millivolts(pin.0, mv)),
                InputRecord::Fault { fault, on } => add(at, Event::Fault(fault.0, on)),
                InputRecord::Poke { row, value } => add(at, Event::Preset(row as u16, value)),
                InputRecord::Power(trace::Power::On) => add(at, Event::Power(true)),
                InputRecord::Power(trace::Power::Off) => add(at, Event::Power(false)),
                ref other => panic!("a trace with {other:?}"),
            },
            trace::Event::Output(output) => match *output {
                OutputRecord::Bytes { port, ref bytes } => {
                    for (part, n) in bytes.chunks(128).zip(0..) {
                        add(at + n * 128 * character.ticks(), Event::Sent(port.0, part));
                    }
                }
                OutputRecord::Line { port, line: settings } => {
                    character = settings.character();
                    add(at, Event::Line(port.0, line(settings)));
                }
                OutputRecord::Level { pin, level: other } => add(at, Event::Level(pin.0, level(other))),
                OutputRecord::Wave { pin, period, high } => {
                    add(at, Event::Wave { pin: pin.0, period: period.ticks(), high: high.ticks() });
                }
                OutputRecord::Plan { axis, ref plan } => add(at, Event::Plan(axis.0, course(plan))),
                OutputRecord::Step { axis, steps } => add(at, Event::Step(axis.0, steps)),
                OutputRecord::CurrentLimit { axis, ma } => add(at, Event::CurrentLimit(axis.0, ma)),
                OutputRecord::Duty { axis, duty } => add(at, Event::Duty(axis.0, duty)),
                OutputRecord::Store { offset, ref bytes } => {
                    for (part, n) in bytes.chunks(128).zip(0..) {
                        add(at, Event::Store(offset + 128 * n, part));
                    }
                }
                ref other => panic!("a trace with {other:?}"),
            },
            trace::Event::Shaft { .. } | trace::Event::Received(_) | trace::Event::Missing { .. } => {}
        }
    }
    sorted(events)
}

fn sorted(mut events: Events) -> Events {
    events.sort();
    events
}

/// The inputs of a trace, each with the time at which the computer acts, in ticks: a character begins before it arrives.
fn actions(trace: &Trace) -> Vec<(u64, InputRecord)> {
    let mut actions = vec![(START, InputRecord::Power(trace::Power::On))];
    let mut character = trace.drives[0].spec.ports[0].line.expect("a serial port").character();
    for entry in trace.events() {
        match &entry.event {
            trace::Event::Output(OutputRecord::Line { line, .. }) => character = line.character(),
            trace::Event::Input(input) => {
                let begins = matches!(input, InputRecord::Bytes { .. } | InputRecord::RxError { .. });
                let before = if begins { character.ticks() } else { 0 };
                actions.push((START + entry.at.ticks() - before, input.clone()));
            }
            _ => {}
        }
    }
    // A board reports at power-on what has come before.
    actions.sort_by_key(|(at, input)| (*at, *input == InputRecord::Power(trace::Power::On)));
    actions
}

/// Settings of a line with characters as long as those of `line`, but not the same ones.
fn other(line: device::Line) -> device::Line {
    match (line.parity, line.data) {
        (Parity::Even, _) => device::Line { parity: Parity::Odd, ..line },
        (Parity::Odd, _) => device::Line { parity: Parity::Even, ..line },
        (Parity::None, 8) => device::Line { data: 7, parity: Parity::Even, ..line },
        (Parity::None, _) => device::Line { data: 8, stop: line.stop - 1, ..line },
    }
}

/// Plays the inputs of a trace on a board. Returns the events that it records.
fn play(trace: &Trace) -> Events {
    let drive = &trace.drives[0];
    let boot = device::Boot { fast: drive.boot_fast, ..device::Boot::default() };
    let mut rig = Rig::with(drive.spec.kind, boot, Some(drive.memory.to_vec()));
    let presence = actions(trace).into_iter().find_map(|(_, input)| match input {
        InputRecord::HostPresence { here, .. } => Some(here),
        _ => None,
    });
    rig.open(CablePort::Bus, presence == Some(false));
    for call in [Call::Power(Power::Off), Call::Trace(true)] {
        rig.call(call).expect("done");
    }
    for (at, input) in actions(trace) {
        rig.run_until(Instant::from_ticks(at));
        let line = rig.uart_line();
        match input {
            InputRecord::Bytes { bytes, .. } => {
                rig.set_line(line);
                rig.write(CablePort::Bus, &bytes);
            }
            InputRecord::RxError { .. } => {
                rig.set_line(line.map(other));
                rig.write(CablePort::Bus, &[0]);
            }
            InputRecord::HostPresence { here, .. } => rig.open(CablePort::Bus, here),
            input => {
                rig.send(call(drive.spec, &input));
            }
        }
        rig.run_until(rig.now());
    }
    rig.run_until(Instant::from_ticks(START + trace.end.ticks()));
    let events = rig.events().into_iter().flat_map(drivetwin_control::Events::decode);
    sorted(events.map(|(at, event)| (at - START, format!("{event:?}"))).collect())
}

/// The call for an input other than characters.
fn call(spec: &Spec, input: &InputRecord) -> Call<'static> {
    let drive = |pin: Pin, stimulus| Call::Drive { pin: pin.0, stimulus };
    match *input {
        InputRecord::Edge { pin, high } => {
            assert_ne!(spec.pins[usize::from(pin.0)].role, Role::Analogue);
            drive(pin, if high { Stimulus::High } else { Stimulus::Low })
        }
        InputRecord::Open { pin } => drive(pin, Stimulus::Open),
        InputRecord::Millivolts { pin, mv } => drive(pin, Stimulus::Millivolts(mv)),
        InputRecord::Fault { fault, on } => Call::Fault { fault: fault.0, on },
        InputRecord::Poke { row, value } => Call::Preset { row: row as u16, value },
        InputRecord::Power(trace::Power::On) => Call::Power(Power::On),
        InputRecord::Power(trace::Power::Off) => Call::Power(Power::Off),
        ref other => panic!("a trace with {other:?}"),
    }
}

/// Returns true if the drive gets characters while it sends, although its line has one wire for both. A board hears nothing
/// then, but a replay gives them to the drive.
fn overlaps(events: &Trace) -> bool {
    let port = events.drives[0].spec.ports[0];
    let mut character = port.line.expect("a serial port").character();
    let (mut received, mut sent, mut free) = (Vec::new(), Vec::new(), Instant::ZERO);
    for entry in events.events() {
        match &entry.event {
            trace::Event::Output(OutputRecord::Line { line, .. }) => character = line.character(),
            trace::Event::Output(OutputRecord::Bytes { bytes, .. }) => {
                let start = entry.at.max(free);
                free = start + character * bytes.len() as u64;
                sent.push((start, free));
            }
            trace::Event::Input(InputRecord::Bytes { bytes, .. }) => {
                received.extend((0..bytes.len() as u64).map(|n| entry.at + character * n));
            }
            trace::Event::Input(InputRecord::RxError { .. }) => received.push(entry.at),
            _ => {}
        }
    }
    let is_sent = |at: &Instant| sent.iter().any(|(start, end)| start <= at && at <= end);
    port.framing == Framing::Silence && received.iter().any(is_sent)
}

/// The text of a trace in which calls come some ticks later, each time one tick more. At one instant a bench handles a
/// stimulus before a deadline of the drive, but a board executes a call behind the deadlines that are due.
fn with_later_calls(text: &str) -> String {
    let (mut last, mut ticks) = (String::new(), 0);
    let mut later = |line: &str| {
        let (at, rest) = line.split_once(" > ")?;
        let is_call = !["rx", "spoiled", "attached"].iter().any(|word| rest.starts_with(word));
        let ms: f64 = at.parse().ok().filter(|_| is_call)?;
        ticks += u32::from(last != at);
        last = at.to_owned();
        Some(format!("{:.6} > {rest}\n", ms + f64::from(ticks) / 16_000.0))
    };
    text.lines().map(|line| later(line).unwrap_or_else(|| format!("{line}\n"))).collect()
}

#[test]
fn a_board_records_what_the_bench_records() {
    let make = |kind: &str| catalog::make(kind).ok();
    let (mut played, mut skipped) = (0, Vec::new());
    for spec in catalog::specs().filter(|spec| !spec.is_on_network()) {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("traces").join(spec.kind);
        let mut paths: Vec<_> =
            fs::read_dir(&folder).expect("traces").map(|file| file.expect("a file").path()).collect();
        paths.sort();
        for path in paths {
            let text = fs::read_to_string(&path).expect("text");
            let trace = Trace::parse(&with_later_calls(&text), &make).expect("a trace");
            let is_cut = |entry: &trace::Entry| {
                matches!(entry.event, trace::Event::Input(InputRecord::Power(trace::Power::Cut(_))))
            };
            if trace.events().any(is_cut) || trace.drives[0].fast_line {
                continue;
            }
            let bench = replay::benches(&trace, &make).expect("a playable trace").remove(0);
            if overlaps(bench.trace()) {
                skipped.push(path);
                continue;
            }
            let expected = expected(bench.trace());
            let seen = play(bench.trace());
            for (seen, expected) in seen.iter().zip(&expected) {
                assert_eq!(seen, expected, "{}", path.display());
            }
            assert_eq!(seen.len(), expected.len(), "{}", path.display());
            played += 1;
        }
    }
    assert!(played >= 60 && skipped.len() <= 4, "{played} traces, without {skipped:?}");
}
