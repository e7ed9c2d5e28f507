// SPDX-License-Identifier: GPL-2.0-or-later
//! Declarations of what QEMU 10.0 exports: the plugin API version 4 (`qemu/qemu-plugin.h`) and a few internal functions
//! that its binary exports as well. Written by hand from the headers; no bindings generator at build time.

use std::ffi::{c_char, c_int, c_uint, c_void};

/// `QEMU_PLUGIN_VERSION` these declarations follow.
pub(crate) const PLUGIN_API: c_int = 4;
/// `QEMU_CLOCK_VIRTUAL`.
pub(crate) const CLOCK_VIRTUAL: c_int = 1;
/// `QEMU_PLUGIN_CB_NO_REGS`.
pub(crate) const CB_NO_REGS: c_int = 0;
/// `QEMU_PLUGIN_INLINE_ADD_U64`.
pub(crate) const INLINE_ADD_U64: c_int = 0;
/// `DEVICE_LITTLE_ENDIAN`.
pub(crate) const LITTLE_ENDIAN: c_int = 2;
/// `SCALE_NS`.
pub(crate) const SCALE_NS: c_int = 1;
/// `SHUTDOWN_CAUSE_GUEST_RESET`: as if the guest had asked for it.
pub(crate) const RESET_CAUSE_GUEST: c_int = 7;

/// `qemu_plugin_id_t`.
pub(crate) type PluginId = u64;

/// Only ever behind a pointer.
#[repr(C)]
pub(crate) struct Opaque {
    _private: [u8; 0],
}

/// `qemu_plugin_u64`: a counter inside a scoreboard.
#[repr(C)]
#[derive(Clone, Copy)]
pub(crate) struct PluginU64 {
    pub(crate) score: *mut Opaque,
    pub(crate) offset: usize,
}

/// `Notifier` (`qemu/notify.h`).
#[repr(C)]
pub(crate) struct Notifier {
    pub(crate) notify: extern "C" fn(*mut Notifier, *mut c_void),
    pub(crate) node: [*mut c_void; 2],
}

/// Widths a region takes (`valid` and `impl` of `MemoryRegionOps`).
#[repr(C)]
pub(crate) struct AccessValid {
    pub(crate) min: c_uint,
    pub(crate) max: c_uint,
    pub(crate) unaligned: bool,
    pub(crate) accepts: *const c_void,
}

/// See [`AccessValid`].
#[repr(C)]
pub(crate) struct AccessImpl {
    pub(crate) min: c_uint,
    pub(crate) max: c_uint,
    pub(crate) unaligned: bool,
}

/// `MemoryRegionOps` (`exec/memory.h`).
#[repr(C)]
pub(crate) struct MemoryRegionOps {
    pub(crate) read: extern "C" fn(*mut c_void, u64, c_uint) -> u64,
    pub(crate) write: extern "C" fn(*mut c_void, u64, u64, c_uint),
    pub(crate) read_with_attrs: *const c_void,
    pub(crate) write_with_attrs: *const c_void,
    pub(crate) endianness: c_int,
    pub(crate) valid: AccessValid,
    pub(crate) implemented: AccessImpl,
}

/// Room for a `MemoryRegion`: 272 bytes in 10.0, with a margin. Zero is its state before initialisation.
#[repr(C, align(16))]
pub(crate) struct MemoryRegionRoom(pub(crate) [u8; 1024]);

/// Room for a `QEMUTimer`: 48 bytes in 10.0, with a margin. Zero is its state before initialisation.
#[repr(C, align(16))]
pub(crate) struct TimerRoom(pub(crate) [u8; 128]);

