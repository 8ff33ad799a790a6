//! An interpreter of user programs, written from the manual (6.9): one line after the other, not optimised.
//!
//! It models a drive that cannot move: HARD_STOP was open at power-on, so START has no effect (RS434-6), and
//! STATUS, SPEED_VALID and similar registers do not change. All contacts are open. Programs with a turning
//! motor are tested in `tests/rs434_examples.rs` and in `flow.rs`.

use drivetwin_tests::rs434::at;

/// Number of lines of a program.
pub(crate) const LINES: usize = 1_024;

/// Values of STATUS_USER_PROGRAM (6.3).
pub(crate) mod status {
    pub(crate) const STOPPED: u16 = 1;
    pub(crate) const RUNS: u16 = 4;
    pub(crate) const END: u16 = 5;
    pub(crate) const ENDF: u16 = 6;
    pub(crate) const ERROR: u16 = 7;
}

/// Bits of ERROR (6.5).
const EMERGENCY_STOP: u16 = 1 << 5;
const PROGRAM: u16 = 1 << 8;
const RANGE: u16 = 1 << 13;
/// Bits that a write of 0 clears: 8 and 11 to 15 (RS434-23).
const WARNINGS: u16 = 0xF900;

/// Settings from 5000h to 5014h: least and greatest value of a write, and value in a new RS 434544.
#[rustfmt::skip]
const SETTINGS: [(u16, u16, u16); 21] = [
    // Least, greatest, default.
    (0, 247, 1), (1, 5, 3), (0, 10, 9), (0, 65_535, 0),           // 5000h, 6.4
    (1, 2, 1), (1, 3, 1), (1, 3, 1), (1, 5, 1),                   // 5004h: the modes
    (1, 4, 1), (1_000, 20_000, 20_000),                           // 5008h: POSITION_N, REF_CURRENT
    (1_000, 15_000, 3_000), (30, 15_000, 1_000),                  // 500Ah: RATED_SPEED, SPEED
    (10, 1_000, 100), (10, 1_000, 100), (1, 2, 1),                // 500Ch: ACC, DEC, DIRECTION
    (1, 12, 4), (0, 2, 2), (0, 1, 0),                             // 500Fh: PULSES, USE_HALL, MODE_COIL
    (0, 65_535, 0), (0, 65_535, 10), (0, 65_535, 10),             // 5012h
];

/// An error that ends the program with status 7.
#[derive(Debug)]
struct Fails;

type Result<T> = std::result::Result<T, Fails>;

/// A FOR loop that is running.
#[derive(Clone, Debug)]
struct Loop {
    first: i32,
    /// The line after the body.
    end: i32,
    rounds: u16,
    /// Number of open CALLs around the loop.
    level: usize,
}

/// The register that an operand names.
#[derive(Clone, Copy)]
enum Place {
    System(u16),
    Modbus { kind: u16, address: u16 },
}

/// Effect of a line on the program: it continues at a line, or ends with a status.
enum Then {
    Goes(i32),
    Framing(u16),
}

/// A drive that runs a program.
#[derive(Clone)]
pub(crate) struct Oracle {
    pub(crate) program: Vec<u32>,
    pub(crate) system: [u16; 10],
    /// 5000h to 5022h.
    pub(crate) settings: [u16; 0x23],
    pub(crate) error: u16,
    pub(crate) status: u16,
    /// The line being executed.
    pub(crate) pc: i32,
    /// 6000h to 6005h.
    pub(crate) port: [u16; 6],
    buffer: Vec<u32>,
    /// HW_MINOR, FW_MAJOR, FW_MINOR, which the manual leaves open.
    versions: [u16; 3],
    calls: Vec<i32>,
    loops: Vec<Loop>,
    /// AX to JX and the settings at the start of the program.
    before: ([u16; 10], [u16; 0x23]),
}

impl Oracle {
    /// A drive at rest that has just started this program.
    pub(crate) fn new(program: Vec<u32>, system: [u16; 10], versions: [u16; 3]) -> Self {
        let mut settings = [0; 0x23];
        for (register, (_, _, default)) in settings.iter_mut().zip(SETTINGS) {
            *register = default;
        }
        settings[5] = 2;
        Self {
            program,
            system,
            settings,
            error: EMERGENCY_STOP,
            status: status::RUNS,
            pc: 0,
            port: [0; 6],
            buffer: vec![0; LINES],
            versions,
            calls: Vec::new(),
            loops: Vec::new(),
            before: (system, settings),
        }
    }

