//! Messages of the chosen drive, in words.

use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::text::{Line, Span};
use serde_json::Value;

use super::parts::{self, Part};
use super::{style, text};
use crate::app::App;
use crate::keys::Pane;

/// Rows for the whole of a message.
const DETAIL: u16 = 4;

/// Least width at which the time since the message before is shown.
const WIDE: u16 = 60;

pub(super) fn draw(frame: &mut Frame, area: Rect, app: &App) {
    let frames = app.frames();
    let errors = if app.only_errors { "not done " } else { "" };
    let left_out = match app.bench.left_out() {
        0 => String::new(),
        count => format!(", {} left out", parts::number(count as f64, 0)),
    };
    let title = format!("{errors}{}{left_out}", frames.len());
    let inside = parts::pane(frame, area, app, Pane::Traffic, &title);
    let chosen = app.row(Pane::Traffic, frames.len());
    // Without a choice the newest message that was not done is what a person wants to know more about.
    let newest = || frames.iter().rposition(|message| message["verdict"] != "done");
    let whole = chosen.or_else(newest).map(|row| frames[row]);
    let detail = if whole.is_some() { DETAIL.min(inside.height / 2) } else { 0 };
    let [list, below] = Layout::vertical([Constraint::Min(1), Constraint::Length(detail)]).areas(inside);
    let is_wide = list.width >= WIDE;
    let mut widths = vec![Constraint::Length(11), Constraint::Length(1), Constraint::Fill(1)];
    if is_wide {
        widths.insert(1, Constraint::Length(9));
    }
    parts::rows(
        frame,
        list,
        &widths,
        frames.len(),
        Part::around_or_last(app, Pane::Traffic, chosen),
        |row| {
            let message = frames[row];
            let at = message["at"].as_f64().unwrap_or(0.0);
            let before = row.checked_sub(1).and_then(|before| frames[before]["at"].as_f64());
            let style = style::verdict(text(message, "verdict"));
            let is_sent = message["sent"] == true;
            let sign = if is_sent { Span::styled("←", style::INFO) } else { Span::styled("→", style) };
            let mut words = vec![Span::raw(text(message, "text"))];
            if !is_sent {
                words.push(Span::styled(format!("  {}", text(message, "outcome")), style));
            }
            let mut cells =
                vec![Line::styled(parts::time(at), style::MUTED).right_aligned(), sign.into(), words.into()];
            if is_wide {
                let since = before.map(|before| since(at - before)).unwrap_or_default();
                cells.insert(1, Line::styled(since, style::INFO).right_aligned());
            }
            cells
        },
    );
    if let Some(message) = whole {
        draw_detail(frame, below, message);
    }
    if frames.is_empty() {
        let sentence = if app.bench.frames().is_empty() { "no messages yet" } else { "no such messages" };
        frame.render_widget(Line::styled(sentence, style::MUTED), inside);
    }
}

/// Time since the message before.
fn since(seconds: f64) -> String {
    let ms = seconds.max(0.0) * 1_000.0;
    match ms {
        0.0..100.0 => format!("+{ms:.1} ms"),
        0.0..1_000.0 => format!("+{ms:.0} ms"),
        0.0..100_000.0 => format!("+{:.1} s", ms / 1_000.0),
        _ => format!("+{:.0} s", ms / 1_000.0),
    }
}

/// The whole of a message: time, port, bytes, answer, outcome.
fn draw_detail(frame: &mut Frame, area: Rect, message: &Value) {
    let width = usize::from(area.width);
    let at = parts::time(message["at"].as_f64().unwrap_or(0.0));
    let mut lines = vec![Line::from(vec![
        Span::styled(format!("{at} {} ", text(message, "port")), style::MUTED),
        Span::raw(text(message, "bytes")),
        Span::styled(
            message["answer"].as_str().map(|answer| format!("  answer {answer}")).unwrap_or_default(),
            style::MUTED,
        ),
    ])];
    let outcome = format!("{}: {}", text(message, "text"), text(message, "outcome"));
    let style = style::verdict(text(message, "verdict"));
    let most = usize::from(area.height).saturating_sub(1);
    lines.extend(parts::wrapped(&outcome, width, most).into_iter().map(|line| Line::styled(line, style)));
    for (row, line) in (area.y..area.bottom()).zip(lines) {
        frame.render_widget(parts::fit(line, width), Rect { y: row, height: 1, ..area });
    }
}
