//! Lines of Modbus ASCII: a line feed ends a message, and silence has no meaning.

use drivetwin_firmware::device::{
    Boot, Context, DropReason, Framing, Input, LogEvent, Output, PortSpec, PresetError, Spec,
};
use drivetwin_protocol::modbus::ascii;

use super::*;

const LINE: Line = Line::new(9_600, 7, Parity::Even, 1);
/// Duration of a character of this line, 10 bits.
const CHARACTER: Duration = Duration::from_ticks(16_667);
/// Number of characters of [`ask`], and of an answer to it.
const LENGTH: u64 = 9;

static SPEC: Spec = Spec {
    kind: "echo",
    product: "an echo",
    manual: "this file",
    ports: &[PortSpec { name: "rs485", framing: Framing::Silence, line: Some(LINE) }],
    ..Spec::EMPTY
};

/// A device that sends every message for its address back; for the function `TWICE` it sends two copies at
/// once.
struct EchoDevice {
    address: u8,
    receiver: ascii::AsciiReceiver,
}

const TWICE: u8 = 2;

impl EchoDevice {
    fn at(address: u8) -> Self {
        Self { address, receiver: ascii::AsciiReceiver::new(LINE) }
    }

    fn serve(&mut self, at: Instant, out: &mut dyn Context) {
        match self.receiver.take() {
            None => {}
            Some(Err(why)) => out.put(at, Output::Log(LogEvent::Dropped { port: RS485, why })),
            Some(Ok(&[unit, function])) if unit == self.address || unit == 0 => {
                out.put(at, Output::Log(LogEvent::Request { port: RS485, unit, function }));
                let answers = ascii::encode(&[unit, function]).repeat(if function == TWICE { 2 } else { 1 });
                if unit != 0 {
                    out.put(at, Output::Bytes { port: RS485, bytes: &answers });
                }
            }
            Some(Ok(_)) => {
                out.put(at, Output::Log(LogEvent::Dropped { port: RS485, why: DropReason::Address }));
            }
        }
    }
}

impl Device for EchoDevice {
    fn spec(&self) -> &'static Spec {
        &SPEC
    }

    fn power_on(&mut self, _at: Instant, _boot: Boot, _out: &mut dyn Context) {}

    fn input(&mut self, at: Instant, input: Input<'_>, out: &mut dyn Context) {
        match input {
            Input::Bytes { bytes, .. } => {
                let end = bytes.iter().position(|&byte| byte == b'\n');
                assert!(end.is_none_or(|end| end + 1 == bytes.len()), "{}", bytes.escape_ascii());
                self.receiver.bytes(at, bytes);
            }
            Input::RxError { .. } => self.receiver.rx_error(at),
            Input::Idle { .. } => self.serve(at, out),
            _ => {}
        }
    }

    fn deadline(&self) -> Instant {
        self.receiver.deadline()
    }

    fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        self.serve(at, out);
    }

    fn peek(&self, _at: Instant, _row: usize) -> i64 {
        0
    }

    fn poke(
        &mut self,
        _at: Instant,
        _row: usize,
        _value: i64,
        _out: &mut dyn Context,
    ) -> Result<(), PresetError> {
        Err(PresetError::NoSuchRegister)
    }
}

/// A message of two bytes: `:aaffss`, CR, LF.
fn ask(address: u8, function: u8) -> Vec<u8> {
    ascii::encode(&[address, function]).to_vec()
}

/// Two echo devices on one line, at addresses 1 and 2, and a client there.
fn echoes(line: LineMode) -> (Bench, [DriveId; 2], Client) {
    let mut bench = Bench::with(Settings { line, ..Settings::default() });
    let mut echo =
        |name, address| bench.add_with(name, Box::new(EchoDevice::at(address)), Setup::default()).unwrap();
    let slots = [echo("x", 1), echo("y", 2)];
    let bus = bench.share("line1", &slots.map(|drive| (drive, RS485)));
    let client = bench.connect(bus);
    (bench, slots, client)
}

/// Number of requests and of dropped frames at the port of a drive.
fn seen(bench: &Bench, drive: DriveId) -> (u64, u64) {
    let statistics = bench.statistics(drive, RS485);
    (statistics.requests, statistics.dropped())
}

