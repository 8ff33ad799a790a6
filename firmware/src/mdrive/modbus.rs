//! Requests on port 502: the functions of FB 4, without its misprints (MDRIVE-1).
//!
//! A request for an address that does not exist, or with a wrong structure, is refused before it reaches the
//! drive. If the drive itself refuses a request, EF and ER report that as an error of MCode, too.

use drivetwin_protocol::modbus::pdu::{ENCAPSULATED_INTERFACE, Exception};
use drivetwin_protocol::modbus::server::{RequestHandler, Rules, Values, refuse_tcp, serve_tcp};
use drivetwin_protocol::modbus::tcp::Adu;
use drivetwin_protocol::modbus::{Reply, identification};
use drivetwin_protocol::registers::Entries;

use super::MODBUS;
use super::drive::Drive;
use super::error::{Error, illegal};
use super::mcode::statement::Statement;
use super::reader::Text;
use super::reasons::report;
use super::registers::{ETHERNET, FIRMWARE, Model, PART_NUMBER, Reg, SERIAL_NUMBER};
use crate::device::{Context, Instant, Link, LogEvent, Output};

/// Function "read manufacturer specific" (FB 4.3.2).
const READ_SPECIFIC: u8 = 65;
/// Function "write manufacturer specific" (FB 4.3.3).
const WRITE_SPECIFIC: u8 = 66;

/// Limits of a request: up to four registers (FB 4.2.4, 4.2.5), inputs (FB 4.2.1) or outputs (FB 4.2.2). Half
/// of a value cannot be written (MDRIVE-2).
pub(super) static RULES: Rules = Rules {
    functions: &[1, 2, 3, 5, 16, ENCAPSULATED_INTERFACE, READ_SPECIFIC, WRITE_SPECIFIC],
    broadcast: None,
    max_read: 4,
    max_written: 4,
    bits_per_word: 1,
    partial_writes: false,
    bad_quantity: Exception::IllegalDataValue,
    bad_value: Exception::IllegalDataValue,
    read_only: Exception::IllegalDataAddress,
};

/// Conformity level of the identification: regular objects, which can also be read one by one (MDRIVE-6).
const CONFORMITY: u8 = identification::REGULAR | identification::SINGLE_OBJECTS;

/// Maximum length of a parameter string, in characters (FB 4.3.3).
const MAX_STRING: usize = 28;
/// Length of a mnemonic in a request. Blanks come first, then its characters in reverse order.
const MNEMONIC: usize = 4;

/// Targets of functions 65 and 66 (FB 4.3.1; MDRIVE-7).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Specific {
    /// Values that can be read and written.
    Values,
    /// A command.
    Command(Command),
    /// EX: runs the program at an address or a label.
    Execute,
}

/// A command without a value.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Command {
    /// E: ends the program.
    End,
    /// PS: pauses program and motion.
    Pause,
    /// RS: resumes program and motion.
    Resume,
}

impl Specific {
    /// Target of a mnemonic.
    fn find(mnemonic: &[u8], model: Model) -> Option<Self> {
        match mnemonic {
            b"S1" | b"S2" | b"S3" | b"S4" | b"S5" | b"S13" | b"TR" => Some(Self::Values),
            b"S7" | b"S8" | b"CR" if model == Model::Plus => Some(Self::Values),
            b"MU" if model == Model::Hybrid => Some(Self::Values),
            b"E" => Some(Self::Command(Command::End)),
            b"PS" => Some(Self::Command(Command::Pause)),
            b"RS" => Some(Self::Command(Command::Resume)),
            b"EX" => Some(Self::Execute),
            _ => None,
        }
    }
}

/// Answers a request.
pub(super) fn serve(drive: &mut Drive, at: Instant, link: Link, adu: &[u8], out: &mut dyn Context) {
    let mut reply = Adu::new();
    let outcome = if drive.startup.is_started() {
        serve_tcp(adu, &RULES, &mut Bus { drive, at, out }, &mut reply)
    } else {
        // After a restart the Ethernet controller receives requests while the drive itself still starts.
        refuse_tcp(adu, Exception::ServerDeviceFailure, &mut reply)
    };
    out.put(at, Output::Log(LogEvent::of(MODBUS, outcome)));
    if !reply.is_empty() {
        out.put(at, Output::Message { port: MODBUS, link, bytes: &reply });
    }
}

/// The drive as its bus sees it during a request.
struct Bus<'a> {
    drive: &'a mut Drive,
    at: Instant,
    out: &'a mut dyn Context,
}

