//! Queues between an interrupt and the loop.

use core::cell::RefCell;

use critical_section::Mutex;
use heapless::Deque;

/// A queue that interrupts and the loop share. `heapless::spsc` would need no critical sections, but it
/// divides by a length that is known only at run time, and that can panic (PROJECT-12).
#[derive(Debug)]
pub struct Queue<T, const N: usize>(Mutex<RefCell<Deque<T, N>>>);

impl<T, const N: usize> Queue<T, N> {
    /// An empty queue.
    #[expect(clippy::new_without_default, reason = "a static needs a constant")]
    pub const fn new() -> Self {
        Self(Mutex::new(RefCell::new(Deque::new())))
    }

    /// Adds an item at the end. Returns `false` if there is no room.
    #[must_use]
    pub fn push(&self, thing: T) -> bool {
        self.with(|queue| queue.push_back(thing).ok()).is_some()
    }

    /// Takes the first item.
    pub fn pop(&self) -> Option<T> {
        self.pop_if(|_| true)
    }

    /// Takes the first item if `is` accepts it.
    pub fn pop_if(&self, is: impl FnOnce(&T) -> bool) -> Option<T> {
        self.with(|queue| if is(queue.front()?) { queue.pop_front() } else { None })
    }

    /// Number of waiting items.
    pub fn len(&self) -> usize {
        self.with(|queue| Some(queue.len())).unwrap_or(N)
    }

    /// Returns whether the queue is empty.
    pub fn is_empty(&self) -> bool {
        self.with(|queue| queue.front().map(|_| ())).is_none()
    }

    /// Returns whether the queue is full.
    pub fn is_full(&self) -> bool {
        self.with(|queue| queue.is_full().then_some(())).is_some()
    }

    /// Calls `act` with the queue. In a critical section there is no other borrow, so only `act` returns
    /// `None`.
    fn with<R>(&self, act: impl FnOnce(&mut Deque<T, N>) -> Option<R>) -> Option<R> {
        critical_section::with(|cs| act(&mut *self.0.borrow(cs).try_borrow_mut().ok()?))
    }
}
