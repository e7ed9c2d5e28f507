//! Bound of the stack from the image alone: frame of every function, call graph, interrupts on top.
//!
//! Frames are read from the instructions that lower the stack pointer; calls from `bl` and branches that leave the
//! function. A call through a pointer may reach any function whose address stands in the image; it is taken as the
//! deepest of them, two levels of such calls at most. Tasks are the exception: only the executor's loop polls them.
//! What cannot be bounded is listed.

use std::collections::{BTreeMap, BTreeSet};

use super::elf::Elf;

/// Exception frame with floating point registers: 26 words and 4 bytes of alignment (ARMv7-M B1.5.6).
pub const EXCEPTION_FRAME_BYTES: u32 = 108;
/// Part of the name of a task's entry, and of the only function that calls it.
const TASK: &str = "TaskStorage";
const TASK_CALLER: &str = "stm328executor";
/// Levels of calls through pointers that are followed.
const POINTER_LEVELS: u32 = 2;

/// One function as far as the stack is concerned.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Frame {
    /// Mangled name.
    pub name: String,
    /// Bytes it takes itself.
    pub bytes: u32,
    /// Entry addresses of what it calls or jumps to.
    pub calls: BTreeSet<u32>,
    /// Addresses that it loads in two halves.
    pub loads: BTreeSet<u32>,
    /// It calls through a pointer.
    pub indirect: bool,
    low_half: [u32; 16],
    /// It moves the stack pointer by an amount that is not in the instruction.
    pub unbounded: bool,
}

/// The bound.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StackBound {
    /// Deepest path from reset.
    pub thread_bytes: u32,
    /// Deepest interrupt handler with its exception frame. All have one priority, so they do not nest.
    pub interrupt_bytes: u32,
    /// Fault handler on top of both.
    pub fault_bytes: u32,
    /// Functions on a cycle of direct calls: recursion, counted once.
    pub recursive: Vec<String>,
    /// Functions whose frame is not a constant.
    pub unbounded: Vec<String>,
}

impl StackBound {
    /// Everything at once.
    #[must_use]
    pub fn total_bytes(&self) -> u32 {
        self.thread_bytes + self.interrupt_bytes + self.fault_bytes
    }
}

/// Reads every function of the image.
#[must_use]
pub fn frames(elf: &Elf<'_>) -> BTreeMap<u32, Frame> {
    let mut marks: Vec<(u32, bool)> = elf
        .symbols
        .iter()
        .filter(|s| s.name.starts_with("$t") || s.name.starts_with("$d"))
        .map(|s| (s.address, s.name.starts_with("$t")))
        .collect();
    marks.sort_unstable();
    let mut functions = BTreeMap::new();
    for symbol in elf.symbols.iter().filter(|s| s.function && s.size > 0) {
        let mut frame = Frame {
            name: symbol.name.clone(),
            ..Frame::default()
        };
        let end = symbol.address + symbol.size;
        let mut at = symbol.address;
        while at + 2 <= end {
            let next_mark = marks.partition_point(|&(address, _)| address <= at);
            if next_mark > 0 && !marks[next_mark - 1].1 {
                // A literal pool or jump table: on to the next code mark.
                at = marks[next_mark..].iter().find(|m| m.1).map_or(end, |m| m.0);
                continue;
            }
            let Some(first) = elf.half_at(at) else { break };
            if first >= 0xe800 {
                let second = elf.half_at(at + 2).unwrap_or(0);
                frame.take_wide(first, second, at, symbol.address..end);
                at += 4;
            } else {
                frame.take_narrow(first, at, symbol.address..end);
                at += 2;
            }
        }
        functions.insert(symbol.address, frame);
    }
    functions
}

