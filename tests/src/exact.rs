//! The exact instants of steps, computed from constant acceleration without a plan: real numbers from square
//! roots, in 1/65,536 tick or as floating point of exact radicands.
//!
//! With *h* = speed · ticks/s, and distances (`way`) in which a step is 2·(ticks/s)², speed and distance
//! satisfy h² = h₀² + a·way, and a change of speed by Δh takes Δh/a ticks.

use drivetwin_firmware::motion::Limits;
use drivetwin_protocol::time::{Duration, TICKS_PER_SECOND};
use fixed::types::{I24F8, U24F8};

/// A step in the unit of `way`.
pub const STEP: u128 = 2 * (TICKS_PER_SECOND as u128) * (TICKS_PER_SECOND as u128);
/// A tick in the unit of an instant.
pub const TICK: i128 = 1 << 16;

/// A speed in 1/256 step/s as *h*.
#[must_use]
pub fn h(bits: u32) -> u128 {
    u128::from(bits) * u128::from(TICKS_PER_SECOND) / 256
}

/// A profile move.
pub struct Move {
    steps: u32,
    start: u128,
    speed: u128,
    up: u128,
    down: u128,
    /// Distances at which the ramp up ends and the ramp down begins.
    ramps: [u128; 2],
    end: i128,
}

impl Move {
    /// A move of `steps` steps. Its distance times up·down/(up + down) must fit into 96 bits.
    #[must_use]
    pub fn of(steps: u32, rates: Limits) -> Self {
        let speed = h(rates.max_speed.to_bits());
        let start = h(rates.start_speed.to_bits()).min(speed);
        let (up, down) = (u128::from(rates.acceleration), u128::from(rates.deceleration));
        let way = u128::from(steps) * STEP;
        let gained = speed * speed - start * start;
        let (mut first, mut last) = (gained / up, gained / down);
        let mut cruise = 0;
        if first + last > way {
            // The ramps meet: first·up = last·down.
            first = way * down / (up + down);
            last = way - first;
        } else {
            cruise = (((way - first - last) << 16) / (2 * speed)) as i128;
        }
        let end = ramp(start, up, first) + cruise + ramp(start, down, last);
        Self { steps, start, speed, up, down, ramps: [first, way - last], end }
    }

    /// Instant at which the move ends.
    #[must_use]
    pub fn end(&self) -> i128 {
        self.end
    }

    /// The last steps of the ramp up and of the cruise.
    #[must_use]
    pub fn seams(&self) -> [u32; 2] {
        self.ramps.map(|way| (way / STEP) as u32)
    }

    /// Instant of step `n`, counted from 1.
    #[must_use]
    pub fn step(&self, n: u32) -> i128 {
        let way = u128::from(n) * STEP;
        let [first, last] = self.ramps;
        if way <= first {
            ramp(self.start, self.up, way)
        } else if way <= last {
            ramp(self.start, self.up, first) + (((way - first) << 16) / (2 * self.speed)) as i128
        } else {
            self.end - ramp(self.start, self.down, u128::from(self.steps) * STEP - way)
        }
    }
}

/// Instants of the steps of a move, measured from its start and rounded to the nearest tick. The move starts
/// and ends at standstill, accelerates and decelerates with `acceleration` in steps/s², and reaches at most
/// `speed` in steps/s. Neither may be 0.
pub fn step_instants(steps: u32, speed: u32, acceleration: u32) -> impl Iterator<Item = Duration> {
    let exact = Move::of(steps, Limits::even(U24F8::from_num(speed), acceleration));
    (1..=steps).map(move |n| Duration::from_ticks(((exact.step(n) + TICK / 2) / TICK) as u64))
}

/// Time that the distance `way` takes from the speed `start` with acceleration `a`.
fn ramp(start: u128, a: u128, way: u128) -> i128 {
    ((((start * start + a * way) << 32).isqrt() - (start << 16)) / a) as i128
}

/// A jog in exact arithmetic: an order takes effect at its tick; standstill resets the phase.
#[derive(Default)]
pub struct Jog {
    /// Tick of the last order.
    tick: u64,
    target: i128,
    a: i128,
    /// At `tick`: distance since standstill, speed, and the direction in which both count.
    way: i128,
    speed: i128,
    sign: i128,
    /// Steps since standstill.
    made: i128,
}

