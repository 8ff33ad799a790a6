//! A board that hangs, and runs that must be identical.

use drivetwin_protocol::modbus::rtu;
use drivetwin_tests::md3::at;

use crate::play::{MS, OutputRecord, Script};
use crate::{START, TURN, image, value};

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn a_board_that_hangs_starts_its_drive_again() {
    let mut script = Script::fast();
    script.at(100 * MS, "hang");
    let asked = 5_000 * MS;
    script.hear(asked, &rtu::read(1, at::MOVE_STEPS + 1, 1));
    let run = script.play(&image(), asked + TURN);
    let resets: Vec<_> = run.did.iter().filter(|(_, did)| *did == OutputRecord::Watchdog).collect();
    assert!(matches!(resets[..], [(when, _)] if *when < 2_000 * MS), "{resets:?}");
    assert_eq!(value(&run, asked), 10_000);
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn two_runs_are_the_same() {
    let mut script = Script::fast();
    script.hear(START, &rtu::write(1, at::MOTION, 1));
    let run = script.play(&image(), 400 * MS);
    assert!(run.did.len() > 100, "it moves");
    assert_eq!(script.play(&image(), 400 * MS), run);
}
