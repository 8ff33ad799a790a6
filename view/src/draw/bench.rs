//! Lines, motors and wires of the bench; the log of the process.

use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::text::{Line, Span};
use serde_json::Value;

use super::parts::{self, Part};
use super::{face, style};
use crate::app::App;
use crate::entry;
use crate::keys::Pane;

pub(super) fn draw(frame: &mut Frame, area: Rect, app: &App) {
    let state = app.bench.state();
    let inside = parts::pane(frame, area, app, Pane::Bench, "");
    let buses = app.buses();
    let others = others(state);
    let below = (others.len() as u16).min(inside.height / 3);
    let [list, below] = Layout::vertical([Constraint::Min(1), Constraint::Length(below)]).areas(inside);
    let chosen = app.row(Pane::Bench, buses.len());
    let names = Constraint::Max(18);
    parts::rows(
        frame,
        list,
        &[names, Constraint::Fill(1)],
        buses.len(),
        Part::around_or_first(app, Pane::Bench, chosen),
        |row| {
            let bus = &state["buses"][buses[row]];
            vec![buses[row].into(), Line::from(bus_words(bus))]
        },
    );
    for (row, line) in (below.y..below.bottom()).zip(others) {
        frame.render_widget(parts::fit(line, below.width.into()), Rect { y: row, height: 1, ..below });
    }
}

/// Faults, settings, addresses and drives of a line or a TCP port.
fn bus_words(bus: &Value) -> Vec<Span<'static>> {
    let list = |member: &str| {
        let words = bus[member].as_array().into_iter().flatten().filter_map(Value::as_str);
        words.map(ToOwned::to_owned).collect::<Vec<_>>()
    };
    let mut spans = Vec::new();
    let faults = entry::line_faults_text(&bus["faults"]);
    if !faults.is_empty() {
        spans.push(Span::styled(format!("! {faults}  "), style::BAD));
    }
    spans.push(Span::styled(format!("{}  ", bus["line"].as_str().unwrap_or("TCP")), style::MUTED));
    spans.push(Span::raw(list("listen").join("  ")));
    let drives = list("drives");
    let few = if drives.len() > 4 { format!("{} drives", drives.len()) } else { drives.join(", ") };
    spans.push(Span::styled(format!("  {few}"), style::MUTED));
    if bus["strict"] == true {
        spans.push(Span::styled("  strict", style::ODD));
    }
    if let Some(early) = bus["early_requests"].as_u64().filter(|early| *early > 0) {
        spans.push(Span::styled(format!("  {early} too early"), style::ODD));
    }
    spans
}

/// Motors and wires.
fn others(state: &Value) -> Vec<Line<'static>> {
    let motors = state["motors"].as_object().into_iter().flatten().map(|(name, motor)| {
        let drive = motor["drive"].as_str().unwrap_or("–");
        let mut spans = vec![Span::styled(format!("motor of {drive}: "), style::MUTED)];
        spans.extend(face::turn(name, motor));
        Line::from(spans)
    });
    let wires = state["wires"].as_array().into_iter().flatten().map(|wire| {
        let end = |member: &str| wire[member].as_str().unwrap_or("–").to_owned();
        Line::from(vec![
            Span::styled("wire ", style::MUTED),
            Span::raw(format!("{} ► {}", end("from"), end("to"))),
        ])
    });
    motors.chain(wires).collect()
}

pub(super) fn draw_log(frame: &mut Frame, area: Rect, app: &App) {
    let lines = app.log_lines();
    let inside = parts::pane(frame, area, app, Pane::Log, "");
    let chosen = app.row(Pane::Log, lines.len());
    parts::rows(
        frame,
        inside,
        &[Constraint::Fill(1)],
        lines.len(),
        Part::around_or_last(app, Pane::Log, chosen),
        |row| vec![lines[row].into()],
    );
}
