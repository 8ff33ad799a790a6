//! When the steps of a move are due, by mathematics that knows nothing of plans.

use standin_protocol::time::{Duration, TICKS_PER_SECOND};

/// Parts of a tick that are counted on the way; only the result is rounded.
const PARTS: u128 = 1 << 20;

/// The instants of the steps of a move from standstill to standstill, since its beginning, to the
/// nearest tick: `steps` of them, speeding up and slowing down with `acceleration` in steps/s², at
/// `speed` in steps/s in between if it gets there.
///
/// Step *n* of the ramp is made at sqrt(2n/a), and of the cruise at v/2a + n/v; the end mirrors the
/// beginning. Neither rate may be 0.
pub fn step_instants(steps: u32, speed: u32, acceleration: u32) -> impl Iterator<Item = Duration> {
    let [count, v, a] = [steps, speed, acceleration].map(u128::from);
    let second = u128::from(TICKS_PER_SECOND) * PARTS;
    let ramp = move |n: u128| (2 * n * second * second / a).isqrt();
    let reaches_speed = v * v <= a * count;
    let end = if reaches_speed {
        second * v / a + second * count / v
    } else {
        (4 * count * second * second / a).isqrt()
    };
    (1..=count).map(move |n| {
        let left = count - n;
        let parts = if n <= left && 2 * a * n <= v * v {
            ramp(n)
        } else if left <= n && 2 * a * left <= v * v {
            end - ramp(left)
        } else {
            second * v / (2 * a) + second * n / v
        };
        Duration::from_ticks(((parts + PARTS / 2) / PARTS) as u64)
    })
}

#[cfg(test)]
mod tests {
    use super::step_instants;
    use standin_protocol::time::{Duration, Span};

    #[test]
    fn the_factory_move_of_an_md3() {
        // 5000²/(2·10,000) = 1250 steps in half a second, 7500 at 5000 a second, 1250 to stop.
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
