//! Prints the table of docs/explanation/motion.md: the timing errors of the worst and of the last step of
//! moves.

use drivetwin_tests::ramps::{rows, table};

fn main() {
    print!("{}", table(&rows()));
}
