//! The screen: cells from what is known. Nothing here changes anything.

mod bench;
mod drives;
mod face;
mod help;
mod parts;
mod pins;
mod plot;
mod registers;
mod style;
mod traffic;

use std::time::Duration;

use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::text::{Line, Span};
use serde_json::Value;

use crate::app::{App, Mode, Purpose};
use crate::bench::Link;
use crate::keys::{Pane, TABLE};

pub(crate) use help::height as help_height;

/// Least size of a terminal in which all panes are visible at once: columns and rows.
const LARGE: (u16, u16) = (110, 32);

/// Least size of a terminal: columns and rows.
const LEAST: (u16, u16) = (40, 12);

/// Draws the whole screen.
pub(crate) fn draw(frame: &mut Frame, app: &App, now: Duration, has_colours: bool) {
    let area = frame.area();
    if area.width < LEAST.0 || area.height < LEAST.1 {
        let sentence = format!("the terminal is too small: {} x {} is the least", LEAST.0, LEAST.1);
        for (row, line) in (area.y..area.bottom()).zip(parts::wrapped(&sentence, area.width.into(), 9)) {
            frame.render_widget(Line::from(line), Rect { y: row, height: 1, ..area });
        }
        return;
    }
    let [top, middle, bottom] =
        Layout::vertical([Constraint::Length(1), Constraint::Min(1), Constraint::Length(2)]).areas(area);
    header(frame, top, app, now);
    if let Mode::Help(first) = app.mode {
        help::draw(frame, middle, first);
    } else if app.bench.state().is_null() {
        waiting(frame, middle, app);
    } else {
        panes(frame, middle, app, now);
    }
    footer(frame, bottom, app, now);
    if !has_colours {
        style::remove_colours(frame.buffer_mut(), area);
    }
}

fn header(frame: &mut Frame, area: Rect, app: &App, now: Duration) {
    let bench = &app.bench;
    let mut left = vec![Span::styled("drivetwin ", style::TITLE), Span::raw(app.address.clone())];
    if let Some(seconds) = bench.seconds() {
        let mode = bench.state()["time"]["mode"].as_str().unwrap_or_default();
        left.push(Span::styled(format!("  {mode} time "), style::MUTED));
        left.push(Span::raw(parts::time(seconds)));
    }
    let right = match (bench.link(), bench.silence(now)) {
        (Link::Live, Some(silence)) => {
            Span::styled(format!("✗ no answer for {} s", silence.as_secs()), style::BAD)
        }
        (Link::Live, None) => Span::styled("● live", style::GOOD),
        (Link::Connecting, _) => Span::styled("○ connecting", style::ODD),
        (Link::Lost(_), _) => Span::styled("✗ connection lost", style::BAD),
    };
    let wide = right.width() as u16;
    let [left_area, right_area] =
        Layout::horizontal([Constraint::Min(1), Constraint::Length(wide)]).spacing(1).areas(area);
    frame.render_widget(parts::fit(Line::from(left), left_area.width.into()), left_area);
    frame.render_widget(right, right_area);
}

/// The screen before the first update.
fn waiting(frame: &mut Frame, area: Rect, app: &App) {
    let text = match app.bench.link() {
        Link::Lost(reason) => format!("{reason}; the view tries again until you press q"),
        _ => format!("connecting to {}", app.address),
    };
    let lines = parts::wrapped(&text, usize::from(area.width).saturating_sub(4), 6);
    for (row, line) in (area.y + area.height / 3..area.bottom()).zip(lines) {
        frame.render_widget(Line::from(line).centered(), Rect { y: row, height: 1, ..area });
    }
}

fn panes(frame: &mut Frame, area: Rect, app: &App, now: Duration) {
    let is_large = frame.area().width >= LARGE.0 && frame.area().height >= LARGE.1;
    let mut area = area;
    if app.has_list() {
        let wide = if is_large { 26 } else { (area.width / 4).clamp(14, 26) };
        let [list, rest] = Layout::horizontal([Constraint::Length(wide), Constraint::Min(1)]).areas(area);
        drives::draw(frame, list, app);
        area = rest;
    }
    let [face, rest] = Layout::vertical([Constraint::Length(face::HEIGHT), Constraint::Min(1)]).areas(area);
    face::draw(frame, face, app);
    if is_large {
        let [left, right] =
            Layout::horizontal([Constraint::Percentage(56), Constraint::Percentage(44)]).areas(rest);
        let [plot, bottom] =
            Layout::vertical([Constraint::Percentage(55), Constraint::Percentage(45)]).areas(left);
        let [registers, contacts] =
            Layout::vertical([Constraint::Percentage(60), Constraint::Percentage(40)]).areas(right);
        let [pins, faults] =
            Layout::horizontal([Constraint::Percentage(58), Constraint::Percentage(42)]).areas(contacts);
        for (pane, area) in [
            (Pane::Plot, plot),
            (app.bottom(), bottom),
            (Pane::Registers, registers),
            (Pane::Pins, pins),
            (Pane::Faults, faults),
        ] {
            body(frame, area, app, pane, now);
        }
    } else {
        body(frame, rest, app, app.body(), now);
    }
    tabs(frame, Rect { y: face.bottom() - 1, height: 1, ..face }, app);
}

/// The names of the panes with their keys.
fn tabs(frame: &mut Frame, area: Rect, app: &App) {
    let mut spans = Vec::new();
    for pane in app.panes().filter(|pane| *pane != Pane::Drives) {
        let style = if app.focus == pane { style::CHOSEN } else { style::PLAIN };
        spans.push(Span::styled(format!("{} {}", pane.digit(), pane.name()), style));
        spans.push(Span::raw(" "));
    }
    frame.render_widget(parts::fit(Line::from(spans), area.width.into()), area);
}

