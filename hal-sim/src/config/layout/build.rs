//! Building the bench of a layout.

use drivetwin_firmware::device::{PresetError, Spec};
use drivetwin_firmware::motor::{self, stepper};

use super::{At, BoardLayout, BrushKeys, BusLayout, DriveLayout, Layout, MotorKind, MotorLayout};
use crate::bench::{AddError, Bench, Bus, DriveId, Motor, MotorModel, Settings, Setup};
use crate::catalog;
use crate::config::preset::{self, Preset};

/// A bench that was made from a [`Layout`].
pub struct Built {
    /// The bench, at [`Instant::ZERO`](drivetwin_firmware::device::Instant::ZERO).
    pub bench: Bench,
    /// Handles of [`Layout::drives`], in that order.
    pub drives: Vec<DriveId>,
    /// Handles of [`Layout::buses`], in that order; [`Bench::bus`] finds the lines of other ports.
    pub buses: Vec<Bus>,
    /// Handles of [`Layout::motors`], in that order.
    pub motors: Vec<Motor>,
}

/// Handles of the entries of a [`Layout`] on a bench.
pub struct Added {
    /// Handles of [`Layout::drives`], in that order.
    pub drives: Vec<DriveId>,
    /// Handles of [`Layout::buses`], in that order.
    pub buses: Vec<Bus>,
    /// Handles of [`Layout::motors`], in that order.
    pub motors: Vec<Motor>,
}

impl Layout {
    /// Makes the bench of a layout, for instance with the layout's own [settings](Self::settings). The order
    /// of entries in the layout does not change the behaviour of the bench.
    ///
    /// `setups` contains the memory content and persist function of each of [`drives`](Self::drives), in that
    /// order. Presets, fast start and motors are added from the layout. A drive without an entry starts with
    /// erased memory.
    ///
    /// # Errors
    /// One sentence that says what is wrong: a drive refuses a preset, a name is not valid, or there is no
    /// such kind, motor or line.
    ///
    /// # Panics
    /// If the layout has an index of a drive, motor or pin that does not exist, or two lines with the same
    /// name. Layouts from [`bench_file::parse`](crate::config::bench_file::parse) and from the command line
    /// are always correct.
    pub fn build(&self, settings: Settings, setups: Vec<Setup>) -> Result<Built, String> {
        let mut bench = Bench::with(settings);
        let Added { drives, buses, motors } = self.add_to(&mut bench, setups)?;
        Ok(Built { bench, drives, buses, motors })
    }

    /// The drives, shared lines and motors of a bench, so that the tables of a bench file can refer to them:
    /// [`parse_more`](crate::config::bench_file::parse_more) reads these tables, and [`add_to`](Self::add_to) adds
    /// what they have to the bench.
    #[must_use]
    pub fn of(bench: &Bench) -> Self {
        let drives = bench.drives().map(|id| DriveLayout {
            name: bench.name(id).to_owned(),
            kind: bench.spec(id).kind,
            listen: Vec::new(),
            nv: None,
            presets: Vec::new(),
            program: None,
            fast_boot: false,
            faults: Vec::new(),
            board: bench.is_elsewhere(id).then(BoardLayout::default),
        });
        let buses = bench.shared_buses().map(|bus| BusLayout {
            name: bench.bus_name(bus).to_owned(),
            listen: Vec::new(),
            drives: bench.ports(bus).iter().map(|&(DriveId(drive), port)| (drive as usize, port)).collect(),
            collisions: false,
            strict: false,
        });
        let motors = bench.motors().map(|motor| {
            let (DriveId(drive), axis) = bench.turned_by(motor);
            let is = MotorKind::Stepper(stepper::StepperParameters::NOMINAL);
            MotorLayout { name: bench.motor_name(motor).to_owned(), drive: drive as usize, axis, is }
        });
        Self { drives: drives.collect(), buses: buses.collect(), motors: motors.collect(), ..Self::default() }
    }

