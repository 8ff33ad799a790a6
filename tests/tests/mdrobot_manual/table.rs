//! The table of PIDs (p. 6 to 17), typed by hand. It includes the PIDs of the header file whose meaning is
//! known from real controllers (2.4, MDROBOT-8). The other PIDs of the header follow it.

/// Type, as the manual calls it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Type {
    /// R, R2 and longer: read only.
    R,
    /// W, W2, W3: write only.
    W,
    /// R/W, R2/W2.
    RW,
}

/// Legal values of a word.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Word {
    /// No range is printed, so every word is legal (MDROBOT-3).
    Any,
    /// Least and greatest value. The word is signed if the first is negative.
    Range(i32, i32),
    /// Values of INPUT_TYPE, which do not include 4 (p. 10).
    InputType,
}

/// A PID.
pub(crate) struct Row {
    pub(crate) pid: u16,
    pub(crate) name: &'static str,
    pub(crate) kind: Type,
    /// Legal values of each word. For a read-only PID only the number of words matters.
    pub(crate) words: &'static [Word],
    /// Factory values, or the readings of a new controller at rest.
    pub(crate) reset: &'static [u16],
    /// True if the value survives a power failure (MDROBOT-6).
    pub(crate) saved: bool,
}

const fn r(pid: u16, name: &'static str, words: &'static [Word], reset: &'static [u16]) -> Row {
    Row { pid, name, kind: Type::R, words, reset, saved: false }
}

const fn w(pid: u16, name: &'static str, words: &'static [Word]) -> Row {
    Row { pid, name, kind: Type::W, words, reset: &[], saved: false }
}

const fn rw(pid: u16, name: &'static str, words: &'static [Word], reset: &'static [u16]) -> Row {
    Row { pid, name, kind: Type::RW, words, reset, saved: true }
}

/// A PID that can be read and written, and that is lost at power-off (MDROBOT-6).
const fn fleeting(pid: u16, name: &'static str, words: &'static [Word]) -> Row {
    Row { pid, name, kind: Type::RW, words, reset: &[0], saved: false }
}

use Word::{Any, InputType, Range};

const BIT: &[Word] = &[Range(0, 1)];
const BYTE: &[Word] = &[Range(0, 255)];
const WORD: &[Word] = &[Any];
const LONG: &[Word] = &[Any, Any];
/// Values of a ramp: 0 to 1,023 are 0 to 15 s (p. 13).
const SLOW: &[Word] = &[Range(0, 1_023)];
/// p. 12
const OUTPUT: &[Word] = &[Range(-1_023, 1_023)];

#[rustfmt::skip]
pub(crate) static TABLE: &[Row] = &[
    // Version 8.1 (MDROBOT-1).
    r(1, "VERSION", BYTE, &[81]),
    w(3, "DEFAULT_SET", WORD),
    w(5, "TQ_OFF", WORD),
    w(6, "BRAKE", WORD),
    // "DL = Command": a value that exceeds a byte is not a command (MDROBOT-10).
    w(10, "COMMAND", BYTE),
    w(12, "ALARM_RESET", WORD),
    w(13, "POSI_RESET", WORD),
    rw(16, "INV_SIGN_CMD", BIT, &[0]),
    rw(17, "USE_LIMIT_SW", BIT, &[1]),
    rw(19, "INV_ALARM", BIT, &[0]),
    rw(21, "HALL_TYPE", BYTE, &[0]),
    rw(24, "STOP_STATUS", &[Range(0, 3)], &[0]),
    rw(25, "INPUT_TYPE", &[InputType], &[0]),
    r(34, "CTRL_STATUS", BYTE, &[0]),
    rw(36, "START_INV_SIGN", BIT, &[0]),
    rw(37, "RUN_INV_SIGN", BIT, &[0]),
    rw(40, "LIMIT_STOP_COND", BIT, &[0]),
    rw(44, "TQ_CTRL", BIT, &[0]),
    rw(45, "BLUETOOTH", BIT, &[0]),
    // Nothing is wired. ENC_A and ENC_B are open, which reads as 1 (MDROBOT-22).
    r(48, "DI", BYTE, &[0b110_0000]),
    r(49, "IN_POSITION_OK", BYTE, &[0]),
    // PIDs 66, 176, 178, 179, 210, 216, 220 and 230 are not in V1.1 (MDROBOT-10).
    fleeting(66, "TQ_RATIO", BYTE),
    fleeting(78, "UI_COM", BIT),
    fleeting(100, "START_STOP", &[Range(0, 2)]),
    fleeting(130, "VEL_CMD", WORD),
    w(133, "ID", WORD),
    w(134, "OPEN_VEL_CMD", OUTPUT),
    w(135, "BAUDRATE", WORD),
    r(138, "RPM_DATA", WORD, &[0]),
    r(139, "TQ_DATA", WORD, &[0]),
    w(140, "TQ_CMD", OUTPUT),
    // 24.0 V
    r(143, "VOLT_IN", WORD, &[240]),
    rw(153, "SLOW_START", SLOW, &[0]),
    rw(154, "SLOW_DOWN", SLOW, &[0]),
    rw(155, "TAR_VEL", &[Range(0, 5_000)], &[0]),
    rw(156, "ENC_PPR", WORD, &[0]),
    rw(157, "LOW_SPEED_LIMIT", &[Range(0, 512)], &[0]),
    rw(158, "HIGH_SPEED_LIMIT", &[Range(512, 1_023)], &[0]),
    rw(167, "PV_GAIN", WORD, &[20]),
    rw(168, "P_GAIN", WORD, &[6_000]),
    rw(169, "I_GAIN", WORD, &[6_000]),
    rw(171, "IN_POSITION", WORD, &[0]),
    rw(176, "TAR_POSI_VEL", WORD, &[5_000]),
    rw(178, "POSI_SS", SLOW, &[0]),
    rw(179, "POSI_SD", SLOW, &[0]),
    fleeting(180, "COM_TAR_SPEED", WORD),
    // 20 A
    rw(181, "MAX_LOAD", WORD, &[200]),
    rw(183, "FUNC_CMD_TYPE", &[Range(0, 4)], &[0]),
    w(184, "FUNC_CMD", WORD),
    // Speed, current, output, position and CTRL_STATUS of a motor at rest.
    r(196, "MONITOR", &[Any; 6], &[0; 6]),
    r(197, "POSI_DATA", LONG, &[0, 0]),
    r(210, "PNT_MAIN_DATA", &[Any; 9], &[0; 9]),
    rw(211, "MAX_LOAD", WORD, &[200]),
    r(216, "PNT_MONITOR", &[Any; 7], &[0; 7]),
    w(219, "POSI_VEL_CMD", &[Any; 3]),
    w(220, "INC_POSI_VEL_CMD", &[Any; 3]),
    rw(221, "MAX_RPM", WORD, &[3_000]),
    rw(222, "SPEED_LIMIT", &[Range(0, 512), Range(512, 1_023)], &[0, 0]),
    r(230, "TAR_POSI", LONG, &[0, 0]),
    rw(239, "FUNC_SPEED", LONG, &[1_000, 10]),
    w(243, "POSI_CMD", LONG),
    w(244, "INC_POSI_CMD", LONG),
    rw(250, "FUNC_POSI", LONG, &[1_500, 240]),
];

