//! The bench, and who talks to what.

use crate::dialect::{Dialect, MDROBOT, R1, md3, rs};

/// The bench file. 0x25 is 115,200 8E1 of an MD3 (7.22), the factory's settings of an RS drive. Code 5 is 115,200 baud of
/// an MDROBOT. Drives whose power fails have their start-up delay. Visitors open all ports of `step`.
const BENCH: &str = r#"
[[drive]]
name = "step"
kind = "md3"
fast_boot = true
set = { SerialPortConfiguration = 0x25 }
listen = ["tcp:127.0.0.1:0", "pty:", "rfc2217:127.0.0.1:0"]
[[motor]]
name = "shaft"
drive = "step"
[[encoder]]
motor = "shaft"
cycles_per_rev = 100
to = { a = "count.A", b = "count.B", index = "count.I" }
[[drive]]
name = "count"
kind = "qsb-d"
fast_boot = true
[[drive]]
name = "low"
kind = "md3-low"
fast_boot = true
set = { SerialPortConfiguration = 0x25 }
listen = ["rfc2217:127.0.0.1:0"]
[[drive]]
name = "tty"
kind = "rs434544"
fast_boot = true
listen = ["pty:"]
[[drive]]
name = "brush"
kind = "rs434546"
fast_boot = true
[[drive]]
name = "robot"
kind = "mdrobot"
fast_boot = true
set = { CONTROLLER_BAUD = 5, UI_COM = 1 }
[[drive]]
name = "single"
kind = "qsb-s"
fast_boot = true
[[drive]]
name = "mover"
kind = "qsb-m"
fast_boot = true
[[drive]]
name = "plus{1..2}"
kind = "mdrive"
fast_boot = true
[[drive]]
name = "hybrid{1..2}"
kind = "mdrive-hybrid"
fast_boot = true

[[drive]]
name = "s1"
kind = "md3"
address = 1
fast_boot = true
set = { SerialPortConfiguration = 0x25 }
[[drive]]
name = "s2"
kind = "md3-low"
address = 2
fast_boot = true
set = { SerialPortConfiguration = 0x25 }
[[drive]]
name = "s3"
kind = "rs434544"
address = 3
fast_boot = true
[[drive]]
name = "s4"
kind = "rs434546"
address = 4
fast_boot = true
[[bus]]
name = "shared"
drives = ["s1", "s2", "s3", "s4"]

[[drive]]
name = "f1"
kind = "md3"
address = 1
set = { SerialPortConfiguration = 0x25 }
[[drive]]
name = "f2"
kind = "rs434546"
address = 2
[[bus]]
name = "bad"
drives = ["f1", "f2"]
[[drive]]
name = "f3"
kind = "mdrobot"
set = { CONTROLLER_BAUD = 5 }
[[drive]]
name = "f4"
kind = "qsb-d"
[[drive]]
name = "f5"
kind = "mdrive"
[[drive]]
name = "f6"
kind = "mdrive-hybrid"
"#;