    /// Adds to a bench what the layout has more than the bench. The first drives, shared lines and motors of the
    /// layout are those [of](Self::of) the bench. `setups` are those of the new drives; see [`build`](Self::build).
    ///
    /// # Errors
    /// As [`build`](Self::build). What was added before the error remains on the bench.
    ///
    /// # Panics
    /// As [`build`](Self::build).
    pub fn add_to(&self, bench: &mut Bench, setups: Vec<Setup>) -> Result<Added, String> {
        let before: Vec<DriveId> = bench.drives().collect();
        let mut setups: Vec<Setup> = setups;
        setups.resize_with(self.drives.len() - before.len(), Setup::default);
        let by_name: Vec<usize> = sorted(&self.drives, |drive| drive.name.clone())
            .into_iter()
            .filter(|&index| index >= before.len())
            .collect();
        let mut ids: Vec<Option<DriveId>> = before.iter().copied().map(Some).collect();
        ids.resize(self.drives.len(), None);
        let mut later = vec![Vec::new(); self.drives.len()];
        for &index in &by_name {
            let setup = std::mem::take(&mut setups[index - before.len()]);
            let (id, not_saved) = self.add_drive(bench, index, setup)?;
            (ids[index], later[index]) = (Some(id), not_saved);
        }
        let ids: Vec<DriveId> = ids.into_iter().flatten().collect();
        let buses = self.share(bench, &ids);
        let motors = self.attach_motors(bench, &ids, &later)?;
        self.connect_sensors(bench, &ids, &motors);
        // Presets come after all connections, because a preset ends the start-up of a drive with a fast
        // start.
        for index in by_name {
            let presets = std::mem::take(&mut later[index]);
            if !presets.is_empty() {
                bench.preset(ids[index], presets).map_err(|error| self.cannot_add(index, &error))?;
            }
        }
        for bus in bench.buses().into_iter().filter(|_| self.strict) {
            bench.set_strict(bus, true);
        }
        let on_bench = |DriveId(index)| ids.get(index as usize).copied().unwrap_or(DriveId(index));
        for entry in &self.faults {
            let outlet = bench.find_outlet(&entry.bus);
            let outlet = outlet.ok_or_else(|| format!("there is no bus '{}'", entry.bus))?;
            let mut faults = entry.faults;
            faults.map_drives(on_bench);
            bench.set_faults(outlet, faults);
        }
        let mut scenarios = self.scenarios.clone();
        for scenario in &mut scenarios {
            scenario.map_drives(on_bench);
        }
        bench.play_all(scenarios)?;
        Ok(Added { drives: ids, buses, motors })
    }

    /// Adds a drive with its saved presets, and returns the other presets.
    fn add_drive(
        &self,
        bench: &mut Bench,
        index: usize,
        mut setup: Setup,
    ) -> Result<(DriveId, Vec<(usize, i64)>), String> {
        let drive = &self.drives[index];
        if drive.board.is_some() {
            let added = match drive.kind {
                "" => bench.add_unknown(&drive.name),
                kind => bench.add_elsewhere(&drive.name, catalog::make(kind)?),
            };
            return Ok((added.map_err(|error| self.cannot_add(index, &error))?, Vec::new()));
        }
        let device = catalog::make(drive.kind)?;
        let spec = device.spec();
        setup.boot_fast |= drive.fast_boot;
        for motor in self.motors.iter().filter(|motor| motor.drive == index) {
            if let MotorKind::Stepper(is) = &motor.is {
                setup.presets.extend(own_stepper(is, spec));
            }
        }
        setup.presets.extend(values(&drive.presets, spec, setup.memory.as_deref()));
        setup.presets.extend(spec.supply.zip(self.supply(index)));
        setup.external_motor |=
            self.motors.iter().any(|motor| motor.drive == index && matches!(motor.is, MotorKind::Brush(_)));
        let saved = |&(row, _): &(usize, i64)| spec.registers.rows.get(row).is_some_and(|row| row.saved != 0);
        let (now, later) = std::mem::take(&mut setup.presets).into_iter().partition(saved);
        setup.presets = now;
        let id =
            bench.add_with(&drive.name, device, setup).map_err(|error| self.cannot_add(index, &error))?;
        let mut faults = drive.faults.clone();
        faults.sort_unstable();
        for fault in faults {
            bench.fault(id, fault, true);
        }
        Ok((id, later))
    }

