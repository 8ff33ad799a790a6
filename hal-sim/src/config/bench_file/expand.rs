//! Shorthand of bench files: variables, defaults of emulated drives, numbered tables.
//!
//! All of it is expanded before the tables are read. A copy of a numbered table has the positions of the
//! original, so an error in a copy points into the file.

use std::collections::BTreeSet;

use toml::Spanned;
use toml::de::{DeArray, DeTable, DeValue};

use super::table::LocatedError;
use crate::suggest;

/// Maximum number of copies of a table.
const MAX_COPIES: u64 = 10_000;

/// The keys of `[[drive]]` that cannot be defaults.
const OF_ONE_DRIVE: [&str; 3] = ["name", "board", "bus"];

/// Byte offsets of the strings that had a placeholder: such a string may also stand for a number.
pub(super) type Filled = BTreeSet<usize>;

/// Expands the shorthand of a bench file. `variable` returns the value of an environment variable.
///
/// # Errors
/// The first error, with its position.
pub(super) fn expand(
    root: &mut DeTable<'_>,
    variable: &dyn Fn(&str) -> Option<String>,
) -> Result<Filled, LocatedError> {
    let mut filled = Filled::new();
    for (_, value) in root.iter_mut() {
        replace(value, &mut filled, &|text| fill_variables(text, variable))?;
    }
    add_defaults(root)?;
    for (key, value) in root.iter_mut() {
        if let DeValue::Array(tables) = value.get_mut() {
            if key.get_ref() == "bus" {
                tables.iter_mut().try_for_each(expand_names_of_bus)?;
            }
            *tables = copies(std::mem::replace(tables, DeArray::new()), &mut filled)?;
        }
    }
    Ok(filled)
}

/// Replaces each string in a value by the result of `fill`; `None` leaves it unchanged.
fn replace(
    value: &mut Spanned<DeValue<'_>>,
    filled: &mut Filled,
    fill: &dyn Fn(&str) -> Result<Option<String>, String>,
) -> Result<(), LocatedError> {
    let at = value.span().start;
    match value.get_mut() {
        DeValue::String(text) => {
            if let Some(result) = fill(text).map_err(LocatedError::at(at))? {
                *text = result.into();
                filled.insert(at);
            }
            Ok(())
        }
        DeValue::Array(values) => values.iter_mut().try_for_each(|value| replace(value, filled, fill)),
        DeValue::Table(table) => table.iter_mut().try_for_each(|(_, value)| replace(value, filled, fill)),
        _ => Ok(()),
    }
}

/// Replaces `${NAME}` and `${NAME:-else}` in a text.
fn fill_variables(text: &str, variable: &dyn Fn(&str) -> Option<String>) -> Result<Option<String>, String> {
    let (mut result, mut rest) = (String::new(), text);
    while let Some((before, after)) = rest.split_once("${") {
        let (inside, behind) =
            after.split_once('}').ok_or_else(|| format!("'{text}' has a ${{ without a }}"))?;
        let (name, otherwise) = match inside.split_once(":-") {
            Some((name, otherwise)) => (name, Some(otherwise)),
            None => (inside, None),
        };
        // As in a shell, an empty variable counts as one that is not there.
        let value = variable(name).filter(|value| otherwise.is_none() || !value.is_empty());
        let value = value.or_else(|| otherwise.map(str::to_owned)).ok_or_else(|| {
            format!("there is no environment variable '{name}'; ${{{name}:-else}} has a default")
        })?;
        result.push_str(before);
        result.push_str(&value);
        rest = behind;
    }
    if rest.len() == text.len() {
        return Ok(None);
    }
    result.push_str(rest);
    Ok(Some(result))
}

