//! The registers of the chosen drive.

use std::time::Duration;

use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::text::{Line, Span};
use serde_json::Value;

use super::parts::{self, Part};
use super::style;
use crate::app::{App, value_text};
use crate::bench::Register;
use crate::keys::Pane;

/// Rows for the meaning of the chosen register.
const DETAIL: u16 = 4;

/// Columns for the access: `R/W`.
const ACCESS: u16 = 3;

/// Least number of columns for the text of a register beside it.
const LEAST_DOC: u16 = 16;

pub(super) fn draw(frame: &mut Frame, area: Rect, app: &App, now: Duration) {
    let registers = app.registers();
    let inside = parts::pane(frame, area, app, Pane::Registers, &format!("{}", registers.len()));
    let detail = if inside.height > 3 * DETAIL { DETAIL } else { DETAIL.min(inside.height / 3) };
    let [list, below] = Layout::vertical([Constraint::Min(1), Constraint::Length(detail)]).areas(inside);
    let chosen = app.row(Pane::Registers, registers.len());
    let value = |register: &Register| {
        if app.is_hexadecimal { hexadecimal(register) } else { value_text(register.value) }
    };
    let values: Vec<String> = registers.iter().map(value).collect();
    let name = parts::widest(registers.iter().map(|register| register.name), list.width / 2);
    let number = parts::widest(values.iter().map(String::as_str), list.width / 3);
    let left = list.width.saturating_sub(name + number + ACCESS + 3);
    let doc = if left < LEAST_DOC { 0 } else { left };
    let widths = [name, number, ACCESS, doc].map(Constraint::Length);
    let part = Part::around_or_first(app, Pane::Registers, chosen);
    parts::rows(frame, list, &widths, registers.len(), part, |row| {
        let register = &registers[row];
        let style = if app.bench.is_lit(register.name, now) { style::LIT } else { style::PLAIN };
        let of = |member: &str| register.row[member].as_str().unwrap_or_default();
        vec![
            Line::styled(register.name, style),
            Line::styled(values[row].as_str(), style).right_aligned(),
            Line::styled(of("access"), style::MUTED),
            Line::styled(of("doc"), style::MUTED),
        ]
    });
    if let Some(register) = chosen.map(|row| &registers[row]) {
        draw_detail(frame, below, register);
    }
}

/// The meaning of a register: section, range, bits, and text.
fn draw_detail(frame: &mut Frame, area: Rect, register: &Register) {
    let width = usize::from(area.width);
    let mut lines = vec![Line::from(facts(register))];
    lines.extend(fields(register).map(|fields| Line::styled(fields, style::INFO)));
    let doc = register.row["doc"].as_str().unwrap_or_default();
    let left = usize::from(area.height).saturating_sub(1);
    let text = parts::wrapped(doc, width, 2.min(left));
    let fields = left.saturating_sub(text.len());
    let all = lines.into_iter().take(1 + fields).chain(text.into_iter().map(Line::from));
    for (row, line) in (area.y..area.bottom()).zip(all) {
        frame.render_widget(parts::fit(line, width), Rect { y: row, height: 1, ..area });
    }
}

/// Section, address, access, range and default.
fn facts(register: &Register) -> Vec<Span<'static>> {
    let row = register.row;
    let mut spans = vec![Span::styled(register.name.to_owned(), style::TITLE)];
    let mut add = |text: String| spans.push(Span::styled(text, style::MUTED));
    if let Some(section) = row["section"].as_str() {
        let sign = if section.starts_with(|c: char| c.is_ascii_digit()) { "§" } else { "" };
        add(format!("  {sign}{section}"));
    }
    // A variable or a setting is reached by its name only.
    let has_address = !["variable", "setting"].contains(&row["space"].as_str().unwrap_or_default());
    if let Some(address) = row["address"].as_u64().filter(|_| has_address) {
        add(format!("  {address:#06x}"));
    }
    if let Some(access) = row["access"].as_str() {
        add(format!("  {access}"));
    }
    if let (Some(least), Some(greatest)) = (row["least"].as_i64(), row["greatest"].as_i64()) {
        add(format!("  {least} to {greatest}"));
    }
    if let Some(codes) = row["codes"].as_array() {
        add(format!("  one of {}", value_text(&Value::Array(codes.clone()))));
    }
    if !row["default"].is_null() {
        add(format!("  default {}", value_text(&row["default"])));
    }
    spans
}

