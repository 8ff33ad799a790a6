//! Power failures at any byte of any store of a save, in every kind of drive. An MDROBOT starts with the old
//! or the new values. Others may have the factory's values, too. They then report that their memory is bad,
//! if they can.
#![allow(missing_docs, reason = "a test")]

use drivetwin_firmware::device::{Boot, Device, Instant, Output, advance};
use drivetwin_firmware::testing::{Recorder, Treatment};
use drivetwin_protocol::time::Span;
use drivetwin_sim::catalog;

/// A kind of drive, and how it saves.
struct Kind {
    kind: &'static str,
    /// Two registers far apart in the drive's memory, each with values to save. A low byte of 0x00FF is equal to
    /// a byte of an erased memory.
    values: [(&'static str, [i64; 5]); 2],
    /// Register and value that start a save. `None` if the drive saves each value when it is written.
    save: Option<(&'static str, i64)>,
    bad: Bad,
}

/// Values that a drive may have after an interrupted save, besides the old and the new ones.
enum Bad {
    /// Only the old or the new values.
    Never,
    /// The factory's values without a report, because a QSB has none (QSB-8).
    Silent,
    /// The factory's values, reported by a register: the bits in `mask` then have the value `is`.
    Said { register: &'static str, mask: i64, is: i64 },
}

const KINDS: [Kind; 10] = [
    md3("md3"),
    md3("md3-low"),
    qsb("qsb-d"),
    qsb("qsb-m"),
    qsb("qsb-s"),
    rs434("rs434544"),
    rs434("rs434546"),
    Kind {
        kind: "mdrobot",
        values: [("USE_LIMIT_SW", [0, 1, 0, 1, 0]), ("MAX_RPM", [1, 0x1234, 400, 0x00FF, 2])],
        save: None,
        bad: Bad::Never,
    },
    mdrive("mdrive"),
    mdrive("mdrive-hybrid"),
];

const fn md3(kind: &'static str) -> Kind {
    Kind {
        kind,
        values: [("Speed", [1, -2, 31_234, 0x00FF, 5_000]), ("UserRegister", [1, 2, 0xFFFF, 0x00FF, 78])],
        save: Some(("EEPROMControl", 1)),
        bad: Bad::Said { register: "EEPROMControl", mask: 0xFF00, is: 0xF100 },
    }
}

const fn qsb(kind: &'static str) -> Kind {
    Kind {
        kind,
        values: [("Mode", [1, 2, 4, 18, 1]), ("Threshold", [1, 2, 0xFFFF, 0x00FF, 3])],
        save: Some(("Command", 3)),
        bad: Bad::Silent,
    }
}

const fn rs434(kind: &'static str) -> Kind {
    Kind {
        kind,
        values: [
            ("SPEED", [30, 31, 0x0F0F, 0x00FF, 14_999]),
            ("TARGET_POSITION3", [1, -1, 0x0102_0304, 0x00FF_00FF, 7]),
        ],
        save: Some(("FLAG_SAVE_INI", 0x37FA)),
        bad: Bad::Said { register: "ERROR", mask: 1 << 9, is: 1 << 9 },
    }
}

const fn mdrive(kind: &'static str) -> Kind {
    Kind {
        kind,
        values: [("A", [91, 92, 0x0102_0304, 0x00FF_00FF, 1_000]), ("R4", [1, -1, 0x0102_0304, 0x00FF, 7])],
        save: Some(("S", 1)),
        bad: Bad::Said { register: "ER", mask: 0xFFFF, is: 70 },
    }
}

/// A recorder with this memory. Power fails after `left` stored bytes.
fn memory_of(bytes: &[u8], left: usize) -> Recorder {
    let mut out = Recorder::with_memory(bytes.to_vec()).ruled(|output| match output {
        Output::Store { .. } => Treatment::Keep,
        _ => Treatment::Ignore,
    });
    out.bytes_left = left;
    out
}

/// Number of bytes in all stores.
fn stored_bytes(out: &Recorder) -> usize {
    out.stores.iter().map(|(_, _, bytes)| bytes.len()).sum()
}

/// A drive with its memory.
struct Drive {
    device: Box<dyn Device>,
    out: Recorder,
    now: Instant,
}

impl Drive {
    fn wake(kind: &Kind, out: Recorder) -> Self {
        let device = catalog::make(kind.kind).unwrap();
        let mut drive = Self { device, out, now: Instant::ZERO };
        drive.device.power_on(drive.now, Boot { fast: true, ..Boot::default() }, &mut drive.out);
        // A bad memory may make the start-up longer.
        drive.run(20_000);
        drive
    }

    fn run(&mut self, ms: u64) {
        self.now += ms.millis();
        advance(&mut *self.device, self.now, core::iter::empty(), &mut self.out);
    }

    fn row(&self, name: &str) -> usize {
        self.device.spec().find(name).unwrap_or_else(|| panic!("{name}")).row
    }

    fn get(&self, name: &str) -> i64 {
        self.device.peek(self.now, self.row(name))
    }

    fn set(&mut self, name: &str, value: i64) {
        let row = self.row(name);
        let set = self.device.poke(self.now, row, value, &mut self.out);
        assert_eq!(set, Ok(()), "{name} = {value}");
    }

    /// Writes some values and saves them.
    fn save(&mut self, kind: &Kind, values: &[(&str, i64)]) {
        for &(name, value) in values {
            self.set(name, value);
        }
        if let Some((name, value)) = kind.save {
            self.set(name, value);
        }
        self.run(100);
    }

    fn values(&self, kind: &Kind) -> [i64; 2] {
        kind.values.map(|(name, _)| self.get(name))
    }

    /// Returns true if the drive may have the factory's values after a power failure, by its own report.
    fn may_be_new(&self, kind: &Kind) -> bool {
        match kind.bad {
            Bad::Never => false,
            Bad::Silent => true,
            Bad::Said { register, mask, is } => self.get(register) & mask == is,
        }
    }
}

/// The writes before each save: both registers, or one at a time if the drive saves each write by itself.
fn written(kind: &Kind) -> Vec<Vec<(&'static str, i64)>> {
    let both = |n: usize| kind.values.map(|(name, values)| (name, values[n])).to_vec();
    let each = |n: usize| both(n).into_iter().map(|one| vec![one]).collect();
    (0..5).flat_map(|n| if kind.save.is_some() { vec![both(n)] } else { each(n) }).collect()
}

#[test]
fn power_lost_at_any_byte_of_a_save_mixes_nothing() {
    assert!(
        KINDS.iter().map(|kind| kind.kind).eq(catalog::specs().map(|spec| spec.kind)),
        "a kind is missing"
    );
    for kind in &KINDS {
        let size = usize::from(catalog::make(kind.kind).unwrap().spec().memory);
        let mut memory = vec![0xFF; size];
        let factory = Drive::wake(kind, memory_of(&memory, 0)).values(kind);
        let mut old = factory;
        for values in written(kind) {
            let mut whole = Drive::wake(kind, memory_of(&memory, usize::MAX));
            assert_eq!(whole.values(kind), old, "{}", kind.kind);
            whole.save(kind, &values);
            let (new, stored) = (whole.values(kind), stored_bytes(&whole.out));
            assert!(new != old && stored > 0, "{}: {values:?}", kind.kind);
            for left in 0..stored {
                let mut cut = Drive::wake(kind, memory_of(&memory, left));
                cut.save(kind, &values);
                let again = Drive::wake(kind, memory_of(&cut.out.memory, usize::MAX));
                let found = again.values(kind);
                assert!(
                    found == old || found == new || (found == factory && again.may_be_new(kind)),
                    "{}: {found:?} after {left} of {stored} bytes, from {old:?} to {new:?}",
                    kind.kind
                );
            }
            memory = whole.out.memory;
            old = new;
        }
    }
}
