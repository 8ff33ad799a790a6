//! Timing errors of the worst and of the last step of a move: prints the table of docs/explanation/motion.md.

use drivetwin_tests::ramps::{rows, table};

fn main() {
    print!("{}", table(&rows()));
}