unsafe extern "C" {
    // Plugin API.
    pub(crate) fn qemu_plugin_register_vcpu_tb_trans_cb(
        id: PluginId,
        callback: extern "C" fn(PluginId, *mut Opaque),
    );
    pub(crate) fn qemu_plugin_register_atexit_cb(
        id: PluginId,
        callback: extern "C" fn(PluginId, *mut c_void),
        user: *mut c_void,
    );
    pub(crate) fn qemu_plugin_tb_n_insns(tb: *const Opaque) -> usize;
    pub(crate) fn qemu_plugin_tb_get_insn(tb: *const Opaque, index: usize) -> *mut Opaque;
    pub(crate) fn qemu_plugin_insn_vaddr(insn: *const Opaque) -> u64;
    pub(crate) fn qemu_plugin_insn_data(
        insn: *const Opaque,
        into: *mut c_void,
        length: usize,
    ) -> usize;
    pub(crate) fn qemu_plugin_register_vcpu_insn_exec_cb(
        insn: *mut Opaque,
        callback: extern "C" fn(c_uint, *mut c_void),
        flags: c_int,
        user: *mut c_void,
    );
    pub(crate) fn qemu_plugin_register_vcpu_insn_exec_inline_per_vcpu(
        insn: *mut Opaque,
        operation: c_int,
        entry: PluginU64,
        value: u64,
    );
    pub(crate) fn qemu_plugin_scoreboard_new(element_size: usize) -> *mut Opaque;
    pub(crate) fn qemu_plugin_u64_sum(entry: PluginU64) -> u64;

    // Internal functions of the binary.
    pub(crate) fn qemu_add_machine_init_done_notifier(notifier: *mut Notifier);
    pub(crate) fn qemu_register_reset(callback: extern "C" fn(*mut c_void), opaque: *mut c_void);
    pub(crate) fn qemu_system_reset_request(cause: c_int);
    pub(crate) fn get_system_memory() -> *mut c_void;
    pub(crate) fn memory_region_init_io(
        region: *mut MemoryRegionRoom,
        owner: *mut c_void,
        ops: *const MemoryRegionOps,
        opaque: *mut c_void,
        name: *const c_char,
        size: u64,
    );
    pub(crate) fn memory_region_add_subregion_overlap(
        parent: *mut c_void,
        offset: u64,
        region: *mut MemoryRegionRoom,
        priority: c_int,
    );
    pub(crate) fn object_resolve_path(path: *const c_char, ambiguous: *mut bool) -> *mut c_void;
    pub(crate) fn qdev_get_gpio_in(device: *mut c_void, n: c_int) -> *mut c_void;
    pub(crate) fn qdev_get_gpio_in_named(
        device: *mut c_void,
        name: *const c_char,
        n: c_int,
    ) -> *mut c_void;
    pub(crate) fn qemu_set_irq(irq: *mut c_void, level: c_int);
    pub(crate) fn timer_init_full(
        timer: *mut TimerRoom,
        group: *mut c_void,
        clock: c_int,
        scale: c_int,
        attributes: c_int,
        callback: extern "C" fn(*mut c_void),
        opaque: *mut c_void,
    );
    pub(crate) fn timer_mod_ns(timer: *mut TimerRoom, expire_ns: i64);
    pub(crate) fn timer_del(timer: *mut TimerRoom);
    pub(crate) fn qemu_clock_get_ns(clock: c_int) -> i64;
    pub(crate) fn cpu_physical_memory_rw(
        address: u64,
        buffer: *mut c_void,
        length: u64,
        write: bool,
    );
    pub(crate) fn qemu_clock_deadline_ns_all(clock: c_int, attributes: c_int) -> i64;
    pub(crate) fn qemu_clock_run_timers(clock: c_int) -> bool;
    pub(crate) fn bql_lock_impl(file: *const c_char, line: c_int);
    pub(crate) fn bql_unlock();
    pub(crate) fn cpu_has_work(cpu: *mut c_void) -> bool;
    pub(crate) fn cpu_exit(cpu: *mut c_void);
    /// Head of the queue of processors: its first member is the first of them.
    pub(crate) static cpus_queue: *mut c_void;
    /// `TimersState`: see `crate::sleep`.
    pub(crate) static mut timers_state: [u8; 0];
    pub(crate) fn _exit(code: c_int) -> !;
}
