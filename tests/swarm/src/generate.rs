//! Makes a plan from a seed. The plan depends on nothing else, and is the same on every 64-bit machine.

use drivetwin_firmware::device::{Duration, Encoder, Fault, Framing, Pin, PortSpec, Role, Spec};
use drivetwin_protocol::time::Span;
use drivetwin_sim::bench::{PinStimulus, PowerAction};
use drivetwin_sim::catalog;
use drivetwin_sim::config::bench_file;
use drivetwin_sim::line::faults::{Direction, FaultRule, LineFaults};
use fastrand::Rng;

use crate::dialect::{self, Family, one_of};
use crate::plan::{Failing, Faults, NAMES, Name, Plan, Step, Who};
use crate::replies::REPLY_DELAY;

/// A drive of the plan.
#[derive(Clone, Copy)]
struct Drive {
    name: Name,
    spec: &'static Spec,
    address: u8,
    ascii: bool,
    /// True if the settings of its serial line are the factory's.
    as_made: bool,
}

/// The plan of a seed.
pub(crate) fn plan(seed: u64) -> Plan {
    let mut rng = Rng::with_seed(seed);
    let specs: Vec<&Spec> = catalog::specs().collect();
    let mut plan =
        Plan { seed: rng.u32(..).into(), fast: rng.u8(..6) == 0, parts: Vec::new(), steps: Vec::new() };
    let count = 1 + rng.usize(..NAMES.len()).min(rng.usize(..NAMES.len()));
    let drives: Vec<Drive> =
        NAMES[..count].iter().map(|name| drive(&mut plan, name, &specs, &mut rng)).collect();
    furnish(&mut plan, &drives, &mut rng);
    for _ in 0..rng.usize(4..30) {
        let drive = one_of(&mut rng, &drives);
        happen(&mut plan.steps, drive, &mut rng);
    }
    plan.steps.extend(drives.iter().map(|drive| Step::Ask(drive.name, rng.u64(..))));
    if rng.bool() {
        // The run ends in the middle of a message.
        for drive in &drives {
            say(&mut plan.steps, *drive, &mut rng);
        }
        plan.steps.push(Step::Wait(pause(&mut rng)));
    }
    plan
}

/// Adds a part, unless the bench file with the part is invalid.
fn add(plan: &mut Plan, part: String) {
    plan.parts.push(part);
    if bench_file::parse(&plan.bench_file()).is_err() {
        plan.parts.pop();
    }
}

