//! The I/O points: IO1 to IO4, the analogue input, the clock points IO7 and IO8, capture and trip at I/O 13,
//! and the filtered channels of a remote encoder.
//!
//! They do not know the drive. They queue events.
//!
//! A debounce timer that expires at the instant of an input is handled before the input. While the drive
//! starts, no filter delays a level: an input that is active when the drive is ready does not become active
//! then (MDRIVE-20).

mod analogue;
mod clock;
mod high_speed;
mod point;
mod remote;
#[cfg(test)]
mod tests;

use heapless::Deque;

use self::analogue::Analogue;
use self::clock::Clock;
use self::high_speed::HighSpeed;
use self::point::{Kind, Point, SetUp};
use self::remote::Remote;
use super::error::Error;
use super::motion::{self, Channel, Contact};
use super::registers::Reg;
use super::variables::Registers;
use super::{A, B, CAPTURE, INDEX, IO1, IO2, IO3, IO4, IO7, IO8};
use crate::device::{Context, Duration, Instant, Pin, Plan};
use drivetwin_protocol::time::TICKS_PER_SECOND;

const PINS: [Pin; 4] = [IO1, IO2, IO3, IO4];

const CONTACTS: [Contact; 5] =
    [Contact::Home, Contact::PlusLimit, Contact::MinusLimit, Contact::JogPlus, Contact::JogMinus];

/// Shortest pulses that the filters 0 to 9 let pass, in ns (MC 5-25, 5-26).
const MIN_PULSES: [u64; 10] = [50, 150, 200, 300, 500, 900, 1_700, 3_300, 6_500, 12_900];

/// Capacity of the event queue. One instant causes fewer events. Each of the four inputs causes its own event
/// and a trip, each contact one event, and there are a capture and three channels.
const EVENTS: usize = 20;

/// Events of the I/O for the rest of the drive.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Event {
    /// A contact of the motion became active (true) or inactive.
    Contact(Contact, bool),
    /// Input 1 to 4 became active: TI may trip on it.
    Active(u8),
    /// Go (G0): runs the program at address 1.
    Go,
    /// Stops motion and program.
    SoftStop,
    /// Pauses motion and program, or resumes them.
    Pause,
    /// Restarts the drive, as Ctrl-C does.
    Reset,
    /// The capture input became active.
    Capture,
    /// Level of a channel of a remote encoder; `None` if it is no longer driven.
    Channel(Channel, Option<bool>),
    /// Steps that the clock inputs request, with the clock ratio applied.
    Clock(i32),
}

/// State of the drive that outputs can show.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(super) struct StateFlags {
    pub(super) moving: bool,
    pub(super) fault: bool,
    pub(super) stall: bool,
    pub(super) changing: bool,
    pub(super) locked_rotor: bool,
    pub(super) positioning: bool,
    pub(super) hybrid: bool,
    pub(super) is_making_up: bool,
}

/// Settings of filters and pulses: present values of variables.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(super) struct Filters {
    /// Debounce times D1 to D4, in ms.
    debounce_ms: [u8; 4],
    /// D5: number of readings to average over.
    average: u8,
    /// Filters FC (capture) and FM (clock), 0 to 9.
    capture: u8,
    clock: u8,
    /// CW: width of output pulses, in units of 50 ns.
    pulse: u8,
    /// CM: true in clock mode. Clock ratio CR, in thousandths.
    clocked: bool,
    ratio: u16,
}

impl Filters {
    /// Settings in the registers.
    pub(super) fn of(bank: &Registers) -> Self {
        let byte = |reg| (bank.word(reg) & 0xFF) as u8;
        Self {
            debounce_ms: [Reg::D1, Reg::D2, Reg::D3, Reg::D4].map(byte),
            average: byte(Reg::D5),
            capture: byte(Reg::FC),
            clock: byte(Reg::FM),
            pulse: byte(Reg::CW),
            clocked: bank.word(Reg::CM) != 0,
            ratio: bank.word(Reg::CR),
        }
    }
}

impl Filters {
    const NONE: Self = Self {
        debounce_ms: [0; 4],
        average: 0,
        capture: 0,
        clock: 0,
        pulse: 0,
        clocked: false,
        ratio: 1_000,
    };

    /// Width of an output pulse: to the nearest tick, but never zero.
    fn width(&self) -> Duration {
        const PER_SECOND: u64 = 1_000_000_000 / 50;
        let ticks = (u64::from(self.pulse) * TICKS_PER_SECOND + PER_SECOND / 2) / PER_SECOND;
        Duration::from_ticks(ticks).max(Duration::TICK)
    }
}

