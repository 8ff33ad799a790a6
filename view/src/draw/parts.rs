//! Parts that several panes have: frames, rows, numbers.

use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, BorderType};

use super::style;
use crate::app::{App, Mode, Purpose};
use crate::keys::Pane;

/// Draws the frame of a pane with its title, and returns the area inside.
pub(super) fn pane(frame: &mut Frame, area: Rect, app: &App, pane: Pane, title: &str) -> Rect {
    let has_focus = app.focus == pane;
    let style = if has_focus { style::FOCUS } else { style::PLAIN };
    let mut spans = vec![Span::styled(format!(" {} {} ", pane.digit(), pane.name()), style)];
    if !title.is_empty() {
        spans.push(Span::raw(format!("{title} ")));
    }
    let typed = matches!(&app.mode, Mode::Entry { purpose: Purpose::Filter(of), .. } if *of == pane);
    if typed || !app.filter(pane).is_empty() {
        spans.push(Span::styled(format!("/{} ", app.filter(pane)), style::INFO));
    }
    let kind = if has_focus { BorderType::Thick } else { BorderType::Plain };
    let border = if has_focus { style::FOCUS } else { style::MUTED };
    let block = Block::bordered().border_type(kind).border_style(border).title(Line::from(spans));
    let inside = block.inner(area);
    frame.render_widget(block, area);
    inside
}

/// Which of many rows are visible.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Part {
    /// From this row on.
    From(usize),
    /// Those around the chosen one, which is reversed while the pane has the focus, else bold.
    Around(usize, bool),
    /// The last ones.
    Last,
}

/// Draws rows; only what is visible is made.
pub(super) fn rows<'a>(
    frame: &mut Frame,
    area: Rect,
    widths: &[Constraint],
    count: usize,
    part: Part,
    mut row: impl FnMut(usize) -> Vec<Line<'a>>,
) {
    let height = usize::from(area.height);
    let most = count.saturating_sub(height);
    let first = match part {
        Part::From(first) => first.min(most),
        Part::Around(chosen, _) => chosen.saturating_sub(height / 2).min(most),
        Part::Last => most,
    };
    for (line, index) in (first..count).take(height).enumerate() {
        let line = Rect { y: area.y + line as u16, height: 1, ..area };
        let columns = Layout::horizontal(widths).spacing(1).split(line);
        for (cell, column) in row(index).into_iter().zip(columns.iter()) {
            frame.render_widget(fit(cell, usize::from(column.width)), *column);
        }
        if let Part::Around(chosen, has_focus) = part
            && chosen == index
        {
            frame.buffer_mut().set_style(line, if has_focus { style::CHOSEN } else { style::TITLE });
        }
    }
}

/// A line that is not wider than this; an ellipsis is at the end of a cut one.
pub(super) fn fit(line: Line<'_>, width: usize) -> Line<'_> {
    if width == 0 {
        return Line::default();
    }
    if line.width() <= width {
        return line;
    }
    let mut left = width.saturating_sub(1);
    let mut spans = Vec::new();
    for span in line.spans {
        let mut text = String::new();
        let mut is_cut = false;
        for c in span.content.chars() {
            let wide = Span::raw(c.to_string()).width();
            if wide > left {
                is_cut = true;
                break;
            }
            left -= wide;
            text.push(c);
        }
        spans.push(Span::styled(text, span.style));
        if is_cut {
            break;
        }
    }
    spans.push(Span::raw("…"));
    Line { spans, ..line }
}

impl Part {
    /// The rows of a pane around the chosen one; without one, the last ones.
    pub(super) fn around_or_last(app: &App, pane: Pane, chosen: Option<usize>) -> Self {
        chosen.map_or(Self::Last, |chosen| Self::Around(chosen, app.focus == pane))
    }

    /// The rows of a pane around the chosen one; without one, the first ones.
    pub(super) fn around_or_first(app: &App, pane: Pane, chosen: Option<usize>) -> Self {
        chosen.map_or(Self::From(0), |chosen| Self::Around(chosen, app.focus == pane))
    }
}

/// The greatest width of some texts, at most a limit, for a column of them.
pub(super) fn widest<'a>(texts: impl Iterator<Item = &'a str>, limit: u16) -> u16 {
    let width = texts.map(|text| Span::raw(text).width()).max().unwrap_or(0);
    u16::try_from(width).unwrap_or(limit).min(limit)
}

/// Words of a text in lines of this width, at most so many.
pub(super) fn wrapped(text: &str, width: usize, most: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if Span::raw(line.as_str()).width() + 1 + Span::raw(word).width() <= width => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    if lines.len() > most {
        lines.truncate(most);
        if let Some(last) = lines.last_mut() {
            last.push_str(" …");
        }
    }
    lines
}

/// A number with a comma between each three digits, and so many digits behind its point.
pub(super) fn number(value: f64, decimals: usize) -> String {
    let text = format!("{:.decimals$}", value.abs());
    let (whole, rest) = text.split_at(text.find('.').unwrap_or(text.len()));
    let is_zero = text.chars().all(|c| "0.".contains(c));
    let sign = if value < 0.0 && !is_zero { "−" } else { "" };
    let mut grouped = String::new();
    for (index, digit) in whole.chars().enumerate() {
        if index > 0 && (whole.len() - index).is_multiple_of(3) && digit.is_ascii_digit() {
            grouped.push(',');
        }
        grouped.push(digit);
    }
    format!("{sign}{grouped}{rest}")
}

/// A time: seconds with three decimals, from a minute on with minutes and hours before them.
pub(super) fn time(seconds: f64) -> String {
    let ms = (seconds.max(0.0) * 1_000.0) as u64;
    let (s, minutes, hours) = ((ms % 60_000) as f64 / 1_000.0, ms / 60_000 % 60, ms / 3_600_000);
    match (hours, minutes) {
        (0, 0) => format!("{s:.3} s"),
        (0, _) => format!("{minutes}:{s:06.3}"),
        _ => format!("{hours}:{minutes:02}:{s:06.3}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_for_people() {
        assert_eq!(number(0.0, 0), "0");
        assert_eq!(number(-999.0, 0), "−999");
        assert_eq!(number(1_000.0, 0), "1,000");
        assert_eq!(number(-12_345_678.25, 1), "−12,345,678.2");
        assert_eq!(number(-0.01, 1), "0.0");
        assert_eq!(number(f64::NAN, 0), "NaN");
    }

    #[test]
    fn times_for_people() {
        assert_eq!(time(0.0), "0.000 s");
        assert_eq!(time(59.9999), "59.999 s");
        assert_eq!(time(83.25), "1:23.250");
        assert_eq!(time(3_600.0), "1:00:00.000");
        assert_eq!(time(-1.0), "0.000 s");
    }

    #[test]
    fn a_cut_line_says_so() {
        let text = |width| fit(Line::from("Prüfstand 東京"), width).to_string();
        assert_eq!(text(14), "Prüfstand 東京");
        assert_eq!(text(13), "Prüfstand 東…");
        assert_eq!(text(12), "Prüfstand …");
        assert_eq!((text(1), text(0)), ("…".to_owned(), String::new()));
        let two = Line::from(vec![Span::raw("abc"), Span::styled("def", style::BAD)]);
        assert_eq!(fit(two, 5).to_string(), "abcd…");
    }

    #[test]
    fn words_are_wrapped() {
        assert_eq!(wrapped("one two three", 7, 5), ["one two", "three"]);
        assert_eq!(wrapped("one two three four", 7, 2), ["one two", "three …"]);
        assert!(wrapped("", 7, 2).is_empty());
    }
}
