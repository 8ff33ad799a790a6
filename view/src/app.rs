//! The view: what it shows and where, and what keys do to it.

use std::collections::VecDeque;
use std::time::Duration;

use hyper::Method;
use ratatui::crossterm::event::{KeyCode, KeyEvent};
use serde_json::{Value, json};

use crate::address::Address;
use crate::bench::{Bench, Link, Register};
use crate::client::{Ask, Call, News, segment};
use crate::draw::help_height;
use crate::entry::{self, Entry, Typed};
use crate::keys::{self, Action, Pane};

/// Wait after the last change of the chosen drive before it is followed, so that a walk through a long list does not
/// open a stream for each drive.
const SETTLING: Duration = Duration::from_millis(150);

/// Time for which the sentence of an error stays.
const MESSAGE: Duration = Duration::from_secs(10);

/// Maximum number of lines of the log that are kept.
const LOG_LINES: usize = 1_000;

/// Number of rows that a page has for the keys.
const PAGE: usize = 10;

/// Durations that the plot may show, in seconds.
const SPANS: [f64; 9] = [1.0, 2.0, 5.0, 10.0, 30.0, 60.0, 120.0, 300.0, 600.0];

/// Purpose of an input line.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) enum Purpose {
    Filter(Pane),
    Register(String),
    Analogue(String),
    Pulses(String),
    Encoder,
    LineFaults(String),
    Times,
    Advance,
}

/// A question with one key for each answer.
#[derive(Clone, PartialEq, Debug)]
pub(crate) struct Menu {
    pub(crate) title: String,
    /// Key, label and what it does.
    pub(crate) choices: Vec<(char, &'static str, Choice)>,
}

/// An answer of a menu.
#[derive(Clone, PartialEq, Debug)]
pub(crate) enum Choice {
    Call(Method, String, Value),
    Ask(Purpose),
}

/// Receiver of the keys.
#[derive(Clone, PartialEq, Debug)]
pub(crate) enum Mode {
    Panes,
    /// An input line. `sent` is the tag of its call, `error` the sentence with which it was refused.
    Entry {
        purpose: Purpose,
        entry: Entry,
        sent: Option<u64>,
        error: Option<String>,
    },
    Menu(Menu),
    /// Number of the first line.
    Help(usize),
}

/// A request of the view to its surroundings.
#[derive(Clone, PartialEq, Debug)]
pub(crate) enum Effect {
    Ask(Ask),
    /// Draws every cell anew.
    Redraw,
    Quit,
}

/// The plot: where its right edge is, and the duration that it shows.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(crate) struct PlotView {
    /// Bench time of the right edge; `None`: now.
    pub(crate) paused: Option<f64>,
    span: usize,
}

impl PlotView {
    /// Duration that the plot shows, in seconds.
    pub(crate) fn span(self) -> f64 {
        SPANS[self.span]
    }
}

/// The view.
pub(crate) struct App {
    pub(crate) bench: Bench,
    /// Address of the server, for the title.
    pub(crate) address: String,
    pub(crate) focus: Pane,
    pub(crate) mode: Mode,
    pub(crate) plot: PlotView,
    pub(crate) is_hexadecimal: bool,
    /// True if the traffic has only messages that were not done.
    pub(crate) only_errors: bool,
    /// Lines of the log of this process; `None` if the view has none.
    pub(crate) log: Option<VecDeque<String>>,
    /// The pane that had the focus last, of those that may share a place.
    last_body: Pane,
    last_bottom: Pane,
    /// The chosen drive.
    drive: Option<String>,
    /// When the chosen drive is to be followed.
    follow_at: Option<Duration>,
    /// Number of the chosen row of each pane. `None`: the newest.
    rows: [Option<usize>; Pane::ALL.len()],
    filters: [String; Pane::ALL.len()],
    message: Option<(String, Duration)>,
    tag: u64,
}

impl App {
    pub(crate) fn new(address: &Address, has_log: bool) -> Self {
        let mut rows = [Some(0); Pane::ALL.len()];
        rows[Pane::Traffic as usize] = None;
        rows[Pane::Log as usize] = None;
        Self {
            bench: Bench::new(),
            address: address.to_string(),
            focus: Pane::Plot,
            mode: Mode::Panes,
            plot: PlotView { paused: None, span: 3 },
            is_hexadecimal: false,
            only_errors: false,
            log: has_log.then(VecDeque::new),
            last_body: Pane::Plot,
            last_bottom: Pane::Traffic,
            drive: address.drive().map(ToOwned::to_owned),
            follow_at: None,
            rows,
            filters: Default::default(),
            message: None,
            tag: 0,
        }
    }

