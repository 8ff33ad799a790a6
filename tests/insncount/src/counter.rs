//! Counts of instructions in groups and interrupt handlers, and of the bytes of stack used.

use std::fmt;
use std::ops::Range;

use crate::thumb::{Instruction, Kind};

/// Everything that was counted so far.
pub(crate) struct Counter {
    /// Instructions of the whole run.
    total: u64,
    groups: Vec<Group>,
    /// Value of `total` at the begin mark of a part that has not ended.
    began: Option<u64>,
    handlers: Vec<Handler>,
    /// Handlers that have begun and not returned. Each has interrupted the one before it.
    frames: Vec<Frame>,
    /// The last instruction, if it is a call or a return. Its condition may have skipped it.
    jump: Option<Instruction>,
    stack: Range<u32>,
    /// Lowest address of the stack that has been written.
    lowest: u32,
}

/// Parts of a program that are counted under one name.
#[derive(Default)]
struct Group {
    parts: u64,
    instructions: u64,
    most: u64,
}

struct Handler {
    name: String,
    entry: u32,
    calls: u64,
    most: u64,
}

/// A handler that is running.
struct Frame {
    handler: usize,
    /// Number of calls that have not returned.
    depth: u32,
    instructions: u64,
}

impl Counter {
    pub(crate) const fn new() -> Self {
        Self {
            total: 0,
            groups: Vec::new(),
            began: None,
            handlers: Vec::new(),
            frames: Vec::new(),
            jump: None,
            stack: 0..0,
            lowest: 0,
        }
    }

    /// Adds an interrupt handler whose calls are counted.
    pub(crate) fn add_handler(&mut self, name: &str, entry: u32) {
        self.handlers.push(Handler { name: name.to_owned(), entry, calls: 0, most: 0 });
    }

    /// Records the lowest write into a stack.
    pub(crate) fn watch_stack(&mut self, stack: Range<u32>) {
        self.lowest = stack.end;
        self.stack = stack;
    }

    /// Handles an instruction that is about to be executed.
    pub(crate) fn executed(&mut self, instruction: &Instruction) {
        // If the condition of a jump skips it, the next instruction is the one after it in memory.
        if let Some(jump) = self.jump.take()
            && jump.next != instruction.address
        {
            self.jumped(jump.kind);
        }
        self.enter(instruction.address);
        self.total += 1;
        if let Some(frame) = self.frames.last_mut() {
            frame.instructions += 1;
        }
        match instruction.kind {
            Kind::Plain => {}
            Kind::Call | Kind::Return => self.jump = Some(*instruction),
            Kind::Group => self.groups.push(Group::default()),
            Kind::Begin => self.began = Some(self.total),
            Kind::End => self.end_part(),
        }
    }

    /// Handles a write to `address`, which may be outside the stack.
    pub(crate) fn stored(&mut self, address: u32) {
        if self.stack.contains(&address) {
            self.lowest = self.lowest.min(address);
        }
    }

    /// Begins a handler when its first instruction is executed, unless the handler already runs and loops to
    /// it.
    fn enter(&mut self, address: u32) {
        let Some(handler) = self.handlers.iter().position(|handler| handler.entry == address) else { return };
        if self.frames.iter().all(|frame| frame.handler != handler) {
            self.frames.push(Frame { handler, depth: 0, instructions: 0 });
        }
    }

    fn jumped(&mut self, kind: Kind) {
        let Some(frame) = self.frames.last_mut() else { return };
        if kind == Kind::Call {
            frame.depth += 1;
        } else if let Some(depth) = frame.depth.checked_sub(1) {
            frame.depth = depth;
        } else if let Some(handler) = self.handlers.get_mut(frame.handler) {
            handler.calls += 1;
            handler.most = handler.most.max(frame.instructions);
            self.frames.pop();
        }
    }

    fn end_part(&mut self) {
        if let (Some(began), Some(group)) = (self.began.take(), self.groups.last_mut()) {
            // The mark at the end of the part is not counted.
            let instructions = self.total - began - 1;
            group.parts += 1;
            group.instructions += instructions;
            group.most = group.most.max(instructions);
        }
    }
}

impl fmt::Display for Counter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for Group { parts, instructions, most } in &self.groups {
            writeln!(f, "group parts {parts} instructions {instructions} most {most}")?;
        }
        for Handler { name, calls, most, .. } in &self.handlers {
            writeln!(f, "handler {name} calls {calls} most {most}")?;
        }
        if !self.stack.is_empty() {
            writeln!(f, "stack {}", self.stack.end - self.lowest)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Executes two-byte instructions.
    fn run(counter: &mut Counter, course: &[(u32, Kind)]) {
        for &(address, kind) in course {
            counter.executed(&Instruction { address, next: address + 2, kind });
        }
    }

    #[test]
    fn a_handler_lasts_until_its_own_return() {
        use Kind::{Call, Plain, Return};
        let mut counter = Counter::new();
        counter.add_handler("outer", 0x100);
        counter.add_handler("inner", 0x200);
        let inner = [(0x200, Plain), (0x202, Return)];
        run(&mut counter, &[(0x10, Plain), (0x100, Plain), (0x102, Call), (0x300, Plain)]);
        run(&mut counter, &inner);
        // The function that `outer` has called returns. In `outer` the first return is skipped, because its
        // condition is false; the second one is executed.
        run(
            &mut counter,
            &[(0x302, Return), (0x104, Return), (0x106, Plain), (0x108, Return), (0x12, Plain)],
        );
        run(&mut counter, &inner);
        run(&mut counter, &[(0x14, Return), (0x16, Plain)]);
        assert_eq!(counter.to_string(), "handler outer calls 1 most 7\nhandler inner calls 2 most 2\n");
    }

    #[test]
    fn parts_are_counted_without_their_marks() {
        use Kind::{Begin, End, Group, Plain};
        let mut counter = Counter::new();
        run(&mut counter, &[(0, Group), (2, Begin), (4, Plain), (6, Plain), (8, End), (10, Plain)]);
        run(&mut counter, &[(2, Begin), (8, End), (12, Group)]);
        let lines = "group parts 2 instructions 2 most 2\ngroup parts 0 instructions 0 most 0\n";
        assert_eq!(counter.to_string(), lines);
    }

    #[test]
    fn the_deepest_write_into_the_stack_counts() {
        let mut counter = Counter::new();
        counter.watch_stack(0x1000..0x2000);
        for address in [0x1FFC, 0x1F00, 0x1FF0, 0xFFF, 0x2000] {
            counter.stored(address);
        }
        assert_eq!(counter.to_string(), "stack 256\n");
    }
}