    /// Executes the line at `pc`. Returns its duration in units of 100 µs and the number of the next line, or
    /// `None` if the program has ended.
    pub(crate) fn step(&mut self) -> Option<(u64, i32)> {
        assert_eq!(self.status, status::RUNS);
        let lasts = match self.field(0, 7) {
            0x04 => (10 * u64::from(self.data())).max(1),
            _ => 1,
        };
        match self.execute().unwrap_or(Then::Framing(status::ERROR)) {
            Then::Goes(_) if self.status != status::RUNS => None,
            Then::Goes(next) => Some((lasts, self.end_of_rounds(next))),
            Then::Framing(how) => {
                self.finish(how);
                None
            }
        }
    }

    /// Starts the next line. Fails if there is no such line.
    pub(crate) fn begin(&mut self, line: i32) {
        if self.line(line).is_ok() {
            self.pc = line;
        } else {
            self.finish(status::ERROR);
        }
    }

    fn finish(&mut self, how: u16) {
        self.status = how;
        if how == status::ERROR {
            self.error |= PROGRAM;
        }
        if how == status::ENDF {
            let (system, settings) = self.before;
            self.system = system;
            // MODE_USER_PROGRAM and the line settings keep their new values (RS434-27).
            self.settings[0x04] = settings[0x04];
            self.settings[0x06..].copy_from_slice(&settings[0x06..]);
            self.pc = 0;
        }
    }

    fn line(&self, number: i32) -> Result<u32> {
        let number = usize::try_from(number).map_err(|_| Fails)?;
        self.program.get(number).copied().ok_or(Fails)
    }

    /// A field of the line at `pc`.
    fn field(&self, low: u32, bits: u32) -> u16 {
        let line = self.line(self.pc).expect("a line of the program");
        (line >> low & ((1 << bits) - 1)) as u16
    }

    fn data(&self) -> u16 {
        self.field(16, 16)
    }

    fn execute(&mut self) -> Result<Then> {
        let code = self.field(0, 7);
        let right = self.field(7, 1) == 1;
        let system = Place::System(self.field(8, 4));
        let data = self.data();
        let modbus = Place::Modbus { kind: self.field(12, 4), address: data };
        let other_system = Place::System(data);
        let next = Then::Goes(self.pc + 1);
        let after_constant = Then::Goes(self.pc + 2);
        let constant = self.line(self.pc + 1);
        let half = |constant: Result<u32>| constant.map(|constant| constant & 0xFFFF);
        let (short, long) = (false, true);
        let data_value = u32::from(data);
        match code {
            0x00 => return Ok(Then::Framing(status::END)),
            0x0D => return Ok(Then::Framing(status::ENDF)),
            0x04 => {}
            0x05..=0x09 | 0x63..=0x66 => {
                let (first, second) = match code {
                    0x63.. => (self.read(Place::System(6), long)?, self.read(Place::System(8), long)?),
                    _ => (self.read(Place::System(0), short)?, self.read(Place::System(1), short)?),
                };
                let jumps = match code {
                    0x05 => true,
                    0x06 | 0x63 => first == second,
                    0x07 | 0x64 => first != second,
                    0x08 | 0x65 => first > second,
                    _ => first < second,
                };
                if jumps {
                    let relative = self.pc + i32::from(data.cast_signed());
                    let target = if right { relative } else { i32::from(data) };
                    self.line(target)?;
                    return Ok(Then::Goes(target));
                }
            }
            0x0A => {
                self.line(i32::from(data))?;
                if self.calls.len() == 16 {
                    return Err(Fails);
                }
                self.calls.push(self.pc + 1);
                return Ok(Then::Goes(i32::from(data)));
            }
            0x0B => {
                let back = self.calls.pop().ok_or(Fails)?;
                self.loops.retain(|one| one.level <= self.calls.len());
                return Ok(Then::Goes(back));
            }
            0x0C => {
                let (length, rounds) = (i32::from(data >> 8), data & 0xFF);
                let (first, end) = (self.pc + 1, self.pc + 1 + length);
                if rounds == 0 {
                    return Ok(Then::Goes(end));
                }
                if length > 0 {
                    if self.loops.len() == 8 {
                        return Err(Fails);
                    }
                    self.loops.push(Loop { first, end, rounds, level: self.calls.len() });
                }
            }
            0x01 => self.write(system, data_value, short)?,
            0x02 => self.copy(system, modbus, short)?,
            0x03 => self.copy(modbus, system, short)?,
            0x0E => {
                self.write(modbus, half(constant)?, short)?;
                return Ok(after_constant);
            }
            0x0F => self.copy(system, other_system, short)?,
            0x10 => {
                self.write(system, constant?, long)?;
                return Ok(after_constant);
            }
            0x11 => self.copy(modbus, system, long)?,
            0x12 => {
                self.write(modbus, constant?, long)?;
                return Ok(after_constant);
            }
            0x13 => self.copy(system, modbus, long)?,
            0x14 => self.copy(system, other_system, long)?,
            0x15 => self.invert(system, short)?,
            0x16 => self.invert(modbus, short)?,
            0x17 => self.invert(system, long)?,
            0x18 => self.invert(modbus, long)?,
            0x20 => self.shift(system, right, data_value, short)?,
            0x45 => self.shift(system, right, data_value, long)?,
            0x2F => {
                self.shift(modbus, right, half(constant)?, short)?;
                return Ok(after_constant);
            }
            0x54 => {
                self.shift(modbus, right, constant?, long)?;
                return Ok(after_constant);
            }
            0x19..=0x1F => self.calculate(code - 0x19, system, data_value, short)?,
            0x21..=0x27 => {
                let second = self.read(modbus, short)?;
                self.calculate(code - 0x21, system, second, short)?;
            }
            0x28..=0x2E => {
                self.calculate(code - 0x28, modbus, half(constant)?, short)?;
                return Ok(after_constant);
            }
            0x30..=0x36 => {
                let second = self.read(system, short)?;
                self.calculate(code - 0x30, modbus, second, short)?;
            }
            0x37..=0x3D => {
                let second = self.read(other_system, short)?;
                self.calculate(code - 0x37, system, second, short)?;
            }
            0x3E..=0x44 => {
                self.calculate(code - 0x3E, system, constant?, long)?;
                return Ok(after_constant);
            }
            0x46..=0x4C => {
                let second = self.read(modbus, long)?;
                self.calculate(code - 0x46, system, second, long)?;
            }
            0x4D..=0x53 => {
                self.calculate(code - 0x4D, modbus, constant?, long)?;
                return Ok(after_constant);
            }
            0x55..=0x5B => {
                let second = self.read(system, long)?;
                self.calculate(code - 0x55, modbus, second, long)?;
            }
            0x5C..=0x62 => {
                let second = self.read(other_system, long)?;
                self.calculate(code - 0x5C, system, second, long)?;
            }
            _ => return Err(Fails),
        }
        Ok(next)
    }