impl Bus<'_> {
    /// Reports an error to MCode and returns the exception for the bus.
    fn note_refusal(&mut self, error: Error) -> Exception {
        self.drive.fail(self.at, error);
        error.exception()
    }

    /// Validates all values of a write with their combined result, then applies all of them.
    ///
    /// # Errors
    /// The first error found; nothing has changed then.
    fn write_all(&mut self, values: &Values<'_, Reg>) -> Result<(), Error> {
        let brought = |reg| values.get(reg).map(narrow);
        let reader = self.drive.reader(self.at);
        for (reg, value) in values.iter() {
            // MR and MS are neighbours: one request can write both. MS makes a Hybrid calibrate, and MR
            // cannot move it then.
            if reader.calibrates(reg, narrow(value)) && brought(Reg::MR).is_some() {
                return Err(Error::CalibrationInMotion);
            }
            // DC and DE are neighbours, too. If DC counts DE down to 0, DE = 1 in the same request calibrates
            // a Hybrid.
            let counted = brought(Reg::DC).and_then(|address| reader.counted_by_address(address).ok());
            let switches_on = reg == Reg::DE && value == 1 && counted == Some(Reg::DE);
            if switches_on && self.drive.bank.model() == Model::Hybrid && reader.is_in_motion() {
                return Err(Error::CalibrationInMotion);
            }
            reader.validate(reg, narrow(value), &|other| {
                brought(other).unwrap_or_else(|| self.drive.bank.stored(other))
            })?;
        }
        // A motion command can be refused even after validation, so it is applied first. Four registers hold
        // at most one motion command.
        for ordered in [true, false] {
            for (reg, value) in values.iter().filter(|(reg, _)| is_order(*reg) == ordered) {
                self.drive.apply(self.at, reg, narrow(value), self.out)?;
            }
        }
        Ok(())
    }

    /// Executes function 65 or 66. `data` is the part of the request after the mnemonic.
    fn serve_specific(
        &mut self,
        function: u8,
        mnemonic: [u8; MNEMONIC],
        data: &[u8],
        reply: &mut Reply,
    ) -> Result<(), Exception> {
        let mut forward = mnemonic;
        forward.reverse();
        let name = forward.trim_ascii_end();
        let specific = Specific::find(name, self.drive.bank.model()).ok_or(Exception::IllegalDataAddress)?;
        if function == READ_SPECIFIC && specific == Specific::Values {
            return if data.is_empty() {
                self.read_values(name, reply)
            } else {
                Err(Exception::IllegalDataValue)
            };
        }
        let string = match data.split_first() {
            None if matches!(specific, Specific::Command(_)) => data,
            Some((&count, string)) if usize::from(count) == string.len() => string,
            _ => return Err(Exception::IllegalDataValue),
        };
        let fits = match specific {
            Specific::Command(_) => string.is_empty(),
            Specific::Values | Specific::Execute => (1..=MAX_STRING).contains(&string.len()),
        };
        if !fits {
            return Err(Exception::IllegalDataValue);
        }
        let is_text = string.iter().all(|byte| matches!(byte, b' '..=b'~'));
        let done = match specific {
            _ if !is_text => Err(Error::IllegalData),
            Specific::Values => self.write_values(name, string),
            Specific::Command(command) => {
                self.command(command);
                Ok(())
            }
            Specific::Execute => self.execute_at(string),
        };
        done.map_err(|error| self.note_refusal(error))?;
        let _ = match function {
            READ_SPECIFIC => reply.extend_from_slice(&[function, 0]),
            _ => reply
                .extend_from_slice(&[function, MNEMONIC as u8])
                .and_then(|()| reply.extend_from_slice(&mnemonic)),
        };
        Ok(())
    }

    /// Reads the values of a mnemonic, in the format that PR prints.
    fn read_values(&mut self, name: &[u8], reply: &mut Reply) -> Result<(), Exception> {
        let _ = reply.extend_from_slice(&[READ_SPECIFIC, 0]);
        let head = reply.len();
        self.drive
            .read(self.at, |reader| reader.print_values(name, &mut Answer(reply)))
            .map_err(Error::exception)?;
        let count = reply.len() - head;
        if let Some(target) = reply.get_mut(head - 1) {
            *target = (count & 0xFF) as u8;
        }
        Ok(())
    }

    /// Sets the values of a mnemonic. The string is `=` and the values, as in MCode.
    fn write_values(&mut self, name: &[u8], string: &[u8]) -> Result<(), Error> {
        if string.first() != Some(&b'=') {
            return Err(Error::IllegalData);
        }
        match self.drive.reader(self.at).parse(&joined(name, string))? {
            Statement::SetList(list, parameters) => {
                self.drive.write_list(self.at, list, &parameters, self.out)
            }
            Statement::Set(reg, value) => {
                let value = value.constant().ok_or(Error::IllegalData)?;
                self.drive.write(self.at, reg, value, self.out)
            }
            _ => Err(Error::IllegalData),
        }
    }

    fn command(&mut self, command: Command) {
        let Drive { mcode, motion, .. } = &mut *self.drive;
        let done = match command {
            Command::End => mcode.end_by_command(motion),
            Command::Pause => mcode.pause(self.at, motion, self.out),
            Command::Resume => mcode.resume(self.at, motion, self.out),
        };
        report(done, self.at, self.out);
    }

    /// Runs the program at an address or a label. The `=` before it is optional.
    fn execute_at(&mut self, place: &[u8]) -> Result<(), Error> {
        let place = place.strip_prefix(b"=").unwrap_or(place);
        match self.drive.reader(self.at).parse(&joined(b"EX ", place))? {
            Statement::Execute(place, None) => {
                self.drive.mcode.start(self.at, place, 0, &mut self.drive.motion)
            }
            _ => Err(Error::IllegalData),
        }
    }
}

