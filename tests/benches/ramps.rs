//! How far from its exact instant the worst step of a move is, and the last one: the table of
//! docs/explanation/motion.md.

use drivetwin_tests::ramps::{rows, table};

fn main() {
    print!("{}", table(&rows()));
}