/// The fields of a register with their values now, as many as stand in a line, in one text.
fn fields(register: &Register) -> Option<String> {
    let value = register.value.as_i64()?;
    let fields = register.row["fields"].as_array().filter(|fields| !fields.is_empty())?;
    let words: Vec<String> = fields.iter().filter_map(|field| field_text(field, value)).collect();
    Some(words.join(", "))
}

/// A field with its value now: `microstepping = 3 (1/8)`.
fn field_text(field: &Value, value: i64) -> Option<String> {
    let bits = field["bits"].as_str()?;
    let (high, low) = bits.split_once(':').unwrap_or((bits, bits));
    let (high, low): (u32, u32) = (high.parse().ok()?, low.parse().ok()?);
    let wide = high.checked_sub(low).filter(|_| high < 32)? + 1;
    let part = value >> low & ((1_i64 << wide) - 1);
    let name = field["name"].as_str().unwrap_or_default();
    let name = if name.is_empty() { bits } else { name };
    let meaning = field["values"][part.to_string()].as_str();
    Some(match meaning {
        Some(meaning) => format!("{name} = {part} ({meaning})"),
        None => format!("{name} = {part}"),
    })
}

fn hexadecimal(register: &Register) -> String {
    let digits = if register.row["addresses"] == 2 { 8 } else { 4 };
    let word = |value: &Value| match value.as_i64() {
        // A negative number as the bus has it.
        Some(number) if digits == 8 => format!("0x{:08X}", number as u32),
        Some(number) => format!("0x{:04X}", number as u16),
        None => value.to_string(),
    };
    match register.value {
        Value::Array(words) => words.iter().map(word).collect::<Vec<_>>().join(", "),
        value => word(value),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn fields_have_their_values_and_names() {
        let row = json!({"fields": [
            {"bits": "13", "name": "motor mode", "values": {"0": "step", "1": "PWM"}},
            {"bits": "12:8", "name": "microstepping", "values": {"3": "1/8"}},
            {"bits": "7:0", "name": "", "values": {}},
            {"bits": "no bits"}, {"bits": "1:9"}, {"bits": "99"},
        ]});
        let register = Register { name: "a", value: &json!(778), row: &row };
        let text = fields(&register);
        assert_eq!(text.as_deref(), Some("motor mode = 0 (step), microstepping = 3 (1/8), 7:0 = 10"));
    }

    #[test]
    fn a_register_without_an_address_shows_none() {
        let facts = |space: &str| {
            let row = json!({"section": "7.8", "space": space, "address": 0, "access": "R/W"});
            Line::from(facts(&Register { name: "a", value: &json!(1), row: &row })).to_string()
        };
        assert_eq!(facts("holding"), "a  §7.8  0x0000  R/W");
        assert_eq!((facts("setting"), facts("variable")), ("a  §7.8  R/W".into(), "a  §7.8  R/W".into()));
    }

    #[test]
    fn hexadecimal_values() {
        let hex = |value: Value, addresses: u16| {
            hexadecimal(&Register { name: "a", value: &value, row: &json!({ "addresses": addresses }) })
        };
        assert_eq!(hex(json!(8000), 1), "0x1F40");
        assert_eq!(hex(json!(-1), 1), "0xFFFF");
        assert_eq!(hex(json!(-10_000), 2), "0xFFFFD8F0");
        assert_eq!(hex(json!([1, 65535]), 1), "0x0001, 0xFFFF");
    }
}
