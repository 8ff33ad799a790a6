//! Execution of the lines of a program (6.9).

use drivetwin_protocol::registers::Space;
use heapless::Vec;

use super::Program;
use super::instruction::{Instruction, Opcode, OperandForm, Operation};
use crate::rs434::{LINES, SETTINGS};

/// Number of the system registers, AX to JX.
pub(super) const REGISTERS: usize = 10;

/// Registers and stacks of a program, in addition to the drive's registers.
#[derive(Clone, Debug)]
pub(super) struct Vm {
    /// AX, BX to JX.
    pub(super) registers: [u16; REGISTERS],
    /// The line in execution: PC_REG.
    pub(super) line: u16,
    /// The next line, unless a loop continues with its first line.
    next: u16,
    calls: Vec<Call, 16>,
    /// Loops of all subroutines, the innermost one last.
    loops: Vec<Loop, 8>,
    /// Number of loops that belong to callers.
    caller_loops: usize,
}

/// A subroutine call that has not returned.
#[derive(Clone, Copy, Debug)]
struct Call {
    /// Line after the call, at which the caller continues.
    return_line: u16,
    /// Value of [`Vm::caller_loops`] in the caller.
    caller_loops: usize,
}

/// A FOR loop that is not finished.
#[derive(Clone, Copy, Debug)]
struct Loop {
    /// First line.
    start: u16,
    /// Number of lines.
    length: u16,
    /// Rounds left, including the present one.
    rounds_left: u16,
}

/// Everything that a program can access: the drive, with the program in it.
pub(in crate::rs434) trait Host {
    /// The program, with its registers.
    fn program(&mut self) -> &mut Program;

    /// The drive's flash.
    fn memory(&self) -> &[u8];

    /// Value of one register of the bus, or of two if `wide`; `None` if there is no register to read.
    fn read(&mut self, space: Space, first: u16, wide: bool) -> Option<u32>;

    /// Writes one or two registers in the same way as the bus. A value out of range is only a warning of the
    /// drive (ERROR bit 13), not an error. This is the last action of a line. Returns true if the write has
    /// an immediate effect.
    ///
    /// # Errors
    /// A register cannot be written; then nothing was written.
    fn write(&mut self, space: Space, first: u16, words: &[u16]) -> Result<bool, CannotWrite>;
}

/// The register does not exist, or cannot be written at all or at present.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::rs434) struct CannotWrite;

/// Result of executing a line.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::rs434) enum Step {
    /// Continue with the next line after the duration of a line.
    Next,
    /// Like `Next`, after a write of a register with an immediate effect.
    Acted,
    /// Continue with the next line after this number of ms.
    Delay(u16),
    /// The program ends by CMD_STOP_PROGRAM.
    End,
    /// The program ends by CMD_FULL_STOP_PROGRAM.
    FullEnd,
    /// The line cannot be executed.
    Error,
}

/// Executes the next line.
pub(super) fn step(host: &mut impl Host) -> Step {
    execute(host).unwrap_or(Step::Error)
}

/// Executes the next line; `None` if that is not possible.
fn execute(host: &mut impl Host) -> Option<Step> {
    let line = host.program().vm.next_pc();
    let instruction = Instruction(fetch(host, line)?);
    let vm = &mut host.program().vm;
    vm.line = line;
    vm.next = line + 1;
    let Some(command) = instruction.command() else {
        // A new flash, in which all bits are 1, is a program that ends at once.
        return host.program().is_new().then_some(Step::End);
    };
    let Opcode { operation, wide, form } = command;
    let (register, data) = (instruction.register().into(), instruction.data());
    let bus = || Some((space(instruction.space())?, data));
    let (changed, second) = match form {
        OperandForm::NoOperand => match operation {
            Operation::Return => return vm.ret(),
            Operation::FullStop => return Some(Step::FullEnd),
            _ => return Some(Step::End),
        },
        OperandForm::Target => {
            if vm.jumps(operation, wide) {
                vm.next = vm.target(instruction)?;
            }
            return Some(Step::Next);
        }
        OperandForm::Time => return Some(Step::Delay(data)),
        OperandForm::Subroutine => return vm.call(data),
        OperandForm::Loop => return vm.repeat(data),
        OperandForm::Register => (register, 0),
        OperandForm::RegisterConstant if wide => (register, constant(host, wide)?),
        OperandForm::RegisterConstant | OperandForm::RegisterShift => (register, data.into()),
        OperandForm::RegisterRegister if operation == Operation::Move => (data, vm.get(register, wide)?),
        OperandForm::RegisterRegister => (register, vm.get(data, wide)?),
        OperandForm::RegisterModbus => {
            let (space, address) = bus()?;
            (register, host.read(space, address, wide)?)
        }
        OperandForm::ModbusRegister => {
            let second = vm.get(register, wide)?;
            return change(host, bus()?, command, instruction, second);
        }
        OperandForm::ModbusConstant | OperandForm::ModbusShift => {
            let second = constant(host, wide)?;
            return change(host, bus()?, command, instruction, second);
        }
        OperandForm::Modbus => return change(host, bus()?, command, instruction, 0),
    };
    host.program().vm.change(changed, command, instruction, second)
}

