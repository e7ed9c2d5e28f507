//! What a board must survive, on the real image: STOP, watchdog, HardFault, unreadable flash, noise on the wire, errors of its receivers and of its generator.

use firmware::crash::{BLOCK_BYTES, CrashKind, CrashRecord};
use hil_sim::board::elf::{Elf, Symbol};
use hil_sim::board::host::{AskError, BoardHost};
use hil_sim::board::peer::Motors;
use hil_sim::board::runner::{BoardConfig, BoardError, BoardRunner, BusPeer};
use hil_sim::board::tools::Built;
use hil_sim::board::wire::{Port, RngFault};
use hil_sim::robot::ideal::IdealMotors;
use protocol::link::{
    EndReason, EventKind, FromModule, Info, KEY_LEN, Key, ModuleState, PortFault, Reject,
    ResetCause, RunEnd, SlotInfo, Tag, ToModule,
};

use crate::common::{SECOND_NS, board, built, gait, law};

/// The watchdog's period and one cycle.
const BITE_NS: u64 = 260_000_000;

fn symbol(built: &Built, part: &str) -> Symbol {
    let bytes = std::fs::read(&built.elf).expect("image");
    let elf = Elf::parse(&bytes).expect("image");
    let found = elf.symbols.iter().find(|s| s.name.contains(part));
    found.expect("static of the image").clone()
}

fn info<B: BusPeer>(board: &mut BoardRunner<B>, host: &mut BoardHost) -> Info {
    match host.ask(board, &ToModule::GetInfo).expect("answers") {
        FromModule::Info(info) => info,
        other => panic!("{other:?}"),
    }
}

fn hello<B: BusPeer>(board: &mut BoardRunner<B>, host: &mut BoardHost) -> u32 {
    let protocol = protocol::link::VERSION;
    match host
        .ask(board, &ToModule::Hello { protocol })
        .expect("answers")
    {
        FromModule::Hello(hello) => hello.boot_id,
        other => panic!("{other:?}"),
    }
}

fn slots<B: BusPeer>(board: &mut BoardRunner<B>, host: &mut BoardHost) -> Vec<Option<SlotInfo>> {
    match host.ask(board, &ToModule::ListSlots).expect("answers") {
        FromModule::Slots { slots, .. } => slots.into_iter().collect(),
        other => panic!("{other:?}"),
    }
}

/// All that the module tells of, in order.
fn events<B: BusPeer>(board: &mut BoardRunner<B>, host: &mut BoardHost) -> Vec<EventKind> {
    let (mut found, mut since) = (Vec::new(), 0);
    loop {
        match host.ask(board, &ToModule::GetEvents { since }) {
            Ok(FromModule::Events { next, events, .. }) if !events.is_empty() => {
                since = next;
                found.extend(events.iter().map(|event| event.kind));
            }
            Ok(FromModule::Events { .. }) => return found,
            other => panic!("{other:?}"),
        }
    }
}

/// The receiver errors among them.
fn port_errors<B: BusPeer>(
    board: &mut BoardRunner<B>,
    host: &mut BoardHost,
) -> Vec<(u8, PortFault)> {
    let told = events(board, host).into_iter();
    told.filter_map(|kind| match kind {
        EventKind::PortError { port, fault } => Some((port, fault)),
        _ => None,
    })
    .collect()
}

#[test]
fn an_open_stop_circuit_ends_a_run_within_two_cycles() {
    let Some(built) = built("STOP input in QEMU") else {
        return;
    };
    let (mut board, mut host) = board(&built.config());
    host.home(&mut board).expect("drivers answer");
    let digest = host.upload(&mut board, 0, &gait("crawl")).expect("clear");
    host.start(&mut board, 0, digest, 20_000).expect("ready");
    board.run_until(8 * SECOND_NS).expect("runs");
    assert_eq!(info(&mut board, &mut host).state, ModuleState::Run);
    board.set_stop(true);
    board.run_until(board.now_ns() + 100_000_000).expect("runs");
    assert!((0..6).all(|joint| !board.bus().motors().torque(joint)));
    assert_eq!(info(&mut board, &mut host).state, ModuleState::EStop);
}

#[test]
fn the_image_says_whether_power_or_an_order_started_it() {
    let Some(built) = built("causes of a reset in QEMU") else {
        return;
    };
    let (mut board, mut host) = board(&built.config());
    host.home(&mut board).expect("drivers answer");
    let first_boot = hello(&mut board, &mut host);
    assert_eq!(info(&mut board, &mut host).reset_cause, ResetCause::PowerOn);
    let tag = Tag::NONE;
    host.ask(&mut board, &ToModule::Reset { tag })
        .expect("at rest");
    board.run_until(board.now_ns() + SECOND_NS).expect("runs");
    let mut host = BoardHost::new(Port::Wire);
    assert_ne!(hello(&mut board, &mut host), first_boot);
    assert_eq!(
        info(&mut board, &mut host).reset_cause,
        ResetCause::Software
    );
}

