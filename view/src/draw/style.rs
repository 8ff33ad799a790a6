//! Colours: the eight of every terminal, on its own background.
//!
//! White, black and yellow are not among them, because one of them is invisible on a light or a dark background. Each
//! colour has a word or a sign beside it.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::{Color, Modifier, Style};

pub(super) const PLAIN: Style = Style::new();
pub(super) const TITLE: Style = Style::new().add_modifier(Modifier::BOLD);
pub(super) const MUTED: Style = Style::new().add_modifier(Modifier::DIM);
pub(super) const CHOSEN: Style = Style::new().add_modifier(Modifier::REVERSED);
pub(super) const FOCUS: Style = Style::new().fg(Color::Cyan).add_modifier(Modifier::BOLD);
pub(super) const GOOD: Style = Style::new().fg(Color::Green);
pub(super) const BAD: Style = Style::new().fg(Color::Red).add_modifier(Modifier::BOLD);
pub(super) const ODD: Style = Style::new().fg(Color::Magenta);
pub(super) const INFO: Style = Style::new().fg(Color::Cyan);
pub(super) const LIT: Style = Style::new().fg(Color::Magenta).add_modifier(Modifier::BOLD);

/// The style of a message by its verdict, as the control API names it.
pub(super) fn verdict(verdict: &str) -> Style {
    match verdict {
        "done" => GOOD,
        "refused" | "bad frame" => BAD,
        "without effect" | "too early" | "lost" => ODD,
        _ => MUTED,
    }
}

/// The style of a light that is lit. A red light has a name that says so, except D5 of an MD3 (section 2).
pub(super) fn light(name: &str) -> Style {
    match name {
        "RED" | "D5" => Style::new().fg(Color::Red),
        _ => GOOD,
    }
}

/// Removes all colours, as `NO_COLOR` demands; bold, dim and reversed text stay.
pub(super) fn remove_colours(buffer: &mut Buffer, area: Rect) {
    buffer.set_style(area, Style::new().fg(Color::Reset).bg(Color::Reset));
}