fn body(frame: &mut Frame, area: Rect, app: &App, pane: Pane, now: Duration) {
    match pane {
        Pane::Drives => drives::draw(frame, area, app),
        Pane::Plot => plot::draw(frame, area, app),
        Pane::Registers => registers::draw(frame, area, app, now),
        Pane::Pins => pins::draw(frame, area, app),
        Pane::Faults => pins::draw_faults(frame, area, app),
        Pane::Traffic => traffic::draw(frame, area, app),
        Pane::Bench => bench::draw(frame, area, app),
        Pane::Log => bench::draw_log(frame, area, app),
    }
}

/// Two lines at the bottom: what is asked for, or the sentence of an error, or keys.
fn footer(frame: &mut Frame, area: Rect, app: &App, now: Duration) {
    let [first, second] = Layout::vertical([Constraint::Length(1); 2]).areas(area);
    let width = usize::from(area.width);
    match &app.mode {
        Mode::Entry { purpose, entry, sent, error } => {
            let (before, after) = entry.parts();
            let (label, hint) = question(purpose);
            let mut chars = after.chars();
            let under = chars.next().map_or(" ".to_owned(), |c| c.to_string());
            let label = Span::styled(label, style::TITLE);
            // The cursor stays visible in a line that is longer than the terminal.
            let room = width.saturating_sub(label.width() + 3);
            let skipped = Span::raw(before).width().saturating_sub(room);
            let typed = if entry.is_old() { style::CHOSEN } else { style::PLAIN };
            let line = Line::from(vec![
                label,
                Span::raw(" "),
                Span::styled(before.chars().skip(skipped).collect::<String>(), typed),
                Span::styled(under, style::CHOSEN),
                Span::raw(chars.collect::<String>()),
            ]);
            frame.render_widget(line, first);
            let below = match (error, sent) {
                (Some(sentence), _) => Span::styled(sentence.clone(), style::BAD),
                (None, Some(_)) => Span::styled("waiting for the bench", style::MUTED),
                (None, None) => Span::styled(hint, style::MUTED),
            };
            frame.render_widget(parts::fit(Line::from(below), width), second);
        }
        Mode::Menu(menu) => {
            let mut spans = vec![Span::styled(menu.title.clone(), style::TITLE)];
            for (key, label, _) in &menu.choices {
                spans.push(Span::styled(format!("  {key} "), style::FOCUS));
                spans.push(Span::raw(*label));
            }
            frame.render_widget(parts::fit(Line::from(spans), width), first);
            frame.render_widget(Span::styled("another key: nothing", style::MUTED), second);
        }
        Mode::Panes | Mode::Help(_) => {
            frame.render_widget(parts::fit(hints(app), width), second);
            let sentence = match (app.message(now), app.bench.link()) {
                (Some(sentence), _) => sentence,
                (None, Link::Lost(reason)) if !app.bench.state().is_null() => reason,
                _ => "",
            };
            frame.render_widget(
                parts::fit(Line::from(Span::styled(sentence.to_owned(), style::BAD)), width),
                first,
            );
        }
    }
}

/// The label of an input line, and what may be typed.
fn question(purpose: &Purpose) -> (String, String) {
    let (label, hint) = match purpose {
        Purpose::Filter(pane) => {
            return (format!("search in {}:", pane.name()), "Enter keeps it, Esc ends it".into());
        }
        Purpose::Register(name) => (format!("{name} ="), "a number: 8000, -5, 0x1F40; words with commas"),
        Purpose::Analogue(pin) => (format!("{pin} ="), "2.5 V or 12 mA"),
        Purpose::Pulses(pin) => {
            (format!("pulses into {pin}:"), "how many, and how many per second: 1000 2000")
        }
        Purpose::Encoder => {
            ("turn the encoder:".into(), "edges, negative turns back, and edges per second: 400 10000")
        }
        Purpose::LineFaults(bus) => (
            format!("faults of {bus}:"),
            "drop corrupt duplicate truncate noise mute delay_ms …: drop=0.01 delay_ms=5",
        ),
        Purpose::Times => ("time, times faster:".into(), "1 to 1000"),
        Purpose::Advance => ("advance, seconds:".into(), "0 to 86400, in manual time"),
    };
    (label, hint.to_owned())
}

/// The keys of the pane with the focus, and some for all.
fn hints(app: &App) -> Line<'static> {
    if matches!(app.mode, Mode::Help(_)) {
        return Line::from(Span::styled("Up, Down: scroll; another key: back", style::MUTED));
    }
    let of_pane = TABLE.iter().filter(|row| row.pane == Some(app.focus));
    let of_pane = of_pane.map(|row| (row.label, row.help.split([':', ';', ',']).next().unwrap_or_default()));
    let others = [("P", "power"), ("t", "time"), ("/", "search"), ("q", "end")];
    let mut spans = Vec::new();
    for (key, what) in [("?", "help")].into_iter().chain(of_pane).chain(others) {
        spans.push(Span::styled(key, style::FOCUS));
        spans.push(Span::styled(format!(" {what}  "), style::MUTED));
    }
    Line::from(spans)
}

/// A text of the state, or a dash.
fn text<'a>(value: &'a Value, member: &str) -> &'a str {
    value[member].as_str().unwrap_or("–")
}
