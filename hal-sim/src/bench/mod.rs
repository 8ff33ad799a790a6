//! A bench of drives on virtual time.
//!
//! The resolution is one tick of 62.5 ns. An output of a drive reaches other drives one tick later at the
//! earliest, so there is no loop without delay. Events of one instant have a fixed order: by kind (power,
//! faults, pins, lines, deadlines), then by the name of the drive, then by the order in which they were
//! scheduled. Therefore the order in which drives are added makes no difference, and the
//! [trace](Bench::trace) replays exactly.
//!
//! Time advances from event to event. A tournament tree holds the next deadline of each drive and a heap
//! holds scheduled events; only the drive that is due is called. Step pulses and edges of waves become events
//! only where a [wire](Bench::wire) is connected, and only the next edge is scheduled. Elsewhere a whole move
//! is one event.
//!
//! ```
//! use drivetwin_firmware::device::{Axis, Duration, Instant};
//! use drivetwin_firmware::md3::Md3;
//! use drivetwin_protocol::modbus::rtu;
//! use drivetwin_sim::bench::Bench;
//!
//! let mut bench = Bench::new();
//! let drive = bench.add::<Md3>("x");
//! // The MD3 ignores requests while it starts, for 2.5 s.
//! bench.run_until(Instant::ZERO + Duration::secs(3));
//! // Write 1, Move, to MotionControl: 10,000 steps by default.
//! let request = rtu::write(1, 0x11, 1);
//! assert_eq!(bench.ask(drive, &request), &request[..]);
//! bench.run_until(bench.now() + Duration::secs(10));
//! assert_eq!(bench.motion(drive, Axis(0)).position, 10_000);
//! ```

mod arbitration;
mod clients;
mod early_requests;
mod elsewhere;
mod events;
mod line_faults;
mod lines;
mod motors;
mod pin_wires;
mod received;
pub mod scenario;
mod shaft_sensors;
mod stimulus;
mod tcp_clients;
mod tcp_faults;
#[cfg(test)]
mod tests;
mod transmit;

use std::collections::{BTreeMap, HashMap};
use std::fmt;
use std::sync::Arc;

use drivetwin_firmware::device::{Device, Duration, Instant, Port, PresetError, Spec};

pub use crate::ids::{Bus, Client, DriveId};
use crate::line::{Clients, LineMode, SerialLine};
use crate::record::capture::Capture;
pub use crate::record::early::{EarlyCause, EarlyRequest, EarlyRequests};
pub use crate::record::requests::{RequestStatistics, StartingRequests};
use crate::record::trace::{self, InputRecord, Power, Retention, Trace};
use crate::scheduler::{Event, EventKey, Phase, Queue, Tournament};
use crate::slot::{CallContext, Outputs, Slot, WholeFrame};
pub use crate::slot::{MOST_CONNECTIONS, Motion, PersistFn, PinStimulus, Statistics};
use elsewhere::{Reported, Waits};
use events::{EventKind, Heard};
use motors::MotorSlot;
pub use motors::{Motor, MotorModel, ShaftState};
use pin_wires::PinWire;
pub use pin_wires::{StepOutput, Wire, WireOutput};
pub use received::{Accesses, Counts, News, OwnNews, Received, ReceivedMessage, Receiver, SentMessage};
use scenario::Playing;
pub use shaft_sensors::{CYCLES_PER_REV, Closed, FURTHEST_REV};
pub use stimulus::{ENCODER_HZ, PULSE_HZ};
use tcp_clients::Connections;
pub use tcp_clients::{ConnectError, Ended, Outlet};

