//! Well-behaved clients. They send valid requests on a quiet line and know the right answers.

use drivetwin_firmware::device::{Duration, Instant, Port, Role, Spec};
use drivetwin_protocol::line::Parity;
use drivetwin_protocol::modbus::tcp::{self, Header};
use drivetwin_protocol::modbus::{ascii, rtu};
use drivetwin_protocol::registers::{Row, Space};
use drivetwin_protocol::time::Span;
use drivetwin_sim::bench::{Client, DriveId, PowerAction};
use drivetwin_sim::line::{PortParity, Sender};
use drivetwin_sim::record::trace::{Cut, Event, InputRecord, OutputRecord};
use fastrand::Rng;

use crate::dialect::{self, Block, Family, QSB, one_of};
use crate::oracle::{Failure, TOO_MUCH};
use crate::plan::{Failing, NAMES, Name};
use crate::run::Runner;

/// Ports of an MDrive.
const MODBUS: Port = Port(0);
const MCODE: Port = Port(1);

/// Exception codes (application 7), and a register that no drive has.
const ILLEGAL_ADDRESS: u8 = 2;
const ILLEGAL_VALUE: u8 = 3;
const NOWHERE: u16 = 0xF000;

/// The failures of a drive that does not answer, and of one that gives another answer.
const NO_ANSWER: &str = "no answer";
const WRONG_ANSWER: &str = "wrong answer";

/// The failure of a drive that has wrong values after power-on.
const AFTER_POWER_ON: &str = "wrong after power-on";

/// Longest time that a client waits for a reply. How late a reply may be is judged in the trace
/// ([`replies`](crate::replies)).
const LONGEST_REPLY: Duration = Duration::secs(3);

/// A variable of an MDrive that no other client uses.
const USER_VARIABLE: &str = "Z9";

/// Time for which the bench waits for the rest of a message.
const FRAME_TIMEOUT: Duration = Duration::millis(20);

/// Address of a drive whose memory is bad.
const FACTORY_ADDRESS: u8 = 1;

/// Registers by name, with their values.
type Rows = Vec<(&'static str, i64)>;

/// What a drive has saved: its address, its first block, and all other saved registers.
struct Saved {
    address: Option<u8>,
    values: Vec<u32>,
    rows: Rows,
}

/// Saved registers, and their indices in the table. Leaves out the first block, and registers that the drive
/// changes by itself.
fn kept_rows(spec: &'static Spec) -> impl Iterator<Item = (usize, &'static Row)> {
    let family = Family::of(spec.kind);
    let block = family.blocks()[0];
    let in_block = move |address: u16| match family {
        Family::Qsb => QSB.iter().any(|(register, _)| *register == address),
        _ => block.contains(address),
    };
    let is_kept =
        move |row: &Row| row.saved != 0 && !in_block(row.address) && !family.changes_by_itself(row.address);
    dialect::settable(spec).filter(move |(_, row)| is_kept(row))
}

/// [`kept_rows`], and the saved values that are not on the bus, for example S1 of an MDrive.
fn compared_rows(spec: &'static Spec) -> impl Iterator<Item = (usize, &'static Row)> {
    let off_bus = |row: &Row| matches!(row.space, Space::Variable | Space::Setting);
    let others = spec.rows().filter(move |(_, row)| off_bus(row) && row.saved != 0 && !row.live);
    kept_rows(spec).chain(others)
}

/// Bits of a register that are saved; all of them if the register is not saved.
fn saved_bits(row: &Row) -> i64 {
    if matches!(row.saved, 0 | u16::MAX) { -1 } else { i64::from(row.saved) }
}

/// A point of a save. A save has one or two stores; the second one has two bytes. One point in four is before
/// the first byte of a store, and one in four after its last byte. `memory` is the size of the memory.
fn any_cut(memory: usize, rng: &mut Rng) -> Cut {
    let stores = rng.u32(..2);
    let bytes = match rng.u8(..4) {
        0 => 0,
        1 => memory,
        _ => rng.usize(..=if stores == 0 { memory } else { 2 }),
    };
    Cut { stores, bytes }
}

/// A request and its reply.
type Exchange = (Vec<u8>, Vec<u8>);

/// A PDU: a function code and the words after it.
fn pdu(function: u8, words: &[u16]) -> Vec<u8> {
    std::iter::once(function).chain(words.iter().flat_map(|word| word.to_be_bytes())).collect()
}

/// Splits the values of a block into the parts that a family takes in one request. Each part is the address
/// of its first register and its words.
fn parts<'a>(
    family: Family,
    block: Block,
    values: &'a [u32],
) -> impl Iterator<Item = (u16, Vec<u16>)> + use<'a> {
    let most = family.words_at_once().min(values.len());
    let words = |values: &[u32]| values.iter().map(|&value| value as u16).collect();
    (block.first..).step_by(most).zip(values.chunks(most)).map(move |(first, values)| (first, words(values)))
}

