//! Sections 6 and 6.4: the five types and eleven rates of the serial line, ASCII, the delay of replies,
//! parity.

use drivetwin_firmware::device::{Line, Port};
use drivetwin_protocol::line::Parity;
use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::time::{Duration, Span};
use drivetwin_sim::bench::Setup;
use drivetwin_sim::line::{LineMode, PortParity, Sender};
use drivetwin_tests::rs434::{BOOT, Rig, SILENCE, at, key, request};

/// Values of TYPE_MODBUS with data bits, parity and stop bits (6.4).
const TYPES: [(u16, u8, Parity, u8); 5] = [
    (1, 7, Parity::Even, 1),
    (2, 7, Parity::Odd, 1),
    (3, 8, Parity::Even, 1),
    (4, 8, Parity::Odd, 1),
    (5, 8, Parity::None, 2),
];

/// Baud rates for BITRATE_MODBUS 0 to 10 (6.4).
const RATES: [u32; 11] = [600, 1_200, 2_400, 4_800, 9_600, 14_400, 19_200, 38_400, 57_600, 115_200, 128_000];

/// A drive after its start-up, on a line on which characters take time.
fn timed() -> Rig {
    let mut rig = Rig::new("rs434544", LineMode::Timed, Setup::default());
    rig.after(BOOT);
    rig
}

/// A drive that was restarted after these settings were saved, on a line on which characters take time.
fn restarted(settings: &[(u16, u16)]) -> Rig {
    let mut rig = timed();
    for &(address, value) in settings {
        rig.write(address, value);
    }
    rig.save();
    rig.restart();
    rig
}

fn line(rig: &Rig) -> Line {
    rig.bench.line(rig.bench.bus(rig.seat, Port(0)).expect("a line"))
}

/// An ASCII message in upper case: `:`, two digits per byte, LRC, CR LF (serial 2.5.2).
fn ascii(body: &[u8]) -> Vec<u8> {
    let sum: u32 = body.iter().map(|&byte| u32::from(byte)).sum();
    let lrc = (256 - sum % 256) as u8;
    let digits: String = body.iter().chain([&lrc]).map(|byte| format!("{byte:02X}")).collect();
    format!(":{digits}\r\n").into_bytes()
}

/// Sends a message and returns the replies as text, for readable failures.
fn ask_ascii(rig: &mut Rig, message: &[u8]) -> String {
    String::from_utf8_lossy(&rig.bench.ask(rig.seat, message)).into_owned()
}

#[test]
fn section_6_factory_line() {
    assert_eq!(line(&timed()), Line::new(115_200, 8, Parity::Even, 1));
}

/// All 55 combinations take effect "after the reboot" (6.4), not before. Then SPEED is read with the new
/// framing.
#[test]
fn section_6_4_types_and_rates() {
    for (kind, data, parity, stop) in TYPES {
        for (code, baud) in (0..).zip(RATES) {
            let mut rig = timed();
            rig.write(at::TYPE, kind);
            rig.write(at::BITRATE, code);
            rig.save();
            assert_eq!(line(&rig), Line::new(115_200, 8, Parity::Even, 1));
            rig.write(at::RESTART, key::RESTART);
            rig.after(BOOT + 10.millis());
            assert_eq!(line(&rig), Line::new(baud, data, parity, stop), "{kind} {code}");
            let body = [&[1][..], &request(3, at::SPEED, 1)].concat();
            if data == 7 {
                assert_eq!(ask_ascii(&mut rig, &ascii(&body)), ":01030203E80F\r\n", "{kind} {code}");
                assert_eq!(rig.bench.ask(rig.seat, &rtu::read(1, at::SPEED, 1)), SILENCE);
            } else {
                assert_eq!(rig.read(at::SPEED), 1_000, "{kind} {code}");
                assert_eq!(rig.bench.ask(rig.seat, &ascii(&body)), SILENCE);
            }
        }
    }
}

/// "New values must be saved": without a save a restart restores the saved values.
#[test]
fn section_6_4_without_a_save() {
    let mut rig = timed();
    rig.write(at::TYPE, 1);
    rig.write(at::BITRATE, 4);
    rig.write(at::SLAVE_ADDRESS, 9);
    rig.restart();
    assert_eq!(line(&rig), Line::new(115_200, 8, Parity::Even, 1));
    assert_eq!([at::TYPE, at::BITRATE, at::SLAVE_ADDRESS].map(|address| rig.read(address)), [3, 9, 1]);
}

