//! The bench as the view knows it: the live state, latest messages, motion over time.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::time::Duration;

use serde_json::Value;

use crate::client::{Ask, Live, News};
use crate::patch::merge;

/// Maximum number of messages that are kept.
const FRAMES: usize = 1_000;

/// Duration of the motion that is kept, in seconds of bench time.
const KEPT: f64 = 600.0;

/// Maximum number of samples of motion of a drive: 30 per second for [`KEPT`].
const SAMPLES: usize = 18_000;

/// Maximum number of drives of which the motion is kept while another drive is followed.
const KEPT_DRIVES: usize = 20;

/// Time for which a changed register is lit.
const LIT: Duration = Duration::from_millis(1_000);

/// Silence after which the view says so. While the time of a bench goes on, there are four updates per second.
const SILENCE: Duration = Duration::from_secs(3);

/// The connection to the server.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) enum Link {
    Connecting,
    Live,
    /// The reason in one sentence.
    Lost(String),
}

/// The motion of a drive at a time.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(crate) struct Sample {
    /// Bench time in seconds.
    pub(crate) at: f64,
    /// Steps or counts.
    pub(crate) position: f64,
    /// Steps or counts per second.
    pub(crate) speed: f64,
}

/// A register of the followed drive: its value, and its row in the description of the kind, or null.
pub(crate) struct Register<'a> {
    pub(crate) name: &'a str,
    pub(crate) value: &'a Value,
    pub(crate) row: &'a Value,
}

/// A pin of the followed drive: its level, and its row in the description of the kind, or null.
pub(crate) struct Pin<'a> {
    pub(crate) name: &'a str,
    pub(crate) level: &'a str,
    pub(crate) row: &'a Value,
}

/// The bench as the view knows it.
pub(crate) struct Bench {
    /// State of the contract of `GET /api/live`.
    state: Value,
    link: Link,
    /// Time of the last update.
    heard: Duration,
    /// Number of the newest request to follow; news of earlier ones mean nothing.
    number: u64,
    followed: Option<String>,
    /// True until the first update of a stream, which is whole.
    is_fresh: bool,
    frames: VecDeque<Value>,
    left_out: u64,
    motion: BTreeMap<String, VecDeque<Sample>>,
    /// Descriptions of kinds; null while one is asked for, or if the server has none.
    kinds: BTreeMap<String, Value>,
    /// Registers of the followed drive that have changed, and when.
    changed: BTreeMap<String, Duration>,
    /// Names of the drives in the order of the bench.
    names: Vec<String>,
}

impl Bench {
    pub(crate) fn new() -> Self {
        Self {
            state: Value::Null,
            link: Link::Connecting,
            heard: Duration::ZERO,
            number: 0,
            followed: None,
            is_fresh: true,
            frames: VecDeque::new(),
            left_out: 0,
            motion: BTreeMap::new(),
            kinds: BTreeMap::new(),
            changed: BTreeMap::new(),
            names: Vec::new(),
        }
    }

    /// Follows a drive, or only the bench.
    pub(crate) fn follow(&mut self, drive: Option<String>) -> Ask {
        self.number += 1;
        if drive != self.followed {
            self.changed.clear();
            self.frames.clear();
            self.left_out = 0;
        }
        self.followed = drive;
        Ask::Follow { number: self.number, drive: self.followed.clone() }
    }

    /// Takes news of the live state or the description of a kind. Returns what to ask for next.
    pub(crate) fn hear(&mut self, news: News, now: Duration) -> Vec<Ask> {
        match news {
            News::Live { number, live } if number == self.number => match live {
                Live::Open => {
                    self.is_fresh = true;
                    // The answer to a question may have been lost with the old stream.
                    self.kinds.retain(|_, description| !description.is_null());
                }
                Live::Lost(reason) => self.link = Link::Lost(reason),
                Live::Gone(reason) => {
                    self.link = Link::Lost(reason);
                    return vec![self.follow(None)];
                }
                Live::Update(update) if update.is_object() => return self.update(update, now),
                Live::Update(_) => {}
            },
            News::Kind { kind, description: Some(description) } => {
                self.kinds.insert(kind, description);
            }
            News::Live { .. } | News::Kind { .. } | News::Answer { .. } => {}
        }
        Vec::new()
    }