#[test]
fn the_reply_leaves_with_the_line_feed() {
    let (mut bench, _, client) = echoes(LineMode::Timed);
    bench.send(client, &ask(1, 65));
    let first = Instant::ZERO + CHARACTER * (LENGTH + 1);
    bench.run_until(first - Duration::TICK);
    assert_eq!(received_by(&mut bench, client), [0; 0]);
    bench.run_until(first);
    assert_eq!(received_by(&mut bench, client), b":");
    bench.run_until_idle();
    assert_eq!(received_by(&mut bench, client), ask(1, 65)[1..]);
    assert_eq!(bench.now(), Instant::ZERO + CHARACTER * (2 * LENGTH));
}

#[test]
fn half_a_message_waits_in_manual_time() {
    let (mut bench, slots, client) = echoes(LineMode::Timed);
    bench.send(client, &ask(1, 65)[..8]);
    bench.run_until_idle();
    assert_eq!(bench.now(), Instant::ZERO);
    bench.send(client, b"\n");
    bench.run_until_idle();
    assert_eq!(received_by(&mut bench, client), ask(1, 65));
    assert_eq!(seen(&bench, slots[0]), (1, 0));
}

#[test]
fn the_rest_may_come_a_second_after_half_a_message() {
    let (mut bench, slots, client) = echoes(LineMode::Timed);
    bench.send(client, &ask(1, 65)[..4]);
    bench.run_until(Instant::from(20.millis()) - Duration::TICK);
    assert_eq!(stamps(&bench, "> rx"), [""; 0]);
    // The frame timeout ends, so the partial frame goes to the drives. The rest follows when it arrives.
    let half = Instant::from(20.millis()) + CHARACTER * 4;
    bench.run_until(half + 1.secs());
    assert_eq!(stamps(&bench, "> rx"), ["21.041688", "21.041688"]);
    bench.send(client, &ask(1, 65)[4..]);
    bench.run_until_idle();
    assert_eq!(received_by(&mut bench, client), ask(1, 65));
    assert_eq!(bench.now(), half + 1.secs() + CHARACTER * (5 + LENGTH));
    bench.send(client, &ask(1, 65)[..4]);
    bench.run_until(bench.now() + 20.millis() + CHARACTER * 4 + 1.secs() + Duration::TICK);
    bench.send(client, &ask(1, 65)[4..]);
    bench.run_until_idle();
    assert_eq!(received_by(&mut bench, client), [0; 0]);
    assert_eq!(bench.statistics(slots[0], RS485).gap, 1);
}

#[test]
fn noise_goes_at_once_and_means_nothing() {
    for line in [LineMode::Timed, LineMode::Fast] {
        let (mut bench, slots, client) = echoes(line);
        let rtu = rtu::read(1, 0, 1);
        for noise in [&b"0123"[..], &rtu, b"\r\n", b":01", b"\r\n\r\n\n"] {
            bench.send(client, noise);
            bench.run_until(bench.now() + 100.millis());
            bench.send(client, &[noise, &ask(1, 65)].concat());
            bench.run_until_idle();
            assert_eq!(received_by(&mut bench, client), ask(1, 65), "{}", noise.escape_ascii());
        }
        assert_eq!(bench.backlog(client), 0);
        assert_eq!(seen(&bench, slots[0]).0, 5);
    }
}

#[test]
fn messages_written_at_once_follow_each_other_without_a_silence() {
    let (mut bench, slots, client) = echoes(LineMode::Timed);
    bench.send(client, &[ask(1, 65), ask(0, 66), ask(2, 67)].concat());
    bench.run_until_idle();
    assert_eq!(received_by(&mut bench, client), [ask(1, 65), ask(2, 67)].concat());
    // The line is free right after an answer, and one tick after a frame without an answer.
    let spoken = CHARACTER * (5 * LENGTH) + Duration::TICK;
    assert_eq!(bench.now(), Instant::ZERO + spoken);
    // Each drive also receives the requests for the other drive, and the answers of the other drive.
    assert_eq!([seen(&bench, slots[0]), seen(&bench, slots[1])], [(2, 2), (2, 2)]);
}

#[test]
fn what_two_messages_overheard_at_once_are() {
    for line in [LineMode::Timed, LineMode::Fast] {
        let (mut bench, slots, client) = echoes(line);
        bench.send(client, &ask(1, TWICE));
        bench.run_until(1.secs());
        assert_eq!(received_by(&mut bench, client), [ask(1, TWICE), ask(1, TWICE)].concat());
        assert_eq!([seen(&bench, slots[0]), seen(&bench, slots[1])], [(1, 0), (0, 3)]);
    }
}

