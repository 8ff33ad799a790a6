//! Random lines, typed and stored: the drive does not panic, always makes progress, and E ends the program.

use std::format;

use proptest::prelude::*;

use super::*;

/// Lines with a number for `#` and a label for `@`.
const LINES: [&str; 66] = [
    "A=#",
    "AS=#",
    "BP @,#",
    "BP 0",
    "BR @",
    "BR @,R1<#",
    "BR #",
    "BY=1",
    "C1=#",
    "C2=#",
    "CL @",
    "CL @,MV=1",
    "CM=#",
    "CP @",
    "D=#",
    "DC R1",
    "DC Q1",
    "DE=#",
    "E",
    "EE=#",
    "EX @",
    "EX @,1",
    "EX @,2",
    "EX #",
    "H",
    "H #",
    "HI #",
    "HM #",
    "IC R2",
    "IC P",
    "IF=0",
    "IP",
    "IV R1",
    "IV Q1",
    "JE=#",
    "LM=#",
    "MA #",
    "MR #,1,1",
    "MR #",
    "MS=#",
    "MT=#",
    "OE @",
    "OE 0",
    "P=#",
    "PR P,ER",
    "PR AL",
    "PS",
    "R1=R2*#",
    "R2=P/#",
    "R3=!ER",
    "RS",
    "RT",
    "S",
    "S1=#,0",
    "SL #",
    "TC=@",
    "TE=#",
    "TI=#,@",
    "TP=#,@",
    "TR=#,@,#",
    "TR=#",
    "TT=#,@",
    "VA Q1=#",
    "VI=#",
    "VM=#",
    "#",
];

fn text() -> impl Strategy<Value = String> {
    let number = prop_oneof![
        4 => 0..=4_i32,
        3 => prop_oneof![Just(8), Just(15), Just(16), Just(63), Just(256), Just(-1)],
        3 => -100_000..100_000_i32,
        1 => any::<i32>(),
    ];
    let label = proptest::sample::select(&["K1", "K2", "K3", "K4", "K9", "3"][..]);
    (proptest::sample::select(&LINES[..]), number, label)
        .prop_map(|(line, number, label)| line.replace('#', &format!("{number}")).replace('@', label))
}

/// Random events, each with a time in µs after the previous one.
#[derive(Clone, Debug)]
enum Event {
    Typed(String),
    Level(u8, bool),
    Key(bool),
}

fn event() -> impl Strategy<Value = (u64, Event)> {
    let wait = prop_oneof![0..1_000_u64, 0..100_000_u64];
    let event = prop_oneof![
        6 => text().prop_map(Event::Typed),
        2 => (0..8_u8, any::<bool>()).prop_map(|(pin, high)| Event::Level(pin, high)),
        1 => any::<bool>().prop_map(Event::Key),
    ];
    (wait, event)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn the_drive_goes_on(
        lines in proptest::collection::vec(text(), 30..31),
        events in proptest::collection::vec(event(), 1..60),
    ) {
        let mut dut = Dut::new(Mdrive::plus());
        for (address, line) in (1..).zip(&lines) {
            let label = format!("LB K{}", address / 8 + 1);
            let line = if address % 8 == 1 { &label } else { line };
            dut.store(address, line);
        }
        dut.commands("EX 1");
        for (wait, event) in events {
            dut.wait(wait.micros());
            match event {
                Event::Typed(line) => {
                    let _ = dut.command(&line);
                }
                Event::Level(pin, high) if Pin(pin) != ANALOG => dut.level(Pin(pin), high),
                Event::Level(..) => {}
                Event::Key(one) => {
                    let Fixture { drive, now, .. } = &mut dut.fixture;
                    drive.drive.mcode.vm.step(*now, one);
                }
            }
            dut.wait(Duration::ZERO);
            prop_assert!(dut.drive.deadline() > dut.now);
            // If only motion were paused, later motion commands would wait for an RS that does nothing.
            prop_assert!(!dut.drive().motion.is_paused() || dut.drive().mcode.vm.is_paused());
        }
        dut.commands("TE=0; OE 0");
        dut.wait(1.secs());
        dut.commands("OE 0; E");
        prop_assert_eq!((dut.value(Reg::BY), dut.drive().mcode.vm.deadline()), (0, Instant::NEVER));
    }
}