    /// Ends rounds and loops where `next` leaves their bodies (RS434-30). Returns the line that is executed
    /// next.
    fn end_of_rounds(&mut self, mut next: i32) -> i32 {
        while let Some(innermost) = self.loops.last_mut() {
            if innermost.level != self.calls.len() {
                break;
            }
            if next == innermost.end {
                innermost.rounds -= 1;
                if innermost.rounds > 0 {
                    next = innermost.first;
                    break;
                }
            } else if (innermost.first..innermost.end).contains(&next) {
                break;
            }
            self.loops.pop();
        }
        next
    }

    fn copy(&mut self, from: Place, to: Place, long: bool) -> Result<()> {
        let value = self.read(from, long)?;
        self.write(to, value, long)
    }

    /// Adds, subtracts, divides, multiplies, ANDs, ORs or XORs, in the order of the codes.
    fn calculate(&mut self, operation: u16, place: Place, second: u32, long: bool) -> Result<()> {
        let first = self.read(place, long)?;
        let result = match operation {
            0 => first.wrapping_add(second),
            1 => first.wrapping_sub(second),
            2 => first.checked_div(second).ok_or(Fails)?,
            3 => first.wrapping_mul(second),
            4 => first & second,
            5 => first | second,
            _ => first ^ second,
        };
        self.write(place, result, long)
    }

    fn shift(&mut self, place: Place, right: bool, by: u32, long: bool) -> Result<()> {
        let first = u64::from(self.read(place, long)?);
        let by = by.min(32);
        let result = if right { first >> by } else { first << by };
        self.write(place, result as u32, long)
    }

    fn invert(&mut self, place: Place, long: bool) -> Result<()> {
        let value = self.read(place, long)?;
        // A bit register has only bit 0.
        let mask = match place {
            Place::Modbus { kind: 0 | 1, .. } => 0x0001_0001,
            _ => 0xFFFF_FFFF,
        };
        self.write(place, value ^ mask, long)
    }

    fn read(&self, place: Place, long: bool) -> Result<u32> {
        let word = |n: u16| match place {
            Place::System(number) => {
                self.system.get(usize::from(number) + usize::from(n)).copied().ok_or(Fails)
            }
            Place::Modbus { kind, address } => self.read_modbus(kind, address.checked_add(n).ok_or(Fails)?),
        };
        let low = u32::from(word(0)?);
        Ok(if long { u32::from(word(1)?) << 16 | low } else { low })
    }

