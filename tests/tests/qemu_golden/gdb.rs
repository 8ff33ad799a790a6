//! The part of GDB's remote protocol that stops and continues a processor.

use std::io::{Read, Write};
use std::os::unix::net::UnixStream;

/// QEMU's debug stub at the other end of a socket.
pub(crate) struct Gdb {
    line: UnixStream,
    /// Bytes received but not read yet.
    heard: Vec<u8>,
}

impl Gdb {
    pub(crate) fn new(line: UnixStream) -> Self {
        Self { line, heard: Vec::new() }
    }

    /// Waits until the stub answers, which means that the machine exists and is stopped.
    pub(crate) fn greet(&mut self) {
        assert!(self.ask("?").starts_with('T'), "QEMU says why the machine stands");
    }

    /// Sets a watchpoint at the word at `address`: the processor stops before each instruction that writes it.
    pub(crate) fn stop_before_write(&mut self, address: u32) {
        assert_eq!(self.ask(&format!("Z2,{address:x},4")), "OK");
    }

    /// Continues the processor until it stops again, at `address` or where it stopped.
    pub(crate) fn run(&mut self, address: Option<u32>) {
        // Bit 0 marks Thumb code.
        let stop = match address {
            Some(address) => self.ask(&format!("c{:x}", address | 1)),
            None => self.ask("c"),
        };
        let is_sleep = stop.starts_with("T05") && stop.contains("watch:");
        assert!(is_sleep, "the processor stops where it sleeps, not with {stop}");
    }

    /// Reads the program counter.
    pub(crate) fn pc(&mut self) -> u32 {
        const PC: usize = 15;
        let registers = self.ask("g");
        let word = registers.get(8 * PC..8 * PC + 8).expect("all registers");
        u32::from_str_radix(word, 16).expect("a number").swap_bytes()
    }

    /// Sends a command to QEMU's monitor and returns its output.
    pub(crate) fn monitor(&mut self, command: &str) -> String {
        let hex: String = command.bytes().map(|byte| format!("{byte:02x}")).collect();
        let mut said = Vec::new();
        let mut packet = self.ask(&format!("qRcmd,{hex}"));
        while let Some(hex) = packet.strip_prefix('O').filter(|_| packet != "OK") {
            let digits = hex.as_bytes().chunks(2).map(|pair| std::str::from_utf8(pair).expect("text"));
            said.extend(digits.map(|pair| u8::from_str_radix(pair, 16).expect("hex")));
            packet = self.packet();
        }
        assert_eq!(packet, "OK", "{command}");
        String::from_utf8(said).expect("text")
    }

    fn ask(&mut self, words: &str) -> String {
        let sum = words.bytes().fold(0_u8, u8::wrapping_add);
        self.line.write_all(format!("${words}#{sum:02x}").as_bytes()).expect("QEMU listens");
        self.packet()
    }

    /// The next packet: the text between `$` and `#`. A checksum of two digits follows, which a socket does
    /// not need.
    fn packet(&mut self) -> String {
        loop {
            let begin = self.heard.iter().position(|&byte| byte == b'$');
            let end = self.heard.iter().position(|&byte| byte == b'#');
            if let (Some(begin), Some(end)) = (begin, end)
                && self.heard.len() >= end + 3
            {
                let packet = self.heard.get(begin + 1..end).unwrap_or_default().to_vec();
                self.heard.drain(..end + 3);
                self.line.write_all(b"+").expect("QEMU listens");
                return String::from_utf8(packet).expect("text");
            }
            let mut buffer = [0; 4096];
            let n = self
                .line
                .read(&mut buffer)
                .expect("the machine stops within the time that a host has for it");
            assert!(n > 0, "QEMU is gone");
            self.heard.extend(buffer.iter().take(n));
        }
    }
}
