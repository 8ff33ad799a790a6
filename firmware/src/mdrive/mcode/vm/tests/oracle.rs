//! Random programs compared with a second interpreter. It works on structures and does not parse or store
//! lines.

use std::format;

use proptest::prelude::*;

use super::*;

/// A register, 1 to 4, or a constant.
#[derive(Clone, Copy, Debug)]
enum Source {
    Register(usize),
    Constant(i32),
}

/// Operator between two values, and its character.
#[derive(Clone, Copy, Debug)]
enum Sign {
    Plus,
    Minus,
    Times,
    Over,
    And,
    Or,
    Xor,
}

#[derive(Clone, Copy, Debug)]
enum Test {
    Equal,
    Unequal,
    Less,
    AtMost,
    Greater,
    AtLeast,
}

type When = Option<(Source, Test, Source)>;

#[derive(Clone, Copy, Debug)]
enum Line {
    Copy(usize, Source),
    Not(usize, Source),
    Calculate(usize, Source, Sign, Source),
    /// Several operators, applied from left to right.
    Chain(usize, Source, [(Sign, Source); 3]),
    Step(usize, i32),
    /// Branch to a line that may not exist.
    Branch(usize, When),
    Call(usize, When),
    Return,
    End,
}

impl Source {
    fn text(self) -> String {
        match self {
            Self::Register(n) => format!("R{n}"),
            Self::Constant(value) => format!("{value}"),
        }
    }
}

impl Sign {
    fn text(self) -> char {
        match self {
            Self::Plus => '+',
            Self::Minus => '-',
            Self::Times => '*',
            Self::Over => '/',
            Self::And => '&',
            Self::Or => '|',
            Self::Xor => '^',
        }
    }

    /// Result of two values; `None` for a division by 0.
    fn of(self, left: i128, right: i128) -> Option<i128> {
        Some(match self {
            Self::Plus => left + right,
            Self::Minus => left - right,
            Self::Times => left * right,
            Self::Over if right == 0 => return None,
            Self::Over => left / right,
            Self::And => left & right,
            Self::Or => left | right,
            Self::Xor => left ^ right,
        })
    }
}

fn when_text(when: When) -> String {
    let Some((left, test, right)) = when else { return String::new() };
    let sign = match test {
        Test::Equal => "=",
        Test::Unequal => "<>",
        Test::Less => "<",
        Test::AtMost => "<=",
        Test::Greater => ">",
        Test::AtLeast => ">=",
    };
    format!(",{}{sign}{}", left.text(), right.text())
}

impl Line {
    fn text(self) -> String {
        match self {
            Self::Copy(to, from) => format!("R{to}={}", from.text()),
            Self::Not(to, from) => format!("R{to}=!{}", from.text()),
            Self::Calculate(to, left, sign, right) => {
                format!("R{to}={} {} {}", left.text(), sign.text(), right.text())
            }
            Self::Chain(to, first, steps) => {
                let steps = steps.map(|(sign, source)| format!("{}{}", sign.text(), source.text()));
                format!("R{to}={}{}", first.text(), steps.concat())
            }
            Self::Step(of, 1) => format!("IC R{of}"),
            Self::Step(of, _) => format!("DC R{of}"),
            Self::Branch(to, when) => format!("BR {to}{}", when_text(when)),
            Self::Call(to, when) => format!("CL {to}{}", when_text(when)),
            Self::Return => "RT".into(),
            Self::End => "E".into(),
        }
    }
}

/// The second interpreter. It executes a line at a time, with numbers of 128 bits truncated to 32.
struct Oracle {
    lines: Vec<Line>,
    registers: [i128; 5],
    next: usize,
    calls: Vec<usize>,
    runs: bool,
    error: i32,
}

impl Oracle {
    fn value(&self, source: Source) -> i128 {
        match source {
            Source::Register(n) => self.registers[n],
            Source::Constant(value) => value.into(),
        }
    }

    fn keep(&mut self, register: usize, value: i128) {
        self.registers[register] = in_32_bits(value);
    }

    fn is_so(&self, when: When) -> bool {
        let Some((left, test, right)) = when else { return true };
        let (left, right) = (self.value(left), self.value(right));
        match test {
            Test::Equal => left == right,
            Test::Unequal => left != right,
            Test::Less => left < right,
            Test::AtMost => left <= right,
            Test::Greater => left > right,
            Test::AtLeast => left >= right,
        }
    }

    fn fail(&mut self, error: i32) {
        self.error = error;
        self.runs = error == 21;
    }

