//! The kinds of drive, with the names of their registers and pins for completion in an editor.

pub use drivetwin_sim::catalog::Kind;

/// Adds kinds of drive of other crates to this process, once, before a bench is made. `examples/own-drive` has one.
///
/// ```
/// use drivetwin::Bench;
/// use drivetwin::firmware::md3::Md3;
///
/// // A kind of your own in place of Md3, whose name is in use.
/// let refused = drivetwin::add_kinds(&[|| Box::new(Md3::new())]);
/// assert_eq!(refused.unwrap_err().to_string(), "there are two kinds with the name md3");
/// ```
///
/// # Errors
/// Kinds were added before, or the name of a kind is not one word or is in use.
pub fn add_kinds(kinds: &'static [Kind]) -> Result<(), crate::Error> {
    drivetwin_sim::catalog::add(kinds).map_err(crate::Error)
}

/// All kinds, for [`Bench::add`](crate::Bench::add).
pub const ALL: [&str; 10] = [
    "md3",
    "md3-low",
    "qsb-d",
    "qsb-m",
    "qsb-s",
    "rs434544",
    "rs434546",
    "mdrobot",
    "mdrive",
    "mdrive-hybrid",
];

/// MD3 stepper drive: kinds `md3` and `md3-low`.
pub mod md3 {
    pub use drivetwin_firmware::md3::Reg;

    /// Names of the pins.
    pub mod pin {
        /// Pin `J2.2`.
        pub const J2_2: &str = "J2.2";
        /// Pin `J2.3`.
        pub const J2_3: &str = "J2.3";
        /// Pin `J2.4`.
        pub const J2_4: &str = "J2.4";
        /// Pin `J2.5`.
        pub const J2_5: &str = "J2.5";
        /// Pin `J2.9`.
        pub const J2_9: &str = "J2.9";
        /// Pin `J2.10`.
        pub const J2_10: &str = "J2.10";
        /// Pin `J2.12`.
        pub const J2_12: &str = "J2.12";
        /// Pin `J3.7`.
        pub const J3_7: &str = "J3.7";
        /// Pin `J3.8`.
        pub const J3_8: &str = "J3.8";
        /// Pin `STEP`.
        pub const STEP: &str = "STEP";
        /// Pin `DIR`.
        pub const DIR: &str = "DIR";
        /// Pin `D5`.
        pub const D5: &str = "D5";
        /// Pin `D6`.
        pub const D6: &str = "D6";
    }
}

/// QSB encoder adapter: kinds `qsb-d`, `qsb-m` and `qsb-s`. A QSB-D has DIO0 only, a QSB-S none.
pub mod qsb {
    pub use drivetwin_firmware::qsb::Reg;

    /// Names of the pins.
    pub mod pin {
        /// Pin `A`.
        pub const A: &str = "A";
        /// Pin `B`.
        pub const B: &str = "B";
        /// Pin `I`.
        pub const I: &str = "I";
        /// Pin `PWM`.
        pub const PWM: &str = "PWM";
        /// Pin `ANALOG`.
        pub const ANALOG: &str = "ANALOG";
        /// Pin `DIO0`.
        pub const DIO0: &str = "DIO0";
        /// Pin `DIO1`.
        pub const DIO1: &str = "DIO1";
        /// Pin `DIO2`.
        pub const DIO2: &str = "DIO2";
        /// Pin `DIO3`.
        pub const DIO3: &str = "DIO3";
    }
}

/// RS 434 brush motor controller: kinds `rs434544` and `rs434546`.
pub mod rs434 {
    pub use drivetwin_firmware::rs434::Reg;

    /// Names of the pins.
    pub mod pin {
        /// Pin `IN1`.
        pub const IN1: &str = "IN1";
        /// Pin `IN2`.
        pub const IN2: &str = "IN2";
        /// Pin `HARD_STOP`.
        pub const HARD_STOP: &str = "HARD_STOP";
        /// Pin `HA`.
        pub const HA: &str = "HA";
        /// Pin `HB`.
        pub const HB: &str = "HB";
        /// Pin `CLR_FLASH`.
        pub const CLR_FLASH: &str = "CLR_FLASH";
        /// Pin `RED`.
        pub const RED: &str = "RED";
        /// Pin `GREEN`.
        pub const GREEN: &str = "GREEN";
    }
}

