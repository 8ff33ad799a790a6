use super::*;
use drivetwin_firmware::rs434::program::instruction::{COMMANDS, MNEMONICS};
use proptest::prelude::*;
use proptest::test_runner::{RngAlgorithm, TestRng};

/// Assembles a program that has no error.
fn lines(source: &str) -> Vec<u32> {
    assemble(source).unwrap_or_else(|error| panic!("{error}\n{source}"))
}

/// Error message for a program.
fn wrong(source: &str) -> String {
    assemble(source).unwrap_err().to_string()
}

/// A program line made of its fields, from the highest bit on (6.9): data, space, register, bTypeJmp,
/// command.
fn line(data: u16, space: u32, register: u32, type_jmp: u32, command: u32) -> u32 {
    u32::from(data) << 16 | space << 12 | register << 8 | type_jmp << 7 | command
}

#[test]
fn each_form_of_operands_has_its_fields() {
    for (source, expected) in [
        ("stop_program", vec![line(0, 0, 0, 0, 0x00)]),
        ("full_stop_program", vec![line(0, 0, 0, 0, 0x0D)]),
        ("delay 65535", vec![line(65_535, 0, 0, 0, 0x04)]),
        ("jmp 1023", vec![line(1_023, 0, 0, 0, 0x05)]),
        ("jmp rel -1", vec![line(0xFFFF, 0, 0, 1, 0x05)]),
        ("djmp_gx_less_ix rel +2", vec![line(2, 0, 0, 1, 0x66)]),
        ("call 7", vec![line(7, 0, 0, 0, 0x0A)]),
        ("return", vec![line(0, 0, 0, 0, 0x0B)]),
        // The example of section 6.9 of the manual: 23 commands, 5 times.
        ("for 23, 5", vec![line(0x1705, 0, 0, 0, 0x0C)]),
        ("not_sysreg jx", vec![line(0, 0, 9, 0, 0x15)]),
        ("not_modbus START_bit", vec![line(0x2000, 1, 0, 0, 0x16)]),
        ("mov_sysreg_const bx, -2", vec![line(0xFFFE, 0, 1, 0, 0x01)]),
        ("dmov_sysreg_const gx, -2", vec![line(0, 0, 6, 0, 0x10), 0xFFFF_FFFE]),
        ("mov_sysreg_modbus ax, IN2_bit", vec![line(0x1001, 0, 0, 0, 0x03)]),
        ("add_sysreg_modbus cx, STATUS", vec![line(0x3000, 2, 2, 0, 0x21)]),
        ("mov_modbus_const SPEED, 1500", vec![line(0x500B, 3, 0, 0, 0x0E), 1_500]),
        ("mov_modbus_const OFFSET_COMPENSATION, -15", vec![line(0x5012, 3, 0, 0, 0x0E), 0xFFF1]),
        ("dmov_modbus_const OFFSET, 0xDEADBEEF", vec![line(0x5015, 3, 0, 0, 0x12), 0xDEAD_BEEF]),
        ("mov_modbus_sysreg OFFSETHigh, dx", vec![line(0x5016, 3, 3, 0, 0x02)]),
        ("mov_modbus_sysreg input 0x3000, ax", vec![line(0x3000, 2, 0, 0, 0x02)]),
        // 6.9: from uAdrSysReg to uData. In the text the destination comes first, as everywhere.
        ("mov_sysreg_sysreg bx, ax", vec![line(1, 0, 0, 0, 0x0F)]),
        ("dmov_sysreg_sysreg ix, gx", vec![line(8, 0, 6, 0, 0x14)]),
        ("sub_sysreg_sysreg bx, ax", vec![line(0, 0, 1, 0, 0x38)]),
        ("sh_sysreg_const ax, left, 3", vec![line(3, 0, 0, 0, 0x20)]),
        ("dsh_sysreg_const ax, right, 31", vec![line(31, 0, 0, 1, 0x45)]),
        ("sh_modbus_const SPEED, right, 1", vec![line(0x500B, 3, 0, 1, 0x2F), 1]),
        ("dsh_modbus_const holding 0x501B, left, 4", vec![line(0x501B, 3, 0, 0, 0x54), 4]),
        (".word 0x89ABCDEF", vec![0x89AB_CDEF]),
        (".zero 3", vec![0, 0, 0]),
    ] {
        assert_eq!(lines(source), expected, "{source}");
        let text = disassemble(&expected);
        assert_eq!(lines(&text), expected, "{source} comes back as {text}");
    }
}

