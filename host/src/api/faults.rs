//! Faults of lines and TCP ports, as JSON.

use std::fmt;
use std::marker::PhantomData;

use drivetwin_firmware::device::{Duration, Instant};
use drivetwin_protocol::time::TICKS_PER_SECOND;
use drivetwin_sim::bench::{Bench, Outlet};
use drivetwin_sim::line::faults::{Amount, Direction, FaultRule, LONGEST_DELAY, LineFaults, Party};
use serde::de::value::MapAccessDeserializer;
use serde::de::{self, Deserializer, Visitor};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;
use utoipa::openapi::schema::{AnyOfBuilder, ObjectBuilder, Type};
use utoipa::openapi::{Ref, RefOr, Schema};

use super::schema::seconds;

/// Faults of a line or TCP port. A number is a share of the frames, 0 to 1, for requests and replies alike unless
/// stated otherwise; a table says which frames and how many.
#[derive(Serialize, Deserialize, ToSchema)]
#[serde(default, deny_unknown_fields)]
#[schema(example = json!({"drop": {"count": 1, "direction": "reply"}, "corrupt": 0.01, "delay_ms": 5}))]
pub(super) struct Faults {
    /// Frames that are lost.
    #[schema(schema_with = rate_or_rule)]
    drop: Setting<Rule>,
    /// Frames in which one bit is inverted.
    #[schema(schema_with = rate_or_rule)]
    corrupt: Setting<Rule>,
    /// Frames that are delivered twice.
    #[schema(schema_with = rate_or_rule)]
    duplicate: Setting<Rule>,
    /// Frames whose end is missing.
    #[schema(schema_with = rate_or_rule)]
    truncate: Setting<Rule>,
    /// Replies with an address that no drive of the bus has; only with Modbus.
    #[schema(schema_with = rate_or_rule)]
    wrong_address: Setting<Rule>,
    /// Replies with the number of the next transaction; only on Modbus/TCP ports.
    #[schema(schema_with = rate_or_rule)]
    wrong_transaction: Setting<Rule>,
    /// Requests that are not executed but answered with an exception; only with Modbus.
    #[schema(schema_with = rate_or_exception_rule)]
    exception: Setting<ExceptionRule>,
    /// Modbus exception code for `exception`, unless its table has a `code`.
    #[schema(minimum = 1, maximum = 255)]
    exception_code: u8,
    /// Frames that are followed by some characters of noise; on a TCP port, replies that follow noise.
    #[schema(schema_with = rate_or_rule)]
    noise: Setting<Rule>,
    /// Delay of every reply in milliseconds, or a table.
    #[schema(schema_with = delay_or_rule)]
    delay_ms: Setting<DelayRule>,
    /// Replies that are not delivered; true for all of them.
    #[schema(schema_with = flag_rate_or_rule)]
    mute: Setting<Rule>,
    /// Frames in the middle of which the connection is closed; only on TCP ports.
    #[schema(schema_with = rate_or_rule)]
    close: Setting<Rule>,
    /// Baud rate of the clients; only on serial lines. By default it is that of the drives.
    #[schema(minimum = 50, maximum = 4000000)]
    baud: Option<u32>,
}

