//! What somebody may have meant who mistyped a name.

use std::fmt::Write as _;

/// One sentence: there is no `what` of that `name`, and which one comes next to it.
pub(crate) fn unknown<'a>(what: &str, name: &str, names: impl Iterator<Item = &'a str>) -> String {
    let mut sentence = format!("there is no {what} '{name}'");
    let lower = name.to_lowercase();
    let nearest = names.min_by_key(|other| strsim::damerau_levenshtein(&lower, &other.to_lowercase()));
    if let Some(nearest) = nearest {
        let _ = write!(sentence, "; the nearest is '{nearest}'");
    }
    sentence
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
    }
}
