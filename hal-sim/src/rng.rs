//! Repeatable random numbers: one stream for each seed and name.

/// Increment from one state to the next.
const STRIDE: u64 = 0x9E37_79B9_7F4A_7C15;

/// A stream of pseudo-random numbers (SplitMix64).
#[derive(Clone, Debug)]
pub(crate) struct Rng {
    state: u64,
}

impl Rng {
    /// The stream for `name` on a bench with the seed `seed`.
    pub(crate) fn new(seed: u64, name: &str) -> Self {
        // FNV-1a, because it gives the same stream for a name on every host.
        let state = name.bytes().fold(0xCBF2_9CE4_8422_2325 ^ seed, |state, byte| {
            (state ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01B3)
        });
        let mut rng = Self { state };
        rng.state = rng.next();
        rng
    }

    /// The next number.
    pub(crate) fn next(&mut self) -> u64 {
        self.skip(1);
        let mut z = self.state;
        z = (z ^ z >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ z >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ z >> 31
    }

    /// Returns true with probability `share`; never if `share` is 0 or less, always if it is 1 or more.
    pub(crate) fn gen_bool(&mut self, share: f64) -> bool {
        // A float from 0 to 1 has a precision of 53 bits.
        let throw = (self.next() >> 11) as f64 / (1_u64 << 53) as f64;
        throw < share
    }

    /// Skips that many numbers.
    pub(crate) fn skip(&mut self, numbers: u64) {
        self.state = self.state.wrapping_add(STRIDE.wrapping_mul(numbers));
    }

    /// A new stream whose initial state is a number from another stream.
    pub(crate) fn branch(number: u64) -> Self {
        Self { state: number }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stream_depends_on_seed_and_name_alone() {
        let first = |seed, name| Rng::new(seed, name).next();
        assert_eq!(first(1, "x"), first(1, "x"));
        assert_ne!(first(1, "x"), first(2, "x"));
        assert_ne!(first(1, "x"), first(1, "y"));
    }

    #[test]
    fn numbers_left_out_are_those_that_would_have_come() {
        let (mut thrown, mut skipped) = (Rng::new(1, "x"), Rng::new(1, "x"));
        for _ in 0..1_000 {
            thrown.next();
        }
        skipped.skip(1_000);
        assert_eq!(thrown.next(), skipped.next());
    }

    #[test]
    fn a_share_is_one_of_many() {
        let mut rng = Rng::new(1, "x");
        let mut count = |share| (0..10_000).filter(|_| rng.gen_bool(share)).count();
        assert_eq!((count(0.0), count(1.0), count(f64::NAN)), (0, 10_000, 0));
        // The tolerance is 4 σ = 4·√(10,000·0.3·0.7).
        assert!(count(0.3).abs_diff(3_000) < 184);
    }
}
