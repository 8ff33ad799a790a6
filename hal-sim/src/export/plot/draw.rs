//! Layout and drawing of a picture.

use std::collections::HashSet;
use std::fmt::Write as _;

use drivetwin_firmware::device::Instant;
use svg::Document;
use svg::node::element::{Group, Line, Path, Rectangle, Style, Text, Title};

use super::Span;
use super::axis::{number, seconds, ticks};
use super::exchanges::{Exchange, exchanges};
use super::tracks::{Edge, Panel, Shape, Words};
use crate::decode::Mark;
use crate::signals::waveforms::{Kind, Track, Variable};

/// Width of a picture, and the part of it in which time runs, in px.
const WIDTH: f64 = 1_200.0;
const LEFT: f64 = 168.0;
const RIGHT: f64 = 1_176.0;
/// Margin of a picture.
const MARGIN: f64 = 24.0;
/// Heights of a heading, of the heading of a drive, of a pin, of the marks of messages, of a row of their words.
const HEADING: f64 = 52.0;
const DRIVE: f64 = 34.0;
const PIN: f64 = 22.0;
const MARKS: f64 = 18.0;
const ROW: f64 = 15.0;
/// Distance of two tracks, and of two drives.
const GAP: f64 = 8.0;
const PANEL_GAP: f64 = 18.0;
/// Number of messages above which equal reads are named once.
const CROWD: usize = 40;
/// Maximum number of characters of a label, and of rows of labels.
const LABEL: usize = 56;
const ROWS: usize = 5;

