//! The plot of position and speed over time.

use std::collections::VecDeque;

use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Style};
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Axis, Chart, Dataset, GraphType};

use super::parts::{fit, number, time};
use super::{parts, style};
use crate::app::App;
use crate::bench::Sample;
use crate::keys::Pane;

/// Least height for two charts.
const TWO: u16 = 10;

pub(super) fn draw(frame: &mut Frame, area: Rect, app: &App) {
    let span = app.plot.span();
    let now = app.bench.seconds().unwrap_or(0.0);
    let edge = app.plot.paused.unwrap_or(now);
    let paused =
        if app.plot.paused.is_some() { format!(", paused at {}", time(edge)) } else { String::new() };
    let inside = parts::pane(frame, area, app, Pane::Plot, &format!("{span} s{paused}"));
    let samples = app.drive().and_then(|name| app.bench.motion(name)).filter(|samples| !samples.is_empty());
    let Some(samples) = samples else {
        let sentence = if app.bench.seconds().is_some() { "this drive has no motion" } else { "" };
        frame.render_widget(Line::styled(sentence, style::MUTED).centered(), inside);
        return;
    };
    let here = at(samples, edge);
    let count = if inside.height < TWO { 1 } else { 2 };
    let areas = Layout::vertical(vec![Constraint::Fill(1); count]).split(inside);
    let windows = CHARTS.map(|chart| {
        let window = decimated(samples, [edge - span, edge], chart.value, usize::from(inside.width) * 2);
        let bounds = bounds(&window, chart.has_zero);
        (window, bounds)
    });
    // Charts one below the other have the same time at the same column.
    let wide =
        windows.iter().flat_map(|(_, bounds)| labels(*bounds)).map(|label| label.chars().count()).max();
    for ((chart, (window, [low, high])), area) in CHARTS.into_iter().zip(&windows).zip(areas.iter()) {
        let [title, area] = Layout::vertical([Constraint::Length(1), Constraint::Min(1)]).areas(*area);
        let style = Style::new().fg(chart.colour);
        let mut figure = vec![Span::styled("━ ", style), Span::raw(chart.name), Span::raw(" ")];
        if let Some(here) = here {
            let value = number((chart.value)(&here), 0);
            figure.push(Span::styled(format!("{value}{}", chart.unit), style::TITLE));
        }
        frame.render_widget(fit(Line::from(figure), title.width.into()), title);
        let data =
            Dataset::default().marker(Marker::Braille).graph_type(GraphType::Line).style(style).data(window);
        let labels = labels([*low, *high]).map(|label| format!("{label:>0$}", wide.unwrap_or(0)));
        let ends = match app.plot.paused {
            Some(_) => [time(edge - span), time(edge)],
            None => [format!("−{span} s"), "now".into()],
        };
        let widget = Chart::new(vec![data])
            .x_axis(Axis::default().bounds([edge - span, edge]).labels(ends).style(style::MUTED))
            .y_axis(Axis::default().bounds([*low, *high]).labels(labels).style(style::MUTED))
            .legend_position(None);
        frame.render_widget(widget, area);
    }
}

/// A figure over time.
struct Figure {
    name: &'static str,
    unit: &'static str,
    colour: Color,
    value: fn(&Sample) -> f64,
    /// True if zero is always visible.
    has_zero: bool,
}

const CHARTS: [Figure; 2] = [
    Figure {
        name: "position",
        unit: "",
        colour: Color::Cyan,
        value: |sample| sample.position,
        has_zero: false,
    },
    Figure {
        name: "speed",
        unit: "/s",
        colour: Color::Magenta,
        value: |sample| sample.speed,
        has_zero: true,
    },
];

/// The lowest and the highest value of an axis.
fn labels([low, high]: [f64; 2]) -> [String; 2] {
    let digits = if high - low < 4.0 { 1 } else { 0 };
    [low, high].map(|value| number(value, digits))
}

/// The motion at a time: the last sample that is not later.
fn at(samples: &VecDeque<Sample>, at: f64) -> Option<Sample> {
    let after = samples.partition_point(|sample| sample.at <= at);
    after.checked_sub(1).map(|last| samples[last])
}

