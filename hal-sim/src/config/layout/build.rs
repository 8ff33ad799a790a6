//! The bench of a layout.

use drivetwin_firmware::device::{PresetError, Spec};
use drivetwin_firmware::motor::{self, stepper};

use super::{At, BrushKeys, DriveLayout, Layout, MotorKind};
use crate::bench::{AddError, Bench, Bus, DriveId, Motor, MotorModel, Settings, Setup};
use crate::catalog;
use crate::config::preset::{self, Preset};

/// A bench that was made of a [`Layout`].
pub struct Built {
    /// The bench, at the beginning of time.
    pub bench: Bench,
    /// The seats of [`Layout::drives`].
    pub seats: Vec<DriveId>,
    /// The lines of [`Layout::buses`]; those of other ports are found by [`Bench::bus`].
    pub buses: Vec<Bus>,
    /// The motors of [`Layout::motors`].
    pub motors: Vec<Motor>,
}

impl Layout {
    /// Makes the bench of a layout, for instance with its own [settings](Self::settings). It does not depend on the
    /// order of what is in the layout.
    ///
    /// `given` is what is known of each of [`drives`](Self::drives) beside the layout: the content of its memory, with
    /// its user program, and who keeps it. Presets, a fast start and motors are added to it. Who is given nothing is
    /// new.
    ///
    /// # Errors
    /// One sentence: a drive does not take a preset or its name, or there is no such kind, motor or line.
    ///
    /// # Panics
    /// If a layout that was made by hand names a drive, a motor or a pin by a place where there is none, or two lines
    /// alike: [`file::parse`](crate::config::bench_file::parse) and the command line make none of these.
    pub fn build(&self, settings: Settings, given: Vec<Setup>) -> Result<Built, String> {
        let mut bench = Bench::with(settings);
        let mut given: Vec<Setup> = given;
        given.resize_with(self.drives.len(), Setup::default);
        let by_name = sorted(&self.drives, |drive| drive.name.clone());
        let mut seats = vec![None; self.drives.len()];
        let mut later = vec![Vec::new(); self.drives.len()];
        for &place in &by_name {
            let setup = std::mem::take(&mut given[place]);
            let (seat, not_saved) = self.add_drive(&mut bench, place, setup)?;
            (seats[place], later[place]) = (Some(seat), not_saved);
        }
        let seats: Vec<DriveId> = seats.into_iter().flatten().collect();
        let buses = self.share(&mut bench, &seats);
        let motors = self.attach_motors(&mut bench, &seats, &later)?;
        self.put_up(&mut bench, &seats, &motors);
        // Once all are connected, since a preset makes a drive with a fast start ready.
        for place in by_name {
            let presets = std::mem::take(&mut later[place]);
            if !presets.is_empty() {
                bench.preset(seats[place], presets).map_err(|error| self.cannot_seat(place, &error))?;
            }
        }
        for disturbed in &self.faults {
            let bus = bench.find_bus(&disturbed.bus);
            let bus = bus.ok_or_else(|| format!("there is no bus '{}'", disturbed.bus))?;
            bench.set_line_faults(bus, disturbed.faults);
        }
        Ok(Built { bench, seats, buses, motors })
    }

    /// Seats a drive with what is saved of its presets, and returns the others.
    fn add_drive(
        &self,
        bench: &mut Bench,
        place: usize,
        mut setup: Setup,
    ) -> Result<(DriveId, Vec<(usize, i64)>), String> {
        let drive = &self.drives[place];
        let device = catalog::make(drive.kind)?;
        let spec = device.spec();
        setup.boot_fast |= drive.fast_boot;
        for motor in self.motors.iter().filter(|motor| motor.drive == place) {
            if let MotorKind::Stepper(is) = &motor.is {
                setup.presets.extend(own_stepper(is, spec));
            }
        }
        setup.presets.extend(values(&drive.presets, spec, setup.memory.as_deref()));
        setup.presets.extend(spec.supply.zip(self.supply(place)));
        setup.apart |=
            self.motors.iter().any(|motor| motor.drive == place && matches!(motor.is, MotorKind::Brush(_)));
        let saved = |&(row, _): &(usize, i64)| spec.registers.rows.get(row).is_some_and(|row| row.saved != 0);
        let (now, later) = std::mem::take(&mut setup.presets).into_iter().partition(saved);
        setup.presets = now;
        let seat =
            bench.add_with(&drive.name, device, setup).map_err(|error| self.cannot_seat(place, &error))?;
        let mut faults = drive.faults.clone();
        faults.sort_unstable();
        for fault in faults {
            bench.fault(seat, fault, true);
        }
        Ok((seat, later))
    }