/// Settings of a bench, fixed when it is created ([`Bench::with`]).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Settings {
    /// Seed of all random choices: the same seed and the same calls give the same trace. Default: 1.
    pub seed: u64,
    /// Timing of characters on serial lines. Default: [`LineMode::Timed`].
    pub line: LineMode,
    /// Longest wait for the rest of a partial frame of a client, in bench time. Default: 20 ms.
    pub frame_timeout: Duration,
    /// Retention of the [trace](Bench::trace). Default: a ring of 64 MiB.
    pub trace: Retention,
    /// Retention of the [frames](Bench::capture) on the lines. Default: none.
    pub capture: Retention,
    /// True to record the motion of brush and brushless motors in the trace, for waveforms. The motion of
    /// stepper motors is in the trace anyway, as plans. Default: false.
    pub shafts: bool,
    /// True to record the outcomes of messages in the trace, for waveforms. Default: false.
    pub outcomes: bool,
    /// True if drives and lines keep [journals](Bench::received). Default: true.
    pub journals: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            seed: 1,
            line: LineMode::Timed,
            frame_timeout: Duration::millis(20),
            trace: Retention::default(),
            capture: Retention::Off,
            shafts: false,
            outcomes: false,
            journals: true,
        }
    }
}

/// Options of a drive for [`Bench::add_with`]; the default is a factory-new drive.
#[derive(Default)]
pub struct Setup {
    /// True to skip the start-up delay of the drive.
    pub boot_fast: bool,
    /// Content of the non-volatile memory, truncated or padded with `0xFF` to its size. `None`: erased memory, as a
    /// factory-new drive has.
    pub memory: Option<Vec<u8>>,
    /// Function that is called for each store to the memory, for instance to write a file.
    pub persist: Option<PersistFn>,
    /// Registers to preset: row of the register map, value. Saved registers are written to the memory before the first
    /// power-on; others are set after every power-on.
    pub presets: Vec<(usize, i64)>,
    /// True if the drive turns a motor of the bench ([`attach_motor`](Bench::attach_motor)) instead of its
    /// internal motor model. Later changes of its motor registers then affect only the drive's control, not
    /// the motor.
    pub external_motor: bool,
}

/// Reason why a drive cannot be added. The bench is then unchanged.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum AddError {
    /// The name is not valid. A valid name is one word without dots, does not begin with a digit, `#`, `<`, `>` or
    /// `"`, and is not `end`.
    Name(String),
    /// A drive, a shared line or a motor has that name already.
    Taken(String),
    /// A preset is refused.
    Preset {
        /// Row of the register map.
        row: usize,
        /// Reason.
        why: PresetError,
    },
}

impl fmt::Display for AddError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Name(name) => {
                write!(f, "\"{name}\" is not a valid name for a drive: use one word without dots")
            }
            Self::Taken(name) => write!(f, "the name {name} is in use already"),
            Self::Preset { row, why } => write!(f, "the preset of row {row} is refused: {why:?}"),
        }
    }
}

impl std::error::Error for AddError {}

/// Error: a pulse train or an encoder already drives that pin.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Busy;

impl fmt::Display for Busy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a pulse train or an encoder drives that pin already")
    }
}

impl std::error::Error for Busy {}

/// Change of a drive's power, for [`Bench::power`].
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum PowerAction {
    /// Power off.
    Off,
    /// Power on.
    On,
    /// Power off, and on again one tick later.
    Cycle,
    /// Power fails in the middle of the next save, and stays off.
    Cut,
}

/// State of [`Bench::continue_idle_run`] between two calls.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct IdleRun {
    /// Time by which scheduled changes of pins and power have arrived and waits for partial frames have
    /// ended.
    inputs_due: Instant,
}