const STYLE: &str = "\
text { font-family: system-ui, 'Segoe UI', 'Helvetica Neue', Arial, 'DejaVu Sans', sans-serif; font-size: 11px; fill: #334155; }
.title { font-size: 16px; font-weight: 600; fill: #0f172a; }
.drive { font-size: 13px; font-weight: 600; fill: #0f172a; }
.note, .tick { fill: #64748b; }
.tick, .note { font-size: 10px; }
.name { font-weight: 600; }
.frame { fill: #f8fafc; stroke: #e2e8f0; stroke-width: 1; }
.grid { stroke: #e2e8f0; stroke-width: 1; }
.curve { fill: none; stroke-width: 1.6; stroke-linejoin: round; stroke-linecap: round; }
.position { stroke: #2563eb; } .speed { stroke: #059669; } .current { stroke: #d97706; }
.duty { stroke: #7c3aed; } .volts { stroke: #0891b2; } .pin { stroke: #475569; }
.many { fill: #94a3b8; } .floating { stroke: #94a3b8; stroke-dasharray: 3 3; fill: none; }
.unknown { fill: #e2e8f0; }
.received { fill: #0284c7; } .sent { fill: #7dd3fc; }
.refused { fill: #dc2626; stroke: #dc2626; } .without-effect { fill: #d97706; stroke: #d97706; }
.not-received { fill: none; stroke: #0f172a; } .by-fault { fill: #a21caf; stroke: #a21caf; }
.sign { stroke-width: 1.6; }
.pole { stroke: #cbd5e1; stroke-width: 1; }
text.words { font-size: 10.5px; fill: #075985; stroke: #f8fafc; stroke-width: 3px; paint-order: stroke; }
text.refused { fill: #b91c1c; stroke: #f8fafc; } text.without-effect { fill: #b45309; stroke: #f8fafc; }
text.not-received { fill: #0f172a; stroke: #f8fafc; } text.by-fault { fill: #86198f; stroke: #f8fafc; }
";

/// A track in its place.
struct Place<'a> {
    top: f64,
    height: f64,
    content: Content<'a>,
}

enum Content<'a> {
    Curve(&'a Variable, &'a [(Instant, Option<f64>)]),
    Levels(&'a Variable, &'a [Edge]),
    Messages(String, Vec<Exchange<'a>>, Vec<Label>),
}

/// Words beside the mark of a message.
struct Label {
    x: f64,
    row: usize,
    text: String,
    mark: Mark,
    /// True if the words are to the left of the mark.
    is_left: bool,
}

/// Draws the picture.
pub(super) fn picture(title: &str, span: Span, panels: &[Panel]) -> String {
    let mut top = HEADING;
    let mut drawn = Group::new();
    for panel in panels {
        let (group, bottom) = drive(panel, top, span);
        drawn = drawn.add(group);
        top = bottom + PANEL_GAP;
    }
    let bottom = top - PANEL_GAP + GAP;
    let height = bottom + 44.0;
    let mut document = Document::new()
        .set("viewBox", format!("0 0 {WIDTH} {height:.0}"))
        .set("width", WIDTH)
        .set("height", format!("{height:.0}"))
        .set("role", "img")
        .add(Title::new(title))
        .add(Style::new(STYLE))
        .add(Rectangle::new().set("width", "100%").set("height", "100%").set("fill", "#ffffff"))
        .add(text("title", MARGIN, 30.0, title))
        .add(legend(&marks(panels)));
    document = document.add(drawn).add(time_axis(span, bottom));
    document.to_string() + "\n"
}

fn text(class: &str, x: f64, y: f64, words: &str) -> Text {
    Text::new(words).set("class", class).set("x", round(x)).set("y", round(y))
}

fn round(value: f64) -> f64 {
    (value * 10.0).round() / 10.0
}

/// Place of a time.
fn x(span: Span, at: Instant) -> f64 {
    LEFT + (RIGHT - LEFT) * span.part(at).clamp(0.0, 1.0)
}

/// Class of a mark; empty for a message that is done.
fn class(mark: Mark) -> &'static str {
    match mark {
        Mark::Done => "",
        Mark::Refused => "refused",
        Mark::WithoutEffect => "without-effect",
        Mark::NotReceived => "not-received",
        Mark::ByFault => "by-fault",
    }
}

/// The sign of a mark, with the middle of the sign at (`x`, `y`): a square, a triangle, a cross or a diamond. A message
/// that is done has no sign.
fn sign(mark: Mark, x: f64, y: f64) -> Option<Path> {
    let steps = match mark {
        Mark::Done => return None,
        Mark::Refused => "m-4,-4h8v8h-8z",
        Mark::WithoutEffect => "m0,-5l5,9h-10z",
        Mark::NotReceived => "m-4,-4l8,8m0,-8l-8,8",
        Mark::ByFault => "m0,-6l6,6l-6,6l-6,-6z",
    };
    let class = format!("sign {}", class(mark));
    Some(Path::new().set("class", class).set("d", format!("M{x:.1},{y:.1}{steps}")))
}

/// The marks of all messages, each once.
fn marks(panels: &[Panel]) -> Vec<Mark> {
    let shapes = panels.iter().flat_map(|panel| panel.tracks.iter().map(|(_, shape)| shape));
    let messages = shapes.filter_map(|shape| match shape {
        Shape::Messages(messages) => Some(messages),
        _ => None,
    });
    let present: HashSet<Mark> =
        messages.flatten().filter_map(|message| message.outcome.as_ref()).map(|(_, mark)| *mark).collect();
    let all = [Mark::Refused, Mark::WithoutEffect, Mark::NotReceived, Mark::ByFault];
    all.into_iter().filter(|mark| present.contains(mark)).collect()
}

/// Legend of the colours and signs of these marks, at the right of the heading.
fn legend(marks: &[Mark]) -> Group {
    let mut group = Group::new();
    let words = |mark| class(mark).replace('-', " ");
    let width = |mark| 19.0 + words(mark).len() as f64 * 5.4 + 22.0;
    // Before the colours, which begin at 780.
    let mut left = 780.0 - marks.iter().map(|&mark| width(mark)).sum::<f64>();
    for &mark in marks {
        if let Some(sign) = sign(mark, left + 7.0, 25.5) {
            let words = words(mark);
            group = group.add(sign).add(text("note", left + 19.0, 29.0, &words));
            left += width(mark);
        }
    }
    left = 780.0;
    let mark = |class: &str, left: f64| {
        Rectangle::new().set("class", class).set("x", left).set("y", 21).set("width", 14).set("height", 9)
    };
    for (class, words) in
        [("received", "to the drive"), ("sent", "answer"), ("many", "many edges"), ("unknown", "unknown")]
    {
        group = group.add(mark(class, left)).add(text("note", left + 19.0, 29.0, words));
        left += 19.0 + words.len() as f64 * 5.4 + 22.0;
    }
    group
}

/// The time axis below all drives.
fn time_axis(span: Span, bottom: f64) -> Group {
    let (from, to) = (seconds(span.from), seconds(span.to));
    let mut group = Group::new();
    for (at, words) in time_ticks(from, to) {
        let x = LEFT + (RIGHT - LEFT) * (at - from) / (to - from);
        group = group.add(text("tick", x, bottom + 14.0, &words).set("text-anchor", "middle"));
    }
    let words = format!("time in {}", time_unit(from, to).1);
    group.add(text("note", (LEFT + RIGHT) / 2.0, bottom + 32.0, &words).set("text-anchor", "middle"))
}

/// Unit of the time axis: its number in a second, and its name.
fn time_unit(from: f64, to: f64) -> (f64, &'static str) {
    if to - from < 0.2 { (1e3, "ms") } else { (1.0, "s") }
}

/// Ticks of the time axis, in seconds, with their numbers.
fn time_ticks(from: f64, to: f64) -> Vec<(f64, String)> {
    let (unit, _) = time_unit(from, to);
    let ticks = ticks(from * unit, to * unit, 10);
    let step = ticks.get(1).map_or(1.0, |second| second - ticks[0]);
    ticks.into_iter().map(|at| (at / unit, number(at, step))).collect()
}

/// Draws a drive from `top` on. Returns the bottom, too.
fn drive(panel: &Panel, top: f64, span: Span) -> (Group, f64) {
    let mut group = Group::new().set("data-drive", panel.name.as_str());
    let heading = text("drive", MARGIN, top + 18.0, &panel.name);
    let product = text("note", LEFT, top + 18.0, panel.spec.product);
    group = group.add(heading).add(product);
    let places = places(panel, top + DRIVE, span);
    let bottom = places.last().map_or(top + DRIVE + PIN, |place| place.top + place.height);
    let frame = Rectangle::new()
        .set("class", "frame")
        .set("x", LEFT)
        .set("y", round(top + DRIVE - GAP / 2.0))
        .set("width", RIGHT - LEFT)
        .set("height", round(bottom - top - DRIVE + GAP));
    group = group.add(frame);
    let (from, to) = (seconds(span.from), seconds(span.to));
    for (at, _) in time_ticks(from, to) {
        let x = round(LEFT + (RIGHT - LEFT) * (at - from) / (to - from));
        let (y1, y2) = (round(top + DRIVE - GAP / 2.0), round(bottom + GAP / 2.0));
        group =
            group.add(Line::new().set("class", "grid").set("x1", x).set("x2", x).set("y1", y1).set("y2", y2));
    }
    if places.is_empty() {
        group = group.add(text("note", LEFT + 8.0, top + DRIVE + 14.0, "nothing changes"));
    }
    for place in places {
        group = group.add(match &place.content {
            Content::Curve(variable, points) => curve(variable, points, panel.turns_motor, &place, span),
            Content::Levels(variable, edges) => levels(variable, edges, &place, span),
            Content::Messages(port, exchanges, labels) => messages(port, exchanges, labels, &place, span),
        });
    }
    (group, bottom)
}

/// The tracks of a drive that have something to show, in their places: motion, messages, pins.
fn places(panel: &Panel, mut top: f64, span: Span) -> Vec<Place<'_>> {
    let mut contents = Vec::new();
    let alive = || panel.tracks.iter().filter(|(_, shape)| shape.is_alive());
    for (variable, shape) in alive() {
        if let (Kind::Track(track), Shape::Curve(points)) = (variable.kind, shape) {
            let height = if track == Track::Position { 92.0 } else { 64.0 };
            contents.push((height, Content::Curve(variable, points)));
        }
    }
    let of = |kind| panel.tracks.iter().filter(move |(variable, _)| variable.kind == kind);
    for ((variable, received), (_, sent)) in of(Kind::Received).zip(of(Kind::Sent)) {
        let (Shape::Messages(received), Shape::Messages(sent)) = (received, sent) else { continue };
        if received.is_empty() && sent.is_empty() {
            continue;
        }
        let exchanges = exchanges(received, sent);
        let labels = labels(&exchanges, span);
        let rows = labels.iter().map(|label| label.row + 1).max().unwrap_or(0);
        let port = variable.name.trim_end_matches("_rx");
        let lane = format!("{}.{port}", panel.name);
        contents.push((MARKS + ROW * rows as f64, Content::Messages(lane, exchanges, labels)));
    }
    for (variable, shape) in alive() {
        match (variable.kind, shape) {
            (Kind::Volts, Shape::Curve(points)) => contents.push((44.0, Content::Curve(variable, points))),
            (Kind::Level, Shape::Levels(edges)) => {
                contents.push((PIN - GAP, Content::Levels(variable, edges)));
            }
            _ => {}
        }
    }
    let place = |(height, content)| {
        let place = Place { top, height, content };
        top += height + GAP;
        place
    };
    contents.into_iter().map(place).collect()
}

/// Words of messages, as far as there is room: first of those that were refused, then of commands, then of
/// reads. A message like the one before has none; among many messages only the first of equal reads has. Later
/// messages are in higher rows, so the lines from the marks to the words cross few words.
fn labels(exchanges: &[Exchange<'_>], span: Span) -> Vec<Label> {
    let (mut bad, mut commands, mut reads) = (Vec::new(), Vec::new(), Vec::new());
    let (mut before, mut known) = (String::new(), HashSet::new());
    for exchange in exchanges {
        let words = exchange.text();
        let is_read = exchange.request().is_none_or(|request| request.starts_with("read "));
        let is_new = !(is_read && exchanges.len() > CROWD) || known.insert(exchange.request());
        let list = match (exchange.is_bad(), is_read) {
            (true, _) => &mut bad,
            (_, false) => &mut commands,
            (_, true) => &mut reads,
        };
        if is_new && words != before {
            list.push((exchange, words.clone()));
        }
        before = words;
    }
    let mut taken: Vec<Vec<(f64, f64)>> = vec![Vec::new(); ROWS];
    let mut labels = Vec::new();
    for (exchange, words) in [bad, commands, reads].into_iter().flat_map(|list| list.into_iter().rev()) {
        let mut text: String = words.chars().take(LABEL).collect();
        if words.chars().count() > LABEL {
            text.push('…');
        }
        let width = text.chars().map(width).sum::<f64>() + 12.0;
        let x = x(span, exchange.begin());
        let is_left = x + width > RIGHT;
        let (from, to) = if is_left { (x - width, x) } else { (x, x + width) };
        let is_free = |row: &Vec<(f64, f64)>| row.iter().all(|&(a, b)| to <= a || b <= from);
        if let Some(row) = taken.iter().position(is_free) {
            taken[row].push((from, to));
            labels.push(Label { x, row, text, mark: exchange.mark(), is_left });
        }
    }
    labels
}

/// Width of a character in a label. Fonts differ, so it is a wide one's.
fn width(character: char) -> f64 {
    match character {
        'i' | 'j' | 'l' | 'f' | 't' | 'r' | 'I' | ' ' | '.' | ',' | ':' | '(' | ')' => 4.2,
        'm' | 'w' | 'M' | 'W' | '→' | '…' => 9.5,
        'A'..='Z' | '=' | '_' => 7.6,
        _ => 6.4,
    }
}

/// Name and unit of a track at its left.
fn name(words: &str, unit: &str, top: f64) -> Group {
    let group = Group::new().add(text("name", MARGIN, top + 11.0, words));
    if unit.is_empty() { group } else { group.add(text("note", MARGIN, top + 24.0, unit)) }
}

fn curve(
    variable: &Variable,
    points: &[(Instant, Option<f64>)],
    counts: bool,
    place: &Place<'_>,
    span: Span,
) -> Group {
    let (class, unit) = match variable.kind {
        Kind::Track(Track::Position) => ("position", if counts { "counts" } else { "steps" }),
        Kind::Track(Track::Speed) => ("speed", if counts { "counts/s" } else { "steps/s" }),
        Kind::Track(Track::Current) => ("current", "A"),
        Kind::Track(Track::Duty) => ("duty", "of full on"),
        _ => ("volts", "V"),
    };
    let known = || points.iter().filter_map(|(_, value)| *value);
    let (least, most) = (known().fold(f64::INFINITY, f64::min), known().fold(f64::NEG_INFINITY, f64::max));
    // Zero is in the picture if it is near.
    let (least, most) = (
        least.min(if least < most - least { 0.0 } else { least }),
        most.max(if -most < most - least { 0.0 } else { most }),
    );
    let pad = ((most - least) * 0.06).max(1e-9);
    let (least, most) = (least - pad, most + pad);
    let y = |value: f64| place.top + place.height * (most - value) / (most - least);
    let mut group =
        Group::new().set("data-track", variable.name.as_str()).add(name(&variable.name, unit, place.top));
    let count = (place.height / 20.0) as usize;
    let ticks = (count..).map(|count| ticks(least, most, count)).find(|ticks| ticks.len() > 1);
    let ticks = ticks.unwrap_or_default();
    let step = ticks.get(1).map_or(1.0, |second| second - ticks[0]);
    for tick in ticks {
        let y = round(y(tick));
        group = group
            .add(Line::new().set("class", "grid").set("x1", LEFT).set("x2", RIGHT).set("y1", y).set("y2", y))
            .add(text("tick", LEFT - 6.0, y + 3.5, &number(tick, step)).set("text-anchor", "end"));
    }
    let mut path = String::new();
    for curve in points.split(|(_, value)| value.is_none()) {
        let points = curve.iter().filter_map(|(at, value)| Some((x(span, *at), y((*value)?))));
        for (n, (x, y)) in simple(points).into_iter().enumerate() {
            let _ = write!(path, "{}{x:.1},{y:.1}", if n == 0 { "M" } else { "L" });
        }
    }
    group.add(Path::new().set("class", format!("curve {class}")).set("d", path))
}

/// The points of a curve that are needed so that no other point is more than 0.1 px beside it.
fn simple(points: impl Iterator<Item = (f64, f64)>) -> Vec<(f64, f64)> {
    const NEAR: f64 = 0.1;
    let mut kept: Vec<(f64, f64)> = Vec::new();
    // The last point, and the slopes from the last kept point that pass all points after it.
    let mut last: Option<(f64, f64)> = None;
    let mut slopes = (f64::NEG_INFINITY, f64::INFINITY);
    for point in points {
        let way = |from: (f64, f64)| (point.0 - from.0, point.1 - from.1);
        let Some(&from) = kept.last() else {
            kept.push(point);
            continue;
        };
        let (dx, dy) = way(from);
        let fits = dx > 0.0 && slopes.0 <= dy / dx && dy / dx <= slopes.1;
        if !fits {
            kept.extend(last.take());
            slopes = (f64::NEG_INFINITY, f64::INFINITY);
        }
        let (dx, dy) = way(*kept.last().unwrap_or(&from));
        if dx > 0.0 {
            slopes = (slopes.0.max((dy - NEAR) / dx), slopes.1.min((dy + NEAR) / dx));
            last = Some(point);
        } else {
            kept.push(point);
        }
    }
    kept.extend(last);
    kept
}

fn levels(variable: &Variable, edges: &[Edge], place: &Place<'_>, span: Span) -> Group {
    let mut group =
        Group::new().set("data-pin", variable.name.as_str()).add(name(&variable.name, "", place.top));
    let (high, low) = (place.top + 1.0, place.top + place.height - 1.0);
    let middle = (high + low) / 2.0;
    let (mut line, mut dashes, mut is_down) = (String::new(), String::new(), false);
    let block = |class: &str, from: f64, to: f64| {
        Rectangle::new()
            .set("class", class)
            .set("x", round(from))
            .set("y", round(high))
            .set("width", round((to - from).max(0.6)))
            .set("height", round(low - high))
    };
    // Adjacent columns of many edges are one block.
    let mut crowd: Option<(f64, f64)> = None;
    let mut blocks = Vec::new();
    let column = (RIGHT - LEFT) / super::tracks::COLUMNS;
    for (index, edge) in edges.iter().enumerate() {
        let from = x(span, edge.at);
        let to = edges.get(index + 1).map_or(RIGHT, |next| x(span, next.at));
        if edge.many {
            let until = (from + column).min(to.max(from));
            crowd = match crowd {
                Some((since, end)) if from - end < column => Some((since, until)),
                Some(before) => {
                    blocks.push(before);
                    Some((from, until))
                }
                None => Some((from, until)),
            };
        }
        match edge.level {
            // The level between two crowds of edges cannot be seen.
            _ if edge.many && to - from < 2.0 * column => is_down = false,
            '0' | '1' => {
                let y = if edge.level == '1' { high } else { low };
                let start = if is_down { "L" } else { "M" };
                let _ = write!(line, "{start}{from:.1},{y:.1}H{to:.1}");
                is_down = true;
            }
            'z' => {
                let _ = write!(dashes, "M{from:.1},{middle:.1}H{to:.1}");
                is_down = false;
            }
            _ => {
                group = group.add(block("unknown", from, to));
                is_down = false;
            }
        }
    }
    blocks.extend(crowd);
    for (from, to) in blocks {
        group = group.add(block("many", from, to));
    }
    if !dashes.is_empty() {
        group = group.add(Path::new().set("class", "floating").set("d", dashes));
    }
    group.add(Path::new().set("class", "curve pin").set("d", line))
}

fn messages(
    port: &str,
    exchanges: &[Exchange<'_>],
    labels: &[Label],
    place: &Place<'_>,
    span: Span,
) -> Group {
    let mut group = Group::new().set("data-messages", port).add(name(port, "messages", place.top));
    let bottom = place.top + 14.0;
    for label in labels {
        let (x, y) = (round(label.x), round(bottom + ROW * (label.row as f64 + 1.0)));
        let pole = Line::new().set("class", "pole").set("x1", x).set("x2", x);
        group = group.add(pole.set("y1", bottom).set("y2", y));
    }
    for label in labels {
        let y = bottom + ROW * (label.row as f64 + 1.0);
        let class = format!("words {}", class(label.mark));
        let (anchor, place) = if label.is_left { ("end", label.x - 4.0) } else { ("start", label.x + 4.0) };
        group = group.add(text(class.trim_end(), place, y - 2.0, &label.text).set("text-anchor", anchor));
    }
    let mark = |class: &str, top: f64, words: &Words, title: &str| {
        let from = x(span, words.begin);
        let width = (x(span, words.end) - from).max(1.2);
        Rectangle::new()
            .set("class", class)
            .set("x", round(from))
            .set("y", round(place.top + top))
            .set("width", round(width))
            .set("height", 6)
            .add(Title::new(title))
    };
    let mut last = f64::NEG_INFINITY;
    for exchange in exchanges {
        // Marks that would cover each other are left out.
        let from = x(span, exchange.begin());
        if from - last < 0.5 && !exchange.is_bad() {
            continue;
        }
        last = from;
        let title = format!("{} s: {}", seconds(exchange.begin()), exchange.text());
        if let Some(sent) = exchange.sent {
            group = group.add(mark("sent", 7.0, sent, &title));
        }
        if let Some(received) = exchange.received {
            group = group.add(mark("received", 0.0, received, &title));
        }
        if let Some(sign) = sign(exchange.mark(), from, place.top + 6.0) {
            group = group.add(sign.add(Title::new(&title)));
        }
    }
    group
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_keeps_its_corners_and_steps() {
        let line = (0..100).map(|x| (f64::from(x), 2.0 * f64::from(x)));
        assert_eq!(simple(line), [(0.0, 0.0), (99.0, 198.0)]);
        let steps = [(0.0, 0.0), (5.0, 0.0), (5.0, 9.0), (6.0, 9.0), (8.0, 9.0), (8.0, 0.0), (9.0, 0.0)];
        let kept = [(0.0, 0.0), (5.0, 0.0), (5.0, 9.0), (8.0, 9.0), (8.0, 0.0), (9.0, 0.0)];
        assert_eq!(simple(steps.into_iter()), kept);
        let curve = |x: f64| (x, x * x / 1_000.0);
        let kept = simple((0..1_000).map(|x| curve(f64::from(x))));
        assert!(kept.len() < 100, "{}", kept.len());
        for pair in kept.windows(2) {
            let ((x0, y0), (x1, y1)) = (pair[0], pair[1]);
            for x in x0 as i32..x1 as i32 {
                let on_line = y0 + (y1 - y0) * (f64::from(x) - x0) / (x1 - x0);
                assert!((on_line - curve(f64::from(x)).1).abs() < 0.25, "{x}");
            }
        }
    }
}
