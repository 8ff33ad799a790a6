//! Functions of the boot ROM (5.4), and the number of the chip.

use core::mem::transmute_copy;
use core::ptr;

use crate::registers::Register;

/// Finds a function of the boot ROM by its two letters (5.4).
///
/// # Safety
/// `F` is a function pointer with the signature that the datasheet declares for this function.
pub(crate) unsafe fn function<F>(letters: [u8; 2]) -> F {
    /// Half-word of the ROM with the address of the function that searches its table.
    const LOOKUP: *const u16 = ptr::without_provenance(0x16);
    /// The function is to be called by Arm code in the secure state.
    const ARM_SECURE: u32 = 0x0004;
    // SAFETY: the ROM is always mapped.
    let lookup = usize::from(unsafe { LOOKUP.read_volatile() });
    // SAFETY: the function takes the letters and a mask, and returns an address.
    let lookup: extern "C" fn(u32, u32) -> usize = unsafe { transmute_copy(&lookup) };
    let function = lookup(u32::from(u16::from_le_bytes(letters)), ARM_SECURE);
    // SAFETY: an address is as wide as a function pointer; every version of the ROM has these functions.
    unsafe { transmute_copy(&function) }
}

/// Starts the boot loader (5.4.8.24). `light` is the bit of the pin that is lit while a file is received.
pub(crate) fn start_boot_loader(light: u32) {
    /// A start of the boot loader, after which the function does not return.
    const BOOTSEL: u32 = 0x2;
    const NO_RETURN: u32 = 0x100;
    const HAS_LIGHT: u32 = 0x20;
    const DELAY_MS: u32 = 10;
    // SAFETY: "reboot" takes flags, a delay in ms, and two arguments that depend on the flags: here flags of the boot loader
    // and the number of a pin.
    let reboot: extern "C" fn(u32, u32, u32, u32) -> i32 = unsafe { function(*b"RB") };
    reboot(BOOTSEL | NO_RETURN, DELAY_MS, HAS_LIGHT, light.trailing_zeros());
}

/// Rows of the memory that is programmed once, with their errors corrected, two in a word (13.1).
const OTP: usize = 0x4013_0000;

/// The number that every chip has of its own (rows CHIPID0 to CHIPID3), with the last byte first, as the boot loader shows it.
pub(crate) fn unique_id() -> [u8; 8] {
    let [low, high] = [0, 4].map(|offset| Register::at(OTP, offset).read());
    (u64::from(high) << 32 | u64::from(low)).to_be_bytes()
}