/// Test bench: drives, serial lines, motors, wires and clients on one virtual clock.
///
/// [Add](Self::add) drives. Time [advances](Self::run_until) on request only. Tests [send
/// requests](Self::ask), [drive pins](Self::set_pin) and read registers, pins and motion. The [module](self)
/// has an example. A bench may move to another thread.
pub struct Bench {
    settings: Settings,
    now: Instant,
    slots: Vec<Slot>,
    /// Names of drives, shared lines and motors; with the handle if the name belongs to a drive.
    names: HashMap<String, Option<DriveId>>,
    /// Slots sorted by name; `ranks` has the position of each slot in this order.
    order: Vec<u32>,
    ranks: Vec<u32>,
    deadlines: Tournament,
    /// True if `order`, `ranks` and `deadlines` are up to date.
    indexed: bool,
    /// True to schedule an event for each drive of a line, for a test that the traces are equal.
    #[cfg(test)]
    one_by_one: bool,
    scheduled: Queue<EventKind>,
    /// Erased memories by their size; drives share them.
    erased: BTreeMap<u16, Arc<[u8]>>,
    /// Wires between pins.
    wires: Vec<PinWire>,
    /// Motors, and the rank of each motor.
    motors: Vec<MotorSlot>,
    motor_ranks: Vec<u32>,
    buses: Vec<SerialLine>,
    /// Number of lines that serve a client, plus inputs that are scheduled on TCP connections.
    busy: usize,
    clients: Clients,
    /// Clients of TCP ports.
    connections: Connections,
    /// Number of the last client.
    last_client: u32,
    /// Number of arrivals of bytes from clients so far; defines the order of arrival.
    arrivals: u64,
    /// Time by which the bytes of a client that are sent now were sent at the latest; now, if it is earlier.
    arrived_by: Instant,
    /// True if the silence before a request is not judged.
    silence_is_free: bool,
    /// Number of requests on all lines that were too early.
    early_count: u64,
    /// Number of requests to all drives that were starting.
    starting_count: u64,
    /// Outputs of the device that was called last.
    outputs: Outputs,
    trace: Trace,
    capture: Capture,
    /// Scenarios that are played, or that have ended.
    scenarios: Vec<Playing>,
    /// Drives that are elsewhere.
    reported: BTreeMap<DriveId, Reported>,
    /// Recordings that wait for reports of these drives; `None` if they do not wait.
    waits: Option<Waits>,
}

impl Default for Bench {
    fn default() -> Self {
        Self::new()
    }
}

/// Adding and finding drives.
impl Bench {
    /// An empty bench at [`Instant::ZERO`], with default [`Settings`].
    #[must_use]
    pub fn new() -> Self {
        Self::with(Settings::default())
    }

    /// An empty bench at [`Instant::ZERO`], with these settings.
    #[must_use]
    pub fn with(settings: Settings) -> Self {
        Self {
            settings,
            now: Instant::ZERO,
            slots: Vec::new(),
            names: HashMap::new(),
            order: Vec::new(),
            ranks: Vec::new(),
            deadlines: Tournament::new(&[]),
            indexed: true,
            #[cfg(test)]
            one_by_one: false,
            scheduled: Queue::default(),
            erased: BTreeMap::new(),
            wires: Vec::new(),
            motors: Vec::new(),
            motor_ranks: Vec::new(),
            buses: Vec::new(),
            busy: 0,
            clients: Clients::default(),
            connections: Connections::default(),
            last_client: 0,
            arrivals: 0,
            arrived_by: Instant::ZERO,
            silence_is_free: false,
            early_count: 0,
            starting_count: 0,
            outputs: Outputs::default(),
            trace: Trace::new(settings.seed, settings.trace),
            capture: Capture::new(settings.capture),
            scenarios: Vec::new(),
            reported: BTreeMap::new(),
            waits: None,
        }
    }

