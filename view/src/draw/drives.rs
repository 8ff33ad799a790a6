//! The list of drives.

use ratatui::Frame;
use ratatui::layout::{Constraint, Rect};
use ratatui::text::{Line, Span};

use super::parts::{self, Part};
use super::{style, text};
use crate::app::App;
use crate::keys::Pane;

pub(super) fn draw(frame: &mut Frame, area: Rect, app: &App) {
    let drives = app.drives();
    let chosen = drives.iter().position(|name| Some(*name) == app.drive());
    let all = app.bench.names().len();
    let title = if drives.len() == all { format!("{all}") } else { format!("{}/{all}", drives.len()) };
    let inside = parts::pane(frame, area, app, Pane::Drives, &title);
    let widths = [Constraint::Length(1), Constraint::Fill(3), Constraint::Fill(2)];
    parts::rows(
        frame,
        inside,
        &widths,
        drives.len(),
        Part::around_or_first(app, Pane::Drives, chosen),
        |row| {
            let name = drives[row];
            let drive = app.bench.summary(name);
            let sign = if drive["fault"] == true {
                Span::styled("!", style::BAD)
            } else if drive["powered"] == false {
                Span::styled("○", style::MUTED)
            } else if drive["moving"] == true {
                Span::styled("▶", style::INFO)
            } else {
                Span::styled("●", style::GOOD)
            };
            vec![sign.into(), name.into(), Line::styled(text(drive, "kind").to_owned(), style::MUTED)]
        },
    );
}
