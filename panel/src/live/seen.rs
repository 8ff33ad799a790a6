//! State of a bench as numbers, and its JSON.

use std::collections::BTreeMap;
use std::sync::Arc;

use drivetwin_firmware::device::{Axis, Fault, Instant, Level, Pin, Role, Spec};
use drivetwin_sim::bench::{Bench, Bus, DriveId, Motion, Outlet, ShaftState, Wire, WireOutput};
use drivetwin_sim::commands::State;
use drivetwin_sim::config::time_mode::TimeMode;
use drivetwin_sim::programs::{self, ProgramLine};
use drivetwin_sim::record::journal::Failures;
use serde::Serialize;
use serde_json::{Map, Value, json};

use super::patch::{merge_patch, without_nulls};
use crate::schema::{self, BoardView, BusState, Drive, Motor, Places, Time};

/// Reason why the clock of a bench cannot be advanced while its time goes on by itself.
const NO_ADVANCE: &str = "time goes on by itself; choose manual time to advance it";

/// Controls that the bench does not have, with the reason.
type Cannot = BTreeMap<&'static str, &'static str>;

/// Names of everything on a bench, and wires. They stay the same while the shape of the bench does.
#[derive(Default)]
pub(super) struct Layout {
    drives: Vec<(String, &'static Spec)>,
    outlets: Vec<OutletNames>,
    /// Motors, each with the name of its drive.
    motors: Vec<(String, String)>,
    wires: Vec<WireNames>,
}

struct OutletNames {
    outlet: Outlet,
    name: String,
    drives: Vec<String>,
    listen: Vec<String>,
}

#[derive(Serialize)]
struct WireNames {
    from: String,
    to: String,
}

impl Layout {
    pub(super) fn of(bench: &Bench, places: &Places) -> Self {
        let name = |id: DriveId| bench.name(id).to_owned();
        let outlets = bench.outlets().into_iter().map(|outlet| OutletNames {
            outlet,
            name: bench.outlet_name(outlet),
            drives: bench.drives_at(outlet).into_iter().map(name).collect(),
            listen: places.get(&outlet).cloned().unwrap_or_default(),
        });
        let motors = bench.motors().map(|motor| {
            let (drive, _) = bench.turned_by(motor);
            (bench.motor_name(motor).to_owned(), name(drive))
        });
        Self {
            drives: bench.drives().map(|id| (name(id), bench.spec(id))).collect(),
            outlets: outlets.collect(),
            motors: motors.collect(),
            wires: bench.wires().iter().map(|wire| WireNames::of(bench, wire)).collect(),
        }
    }

    /// All lines and TCP ports.
    pub(super) fn outlets(&self) -> Arc<[Outlet]> {
        self.outlets.iter().map(|names| names.outlet).collect()
    }

    pub(super) fn drive_name(&self, id: DriveId) -> Option<&str> {
        self.drives.get(id.index()).map(|(name, _)| name.as_str())
    }

    pub(super) fn spec(&self, id: DriveId) -> Option<&'static Spec> {
        self.drives.get(id.index()).map(|(_, spec)| *spec)
    }

    pub(super) fn bus_name(&self, bus: Bus) -> Option<&str> {
        let found = self.outlets.iter().find(|names| names.outlet == Outlet::Line(bus));
        found.map(|names| names.name.as_str())
    }
}

impl WireNames {
    fn of(bench: &Bench, wire: &Wire) -> Self {
        let pin = |(drive, Pin(pin)): (DriveId, Pin)| {
            let pin = bench.spec(drive).pins.get(usize::from(pin)).map_or("", |pin| pin.name);
            format!("{}.{pin}", bench.name(drive))
        };
        let from = match wire.from {
            WireOutput::Pin(drive, number) => pin((drive, number)),
            WireOutput::Hall(motor) => format!("{}.hall", bench.motor_name(motor)),
            WireOutput::Switch(motor) => format!("{}.switch", bench.motor_name(motor)),
            WireOutput::Encoder(motor, channel) => {
                let channel = ["a", "b", "index"].get(usize::from(channel)).copied().unwrap_or_default();
                format!("{}.{channel}", bench.motor_name(motor))
            }
        };
        Self { from, to: pin(wire.to) }
    }
}

/// A drive in the list.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct DriveSeen {
    powered: bool,
    /// A bit for each pin: set if it is a light that is lit.
    lit: u64,
    motion: Option<Motion>,
    /// Count of its encoder; `None` if it has an axis, or no register with the count.
    count: Option<i64>,
    /// True if the cause of a fault is present.
    fault: bool,
    /// Numbers of its messages without success; `None` if it has no journal.
    failures: Option<Failures>,
}

