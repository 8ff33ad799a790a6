//! Functions of the boot ROM (2.8.3), and the number of the flash chip.

use core::mem::transmute_copy;
use core::ptr;

use crate::flash;
use crate::registers::Register;

/// Finds a function of the boot ROM by its two letters (2.8.3).
///
/// # Safety
/// `F` is a function pointer with the signature that the datasheet declares for this function.
pub(crate) unsafe fn function<F>(letters: [u8; 2]) -> F {
    /// Half-words of the ROM with addresses: of the list of functions, and of the function that searches it.
    const FUNCTIONS: *const u16 = ptr::without_provenance(0x14);
    const LOOKUP: *const u16 = ptr::without_provenance(0x18);
    // SAFETY: the ROM is always mapped.
    let functions = usize::from(unsafe { FUNCTIONS.read_volatile() });
    // SAFETY: as above.
    let lookup = usize::from(unsafe { LOOKUP.read_volatile() });
    // SAFETY: the function takes the list and the letters, and returns an address.
    let lookup: extern "C" fn(usize, u32) -> usize = unsafe { transmute_copy(&lookup) };
    let function = lookup(functions, u32::from(u16::from_le_bytes(letters)));
    // SAFETY: an address is as wide as a function pointer; every version of the ROM has these functions.
    unsafe { transmute_copy(&function) }
}

/// Starts the boot loader (2.8.3.1.5). Returns if this version of the ROM does not have the function. `light` is the bit of
/// the pin that is lit while a file is received.
pub(crate) fn start_boot_loader(light: u32) {
    // SAFETY: "reset_to_usb_boot" takes the pin of a light, and interfaces to leave out.
    let reset_to_usb_boot: extern "C" fn(u32, u32) = unsafe { function(*b"UB") };
    reset_to_usb_boot(light, 0);
}

/// Registers of the interface to the flash chip (4.10.13), and of its select pin (2.19.6.2).
const SSI: usize = 0x1800_0000;
const SSI_SR: Register = Register::at(SSI, 0x28);
const SSI_DR0: Register = Register::at(SSI, 0x60);
const SELECT: Register = Register::at(0x4001_8000, 0x0C);

/// The number that every flash chip has of its own ("Read Unique ID Number", flash chip, 8.2.31).
pub(crate) fn unique_id() -> [u8; 8] {
    const READ_UNIQUE_ID: u8 = 0x4B;
    /// The command, four bytes more, and the answer.
    const LENGTH: usize = 1 + 4 + 8;
    const RECEIVED: u32 = 1 << 3;
    /// Overrides of the select pin, which `flash_flush_cache` ends.
    const LOW: u32 = 2 << 8;
    const HIGH: u32 = 3 << 8;

    let mut bytes = [0; LENGTH];
    bytes[0] = READ_UNIQUE_ID;
    flash::command(|| {
        SELECT.set(LOW);
        for byte in &mut bytes {
            SSI_DR0.write(u32::from(*byte));
            while SSI_SR.read() & RECEIVED == 0 {}
            *byte = SSI_DR0.read() as u8;
        }
        SELECT.set(HIGH);
    });
    bytes.last_chunk().copied().unwrap_or_default()
}
