//! What the looks tell of the motor.
//!
//! The current tells the speed at the last look: what of the voltage is not lost in the winding, the motor makes
//! itself. The speed, added up, tells the place inside a count, which the edges of the Hall sensors set right. What
//! does not fit together tells that the motor is another one ([`Model`]).

use fixed::types::I40F24;

use super::fit::Fit;
use super::model::{MARGIN_MA, Model};
use super::response::Response;
use super::{HALF, LOOK};
use crate::device::{Duration, Instant};

/// Edges that stayed out after which something is wrong with the sensors: fewer may be a speed that was taken
/// for too high while the motor was held or let go, or before the first edge of another motor.
const MISSED: I40F24 = I40F24::lit("16");
/// The part of what nothing else explains that is believed to be load: all of it would make load of each rounded
/// mA, and the motor would tremble.
const BELIEVED: i64 = 2;
/// What has not passed an edge for so long stands.
const STANDS: Duration = Duration::millis(200);
/// A current that is less does not tell a resistance.
const TELLING_MA: i32 = 200;
/// How many looks at most a motor gets to come to rest that got more than the limit of its current.
const FADES: u8 = 250;
/// There and back on the wires.
const SOON: Duration = Duration::from_ticks(2);

/// What the drive does to the motor from one look to the next.
#[derive(Clone, Copy, Debug)]
pub(super) struct Drives {
    pub(super) duty: i32,
    pub(super) limit_ma: u32,
}

/// A motor that begins to turn tells the resistance of its winding: at rest it has no back-EMF.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Start {
    /// It is over, or the motor did not quite stand.
    Over,
    /// It stands.
    Stands,
    /// It got more than the limit: shorted until it stands again, for so many more looks at most.
    Fades(u8),
}

/// What the looks tell of the motor.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    /// The last look.
    at: Instant,
    /// How fast it was supposed to be then.
    pub(super) speed: I40F24,
    /// How fast the current just after the look before it told that it was.
    pub(super) told: I40F24,
    /// The current just after it, in mA.
    ma: i32,
    /// What load and friction take of the speed that the voltage would give.
    pub(super) load: I40F24,
    /// Friction held it at the last look.
    held: bool,
    /// The limit of the current held it back at the last look.
    pub(super) limited: bool,
    /// Part of a count beyond the edge behind it, and when it was there.
    pub(super) place: I40F24,
    since: Instant,
    /// How much of a mistake in `speed` is in `place`.
    doubt: I40F24,
    /// Counts that it should have made without an edge.
    missed: I40F24,
    start: Start,
    fit: Fit,
    response: Response,
}

impl Seen {
    /// A motor that stands in the middle of a count.
    pub(super) const AT_REST: Self = Self {
        at: Instant::ZERO,
        speed: I40F24::ZERO,
        told: I40F24::ZERO,
        ma: 0,
        load: I40F24::ZERO,
        held: false,
        limited: false,
        place: HALF,
        since: Instant::ZERO,
        doubt: I40F24::ZERO,
        missed: I40F24::ZERO,
        start: Start::Over,
        fit: Fit::NEW,
        response: Response::NEW,
    };

    /// What stood begins to move.
    pub(super) fn begin(&mut self, at: Instant, ma: i32) {
        let start = if at.since(self.since) >= STANDS { Start::Stands } else { Start::Over };
        *self = Self { at, since: at, ma, place: self.place, start, ..Self::AT_REST };
    }

    /// It was looked at, and something was done to it; until then it drew `ma`.
    pub(super) fn looked(&mut self, at: Instant, ma: i32) {
        (self.at, self.ma) = (at, ma);
    }

    /// It draws so much from `at` on. Only what follows upon a look tells of it.
    pub(super) fn draws(&mut self, at: Instant, ma: i32) {
        if at.since(self.at) <= SOON {
            self.ma = ma;
        }
    }

