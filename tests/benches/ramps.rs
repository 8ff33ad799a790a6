//! Timing error of the worst step of a move and of the last one: the table of
//! docs/explanation/motion.md.

use drivetwin_tests::ramps::{rows, table};

fn main() {
    print!("{}", table(&rows()));
}
