//! Garbage, broken frames, a computer that does not read: the drive goes on, and answers afterwards.

use drivetwin_board::CablePort;
use drivetwin_control::{Answer, Call, Event, Message, Power, Request, Stimulus, encode};
use drivetwin_firmware::device::Duration;
use drivetwin_protocol::modbus::rtu;
use drivetwin_tests::at_cable::Rig;
use proptest::prelude::*;

use crate::calls::{FAMILIES, pin, state};

fn frame(number: u16, call: Call<'_>) -> Vec<u8> {
    encode(&Request { number, call }, &mut [0; 256]).expect("a short request").to_vec()
}

#[test]
fn garbage_and_broken_frames_hide_no_later_request() {
    let mut rig = Rig::new("md3", true);
    let good = frame(7, Call::State);
    let mut bad = good.clone();
    bad[3] ^= 1;
    let long = [0x11; 5_000];
    for garbage in [&b"noise"[..], &bad, &good[1..], &long, &[0; 100]] {
        rig.write(CablePort::Control, garbage);
        rig.write(CablePort::Control, &[0]);
        assert!(rig.call(Call::State).is_ok());
    }
    assert_eq!(rig.messages(), []);
}

#[test]
fn two_requests_at_once_have_two_replies() {
    let mut rig = Rig::new("md3", true);
    rig.write(CablePort::Control, &[frame(1, Call::Hello), frame(2, Call::State)].concat());
    rig.run_for(Duration::millis(1));
    let numbers = rig.messages().into_iter().map(|message| match message {
        Message::Reply(reply) => reply.number,
        Message::Events(_) => panic!("no trace"),
    });
    assert_eq!(numbers.collect::<Vec<_>>(), [1, 2]);
}

#[test]
fn a_computer_that_does_not_read_stops_nothing_but_its_own_requests() {
    let mut rig = Rig::new("md3", true);
    rig.call(Call::Trace(true)).expect("done");
    rig.stall(true);
    let input = pin(rig.spec(), "J2.2");
    // 16,000 edges in 2 s, of 5 bytes each; a move meanwhile.
    for n in 0..8 {
        rig.write(
            CablePort::Control,
            &frame(n, Call::Pulse { pin: input, count: 1_000, period: 4_000, high: 2_000 }),
        );
        rig.run_for(Duration::millis(260));
    }
    let requests = rtu::read(1, 0x00, 1);
    rig.write(CablePort::Bus, &requests);
    rig.run_for(Duration::millis(100));
    assert_eq!(rig.read_bus(), rtu::frame(1, &[3, 2, 0, 1]).as_slice());
    rig.stall(false);
    rig.run_for(Duration::millis(100));
    let messages = rig.messages();
    let (mut replies, mut number, mut missing, mut edges) = (0, 0, 0, 0);
    for message in messages {
        match message {
            Message::Reply(reply) => replies += u32::from(reply.answer == Ok(Answer::Done)),
            Message::Events(events) => {
                assert_eq!(events.number, number, "no message is lost");
                for (_, event) in events.decode() {
                    number += 1;
                    match event {
                        Event::Lost(count) => missing += count,
                        Event::Edge(..) => edges += 1,
                        _ => {}
                    }
                }
            }
        }
    }
    assert!(replies >= 1, "{replies} replies");
    let Ok(Answer::Statistics(statistics)) = rig.call(Call::Statistics) else { panic!("no statistics") };
    assert_eq!(statistics.lost_events, missing);
    assert!(missing > 500 && edges > 500, "{missing} left out, {edges} edges");
}

#[test]
fn a_closed_port_of_control_begins_anew() {
    let mut rig = Rig::new("md3", true);
    rig.call(Call::Trace(true)).expect("done");
    rig.write(CablePort::Control, &frame(1, Call::State)[..3]);
    rig.open(CablePort::Control, false);
    rig.run_for(Duration::millis(1));
    rig.open(CablePort::Control, true);
    rig.call(Call::Drive { pin: pin(rig.spec(), "J2.2"), stimulus: Stimulus::Low }).expect("done");
    rig.run_for(Duration::millis(10));
    assert_eq!(rig.messages(), [], "no trace");
}

