//! Execution of statements.

use super::super::drive::Drive;
use super::super::error::Error;
use super::super::motion::Order;
use super::super::reasons::report;
use super::super::registers::Reg;
use super::super::variables::{RATIO_ONE, entry};
use super::console::prompt;
use super::names::{Meaning, Names};
use super::parse::Expression;
use super::statement::{Name, Operand, Operator, Place, Statement, Step};
use crate::device::{Context, Duration, Instant};

impl Drive {
    /// Executes a statement of the program that runs (`program`) or of a typed line. The caller executes
    /// statements that print. BR, LB and RT are allowed in programs only. Other statements for programs act
    /// on the program that runs, also when typed.
    ///
    /// # Errors
    /// An error of MC 9; nothing has changed then.
    pub(in crate::mdrive) fn execute(
        &mut self,
        at: Instant,
        statement: &Statement<'_>,
        program: bool,
        out: &mut dyn Context,
    ) -> Result<(), Error> {
        match statement {
            // "IF will be cleared to zero with a carriage return" (MC 5-36).
            Statement::Empty if !program => self.mcode.vm.set_input_pending(false),
            Statement::Empty => {}
            Statement::Number(number) if !program && self.mcode.vm.awaits_input() => {
                self.take_input(at, number, out)?;
            }
            Statement::Number(number) => self.repeat_motion(at, number, out)?,
            Statement::Set(reg, value) => self.set_variable(at, *reg, value, out)?,
            Statement::Name(code) => self.write(at, Reg::DN, *code, out)?,
            Statement::SetUser(name, value) => self.set_user(at, *name, value)?,
            Statement::SetList(list, parameters) => self.write_list(at, *list, parameters, out)?,
            Statement::Declare(name, value) => {
                let value = value.as_ref().map_or(Ok(0), |value| self.evaluate(at, value))?;
                let meaning = if program { Meaning::Local(value) } else { Meaning::Global(value) };
                self.mcode.names.add(*name, meaning)?;
            }
            Statement::Move { relative, way, notify_on_end, continuous } => {
                let (way, notify_on_end, continuous) = (self.evaluate(at, way)?, *notify_on_end, *continuous);
                let order = if *relative {
                    Order::By { distance: way, notify_on_end, continuous }
                } else {
                    Order::To { position: way, notify_on_end, continuous }
                };
                self.order(at, order, out)?;
            }
            Statement::Slew(speed) => {
                let speed = self.evaluate(at, speed)?;
                self.write(at, Reg::SL, speed, out)?;
            }
            Statement::HomeToIndex(way) => {
                let way = self.evaluate(at, way)?;
                let way =
                    u8::try_from(way).ok().filter(|way| (1..=4).contains(way)).ok_or(Error::HomeType)?;
                self.order(at, Order::HomeToIndex(way), out)?;
            }
            Statement::Hold(time) => {
                self.needs_running()?;
                let ms = time.as_ref().map_or(Ok(0), |time| self.evaluate(at, time))?;
                let ms = u64::try_from(ms).ok().filter(|&ms| ms <= 65_000).ok_or(Error::IllegalValue)?;
                // "Blank/0=Motion stops" (MC 4.4).
                self.mcode.vm.set_hold((ms != 0).then(|| at + Duration::millis(ms)));
            }
            Statement::Branch(place, condition) => {
                needs_line(program)?;
                if self.holds(at, condition.as_ref())? {
                    let address = self.mcode.find_line(*place)?;
                    self.mcode.vm.jump(address);
                }
            }
            Statement::Call(place, condition) => {
                self.needs_no_pause()?;
                if self.holds(at, condition.as_ref())? {
                    let address = self.mcode.find_line(*place)?;
                    self.mcode.vm.call(at, address, false)?;
                }
            }
            Statement::Return => {
                needs_line(program)?;
                self.mcode.vm.ret(at)?;
            }
            Statement::End if program => self.end_program(),
            Statement::End => report(self.end_by_command(), at, out),
            Statement::Execute(place, mode) => {
                let mode = mode.as_ref().map_or(Ok(0), |mode| self.evaluate(at, mode))?;
                let mode = u8::try_from(mode).map_err(|_| Error::IllegalValue)?;
                self.start_program(at, *place, mode)?;
            }
            Statement::Pause => report(self.pause_program(at, out), at, out),
            Statement::Resume => report(self.resume_program(at, out), at, out),
            // In a program a label only marks a place.
            Statement::Label(_) => needs_line(program)?,
            Statement::OnError(Place::Address(0)) => self.mcode.vm.set_handler(None),
            Statement::OnError(place) => {
                self.mcode.find_line(*place)?;
                self.mcode.vm.set_handler(Some(*place));
            }
            Statement::BreakPoint(Place::Address(0), _) => self.mcode.vm.set_break_point(None, 0),
            Statement::BreakPoint(place, count) => {
                let address = self.mcode.find_line(*place)?;
                let count = count.as_ref().map_or(Ok(0), |count| self.evaluate(at, count))?;
                let count = u16::try_from(count).map_err(|_| Error::IllegalValue)?;
                self.mcode.vm.set_break_point(Some(address), count);
            }
            Statement::Input(variable) => {
                if self.mcode.vm.awaits_input() {
                    return Err(Error::InputPending);
                }
                self.judge_input(*variable)?;
                self.mcode.vm.await_input(*variable);
            }
            Statement::Increment(variable) => self.count_variable(at, *variable, 1, out)?,
            Statement::Decrement(variable) => self.count_variable(at, *variable, -1, out)?,
            Statement::Save => self.save(at, out)?,
            Statement::Defaults => self.restore(at, out)?,
            Statement::Initialize => self.initialize(at, out)?,
            Statement::Calibrate(mode) => {
                match mode.as_ref().map_or(Ok(0), |mode| self.evaluate(at, mode))? {
                    0 => self.calibrate_by_command(at, false, out)?,
                    // The configuration test (MC 4-8) is not modelled.
                    1 => return Err(Error::NotAvailable),
                    _ => return Err(Error::IllegalValue),
                }
            }
            Statement::ClearLocked => self.calibrate_by_command(at, true, out)?,
            Statement::Clear(place) => {
                self.clear_program(at, *place, out)?;
                // The program may be deleted, so it ends. OE is reset (MC 5-52).
                self.end_program();
                self.mcode.vm.set_handler(None);
            }
            // The caller executes these statements, because it knows the recipients.
            Statement::Print(_) | Statement::ListProgram(_) | Statement::Program(_) => {}
        }
        Ok(())
    }

