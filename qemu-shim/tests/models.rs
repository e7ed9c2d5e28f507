// SPDX-License-Identifier: GPL-2.0-or-later
//! The register models against what RM0351 says of the silicon. They are pure, so they run without QEMU.
#![allow(dead_code, unreachable_pub)]

#[path = "../src/blocks.rs"]
mod blocks;
#[path = "../src/usart.rs"]
mod usart;
#[path = "../../hil-sim/src/board/wire.rs"]
mod wire;

use blocks::{Adc, Flash, ResetFlags, Rng, STORE_BYTES, Watchdog};
use usart::{Transmitted, Usart};
use wire::RngFault;

const CR1: u64 = 0x00;
const CR3: u64 = 0x08;
const BRR: u64 = 0x0c;
const ISR: u64 = 0x1c;
const ICR: u64 = 0x20;
const RDR: u64 = 0x24;
const TDR: u64 = 0x28;
const UE_RE_TE: u32 = 0b1101;
const FE: u32 = 1 << 1;
const ORE: u32 = 1 << 3;
const IDLE: u32 = 1 << 4;
const RXNE: u32 = 1 << 5;
const TC: u32 = 1 << 6;
const TXE: u32 = 1 << 7;

/// 80 MHz / 80 = 1 Mbaud: 10 us per byte.
fn megabaud() -> Usart {
    let mut usart = Usart::new(80_000_000);
    usart.write(BRR, 80, 0);
    usart.write(CR1, UE_RE_TE, 0);
    usart
}

fn byte(byte: u8, end_ns: u64) -> Transmitted {
    Transmitted {
        byte,
        end_ns,
        damaged: false,
    }
}

#[test]
fn byte_time_follows_the_baud_rate_register() {
    // Divider, OVER8, expected ns: 1 Mbaud, 115200 (694), 1 Mbaud with 8-fold oversampling (USARTDIV 160, BRR 0xa0).
    for (brr, over8, expected) in [(80, 0, 10_000), (694, 0, 86_750), (0xa0, 1 << 15, 10_000)] {
        let mut usart = Usart::new(80_000_000);
        assert_eq!(usart.byte_ns(), 0, "off after reset");
        usart.write(BRR, brr, 0);
        usart.write(CR1, UE_RE_TE | over8, 0);
        assert_eq!(usart.byte_ns(), expected);
    }
}

#[test]
fn two_bytes_leave_back_to_back_and_the_flags_follow() {
    let mut usart = megabaud();
    usart.write(TDR, 0x41, 1_000);
    assert_eq!(
        usart.read(ISR) & (TXE | TC),
        TXE,
        "first byte is in the shift register"
    );
    usart.write(TDR, 0x42, 2_000);
    assert_eq!(usart.read(ISR) & (TXE | TC), 0);
    usart.advance(11_000);
    assert_eq!(usart.read(ISR) & (TXE | TC), TXE);
    assert!(!usart.has_news(), "the burst goes on");
    usart.advance(21_000);
    assert_eq!(usart.read(ISR) & (TXE | TC), TXE | TC);
    assert!(usart.has_news());
    assert_eq!(usart.take_sent(), [byte(0x41, 11_000), byte(0x42, 21_000)]);
}

#[test]
fn writing_reserved_bit_7_of_icr_keeps_txe() {
    let mut usart = megabaud();
    usart.write(ICR, 0xffff_ffff, 0);
    assert_eq!(usart.read(ISR) & (TXE | TC), TXE);
}

#[test]
fn reception_idle_and_overrun() {
    let mut usart = megabaud();
    usart.schedule([byte(1, 20_000), byte(2, 30_000), byte(3, 60_000)].into_iter());
    usart.advance(20_000);
    assert_eq!(usart.read(ISR) & (RXNE | IDLE | ORE), RXNE);
    assert_eq!(usart.read(RDR), 1);
    usart.advance(39_999);
    assert_eq!(
        usart.read(ISR) & (RXNE | IDLE),
        RXNE,
        "the line was never quiet for a frame"
    );
    usart.advance(40_000);
    assert_eq!(
        usart.read(ISR) & IDLE,
        IDLE,
        "one frame of silence after the second byte"
    );
    usart.advance(60_000);
    assert_eq!(usart.read(ISR) & ORE, ORE, "RDR was still full");
    assert_eq!((usart.read(RDR), usart.overruns()), (2, 1));
}

#[test]
fn a_damaged_byte_raises_the_framing_error_until_it_is_cleared() {
    let mut usart = megabaud();
    let damaged = Transmitted {
        damaged: true,
        ..byte(7, 20_000)
    };
    usart.schedule([byte(6, 10_000), damaged, byte(8, 30_000)].into_iter());
    usart.advance(10_000);
    assert_eq!((usart.read(ISR) & (FE | RXNE), usart.read(RDR)), (RXNE, 6));
    usart.advance(20_000);
    assert_eq!(
        (usart.read(ISR) & (FE | RXNE), usart.read(RDR)),
        (FE | RXNE, 7)
    );
    usart.advance(30_000);
    assert_eq!(usart.read(ISR) & FE, FE, "stays");
    usart.write(ICR, FE, 0);
    assert_eq!((usart.read(ISR) & (FE | RXNE), usart.read(RDR)), (RXNE, 8));
}

