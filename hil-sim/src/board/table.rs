//! The figures of the image: sizes from the file, stack and instructions from a run in QEMU.

use std::fmt;
use std::time::Instant;

use control::gait::Gait;
use firmware::app::core::HEARTBEATS;
use protocol::link::{FromModule, ModuleState, Tag, ToModule};
use thiserror::Error;

use super::elf::{Elf, ElfError, Region};
use super::host::{AskError, BoardHost};
use super::peer::Motors;
use super::runner::{BoardConfig, BoardError, BoardFigures, BoardRunner, BusPeer};
use super::stack::{self, StackBound};
use super::tools::Built;
use super::wire::{Port, RegionCount};
use crate::robot::ideal::IdealMotors;

/// Cycles per second of the core after start-up.
const CORE_HZ: u64 = 80_000_000;
/// Cycles per instruction that are reckoned with: QEMU counts instructions only. Wait states and branches included.
const CYCLES_PER_INSTRUCTION: u64 = 2;
/// Ticks per second.
const TICK_HZ: u64 = 20;
/// Share of a tick that the computing may take.
const TARGET_SHARE: f64 = 0.06;
/// Length of the run, ms.
const RUN_MS: u32 = 30_000;
/// Guest time within which the run must have ended, ns: approach and ramp included.
const LIMIT_NS: u64 = 90_000_000_000;
/// From one change of the gait in a run to the next, ns: what is left of the run is longer than a ramp.
const CHANGE_NS: u64 = 10_000_000_000;
/// From one question of a host that keeps in touch to the next, ns.
const ASK_NS: u64 = 500_000_000;
/// How many functions the profile shows.
const PROFILE_ROWS: usize = 12;

/// The regions, the first of which divides time into ticks: name and a part of the symbol.
const PERIOD: (&str, &str) = ("total", "8firmware3app3App11begin_cycle");
const PARTS: [(&str, &str); 3] = [
    ("CPG", "7control3cpg7advance"),
    ("pre-check", "7control8precheck10check_move"),
    ("motor bus: answers", "8exchange6Master12take_answers"),
];

