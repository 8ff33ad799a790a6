//! The drive of a board, for commands by name.

use std::sync::Arc;
use std::time::Duration;

use drivetwin_control::{Call, Level, PIECE, Power, Refused, State as BoardState, Statistics, Stimulus};
use drivetwin_firmware::device::{Encoder, Fault, Instant, Line, Pin, PresetError, Role, Spec};
use drivetwin_protocol::registers::Shape;
use drivetwin_protocol::time::TICKS_PER_SECOND;
use drivetwin_sim::bench::{self, Busy, Motion, PinStimulus, PowerAction};
use drivetwin_sim::catalog;
use drivetwin_sim::commands::{self, Refusal, State};
use drivetwin_sim::config::preset::Preset;
use drivetwin_sim::value::Value;
use fixed::types::I48F16;

use super::answer::{Answered, Failure};
use super::client::{Session, Shared};
use super::{flash_again, report};

/// Longest wait for a board that starts again.
const STARTED: Duration = Duration::from_secs(10);

/// The drive of a board, in one session.
pub struct Drive {
    shared: Arc<Shared>,
    session: Session,
    name: Arc<str>,
}

impl Drive {
    pub(super) fn new(shared: Arc<Shared>, session: Session, name: Arc<str>) -> Self {
        Self { shared, session, name }
    }

    /// Number of the session in which the drive is known.
    #[cfg(test)]
    pub(super) fn session_number(&self) -> u64 {
        self.session.number
    }

    /// The refusal of an answer that belongs to another call.
    fn confused(&self) -> Refusal {
        let again = flash_again(&self.session.board);
        Refusal::Away(format!("the board answers something else; {again}"))
    }

    /// A number of the protocol.
    fn number(&self, number: usize) -> Result<u16, Refusal> {
        u16::try_from(number).map_err(|_| self.confused())
    }

    fn ask(&self, call: Call<'_>) -> Result<Answered, Refusal> {
        self.answer(call).map_err(|failure| self.refusal(failure))
    }

    fn answer(&self, call: Call<'_>) -> Result<Answered, Failure> {
        self.shared.ask(self.session.number, call)
    }

    /// Makes a call that has no answer but that it is done.
    fn act(&self, call: Call<'_>) -> Result<(), Refusal> {
        match self.ask(call)? {
            Answered::Done => Ok(()),
            _ => Err(self.confused()),
        }
    }

    fn refusal(&self, failure: Failure) -> Refusal {
        let refused = match failure {
            Failure::Refused(refused) => refused,
            Failure::Away(sentence) => return Refusal::Away(sentence),
        };
        let name = &self.name;
        match refused {
            Refused::Driven => Busy.into(),
            Refused::NoPower => Refusal::Conflict(format!("{name} has no power")),
            Refused::HasPower => Refusal::Conflict(format!("{name} has power; switch it off first")),
            Refused::TooFast => Refusal::Invalid(
                "a board makes at most 20000 edges a second, in at most four trains and encoders at once"
                    .into(),
            ),
            Refused::NotHere => Refusal::Conflict("this board cannot do this".into()),
            Refused::Flash => Refusal::Conflict("the flash of the board does not take the data".into()),
            Refused::OutOfRange => Refusal::Invalid("the board does not take the value".into()),
            Refused::Busy => Refusal::Conflict(format!("{name} is busy; try again later")),
            Refused::Unknown | Refused::ReadOnly | Refused::BadMemory => {
                Refusal::Conflict("the board has no such thing, or does not let it be changed".into())
            }
        }
    }

    fn board_state(&self) -> Result<BoardState, Refusal> {
        match self.ask(Call::State)? {
            Answered::State(state) => Ok(state),
            _ => Err(self.confused()),
        }
    }

    /// Time of the board.
    ///
    /// # Errors
    /// The board cannot be reached.
    pub fn now(&self) -> Result<Instant, Refusal> {
        Ok(self.session.time(self.board_state()?.at))
    }