    /// Adds a device to the bench and powers it on now.
    ///
    /// # Panics
    /// If the name is not valid or is taken.
    pub fn add<D: Device + Default + 'static>(&mut self, name: &str) -> DriveId {
        match self.add_with(name, Box::new(D::default()), Setup::default()) {
            Ok(drive) => drive,
            Err(error) => panic!("{error}"),
        }
    }

    /// Adds a device to the bench and powers it on now. Each of its serial ports gets its own line.
    ///
    /// # Errors
    /// The name is not valid or taken, or the drive refuses a preset.
    pub fn add_with(
        &mut self,
        name: &str,
        device: Box<dyn Device>,
        setup: Setup,
    ) -> Result<DriveId, AddError> {
        if !trace::is_name(name) {
            return Err(AddError::Name(name.to_owned()));
        }
        if self.is_taken(name) {
            return Err(AddError::Taken(name.to_owned()));
        }
        let index = u32::try_from(self.slots.len()).expect("a bench has room for four billion drives");
        let Setup { boot_fast, memory, persist, presets, external_motor } = setup;
        let spec = device.spec();
        let saved = |row: usize| spec.registers.rows.get(row).is_some_and(|row| row.saved != 0);
        let (now, mark) = (self.now, self.trace.position());
        let Settings { seed, journals, .. } = self.settings;
        let memory = self.new_memory(memory, spec.memory);
        let mut slot = Slot::new(index, name, device, seed, boot_fast, memory, persist);
        if !journals {
            slot.state.reception.switch_off();
        }
        if external_motor {
            slot.detach_motor();
        }
        let external_motor = slot.halls.is_some();
        let mut context = call_context(&mut self.trace, &mut self.outputs, self.settings);
        let mut result = Ok(());
        for &(row, value) in presets.iter().filter(|(row, _)| saved(*row)) {
            result = result.and_then(|()| {
                slot.preset(now, row, value, &mut context).map_err(|why| AddError::Preset { row, why })
            });
        }
        // The trace contains the memory after these presets, so their stores are not recorded.
        context.trace.rewind(mark);
        let memory = Arc::clone(&slot.state.memory);
        if result.is_ok() {
            slot.presets = presets.into_iter().filter(|(row, _)| !saved(*row)).collect();
            slot.power_on(now, &mut context);
            result = slot.preset_again(now, &mut context).map_err(|(row, why)| AddError::Preset { row, why });
        }
        if let Err(error) = result {
            context.trace.rewind(mark);
            self.outputs.clear();
            return Err(error);
        }
        slot.record_detached_motor();
        self.trace.drives.push(trace::TraceDrive {
            name: name.to_owned(),
            spec,
            boot_fast,
            fast_line: self.settings.line == LineMode::Fast,
            external_motor,
            elsewhere: false,
            turns_motor: slot.turns_motor(),
            from: now,
            memory,
        });
        for (port, serial) in (0..).map(Port).zip(spec.ports) {
            if serial.line.is_some() {
                self.buses.push(SerialLine::own(
                    self.settings.seed,
                    name,
                    serial.name,
                    (DriveId(index), port),
                ));
                slot.set_bus(port, self.buses.len() - 1);
            }
        }
        self.slots.push(slot);
        self.names.insert(name.to_owned(), Some(DriveId(index)));
        self.indexed = false;
        self.finish_call(index);
        Ok(DriveId(index))
    }

    /// The content of a memory of `size` bytes, for a drive that is added.
    fn new_memory(&mut self, content: Option<Vec<u8>>, size: u16) -> Arc<[u8]> {
        let filled = |mut content: Vec<u8>| {
            content.resize(usize::from(size), 0xFF);
            Arc::from(content)
        };
        match content {
            Some(content) => filled(content),
            None => Arc::clone(self.erased.entry(size).or_insert_with(|| filled(Vec::new()))),
        }
    }

    /// Sets registers that are not saved, now and after every power-on. These presets replace those of
    /// [`Setup::presets`]. At power-on the new presets are applied after the initial levels of the pins. The
    /// presets of [`Setup`] are applied before these levels, because no wire is connected yet.
    ///
    /// # Errors
    /// The drive refuses a preset. The presets before it have been applied.
    pub fn preset(&mut self, drive: DriveId, presets: Vec<(usize, i64)>) -> Result<(), AddError> {
        self.run_until(self.now);
        let mut context = call_context(&mut self.trace, &mut self.outputs, self.settings);
        let slot = &mut self.slots[drive.0 as usize];
        slot.presets = presets;
        let result = slot.preset_again(self.now, &mut context);
        self.finish_call(drive.0);
        result.map_err(|(row, why)| AddError::Preset { row, why })
    }

    /// All drives, in the order in which they were added.
    pub fn drives(&self) -> impl ExactSizeIterator<Item = DriveId> + use<> {
        (0..self.trace.drives.len() as u32).map(DriveId)
    }

    /// Description of a drive: its kind, ports, pins, axes, faults and registers.
    #[must_use]
    pub fn spec(&self, drive: DriveId) -> &'static Spec {
        self.at(drive).spec
    }

    /// The name of a drive, as given to [`add`](Self::add).
    #[must_use]
    pub fn name(&self, drive: DriveId) -> &str {
        &self.at(drive).name
    }

    /// The drive of that name, if there is one.
    #[must_use]
    pub fn find_drive(&self, name: &str) -> Option<DriveId> {
        self.names.get(name).copied().flatten()
    }

    /// Returns true if a drive, a shared line or a motor has that name: all three share one list of names.
    /// The line of a single port is not in the list, because its name has a dot and no other name has one.
    #[must_use]
    pub fn is_taken(&self, name: &str) -> bool {
        self.names.contains_key(name)
    }

    /// Numbers that change when a drive, line, motor or wire is added, or when a board becomes a drive of another kind.
    #[must_use]
    pub fn shape(&self) -> [usize; 5] {
        let generation = self.trace.generation() as usize;
        [generation, self.slots.len(), self.buses.len(), self.motors.len(), self.wire_count()]
    }

    /// Record of all inputs and outputs of the drives, as far as [`Settings::trace`] retains it.
    #[must_use]
    pub fn trace(&self) -> &Trace {
        &self.trace
    }

    /// Marks all events of the [trace](Self::trace) as written to a file, so that [`Retention::Written`] may
    /// drop them.
    pub fn mark_written(&mut self) {
        self.trace.mark_written();
    }

    /// Frames on the lines and TCP connections, as far as [`Settings::capture`] retains them.
    #[must_use]
    pub fn capture(&self) -> &Capture {
        &self.capture
    }

    fn at(&self, drive: DriveId) -> &Slot {
        &self.slots[drive.0 as usize]
    }

    fn at_mut(&mut self, drive: DriveId) -> &mut Slot {
        &mut self.slots[drive.0 as usize]
    }
}