/// Moves the keys of `[defaults.drive]` into each emulated `[[drive]]` that does not have them. Tables, like `set`, are
/// merged key by key. A drive on a board gets none, because it keeps what it is (BENCH-22).
fn add_defaults(root: &mut DeTable<'_>) -> Result<(), LocatedError> {
    let Some(defaults) = root.remove("defaults") else { return Ok(()) };
    let at = defaults.span().start;
    let wrong = |at: usize, what: String| Err(LocatedError { at, what });
    let DeValue::Table(tables) = defaults.into_inner() else {
        return wrong(at, "defaults must be a table; write [defaults.drive] above its keys".to_owned());
    };
    if tables.is_empty() {
        return wrong(
            at,
            "defaults has no keys; write [defaults.drive] and keys of drives below it".to_owned(),
        );
    }
    for (key, value) in tables {
        let at = key.span().start;
        if key.get_ref() != "drive" {
            return wrong(at, suggest::unknown("table of defaults", key.get_ref(), ["drive"].into_iter()));
        }
        let DeValue::Table(defaults) = value.into_inner() else {
            return wrong(at, "defaults must be a table; write [defaults.drive] above its keys".to_owned());
        };
        let own = OF_ONE_DRIVE.iter().find_map(|own| defaults.get_key_value(*own));
        if let Some((key, _)) = own {
            let what = format!("{} cannot be a default; give each [[drive]] its own", key.get_ref());
            return wrong(key.span().start, what);
        }
        let drives = match root.get_mut("drive").map(Spanned::get_mut) {
            Some(DeValue::Array(drives)) => drives,
            Some(_) => continue,
            None => {
                return wrong(
                    at,
                    "[defaults.drive] is for drives, and the file has none; add a [[drive]]".to_owned(),
                );
            }
        };
        let is_emulated = |drive: &DeTable<'_>| !drive.contains_key("board");
        let mut emulated = drives
            .iter_mut()
            .filter_map(|drive| match drive.get_mut() {
                DeValue::Table(drive) if is_emulated(drive) => Some(drive),
                _ => None,
            })
            .peekable();
        if emulated.peek().is_none() {
            return wrong(
                at,
                "[defaults.drive] is for emulated drives, and the file has none; give each [[drive]] on a board its own keys"
                    .to_owned(),
            );
        }
        emulated.for_each(|drive| merge(drive, &defaults));
    }
    Ok(())
}

/// Adds the keys of `defaults` that `table` does not have.
fn merge<'i>(table: &mut DeTable<'i>, defaults: &DeTable<'i>) {
    for (key, value) in defaults {
        match (table.get_mut(key.get_ref().as_ref()).map(Spanned::get_mut), value.get_ref()) {
            (Some(DeValue::Table(table)), DeValue::Table(defaults)) => merge(table, defaults),
            (Some(_), _) => {}
            (None, _) => {
                table.insert(key.clone(), value.clone());
            }
        }
    }
}

/// Replaces each numbered table by its copies. A table is numbered by the range in its name, like `x{1..300}`, or, if
/// it has no name, by the first range in its text.
fn copies<'i>(tables: DeArray<'i>, filled: &mut Filled) -> Result<DeArray<'i>, LocatedError> {
    let mut all = DeArray::new();
    for table in tables {
        let Some(range) = range_of(&table)? else {
            all.push(table);
            continue;
        };
        for number in range.numbers() {
            let mut copy = table.clone();
            replace(&mut copy, filled, &|text| fill_numbers(text, &range, number))?;
            all.push(copy);
        }
    }
    Ok(all)
}

/// The range that numbers a table, if there is one.
fn range_of(table: &Spanned<DeValue<'_>>) -> Result<Option<Range>, LocatedError> {
    let mut texts = Vec::new();
    match table.get_ref().get("name") {
        Some(name) => strings(name, &mut texts),
        None => {
            strings(table, &mut texts);
            texts.retain(|(_, text)| text.contains(".."));
            texts.sort_by_key(|(at, _)| *at);
        }
    }
    for (at, text) in texts {
        if let Some(range) = Range::find(text).map_err(LocatedError::at(at))? {
            return Ok(Some(range));
        }
    }
    Ok(None)
}

/// Adds all strings in a value, each with its position.
fn strings<'a>(value: &'a Spanned<DeValue<'_>>, all: &mut Vec<(usize, &'a str)>) {
    match value.get_ref() {
        DeValue::String(text) => all.push((value.span().start, text)),
        DeValue::Array(values) => values.iter().for_each(|value| strings(value, all)),
        DeValue::Table(table) => table.values().for_each(|value| strings(value, all)),
        _ => {}
    }
}

