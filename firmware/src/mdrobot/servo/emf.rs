//! What the current tells of the speed: of the voltage, what is not lost in the winding the motor makes itself.
//!
//! Edges are rare while it turns slowly; the back-EMF is there at any time, and says at once what has changed. But
//! how fast the motor turns is for the sensors to say, whatever registers tell about them: so what a rpm is worth is
//! learnt from their edges.

use fixed::types::I40F24;

use super::pi::FULL;
use crate::device::{Duration, Instant};
use crate::mdrobot::drive::MOTOR;
use crate::mdrobot::registers::SUPPLY;

/// What a mA loses in the winding of [`MOTOR`], as a duty at [`SUPPLY`], 0.8; or in 10 mΩ.
const LOST: I40F24 =
    I40F24::from_bits(FULL.to_bits() * MOTOR.resistance_mohm as i64 / (MOTOR.supply_mv as i64 * 1_000));
const LEAST_LOST: I40F24 = I40F24::lit("0.0273");
/// What a current that measures it may be off by, in mA: rounding, and what its speed changes in that instant.
const OFF_MA: i64 = 2;
/// How much more duty measures it, for an instant: some 5 A, so that rounding makes less of the current than
/// [`STILL_DUTY`]; and no more than this part of the limit, so that a winding of a quarter of the usual is measured, too.
const PROBE: i32 = 4_000;
const PROBE_PART: u32 = 4;
/// There and back on the wires.
const SOON: Duration = Duration::from_ticks(8);
/// The duty for a rpm of [`MOTOR`] at [`SUPPLY`], to five places. It is learnt in these bounds.
const PER_RPM: I40F24 = I40F24::lit("17.15602");
const _: () =
    assert!(PER_RPM.to_bits().abs_diff(FULL.to_bits() / MOTOR.no_load_rpm as i64) < (1 << 24) / 100_000);
const LEAST_PER_RPM: I40F24 = I40F24::lit("0.268");
const MOST_PER_RPM: I40F24 = I40F24::lit("1098");
/// Less is rounding: a mA is 0.8 of it.
const STILL_DUTY: I40F24 = I40F24::lit("3");
/// Counts that the motor should have made without an edge, or for each edge, after which its current is not believed:
/// it stands, and another winding or a broken wire makes believe that it turns. From rest a count may be almost one
/// more, and what a rpm is worth may be wrong by as much as poles or ENC_PPR are.
const MISSED_COUNTS: i64 = 4;
const MISSED_COUNTS_EACH: i64 = 16;
/// What edges say is believed by a part that grows with the time that they took, to a half in so many ms: ticks and
/// sensors that are not quite even show in shorter ones.
const LEARNT_MS: u64 = 64;
/// The part of its limit that is left to a current, which at the limit does not tell the speed; and some mA more.
const SPARED: u32 = 32;
const SPARED_MA: u32 = 2;
/// More than any current that matters.
const MOST_MA: i32 = 200_000;

/// A duty that is put for an instant.
#[derive(Clone, Copy, Debug)]
struct Probe {
    since: Instant,
    duty: i32,
    /// How much more duty that is, and what it drew before, in mA.
    more: i32,
    ma: i32,
}

/// In ms.
fn ms(span: Duration) -> I40F24 {
    const MS: u64 = Duration::millis(1).ticks();
    I40F24::from_bits(((span.ticks().min(1 << 38) << 24) / MS).cast_signed())
}

/// A duty at [`SUPPLY`], for the same voltage at another one.
fn at_supply(duty: I40F24, supply: u16) -> I40F24 {
    duty * i64::from(SUPPLY) / i64::from(supply.max(1))
}

