//! QEMU's interface for plugins, version 1 (`qemu/qemu-plugin.h`): the only `unsafe` code here.

use std::ffi::{CStr, CString, c_char, c_int, c_uint, c_void};
use std::marker::PhantomData;
use std::{ptr, slice};

/// Which plugin is meant.
type Id = u64;
/// What a callback is given back.
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

/// The version of the interface.
#[unsafe(no_mangle)]
pub static qemu_plugin_version: c_int = 1;

/// Where QEMU begins.
///
/// # Safety
/// `argv` points to `argc` strings, as QEMU's does.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn qemu_plugin_install(
    id: Id,
    _info: *const c_void,
    argc: c_int,
    argv: *const *const c_char,
) -> c_int {
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
    /// Its instructions, in their order.
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

/// An instruction of a block.
pub(crate) struct Translated<'a>(*mut c_void, PhantomData<&'a Block>);

impl Translated<'_> {
    /// Where it lies.
    pub(crate) fn address(&self) -> u32 {
        // SAFETY: the block that it is borrowed from is valid.
        unsafe { qemu_plugin_insn_vaddr(self.0) as u32 }
    }

    /// Its bytes.
    pub(crate) fn code(&self) -> &[u8] {
        // SAFETY: the block that it is borrowed from is valid.
        let (code, size) =
            (unsafe { qemu_plugin_insn_data(self.0) }, unsafe { qemu_plugin_insn_size(self.0) });
        // SAFETY: QEMU keeps that many bytes as long as the block.
        unsafe { slice::from_raw_parts(code, size) }
    }

    /// From now on [`executed`](crate::executed) is told when it is executed.
    pub(crate) fn tell_executed(&self, place: usize) {
        let data = ptr::without_provenance_mut(place);
        // SAFETY: the block that it is borrowed from is valid; the data is no address.
        unsafe { qemu_plugin_register_vcpu_insn_exec_cb(self.0, on_execution, NO_REGISTERS, data) };
    }

    /// From now on [`stored`](crate::stored) is told when it writes.
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
