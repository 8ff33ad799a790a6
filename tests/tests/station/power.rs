//! Power of the drive: off, on, and failing in a save.

use drivetwin_board::CablePort;
use drivetwin_control::{Answer, Call, Event, Level, Power, Refused, Stimulus};
use drivetwin_firmware::device::{Boot, Duration, Instant};
use drivetwin_protocol::modbus::rtu;
use drivetwin_tests::at_cable::Rig;

use crate::calls::{FAMILIES, pin, read, row, state};

fn power(rig: &mut Rig, power: Power) {
    assert_eq!(rig.call(Call::Power(power)), Ok(Answer::Done));
}

fn preset(rig: &mut Rig, name: &str, value: i64) {
    let row = row(rig.spec(), name);
    assert_eq!(rig.call(Call::Preset { row, value }), Ok(Answer::Done), "{name}");
}

/// Asks an MD3 over the bus, and waits for the reply.
fn ask(rig: &mut Rig, request: &[u8]) -> Vec<u8> {
    rig.write(CablePort::Bus, request);
    rig.run_for(Duration::millis(60));
    rig.read_bus()
}

#[test]
fn without_power_a_drive_hears_and_does_nothing() {
    let mut rig = Rig::new("md3", true);
    rig.run_for(Duration::millis(10));
    preset(&mut rig, "MotionControl", 1);
    rig.run_for(Duration::millis(1_000));
    let (steps, light) = (rig.steps().len(), pin(rig.spec(), "D6"));
    assert!(steps > 1_000);
    power(&mut rig, Power::Off);
    let off = state(&mut rig);
    let motion = off.motion.expect("an axis");
    assert!(!off.powered && !motion.moving && motion.speed == 0 && motion.ma == 0, "{motion:?}");
    assert_eq!(off.level(light), Level::Low);
    // Every pin of the board that the drive drove is released.
    let levels = rig.levels();
    for (_, pin, _) in &levels {
        let last = levels.iter().rfind(|(_, other, _)| other == pin).map(|(.., level)| *level);
        assert_eq!(last, Some(None), "{pin:?}");
    }
    assert_eq!(ask(&mut rig, &rtu::read(1, 0x00, 1)), [0; 0]);
    rig.run_for(Duration::secs(2));
    assert_eq!(rig.steps().len() - steps, 0);
    assert_eq!(motion.position, steps as i32);
    power(&mut rig, Power::Off);
    power(&mut rig, Power::On);
    power(&mut rig, Power::On);
    assert!(state(&mut rig).powered);
    assert_eq!(state(&mut rig).motion.expect("an axis").position, 0);
    assert_eq!(ask(&mut rig, &rtu::read(1, 0x00, 1)), rtu::frame(1, &[3, 2, 0, 1]).as_slice());
}

#[test]
fn a_reply_ends_with_the_power() {
    let mut rig = Rig::new("md3", true);
    rig.write(CablePort::Bus, &rtu::read(1, 0x00, 10));
    rig.run_for(Duration::millis(18));
    let before = rig.sent().len();
    assert!(before > 0, "the reply has begun");
    power(&mut rig, Power::Off);
    rig.run_for(Duration::millis(60));
    // Two characters were in the UART.
    assert!(rig.sent().len() <= before + 1, "{} of 25 characters", rig.sent().len());
    power(&mut rig, Power::On);
    rig.read_bus();
    assert_eq!(ask(&mut rig, &rtu::read(1, 0x00, 1)), rtu::frame(1, &[3, 2, 0, 1]).as_slice());
}

#[test]
fn a_drive_starts_as_it_was_booted() {
    let mut rig = Rig::with("md3", Boot::default(), None);
    rig.run_for(Duration::secs(4));
    power(&mut rig, Power::Cycle);
    assert_eq!(ask(&mut rig, &rtu::read(1, 0x00, 1)), [0; 0], "it is starting");
    rig.run_for(Duration::secs(4));
    assert_eq!(ask(&mut rig, &rtu::read(1, 0x00, 1)), rtu::frame(1, &[3, 2, 0, 1]).as_slice());
}

#[test]
fn what_is_not_saved_is_lost_and_stimuli_stay() {
    let mut rig = Rig::new("md3", true);
    preset(&mut rig, "AccelDecel", 5_000);
    let input = pin(rig.spec(), "J2.2");
    rig.call(Call::Drive { pin: input, stimulus: Stimulus::Low }).expect("done");
    rig.call(Call::Fault { fault: 0, on: true }).expect("done");
    power(&mut rig, Power::Off);
    rig.call(Call::Trace(true)).expect("done");
    power(&mut rig, Power::On);
    rig.run_for(Duration::millis(1));
    assert_eq!(read(&mut rig, "AccelDecel"), 10_000);
    let messages = rig.events();
    let events: Vec<Event<'_>> =
        messages.iter().flat_map(|events| events.decode()).map(|(_, event)| event).collect();
    let place = |event| events.iter().position(|other| *other == event);
    assert_eq!(place(Event::Power(true)), Some(0));
    assert!(place(Event::Fault(0, true)).is_some() && place(Event::Edge(input, false)).is_some());
    assert!(place(Event::Fault(0, true)) < place(Event::Edge(input, false)));
    assert_eq!((state(&mut rig).faults, state(&mut rig).level(input)), (1, Level::Low));
}