/// Faults of a port: its name, and the rate of each fault.
type Faults = (&'static str, &'static [(&'static str, f64)]);

/// Faults of the lines and TCP ports. Every kind of fault is on, except those that change nothing or all.
const FAULTS: [Faults; 6] = [
    ("bad", SERIAL),
    ("f3.rs485", SERIAL),
    ("f4.usb", &[("drop", 0.001), ("corrupt", 0.001), ("truncate", 0.001)]),
    ("f5.modbus", TCP),
    ("f6.modbus", TCP),
    ("f5.mcode", &[("drop", 0.0005), ("close", 0.0005)]),
];

const SERIAL: &[(&str, f64)] = &[
    ("drop", 0.001),
    ("corrupt", 0.001),
    ("truncate", 0.001),
    ("duplicate", 0.0005),
    ("noise", 0.0005),
    ("wrong_address", 0.0005),
    ("exception", 0.0005),
];

const TCP: &[(&str, f64)] = &[
    ("drop", 0.0002),
    ("corrupt", 0.0002),
    ("truncate", 0.0001),
    ("duplicate", 0.0001),
    ("wrong_transaction", 0.0002),
    ("exception", 0.0002),
    ("close", 0.0002),
];

/// Faults that only a request, or only a reply can have. All others strike both.
const ONE_WAY: [&str; 3] = ["wrong_address", "wrong_transaction", "exception"];

/// The whole bench file.
pub(crate) fn text() -> String {
    let mut text = BENCH.to_owned();
    for (bus, rates) in FAULTS {
        text += &format!("[[fault]]\nbus = \"{bus}\"\ndelay_ms = {{ rate = 0.01, ms = 2, spread_ms = 5 }}\n");
        for (fault, rate) in rates {
            text += &format!("{fault} = {rate}\n");
        }
    }
    text
}

/// Share of the exchanges at a port that a fault strikes.
pub(crate) fn fault_share(port: &str) -> f64 {
    let rates = FAULTS.iter().filter(|(name, _)| *name == port).flat_map(|(_, rates)| *rates);
    rates.fold(0.0, |sum, (fault, rate)| sum + if ONE_WAY.contains(fault) { *rate } else { 2.0 * rate })
}

/// Returns true for a port whose masters fill up the rate.
pub(crate) fn fills_up(port: &str) -> bool {
    PLANS.iter().any(|plan| plan.port == port && plan.is_modbus_tcp())
}

/// A port, and the masters at it.
pub(crate) struct Plan {
    /// Name of the port, as of a fault.
    pub(crate) port: &'static str,
    /// Name of a drive at the port, and the index of the port's address.
    pub(crate) place: (&'static str, usize),
    /// Number of connections, each with a request under way.
    pub(crate) connections: usize,
    /// The requests in turn, each with the name of the drive. A further connection only reads.
    pub(crate) talks: &'static [(&'static str, Dialect)],
}

impl Plan {
    /// Returns true for a port of Modbus/TCP, which is as fast as its masters: these fill up the rate.
    pub(crate) fn is_modbus_tcp(&self) -> bool {
        matches!(self.talks[0].1, Dialect::Tcp { .. } | Dialect::TcpConstant)
    }
}

const fn plan(
    port: &'static str,
    place: (&'static str, usize),
    connections: usize,
    talks: &'static [(&'static str, Dialect)],
) -> Plan {
    Plan { port, place, connections, talks }
}

/// All masters.
pub(crate) const PLANS: &[Plan] = &[
    plan("step.rs485", ("step", 0), 1, &[("step", md3(1))]),
    plan("count.usb", ("count", 0), 1, &[("count", Dialect::Qsb)]),
    plan("low.rs485", ("low", 0), 1, &[("low", md3(1))]),
    plan("tty.rs485", ("tty", 0), 1, &[("tty", rs(1))]),
    plan("brush.rs485", ("brush", 0), 1, &[("brush", rs(1))]),
    plan("robot.rs485", ("robot", 0), 1, &[("robot", MDROBOT)]),
    plan("single.usb", ("single", 0), 1, &[("single", Dialect::Qsb)]),
    plan("mover.usb", ("mover", 0), 1, &[("mover", Dialect::Qsb)]),
    plan("shared", ("s1", 0), 1, &[("s1", md3(1)), ("s2", md3(2)), ("s3", rs(3)), ("s4", rs(4))]),
    plan("plus1.mcode", ("plus1", 1), 1, &[("plus1", Dialect::Mcode)]),
    plan("hybrid1.mcode", ("hybrid1", 1), 1, &[("hybrid1", Dialect::Mcode)]),
    plan("plus1.modbus", ("plus1", 0), 12, &[("plus1", Dialect::TcpConstant)]),
    plan("plus2.modbus", ("plus2", 0), 12, &[("plus2", R1)]),
    plan("hybrid1.modbus", ("hybrid1", 0), 12, &[("hybrid1", Dialect::TcpConstant)]),
    plan("hybrid2.modbus", ("hybrid2", 0), 12, &[("hybrid2", R1)]),
    plan("bad", ("f1", 0), 1, &[("f1", md3(1)), ("f2", rs(2))]),
    plan("f3.rs485", ("f3", 0), 1, &[("f3", MDROBOT)]),
    plan("f4.usb", ("f4", 0), 1, &[("f4", Dialect::Qsb)]),
    plan("f5.modbus", ("f5", 0), 2, &[("f5", Dialect::Tcp { register: 0x61 })]),
    plan("f6.modbus", ("f6", 0), 2, &[("f6", R1)]),
    plan("f5.mcode", ("f5", 1), 1, &[("f5", Dialect::Mcode)]),
];

/// Drives whose power fails now and then, with the seconds from power-on until they surely answer: MD3 7.4, RS434-9,
/// MDROBOT-11, QSB-6, MC 5-9.
pub(crate) const POWER_FAILS: [(&str, u64); 6] =
    [("f1", 3), ("f2", 1), ("f3", 1), ("f4", 1), ("f5", 4), ("f6", 4)];

#[cfg(test)]
mod tests {
    use drivetwin_sim::catalog;
    use drivetwin_sim::config::bench_file;

    use super::*;

    #[test]
    fn the_bench_has_every_kind_and_a_master_for_every_drive() {
        let layout = bench_file::parse(&text()).unwrap();
        for spec in catalog::specs() {
            assert!(layout.drives.iter().any(|drive| drive.kind == spec.kind), "no {}", spec.kind);
        }
        for drive in &layout.drives {
            let is_asked = PLANS.iter().any(|plan| plan.talks.iter().any(|(name, _)| *name == drive.name));
            assert!(is_asked, "nobody talks to {}", drive.name);
        }
    }

    #[test]
    fn a_fault_of_both_directions_strikes_twice_as_often() {
        // 4 faults of both directions: 2 · (1 + 1 + 1 + 0.5 + 0.5) ‰, and two of replies or requests: 0.5 + 0.5 ‰.
        assert!((fault_share("bad") - 0.009).abs() < 1e-9);
        assert!(fault_share("shared").abs() < 1e-9);
    }
}