/// Noise that begins with an address which no drive has. No beginning of it is a frame by chance, because the rest would then
/// be a frame of its own, later than the client expects.
fn noise(free: u8, rng: &mut Rng) -> Vec<u8> {
    loop {
        let bytes: Vec<u8> = std::iter::once(free).chain((0..rng.u8(1..40)).map(|_| rng.u8(..))).collect();
        if (1..=bytes.len()).all(|count| rtu::verify_crc(&bytes[..count]).is_none()) {
            return bytes;
        }
    }
}

/// Requests that write a block, and their replies (application 6.6, 6.12). A single word is written by
/// function 6 or 16.
fn writing(family: Family, block: Block, values: &[u32], rng: &mut Rng) -> Vec<Exchange> {
    let write = |(first, words): (u16, Vec<u16>)| match words[..] {
        [word] if one_of(rng, family.writes_a_word()) == 6 => {
            (pdu(6, &[first, word]), pdu(6, &[first, word]))
        }
        _ => {
            let head = pdu(16, &[first, words.len() as u16]);
            let data = pdu(2 * words.len() as u8, &words);
            ([&head[..], &data].concat(), head)
        }
    };
    parts(family, block, values).map(write).collect()
}

/// Requests that read a block with these values, and their replies (application 6.3).
fn reading(family: Family, block: Block, values: &[u32]) -> Vec<Exchange> {
    let read = |(first, words): (u16, Vec<u16>)| {
        let data = pdu(2 * words.len() as u8, &words);
        (pdu(3, &[first, words.len() as u16]), [&[3], &data[..]].concat())
    };
    parts(family, block, values).map(read).collect()
}