    fn step(&mut self) {
        let Some(&line) = self.lines.get(self.next - 1) else {
            self.runs = false;
            return;
        };
        self.next += 1;
        match line {
            Line::Copy(to, from) => self.keep(to, self.value(from)),
            Line::Not(to, from) => self.keep(to, -1 - self.value(from)),
            Line::Calculate(to, left, sign, right) => {
                let Some(result) = sign.of(self.value(left), self.value(right)) else { return self.fail(21) };
                self.keep(to, result);
            }
            Line::Chain(to, first, steps) => {
                let mut result = self.value(first);
                for (sign, source) in steps {
                    let Some(value) = sign.of(result, self.value(source)) else { return self.fail(21) };
                    result = in_32_bits(value);
                }
                self.keep(to, result);
            }
            Line::Step(of, by) => self.keep(of, self.registers[of] + i128::from(by)),
            Line::Branch(to, when) if self.is_so(when) => {
                if to > self.lines.len() {
                    return self.fail(42);
                }
                self.next = to;
            }
            Line::Call(to, when) if self.is_so(when) => {
                if to > self.lines.len() {
                    return self.fail(42);
                }
                if self.calls.len() == 16 {
                    return self.fail(43);
                }
                self.calls.push(self.next);
                self.next = to;
            }
            Line::Branch(..) | Line::Call(..) => {}
            Line::Return => match self.calls.pop() {
                Some(back) => self.next = back,
                None => self.fail(41),
            },
            Line::End => self.runs = false,
        }
    }
}

fn in_32_bits(value: i128) -> i128 {
    let low = value.rem_euclid(1 << 32);
    if low < 1 << 31 { low } else { low - (1 << 32) }
}

fn source() -> impl Strategy<Value = Source> {
    prop_oneof![
        4 => (1..=4_usize).prop_map(Source::Register),
        3 => (-9..=9).prop_map(Source::Constant),
        1 => any::<i32>().prop_map(Source::Constant),
        1 => prop_oneof![Just(i32::MIN), Just(i32::MAX)].prop_map(Source::Constant),
    ]
}

fn when() -> impl Strategy<Value = When> {
    use Test::{AtLeast, AtMost, Equal, Greater, Less, Unequal};
    let test = proptest::sample::select(&[Equal, Unequal, Less, AtMost, Greater, AtLeast][..]);
    proptest::option::weighted(0.8, (source(), test, source()))
}

fn line() -> impl Strategy<Value = Line> {
    use Sign::{And, Minus, Or, Over, Plus, Times, Xor};
    let register = || 1..=4_usize;
    let place = || 1..=22_usize;
    let sign = proptest::sample::select(&[Plus, Minus, Times, Over, And, Or, Xor][..]);
    prop_oneof![
        2 => (register(), source()).prop_map(|(to, from)| Line::Copy(to, from)),
        1 => (register(), source()).prop_map(|(to, from)| Line::Not(to, from)),
        8 => (register(), source(), sign.clone(), source()).prop_map(|(to, a, sign, b)| Line::Calculate(to, a, sign, b)),
        3 => (register(), source(), proptest::array::uniform3((sign.clone(), source())))
            .prop_map(|(to, first, steps)| Line::Chain(to, first, steps)),
        3 => (register(), prop_oneof![Just(1), Just(-1)]).prop_map(|(of, by)| Line::Step(of, by)),
        4 => (place(), when()).prop_map(|(to, when)| Line::Branch(to, when)),
        3 => (place(), when()).prop_map(|(to, when)| Line::Call(to, when)),
        1 => Just(Line::Return),
        1 => Just(Line::End),
    ]
}

proptest! {
    #[test]
    fn a_program_does_what_another_interpreter_does(
        lines in proptest::collection::vec(line(), 20..=21),
        registers in proptest::array::uniform4(prop_oneof![any::<i32>(), -9..=9_i32]),
    ) {
        let mut dut = Dut::new(Mdrive::plus());
        for (n, value) in (1..).zip(registers) {
            dut.commands(&format!("R{n}={value}"));
        }
        for (address, line) in (1..).zip(&lines) {
            dut.store(address, &line.text());
        }
        let [a, b, c, d] = registers.map(i128::from);
        let mut oracle = Oracle {
            lines, registers: [0, a, b, c, d], next: 1, calls: Vec::new(), runs: true, error: 0,
        };
        dut.commands("EX 1");
        for step in 0..100 {
            dut.lines(1);
            oracle.step();
            let [_, ours @ ..] = oracle.registers;
            prop_assert_eq!(dut.r().map(i128::from), ours, "after line {}", step);
            prop_assert_eq!(dut.value(Reg::ER), oracle.error);
            prop_assert_eq!(dut.value(Reg::BY), i32::from(oracle.runs));
            if !oracle.runs {
                break;
            }
        }
    }
}
