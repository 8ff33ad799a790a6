//! JSON merge patches (RFC 7396).

use serde_json::{Map, Value};

/// The patch that makes `new` of `old`; `None` if they are equal. Both are objects without nulls.
pub(super) fn merge_patch(old: &Value, new: &Value) -> Option<Value> {
    if old == new {
        return None;
    }
    let (Value::Object(before), Value::Object(after)) = (old, new) else { return Some(new.clone()) };
    let mut patch = Map::new();
    for (name, value) in after {
        let change = match before.get(name) {
            // A patch that is an object changes an object, and replaces anything else by what it has.
            Some(held) => merge_patch(held, value),
            None => Some(value.clone()),
        };
        patch.extend(change.map(|change| (name.clone(), change)));
    }
    let gone = before.keys().filter(|name| !after.contains_key(*name));
    patch.extend(gone.map(|name| (name.clone(), Value::Null)));
    Some(Value::Object(patch))
}

/// Removes members that are null, which a state does not have.
pub(super) fn without_nulls(value: Value) -> Value {
    match value {
        Value::Object(members) => {
            let members = members.into_iter().filter(|(_, value)| !value.is_null());
            Value::Object(members.map(|(name, value)| (name, without_nulls(value))).collect())
        }
        other => other,
    }
}

#[cfg(test)]
pub(super) mod tests {
    use proptest::prelude::*;
    use serde_json::json;

    use super::*;

    /// Applies a patch as RFC 7396, section 2 says.
    pub(in crate::live) fn apply(target: &mut Value, patch: &Value) {
        let Value::Object(members) = patch else {
            target.clone_from(patch);
            return;
        };
        if !target.is_object() {
            *target = json!({});
        }
        let Some(object) = target.as_object_mut() else { return };
        for (name, value) in members {
            if value.is_null() {
                object.remove(name);
            } else {
                apply(object.entry(name.clone()).or_insert(Value::Null), value);
            }
        }
    }

    fn states() -> impl Strategy<Value = Value> {
        let leaf = prop_oneof![
            any::<bool>().prop_map(Value::from),
            (0..3).prop_map(Value::from),
            "[ab]{0,2}".prop_map(Value::from),
            prop::collection::vec(0..3, 0..3).prop_map(Value::from),
        ];
        let objects = leaf.prop_recursive(3, 24, 4, |inner| {
            prop::collection::btree_map("[a-d]", inner, 0..4)
                .prop_map(|members| Value::Object(members.into_iter().collect()))
        });
        prop::collection::btree_map("[a-d]", objects, 0..4)
            .prop_map(|members| Value::Object(members.into_iter().collect()))
    }

    proptest! {
        #[test]
        fn a_patch_makes_the_new_of_the_old(old in states(), new in states()) {
            let mut made = old.clone();
            match merge_patch(&old, &new) {
                Some(patch) => apply(&mut made, &patch),
                None => prop_assert_eq!(&old, &new),
            }
            prop_assert_eq!(made, new);
        }
    }

    /// The example of RFC 7396, section 3, without its member that stays null.
    #[test]
    fn the_example_of_the_rfc() {
        let old = json!({"title": "Goodbye!", "author": {"givenName": "John", "familyName": "Doe"},
            "tags": ["example", "sample"], "content": "This will be unchanged"});
        let new = json!({"title": "Hello!", "author": {"givenName": "John"}, "tags": ["example"],
            "content": "This will be unchanged", "phoneNumber": "+01-123-456-7890"});
        let patch = json!({"title": "Hello!", "author": {"familyName": null}, "tags": ["example"],
            "phoneNumber": "+01-123-456-7890"});
        assert_eq!(merge_patch(&old, &new), Some(patch));
    }

    #[test]
    fn a_state_has_no_nulls() {
        let value = json!({"a": null, "b": {"c": null, "d": [null]}});
        assert_eq!(without_nulls(value), json!({"b": {"d": [null]}}));
    }
}