    /// Begins with the bench; the drive of the address, or else the first one, is followed as soon as it is known.
    pub(crate) fn start(&mut self) -> Effect {
        Effect::Ask(self.bench.follow(None))
    }

    /// Takes news of the server.
    pub(crate) fn hear(&mut self, news: News, now: Duration) -> Vec<Effect> {
        if let News::Answer { tag, result } = news {
            self.answered(tag, result, now);
            return Vec::new();
        }
        let asks = self.bench.hear(news, now);
        let mut effects: Vec<Effect> = asks.into_iter().map(Effect::Ask).collect();
        let names = self.bench.names();
        let is_there = self.drive.as_ref().is_some_and(|drive| names.contains(drive));
        if self.bench.link() == &Link::Live {
            if !is_there {
                let gone = std::mem::replace(&mut self.drive, names.first().cloned());
                self.follow_at = None;
                if let Some(gone) = gone {
                    let instead = self.drive.as_ref().map(|drive| format!("; the view shows {drive}"));
                    self.say(format!("there is no drive {gone}{}", instead.unwrap_or_default()), now);
                }
            }
            if self.follow_at.is_none() && self.drive.as_deref() != self.bench.followed() {
                effects.push(Effect::Ask(self.bench.follow(self.drive.clone())));
            }
        }
        effects
    }

    fn answered(&mut self, tag: u64, result: Result<(), String>, now: Duration) {
        if let Mode::Entry { sent, error, .. } = &mut self.mode
            && *sent == Some(tag)
        {
            match result {
                Ok(()) => self.mode = Mode::Panes,
                Err(sentence) => {
                    *error = Some(sentence);
                    *sent = None;
                }
            }
        } else if let Err(sentence) = result {
            self.say(sentence, now);
        }
    }

    /// Adds a line of the log.
    pub(crate) fn add_log(&mut self, line: String) {
        if let Some(log) = &mut self.log {
            log.push_back(line);
            let more = log.len().saturating_sub(LOG_LINES);
            log.drain(..more);
        }
    }

    fn say(&mut self, sentence: impl Into<String>, now: Duration) {
        self.message = Some((sentence.into(), now));
    }

    /// The sentence of the last error.
    pub(crate) fn message(&self, now: Duration) -> Option<&str> {
        let (sentence, at) = self.message.as_ref()?;
        (now.saturating_sub(*at) < MESSAGE).then_some(sentence)
    }

    /// The time at which the view changes by itself.
    pub(crate) fn wake(&self, now: Duration) -> Option<Duration> {
        let message = self.message.as_ref().map(|(_, at)| *at + MESSAGE).filter(|end| *end > now);
        [self.follow_at, message, self.bench.next_dark(now), self.bench.next_silence(now)]
            .into_iter()
            .flatten()
            .min()
    }

    /// Does what is due.
    pub(crate) fn tick(&mut self, now: Duration) -> Vec<Effect> {
        if self.follow_at.is_none_or(|at| now < at) {
            return Vec::new();
        }
        self.follow_at = None;
        if self.drive.as_deref() == self.bench.followed() {
            return Vec::new();
        }
        vec![Effect::Ask(self.bench.follow(self.drive.clone()))]
    }

    /// The name of the chosen drive.
    pub(crate) fn drive(&self) -> Option<&str> {
        self.drive.as_deref()
    }

    /// Names of the drives that the filter lets through.
    pub(crate) fn drives(&self) -> Vec<&str> {
        let filter = self.filter(Pane::Drives).to_lowercase();
        let matches = |name: &&String| {
            filter.is_empty()
                || name.to_lowercase().contains(&filter)
                || self.bench.summary(name)["kind"].as_str().is_some_and(|kind| kind.contains(&filter))
        };
        self.bench.names().iter().filter(matches).map(String::as_str).collect()
    }