#[test]
fn section_6_4_addresses() {
    for address in [2, 247] {
        let mut rig = timed();
        rig.write(at::SLAVE_ADDRESS, address);
        rig.save();
        assert_eq!(rig.read(at::SLAVE_ADDRESS), address, "still at address 1");
        rig.restart();
        assert_eq!(rig.bench.ask(rig.seat, &rtu::read(1, at::SPEED, 1)), SILENCE);
        let reply = rig.bench.ask(rig.seat, &rtu::read(address as u8, at::SPEED, 1));
        assert_eq!(reply, rtu::frame(address as u8, &[3, 2, 0x03, 0xE8])[..]);
    }
}

/// RS434-3: a drive with address 0 obeys broadcasts and never answers.
#[test]
fn section_6_4_address_0() {
    let mut rig = restarted(&[(at::SLAVE_ADDRESS, 0)]);
    for frame in [rtu::read(1, at::SPEED, 1), rtu::read(0, at::SPEED, 1), rtu::write(0, at::SPEED, 500)] {
        assert_eq!(rig.bench.ask(rig.seat, &frame), SILENCE);
    }
    let row = rig.bench.spec(rig.seat).find("SPEED").expect("a register").row;
    assert_eq!(rig.bench.peek(rig.seat, row), 500);
}

/// Time from the start of a request, on a silent line, to the reply.
fn reply_takes(rig: &mut Rig, frame: &[u8]) -> Duration {
    rig.after(1.secs());
    let bus = rig.bench.bus(rig.seat, Port(0)).expect("a line");
    let client = rig.bench.connect(bus);
    let start = rig.now();
    rig.bench.send(client, frame);
    let mut reply = Vec::new();
    while rig.bench.receive(client, &mut reply) == 0 {
        let next = rig.bench.next();
        assert!(next < start + 1_000.secs(), "no reply");
        rig.bench.run_until(next);
    }
    let took = rig.now().since(start);
    rig.bench.run_until_idle();
    rig.bench.disconnect(client);
    took
}

/// "An additional delay between the received packet and the reply message", in ms (RS434-3). Like the other
/// three settings it takes effect after a restart.
#[test]
fn section_6_4_timeout() {
    let read = rtu::read(1, at::SPEED, 1);
    let plain = reply_takes(&mut timed(), &read);
    // At least the request and 3.5 characters of silence: 8 characters of 11 bits at 115,200 baud are 764 µs,
    // and 1.75 ms.
    assert!(plain >= 2_500.micros() && plain < 4.millis(), "{plain:?}");
    for ms in [1, 250, 2_000, 65_535] {
        let mut rig = restarted(&[(at::TIMEOUT, ms)]);
        assert_eq!(reply_takes(&mut rig, &read), plain + u64::from(ms).millis());
        // A refusal is delayed like any reply.
        let refused = reply_takes(&mut rig, &rtu::read(1, 0, 1));
        assert_eq!(refused, plain + u64::from(ms).millis());
    }
}

/// "After the reboot": a written or saved delay takes effect only after a restart. Without a save it never
/// does.
#[test]
fn section_6_4_timeout_before_the_restart() {
    let read = rtu::read(1, at::SPEED, 1);
    let mut rig = timed();
    let plain = reply_takes(&mut rig, &read);
    rig.write(at::TIMEOUT, 2_000);
    assert_eq!(reply_takes(&mut rig, &read), plain);
    rig.restart();
    assert_eq!((reply_takes(&mut rig, &read), rig.read(at::TIMEOUT)), (plain, 0));
    rig.write(at::TIMEOUT, 2_000);
    rig.save();
    assert_eq!((reply_takes(&mut rig, &read), rig.read(at::TIMEOUT)), (plain, 2_000));
}