/// The lights of a drive.
fn lights(spec: &'static Spec) -> impl Iterator<Item = Pin> {
    (0..64).map(Pin).zip(spec.pins).filter(|(_, pin)| pin.role == Role::Led).map(|(pin, _)| pin)
}

/// Time of the next change of a light of a drive that blinks by itself.
pub(super) fn next_light(bench: &Bench, id: DriveId) -> Instant {
    lights(bench.spec(id)).map(|pin| bench.next_edge(id, pin)).min().unwrap_or(Instant::NEVER)
}

/// Row of the register with the count of the encoder, of a drive without an axis: of a QSB that moves no motor.
fn counter(spec: &'static Spec) -> Option<usize> {
    spec.axes
        .is_empty()
        .then(|| spec.rows().find(|(_, of)| of.name == "ReadEncoder").map(|(row, _)| row))
        .flatten()
}

impl DriveSeen {
    fn of(bench: &Bench, id: DriveId) -> Self {
        let spec = bench.spec(id);
        Self {
            powered: bench.powered(id),
            lit: lit(spec, |pin| bench.level(id, pin)),
            motion: spec.axes.first().map(|_| bench.motion(id, Axis(0))),
            count: counter(spec).filter(|_| !bench.is_elsewhere(id)).map(|row| bench.peek(id, row)),
            fault: (0..).map(Fault).zip(spec.faults).any(|(fault, _)| bench.faulty(id, fault)),
            failures: (!bench.is_elsewhere(id)).then(|| bench.failures(id)),
        }
    }

    fn of_state(spec: &'static Spec, state: &State) -> Self {
        Self {
            powered: state.powered,
            lit: lit(spec, |pin| state.level(pin)),
            motion: state.motion,
            count: None,
            fault: state.faults.contains(&true),
            failures: None,
        }
    }

    fn json(&self, index: usize, spec: &'static Spec, board: Option<&BoardView>) -> Value {
        let lit: Vec<&str> = lights(spec)
            .filter(|Pin(pin)| self.lit >> pin & 1 == 1)
            .filter_map(|Pin(pin)| spec.pins.get(usize::from(pin)).map(|pin| pin.name))
            .collect();
        let mut drive = json!({
            "index": index,
            "kind": spec.kind,
            "powered": self.powered,
            "lit": lit.join(" "),
            "fault": self.fault,
        });
        if let Some(motion) = self.motion {
            drive["moving"] = motion.moving.into();
            drive["position"] = motion.position.into();
            drive["speed"] = motion.speed.to_num::<f64>().into();
        }
        if let Some(count) = self.count {
            drive["count"] = count.into();
        }
        if let Some(Failures { refused, unanswered }) = self.failures {
            drive["refused"] = refused.into();
            drive["unanswered"] = unanswered.into();
        }
        if let Some(board) = board {
            drive["board"] = without(board, &["drive"]);
        }
        drive
    }
}

fn lit(spec: &'static Spec, level: impl Fn(Pin) -> Level) -> u64 {
    lights(spec).filter(|&pin| level(pin) == Level::High).fold(0, |lit, Pin(pin)| lit | 1 << pin)
}

/// State of a bench.
#[derive(Clone, PartialEq, Debug)]
pub(super) struct Seen {
    pub(super) shape: [usize; 5],
    pub(super) mode: TimeMode,
    pub(super) now: Instant,
    drives: Vec<DriveSeen>,
    motors: Vec<ShaftState>,
    /// Lines and TCP ports, each with the number of messages that none of its drives answered.
    buses: Vec<(BusState, u64)>,
    /// Boards, by the index of their drives.
    boards: BTreeMap<usize, BoardView>,
    /// The drive whose details are wanted.
    wanted: Option<usize>,
    details: Option<Drive>,
    program: Option<ProgramSeen>,
}

/// User program of a drive.
#[derive(Clone, PartialEq, Debug)]
struct ProgramSeen {
    /// The memory with the program.
    memory: Vec<u8>,
    /// The line that is executed next, while the program runs.
    running: Option<u16>,
}

impl ProgramSeen {
    fn of(bench: &Bench, id: DriveId) -> Option<Self> {
        let has_program = programs::runs_on(bench.spec(id)) && !bench.is_elsewhere(id);
        has_program.then(|| Self { memory: bench.memory(id).to_vec(), running: bench.program_line(id) })
    }