    fn read_modbus(&self, kind: u16, address: u16) -> Result<u16> {
        Ok(match (kind, address) {
            (0, 0x1000..=0x1002) => 0,
            (1, 0x2000..=0x2003) => 0,
            (2, 0x3000..=0x3004) => 0,
            (2, 0x3005..=0x3007) => 250,
            (2, 0x3008) => panic!("TASK_COUNTER is random: no oracle knows it"),
            (2, 0x3009) => self.status,
            (2, 0x8001) => 1_001,
            (2, 0x8002..=0x8004) => self.versions[usize::from(address) - 0x8002],
            (3, 0x5000..=0x5022) => self.settings[usize::from(address) - 0x5000],
            (3, at::ERROR) => self.error,
            (3, 0x5024..=0x5026) => 0,
            (3, 0x6000..=0x6005) => self.port[usize::from(address) - 0x6000],
            (3, 0x7000..=0x7005) => self.system[usize::from(address) - 0x7000],
            (3, at::PC) => self.pc as u16,
            (3, 0x7007..=0x700A) => self.system[usize::from(address) - 0x7001],
            _ => return Err(Fails),
        })
    }

    fn write(&mut self, place: Place, value: u32, long: bool) -> Result<()> {
        let words = [value as u16, (value >> 16) as u16];
        let words = &words[..if long { 2 } else { 1 }];
        match place {
            Place::System(number) => {
                let number = usize::from(number);
                self.system.get_mut(number..number + words.len()).ok_or(Fails)?.copy_from_slice(words);
            }
            Place::Modbus { kind, address } => {
                let mut written = Vec::new();
                for (n, &word) in (0..).zip(words) {
                    let address = address.checked_add(n).ok_or(Fails)?;
                    if !is_writable(kind, address) {
                        return Err(Fails);
                    }
                    written.push((address, word));
                }
                if written.iter().any(|&(address, word)| kind == 3 && !is_in_range(address, word)) {
                    self.error |= RANGE;
                } else if kind == 3 {
                    self.write_holding(&written);
                }
                // Coils have no effect here: the motor cannot move, and the position is already 0.
            }
        }
        Ok(())
    }

    /// Stores all words before any of them takes effect (RS434-1).
    fn write_holding(&mut self, written: &[(u16, u16)]) {
        for &(address, word) in written {
            match address {
                0x5000..=0x5022 => self.settings[usize::from(address) - 0x5000] = word,
                at::ERROR => self.error &= word | !WARNINGS,
                0x6000..=0x6005 => self.port[usize::from(address) - 0x6000] = word,
                0x7000..=0x7005 => self.system[usize::from(address) - 0x7000] = word,
                0x7007..=0x700A => self.system[usize::from(address) - 0x7001] = word,
                _ => {}
            }
        }
        for &(address, word) in written {
            match address {
                // IN2 is open, so the direction is forward (RS434-22).
                at::MODE_DEVICE | at::MODE_EXT_IN
                    if self.settings[4] == 2 && [2, 4].contains(&self.settings[7]) =>
                {
                    self.settings[0x0E] = 1;
                }
                at::MODE_USER_PROGRAM if word == 1 => self.finish(status::STOPPED),
                at::WRITE_CMD => {
                    self.buffer[usize::from(word)] = u32::from(self.port[2]) << 16 | u32::from(self.port[1]);
                }
                at::READ_CMD => {
                    let line = self.buffer[usize::from(word)];
                    (self.port[4], self.port[5]) = (line as u16, (line >> 16) as u16);
                }
                _ => {}
            }
        }
    }
}

fn is_writable(kind: u16, address: u16) -> bool {
    match kind {
        1 => (0x2000..=0x2003).contains(&address),
        3 => matches!(address, 0x5000..=0x5026 | 0x6000..=0x6005 | 0x7000..=0x7005 | 0x7007..=0x700A),
        _ => false,
    }
}

fn is_in_range(address: u16, word: u16) -> bool {
    match address {
        0x5000..=0x5014 => {
            let (least, greatest, _) = SETTINGS[usize::from(address) - 0x5000];
            (least..=greatest).contains(&word)
        }
        // Keys, and the 0 that they read. The generator leaves out keys that would have an effect here.
        0x5024 => [0, 0x37FA].contains(&word),
        0x5025 => [0, 0x8426, 0x9346].contains(&word),
        0x5026 => [0, 0x95AF].contains(&word),
        at::WRITE_CMD | at::READ_CMD => word < 1_024,
        _ => true,
    }
}