impl Frame {
    fn take_narrow(&mut self, op: u16, at: u32, own: std::ops::Range<u32>) {
        let low = u32::from(op & 0xff);
        match op >> 8 {
            // PUSH, with LR or without.
            0xb4 | 0xb5 => self.bytes += 4 * (low.count_ones() + u32::from(op >> 8 & 1)),
            // SUB SP, SP, #imm7 * 4.
            0xb0 if op & 0x80 != 0 => self.bytes += 4 * (low & 0x7f),
            // BLX register; BX of a register that is not LR.
            0x47 if op & 0x80 != 0 || (op >> 3) & 0xf != 14 => self.indirect = true,
            // B: a jump out of the function is a tail call.
            0xe0..=0xe7 => {
                let offset = ((i32::from(op & 0x7ff)) << 21) >> 20;
                self.jump(at.wrapping_add(4).wrapping_add_signed(offset), own);
            }
            _ => {}
        }
    }

    fn take_wide(&mut self, first: u16, second: u16, at: u32, own: std::ops::Range<u32>) {
        let immediate = wide_immediate(first, second);
        match (first, second) {
            (0xe92d, list) => self.bytes += 4 * list.count_ones(),
            (0xf84d, s) if s & 0x0fff == 0x0d04 => self.bytes += 4,
            (f, s) if f & 0xffbf == 0xed2d && s & 0x0e00 == 0x0a00 => {
                self.bytes += 4 * u32::from(s & 0xff)
            }
            // STRD with write-back on SP.
            (0xe96d, s) => self.bytes += 4 * u32::from(s & 0xff),
            (f, s) if f & 0xfbef == 0xf1ad && s & 0x8f00 == 0x0d00 => {
                self.bytes += expand(immediate)
            }
            (f, s) if f & 0xfbff == 0xf2ad && s & 0x8f00 == 0x0d00 => self.bytes += immediate,
            (0xebad, s) if s & 0x0f00 == 0x0d00 => self.unbounded = true,
            // MOVW, MOVT.
            (f, s) if f & 0xfbf0 == 0xf240 && s & 0x8000 == 0 => {
                self.low_half[usize::from(s >> 8 & 0xf)] = wide_16(f, s);
            }
            (f, s) if f & 0xfbf0 == 0xf2c0 && s & 0x8000 == 0 => {
                let low = self.low_half[usize::from(s >> 8 & 0xf)];
                self.loads.insert((wide_16(f, s) << 16 | low) & !1);
            }
            // B.W, BL; the conditional B.W (encoding T3) does not leave a function.
            (f, s) if f & 0xf800 == 0xf000 && s & 0x9000 == 0x9000 => {
                let target = super::elf::branch_target(f, s, at);
                if s & 0x4000 == 0 {
                    self.jump(target, own);
                } else {
                    self.calls.insert(target);
                }
            }
            _ => {}
        }
    }

    fn jump(&mut self, target: u32, own: std::ops::Range<u32>) {
        if !own.contains(&target) {
            self.calls.insert(target);
        }
    }
}

/// The 16-bit immediate imm4:i:imm3:imm8 of MOVW and MOVT.
fn wide_16(first: u16, second: u16) -> u32 {
    (u32::from(first & 0xf) << 12) | wide_immediate(first, second)
}

/// The 12-bit immediate i:imm3:imm8.
fn wide_immediate(first: u16, second: u16) -> u32 {
    (u32::from(first >> 10 & 1) << 11)
        | (u32::from(second >> 12 & 7) << 8)
        | u32::from(second & 0xff)
}

/// `ThumbExpandImm` (ARMv7-M A5.3.2).
fn expand(immediate: u32) -> u32 {
    let byte = immediate & 0xff;
    match immediate >> 8 {
        0 => byte,
        1 => byte | byte << 16,
        2 => byte << 8 | byte << 24,
        3 => byte | byte << 8 | byte << 16 | byte << 24,
        _ => (0x80 | (immediate & 0x7f)).rotate_right(immediate >> 7),
    }
}

struct Walk<'a> {
    functions: &'a BTreeMap<u32, Frame>,
    /// Depth of a call through a pointer, and of one that polls a task.
    pointer_bytes: u32,
    task_bytes: u32,
    known: BTreeMap<u32, u32>,
    path: Vec<u32>,
    recursive: BTreeSet<String>,
}

