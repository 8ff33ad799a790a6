//! Execution of statements, of typed lines and of a program's lines.

use heapless::Vec;

use super::Interpreter;
use super::message_writer::MessageWriter;
use crate::device::{Duration, Link};
use crate::mdrive::error::Error;
use crate::mdrive::mcode::console::{CR_LF, MAX_CONNECTIONS, prompt};
use crate::mdrive::mcode::names::{Meaning, Name, Names};
use crate::mdrive::mcode::operand::{Operand, Place};
use crate::mdrive::mcode::parse::Expression;
use crate::mdrive::mcode::program::LINE_BYTES;
use crate::mdrive::mcode::statement::Statement;
use crate::mdrive::motion::Order;
use crate::mdrive::reader::Text;
use crate::mdrive::reasons::report;
use crate::mdrive::registers::Reg;
use crate::mdrive::variables::entry;

impl Interpreter<'_> {
    /// Executes the line of the program whose execution time has ended.
    pub(super) fn execute_program_line(&mut self) {
        let mut line = Vec::<u8, LINE_BYTES>::new();
        match self.drive.mcode.program.line(self.out.memory(), self.drive.mcode.vm.address()) {
            // No stored line is longer than the buffer.
            Some(text) => line.extend_from_slice(text).unwrap_or_default(),
            // There are no more lines: a program without E ends here, as in MC 7.2.5.
            None => return self.drive.mcode.end(&mut self.drive.motion),
        }
        if self.drive.mcode.vm.begin_line(self.at) {
            self.drive.mcode.consoles.send_to_all(self.at, &line, self.out);
            self.drive.mcode.consoles.send_to_all(self.at, b"\r\n", self.out);
        }
        let done = self.drive.reader(self.at).parse(&line).and_then(|statement| match statement {
            Statement::Print(items) => self.print_on(self.drive.mcode.consoles.links(), items),
            Statement::ListProgram(place) => self.list_program(self.drive.mcode.consoles.links(), place),
            _ => self.execute(&statement, true),
        });
        if let Err(error) = done {
            self.drive.mcode.fail_program(self.at, error, &mut self.drive.motion);
        }
        if self.drive.mcode.vm.end_line(self.at) {
            self.drive.mcode.call_next_interrupt(self.at, &mut self.drive.motion);
        }
    }

    /// Executes a statement of the program that runs (`program`) or of a typed line. The caller executes
    /// statements that print. BR, LB and RT are allowed in programs only. Other statements for programs act
    /// on the program that runs, also when typed.
    ///
    /// # Errors
    /// An error of MC 9; nothing has changed then.
    pub(in crate::mdrive) fn execute(
        &mut self,
        statement: &Statement<'_>,
        program: bool,
    ) -> Result<(), Error> {
        match statement {
            // "IF will be cleared to zero with a carriage return" (MC 5-36).
            Statement::Empty if !program => self.drive.mcode.vm.set_input_pending(false),
            Statement::Empty => {}
            Statement::Number(number) if !program && self.drive.mcode.vm.awaits_input() => {
                self.take_input(number)?;
            }
            Statement::Number(number) => self.repeat_motion(number)?,
            Statement::Set(reg, value) => self.set_variable(*reg, value)?,
            Statement::Name(code) => self.drive.write(self.at, Reg::DN, *code, self.out)?,
            Statement::SetUser(name, value) => self.set_user(*name, value)?,
            Statement::SetList(list, parameters) => {
                self.drive.write_list(self.at, *list, parameters, self.out)?;
            }
            Statement::Declare(name, value) => {
                let value = value.as_ref().map_or(Ok(0), |value| self.evaluate(value))?;
                let meaning = if program { Meaning::Local(value) } else { Meaning::Global(value) };
                self.drive.mcode.names.add(*name, meaning)?;
            }
            Statement::Move { relative, way, notify_on_end, continuous } => {
                let (way, notify_on_end, continuous) = (self.evaluate(way)?, *notify_on_end, *continuous);
                let order = if *relative {
                    Order::By { distance: way, notify_on_end, continuous }
                } else {
                    Order::To { position: way, notify_on_end, continuous }
                };
                self.drive.order(self.at, order, self.out)?;
            }
            Statement::Slew(speed) => {
                let speed = self.evaluate(speed)?;
                self.drive.write(self.at, Reg::SL, speed, self.out)?;
            }
            Statement::HomeToIndex(way) => {
                let way = self.evaluate(way)?;
                let way =
                    u8::try_from(way).ok().filter(|way| (1..=4).contains(way)).ok_or(Error::HomeType)?;
                self.drive.order(self.at, Order::HomeToIndex(way), self.out)?;
            }
            Statement::Hold(time) => {
                self.needs_running()?;
                let ms = time.as_ref().map_or(Ok(0), |time| self.evaluate(time))?;
                let ms = u64::try_from(ms).ok().filter(|&ms| ms <= 65_000).ok_or(Error::IllegalValue)?;
                // "Blank/0=Motion stops" (MC 4.4).
                self.drive.mcode.vm.set_hold((ms != 0).then(|| self.at + Duration::millis(ms)));
            }
            Statement::Branch(place, condition) => {
                needs_line(program)?;
                if self.holds(condition.as_ref())? {
                    let address = self.drive.mcode.find_line(*place)?;
                    self.drive.mcode.vm.jump(address);
                }
            }
            Statement::Call(place, condition) => {
                self.needs_no_pause()?;
                if self.holds(condition.as_ref())? {
                    let address = self.drive.mcode.find_line(*place)?;
                    self.drive.mcode.vm.call(self.at, address, false)?;
                }
            }
            Statement::Return => {
                needs_line(program)?;
                self.drive.mcode.vm.ret(self.at)?;
            }
            Statement::End if program => self.drive.mcode.end(&mut self.drive.motion),
            Statement::End => {
                report(self.drive.mcode.end_by_command(&mut self.drive.motion), self.at, self.out);
            }
            Statement::Execute(place, mode) => {
                let mode = mode.as_ref().map_or(Ok(0), |mode| self.evaluate(mode))?;
                let mode = u8::try_from(mode).map_err(|_| Error::IllegalValue)?;
                self.drive.mcode.start(self.at, *place, mode, &mut self.drive.motion)?;
            }
            Statement::Pause => {
                report(self.drive.mcode.pause(self.at, &mut self.drive.motion, self.out), self.at, self.out);
            }
            Statement::Resume => {
                report(self.drive.mcode.resume(self.at, &mut self.drive.motion, self.out), self.at, self.out);
            }
            // In a program a label only marks a place.
            Statement::Label(_) => needs_line(program)?,
            Statement::OnError(Place::Address(0)) => self.drive.mcode.vm.set_handler(None),
            Statement::OnError(place) => {
                self.drive.mcode.find_line(*place)?;
                self.drive.mcode.vm.set_handler(Some(*place));
            }
            Statement::BreakPoint(Place::Address(0), _) => self.drive.mcode.vm.set_break_point(None, 0),
            Statement::BreakPoint(place, count) => {
                let address = self.drive.mcode.find_line(*place)?;
                let count = count.as_ref().map_or(Ok(0), |count| self.evaluate(count))?;
                let count = u16::try_from(count).map_err(|_| Error::IllegalValue)?;
                self.drive.mcode.vm.set_break_point(Some(address), count);
            }
            Statement::Input(variable) => {
                if self.drive.mcode.vm.awaits_input() {
                    return Err(Error::InputPending);
                }
                self.judge_input(*variable)?;
                self.drive.mcode.vm.await_input(*variable);
            }
            Statement::Increment(variable) => self.count_variable(*variable, 1)?,
            Statement::Decrement(variable) => self.count_variable(*variable, -1)?,
            Statement::Save => self.drive.save(self.at, self.out)?,
            Statement::Defaults => self.restore()?,
            Statement::Initialize => self.drive.initialize(self.at, self.out)?,
            Statement::Calibrate(mode) => {
                match mode.as_ref().map_or(Ok(0), |mode| self.evaluate(mode))? {
                    0 => self.drive.calibrate_by_command(self.at, false, self.out)?,
                    // The configuration test (MC 4-8) is not modelled.
                    1 => return Err(Error::NotAvailable),
                    _ => return Err(Error::IllegalValue),
                }
            }
            Statement::ClearLocked => self.drive.calibrate_by_command(self.at, true, self.out)?,
            Statement::Clear(place) => {
                self.clear_program(*place)?;
                // The program may be deleted, so it ends. OE is reset (MC 5-52).
                self.drive.mcode.end(&mut self.drive.motion);
                self.drive.mcode.vm.set_handler(None);
            }
            // The caller executes these statements, because it knows the recipients.
            Statement::Print(_) | Statement::ListProgram(_) | Statement::Program(_) => {}
        }
        Ok(())
    }

    /// Prints the items of PR on these connections.
    ///
    /// # Errors
    /// Those of [`Reader::print`](crate::mdrive::reader::Reader::print).
    pub(super) fn print_on(&mut self, links: Vec<Link, MAX_CONNECTIONS>, items: &[u8]) -> Result<(), Error> {
        let mut writer = MessageWriter::new(self.at, links, self.drive.bank.check_sums() != 0, self.out);
        self.drive.read(self.at, |reader| reader.print(items, &mut writer))?;
        writer.end();
        Ok(())
    }

    /// Lists the stored lines from a place on, on these connections (L, MC 5-40).
    ///
    /// # Errors
    /// Error 30, 42 or 44.
    pub(super) fn list_program(
        &mut self,
        links: Vec<Link, MAX_CONNECTIONS>,
        place: Option<Place>,
    ) -> Result<(), Error> {
        self.drive.bank.needs_unlocked()?;
        let mut address = place.map_or(Ok(1), |place| self.drive.mcode.address(place))?;
        while let Some(next) = self.drive.mcode.program.next(address) {
            let line = self.drive.mcode.program.copy(self.out.memory(), next).unwrap_or_default();
            let mut writer =
                MessageWriter::new(self.at, links.clone(), self.drive.bank.check_sums() != 0, self.out);
            writer.write(&line);
            writer.write(CR_LF);
            writer.end();
            address = next + 1;
        }
        Ok(())
    }

    /// FD: resets the variables to the factory's and deletes the program and the user variables, all of this
    /// also in the memory. Sets counters to 0 and sends the sign-on. Settings keep their values.
    ///
    /// # Errors
    /// Error 73 in motion.
    pub(super) fn restore(&mut self) -> Result<(), Error> {
        if self.drive.reader(self.at).is_in_motion() {
            return Err(Error::SaveInMotion);
        }
        self.drive.mcode.clear(&mut self.drive.motion);
        let serial = self.drive.bank.get(Reg::SerialCommands);
        self.drive.bank.factory_reset();
        self.drive.bank.set(Reg::SerialCommands, serial);
        self.drive.mcode.names = Names::new();
        self.drive.apply_variables(self.at, self.out);
        self.drive.motion.shaft_mut().set_steps(self.at, 0);
        self.drive.motion.shaft_mut().set_counts(self.at, 0);
        // From here until all of the memory is reset, it fails its test.
        self.drive.saving.begin(self.at, &mut self.drive.bank, &self.drive.mcode.names, self.out);
        self.drive.mcode.program.clear(self.at, 1, self.out);
        self.drive.mcode.consoles.greet(self.at, prompt(&self.drive.bank, self.drive.mcode.errors), self.out);
        Ok(())
    }

    /// CP: clears all lines from a place on, and their labels. Without a place it clears all lines and LK.
    ///
    /// # Errors
    /// Error 30 or 42; 44 if the program is locked; 74 in motion. Nothing has happened then.
    fn clear_program(&mut self, place: Option<Place>) -> Result<(), Error> {
        if self.drive.reader(self.at).is_in_motion() {
            return Err(Error::ClearInMotion);
        }
        let from = match place {
            Some(place) => {
                self.drive.bank.needs_unlocked()?;
                self.drive.mcode.address(place)?
            }
            None => 1,
        };
        self.drive.mcode.clear_program(self.at, from, self.out);
        if place.is_none() {
            self.drive.bank.set(Reg::LK, 0);
            self.drive.saving.save_unlocked(self.at, self.drive.bank.model(), self.out);
        }
        Ok(())
    }

    /// Computes an expression. Reading ER clears it.
    ///
    /// # Errors
    /// Those of [`Reader::evaluate`](crate::mdrive::reader::Reader::evaluate).
    fn evaluate(&mut self, expression: &Expression<'_>) -> Result<i32, Error> {
        self.drive.read(self.at, |reader| reader.evaluate(expression))
    }

    /// Returns true if a condition is not 0, or if there is no condition.
    fn holds(&mut self, condition: Option<&Expression<'_>>) -> Result<bool, Error> {
        condition.map_or(Ok(true), |condition| self.drive.read(self.at, |reader| reader.holds(condition)))
    }

    /// Sets a variable to the value of an expression.
    fn set_variable(&mut self, reg: Reg, value: &Expression<'_>) -> Result<(), Error> {
        let value = match reg {
            // A value that does not fit in 32 bits is outside of CR's range.
            Reg::CR => self.drive.read(self.at, |reader| reader.evaluate_ratio(value))?,
            _ => self.evaluate(value)?,
        };
        self.drive.write_mcode(self.at, reg, value, self.out)
    }

    /// Sets a user variable to the value of an expression.
    fn set_user(&mut self, name: Name, value: &Expression<'_>) -> Result<(), Error> {
        let value = self.evaluate(value)?;
        self.drive.mcode.names.set(name, value)
    }

    /// Stores the number that IV waits for. Only CR can get a number with a fraction.
    fn take_input(&mut self, number: &Expression<'_>) -> Result<(), Error> {
        match self.drive.mcode.vm.take_input() {
            Some(Operand::Variable(reg)) if reg == Reg::CR || !number.is_ratio() => {
                self.set_variable(reg, number)
            }
            Some(Operand::User(name)) if !number.is_ratio() => self.set_user(name, number),
            _ => Err(Error::IllegalData),
        }
    }

    /// Checks that IV may wait for a variable.
    ///
    /// # Errors
    /// Error 25 for a read-only variable, 30 for a name that is not a variable.
    fn judge_input(&self, variable: Operand) -> Result<(), Error> {
        match variable {
            Operand::Variable(reg) if !entry(reg).access.writes() => Err(Error::ReadOnly),
            Operand::User(name) if self.drive.mcode.names.value(name).is_none() => Err(Error::UnknownLabel),
            _ => Ok(()),
        }
    }

    /// Adds `by` to a variable (IC, DC).
    fn count_variable(&mut self, variable: Operand, by: i32) -> Result<(), Error> {
        match variable {
            Operand::Variable(reg) => self.drive.count(self.at, reg, by, self.out),
            Operand::User(name) => {
                let value = self.drive.mcode.names.value(name).ok_or(Error::UnknownLabel)?;
                self.drive.mcode.names.set(name, value.wrapping_add(by))
            }
            Operand::Number(_) | Operand::Ratio(_) => Err(Error::IllegalData),
        }
    }

    /// Returns error 40 unless a program runs and is not paused (PS).
    fn needs_running(&self) -> Result<(), Error> {
        self.needs_no_pause()?;
        if self.drive.mcode.vm.is_running() { Ok(()) } else { Err(Error::NotRunning) }
    }

    /// Returns error 40 while the program is paused (PS).
    fn needs_no_pause(&self) -> Result<(), Error> {
        if self.drive.mcode.vm.is_paused() { Err(Error::NotRunning) } else { Ok(()) }
    }

    /// Repeats the last motion command with a number that was given alone (MC 5-45), unless NE is 0.
    fn repeat_motion(&mut self, number: &Expression<'_>) -> Result<(), Error> {
        if number.is_ratio() {
            return Err(Error::IllegalData);
        }
        let number = self.evaluate(number)?;
        let last = self.drive.mcode.vm.last_motion().filter(|_| self.drive.bank.word(Reg::NE) != 0);
        self.drive.write(self.at, last.ok_or(Error::IllegalData)?, number, self.out)
    }
}

/// Returns error 46 unless the line belongs to the program. A typed line has no position in the program.
fn needs_line(program: bool) -> Result<(), Error> {
    if program { Ok(()) } else { Err(Error::NotInProgramMode) }
}