    /// It passed an edge.
    pub(super) fn edge(&mut self, at: Instant, forward: bool) {
        self.place = if forward { I40F24::ZERO } else { I40F24::ONE };
        (self.since, self.doubt, self.missed) = (at, I40F24::ZERO, I40F24::ZERO);
        self.fit.edge(forward);
    }

    /// Counts are now so much smaller, or bigger: `to` for `from`.
    pub(super) fn rescale(&mut self, to: i64, from: i64) {
        for speed in [&mut self.speed, &mut self.told, &mut self.load] {
            *speed = scaled(*speed, to, from);
        }
        self.place = HALF;
    }

    /// What is believed of the motor is something else now.
    pub(super) fn forget(&mut self) {
        (self.fit, self.response) = (Fit::NEW, Response::NEW);
    }

    /// Whether it has to be left alone, shorted, before it can begin: it draws `ma`.
    pub(super) fn fades(&mut self, at: Instant, ma: i32) -> bool {
        let Start::Fades(looks) = self.start else { return false };
        if looks > 0 && i64::from(ma.abs()) > MARGIN_MA {
            self.start = Start::Fades(looks - 1);
            return true;
        }
        *self = Self { at, since: at, ma, place: self.place, start: Start::Stands, ..Self::AT_REST };
        false
    }

    /// The first push of a motor that stood.
    fn begins(&mut self, model: &mut Model, duty: i32) {
        if self.start != Start::Stands || duty == 0 {
            return;
        }
        self.start = Start::Over;
        if self.limited {
            model.stood_at_limit();
            self.start = Start::Fades(FADES);
        } else if self.ma.abs() >= TELLING_MA {
            model.stood(duty, self.ma);
        }
    }

    /// What has happened since the last look, and how fast the motor is now. Whether edges have stayed out.
    pub(super) fn observe(&mut self, at: Instant, model: &mut Model, drives: Drives) -> bool {
        let limit_ma = i64::from(drives.limit_ma);
        let ma = i64::from(self.ma);
        self.limited = ma.abs() >= limit_ma;
        self.begins(model, drives.duty);
        let voltage = model.of_duty(drives.duty);
        let then = if self.limited {
            let bound = voltage - model.lost(ma);
            if ma > 0 { self.speed.min(bound) } else { self.speed.max(bound) }
        } else {
            voltage - model.lost(ma)
        };
        let mistake = then - self.speed;
        // What should have moved and stands is held by friction, however little is missing.
        let least = model.lost(MARGIN_MA);
        let stands = !self.limited && then.abs() <= least;
        self.held = stands && (self.held || self.speed.abs() > least);
        let tells = !self.limited && then.abs() > least && at.since(self.at) == LOOK;
        if let Some(answer) = self.response.looked(then, voltage - then, tells) {
            model.answered(answer);
        }
        if self.held {
            self.load = voltage;
        } else if !self.limited {
            self.load -= mistake * model.inverse / BELIEVED;
        }
        let limit = model.lost(limit_ma);
        let push = (voltage - then).min(limit).max(-limit);
        let change = if self.held { -then } else { (push - self.load) * model.gain };
        let part = looks(at.since(self.since).min(LOOK));
        let way = part * (then + change - change * part / 2);
        let before = looks(self.since.since(self.at).min(LOOK));
        let before = before * (then + change * before / 2) + mistake * self.doubt;
        let times = self.fit.looked(before, way, !self.held && !self.limited);
        let place = self.place + mistake * self.doubt + way;
        self.place = place.clamp(I40F24::ZERO, I40F24::ONE);
        if !self.limited {
            self.missed += (place - self.place).abs();
        }
        (self.told, self.speed, self.since, self.doubt) = (then, then + change, at, part / 2);
        if let Some(times) = times {
            model.turns(times);
            (self.speed, self.load, self.response) = (self.speed * times, self.load * times, Response::NEW);
        }
        let stayed_out = self.missed > MISSED;
        if stayed_out {
            self.missed = I40F24::ZERO;
        }
        stayed_out
    }
}

/// A speed in other counts: `to` for `from`.
pub(super) fn scaled(speed: I40F24, to: i64, from: i64) -> I40F24 {
    I40F24::from_bits(speed.to_bits() * to / from.max(1))
}

