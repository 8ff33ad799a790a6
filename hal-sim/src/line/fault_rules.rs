//! Rules: which frames a fault disturbs, and how many of them.

use drivetwin_firmware::device::Spec;
use drivetwin_protocol::modbus::pdu::{EXCEPTION_BIT, Request};
use drivetwin_protocol::registers::{Row, Space};

use crate::ids::DriveId;
use crate::suggest;

/// Number of frames that a fault disturbs.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Amount {
    /// Share of the frames that the rule covers, from 0 to 1. A random choice decides for each frame.
    Rate(f64),
    /// Each of the next N frames that the rule covers, where N is the number here. Each of these frames reduces the
    /// number by 1.
    Count(u32),
}

/// Direction of a frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Direction {
    /// From a client to the drives.
    Request,
    /// From a drive to the clients.
    Reply,
}

impl Direction {
    /// The name in bench files and in the control API.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Request => "request",
            Self::Reply => "reply",
        }
    }

    /// The direction of that name.
    ///
    /// # Errors
    /// One sentence with both names.
    pub fn named(name: &str) -> Result<Self, String> {
        let known = [Self::Request, Self::Reply].into_iter().find(|direction| direction.name() == name);
        known.ok_or_else(|| format!("direction takes request or reply, not '{name}'"))
    }
}

/// The frames that a fault disturbs: how many, and which. A field that is `None` covers all frames.
///
/// ```
/// use drivetwin_sim::line::faults::{Direction, FaultRule, LineFaults};
///
/// // The answers to the next three writes of one register, and one of ten frames.
/// let lost = FaultRule::next(3).direction(Direction::Reply).function(6);
/// let faults = LineFaults { drop: lost, corrupt: FaultRule::rate(0.1), ..LineFaults::NONE };
/// assert_eq!(faults.check(), Ok(()));
/// ```
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct FaultRule {
    /// Number of frames.
    pub amount: Amount,
    /// Only requests, or only replies.
    pub direction: Option<Direction>,
    /// Only requests to this drive, broadcasts included, and its replies.
    pub drive: Option<DriveId>,
    /// Only requests with this Modbus function code, and their replies.
    pub function: Option<u8>,
    /// Only Modbus requests that read or write a word of the register with this name, and their replies. The name is
    /// that of the row in the drive's register map.
    pub register: Option<&'static str>,
}

impl Default for FaultRule {
    fn default() -> Self {
        Self::NONE
    }
}

impl From<f64> for FaultRule {
    fn from(rate: f64) -> Self {
        Self::rate(rate)
    }
}

impl FaultRule {
    /// No frame, the default.
    pub const NONE: Self = Self::rate(0.0);

    /// Every frame.
    pub const ALL: Self = Self::rate(1.0);

    /// A share of all frames, from 0 to 1.
    #[must_use]
    pub const fn rate(rate: f64) -> Self {
        Self { amount: Amount::Rate(rate), direction: None, drive: None, function: None, register: None }
    }

    /// Each of the next `count` frames.
    #[must_use]
    pub const fn next(count: u32) -> Self {
        Self { amount: Amount::Count(count), ..Self::NONE }
    }

    /// The same rule for frames in one direction.
    #[must_use]
    pub const fn direction(self, direction: Direction) -> Self {
        Self { direction: Some(direction), ..self }
    }

    /// The same rule for frames to and from one drive.
    #[must_use]
    pub const fn drive(self, drive: DriveId) -> Self {
        Self { drive: Some(drive), ..self }
    }

    /// The same rule for frames with one Modbus function code.
    #[must_use]
    pub const fn function(self, function: u8) -> Self {
        Self { function: Some(function), ..self }
    }

    /// The same rule for frames about one register, by the name of its row.
    #[must_use]
    pub const fn register(self, register: &'static str) -> Self {
        Self { register: Some(register), ..self }
    }

