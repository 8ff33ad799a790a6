//! The face of the chosen drive: lights, power, motion, ports.

use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use serde_json::Value;

use super::parts::{fit, number};
use super::{style, text};
use crate::app::App;

/// Rows of the face: the name, lights, motion, ports, and the names of the panes.
pub(super) const HEIGHT: u16 = 5;

pub(super) fn draw(frame: &mut Frame, area: Rect, app: &App) {
    let lines = match app.drive() {
        Some(name) => [title(app, name), lights(app, name), motion(app, name), ports(app)],
        None => [Line::from("the bench has no drives"), Line::default(), Line::default(), Line::default()],
    };
    for (row, line) in (area.y..area.bottom()).zip(lines) {
        frame.render_widget(fit(line, area.width.into()), Rect { y: row, height: 1, ..area });
    }
}

/// Name, product, and power.
fn title(app: &App, name: &str) -> Line<'static> {
    let drive = app.bench.summary(name);
    let power = match drive["powered"].as_bool() {
        Some(true) => Span::styled("power on", style::GOOD),
        Some(false) => Span::styled("power off", style::BAD),
        None => Span::raw(""),
    };
    let kind = match (app.bench.followed() == Some(name)).then(|| app.bench.kind()["product"].as_str()) {
        Some(Some(product)) => product,
        _ => text(drive, "kind"),
    };
    let mut spans = vec![Span::styled(name.to_owned(), style::TITLE), "  ".into(), power, "  ".into()];
    if let Some(reason) = drive["board"]["away"].as_str() {
        spans.push(Span::styled(format!("{reason}  "), style::BAD));
    } else if let Some(place) = drive["board"]["place"].as_str() {
        spans.push(Span::styled(format!("board at {place}  "), style::INFO));
    }
    spans.push(Span::styled(kind.to_owned(), style::MUTED));
    Line::from(spans)
}

/// Lights, and the causes of faults that are there.
fn lights(app: &App, name: &str) -> Line<'static> {
    let mut spans = Vec::new();
    for (name, is_lit) in app.bench.lights() {
        let (sign, style) = if is_lit { ("●", style::light(name)) } else { ("○", style::MUTED) };
        spans.extend([Span::styled(sign, style), format!(" {name}  ").into()]);
    }
    let causes: Vec<&str> =
        app.bench.faults().into_iter().filter(|(_, is_there)| *is_there).map(|(name, _)| name).collect();
    if !causes.is_empty() {
        spans.push(Span::styled(format!("! {}  ", causes.join(", ")), style::BAD));
    } else if app.bench.summary(name)["fault"] == true {
        spans.push(Span::styled("! fault  ", style::BAD));
    }
    Line::from(spans)
}

/// Figures of the motion, and of the motor.
fn motion(app: &App, name: &str) -> Line<'static> {
    let drive = app.bench.summary(name);
    let Some(position) = drive["position"].as_f64() else {
        return Line::styled("no motion", style::MUTED);
    };
    let label = |text: &'static str| Span::styled(text, style::MUTED);
    let speed = drive["speed"].as_f64().unwrap_or(0.0);
    let moving = if drive["moving"] == true {
        Span::styled("▶ moving  ", style::INFO)
    } else {
        Span::styled("■ at rest  ", style::MUTED)
    };
    let mut spans = vec![
        moving,
        label("position "),
        Span::styled(number(position, 0), style::TITLE),
        label("  speed "),
        Span::styled(format!("{}/s", number(speed, 0)), style::TITLE),
    ];
    let motion = &app.bench.drive()["motion"];
    if let Some(current) = motion["current"].as_f64() {
        spans.extend([label("  current "), format!("{} A", number(current, 2)).into()]);
    }
    if let Some(duty) = motion["duty"].as_f64().filter(|duty| *duty != 0.0) {
        spans.extend([label("  duty "), number(duty, 2).into()]);
    }
    for (motor, state) in app.bench.state()["motors"].as_object().into_iter().flatten() {
        if state["drive"] == name {
            spans.push(label("  motor "));
            spans.extend(turn(motor, state));
        }
    }
    Line::from(spans)
}

/// Figures of a motor.
pub(super) fn turn(name: &str, motor: &Value) -> Vec<Span<'static>> {
    let of = |member: &str| motor[member].as_f64().unwrap_or(0.0);
    let figures = format!("{name} {} rev, {} rpm", number(of("revolutions"), 2), number(of("rpm"), 0));
    let mut spans = vec![Span::raw(figures)];
    if motor["stalled"] == true {
        spans.push(Span::styled(" stalled", style::BAD));
    }
    spans
}

/// Statistics of the ports, in the words of the page.
fn ports(app: &App) -> Line<'static> {
    let mut spans = Vec::new();
    for (name, port) in app.bench.drive()["ports"].as_object().into_iter().flatten() {
        let count = |member: &str| port[member].as_u64().unwrap_or(0);
        let line = port["line"].as_str().unwrap_or("TCP");
        let counts = format!("{name} {line}: {} executed", number(count("requests") as f64, 0));
        spans.push(Span::styled(counts, style::MUTED));
        for (member, word, style) in [("refused", "refused", style::BAD), ("dropped", "ignored", style::ODD)]
        {
            if count(member) > 0 {
                let count = number(count(member) as f64, 0);
                spans.push(Span::styled(format!(", {count} {word}"), style));
            }
        }
        spans.push(Span::raw("  "));
    }
    Line::from(spans)
}
