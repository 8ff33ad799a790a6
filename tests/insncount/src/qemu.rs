//! QEMU's interface for plugins (`qemu/qemu-plugin.h`). All `unsafe` code of this crate is here.
//!
//! | QEMU | plugin versions that it accepts |
//! |---|---|
//! | 6 to 8 | 0 and 1 |
//! | 9.0 | 2 |
//! | 9.1 | 2 and 3: `qemu_plugin_insn_data` copies an instruction's bytes, whatever the plugin declares |
//! | 9.2 to 10 | 2 to 4 or 5, which only add functions |
//!
//! The plugin must declare one version before it knows QEMU's: 1, or 2 with the feature `second-interface`.

use std::ffi::{CStr, CString, c_char, c_int, c_uint, c_void};
use std::marker::PhantomData;
use std::sync::atomic::{AtomicBool, Ordering};
use std::{ptr, slice};

use crate::thumb::Instruction;

/// Number that QEMU gives the plugin.
type Id = u64;
/// Data that QEMU passes back to a callback.
type Data = *mut c_void;

/// `QEMU_PLUGIN_CB_NO_REGS`
const NO_REGISTERS: c_int = 0;
/// `QEMU_PLUGIN_MEM_W`
const WRITES: c_int = 2;

unsafe extern "C" {
    fn qemu_plugin_register_vcpu_tb_trans_cb(id: Id, then: extern "C" fn(Id, *mut c_void));
    fn qemu_plugin_register_atexit_cb(id: Id, then: extern "C" fn(Id, Data), data: Data);
    fn qemu_plugin_tb_n_insns(block: *const c_void) -> usize;
    fn qemu_plugin_tb_get_insn(block: *const c_void, place: usize) -> *mut c_void;
    fn qemu_plugin_insn_vaddr(instruction: *const c_void) -> u64;
    /// Before version 3: returns the address of the instruction's bytes.
    fn qemu_plugin_insn_data(instruction: *const c_void) -> *const u8;
    fn qemu_plugin_insn_size(instruction: *const c_void) -> usize;
    fn qemu_plugin_register_vcpu_insn_exec_cb(
        instruction: *mut c_void,
        then: extern "C" fn(c_uint, Data),
        flags: c_int,
        data: Data,
    );
    fn qemu_plugin_register_vcpu_mem_cb(
        instruction: *mut c_void,
        then: extern "C" fn(c_uint, u32, u64, Data),
        flags: c_int,
        which: c_int,
        data: Data,
    );
    fn qemu_plugin_outs(text: *const c_char);
}

/// From version 3 on, QEMU has another function with the name of the old one.
mod since_3 {
    use std::ffi::c_void;

    #[expect(clashing_extern_declarations, reason = "QEMU says at run time which of the two it has")]
    unsafe extern "C" {
        /// Copies at most `most` bytes of the instruction to `to`. Returns the number of bytes copied.
        pub(super) fn qemu_plugin_insn_data(
            instruction: *const c_void,
            to: *mut c_void,
            most: usize,
        ) -> usize;
    }
}

/// Version of the plugin interface that the plugin declares.
#[unsafe(no_mangle)]
pub static qemu_plugin_version: c_int = if cfg!(feature = "second-interface") { 2 } else { 1 };

/// The first version in which QEMU copies the bytes of an instruction.
const COPIES: c_int = 3;

/// True if this QEMU copies the bytes of an instruction.
static DOES_COPY: AtomicBool = AtomicBool::new(false);

/// Information about QEMU; only its first fields.
#[repr(C)]
pub struct Info {
    target: *const c_char,
    least_version: c_int,
    version: c_int,
}

