//! Faults of lines and TCP ports, as JSON.

use std::fmt;

use drivetwin_firmware::device::{Duration, Instant};
use drivetwin_protocol::time::TICKS_PER_SECOND;
use drivetwin_sim::bench::{Bench, DriveId, Outlet};
use drivetwin_sim::line::faults::{Amount, Direction, FaultRule, LONGEST_DELAY, LineFaults, Party};
use serde::de::value::MapAccessDeserializer;
use serde::de::{self, Deserializer, Visitor};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;
use utoipa::openapi::schema::{AnyOfBuilder, ObjectBuilder, Type};
use utoipa::openapi::{Ref, RefOr, Schema};

use crate::units::seconds;

/// Faults of a line or TCP port. A number is a share of the frames, 0 to 1, for requests and replies alike unless
/// stated otherwise; a table says which frames and how many.
#[derive(Serialize, Deserialize, ToSchema)]
#[serde(default, deny_unknown_fields)]
#[schema(example = json!({"drop": {"count": 1, "direction": "reply"}, "corrupt": 0.01, "delay_ms": 5}))]
pub struct Faults {
    /// Frames that are lost.
    #[schema(schema_with = rate_or_rule)]
    drop: Setting,
    /// Frames in which one bit is inverted.
    #[schema(schema_with = rate_or_rule)]
    corrupt: Setting,
    /// Frames that are delivered twice.
    #[schema(schema_with = rate_or_rule)]
    duplicate: Setting,
    /// Frames whose end is missing.
    #[schema(schema_with = rate_or_rule)]
    truncate: Setting,
    /// Replies with an address that no drive of the bus has; only with Modbus.
    #[schema(schema_with = rate_or_rule)]
    wrong_address: Setting,
    /// Replies with the number of the next transaction; only on Modbus/TCP ports.
    #[schema(schema_with = rate_or_rule)]
    wrong_transaction: Setting,
    /// Requests that do not reach their drive and are answered with an exception; only with Modbus.
    #[schema(schema_with = rate_or_rule)]
    exception: Setting,
    /// Modbus exception code for `exception`, unless its table has a `code`.
    #[schema(minimum = 1, maximum = 255)]
    exception_code: u8,
    /// Frames that are followed by some characters of noise; on a TCP port, replies that follow noise.
    #[schema(schema_with = rate_or_rule)]
    noise: Setting,
    /// Delay of every reply in milliseconds, or a table.
    #[schema(schema_with = delay_or_rule)]
    delay_ms: Setting,
    /// Replies that are not delivered; true for all of them.
    #[schema(schema_with = flag_rate_or_rule)]
    mute: Setting,
    /// Frames in the middle of which the connection is closed; only on TCP ports.
    #[schema(schema_with = rate_or_rule)]
    close: Setting,
    /// Baud rate of the clients; only on serial lines. By default it is that of the drives.
    #[schema(minimum = 50, maximum = 4000000)]
    baud: Option<u32>,
}

/// The frames that a fault disturbs. Without `rate` and `count`, all frames that the other members name.
#[derive(Clone, Default, Serialize, Deserialize, ToSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Rule {
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
    /// Only for `exception`: its code, `exception_code` by default.
    #[schema(minimum = 1, maximum = 255)]
    #[serde(skip_serializing_if = "Option::is_none")]
    code: Option<u8>,
    /// Only for `noise`: true if it comes right before the frame, without a gap.
    #[serde(skip_serializing_if = "Option::is_none")]
    before: Option<bool>,
    /// Only for `delay_ms`, and necessary there: the delay in milliseconds.
    #[schema(minimum = 0, maximum = 60000)]
    #[serde(skip_serializing_if = "Option::is_none")]
    ms: Option<f64>,
    /// Only for `delay_ms`: greatest random addition to the delay, in milliseconds. Both together are up to 60,000.
    #[schema(minimum = 0, maximum = 60000)]
    #[serde(skip_serializing_if = "Option::is_none")]
    spread_ms: Option<f64>,
}

/// Direction of a frame.
#[derive(Clone, Copy, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
#[schema(as = Direction)]
pub enum Way {
    /// To a drive.
    Request,
    /// From a drive.
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

impl Rule {
    /// The JSON of a rule, without the members that only some faults have.
    fn of<'a>(rule: FaultRule, name_of: &dyn Fn(DriveId) -> &'a str) -> Self {
        let (rate, count) = match rule.amount {
            Amount::Rate(rate) => (Some(rate), None),
            Amount::Count(count) => (None, Some(count)),
        };
        Self {
            rate,
            count,
            direction: rule.direction.map(Way::of),
            drive: rule.drive.map(|drive| name_of(drive).to_owned()),
            function: rule.function,
            register: rule.register.map(str::to_owned),
            ..Self::default()
        }
    }

