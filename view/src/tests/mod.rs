//! The view as a whole: from updates and keys to cells and calls.

mod actions;
mod screens;
mod server;
mod terminal;

use std::time::Duration;

use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::buffer::{Buffer, Cell};
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use serde_json::{Value, json};

use crate::app::{App, Effect};
use crate::client::{Ask, Live, News};
use crate::draw;

/// A view, and the number of its newest request to follow.
struct View {
    app: App,
    number: u64,
    /// Time since the start of the view.
    now: Duration,
    effects: Vec<Effect>,
}

impl View {
    /// A view of a bench in this state, whose first drive is followed and whose kind is described.
    fn of(bench: Value) -> Self {
        let mut view = Self::connecting();
        view.live(Live::Open);
        view.live(Live::Update(json!({ "state": bench })));
        view
    }

    fn connecting() -> Self {
        Self::connecting_to("http://127.0.0.1:8080")
    }

    fn connecting_to(address: &str) -> Self {
        let mut view = Self {
            app: App::new(&address.parse().unwrap(), false),
            number: 0,
            now: Duration::ZERO,
            effects: Vec::new(),
        };
        let start = view.app.start();
        view.take(vec![start]);
        view
    }

    /// Keeps effects, except the numbers of requests to follow, which are checked.
    fn take(&mut self, effects: Vec<Effect>) {
        for effect in &effects {
            if let Effect::Ask(Ask::Follow { number, .. }) = effect {
                assert_eq!(*number, self.number + 1);
                self.number = *number;
            }
        }
        self.effects.extend(effects);
    }

    fn live(&mut self, live: Live) {
        let news = News::Live { number: self.number, live };
        self.hear(news);
    }

    fn hear(&mut self, news: News) {
        let effects = self.app.hear(news, self.now);
        self.take(effects);
    }

    fn update(&mut self, update: Value) {
        self.live(Live::Update(update));
    }

    /// Follows as the server does: a whole state with this drive.
    fn whole(&mut self, state: Value) {
        self.live(Live::Open);
        self.update(json!({ "state": state }));
    }

    fn describe(&mut self, kind: &str, description: Value) {
        self.hear(News::Kind { kind: kind.into(), description: Some(description) });
    }

    fn press(&mut self, code: KeyCode) {
        let effects = self.app.key(KeyEvent::new(code, KeyModifiers::NONE), self.now);
        self.take(effects);
    }

    fn keys(&mut self, keys: &str) {
        keys.chars().for_each(|c| self.press(KeyCode::Char(c)));
    }

    /// Lets time pass, and does what is due.
    fn wait(&mut self, ms: u64) {
        self.now += Duration::from_millis(ms);
        let effects = self.app.tick(self.now);
        self.take(effects);
    }

    /// Requests of the view since the last call.
    fn wanted(&mut self) -> Vec<Effect> {
        std::mem::take(&mut self.effects)
    }

    fn buffer(&self, width: u16, height: u16) -> Buffer {
        self.buffer_in(width, height, true)
    }

    fn buffer_in(&self, width: u16, height: u16, has_colours: bool) -> Buffer {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal.draw(|frame| draw::draw(frame, &self.app, self.now, has_colours)).unwrap();
        terminal.backend().buffer().clone()
    }

    fn screen(&self, width: u16, height: u16) -> String {
        text(&self.buffer(width, height))
    }

    #[track_caller]
    fn shows(&self, width: u16, height: u16, words: &[&str]) {
        let screen = self.screen(width, height);
        for word in words {
            assert!(screen.contains(word), "no '{word}' in\n{screen}");
        }
    }
}

/// The cells of a screen as lines. The second cell of a wide character is left out.
fn text(buffer: &Buffer) -> String {
    let mut text = String::new();
    for y in 0..buffer.area.height {
        let mut skipped = 0;
        for x in 0..buffer.area.width {
            if skipped > 0 {
                skipped -= 1;
                continue;
            }
            let symbol = buffer[(x, y)].symbol();
            skipped = ratatui::text::Span::raw(symbol).width().saturating_sub(1);
            text.push_str(symbol);
        }
        text.truncate(text.trim_end_matches(' ').len());
        text.push('\n');
    }
    text
}

