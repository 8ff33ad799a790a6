//! Budgets of the drives. `cargo xtask size` measures every value, and fails if a value exceeds its budget or
//! has no budget here.

use crate::board::BOARDS;

/// Budget of a measured value.
#[derive(Debug)]
pub(crate) struct Budget {
    /// Name of the measured value. The unit is instructions, if not stated otherwise.
    pub(crate) what: &'static str,
    /// Maximum on a Cortex-M3 and the lm3s6965, on a Cortex-M0+ and the rp2040, on a Cortex-M4F and the stm32f4, and on
    /// a Cortex-M33 and the rp2350.
    pub(crate) most: [u64; PLACES],
    /// Reason.
    pub(crate) why: &'static str,
}

/// A budget of a value that is counted in emulation. The stm32f4 and the rp2350 are not emulated.
const fn most(what: &'static str, [m3, m0]: [u64; 2], why: &'static str) -> Budget {
    Budget { what, most: [m3, m0, NO_BUDGET, NO_BUDGET], why }
}

/// A budget of a value of the image for each board.
const fn image(what: &'static str, most: [u64; PLACES], why: &'static str) -> Budget {
    Budget { what, most, why }
}

/// Number of boards, or processors.
pub(crate) const PLACES: usize = BOARDS.len();

/// Marks a value that is not measured on a board, or that depends on the host there.
pub(crate) const NO_BUDGET: u64 = u64::MAX;

const REACHED: &str = "what has been reached, and a little for another compiler";
const AIM: &str = "the aim for what runs at every step";
const LATE: &str = "the first steps of a ramp, far apart, are searched for; QEMU brings the timer late, so it is not counted there";
const HOST: &str =
    "QEMU's UART brings as many characters at once as the host has sent, so it is not judged there";
const FLASH: &str = "what has been reached; the aim is 32 KiB";
const RS434: &str = "what has been reached, with two framings, a program that runs, and a motor";
const PROGRAM: &str = "a program of 1,024 lines takes 4 KiB, twice: in the buffer and in the memory";
const RAM: &str =
    "the aim; the others have more, and wait for their flash: 256 and 512 things may be caught meanwhile";
const TX_REPLIES: &str = "1,024 characters of answers may wait on the stack, three times as many as an MD3's";
const BEGIN: &str =
    "the reserve, less what another interrupt would take; deepest before the first interrupt may come";
const DEPTH: &str = "the reserve, less what another interrupt would take";
const RESERVED: &str = "what the board's map reserves";
const NO_PANIC: &str = "our drivers cannot panic; the others have them from the crates that keep saved registers in flash and serve the cable";
const NETWORK: &str = "what has been reached, with MCode and smoltcp; only this board has Ethernet";
const CONNECTIONS: &str =
    "14 KiB of memory, 14 KiB for long answers, 13 KiB of connections; 6 KiB of the board are left";
const SMOLTCP: &str = "smoltcp has them, and perhaps what calls it; they end in a reset";
const MCODE: &str =
    "what has been reached, with a language, its programs' index of 2,047 addresses and four terminals";