/// Entry point for QEMU.
///
/// # Safety
/// `info` points to QEMU's information, and `argv` to `argc` strings, as QEMU passes them.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn qemu_plugin_install(
    id: Id,
    info: *const Info,
    argc: c_int,
    argv: *const *const c_char,
) -> c_int {
    // SAFETY: `info` points to QEMU's information.
    let version = unsafe { (*info).version };
    DOES_COPY.store(version >= COPIES, Ordering::Relaxed);
    let count = usize::try_from(argc).unwrap_or(0);
    for place in 0..count {
        // SAFETY: `argv` points to `argc` pointers.
        let argument = unsafe { argv.add(place) };
        // SAFETY: `argument` points to a pointer.
        let argument = unsafe { argument.read() };
        // SAFETY: the pointer points to a string.
        let argument = unsafe { CStr::from_ptr(argument) };
        if let Err(error) = crate::configure(&argument.to_string_lossy()) {
            eprintln!("insncount: {error}");
            return 1;
        }
    }
    // SAFETY: `id` is the number of the plugin that is being installed.
    unsafe { qemu_plugin_register_vcpu_tb_trans_cb(id, on_translation) };
    // SAFETY: as above, `id` is the number of the plugin.
    unsafe { qemu_plugin_register_atexit_cb(id, on_exit, ptr::null_mut()) };
    0
}

/// A block of instructions that QEMU has translated together.
pub(crate) struct Block(*const c_void);

impl Block {
    /// The instructions, in the order of their addresses.
    pub(crate) fn instructions(&self) -> impl Iterator<Item = Translated<'_>> {
        // SAFETY: QEMU passed this block to the callback that is running.
        let count = unsafe { qemu_plugin_tb_n_insns(self.0) };
        (0..count).map(|place| {
            // SAFETY: the same, and `place` is less than the number of instructions.
            let instruction = unsafe { qemu_plugin_tb_get_insn(self.0, place) };
            Translated(instruction, PhantomData)
        })
    }
}

/// Length of the longest instruction, in bytes.
const LONGEST: usize = 4;

/// An instruction of a block.
pub(crate) struct Translated<'a>(*mut c_void, PhantomData<&'a Block>);

impl Translated<'_> {
    /// Address.
    fn address(&self) -> u32 {
        // SAFETY: the block from which it is borrowed is valid.
        unsafe { qemu_plugin_insn_vaddr(self.0) as u32 }
    }

    /// Decoded instruction.
    pub(crate) fn decode(&self) -> Instruction {
        // SAFETY: the block from which it is borrowed is valid.
        let size = unsafe { qemu_plugin_insn_size(self.0) };
        if DOES_COPY.load(Ordering::Relaxed) {
            let mut code = [0; LONGEST];
            let to = code.as_mut_ptr().cast();
            // SAFETY: the block is valid, QEMU has this version of the function, and `code` has room for that
            // many bytes.
            let copied = unsafe { since_3::qemu_plugin_insn_data(self.0, to, code.len()) };
            return Instruction::decode(self.address(), code.get(..copied.min(size)).unwrap_or_default());
        }
        // SAFETY: the block is valid, and QEMU has the old version of the function.
        let code = unsafe { qemu_plugin_insn_data(self.0) };
        // SAFETY: QEMU keeps `size` bytes as long as the block exists.
        Instruction::decode(self.address(), unsafe { slice::from_raw_parts(code, size) })
    }

    /// Asks QEMU to call [`executed`](crate::executed) whenever this instruction is executed.
    pub(crate) fn tell_executed(&self, place: usize) {
        let data = ptr::without_provenance_mut(place);
        // SAFETY: the block from which it is borrowed is valid, and the data is not used as an address.
        unsafe { qemu_plugin_register_vcpu_insn_exec_cb(self.0, on_execution, NO_REGISTERS, data) };
    }

    /// Asks QEMU to call [`stored`](crate::stored) whenever this instruction writes to memory.
    pub(crate) fn tell_stored(&self) {
        let none = ptr::null_mut();
        // SAFETY: the block from which it is borrowed is valid.
        unsafe { qemu_plugin_register_vcpu_mem_cb(self.0, on_store, NO_REGISTERS, WRITES, none) };
    }
}

extern "C" fn on_translation(_id: Id, block: *mut c_void) {
    crate::translated(&Block(block));
}

extern "C" fn on_execution(_cpu: c_uint, data: Data) {
    crate::executed(data.addr());
}

extern "C" fn on_store(_cpu: c_uint, _info: u32, address: u64, _data: Data) {
    crate::stored(address as u32);
}

extern "C" fn on_exit(_id: Id, _data: Data) {
    if let Ok(text) = CString::new(crate::report()) {
        // SAFETY: the text exists until QEMU has written it.
        unsafe { qemu_plugin_outs(text.as_ptr()) };
    }
}
