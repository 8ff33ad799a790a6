//! What a statement does.

use super::super::drive::Drive;
use super::super::error::Error;
use super::super::motion::Order;
use super::super::registers::Reg;
use super::names::Meaning;
use super::statement::{Condition, Expression, List, Operand, Operator, Place, Relation, Statement};
use crate::device::{Duration, Instant, Sink};

impl Drive {
    /// Carries out a statement, be it a line of the program that runs or typed; what prints is for who has said so.
    /// BR, H and RT are for programs alone; the others that programs are made of act on the one that runs.
    ///
    /// # Errors
    /// What MC 9 says; nothing has happened then.
    pub(in crate::mdrive) fn execute(
        &mut self,
        at: Instant,
        statement: &Statement<'_>,
        program: bool,
        out: &mut dyn Sink,
    ) -> Result<(), Error> {
        match statement {
            // "IF will be cleared to zero with a carriage return" (MC 5-36).
            Statement::Empty if !program => self.mcode.vm.forget_input(),
            Statement::Empty => {}
            Statement::Number(number) => {
                let number = self.evaluate(at, number)?;
                match self.mcode.vm.awaited.take_if(|_| !program) {
                    Some(variable) => self.set_operand(at, variable, number, out)?,
                    None => self.repeat_motion(at, number, out)?,
                }
            }
            Statement::Set(reg, value) => {
                let value = self.evaluate(at, value)?;
                self.write_mcode(at, *reg, value, out)?;
            }
            Statement::SetUser(name, value) => {
                let value = self.evaluate(at, value)?;
                self.mcode.names.set(*name, value)?;
            }
            Statement::SetList(List::Trip(trip), parameters) => {
                self.define_trip(at, *trip, parameters)?;
            }
            Statement::SetList(list, parameters) => self.write_list(at, *list, parameters, out)?,
            Statement::Declare(name, value) => {
                let value = value.as_ref().map_or(Ok(0), |value| self.evaluate(at, value))?;
                let meaning = if program { Meaning::Local(value) } else { Meaning::Global(value) };
                self.mcode.names.add(*name, meaning)?;
            }
            Statement::Move { relative, way, announces, goes_on } => {
                let (way, announces, goes_on) = (self.evaluate(at, way)?, *announces, *goes_on);
                let order = if *relative {
                    Order::By { distance: way, announces, goes_on }
                } else {
                    Order::To { position: way, announces, goes_on }
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
                self.needs_program(program)?;
                let ms = time.as_ref().map_or(Ok(0), |time| self.evaluate(at, time))?;
                let ms = u64::try_from(ms).ok().filter(|&ms| ms <= 65_000).ok_or(Error::IllegalValue)?;
                // "Blank/0=Motion stops" (MC 4.4).
                self.mcode.vm.hold((ms != 0).then(|| at + Duration::millis(ms)));
            }
            Statement::Branch(place, condition) => {
                self.needs_program(program)?;
                if self.holds(at, condition.as_ref())? {
                    let address = self.find_line(*place)?;
                    self.mcode.vm.jump(address);
                }
            }
            Statement::Call(place, condition) => {
                self.needs_no_pause()?;
                if self.holds(at, condition.as_ref())? {
                    let address = self.find_line(*place)?;
                    self.mcode.vm.call(at, address, false)?;
                }
            }
            Statement::Return => {
                self.needs_program(program)?;
                self.mcode.vm.come_back(at)?;
            }
            Statement::End => self.end_program(),
            Statement::Execute(place, mode) => {
                let mode = mode.as_ref().map_or(Ok(0), |mode| self.evaluate(at, mode))?;
                let mode = u8::try_from(mode).map_err(|_| Error::IllegalValue)?;
                self.start_program(at, *place, mode)?;
            }
            Statement::Pause => self.pause_program(at, out),
            Statement::Resume => self.resume_program(at, out),
            // In a program it is but a place.
            Statement::Label(_) if program => {}
            Statement::Label(_) => return Err(Error::NotInProgramMode),
            Statement::OnError(Place::Address(0)) => self.mcode.vm.set_handler(None),
            Statement::OnError(place) => {
                self.find_line(*place)?;
                self.mcode.vm.set_handler(Some(*place));
            }
            Statement::BreakPoint(Place::Address(0), _) => self.mcode.vm.set_break_point(None, 0),
            Statement::BreakPoint(place, count) => {
                let address = self.find_line(*place)?;
                let count = count.as_ref().map_or(Ok(0), |count| self.evaluate(at, count))?;
                let count = u16::try_from(count).map_err(|_| Error::IllegalValue)?;
                self.mcode.vm.set_break_point(Some(address), count);
            }
            Statement::Input(variable) => {
                if self.mcode.vm.awaits_input() {
                    return Err(Error::InputPending);
                }
                self.operand(at, *variable)?;
                self.mcode.vm.awaited = Some(*variable);
            }
            Statement::Increment(variable) => self.count_variable(at, *variable, 1, out)?,
            Statement::Decrement(variable) => self.count_variable(at, *variable, -1, out)?,
            Statement::Save => self.save(at, out)?,
            Statement::Defaults => self.restore(at, out)?,
            Statement::Initialize => self.initialize(at, out)?,
            Statement::Calibrate => self.calibrate(at, false, out)?,
            Statement::ClearLocked => self.calibrate(at, true, out)?,
            Statement::Clear(place) => {
                self.clear_program(at, *place, out)?;
                // The program may be gone; OE is reset (MC 5-52).
                self.end_program();
                self.mcode.vm.set_handler(None);
            }
            // Who hears it knows what to do.
            Statement::Print(_) | Statement::ListProgram(_) | Statement::Program(_) => {}
        }
        Ok(())
    }

    /// What an expression comes to, in 32 bits that wrap.
    ///
    /// # Errors
    /// 21 for a division by 0, 30 for a name that is no variable.
    pub(super) fn evaluate(&mut self, at: Instant, expression: &Expression) -> Result<i32, Error> {
        let first = self.operand(at, expression.first)?;
        let first = if expression.not { !first } else { first };
        let Some((operator, second)) = expression.then else { return Ok(first) };
        let second = self.operand(at, second)?;
        Ok(match operator {
            Operator::Plus => first.wrapping_add(second),
            Operator::Minus => first.wrapping_sub(second),
            Operator::Times => first.wrapping_mul(second),
            Operator::Over if second == -1 => first.wrapping_neg(),
            Operator::Over => first.checked_div(second).ok_or(Error::IllegalValue)?,
            Operator::And => first & second,
            Operator::Or => first | second,
            Operator::Xor => first ^ second,
        })
    }

    /// Whether a condition holds; none always does.
    fn holds(&mut self, at: Instant, condition: Option<&Condition>) -> Result<bool, Error> {
        let Some(condition) = condition else { return Ok(true) };
        let left = self.operand(at, condition.left)?;
        let Some((relation, right)) = condition.right else { return Ok(left != 0) };
        let right = self.operand(at, right)?;
        Ok(match relation {
            Relation::Equal => left == right,
            Relation::Unequal => left != right,
            Relation::Less => left < right,
            Relation::AtMost => left <= right,
            Relation::Greater => left > right,
            Relation::AtLeast => left >= right,
        })
    }

    /// Gives a variable a value.
    fn set_operand(
        &mut self,
        at: Instant,
        variable: Operand,
        value: i32,
        out: &mut dyn Sink,
    ) -> Result<(), Error> {
        match variable {
            Operand::Variable(reg) => self.write_mcode(at, reg, value, out),
            Operand::User(name) => self.mcode.names.set(name, value),
            Operand::Number(_) => Err(Error::IllegalData),
        }
    }

    /// IC, DC: adds to a variable.
    fn count_variable(
        &mut self,
        at: Instant,
        variable: Operand,
        by: i32,
        out: &mut dyn Sink,
    ) -> Result<(), Error> {
        match variable {
            Operand::Variable(reg) => self.count(at, reg, by, out),
            user => {
                let value = self.operand(at, user)?;
                self.set_operand(at, user, value.wrapping_add(by), out)
            }
        }
    }

    /// 40 unless it is a line of the program: what is typed has no part in where that is.
    fn needs_program(&self, program: bool) -> Result<(), Error> {
        self.needs_no_pause()?;
        if program { Ok(()) } else { Err(Error::NotRunning) }
    }

    /// 40 while PS holds the program: it stays where it is.
    fn needs_no_pause(&self) -> Result<(), Error> {
        if self.mcode.vm.is_paused() { Err(Error::NotRunning) } else { Ok(()) }
    }

    /// A number alone: the last motion command with it (MC 5-45), unless NE is 0.
    fn repeat_motion(&mut self, at: Instant, number: i32, out: &mut dyn Sink) -> Result<(), Error> {
        let last = self.mcode.vm.last_motion().filter(|_| self.bank.word(Reg::NE) != 0);
        let reg = match last.as_ref() {
            Some(b"MA") => Reg::MA,
            Some(b"MR") => Reg::MR,
            Some(_) => Reg::SL,
            None => return Err(Error::IllegalData),
        };
        self.write(at, reg, number, out)
    }
}