    fn update(&mut self, mut update: Value, now: Duration) -> Vec<Ask> {
        let is_whole = std::mem::take(&mut self.is_fresh);
        self.link = Link::Live;
        self.heard = now;
        let patch = update["state"].take();
        if is_whole {
            self.begin(&patch);
        } else if let Some(registers) = patch["drive"]["registers"].as_object() {
            self.changed.extend(registers.keys().map(|name| (name.clone(), now)));
        }
        self.changed.retain(|_, at| now.saturating_sub(*at) < LIT);
        if is_whole || !patch["drives"].is_null() {
            merge(&mut self.state, patch);
            self.sort_names();
        } else if !patch.is_null() {
            merge(&mut self.state, patch);
        }
        if let Value::Array(frames) = update["traffic"].take() {
            self.add_frames(frames);
        }
        self.left_out += update["left_out"].as_u64().unwrap_or(0);
        self.sample();
        self.missing_kind().map(Ask::Kind).into_iter().collect()
    }

    /// Begins with the whole state of a new stream. Its clock shows if the stream is that of another run.
    fn begin(&mut self, state: &Value) {
        let seconds = |state: &Value| state["time"]["seconds"].as_f64();
        if seconds(state) < seconds(&self.state) {
            self.frames.clear();
            self.motion.clear();
            self.left_out = 0;
        }
        self.changed.clear();
        self.state = Value::Null;
    }

    fn sort_names(&mut self) {
        let drives = self.state["drives"].as_object();
        let mut names: Vec<(u64, &String)> = drives
            .into_iter()
            .flatten()
            .map(|(name, drive)| (drive["index"].as_u64().unwrap_or(u64::MAX), name))
            .collect();
        names.sort();
        self.names = names.into_iter().map(|(_, name)| name.clone()).collect();
    }

    fn add_frames(&mut self, frames: Vec<Value>) {
        // A new stream may begin with messages that the old one has sent.
        let is_known = |frame: &Value, of: &VecDeque<Value>| {
            let same = |other: &&Value| {
                ["number", "drive", "at", "sent"].iter().all(|member| other[member] == frame[member])
            };
            of.iter().rev().take(200).any(|other| same(&other))
        };
        for frame in frames {
            if frame.is_object() && !is_known(&frame, &self.frames) {
                self.frames.push_back(frame);
            }
        }
        let more = self.frames.len().saturating_sub(FRAMES);
        self.frames.drain(..more);
    }

    /// Notes the motion of drives: of all of a small bench, else of the followed one.
    fn sample(&mut self) {
        let Some(now) = self.seconds() else { return };
        let is_small = self.names.len() <= KEPT_DRIVES;
        let followed = self.followed.as_ref();
        for name in self.names.iter().filter(|name| is_small || Some(*name) == followed) {
            let drive = &self.state["drives"][name.as_str()];
            let (Some(position), Some(speed)) = (drive["position"].as_f64(), drive["speed"].as_f64()) else {
                continue;
            };
            let samples = self.motion.entry(name.clone()).or_default();
            if samples.back().is_some_and(|last| last.at >= now) {
                samples.pop_back();
            }
            samples.push_back(Sample { at: now, position, speed });
            while samples.len() > SAMPLES || samples.front().is_some_and(|first| first.at < now - KEPT) {
                samples.pop_front();
            }
        }
    }

    /// The kind of the followed drive, if its description is not known; from now on it is asked for.
    fn missing_kind(&mut self) -> Option<String> {
        let kind = self.summary(self.followed.as_deref()?)["kind"].as_str()?.to_owned();
        if self.kinds.contains_key(&kind) {
            return None;
        }
        self.kinds.insert(kind.clone(), Value::Null);
        Some(kind)
    }

    pub(crate) fn link(&self) -> &Link {
        &self.link
    }

    /// Duration without a word of the server, if it is too long. A bench in manual time has nothing to say.
    pub(crate) fn silence(&self, now: Duration) -> Option<Duration> {
        self.may_hang().then(|| now.saturating_sub(self.heard)).filter(|silence| *silence >= SILENCE)
    }

    /// The time at which the silence is too long, or a second longer than it is now.
    pub(crate) fn next_silence(&self, now: Duration) -> Option<Duration> {
        let seconds = now.saturating_sub(self.heard).as_secs() + 1;
        self.may_hang().then(|| self.heard + SILENCE.max(Duration::from_secs(seconds)))
    }

    fn may_hang(&self) -> bool {
        self.link == Link::Live && self.state["time"]["mode"] != "manual"
    }

    /// State of the bench; null before the first update.
    pub(crate) fn state(&self) -> &Value {
        &self.state
    }

    /// Bench time in seconds.
    pub(crate) fn seconds(&self) -> Option<f64> {
        self.state["time"]["seconds"].as_f64()
    }

    /// Why the bench cannot do something, in one sentence; `None` if it can.
    pub(crate) fn cannot(&self, what: &str) -> Option<&str> {
        self.state["cannot"][what].as_str()
    }

