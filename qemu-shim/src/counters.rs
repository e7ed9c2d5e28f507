// SPDX-License-Identifier: GPL-2.0-or-later
//! Counters between two addresses of the image.

use std::ffi::{c_uint, c_void};
use std::sync::{Mutex, PoisonError};

use crate::ffi::{self, Opaque, PluginId, PluginU64};
use crate::options::{Options, RegionOption};
use crate::sleep;
use crate::wire::RegionCount;

struct Region {
    option: RegionOption,
    opened_at: Option<u64>,
    in_period: u64,
    count: RegionCount,
}

struct Counters {
    /// Element 0 of the scoreboard counts everything, element 1 + n the n-th function of the profile.
    score: *mut Opaque,
    profile: Vec<(u64, u64)>,
    /// Counts of the profile at the last restart.
    forgotten: Vec<u64>,
    regions: Vec<Region>,
}

// SAFETY: the scoreboard pointer is only handed back to QEMU, whose scoreboard functions take any thread.
unsafe impl Send for Counters {}

static COUNTERS: Mutex<Option<Counters>> = Mutex::new(None);

/// Starts counting; called once, at installation.
pub(crate) fn install(id: PluginId, options: &Options) {
    let profile = options.profile.clone();
    // SAFETY: called by QEMU during plugin installation, where scoreboards may be made.
    let score = unsafe { ffi::qemu_plugin_scoreboard_new((1 + profile.len()) * size_of::<u64>()) };
    let regions = options
        .regions
        .iter()
        .map(|option| Region {
            option: option.clone(),
            opened_at: None,
            in_period: 0,
            count: RegionCount::default(),
        })
        .collect();
    *COUNTERS.lock().unwrap_or_else(PoisonError::into_inner) = Some(Counters {
        score,
        forgotten: vec![0; profile.len()],
        profile,
        regions,
    });
    // SAFETY: `id` is the one QEMU gave to the installation; the callback has the right type.
    unsafe { ffi::qemu_plugin_register_vcpu_tb_trans_cb(id, translated) };
}

/// Instructions so far, the regions, and the instructions of each function of the profile.
pub(crate) fn read() -> (u64, Vec<RegionCount>, Vec<u64>) {
    let guard = COUNTERS.lock().unwrap_or_else(PoisonError::into_inner);
    guard.as_ref().map_or((0, Vec::new(), Vec::new()), |c| {
        let regions = c.regions.iter().map(|r| r.count).collect();
        let since = |(n, &before): (usize, &u64)| c.sum(1 + n).saturating_sub(before);
        let profile = c.forgotten.iter().enumerate().map(since).collect();
        (c.sum(0), regions, profile)
    })
}

/// Forgets what was counted but for the total.
pub(crate) fn restart() {
    let mut guard = COUNTERS.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(counters) = guard.as_mut() {
        counters.forgotten = (1..=counters.profile.len())
            .map(|n| counters.sum(n))
            .collect();
        for region in &mut counters.regions {
            region.opened_at = None;
            region.in_period = 0;
            region.count = RegionCount::default();
        }
    }
}

impl Counters {
    fn element(&self, index: usize) -> PluginU64 {
        PluginU64 {
            score: self.score,
            offset: index * size_of::<u64>(),
        }
    }

    fn sum(&self, index: usize) -> u64 {
        // SAFETY: the scoreboard was made at installation with this many elements and is never freed.
        unsafe { ffi::qemu_plugin_u64_sum(self.element(index)) }
    }

    fn function_at(&self, address: u64) -> Option<usize> {
        let after = self.profile.partition_point(|&(start, _)| start <= address);
        let index = after.checked_sub(1)?;
        (address < self.profile[index].1).then_some(1 + index)
    }
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
        sleep::watch(instruction);
        let function = counters.function_at(address);
        for element in [Some(0), function].into_iter().flatten() {
            // SAFETY: the instruction belongs to the block being translated; the scoreboard has this element.
            unsafe {
                ffi::qemu_plugin_register_vcpu_insn_exec_inline_per_vcpu(
                    instruction,
                    ffi::INLINE_ADD_U64,
                    counters.element(element),
                    1,
                );
            }
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
    let now = counters.sum(0);
    if counters
        .regions
        .first()
        .is_some_and(|first| first.option.begin == address)
    {
        counters.regions.iter_mut().for_each(Region::end_period);
    }
    for region in &mut counters.regions {
        if region.option.ends.contains(&address)
            && let Some(begin) = region.opened_at.take()
        {
            let instructions = now.saturating_sub(begin);
            region.in_period += instructions;
            region.count.add(instructions);
        }
        if region.option.begin == address {
            region.opened_at = Some(now);
        }
    }
}

impl Region {
    /// The first region's begin divides time into periods.
    fn end_period(&mut self) {
        self.count.most_in_period = self.count.most_in_period.max(self.in_period);
        self.in_period = 0;
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