/// One by the other, of the same sign; as much as there is if the other is nothing.
pub(super) fn ratio(one: I40F24, other: I40F24) -> I40F24 {
    I40F24::from_bits((one.to_bits() << 24).checked_div(other.to_bits()).unwrap_or(i64::MAX))
}

/// In looks.
fn looks(span: Duration) -> I40F24 {
    I40F24::from_bits(((span.ticks() << 24) / LOOK.ticks()).cast_signed())
}

#[cfg(test)]
mod tests {
    #![expect(clippy::float_arithmetic, reason = "mathematics that is not the code's")]

    use super::*;
    use crate::rs434::servo::Settings;

    /// 3,000 rpm and 4 pulses: 0.8 counts in a look at 24 V; of it 0.5 Ω take a 48,000th for each mA.
    const SETTINGS: Settings = Settings {
        speed: 1_000,
        acc: 100,
        dec: 100,
        rated: 3_000,
        pulses: 4,
        halls: 2,
        limit_ma: 20_000,
        closed: false,
    };
    const FULL: f64 = 0.8;

    fn lost(ma: i32) -> f64 {
        FULL * f64::from(ma) / 48_000.0
    }

    #[track_caller]
    fn assert_near(is: I40F24, should: f64) {
        let is = is.to_num::<f64>();
        assert!((is - should).abs() < 0.002, "{is} is not {should}");
    }

    /// Look after look at a motor that draws so much at that duty, and makes its edges if it turns. What has
    /// been seen, and whether edges stayed out.
    fn watched(duty: i32, ma: i32, edges: bool) -> (Seen, bool) {
        let mut model = Model::of(&SETTINGS);
        let (mut seen, mut at, mut stayed_out) = (Seen::AT_REST, Instant::ZERO, false);
        let speed = FULL * f64::from(duty) / 65_536.0 - lost(ma);
        let mut place = 0.5;
        seen.begin(at, ma);
        for _ in 0..100 {
            let next = place + speed;
            if edges && next >= 1.0 {
                let part = (1.0 - place) / speed;
                seen.edge(at + Duration::from_ticks((part * LOOK.ticks() as f64) as u64), true);
            }
            place = next.fract();
            at += LOOK;
            stayed_out |= seen.observe(at, &mut model, Drives { duty, limit_ma: SETTINGS.limit_ma });
            if edges {
                assert!((seen.place.to_num::<f64>() - place).abs() < 0.05 || at < Instant::ZERO + LOOK * 20);
            }
            seen.looked(at, ma);
        }
        (seen, stayed_out)
    }

    #[test]
    fn the_current_tells_speed_and_load() {
        for (duty, ma) in [(32_768, 1_000), (65_536, 5_000), (16_384, 131), (32_768, -2_000)] {
            let (seen, stayed_out) = watched(duty, ma, true);
            assert_near(seen.speed, FULL * f64::from(duty) / 65_536.0 - lost(ma));
            assert_near(seen.load, lost(ma));
            assert!(!stayed_out && !seen.limited && !seen.held);
        }
    }

    #[test]
    fn what_turns_without_edges_is_noticed() {
        assert!(watched(32_768, 1_000, false).1);
    }

    #[test]
    fn what_draws_all_that_the_voltage_gives_stands() {
        // 12 V in 0.5 Ω are 24 A, 6 V 12 A.
        let (seen, stayed_out) = watched(16_384, 12_000, false);
        assert_near(seen.speed, 0.0);
        assert!(!stayed_out);
    }

    #[test]
    fn a_current_at_its_limit_tells_only_how_fast_it_is_at_most() {
        let (seen, stayed_out) = watched(65_536, 20_000, false);
        assert!(seen.limited && !stayed_out);
        // And so much more it gets in a ms by 20 A, which are 1.53 N·m on 400 g·cm².
        assert!(seen.speed.to_num::<f64>() <= FULL - lost(20_000) + 0.0973);
    }
}
