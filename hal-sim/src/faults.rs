//! What disturbs a line: frames lost, changed, doubled, cut, delayed, and noise between them.

use standin_firmware::device::{Duration, Ends, PortSpec};

/// The longest that a reply may be late.
pub const LONGEST_DELAY: Duration = Duration::secs(60);

/// The slowest and the fastest rate at which clients may talk.
pub const BAUDS: std::ops::RangeInclusive<u32> = 50..=4_000_000;

/// What disturbs a line. Shares are of its frames, requests and replies alike where nothing else is said, from
/// 0 to 1; the default disturbs nothing. Where each character has its time, a frame is what a client has written
/// at once, or what a drive has sent at once.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct LineFaults {
    /// Frames that are lost.
    pub drop: f64,
    /// Frames in which a data bit is turned over. Drives on a line with parity notice it in that character.
    pub corrupt: f64,
    /// Frames that come twice: a reply again when the line has been silent behind it, a request again when its
    /// answer is over.
    pub duplicate: f64,
    /// Frames whose end is missing: at least a character, and all but one at most.
    pub truncate: f64,
    /// Replies that bear the address of no drive of the line, with a good check sum; only of Modbus.
    pub wrong_address: f64,
    /// Requests that are not carried out but refused, with `exception_code`; only of Modbus.
    pub exception: f64,
    /// The code of such a refusal, 1 to 255.
    pub exception_code: u8,
    /// Frames after which, when the line has been silent, it carries one to eight characters of noise.
    pub noise: f64,
    /// Every reply is late by that, up to a minute.
    pub delay: Duration,
    /// No reply reaches anybody.
    pub mute: bool,
    /// Clients talk and listen at that rate, 50 to 4,000,000 bits per second, whatever the drives do.
    pub baud: Option<u32>,
}

impl Default for LineFaults {
    fn default() -> Self {
        Self {
            drop: 0.0,
            corrupt: 0.0,
            duplicate: 0.0,
            truncate: 0.0,
            wrong_address: 0.0,
            exception: 0.0,
            exception_code: 4,
            noise: 0.0,
            delay: Duration::ZERO,
            mute: false,
            baud: None,
        }
    }
}

impl LineFaults {
    /// Whether every value is in its range.
    ///
    /// # Errors
    /// One sentence: which is not, and what it takes.
    pub fn check(&self) -> Result<(), String> {
        let shares = [
            ("drop", self.drop),
            ("corrupt", self.corrupt),
            ("duplicate", self.duplicate),
            ("truncate", self.truncate),
            ("wrong_address", self.wrong_address),
            ("exception", self.exception),
            ("noise", self.noise),
        ];
        if let Some((name, share)) = shares.iter().find(|(_, share)| !(0.0..=1.0).contains(share)) {
            return Err(format!("{name} takes a share of the frames from 0 to 1, not {share}"));
        }
        if self.exception_code == 0 {
            return Err("exception_code takes 1 to 255, not 0".into());
        }
        if self.delay > LONGEST_DELAY {
            return Err("a reply can be late by 60 s at most".into());
        }
        match self.baud.filter(|baud| !BAUDS.contains(baud)) {
            Some(baud) => {
                Err(format!("baud takes {} to {} bits per second, not {baud}", BAUDS.start(), BAUDS.end()))
            }
            None => Ok(()),
        }
    }

    /// Whether a line with that port can be disturbed so: [`check`](Self::check), and only Modbus knows addresses
    /// and exceptions.
    ///
    /// # Errors
    /// One sentence: what cannot be.
    pub fn check_for(&self, port: &PortSpec) -> Result<(), String> {
        self.check()?;
        let needs_modbus = [("wrong_address", self.wrong_address), ("exception", self.exception)];
        match needs_modbus.iter().find(|(_, share)| *share > 0.0) {
            Some((name, _)) if port.ends != Ends::Silence => {
                Err(format!("{name} is for lines of Modbus, and {} is none", port.name))
            }
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_out_of_range_is_named() {
        let wrong = |faults: LineFaults| faults.check().unwrap_err();
        let quiet = LineFaults::default();
        assert_eq!(quiet.check(), Ok(()));
        assert_eq!(LineFaults { drop: 1.0, mute: true, baud: Some(50), ..quiet }.check(), Ok(()));
        for (faults, message) in [
            (LineFaults { drop: 1.5, ..quiet }, "drop takes a share of the frames from 0 to 1, not 1.5"),
            (LineFaults { noise: -0.1, ..quiet }, "noise takes a share of the frames from 0 to 1, not -0.1"),
            (
                LineFaults { corrupt: f64::NAN, ..quiet },
                "corrupt takes a share of the frames from 0 to 1, not NaN",
            ),
            (LineFaults { exception_code: 0, ..quiet }, "exception_code takes 1 to 255, not 0"),
            (
                LineFaults { delay: LONGEST_DELAY + Duration::TICK, ..quiet },
                "a reply can be late by 60 s at most",
            ),
            (LineFaults { baud: Some(49), ..quiet }, "baud takes 50 to 4000000 bits per second, not 49"),
        ] {
            assert_eq!(wrong(faults), message);
        }
    }

    #[test]
    fn only_modbus_knows_addresses_and_exceptions() {
        let port = |name, ends| PortSpec { name, ends, line: None };
        let (rs485, usb) = (port("rs485", Ends::Silence), port("usb", Ends::Character));
        let faults = LineFaults { exception: 0.1, ..LineFaults::default() };
        assert_eq!(faults.check_for(&rs485), Ok(()));
        assert_eq!(faults.check_for(&usb).unwrap_err(), "exception is for lines of Modbus, and usb is none");
        let both = LineFaults { drop: 2.0, ..faults };
        assert!(both.check_for(&usb).unwrap_err().starts_with("drop "));
        assert_eq!(LineFaults { drop: 0.5, ..LineFaults::default() }.check_for(&usb), Ok(()));
    }
}