    /// Registers that the filter lets through.
    pub(crate) fn registers(&self) -> Vec<Register<'_>> {
        let filter = self.filter(Pane::Registers).to_lowercase();
        let matches = |register: &Register| {
            filter.is_empty()
                || register.name.to_lowercase().contains(&filter)
                || register.row["doc"].as_str().is_some_and(|doc| doc.to_lowercase().contains(&filter))
        };
        self.bench.registers().into_iter().filter(matches).collect()
    }

    /// Messages that the filter lets through, the oldest first.
    pub(crate) fn frames(&self) -> Vec<&Value> {
        let filter = self.filter(Pane::Traffic).to_lowercase();
        let has = |frame: &Value, member: &str| {
            frame[member].as_str().is_some_and(|text| text.to_lowercase().contains(&filter))
        };
        let matches = |frame: &&Value| {
            (filter.is_empty() || ["text", "outcome", "port", "verdict"].iter().any(|of| has(frame, of)))
                && !(self.only_errors && frame["verdict"] == "done" && frame["unanswered"] != true)
        };
        self.bench.frames().iter().filter(matches).collect()
    }

    /// Lines of the log that the filter lets through.
    pub(crate) fn log_lines(&self) -> Vec<&str> {
        let filter = self.filter(Pane::Log).to_lowercase();
        let lines = self.log.iter().flatten().map(String::as_str);
        lines.filter(|line| filter.is_empty() || line.to_lowercase().contains(&filter)).collect()
    }

    /// Names of the buses.
    pub(crate) fn buses(&self) -> Vec<&str> {
        let buses = self.bench.state()["buses"].as_object();
        buses.into_iter().flatten().map(|(name, _)| name.as_str()).collect()
    }

    pub(crate) fn filter(&self, pane: Pane) -> &str {
        &self.filters[pane as usize]
    }

    /// The chosen row of a pane with this number of rows. `None`: the newest, or there are no rows.
    pub(crate) fn row(&self, pane: Pane, count: usize) -> Option<usize> {
        self.rows[pane as usize].filter(|_| count > 0).map(|row| row.min(count - 1))
    }

    /// Panes that the view has now, in the order of Tab.
    pub(crate) fn panes(&self) -> impl Iterator<Item = Pane> + '_ {
        Pane::ALL.into_iter().filter(|pane| match pane {
            Pane::Drives => self.has_list(),
            Pane::Log => self.log.is_some(),
            _ => true,
        })
    }

    /// Returns whether the view shows the list of drives: a bench of one drive needs none.
    pub(crate) fn has_list(&self) -> bool {
        self.bench.names().len() > 1
    }

    /// The pane in a place for all panes but the list.
    pub(crate) fn body(&self) -> Pane {
        self.last_body
    }

    /// The pane in a place for traffic, bench and log.
    pub(crate) fn bottom(&self) -> Pane {
        self.last_bottom
    }

    fn set_focus(&mut self, pane: Pane) {
        if !self.panes().any(|other| other == pane) {
            return;
        }
        self.focus = pane;
        if pane != Pane::Drives {
            self.last_body = pane;
        }
        if matches!(pane, Pane::Traffic | Pane::Bench | Pane::Log) {
            self.last_bottom = pane;
        }
    }

    /// Pastes text into an input line. Without one the text does nothing, so that no pasted letter is a key.
    pub(crate) fn paste(&mut self, text: &str) {
        if let Mode::Entry { purpose, entry, .. } = &mut self.mode {
            entry.paste(text);
            if let Purpose::Filter(pane) = *purpose {
                self.filters[pane as usize] = entry.text();
            }
        }
    }

    /// Does what a key means.
    pub(crate) fn key(&mut self, key: KeyEvent, now: Duration) -> Vec<Effect> {
        if !key.modifiers.is_empty() {
            // Keys that mean the same everywhere.
            match keys::action(key, self.focus) {
                Some(Action::Quit) => return vec![Effect::Quit],
                Some(Action::Redraw) => return vec![Effect::Redraw],
                _ => {}
            }
        }
        match &mut self.mode {
            Mode::Panes => self.pane_key(key, now),
            Mode::Help(first) => {
                match key.code {
                    KeyCode::Down | KeyCode::Char('j' | ' ') => *first += 1,
                    KeyCode::PageDown => *first += PAGE,
                    KeyCode::Up | KeyCode::Char('k') => *first = first.saturating_sub(1),
                    KeyCode::PageUp => *first = first.saturating_sub(PAGE),
                    _ => {
                        self.mode = Mode::Panes;
                        return Vec::new();
                    }
                }
                *first = (*first).min(help_height().saturating_sub(PAGE));
                Vec::new()
            }
            Mode::Menu(menu) => {
                let pressed = |choice: &&(char, _, _)| key.code == KeyCode::Char(choice.0);
                let choice = menu.choices.iter().find(pressed).map(|(_, _, choice)| choice.clone());
                self.mode = Mode::Panes;
                match choice {
                    Some(Choice::Call(method, path, body)) => vec![self.call(method, path, Some(body))],
                    Some(Choice::Ask(purpose)) => {
                        self.ask(purpose, "");
                        Vec::new()
                    }
                    None => Vec::new(),
                }
            }
            Mode::Entry { purpose, entry, error, .. } => {
                let purpose = purpose.clone();
                let typed = entry.key(key);
                let text = entry.text();
                match typed {
                    Typed::Changed => {
                        *error = None;
                        if let Purpose::Filter(pane) = purpose {
                            self.filters[pane as usize] = text;
                        }
                        Vec::new()
                    }
                    Typed::Left => {
                        if let Purpose::Filter(pane) = purpose {
                            self.filters[pane as usize].clear();
                        }
                        self.mode = Mode::Panes;
                        Vec::new()
                    }
                    Typed::Done => self.enter(purpose, &text, now),
                }
            }
        }
    }

    /// Does what an input line says.
    fn enter(&mut self, purpose: Purpose, text: &str, now: Duration) -> Vec<Effect> {
        let drive = self.drive_path();
        let call = match purpose {
            Purpose::Filter(pane) => {
                self.mode = Mode::Panes;
                if pane == Pane::Drives && !self.drives().contains(&self.drive().unwrap_or_default()) {
                    self.choose(0, now);
                }
                return Vec::new();
            }
            Purpose::Register(name) => entry::register_value(text).map(|value| {
                (Method::PUT, format!("{drive}/registers/{}", segment(&name)), json!({ "value": value }))
            }),
            Purpose::Analogue(pin) => entry::analogue(text)
                .map(|level| (Method::PUT, format!("{drive}/pins/{}", segment(&pin)), level)),
            Purpose::Pulses(pin) => entry::count_and_rate(text, "count")
                .map(|train| (Method::POST, format!("{drive}/pins/{}/pulses", segment(&pin)), train)),
            Purpose::Encoder => entry::count_and_rate(text, "counts")
                .map(|turn| (Method::POST, format!("{drive}/encoder"), turn)),
            Purpose::LineFaults(bus) => entry::line_faults(text)
                .map(|faults| (Method::PUT, format!("/api/buses/{}/faults", segment(&bus)), faults)),
            Purpose::Times => {
                let mode = format!("x{}", text.trim().trim_start_matches('x'));
                Ok((Method::PUT, "/api/time".to_owned(), json!({ "mode": mode })))
            }
            Purpose::Advance => entry::seconds(text)
                .map(|seconds| (Method::POST, "/api/time/advance".to_owned(), json!({ "seconds": seconds }))),
        };
        let effect = call.map(|(method, path, body)| self.call(method, path, Some(body)));
        let Mode::Entry { sent, error, .. } = &mut self.mode else { return Vec::new() };
        match effect {
            Ok(effect) => {
                *sent = Some(self.tag);
                vec![effect]
            }
            Err(sentence) => {
                *error = Some(sentence);
                Vec::new()
            }
        }
    }

    fn pane_key(&mut self, key: KeyEvent, now: Duration) -> Vec<Effect> {
        if let Some(pane) = keys::pane(key) {
            self.set_focus(pane);
            return Vec::new();
        }
        let Some(action) = keys::action(key, self.focus) else { return Vec::new() };
        match action {
            Action::Quit => return vec![Effect::Quit],
            Action::Redraw => return vec![Effect::Redraw],
            Action::Help => self.mode = Mode::Help(0),
            Action::Next | Action::Previous => {
                let panes: Vec<Pane> = self.panes().collect();
                let place = panes.iter().position(|pane| *pane == self.focus).unwrap_or(0);
                let step = if action == Action::Next { 1 } else { panes.len() - 1 };
                self.set_focus(panes[(place + step) % panes.len()]);
            }
            Action::Up => self.walk(-1, now),
            Action::Down => self.walk(1, now),
            Action::PageUp => self.walk(-(PAGE as isize), now),
            Action::PageDown => self.walk(PAGE as isize, now),
            Action::First => self.walk(isize::MIN, now),
            Action::Last => self.walk(isize::MAX, now),
            Action::Filter => {
                let pane = self.focus;
                if matches!(pane, Pane::Drives | Pane::Registers | Pane::Traffic | Pane::Log) {
                    self.ask(Purpose::Filter(pane), self.filter(pane).to_owned());
                } else if self.has_list() {
                    self.set_focus(Pane::Drives);
                    self.ask(Purpose::Filter(Pane::Drives), self.filter(Pane::Drives).to_owned());
                }
            }
            Action::Leave => {
                self.filters[self.focus as usize].clear();
                self.message = None;
                match self.focus {
                    Pane::Traffic | Pane::Log => self.rows[self.focus as usize] = None,
                    Pane::Plot => self.plot.paused = None,
                    _ => {}
                }
            }
            Action::PreviousDrive => self.walk_drives(-1, now),
            Action::NextDrive => self.walk_drives(1, now),
            Action::Hexadecimal => self.is_hexadecimal = !self.is_hexadecimal,
            Action::Errors => self.only_errors = !self.only_errors,
            Action::Pause => {
                self.plot.paused = if self.plot.paused.is_some() { None } else { self.bench.seconds() };
            }
            Action::ZoomIn => self.plot.span = self.plot.span.saturating_sub(1),
            Action::ZoomOut => self.plot.span = (self.plot.span + 1).min(SPANS.len() - 1),
            Action::Earlier => self.scroll_plot(-0.1),
            Action::Later => self.scroll_plot(0.1),
            Action::Time => self.time_menu(now),
            Action::Advance => {
                if !self.refuse("advance", now) {
                    self.ask(Purpose::Advance, "");
                }
            }
            Action::NextEvent => {
                if !self.refuse("advance", now) {
                    let body = json!({"to": "next"});
                    return vec![self.call(Method::POST, "/api/time/advance".into(), Some(body))];
                }
            }
            Action::LineFaults => {
                let buses = self.buses();
                let bus = self.row(Pane::Bench, buses.len()).map(|row| buses[row].to_owned());
                if let Some(bus) = bus
                    && !self.refuse("faults", now)
                {
                    let text = entry::line_faults_text(&self.bench.state()["buses"][&bus]["faults"]);
                    self.ask(Purpose::LineFaults(bus), text);
                }
            }
            Action::Power
            | Action::Edit
            | Action::Drive(_)
            | Action::Press
            | Action::Analogue
            | Action::Pulses
            | Action::Encoder
            | Action::Cause => return self.act(action),
        }
        Vec::new()
    }

    /// Acts on the chosen drive, once all of it is known.
    fn act(&mut self, action: Action) -> Vec<Effect> {
        if self.drive.is_none() || self.drive.as_deref() != self.bench.followed() {
            return Vec::new();
        }
        let drive = self.drive_path();
        let pins = self.bench.pins();
        let pin =
            self.row(Pane::Pins, pins.len()).map(|row| (pins[row].name.to_owned(), pins[row].level == "low"));
        match action {
            Action::Power => {
                let choice = |key, label, action| {
                    (
                        key,
                        label,
                        Choice::Call(Method::POST, format!("{drive}/power"), json!({ "action": action })),
                    )
                };
                self.mode = Mode::Menu(Menu {
                    title: format!("power of {}", self.drive().unwrap_or_default()),
                    choices: vec![
                        choice('o', "on", "on"),
                        choice('f', "off", "off"),
                        choice('c', "cycle", "cycle"),
                        choice('x', "cut in the next save", "cut"),
                    ],
                });
            }
            Action::Edit => {
                let registers = self.registers();
                let chosen = self.row(Pane::Registers, registers.len()).map(|row| &registers[row]);
                if let Some(register) = chosen {
                    let (name, text) = (register.name.to_owned(), value_text(register.value));
                    self.open(Purpose::Register(name), Entry::over(text));
                }
            }
            Action::Cause => {
                let faults = self.bench.faults();
                let chosen = self.row(Pane::Faults, faults.len()).map(|row| faults[row]);
                if let Some((name, is_there)) = chosen {
                    let method = if is_there { Method::DELETE } else { Method::PUT };
                    return vec![self.call(method, format!("{drive}/faults/{}", segment(name)), None)];
                }
            }
            Action::Encoder => self.ask(Purpose::Encoder, ""),
            _ => {
                let Some((pin, is_low)) = pin else { return Vec::new() };
                let level = match action {
                    Action::Drive(level) => level,
                    Action::Press if is_low => "open",
                    Action::Press => "low",
                    Action::Analogue => {
                        self.ask(Purpose::Analogue(pin), "");
                        return Vec::new();
                    }
                    _ => {
                        self.ask(Purpose::Pulses(pin), "");
                        return Vec::new();
                    }
                };
                let path = format!("{drive}/pins/{}", segment(&pin));
                return vec![self.call(Method::PUT, path, Some(json!({ "level": level })))];
            }
        }
        Vec::new()
    }

    fn time_menu(&mut self, now: Duration) {
        if self.refuse("time", now) {
            return;
        }
        let mode = |key, label, mode| {
            (key, label, Choice::Call(Method::PUT, "/api/time".to_owned(), json!({ "mode": mode })))
        };
        self.mode = Mode::Menu(Menu {
            title: "time".into(),
            choices: vec![
                mode('r', "real", "real"),
                ('x', "faster: times", Choice::Ask(Purpose::Times)),
                mode('m', "manual", "manual"),
                ('a', "advance", Choice::Ask(Purpose::Advance)),
            ],
        });
    }

    /// Says why the bench cannot do something. Returns false if it can.
    fn refuse(&mut self, what: &str, now: Duration) -> bool {
        let Some(reason) = self.bench.cannot(what).map(ToOwned::to_owned) else { return false };
        self.say(reason, now);
        true
    }

    fn ask(&mut self, purpose: Purpose, text: impl Into<String>) {
        self.open(purpose, Entry::new(text));
    }

    fn open(&mut self, purpose: Purpose, entry: Entry) {
        self.mode = Mode::Entry { purpose, entry, sent: None, error: None };
    }

    fn call(&mut self, method: Method, path: String, body: Option<Value>) -> Effect {
        self.tag += 1;
        self.message = None;
        Effect::Ask(Ask::Call(Call { method, path, body, tag: self.tag }))
    }

    fn drive_path(&self) -> String {
        format!("/api/drives/{}", segment(self.drive().unwrap_or_default()))
    }

    fn scroll_plot(&mut self, part: f64) {
        let Some(now) = self.bench.seconds() else { return };
        let edge = self.plot.paused.unwrap_or(now) + part * self.plot.span();
        self.plot.paused = Some(edge.clamp(0.0, now));
    }

    /// Number of rows of the pane with the focus.
    fn count(&self) -> usize {
        match self.focus {
            Pane::Drives => self.drives().len(),
            Pane::Plot => 0,
            Pane::Registers => self.registers().len(),
            Pane::Pins => self.bench.pins().len(),
            Pane::Faults => self.bench.faults().len(),
            Pane::Traffic => self.frames().len(),
            Pane::Bench => self.buses().len(),
            Pane::Log => self.log_lines().len(),
        }
    }

    /// Moves the chosen row of the pane with the focus.
    fn walk(&mut self, step: isize, now: Duration) {
        if self.focus == Pane::Drives {
            return self.walk_drives(step, now);
        }
        let count = self.count();
        if count == 0 {
            return;
        }
        let follows_newest = matches!(self.focus, Pane::Traffic | Pane::Log);
        let row = self.row(self.focus, count).unwrap_or(count - 1);
        let to = row.saturating_add_signed(step);
        // Beyond the last row is the newest.
        let is_newest = follows_newest && to >= count;
        self.rows[self.focus as usize] = (!is_newest).then_some(to.min(count - 1));
    }

    fn walk_drives(&mut self, step: isize, now: Duration) {
        let drives = self.drives();
        let place = drives.iter().position(|name| Some(*name) == self.drive());
        if drives.is_empty() {
            return;
        }
        let to = place.unwrap_or(0).saturating_add_signed(step).min(drives.len() - 1);
        self.choose(to, now);
    }

    /// Chooses a drive of those that the filter lets through.
    fn choose(&mut self, place: usize, now: Duration) {
        let Some(name) = self.drives().get(place).map(|name| (*name).to_owned()) else { return };
        if self.drive.as_ref() == Some(&name) {
            return;
        }
        self.drive = Some(name);
        self.follow_at = Some(now + SETTLING);
        for pane in [Pane::Registers, Pane::Pins, Pane::Faults] {
            self.rows[pane as usize] = Some(0);
        }
        self.rows[Pane::Traffic as usize] = None;
    }
}

/// A value as people type it: words with commas.
pub(crate) fn value_text(value: &Value) -> String {
    match value {
        Value::Array(words) => words.iter().map(ToString::to_string).collect::<Vec<_>>().join(", "),
        value => value.to_string(),
    }
}