/// Why there is no table.
#[derive(Debug, Error)]
pub enum TableError {
    /// The image cannot be read.
    #[error("cannot read {path}: {source}")]
    File {
        /// The image.
        path: std::path::PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The image lacks something.
    #[error(transparent)]
    Elf(#[from] ElfError),
    /// The image has no stack symbols: another linker script.
    #[error("the image has no symbol {0}; it was not linked with the memory map of its board")]
    NoStack(&'static str),
    /// The run failed.
    #[error(transparent)]
    Board(#[from] BoardError),
    /// A request failed.
    #[error(transparent)]
    Ask(#[from] AskError),
    /// The run did not end.
    #[error("the run did not end within 90 s of guest time")]
    NoEnd,
}

/// Bytes of the image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sizes {
    /// Code and vector table.
    pub text: u32,
    /// Constants.
    pub rodata: u32,
    /// Initialised variables: flash and RAM.
    pub data: u32,
    /// Zeroed and uninitialised variables: RAM.
    pub bss: u32,
    /// The stack's own memory.
    pub stack: u32,
}

/// One row of the instruction table.
#[derive(Clone, Debug, PartialEq)]
pub struct TickRow {
    /// What.
    pub label: String,
    /// Mean per tick.
    pub mean: f64,
    /// Most in one tick; `None` for the rest, whose worst tick was not told apart.
    pub max: Option<u64>,
}

/// The table.
#[derive(Clone, Debug)]
pub struct BoardTable {
    /// Sizes.
    pub sizes: Sizes,
    /// Stack used, by its paint, bytes.
    pub stack_used: u32,
    /// Bound from the call graph.
    pub stack_bound: Option<StackBound>,
    /// Instructions per tick: total first, then its parts.
    pub rows: Vec<TickRow>,
    /// Ticks counted.
    pub ticks: u64,
    /// The functions that execute most: share of all instructions and name.
    pub profile: Vec<(f64, String)>,
    /// Guest time of the run, s.
    pub guest_s: f64,
    /// Wall time of it, s.
    pub wall_s: f64,
    /// Figures of the plugin.
    pub figures: BoardFigures,
}

/// Sizes from the sections.
#[must_use]
pub fn sizes(elf: &Elf<'_>) -> Sizes {
    let mut sizes = Sizes::default();
    for section in &elf.sections {
        match (
            section.stored,
            section.writable,
            section.code || section.name == ".vector_table",
        ) {
            (false, _, _) => sizes.bss += section.size,
            (true, true, _) => sizes.data += section.size,
            (true, false, true) => sizes.text += section.size,
            (true, false, false) => sizes.rodata += section.size,
        }
    }
    let symbol = |name| elf.address_of(name).unwrap_or(0);
    sizes.stack = symbol("_stack_start").saturating_sub(symbol("_stack_end"));
    sizes
}

/// The functions of the image in order of address, none overlapping.
fn functions(elf: &Elf<'_>) -> Vec<(u32, u32, String)> {
    let mut list: Vec<_> = elf
        .symbols
        .iter()
        .filter(|s| s.function && s.size > 0)
        .map(|s| (s.address, s.address + s.size, s.name.clone()))
        .collect();
    list.sort();
    list.dedup_by_key(|f| f.0);
    list
}

fn regions(elf: &Elf<'_>) -> Result<Vec<Region>, ElfError> {
    let mut regions = vec![elf.period(PERIOD.0, PERIOD.1)?];
    for (label, part) in PARTS {
        regions.push(elf.region(label, part)?);
    }
    Ok(regions)
}

/// Uploads and runs a gait for 30 s on ideal motors and counts.
///
/// # Errors
/// [`TableError`].
pub fn measure(built: &Built, gait: &Gait) -> Result<BoardTable, TableError> {
    let path = built.elf.clone();
    let bytes = std::fs::read(&path).map_err(|source| TableError::File { path, source })?;
    let elf = Elf::parse(&bytes)?;
    let symbol = |name| elf.address_of(name).ok_or(TableError::NoStack(name));
    let stack = (symbol("_stack_end")?, symbol("_stack_start")?);
    let functions = functions(&elf);
    let config = BoardConfig {
        regions: regions(&elf)?,
        profile: functions.iter().map(|f| (f.0, f.1)).collect(),
        stack: Some(stack),
        ..built.config()
    };

    let mut board = BoardRunner::start(&config, Motors::new(IdealMotors::new(false)))?;
    let mut host = BoardHost::new(Port::Wire);
    host.home(&mut board)?;
    let digest = host.upload(&mut board, 0, gait)?;
    board.restart_counts();
    let (guest_ns, wall) = (board.now_ns(), Instant::now());
    host.start(&mut board, 0, digest, RUN_MS)?;
    host.wait_for_end(&mut board, LIMIT_NS)?
        .ok_or(TableError::NoEnd)?;
    let guest_s = (board.now_ns() - guest_ns) as f64 * 1e-9;
    let wall_s = wall.elapsed().as_secs_f64();
    let figures = board.finish()?;

    let untouched = figures.stack_untouched.unwrap_or(0) as u32;
    let ticks = figures.regions.first().map_or(0, |total| total.runs);
    Ok(BoardTable {
        sizes: sizes(&elf),
        stack_used: (stack.1 - stack.0).saturating_sub(untouched),
        stack_bound: stack::bound(&elf),
        rows: rows(&figures.regions),
        ticks,
        profile: profile(&figures.profile, &functions),
        guest_s,
        wall_s,
        figures,
    })
}

/// Most instructions in one tick of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Most {
    /// Of the whole tick.
    pub tick: u64,
    /// Of the motor bus's answers in a tick, which need not be the same one.
    pub bus: u64,
}

impl Most {
    /// The greater of each.
    #[must_use]
    pub fn max(self, other: Self) -> Self {
        Self {
            tick: self.tick.max(other.tick),
            bus: self.bus.max(other.bus),
        }
    }
}

/// Most of a run of 30 s on ideal motors; `None` of a gait that the module refuses.
///
/// # Errors
/// [`TableError`].
pub fn most(built: &Built, gait: &Gait) -> Result<Option<Most>, TableError> {
    most_of(built, &[gait], Contact::Kept)
}

/// What the host of a run with changes does between them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Contact {
    /// Asks twice a second.
    Kept,
    /// Asks a few times and falls silent, so that the record waits for it: with the next order it comes back, and all of the record at once.
    Lost,
}

/// As [`most`], but in mid-run the second gait takes over, and later the first one again; `None` where the module refuses one of them or the change.
///
/// # Errors
/// [`TableError`].
pub fn most_of_change(
    built: &Built,
    first: &Gait,
    second: &Gait,
    contact: Contact,
) -> Result<Option<Most>, TableError> {
    most_of(built, &[first, second], contact)
}

/// The run goes through these gaits, and back to the first of several.
fn most_of(built: &Built, gaits: &[&Gait], contact: Contact) -> Result<Option<Most>, TableError> {
    let path = built.elf.clone();
    let bytes = std::fs::read(&path).map_err(|source| TableError::File { path, source })?;
    let elf = Elf::parse(&bytes)?;
    let [.., bus] = PARTS;
    let config = BoardConfig {
        regions: vec![elf.period(PERIOD.0, PERIOD.1)?, elf.region(bus.0, bus.1)?],
        ..built.config()
    };
    let mut board = BoardRunner::start(&config, Motors::new(IdealMotors::new(false)))?;
    let mut host = BoardHost::new(Port::Wire);
    host.home(&mut board)?;
    match play(&mut board, &mut host, gaits, contact) {
        Ok(()) => {}
        Err(TableError::Ask(AskError::Rejected(_))) => return Ok(None),
        Err(error) => return Err(error),
    }
    let figures = board.finish()?;
    let [tick, bus] = figures.regions[..] else {
        return Ok(None);
    };
    Ok(Some(Most {
        tick: tick.max,
        bus: bus.most_in_period,
    }))
}

/// Uploads, counts anew, plays for [`RUN_MS`]. Of several gaits the next takes over every [`CHANGE_NS`] of the run, and the first comes last again.
fn play<B: BusPeer>(
    board: &mut BoardRunner<B>,
    host: &mut BoardHost,
    gaits: &[&Gait],
    contact: Contact,
) -> Result<(), TableError> {
    let mut stored = Vec::new();
    for (slot, gait) in (0..).zip(gaits) {
        stored.push((slot, host.upload(board, slot, gait)?));
    }
    let Some((&(slot, digest), others)) = stored.split_first() else {
        return Ok(());
    };
    board.restart_counts();
    host.start(board, slot, digest, RUN_MS)?;
    if !others.is_empty() {
        wait_for_run(board, host)?;
        for &(slot, digest) in others.iter().chain([&(slot, digest)]) {
            wait_for_change(board, host, contact)?;
            let tag = Tag::NONE;
            host.ask(board, &ToModule::ChangeGait { slot, digest, tag })?;
        }
    }
    // A change may bring the end of the run with it.
    if host.ends.is_empty() {
        host.wait_for_end(board, LIMIT_NS)?
            .ok_or(TableError::NoEnd)?;
    }
    Ok(())
}

/// Lets the time to the next change pass.
fn wait_for_change<B: BusPeer>(
    board: &mut BoardRunner<B>,
    host: &mut BoardHost,
    contact: Contact,
) -> Result<(), TableError> {
    let change_ns = board.now_ns() + CHANGE_NS;
    let mut asked = 0;
    while board.now_ns() + ASK_NS < change_ns && (contact == Contact::Kept || asked < HEARTBEATS) {
        board.run_until(board.now_ns() + ASK_NS)?;
        host.ask(board, &ToModule::Ping { host_t_us: 0 })?;
        asked += 1;
    }
    Ok(board.run_until(change_ns)?)
}

/// Lets the approach pass.
fn wait_for_run<B: BusPeer>(
    board: &mut BoardRunner<B>,
    host: &mut BoardHost,
) -> Result<(), TableError> {
    let limit_ns = board.now_ns() + LIMIT_NS;
    while board.now_ns() < limit_ns {
        match host.ask(board, &ToModule::GetInfo)? {
            FromModule::Info(info) if info.state == ModuleState::Run => return Ok(()),
            _ => board.run_until(board.now_ns() + ASK_NS)?,
        }
    }
    Err(TableError::NoEnd)
}

fn rows(regions: &[RegionCount]) -> Vec<TickRow> {
    let Some((total, parts)) = regions.split_first() else {
        return Vec::new();
    };
    let ticks = total.runs.max(1) as f64;
    let mean = |region: &RegionCount| region.sum as f64 / ticks;
    let mut rows = vec![TickRow {
        label: PERIOD.0.to_owned(),
        mean: mean(total),
        max: Some(total.max),
    }];
    for (region, (label, _)) in parts.iter().zip(PARTS) {
        rows.push(TickRow {
            label: label.to_owned(),
            mean: mean(region),
            max: Some(region.most_in_period),
        });
    }
    let named: f64 = parts.iter().map(mean).sum();
    rows.push(TickRow {
        label: "interrupts, links, telemetry, clock and the rest".to_owned(),
        mean: mean(total) - named,
        max: None,
    });
    rows
}

fn profile(counts: &[u64], functions: &[(u32, u32, String)]) -> Vec<(f64, String)> {
    let all = counts.iter().sum::<u64>().max(1) as f64;
    let mut list: Vec<_> = counts
        .iter()
        .zip(functions)
        .map(|(&count, f)| (count as f64 / all, plain_name(&f.2)))
        .collect();
    list.sort_by(|a, b| b.0.total_cmp(&a.0));
    list.truncate(PROFILE_ROWS);
    list
}

/// The path of a mangled name, good enough to read.
fn plain_name(mangled: &str) -> String {
    let Some(mut rest) = mangled.strip_prefix("_ZN") else {
        return mangled.to_owned();
    };
    let mut parts = Vec::new();
    while let Some(digits) = rest.find(|c: char| !c.is_ascii_digit()).filter(|&d| d > 0) {
        let length: usize = rest[..digits].parse().unwrap_or(0);
        let Some(part) = rest.get(digits..digits + length) else {
            break;
        };
        parts.push(part);
        rest = &rest[digits + length..];
    }
    // The last part is the hash.
    parts.pop();
    parts.join("::")
}

/// Instructions that fit into the target share of a tick.
#[must_use]
pub fn target_instructions() -> u64 {
    let tick_cycles = CORE_HZ / TICK_HZ;
    (tick_cycles as f64 * TARGET_SHARE) as u64 / CYCLES_PER_INSTRUCTION
}

impl fmt::Display for BoardTable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let s = &self.sizes;
        writeln!(f, "| image | bytes |\n|---|---|")?;
        writeln!(
            f,
            "| flash: code | {} |\n| flash: constants | {} |",
            s.text, s.rodata
        )?;
        writeln!(f, "| flash: initial values | {} |", s.data)?;
        writeln!(
            f,
            "| flash in all | {} of 1007616 |",
            s.text + s.rodata + s.data
        )?;
        writeln!(
            f,
            "| RAM: variables (SRAM1) | {} of 98304 |",
            s.data + s.bss
        )?;
        writeln!(f, "| RAM: stack (SRAM2) | {} |", s.stack)?;
        writeln!(
            f,
            "| stack used in the run, by its paint | {} |",
            self.stack_used
        )?;
        if let Some(bound) = &self.stack_bound {
            writeln!(
                f,
                "| stack bound from the call graph | {} (thread {}, interrupt {}, fault {}) |",
                bound.total_bytes(),
                bound.thread_bytes,
                bound.interrupt_bytes,
                bound.fault_bytes
            )?;
        }
        writeln!(
            f,
            "\n| instructions per 20 Hz tick ({} ticks) | mean | most |\n|---|---|---|",
            self.ticks
        )?;
        for row in &self.rows {
            let max = row
                .max
                .map_or_else(|| "-".to_owned(), |max| max.to_string());
            writeln!(f, "| {} | {:.0} | {max} |", row.label, row.mean)?;
        }
        let target = target_instructions();
        let worst = self.rows.first().and_then(|row| row.max).unwrap_or(0);
        writeln!(
            f,
            "| target: {} | {:.1} % of the tick at most | {} |",
            target,
            100.0 * TARGET_SHARE * worst as f64 / target as f64,
            if worst <= target { "met" } else { "missed" }
        )?;
        writeln!(f, "\n| function | share of the instructions |\n|---|---|")?;
        for (share, name) in &self.profile {
            writeln!(f, "| `{name}` | {:.1} % |", 100.0 * share)?;
        }
        writeln!(
            f,
            "\n{:.1} s of guest time in {:.1} s ({:.0} times real time), {} exchanges, bytes lost in the guest: {:?}.",
            self.guest_s,
            self.wall_s,
            self.guest_s / self.wall_s.max(1e-9),
            self.figures.exchanges,
            self.figures.overruns
        )
    }
}