fn any_call() -> impl Strategy<Value = Call<'static>> {
    let stimulus = prop_oneof![
        Just(Stimulus::Low),
        Just(Stimulus::High),
        Just(Stimulus::Open),
        Just(Stimulus::Wire),
        any::<i32>().prop_map(Stimulus::Millivolts),
    ];
    let power = proptest::sample::select(&[Power::Off, Power::On, Power::Cycle, Power::Cut, Power::Keep]);
    let small = 0..40_u8;
    prop_oneof![
        Just(Call::Hello),
        Just(Call::State),
        (0..300_u16).prop_map(|row| Call::Read { row }),
        (0..300_u16).prop_map(|row| Call::ReadMany { row }),
        (0..300_u16, any::<u16>()).prop_map(|(row, word)| Call::ReadWords { row, word }),
        (0..300_u16, any::<i64>()).prop_map(|(row, value)| Call::Preset { row, value }),
        (0..300_u16, 0..10_i64).prop_map(|(row, value)| Call::Preset { row, value }),
        (small.clone(), stimulus).prop_map(|(pin, stimulus)| Call::Drive { pin, stimulus }),
        (small.clone(), any::<u32>(), any::<u64>(), any::<u64>())
            .prop_map(|(pin, count, period, high)| Call::Pulse { pin, count, period, high }),
        (small.clone(), 1..100_u32, 1_600..100_000_u64, 1..1_600_u64)
            .prop_map(|(pin, count, period, high)| Call::Pulse { pin, count, period, high }),
        (0..2_u8, any::<i32>(), 0..100_000_u64).prop_map(|(encoder, counts, period)| Call::Turn {
            encoder,
            counts,
            period
        }),
        (small, any::<bool>()).prop_map(|(fault, on)| Call::Fault { fault, on }),
        power.prop_map(Call::Power),
        Just(Call::Statistics),
        any::<u16>().prop_map(|offset| Call::ReadMemory { offset }),
        (0..5_000_u16).prop_map(|offset| Call::WriteMemory { offset, bytes: &[0xA5; 100] }),
        any::<bool>().prop_map(Call::Trace),
        any::<u8>().prop_map(Call::Kind),
        Just(Call::Become("md3")),
        Just(Call::Bootloader),
    ]
}

/// Something that a computer does.
#[derive(Clone, Debug)]
enum Act {
    Call(Call<'static>),
    Control(Vec<u8>),
    Bus(Vec<u8>),
    Open(bool, bool),
    Stall(bool),
    Wait(u64),
}

fn any_act() -> impl Strategy<Value = Act> {
    let bytes = || proptest::collection::vec(any::<u8>(), 0..80);
    prop_oneof![
        8 => any_call().prop_map(Act::Call),
        1 => bytes().prop_map(Act::Control),
        1 => bytes().prop_map(Act::Bus),
        1 => any::<(bool, bool)>().prop_map(|(bus, control)| Act::Open(bus, control)),
        1 => any::<bool>().prop_map(Act::Stall),
        4 => (0..200_000_u64).prop_map(Act::Wait),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    /// Whatever a computer does, nothing panics, and the drive answers afterwards.
    #[test]
    fn whatever_a_computer_does_the_drive_answers_afterwards(
        kind in 0..FAMILIES.len(),
        acts in proptest::collection::vec(any_act(), 0..60),
    ) {
        let mut rig = Rig::new(FAMILIES[kind], true);
        for act in acts {
            match act {
                Act::Call(call) => {
                    rig.send(call);
                }
                Act::Control(bytes) => rig.write(CablePort::Control, &bytes),
                Act::Bus(bytes) => rig.write(CablePort::Bus, &bytes),
                Act::Open(bus, control) => {
                    rig.open(CablePort::Bus, bus);
                    rig.open(CablePort::Control, control);
                }
                Act::Stall(stalled) => rig.stall(stalled),
                Act::Wait(ticks) => rig.run_for(Duration::from_ticks(ticks)),
            }
        }
        rig.stall(false);
        for open in [false, true] {
            rig.open(CablePort::Control, open);
            rig.run_for(Duration::millis(50));
        }
        rig.write(CablePort::Control, &[0]);
        rig.run_for(Duration::millis(1));
        rig.messages();
        prop_assert_eq!(rig.call(Call::Power(Power::Off)), Ok(Answer::Done));
        // A cut may still wait for a save, as that of an RS 434544 that restores its factory settings.
        prop_assert_eq!(rig.call(Call::Power(Power::Keep)), Ok(Answer::Done));
        // With a new memory it has its factory settings.
        for offset in 0..rig.spec().memory {
            prop_assert_eq!(rig.call(Call::WriteMemory { offset, bytes: &[0xFF] }), Ok(Answer::Done));
        }
        prop_assert_eq!(rig.call(Call::Power(Power::On)), Ok(Answer::Done));
        // An RS 434544 whose input CLR_FLASH is low starts for 5 s.
        rig.run_for(Duration::secs(8));
        prop_assert!(state(&mut rig).powered);
        rig.set_line(rig.uart_line());
        rig.open(CablePort::Bus, true);
        rig.run_for(Duration::secs(1));
        rig.read_bus();
        let request = match FAMILIES[kind] {
            "md3" => rtu::read(1, 0x00, 1).to_vec(),
            "rs434544" => rtu::read(1, 0x500B, 1).to_vec(),
            "mdrobot" => rtu::read(1, 0x30, 1).to_vec(),
            _ => b"R0E\r".to_vec(),
        };
        rig.write(CablePort::Bus, &request);
        rig.run_for(Duration::secs(1));
        prop_assert!(!rig.read_bus().is_empty(), "{}", FAMILIES[kind]);
    }
}
