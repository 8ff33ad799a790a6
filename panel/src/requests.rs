//! Requests of the control API, as JSON. The responses are those of [`schema`](crate::schema).

use drivetwin_firmware::device::Duration;
use drivetwin_protocol::time::TICKS_PER_SECOND;
use drivetwin_sim::bench::{self, PowerAction, scenario};
use drivetwin_sim::commands::{Contact, InputLevel};
use drivetwin_sim::config::bench_file::parse_scenarios;
use drivetwin_sim::value::Value;
use serde::{Deserialize, Serialize};
use serde_json::Value as Json;
use utoipa::ToSchema;

use crate::schema::ValueSchema;

/// Level, voltage or current of an input pin: exactly one of the three.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"level": "low"}))]
pub struct PinLevel {
    /// `low` pulls the pin low, `high` drives it high, `open` does not drive it.
    pub level: Option<Driven>,
    /// A voltage, on an analogue input.
    pub volts: Option<f64>,
    /// A current in mA, on an analogue input that can measure one.
    pub milliamps: Option<f64>,
}

/// A level from outside.
#[derive(Clone, Copy, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Driven {
    /// Pulls the pin low.
    Low,
    /// Drives the pin high.
    High,
    /// Does not drive the pin.
    Open,
}

impl From<PinLevel> for InputLevel {
    fn from(PinLevel { level, volts, milliamps }: PinLevel) -> Self {
        let level = level.map(|level| match level {
            Driven::Low => Contact::Low,
            Driven::High => Contact::High,
            Driven::Open => Contact::Open,
        });
        Self { level, volts, milliamps }
    }
}

/// A train of pulses.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"count": 1000, "hz": 250000}))]
pub struct Pulses {
    /// Number of pulses.
    #[schema(minimum = 1, maximum = 4294967295_i64)]
    pub count: u32,
    /// Pulses per second of bench time.
    #[schema(minimum = 0.000001, maximum = 8000000)]
    pub hz: f64,
    /// Duty: the part of each period for which the pulse lasts, above 0 and below 1; 0.5 by default.
    #[schema(exclusive_minimum = 0, exclusive_maximum = 1)]
    pub duty: Option<f64>,
}

/// Motion of an encoder.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"counts": 400, "hz": 10000}))]
pub struct Turn {
    /// Number of edges, four per cycle; not 0. A negative number turns in the other direction.
    #[schema(minimum = -2147483648, maximum = 2147483647)]
    pub counts: i64,
    /// Edges per second of bench time.
    #[schema(minimum = 0.000001, maximum = 16000000)]
    pub hz: f64,
}

/// New value of a register.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"value": 5}))]
pub struct NewValue {
    /// The value.
    #[schema(value_type = ValueSchema)]
    pub value: Value,
}

/// Change of a drive's power.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"action": "cycle"}))]
pub struct Power {
    /// Change of the power.
    pub action: Action,
}

/// `off`, `on`, `cycle` (off and on again), or `cut`: the drive continues to run, and its power fails in the
/// middle of its next save to memory.
#[derive(Clone, Copy, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Action {
    /// Off.
    Off,
    /// On.
    On,
    /// Off and on again.
    Cycle,
    /// Off in the middle of the next save.
    Cut,
}

impl From<Action> for PowerAction {
    fn from(action: Action) -> Self {
        match action {
            Action::Off => Self::Off,
            Action::On => Self::On,
            Action::Cycle => Self::Cycle,
            Action::Cut => Self::Cut,
        }
    }
}

/// The kind that a board shall be.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"kind": "qsb-d"}))]
pub struct Kind {
    /// Name of the kind.
    pub kind: String,
}

/// The kind that a drive is now.
#[derive(Serialize, ToSchema)]
pub struct Kinds {
    /// Name of the kind.
    pub kind: String,
    /// Kinds that it can be.
    pub kinds: Vec<String>,
}

