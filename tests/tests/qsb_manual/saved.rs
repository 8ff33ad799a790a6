//! Values that command 3 saves, and the values after a memory failure.

use drivetwin_protocol::time::Span;
use drivetwin_sim::bench::PowerAction;

use crate::rig::{Rig, START_UP, TICK};

impl Rig {
    /// Saves the parameters, whatever the format of the replies.
    pub(crate) fn save_in_any_format(&mut self) {
        let reply = self.ask("W163");
        assert!(reply.starts_with('w'), "W163 is answered {reply}");
        self.after(11.millis());
    }
}

/// Saved outputs are restored after the configuration, which sets all pins high.
#[test]
fn outputs_are_restored() {
    let mut rig = Rig::ready("qsb-m");
    rig.write("W02F00");
    rig.write("W015");
    rig.save();
    rig.write("W01A");
    rig.restart("qsb-m");
    rig.says(&[("R02", "r 02 00000F00 !"), ("R01", "r 01 00000005 !")]);
    let levels = ["DIO3", "DIO2", "DIO1", "DIO0"].map(|pin| rig.is_high(pin));
    assert_eq!(levels, [false, true, false, true]);
}

/// QSB-13: command 0 restores the saved port, not the factory's.
#[test]
fn command_0_restores_the_saved_port() {
    let mut rig = Rig::ready("qsb-m");
    rig.write("W02700");
    rig.write("W012");
    rig.save();
    rig.write("W02FF0");
    rig.write("W01F");
    rig.write("W0B9");
    rig.write("W160");
    rig.says(&[
        ("R02", "r 02 00000700 !"),
        // Outputs 2 to 0 have their saved values. Pin 3 is an input.
        ("R01", "r 01 0000000A !"),
        // No other register is restored.
        ("R0B", "r 0B 00000009 !"),
    ]);
}

/// If power fails during a save, the memory is bad, and the drive starts with the factory's values.
#[test]
fn power_fails_in_a_save() {
    let mut rig = Rig::ready("qsb-m");
    rig.write("W0B5");
    rig.save();
    rig.restart("qsb-m");
    rig.says(&[("R0B", "r 0B 00000005 !"), ("W0B7", "w 0B 00000007 !")]);
    rig.write("W163");
    rig.after(2.millis());
    rig.bench.power(rig.seat, PowerAction::Off);
    rig.after(1.secs());
    rig.bench.power(rig.seat, PowerAction::On);
    let heard = rig.hear(START_UP + TICK);
    rig.take_banner(heard, "qsb-m");
    rig.says(&[("R0B", "r 0B 00000000 !"), ("R0C", "r 0C 0000FFFF !"), ("R15", "r 15 0000000B !")]);
    // Saving works again.
    rig.write("W0B8");
    rig.save();
    rig.restart("qsb-m");
    rig.says(&[("R0B", "r 0B 00000008 !")]);
}

/// The drive answers during a save. A second save starts again, with the values of that moment.
#[test]
fn commands_during_a_save() {
    let mut rig = Rig::ready("qsb-m");
    rig.write("W0B5");
    rig.write("W163");
    rig.after(4.millis());
    rig.says(&[("R0B", "r 0B 00000005 !"), ("W0B6", "w 0B 00000006 !")]);
    rig.save();
    rig.restart("qsb-m");
    rig.says(&[("R0B", "r 0B 00000006 !")]);
}

/// Streams and the state of the motor drive are saved, too. After a later
/// save without streams, no stream starts at power-on.
#[test]
fn streams_wake_up() {
    let mut rig = Rig::ready("qsb-m");
    rig.write("W15F");
    rig.write("W0C1");
    rig.ask("S0E");
    rig.ask("S13");
    rig.write("W162");
    rig.save_in_any_format();
    rig.power_cycle();
    let heard = rig.hear(START_UP + 100.millis());
    rig.take_banner(heard, "qsb-m");
    let heard = rig.hear(0.millis());
    let stamps: Vec<u64> = heard.iter().filter(|(_, text)| text.starts_with("s 0E ")).map(stamp).collect();
    // 50 ms is within tick 25, 150 ms within tick 76.
    assert!((25..=27).contains(&stamps[0]), "{heard:?}");
    assert!(stamps.len() >= 49 && stamps.windows(2).all(|pair| pair[1] == pair[0] + 1), "{stamps:?}");
    assert!(rig.ask("R13").starts_with("r 13 00000011 "));

    rig.write("W161");
    rig.write("W160");
    rig.save_in_any_format();
    rig.power_cycle();
    let heard = rig.hear(START_UP + 100.millis());
    rig.take_banner(heard, "qsb-m");
    assert_eq!(rig.texts(1.secs()), [""; 0]);
    assert!(rig.ask("R13").starts_with("r 13 00000001 "));
}

/// Time stamp of a record in format F.
pub(crate) fn stamp(line: &crate::rig::Line) -> u64 {
    u64::from_str_radix(&line.1[14..22], 16).expect("a record with a time stamp")
}
