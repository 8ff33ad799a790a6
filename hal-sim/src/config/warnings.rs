//! Warnings: what a bench file allows, and what is rarely meant.

use std::collections::BTreeMap;

use drivetwin_firmware::device::{Duration, Level, Pin};

use crate::bench::{Bench, DriveId, Setup};
use crate::config::layout::{At, Built, Layout, WireLayout};

/// Time after power-on at which the pins of drives without a start-up delay are examined.
const SETTLED: Duration = Duration::millis(10);

impl Layout {
    /// Warnings about a layout, one sentence each: drives with the same address on a bus, drives with different
    /// serial settings on a bus, wires from pins that their drives do not drive after power-on.
    ///
    /// Drives start with the registers of the layout; files of non-volatile memory are not read.
    ///
    /// # Errors
    /// As [`build`](Self::build).
    pub fn warnings(&self) -> Result<Vec<String>, String> {
        let setup = |_: &_| Setup { boot_fast: true, ..Setup::default() };
        let Built { mut bench, drives, .. } =
            self.build(self.settings(), self.drives.iter().map(setup).collect())?;
        bench.run_until(bench.now() + SETTLED);
        let (addresses, settings) = self.of_buses(&bench, &drives);
        let floats = |wire: &&WireLayout| bench.output(drives[wire.from.0], wire.from.1) == Level::Float;
        let wires = self.wires.iter().filter(floats).map(|wire| {
            format!(
                "[[wire]] from {} to {}: {} does not drive that pin after power-on",
                self.pin_name(&bench, &drives, wire.from),
                self.pin_name(&bench, &drives, wire.to),
                self.drives[wire.from.0].name,
            )
        });
        Ok([
            some(addresses, "drives with the same address on a bus"),
            some(settings, "a bus with different serial settings"),
            some(wires.collect(), "a wire from a pin that its drive does not drive after power-on"),
        ]
        .concat())
    }

    /// Warnings about drives on shared lines: about their addresses, and about their serial settings.
    fn of_buses(&self, bench: &Bench, ids: &[DriveId]) -> (Vec<String>, Vec<String>) {
        let (mut same_address, mut other_settings) = (Vec::new(), Vec::new());
        for bus in &self.buses {
            let mut addresses: BTreeMap<i64, Vec<&str>> = BTreeMap::new();
            let mut lines: BTreeMap<String, Vec<&str>> = BTreeMap::new();
            for &(drive, port) in &bus.drives {
                let (id, name) = (ids[drive], self.drives[drive].name.as_str());
                if let Some(row) = bench.spec(id).address {
                    addresses.entry(bench.peek(id, row)).or_default().push(name);
                }
                if let Some(line) = bench.port_line(id, port) {
                    lines.entry(line.to_string()).or_default().push(name);
                }
            }
            for (address, names) in addresses.iter().filter(|(_, names)| names.len() > 1) {
                same_address.push(format!(
                    "bus '{}': {} have the same address {address}",
                    bus.name,
                    listed(names)
                ));
            }
            if lines.len() > 1 {
                let parts: Vec<String> =
                    lines.iter().map(|(line, names)| format!("{line} ({})", listed(names))).collect();
                other_settings.push(format!(
                    "bus '{}' has different serial settings: {}",
                    bus.name,
                    parts.join(", ")
                ));
            }
        }
        (same_address, other_settings)
    }

    /// Name of a pin, like `x.J2.4`.
    fn pin_name(&self, bench: &Bench, ids: &[DriveId], (drive, Pin(pin)): At) -> String {
        let pin = bench.spec(ids[drive]).pins.get(usize::from(pin)).map_or("", |pin| pin.name);
        format!("{}.{pin}", self.drives[drive].name)
    }
}

/// Of many warnings of one sort the first three, and the number of the others: a numbered table repeats its warning.
fn some(mut warnings: Vec<String>, about: &str) -> Vec<String> {
    const SHOWN: usize = 3;
    let left_out = warnings.len().saturating_sub(SHOWN);
    if left_out > 1 {
        warnings.truncate(SHOWN);
        warnings.push(format!("{left_out} more warnings about {about}"));
    }
    warnings
}

