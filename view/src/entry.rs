//! An input line, and the words that people type into it.

use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use serde_json::{Map, Value, json};

/// Maximum number of characters.
const LONGEST: usize = 400;

/// An input line with a cursor.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub(crate) struct Entry {
    before: String,
    after: String,
    /// True while the text is the old one, which the first character replaces.
    is_old: bool,
}

/// Meaning of a key for an input line.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Typed {
    /// The line may have changed.
    Changed,
    Done,
    Left,
}

impl Entry {
    /// A line with this text, and the cursor at its end.
    pub(crate) fn new(text: impl Into<String>) -> Self {
        Self { before: text.into(), ..Self::default() }
    }

    /// A line with an old text, which the first character replaces. Keys of the cursor keep it.
    pub(crate) fn over(old: impl Into<String>) -> Self {
        Self { is_old: true, ..Self::new(old) }
    }

    /// Returns whether the first character replaces the text.
    pub(crate) fn is_old(&self) -> bool {
        self.is_old
    }

    pub(crate) fn text(&self) -> String {
        format!("{}{}", self.before, self.after)
    }

    /// The text before and behind the cursor.
    pub(crate) fn parts(&self) -> (&str, &str) {
        (&self.before, &self.after)
    }

    /// Adds pasted text without its control characters.
    pub(crate) fn paste(&mut self, text: &str) {
        self.clear_old();
        let free = LONGEST.saturating_sub(self.text().chars().count());
        self.before.extend(text.chars().filter(|c| !c.is_control()).take(free));
    }

    fn clear_old(&mut self) -> bool {
        let was_old = std::mem::take(&mut self.is_old);
        if was_old {
            *self = Self::default();
        }
        was_old
    }

    pub(crate) fn key(&mut self, key: KeyEvent) -> Typed {
        if key.modifiers.intersects(KeyModifiers::CONTROL | KeyModifiers::ALT) {
            if key.code == KeyCode::Char('u') {
                self.before.clear();
            }
            return Typed::Changed;
        }
        match key.code {
            KeyCode::Enter => return Typed::Done,
            KeyCode::Esc => return Typed::Left,
            KeyCode::Char(c) => self.paste(c.encode_utf8(&mut [0; 4])),
            KeyCode::Backspace | KeyCode::Delete if self.clear_old() => {}
            KeyCode::Backspace => {
                self.before.pop();
            }
            KeyCode::Delete => self.after = self.after.chars().skip(1).collect(),
            KeyCode::Left => {
                if let Some(c) = self.before.pop() {
                    self.after.insert(0, c);
                }
            }
            KeyCode::Right => {
                let mut rest = self.after.chars();
                self.before.extend(rest.next());
                self.after = rest.collect();
            }
            KeyCode::Home => *self = Self { after: self.text(), ..Self::default() },
            KeyCode::End => *self = Self::new(self.text()),
            _ => {}
        }
        self.is_old = false;
        Typed::Changed
    }
}

/// A value of a register: a number, or numbers with commas between them.
///
/// # Errors
/// One sentence that names the word that is not a number.
pub(crate) fn register_value(text: &str) -> Result<Value, String> {
    let words: Vec<&str> = text.split(',').map(str::trim).collect();
    let numbers = words.iter().map(|word| whole_number(word)).collect::<Result<Vec<_>, _>>()?;
    Ok(if let [number] = numbers[..] { json!(number) } else { json!(numbers) })
}

fn whole_number(word: &str) -> Result<i64, String> {
    let number = match word.get(..2) {
        Some("0x" | "0X") => i64::from_str_radix(&word[2..], 16).ok(),
        Some("0b" | "0B") => i64::from_str_radix(&word[2..], 2).ok(),
        _ => word.parse().ok(),
    };
    number.ok_or_else(|| format!("'{word}' is not a number; 8000, -5 and 0x1F40 are"))
}