#[test]
fn a_clock_that_stands_still_brings_the_watchdog_and_a_new_boot_without_motion() {
    let Some(built) = built("watchdog in QEMU") else {
        return;
    };
    let driver = symbol(&built, "5stm325clock6DRIVER");
    let (mut board, mut host) = board(&built.config());
    host.home(&mut board).expect("drivers answer");
    let first_boot = hello(&mut board, &mut host);
    board.poke(driver.address, &vec![0; driver.size as usize]);
    board.run_until(board.now_ns() + BITE_NS).expect("runs");
    let mut host = BoardHost::new(Port::Wire);
    assert_ne!(hello(&mut board, &mut host), first_boot);
    let info = info(&mut board, &mut host);
    let found = (info.state, info.reset_cause);
    assert_eq!(found, (ModuleState::Unhomed, ResetCause::Watchdog));
    assert_eq!(board.finish().expect("ends").watchdog_bites, 1);
}

#[test]
fn a_wild_task_pointer_is_a_hard_fault_that_ends_the_emulator_with_code_2() {
    let Some(built) = built("HardFault in QEMU") else {
        return;
    };
    let task = symbol(&built, "11application4POOL");
    let (mut board, _) = board(&built.config());
    board.run_until(SECOND_NS).expect("runs");
    board.poke(task.address, &[0xee; 64]);
    match board.run_until(2 * SECOND_NS) {
        Err(BoardError::GuestExit { code, .. }) => assert_eq!(code, Some(2)),
        other => panic!("{other:?}"),
    }
}

/// The image with another initial stack pointer: the first word of the vector table, found through the program headers of the ELF32 file.
fn with_stack_pointer(built: &Built, stack_pointer: u32) -> std::path::PathBuf {
    const VECTORS: u32 = 0x0800_0000;
    let mut bytes = std::fs::read(&built.elf).expect("image");
    let word = |bytes: &[u8], at: usize| {
        u32::from_le_bytes(bytes[at..at + 4].try_into().expect("four bytes"))
    };
    let (table, count) = (word(&bytes, 28) as usize, usize::from(bytes[44]));
    let offset = (0..count)
        .map(|index| table + 32 * index)
        .find(|&at| word(&bytes, at + 8) == VECTORS && word(&bytes, at + 16) > 0)
        .map(|at| word(&bytes, at + 4) as usize)
        .expect("a segment at the begin of the flash");
    bytes[offset..offset + 4].copy_from_slice(&stack_pointer.to_le_bytes());
    let path = std::path::Path::new(env!("CARGO_TARGET_TMPDIR"))
        .join(format!("stack-{}.elf", std::process::id()));
    std::fs::write(&path, bytes).expect("written");
    path
}

/// With 3 KiB of the 32 KiB stack the application runs out of it. What it leaves is a record and not a locked-up core: here, where QEMU ends before the
/// reset, the exit code of that record.
#[test]
fn a_stack_that_runs_out_is_a_record_of_its_own_kind() {
    let Some(built) = built("stack overflow in QEMU") else {
        return;
    };
    let bottom = 0x1000_0000;
    let mut config = built.config();
    config.elf = with_stack_pointer(&built, bottom + 3 * 1024);
    let peer = Motors::new(IdealMotors::new(false));
    let end = BoardRunner::start(&config, peer).and_then(|mut board| {
        board.run_until(3 * SECOND_NS)?;
        Ok(())
    });
    match end {
        Err(BoardError::GuestExit { code, .. }) => assert_eq!(code, Some(3)),
        other => panic!("{other:?}"),
    }
}

