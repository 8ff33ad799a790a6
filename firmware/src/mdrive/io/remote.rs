//! Channels of a remote encoder, filtered by FM (MC 5-26).

use crate::debounce::Debounce;
use crate::device::{Duration, Instant};
use crate::mdrive::motion::Channel;

const CHANNELS: [Channel; 3] = [Channel::A, Channel::B, Channel::Index];

/// Channels A, B and index. Each is `None` while nothing drives it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Remote {
    seen: [Option<Debounce>; 3],
}

impl Remote {
    /// No remote encoder is connected.
    pub(super) const OPEN: Self = Self { seen: [None; 3] };

    /// Sets the level of a channel, which takes effect once it has lasted for `min_time`; `None` if nothing
    /// drives the channel any more. A channel that starts or stops being driven is not filtered. Returns true
    /// if the level takes effect now.
    pub(super) fn sample(
        &mut self,
        at: Instant,
        channel: Channel,
        level: Option<bool>,
        min_time: Duration,
    ) -> bool {
        let Some(seen) = self.seen.get_mut(channel as usize) else { return false };
        match (seen, level) {
            (Some(seen), Some(level)) => seen.sample(at, level, min_time),
            (seen, level) => {
                let changes = seen.is_some() != level.is_some();
                *seen = level.map(Debounce::new);
                changes
            }
        }
    }

    pub(super) fn deadline(&self) -> Instant {
        self.seen.iter().flatten().fold(Instant::NEVER, |first, seen| first.min(seen.due()))
    }

    /// Channels whose new level has lasted long enough and takes effect now.
    pub(super) fn timeout(&mut self, at: Instant) -> impl Iterator<Item = (Channel, bool)> + use<> {
        let changed = self.seen.each_mut().map(|seen| {
            let seen = seen.as_mut()?;
            seen.timeout(at).then_some(seen.level())
        });
        CHANNELS.into_iter().zip(changed).filter_map(|(channel, level)| Some((channel, level?)))
    }
}