/// Time of the bench.
impl Bench {
    /// Present bench time.
    #[must_use]
    pub fn now(&self) -> Instant {
        self.now
    }

    /// Time of the next event, or at which a client can next read a character; [`Instant::NEVER`] if nothing
    /// is scheduled.
    #[must_use]
    pub fn next(&self) -> Instant {
        let readable = if self.connections.readable().next().is_some() { self.now } else { Instant::NEVER };
        self.next_event().min(self.clients.due()).min(readable)
    }

    fn next_event(&self) -> Instant {
        let scheduled = self.scheduled.first().map_or(Instant::NEVER, |key| key.at);
        let deadline = if self.indexed {
            self.deadlines.first().0
        } else {
            self.slots.iter().map(Slot::deadline).min().unwrap_or(Instant::NEVER)
        };
        scheduled.min(deadline)
    }

    /// Runs the bench up to and including `at`. Time never goes back: if `at` is in the past, only events
    /// that are due now are handled. With [`Instant::NEVER`] the bench runs until no event is left.
    pub fn run_until(&mut self, at: impl Into<Instant>) {
        let at = at.into();
        self.index();
        while self.handle_next(at) {}
        self.arrive(at);
    }

    /// Runs like [`run_until`](Self::run_until), but handles at most `most` events, so that the caller can stop. Returns
    /// true if the bench has arrived at `at`. The number of calls makes no difference.
    pub fn run_some(&mut self, at: impl Into<Instant>, most: usize) -> bool {
        let at = at.into();
        self.index();
        let arrived = (0..most).any(|_| !self.handle_next(at));
        self.arrive(if arrived { at } else { self.now });
        arrived
    }

    /// Handles the next event if it is not after `at`. Returns whether there was one.
    fn handle_next(&mut self, at: Instant) -> bool {
        self.deadlines.compare();
        let (due, rank) = self.deadlines.first();
        match self.scheduled.first() {
            Some(key) if (key.at, key.phase) < (due, Phase::Deadline) => {
                if key.at > at {
                    return false;
                }
                self.now = self.now.max(key.at);
                if let Some(event) = self.scheduled.pop() {
                    self.handle(event);
                }
            }
            _ if due > at || due == Instant::NEVER => return false,
            _ => {
                self.now = self.now.max(due);
                self.wake(rank, due);
            }
        }
        true
    }

    /// Moves the clock to `at`, when all events until then are handled.
    fn arrive(&mut self, at: Instant) {
        if at < Instant::NEVER {
            self.now = self.now.max(at);
        }
        match self.waits {
            None => self.trace.end = self.now,
            Some(_) => self.settle(),
        }
    }

