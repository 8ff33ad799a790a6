//! Keys and their actions, in one table from which the help is made, too.

use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};

/// A part of the screen.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(crate) enum Pane {
    Drives,
    Plot,
    Registers,
    Pins,
    Faults,
    Traffic,
    Bench,
    Log,
}

impl Pane {
    /// All panes, in the order of Tab and of the keys 0 to 7.
    pub(crate) const ALL: [Self; 8] = [
        Self::Drives,
        Self::Plot,
        Self::Registers,
        Self::Pins,
        Self::Faults,
        Self::Traffic,
        Self::Bench,
        Self::Log,
    ];

    /// The name in the title of the pane.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Drives => "drives",
            Self::Plot => "plot",
            Self::Registers => "registers",
            Self::Pins => "pins",
            Self::Faults => "faults",
            Self::Traffic => "traffic",
            Self::Bench => "bench",
            Self::Log => "log",
        }
    }

    /// The key that goes to the pane.
    pub(crate) fn digit(self) -> char {
        char::from(b'0' + self as u8)
    }
}

/// Action of a key.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Action {
    Quit,
    Help,
    Redraw,
    Next,
    Previous,
    Up,
    Down,
    PageUp,
    PageDown,
    First,
    Last,
    Filter,
    Leave,
    PreviousDrive,
    NextDrive,
    Power,
    Time,
    Advance,
    NextEvent,
    Edit,
    Hexadecimal,
    Drive(&'static str),
    Press,
    Analogue,
    Pulses,
    Encoder,
    Cause,
    LineFaults,
    Errors,
    Pause,
    ZoomIn,
    ZoomOut,
    Earlier,
    Later,
}

/// A row of the table: keys, the pane that has the focus (`None`: any), the action, and its help.
pub(crate) struct Row {
    pub(crate) keys: &'static [KeyCode],
    pub(crate) pane: Option<Pane>,
    pub(crate) action: Action,
    /// The keys as the help shows them.
    pub(crate) label: &'static str,
    pub(crate) help: &'static str,
}

const fn row(
    pane: Option<Pane>,
    keys: &'static [KeyCode],
    action: Action,
    label: &'static str,
    help: &'static str,
) -> Row {
    Row { keys, pane, action, label, help }
}

use KeyCode::Char;

/// All keys. A row for a pane comes before one for any.
pub(crate) const TABLE: &[Row] = &[
    row(Some(Pane::Plot), &[Char('p'), Char(' ')], Action::Pause, "p", "pause, and go on with now"),
    row(Some(Pane::Plot), &[Char('+'), Char('=')], Action::ZoomIn, "+", "show less time"),
    row(Some(Pane::Plot), &[Char('-')], Action::ZoomOut, "-", "show more time"),
    row(Some(Pane::Plot), &[KeyCode::Left, Char('h')], Action::Earlier, "Left", "earlier; pauses"),
    row(Some(Pane::Plot), &[KeyCode::Right, Char('l')], Action::Later, "Right", "later"),
    row(Some(Pane::Registers), &[KeyCode::Enter, Char('e')], Action::Edit, "Enter", "edit the register"),
    row(Some(Pane::Registers), &[Char('x')], Action::Hexadecimal, "x", "hexadecimal, decimal"),
    row(Some(Pane::Pins), &[Char(' '), KeyCode::Enter], Action::Press, "Space", "press: low, or open again"),
    row(Some(Pane::Pins), &[Char('l')], Action::Drive("low"), "l", "low"),
    row(Some(Pane::Pins), &[Char('h')], Action::Drive("high"), "h", "high"),
    row(Some(Pane::Pins), &[Char('o')], Action::Drive("open"), "o", "open: not driven"),
    row(Some(Pane::Pins), &[Char('v')], Action::Analogue, "v", "voltage or current of an analogue input"),
    row(Some(Pane::Pins), &[Char('u')], Action::Pulses, "u", "pulses into the pin"),
    row(Some(Pane::Pins), &[Char('w')], Action::Encoder, "w", "turn the encoder"),
    row(Some(Pane::Faults), &[Char(' '), KeyCode::Enter], Action::Cause, "Space", "set or remove the cause"),
    row(Some(Pane::Traffic), &[Char('!')], Action::Errors, "!", "only what was not done, or all"),
    row(Some(Pane::Bench), &[KeyCode::Enter, Char('f')], Action::LineFaults, "Enter", "faults of the line"),
    row(None, &[KeyCode::Tab], Action::Next, "Tab", "next pane; 0 to 7: a pane"),
    row(None, &[KeyCode::BackTab], Action::Previous, "Shift-Tab", "previous pane"),
    row(None, &[KeyCode::Up, Char('k')], Action::Up, "Up", "up"),
    row(None, &[KeyCode::Down, Char('j')], Action::Down, "Down", "down"),
    row(None, &[KeyCode::PageUp], Action::PageUp, "PageUp", "a page up"),
    row(None, &[KeyCode::PageDown], Action::PageDown, "PageDown", "a page down"),
    row(None, &[KeyCode::Home, Char('g')], Action::First, "Home", "the first"),
    row(None, &[KeyCode::End, Char('G')], Action::Last, "End", "the last"),
    row(None, &[Char('/')], Action::Filter, "/", "search in drives, registers, traffic and log"),
    row(None, &[KeyCode::Esc], Action::Leave, "Esc", "leave a search or an input"),
    row(None, &[Char('[')], Action::PreviousDrive, "[", "previous drive"),
    row(None, &[Char(']')], Action::NextDrive, "]", "next drive"),
    row(None, &[Char('P')], Action::Power, "P", "power: off, on, cycle, cut"),
    row(None, &[Char('t')], Action::Time, "t", "time: real, faster, manual"),
    row(None, &[Char('a')], Action::Advance, "a", "advance manual time"),
    row(None, &[Char('n')], Action::NextEvent, "n", "advance to the next event"),
    row(None, &[Char('?'), KeyCode::F(1)], Action::Help, "?", "this help"),
    row(None, &[], Action::Redraw, "Ctrl-L", "draw the screen anew"),
    row(None, &[Char('q')], Action::Quit, "q", "end; so does Ctrl-C"),
];