/// A number with a point, in these limits.
///
/// # Errors
/// One sentence.
pub(crate) fn seconds(text: &str) -> Result<f64, String> {
    let seconds = text.trim().parse().ok().filter(|seconds| (0.0..=86_400.0).contains(seconds));
    seconds.ok_or_else(|| format!("'{text}' is not a number of seconds, 0 to 86400"))
}

/// A voltage or a current of an analogue input: `2.5 V`, `12 mA`.
///
/// # Errors
/// One sentence.
pub(crate) fn analogue(text: &str) -> Result<Value, String> {
    let text = text.trim();
    let lower = text.to_lowercase();
    let (member, number) = match (lower.strip_suffix("ma"), lower.strip_suffix('v')) {
        (Some(number), _) => ("milliamps", number),
        (None, Some(number)) => ("volts", number),
        (None, None) => ("volts", lower.as_str()),
    };
    match number.trim().parse::<f64>() {
        Ok(number) if number.is_finite() => Ok(json!({ member: number })),
        _ => Err(format!("'{text}' is not a voltage or a current; 2.5 V and 12 mA are")),
    }
}

/// Two numbers: a count and its rate in Hz.
///
/// # Errors
/// One sentence.
pub(crate) fn count_and_rate(text: &str, count: &str) -> Result<Value, String> {
    let wrong = || format!("'{text}' is not two numbers, {count} and their number per second; 400 10000 is");
    let words: Vec<&str> = text.split_whitespace().collect();
    let [number, hz] = words[..] else { return Err(wrong()) };
    let number: i64 = number.parse().map_err(|_| wrong())?;
    let hz: f64 = hz.parse().ok().filter(|hz: &f64| hz.is_finite()).ok_or_else(wrong)?;
    Ok(json!({ count: number, "hz": hz }))
}

/// Faults of a line: words like `drop=0.01` or `mute=true`.
///
/// # Errors
/// One sentence that names the word that is wrong.
pub(crate) fn line_faults(text: &str) -> Result<Value, String> {
    let mut faults = Map::new();
    for word in text.split_whitespace() {
        let fault = word.split_once('=').and_then(|(name, value)| {
            serde_json::from_str::<Value>(value).ok().map(|value| (name.to_owned(), value))
        });
        let (name, value) =
            fault.ok_or_else(|| format!("'{word}' is not a fault; drop=0.01 and mute=true are"))?;
        faults.insert(name, value);
    }
    Ok(Value::Object(faults))
}

