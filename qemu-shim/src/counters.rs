// SPDX-License-Identifier: GPL-2.0-or-later
//! Instruction counters between two addresses of the image.

use std::ffi::{c_int, c_uint, c_void};
use std::sync::{Mutex, PoisonError};

use crate::ffi::{self, Opaque, PluginId, PluginU64};
use crate::options::RegionOption;
use crate::wire::RegionCount;

struct Region {
    option: RegionOption,
    opened_at: Option<u64>,
    count: RegionCount,
}

struct Counters {
    total: PluginU64,
    regions: Vec<Region>,
}

// SAFETY: the scoreboard pointer is only handed back to QEMU, whose scoreboard functions take any thread.
unsafe impl Send for Counters {}

static COUNTERS: Mutex<Option<Counters>> = Mutex::new(None);

/// Starts counting; called once, at installation.
pub(crate) fn install(id: PluginId, regions: &[RegionOption]) {
    // SAFETY: called by QEMU during plugin installation, where scoreboards may be made.
    let score = unsafe { ffi::qemu_plugin_scoreboard_new(size_of::<u64>()) };
    let regions = regions
        .iter()
        .map(|option| Region {
            option: option.clone(),
            opened_at: None,
            count: RegionCount::default(),
        })
        .collect();
    *COUNTERS.lock().unwrap_or_else(PoisonError::into_inner) = Some(Counters {
        total: PluginU64 { score, offset: 0 },
        regions,
    });
    // SAFETY: `id` is the one QEMU gave to the installation; the callback has the right type.
    unsafe { ffi::qemu_plugin_register_vcpu_tb_trans_cb(id, translated) };
}

/// Instructions so far, and the regions.
pub(crate) fn read() -> (u64, Vec<RegionCount>) {
    let guard = COUNTERS.lock().unwrap_or_else(PoisonError::into_inner);
    guard.as_ref().map_or((0, Vec::new()), |c| {
        // SAFETY: the scoreboard was made at installation and is never freed.
        let total = unsafe { ffi::qemu_plugin_u64_sum(c.total) };
        (total, c.regions.iter().map(|r| r.count).collect())
    })
}

extern "C" fn translated(_id: PluginId, tb: *mut Opaque) {
    let guard = COUNTERS.lock().unwrap_or_else(PoisonError::into_inner);
    let Some(counters) = guard.as_ref() else {
        return;
    };
    // SAFETY: QEMU passes a translation block that is valid during this call.
    let count = unsafe { ffi::qemu_plugin_tb_n_insns(tb) };
    for index in 0..count {
        // SAFETY: `index` is below the number of instructions of this block.
        let (instruction, address) = unsafe {
            let instruction = ffi::qemu_plugin_tb_get_insn(tb, index);
            (instruction, ffi::qemu_plugin_insn_vaddr(instruction))
        };
        // SAFETY: the instruction belongs to the block being translated; the scoreboard holds one u64 per vCPU.
        unsafe {
            ffi::qemu_plugin_register_vcpu_insn_exec_inline_per_vcpu(
                instruction,
                ffi::INLINE_ADD_U64 as c_int,
                counters.total,
                1,
            );
        }
        if counters
            .regions
            .iter()
            .any(|r| r.option.begin == address || r.option.ends.contains(&address))
        {
            // SAFETY: as above; the user pointer carries a guest address and is never dereferenced.
            unsafe {
                ffi::qemu_plugin_register_vcpu_insn_exec_cb(
                    instruction,
                    visited,
                    ffi::CB_NO_REGS,
                    std::ptr::without_provenance_mut(address as usize),
                );
            }
        }
    }
}

extern "C" fn visited(_vcpu: c_uint, user: *mut c_void) {
    let address = user.addr() as u64;
    let mut guard = COUNTERS.lock().unwrap_or_else(PoisonError::into_inner);
    let Some(counters) = guard.as_mut() else {
        return;
    };
    // SAFETY: the scoreboard was made at installation and is never freed.
    let now = unsafe { ffi::qemu_plugin_u64_sum(counters.total) };
    for region in &mut counters.regions {
        if region.option.ends.contains(&address)
            && let Some(begin) = region.opened_at.take()
        {
            region.count.add(now.saturating_sub(begin));
        }
        if region.option.begin == address {
            region.opened_at = Some(now);
        }
    }
}

impl RegionCount {
    fn add(&mut self, instructions: u64) {
        self.min = if self.runs == 0 {
            instructions
        } else {
            self.min.min(instructions)
        };
        self.max = self.max.max(instructions);
        self.sum += instructions;
        self.runs += 1;
    }
}