/// What the current tells.
#[derive(Clone, Debug)]
pub(super) struct Emf {
    /// What feeds it, in 0.1 V.
    supply: u16,
    /// What it is put to.
    duty: i32,
    /// What its terminals may carry, in mA; 0 while they are open.
    limit_ma: u32,
    /// What it draws, in mA.
    ma: i32,
    /// What a mA loses in the winding, as a duty.
    lost: I40F24,
    /// That was measured since the motor was left alone.
    knows: bool,
    /// What it is put to so that its current tells what a mA loses.
    probed: Option<Probe>,
    /// The duty that makes as much back-EMF as it has at a rpm of the sensors.
    per_rpm: I40F24,
    /// The back-EMF, added up since the last window of edges began, times ms; and until when.
    way: I40F24,
    at: Instant,
    /// The way since an edge, without a gap.
    whole: bool,
    /// The sensors say that it turns the other way.
    opposed: bool,
}

impl Emf {
    /// Of open terminals, with that supply.
    pub(super) fn new(supply: u16) -> Self {
        Self {
            supply,
            duty: 0,
            limit_ma: 0,
            ma: 0,
            lost: at_supply(LOST, supply),
            knows: false,
            probed: None,
            opposed: false,
            per_rpm: at_supply(PER_RPM, supply),
            way: I40F24::ZERO,
            at: Instant::ZERO,
            whole: false,
        }
    }

    /// It is fed with that from now on: what was known of it holds for other duties.
    pub(super) fn fed(&mut self, at: Instant, supply: u16) {
        let before = core::mem::replace(&mut self.supply, supply);
        if supply == before {
            return;
        }
        let same = |duty: I40F24| duty * i64::from(before.max(1)) / i64::from(supply.max(1));
        self.lost = same(self.lost).min(PROBE.into());
        self.per_rpm = same(self.per_rpm).clamp(LEAST_PER_RPM, MOST_PER_RPM);
        self.probed = None;
        self.begin(at, false);
    }

    /// In mA.
    pub(super) fn ma(&self) -> i32 {
        self.ma
    }

    /// The duty for a rpm.
    pub(super) fn per_rpm(&self) -> I40F24 {
        self.per_rpm
    }

    /// A current, as the duty that it loses in the winding.
    pub(super) fn lost(&self, ma: i32) -> I40F24 {
        self.lost * I40F24::from_num(ma.clamp(-MOST_MA, MOST_MA))
    }

    /// What a limit of the current leaves to the duty, beyond the back-EMF.
    pub(super) fn spare(&self, limit_ma: u32) -> I40F24 {
        let fair = limit_ma - limit_ma / SPARED;
        self.lost(i32::try_from(fair.saturating_sub(SPARED_MA)).unwrap_or(MOST_MA)).min(2 * FULL)
    }

    /// Whether it was measured what the winding loses.
    pub(super) fn knows_winding(&self) -> bool {
        self.knows
    }

    /// It is to be measured again; what it was is as good a guess as any.
    pub(super) fn forget_winding(&mut self) {
        self.knows = false;
    }

    /// The duty to be put now, with that limit, so that the current tells what the winding loses: one that makes less
    /// of what it draws, and so stays away from the limit.
    pub(super) fn probe(&mut self, at: Instant, limit_ma: u32) -> i32 {
        let fair = i32::try_from(limit_ma / PROBE_PART).unwrap_or(MOST_MA);
        let more = self.lost(fair).to_num::<i32>().min(PROBE) * if self.ma > 0 { -1 } else { 1 };
        let duty = self.duty + more;
        self.probed = Some(Probe { since: at, duty, more, ma: self.ma });
        duty
    }

    /// It draws so many mA.
    pub(super) fn draws(&mut self, at: Instant, ma: i32) {
        self.go_on(at);
        self.ma = ma;
        let Some(probe) = self.probed.take() else { return };
        if at.since(probe.since) > SOON || self.is_limited() {
            return;
        }
        let made = I40F24::from_num(i64::from(ma) - i64::from(probe.ma));
        let usual = at_supply(LOST, self.supply);
        let lost = I40F24::from_num(probe.more).checked_div(made).unwrap_or(usual);
        if lost > 0 {
            let is_usual = (usual * made - I40F24::from_num(probe.more)).abs() <= usual * OFF_MA;
            let least = at_supply(LEAST_LOST, self.supply);
            (self.lost, self.knows) = (if is_usual { usual } else { lost.max(least) }, true);
        }
    }