#[test]
fn with_driver_enable_the_receiver_is_deaf_while_sending() {
    let mut usart = megabaud();
    usart.write(CR3, 1 << 14, 0);
    usart.write(TDR, 0x55, 0);
    usart.schedule([byte(9, 5_000)].into_iter());
    usart.advance(5_000);
    assert_eq!(usart.read(ISR) & RXNE, 0);
}

/// `DRIVER_ENABLE` of the firmware, as its source has it: the image is for another target.
fn firmware_deat() -> u32 {
    let source = include_str!("../../firmware/src/stm32/parts.rs");
    let (_, value) = source
        .split_once("const DRIVER_ENABLE: u8 = ")
        .expect("the constant");
    let (value, _) = value.split_once(';').expect("a statement");
    value.parse().expect("a number")
}

/// What reaches the line of two bursts of two bytes each, sent with this DEAT and with or without driver enable.
fn two_bursts(deat: u32, driver_enable: bool) -> Vec<u8> {
    let mut usart = megabaud();
    usart.write(CR1, UE_RE_TE | (deat << 21), 0);
    usart.write(CR3, u32::from(driver_enable) << 14, 0);
    let mut sent = Vec::new();
    for start_ns in [1_000, 100_000] {
        usart.write(TDR, 0x41, start_ns);
        usart.write(TDR, 0x42, start_ns + 1_000);
        usart.advance(start_ns + 50_000);
        assert_eq!(usart.read(ISR) & TC, TC);
        assert!(usart.has_news());
        sent.extend(usart.take_sent().iter().map(|sent| sent.byte));
    }
    sent
}

#[test]
fn without_lead_time_of_the_driver_enable_every_burst_loses_its_first_byte() {
    let whole = [0x41, 0x42, 0x41, 0x42];
    assert_eq!(two_bursts(0, true), [0x42, 0x42]);
    assert_eq!(two_bursts(firmware_deat(), true), whole);
    assert_eq!(two_bursts(0, false), whole, "no driver to enable");
}

#[test]
fn interrupt_line_is_flag_and_enable() {
    let mut usart = megabaud();
    assert!(!usart.interrupt());
    usart.write(CR1, UE_RE_TE | (1 << 7), 0);
    assert!(usart.interrupt(), "TXE with TXEIE");
    usart.write(CR1, UE_RE_TE | (1 << 5), 0);
    assert!(!usart.interrupt());
    usart.schedule([byte(1, 10_000)].into_iter());
    usart.advance(10_000);
    assert!(usart.interrupt(), "RXNE with RXNEIE");
    usart.read(RDR);
    assert!(!usart.interrupt());
}

const KEYR: u64 = 0x08;
const SR: u64 = 0x10;
const CR: u64 = 0x14;
const ECCR: u64 = 0x18;
const PG: u32 = 1;
const LOCK: u32 = 1 << 31;
const PROGERR: u32 = 1 << 3;
const PGSERR: u32 = 1 << 7;

fn unlocked() -> Flash {
    let mut flash = Flash::new();
    flash.write(CR, PG);
    assert_eq!(flash.read(CR), LOCK, "locked: no effect");
    flash.write(KEYR, 0x4567_0123);
    flash.write(KEYR, 0xcdef_89ab);
    assert_eq!(flash.read(CR), 0);
    flash
}

/// Page erase of bank 2.
fn erase(page: u32) -> u32 {
    (1 << 1) | (page << 3) | (1 << 11) | (1 << 16)
}

#[test]
fn a_word_is_programmed_once_between_two_erases() {
    let mut flash = unlocked();
    flash.write(CR, PG);
    flash.store(2048, 0x1111_1111, 4);
    assert_eq!(flash.load(2048, 4).0, 0xffff_ffff, "half a word is nothing");
    flash.store(2052, 0x2222_2222, 4);
    assert_eq!(
        (flash.load(2048, 4).0, flash.load(2052, 4).0),
        (0x1111_1111, 0x2222_2222)
    );
    flash.store(2048, 0, 4);
    flash.store(2052, 1, 4);
    assert_eq!(flash.read(SR), PROGERR);
    flash.write(SR, PROGERR);
    flash.store(2056, 0, 1);
    assert_eq!(flash.read(SR), PGSERR, "bytes cannot be programmed");
    flash.write(CR, erase(237));
    assert_eq!(flash.load(2048, 4).0, 0xffff_ffff);
    assert_eq!(flash.read(CR) & (1 << 16), 0, "start bit clears itself");
}

#[test]
fn pages_of_the_image_are_protected_and_cells_survive_a_reset() {
    let mut flash = unlocked();
    flash.write(CR, PG);
    flash.store(STORE_BYTES as u64 - 8, 5, 4);
    flash.store(STORE_BYTES as u64 - 4, 6, 4);
    flash.write(CR, erase(0));
    assert_eq!(flash.read(SR), 1 << 4, "WRPERR");
    flash.reset();
    assert_eq!(flash.read(CR), LOCK);
    assert_eq!(flash.load(STORE_BYTES as u64 - 8, 4).0, 5);
}

