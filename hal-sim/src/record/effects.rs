//! Effects of line faults on a frame, for journals.

use std::fmt;

/// Effect of a line or TCP port on a frame. Each effect of a fault has the name of the fault in bench files.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum FrameEffect {
    /// `drop`.
    Dropped,
    /// `mute`.
    Muted,
    /// `truncate`.
    Truncated,
    /// `corrupt`.
    Corrupted,
    /// `duplicate`.
    Duplicated,
    /// `wrong_address`.
    Readdressed,
    /// `wrong_transaction`.
    WrongTransaction,
    /// `delay_ms`.
    Delayed,
    /// `close`.
    Closed,
    /// `noise` after the frame or, on a TCP port, before it.
    WithNoise,
    /// The frame itself is `noise`.
    IsNoise,
    /// The drive takes the frame for the rest of a truncated one.
    Swallowed,
    /// The frame overlapped other characters on the line, which is no fault.
    Collided,
}

impl FrameEffect {
    /// All effects, with their words in a sentence about a frame.
    const ALL: [(Self, &'static str); 13] = [
        (Self::Dropped, "was dropped"),
        (Self::Muted, "was not delivered"),
        (Self::Truncated, "was truncated"),
        (Self::Corrupted, "was corrupted"),
        (Self::Duplicated, "was sent twice"),
        (Self::Readdressed, "had a wrong address"),
        (Self::WrongTransaction, "had a wrong transaction"),
        (Self::Delayed, "was delayed"),
        (Self::Closed, "was cut off by the end of the connection"),
        (Self::WithNoise, "had noise beside it"),
        (Self::IsNoise, "was noise"),
        (Self::Swallowed, "was taken for the rest of the one before"),
        (Self::Collided, "collided"),
    ];
}

/// Effects of faults on one frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct FrameEffects(u16);

impl FrameEffects {
    /// No effects.
    pub const NONE: Self = Self(0);

    /// These effects and, if `acts`, another one.
    #[must_use]
    pub const fn with(self, effect: FrameEffect, acts: bool) -> Self {
        if acts { Self(self.0 | 1 << effect as u16) } else { self }
    }

    /// The effects of both.
    #[must_use]
    pub const fn and(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Returns true if there are no effects.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// The effects of faults among these.
    #[must_use]
    pub const fn of_faults(self) -> Self {
        Self(self.0 & !(1 << FrameEffect::Collided as u16))
    }

    /// Returns true if one of the effects is `effect`.
    #[must_use]
    pub const fn contains(self, effect: FrameEffect) -> bool {
        self.0 & 1 << effect as u16 != 0
    }
}

impl fmt::Display for FrameEffects {
    /// The effects as the end of a sentence: `was truncated and was delayed`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let words: Vec<&str> = FrameEffect::ALL
            .iter()
            .filter(|(effect, _)| self.contains(*effect))
            .map(|&(_, words)| words)
            .collect();
        f.write_str(&words.join(" and "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn effects_are_a_set_in_words() {
        assert!(FrameEffects::NONE.is_empty());
        for (effect, words) in FrameEffect::ALL {
            let one = FrameEffects::NONE.with(effect, true);
            assert_eq!((one.contains(effect), one.to_string().as_str()), (true, words));
            assert_eq!(FrameEffects::NONE.with(effect, false), FrameEffects::NONE);
        }
        let two = FrameEffects::NONE.with(FrameEffect::Delayed, true).with(FrameEffect::Truncated, true);
        assert_eq!(two.to_string(), "was truncated and was delayed");
        assert_eq!(two.and(FrameEffects::NONE), two);
    }
}