/// All I/O points.
#[derive(Clone, Debug)]
pub(super) struct Io {
    points: [Point; 4],
    analogue: Analogue,
    clock: Clock,
    high_speed: HighSpeed,
    remote: Remote,
    filters: Filters,
    /// True while the drive starts.
    is_starting: bool,
    /// True while all set-ups are being loaded.
    is_loading: bool,
    /// The contacts that were last reported as active, in the order of [`CONTACTS`].
    reported: [bool; 5],
    events: Deque<Event, EVENTS>,
}

impl Io {
    /// Set-ups of the factory, and nothing drives the pins.
    pub(super) const OPEN: Self = Self {
        points: [Point::OPEN; 4],
        analogue: Analogue::ZERO,
        clock: Clock::OPEN,
        high_speed: HighSpeed::OPEN,
        remote: Remote::OPEN,
        filters: Filters::NONE,
        is_starting: false,
        is_loading: false,
        reported: [false; 5],
        events: Deque::new(),
    };

    /// Resets all set-ups to the factory's, at power-on (`whole`) or a restart. At power-on the levels of all
    /// inputs follow as events; at a restart the levels stay.
    pub(super) fn power_on(&mut self, at: Instant, whole: bool, out: &mut dyn Context) {
        if whole {
            *self = Self { is_starting: true, ..Self::OPEN };
            return;
        }
        (self.filters, self.is_starting) = (Filters::NONE, true);
        self.analogue.restart();
        self.clock.restart(at, out);
        self.high_speed.restart(at, out);
        self.begin_load();
        self.end_load(at, out);
        self.reported = [false; 5];
        self.events.clear();
    }

    /// Ends the start of the drive: from now on the filters apply.
    pub(super) fn ready(&mut self) {
        self.is_starting = false;
    }

    /// Begins to load all set-ups together, up to [`Self::end_load`].
    pub(super) fn begin_load(&mut self) {
        self.is_loading = true;
        for point in &mut self.points {
            point.set_up(SetUp::FACTORY);
        }
    }

    /// Ends the loading. An input that is active now counts as if it had been active before. So a switch that
    /// is closed already starts, stops or resets nothing.
    pub(super) fn end_load(&mut self, at: Instant, out: &mut dyn Context) {
        self.is_loading = false;
        for (point, pin) in self.points.iter_mut().zip(PINS) {
            point.load(at, pin, out);
        }
        self.report_contacts();
    }

    /// Sets up S1 to S4 (`n` 1 to 4): type, active state, sinking or sourcing. An input is inactive until it
    /// has settled. If it is active then, this counts as an activation.
    ///
    /// # Errors
    /// Error 6 if another point has the type, 8 for the type, 10 for `n`, 21 for the other values.
    pub(super) fn set_up(
        &mut self,
        at: Instant,
        n: u8,
        values: [u16; 3],
        out: &mut dyn Context,
    ) -> Result<(), Error> {
        let set_up = SetUp::of(values)?;
        let place = Self::place(n);
        let taken = |(other, point): (usize, &Point)| other != place && point.kind() == set_up.kind;
        if set_up.kind.is_dedicated() && self.points.iter().enumerate().any(taken) {
            return Err(Error::TypeTaken);
        }
        let (debounce, is_loading) = (self.debounce(place), self.is_loading);
        let Some((point, pin)) = self.point(n) else { return Err(Error::IllegalIo) };
        let was_high = point.level();
        if point.set_up(set_up) && !is_loading {
            let became_active = point.start(at, pin, debounce, out);
            self.report(place, became_active || was_high && set_up.resets_when_high());
        }
        Ok(())
    }

    /// Sets up S5: type 9 or 10, range.
    ///
    /// # Errors
    /// Error 8 for the type, 21 for the range.
    pub(super) fn set_up_analogue(&mut self, at: Instant, values: [u16; 2]) -> Result<(), Error> {
        self.analogue.set_up(at, values)
    }

    /// Sets up S7 or S8 (`n` 7 or 8): clock type, active state.
    ///
    /// # Errors
    /// Error 11 for the type, 21 for the state.
    pub(super) fn set_up_clock(
        &mut self,
        at: Instant,
        n: u8,
        values: [u16; 2],
        out: &mut dyn Context,
    ) -> Result<(), Error> {
        self.clock.set_up(at, if n == 7 { IO7 } else { IO8 }, values, out)
    }

    /// Sets up S13: type 60 or 61, active state.
    ///
    /// # Errors
    /// Error 8 for the type, 21 for the state.
    pub(super) fn set_up_capture(
        &mut self,
        at: Instant,
        values: [u16; 2],
        out: &mut dyn Context,
    ) -> Result<(), Error> {
        self.high_speed.set_up(at, values, out)
    }