/// A struct with the keys of every rule, and more keys.
macro_rules! rule {
    ($(#[$attribute:meta])* $name:ident { $($more:tt)* }) => {
        $(#[$attribute])*
        #[derive(Clone, Default, Serialize, Deserialize, ToSchema)]
        #[serde(default, deny_unknown_fields)]
        pub(super) struct $name {
            /// Share of these frames.
            #[schema(minimum = 0, maximum = 1)]
            #[serde(skip_serializing_if = "Option::is_none")]
            rate: Option<f64>,
            /// Each of the next so many of these frames. The number goes down with each of them.
            #[schema(minimum = 0, maximum = 4294967295_i64)]
            #[serde(skip_serializing_if = "Option::is_none")]
            count: Option<u32>,
            /// Only requests, or only replies.
            #[serde(skip_serializing_if = "Option::is_none")]
            direction: Option<Way>,
            /// Only requests to the drive with this name, and its replies.
            #[serde(skip_serializing_if = "Option::is_none")]
            drive: Option<String>,
            /// Only Modbus requests with this function code, and their replies.
            #[schema(minimum = 1, maximum = 127)]
            #[serde(skip_serializing_if = "Option::is_none")]
            function: Option<u8>,
            /// Only Modbus requests that read or write the register with this name, and their replies.
            #[serde(skip_serializing_if = "Option::is_none")]
            register: Option<String>,
            $($more)*
        }

        impl $name {
            /// The keys that every rule has.
            fn keys(&self) -> Keys<'_> {
                Keys {
                    rate: self.rate,
                    count: self.count,
                    direction: self.direction,
                    drive: self.drive.as_deref(),
                    function: self.function,
                    register: self.register.as_deref(),
                }
            }

            /// The JSON of a rule, without the additional keys.
            fn of(bench: &Bench, rule: FaultRule) -> Self {
                let (rate, count) = match rule.amount {
                    Amount::Rate(rate) => (Some(rate), None),
                    Amount::Count(count) => (None, Some(count)),
                };
                Self {
                    rate,
                    count,
                    direction: rule.direction.map(Way::of),
                    drive: rule.drive.map(|drive| bench.name(drive).to_owned()),
                    function: rule.function,
                    register: rule.register.map(str::to_owned),
                    ..Self::default()
                }
            }
        }
    };
}

rule! {
    /// The frames that a fault disturbs. Without `rate` and `count`, all frames that the other members name.
    Rule {}
}

rule! {
    /// The requests that are answered with an exception.
    ExceptionRule {
        /// Code of the exception; `exception_code` by default.
        #[schema(minimum = 1, maximum = 255)]
        #[serde(skip_serializing_if = "Option::is_none")]
        code: Option<u8>,
    }
}

rule! {
    /// The replies that are delayed.
    DelayRule {
        /// Delay in milliseconds.
        #[schema(minimum = 0, maximum = 60000)]
        #[serde(skip_serializing_if = "Option::is_none")]
        ms: Option<f64>,
        /// Greatest random addition to the delay, in milliseconds. Both together are up to 60,000.
        #[schema(minimum = 0, maximum = 60000)]
        #[serde(skip_serializing_if = "Option::is_none")]
        spread_ms: Option<f64>,
    }
}

/// Direction of a frame.
#[derive(Clone, Copy, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
#[schema(as = Direction)]
pub(super) enum Way {
    Request,
    Reply,
}

impl Way {
    fn of(direction: Direction) -> Self {
        match direction {
            Direction::Request => Self::Request,
            Direction::Reply => Self::Reply,
        }
    }
}

impl From<Way> for Direction {
    fn from(way: Way) -> Self {
        match way {
            Way::Request => Self::Request,
            Way::Reply => Self::Reply,
        }
    }
}

/// The keys that every rule has.
struct Keys<'a> {
    rate: Option<f64>,
    count: Option<u32>,
    direction: Option<Way>,
    drive: Option<&'a str>,
    function: Option<u8>,
    register: Option<&'a str>,
}

impl Keys<'_> {
    /// The rule of the fault `name`, on a bus with these drives.
    fn rule(&self, name: &str, drives: &[Party<'_>]) -> Result<FaultRule, String> {
        let amount = match (self.rate, self.count) {
            (Some(_), Some(_)) => return Err(format!("{name} takes rate or count, not both")),
            (_, Some(count)) => Amount::Count(count),
            (rate, None) => Amount::Rate(rate.unwrap_or(1.0)),
        };
        if self.function.is_some_and(|function| !(1..=127).contains(&function)) {
            return Err(format!("function of {name} takes 1 to 127"));
        }
        let at = |sentence: String| format!("{name}: {sentence}");
        let direction = self.direction.map(Direction::from);
        let mut rule = FaultRule { amount, direction, function: self.function, ..FaultRule::NONE };
        if let Some(drive) = self.drive {
            rule = rule.drive_named(drive, drives).map_err(at)?;
        }
        match self.register {
            Some(register) => rule.register_named(register, drives).map_err(at),
            None => Ok(rule),
        }
    }
}

/// A plain value, or a table.
#[derive(Serialize)]
#[serde(untagged)]
enum Setting<T> {
    Flag(bool),
    Number(f64),
    Table(T),
}

impl<T> Default for Setting<T> {
    fn default() -> Self {
        Self::Number(0.0)
    }
}

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Setting<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Reads<T>(PhantomData<T>);

        impl<'de, T: Deserialize<'de>> Visitor<'de> for Reads<T> {
            type Value = Setting<T>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a number or an object")
            }

            fn visit_bool<E: de::Error>(self, flag: bool) -> Result<Self::Value, E> {
                Ok(Setting::Flag(flag))
            }

            fn visit_i64<E: de::Error>(self, number: i64) -> Result<Self::Value, E> {
                Ok(Setting::Number(number as f64))
            }

            fn visit_u64<E: de::Error>(self, number: u64) -> Result<Self::Value, E> {
                Ok(Setting::Number(number as f64))
            }

            fn visit_f64<E: de::Error>(self, number: f64) -> Result<Self::Value, E> {
                Ok(Setting::Number(number))
            }

            fn visit_map<A: de::MapAccess<'de>>(self, map: A) -> Result<Self::Value, A::Error> {
                T::deserialize(MapAccessDeserializer::new(map)).map(Setting::Table)
            }
        }

        deserializer.deserialize_any(Reads(PhantomData))
    }
}