    fn lines(&self, spec: &Spec) -> Value {
        let lines = programs::listing(spec, &self.memory).unwrap_or_default();
        lines.into_iter().map(|ProgramLine { at, text }| json!({"at": at, "text": text})).collect()
    }

    /// The changes since `old`, as a merge patch; the whole program without `old`.
    fn changes_since(&self, old: Option<&Self>, spec: &Spec) -> Option<Value> {
        let mut patch = Map::new();
        if old.is_none_or(|old| old.memory != self.memory) {
            let lines = self.lines(spec);
            if old.is_none_or(|old| old.lines(spec) != lines) {
                patch.insert("lines".into(), lines);
            }
        }
        let running = old.and_then(|old| old.running);
        if self.running != running {
            patch.insert("running".into(), self.running.map_or(Value::Null, Value::from));
        }
        (!patch.is_empty()).then_some(Value::Object(patch))
    }
}

impl Seen {
    /// The present state of a bench with these lines and TCP ports.
    pub(super) fn of(
        bench: &Bench,
        mode: TimeMode,
        outlets: &[Outlet],
        wanted: Option<DriveId>,
        places: &Places,
    ) -> Self {
        Self {
            shape: bench.shape(),
            mode,
            now: bench.now(),
            drives: bench.drives().map(|id| DriveSeen::of(bench, id)).collect(),
            motors: bench.motors().map(|motor| bench.turn(motor)).collect(),
            buses: outlets
                .iter()
                .map(|&outlet| (BusState::of(bench, outlet), unanswered(bench, outlet)))
                .collect(),
            boards: BTreeMap::new(),
            wanted: wanted.map(DriveId::index),
            details: wanted.map(|id| Drive::of_bench(bench, id, places)),
            program: wanted.and_then(|id| ProgramSeen::of(bench, id)),
        }
    }

    pub(super) fn add_board(
        &mut self,
        spec: &'static Spec,
        drive: DriveId,
        board: BoardView,
        state: Option<&State>,
        details: Option<Drive>,
    ) {
        let index = drive.index();
        if let Some(seen) = self.drives.get_mut(index) {
            *seen = match state {
                Some(state) => DriveSeen::of_state(spec, state),
                None => DriveSeen { powered: false, ..*seen },
            };
        }
        if self.wanted == Some(index) {
            self.details = details;
        }
        self.boards.insert(index, board);
    }

    /// Returns true if an axis or a motor moves.
    pub(super) fn is_moving(&self) -> bool {
        let moves = |motion: Option<Motion>| motion.is_some_and(|motion| motion.moving);
        self.drives.iter().any(|drive| moves(drive.motion))
            || self.motors.iter().any(|motor| motor.rpm != 0.0)
    }

    /// The whole state as JSON.
    pub(super) fn whole(&self, layout: &Layout, cannot: &Cannot) -> Value {
        let mut state = json!({
            "time": self.time(),
            "version": env!("CARGO_PKG_VERSION"),
            "drives": object(layout.drives.iter().enumerate().map(|(index, (name, _))| {
                (name.as_str(), self.drive(index, layout))
            })),
            "motors": object(layout.motors.iter().enumerate().map(|(index, (name, _))| {
                (name.as_str(), self.motor(index, layout))
            })),
            "buses": object(layout.outlets.iter().enumerate().map(|(index, names)| {
                (names.name.as_str(), self.bus(index, layout))
            })),
            "wires": layout.wires,
            "cannot": self.cannot(cannot),
        });
        if let Some(details) = self.details() {
            state["drive"] = details;
            if let Some(program) = self.program_changes(None, layout) {
                state["drive"]["program"] = program;
            }
        }
        without_nulls(state)
    }

