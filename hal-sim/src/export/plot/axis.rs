//! Ticks of an axis, and numbers as people write them.

use drivetwin_firmware::device::Instant;
use drivetwin_protocol::time::TICKS_PER_SECOND;

/// A time in seconds, to the microsecond.
pub(super) fn seconds(at: Instant) -> f64 {
    (at.ticks() as f64 / TICKS_PER_SECOND as f64 * 1e6).round() / 1e6
}

/// Numbers at even distances of 1, 2 or 5 times a power of ten, from `least` to `most`: at most `count`.
pub(super) fn ticks(least: f64, most: f64, count: usize) -> Vec<f64> {
    let coarse = (most - least) / count.max(1) as f64;
    if !(coarse > 0.0 && coarse.is_finite()) {
        return vec![least];
    }
    let power = 10_f64.powf(coarse.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].map(|factor| factor * power);
    let step = step.into_iter().find(|step| *step >= coarse * (1.0 - 1e-9)).unwrap_or(10.0 * power);
    let first = (least / step - 1e-9).ceil() as i64;
    let last = (most / step + 1e-9).floor() as i64;
    (first..=last).map(|n| n as f64 * step).collect()
}

/// A number with as many decimals as the distance `step` of its neighbours needs, and commas between groups of
/// three digits.
pub(super) fn number(value: f64, step: f64) -> String {
    let decimals = if step > 0.0 { (-(step * 1.000_001).log10().floor()).max(0.0) as usize } else { 0 };
    let text = format!("{:.decimals$}", value.abs());
    let (whole, part) = text.split_once('.').map_or((text.as_str(), ""), |(whole, part)| (whole, part));
    let mut grouped = String::new();
    for (n, digit) in whole.chars().enumerate() {
        if n > 0 && (whole.len() - n) % 3 == 0 {
            grouped.push(',');
        }
        grouped.push(digit);
    }
    let is_zero = text.chars().all(|c| c == '0' || c == '.');
    let sign = if value < 0.0 && !is_zero { "−" } else { "" };
    let point = if part.is_empty() { "" } else { "." };
    format!("{sign}{grouped}{point}{part}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_numbers() {
        assert_eq!(ticks(0.0, 10.0, 5), [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]);
        assert_eq!(ticks(0.0, 3.0, 10).len(), 7);
        assert_eq!(ticks(-5_000.0, 5_000.0, 3), [-5_000.0, 0.0, 5_000.0]);
        assert_eq!(ticks(1.0, 1.0, 3), [1.0]);
    }

    #[test]
    fn numbers_have_groups_and_the_decimals_that_they_need() {
        assert_eq!(number(12_345_678.0, 1.0), "12,345,678");
        assert_eq!(number(-1_500.0, 500.0), "−1,500");
        assert_eq!(number(0.25, 0.05), "0.25");
        assert_eq!(number(2.0, 0.5), "2.0");
        assert_eq!(number(-0.0, 1.0), "0");
    }
}
