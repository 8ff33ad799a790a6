//! The help: the table of keys, and signs.

use ratatui::Frame;
use ratatui::layout::{Constraint, Rect};
use ratatui::text::Line;
use ratatui::widgets::Block;

use super::{parts, style};
use crate::keys::{Pane, TABLE};

/// Signs of the list of drives, and of messages.
const SIGNS: [(&str, &str); 6] = [
    ("●", "the drive has power"),
    ("▶", "it moves"),
    ("○", "it has no power"),
    ("!", "it has a fault"),
    ("→", "a message to the drive"),
    ("←", "a message that the drive sends by itself"),
];

pub(super) fn draw(frame: &mut Frame, area: Rect, first: usize) {
    let block = Block::bordered().border_style(style::FOCUS).title(" help ");
    let inside = block.inner(area);
    frame.render_widget(block, area);
    let lines = lines();
    let widths = [Constraint::Length(10), Constraint::Fill(1)];
    parts::rows(frame, inside, &widths, lines.len(), parts::Part::From(first), |row| {
        let (left, right) = lines[row];
        let style = if right.is_empty() { style::TITLE } else { style::INFO };
        vec![Line::styled(left, style), right.into()]
    });
}

/// Number of lines of the help.
pub(crate) fn height() -> usize {
    lines().len()
}

/// Keys and what they do, and a title before each group.
fn lines() -> Vec<(&'static str, &'static str)> {
    let mut lines = Vec::new();
    for pane in [None].into_iter().chain(Pane::ALL.map(Some)) {
        let rows = TABLE.iter().filter(|row| row.pane == pane).map(|row| (row.label, row.help));
        let title = (pane.map_or("everywhere", Pane::name), "");
        lines.extend([title].into_iter().chain(rows));
        if lines.last() == Some(&title) {
            lines.pop();
        }
    }
    lines.push(("signs", ""));
    lines.extend(SIGNS);
    lines
}