    /// The changes on the same bench since `old`, as a merge patch; `None` if there are none. Makes JSON only
    /// of what differs.
    pub(super) fn changes_since(&self, old: &Self, layout: &Layout, cannot: &Cannot) -> Option<Value> {
        let mut patch = Map::new();
        let mut add =
            |name: &str, change: Option<Value>| patch.extend(change.map(|change| (name.to_owned(), change)));
        if (self.now, self.mode) != (old.now, old.mode) {
            add("time", merge_patch(&old.time(), &self.time()));
            add("cannot", merge_patch(&old.cannot(cannot), &self.cannot(cannot)));
        }
        add(
            "drives",
            Self::changed(layout.drives.iter().map(|(name, _)| name), |index| {
                let differs = self.drives.get(index) != old.drives.get(index)
                    || self.boards.get(&index) != old.boards.get(&index);
                differs.then(|| [old, self].map(|seen| seen.drive(index, layout)))
            }),
        );
        add(
            "motors",
            Self::changed(layout.motors.iter().map(|(name, _)| name), |index| {
                (self.motors.get(index) != old.motors.get(index))
                    .then(|| [old, self].map(|seen| seen.motor(index, layout)))
            }),
        );
        add(
            "buses",
            Self::changed(layout.outlets.iter().map(|names| &names.name), |index| {
                (self.buses.get(index) != old.buses.get(index))
                    .then(|| [old, self].map(|seen| seen.bus(index, layout)))
            }),
        );
        if self.details != old.details {
            let json = |seen: &Self| seen.details().map_or_else(|| json!({}), without_nulls);
            let change =
                if self.details.is_none() { Some(Value::Null) } else { merge_patch(&json(old), &json(self)) };
            add("drive", change);
        }
        if let Some(program) = self.program_changes(Some(old), layout) {
            let drive = patch.entry("drive").or_insert_with(|| json!({}));
            drive["program"] = program;
        }
        (!patch.is_empty()).then_some(Value::Object(patch))
    }

    /// The changes of things with names; `states` gives the old and the new state of one that may differ.
    fn changed<'a>(
        names: impl Iterator<Item = &'a String>,
        states: impl Fn(usize) -> Option<[Value; 2]>,
    ) -> Option<Value> {
        let changes = names.enumerate().filter_map(|(index, name)| {
            let [old, new] = states(index)?;
            Some((name.as_str(), merge_patch(&old, &new)?))
        });
        let changes: Vec<(&str, Value)> = changes.collect();
        (!changes.is_empty()).then(|| object(changes))
    }

    fn time(&self) -> Value {
        to_value(&Time::new(self.mode, self.now))
    }

    fn cannot(&self, cannot: &Cannot) -> Value {
        let mut all = cannot.clone();
        if self.mode != TimeMode::Manual {
            all.entry("advance").or_insert(NO_ADVANCE);
        }
        to_value(&all)
    }

    fn drive(&self, index: usize, layout: &Layout) -> Value {
        let (Some(seen), Some((_, spec))) = (self.drives.get(index), layout.drives.get(index)) else {
            return Value::Null;
        };
        without_nulls(seen.json(index, spec, self.boards.get(&index)))
    }

    fn motor(&self, index: usize, layout: &Layout) -> Value {
        let (Some(shaft), Some((name, drive))) = (self.motors.get(index), layout.motors.get(index)) else {
            return Value::Null;
        };
        without(&Motor::new(name, drive, *shaft), &["name"])
    }

    fn bus(&self, index: usize, layout: &Layout) -> Value {
        let (Some((state, unanswered)), Some(names)) = (self.buses.get(index), layout.outlets.get(index))
        else {
            return Value::Null;
        };
        let OutletNames { name, drives, listen, .. } = names;
        let name_of = |id| layout.drive_name(id).unwrap_or_default();
        let mut bus = without(&schema::Bus::new(name, drives, listen, state, name_of), &["name"]);
        if *unanswered > 0 {
            bus["unanswered"] = (*unanswered).into();
        }
        bus
    }

    /// The changes in the program of the wanted drive.
    fn program_changes(&self, old: Option<&Self>, layout: &Layout) -> Option<Value> {
        let (_, spec) = layout.drives.get(self.wanted?)?;
        self.program.as_ref()?.changes_since(old.and_then(|old| old.program.as_ref()), spec)
    }

    fn details(&self) -> Option<Value> {
        self.details.as_ref().map(to_value)
    }
}

/// Number of messages so far that none of the drives of a line answered; those of a drive alone on its line are its own.
fn unanswered(bench: &Bench, outlet: Outlet) -> u64 {
    match outlet {
        Outlet::Line(bus) => bench.unanswered_on(bus),
        Outlet::Tcp(..) => 0,
    }
}

fn to_value(what: &impl Serialize) -> Value {
    serde_json::to_value(what).unwrap_or_default()
}

/// JSON without some members, and without nulls.
fn without(what: &impl Serialize, names: &[&str]) -> Value {
    let mut value = to_value(what);
    if let Some(members) = value.as_object_mut() {
        members.retain(|name, _| !names.contains(&name.as_str()));
    }
    without_nulls(value)
}

fn object<'a>(members: impl IntoIterator<Item = (&'a str, Value)>) -> Value {
    Value::Object(members.into_iter().map(|(name, value)| (name.to_owned(), value)).collect())
}
