//! State of boards, as JSON. Requests are those of [`drivetwin_panel::requests`], other responses those of
//! [`drivetwin_panel::schema`].

use drivetwin_firmware::device::Instant;
use drivetwin_panel::schema::{BoardView, Drive, ImageView, PortState};
use drivetwin_sim::commands::{self, Refusal};

use crate::board::{Board, Drive as OnBoard, of_first_port};

/// A board as it is seen now, with the power of its drive and its time; `None` if it cannot be reached.
pub(super) fn board_view(board: &Board) -> (BoardView, Option<(bool, Instant)>) {
    let seen = board.drive().and_then(|mut drive| {
        let (state, statistics) = (commands::Drive::state(&mut drive)?, drive.statistics()?);
        let now = (state.powered, drive.now()?);
        Ok((image_view(&drive, &statistics)?, now))
    });
    let (image, away, now) = match seen {
        Ok((image, now)) => (Some(image), None, Some(now)),
        Err(refusal) => (None, Some(refusal.to_string()), None),
    };
    (BoardView { drive: board.name().to_owned(), place: board.place().to_owned(), away, image }, now)
}

fn image_view(drive: &OnBoard, statistics: &drivetwin_control::Statistics) -> Result<ImageView, Refusal> {
    Ok(ImageView {
        version: drive.image().to_owned(),
        kinds: drive.kinds()?,
        fast_boot: drive.is_fast_boot(),
        lost_inputs: statistics.lost_inputs,
        lost_events: statistics.lost_events,
        lost_characters: statistics.lost_characters,
        failures: statistics.failures,
        slipped_steps: statistics.slipped,
    })
}

/// The drive of a board.
pub(super) fn drive_of_board(drive: &mut OnBoard) -> Result<Drive, Refusal> {
    let (line, seen) = of_first_port(&drive.statistics()?);
    let spec = commands::Drive::spec(drive);
    let first = spec.ports.first().and_then(|port| Some((port.name, line.or(port.line)?)));
    let ports = first.into_iter().map(|(name, line)| (name, PortState::serial(line, seen))).collect();
    let (state, registers) = (commands::Drive::state(drive)?, commands::Drive::values(drive)?);
    Ok(Drive::new(commands::Drive::name(drive), spec, &state, registers, ports))
}