#[test]
fn a_saved_register_is_preset_without_power() {
    // A saved register with a new value, and another one that loses its value.
    let rows = [
        ("md3", ("AccelDecel", 5_000), ("StartupDelay", 7)),
        ("qsb-m", ("Mdr0", 2), ("Dtr", 77)),
        ("rs434544", ("MODE_DEVICE", 2), ("TIMEOUT_BROADCAST_MODBUS", 7)),
    ];
    for (kind, (name, value), (other, lost)) in rows {
        let mut rig = Rig::new(kind, true);
        rig.run_for(Duration::millis(200));
        let factory = read(&mut rig, other);
        assert!(read(&mut rig, name) != value && factory != lost, "{kind}");
        preset(&mut rig, other, lost);
        assert_eq!(read(&mut rig, other), lost, "{kind}");
        power(&mut rig, Power::Off);
        preset(&mut rig, name, value);
        power(&mut rig, Power::On);
        rig.run_for(Duration::millis(200));
        assert_eq!((read(&mut rig, name), read(&mut rig, other)), (value, factory), "{kind}");
        // The memory is one that the drive has written itself.
        power(&mut rig, Power::Cycle);
        rig.run_for(Duration::millis(200));
        assert_eq!(read(&mut rig, name), value, "{kind} {name}");
    }
    // An MDROBOT saves every value at once.
    let mut rig = Rig::new("mdrobot", true);
    power(&mut rig, Power::Off);
    preset(&mut rig, "STOP_STATUS", 2);
    power(&mut rig, Power::On);
    assert_eq!(read(&mut rig, "STOP_STATUS"), 2);
    let mut rig = Rig::new("md3", true);
    power(&mut rig, Power::Off);
    let row = row(rig.spec(), "QuadratureEncoderCount");
    assert_eq!(rig.call(Call::Preset { row, value: 0 }), Err(Refused::ReadOnly));
}

#[test]
fn power_fails_in_the_middle_of_a_save_as_on_the_bench() {
    let mut rig = Rig::new("md3", true);
    rig.run_for(Duration::millis(10));
    preset(&mut rig, "AccelDecel", 5_000);
    rig.call(Call::Trace(true)).expect("done");
    power(&mut rig, Power::Cut);
    assert!(state(&mut rig).powered, "not before a save");
    // Half of the image is written (BOARD-16). EEPROMControl = 1: the drive has no power any more when it would answer.
    assert_eq!(ask(&mut rig, &rtu::write(1, 0x1A, 1)), [0; 0]);
    assert!(!state(&mut rig).powered);
    let messages = rig.events();
    let events: Vec<Event<'_>> =
        messages.iter().flat_map(|events| events.decode()).map(|(_, event)| event).collect();
    let [.., Event::Store(0, stored), Event::Cut(count)] = events[..] else { panic!("{events:?}") };
    let size = usize::from(rig.spec().memory);
    assert_eq!((stored.len(), count), (size / 2, size as u16 / 2));
    let Ok(Answer::Memory(memory)) = rig.call(Call::ReadMemory { offset: 0 }) else { panic!("memory") };
    assert_eq!(memory[..size / 2], *stored);
    assert!(memory[size / 2..].iter().all(|byte| *byte == 0xFF));
    // Bit 15 of 0x1A: the CRC of the memory is wrong, and the factory values hold.
    power(&mut rig, Power::On);
    assert_eq!(ask(&mut rig, &rtu::read(1, 0x1A, 1))[3] & 0x80, 0x80);
    assert_eq!(read(&mut rig, "AccelDecel"), 10_000);
    // The next save is a whole one.
    preset(&mut rig, "AccelDecel", 6_000);
    assert_eq!(ask(&mut rig, &rtu::write(1, 0x1A, 1)), rtu::write(1, 0x1A, 1).as_slice());
    power(&mut rig, Power::Cycle);
    rig.run_for(Duration::millis(10));
    assert_eq!(read(&mut rig, "AccelDecel"), 6_000);
}

#[test]
fn a_cut_is_taken_back() {
    let mut rig = Rig::new("md3", true);
    rig.run_for(Duration::millis(10));
    // Off and on do not end a cut that has not happened, as on the bench.
    for (action, reply) in [(Power::Keep, &rtu::write(1, 0x1A, 1)[..]), (Power::Cycle, &[])] {
        power(&mut rig, Power::Cut);
        power(&mut rig, action);
        rig.run_for(Duration::millis(10));
        preset(&mut rig, "AccelDecel", 5_000);
        assert_eq!(ask(&mut rig, &rtu::write(1, 0x1A, 1)), reply, "{action:?}");
        assert_eq!(state(&mut rig).powered, !reply.is_empty(), "{action:?}");
    }
}

#[test]
fn a_drive_with_two_copies_keeps_the_old_values_in_a_power_cut() {
    let mut rig = Rig::new("mdrobot", true);
    rig.run_for(Duration::millis(10));
    let name = rig.spec().rows().map(|(_, row)| row.name).find(|name| name.ends_with("MAX_RPM"));
    let name = name.expect("the greatest speed");
    let factory = read(&mut rig, name);
    power(&mut rig, Power::Cut);
    preset(&mut rig, name, 700);
    rig.run_for(Duration::millis(100));
    assert!(!state(&mut rig).powered);
    power(&mut rig, Power::On);
    rig.run_for(Duration::millis(10));
    assert_eq!(read(&mut rig, name), factory);
}

#[test]
fn power_comes_and_goes_for_every_kind() {
    for kind in FAMILIES {
        let mut rig = Rig::new(kind, false);
        for n in 1..20 {
            power(&mut rig, if n % 3 == 0 { Power::Cycle } else { Power::Off });
            rig.run_until(rig.now() + Duration::millis(n));
            power(&mut rig, Power::On);
            rig.run_until(rig.now() + Duration::millis(40 * n));
        }
        assert!(state(&mut rig).powered && rig.now() > Instant::ZERO, "{kind}");
    }
}