/// Expands names with a range in the list of drives of a `[[bus]]`.
fn expand_names_of_bus(bus: &mut Spanned<DeValue<'_>>) -> Result<(), LocatedError> {
    let DeValue::Table(bus) = bus.get_mut() else { return Ok(()) };
    let Some(DeValue::Array(drives)) = bus.get_mut("drives").map(Spanned::get_mut) else { return Ok(()) };
    let mut all = DeArray::new();
    for name in std::mem::replace(drives, DeArray::new()) {
        let span = name.span();
        // `{n}` of a numbered bus is filled later.
        let text = name.get_ref().as_str().filter(|text| text.contains("..")).unwrap_or_default();
        match Range::find(text).map_err(LocatedError::at(span.start))? {
            None => all.push(name),
            Some(range) => {
                for number in range.numbers() {
                    all.push(Spanned::new(span.clone(), DeValue::String(range.name(number).into())));
                }
            }
        }
    }
    *drives = all;
    Ok(())
}

/// A name with a range of numbers, like `x{1..300}`.
struct Range {
    before: String,
    /// The text in the braces.
    inside: String,
    first: u64,
    last: u64,
    behind: String,
}

impl Range {
    /// The range in a name, if there is one.
    fn find(text: &str) -> Result<Option<Self>, String> {
        let Some((before, rest)) = text.split_once('{') else { return Ok(None) };
        let wrong = || format!("'{text}' has no range of numbers, like x{{1..300}}");
        let (inside, behind) = rest.split_once('}').ok_or_else(wrong)?;
        let (first, last) = inside.split_once("..").ok_or_else(wrong)?;
        let number = |digits: &str| digits.parse::<u64>().map_err(|_| wrong());
        let (first, last) = (number(first)?, number(last)?);
        if behind.contains('{') {
            return Err(format!("'{text}' has more than one range"));
        }
        if first > last {
            return Err(format!("'{text}' has no numbers; write the lower one first"));
        }
        if last - first >= MAX_COPIES {
            return Err(format!(
                "'{text}' has {} numbers; a range has at most {MAX_COPIES}",
                (last - first).saturating_add(1)
            ));
        }
        let (before, inside, behind) = (before.to_owned(), inside.to_owned(), behind.to_owned());
        Ok(Some(Self { before, inside, first, last, behind }))
    }

    fn numbers(&self) -> std::ops::RangeInclusive<u64> {
        self.first..=self.last
    }

    fn name(&self, number: u64) -> String {
        format!("{}{number}{}", self.before, self.behind)
    }
}

/// Replaces the range of a numbered table, `{n}`, and expressions with `n` such as `{5000+n}`, in a text.
fn fill_numbers(text: &str, range: &Range, n: u64) -> Result<Option<String>, String> {
    let (mut result, mut rest) = (String::new(), text);
    while let Some((before, after)) = rest.split_once('{') {
        let wrong =
            || format!("'{text}' needs a sum with n in its braces, like {{n}}, {{5000+n}} or {{2*n-1}}");
        let (inside, behind) = after.split_once('}').ok_or_else(wrong)?;
        result.push_str(before);
        if inside == range.inside {
            result.push_str(&n.to_string());
        } else if inside.contains("..") {
            let own = &range.inside;
            return Err(format!(
                "'{text}' has another range than {{{own}}}, which numbers the table; use {{n}}"
            ));
        } else {
            result.push_str(&sum(inside, n).ok_or_else(wrong)?.to_string());
        }
        rest = behind;
    }
    if rest.len() == text.len() {
        return Ok(None);
    }
    result.push_str(rest);
    Ok(Some(result))
}

/// Value of a sum of products of whole numbers and `n`.
fn sum(text: &str, n: u64) -> Option<i64> {
    let factor = |word: &str| match word.trim() {
        "n" => i64::try_from(n).ok(),
        digits if digits.bytes().all(|byte| byte.is_ascii_digit()) => digits.parse().ok(),
        _ => None,
    };
    let product =
        |term: &str| term.split('*').try_fold(1_i64, |product, word| product.checked_mul(factor(word)?));
    let mut total = 0_i64;
    for part in text.split('+') {
        let mut terms = part.split('-');
        total = total.checked_add(product(terms.next()?)?)?;
        for term in terms {
            total = total.checked_sub(product(term)?)?;
        }
    }
    Some(total)
}

#[cfg(test)]
mod tests {
    use super::super::{FileError, parse_with};
    use crate::bench::scenario::{Step, Trigger};
    use crate::config::layout::Layout;
    use proptest::prelude::*;

    fn read(text: &str) -> Result<Layout, FileError> {
        let variable = |name: &str| match name {
            "SPEED" => Some("8000".to_owned()),
            "SAVED" => Some("m{n}.nv".to_owned()),
            "EMPTY" => Some(String::new()),
            "FAST" => Some("true".to_owned()),
            _ => None,
        };
        parse_with(text, &variable)
    }