/// Names as text; of many names the first three and the number of the others.
fn listed(names: &[&str]) -> String {
    match names {
        [one] => (*one).to_owned(),
        [most @ .., last] if names.len() <= 4 => format!("{} and {last}", most.join(", ")),
        _ => format!("{} and {} others", names[..3].join(", "), names.len() - 3),
    }
}

#[cfg(test)]
mod tests {
    use crate::config::bench_file;

    fn warnings(text: &str) -> Vec<String> {
        bench_file::parse(text).expect("a bench file").warnings().expect("a bench")
    }

    const DRIVES: &str = "
        [defaults.drive]
        kind = 'md3'
        [[drive]]
        name = 'x{1..6}'
        address = '{n}'
        [[bus]]
        name = 'line1'
        drives = ['x{1..6}']
    ";

    #[test]
    fn a_proper_bench_has_no_warnings() {
        assert_eq!(warnings(DRIVES), [""; 0]);
    }

    #[test]
    fn equal_addresses_are_reported_by_bus() {
        let text = DRIVES.replace("'{n}'", "7");
        assert_eq!(warnings(&text), ["bus 'line1': x1, x2, x3 and 3 others have the same address 7"]);
        let text = text.replace("'x{1..6}']", "'x2', 'x5']");
        assert_eq!(warnings(&text), ["bus 'line1': x2 and x5 have the same address 7"]);
    }

    #[test]
    fn different_serial_settings_are_reported() {
        let text = DRIVES.replace("['x{1..6}']", "['x1', 'x2', 'm']");
        let text = format!("{text}\n[[drive]]\nname = 'm'\nkind = 'mdrobot'\naddress = 9");
        assert_eq!(
            warnings(&text),
            ["bus 'line1' has different serial settings: 19200 8N1 (m), 9600 8E1 (x1 and x2)"]
        );
    }

    #[test]
    fn warnings_of_a_numbered_table_are_not_repeated() {
        let text = "
            [defaults.drive]
            kind = 'md3'
            [[drive]]
            name = 'x{1..300}'
            [[drive]]
            name = 'y{1..300}'
            [[bus]]
            name = 'b{1..300}'
            drives = ['x{n}', 'y{n}']
            [[wire]]
            from = 'x{1..300}.J2.9'
            to = 'y{n}.J2.2'
        ";
        assert_eq!(
            warnings(text),
            [
                "bus 'b1': x1 and y1 have the same address 1",
                "bus 'b2': x2 and y2 have the same address 1",
                "bus 'b3': x3 and y3 have the same address 1",
                "297 more warnings about drives with the same address on a bus",
                "[[wire]] from x1.J2.9 to y1.J2.2: x1 does not drive that pin after power-on",
                "[[wire]] from x2.J2.9 to y2.J2.2: x2 does not drive that pin after power-on",
                "[[wire]] from x3.J2.9 to y3.J2.2: x3 does not drive that pin after power-on",
                "297 more warnings about a wire from a pin that its drive does not drive after power-on",
            ]
        );
    }

    #[test]
    fn a_wire_from_a_pin_that_is_an_input_is_reported() {
        // 7.8 of the guide: bit 12 of PinFunctionAndPolarity makes J2 pins 9, 10 and 12 outputs.
        let text = format!("{DRIVES}\n[[wire]]\nfrom = 'x1.J2.9'\nto = 'x2.J2.2'");
        assert_eq!(
            warnings(&text),
            ["[[wire]] from x1.J2.9 to x2.J2.2: x1 does not drive that pin after power-on"]
        );
        let outputs = "[[drive]]\nname = 'y'\nset = { PinFunctionAndPolarity = 0x1000 }";
        let text = text.replace("'x1.J2.9'", "'y.J2.9'");
        assert_eq!(warnings(&format!("{text}\n{outputs}")), [""; 0]);
    }
}