    /// Time of the board, if it answers within `span`.
    ///
    /// # Errors
    /// The board cannot be reached, or does not answer in time.
    pub(crate) fn now_within(&self, span: Duration) -> Result<Instant, Refusal> {
        match self.shared.ask_within(self.session.number, Call::State, span) {
            Ok(Answered::State(state)) => Ok(self.session.time(state.at)),
            Ok(_) => Err(self.confused()),
            Err(failure) => Err(self.refusal(failure)),
        }
    }

    /// Statistics of the board.
    pub(crate) fn statistics(&self) -> Result<Statistics, Refusal> {
        match self.ask(Call::Statistics)? {
            Answered::Statistics(statistics) => Ok(*statistics),
            _ => Err(self.confused()),
        }
    }

    /// Settings of the line of the first port, for instance `9600 8E1`.
    ///
    /// # Errors
    /// The board cannot be reached.
    pub fn line(&self) -> Result<String, Refusal> {
        Ok(of_first_port(&self.statistics()?).0.map_or_else(String::new, |line| line.to_string()))
    }

    /// Version of the board's image.
    pub(crate) fn image(&self) -> &str {
        &self.session.image
    }

    /// Returns true if the drive starts without its start-up delay.
    #[must_use]
    pub fn is_fast_boot(&self) -> bool {
        self.session.fast_boot
    }

    /// Kinds of drive that the board can be; only its own if its image is one kind.
    ///
    /// # Errors
    /// The board cannot be reached.
    pub fn kinds(&self) -> Result<Vec<String>, Refusal> {
        let mut kinds = Vec::new();
        for number in 0..=u8::MAX {
            match self.ask(Call::Kind(number))? {
                Answered::Kind(Some(kind)) => kinds.push(kind),
                _ => break,
            }
        }
        if kinds.is_empty() {
            kinds.push(self.session.spec.kind.to_owned());
        }
        Ok(kinds)
    }

    /// Makes the drive a new one: with an erased memory, without a cut of its power to come, causes of faults and stimuli at
    /// its pins, and with these registers. Saved registers are preset as if saved before power-on, the others after it. The power is on afterwards.
    ///
    /// # Errors
    /// The drive refuses a register, or the board cannot be reached.
    pub fn begin_anew(&mut self, presets: &[Preset]) -> Result<(), Refusal> {
        let spec = self.session.spec;
        let row = |preset: &Preset| spec.registers.rows.get(preset.row);
        let is_saved = |preset: &&Preset| row(preset).is_some_and(|row| row.saved != 0);
        self.act(Call::Power(Power::Off))?;
        self.act(Call::Power(Power::Keep))?;
        for (number, _) in (0..).zip(spec.faults) {
            self.act(Call::Fault { fault: number, on: false })?;
        }
        for (number, pin) in (0..).zip(spec.pins) {
            if !matches!(pin.role, Role::Output | Role::Led) {
                self.act(Call::Drive { pin: number, stimulus: Stimulus::Wire })?;
            }
        }
        commands::Drive::set_memory(self, &vec![0xFF; usize::from(spec.memory)])?;
        self.preset(presets.iter().filter(is_saved))?;
        self.act(Call::Power(Power::On))?;
        self.preset(presets.iter().filter(|preset| !is_saved(preset)))
    }