    fn wrong(text: &str) -> String {
        read(text).map(|_| ()).expect_err("an error").to_string()
    }

    fn names(layout: &Layout) -> Vec<&str> {
        layout.drives.iter().map(|drive| drive.name.as_str()).collect()
    }

    #[test]
    fn a_name_with_a_range_makes_numbered_drives() {
        let text = "
            [[drive]]
            name = 'x{9..11}'
            kind = 'md3'
            address = '{n}'
            nv = 'x{n}.nv'
            listen = ['tcp:127.0.0.1:{5000+n}', 'pty:x{2*n-1}.tty']
        ";
        let layout = read(text).expect("a bench");
        assert_eq!(names(&layout), ["x9", "x10", "x11"]);
        let listen: Vec<String> = layout.drives[1].listen.iter().map(|(_, uri)| uri.to_string()).collect();
        assert_eq!(listen, ["tcp:127.0.0.1:5010", "pty:x19.tty"]);
        assert_eq!(layout.drives[2].nv.as_deref(), Some(std::path::Path::new("x11.nv")));
        let built = layout.build(layout.settings(), Vec::new()).expect("it can be built");
        let address = built.bench.spec(built.drives[0]).address.expect("an MD3 has an address");
        let addresses: Vec<i64> = built.drives.iter().map(|&id| built.bench.peek(id, address)).collect();
        assert_eq!(addresses, [9, 10, 11]);
    }

    #[test]
    fn buses_and_motors_have_ranges_too() {
        let text = "
            [[drive]]
            name = 'x{1..4}'
            kind = 'md3'
            [[bus]]
            name = 'low'
            drives = ['x{1..3}']
            [[bus]]
            name = 'high'
            drives = ['x4']
            [[motor]]
            name = 'm{1..4}'
            drive = 'x{5-n}'
            inertia_gcm2 = '{100*n}'
        ";
        let layout = read(text).expect("a bench");
        assert_eq!(layout.buses[0].drives.len(), 3);
        let drives: Vec<usize> = layout.motors.iter().map(|motor| motor.drive).collect();
        assert_eq!(drives, [3, 2, 1, 0]);
    }

    #[test]
    fn tables_without_a_name_are_numbered_by_their_first_range() {
        let text = "
            [[drive]]
            name = 'x{1..3}'
            kind = 'md3'
            [[motor]]
            name = 'm{1..3}'
            drive = 'x{1..3}'
            [[encoder]]
            cycles_per_rev = '{100*n}'
            motor = 'm{1..3}'
            to = { index = 'x{4-n}.J2.4' }
            [[switch]]
            to = 'x{n}.J2.2'
            motor = 'm{2..3}'
            closed = { below_rev = '{n}' }
            [[wire]]
            from = 'x{1..2}.J2.9'
            to = 'x{n+1}.J2.3'
            [[wire]]
            from = 'x1.J2.10'
            to = 'x{1..3}.J2.5'
            [[fault]]
            bus = 'x{1..3}.rs485'
            delay_ms = '{n}'
            [[scenario]]
            steps = [
                { at_s = 1, drive = 'x1', power = 'off' },
                { when = { drive = 'x{2..3}', register = 'Speed', value = '{n}' }, drive = 'x{2..3}', power = 'off' },
            ]
        ";
        let layout = read(text).expect("a bench");
        let encoders = layout.encoders.iter();
        let encoders: Vec<_> = encoders
            .map(|encoder| (encoder.motor, encoder.cycles_per_rev, encoder.index.map(|(drive, _)| drive)))
            .collect();
        assert_eq!(encoders, [(0, 100, Some(2)), (1, 200, Some(1)), (2, 300, Some(0))]);
        let switches = layout.switches.iter();
        let switches: Vec<_> =
            switches.map(|switch| (switch.motor, switch.to.0, switch.closed.below_rev)).collect();
        assert_eq!(switches, [(1, 1, Some(2.0)), (2, 2, Some(3.0))]);
        let wires: Vec<_> = layout.wires.iter().map(|wire| (wire.from.0, wire.to.0)).collect();
        assert_eq!(wires, [(0, 1), (1, 2), (0, 0), (0, 1), (0, 2)]);
        let buses: Vec<_> = layout.faults.iter().map(|fault| fault.bus.as_str()).collect();
        assert_eq!(buses, ["x1.rs485", "x2.rs485", "x3.rs485"]);
        let waits = layout.scenarios.iter().map(|scenario| match &scenario.steps[..] {
            [Step { trigger: Trigger::At(_), .. }, Step { trigger: Trigger::Written(written), .. }] => {
                (written.drive.0, written.value)
            }
            steps => panic!("{steps:?}"),
        });
        assert_eq!(waits.collect::<Vec<_>>(), [(1, Some(2)), (2, Some(3))]);
    }

