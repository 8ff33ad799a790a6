//! Execution of the computer's requests.

use drivetwin_control::{
    Answer, Call, Event, Events, Hello, PIECE, Power, Refused, State, Statistics, Stimulus, VERSION,
    fingerprint,
};
use drivetwin_firmware::device::{Device, Duration, Encoder, Fault, Instant, Level, Pin, PresetError};
use drivetwin_firmware::shell::{Links, Outputs};
use drivetwin_protocol::registers::{Entry, Shape};
use embedded_storage::Storage;

use super::{OnStation, convert, trace};
use crate::board::{Board, Leave};
use crate::bus::Uart;
use crate::slips::SLIPPED;

/// Greatest number of registers in one answer. A drive may need long to tell a value.
const VALUES: u8 = 16;

/// Time for the computer to take the reply to a call that ends the image. A computer asks for packets in each millisecond, and
/// its program needs some more to read them.
const LINGER: Duration = Duration::millis(50);

/// Greatest number of bytes of a number as postcard.
const NUMBER: usize = 10;

/// A drive, as the port of control uses it.
pub(crate) trait Calls {
    /// Does what a call says. `piece` has room for the bytes of the answer.
    ///
    /// # Errors
    /// The reason why nothing has been done.
    fn execute<'p>(&mut self, call: Call<'_>, piece: &'p mut [u8; PIECE]) -> Result<Answer<'p>, Refused>;

    /// The next events of the trace.
    fn events<'b>(&mut self, bytes: &'b mut [u8; trace::MESSAGE]) -> Option<Events<'b>>;

    /// Returns `true` if the image is about to end. Then it answers nothing more.
    fn leaves(&self) -> bool;

    /// Ends what only a computer at the port of control needs.
    fn hang_up(&mut self);
}

impl<B, D, M, L, const CHARACTERS: usize, const WIRES: usize> Calls
    for OnStation<'_, B, D, M, L, CHARACTERS, WIRES>
where
    B: Board,
    D: Device,
    M: Storage + AsRef<[u8]>,
    L: Links,
{
    fn execute<'p>(&mut self, call: Call<'_>, piece: &'p mut [u8; PIECE]) -> Result<Answer<'p>, Refused> {
        let now = B::past();
        match call {
            Call::Hello => return Ok(self.hello()),
            Call::State => return Ok(Answer::State(self.state(now))),
            Call::Read { row } => return self.value(now, row).map(Answer::Value),
            Call::ReadMany { row } => return Ok(self.values(now, row, piece)),
            Call::ReadWords { row, word } => return self.words(now, row, word, piece),
            Call::Preset { row, value } => self.preset(now, row, value)?,
            Call::Drive { pin, stimulus } => self.stimulate(now, pin, stimulus)?,
            Call::Pulse { pin, count, period, high } => {
                self.shell.inputs().pulse(now, Pin(pin), count, (period, high))?;
            }
            Call::Turn { encoder, counts, period } => {
                self.shell.inputs().turn(now, Encoder(encoder), counts, period)?;
            }
            Call::Fault { fault, on } => self.shell.inputs().fault(now, Fault(fault), on)?,
            Call::Power(power) => self.power(now, power),
            Call::Statistics => return Ok(Answer::Statistics(self.statistics())),
            Call::ReadMemory { offset } => return Ok(self.memory(offset, piece)),
            Call::WriteMemory { offset, bytes } => self.write_memory(offset, bytes)?,
            Call::Trace(on) => self.shell.outputs().trace().set(on),
            Call::Kind(number) => return Ok(Answer::Kind(B::kind(number))),
            Call::Become(kind) => self.become_kind(kind)?,
            Call::Bootloader => self.leave(B::boot_loader()?),
        }
        Ok(Answer::Done)
    }

    fn events<'b>(&mut self, bytes: &'b mut [u8; trace::MESSAGE]) -> Option<Events<'b>> {
        self.shell.outputs().trace().take(bytes)
    }

    fn leaves(&self) -> bool {
        self.leaves.is_some()
    }

    fn hang_up(&mut self) {
        self.shell.outputs().trace().set(false);
    }
}