    /// FD: resets the variables to the factory's and deletes the program and the user variables, all of this
    /// also in the memory. Sets counters to 0 and sends the sign-on. Settings keep their values.
    ///
    /// # Errors
    /// Error 73 in motion.
    pub(super) fn restore(&mut self, at: Instant, out: &mut dyn Context) -> Result<(), Error> {
        if self.is_in_motion() {
            return Err(Error::SaveInMotion);
        }
        self.clear_activity();
        let serial = self.bank.get(Reg::SerialCommands);
        self.bank.factory_reset();
        self.bank.set(Reg::SerialCommands, serial);
        self.mcode.names = Names::new();
        self.apply_variables(at, out);
        self.motion.shaft_mut().set_steps(at, 0);
        self.motion.shaft_mut().set_counts(at, 0);
        // From here until all of the memory is reset, it fails its test.
        self.saving.begin(at, &mut self.bank, &self.mcode.names, out);
        self.mcode.program.clear(at, 1, out);
        self.mcode.consoles.greet(at, prompt(&self.bank, self.errors), out);
        Ok(())
    }

    /// CP: clears all lines from a place on, and their labels. Without a place it clears all lines and LK.
    ///
    /// # Errors
    /// Error 30 or 42; 44 if the program is locked; 74 in motion. Nothing has happened then.
    fn clear_program(
        &mut self,
        at: Instant,
        place: Option<Place>,
        out: &mut dyn Context,
    ) -> Result<(), Error> {
        if self.is_in_motion() {
            return Err(Error::ClearInMotion);
        }
        let from = match place {
            Some(place) => {
                self.bank.needs_unlocked()?;
                self.mcode.address(place)?
            }
            None => 1,
        };
        self.mcode.clear_program(at, from, out);
        if place.is_none() {
            self.bank.set(Reg::LK, 0);
            self.saving.save_unlocked(at, self.bank.model(), out);
        }
        Ok(())
    }

    /// Computes an expression in 32 bits that wrap, and drops the fraction of the result.
    ///
    /// # Errors
    /// Error 21 for a division by 0, 30 for a name that is not a variable.
    pub(super) fn evaluate(&mut self, at: Instant, expression: &Expression<'_>) -> Result<i32, Error> {
        let ratio = expression.is_ratio();
        let value = self.compute(at, expression, ratio)?;
        Ok(if ratio { value / i64::from(RATIO_ONE) } else { value } as i32)
    }

    /// Computes an expression, in thousandths if `ratio`.
    fn compute(&mut self, at: Instant, expression: &Expression<'_>, ratio: bool) -> Result<i64, Error> {
        let (mut value, mut ratio) = (0, ratio);
        for step in expression.steps() {
            let operand = self.term(at, step.operand(), ratio)?;
            value = match step {
                Step::Calculate { operator, not, .. } => {
                    operator.apply(value, if not { !operand } else { operand }, ratio)?
                }
                Step::Compare(relation, _) => {
                    // The result of a comparison has no fraction, whatever was compared.
                    ratio = false;
                    relation.holds(value, operand).into()
                }
            };
        }
        Ok(value)
    }

    /// Value of an operand, in thousandths if `ratio`.
    fn term(&mut self, at: Instant, operand: Operand, ratio: bool) -> Result<i64, Error> {
        if ratio { self.thousandths(at, operand) } else { self.operand(at, operand).map(i64::from) }
    }