impl Setting<Rule> {
    fn of(bench: &Bench, rule: FaultRule) -> Self {
        match rule.amount {
            Amount::Rate(rate) if rule.is_plain() => Self::Number(rate),
            _ => Self::Table(Rule::of(bench, rule)),
        }
    }

    fn rule(&self, name: &str, drives: &[Party<'_>]) -> Result<FaultRule, String> {
        match self {
            Self::Flag(flag) => Err(format!("{name} takes a number or an object, not {flag}")),
            Self::Number(rate) => Ok(FaultRule::rate(*rate)),
            Self::Table(rule) => rule.keys().rule(name, drives),
        }
    }
}

impl Faults {
    /// The faults of a bus.
    pub(super) fn of(bench: &Bench, outlet: Outlet) -> Self {
        let faults = bench.faults(outlet);
        let setting = |rule| Setting::of(bench, rule);
        let exception = match faults.exception.amount {
            Amount::Rate(rate) if faults.exception.is_plain() => Setting::Number(rate),
            _ => Setting::Table(ExceptionRule {
                code: Some(faults.exception_code),
                ..ExceptionRule::of(bench, faults.exception)
            }),
        };
        let delay = if faults.delay_spread == Duration::ZERO && faults.delayed == FaultRule::ALL {
            Setting::Number(milliseconds(faults.delay))
        } else {
            Setting::Table(DelayRule {
                ms: Some(milliseconds(faults.delay)),
                spread_ms: Some(milliseconds(faults.delay_spread)),
                ..DelayRule::of(bench, faults.delayed)
            })
        };
        let mute = match faults.mute {
            FaultRule::NONE => Setting::Flag(false),
            FaultRule::ALL => Setting::Flag(true),
            rule => setting(rule),
        };
        Self {
            drop: setting(faults.drop),
            corrupt: setting(faults.corrupt),
            duplicate: setting(faults.duplicate),
            truncate: setting(faults.truncate),
            wrong_address: setting(faults.wrong_address),
            wrong_transaction: setting(faults.wrong_transaction),
            exception,
            exception_code: faults.exception_code,
            noise: setting(faults.noise),
            delay_ms: delay,
            mute,
            close: setting(faults.close),
            baud: faults.baud,
        }
    }

    /// The faults for a bus with these drives.
    ///
    /// # Errors
    /// One sentence: a value out of range, or an unknown name.
    pub(super) fn on(&self, drives: &[Party<'_>]) -> Result<LineFaults, String> {
        let rule = |name, setting: &Setting<Rule>| setting.rule(name, drives);
        let (exception, code) = match &self.exception {
            Setting::Flag(flag) => return Err(format!("exception takes a number or an object, not {flag}")),
            Setting::Number(rate) => (FaultRule::rate(*rate), None),
            Setting::Table(table) => (table.keys().rule("exception", drives)?, table.code),
        };
        let (delay, delay_spread, delayed) = match &self.delay_ms {
            Setting::Flag(flag) => return Err(format!("delay_ms takes a number or an object, not {flag}")),
            Setting::Number(ms) => (span("delay_ms", *ms)?, Duration::ZERO, FaultRule::ALL),
            Setting::Table(table) => {
                let ms = table.ms.ok_or("delay_ms needs ms")?;
                let spread = span("spread_ms", table.spread_ms.unwrap_or(0.0))?;
                (span("ms", ms)?, spread, table.keys().rule("delay_ms", drives)?)
            }
        };
        let mute = match self.mute {
            Setting::Flag(true) => FaultRule::ALL,
            Setting::Flag(false) => FaultRule::NONE,
            ref setting => rule("mute", setting)?,
        };
        let faults = LineFaults {
            drop: rule("drop", &self.drop)?,
            corrupt: rule("corrupt", &self.corrupt)?,
            duplicate: rule("duplicate", &self.duplicate)?,
            truncate: rule("truncate", &self.truncate)?,
            wrong_address: rule("wrong_address", &self.wrong_address)?,
            wrong_transaction: rule("wrong_transaction", &self.wrong_transaction)?,
            exception,
            exception_code: code.unwrap_or(self.exception_code),
            noise: rule("noise", &self.noise)?,
            delay,
            delay_spread,
            delayed,
            mute,
            close: rule("close", &self.close)?,
            baud: self.baud,
        };
        faults.check().map(|()| faults)
    }
}

impl Default for Faults {
    fn default() -> Self {
        Self {
            drop: Setting::default(),
            corrupt: Setting::default(),
            duplicate: Setting::default(),
            truncate: Setting::default(),
            wrong_address: Setting::default(),
            wrong_transaction: Setting::default(),
            exception: Setting::default(),
            exception_code: LineFaults::NONE.exception_code,
            noise: Setting::default(),
            delay_ms: Setting::default(),
            mute: Setting::Flag(false),
            close: Setting::default(),
            baud: None,
        }
    }
}

fn milliseconds(span: Duration) -> f64 {
    seconds(Instant::ZERO + span) * 1_000.0
}

/// A time in milliseconds, up to the longest delay.
fn span(name: &str, ms: f64) -> Result<Duration, String> {
    let longest = milliseconds(LONGEST_DELAY);
    if !(0.0..=longest).contains(&ms) {
        return Err(format!("{name} is 0 to {longest}"));
    }
    Ok(Duration::from_ticks((ms / 1_000.0 * TICKS_PER_SECOND as f64).round() as u64))
}

fn number_or(most: u32, table: &str) -> AnyOfBuilder {
    let number = ObjectBuilder::new().schema_type(Type::Number).minimum(Some(0)).maximum(Some(most));
    AnyOfBuilder::new().item(number).item(Ref::from_schema_name(table))
}

fn rate_or_rule() -> RefOr<Schema> {
    number_or(1, "Rule").into()
}

fn rate_or_exception_rule() -> RefOr<Schema> {
    number_or(1, "ExceptionRule").into()
}

fn delay_or_rule() -> RefOr<Schema> {
    number_or(60_000, "DelayRule").into()
}

fn flag_rate_or_rule() -> RefOr<Schema> {
    number_or(1, "Rule").item(ObjectBuilder::new().schema_type(Type::Boolean)).into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivetwin_sim::testing::echo_device::{EchoDevice, MODBUS};
    use serde_json::{Value, json};

    fn sentence(faults: Value) -> String {
        let bench = Bench::new();
        match serde_json::from_value::<Faults>(faults) {
            Ok(faults) => faults.on(&parties(&bench)).unwrap_err(),
            Err(error) => error.to_string(),
        }
    }

    fn parties(bench: &Bench) -> Vec<Party<'_>> {
        let party = |id| Party { id, name: bench.name(id), spec: bench.spec(id) };
        bench.drives().map(party).collect()
    }