impl<B, D, M, L, const CHARACTERS: usize, const WIRES: usize> OnStation<'_, B, D, M, L, CHARACTERS, WIRES>
where
    B: Board,
    D: Device,
    M: Storage + AsRef<[u8]>,
    L: Links,
{
    fn hello<'p>(&self) -> Answer<'p> {
        let spec = self.shell.device().spec();
        Answer::Hello(Hello {
            version: VERSION,
            kind: spec.kind,
            image: env!("CARGO_PKG_VERSION"),
            tables: fingerprint(spec),
            fast_boot: self.boot.fast,
            board: B::NAME,
        })
    }

    fn state(&mut self, now: Instant) -> State {
        let (mut high, mut open, mut driven) = (0, 0, 0);
        let pins = self.shell.inputs().pins().all();
        for pin in pins {
            let wave = self.shell.wave_level(pin).filter(|_| self.is_on);
            let own = match wave {
                Some(true) => Level::High,
                Some(false) => Level::Low,
                None => self.shell.outputs().level(pin),
            };
            let pins = self.shell.inputs().pins();
            let bit = 1_u64 << (pin.0 & 63);
            match pins.level(pin, own) {
                Level::High => high |= bit,
                Level::Float => open |= bit,
                Level::Low => {}
            }
            if pins.stimulus(pin) != Stimulus::Wire {
                driven |= bit;
            }
        }
        let (faults, motion) = (self.shell.inputs().faults(), self.motion(now));
        State { at: now.ticks(), powered: self.is_on, high, open, driven, faults, motion }
    }

    /// The register of a row, if this variant of the product has it.
    fn entry(&self, row: u16) -> Result<&'static Entry, Refused> {
        let spec = self.shell.device().spec();
        let entry = spec.registers.list.get(usize::from(row));
        entry.filter(|entry| entry.variants & spec.variant != 0).ok_or(Refused::Unknown)
    }

    fn value(&self, now: Instant, row: u16) -> Result<i64, Refused> {
        self.entry(row)?;
        Ok(self.shell.device().peek(self.shell.drive_time(now), row.into()))
    }

    fn values<'p>(&self, now: Instant, row: u16, piece: &'p mut [u8; PIECE]) -> Answer<'p> {
        let rows = self.shell.device().spec().registers.list.len();
        let (mut count, mut used) = (0, 0);
        for row in (usize::from(row)..rows).take(VALUES.into()) {
            let Some(room) = piece.get_mut(used..used + NUMBER) else { break };
            let value = self.shell.device().peek(self.shell.drive_time(now), row);
            used += postcard::to_slice(&value, room).map_or(0, |bytes| bytes.len());
            count += 1;
        }
        Answer::Values { row, count, bytes: piece.get(..used).unwrap_or_default() }
    }

    fn words<'p>(
        &self,
        now: Instant,
        row: u16,
        word: u16,
        piece: &'p mut [u8; PIECE],
    ) -> Result<Answer<'p>, Refused> {
        let shape = self.entry(row)?.shape;
        let Shape::Words(5..) = shape else { return Err(Refused::OutOfRange) };
        let at = self.shell.drive_time(now);
        let mut count = 0;
        for (word, place) in (word..shape.words()).zip(piece.as_chunks_mut().0) {
            *place = self.shell.device().peek_word(at, row.into(), word.into()).to_be_bytes();
            count += place.len();
        }
        Ok(Answer::Words(piece.get(..count).unwrap_or_default()))
    }

    fn preset(&mut self, now: Instant, row: u16, value: i64) -> Result<(), Refused> {
        self.entry(row)?;
        let mark = self.shell.outputs().trace().mark();
        self.note(now, &Event::Preset(row, value));
        let result = self.shell.poke(now, row.into(), value);
        if result.is_err() {
            self.shell.outputs().trace().rewind(mark);
        }
        if self.shell.outputs().has_failed() {
            self.power_off(now);
        }
        result.map_err(|error| match error {
            PresetError::NoSuchRegister => Refused::Unknown,
            PresetError::ReadOnly => Refused::ReadOnly,
            PresetError::OutOfRange => Refused::OutOfRange,
            PresetError::BadMemory => Refused::BadMemory,
            PresetError::Busy => Refused::Busy,
        })
    }

    fn stimulate(&mut self, now: Instant, pin: u8, stimulus: Stimulus) -> Result<(), Refused> {
        self.shell.inputs().drive(now, Pin(pin), stimulus)
    }

    fn power(&mut self, now: Instant, power: Power) {
        match power {
            Power::Off => self.power_off(now),
            Power::On => self.power_on(now),
            Power::Cycle => {
                self.power_off(now);
                self.power_on(now);
            }
            Power::Cut => self.shell.outputs().set_cut(true),
            Power::Keep => self.shell.outputs().set_cut(false),
        }
    }

    fn statistics(&mut self) -> Statistics {
        let failures = self.shell.failures();
        let outputs = self.shell.outputs();
        Statistics {
            line: convert::line(outputs.line()),
            lost_inputs: B::lost_inputs(),
            lost_events: outputs.trace().lost(),
            lost_characters: B::Uart::tap().map_or(0, crate::tap::Tap::lost),
            failures,
            slipped: SLIPPED.load(core::sync::atomic::Ordering::Relaxed),
            ..outputs.statistics()
        }
    }

    /// Stores the kind that the board is from its next start on. If the board is a drive of another kind now, it starts
    /// again (BOARD-18).
    fn become_kind(&mut self, kind: &str) -> Result<(), Refused> {
        let mut kinds = (0..).map_while(B::kind);
        if B::kind(0).is_some() && !kinds.any(|known| known == kind) {
            return Err(Refused::Unknown);
        }
        let restart = B::choose(kind)?;
        if kind != self.shell.device().spec().kind {
            self.leave(restart);
        }
        Ok(())
    }

    /// Switches the power off. The image ends when the computer has had time for the reply.
    fn leave(&mut self, leave: Leave) {
        // The store of a choice has taken some time.
        let now = B::past();
        self.power_off(now);
        self.leaves = Some((now + LINGER, leave));
    }

    fn memory<'p>(&mut self, offset: u16, piece: &'p mut [u8; PIECE]) -> Answer<'p> {
        let stored = self.shell.outputs().stored().get(usize::from(offset)..).unwrap_or_default();
        let mut count = 0;
        for (place, byte) in piece.iter_mut().zip(stored) {
            *place = *byte;
            count += 1;
        }
        Answer::Memory(piece.get(..count).unwrap_or_default())
    }

    fn write_memory(&mut self, offset: u16, bytes: &[u8]) -> Result<(), Refused> {
        if self.is_on {
            return Err(Refused::HasPower);
        }
        let outputs = self.shell.outputs();
        if usize::from(offset) + bytes.len() > outputs.stored().len() {
            return Err(Refused::Unknown);
        }
        outputs.memory().write(offset.into(), bytes).map_err(|_| Refused::Flash)
    }
}
