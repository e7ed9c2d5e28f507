// SPDX-License-Identifier: GPL-2.0-or-later
//! QEMU TCG plugin: lock-step with the emulated drivers, and the peripherals QEMU lacks. Developer tool, never shipped.
//!
//! Loaded with `-plugin librb_qemu_shim.so,socket=PATH,…`, it lets the unmodified firmware image run on the machine
//! `b-l475e-iot01a` of QEMU 10.0:
//!
//! * `machine`: the blocks in QEMU's memory map, the STOP input, the lock-step;
//! * `usart`, `blocks`: register models: USARTs with byte times, flash, watchdog, ADC, RNG;
//! * `counters`: instructions between two addresses; `sleep`: what happens at WFI.
//!
//! It uses the plugin API and some functions that the QEMU binary happens to export. The layouts it relies on are those
//! of 10.0: pin the package. Guest time is `-icount` time; the host side of the socket is `hil_sim::board`.

mod blocks;
mod counters;
mod ffi;
mod machine;
mod options;
mod sleep;
mod usart;
#[path = "../../hil-sim/src/board/wire.rs"]
pub mod wire;

use std::ffi::{CStr, c_char, c_int, c_void};

/// The plugin API version this library was written for; QEMU refuses to load another one.
#[unsafe(no_mangle)]
pub static qemu_plugin_version: c_int = ffi::PLUGIN_API;

/// Called by QEMU when it loads the plugin.
///
/// # Safety
/// QEMU passes `argc` valid C strings in `argv`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn qemu_plugin_install(
    id: ffi::PluginId,
    _info: *const c_void,
    argc: c_int,
    argv: *const *const c_char,
) -> c_int {
    let count = usize::try_from(argc).unwrap_or(0);
    let arguments = (0..count).map(|index| {
        // SAFETY: the caller passes `argc` strings that live during this call.
        let text = unsafe { CStr::from_ptr(*argv.add(index)) };
        text.to_str().unwrap_or("?")
    });
    let options = match options::parse(arguments) {
        Ok(options) => options,
        Err(error) => {
            eprintln!(
                "rb-shim: {error:?}; options are socket=PATH[,clock=HZ][,seed=N][,rng=FAULT][,region=BEGIN:END+END][,profile=FILE][,stack=LOW:HIGH]"
            );
            return 1;
        }
    };
    counters::install(id, &options);
    if let Err(error) = machine::install(options) {
        eprintln!("rb-shim: cannot reach the host side: {error}");
        return 1;
    }
    // SAFETY: `id` is the one of this installation; the callback has the right type and needs no data.
    unsafe { ffi::qemu_plugin_register_atexit_cb(id, at_exit, std::ptr::null_mut()) };
    0
}

extern "C" fn at_exit(_id: ffi::PluginId, _user: *mut c_void) {
    machine::finish();
}