    /// The reason why a drive cannot be added, in one sentence.
    fn cannot_add(&self, index: usize, error: &AddError) -> String {
        let drive = &self.drives[index];
        let AddError::Preset { row, why } = *error else { return error.to_string() };
        let Some(spec) = catalog::specs().find(|spec| spec.kind == drive.kind) else {
            return error.to_string();
        };
        let name = spec.registers.rows.get(row).map_or("", |row| row.name);
        let kept = drive.nv.as_ref().map(|path| format!(" ({})", path.display())).unwrap_or_default();
        format!("{}: {}{kept}", drive.name, preset::refusal(spec, row, name, why))
    }

    /// Supply voltage of a drive in 0.1 V, if its motor sets one.
    fn supply(&self, drive: usize) -> Option<i64> {
        let of = |motor: &super::MotorLayout| match motor.is {
            MotorKind::Brush(keys) if motor.drive == drive => keys.supply_mv,
            _ => None,
        };
        self.motors.iter().find_map(of).map(|mv| i64::from((mv + 50) / 100))
    }

    fn share(&self, bench: &mut Bench, ids: &[DriveId]) -> Vec<Bus> {
        let mut buses: Vec<Option<Bus>> = bench.shared_buses().map(Some).collect();
        let before = buses.len();
        buses.resize(self.buses.len(), None);
        let by_name = sorted(&self.buses, |bus| bus.name.clone());
        for index in by_name.into_iter().filter(|&index| index >= before) {
            let shared = &self.buses[index];
            let ports: Vec<_> = shared.drives.iter().map(|&(drive, port)| (ids[drive], port)).collect();
            let bus = bench.share(&shared.name, &ports);
            bench.set_collisions(bus, shared.collisions);
            bench.set_strict(bus, shared.strict);
            buses[index] = Some(bus);
        }
        buses.into_iter().flatten().collect()
    }

    fn attach_motors(
        &self,
        bench: &mut Bench,
        ids: &[DriveId],
        presets: &[Vec<(usize, i64)>],
    ) -> Result<Vec<Motor>, String> {
        let mut motors: Vec<Option<Motor>> = bench.motors().map(Some).collect();
        let before = motors.len();
        motors.resize(self.motors.len(), None);
        let by_name = sorted(&self.motors, |motor| motor.name.clone());
        for index in by_name.into_iter().filter(|&index| index >= before) {
            let motor = &self.motors[index];
            let id = ids[motor.drive];
            let is = match &motor.is {
                MotorKind::Stepper(parameters) => MotorModel::Stepper(*parameters),
                MotorKind::Brush(keys) => {
                    let own = self.described(bench, motor.drive, id, &presets[motor.drive])?;
                    MotorModel::Brush(brush(bench, id, own, keys)?)
                }
            };
            motors[index] = Some(bench.attach_motor(&motor.name, id, motor.axis, is)?);
        }
        Ok(motors.into_iter().flatten().collect())
    }

    /// Parameters of the detached motor of a drive, as the drive's registers will describe it after these
    /// presets.
    fn described(
        &self,
        bench: &Bench,
        index: usize,
        id: DriveId,
        presets: &[(usize, i64)],
    ) -> Result<Option<motor::Parameters>, String> {
        let drive = &self.drives[index];
        let mut other = Bench::new();
        let (memory, presets) = (Some(bench.memory(id).to_vec()), presets.to_vec());
        let setup = Setup { boot_fast: true, external_motor: true, memory, presets, ..Setup::default() };
        let id = other.add_with(&drive.name, catalog::make(drive.kind)?, setup);
        Ok(other.detached_motor(id.map_err(|error| self.cannot_add(index, &error))?))
    }

    /// Adds encoders, switches and wires.
    fn connect_sensors(&self, bench: &mut Bench, ids: &[DriveId], motors: &[Motor]) {
        let at = |(drive, pin): At| (ids[drive], pin);
        // Each kind is added in the order of names, because the order of changes of one pin at one instant
        // may matter.
        let key = |(drive, pin): At| (self.drives[drive].name.clone(), pin);
        let keys = |ats: [Option<At>; 3]| ats.map(|at| at.map(key));
        let named = |motor: usize| self.motors[motor].name.clone();
        for index in sorted(&self.encoders, |encoder| {
            (named(encoder.motor), keys([encoder.a, encoder.b, encoder.index]), encoder.cycles_per_rev)
        }) {
            let encoder = &self.encoders[index];
            let to = [encoder.a, encoder.b, encoder.index].map(|pin| pin.map(at));
            bench.encode(motors[encoder.motor], encoder.cycles_per_rev, to);
        }
        for index in sorted(&self.switches, |switch| {
            let bits = |bound: Option<f64>| bound.map(f64::to_bits);
            (
                named(switch.motor),
                key(switch.to),
                bits(switch.closed.above_rev),
                bits(switch.closed.below_rev),
            )
        }) {
            let switch = &self.switches[index];
            bench.switch(motors[switch.motor], switch.closed, at(switch.to));
        }
        for index in sorted(&self.wires, |wire| (key(wire.from), key(wire.to))) {
            let wire = &self.wires[index];
            bench.wire(at(wire.from), at(wire.to));
        }
    }
}