/// 32 PIDs that only section 2.4 names.
pub(crate) const HEADER_ONLY: [u16; 32] = [
    4, 7, 14, 15, 18, 30, 31, 131, 137, 146, 147, 149, 150, 152, 159, 162, 163, 164, 193, 194, 198, 202, 203,
    205, 217, 225, 226, 227, 231, 234, 238, 241,
];

impl Row {
    pub(crate) fn is_read(&self) -> bool {
        self.kind != Type::W
    }

    pub(crate) fn is_written(&self) -> bool {
        self.kind != Type::R
    }

    pub(crate) fn count(&self) -> u16 {
        self.words.len() as u16
    }

    /// Legal values, in which each word takes each of its limits.
    pub(crate) fn legal(&self) -> Vec<Vec<u16>> {
        self.samples(Word::legal)
    }

    /// Values with exactly one illegal word.
    pub(crate) fn illegal(&self) -> Vec<Vec<u16>> {
        let mut all = Vec::new();
        for (place, word) in self.words.iter().enumerate() {
            for bad in word.illegal() {
                let mut words: Vec<u16> = self.words.iter().map(|word| word.legal()[0]).collect();
                words[place] = bad;
                all.push(words);
            }
        }
        all
    }

    fn samples(&self, of: impl Fn(&Word) -> Vec<u16>) -> Vec<Vec<u16>> {
        let each: Vec<Vec<u16>> = self.words.iter().map(of).collect();
        let most = each.iter().map(Vec::len).max().unwrap_or(0);
        (0..most).map(|n| each.iter().map(|words| words[n % words.len()]).collect()).collect()
    }
}

impl Word {
    fn legal(&self) -> Vec<u16> {
        match *self {
            Any => vec![0, 1, 0x1234, 0x7FFF, 0x8000, 0xFFFF],
            Range(least, most) => vec![least as u16, (least + 1) as u16, (most - 1) as u16, most as u16],
            InputType => vec![0, 1, 2, 3, 5],
        }
    }

    /// Illegal words: next to the limits, far outside, and a legal DL with a DH other than 0, because the
    /// drive checks the whole word (MDROBOT-3).
    fn illegal(&self) -> Vec<u16> {
        match *self {
            Any => vec![],
            Range(least, most) if least < 0 => vec![(least - 1) as u16, (most + 1) as u16, 0x8000, 0x7FFF],
            Range(0, most) => vec![most as u16 + 1, 0x0100 + most as u16 + 1, 0x7FFF, 0x8000, 0xFFFF],
            Range(least, most) => vec![0, least as u16 - 1, most as u16 + 1, 0x8000, 0xFFFF],
            InputType => vec![4, 6, 0x0100, 0x0105, 0xFFFF],
        }
    }
}
