//! QEMU's interface for plugins (`qemu/qemu-plugin.h`): the only `unsafe` code here.
//!
//! | QEMU | versions that it takes |
//! |---|---|
//! | 6 to 8 | 0 and 1 |
//! | 9.0 | 2 |
//! | 9.1 | 2 and 3: `qemu_plugin_insn_data` copies the bytes of an instruction, whatever version the plugin has |
//! | 9.2 to 10 | 2 to 4 or 5, which only add |
//!
//! The plugin declares one version, before it gets QEMU's: 1, or with the feature `second-interface` 2.

use std::ffi::{CStr, CString, c_char, c_int, c_uint, c_void};
use std::marker::PhantomData;
use std::sync::atomic::{AtomicBool, Ordering};
use std::{ptr, slice};

use crate::thumb::Instruction;

/// Which plugin is meant.
type Id = u64;
/// Data that a callback gets back.
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
    /// Before version 3: where the bytes are.
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

/// The function of version 3 that replaces the other one of this name.
mod since_3 {
    use std::ffi::c_void;

    #[expect(clashing_extern_declarations, reason = "QEMU says at run time which of the two it has")]
    unsafe extern "C" {
        /// Copies at most that many of the bytes to `to`; returns their number.
        pub(super) fn qemu_plugin_insn_data(
            instruction: *const c_void,
            to: *mut c_void,
            most: usize,
        ) -> usize;
    }
}

/// The version of the interface.
#[unsafe(no_mangle)]
pub static qemu_plugin_version: c_int = if cfg!(feature = "second-interface") { 2 } else { 1 };

/// The first version in which QEMU copies the bytes of an instruction.
const COPIES: c_int = 3;

/// True if this QEMU copies them.
static DOES_COPY: AtomicBool = AtomicBool::new(false);

/// QEMU's information about itself; only the first fields.
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
    // SAFETY: it points there.
    let version = unsafe { (*info).version };
    DOES_COPY.store(version >= COPIES, Ordering::Relaxed);
    let count = usize::try_from(argc).unwrap_or(0);
    for place in 0..count {
        // SAFETY: there are `argc` of them.
        let argument = unsafe { argv.add(place) };
        // SAFETY: it points to a pointer.
        let argument = unsafe { argument.read() };
        // SAFETY: that points to a string.
        let argument = unsafe { CStr::from_ptr(argument) };
        if let Err(error) = crate::configure(&argument.to_string_lossy()) {
            eprintln!("insncount: {error}");
            return 1;
        }
    }
    // SAFETY: this is the plugin that is being installed.
    unsafe { qemu_plugin_register_vcpu_tb_trans_cb(id, on_translation) };
    // SAFETY: the same.
    unsafe { qemu_plugin_register_atexit_cb(id, on_exit, ptr::null_mut()) };
    0
}

/// Instructions that were translated together.
pub(crate) struct Block(*const c_void);

impl Block {
    /// Instructions, in their order.
    pub(crate) fn instructions(&self) -> impl Iterator<Item = Translated<'_>> {
        // SAFETY: QEMU gave us this block, and we are in its callback.
        let count = unsafe { qemu_plugin_tb_n_insns(self.0) };
        (0..count).map(|place| {
            // SAFETY: the same, and the place is one of the block's.
            let instruction = unsafe { qemu_plugin_tb_get_insn(self.0, place) };
            Translated(instruction, PhantomData)
        })
    }
}

/// Bytes of the longest instruction.
const LONGEST: usize = 4;

/// An instruction of a block.
pub(crate) struct Translated<'a>(*mut c_void, PhantomData<&'a Block>);

impl Translated<'_> {
    /// Address.
    fn address(&self) -> u32 {
        // SAFETY: the block that it is borrowed from is valid.
        unsafe { qemu_plugin_insn_vaddr(self.0) as u32 }
    }

    /// Decoded instruction.
    pub(crate) fn decode(&self) -> Instruction {
        // SAFETY: the block that it is borrowed from is valid.
        let size = unsafe { qemu_plugin_insn_size(self.0) };
        if DOES_COPY.load(Ordering::Relaxed) {
            let mut code = [0; LONGEST];
            let to = code.as_mut_ptr().cast();
            // SAFETY: the same, and QEMU has the function of this version; there is room for that many bytes.
            let copied = unsafe { since_3::qemu_plugin_insn_data(self.0, to, code.len()) };
            return Instruction::decode(self.address(), code.get(..copied.min(size)).unwrap_or_default());
        }
        // SAFETY: the same, and QEMU has the function of before.
        let code = unsafe { qemu_plugin_insn_data(self.0) };
        // SAFETY: QEMU keeps that many bytes as long as the block.
        Instruction::decode(self.address(), unsafe { slice::from_raw_parts(code, size) })
    }

    /// From now on [`executed`](crate::executed) is called when it is executed.
    pub(crate) fn tell_executed(&self, place: usize) {
        let data = ptr::without_provenance_mut(place);
        // SAFETY: the block that it is borrowed from is valid; the data is no address.
        unsafe { qemu_plugin_register_vcpu_insn_exec_cb(self.0, on_execution, NO_REGISTERS, data) };
    }

    /// From now on [`stored`](crate::stored) is called when it writes.
    pub(crate) fn tell_stored(&self) {
        let none = ptr::null_mut();
        // SAFETY: the block that it is borrowed from is valid.
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
        // SAFETY: the text lives until QEMU has written it.
        unsafe { qemu_plugin_outs(text.as_ptr()) };
    }
}
