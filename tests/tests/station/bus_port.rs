//! The port of the bus.

use drivetwin_board::CablePort;
use drivetwin_control::{Answer, Call, Statistics};
use drivetwin_firmware::device::{Duration, Instant, Line};
use drivetwin_protocol::line::Parity;
use drivetwin_protocol::modbus::rtu;
use drivetwin_tests::at_cable::Rig;

/// Ticks of a character of 9,600 8E1: 11 bits.
const CHARACTER: u64 = 18_333;

fn statistics(rig: &mut Rig) -> Statistics {
    match rig.call(Call::Statistics) {
        Ok(Answer::Statistics(statistics)) => statistics,
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_request_is_answered_after_exactly_3_5_characters_of_silence() {
    let mut rig = Rig::new("md3", true);
    rig.run_until(Instant::from_ticks(1_000_000));
    let request = rtu::read(1, 0x00, 1);
    rig.write(CablePort::Bus, &request);
    rig.run_for(Duration::millis(100));
    // Eight characters, 3.5 characters of silence, and one more: a character that begins before that ends then.
    let start = 1_000_000 + 8 * CHARACTER + 64_166 + CHARACTER;
    let reply = rtu::frame(1, &[3, 2, 0, 1]);
    let sent: Vec<(Instant, u8)> = rig.sent();
    let bytes: Vec<u8> = sent.iter().map(|(_, byte)| *byte).collect();
    assert_eq!(bytes, reply.as_slice());
    assert_eq!(sent[0].0, Instant::from_ticks(start));
    assert_eq!(rig.read_bus(), reply.as_slice());
    assert_eq!(statistics(&mut rig).requests, 1);
}

#[test]
fn other_settings_are_characters_with_an_error() {
    let line = Line::new(9_600, 8, Parity::Even, 1);
    let wrong = [
        Line { baud: 19_200, ..line },
        Line { parity: Parity::Odd, ..line },
        Line { stop: 2, ..line },
        Line { data: 7, ..line },
    ];
    for wrong in wrong {
        let mut rig = Rig::new("md3", true);
        rig.set_line(Some(wrong));
        rig.write(CablePort::Bus, &rtu::read(1, 0x00, 1));
        rig.run_for(Duration::millis(100));
        assert_eq!((rig.sent(), rig.read_bus()), (vec![], vec![]), "{wrong}");
        assert_eq!(statistics(&mut rig).spoiled, 1, "{wrong}");
        rig.set_line(Some(line));
        rig.write(CablePort::Bus, &rtu::read(1, 0x00, 1));
        rig.run_for(Duration::millis(100));
        assert_eq!(rig.read_bus(), rtu::frame(1, &[3, 2, 0, 1]).as_slice(), "{wrong}");
    }
}