#[test]
fn the_fault_record_of_the_life_before_is_told_once() {
    let Some(built) = built("fault record in QEMU") else {
        return;
    };
    let place = symbol(&built, "5stm325fault11CRASH_BLOCK");
    let mut record = CrashRecord::new(CrashKind::HardFault, 0, 12_345_678);
    (record.pc, record.lr, record.detail) = (0x0800_1234, 0x0800_5678, 0x8200);
    let mut block = [0; BLOCK_BYTES];
    record.encode(&mut block);
    assert_eq!(place.size as usize, BLOCK_BYTES);

    let (mut board, mut host) = board(&built.config());
    board.poke(place.address, &block);
    board.run_until(SECOND_NS / 2).expect("runs");
    hello(&mut board, &mut host);
    match host.ask(&mut board, &ToModule::GetCrash).expect("answers") {
        FromModule::Crash(Some(told)) => {
            assert_eq!((told.pc, told.lr), (0x0800_1234, 0x0800_5678));
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_gait_survives_a_reset_and_an_unreadable_word_is_an_error_not_a_hang() {
    let Some(built) = built("flash store in QEMU") else {
        return;
    };
    let (mut board, mut host) = board(&built.config());
    host.home(&mut board).expect("drivers answer");
    let digest = host.upload(&mut board, 2, &gait("crawl")).expect("clear");
    let stored = |slots: &[Option<SlotInfo>]| slots[2].as_ref().map(|slot| slot.digest);

    board.reset();
    board.run_until(board.now_ns() + SECOND_NS).expect("boots");
    let mut host = BoardHost::new(Port::Wire);
    hello(&mut board, &mut host);
    assert_eq!(stored(&slots(&mut board, &mut host)), Some(digest));

    // Slot 2 owns pages 4 and 5; its third word is payload, in whichever of the two it lies.
    let page = u32::try_from(firmware::ports::PAGE_BYTES).expect("small");
    board.damage(4 * page + 16);
    board.damage(5 * page + 16);
    board.reset();
    board.run_until(board.now_ns() + SECOND_NS).expect("boots");
    let mut host = BoardHost::new(Port::Wire);
    hello(&mut board, &mut host);
    assert_eq!(stored(&slots(&mut board, &mut host)), None);
}

/// Runs for 4 s with these bytes on the cable; the end of the run and the module's counters.
fn run_under(built: &Built, noise: &[u8]) -> (RunEnd, Info) {
    let (mut board, mut host) = board(&built.config());
    host.home(&mut board).expect("drivers answer");
    let digest = host.upload(&mut board, 0, &gait("crawl")).expect("clear");
    host.start(&mut board, 0, digest, 4_000).expect("ready");
    board.send(Port::Wire, noise);
    let end = host
        .wait_for_end(&mut board, 20 * SECOND_NS)
        .expect("runs")
        .expect("the lease ends");
    let info = info(&mut board, &mut host);
    assert_eq!(board.finish().expect("ends").overruns, [0; 3]);
    (end, info)
}

#[test]
fn noise_at_line_rate_on_the_cable_changes_no_set_point_and_costs_no_cycle() {
    let Some(built) = built("noise on the cable in QEMU") else {
        return;
    };
    // 11.5 bytes per ms for 3 s, from a plain generator; zeros are delimiters and come often.
    let mut state = 1_u32;
    let noise: Vec<u8> = (0..34_500)
        .map(|_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let byte = state.to_be_bytes()[0];
            if byte < 24 { 0 } else { byte }
        })
        .collect();
    let (end, info) = run_under(&built, &noise);
    // The lease ends between two cycles; which side of the 80th depends on the phase of the order.
    let cycles = end.cycles as usize;
    assert!((80..=81).contains(&cycles), "{cycles}");
    assert_eq!((end.reason, end.holds), (EndReason::Completed, 0));
    assert_eq!(end.setpoint_crc32c, law(&gait("crawl"), cycles).0);
    let counters = info.counters;
    assert_eq!((counters.overruns, counters.bus_timeouts), (0, 0));
    assert!(counters.link.bad_crc + counters.link.bad_framing > 100);
}

/// What errors the receivers report in a run of 4 s, to which `strike` happens 1 s after the order; its end, and the overruns of the ports.
fn run_struck(
    built: &Built,
    strike: impl FnOnce(&mut BoardRunner<Motors<IdealMotors>>),
) -> (Vec<(u8, PortFault)>, RunEnd, [u64; 3]) {
    let (mut board, mut host) = board(&built.config());
    host.home(&mut board).expect("drivers answer");
    let digest = host.upload(&mut board, 0, &gait("crawl")).expect("clear");
    host.start(&mut board, 0, digest, 4_000).expect("ready");
    board.run_until(board.now_ns() + SECOND_NS).expect("runs");
    assert_eq!(port_errors(&mut board, &mut host), []);
    strike(&mut board);
    board.run_until(board.now_ns() + SECOND_NS).expect("runs");
    let errors = port_errors(&mut board, &mut host);
    let end = host
        .wait_for_end(&mut board, 20 * SECOND_NS)
        .expect("runs")
        .expect("the lease ends");
    assert_eq!(end.reason, EndReason::Completed);
    assert_eq!(
        end.setpoint_crc32c,
        law(&gait("crawl"), end.cycles as usize).0
    );
    (errors, end, board.finish().expect("ends").overruns)
}

#[test]
fn framing_errors_and_overruns_of_the_links_are_told_and_change_no_set_point() {
    let Some(built) = built("receiver errors of the links in QEMU") else {
        return;
    };
    // Zeros end a frame, so that what follows is read again.
    for (number, port) in [(0, Port::Wire), (1, Port::Radio)] {
        let damaged = run_struck(&built, |board| board.send_damaged(port, &[0]));
        assert_eq!(damaged.0, [(number, PortFault::Noise)]);
        assert_eq!((damaged.1.holds, damaged.2), (0, [0; 3]));
        let lost = run_struck(&built, |board| board.send_at_once(port, &[0, 0]));
        assert_eq!(lost.0, [(number, PortFault::Overrun)]);
        assert_eq!(lost.2[usize::from(port.number())], 1);
    }
}

#[test]
fn framing_errors_of_the_motor_bus_are_told_and_the_run_goes_on() {
    let Some(built) = built("receiver errors of the bus in QEMU") else {
        return;
    };
    let (errors, end, overruns) = run_struck(&built, |board| {
        let until_ns = board.now_ns() + 60_000_000;
        board.bus().spoil_until(until_ns);
    });
    assert!(errors.contains(&(2, PortFault::Noise)), "{errors:?}");
    assert!(errors.iter().all(|error| error.0 == 2), "{errors:?}");
    assert_eq!((end.holds, overruns), (0, [0; 3]));
}

/// A robot without a key, on its cable, where orders need no challenge: even there nothing is started.
fn starts_nothing(built: &Built, fault: RngFault) {
    let config = BoardConfig {
        rng_fault: Some(fault),
        ..built.config()
    };
    let (mut board, mut host) = board(&config);
    let refused = |answer| match answer {
        Err(AskError::Rejected(reason)) => assert_eq!(reason, Reject::NoEntropy, "{fault:?}"),
        other => panic!("{fault:?}: {other:?}"),
    };
    // Booted after 200 ms, however long the firmware waited for the generator.
    board.run_until(SECOND_NS / 5).expect("boots");
    hello(&mut board, &mut host);
    refused(host.ask(&mut board, &ToModule::GetChallenge));
    assert_eq!(info(&mut board, &mut host).state, ModuleState::Fault);
    let clear = ToModule::ClearFault { tag: Tag::NONE };
    host.ask(&mut board, &clear).expect("cleared");
    host.home(&mut board).expect("drivers answer");
    let digest = host.upload(&mut board, 0, &gait("crawl")).expect("clear");
    let start = host.start(&mut board, 0, digest, 4_000);
    refused(start.map(|()| FromModule::Ack { request: 0 }));
    board.run_until(board.now_ns() + SECOND_NS).expect("runs");
    assert!((0..6).all(|joint| !board.bus().motors().torque(joint)));
    assert_eq!(board.finish().expect("ends").watchdog_bites, 0);
}

#[test]
fn a_generator_that_fails_gives_no_challenge_and_starts_nothing() {
    let Some(built) = built("random number generator in QEMU") else {
        return;
    };
    for fault in [
        RngFault::Silent,
        RngFault::Seed,
        RngFault::Clock,
        RngFault::Stuck,
    ] {
        starts_nothing(&built, fault);
    }
}

#[test]
fn a_seed_that_fails_once_costs_a_restart_of_the_generator_and_no_more() {
    let Some(built) = built("seed of the random number generator in QEMU") else {
        return;
    };
    let config = BoardConfig {
        rng_fault: Some(RngFault::SeedOnce),
        ..built.config()
    };
    let (mut board, mut host) = board(&config);
    board.run_until(SECOND_NS / 5).expect("boots");
    hello(&mut board, &mut host);
    match host.ask(&mut board, &ToModule::GetChallenge) {
        Ok(FromModule::Challenge { .. }) => {}
        other => panic!("{other:?}"),
    }
    assert_ne!(info(&mut board, &mut host).state, ModuleState::Fault);
}

/// The emulated chip's option bytes are those of a new one: anybody with a probe reads its flash.
#[test]
fn a_key_on_a_chip_that_a_probe_can_read_is_told() {
    let Some(built) = built("readout protection in QEMU") else {
        return;
    };
    let (mut board, mut host) = board(&built.config());
    hello(&mut board, &mut host);
    let told = events(&mut board, &mut host);
    assert!(
        !told.contains(&EventKind::KeyReadable),
        "there is no key yet"
    );
    let key = Key([5; KEY_LEN]);
    host.ask(&mut board, &ToModule::SetKey { key })
        .expect("over the cable");
    assert!(events(&mut board, &mut host).contains(&EventKind::KeyReadable));
}