    #[test]
    fn defaults_hold_for_keys_that_a_drive_does_not_have() {
        let text = "
            [defaults.drive]
            kind = 'md3'
            fast_boot = '${FAST}'
            set = { Speed = '${SPEED}', MoveSteps = 5 }
            [[drive]]
            name = 'x'
            [[drive]]
            name = 'y'
            set = { MoveSteps = 6 }
        ";
        let layout = read(text).expect("a bench");
        assert!(layout.drives.iter().all(|drive| drive.fast_boot));
        let built = layout.build(layout.settings(), Vec::new()).expect("it can be built");
        let value = |drive: usize, name: &str| {
            let row = built.bench.spec(built.drives[drive]).find(name).expect("a register").row;
            built.bench.peek(built.drives[drive], row)
        };
        assert_eq!([value(0, "Speed"), value(0, "MoveSteps")], [8_000, 5]);
        assert_eq!([value(1, "Speed"), value(1, "MoveSteps")], [8_000, 6]);
    }

    /// A board keeps what it is (BENCH-22).
    #[test]
    fn a_drive_on_a_board_has_no_defaults() {
        let text = "
            [defaults.drive]
            kind = 'md3'
            address = 5
            fast_boot = true
            [[drive]]
            name = 'x'
            [[drive]]
            name = 'b'
            board = 'usb:E661'
        ";
        let layout = read(text).expect("a bench");
        let of: Vec<_> = layout.drives.iter().map(|drive| (drive.kind, drive.fast_boot)).collect();
        assert_eq!(of, [("md3", true), ("", false)]);
    }

    #[test]
    fn variables_have_values_or_defaults() {
        let text = "
            [[drive]]
            name = 'x'
            kind = '${KIND:-md3}'
            nv = '${SAVED}'
            program = '${EMPTY:-}'
        ";
        assert_eq!(wrong(text), "line 6, column 23: program takes the name of a file");
        let layout =
            read(&text.replace("program = '${EMPTY:-}'", "listen = ['tcp:${H:-127.0.0.1}:${P:-0}']"));
        let layout = layout.expect("a bench");
        assert_eq!(layout.drives[0].kind, "md3");
        assert_eq!(layout.drives[0].nv.as_deref(), Some(std::path::Path::new("m{n}.nv")));
        assert_eq!(layout.drives[0].listen[0].1.to_string(), "tcp:127.0.0.1:0");
    }

    #[test]
    fn a_numbered_bus_has_the_drive_of_its_number() {
        let layout = read(
            "
            [[drive]]
            name = 'x{1..2}'
            kind = 'md3'
            [[bus]]
            name = 'b{1..2}'
            drives = ['x{n}']
            ",
        )
        .expect("a bench");
        let buses: Vec<_> = layout.buses.iter().map(|bus| (bus.name.as_str(), bus.drives.len())).collect();
        assert_eq!(buses, [("b1", 1), ("b2", 1)]);
    }