    /// The rule of the fault `name`, on a bus with these drives.
    fn on(&self, name: &str, drives: &[Party<'_>]) -> Result<FaultRule, String> {
        let only = [
            ("code", self.code.is_some(), "exception"),
            ("before", self.before.is_some(), "noise"),
            ("ms", self.ms.is_some(), "delay_ms"),
            ("spread_ms", self.spread_ms.is_some(), "delay_ms"),
        ];
        if let Some((member, _, of)) = only.iter().find(|&&(_, is_given, of)| is_given && of != name) {
            return Err(format!("{name} takes no {member}; it is for {of}"));
        }
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
        if let Some(drive) = &self.drive {
            rule = rule.drive_named(drive, drives).map_err(at)?;
        }
        match &self.register {
            Some(register) => rule.register_named(register, drives).map_err(at),
            None => Ok(rule),
        }
    }
}

/// A plain value, or a table.
#[derive(Serialize)]
#[serde(untagged)]
enum Setting {
    Flag(bool),
    Number(f64),
    Table(Box<Rule>),
}

impl Default for Setting {
    fn default() -> Self {
        Self::Number(0.0)
    }
}

impl<'de> Deserialize<'de> for Setting {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Reads;

        impl<'de> Visitor<'de> for Reads {
            type Value = Setting;

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
                let rule = Rule::deserialize(MapAccessDeserializer::new(map))?;
                Ok(Setting::Table(Box::new(rule)))
            }
        }

        deserializer.deserialize_any(Reads)
    }
}

impl Setting {
    fn of<'a>(rule: FaultRule, name_of: &dyn Fn(DriveId) -> &'a str) -> Self {
        match rule.amount {
            Amount::Rate(rate) if rule.is_plain() => Self::Number(rate),
            _ => Self::Table(Box::new(Rule::of(rule, name_of))),
        }
    }

    /// The rule of the fault `name`. A plain number is a rate.
    fn rule(&self, name: &str, drives: &[Party<'_>]) -> Result<FaultRule, String> {
        match self {
            Self::Flag(on) if name == "mute" => Ok(if *on { FaultRule::ALL } else { FaultRule::NONE }),
            Self::Flag(flag) => Err(format!("{name} takes a number or an object, not {flag}")),
            Self::Number(rate) => Ok(FaultRule::rate(*rate)),
            Self::Table(rule) => rule.on(name, drives),
        }
    }

    /// The table, if it is one.
    fn table(&self) -> Option<&Rule> {
        match self {
            Self::Table(rule) => Some(rule),
            Self::Flag(_) | Self::Number(_) => None,
        }
    }
}