    /// Sets D1 to D4 in ms, D5, FC, FM, CW, CM, CR. A level that is already being debounced keeps its old
    /// filter time.
    pub(super) fn set_filters(&mut self, at: Instant, filters: Filters, out: &mut dyn Context) {
        self.filters = filters;
        self.analogue.set_average(at, filters.average);
        self.clock.set(at, filters.clocked, filters.ratio, out);
    }

    /// Writes output `n`, 1 to 4.
    ///
    /// # Errors
    /// Error 9: the point is an input, or has a type.
    pub(super) fn write(
        &mut self,
        at: Instant,
        n: u8,
        active: bool,
        out: &mut dyn Context,
    ) -> Result<(), Error> {
        let debounce = self.debounce(Self::place(n));
        let Some((point, pin)) = self.point(n) else { return Err(Error::IllegalIo) };
        point.write(at, pin, active, debounce, out)
    }

    /// I1 to I4, O1 to O4: true if I/O `n` is active.
    pub(super) fn is_active(&self, n: u8) -> bool {
        self.points.get(Self::place(n)).is_some_and(Point::is_active)
    }

    /// General purpose outputs, one bit each.
    pub(super) fn outputs(&self) -> u8 {
        bits(self.points.map(|point| point.kind() == Kind::Output))
    }

    /// IL: levels after debouncing.
    pub(super) fn levels(&self) -> u8 {
        bits(self.points.map(|point| point.debounced_level()))
    }

    /// IN: levels at the pins.
    pub(super) fn raw_levels(&self) -> u8 {
        bits(self.points.map(|point| point.level()))
    }

    /// I5: present reading of the analogue input.
    pub(super) fn analogue(&self, at: Instant) -> u16 {
        self.analogue.value(at)
    }

    /// State of the input that has the type of this contact: true if active; `None` if there is no such
    /// input.
    pub(super) fn contact(&self, contact: Contact) -> Option<bool> {
        let point = self.points.iter().find(|point| point.kind() == Kind::Contact(contact))?;
        Some(point.is_active())
    }

    /// Settings of the motion: those of the variables, and those of the inputs.
    pub(super) fn motion_settings(&self, registers: &Registers) -> motion::Settings {
        motion::Settings::of(registers).with_inputs(self.home_debounce_ms(), self.follows_clock())
    }

    /// Debounce time of the home switch, in ms; 0 if there is none.
    fn home_debounce_ms(&self) -> u8 {
        let is_home = |point: &Point| point.kind() == Kind::Contact(Contact::Home);
        let place = self.points.iter().position(is_home);
        place.and_then(|place| self.filters.debounce_ms.get(place)).copied().unwrap_or(0)
    }

    /// Returns true if the motor follows clock inputs: CM is 1, and S7 and S8 are inputs.
    fn follows_clock(&self) -> bool {
        self.clock.follows()
    }

    /// Returns true if clock outputs need the motion's plan, though it has not changed.
    pub(super) fn wants_plan(&self) -> bool {
        self.clock.wants_plan()
    }

    /// Makes clock outputs follow the steps of a new plan.
    pub(super) fn plan(&mut self, at: Instant, plan: &Plan, out: &mut dyn Context) {
        self.clock.plan(at, plan, self.filters.width(), out);
    }

    /// Updates the outputs that show a state of the drive.
    pub(super) fn update_outputs(&mut self, at: Instant, flags: StateFlags, out: &mut dyn Context) {
        let debounces = [0, 1, 2, 3].map(|place| self.debounce(place));
        for ((point, pin), debounce) in self.points.iter_mut().zip(PINS).zip(debounces) {
            point.update_output(at, pin, flags, debounce, out);
        }
    }

    /// Makes a pulse at the trip output because of a trip on position, if there is a trip output.
    pub(super) fn pulse(&mut self, at: Instant, out: &mut dyn Context) {
        self.high_speed.pulse(at, self.filters.width(), out);
    }

    /// Sets the level of a pin.
    pub(super) fn edge(&mut self, at: Instant, pin: Pin, high: bool, out: &mut dyn Context) {
        self.timeout(at, out);
        match pin {
            IO7 | IO8 => self.clock.sample(at, pin, high, self.min_pulse(self.filters.clock)),
            CAPTURE => {
                if self.high_speed.sample(at, high, self.min_pulse(self.filters.capture)) {
                    self.push(Event::Capture);
                }
            }
            _ => match channel(pin) {
                Some(channel) => self.sample_channel(at, channel, Some(high)),
                None => self.sample(at, pin, Some(high)),
            },
        }
    }

    /// Marks a pin as open.
    pub(super) fn opened(&mut self, at: Instant, pin: Pin, out: &mut dyn Context) {
        self.timeout(at, out);
        match channel(pin) {
            Some(channel) => self.sample_channel(at, channel, None),
            None => self.sample(at, pin, None),
        }
    }