    #[test]
    fn errors_name_the_place_and_the_remedy() {
        let drive = |keys: &str| format!("[[drive]]\nname = 'x'\nkind = 'md3'\n{keys}");
        for (text, error) in [
            (
                drive("nv = '${HOME2}/x.nv'"),
                "line 4, column 6: there is no environment variable 'HOME2'; ${HOME2:-else} has a default",
            ),
            (drive("nv = '${HOME2'"), "line 4, column 6: '${HOME2' has a ${ without a }"),
            (drive("address = '${A:-many}'"), "line 4, column 11: address takes a whole number, not 'many'"),
            (drive("address = '1'"), "line 4, column 11: address takes a whole number, not a string"),
            (
                drive("").replace("'x'", "'x{1..}'"),
                "line 2, column 8: 'x{1..}' has no range of numbers, like x{1..300}",
            ),
            (
                drive("").replace("'x'", "'x{1..2}{3..4}'"),
                "line 2, column 8: 'x{1..2}{3..4}' has more than one range",
            ),
            (
                drive("").replace("'x'", "'x{1..10001}'"),
                "line 2, column 8: 'x{1..10001}' has 10001 numbers; a range has at most 10000",
            ),
            (
                drive("").replace("'x'", "'x{2..1}'"),
                "line 2, column 8: 'x{2..1}' has no numbers; write the lower one first",
            ),
            (
                drive("nv = '{m}'").replace("'x'", "'x{1..2}'"),
                "line 4, column 6: '{m}' needs a sum with n in its braces, like {n}, {5000+n} or {2*n-1}",
            ),
            (
                drive("nv = 'x.nv'").replace("'x'", "'x{1..2}'"),
                "line 4, column 6: x.nv is already the memory of another drive; use another file",
            ),
            (
                drive("nv = 'x{1..3}.nv'").replace("'x'", "'x{1..2}'"),
                "line 4, column 6: 'x{1..3}.nv' has another range than {1..2}, which numbers the table; use {n}",
            ),
            (
                format!("{}\n[[wire]]\nfrom = 'x.J2.9'\nto = 'x{{3..1}}.J2.2'", drive("")),
                "line 7, column 6: 'x{3..1}.J2.2' has no numbers; write the lower one first",
            ),
            (
                format!("{}\n[[wire]]\nfrom = 'x.J2.9'\nto = 'x{{1..3}}.J2.2'", drive("")),
                "line 7, column 6: there is no drive 'x1'; the nearest is 'x'",
            ),
            (
                format!("{}\n[[wire]]\nfrom = 'x.J2.9'\nto = '{{x..2}}.J2.2'", drive("")),
                "line 7, column 6: '{x..2}.J2.2' has no range of numbers, like x{1..300}",
            ),
            (
                format!("{}\n[[wire]]\nfrom = 'x{{1..2}}.J2.9'\nto = 'x{{1..3}}.J2.2'", drive("")),
                "line 7, column 6: 'x{1..3}.J2.2' has another range than {1..2}, which numbers the table; use {n}",
            ),
            (
                drive("[[scenario]]\nsteps = [{ drive = 'x{1..1001}', power = 'off' }]")
                    .replace("'x'", "'x{1..1001}'"),
                "line 4, column 1: a bench plays 1000 scenarios at once",
            ),
            (
                format!("[defaults.motor]\n{}", drive("")),
                "line 1, column 11: there is no table of defaults 'motor'; available: drive",
            ),
            (
                format!("[defaults.drive]\nname = 'x'\n{}", drive("")),
                "line 2, column 1: name cannot be a default; give each [[drive]] its own",
            ),
            (
                format!("[defaults.drive]\nboard = 'usb:E661'\n{}", drive("")),
                "line 2, column 1: board cannot be a default; give each [[drive]] its own",
            ),
            (
                "[defaults.drive]\nkind = 'md3'\n[[drive]]\nname = 'b'\nboard = 'usb:E661'".to_owned(),
                "line 1, column 11: [defaults.drive] is for emulated drives, and the file has none; give each [[drive]] on a board its own keys",
            ),
            (
                format!("defaults = 1\n{}", drive("")),
                "line 1, column 12: defaults must be a table; write [defaults.drive] above its keys",
            ),
            (
                "[defaults.drive]\nkind = 'md3'".to_owned(),
                "line 1, column 11: [defaults.drive] is for drives, and the file has none; add a [[drive]]",
            ),
            (
                format!("[defaults]\n{}", drive("")),
                "line 1, column 1: defaults has no keys; write [defaults.drive] and keys of drives below it",
            ),
            (
                format!("[defaults.drive]\nadress = 1\n{}", drive("")),
                "line 2, column 1: there is no key of [[drive]] 'adress'; the nearest is 'address'",
            ),
        ] {
            assert_eq!(wrong(&text), error, "{text}");
        }
    }

    proptest! {
        #[test]
        fn no_placeholder_panics(text in "[x{}$n.:0-9*+-]{0,24}") {
            let file = format!("[[drive]]\nname = 'x{{1..2}}'\nkind = 'md3'\nnv = '{text}'\n[[bus]]\nname = 'b'\ndrives = ['{text}']");
            let _ = read(&file);
        }
    }
}
