//! Memory use of a ring.

use std::collections::VecDeque;

/// Memory that a vector of `bytes` bytes uses. With one word for the allocator it is rounded up to a multiple
/// of two words, and to at least four words.
pub(crate) fn allocated(bytes: usize) -> usize {
    const WORD: usize = size_of::<usize>();
    if bytes == 0 { 0 } else { (bytes + WORD).next_multiple_of(2 * WORD).max(4 * WORD) }
}

/// Makes room for one more entry in the queue of a ring, with little spare capacity. A queue alone would
/// double its capacity; a ring uses all of it in turn, so half of the memory would be wasted.
pub(crate) fn make_room<T>(queue: &mut VecDeque<T>) {
    if queue.len() == queue.capacity() {
        queue.reserve_exact(queue.len() / 16 + 16);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_vectors_cost_what_the_allocator_takes() {
        let costs = [0, 1, 12, 24, 25, 40, 41, 100].map(allocated);
        // On a machine of 64 bits; on others it is half of this.
        if size_of::<usize>() == 8 {
            assert_eq!(costs, [0, 32, 32, 32, 48, 48, 64, 112]);
        }
    }

    #[test]
    fn a_queue_has_little_to_spare() {
        let mut queue = VecDeque::new();
        for n in 0..100_000_u64 {
            make_room(&mut queue);
            queue.push_back(n);
            assert!(queue.capacity() <= queue.len() + queue.len() / 16 + 16);
        }
    }
}
