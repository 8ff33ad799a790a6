//! The nearest valid name to a mistyped one.

use std::fmt::Write as _;

/// Maximum number of names that a message lists.
const FEW: usize = 16;

/// Maximum number of characters of a name that are compared. The time grows with both lengths, and a client
/// may send thousands of characters.
const MOST: usize = 64;

/// Returns a message that there is no `what` called `name`. The message includes the nearest name, or a list
/// of all names if none is near.
#[must_use]
pub fn unknown<'a>(what: &str, name: &str, names: impl Iterator<Item = &'a str>) -> String {
    unknown_at(what, name, "", names)
}

/// As [`unknown`], with a place after the name: ` on this bus`.
pub(crate) fn unknown_at<'a>(
    what: &str,
    name: &str,
    place: &str,
    names: impl Iterator<Item = &'a str>,
) -> String {
    let short = cut(name);
    let dots = if short.len() < name.len() { "…" } else { "" };
    let mut sentence = format!("there is no {what} '{short}{dots}'{place}");
    let names: Vec<&str> = names.collect();
    let lower = short.to_lowercase();
    let distance = |other: &&str| strsim::damerau_levenshtein(&lower, &cut(other).to_lowercase());
    // A name is near if at most half of its letters differ: `rs422` is near `rs485`.
    let near = (lower.chars().count() / 2).max(1);
    let nearest = names.iter().copied().min_by_key(distance).filter(|nearest| distance(nearest) <= near);
    if let Some(nearest) = nearest {
        let _ = write!(sentence, "; the nearest is '{nearest}'");
    } else if (1..=FEW).contains(&names.len()) {
        let _ = write!(sentence, "; available: {}", names.join(", "));
    }
    sentence
}

/// Returns true if a sentence, or a clause of it, is one of [`unknown`].
#[must_use]
pub fn is_unknown(sentence: &str) -> bool {
    // The name is in quotes: "there is no command in this program" is about no name.
    sentence.split("there is no ").skip(1).any(|rest| rest.contains(" '"))
}

/// The first characters of a name, at most `MOST`.
fn cut(name: &str) -> &str {
    name.char_indices().nth(MOST).map_or(name, |(end, _)| &name[..end])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_name_is_offered_whatever_its_case() {
        let names = ["DeviceAddress", "Speed", "SpeedselJogsProfile"];
        assert_eq!(
            unknown("register", "sped", names.into_iter()),
            "there is no register 'sped'; the nearest is 'Speed'"
        );
        assert_eq!(unknown("fault", "stall", [].into_iter()), "there is no fault 'stall'");
        assert!(is_unknown(&format!("--set: {}", unknown("register", "sped", names.into_iter()))));
        assert!(!is_unknown("x has no power"));
        assert!(!is_unknown("--program: 'a.rsasm': line 1: there is no command in this program"));
    }

    #[test]
    fn of_a_long_name_only_the_beginning_counts() {
        let long = "ä".repeat(100_000);
        let names: Vec<String> = (0..1_000).map(|n| format!("{long}{n}")).collect();
        let sentence = unknown("drive", &long, names.iter().map(String::as_str));
        assert!(sentence.starts_with(&format!("there is no drive '{}…'", "ä".repeat(64))));
    }

    #[test]
    fn where_no_name_is_near_those_that_there_are_are_listed() {
        let kinds = ["md3", "md1"];
        let sentence = "there is no kind 'qsb-d'; available: md3, md1";
        assert_eq!(unknown("kind", "qsb-d", kinds.into_iter()), sentence);
        assert_eq!(unknown("pin", "D5", ["J2.2"; FEW + 1].into_iter()), "there is no pin 'D5'");
    }
}
