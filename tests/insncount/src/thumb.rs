//! Decoding of Thumb instructions that change the depth of calls (ARM DDI 0403, A5 and A7.7).

/// An instruction at its address.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Instruction {
    /// Address.
    pub(crate) address: u32,
    /// Address of the next instruction in memory.
    pub(crate) next: u32,
    /// Kind of instruction.
    pub(crate) kind: Kind,
}

/// Kind of an instruction, by its effect on the depth of calls.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Kind {
    /// No effect.
    Plain,
    /// `mov r9, r9`
    Group,
    /// `mov r10, r10`
    Begin,
    /// `mov r11, r11`
    End,
    /// `bl`, `blx`
    Call,
    /// `bx lr`, or a load of the program counter from the stack.
    Return,
}

impl Instruction {
    /// Decodes the instruction of two or four bytes at `address`. More bytes may follow, because QEMU 7 reads
    /// four bytes for an instruction in the last halfword but one of a page.
    pub(crate) fn decode(address: u32, code: &[u8]) -> Self {
        let (length, kind) = match *code {
            // A5.1: an instruction whose upper five bits are 0b11101 or more has four bytes.
            [a, b, ..] if b < 0b11101 << 3 => (2, short(u16::from_le_bytes([a, b]))),
            [a, b, c, d, ..] => (4, long(u16::from_le_bytes([a, b]), u16::from_le_bytes([c, d]))),
            _ => (0, Kind::Plain),
        };
        Self { address, next: address.wrapping_add(length), kind }
    }
}

fn short(code: u16) -> Kind {
    match code {
        0x46C9 => Kind::Group,
        0x46D2 => Kind::Begin,
        0x46DB => Kind::End,
        // bx lr; mov pc, lr
        0x4770 | 0x46F7 => Kind::Return,
        // blx register
        _ if code & 0xFF87 == 0x4780 => Kind::Call,
        // pop {…, pc}
        _ if code & 0xFF00 == 0xBD00 => Kind::Return,
        _ => Kind::Plain,
    }
}

fn long(first: u16, second: u16) -> Kind {
    const PC: u16 = 1 << 15;
    match first {
        // bl
        _ if first & 0xF800 == 0xF000 && second & 0xD000 == 0xD000 => Kind::Call,
        // pop.w {…, pc}
        0xE8BD if second & PC != 0 => Kind::Return,
        // ldr pc, [sp], #…
        0xF85D if second & 0xFF00 == 0xFB00 => Kind::Return,
        _ => Kind::Plain,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Encodings as `arm-none-eabi-as` makes them, as halfwords in memory order.
    #[test]
    fn calls_and_returns_are_known() {
        let kind = |halves: &[u16]| {
            let code: Vec<u8> = halves.iter().flat_map(|half| half.to_le_bytes()).collect();
            let instruction = Instruction::decode(0x100, &code);
            assert_eq!(instruction.next, 0x100 + 2 * halves.len() as u32);
            instruction.kind
        };
        assert_eq!(kind(&[0x46C9]), Kind::Group);
        assert_eq!(kind(&[0x46D2]), Kind::Begin);
        assert_eq!(kind(&[0x46DB]), Kind::End);
        assert_eq!(kind(&[0x4770]), Kind::Return, "bx lr");
        assert_eq!(kind(&[0xBDF0]), Kind::Return, "pop {{r4-r7, pc}}");
        assert_eq!(kind(&[0xE8BD, 0x83F0]), Kind::Return, "pop.w {{r4-r9, pc}}");
        assert_eq!(kind(&[0xF85D, 0xFB08]), Kind::Return, "ldr pc, [sp], #8");
        assert_eq!(kind(&[0xF000, 0xF802]), Kind::Call, "bl");
        assert_eq!(kind(&[0xF7FF, 0xFFFE]), Kind::Call, "bl backwards");
        assert_eq!(kind(&[0x4798]), Kind::Call, "blx r3");
        assert_eq!(kind(&[0x4718]), Kind::Plain, "bx r3");
        assert_eq!(kind(&[0xBCF0]), Kind::Plain, "pop {{r4-r7}}");
        assert_eq!(kind(&[0xE8BD, 0x03F0]), Kind::Plain, "pop.w {{r4-r9}}");
        assert_eq!(kind(&[0xF000, 0xB802]), Kind::Plain, "b.w");
        assert_eq!(kind(&[0xF000, 0x8002]), Kind::Plain, "beq.w");
        assert_eq!(kind(&[0xF3BF, 0x8F4F]), Kind::Plain, "dsb");
        assert_eq!(kind(&[0xF85D, 0x7B08]), Kind::Plain, "ldr r7, [sp], #8");
        assert_eq!(kind(&[0xE8DF, 0xF000]), Kind::Plain, "tbb [pc, r0]");
    }

    #[test]
    fn bytes_after_an_instruction_are_not_decoded() {
        // `mov r9, r9`, and half of `bl`.
        let instruction = Instruction::decode(0x23FC, &[0xC9, 0x46, 0xFE, 0xF7]);
        assert_eq!(instruction, Instruction { address: 0x23FC, next: 0x23FE, kind: Kind::Group });
    }
}