    fn preset<'a>(&mut self, presets: impl Iterator<Item = &'a Preset>) -> Result<(), Refusal> {
        for preset in presets {
            let spec = self.session.spec;
            let name = spec.registers.rows.get(preset.row).map_or("", |row| row.name);
            let old = if preset.is_half() { commands::Drive::peek(self, preset.row)? } else { 0 };
            commands::Drive::poke(self, preset.row, name, preset.onto(spec, old))?;
        }
        Ok(())
    }

    /// Makes the board a drive of this kind, and waits until it has started. A drive of this kind goes on.
    ///
    /// # Errors
    /// There is no such kind, the board cannot be it, or does not come back in time.
    pub fn choose(&self, kind: &str) -> Result<(), Refusal> {
        catalog::make(kind).map_err(Refusal::Unknown)?;
        let is_same = kind == self.session.spec.kind;
        if let Some(kept) = self.shared.kind().filter(|kept| *kept != kind) {
            return Err(Refusal::Conflict(format!(
                "{} stays of the kind {kept} while its bench runs; end the run and attach the board alone with drivetwin attach",
                self.name
            )));
        }
        match self.answer(Call::Become(kind)) {
            Ok(_) | Err(Failure::Refused(Refused::NotHere)) if is_same => return Ok(()),
            Ok(_) => self.shared.reconnect(),
            Err(Failure::Refused(Refused::Unknown | Refused::NotHere)) => {
                let kinds = self.kinds()?;
                return Err(Refusal::Conflict(match kinds.as_slice() {
                    [_] => format!(
                        "the image of this board is one kind only, {}; flash another image",
                        self.session.spec.kind
                    ),
                    kinds => format!("this board cannot be {kind}; it can be {}", kinds.join(", ")),
                }));
            }
            Err(failure @ Failure::Refused(_)) => return Err(self.refusal(failure)),
            // The board has started again before its answer came.
            Err(Failure::Away(_)) => {}
        }
        let session = self.shared.session_after(self.session.number, STARTED).map_err(Refusal::Away)?;
        if session.number == self.session.number || session.spec.kind != kind {
            return Err(Refusal::Away(format!("the board has not started again as {kind}")));
        }
        Ok(())
    }
}

/// Ticks of a period, at `hz` periods per second.
fn period(hz: f64) -> u64 {
    ((TICKS_PER_SECOND as f64 / hz).round() as u64).max(1)
}

impl commands::Drive for Drive {
    fn spec(&self) -> &'static Spec {
        self.session.spec
    }

    fn name(&self) -> &str {
        &self.name
    }

    fn state(&mut self) -> Result<State, Refusal> {
        let state = self.board_state()?;
        let spec = self.session.spec;
        let level = |(pin, _)| report::level(if pin < 64 { state.level(pin) } else { Level::Open });
        let motion = state.motion.map(|motion| Motion {
            position: motion.position,
            speed: I48F16::from_bits(motion.speed),
            moving: motion.moving,
            current_ma: motion.ma.unsigned_abs(),
            duty: motion.duty,
        });
        Ok(State {
            powered: state.powered,
            levels: (0..).zip(spec.pins).map(level).collect(),
            faults: (0..).zip(spec.faults).map(|(n, _)| n < 32 && state.faults >> n & 1 == 1).collect(),
            motion: spec.axes.first().map(|_| motion.unwrap_or_default()),
        })
    }

    fn peek(&mut self, row: usize) -> Result<i64, Refusal> {
        match self.ask(Call::Read { row: self.number(row)? })? {
            Answered::Value(value) => Ok(value),
            _ => Err(self.confused()),
        }
    }

    fn value(&mut self, row: usize) -> Result<Value, Refusal> {
        let value = match self.shape(row) {
            Shape::Words(5..) => 0,
            _ => self.peek(row)?,
        };
        self.shaped(row, value)
    }

    fn values(&mut self) -> Result<Vec<(&'static str, Value)>, Refusal> {
        let spec = self.session.spec;
        let mut all: Vec<i64> = Vec::new();
        while all.len() < spec.registers.rows.len() {
            match self.ask(Call::ReadMany { row: self.number(all.len())? })? {
                Answered::Values(row, values) if row == all.len() && !values.is_empty() => all.extend(values),
                _ => return Err(self.confused()),
            }
        }
        let value = |row: usize| self.shaped(row, all.get(row).copied().unwrap_or(0));
        spec.rows().map(|(row, of)| Ok((of.name, value(row)?))).collect()
    }

    fn poke(&mut self, row: usize, name: &str, value: i64) -> Result<(), Refusal> {
        let failure = match self.answer(Call::Preset { row: self.number(row)?, value }) {
            Ok(_) => return Ok(()),
            Err(failure) => failure,
        };
        let refused = match failure {
            Failure::Refused(Refused::Unknown) => PresetError::NoSuchRegister,
            Failure::Refused(Refused::ReadOnly) => PresetError::ReadOnly,
            Failure::Refused(Refused::OutOfRange) => PresetError::OutOfRange,
            Failure::Refused(Refused::BadMemory) => PresetError::BadMemory,
            Failure::Refused(Refused::Busy) => PresetError::Busy,
            other => return Err(self.refusal(other)),
        };
        Err(commands::not_preset(self.session.spec, row, name, refused))
    }

    fn set_pin(&mut self, Pin(pin): Pin, stimulus: PinStimulus) -> Result<(), Refusal> {
        let stimulus = match stimulus {
            PinStimulus::Low => Stimulus::Low,
            PinStimulus::High => Stimulus::High,
            // As on a bench, a pin that is let go has the level of its wire.
            PinStimulus::Open => Stimulus::Wire,
            PinStimulus::Millivolts(mv) => Stimulus::Millivolts(mv),
        };
        self.act(Call::Drive { pin, stimulus })
    }

    fn pulse(&mut self, Pin(pin): Pin, count: u32, hz: f64, duty: f64) -> Result<(), Refusal> {
        let period = period(hz).max(2);
        let high = ((period as f64 * duty).round() as u64).clamp(1, period - 1);
        self.act(Call::Pulse { pin, count, period, high })
    }

    fn turn(&mut self, Encoder(encoder): Encoder, counts: i32, hz: f64) -> Result<(), Refusal> {
        self.act(Call::Turn { encoder, counts, period: period(hz) })
    }

    fn set_fault(&mut self, Fault(fault): Fault, on: bool) -> Result<(), Refusal> {
        self.act(Call::Fault { fault, on })
    }

    fn power(&mut self, action: PowerAction) -> Result<(), Refusal> {
        self.act(Call::Power(match action {
            PowerAction::Off => Power::Off,
            PowerAction::On => Power::On,
            PowerAction::Cycle => Power::Cycle,
            PowerAction::Cut => Power::Cut,
        }))
    }

    fn memory(&mut self) -> Result<Vec<u8>, Refusal> {
        let size = usize::from(self.session.spec.memory);
        let mut memory = Vec::new();
        while memory.len() < size {
            match self.ask(Call::ReadMemory { offset: self.number(memory.len())? })? {
                Answered::Memory(bytes) if !bytes.is_empty() => memory.extend(bytes),
                _ => return Err(self.confused()),
            }
        }
        memory.truncate(size);
        Ok(memory)
    }

    fn set_memory(&mut self, bytes: &[u8]) -> Result<(), Refusal> {
        for (n, bytes) in bytes.chunks(PIECE).enumerate() {
            self.act(Call::WriteMemory { offset: self.number(n * PIECE)?, bytes })?;
        }
        Ok(())
    }
}

