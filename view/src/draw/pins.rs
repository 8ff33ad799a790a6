//! The pins and the faults of the chosen drive.

use ratatui::Frame;
use ratatui::layout::{Constraint, Rect};
use ratatui::text::Line;

use super::parts::{self, Part};
use super::style;
use crate::app::App;
use crate::keys::Pane;

pub(super) fn draw(frame: &mut Frame, area: Rect, app: &App) {
    let pins = app.bench.pins();
    let inside = parts::pane(frame, area, app, Pane::Pins, "");
    let chosen = app.row(Pane::Pins, pins.len());
    let name = parts::widest(pins.iter().map(|pin| pin.name), inside.width / 2);
    let widths = [Constraint::Length(name), Constraint::Length(6), Constraint::Fill(1)];
    parts::rows(frame, inside, &widths, pins.len(), Part::around_or_first(app, Pane::Pins, chosen), |row| {
        let pin = &pins[row];
        let level = match pin.level {
            "high" => Line::styled("▔ high", style::GOOD),
            "low" => Line::styled("▁ low", style::INFO),
            "open" => Line::styled("┄ open", style::MUTED),
            other => Line::styled(other, style::MUTED),
        };
        let role = pin.row["role"].as_str().unwrap_or_default();
        vec![pin.name.into(), level, Line::styled(role, style::MUTED)]
    });
}

pub(super) fn draw_faults(frame: &mut Frame, area: Rect, app: &App) {
    let faults = app.bench.faults();
    let inside = parts::pane(frame, area, app, Pane::Faults, "");
    let chosen = app.row(Pane::Faults, faults.len());
    let widths = [Constraint::Length(3), Constraint::Fill(1)];
    parts::rows(
        frame,
        inside,
        &widths,
        faults.len(),
        Part::around_or_first(app, Pane::Faults, chosen),
        |row| {
            let (name, is_there) = faults[row];
            let sign = if is_there { "[!]" } else { "[ ]" };
            let style = if is_there { style::BAD } else { style::PLAIN };
            vec![Line::styled(sign, style), Line::styled(name, style)]
        },
    );
    if faults.is_empty() && !app.bench.drive().is_null() {
        frame.render_widget(Line::styled("this drive has no faults", style::MUTED), inside);
    }
}