/// Returns true if motion can refuse a write of this register although validation has accepted it.
fn is_order(reg: Reg) -> bool {
    matches!(reg, Reg::HM | Reg::MA | Reg::MR)
}

/// Converts a value of the bus to 32 bits. All legal values fit; a larger one becomes `i32::MAX`.
fn narrow(value: i64) -> i32 {
    i32::try_from(value).unwrap_or(i32::MAX)
}

/// Joins two texts. The result has room for a mnemonic and the longest string.
fn joined(first: &[u8], second: &[u8]) -> heapless::Vec<u8, { MNEMONIC + MAX_STRING }> {
    let mut text = heapless::Vec::new();
    let _ = text.extend_from_slice(first).and_then(|()| text.extend_from_slice(second));
    text
}

/// Text output that appends to a reply.
struct Answer<'a>(&'a mut Reply);

impl Text for Answer<'_> {
    fn write(&mut self, text: &[u8]) {
        let _ = self.0.extend_from_slice(text);
    }
}

impl RequestHandler for Bus<'_> {
    type Register = Reg;

    fn words(&self) -> &[u16] {
        self.drive.bank.words()
    }

    fn words_mut(&mut self) -> &mut [u16] {
        self.drive.bank.words_mut()
    }

    fn refresh(&mut self, register: Reg) {
        let value = self.drive.read(self.at, |reader| reader.take(register));
        self.drive.bank.set(register, value.into());
    }

    /// Does nothing, because [`RequestHandler::write_multiple`] applies all writes.
    fn written(&mut self, _register: Reg) {}

    fn entries(&self) -> &'static Entries {
        self.drive.bank.model().entries()
    }

    fn write_multiple(&mut self, values: &Values<'_, Reg>) -> Option<Result<(), Exception>> {
        Some(self.write_all(values).map_err(|error| self.note_refusal(error)))
    }

    fn on_out_of_range(&mut self, register: Reg, value: i64) {
        let validated = self
            .drive
            .bank
            .validate_together(register, narrow(value), &|other| self.drive.bank.stored(other));
        // Validation may accept the value, because the bus has narrower ranges of some registers than MCode
        // (MDRIVE-3).
        let error = validated.err().unwrap_or_else(|| illegal(register));
        self.drive.fail(self.at, error);
    }

    fn is_present(&self, register: Reg) -> bool {
        self.drive.reader(self.at).is_present(register)
    }

    fn custom_function(&mut self, pdu: &[u8], reply: &mut Reply) -> Result<(), Exception> {
        let Some((&function, data)) = pdu.split_first() else { return Err(Exception::IllegalFunction) };
        if function == ENCAPSULATED_INTERFACE {
            return identify(self.drive, pdu, reply);
        }
        let (mnemonic, data) = data.split_first_chunk().ok_or(Exception::IllegalDataValue)?;
        self.serve_specific(function, *mnemonic, data, reply)
    }
}

/// Answers function 43 (FB 4.1.1).
fn identify(drive: &Drive, pdu: &[u8], reply: &mut Reply) -> Result<(), Exception> {
    let family = if drive.bank.model() == Model::Hybrid { b"ASI " } else { b"MDI " };
    let firmware = joined(family, &drive.bank.text(FIRMWARE));
    let (part, serial) = (drive.bank.text(PART_NUMBER), drive.bank.text(SERIAL_NUMBER));
    let ethernet = drive.bank.text(ETHERNET);
    let objects: [identification::Object<'_>; 7] = [
        (0, b"SEM USA"),
        (1, &part),
        (2, &ethernet),
        (3, b"www.imshome.com"),
        (4, b"MDrive Ethernet"),
        (5, &serial),
        (6, &firmware),
    ];
    identification::answer(pdu, CONFORMITY, &objects, reply)
}