/// MDROBOT brushless motor controller: kind `mdrobot`.
pub mod mdrobot {
    pub use drivetwin_firmware::mdrobot::Pid;

    /// Names of the pins.
    pub mod pin {
        /// Pin `INT_SPEED`.
        pub const INT_SPEED: &str = "INT_SPEED";
        /// Pin `ALARM_RESET`.
        pub const ALARM_RESET: &str = "ALARM_RESET";
        /// Pin `DIR`.
        pub const DIR: &str = "DIR";
        /// Pin `RUN_BRAKE`.
        pub const RUN_BRAKE: &str = "RUN_BRAKE";
        /// Pin `START_STOP`.
        pub const START_STOP: &str = "START_STOP";
        /// Pin `ENC_A`.
        pub const ENC_A: &str = "ENC_A";
        /// Pin `ENC_B`.
        pub const ENC_B: &str = "ENC_B";
        /// Pin `SPEED_IN`.
        pub const SPEED_IN: &str = "SPEED_IN";
        /// Pin `PULSE_IN`.
        pub const PULSE_IN: &str = "PULSE_IN";
        /// Pin `ALARM`.
        pub const ALARM: &str = "ALARM";
        /// Pin `CLUTCH`.
        pub const CLUTCH: &str = "CLUTCH";
        /// Pin `FAN`.
        pub const FAN: &str = "FAN";
        /// Pin `HU`.
        pub const HU: &str = "HU";
        /// Pin `HV`.
        pub const HV: &str = "HV";
        /// Pin `HW`.
        pub const HW: &str = "HW";
    }
}

/// MDrive motor with drive: kinds `mdrive` and `mdrive-hybrid`.
pub mod mdrive {
    pub use drivetwin_firmware::mdrive::Reg;

    /// Names of the pins.
    pub mod pin {
        /// Pin `IO1`.
        pub const IO1: &str = "IO1";
        /// Pin `IO2`.
        pub const IO2: &str = "IO2";
        /// Pin `IO3`.
        pub const IO3: &str = "IO3";
        /// Pin `IO4`.
        pub const IO4: &str = "IO4";
        /// Pin `IO7`.
        pub const IO7: &str = "IO7";
        /// Pin `IO8`.
        pub const IO8: &str = "IO8";
        /// Pin `ANALOG`.
        pub const ANALOG: &str = "ANALOG";
        /// Pin `CAPTURE`.
        pub const CAPTURE: &str = "CAPTURE";
        /// Pin `A`.
        pub const A: &str = "A";
        /// Pin `B`.
        pub const B: &str = "B";
        /// Pin `I`.
        pub const I: &str = "I";
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use drivetwin_sim::catalog;

    #[test]
    fn all_kinds_are_listed() {
        assert_eq!(super::ALL.to_vec(), catalog::specs().map(|spec| spec.kind).collect::<Vec<_>>());
    }

    #[test]
    fn all_pins_of_the_drives_are_listed() {
        let source = include_str!("kinds.rs");
        let listed = |module: &str| {
            let from = source.find(&format!("pub mod {module} {{")).unwrap();
            let end = from + source[from..].find("\n}\n").unwrap();
            let constants = source[from..end].lines().filter(|line| line.contains("pub const "));
            constants.filter_map(|line| line.split('"').nth(1)).collect::<BTreeSet<_>>()
        };
        for (module, kinds) in [
            ("md3", &["md3", "md3-low"][..]),
            ("qsb", &["qsb-d", "qsb-m", "qsb-s"]),
            ("rs434", &["rs434544", "rs434546"]),
            ("mdrobot", &["mdrobot"]),
            ("mdrive", &["mdrive", "mdrive-hybrid"]),
        ] {
            let specs = catalog::specs().filter(|spec| kinds.contains(&spec.kind));
            let names: BTreeSet<_> = specs.flat_map(|spec| spec.pin_names()).map(|(name, _)| name).collect();
            assert_eq!(listed(module), names, "{module}");
        }
    }
}