#[test]
fn labels_count_lines_and_constants_of_two_lines_count_twice() {
    let source = "
        turns = 16
        far   = turns
        start:  mov_modbus_const MODE_ROTATION, 2   ; 0, 1
                for done, 3                         ; 2
                dmov_modbus_const OFFSET, far       ; 3, 4
                call go                             ; 5
        done:   jmp rel start                       ; 6
        go: also: return                            ; 7
                jmp_ax_pari_bx also                 ; 8";
    let expected = vec![
        line(0x5006, 3, 0, 0, 0x0E),
        2,
        line(0x0303, 0, 0, 0, 0x0C),
        line(0x5015, 3, 0, 0, 0x12),
        16,
        line(7, 0, 0, 0, 0x0A),
        line(0xFFFA, 0, 0, 1, 0x05),
        line(0, 0, 0, 0, 0x0B),
        line(7, 0, 0, 0, 0x06),
    ];
    assert_eq!(lines(source), expected);
    let listing = "\
line_0:
        mov_modbus_const MODE_ROTATION, 2               ; 0
        for line_6, 3                                   ; 2
        dmov_modbus_const OFFSET, 16                    ; 3
        call line_7                                     ; 5
line_6:
        jmp rel line_0                                  ; 6
line_7:
        return                                          ; 7
        jmp_ax_pari_bx line_7                           ; 8
";
    assert_eq!(disassemble(&expected), listing);
}

#[test]
fn what_text_cannot_say_exactly_is_a_number() {
    for (program, expected) in [
        (vec![0x0000_0F00], ".word 0x00000F00"), // END with a register
        (vec![line(5, 0, 0, 1, 0x0A)], ".word 0x0005008A"), // CALL with bTypeJmp
        (vec![line(0, 0, 10, 0, 0x15)], ".word 0x00000A15"), // a system register that does not exist
        (vec![line(10, 0, 0, 0, 0x0F)], ".word 0x000A000F"), // the second system register does not exist
        (vec![line(0x5000, 4, 0, 0, 0x03)], ".word 0x50004003"), // a space that does not exist
        (vec![line(0x1000, 0, 0, 0, 0x16)], ".word 0x10000016"), // NOT of an input
        (vec![line(1_025, 0, 0, 0, 0x05)], ".word 0x04010005"), // a jump too far
        (vec![line(0, 0, 0, 0, 0x67)], ".word 0x00000067"), // a code without a command
        (vec![line(0x500B, 3, 0, 0, 0x0E)], ".word 0x500B300E"), // without its constant
        (vec![line(0x500B, 3, 0, 0, 0x0E), 0x1_0000], ".word 0x500B300E"), // with more than 16 bits
        (vec![line(2, 0, 0, 0, 0x05)], "jmp 2"), // beyond the end of the program
        (vec![line(0, 0, 0, 1, 0x05)], "jmp rel line_0"),
        (vec![line(0xFFFF, 0, 0, 1, 0x05)], "jmp rel -1"),
        (vec![line(0x6000, 1, 0, 0, 0x03)], "mov_sysreg_modbus ax, coil 0x6000"),
        (vec![line(0x5023, 3, 0, 0, 0x2C), 0xFF], "and_modbus_const ERROR, 0x00FF"),
        (vec![0; 1_024], ".zero 1024"),
    ] {
        let text = disassemble(&program);
        let first = text.lines().find(|line| !line.ends_with(':')).unwrap();
        assert_eq!(first.split(';').next().unwrap().trim(), expected);
        assert_eq!(lines(&text), program);
    }
}

#[test]
fn an_error_has_its_position() {
    for (source, expected) in [
        ("", "1:1: there is no command in this program"),
        ("; nothing\n\n", "1:1: there is no command in this program"),
        (
            "\n  mov_sysreg_cosnt ax, 1",
            "2:3: there is no command 'mov_sysreg_cosnt'; the nearest is 'mov_sysreg_const'",
        ),
        ("mov_modbus_const SPEDE, 1", "1:18: there is no register 'SPEDE'; the nearest is 'SPEED'"),
        ("add_sysreg_const AX, 1", "1:18: there is no system register 'AX'; the nearest is 'ax'"),
        ("loop: jmp lop", "1:11: there is no label 'lop'; the nearest is 'loop'"),
        ("time = 5\ndelay tme", "2:7: there is no constant 'tme'; the nearest is 'time'"),
        ("here: delay here", "1:13: 'here' is a label; expected a number or a constant"),
        ("delay", "1:6: a number or the name of a constant is missing"),
        ("delay -1", "1:7: expected a number from 0 to 65535, not -1"),
        ("delay 12ms", "1:7: '12ms' is no number of a program; 500, -5 and 0x1F4 are"),
        (
            "delay 99999999999999999999",
            "1:7: '99999999999999999999' is no number of a program; 500, -5 and 0x1F4 are",
        ),
        ("delay 1 2", "1:9: unexpected text after the command; a comment begins with ;"),
        ("mov_sysreg_const ax 1", "1:21: a comma is missing"),
        ("mov_sysreg_const ax, 0x10000", "1:22: expected a number from -32768 to 65535, not 65536"),
        (
            "dmov_sysreg_const ax, 0x100000000",
            "1:23: expected a number from -2147483648 to 4294967295, not 4294967296",
        ),
        ("jmp 1025", "1:5: expected a number from 0 to 1024, not 1025"),
        ("mov_modbus_const STATUS, 1", "1:18: this is an input, which cannot be written"),
        ("sh_sysreg_const ax, up, 1", "1:21: expected left or right"),
        ("for 256, 1", "1:5: expected a number from 0 to 255, not 256"),
        ("a: for a, 1", "1:8: the last line of a loop is 0 to 255 lines after its first, not -1"),
        ("a: return\na: return", "2:1: 'a' is already defined; choose another name"),
        ("SPEED = 5", "1:1: 'SPEED' is a register of the drive and cannot be another name"),
        ("ax: return", "1:1: 'ax' is a system register and cannot be another name"),
        ("return: return", "1:1: 'return' is a command and cannot be another name"),
        ("left = 5", "1:1: 'left' is a word of the language and cannot be another name"),
        ("5", "1:1: expected a command, a label or the name of a constant"),
        (".a = 5", "1:1: '.a' cannot be a name: take a letter, then letters, digits and _"),
        ("; ä\n§", "2:1: '§' is not allowed here"),
        (".zero 1024\nreturn", "2:1: the program is longer than 1024 lines from here on"),
        (".zero 1023\ndmov_sysreg_const ax, 1", "2:1: the program is longer than 1024 lines from here on"),
    ] {
        assert_eq!(wrong(source), expected, "{source}");
    }
    let not_text = assemble_bytes(b"return ; \xC3\xA4\n ; \xC3\xA4 \xFF").unwrap_err();
    assert_eq!(not_text.to_string(), "2:6: this is not UTF-8 text");
}