    /// Runs until the bench is idle: every complete request is answered or rejected, and scheduled changes of
    /// pins and power have arrived. A move may still be running (MDRIVE-36).
    pub fn run_until_idle(&mut self) {
        let idle_run = self.begin_idle_run();
        self.continue_idle_run(idle_run, Instant::NEVER);
    }

    /// Begins a [`run_until_idle`](Self::run_until_idle) in several calls of
    /// [`continue_idle_run`](Self::continue_idle_run).
    pub fn begin_idle_run(&mut self) -> IdleRun {
        self.run_until(self.now);
        // A power cycle takes longest: power goes off within a tick, and on again a tick later.
        IdleRun { inputs_due: self.now + Duration::TICK * 2 }
    }

    /// Begins a [`run_until_idle`](Self::run_until_idle) that also waits until partial frames time out,
    /// because no client will send the rest of them.
    pub fn begin_idle_run_flushing(&mut self) -> IdleRun {
        let IdleRun { inputs_due } = self.begin_idle_run();
        let partial = self.buses.iter().filter_map(SerialLine::partial_until).max();
        IdleRun { inputs_due: partial.map_or(inputs_due, |until| inputs_due.max(until)) }
    }

    /// Continues a [`run_until_idle`](Self::run_until_idle), but not beyond `at`. Returns true if the bench
    /// is idle. The number of calls makes no difference if nothing else is done to the bench in between.
    pub fn continue_idle_run(&mut self, idle_run: IdleRun, at: Instant) -> bool {
        loop {
            let mut next = self.next_event();
            if next == Instant::NEVER || (next > idle_run.inputs_due && self.busy == 0) {
                // No client can send more before this function returns.
                if self.flush_ambiguous() {
                    continue;
                }
                let Some(until) = self.blocking_partial_timeout() else { return true };
                next = until;
            }
            self.run_until(next.min(at));
            if next > at {
                return false;
            }
        }
    }

    /// Calls the drive with that rank at its deadline.
    fn wake(&mut self, rank: u32, due: Instant) {
        let index = self.order[rank as usize];
        let slot = &mut self.slots[index as usize];
        let next = slot.wake(due, &mut call_context(&mut self.trace, &mut self.outputs, self.settings));
        self.deadlines.set(rank, next);
        self.follow_call(index);
    }

    /// Handles the results of a call of a drive: its deadline, and what [follows](Self::follow_call).
    fn finish_call(&mut self, index: u32) {
        if self.indexed {
            let (rank, deadline) = (self.ranks[index as usize], self.slots[index as usize].deadline());
            self.deadlines.set(rank, deadline);
        }
        self.follow_call(index);
    }

    /// Handles the results of a call of a drive except its deadline: its outputs, and the end of its transmissions if
    /// power is off. Most calls have none of them.
    fn follow_call(&mut self, index: u32) {
        let slot = &self.slots[index as usize];
        let (is_off, has_tcp) = (!slot.state.powered, slot.state.has_tcp);
        if !slot.motors.is_empty() {
            self.schedule_motor_commands(index);
        }
        if !self.outputs.is_empty() {
            self.route_outputs();
        }
        if is_off {
            self.cancel_output(index);
            self.lose_connections(index);
        }
        if has_tcp {
            self.update_tcp_busy(index);
        }
        if !self.scenarios.is_empty() {
            self.look_for_writes(index);
        }
        self.record_outcomes(Receiver::Drive(DriveId(index)));
    }

    /// Sorts the slots by name if drives were added.
    fn index(&mut self) {
        if self.indexed {
            return;
        }
        // The slots added since the last time; the others are in order.
        self.order.extend(self.order.len() as u32..self.slots.len() as u32);
        let slots = &self.slots;
        self.order.sort_by(|&a, &b| slots[a as usize].name.cmp(&slots[b as usize].name));
        self.ranks = vec![0; slots.len()];
        for (rank, &index) in (0..).zip(&self.order) {
            self.ranks[index as usize] = rank;
        }
        let deadlines: Vec<Instant> =
            self.order.iter().map(|&index| slots[index as usize].deadline()).collect();
        self.deadlines = Tournament::new(&deadlines);
        self.rank_motors();
        let (ranks, motor_ranks) = (&self.ranks, &self.motor_ranks);
        self.scheduled.rank(|index| match motors::motor_at(index) {
            Some(motor) => motor_ranks[motor],
            None => ranks[index as usize],
        });
        self.indexed = true;
    }