    /// Returns true if a condition is not 0, or if there is no condition.
    fn holds(&mut self, at: Instant, condition: Option<&Expression<'_>>) -> Result<bool, Error> {
        let Some(condition) = condition else { return Ok(true) };
        self.compute(at, condition, condition.is_ratio()).map(|value| value != 0)
    }

    /// Sets a variable to the value of an expression.
    fn set_variable(
        &mut self,
        at: Instant,
        reg: Reg,
        value: &Expression<'_>,
        out: &mut dyn Context,
    ) -> Result<(), Error> {
        let value = match reg {
            // A value that does not fit in 32 bits is outside of CR's range.
            Reg::CR => i32::try_from(self.compute(at, value, true)?).unwrap_or(i32::MAX),
            _ => self.evaluate(at, value)?,
        };
        self.write_mcode(at, reg, value, out)
    }

    /// Sets a user variable to the value of an expression.
    fn set_user(&mut self, at: Instant, name: Name, value: &Expression<'_>) -> Result<(), Error> {
        let value = self.evaluate(at, value)?;
        self.mcode.names.set(name, value)
    }

    /// Stores the number that IV waits for. Only CR can get a number with a fraction.
    fn take_input(
        &mut self,
        at: Instant,
        number: &Expression<'_>,
        out: &mut dyn Context,
    ) -> Result<(), Error> {
        match self.mcode.vm.take_input() {
            Some(Operand::Variable(reg)) if reg == Reg::CR || !number.is_ratio() => {
                self.set_variable(at, reg, number, out)
            }
            Some(Operand::User(name)) if !number.is_ratio() => self.set_user(at, name, number),
            _ => Err(Error::IllegalData),
        }
    }

    /// Checks that IV may wait for a variable.
    ///
    /// # Errors
    /// Error 25 for a read-only variable, 30 for a name that is not a variable.
    fn judge_input(&mut self, variable: Operand) -> Result<(), Error> {
        match variable {
            Operand::Variable(reg) if !entry(reg).access.writes() => Err(Error::ReadOnly),
            Operand::User(name) if !self.has_user_variable(name) => Err(Error::UnknownLabel),
            _ => Ok(()),
        }
    }

    /// Adds `by` to a variable (IC, DC).
    fn count_variable(
        &mut self,
        at: Instant,
        variable: Operand,
        by: i32,
        out: &mut dyn Context,
    ) -> Result<(), Error> {
        match variable {
            Operand::Variable(reg) => self.count(at, reg, by, out),
            Operand::User(name) => {
                let value = self.operand(at, variable)?;
                self.mcode.names.set(name, value.wrapping_add(by))
            }
            Operand::Number(_) | Operand::Ratio(_) => Err(Error::IllegalData),
        }
    }

    /// Returns error 40 unless a program runs and is not paused (PS).
    fn needs_running(&self) -> Result<(), Error> {
        self.needs_no_pause()?;
        if self.mcode.vm.is_running() { Ok(()) } else { Err(Error::NotRunning) }
    }

    /// Returns error 40 while the program is paused (PS).
    fn needs_no_pause(&self) -> Result<(), Error> {
        if self.mcode.vm.is_paused() { Err(Error::NotRunning) } else { Ok(()) }
    }

    /// Repeats the last motion command with a number that was given alone (MC 5-45), unless NE is 0.
    fn repeat_motion(
        &mut self,
        at: Instant,
        number: &Expression<'_>,
        out: &mut dyn Context,
    ) -> Result<(), Error> {
        if number.is_ratio() {
            return Err(Error::IllegalData);
        }
        let number = self.evaluate(at, number)?;
        let last = self.mcode.vm.last_motion().filter(|_| self.bank.word(Reg::NE) != 0);
        self.write(at, last.ok_or(Error::IllegalData)?, number, out)
    }
}

impl Operator {
    /// Applies the operator to two values, in 32 bits that wrap, or in thousandths if `ratio`.
    ///
    /// # Errors
    /// Error 21: a division by 0.
    fn apply(self, left: i64, right: i64, ratio: bool) -> Result<i64, Error> {
        let one = i64::from(RATIO_ONE);
        let value = match self {
            Self::Plus => left.saturating_add(right),
            Self::Minus => left.saturating_sub(right),
            Self::Times if ratio => left.saturating_mul(right) / one,
            Self::Times => left.wrapping_mul(right),
            Self::Over => {
                let left = if ratio { left.saturating_mul(one) } else { left };
                left.checked_div(right).ok_or(Error::IllegalValue)?
            }
            Self::And => left & right,
            Self::Or => left | right,
            Self::Xor => left ^ right,
        };
        Ok(if ratio { value } else { (value as i32).into() })
    }
}

/// Returns error 46 unless the line belongs to the program. A typed line has no position in the program.
fn needs_line(program: bool) -> Result<(), Error> {
    if program { Ok(()) } else { Err(Error::NotInProgramMode) }
}