impl Faults {
    /// The faults of a bus. `name_of` gives the name of a drive.
    pub fn of<'a>(faults: &LineFaults, name_of: impl Fn(DriveId) -> &'a str) -> Self {
        let setting = |rule| Setting::of(rule, &name_of);
        let with = |rule: FaultRule, more: Rule| {
            let Rule { code, before, ms, spread_ms, .. } = more;
            Setting::Table(Box::new(Rule { code, before, ms, spread_ms, ..Rule::of(rule, &name_of) }))
        };
        let exception = if faults.exception.is_plain() {
            setting(faults.exception)
        } else {
            with(faults.exception, Rule { code: Some(faults.exception_code), ..Rule::default() })
        };
        let noise = if faults.noise_before {
            with(faults.noise, Rule { before: Some(true), ..Rule::default() })
        } else {
            setting(faults.noise)
        };
        let delay = if faults.delay_spread == Duration::ZERO && faults.delayed == FaultRule::ALL {
            Setting::Number(milliseconds(faults.delay))
        } else {
            let (ms, spread_ms) = (milliseconds(faults.delay), milliseconds(faults.delay_spread));
            with(faults.delayed, Rule { ms: Some(ms), spread_ms: Some(spread_ms), ..Rule::default() })
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
            noise,
            delay_ms: delay,
            mute,
            close: setting(faults.close),
            baud: faults.baud,
        }
    }

    /// Sets these faults of a line or TCP port, from its next frame on.
    ///
    /// # Errors
    /// One sentence: a value out of range, an unknown name, or a fault that the port cannot have.
    pub fn set_on(&self, bench: &mut Bench, outlet: Outlet) -> Result<(), String> {
        let drives = bench.drives_at(outlet);
        let party = |&id: &DriveId| Party { id, name: bench.name(id), spec: bench.spec(id) };
        let faults = self.on(&drives.iter().map(party).collect::<Vec<_>>())?;
        if let Some(port) = bench.port_at(outlet) {
            faults.check_for(port)?;
        }
        bench.set_faults(outlet, faults);
        Ok(())
    }

    /// The faults for a bus with these drives.
    ///
    /// # Errors
    /// One sentence: a value out of range, or an unknown name.
    fn on(&self, drives: &[Party<'_>]) -> Result<LineFaults, String> {
        let rule = |name, setting: &Setting| setting.rule(name, drives);
        let code = self.exception.table().and_then(|table| table.code);
        let before = self.noise.table().and_then(|table| table.before);
        let (delay, delay_spread, delayed) = match &self.delay_ms {
            Setting::Number(ms) => (span("delay_ms", *ms)?, Duration::ZERO, FaultRule::ALL),
            setting => {
                let delayed = rule("delay_ms", setting)?;
                let table = setting.table();
                let ms = table.and_then(|table| table.ms).ok_or("delay_ms needs ms")?;
                let spread = table.and_then(|table| table.spread_ms).unwrap_or(0.0);
                (span("ms", ms)?, span("spread_ms", spread)?, delayed)
            }
        };
        let faults = LineFaults {
            drop: rule("drop", &self.drop)?,
            corrupt: rule("corrupt", &self.corrupt)?,
            duplicate: rule("duplicate", &self.duplicate)?,
            truncate: rule("truncate", &self.truncate)?,
            wrong_address: rule("wrong_address", &self.wrong_address)?,
            wrong_transaction: rule("wrong_transaction", &self.wrong_transaction)?,
            exception: rule("exception", &self.exception)?,
            exception_code: code.unwrap_or(self.exception_code),
            noise: rule("noise", &self.noise)?,
            noise_before: before == Some(true),
            delay,
            delay_spread,
            delayed,
            mute: rule("mute", &self.mute)?,
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

fn number_or_rule(most: u32) -> AnyOfBuilder {
    let number = ObjectBuilder::new().schema_type(Type::Number).minimum(Some(0)).maximum(Some(most));
    AnyOfBuilder::new().item(number).item(Ref::from_schema_name("Rule"))
}

fn rate_or_rule() -> RefOr<Schema> {
    number_or_rule(1).into()
}

fn delay_or_rule() -> RefOr<Schema> {
    number_or_rule(60_000).into()
}

fn flag_rate_or_rule() -> RefOr<Schema> {
    number_or_rule(1).item(ObjectBuilder::new().schema_type(Type::Boolean)).into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivetwin_sim::bench::Bench;
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
            "noise": {"count": 3, "before": true},
        });
        let faults: Faults = serde_json::from_value(put.clone()).unwrap();
        let faults = faults.on(&parties(&bench)).unwrap();
        bench.set_faults(outlet, faults);
        let got = serde_json::to_value(Faults::of(&bench.faults(outlet), |id| bench.name(id))).unwrap();
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
            (json!({"delay_ms": true}), "delay_ms takes a number or an object, not true"),
            (json!({"drop": {"code": 1}}), "drop takes no code; it is for exception"),
            (json!({"noise": {"ms": 1}}), "noise takes no ms; it is for delay_ms"),
            (json!({"delay_ms": {"ms": 60_000, "spread_ms": 2}}), "delay takes 60 s at most"),
            (
                json!({"mute": {"direction": "request"}}),
                "mute is for replies only; leave out direction = 'request'",
            ),
            (
                json!({"exception": {"direction": "reply"}}),
                "exception is for requests only; leave out direction = 'reply'",
            ),
            (json!({"close": {"drive": "x"}}), "close: there is no drive 'x' on this bus"),
        ] {
            assert_eq!(sentence(faults.clone()), expected, "{faults}");
        }
        for (faults, begins) in [
            (json!({"drop": []}), "invalid type: sequence, expected a number or an object"),
            (json!({"drop": {"codes": 1}}), "unknown field `codes`"),
            (json!({"drop": {"direction": "both"}}), "unknown variant `both`"),
        ] {
            let error = sentence(faults.clone());
            assert!(error.starts_with(begins), "{faults}: {error}");
        }
    }
}