/// A line of the flash; `None` after the last one.
fn fetch(host: &impl Host, line: u16) -> Option<u32> {
    let place = SETTINGS + 4 * usize::from(existing(line)?);
    host.memory().get(place..place + 4)?.first_chunk().copied().map(u32::from_le_bytes)
}

/// Value of uCMD_DATA, the line after this one. A 16-bit command uses its low half.
fn constant(host: &mut impl Host, wide: bool) -> Option<u32> {
    let line = host.program().vm.next;
    let constant = fetch(host, line)?;
    host.program().vm.next = line + 1;
    Some(if wide { constant } else { constant & 0xFFFF })
}

/// The address space for a value of uTypeModbusReg.
fn space(number: u8) -> Option<Space> {
    match number {
        0 => Some(Space::Discrete),
        1 => Some(Space::Coil),
        2 => Some(Space::Input),
        3 => Some(Space::Holding),
        _ => None,
    }
}

/// Executes a command on one or two registers of the bus, with a second operand.
#[inline(never)]
fn change(
    host: &mut impl Host,
    (space, address): (Space, u16),
    command: Opcode,
    instruction: Instruction,
    second: u32,
) -> Option<Step> {
    let Opcode { operation, wide, .. } = command;
    let bits = matches!(space, Space::Coil | Space::Discrete);
    let result = match operation {
        Operation::Move => second,
        Operation::Not if bits => host.read(space, address, wide)? ^ 0x0001_0001,
        _ => calculate(operation, instruction, host.read(space, address, wide)?, second)?,
    };
    let words = split(result);
    // Any value other than 0 sets a bit.
    let words = if bits { words.map(|word| u16::from(word != 0)) } else { words };
    let acted = host.write(space, address, words.get(..if wide { 2 } else { 1 })?).ok()?;
    Some(if acted { Step::Acted } else { Step::Next })
}

/// D as a function of S1 and S2. A 16-bit command uses only the low half (RS434-32).
fn calculate(operation: Operation, instruction: Instruction, first: u32, second: u32) -> Option<u32> {
    Some(match operation {
        Operation::Add => first.wrapping_add(second),
        Operation::Subtract => first.wrapping_sub(second),
        Operation::Divide => first.checked_div(second)?,
        Operation::Multiply => first.wrapping_mul(second),
        Operation::And => first & second,
        Operation::Or => first | second,
        Operation::Xor => first ^ second,
        Operation::Shift if instruction.type_jmp() => first.checked_shr(second).unwrap_or(0),
        Operation::Shift => first.checked_shl(second).unwrap_or(0),
        Operation::Not => !first,
        _ => second,
    })
}

pub(in crate::rs434) const fn join(low: u16, high: u16) -> u32 {
    (high as u32) << 16 | low as u32
}

const fn split(value: u32) -> [u16; 2] {
    [(value & 0xFFFF) as u16, (value >> 16) as u16]
}

impl Vm {
    pub(super) fn new() -> Self {
        Self {
            registers: [0; REGISTERS],
            line: 0,
            next: 0,
            calls: Vec::new(),
            loops: Vec::new(),
            caller_loops: 0,
        }
    }