/// Points in a window of time, from the sample before it to the one behind it. Of the samples in each of `most` parts of
/// the window, only the lowest and the highest stay.
fn decimated(
    samples: &VecDeque<Sample>,
    [from, to]: [f64; 2],
    value: fn(&Sample) -> f64,
    most: usize,
) -> Vec<(f64, f64)> {
    let first = samples.partition_point(|sample| sample.at < from).saturating_sub(1);
    let end = (samples.partition_point(|sample| sample.at <= to) + 1).min(samples.len());
    let part = |at: f64| ((at - from) / (to - from) * most as f64).floor() as i64;
    let mut points: Vec<(f64, f64)> = Vec::new();
    let mut run: Vec<(f64, f64)> = Vec::new();
    for sample in samples.range(first.min(end)..end) {
        let point = (sample.at, value(sample));
        if run.first().is_some_and(|(at, _)| part(*at) != part(point.0)) {
            points.extend(ends(&run));
            run.clear();
        }
        run.push(point);
    }
    points.extend(ends(&run));
    // The first line begins at the left edge and the last one ends at the right edge.
    if let Some(last) = points.last().copied().filter(|(at, _)| *at < to) {
        points.push((to, last.1));
    }
    points
}

/// The lowest and the highest of some points, in the order of time.
fn ends(run: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let lowest = run.iter().min_by(|a, b| a.1.total_cmp(&b.1));
    let highest = run.iter().max_by(|a, b| a.1.total_cmp(&b.1));
    let mut ends: Vec<(f64, f64)> = lowest.into_iter().chain(highest).copied().collect();
    ends.sort_by(|a, b| a.0.total_cmp(&b.0));
    ends.dedup();
    ends
}

/// Bounds of the values of some points, never empty.
fn bounds(points: &[(f64, f64)], has_zero: bool) -> [f64; 2] {
    let zero = [0.0].into_iter().filter(|_| has_zero && !points.is_empty());
    let values = || points.iter().map(|(_, value)| *value).chain(zero.clone());
    let low = values().fold(f64::INFINITY, f64::min);
    let high = values().fold(f64::NEG_INFINITY, f64::max);
    if low > high {
        return [-1.0, 1.0];
    }
    match low == high {
        true if has_zero => [0.0, 1.0],
        true => [low - 1.0, high + 1.0],
        false => [low, high],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(count: u32) -> VecDeque<Sample> {
        let sample = |n| Sample { at: f64::from(n) / 10.0, position: f64::from(n), speed: 5.0 };
        (0..count).map(sample).collect()
    }

    #[test]
    fn a_window_has_its_lowest_and_highest_points() {
        let mut samples = ramp(1_000);
        samples[505].position = -7.0;
        let points = decimated(&samples, [50.0, 60.0], |sample| sample.position, 10);
        assert_eq!(points.first(), Some(&(49.9, 499.0)));
        assert_eq!(points.last(), Some(&(60.1, 601.0)));
        assert!(points.contains(&(50.5, -7.0)) && points.len() <= 24, "{points:?}");
        assert_eq!(bounds(&points, false), [-7.0, 601.0]);
    }

    #[test]
    fn the_last_value_reaches_the_edge() {
        let points = decimated(&ramp(11), [0.0, 5.0], |sample| sample.speed, 10);
        assert_eq!(points.last(), Some(&(5.0, 5.0)));
        assert_eq!(bounds(&points, false), [4.0, 6.0]);
        assert_eq!(bounds(&points, true), [0.0, 5.0]);
        assert!(decimated(&VecDeque::new(), [0.0, 5.0], |sample| sample.speed, 10).is_empty());
        assert_eq!(bounds(&[], true), [-1.0, 1.0]);
    }

    #[test]
    fn the_motion_at_a_time() {
        let samples = ramp(11);
        assert_eq!(at(&samples, 0.55).map(|sample| sample.position), Some(5.0));
        assert_eq!(at(&samples, 99.0).map(|sample| sample.position), Some(10.0));
        assert_eq!(at(&samples, -1.0), None);
    }
}