/// The cell where a text begins on a screen of single-width characters.
#[track_caller]
fn cell_of(buffer: &Buffer, word: &str) -> Cell {
    let lines = text(buffer);
    for (y, line) in lines.lines().enumerate() {
        if let Some(place) = line.find(word) {
            let x = line[..place].chars().count();
            return buffer[(x as u16, y as u16)].clone();
        }
    }
    panic!("no '{word}' in\n{lines}");
}

/// State of a bench of three drives as the contract of `GET /api/live` says, with all of `x`.
fn bench() -> Value {
    json!({
        "time": {"mode": "real", "seconds": 83.25},
        "version": "0.1.0",
        "drives": {
            "x": {"index": 0, "kind": "md3", "powered": true, "moving": true, "lit": "D6", "position": 12345, "speed": 5000.0},
            "Lüfter": {"index": 1, "kind": "mdrobot", "powered": false, "moving": false, "position": 0, "speed": 0.0},
            "東京": {"index": 2, "kind": "qsb-d", "powered": true, "fault": true},
        },
        "motors": {"m": {"drive": "x", "revolutions": 7.5, "rpm": 187.5, "stalled": false, "current": 1.0}},
        "buses": {
            "rs485": {"line": "9600 8E1", "drives": ["x"], "listen": ["tcp:127.0.0.1:5020", "pty:/dev/pts/4"],
                "faults": {"drop": 0.01, "corrupt": 0.0, "mute": false, "delay_ms": 0.0, "exception": 0.0, "exception_code": 4, "baud": null},
                "strict": false, "early_requests": 3},
            "usb": {"line": "230400 8N1", "drives": ["東京"], "listen": [], "faults": {}, "strict": true, "early_requests": 0},
        },
        "wires": [{"from": "x.J3.7", "to": "東京.DIO0"}],
        "drive": {
            "name": "x", "kind": "md3", "powered": true,
            "registers": {"Speed": 8000, "MoveSteps": -10000, "MotionControl": 1},
            "pins": {"J2.2": "high", "J2.10": "low", "J3.7": "open"},
            "leds": {"D5": false, "D6": true},
            "motion": {"position": 12345, "speed": 5000.0, "moving": true, "current": 1.0, "duty": 0.0},
            "faults": {"over_temperature": false, "over_current": false},
            "ports": {"rs485": {"line": "9600 8E1", "requests": 1234, "refused": 2, "dropped": 0}},
        },
    })
}

/// The description of a kind, as `drivetwin describe md3 --json` prints it, in part.
fn md3() -> Value {
    json!({
        "kind": "md3", "product": "US Digital MD3 stepper drive, 7 A",
        "pins": [
            {"name": "J2.2", "role": "input", "rest": "high"},
            {"name": "J2.10", "role": "input or output", "rest": "low"},
            {"name": "J3.7", "role": "output", "rest": "open"},
            {"name": "D5", "role": "LED", "rest": "low"},
            {"name": "D6", "role": "LED", "rest": "low"},
        ],
        "faults": ["over_temperature", "over_current"],
        "registers": [
            {"name": "MotionControl", "section": "7.15", "address": 17, "addresses": 1, "access": "R/W", "least": 0,
                "greatest": 65535, "default": 0, "doc": "Fault (15), Disable (5), Move (0).",
                "fields": [{"bits": "0", "name": "Move", "values": {"1": "begin"}}]},
            {"name": "MoveSteps", "section": "7.16", "address": 18, "addresses": 2, "access": "R/W",
                "least": -2147483648_i64, "greatest": 2147483647, "default": 10000, "doc": "Steps of a move."},
            {"name": "Speed", "section": "7.17", "address": 20, "addresses": 2, "access": "R/W", "least": 1,
                "greatest": 40000, "default": 5000, "doc": "Greatest speed in steps/s."},
        ],
    })
}

/// A view of [`bench`], whose drive `x` is followed.
fn view() -> View {
    let mut state = bench();
    let drive = state["drive"].take();
    let mut view = View::of(state);
    let mut state = bench();
    state["drive"] = drive;
    view.whole(state);
    view.describe("md3", md3());
    view.wanted();
    view
}

/// A frame of the contract.
fn frame(number: u64, at: f64, text: &str, verdict: &str, outcome: &str) -> Value {
    json!({"number": number, "at": at, "drive": "x", "port": "rs485", "text": text, "outcome": outcome,
        "verdict": verdict, "reason": null, "bytes": "010600141F40C1C6", "answer": "010600141F40C1C6"})
}