    /// Schedules an event.
    #[inline(always)]
    fn schedule(&mut self, at: Instant, phase: Phase, index: u32, what: EventKind) {
        // If slots have no ranks yet, `index()` sets them, also in scheduled events, before the next event is
        // handled.
        let rank = self.ranks.get(index as usize).copied().unwrap_or(0);
        self.scheduled.push(at, phase, rank, index, what);
    }

    /// Schedules an input of a drive at `at`.
    fn send_to(&mut self, at: Instant, index: u32, input: InputRecord) {
        self.schedule(at, Phase::of(&input), index, EventKind::Input(input));
    }

    /// Delivers what another drive of the line began to send at `began`. If characters take no time, a drive that began
    /// to send at the same instant is still sending, and receives nothing.
    fn overhear(&mut self, index: u32, input: &InputRecord, began: Instant) {
        if !(self.fast() && self.slots[index as usize].began(input) == Some(began)) {
            self.deliver_overheard(index, input);
        }
    }

    /// Delivers what another drive of the line sends.
    fn deliver_overheard(&mut self, index: u32, input: &InputRecord) {
        self.slots[index as usize].state.reception.overhears = true;
        self.deliver(index, input);
        self.slots[index as usize].state.reception.overhears = false;
    }

    /// Records a frame that is for other drives, in place of its delivery. Returns false if it must be delivered.
    fn ignores(&mut self, drive: DriveId, frame: WholeFrame<'_>) -> bool {
        #[cfg(test)]
        if self.one_by_one {
            return false;
        }
        let mut context = call_context(&mut self.trace, &mut self.outputs, self.settings);
        self.slots[drive.0 as usize].ignores(self.now, frame, &mut context)
    }

    /// Delivers characters to the ports of a line, in the order that events of their own would have.
    fn hear(&mut self, key: EventKey, mut heard: Heard) {
        while let Some(drive) = heard.receiver() {
            let key = EventKey { rank: self.ranks[drive.0 as usize], ..key };
            if self.scheduled.first().is_some_and(|first| *first < key) {
                self.scheduled.put_back(Event { key, target: drive.0, kind: EventKind::Heard(heard) });
                break;
            }
            if let Some(frame) = heard.frame()
                && self.ignores(drive, frame)
            {
                heard.pop_frame();
                continue;
            }
            let Some(input) = heard.input() else { break };
            match heard.began {
                None => self.deliver(drive.0, &input),
                Some(began) => self.overhear(drive.0, &input, began),
            }
            heard.pop();
        }
    }

    /// Handles an event.
    fn handle(&mut self, event: Event<EventKind>) {
        match event.kind {
            EventKind::Input(input) => self.deliver(event.target, &input),
            EventKind::Heard(heard) => self.hear(event.key, heard),
            EventKind::Overheard { input, began } => self.overhear(event.target, &input, began),
            EventKind::MayCollide { input, number, overheard } => {
                let input = self.exposed(event.target, input, number);
                if overheard {
                    self.deliver_overheard(event.target, &input);
                } else {
                    self.deliver(event.target, &input);
                }
            }
            EventKind::Refused { refusal, request, end, number } => {
                self.answer_refused(refusal, &request, end, number);
            }
            EventKind::TcpInput { client, input } => self.tcp_input_arrives(event.target, client, &input),
            EventKind::StreamPart { client, part } => self.stream_part_arrives(client, part),
            EventKind::Stimulus { pin, stimulus } => self.stimulus_arrives(event.target, pin, stimulus),
            EventKind::WireLevel { wire, level } => self.wire_level_arrives(wire, level),
            EventKind::InitialLevels => self.report_initial_levels(event.target),
            EventKind::Pulse { pin, number } => self.pulse_edge(event.target, pin, number),
            EventKind::Encoder { encoder, number } => self.encoder_edge(event.target, encoder, number),
            EventKind::Wave { pin, number } => self.wave_edge(event.target, pin, number),
            EventKind::Steps { axis, number } => self.axis_edge(event.target, axis, number),
            EventKind::Motor { number } => self.motor_is_due(event.target, number, event.key.phase),
            EventKind::MotorReports { motor } => self.deliver_motor_reports(motor),
            EventKind::Scenario { number } => self.scenario_is_due(number),
            EventKind::TurnEnd { bus } => self.turn_ends(bus, event.key.at),
        }
    }

