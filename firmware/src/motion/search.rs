//! The only search of planning. It may take time, so only the main loop uses it and an interrupt never does.

/// The least number for which `predicate` is true; `predicate` must be true for every greater number, too.
/// The search first doubles a number until `predicate` is true, then halves the interval. No number tried is
/// more than twice the answer.
pub(super) fn first_true(mut predicate: impl FnMut(u64) -> bool) -> u64 {
    let (mut low, mut high) = (0, 1 << 62);
    while low < high {
        let tried = (2 * low).min(low + (high - low) / 2);
        if predicate(tried) { high = tried } else { low = tried + 1 }
    }
    low
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_least_number_is_found_without_going_far_beyond(answer in 0..1_u64 << 50) {
            let mut furthest = 0;
            let found = first_true(|n| { furthest = furthest.max(n); n >= answer });
            prop_assert_eq!(found, answer);
            prop_assert!(furthest <= (2 * answer).max(1));
        }
    }
}