    /// The reason why a drive cannot be seated, in one sentence.
    fn cannot_seat(&self, place: usize, error: &AddError) -> String {
        let drive = &self.drives[place];
        let AddError::Preset { row, why } = *error else { return error.to_string() };
        let Some(spec) = catalog::specs().find(|spec| spec.kind == drive.kind) else {
            return error.to_string();
        };
        let name = spec.registers.rows.get(row).map_or("", |row| row.name);
        let kept = drive.nv.as_ref().map(|path| format!(" ({})", path.display())).unwrap_or_default();
        format!("{}: {}{kept}", drive.name, preset::refusal(spec, row, name, why))
    }

    /// Supply voltage by the motor of a drive, in 0.1 V.
    fn supply(&self, drive: usize) -> Option<i64> {
        let of = |motor: &super::MotorLayout| match motor.is {
            MotorKind::Brush(keys) if motor.drive == drive => keys.supply_mv,
            _ => None,
        };
        self.motors.iter().find_map(of).map(|mv| i64::from((mv + 50) / 100))
    }

    fn share(&self, bench: &mut Bench, seats: &[DriveId]) -> Vec<Bus> {
        let mut buses = vec![None; self.buses.len()];
        for place in sorted(&self.buses, |bus| bus.name.clone()) {
            let shared = &self.buses[place];
            let ports: Vec<_> = shared.drives.iter().map(|&(drive, port)| (seats[drive], port)).collect();
            let bus = bench.share(&shared.name, &ports);
            bench.set_collisions(bus, shared.collisions);
            buses[place] = Some(bus);
        }
        buses.into_iter().flatten().collect()
    }

    fn attach_motors(
        &self,
        bench: &mut Bench,
        seats: &[DriveId],
        presets: &[Vec<(usize, i64)>],
    ) -> Result<Vec<Motor>, String> {
        let mut motors = vec![None; self.motors.len()];
        for place in sorted(&self.motors, |motor| motor.name.clone()) {
            let motor = &self.motors[place];
            let seat = seats[motor.drive];
            let is = match &motor.is {
                MotorKind::Stepper(parameters) => MotorModel::Stepper(*parameters),
                MotorKind::Brush(keys) => {
                    let own = self.described(bench, motor.drive, seat, &presets[motor.drive])?;
                    MotorModel::Brush(brush(bench, seat, own, keys)?)
                }
            };
            motors[place] = Some(bench.attach_motor(&motor.name, seat, motor.axis, is)?);
        }
        Ok(motors.into_iter().flatten().collect())
    }

    /// The motor from which a drive has parted, as its registers describe it once these presets are set, which they are
    /// not yet.
    fn described(
        &self,
        bench: &Bench,
        place: usize,
        seat: DriveId,
        presets: &[(usize, i64)],
    ) -> Result<Option<motor::Parameters>, String> {
        let drive = &self.drives[place];
        let mut other = Bench::new();
        let (memory, presets) = (Some(bench.memory(seat).to_vec()), presets.to_vec());
        let setup = Setup { boot_fast: true, apart: true, memory, presets, ..Setup::default() };
        let seat = other.add_with(&drive.name, catalog::make(drive.kind)?, setup);
        Ok(other.detached_motor(seat.map_err(|error| self.cannot_seat(place, &error))?))
    }

    /// Encoders, switches and wires.
    fn put_up(&self, bench: &mut Bench, seats: &[DriveId], motors: &[Motor]) {
        let at = |(drive, pin): At| (seats[drive], pin);
        // By name, since what happens first at one pin at one instant may matter.
        let key = |(drive, pin): At| (self.drives[drive].name.clone(), pin);
        let keys = |ats: [Option<At>; 3]| ats.map(|at| at.map(key));
        let named = |motor: usize| self.motors[motor].name.clone();
        for place in sorted(&self.encoders, |encoder| {
            (named(encoder.motor), keys([encoder.a, encoder.b, encoder.index]), encoder.cycles_per_rev)
        }) {
            let encoder = &self.encoders[place];
            let to = [encoder.a, encoder.b, encoder.index].map(|pin| pin.map(at));
            bench.encode(motors[encoder.motor], encoder.cycles_per_rev, to);
        }
        for place in sorted(&self.switches, |switch| {
            let bits = |bound: Option<f64>| bound.map(f64::to_bits);
            (
                named(switch.motor),
                key(switch.to),
                bits(switch.closed.above_rev),
                bits(switch.closed.below_rev),
            )
        }) {
            let switch = &self.switches[place];
            bench.switch(motors[switch.motor], switch.closed, at(switch.to));
        }
        for place in sorted(&self.wires, |wire| (key(wire.from), key(wire.to))) {
            let wire = &self.wires[place];
            bench.wire(at(wire.from), at(wire.to));
        }
    }
}