/// New time mode.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Mode {
    /// `real`, `xN` (N times faster than real time, N up to 1000) or `manual`.
    #[schema(example = "manual", pattern = "^(real|x([1-9][0-9]{0,2}|1000)|manual)$")]
    pub mode: String,
}

/// Advance of the clock in manual time: exactly one of the two.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"seconds": 1.25}))]
pub struct Advance {
    /// Bench time to run, 0 to 86,400 s.
    #[schema(minimum = 0, maximum = 86400)]
    pub seconds: Option<f64>,
    /// Runs the bench to this moment.
    pub to: Option<Moment>,
}

/// Longest advance of the clock per call, in seconds.
const MAX_ADVANCE: f64 = 86_400.0;

impl Advance {
    /// Bench time to run; `None` for the time until the next event.
    ///
    /// # Errors
    /// One sentence: a value out of range, or not exactly one of the two.
    pub fn span(&self) -> Result<Option<Duration>, String> {
        match *self {
            Self { seconds: Some(seconds), to: None } if (0.0..=MAX_ADVANCE).contains(&seconds) => {
                // The span is not negative, and far below the maximum of a tick counter.
                Ok(Some(Duration::from_ticks((seconds * TICKS_PER_SECOND as f64).round() as u64)))
            }
            Self { seconds: Some(_), to: None } => Err("seconds takes 0 to 86400".into()),
            Self { seconds: None, to: Some(Moment::Next) } => Ok(None),
            _ => Err("an advance takes seconds, or \"to\": \"next\", one of them".into()),
        }
    }
}

/// `next` is the next event of the bench: a drive, a line or a motor has something to do.
#[derive(Clone, Copy, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Moment {
    /// The next event of the bench.
    Next,
}

/// Characters that a person types.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"text": "PR P\r"}))]
pub struct Typed {
    /// Characters to send, with control characters. They are sent as UTF-8.
    pub text: String,
}

/// Actions that happen at a time, or after a request of a master.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Scenario {
    /// The steps, each with the keys of a step of a `[[scenario]]` in a bench file.
    #[schema(value_type = Vec<Object>, min_items = 1, example = json!([
        {"when": {"drive": "md3", "register": "MotionControl"}, "after_ms": 100, "drive": "md3", "power": "cut"}
    ]))]
    pub steps: Vec<serde_json::Map<String, Json>>,
}

impl Scenario {
    /// The scenario for a bench.
    ///
    /// # Errors
    /// The first error, with the number of the step.
    pub fn on(&self, bench: &bench::Bench) -> Result<Vec<scenario::Scenario>, String> {
        let steps = self.steps.iter().zip(1..).map(|(step, number)| {
            toml(&Json::Object(step.clone())).ok_or_else(|| format!("step {number}: null is not a value"))
        });
        let steps = steps.collect::<Result<Vec<_>, _>>()?.join(",\n");
        // Each step has a line of its own. The first one is line 3.
        let text = format!("[[scenario]]\nsteps = [\n{steps}\n]");
        parse_scenarios(&text, bench).map_err(|error| match error.line {
            line @ 3.. if line - 3 < self.steps.len() => format!("step {}: {}", line - 2, error.what),
            _ => error.what,
        })
    }
}

/// A value of JSON on one line of TOML; `None` if it has a null. A text of JSON is one of TOML, too, except that TOML
/// takes DEL only as an escape.
fn toml(json: &Json) -> Option<String> {
    Some(match json {
        Json::Null => return None,
        Json::Bool(_) | Json::Number(_) | Json::String(_) => json.to_string().replace('\u{7f}', "\\u007f"),
        Json::Array(values) => {
            let values: Option<Vec<String>> = values.iter().map(toml).collect();
            format!("[{}]", values?.join(", "))
        }
        Json::Object(members) => {
            let member = |(key, value): (&String, &Json)| {
                Some(format!("{} = {}", toml(&Json::String(key.clone()))?, toml(value)?))
            };
            let members: Option<Vec<String>> = members.iter().map(member).collect();
            format!("{{ {} }}", members?.join(", "))
        }
    })
}
