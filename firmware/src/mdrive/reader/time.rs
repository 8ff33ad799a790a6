//! Execution times of typed lines: "this varies from command to command and usually is in the 1-5 millisecond
//! range" (MC 7.1; MDRIVE-34).

use super::Reader;
use crate::device::Duration;
use crate::mdrive::mcode::statement::Statement;

/// Time of a line that does nothing, or is refused.
const SHORTEST: Duration = Duration::millis(1);
/// Time of a line that sets a variable, or moves.
const COMMON: Duration = Duration::millis(2);
/// Time of a line that is stored in the program.
const STORING: Duration = Duration::millis(4);
/// Time of S, IP, FD, CP and L, and the longest time of a PR.
const LONGEST: Duration = Duration::millis(5);
/// Added to [`SHORTEST`] for each item of a PR. A client measured 24 ms at 9,600 baud for `pr EF,"_"ER`; its
/// 19 characters take 19.8 ms of these.
const ITEM: Duration = Duration::millis(1);

impl Reader<'_> {
    /// Time from the end of a typed line to its effect.
    pub(in crate::mdrive) fn execution_time(&self, line: &[u8], programming: bool) -> Duration {
        let line = match (self.bank.check_sums(), line.split_last()) {
            (1.., Some((_, line))) => line,
            _ => line,
        };
        match self.parse(line) {
            Err(_) | Ok(Statement::Empty) => SHORTEST,
            Ok(Statement::Program(_)) => COMMON,
            Ok(_) if programming => STORING,
            Ok(Statement::Print(items)) => {
                (SHORTEST + ITEM * u64::from(self.count_items(items))).min(LONGEST)
            }
            Ok(
                Statement::ListProgram(_)
                | Statement::Clear(_)
                | Statement::Save
                | Statement::Defaults
                | Statement::Initialize,
            ) => LONGEST,
            Ok(_) => COMMON,
        }
    }

    /// Returns true if a line prints something.
    pub(in crate::mdrive) fn prints(&self, line: &[u8]) -> bool {
        matches!(self.parse(line), Ok(Statement::Print(_) | Statement::ListProgram(_)))
    }
}