#[test]
fn a_client_that_leaves_takes_its_half_message_along() {
    let (mut bench, slots, client) = echoes(LineMode::Timed);
    let other = bench.connect(bench.bus(slots[0], RS485).unwrap());
    bench.send(client, &[ask(1, 65), b":02".to_vec()].concat());
    bench.send(other, &ask(2, 66));
    bench.disconnect(client);
    bench.run_until_idle();
    assert_eq!(received_by(&mut bench, other), [ask(1, 65), ask(2, 66)].concat());
    assert_eq!(bench.statistics(slots[0], RS485).spoiled, 0);
}

#[test]
fn a_sender_with_other_settings_is_not_understood() {
    let (mut bench, slots, client) = echoes(LineMode::Timed);
    bench.send_from(
        client,
        &ask(1, 65),
        Sender { parity: PortParity::Known(Parity::Odd), ..Sender::default() },
    );
    bench.run_until_idle();
    assert_eq!(received_by(&mut bench, client), [0; 0]);
    bench.send_from(client, &ask(1, 65), Sender { parity: PortParity::NotOdd, ..Sender::default() });
    bench.run_until_idle();
    assert_eq!(received_by(&mut bench, client), ask(1, 65));
    assert_eq!(seen(&bench, slots[0]), (1, 0));
}

#[test]
fn fast_takes_no_time() {
    let (mut bench, slots, _) = echoes(LineMode::Fast);
    for function in 65..70 {
        assert_eq!(bench.ask(slots[1], &ask(2, function)), ask(2, function));
    }
    assert!(bench.now() <= Instant::ZERO + Duration::TICK * 10);
    let make = |_: &str| Some(Box::new(EchoDevice::at(2)) as Box<dyn Device>);
    let mut bench = Bench::with(Settings { line: LineMode::Fast, ..Settings::default() });
    let drive = bench.add_with("echo", make("echo").unwrap(), Setup::default()).unwrap();
    assert_eq!(bench.ask(drive, &ask(2, 65)), ask(2, 65));
    let trace = Trace::parse(&bench.trace().to_text(), &make).unwrap();
    assert_eq!(replay::run(&trace, &make), Ok(None));
}

#[test]
fn on_a_strict_line_only_a_request_before_the_end_of_the_reply_is_early() {
    // A reply ends with the line feed, so no silence follows it. A client whose time-out begins when its characters
    // are on the line sends so much earlier here.
    let ends = Instant::ZERO + CHARACTER * (2 * LENGTH);
    let excused = ends - CHARACTER * LENGTH;
    for (at, answered, early) in
        [(ends, true, 0), (excused, true, 0), (excused - Duration::TICK, false, 1), (Instant::ZERO, false, 1)]
    {
        let (mut bench, [x, _], client) = echoes(LineMode::Timed);
        let bus = bench.bus(x, RS485).unwrap();
        bench.set_strict(bus, true);
        bench.send(client, &ask(1, 65));
        bench.run_until(at);
        bench.send(client, &ask(2, 66));
        bench.run_until(1.secs());
        let answers = if answered { [ask(1, 65), ask(2, 66)].concat() } else { ask(1, 65) };
        assert_eq!((received_by(&mut bench, client), bench.early_count()), (answers, early));
        if !answered {
            let message = bench.received(x).messages().last().unwrap();
            assert_eq!(message.exchange.outcome, "sent while the line was in use");
        }
    }
}

#[test]
fn a_fault_refuses_at_the_line_feed_as_a_drive_answers() {
    use crate::line::faults::FaultRule;
    let (mut bench, [x, _], client) = echoes(LineMode::Timed);
    let faults = LineFaults { exception: FaultRule::next(1), ..LineFaults::NONE };
    bench.set_line_faults(bench.bus(x, RS485).unwrap(), faults);
    bench.send(client, &ask(1, 65));
    bench.run_until_idle();
    let mut received = Vec::new();
    bench.receive(client, &mut received);
    // The address, the function with bit 7, the code and the LRC.
    assert_eq!(received, b":01C1043A\r\n");
    assert_eq!(bench.now(), Instant::ZERO + CHARACTER * (LENGTH + 11));
    assert_eq!(seen(&bench, x), (0, 0));
}