impl Drive {
    fn shape(&self, row: usize) -> Shape {
        self.session.spec.registers.list.get(row).map_or(Shape::U16, |entry| entry.shape)
    }

    /// The value of a register as users see it, whose first four words are `value`.
    fn shaped(&self, row: usize, value: i64) -> Result<Value, Refusal> {
        let shape = self.shape(row);
        let Shape::Words(count @ 5..) = shape else {
            return Ok(Value::of(self.session.spec.registers, shape, value));
        };
        let mut words: Vec<u16> = Vec::new();
        while words.len() < usize::from(count) {
            match self.ask(Call::ReadWords { row: self.number(row)?, word: self.number(words.len())? })? {
                Answered::Words(more) if !more.is_empty() => words.extend(more),
                _ => return Err(self.confused()),
            }
        }
        Ok(Value::with_words(shape, 0, |n| words.get(n).copied().unwrap_or(0)))
    }
}

/// Statistics of the first port of a board, and its line; `None` if the port has none.
pub(crate) fn of_first_port(of: &Statistics) -> (Option<Line>, bench::Statistics) {
    let line = report::line(of.line);
    let statistics = bench::Statistics {
        requests: of.requests.into(),
        refused: of.refused.into(),
        crc: of.crc.into(),
        gap: of.gap.into(),
        length: of.length.into(),
        spoiled: of.spoiled.into(),
        foreign: of.foreign.into(),
        starting: of.starting.into(),
        ..bench::Statistics::default()
    };
    (line, statistics)
}