/// The places of things, in the order of their keys.
fn sorted<T, K: Ord>(things: &[T], key: impl Fn(&T) -> K) -> Vec<usize> {
    let mut places: Vec<usize> = (0..things.len()).collect();
    places.sort_by_key(|&place| key(&things[place]));
    places
}

/// A stepper motor to a drive that brings its own: the settings that describe that one.
fn own_stepper(is: &stepper::StepperParameters, spec: &Spec) -> impl Iterator<Item = (usize, i64)> {
    let mnm = |unm: i64| (unm + unm.signum() * 500) / 1_000;
    // The drive's motor is rated for another current.
    let rated = i64::from(stepper::StepperParameters::NOMINAL.rated_ma);
    [
        ("HoldingTorque", mnm(i64::from(is.holding_unm) * rated / i64::from(is.rated_ma))),
        ("PullOutSpeed", is.pull_out_rpm.into()),
        ("Inertia", is.inertia_gcm2.into()),
        ("Friction", mnm(is.friction_unm.into())),
        ("Load", mnm(is.load_unm.into())),
        ("FullSteps", is.steps_per_rev.into()),
    ]
    .into_iter()
    .filter_map(|(name, value)| Some((spec.find(name)?.row, value)))
}

/// A brush motor, or a brushless one: what is not said of it is as its drive describes it, or nominal where the drive
/// knows nothing of it.
fn brush(
    bench: &Bench,
    seat: DriveId,
    own: Option<motor::Parameters>,
    keys: &BrushKeys,
) -> Result<motor::Parameters, String> {
    let nominal = bench.spec(seat).dc_motor.map(|_| motor::Parameters::NOMINAL);
    let own = own.or(nominal);
    let own = own.ok_or_else(|| format!("{} turns no brush motor", bench.name(seat)))?;
    Ok(motor::Parameters {
        supply_mv: keys.supply_mv.unwrap_or(own.supply_mv),
        no_load_rpm: keys.no_load_rpm.unwrap_or(own.no_load_rpm),
        resistance_mohm: keys.resistance_mohm.unwrap_or(own.resistance_mohm),
        inertia_gcm2: keys.inertia_gcm2.unwrap_or(own.inertia_gcm2),
        friction_unm: keys.friction_unm.unwrap_or(own.friction_unm),
        load_unm: keys.load_unm.unwrap_or(own.load_unm),
        hall_pulses: keys.hall_pulses.unwrap_or(own.hall_pulses),
        hall_sensors: own.hall_sensors,
        encoder_cycles: own.encoder_cycles,
    })
}

impl DriveLayout {
    /// Checks that a new drive of the kind accepts its presets; the error has the row that it refuses, and the reason.
    pub(crate) fn try_presets(&self) -> Result<(), (usize, PresetError)> {
        let Some(device) = catalog::make(self.kind).ok().filter(|_| !self.presets.is_empty()) else {
            return Ok(());
        };
        let presets = values(&self.presets, device.spec(), None);
        let setup = Setup { boot_fast: self.fast_boot, presets, ..Setup::default() };
        match Bench::new().add_with(self.kind, device, setup) {
            Err(AddError::Preset { row, why }) => Err((row, why)),
            _ => Ok(()),
        }
    }
}

/// The presets as whole values. A half goes onto what was set before, or is in the memory.
fn values(presets: &[Preset], spec: &Spec, memory: Option<&[u8]>) -> Vec<(usize, i64)> {
    let mut values: Vec<(usize, i64)> = Vec::new();
    for preset in presets {
        let before = values.iter().position(|&(row, _)| row == preset.row);
        let old = match before {
            Some(place) => values[place].1,
            None if preset.is_half() => stored(spec, memory, preset.row),
            None => 0,
        };
        let value = preset.onto(spec, old);
        match before {
            Some(place) => values[place].1 = value,
            None => values.push((preset.row, value)),
        }
    }
    values
}

/// Value of a row when a drive starts with `memory`.
fn stored(spec: &Spec, memory: Option<&[u8]>, row: usize) -> i64 {
    let mut bench = Bench::new();
    let setup = Setup { boot_fast: true, memory: memory.map(<[u8]>::to_vec), ..Setup::default() };
    let seat = catalog::make(spec.kind).ok().and_then(|device| bench.add_with(spec.kind, device, setup).ok());
    seat.map_or(0, |seat| bench.peek(seat, row))
}