#[test]
fn a_file_of_a_windows_editor_is_read_like_any_other() {
    assert_eq!(lines("\u{FEFF}delay 5\r\nreturn\r\n"), lines("delay 5\nreturn"));
}

#[test]
fn bytes_of_a_file_are_lines_with_the_low_byte_first() {
    assert_eq!(to_bytes(&[0x500B_300E, 1]), [0x0E, 0x30, 0x0B, 0x50, 1, 0, 0, 0]);
    assert_eq!(from_bytes(&[0x0E, 0x30, 0x0B, 0x50]), Ok(vec![0x500B_300E]));
    assert_eq!(from_bytes(&[]).unwrap_err(), "it is empty; a program has 1 to 1024 lines of 4 bytes");
    let odd = "a program has lines of 4 bytes, and 5 are no whole lines";
    assert_eq!(from_bytes(&[0; 5]).unwrap_err(), odd);
    let long = "a program has at most 1024 lines of 4 bytes, and this is more";
    assert_eq!(from_bytes(&[0; 4_097]).unwrap_err(), long);
}

/// Programs in which most lines are commands with sensible fields, and some are noise.
fn program() -> impl Strategy<Value = Vec<u32>> {
    let code = 0..COMMANDS.len() as u32;
    let sensible = (code, 0..16_u16, 0..11_u32, 0..5_u32, 0..2_u32, 0..4_u32).prop_map(
        |(code, data, register, space, type_jmp, noise)| {
            let command = COMMANDS[code as usize];
            let word = line(data, space, register, type_jmp, code);
            // Three quarters of the commands have zeros in the fields that they do not use.
            if noise == 0 { word } else { word & command.used() }
        },
    );
    let named = (0x02..0x5C_u32, 0..10_u32, 0..4_u32, 0..11_u16).prop_map(|(code, register, space, n)| {
        let first = [0x1000, 0x2000, 0x3000, 0x5014][space as usize];
        line(first + n, space, register, 0, code) & COMMANDS[code as usize].used()
    });
    proptest::collection::vec(prop_oneof![sensible, named, 0..0x1_0000_u32, Just(0)], 1..=200)
}

proptest! {
    #[test]
    fn whatever_is_disassembled_assembles_to_the_same(program in program()) {
        let text = disassemble(&program);
        prop_assert_eq!(assemble(&text), Ok(program), "{}", text);
    }

    #[test]
    fn any_text_is_a_program_or_an_error(text in "[a-z_.:=,;0-9 \n+-]{0,60}|.{0,60}") {
        if let Ok(program) = assemble(&text) {
            prop_assert!(!program.is_empty() && program.len() <= LINES);
        }
    }
}

proptest! {
    // These programs have the maximum number of lines.
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn any_4096_bytes_come_back(seed in proptest::array::uniform32(any::<u8>())) {
        let mut bytes = vec![0; 4 * LINES];
        TestRng::from_seed(RngAlgorithm::ChaCha, &seed).fill_bytes(&mut bytes);
        let text = disassemble(&from_bytes(&bytes).unwrap());
        prop_assert_eq!(to_bytes(&assemble(&text).unwrap()), bytes);
    }
}

#[test]
fn each_code_has_its_name() {
    assert_eq!(COMMANDS.len(), 0x67);
    for (code, (command, mnemonic)) in (0..).zip(COMMANDS.into_iter().zip(MNEMONICS)) {
        let modbus = if command.used() & 0xF000 == 0 { 0 } else { line(0x500B, 3, 0, 0, 0) };
        let text = disassemble(&[modbus | code, 0][..command.lines().into()]);
        assert!(text.contains(&format!("        {mnemonic}")), "{text}");
    }
}
