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
    let failures = |name: &str| {
        let drive = app.bench.summary(name);
        ["refused", "unanswered"].iter().filter_map(|kind| drive[kind].as_u64()).sum::<u64>()
    };
    let mut widths = vec![Constraint::Length(1), Constraint::Fill(3), Constraint::Fill(2)];
    // Refused and unanswered messages have a column when there are some.
    let most = drives.iter().map(|name| failures(name)).max().unwrap_or(0);
    if most > 0 {
        widths.push(Constraint::Length(most.to_string().len() as u16));
    }
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
            let mut cells =
                vec![sign.into(), name.into(), Line::styled(text(drive, "kind").to_owned(), style::MUTED)];
            match failures(name) {
                _ if most == 0 => {}
                0 => cells.push(Line::default()),
                count => cells.push(Line::styled(count.to_string(), style::BAD).right_aligned()),
            }
            cells
        },
    );
}