    /// Names of the drives in the order of the bench.
    pub(crate) fn names(&self) -> &[String] {
        &self.names
    }

    pub(crate) fn followed(&self) -> Option<&str> {
        self.followed.as_deref()
    }

    /// The state that is known of every drive.
    pub(crate) fn summary(&self, name: &str) -> &Value {
        &self.state["drives"][name]
    }

    /// All of the followed drive; null until it is known.
    pub(crate) fn drive(&self) -> &Value {
        let drive = &self.state["drive"];
        match (drive["name"].as_str(), self.followed()) {
            (Some(name), Some(followed)) if name == followed => drive,
            _ => &Value::Null,
        }
    }

    /// The description of the followed drive's kind; null if it is not known.
    pub(crate) fn kind(&self) -> &Value {
        let kind = self.followed().and_then(|name| self.summary(name)["kind"].as_str());
        kind.and_then(|kind| self.kinds.get(kind)).unwrap_or(&Value::Null)
    }

    /// Messages, the oldest first.
    pub(crate) fn frames(&self) -> &VecDeque<Value> {
        &self.frames
    }

    /// Number of messages that the server has left out.
    pub(crate) fn left_out(&self) -> u64 {
        self.left_out
    }

    /// Motion of a drive, the oldest sample first.
    pub(crate) fn motion(&self, drive: &str) -> Option<&VecDeque<Sample>> {
        self.motion.get(drive)
    }

    /// Registers of the followed drive in the order of its manual.
    pub(crate) fn registers(&self) -> Vec<Register<'_>> {
        let named = in_order(&self.drive()["registers"], &self.kind()["registers"]);
        named.into_iter().map(|(name, value, row)| Register { name, value, row }).collect()
    }

    /// Pins of the followed drive in the order of its manual.
    pub(crate) fn pins(&self) -> Vec<Pin<'_>> {
        let named = in_order(&self.drive()["pins"], &self.kind()["pins"]);
        named
            .into_iter()
            .map(|(name, level, row)| Pin { name, level: level.as_str().unwrap_or("unknown"), row })
            .collect()
    }

    /// Lights of the followed drive in the order of its manual: name, and true if it is lit.
    pub(crate) fn lights(&self) -> Vec<(&str, bool)> {
        let named = in_order(&self.drive()["leds"], &self.kind()["pins"]);
        named.into_iter().map(|(name, lit, _)| (name, lit == &Value::Bool(true))).collect()
    }

    /// Faults of the followed drive in the order of its manual: name, and true if their cause is there.
    pub(crate) fn faults(&self) -> Vec<(&str, bool)> {
        let faults = &self.drive()["faults"];
        let known = self.kind()["faults"].as_array().into_iter().flatten().filter_map(Value::as_str);
        let known: Vec<&str> = known.filter(|name| faults.get(name).is_some()).collect();
        let others = faults.as_object().into_iter().flatten().map(|(name, _)| name.as_str());
        let others = others.filter(|name| !known.contains(name)).collect::<Vec<_>>();
        let all = known.iter().copied().chain(others);
        all.map(|name| (name, faults[name] == Value::Bool(true))).collect()
    }

    /// Returns whether a register of the followed drive has changed a moment ago.
    pub(crate) fn is_lit(&self, register: &str, now: Duration) -> bool {
        self.changed.get(register).is_some_and(|at| now.saturating_sub(*at) < LIT)
    }

    /// The time at which the next register is not lit any more.
    pub(crate) fn next_dark(&self, now: Duration) -> Option<Duration> {
        self.changed.values().map(|at| *at + LIT).filter(|end| *end > now).min()
    }
}

/// Members of an object with their rows in a description: in the order of the rows, then those without a row.
fn in_order<'a>(members: &'a Value, rows: &'a Value) -> Vec<(&'a str, &'a Value, &'a Value)> {
    let Some(members) = members.as_object() else { return Vec::new() };
    let rows = rows.as_array().map(Vec::as_slice).unwrap_or_default();
    let places: HashMap<&str, usize> =
        rows.iter().enumerate().filter_map(|(place, row)| Some((row["name"].as_str()?, place))).collect();
    let mut named: Vec<_> = members
        .iter()
        .map(|(name, value)| {
            let place = places.get(name.as_str()).copied();
            (place.unwrap_or(usize::MAX), name.as_str(), value)
        })
        .collect();
    named.sort_by_key(|(place, name, _)| (*place, *name));
    let row = |place: usize| rows.get(place).unwrap_or(&Value::Null);
    named.into_iter().map(|(place, name, value)| (name, value, row(place))).collect()
}