/// The action of a key while a pane has the focus. Ctrl-C always ends the view, and Ctrl-L draws it anew.
pub(crate) fn action(key: KeyEvent, focus: Pane) -> Option<Action> {
    let held = key.modifiers & (KeyModifiers::CONTROL | KeyModifiers::ALT);
    if !held.is_empty() {
        return match key.code {
            Char('c') if held == KeyModifiers::CONTROL => Some(Action::Quit),
            Char('l') if held == KeyModifiers::CONTROL => Some(Action::Redraw),
            _ => None,
        };
    }
    let rows = TABLE.iter().filter(|row| row.pane.is_none_or(|pane| pane == focus));
    rows.filter(|row| row.keys.contains(&key.code)).map(|row| row.action).next()
}

/// The pane that a digit goes to.
pub(crate) fn pane(key: KeyEvent) -> Option<Pane> {
    Pane::ALL.into_iter().find(|pane| key.code == Char(pane.digit()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn press(code: KeyCode, focus: Pane) -> Option<Action> {
        action(KeyEvent::new(code, KeyModifiers::NONE), focus)
    }

    #[test]
    fn a_key_has_one_meaning_in_a_pane() {
        for (place, row) in TABLE.iter().enumerate() {
            for key in row.keys {
                let same = |other: &&Row| other.pane == row.pane && other.keys.contains(key);
                assert_eq!(TABLE[place..].iter().filter(same).count(), 1, "{key} in {:?}", row.pane);
            }
        }
    }

    #[test]
    fn a_pane_has_its_own_keys_first() {
        assert_eq!(press(Char('l'), Pane::Pins), Some(Action::Drive("low")));
        assert_eq!(press(Char('l'), Pane::Plot), Some(Action::Later));
        assert_eq!(press(Char('l'), Pane::Registers), None);
        assert_eq!(press(Char('j'), Pane::Pins), Some(Action::Down));
    }

    #[test]
    fn control_c_ends_and_other_held_keys_do_nothing() {
        let held = |code, modifiers| action(KeyEvent::new(code, modifiers), Pane::Pins);
        assert_eq!(held(Char('c'), KeyModifiers::CONTROL), Some(Action::Quit));
        assert_eq!(held(Char('l'), KeyModifiers::CONTROL), Some(Action::Redraw));
        assert_eq!(held(Char('h'), KeyModifiers::CONTROL), None);
        assert_eq!(held(Char('q'), KeyModifiers::ALT), None);
    }

    #[test]
    fn digits_are_panes() {
        let digit = |code| pane(KeyEvent::new(code, KeyModifiers::NONE));
        assert_eq!(digit(Char('0')), Some(Pane::Drives));
        assert_eq!(digit(Char('5')), Some(Pane::Traffic));
        assert_eq!(digit(Char('8')), None);
    }
}
