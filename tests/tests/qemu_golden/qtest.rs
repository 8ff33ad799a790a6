//! QEMU's protocol for tests of devices, used while the processor is stopped.

use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::UnixStream;

/// A machine's memory and pins.
pub(crate) struct Qtest {
    to: UnixStream,
    from: BufReader<UnixStream>,
    /// Changes of the intercepted outputs, oldest first.
    changes: Vec<(u32, bool)>,
}

impl Qtest {
    pub(crate) fn new(line: UnixStream) -> Self {
        let from = BufReader::new(line.try_clone().expect("a second handle"));
        Self { to: line, from, changes: Vec::new() }
    }

    /// Reads words of memory or registers.
    pub(crate) fn words(&mut self, addresses: &[u32]) -> Vec<u32> {
        let commands: String = addresses.iter().map(|address| format!("readl {address:#x}\n")).collect();
        self.say(&commands);
        let word = |answer: String| {
            let digits = answer.strip_prefix("0x").and_then(|digits| u64::from_str_radix(digits, 16).ok());
            digits.and_then(|word| u32::try_from(word).ok()).expect("a word")
        };
        addresses.iter().map(|_| word(self.answer())).collect()
    }

    /// Reads a word.
    pub(crate) fn word(&mut self, address: u32) -> u32 {
        self.words(&[address])[0]
    }

    /// Writes words, in the given order.
    pub(crate) fn write<const N: usize>(&mut self, words: [(u32, u32); N]) {
        let commands: String =
            words.iter().map(|(address, word)| format!("writel {address:#x} {word:#x}\n")).collect();
        self.say(&commands);
        for _ in words {
            self.answer();
        }
    }

    /// Reads `length` bytes starting at `address`.
    pub(crate) fn bytes(&mut self, address: u32, length: usize) -> Vec<u8> {
        self.say(&format!("read {address:#x} {length:#x}\n"));
        let answer = self.answer();
        let digits = answer.trim_start_matches("0x").as_bytes();
        let pairs = digits.chunks(2).map(|pair| std::str::from_utf8(pair).expect("text"));
        pairs.map(|pair| u8::from_str_radix(pair, 16).expect("hex")).collect()
    }

    /// Writes bytes starting at `address`.
    pub(crate) fn put(&mut self, address: u32, bytes: &[u8]) {
        let hex: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        self.say(&format!("write {address:#x} {:#x} 0x{hex}\n", bytes.len()));
        self.answer();
    }

    /// Drives input `line` of the device at `path`.
    pub(crate) fn drive(&mut self, path: &str, line: u32, high: bool) {
        self.say(&format!("set_irq_in {path} unnamed-gpio-in {line} {}\n", u32::from(high)));
        self.answer();
    }

    /// Reports changes of the outputs of the device at `path` from now on. Only one device can be selected.
    pub(crate) fn listen(&mut self, path: &str) {
        self.say(&format!("irq_intercept_out {path}\n"));
        self.answer();
    }

    /// Changes of the outputs since the last call.
    pub(crate) fn changes(&mut self) -> Vec<(u32, bool)> {
        std::mem::take(&mut self.changes)
    }

    fn say(&mut self, commands: &str) {
        self.to.write_all(commands.as_bytes()).expect("QEMU listens");
    }

    /// Text after the `OK` to a command. Changes that QEMU reports before it are stored.
    fn answer(&mut self) -> String {
        loop {
            let mut line = String::new();
            self.from.read_line(&mut line).expect("QEMU answers");
            assert!(!line.is_empty(), "QEMU is gone");
            match line.split_whitespace().collect::<Vec<_>>().as_slice() {
                ["OK"] => return String::new(),
                ["OK", answer] => return (*answer).to_owned(),
                ["IRQ", level, output] => {
                    let output = output.parse().expect("a number");
                    self.changes.push((output, *level == "raise"));
                }
                _ => panic!("QEMU refuses: {line}"),
            }
        }
    }
}