/// Indices of entries, in the order of their keys.
fn sorted<T, K: Ord>(things: &[T], key: impl Fn(&T) -> K) -> Vec<usize> {
    let mut places: Vec<usize> = (0..things.len()).collect();
    places.sort_by_key(|&index| key(&things[index]));
    places
}

/// Returns true if a drive of this kind has its own motor, which a motor of a bench replaces only from the first
/// power-on of the drive on.
#[must_use]
pub fn has_own_motor(spec: &Spec) -> bool {
    let is_brush = catalog::make(spec.kind).is_ok_and(|device| device.internal_motor().is_some());
    is_brush || own_stepper(&stepper::StepperParameters::NOMINAL, spec).next().is_some()
}

/// Presets that give the internal motor of a drive the parameters of a stepper motor of the layout.
fn own_stepper(is: &stepper::StepperParameters, spec: &Spec) -> impl Iterator<Item = (usize, i64)> {
    let mnm = |unm: i64| (unm + unm.signum() * 500) / 1_000;
    // The internal motor has another rated current, so the holding torque is converted.
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

/// Parameters of a brush or brushless motor. A missing key has the value that the drive's registers describe,
/// or the nominal value if they do not describe a motor.
fn brush(
    bench: &Bench,
    id: DriveId,
    own: Option<motor::Parameters>,
    keys: &BrushKeys,
) -> Result<motor::Parameters, String> {
    let nominal = bench.spec(id).dc_motor.map(|_| motor::Parameters::NOMINAL);
    let own = own.or(nominal);
    let own = own.ok_or_else(|| format!("{} turns no brush motor", bench.name(id)))?;
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
    /// Adds the drive to a bench, with its presets, and switches its power on. `setup` has what the layout does
    /// not: the content of its memory.
    ///
    /// # Errors
    /// One sentence that says what is wrong: the name is taken or not valid, or the drive refuses a preset.
    pub fn add_to(self, bench: &mut Bench, setup: Setup) -> Result<DriveId, String> {
        let layout = Layout { drives: vec![self], ..Layout::default() };
        let (id, later) = layout.add_drive(bench, 0, setup)?;
        if !later.is_empty() {
            bench.preset(id, later).map_err(|error| layout.cannot_add(0, &error))?;
        }
        Ok(id)
    }

    /// Checks that a new drive of this kind accepts the presets. The error is the row that the drive refuses,
    /// and the reason.
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

/// Presets as values of whole registers. A preset of one half of a register changes that half of the value that an
/// earlier preset or the memory gives.
fn values(presets: &[Preset], spec: &Spec, memory: Option<&[u8]>) -> Vec<(usize, i64)> {
    let mut values: Vec<(usize, i64)> = Vec::new();
    for preset in presets {
        let before = values.iter().position(|&(row, _)| row == preset.row);
        let old = match before {
            Some(index) => values[index].1,
            None if preset.is_half() => stored(spec, memory, preset.row),
            None => 0,
        };
        let value = preset.onto(spec, old);
        match before {
            Some(index) => values[index].1 = value,
            None => values.push((preset.row, value)),
        }
    }
    values
}

/// Value of a row in a drive that starts with `memory`.
fn stored(spec: &Spec, memory: Option<&[u8]>, row: usize) -> i64 {
    let mut bench = Bench::new();
    let setup = Setup { boot_fast: true, memory: memory.map(<[u8]>::to_vec), ..Setup::default() };
    let id = catalog::make(spec.kind).ok().and_then(|device| bench.add_with(spec.kind, device, setup).ok());
    id.map_or(0, |id| bench.peek(id, row))
}