fn drive(plan: &mut Plan, name: Name, specs: &[&'static Spec], rng: &mut Rng) -> Drive {
    let spec = one_of(rng, specs);
    let place = NAMES.iter().position(|other| *other == name).unwrap_or_default() as u8;
    let family = Family::of(spec.kind);
    let address = address(family, place, rng);
    let mut part =
        format!("[[drive]]\nname = \"{name}\"\nkind = \"{}\"\nfast_boot = {}\n", spec.kind, rng.u8(..5) > 0);
    if spec.address.is_some() {
        part += &format!("address = {address}\n");
    }
    let (mut ascii, mut as_made) = (false, true);
    if family == Family::Rs434 && rng.bool() {
        let (mode, rate, delay) = (rng.u8(1..6), rng.u8(3..11), rng.u8(..40).saturating_sub(20));
        (ascii, as_made) = (mode < 3, false);
        part +=
            &format!("set = {{ TYPE_MODBUS = {mode}, BITRATE_MODBUS = {rate}, {REPLY_DELAY} = {delay} }}\n");
    }
    if !spec.faults.is_empty() && rng.u8(..8) == 0 {
        part += &format!("faults = [\"{}\"]\n", one_of(rng, spec.faults));
    }
    plan.parts.push(part);
    Drive { name, spec, address, ascii, as_made }
}

/// An address that no other drive of the plan can have. Half of the drives get an address with a
/// [treacherous](dialect::Block::treacherous) block, if their family has one.
fn address(family: Family, place: u8, rng: &mut Rng) -> u8 {
    let blocks = family.blocks();
    let any: Vec<u8> = (2..248).filter(|address| address % NAMES.len() as u8 == place).collect();
    let treacherous = |address: &u8| blocks.iter().any(|block| block.treacherous(*address).is_some());
    let some: Vec<u8> = any.iter().copied().filter(treacherous).collect();
    if some.is_empty() || rng.bool() { one_of(rng, &any) } else { one_of(rng, &some) }
}

/// Adds serial lines, motors, encoders and switches on shafts, wires, and a scenario to a plan.
fn furnish(plan: &mut Plan, drives: &[Drive], rng: &mut Rng) {
    let names = |drives: &[Drive]| {
        drives.iter().map(|drive| format!("\"{}\"", drive.name)).collect::<Vec<_>>().join(", ")
    };
    if rng.bool() {
        // All drives of a serial line have the same framing.
        let ascii = rng.u8(..3) == 0;
        let on_lines = drives
            .iter()
            .copied()
            .filter(|drive| drive.spec.address.is_some() && drive.ascii == ascii && rng.u8(..4) > 0);
        let on_lines: Vec<Drive> = on_lines.collect();
        if let [first, others @ ..] = &on_lines[..] {
            // Collisions need drives with equal line settings. A client sends at the baud rate of the drive
            // it is connected to, so a slower drive would take longer to receive the message than the client
            // takes to send it.
            let line = |drive: &Drive| drive.spec.ports.first().and_then(|port| port.line);
            let alike =
                others.iter().all(|other| other.as_made && first.as_made && line(other) == line(first));
            let (names, collide) = (names(&on_lines), alike && rng.bool());
            add(plan, format!("[[bus]]\nname = \"line\"\ndrives = [{names}]\ncollisions = {collide}\n"));
        }
    }
    let turning: Vec<Drive> = drives.iter().copied().filter(|_| rng.bool()).collect();
    for drive in &turning {
        let load = rng.i16(-50..50);
        add(
            plan,
            format!(
                "[[motor]]\nname = \"motor-{}\"\ndrive = \"{}\"\nload_mnm = {load}\n",
                drive.name, drive.name
            ),
        );
    }
    for drive in &turning {
        let to = one_of(rng, drives);
        if let Some(encoder) = to.spec.encoders.first().filter(|_| rng.bool()) {
            let pin = |pin: Pin| format!("\"{}.{}\"", to.name, to.spec.pins[usize::from(pin.0)].name);
            let (motor, cycles) = (drive.name, rng.u16(1..200));
            let (a, b) = (pin(encoder.a), pin(encoder.b));
            add(
                plan,
                format!(
                    "[[encoder]]\nmotor = \"motor-{motor}\"\ncycles_per_rev = {cycles}\nto = {{ a = {a}, b = {b} }}\n"
                ),
            );
        }
        let end = one_of(rng, drives);
        if let Some(pin) = input(end.spec, rng).filter(|_| rng.bool()) {
            let side = one_of(rng, &["above_rev", "below_rev"]);
            let (motor, at, to) = (drive.name, f64::from(rng.i16(-300..300)) / 100.0, pin_name(end, pin));
            add(
                plan,
                format!(
                    "[[switch]]\nmotor = \"motor-{motor}\"\nclosed = {{ {side} = {at:.2} }}\nto = {to}\n"
                ),
            );
        }
    }
    for _ in 0..rng.usize(..4) {
        let (from, to) = (one_of(rng, drives), one_of(rng, drives));
        if let (Some(out), Some(pin)) = (output(from.spec, rng), input(to.spec, rng)) {
            add(plan, format!("[[wire]]\nfrom = {}\nto = {}\n", pin_name(from, out), pin_name(to, pin)));
        }
    }
    if rng.u8(..3) == 0 {
        let scenario = scenario(drives, rng);
        add(plan, scenario);
    }
}

/// A scenario that changes pins and causes of faults. Power and lines stay as they are, because a scenario acts
/// also while a well-behaved client waits for its answer.
fn scenario(drives: &[Drive], rng: &mut Rng) -> String {
    let mut at = 0;
    let mut steps = String::new();
    for _ in 0..rng.usize(1..5) {
        let (drive, other) = (one_of(rng, drives), one_of(rng, drives));
        let after = pause(rng).ticks() as f64 / 16_000.0;
        at += rng.u32(1..500);
        let rows: Vec<&str> =
            other.spec.rows().filter(|(_, row)| row.access.writes()).map(|(_, row)| row.name).collect();
        let when = match rng.u8(..3) {
            0 => format!("at_s = {:.3}, ", f64::from(at) / 1e3),
            1 if !rows.is_empty() => {
                format!("when = {{ drive = \"{}\", register = \"{}\" }}, ", other.name, one_of(rng, &rows))
            }
            _ => String::new(),
        };
        let action = match (input(drive.spec, rng), rng.u8(..4)) {
            (Some(pin), 0 | 1) => {
                let level = one_of(rng, &["low", "high", "open"]);
                format!("pin = {}, level = \"{level}\"", pin_name(drive, pin))
            }
            (Some(pin), 2) => {
                let (count, hz) = (rng.u8(1..60), rng.u16(1..30_000));
                format!("pin = {}, pulses = {count}, hz = {hz}", pin_name(drive, pin))
            }
            _ if !drive.spec.faults.is_empty() => {
                let (what, fault) = (one_of(rng, &["fault", "clear"]), one_of(rng, drive.spec.faults));
                format!("drive = \"{}\", {what} = \"{fault}\"", drive.name)
            }
            _ => continue,
        };
        steps += &format!("    {{ {when}after_ms = {after:.4}, {action} }},\n");
    }
    format!("[[scenario]]\nsteps = [\n{steps}]\n")
}

fn pin_name(drive: Drive, pin: Pin) -> String {
    format!("\"{}.{}\"", drive.name, drive.spec.pins[usize::from(pin.0)].name)
}

/// A pin that a drive reads, except `CLR_FLASH`, the contact of an RS that restores the factory's values.
fn input(spec: &Spec, rng: &mut Rng) -> Option<Pin> {
    let reads = |role| matches!(role, Role::Input | Role::Both | Role::AnalogueOrDigital | Role::Analogue);
    let pins = (0..).map(Pin).zip(spec.pins).filter(|(_, pin)| reads(pin.role) && pin.name != "CLR_FLASH");
    let pins: Vec<Pin> = pins.map(|(pin, _)| pin).collect();
    (!pins.is_empty()).then(|| one_of(rng, &pins))
}

/// A pin that a drive sets.
fn output(spec: &Spec, rng: &mut Rng) -> Option<Pin> {
    let drives = |role| matches!(role, Role::Output | Role::Both | Role::Led);
    let pins: Vec<Pin> =
        (0..).map(Pin).zip(spec.pins).filter(|(_, pin)| drives(pin.role)).map(|(pin, _)| pin).collect();
    (!pins.is_empty()).then(|| one_of(rng, &pins))
}

/// Adds a step, and often a wait after it.
fn happen(steps: &mut Vec<Step>, drive: Drive, rng: &mut Rng) {
    let Drive { name, spec, .. } = drive;
    match rng.u8(..41) {
        0..18 => say(steps, drive, rng),
        18 => steps.push(Step::Leave(who(drive, rng))),
        19..23 => {
            if let Some(pin) = input(spec, rng) {
                let analogue =
                    matches!(spec.pins[usize::from(pin.0)].role, Role::Analogue | Role::AnalogueOrDigital);
                let driving = match rng.u8(..4) {
                    0 if analogue => PinStimulus::Millivolts(rng.i32(-1_000..11_000)),
                    0 | 1 => PinStimulus::Low,
                    2 => PinStimulus::High,
                    _ => PinStimulus::Open,
                };
                steps.push(Step::Hand(name, pin, driving));
            }
        }
        23 => {
            if let Some(pin) = input(spec, rng) {
                steps.push(Step::Pulse(name, pin, rng.u32(1..60), rng.u32(1..30_000)));
            }
        }
        24 if !spec.encoders.is_empty() => {
            steps.push(Step::Turn(name, Encoder(0), rng.i32(-400..400), rng.u32(1..100_000)));
        }
        25 if !spec.faults.is_empty() => {
            steps.push(Step::Cause(name, Fault(rng.u8(..spec.faults.len() as u8)), rng.bool()));
        }
        26..28 => {
            let action = one_of(rng, &[PowerAction::Off, PowerAction::On, PowerAction::Cycle]);
            steps.push(Step::Power(name, action));
        }
        28 => steps.push(Step::Attach(name, rng.bool())),
        29..31 => steps.push(disturb(drive, rng)),
        31..35 => steps.push(Step::Ask(name, rng.u64(..))),
        35..38 => steps.push(Step::Save(
            name,
            rng.u64(..),
            one_of(rng, &[Failing::Amid, Failing::Amid, Failing::Later]),
        )),
        38 => steps.push(Step::Restart),
        39 => steps.extend(preset(name, spec, rng)),
        _ => {}
    }
    if rng.u8(..3) > 0 {
        steps.push(Step::Wait(pause(rng)));
    }
}

/// Presets a register, not through the bus. The drive may refuse the value.
fn preset(name: Name, spec: &'static Spec, rng: &mut Rng) -> Option<Step> {
    let rows: Vec<_> = dialect::settable(spec).collect();
    (!rows.is_empty()).then(|| {
        let (place, row) = one_of(rng, &rows);
        Step::Preset(name, place, dialect::any_value(row, rng))
    })
}

/// A duration from one tick to half a second. Each order of magnitude is equally likely.
fn pause(rng: &mut Rng) -> Duration {
    let most = 1 << rng.u32(1..23);
    Duration::from_ticks(rng.u64(1..=most))
}

fn who(drive: Drive, rng: &mut Rng) -> Who {
    Who { drive: drive.name, port: rng.u8(..drive.spec.ports.len().max(1) as u8), number: rng.u8(..3) }
}

/// A client sends bytes, in one piece or in several.
fn say(steps: &mut Vec<Step>, drive: Drive, rng: &mut Rng) {
    let who = who(drive, rng);
    let family = Family::of(drive.spec.kind);
    let bytes = match drive.spec.ports[usize::from(who.port)].framing {
        Framing::Silence => dialect::modbus_mischief(family, drive.address, drive.ascii, rng),
        Framing::Character => dialect::qsb_mischief(rng),
        Framing::Mbap => dialect::tcp_mischief(rng),
        Framing::Return => dialect::mcode_mischief(rng),
    };
    if rng.bool() && bytes.len() > 1 {
        let (head, tail) = bytes.split_at(rng.usize(1..bytes.len()));
        steps.push(Step::Say(who, head.to_vec()));
        steps.push(Step::Wait(Duration::from_ticks(rng.u64(1..40.millis().ticks()))));
        steps.push(Step::Say(who, tail.to_vec()));
    } else if !bytes.is_empty() {
        steps.push(Step::Say(who, bytes));
    }
}

/// Sets the faults of a port; in one case of three none, which ends earlier faults.
fn disturb(Drive { name, spec, .. }: Drive, rng: &mut Rng) -> Step {
    let number = rng.u8(..spec.ports.len().max(1) as u8);
    let mut faults = LineFaults::NONE;
    let own = rng.u8(..4) == 0;
    if rng.u8(..3) > 0 {
        for (fault, rule) in faults.rules() {
            *rule = if rng.u8(..3) == 0 { self::rule(spec, rng) } else { FaultRule::NONE };
            // A silent drive ends most conversations.
            if fault == "mute" && rng.u8(..5) > 0 {
                *rule = FaultRule::NONE;
            }
        }
        faults.noise_before = rng.bool();
        if rng.u8(..4) == 0 {
            (faults.delay, faults.delay_spread) = (pause(rng), pause(rng) * u64::from(rng.bool()));
            faults.delayed = if rng.bool() { FaultRule::ALL } else { rule(spec, rng) };
        }
        faults.baud = (rng.u8(..16) == 0).then(|| one_of(rng, &[1_200, 9_600, 19_200, 115_200]));
    }
    if let Some(port) = spec.ports.get(usize::from(number)) {
        remove_impossible(&mut faults, port);
    }
    Step::Disturb(name, number, Box::new(Faults { faults, own }))
}

/// Frames that a fault disturbs.
fn rule(spec: &Spec, rng: &mut Rng) -> FaultRule {
    let rule = if rng.u8(..3) == 0 {
        FaultRule::next(rng.u32(1..4))
    } else {
        FaultRule::rate(f64::from(rng.u8(0..=10)) / 10.0)
    };
    let rule = match rng.u8(..6) {
        0 => rule.direction(Direction::Request),
        1 => rule.direction(Direction::Reply),
        _ => rule,
    };
    let rows: Vec<&str> = spec.rows().map(|(_, row)| row.name).collect();
    match rng.u8(..6) {
        0 => rule.function(one_of(rng, &[3, 6, 16])),
        1 if !rows.is_empty() => rule.register(one_of(rng, &rows)),
        _ => rule,
    }
}

/// Removes the faults that a port cannot have, and the parts of rules that make them impossible.
fn remove_impossible(faults: &mut LineFaults, port: &PortSpec) {
    let possible = |rule: FaultRule, name: &str| {
        let mut alone = LineFaults::NONE;
        if name == "delay_ms" {
            alone.delayed = rule;
        }
        for (_, own) in alone.rules().into_iter().filter(|(own, _)| *own == name) {
            *own = rule;
        }
        alone.check_for(port).is_ok()
    };
    for (name, rule) in faults.rules() {
        if !possible(*rule, name) {
            *rule = FaultRule { direction: None, function: None, register: None, ..*rule };
        }
        if !possible(*rule, name) {
            *rule = FaultRule::NONE;
        }
    }
    if !possible(faults.delayed, "delay_ms") {
        faults.delayed = FaultRule::ALL;
    }
    if faults.check_for(port).is_err() {
        faults.baud = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The seeds that `cargo xtask test` runs.
    const SEEDS: std::ops::RangeInclusive<u64> = 1..=200;

    #[test]
    fn a_seed_is_a_plan() {
        assert_eq!(plan(7), plan(7));
        assert_ne!(plan(7), plan(8));
    }

    #[test]
    fn plans_have_all_kinds_and_tables_and_steps() {
        let plans: Vec<String> = SEEDS.map(|seed| plan(seed).to_string()).collect();
        let kinds = catalog::specs().map(|spec| format!("kind = \"{}\"", spec.kind));
        let tables =
            ["bus", "motor", "encoder", "switch", "wire", "scenario"].map(|table| format!("[[{table}]]"));
        let steps = [
            "wait",
            "says",
            "leaves",
            "pin",
            "pulses",
            "turns",
            "fault",
            "power of",
            "is open",
            "the line of",
            "is asked",
            "is preset",
            "fails Amid",
            "fails Later",
            "begin again",
        ];
        for part in kinds.chain(tables).chain(steps.map(|step| format!(" {step}"))) {
            let count = plans.iter().filter(|plan| plan.contains(&part)).count();
            assert!(count >= 5, "{part}: {count}");
        }
    }
}
