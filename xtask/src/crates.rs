//! Licences and origins of the dependencies.
//!
//! cargo-deny does that and more, but takes minutes to build on a fresh machine. The two libraries with which
//! it reads a workspace take seconds.

use anyhow::{Result, ensure};
use cargo_metadata::{MetadataCommand, Package};
use spdx::{Expression, ParseMode};
use xshell::Shell;

/// Licences that permit redistribution of an unmodified program.
const LICENCES: [&str; 8] =
    ["0BSD", "Apache-2.0", "BSD-3-Clause", "MIT", "OFL-1.1", "Ubuntu-font-1.0", "Unicode-3.0", "Zlib"];

/// Crates that must not be used, each with the reason.
const BANNED: [(&str, &str); 1] =
    [("rodbus", "its licence allows no commercial use; the server of Modbus is our own")];

/// Checks all crates of the lock file, for all targets.
pub(crate) fn check(sh: &Shell) -> Result<()> {
    let metadata =
        MetadataCommand::new().current_dir(sh.current_dir()).other_options(["--locked".into()]).exec()?;
    let objections: Vec<String> = metadata.packages.iter().filter_map(objection).collect();
    ensure!(objections.is_empty(), "{}", objections.join("\n"));
    Ok(())
}

/// The objection to a crate, in one sentence.
fn objection(package: &Package) -> Option<String> {
    let name = &package.name;
    if let Some((_, reason)) = BANNED.iter().find(|(banned, _)| *banned == name.as_str()) {
        return Some(format!("{name} is banned: {reason}"));
    }
    let source = package.source.as_ref()?;
    if !source.is_crates_io() {
        return Some(format!("{name} comes from {source}; take it from the registry"));
    }
    let licence = package.license.as_deref().unwrap_or("no licence");
    let is_accepted = Expression::parse_mode(licence, ParseMode::LAX).is_ok_and(|expression| {
        expression.evaluate(|wanted| wanted.license.id().is_some_and(|id| LICENCES.contains(&id.name)))
    });
    (!is_accepted).then(|| format!("{name} has {licence}; these are accepted: {}", LICENCES.join(", ")))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A crate from the registry, with another name and licence.
    fn package(name: &str, licence: &str) -> Package {
        let metadata = MetadataCommand::new().exec().expect("cargo");
        let mut package =
            metadata.packages.into_iter().find(|package| package.source.is_some()).expect("one");
        package.name = name.parse().expect("a name");
        package.license = Some(licence.to_owned());
        package
    }

    #[test]
    fn crates_are_judged_by_licence_and_name() {
        for accepted in
            ["MIT", "MIT/Apache-2.0", "GPL-2.0-only OR MIT", "(MIT OR Apache-2.0) AND Unicode-3.0"]
        {
            assert_eq!(objection(&package("x", accepted)), None, "{accepted}");
        }
        for refused in ["GPL-3.0-only", "MIT AND GPL-2.0-only", "non-standard", ""] {
            let said = objection(&package("x", refused)).expect(refused);
            assert!(said.starts_with(&format!("x has {refused}")), "{said}");
        }
        assert!(
            objection(&package("rodbus", "MIT")).is_some_and(|said| said.starts_with("rodbus is banned"))
        );
    }
}