    /// Goes to line 0. The system registers keep their values.
    pub(super) fn rewind(&mut self) {
        (self.line, self.next, self.caller_loops) = (0, 0, 0);
        self.calls.clear();
        self.loops.clear();
    }

    /// The next line. At the end of a round this is the first line of the loop, if there are rounds left. A
    /// loop whose body does not contain the next line ends.
    fn next_pc(&mut self) -> u16 {
        while self.loops.len() > self.caller_loops
            && let Some(innermost) = self.loops.last_mut()
        {
            let into = self.next.wrapping_sub(innermost.start);
            if into < innermost.length {
                break;
            }
            if into == innermost.length && innermost.rounds_left > 1 {
                innermost.rounds_left -= 1;
                self.next = innermost.start;
                break;
            }
            self.loops.pop();
        }
        self.next
    }

    /// Value of a system register, or of a pair of them.
    fn get(&self, number: u16, wide: bool) -> Option<u32> {
        let number = usize::from(number);
        if wide {
            self.registers.get(number..number + 2)?.first_chunk().map(|&[low, high]| join(low, high))
        } else {
            self.registers.get(number).map(|&word| word.into())
        }
    }

    /// Executes a command on a system register, or on a pair of them, with a second operand.
    fn change(
        &mut self,
        number: u16,
        command: Opcode,
        instruction: Instruction,
        second: u32,
    ) -> Option<Step> {
        let number = usize::from(number);
        if command.wide {
            let pair = self.registers.get_mut(number..number + 2)?.first_chunk_mut()?;
            let [low, high] = *pair;
            *pair = split(calculate(command.operation, instruction, join(low, high), second)?);
        } else {
            let register = self.registers.get_mut(number)?;
            let result = calculate(command.operation, instruction, (*register).into(), second)?;
            *register = (result & 0xFFFF) as u16;
        }
        Some(Step::Next)
    }

    /// Returns true if the jump is taken.
    fn jumps(&self, jump: Operation, wide: bool) -> bool {
        let [ax, bx, _, _, _, _, gx, hx, ix, jx] = self.registers;
        let (first, second) = if wide { (join(gx, hx), join(ix, jx)) } else { (ax.into(), bx.into()) };
        match jump {
            Operation::JumpEqual => first == second,
            Operation::JumpUnequal => first != second,
            Operation::JumpGreater => first > second,
            Operation::JumpLess => first < second,
            _ => true,
        }
    }

    /// Target line of a jump (RS434-29).
    fn target(&self, instruction: Instruction) -> Option<u16> {
        let data = instruction.data();
        if instruction.type_jmp() {
            existing(self.line.checked_add_signed(data.cast_signed())?)
        } else {
            existing(data)
        }
    }

    /// Executes CMD_CALL.
    fn call(&mut self, subroutine: u16) -> Option<Step> {
        let subroutine = existing(subroutine)?;
        self.calls.push(Call { return_line: self.next, caller_loops: self.caller_loops }).ok()?;
        (self.next, self.caller_loops) = (subroutine, self.loops.len());
        Some(Step::Next)
    }

    /// Executes CMD_RETURN, which also ends the loops of the subroutine.
    fn ret(&mut self) -> Option<Step> {
        let Call { return_line, caller_loops } = self.calls.pop()?;
        self.loops.truncate(self.caller_loops);
        (self.next, self.caller_loops) = (return_line, caller_loops);
        Some(Step::Next)
    }

    /// Executes CMD_FOR: the high byte is the number of lines, the low byte the number of rounds (RS434-30).
    fn repeat(&mut self, data: u16) -> Option<Step> {
        let [length, rounds] = data.to_be_bytes().map(u16::from);
        match (length, rounds) {
            (0, _) => {}
            (_, 0) => self.next += length,
            _ => self.loops.push(Loop { start: self.next, length, rounds_left: rounds }).ok()?,
        }
        Some(Step::Next)
    }
}

/// Returns `line` if there is such a line.
fn existing(line: u16) -> Option<u16> {
    (usize::from(line) < LINES).then_some(line)
}