    /// Sets the voltage of the analogue input, in mV; for a current, the voltage across 250 Ω.
    pub(super) fn voltage(&mut self, at: Instant, mv: i32) {
        self.analogue.sample(at, mv);
    }

    /// Takes the oldest event, or the steps that the clock inputs request.
    pub(super) fn next_event(&mut self) -> Option<Event> {
        self.events.pop_front().or_else(|| self.clock.take_clock_steps().map(Event::Clock))
    }

    pub(super) fn deadline(&self) -> Instant {
        let fast = self.clock.deadline().min(self.high_speed.deadline()).min(self.remote.deadline());
        self.points.iter().fold(fast, |first, point| first.min(point.deadline()))
    }

    pub(super) fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        if at < self.deadline() {
            return;
        }
        if self.high_speed.timeout(at, out) {
            self.push(Event::Capture);
        }
        self.clock.timeout(at, self.filters.width(), out);
        for (channel, level) in self.remote.timeout(at) {
            self.push(Event::Channel(channel, Some(level)));
        }
        for place in 0..self.points.len() {
            let became_active = self.points.get_mut(place).is_some_and(|point| point.timeout(at));
            self.report(place, became_active);
        }
    }

    /// Debounce time of I/O 1 to 4.
    fn debounce(&self, place: usize) -> Duration {
        let ms = self.filters.debounce_ms.get(place).filter(|_| !self.is_starting);
        Duration::millis(ms.copied().unwrap_or(0).into())
    }

    /// Time for which a level must last with a value of FC or FM: the pulse in whole ticks, rounded up.
    fn min_pulse(&self, filter: u8) -> Duration {
        let ns = MIN_PULSES.get(usize::from(filter)).filter(|_| !self.is_starting).copied().unwrap_or(0);
        Duration::from_ticks((ns * TICKS_PER_SECOND).div_ceil(1_000_000_000))
    }

    /// Index of I/O `n`, 1 to 4.
    fn place(n: u8) -> usize {
        usize::from(n.wrapping_sub(1))
    }

    fn point(&mut self, n: u8) -> Option<(&mut Point, Pin)> {
        self.points.iter_mut().zip(PINS).nth(Self::place(n))
    }

    fn sample(&mut self, at: Instant, pin: Pin, outside: Option<bool>) {
        let Some(place) = PINS.iter().position(|&known| known == pin) else { return };
        let debounce = self.debounce(place);
        let became_active =
            self.points.get_mut(place).is_some_and(|point| point.sample(at, outside, debounce));
        self.report(place, became_active);
    }

    /// Sets the level of a channel of a remote encoder; `None` if nothing drives it. FM filters it, too (MC
    /// 5-26).
    fn sample_channel(&mut self, at: Instant, channel: Channel, level: Option<bool>) {
        if self.remote.sample(at, channel, level, self.min_pulse(self.filters.clock)) {
            self.push(Event::Channel(channel, level));
        }
    }

    /// Queues the events of a change at a point.
    fn report(&mut self, place: usize, became_active: bool) {
        self.report_contacts();
        let kind = self.points.get(place).map(Point::kind).filter(|_| became_active);
        let Some(kind) = kind else { return };
        if let Kind::Command(event) = kind {
            self.push(event);
        }
        self.push(Event::Active((place as u8).wrapping_add(1)));
    }

    /// Queues an event for each contact whose state differs from the last one reported.
    fn report_contacts(&mut self) {
        for (place, contact) in CONTACTS.into_iter().enumerate() {
            let active = self.contact(contact) == Some(true);
            let Some(reported) = self.reported.get_mut(place) else { return };
            if core::mem::replace(reported, active) != active {
                self.push(Event::Contact(contact, active));
            }
        }
    }

    fn push(&mut self, event: Event) {
        let queued = self.events.push_back(event);
        debug_assert!(
            queued.is_ok(),
            "the drive takes events after each thing that happens, each line of a message, too"
        );
    }
}

/// Channel of a remote encoder that is at this pin, if any.
fn channel(pin: Pin) -> Option<Channel> {
    match pin {
        A => Some(Channel::A),
        B => Some(Channel::B),
        INDEX => Some(Channel::Index),
        _ => None,
    }
}

/// Returns true if only a Hybrid has this type of I/O 1 to 4.
pub(super) fn is_of_hybrid(kind: u16) -> bool {
    Kind::of(kind).is_some_and(Kind::is_of_hybrid)
}

/// Packs levels into bits, the first one lowest.
fn bits(levels: [bool; 4]) -> u8 {
    levels.iter().rev().fold(0, |bits, &level| bits << 1 | u8::from(level))
}