    /// The same rule for the drive with that name, one of `drives` on the bus.
    ///
    /// # Errors
    /// One sentence with the nearest name.
    pub fn drive_named(self, name: &str, drives: &[Party<'_>]) -> Result<Self, String> {
        let found = drives.iter().find(|drive| drive.name == name);
        let unknown =
            || suggest::unknown_at("drive", name, " on this bus", drives.iter().map(|drive| drive.name));
        Ok(self.drive(found.ok_or_else(unknown)?.id))
    }

    /// The same rule for the register with that name. It must be a register of the rule's drive or, without
    /// one, of any of `drives`.
    ///
    /// # Errors
    /// One sentence with the nearest name.
    pub fn register_named(self, name: &str, drives: &[Party<'_>]) -> Result<Self, String> {
        let own = || drives.iter().filter(|drive| self.drive.is_none_or(|id| drive.id == id));
        let Some((spec, named)) = own().find_map(|drive| Some((drive.spec, drive.spec.find(name)?))) else {
            let names = own().flat_map(|drive| drive.spec.rows().filter(|(_, row)| has_address(row)));
            let drives: Vec<&str> = own().map(|drive| drive.name).collect();
            let place = match drives[..] {
                [one] => format!(" on {one}"),
                [_, .., _] if drives.len() > 4 => format!(" on the {} drives of this bus", drives.len()),
                _ => format!(" on this bus, with the drives {}", drives.join(", ")),
            };
            return Err(suggest::unknown_at("register", name, &place, names.map(|(_, row)| row.name)));
        };
        let row = spec.registers.rows.get(named.row).ok_or_else(|| format!("{name} has no row"))?;
        if named.word.is_some() {
            return Err(format!("register takes a whole register: {}, not {name}", row.name));
        }
        if !has_address(row) {
            return Err(format!("{name} of {} has no address on the bus", spec.kind));
        }
        Ok(self.register(row.name))
    }

    /// Returns true if the rule disturbs frames now, or may do so.
    #[must_use]
    pub fn is_active(&self) -> bool {
        match self.amount {
            Amount::Rate(rate) => rate > 0.0,
            Amount::Count(count) => count > 0,
        }
    }

    /// Returns true if the rule is a share of all frames.
    #[must_use]
    pub fn is_plain(&self) -> bool {
        matches!(self.amount, Amount::Rate(_)) && self.direction.is_none() && !self.needs_content()
    }

    /// Returns true if only the content of a frame shows if the rule covers it.
    pub(crate) fn needs_content(&self) -> bool {
        self.drive.is_some() || self.function.is_some() || self.register.is_some()
    }

    /// Returns true if the rule covers a frame, whatever its amount is.
    fn covers(&self, direction: Direction, content: Option<&Content>) -> bool {
        let has = |fits: &dyn Fn(&Content) -> bool| content.is_some_and(fits);
        self.direction.is_none_or(|own| own == direction)
            && self.drive.is_none_or(|own| has(&|content| content.drives.iter().any(|&(id, _)| id == own)))
            && self.function.is_none_or(|own| has(&|content| content.function == Some(own)))
            && self.register.is_none_or(|own| has(&|content| content.names(own)))
    }

    /// Decides if the rule disturbs a frame, and counts it if so. `chosen` is the random choice for a rate.
    /// If `possible` is false, the fault has no effect on the frame, and the frame does not count.
    pub(crate) fn hits(
        &mut self,
        chosen: bool,
        possible: bool,
        direction: Direction,
        content: Option<&Content>,
    ) -> bool {
        if !possible || !self.covers(direction, content) {
            return false;
        }
        match &mut self.amount {
            Amount::Rate(_) => chosen,
            Amount::Count(0) => false,
            Amount::Count(count) => {
                *count -= 1;
                true
            }
        }
    }
}

/// A drive on a bus, as rules name it.
#[derive(Clone, Copy, Debug)]
pub struct Party<'a> {
    /// The drive. In a [`Layout`](crate::config::layout::Layout) its index there.
    pub id: DriveId,
    /// Its name.
    pub name: &'a str,
    /// Its description.
    pub spec: &'static Spec,
}

/// Returns true if requests can address a row.
fn has_address(row: &Row) -> bool {
    !matches!(row.space, Space::Variable | Space::Setting)
}

/// The parts of a frame that rules refer to.
#[derive(Clone, Debug, Default)]
pub(crate) struct Content {
    /// The drives that a request is for, or the drive that replies.
    pub(crate) drives: Vec<(DriveId, &'static Spec)>,
    /// Function code of the request.
    pub(crate) function: Option<u8>,
    /// Addresses in the request: the space, the first address, and their number.
    addresses: [Option<(Space, u16, u16)>; 2],
}

impl Content {
    /// Content of a request to these drives. `pdu` is empty if the message is no Modbus request.
    pub(crate) fn of_request(drives: Vec<(DriveId, &'static Spec)>, pdu: &[u8]) -> Self {
        Self { drives, function: pdu.first().copied(), addresses: addresses(pdu) }
    }

    /// Content of the reply of a drive to this request.
    pub(crate) fn of_reply(&self, drive: (DriveId, &'static Spec)) -> Self {
        Self { drives: vec![drive], ..self.clone() }
    }

    /// Content of the reply of a drive to an unknown request.
    pub(crate) fn of_lone_reply(drive: (DriveId, &'static Spec), pdu: &[u8]) -> Self {
        let function = pdu.first().map(|function| function & !EXCEPTION_BIT);
        Self { drives: vec![drive], function, addresses: [None; 2] }
    }

    /// Returns true if the frame is about the register with that name, of one of its drives.
    fn names(&self, register: &str) -> bool {
        let rows = self.drives.iter().flat_map(|(_, spec)| spec.rows());
        rows.filter(|(_, row)| row.name == register).any(|(_, row)| {
            let (first, words) = (u32::from(row.address), u32::from(row.shape.words()));
            self.addresses.iter().flatten().any(|&(space, from, count)| {
                let from = u32::from(from);
                (space == row.space || Some(space) == row.also)
                    && from < first + words
                    && first < from + u32::from(count)
            })
        })
    }
}

/// The addresses that a request reads and writes (application, chapter 6): function 23 has two ranges.
fn addresses(pdu: &[u8]) -> [Option<(Space, u16, u16)>; 2] {
    /// Mask write of a register, and read and write of several registers.
    const MASK_WRITE: u8 = 22;
    const READ_AND_WRITE: u8 = 23;
    let space = |function| match function {
        1 | 5 | 15 => Space::Coil,
        2 => Space::Discrete,
        4 => Space::Input,
        _ => Space::Holding,
    };
    let one = |function, first, count| [Some((space(function), first, count)), None];
    let word = |data: &[u8], index: usize| {
        data.get(index * 2..).and_then(<[u8]>::first_chunk).map(|word: &[u8; 2]| u16::from_be_bytes(*word))
    };
    match Request::parse(pdu) {
        Some(
            Request::Read { function, first, count } | Request::WriteMultiple { function, first, count, .. },
        ) => one(function, first, count),
        Some(Request::WriteSingle { function, address, .. }) => one(function, address, 1),
        Some(Request::Other { function: MASK_WRITE, data }) => {
            [word(data, 0).map(|first| (Space::Holding, first, 1)), None]
        }
        Some(Request::Other { function: READ_AND_WRITE, data }) => {
            [0, 2].map(|index| Some((Space::Holding, word(data, index)?, word(data, index + 1)?)))
        }
        _ => [None, None],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::catalog;

    fn md3(id: u32) -> (DriveId, &'static Spec) {
        (DriveId(id), catalog::make("md3").unwrap().spec())
    }

    /// Functions and addresses as the requests of the specification state them (application, chapter 6).
    #[test]
    fn requests_state_their_addresses() {
        let holding = |first, count| Some((Space::Holding, first, count));
        for (pdu, expected) in [
            (&[3, 0x00, 0x6B, 0x00, 0x03][..], [holding(0x6B, 3), None]),
            (&[1, 0x00, 0x13, 0x00, 0x13], [Some((Space::Coil, 0x13, 0x13)), None]),
            (&[2, 0x00, 0xC4, 0x00, 0x16], [Some((Space::Discrete, 0xC4, 0x16)), None]),
            (&[4, 0x00, 0x08, 0x00, 0x01], [Some((Space::Input, 8, 1)), None]),
            (&[6, 0x00, 0x01, 0x00, 0x03], [holding(1, 1), None]),
            (&[16, 0, 1, 0, 2, 4, 0, 10, 1, 2], [holding(1, 2), None]),
            (&[22, 0x00, 0x04, 0x00, 0xF2, 0x00, 0x25], [holding(4, 1), None]),
            (
                &[23, 0, 3, 0, 6, 0, 0x0E, 0, 3, 6, 0, 0xFF, 0, 0xFF, 0, 0xFF],
                [holding(3, 6), holding(0x0E, 3)],
            ),
            (&[43, 0x0E, 1, 0], [None, None]),
            (&[3, 0], [None, None]),
            (&[23, 0], [None, None]),
            (&[], [None, None]),
        ] {
            assert_eq!(addresses(pdu), expected, "{pdu:02X?}");
        }
    }

    /// Speed of an MD3 is 0x14 and 0x15 (7.1).
    #[test]
    fn a_register_is_named_by_each_of_its_words() {
        let covers = |pdu: &[u8]| {
            let content = Content::of_request(vec![md3(0)], pdu);
            FaultRule::ALL.register("Speed").covers(Direction::Request, Some(&content))
        };
        for (first, count, expected) in [
            (0x14, 1, true),
            (0x15, 1, true),
            (0x13, 1, false),
            (0x16, 1, false),
            (0, 32, true),
            (0, 0x14, false),
        ] {
            assert_eq!(covers(&[3, 0, first, 0, count]), expected, "{first} {count}");
        }
        assert!(covers(&[6, 0, 0x15, 0, 7]));
        assert!(!covers(&[4, 0, 0x15, 0, 1]), "another space");
        assert!(!FaultRule::ALL.register("Speed").covers(Direction::Request, None));
    }

    #[test]
    fn a_rule_covers_what_all_its_fields_name() {
        let rule = FaultRule::ALL.drive(DriveId(1)).function(6).direction(Direction::Reply);
        let request = Content::of_request(vec![md3(0), md3(1)], &[6, 0, 0x15, 0, 7]);
        assert!(!rule.covers(Direction::Request, Some(&request)));
        assert!(rule.covers(Direction::Reply, Some(&request.of_reply(md3(1)))));
        assert!(!rule.covers(Direction::Reply, Some(&request.of_reply(md3(0)))));
        let other = Content::of_request(vec![md3(1)], &[3, 0, 0x15, 0, 1]);
        assert!(!rule.covers(Direction::Reply, Some(&other)));
        assert!(rule.covers(Direction::Reply, Some(&Content::of_lone_reply(md3(1), &[0x86, 4]))));
    }

    #[test]
    fn a_count_goes_down_with_each_frame_that_it_disturbs() {
        let mut rule = FaultRule::next(2).direction(Direction::Reply);
        let mut hits = |direction, possible| rule.hits(false, possible, direction, None);
        assert!(!hits(Direction::Request, true));
        assert!(!hits(Direction::Reply, false));
        assert!(
            hits(Direction::Reply, true) && hits(Direction::Reply, true) && !hits(Direction::Reply, true)
        );
        assert_eq!(rule.amount, Amount::Count(0));
        assert!(!rule.is_active() && !rule.is_plain());
    }

    #[test]
    fn names_are_checked() {
        let (id, spec) = md3(0);
        let (_, rs) = (0, catalog::make("rs434544").unwrap().spec());
        let drives = [Party { id, name: "x", spec }, Party { id: DriveId(1), name: "axis", spec: rs }];
        let rule = FaultRule::ALL;
        assert_eq!(rule.drive_named("axis", &drives).unwrap().drive, Some(DriveId(1)));
        let error = rule.drive_named("axes", &drives).unwrap_err();
        assert_eq!(error, "there is no drive 'axes' on this bus; the nearest is 'axis'");
        assert_eq!(rule.register_named("Speed", &drives).unwrap().register, Some("Speed"));
        let error = rule.register_named("Sped", &drives).unwrap_err();
        assert_eq!(
            error,
            "there is no register 'Sped' on this bus, with the drives x, axis; the nearest is 'Speed'"
        );
        let error = rule.register_named("SpeedHigh", &drives).unwrap_err();
        assert_eq!(error, "register takes a whole register: Speed, not SpeedHigh");
        let error = rule.drive(DriveId(1)).register_named("Acceleration", &drives).unwrap_err();
        assert!(error.starts_with("there is no register 'Acceleration' on axis"), "{error}");
        assert_eq!(Direction::named("reply"), Ok(Direction::Reply));
        let error = Direction::named("answer").unwrap_err();
        assert_eq!(error, "direction takes request or reply, not 'answer'");
    }
}