    /// It is put to that duty, and may draw so much.
    pub(super) fn put(&mut self, at: Instant, duty: i32, limit_ma: u32) {
        self.go_on(at);
        (self.duty, self.limit_ma) = (duty, limit_ma);
        // What it draws from now on answers another duty.
        self.probed = self.probed.filter(|probe| probe.duty == duty);
    }

    /// Its sensors are read in other counts: `to` for `from` in a turn; or they are others.
    pub(super) fn rescale(&mut self, to: u32, from: Option<u32>) {
        self.per_rpm = match from {
            Some(from) => self.per_rpm * i64::from(to) / i64::from(from.max(1)),
            None => at_supply(PER_RPM, self.supply),
        }
        .clamp(LEAST_PER_RPM, MOST_PER_RPM);
        self.whole = false;
    }

    /// A window of edges begins, or something else that was not before.
    pub(super) fn begin(&mut self, at: Instant, is_edge: bool) {
        (self.way, self.at, self.whole) = (I40F24::ZERO, at, is_edge);
    }

    /// A window ends, of so many counts with so many in a turn, and the next begins.
    pub(super) fn learn(&mut self, at: Instant, counts: i32, span: Duration, turn: u32) {
        self.go_on(at);
        // The mean of the back-EMF is way/span, the speed 60,000/span·counts/turn.
        self.opposed = self.whole && self.way.signum() * i64::from(counts.signum()) < 0;
        let per_rpm = (self.way / 60_000)
            .saturating_mul(I40F24::from_num(turn))
            .checked_div(I40F24::from_num(counts))
            .unwrap_or(I40F24::ZERO);
        if self.whole && per_rpm > 0 {
            let part = ms(span.min(Duration::millis(LEARNT_MS))) / (2 * LEARNT_MS.cast_signed());
            let per_rpm = per_rpm.clamp(LEAST_PER_RPM, MOST_PER_RPM);
            self.per_rpm += (per_rpm - self.per_rpm) * part;
        }
        self.begin(at, true);
    }

    /// The back-EMF at present, as the duty that makes it; 0 if it would have brought edges long ago, of which there
    /// are `turn` in a turn and only `counts` have come.
    pub(super) fn now(&self, counts: i32, turn: u32) -> I40F24 {
        let count = self.per_rpm * 60_000 / i64::from(turn.max(1));
        let missed = MISSED_COUNTS + MISSED_COUNTS_EACH * i64::from(counts.unsigned_abs());
        if self.way.abs() > count.saturating_mul(I40F24::from_num(missed)) {
            I40F24::ZERO
        } else {
            self.felt()
        }
    }

    /// Whether the sensors say that it turns the other way.
    pub(super) fn is_opposed(&self) -> bool {
        self.opposed
    }

    /// Whether the limit holds its current.
    pub(super) fn is_limited(&self) -> bool {
        self.ma.unsigned_abs() >= self.limit_ma
    }

    fn felt(&self) -> I40F24 {
        let emf = I40F24::from_num(self.duty) - self.lost(self.ma);
        if emf.abs() < STILL_DUTY { I40F24::ZERO } else { emf.clamp(-4 * FULL, 4 * FULL) }
    }

    /// Adds up the way to `at`.
    pub(super) fn go_on(&mut self, at: Instant) {
        if self.limit_ma == 0 || self.is_limited() {
            self.whole = false;
        } else {
            self.way = self.way.saturating_add(self.felt().saturating_mul(ms(at.since(self.at))));
        }
        self.at = at;
    }
}