    #[test]
    fn what_is_put_is_got() {
        let mut bench = Bench::new();
        let echo = bench.add::<EchoDevice>("echo");
        let outlet = bench.outlet(echo, MODBUS);
        let put = json!({
            "drop": {"count": 2, "direction": "reply"},
            "corrupt": 0.5,
            "exception": {"rate": 1.0, "function": 6, "code": 2},
            "delay_ms": {"rate": 1.0, "ms": 5.0, "spread_ms": 2.5, "drive": "echo"},
            "mute": {"count": 1},
        });
        let faults: Faults = serde_json::from_value(put.clone()).unwrap();
        let faults = faults.on(&parties(&bench)).unwrap();
        bench.set_faults(outlet, faults);
        let got = serde_json::to_value(Faults::of(&bench, outlet)).unwrap();
        for (name, value) in put.as_object().unwrap() {
            assert_eq!(&got[name], value, "{name}");
        }
        assert_eq!((&got["mute"], &got["close"]), (&json!({"count": 1}), &json!(0.0)));
        assert_eq!(got["exception_code"], 2);
        let again: Faults = serde_json::from_value(got).unwrap();
        assert_eq!(again.on(&parties(&bench)), Ok(faults));
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (faults, expected) in [
            (json!({"drop": true}), "drop takes a number or an object, not true"),
            (json!({"drop": 2}), "drop takes a share of the frames from 0 to 1, not 2"),
            (json!({"drop": {"rate": 0.5, "count": 1}}), "drop takes rate or count, not both"),
            (json!({"drop": {"function": 200}}), "function of drop takes 1 to 127"),
            (json!({"delay_ms": {"spread_ms": 2}}), "delay_ms needs ms"),
            (json!({"delay_ms": {"ms": 60_000, "spread_ms": 2}}), "delay takes 60 s at most"),
            (
                json!({"mute": {"direction": "request"}}),
                "mute is for replies only; leave out direction = 'request'",
            ),
            (
                json!({"exception": {"direction": "reply"}}),
                "exception is for requests only; leave out direction = 'reply'",
            ),
            (json!({"close": {"drive": "x"}}), "close: there is no drive on this bus 'x'"),
        ] {
            assert_eq!(sentence(faults.clone()), expected, "{faults}");
        }
        for (faults, begins) in [
            (json!({"drop": []}), "invalid type: sequence, expected a number or an object"),
            (json!({"drop": {"code": 1}}), "unknown field `code`"),
            (json!({"drop": {"direction": "both"}}), "unknown variant `both`"),
        ] {
            let error = sentence(faults.clone());
            assert!(error.starts_with(begins), "{faults}: {error}");
        }
    }
}