/// Constant acceleration: *τ* ticks after the order the distance is `way + τ·(2·speed + a·τ)`.
struct Piece {
    way: i128,
    speed: i128,
    a: i128,
    sign: i128,
    /// End of the piece, if it has one: its time multiplied by the acceleration of the order, and its
    /// distance.
    end: Option<(i128, i128)>,
}

impl Piece {
    fn way(&self, ticks: i128) -> i128 {
        self.way + ticks * (2 * self.speed + self.a * ticks)
    }

    /// Time at which the distance is `way`, in ticks after the order.
    fn time(&self, way: i128) -> f64 {
        if self.a == 0 {
            return (way - self.way) as f64 / (2 * self.speed) as f64;
        }
        let speed = (self.speed * self.speed + self.a * (way - self.way)) as f64;
        (speed.sqrt() - self.speed as f64) / self.a as f64
    }
}

impl Jog {
    /// Accelerates towards `target` from now on, through standstill if the direction changes.
    pub fn order(&mut self, target: I24F8, a: u32) {
        self.target = h(target.unsigned_abs().to_bits()) as i128 * if target < 0 { -1 } else { 1 };
        self.a = i128::from(a);
        if self.speed == 0 {
            (self.way, self.made, self.sign) = (0, 0, self.target.signum());
        }
    }

    fn pieces(&self) -> Vec<Piece> {
        let (way, v, sign, target) = (self.way, self.speed, self.sign, self.target * self.sign);
        // A ramp from `v` to `to`, both in the direction `sign`, then a cruise. The cruise is the tangent at
        // the end of the ramp.
        let reach = |way: i128, v: i128, to: i128, sign| {
            let a = if to < v { -self.a } else { self.a };
            let ramp =
                Piece { way, speed: v, a, sign, end: Some(((to - v).abs(), way + (to * to - v * v) / a)) };
            [ramp, Piece { way: way - (to - v) * (to - v) / a, speed: to, a: 0, sign, end: None }]
        };
        if target > 0 {
            return reach(way, v, target, sign).into();
        }
        let [stop, _] = reach(way, v, 0, sign);
        let mut pieces = vec![stop];
        if target < 0 {
            // Reversing equals a ramp in the direction `-sign` that began at the speed −v.
            pieces.extend(reach(v * v / self.a, -v, -target, -sign));
        }
        pieces
    }

    /// Advances to the tick `until` and appends the instants of the steps, in ticks, each with true for
    /// forward.
    pub fn walk(&mut self, until: u64, steps: &mut Vec<(f64, bool)>) {
        let ticks = i128::from(until - self.tick);
        let from = std::mem::replace(&mut self.tick, until) as f64;
        for piece in self.pieces() {
            if piece.sign != self.sign {
                (self.sign, self.made) = (piece.sign, 0);
            }
            let end = piece.end.filter(|(time, _)| *time <= ticks * self.a);
            let way = end.map_or_else(|| piece.way(ticks), |(_, way)| way);
            while (self.made + 1) * STEP as i128 <= way {
                self.made += 1;
                steps.push((from + piece.time(self.made * STEP as i128), piece.sign > 0));
            }
            if end.is_none() {
                (self.way, self.speed) = (way, piece.speed + piece.a * ticks);
                return;
            }
        }
        self.speed = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::step_instants;
    use drivetwin_protocol::time::{Duration, Span};

    #[test]
    fn the_factory_move_of_an_md3() {
        // 5000²/(2·10,000) = 1250 steps in half a second, 7500 at 5000 steps/s, 1250 to stop.
        let instants: Vec<Duration> = step_instants(10_000, 5_000, 10_000).collect();
        assert_eq!(instants.len(), 10_000);
        assert_eq!(instants[1_249], 500.millis());
        assert_eq!(instants[4_999], 1_250.millis());
        assert_eq!(instants[8_749], 2_000.millis());
        assert_eq!(instants[9_999], 2_500.millis());
        // sqrt(2/10,000) s = 14.142136 ms.
        assert_eq!(instants[0].ticks(), 226_274);
        assert_eq!(instants[9_998].ticks(), 40_000_000 - 226_274);
    }

    #[test]
    fn a_triangle() {
        // 2·sqrt(101/10,000) s
        let instants: Vec<Duration> = step_instants(101, 5_000, 10_000).collect();
        assert_eq!(instants[100].ticks(), 3_215_960);
        assert!(instants.is_sorted());
    }
}