/// A message as in the specification. Its LRC, by hand: 01+03+50+0B+00+01 = 60h, so A0h.
#[test]
fn section_6_4_ascii_messages() {
    let mut rig = restarted(&[(at::TYPE, 1)]);
    let reply = ":01030203E80F\r\n";
    assert_eq!(ask_ascii(&mut rig, b":0103500B0001A0\r\n"), reply);
    assert_eq!(ascii(&[1, 3, 0x50, 0x0B, 0, 1]), b":0103500B0001A0\r\n");
    // Upper and lower case are accepted.
    assert_eq!(ask_ascii(&mut rig, b":0103500b0001a0\r\n"), reply);
    // A write, a refusal, and a coil.
    assert_eq!(ask_ascii(&mut rig, &ascii(&[1, 6, 0x50, 0x0B, 0x01, 0xF4])), ":0106500B01F4A9\r\n");
    assert_eq!(ask_ascii(&mut rig, &ascii(&[1, 6, 0x50, 0x0B, 0, 1])), ":01860376\r\n");
    assert_eq!(ask_ascii(&mut rig, &ascii(&[1, 5, 0x20, 0x03, 0xFF, 0])), ":01052003FF00D8\r\n");
    // A broadcast and a foreign address get no reply.
    assert_eq!(ask_ascii(&mut rig, &ascii(&[0, 6, 0x50, 0x0B, 0x01, 0xF5])), "");
    assert_eq!(ask_ascii(&mut rig, &ascii(&[2, 6, 0x50, 0x0B, 0x01, 0xF6])), "");
    assert_eq!(ask_ascii(&mut rig, b":0103500B0001A0\r\n"), ":01030201F504\r\n");
}

/// A wrong LRC, an odd number of digits, an invalid digit, or no CR: the drive does not answer, but answers
/// the next message. After noise the next `:` starts a message.
#[test]
fn section_6_4_ascii_noise() {
    let mut rig = restarted(&[(at::TYPE, 2)]);
    let good = ":0103500B0001A0\r\n";
    let reply = ":01030203E80F\r\n";
    for bad in [
        ":0103500B0001A1\r\n",
        ":0103500B0001A\r\n",
        ":0103500B000GA0\r\n",
        ":0103500B0001A0\n",
        "0103500B0001A0\r\n",
        ":\r\n",
        ":01\r\n",
        "\r\n\r\n",
    ] {
        assert_eq!(ask_ascii(&mut rig, bad.as_bytes()), "", "{bad:?}");
        rig.after(2.secs());
        assert_eq!(ask_ascii(&mut rig, good.as_bytes()), reply, "after {bad:?}");
    }
    for noise in ["xyz", ":0103", ":0106500B", ":::", "\r\n:01", "\u{7f}\u{1}"] {
        assert_eq!(ask_ascii(&mut rig, format!("{noise}{good}").as_bytes()), reply, "after {noise:?}");
    }
    // RS434-5: none of these sets an ERROR bit.
    assert_eq!(ask_ascii(&mut rig, &ascii(&[1, 3, 0x50, 0x23, 0, 1])), ":0103020000FA\r\n");
}

/// "Intervals of up to one second may elapse between characters within the message."
#[test]
fn section_6_4_ascii_pauses() {
    for (pause, answered) in [(900.millis(), true), (1_100.millis(), false)] {
        let mut rig = restarted(&[(at::TYPE, 1)]);
        rig.bench.set_frame_timeout(1.millis());
        let bus = rig.bench.bus(rig.seat, Port(0)).expect("a line");
        let client = rig.bench.connect(bus);
        let (one, other) = b":0103500B0001A0\r\n".split_at(6);
        rig.bench.send(client, one);
        rig.after(pause);
        rig.bench.send(client, other);
        rig.after(1.secs());
        let mut reply = Vec::new();
        rig.bench.receive(client, &mut reply);
        assert_eq!(!reply.is_empty(), answered, "{pause:?}");
    }
}

/// The drive does not answer characters with another rate or parity. RS434-5: wrong parity sets bit 14, and a
/// write clears it.
#[test]
fn section_6_5_parity() {
    let mut rig = timed();
    let bus = rig.bench.bus(rig.seat, Port(0)).expect("a line");
    let client = rig.bench.connect(bus);
    let odd = Sender { parity: PortParity::Known(Parity::Odd), ..Sender::default() };
    rig.bench.send_from(client, &rtu::write(1, at::SPEED, 500), odd);
    rig.bench.run_until_idle();
    rig.after(100.millis());
    let mut reply = Vec::new();
    rig.bench.receive(client, &mut reply);
    assert_eq!(reply, SILENCE);
    rig.bench.disconnect(client);
    assert_eq!((rig.read(at::SPEED), rig.read(at::ERROR)), (1_000, 1 << 14));
    rig.write(at::ERROR, 0);
    assert_eq!(rig.read(at::ERROR), 0);
}