impl Runner<'_> {
    /// A well-behaved client writes values, reads them back, and requests registers that do not exist. Often
    /// the line has been disturbed just before.
    pub(crate) fn ask_step(&mut self, name: Name, seed: u64) -> Result<(), Failure> {
        let Some(family) = self.family(name) else { return Ok(()) };
        let mut rng = Rng::with_seed(seed);
        let block = self.block(name, family, &mut rng);
        let values = self.values(name, block, &mut rng);
        self.quiet(name)?;
        if family.saves_each_write() {
            self.kept.remove(name);
        }
        if family == Family::Qsb {
            let client = self.qsb_terminal(name)?;
            self.qsb_write(client, &values)?;
            self.qsb_read(client, &values)?;
            self.set_and_read_qsb(name, client, &mut rng)?;
            self.bench.disconnect(client);
            return Ok(());
        }
        let nowhere = (pdu(3, &[NOWHERE, 1]), vec![0x83, ILLEGAL_ADDRESS]);
        let write = writing(family, block, &values, &mut rng);
        let asked = [write, reading(family, block, &values), vec![nowhere]].concat();
        let at_once = if rng.bool() { asked.len() } else { 1 };
        for asked in asked.chunks(at_once) {
            if rng.bool() {
                self.disturb_line(name, block, &mut rng)?;
            }
            self.exchange(name, asked, &mut rng)?;
        }
        self.set_and_read(name, family, &mut rng)?;
        if family == Family::Mdrive {
            return self.ask_mcode(name, &mut rng);
        }
        let others = self.values(name, block, &mut rng);
        self.write_to_nobody(name, block, &others, &mut rng)
    }

    /// A well-behaved client saves values, and reads them back after power was off. If power is to fail
    /// during a save, the client sets other registers, saves a second time, and power fails then. The drive
    /// must have the values of the first or of the second save, or the factory's where its family allows
    /// them.
    pub(crate) fn save_step(&mut self, name: Name, seed: u64, failing: Failing) -> Result<(), Failure> {
        let (Some(family), Some(seat)) = (self.family(name), self.bench.find_drive(name)) else {
            return Ok(());
        };
        let mut rng = Rng::with_seed(seed);
        let block = family.blocks()[0];
        // Waits until the drives have handled everything that other clients have sent.
        self.quiet(name)?;
        self.bench.power(seat, PowerAction::Off);
        self.pass(1.millis())?;
        let since = (self.bench.trace().mark(), self.bench.now());
        self.power_on(name)?;
        self.expect_no_position(name, seat, family, since)?;
        self.set_others(seat, family, &mut rng);
        let values = self.values(name, block, &mut rng);
        let variable = rng.i32(..);
        if family == Family::Mdrive {
            let lines = format!("VA {USER_VARIABLE}\r{USER_VARIABLE}={variable}\rPR {USER_VARIABLE}\r");
            self.mcode(name, &lines, variable)?;
        }
        if !self.save(name, block, &values, &mut rng)? {
            return Ok(());
        }
        let address = self.addresses.get(name).copied();
        let saved = Saved { address, values, rows: self.saved_rows(seat) };
        // If the drive loses its address, the factory's address may be that of another drive on its line.
        let alone = NAMES.iter().filter(|other| self.shares(name, other)).count() == 1;
        let mut may_be = if failing == Failing::Amid && alone {
            self.save_until_cut(name, seat, saved, &mut rng)?
        } else {
            vec![saved]
        };
        if may_be.is_empty() {
            return Ok(());
        }
        self.bench.power(seat, PowerAction::Off);
        self.pass(10.millis())?;
        let since = (self.bench.trace().mark(), self.bench.now());
        self.power_on(name)?;
        let found = self.find(name, seat, block, &may_be)?;
        self.expect_no_position(name, seat, family, since)?;
        if family == Family::Mdrive && may_be.len() == 1 {
            // A user variable that was saved comes back (MC 5-60).
            let printed = self.mcode(name, &format!("PR {USER_VARIABLE}\r"), variable);
            printed.map_err(|failure| failure.of(AFTER_POWER_ON))?;
        }
        if may_be.len() > 1 {
            self.happened.after_cuts[found] += 1;
        }
        self.kept.insert(name, may_be.swap_remove(found).values);
        self.happened.saved += 1;
        Ok(())
    }

    /// Sets other registers and saves until power fails: at any byte of a save, before its first byte or
    /// after its last one. Returns what the drive may then have saved; nothing if an input keeps the drive from
    /// saving.
    fn save_until_cut(
        &mut self,
        name: Name,
        seat: DriveId,
        mut old: Saved,
        rng: &mut Rng,
    ) -> Result<Vec<Saved>, Failure> {
        let spec = self.bench.spec(seat);
        let family = Family::of(spec.kind);
        let block = family.blocks()[0];
        self.set_others(seat, family, rng);
        if family == Family::Qsb {
            // A terminal sets EOR.
            let client = self.qsb_terminal(name)?;
            self.bench.disconnect(client);
        }
        if family.saves_each_write() {
            self.pass(100.millis())?;
            old.rows = self.saved_rows(seat);
        }
        // If a save is a single store, the power failure may be delayed to the next save. That happens to
        // half of them.
        let mut last = Ok(true);
        for _ in 0..64 {
            let values = self.values(name, block, rng);
            let new = Saved { address: old.address, values, rows: self.saved_rows(seat) };
            self.bench.cut_power(seat, any_cut(spec.memory.into(), rng));
            // Power may fail before the answer is complete.
            last = self.save(name, block, &new.values, rng);
            if last.as_ref().is_err_and(|failure| failure.what == TOO_MUCH) {
                return last.map(|_| Vec::new());
            }
            if !self.bench.powered(seat) {
                let rows = self.rows_to_compare(seat).map(|(_, row)| (row.name, row.reset & saved_bits(row)));
                let factory = family.factory().map(|values| Saved {
                    address: old.address.map(|_| FACTORY_ADDRESS),
                    values: values.to_vec(),
                    rows: rows.collect(),
                });
                return Ok([new, old].into_iter().chain(factory).collect());
            }
            if last == Ok(false) {
                return Ok(Vec::new());
            }
            old = new;
        }
        Err(Failure::new("no power cut", format!("{name}, {}: {last:?}", spec.kind)))
    }

    /// Sets some saved registers outside the block to random values.
    fn set_others(&mut self, seat: DriveId, family: Family, rng: &mut Rng) {
        let rows = kept_rows(self.bench.spec(seat));
        let rows = rows.filter(|(_, row)| !family.keeps_from_saving(row.address));
        let rows: Vec<_> = rows.collect();
        for _ in 0..8 {
            let (place, row) = one_of(rng, &rows);
            // A drive may refuse the value.
            let _ = self.bench.poke(seat, place, dialect::any_value(row, rng));
        }
    }

    /// [`compared_rows`] without those that an input of this drive may change.
    fn rows_to_compare(&self, seat: DriveId) -> impl Iterator<Item = (usize, &'static Row)> + use<> {
        let spec = self.bench.spec(seat);
        let has_inputs = self.has_inputs(self.bench.name(seat));
        compared_rows(spec)
            .filter(move |(_, row)| !has_inputs || !Family::of(spec.kind).changes_by_inputs(row.name))
    }

    /// [`rows_to_compare`](Self::rows_to_compare) by name, with only the bits that are saved.
    fn saved_rows(&self, seat: DriveId) -> Rows {
        let value = |(place, row)| (row, self.bench.peek(seat, place));
        let rows = self.rows_to_compare(seat).map(value);
        rows.map(|(row, value)| (row.name, value & saved_bits(row))).collect()
    }

    /// Registers of a drive by name that only a write changes.
    fn steady_rows(&self, seat: DriveId) -> Rows {
        let spec = self.bench.spec(seat);
        let family = Family::of(spec.kind);
        let blocks = family.blocks();
        let has_inputs = self.has_inputs(self.bench.name(seat));
        let is_steady = |row: &Row| {
            (row.saved != 0 || blocks.iter().any(|block| block.contains(row.address)))
                && !family.changes_by_itself(row.address)
                && !(has_inputs && family.changes_by_inputs(row.name))
        };
        let rows = dialect::settable(spec).filter(|(_, row)| is_steady(row));
        rows.map(|(place, row)| (row.name, self.bench.peek(seat, place) & saved_bits(row))).collect()
    }

    /// The registers of the drives on the line of `name` which only a write changes. Leaves out the drives in
    /// `except`, and drives without power.
    fn line_rows(&self, name: Name, except: &[Name]) -> Vec<(Name, Rows)> {
        let drives = NAMES.iter().filter(|other| self.shares(name, other) && !except.contains(other));
        let seats = drives.filter_map(|other| Some((*other, self.bench.find_drive(other)?)));
        let powered = seats.filter(|(_, seat)| self.bench.powered(*seat));
        powered.map(|(other, seat)| (other, self.steady_rows(seat))).collect()
    }

    /// Reads a block, and returns the index in `may_be` of the values that it and all other saved registers
    /// have.
    fn find(&mut self, name: Name, seat: DriveId, block: Block, may_be: &[Saved]) -> Result<usize, Failure> {
        let rows = self.saved_rows(seat);
        let (mut failure, mut lost) = (Failure::new("nothing to find", name), None);
        for (place, saved) in may_be.iter().enumerate() {
            if let Some(address) = saved.address {
                self.addresses.insert(name, address);
            }
            match self.expect(name, block, &saved.values) {
                Ok(()) => match saved.rows.iter().zip(&rows).find(|(saved, row)| saved != row) {
                    None => return Ok(place),
                    Some((saved, row)) => lost = Some(format!("{name}: {saved:?} became {row:?}")),
                },
                Err(other) => failure = other,
            }
        }
        Err(lost.map_or_else(
            || failure.of("saved values lost or mixed"),
            |detail| Failure::new("a saved register lost", detail),
        ))
    }

    /// Reads back values that were saved before a restart.
    pub(crate) fn expect_kept(&mut self, name: Name, values: &[u32]) -> Result<(), Failure> {
        let Some(family) = self.family(name) else { return Ok(()) };
        self.expect(name, family.blocks()[0], values).map_err(|failure| failure.of("saved values lost"))
    }

    /// Picks one of a family's blocks; often a [treacherous](Block::treacherous) one.
    fn block(&self, name: Name, family: Family, rng: &mut Rng) -> Block {
        let blocks = family.blocks();
        let address = self.addresses.get(name).copied().unwrap_or_default();
        let some: Vec<Block> =
            blocks.iter().copied().filter(|block| block.treacherous(address).is_some()).collect();
        if some.is_empty() || rng.bool() { one_of(rng, &blocks) } else { one_of(rng, &some) }
    }

    /// Random values of a block. For a [treacherous](Block::treacherous) block the first byte is often the
    /// one that makes a valid CRC too early.
    fn values(&self, name: Name, block: Block, rng: &mut Rng) -> Vec<u32> {
        if self.family(name) == Some(Family::Qsb) {
            let mut word = || u32::from(dialect::any_word(rng));
            return QSB.iter().map(|(_, most)| (word() << 16 | word()) & most).collect();
        }
        let mut values: Vec<u32> = (0..block.count).map(|_| dialect::any_word(rng).into()).collect();
        let address = self.addresses.get(name).copied().unwrap_or_default();
        if let Some([_, first]) = block.treacherous(address).filter(|_| rng.u8(..4) > 0) {
            values[0] = u32::from(first) << 8 | values[0] & 0xFF;
        }
        values
    }

    /// Writes a block and saves it. Returns false if an input moves the drive, which therefore does not save.
    fn save(&mut self, name: Name, block: Block, values: &[u32], rng: &mut Rng) -> Result<bool, Failure> {
        let Some(family) = self.family(name) else { return Ok(true) };
        let mut is_saved = true;
        if family == Family::Qsb {
            let client = self.qsb_terminal(name)?;
            // COMMAND 3 (command list) saves.
            let saved = self
                .qsb_write(client, values)
                .and_then(|()| self.qsb_command(client, "W163", "w 16 00000003 !"));
            // Disconnects, because the bench would keep all bytes for a connected client that never reads.
            self.bench.disconnect(client);
            saved?;
        } else {
            for write in writing(family, block, values, rng) {
                self.exchange(name, &[write], rng)?;
            }
            if let Some((register, value)) = family.save() {
                let block = Block { first: register, count: 1 };
                let write = writing(family, block, &[value.into()], rng);
                let refusal = family.refuses_to_save().filter(|_| self.has_inputs(name));
                is_saved = self.exchange_or_refusal(name, &write, refusal, rng)?;
            }
        }
        self.pass(100.millis())?;
        Ok(is_saved)
    }

    /// Reads a block and fails if it does not hold these values.
    fn expect(&mut self, name: Name, block: Block, values: &[u32]) -> Result<(), Failure> {
        let Some(family) = self.family(name) else { return Ok(()) };
        if family == Family::Qsb {
            let client = self.qsb_terminal(name)?;
            let read = self.qsb_read(client, values);
            self.bench.disconnect(client);
            return read;
        }
        let mut reads = reading(family, block, values).into_iter();
        reads.try_for_each(|read| self.exchange(name, &[read], &mut Rng::with_seed(0)))
    }

    /// Sends requests as one burst, split at random. Expects their replies and nothing else.
    fn exchange(&mut self, name: Name, asked: &[Exchange], rng: &mut Rng) -> Result<(), Failure> {
        self.exchange_or_refusal(name, asked, None, rng).map(|_| ())
    }

    /// Like [`exchange`](Self::exchange). Returns false if the drive refused the first request with the
    /// exception code `refusal` instead.
    fn exchange_or_refusal(
        &mut self,
        name: Name,
        asked: &[Exchange],
        refusal: Option<u8>,
        rng: &mut Rng,
    ) -> Result<bool, Failure> {
        let Some(seat) = self.bench.find_drive(name) else { return Ok(true) };
        let before = self.line_rows(name, &[name]);
        let client =
            self.bench.connect_to(seat, MODBUS).map_err(|error| Failure::new("nobody let in", error))?;
        let unit = self.addresses.get(name).copied().unwrap_or(1);
        let framed = |n: usize, pdu: &[u8]| self.framed(name, unit, n as u16, pdu);
        let request: Vec<u8> = asked.iter().enumerate().flat_map(|(n, (ask, _))| framed(n, ask)).collect();
        let expected: Vec<u8> =
            asked.iter().enumerate().flat_map(|(n, (_, reply))| framed(n, reply)).collect();
        let refused = refusal.zip(asked.first()).map(|(code, (ask, _))| framed(0, &[ask[0] | 0x80, code]));
        let mut rest = &request[..];
        while !rest.is_empty() {
            let (piece, behind) =
                rest.split_at(if rng.bool() { rest.len() } else { rng.usize(1..=rest.len()) });
            self.bench.send(client, piece);
            // A drive waits 20 ms for the rest of a message.
            self.pass(Duration::from_ticks(rng.u64(0..5.millis().ticks())))?;
            rest = behind;
        }
        let heard = self.hear(client, expected.len(), LONGEST_REPLY)?;
        self.bench.disconnect(client);
        self.happened.answered += asked.len() as u64;
        let is_refused = refused.is_some_and(|refused| refused == heard);
        if !is_refused {
            judge(name, &request, &expected, &heard)?;
        }
        unchanged(&before, &self.line_rows(name, &[name]))?;
        Ok(!is_refused)
    }

    /// Sends what no drive may answer: noise, a frame with a wrong checksum, characters with the wrong parity,
    /// a frame for another address. Then waits only for the silence that the line needs.
    fn disturb_line(&mut self, name: Name, block: Block, rng: &mut Rng) -> Result<(), Failure> {
        let Some(seat) = self.bench.find_drive(name) else { return Ok(()) };
        let Some(line) = self.bench.port_line(seat, MODBUS) else { return Ok(()) };
        let Ok(client) = self.bench.connect_to(seat, MODBUS) else { return Ok(()) };
        let (is_ascii, free) = (ascii::is_on(line), self.free_unit(rng));
        let read = pdu(3, &[block.first, 1]);
        let unit = self.addresses.get(name).copied().unwrap_or(FACTORY_ADDRESS);
        for _ in 0..rng.u8(1..3) {
            let mut bytes = self.framed(name, unit, 0, &read);
            let mut sender = Sender::default();
            // The bench waits this long for the rest of a message that is not complete.
            let mut patience = FRAME_TIMEOUT;
            match rng.u8(..4) {
                0 => bytes = noise(free, rng),
                1 if is_ascii => {
                    let check = bytes.len() - 3;
                    bytes[check] = if bytes[check] == b'0' { b'1' } else { b'0' };
                }
                1 => {
                    let last = bytes.len() - 1;
                    bytes[last] ^= 1 << rng.u8(..8);
                }
                2 => {
                    let other = if line.parity == Parity::Odd { Parity::Even } else { Parity::Odd };
                    sender.parity = PortParity::Known(other);
                }
                _ => {
                    bytes = self.framed(name, free, 0, &read);
                    patience = Duration::ZERO;
                }
            }
            self.bench.send_from(client, &bytes, sender);
            let silence = match (is_ascii, line.baud) {
                (true, _) => Duration::ZERO,
                (false, ..=19_200) => Duration::from_ticks(line.character().ticks() * 7 / 2),
                (false, _) => Duration::micros(1_750),
            };
            self.pass(patience + line.character() * bytes.len() as u64 + silence + Duration::TICK * 2)?;
        }
        let mut heard = Vec::new();
        self.bench.receive(client, &mut heard);
        self.bench.disconnect(client);
        if heard.is_empty() {
            return Ok(());
        }
        Err(Failure::new("an answer to a bad frame", format!("{name} says {heard:02X?}")))
    }

    /// Writes one of the registers that a drive saves, and reads it back. The register table determines
    /// which values the drive refuses.
    fn set_and_read(&mut self, name: Name, family: Family, rng: &mut Rng) -> Result<(), Failure> {
        let Some(seat) = self.bench.find_drive(name) else { return Ok(()) };
        let spec = self.bench.spec(seat);
        let is_set = |row: &Row| {
            row.saved == u16::MAX
                && !family.keeps_from_saving(row.address)
                && !family.has_other_rules(row.address)
                && usize::from(row.shape.words()) <= family.words_at_once()
        };
        let rows: Vec<_> = kept_rows(spec).filter(|(_, row)| is_set(row)).collect();
        let is_ascii = self.bench.port_line(seat, MODBUS).is_some_and(ascii::is_on);
        // Few plans have a line with ASCII, so more is written there.
        for _ in 0..rng.u8(1..if is_ascii { 40 } else { 4 }) {
            let (_, row) = one_of(rng, &rows);
            let value = dialect::any_value(row, rng);
            let (least, greatest) = row.shape.limits();
            let value = value.clamp(least, greatest);
            let count = row.shape.words();
            let word = |n: u16| u32::from(spec.registers.word(row.shape, value, n.into()));
            let words: Vec<u32> = (0..count).map(word).collect();
            let block = Block { first: row.address, count };
            let mut write = writing(family, block, &words, rng);
            if row.accepts(value) {
                write.extend(reading(family, block, &words));
            } else {
                for (request, reply) in &mut write {
                    *reply = vec![request[0] | 0x80, ILLEGAL_VALUE];
                }
            }
            for asked in write {
                self.exchange(name, &[asked], rng).map_err(|failure| failure.of(row.name))?;
            }
        }
        Ok(())
    }

    /// An address that no drive has.
    fn free_unit(&self, rng: &mut Rng) -> u8 {
        let is_free = |unit: &u8| self.addresses.values().all(|address| address != unit);
        let free: Vec<u8> = (FACTORY_ADDRESS + 1..248).filter(is_free).collect();
        one_of(rng, &free)
    }

    /// Writes a block at an address that no drive has. Nobody may answer, and no drive may carry out the
    /// write.
    fn write_to_nobody(
        &mut self,
        name: Name,
        block: Block,
        values: &[u32],
        rng: &mut Rng,
    ) -> Result<(), Failure> {
        let (Some(family), Some(seat)) = (self.family(name), self.bench.find_drive(name)) else {
            return Ok(());
        };
        let unit = self.free_unit(rng);
        let before = self.line_rows(name, &[]);
        let Ok(client) = self.bench.connect_to(seat, MODBUS) else { return Ok(()) };
        for (write, _) in writing(family, block, values, rng) {
            self.bench.send(client, &self.framed(name, unit, 0, &write));
            self.pass(300.millis())?;
        }
        let mut heard = Vec::new();
        self.bench.receive(client, &mut heard);
        self.bench.disconnect(client);
        if !heard.is_empty() {
            return Err(Failure::new(
                "an answer for another",
                format!("{unit} is asked; heard {heard:02X?}"),
            ));
        }
        unchanged(&before, &self.line_rows(name, &[]))
    }

    /// Receives `expected` bytes, or fewer if no more arrive within `most`. Then waits 20 ms for surplus bytes.
    fn hear(&mut self, client: Client, expected: usize, most: Duration) -> Result<Vec<u8>, Failure> {
        let (mut heard, from) = (Vec::new(), self.bench.now());
        loop {
            self.bench.receive(client, &mut heard);
            if heard.len() >= expected || self.bench.now() >= from + most {
                break;
            }
            self.pass(20.millis())?;
        }
        self.pass(20.millis())?;
        self.bench.receive(client, &mut heard);
        Ok(heard)
    }

    /// The bytes that carry a PDU to a unit or back, on the line or connection of a drive.
    fn framed(&self, name: Name, unit: u8, transaction: u16, pdu: &[u8]) -> Vec<u8> {
        let bus = self.bench.find_drive(name).and_then(|seat| self.bench.bus(seat, MODBUS));
        match bus {
            None => tcp::frame(Header { transaction, unit }, pdu).to_vec(),
            Some(bus) if ascii::is_on(self.bench.line(bus)) => ascii::frame(unit, pdu).to_vec(),
            Some(_) => rtu::frame(unit, pdu).to_vec(),
        }
    }

    /// Sets a variable over MCode (MC 5-60) and prints it.
    fn ask_mcode(&mut self, name: Name, rng: &mut Rng) -> Result<(), Failure> {
        let value = rng.i32(..);
        self.mcode(name, &format!("R4={value}\rPR R4\r"), value)
    }

    /// Sends lines to an MCode port. The value must be printed in a text line of its own.
    fn mcode(&mut self, name: Name, lines: &str, value: i32) -> Result<(), Failure> {
        let Some(seat) = self.bench.find_drive(name) else { return Ok(()) };
        let Ok(client) = self.bench.connect_to(seat, MCODE) else { return Ok(()) };
        // Esc stops a program.
        self.bench.send(client, b"\x1b\r");
        self.hear(client, usize::MAX, LONGEST_REPLY)?;
        self.bench.send(client, lines.as_bytes());
        self.pass(200.millis())?;
        let mut heard = Vec::new();
        self.bench.receive(client, &mut heard);
        self.bench.disconnect(client);
        self.happened.answered += 1;
        let printed = format!("\r\n{value}\r\n").into_bytes();
        if heard.windows(printed.len()).any(|part| part == printed) {
            return Ok(());
        }
        judge(name, lines.as_bytes(), &printed, &heard)
    }

    /// Reads the position of a drive, which must be 0 unless something has turned the motor or the encoder
    /// since power-on: at an instant, which is given with the number of events before it.
    fn expect_no_position(
        &mut self,
        name: Name,
        seat: DriveId,
        family: Family,
        since: (u64, Instant),
    ) -> Result<(), Failure> {
        let read = match family.position() {
            Some((function, block)) => {
                let data = vec![0; 2 * usize::from(block.count)];
                let reply = [vec![function, data.len() as u8], data].concat();
                let read = (pdu(function, &[block.first, block.count]), reply);
                self.exchange(name, &[read], &mut Rng::with_seed(0))
            }
            None => {
                let client = self.qsb_terminal(name)?;
                let read = self.qsb_command(client, "R0E", "r 0E 00000000 !");
                self.bench.disconnect(client);
                read
            }
        };
        match read {
            // In each mode the client sends the same, whatever the trace still holds.
            Err(failure) if failure.what == WRONG_ANSWER && self.may_have_turned(seat, family, since) => {
                Ok(())
            }
            other => other.map_err(|failure| failure.of(AFTER_POWER_ON)),
        }
    }

    /// Returns true if a motor or an encoder of a drive may have turned after power-on: a pin changed, or the
    /// sensors of the drive's own motor did, which may coast on from before. An MDrive has a position of its
    /// own, so pins change it only in clock mode and with jogs. A QSB counts from 0 only with the factory's
    /// MODE and MDR0: the others measure, or load the counter at an index.
    fn may_have_turned(&self, seat: DriveId, family: Family, (mark, on): (u64, Instant)) -> bool {
        let (trace, spec) = (self.bench.trace(), self.bench.spec(seat));
        let is_set = |row: &str| spec.find(row).is_some_and(|found| self.bench.peek(seat, found.row) != 0);
        if family == Family::Mdrive && !is_set("CM") && !is_set("JE") {
            return false;
        }
        let selects = |row: &Row| row.space != Space::Setting && matches!(row.address, 0x00 | 0x03);
        let is_other =
            |(place, row): (usize, &Row)| selects(row) && self.bench.peek(seat, place) != row.reset;
        if family == Family::Qsb && spec.rows().any(is_other) {
            return true;
        }
        let events = trace.since(mark);
        // A ring may have dropped the change of a pin.
        if (events.len() as u64) < trace.mark() - mark {
            return true;
        }
        let name = self.bench.name(seat);
        let mut later = events.filter(|entry| entry.at > on && trace.drives[entry.drive].name == name);
        later.any(|entry| match &entry.event {
            Event::Input(InputRecord::Edge { .. } | InputRecord::Open { .. }) => true,
            Event::Output(OutputRecord::Level { pin, .. }) => {
                spec.pins[usize::from(pin.0)].role == Role::Both
            }
            _ => false,
        })
    }

    /// A client at a QSB whose streams are stopped, and whose reply format is the factory's.
    fn qsb_terminal(&mut self, name: Name) -> Result<Client, Failure> {
        let seat = self.bench.find_drive(name).ok_or_else(|| Failure::new("no drive", name))?;
        let client =
            self.bench.connect_to(seat, Port(0)).map_err(|error| Failure::new("nobody let in", error))?;
        // These commands end a partial command and stop all streams, by COMMAND 1 or by reading.
        for command in ["\r\r", "W161\r", "R01\r", "R05\r", "R06\r", "R0E\r", "R13\r", "W15B\r"] {
            self.bench.send(client, command.as_bytes());
            self.pass(20.millis())?;
        }
        // Answers may arrive up to a second late.
        self.pass(1_500.millis())?;
        self.bench.receive(client, &mut Vec::new());
        Ok(client)
    }

    fn qsb_write(&mut self, client: Client, values: &[u32]) -> Result<(), Failure> {
        QSB.iter().zip(values).try_for_each(|((register, _), value)| {
            self.qsb_command(
                client,
                &format!("W{register:02X}{value:08X}"),
                &format!("w {register:02X} {value:08X} !"),
            )
        })
    }

    fn qsb_read(&mut self, client: Client, values: &[u32]) -> Result<(), Failure> {
        QSB.iter().zip(values).try_for_each(|((register, _), value)| {
            self.qsb_command(client, &format!("R{register:02X}"), &format!("r {register:02X} {value:08X} !"))
        })
    }

    /// Writes some of the registers that a QSB saves, and reads them back. The register table determines
    /// which values the QSB refuses.
    fn set_and_read_qsb(&mut self, name: Name, client: Client, rng: &mut Rng) -> Result<(), Failure> {
        let Some(seat) = self.bench.find_drive(name) else { return Ok(()) };
        let is_set = |row: &Row| {
            row.saved == u16::MAX
                && row.space != Space::Setting
                && !Family::Qsb.changes_by_itself(row.address)
                && !Family::Qsb.has_other_rules(row.address)
        };
        let rows: Vec<_> =
            self.bench.spec(seat).rows().map(|(_, row)| row).filter(|row| is_set(row)).collect();
        for _ in 0..rng.u8(1..4) {
            let row = one_of(rng, &rows);
            let (register, sent) = (row.address, dialect::any_value(row, rng) as u32);
            let (least, greatest) = row.shape.limits();
            let value = if least < 0 { i64::from(sent.cast_signed()) } else { sent.into() };
            let write = format!("W{register:02X}{sent:08X}");
            if (least..=greatest).contains(&value) && row.accepts(value) {
                self.qsb_command(client, &write, &format!("w {register:02X} {sent:08X} !"))?;
                self.qsb_command(
                    client,
                    &format!("R{register:02X}"),
                    &format!("r {register:02X} {sent:08X} !"),
                )?;
            } else {
                self.qsb_command(client, &write, &format!("e {register:02X} {sent:08X} !"))?;
            }
        }
        Ok(())
    }

    /// Sends a command, and expects its answer and nothing else.
    fn qsb_command(&mut self, client: Client, command: &str, answer: &str) -> Result<(), Failure> {
        self.bench.send(client, format!("{command}\r").as_bytes());
        let expected = format!("{answer}\r\n");
        let heard = self.hear(client, expected.len(), LONGEST_REPLY)?;
        self.happened.answered += 1;
        judge("a QSB", command.as_bytes(), expected.as_bytes(), &heard)
    }
}

/// Compares registers of drives before and after a request to another address.
fn unchanged(before: &[(Name, Rows)], after: &[(Name, Rows)]) -> Result<(), Failure> {
    let differs = before.iter().zip(after).find_map(|((name, before), (_, after))| {
        let differs = before.iter().zip(after).find(|(before, after)| before != after);
        differs.map(|(before, after)| format!("{name}: {before:?} became {after:?}"))
    });
    differs.map_or(Ok(()), |detail| Err(Failure::new("a write for another carried out", detail)))
}

fn judge(name: &str, request: &[u8], expected: &[u8], heard: &[u8]) -> Result<(), Failure> {
    if expected == heard {
        return Ok(());
    }
    let what = if heard.is_empty() { NO_ANSWER } else { WRONG_ANSWER };
    let [request, expected, heard] =
        [request, expected, heard].map(|bytes| match std::str::from_utf8(bytes) {
            Ok(text) if text.is_ascii() && !text.is_empty() && !text.contains('\0') => format!("{text:?}"),
            _ => format!("{bytes:02X?}"),
        });
    Err(Failure::new(what, format!("{name} is asked {request}; expected {expected}; heard {heard}")))
}