#[test]
fn a_damaged_word_raises_the_ecc_flag_until_erased() {
    let mut flash = unlocked();
    flash.damage(16);
    assert!(!flash.load(8, 4).1);
    assert!(flash.load(20, 4).1);
    assert_eq!(flash.read(ECCR), 1 << 31);
    flash.write(ECCR, 1 << 31);
    assert_eq!(flash.read(ECCR), 0);
    flash.write(CR, erase(236));
    assert!(!flash.load(16, 4).1);
}

#[test]
fn watchdog_bites_after_its_period_and_not_before_it_is_started() {
    let mut watchdog = Watchdog::new();
    watchdog.write(0x00, 0x5555, 0);
    watchdog.write(0x04, 0, 0);
    watchdog.write(0x08, 1599, 0);
    assert_eq!(watchdog.bites_at_ns(), None);
    watchdog.write(0x00, 0xcccc, 1_000);
    // 1600 steps of 4 / 32 kHz.
    assert_eq!(watchdog.bites_at_ns(), Some(200_001_000));
    watchdog.write(0x00, 0xaaaa, 50_000_000);
    assert_eq!(watchdog.bites_at_ns(), Some(250_000_000));
}

#[test]
fn adc_becomes_ready_and_converts() {
    let mut adc = Adc::new(2193);
    adc.write(0x08, 1 << 2);
    assert_eq!(adc.read(0x00), 0, "not enabled: no conversion");
    adc.write(0x08, 1 << 31);
    assert_eq!(adc.read(0x08) >> 31, 0, "calibration is over at once");
    adc.write(0x08, 1);
    assert_eq!(adc.read(0x00) & 1, 1);
    adc.write(0x08, 1 << 2);
    assert_eq!(adc.read(0x00) & 0b1100, 0b1100);
    assert_eq!(adc.read(0x40), 2193);
    assert_eq!(adc.read(0x00) & 0b0100, 0, "reading the data clears EOC");
}

const RNG_CR: u64 = 0x00;
const RNG_SR: u64 = 0x04;
const RNG_DR: u64 = 0x08;
const RNGEN: u32 = 1 << 2;

#[test]
fn a_generator_gives_words_when_on_and_a_failed_seed_needs_a_restart() {
    let mut rng = Rng::new(5, None);
    assert_eq!((rng.read(RNG_SR), rng.read(RNG_DR)), (0, 0), "off");
    rng.write(RNG_CR, RNGEN);
    assert_eq!(rng.read(RNG_SR), 1);
    assert_ne!(rng.read(RNG_DR), rng.read(RNG_DR));

    let mut rng = Rng::new(5, Some(RngFault::SeedOnce));
    rng.write(RNG_CR, RNGEN);
    while rng.read(RNG_SR) == 1 {
        assert_ne!(rng.read(RNG_DR), 0);
    }
    assert_eq!(rng.read(RNG_SR), (1 << 2) | (1 << 6));
    rng.write(RNG_SR, 0);
    assert_ne!(rng.read(RNG_SR), 1, "not while it is on");
    rng.write(RNG_CR, 0);
    rng.write(RNG_SR, 0);
    rng.write(RNG_CR, RNGEN);
    assert_eq!(rng.read(RNG_SR), 1);
    for _ in 0..100 {
        assert_ne!(rng.read(RNG_DR), 0);
    }
    assert_eq!(rng.read(RNG_SR), 1, "once");
}

#[test]
fn a_broken_generator_says_how_or_says_nothing() {
    for (fault, status) in [
        (RngFault::Silent, 0),
        (RngFault::Seed, (1 << 2) | (1 << 6)),
        (RngFault::Clock, (1 << 1) | (1 << 5)),
    ] {
        let mut rng = Rng::new(5, Some(fault));
        for _ in 0..3 {
            rng.write(RNG_CR, 0);
            rng.write(RNG_SR, 0);
            rng.write(RNG_CR, RNGEN);
            assert_eq!((rng.read(RNG_SR), rng.read(RNG_DR)), (status, 0));
        }
    }
    let mut rng = Rng::new(5, Some(RngFault::Stuck));
    rng.write(RNG_CR, RNGEN);
    assert_eq!((rng.read(RNG_DR), rng.read(RNG_DR)), (5, 5));
}

/// RM0351 section 6.4.29: flags add up until software removes them, and the slow oscillator is ready at once.
#[test]
fn the_cause_of_a_reset_stands_until_it_is_removed() {
    const RMVF: u32 = 1 << 23;
    let [pin, brown_out, software, watchdog] = [26, 27, 28, 29].map(|bit| 1_u32 << bit);
    let mut flags = ResetFlags::new();
    assert_eq!(flags.read(), 0x0c00_0600, "the reset value");
    flags.reset(true);
    assert_eq!(flags.read() & (0xff << 24), pin | brown_out | watchdog);
    flags.write(flags.read() | RMVF | 1);
    assert_eq!(flags.read(), 0x0000_0603);
    flags.reset(false);
    assert_eq!(flags.read(), pin | software | 0x600);
}