/// The faults of a line that are on, as [`line_faults`] reads them.
pub(crate) fn line_faults_text(faults: &Value) -> String {
    let is_off = |value: &Value| value.is_null() || value == &json!(false) || value.as_f64() == Some(0.0);
    // The code means nothing without its fault.
    let rests = |name: &str, value: &Value| {
        is_off(value) || (name == "exception_code" && is_off(&faults["exception"]))
    };
    let faults = faults.as_object().into_iter().flatten().filter(|(name, value)| !rests(name, value));
    faults.map(|(name, value)| format!("{name}={value}")).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn press(entry: &mut Entry, code: KeyCode) -> Typed {
        entry.key(KeyEvent::new(code, KeyModifiers::NONE))
    }

    #[test]
    fn a_line_is_edited_at_its_cursor() {
        let mut entry = Entry::new("aü");
        for code in [KeyCode::Left, KeyCode::Left, KeyCode::Char('ß'), KeyCode::Delete, KeyCode::End] {
            assert_eq!(press(&mut entry, code), Typed::Changed);
        }
        assert_eq!(entry.parts(), ("ßü", ""));
        press(&mut entry, KeyCode::Home);
        press(&mut entry, KeyCode::Right);
        assert_eq!(entry.parts(), ("ß", "ü"));
        press(&mut entry, KeyCode::Backspace);
        press(&mut entry, KeyCode::Backspace);
        entry.paste("a\x1b[2Jb\n");
        assert_eq!(entry.parts(), ("a[2Jb", "ü"));
        assert_eq!(
            (press(&mut entry, KeyCode::Enter), press(&mut entry, KeyCode::Esc)),
            (Typed::Done, Typed::Left)
        );
        entry.key(KeyEvent::new(KeyCode::Char('u'), KeyModifiers::CONTROL));
        assert_eq!(entry.text(), "ü");
    }

    #[test]
    fn the_first_character_replaces_an_old_text() {
        let after = |codes: &[KeyCode]| {
            let mut entry = Entry::over("800");
            codes.iter().for_each(|code| assert_eq!(press(&mut entry, *code), Typed::Changed));
            entry.text()
        };
        assert_eq!(after(&[KeyCode::Char('1'), KeyCode::Char('2')]), "12");
        assert_eq!(after(&[KeyCode::End, KeyCode::Char('1')]), "8001");
        assert_eq!(after(&[KeyCode::Home, KeyCode::Char('1')]), "1800");
        assert_eq!(after(&[KeyCode::Left, KeyCode::Backspace]), "80");
        assert_eq!((after(&[KeyCode::Backspace]), after(&[KeyCode::Delete])), (String::new(), String::new()));
        let mut entry = Entry::over("800");
        entry.paste("0x1F");
        assert_eq!((entry.text().as_str(), press(&mut entry, KeyCode::Enter)), ("0x1F", Typed::Done));
        assert_eq!(press(&mut Entry::over("800"), KeyCode::Enter), Typed::Done);
    }

    #[test]
    fn a_line_has_an_end() {
        let mut entry = Entry::default();
        entry.paste(&"x".repeat(5_000));
        assert_eq!(entry.text().len(), 400);
    }

    #[test]
    fn values_of_registers() {
        assert_eq!(register_value("8000"), Ok(json!(8000)));
        assert_eq!(register_value(" -5 "), Ok(json!(-5)));
        assert_eq!(register_value("0x1F40"), Ok(json!(8000)));
        assert_eq!(register_value("0b101"), Ok(json!(5)));
        assert_eq!(register_value("1, 0x10,3"), Ok(json!([1, 16, 3])));
        assert_eq!(register_value("fast"), Err("'fast' is not a number; 8000, -5 and 0x1F40 are".into()));
        for wrong in ["", "1,", "0x", "1.5", "99999999999999999999", "ü0"] {
            assert!(register_value(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn other_values() {
        assert_eq!((seconds("1.25"), seconds("0")), (Ok(1.25), Ok(0.0)));
        for wrong in ["-1", "86401", "inf", "NaN", ""] {
            assert!(seconds(wrong).is_err(), "{wrong}");
        }
        assert_eq!(analogue("2.5"), Ok(json!({"volts": 2.5})));
        assert_eq!(analogue("2.5 V"), Ok(json!({"volts": 2.5})));
        assert_eq!(analogue("12mA"), Ok(json!({"milliamps": 12.0})));
        assert!(analogue("a lot").is_err() && analogue("inf").is_err());
        assert_eq!(count_and_rate("-400 1e4", "counts"), Ok(json!({"counts": -400, "hz": 10000.0})));
        assert!(count_and_rate("400", "counts").is_err() && count_and_rate("4 5 6", "counts").is_err());
    }

    #[test]
    fn faults_of_a_line_as_words() {
        let faults = json!({"drop": 0.01, "mute": false, "delay_ms": 0.0, "exception_code": 4, "baud": null,
            "corrupt": {"count": 2, "direction": "reply"}});
        let text = line_faults_text(&faults);
        assert_eq!(text, "corrupt={\"count\":2,\"direction\":\"reply\"} drop=0.01");
        let read = line_faults(&text).unwrap();
        assert_eq!(read, json!({"drop": 0.01, "corrupt": {"count": 2, "direction": "reply"}}));
        assert_eq!(line_faults(" "), Ok(json!({})));
        assert_eq!(line_faults("drop"), Err("'drop' is not a fault; drop=0.01 and mute=true are".into()));
    }
}
