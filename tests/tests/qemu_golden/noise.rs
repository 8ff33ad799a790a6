//! Invalid Ethernet frames, which test the board's driver and the code above it on the image.

use drivetwin_firmware::device::{Duration, Instant, Link, Port};

use crate::host::{Host, frames};
use crate::image::Image;
use crate::machine::{CYCLES_PER_US, Jack, Machine};
use crate::stack::Stack;
use crate::{images, kind};

const MODBUS: (Port, Link) = (Port(0), Link(0));
/// A read of VM, and the reply 768,000 (FB 4.2.4).
const REQUEST: [u8; 12] = [0, 1, 0, 0, 0, 6, 1, 3, 0, 0x8B, 0, 2];
const ANSWER: [u8; 13] = [0, 1, 0, 0, 0, 7, 1, 3, 4, 0, 0x0B, 0xB8, 0];
/// Bytes of the longest frame in QEMU's controller, without its length and its check sequence.
const LONGEST: usize = 2_041;
/// Number of frames that the controller stores.
const MOST: usize = 31;

/// A board, and a host with a cable to it.
struct Pair {
    board: Machine,
    host: Host,
    now: Instant,
}

impl Pair {
    /// Runs the board and the host until both are idle.
    fn run(&mut self) {
        loop {
            let micros = self.board.run() / CYCLES_PER_US;
            self.now = Instant::ZERO + Duration::micros(micros);
            let back = self.host.poll(self.now, frames(&self.board.said()));
            if back.is_empty() {
                break;
            }
            self.board.take(&back);
        }
    }

    fn run_until(&mut self, ms: u64) {
        while self.now < Instant::ZERO + Duration::millis(ms) {
            self.board.sleep(ms * 1_000 * CYCLES_PER_US).expect("no other timer is due in that nanosecond");
            self.run();
        }
    }

    /// Sends frames, and right after them a register read that the drive must answer.
    fn is_served_behind(&mut self, mut frames: Vec<Vec<u8>>) {
        self.host.say(MODBUS, &REQUEST);
        frames.extend(self.host.poll(self.now, std::iter::empty()));
        self.board.take(&frames);
        self.run();
        assert_eq!(self.host.heard(), [(MODBUS, ANSWER.to_vec())]);
    }
}

#[test]
#[ignore = "needs QEMU and the images of the board: `cargo xtask test` brings both"]
fn frames_of_every_length_and_more_than_have_room() {
    let image = Image::read(&images().join("mdrive"));
    let mut board = Machine::new(&image, Jack::Ethernet, 4);
    let stack = Stack::paint(&mut board, &image);
    let host = Host::new((kind("mdrive").make)().spec());
    let mut pair = Pair { board, host, now: Instant::ZERO };
    pair.run();
    pair.run_until(1_000);
    pair.host.open(MODBUS);
    let knocks = pair.host.poll(pair.now, std::iter::empty());
    pair.board.take(&knocks);
    pair.run();
    // Frames that are too short or too long, broadcasts, and beginnings of packets.
    let lengths = (1..70).chain([589, 590, 591, 592, 1_514, LONGEST]);
    for length in lengths {
        for start in [&[0xFF; 12][..], &[0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 2, 0, 0, 0, 0, 3, 8, 0, 0x45]] {
            let mut frame = start.to_vec();
            frame.resize(length.max(start.len()), 0);
            frame.truncate(length);
            pair.is_served_behind(vec![frame]);
        }
    }
    for length in [60, 590, 1_514] {
        pair.board.take(&vec![vec![0xFF; length]; 3 * MOST]);
        pair.run();
        pair.is_served_behind(Vec::new());
    }
    stack.used(&mut pair.board);
}