/// Every budget.
pub(crate) const BUDGETS: &[Budget] = &[
    image("md3: flash, bytes", [41_984, 90_112, 90_624, 86_528], FLASH),
    image("md3: RAM with its stack, bytes", [8_192, 27_648, 36_352, 31_744], RAM),
    image("md3: stack, bytes", [5_632, 20_480, 24_576, 24_576], RESERVED),
    image("md3: calls of a panic", [0, 80, 72, 64], NO_PANIC),
    most("md3 without a board: flash, bytes", [28_928, 31_360], REACHED),
    most("md3 without a board: RAM, bytes", [776, 776], REACHED),
    image("md3-low: flash, bytes", [41_984, 90_112, 90_624, 86_528], FLASH),
    image("md3-low: RAM with its stack, bytes", [8_192, 27_648, 36_352, 31_744], RAM),
    image("md3-low: stack, bytes", [5_632, 20_480, 24_576, 24_576], RESERVED),
    image("md3-low: calls of a panic", [0, 80, 72, 64], NO_PANIC),
    most("md3-low without a board: flash, bytes", [28_928, 31_360], REACHED),
    most("md3-low without a board: RAM, bytes", [776, 776], REACHED),
    image("qsb-d: flash, bytes", [41_984, 90_624, 90_624, 86_528], FLASH),
    image("qsb-d: RAM with its stack, bytes", [9_216, 27_648, 36_352, 31_744], TX_REPLIES),
    image("qsb-d: stack, bytes", [6_656, 20_480, 24_576, 24_576], RESERVED),
    image("qsb-d: calls of a panic", [0, 80, 72, 64], NO_PANIC),
    most("qsb-d without a board: flash, bytes", [30_720, 32_896], REACHED),
    most("qsb-d without a board: RAM, bytes", [640, 640], REACHED),
    image("qsb-m: flash, bytes", [41_984, 90_624, 90_624, 86_528], FLASH),
    image("qsb-m: RAM with its stack, bytes", [9_216, 27_648, 36_352, 31_744], TX_REPLIES),
    image("qsb-m: stack, bytes", [6_656, 20_480, 24_576, 24_576], RESERVED),
    image("qsb-m: calls of a panic", [0, 80, 72, 64], NO_PANIC),
    most("qsb-m without a board: flash, bytes", [30_720, 32_896], REACHED),
    most("qsb-m without a board: RAM, bytes", [640, 640], REACHED),
    image("qsb-s: flash, bytes", [41_984, 90_624, 90_624, 86_528], FLASH),
    image("qsb-s: RAM with its stack, bytes", [9_216, 27_648, 36_352, 31_744], TX_REPLIES),
    image("qsb-s: stack, bytes", [6_656, 20_480, 24_576, 24_576], RESERVED),
    image("qsb-s: calls of a panic", [0, 80, 72, 64], NO_PANIC),
    most("qsb-s without a board: flash, bytes", [30_720, 32_896], REACHED),
    most("qsb-s without a board: RAM, bytes", [640, 640], REACHED),
    image("rs434544: flash, bytes", [74_496, 128_512, 124_928, 120_832], RS434),
    image("rs434544: RAM with its stack, bytes", [22_016, 36_864, 45_568, 40_960], PROGRAM),
    image("rs434544: stack, bytes", [14_848, 29_696, 33_792, 33_792], RESERVED),
    image("rs434544: calls of a panic", [0, 80, 72, 64], NO_PANIC),
    most("rs434544 without a board: flash, bytes", [62_336, 68_352], REACHED),
    most("rs434544 without a board: RAM, bytes", [6_080, 6_080], PROGRAM),
    image("rs434546: flash, bytes", [74_496, 128_512, 124_928, 120_832], RS434),
    image("rs434546: RAM with its stack, bytes", [22_016, 36_864, 45_568, 40_960], PROGRAM),
    image("rs434546: stack, bytes", [14_848, 29_696, 33_792, 33_792], RESERVED),
    image("rs434546: calls of a panic", [0, 80, 72, 64], NO_PANIC),
    most("rs434546 without a board: flash, bytes", [62_336, 68_352], REACHED),
    most("rs434546 without a board: RAM, bytes", [6_080, 6_080], PROGRAM),
    image("mdrobot: flash, bytes", [68_608, 122_368, 118_784, 114_176], REACHED),
    image("mdrobot: RAM with its stack, bytes", [9_216, 27_648, 36_352, 31_744], REACHED),
    image("mdrobot: stack, bytes", [6_656, 20_480, 24_576, 24_576], RESERVED),
    image("mdrobot: calls of a panic", [0, 80, 72, 64], NO_PANIC),
    most("mdrobot without a board: flash, bytes", [56_320, 62_720], REACHED),
    most("mdrobot without a board: RAM, bytes", [1_728, 1_728], REACHED),
    image("mdrive: flash, bytes", [204_160, NO_BUDGET, NO_BUDGET, NO_BUDGET], NETWORK),
    image("mdrive: RAM with its stack, bytes", [65_344, NO_BUDGET, NO_BUDGET, NO_BUDGET], CONNECTIONS),
    image("mdrive: stack, bytes", [22_016, NO_BUDGET, NO_BUDGET, NO_BUDGET], RESERVED),
    image("mdrive: calls of a panic", [88, NO_BUDGET, NO_BUDGET, NO_BUDGET], SMOLTCP),
    most("mdrive without a board: flash, bytes", [172_200, 182_200], MCODE),
    most("mdrive without a board: RAM, bytes", [10_496, 10_496], MCODE),
    image("mdrive-hybrid: flash, bytes", [204_160, NO_BUDGET, NO_BUDGET, NO_BUDGET], NETWORK),
    image("mdrive-hybrid: RAM with its stack, bytes", [65_344, NO_BUDGET, NO_BUDGET, NO_BUDGET], CONNECTIONS),
    image("mdrive-hybrid: stack, bytes", [22_016, NO_BUDGET, NO_BUDGET, NO_BUDGET], RESERVED),
    image("mdrive-hybrid: calls of a panic", [88, NO_BUDGET, NO_BUDGET, NO_BUDGET], SMOLTCP),
    most("mdrive-hybrid without a board: flash, bytes", [172_200, 182_200], MCODE),
    most("mdrive-hybrid without a board: RAM, bytes", [10_496, 10_496], MCODE),
    most("md3: stack in use, bytes", [5_376, 19_968], DEPTH),
    most("md3: bus's interrupt, at worst", [NO_BUDGET, 460], HOST),
    most("md3: clock's interrupt, at worst", [40, NO_BUDGET], REACHED),
    most("md3: step's interrupt, with the wait for its pulse, at worst", [NO_BUDGET, 2_000], LATE),
    most("md3: pins' interrupt, at worst", [NO_BUDGET, 600], REACHED),
    most("qsb-m: stack in use, bytes", [6_400, 20_224], BEGIN),
    most("qsb-m: bus's interrupt, at worst", [NO_BUDGET, 460], HOST),
    most("qsb-m: clock's interrupt, at worst", [40, NO_BUDGET], REACHED),
    most("qsb-m: step's interrupt, with the wait for its pulse, at worst", [NO_BUDGET, 2_000], LATE),
    most("qsb-m: pins' interrupt, at worst", [NO_BUDGET, 600], REACHED),
    most("rs434544: stack in use, bytes", [14_336, 29_184], DEPTH),
    most("rs434544: bus's interrupt, at worst", [NO_BUDGET, 460], HOST),
    most("rs434544: clock's interrupt, at worst", [40, NO_BUDGET], REACHED),
    most("rs434544: pins' interrupt, at worst", [NO_BUDGET, 600], REACHED),
    most("mdrobot: stack in use, bytes", [6_144, 19_968], DEPTH),
    most("mdrobot: bus's interrupt, at worst", [NO_BUDGET, 460], HOST),
    most("mdrobot: clock's interrupt, at worst", [40, NO_BUDGET], REACHED),
    most("mdrobot: pins' interrupt, at worst", [NO_BUDGET, 600], REACHED),
    most("mdrive: stack in use, bytes", [21_504, NO_BUDGET], DEPTH),
    most("mdrive: network's interrupt, at worst", [100, NO_BUDGET], REACHED),
    most("mdrive: clock's interrupt, at worst", [40, NO_BUDGET], REACHED),
    most("step, one of the first 100 at 10,000 steps/s²", [240, 415], REACHED),
    most("step, one of the first 100 at 10,000 steps/s², at worst", [615, 1_650], REACHED),
    most("step in a ramp at 10,000 steps/s²", [80, 150], AIM),
    most("step in a ramp at 10,000 steps/s², at worst", [220, 365], REACHED),
    most("step in a ramp at 500,000 steps/s²", [80, 150], AIM),
    most("step in a ramp at 500,000 steps/s², at worst", [220, 365], REACHED),
    most("step in a cruise", [30, 33], REACHED),
    most("step of a move of 10,000", [47, 60], REACHED),
    most("step of a move of 10,000, at worst", [660, 2_000], REACHED),
    most("step and its pulse in a ramp at 500,000 steps/s²", [126, 210], REACHED),
    most("step and its pulse in a ramp at 500,000 steps/s², at worst", [265, 470], REACHED),
    most("step and its pulse in a cruise", [80, 140], REACHED),
    most("plan of a move", [19_500, 46_300], REACHED),
    most("plan of a jog", [9_500, 23_000], REACHED),
    most("plan of a reversal", [13_000, 33_000], REACHED),
    most("counter: edge in x4", [210, 280], REACHED),
    most("counter: edge in x4, at worst", [220, 290], REACHED),
    most("counter: edge in x4 and modulo-n", [200, 265], REACHED),
    most("counter: edge in x4 and modulo-n, at worst", [210, 275], REACHED),
    most("counter: edge without quadrature", [120, 165], REACHED),
    most("counter: edge without quadrature, at worst", [165, 205], REACHED),
    most("counter: 1,000 steps at once in x4", [850, 930], REACHED),
    most("counter: 1,000 steps at once in x4 and modulo-n", [750, 880], REACHED),
    most("program: line", [290, 435], REACHED),
    most("program: line, at worst", [645, 925], REACHED),
    most("program: line of system registers", [225, 350], REACHED),
    most("program: line of system registers, at worst", [235, 365], REACHED),
    most("program: line of registers of the bus", [425, 610], REACHED),
    most("program: line of registers of the bus, at worst", [645, 925], REACHED),
    most("rs434544: ms of turning", [8_160, 23_510], REACHED),
    most("rs434544: ms of turning, at worst", [13_250, 33_300], REACHED),
    most("mdrobot: ms of turning", [9_160, 23_280], REACHED),
    most("mdrobot: ms of turning, at worst", [13_910, 34_950], REACHED),
    most("md3: byte received", [225, 370], REACHED),
    most("md3: byte received, at worst", [228, 375], REACHED),
    most("md3: request of 10 registers", [1_150, 1_760], REACHED),
    most("md3-low: byte received", [225, 370], REACHED),
    most("md3-low: byte received, at worst", [228, 375], REACHED),
    most("md3-low: request of 10 registers", [1_150, 1_760], REACHED),
    most("qsb-d: byte received", [285, 525], REACHED),
    most("qsb-d: command R0E", [1_345, 2_030], REACHED),
    most("qsb-m: byte received", [285, 525], REACHED),
    most("qsb-m: command R0E", [1_345, 2_030], REACHED),
    most("qsb-s: byte received", [285, 525], REACHED),
    most("qsb-s: command R0E", [1_345, 2_030], REACHED),
    most("rs434544: byte received", [524, 915], REACHED),
    most("rs434544: byte received, at worst", [527, 919], REACHED),
    most("rs434544: request of 10 registers", [1_900, 2_790], REACHED),
    most("rs434546: byte received", [524, 915], REACHED),
    most("rs434546: byte received, at worst", [527, 919], REACHED),
    most("rs434546: request of 10 registers", [1_900, 2_790], REACHED),
    most("mdrobot: byte received", [460, 860], REACHED),
    most("mdrobot: byte received, at worst", [463, 865], REACHED),
    most("mdrobot: request of the longest value", [2_100, 2_905], REACHED),
];