impl<'a> Walk<'a> {
    fn new(functions: &'a BTreeMap<u32, Frame>, pointer_bytes: u32, task_bytes: u32) -> Self {
        Walk {
            functions,
            pointer_bytes,
            task_bytes,
            known: BTreeMap::new(),
            path: Vec::new(),
            recursive: BTreeSet::new(),
        }
    }

    fn depth(&mut self, entry: u32) -> u32 {
        if let Some(&known) = self.known.get(&entry) {
            return known;
        }
        let Some(frame) = self.functions.get(&entry) else {
            return 0;
        };
        if self.path.contains(&entry) {
            self.recursive.insert(frame.name.clone());
            return 0;
        }
        self.path.push(entry);
        let below = frame
            .calls
            .iter()
            .map(|&callee| self.depth(callee))
            .max()
            .unwrap_or(0);
        self.path.pop();
        let pointer = match frame.indirect {
            true if frame.name.contains(TASK_CALLER) => self.pointer_bytes.max(self.task_bytes),
            true => self.pointer_bytes,
            false => 0,
        };
        let bytes = frame.bytes + below.max(pointer);
        self.known.insert(entry, bytes);
        bytes
    }
}

/// Computes the bound. `interrupts` are names of handlers beside the tick.
///
/// Returns `None` if the image has no `Reset` function.
#[must_use]
pub fn bound(elf: &Elf<'_>) -> Option<StackBound> {
    let functions = frames(elf);
    let reset = elf.address_of("Reset")?;
    let handlers = handlers(elf, &functions, reset);
    let faults: Vec<u32> = ["HardFaultTrampoline", "NonMaskableInt"]
        .iter()
        .filter_map(|n| elf.address_of(n))
        .collect();
    let loaded = functions.values().flat_map(|f| f.loads.iter().copied());
    let taken: BTreeSet<u32> = elf
        .addresses_in_data()
        .chain(loaded)
        .filter(|a| {
            functions.contains_key(a) && !handlers.contains(a) && !faults.contains(a) && *a != reset
        })
        .collect();
    let is_task = |entry: &&u32| functions.get(*entry).is_some_and(|f| f.name.contains(TASK));
    let (mut pointer_bytes, mut task_bytes) = (0, 0);
    for _ in 0..POINTER_LEVELS {
        let mut walk = Walk::new(&functions, pointer_bytes, 0);
        let deepest = |walk: &mut Walk<'_>, tasks: bool| {
            let entries = taken.iter().filter(|&entry| is_task(&entry) == tasks);
            entries.map(|&entry| walk.depth(entry)).max().unwrap_or(0)
        };
        task_bytes = deepest(&mut walk, true);
        pointer_bytes = deepest(&mut walk, false);
    }
    let mut walk = Walk::new(&functions, pointer_bytes, task_bytes);
    let thread_bytes = walk.depth(reset);
    let interrupt_bytes = handlers
        .iter()
        .map(|&h| walk.depth(h) + EXCEPTION_FRAME_BYTES)
        .max()
        .unwrap_or(0);
    let fault_bytes = faults
        .iter()
        .map(|&h| walk.depth(h) + EXCEPTION_FRAME_BYTES)
        .max()
        .unwrap_or(0);
    Some(StackBound {
        thread_bytes,
        interrupt_bytes,
        fault_bytes,
        recursive: walk.recursive.into_iter().collect(),
        unbounded: functions
            .values()
            .filter(|f| f.unbounded)
            .map(|f| f.name.clone())
            .collect(),
    })
}

/// Entries of the vector table but for reset and faults.
fn handlers(elf: &Elf<'_>, functions: &BTreeMap<u32, Frame>, reset: u32) -> BTreeSet<u32> {
    let table = elf.sections.iter().find(|s| s.name == ".vector_table");
    let words = table.map_or(0..0, |t| t.address + 4 * 14..t.address + t.size);
    words
        .step_by(4)
        .filter_map(|at| elf.word_at(at))
        .map(|word| word & !1)
        .filter(|entry| functions.contains_key(entry) && *entry != reset)
        .collect()
}