    /// Delivers an input to a drive now, unless the drive cannot receive it.
    fn deliver(&mut self, index: u32, input: &InputRecord) {
        let now = self.now;
        if let InputRecord::Fault { fault, on } = *input {
            self.set_shaft_blocked(index, fault, on);
        }
        let slot = &mut self.slots[index as usize];
        if !slot.receives(now, input) {
            return self.missed(index, input);
        }
        let powers_on = matches!(input, InputRecord::Power(Power::On)) && !slot.state.powered;
        let reports = if powers_on { self.motors_report(index) } else { Vec::new() };
        let slot = &mut self.slots[index as usize];
        let mut context = call_context(&mut self.trace, &mut self.outputs, self.settings);
        // A call can fail only for a preset, and presets are not delivered here.
        let _ = slot.feed(now, input, &mut context);
        if powers_on {
            for input in slot.state_to_report().into_iter().chain(reports) {
                let _ = slot.feed(now, &input, &mut context);
            }
            // The drive accepted these presets at its first power-on, so the call cannot fail.
            let _ = slot.preset_again(now, &mut context);
            self.record_motors(index);
        }
        self.finish_call(index);
    }

    /// Delivers an input of a trace to a drive at `at`, an instant that has not passed. Several characters
    /// for a port with timed characters follow back to back.
    pub(crate) fn feed(&mut self, drive: DriveId, at: Instant, input: &InputRecord) {
        if matches!(input, InputRecord::Poke { .. }) && at > Instant::ZERO {
            self.run_until(at);
        } else if at > Instant::ZERO {
            self.run_until(at - Duration::TICK);
        }
        self.now = self.now.max(at);
        self.index();
        // A preset at power-on is applied after the deadlines of its own drive; other drives still receive
        // their initial levels afterwards.
        if matches!(input, InputRecord::Poke { .. }) {
            while self.at(drive).deadline() <= at {
                self.wake(self.ranks[drive.0 as usize], self.at(drive).deadline());
            }
        }
        let serial = |port| self.at(drive).serial(port).filter(|serial| !serial.framed);
        if let InputRecord::Bytes { port, ref bytes } = *input
            && let Some(serial) = serial(port)
        {
            let character = self.takes(serial.line_at(at), 1);
            let single = |&byte| InputRecord::Bytes { port, bytes: [byte].into() };
            // If characters take no time, all are delivered now, so that they keep their order among the
            // events of this instant.
            let count = if character == Duration::ZERO { bytes.len() } else { 1 };
            let (now, later) = bytes.split_at(count.min(bytes.len()));
            for (n, byte) in (1..).zip(later) {
                self.send_to(at + character * n, drive.0, single(byte));
            }
            for byte in now {
                self.feed_now(drive, at, &single(byte));
            }
            return;
        }
        self.feed_now(drive, at, input);
    }

    fn feed_now(&mut self, drive: DriveId, at: Instant, input: &InputRecord) {
        let mut context = call_context(&mut self.trace, &mut self.outputs, self.settings);
        // A refused preset has no effect and is not recorded.
        let _ = self.slots[drive.0 as usize].feed(at, input, &mut context);
        self.finish_call(drive.0);
    }
}

/// Context of a call of a drive.
fn call_context<'a>(trace: &'a mut Trace, outputs: &'a mut Outputs, settings: Settings) -> CallContext<'a> {
    CallContext { trace, outputs, fast: settings.line == LineMode::Fast, shafts: settings.shafts }
}
