// SPDX-License-Identifier: GPL-2.0-or-later
//! Register model of an STM32L4 USART (RM0351 section 40), as much of it as the HAL touches, with byte times.
//!
//! Pure: time comes in as nanoseconds, bytes come from a queue and go to a list. QEMU's own model has no byte times, no
//! IDLE flag, refuses 8-bit access and loses TXE when reserved bit 7 of ICR is written; this one replaces it.

use std::collections::VecDeque;

const CR1: u64 = 0x00;
const CR2: u64 = 0x04;
const CR3: u64 = 0x08;
const BRR: u64 = 0x0c;
const GTPR: u64 = 0x10;
const RTOR: u64 = 0x14;
const RQR: u64 = 0x18;
const ISR: u64 = 0x1c;
const ICR: u64 = 0x20;
const RDR: u64 = 0x24;
const TDR: u64 = 0x28;

// CR1 bits.
const UE: u32 = 1 << 0;
const RE: u32 = 1 << 2;
const TE: u32 = 1 << 3;
const IDLEIE: u32 = 1 << 4;
const RXNEIE: u32 = 1 << 5;
const TCIE: u32 = 1 << 6;
const TXEIE: u32 = 1 << 7;
const OVER8: u32 = 1 << 15;
/// DEAT, five bits: how long the driver is enabled before the start bit, in samples of a bit (RM0351 section 40.8.1).
const DEAT: u32 = 0x1f << 21;
// CR3 bits.
const EIE: u32 = 1 << 0;
const DEM: u32 = 1 << 14;
// ISR bits; ICR clears at the same places.
const FE: u32 = 1 << 1;
const ORE: u32 = 1 << 3;
const IDLE: u32 = 1 << 4;
const RXNE: u32 = 1 << 5;
const TC: u32 = 1 << 6;
const TXE: u32 = 1 << 7;
const TEACK: u32 = 1 << 21;
const REACK: u32 = 1 << 22;
/// Flags that ICR can clear: PE, FE, NE, ORE, IDLE, TC, LBD, CTS, RTO, EOB, CM, WU. Bit 7 is reserved.
const CLEARABLE: u32 = 0x0012_1b5f;
/// RXFRQ of RQR: drop the received byte.
const RXFRQ: u32 = 1 << 3;

/// Bits on the wire for one byte: start, eight data, stop.
const BITS_PER_BYTE: u64 = 10;

/// One byte on the line and the end of its stop bit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Transmitted {
    pub(crate) byte: u8,
    pub(crate) end_ns: u64,
    /// Its stop bit is none. What the guest sends never is.
    pub(crate) damaged: bool,
}

impl Transmitted {
    fn whole(byte: u8, end_ns: u64) -> Self {
        Transmitted {
            byte,
            end_ns,
            damaged: false,
        }
    }
}

/// The USART.
#[derive(Debug, Default)]
pub(crate) struct Usart {
    clock_hz: u64,
    cr1: u32,
    cr2: u32,
    cr3: u32,
    brr: u32,
    gtpr: u32,
    rtor: u32,
    flags: u32,
    received: u8,
    waiting: Option<u8>,
    shifting: Option<Transmitted>,
    /// The byte that is leaving does not reach the line: see [`Usart::enables_too_late`].
    muffled: bool,
    idle_at_ns: Option<u64>,
    incoming: VecDeque<Transmitted>,
    sent: Vec<Transmitted>,
    overruns: u64,
    burst_ended: bool,
}

impl Usart {
    /// A USART after reset, clocked with `clock_hz`.
    pub(crate) fn new(clock_hz: u64) -> Self {
        Usart {
            clock_hz,
            flags: TC | TXE,
            ..Usart::default()
        }
    }

    /// Back to the state after reset. Bytes on their way to the guest stay on their way.
    pub(crate) fn reset(&mut self) {
        let incoming = std::mem::take(&mut self.incoming);
        let overruns = self.overruns;
        *self = Usart {
            incoming,
            overruns,
            ..Usart::new(self.clock_hz)
        };
    }

    /// Duration of one byte; 0 while the baud rate is not set or the USART is off.
    pub(crate) fn byte_ns(&self) -> u64 {
        if self.cr1 & UE == 0 || self.brr == 0 {
            return 0;
        }
        let divider = if self.cr1 & OVER8 == 0 {
            u64::from(self.brr)
        } else {
            // RM0351 40.5.4: BRR[3:0] holds USARTDIV[3:0] shifted right by one.
            u64::from((self.brr & !0xf) | ((self.brr & 0x7) << 1)) / 2
        };
        BITS_PER_BYTE * divider * 1_000_000_000 / self.clock_hz
    }

    /// Bytes lost because RDR was still full.
    pub(crate) fn overruns(&self) -> u64 {
        self.overruns
    }

    /// Replaces the bytes on their way to the guest (in order of time).
    pub(crate) fn schedule(&mut self, bytes: impl Iterator<Item = Transmitted>) {
        self.incoming.clear();
        self.incoming.extend(bytes);
    }

    /// True while a byte is leaving.
    pub(crate) fn transmitting(&self) -> bool {
        self.shifting.is_some()
    }

    /// Takes what was sent since the last call.
    pub(crate) fn take_sent(&mut self) -> Vec<Transmitted> {
        self.burst_ended = false;
        std::mem::take(&mut self.sent)
    }

    /// True when the last byte of a burst has left and nobody has taken it.
    pub(crate) fn has_news(&self) -> bool {
        self.burst_ended
    }

    /// The next instant at which something happens by itself.
    pub(crate) fn next_event_ns(&self) -> Option<u64> {
        let shift = self.shifting.map(|s| s.end_ns);
        let rx = self.incoming.front().map(|b| b.end_ns);
        [shift, rx, self.idle_at_ns].into_iter().flatten().min()
    }

    /// Runs to `now_ns`, events in order of time; at equal times transmission first, then reception, then IDLE.
    pub(crate) fn advance(&mut self, now_ns: u64) {
        while let Some(at) = self.next_event_ns().filter(|&at| at <= now_ns) {
            if self.shifting.is_some_and(|s| s.end_ns == at) {
                self.transmit_done(at);
            } else if self.incoming.front().is_some_and(|b| b.end_ns == at) {
                self.receive(at);
            } else {
                self.idle_at_ns = None;
                self.flags |= IDLE;
            }
        }
    }

    fn transmit_done(&mut self, at_ns: u64) {
        let sent = self.shifting.take();
        if !std::mem::take(&mut self.muffled) {
            self.sent.extend(sent);
        }
        match self.waiting.take() {
            Some(byte) => {
                self.flags |= TXE;
                self.shifting = Some(Transmitted::whole(byte, at_ns + self.byte_ns()));
            }
            None => {
                self.flags |= TC;
                self.burst_ended = true;
            }
        }
    }

    fn receive(&mut self, at_ns: u64) {
        let Some(byte) = self.incoming.pop_front() else {
            return;
        };
        // With driver enable the transceiver's receiver is off while it sends.
        let deaf = self.cr3 & DEM != 0 && self.shifting.is_some();
        if deaf || self.cr1 & (UE | RE) != UE | RE {
            return;
        }
        if self.flags & RXNE != 0 {
            self.flags |= ORE;
            self.overruns += 1;
        } else {
            self.received = byte.byte;
            self.flags |= RXNE;
            // With the byte, which reaches RDR too (RM0351 section 40.5.3). A byte that is lost leaves its fault with it.
            if byte.damaged {
                self.flags |= FE;
            }
        }
        // IDLE needs the line quiet for a whole frame: not if the next start bit comes before that.
        let byte_ns = self.byte_ns();
        let next_start = self
            .incoming
            .front()
            .map(|b| b.end_ns.saturating_sub(byte_ns));
        self.idle_at_ns = match next_start {
            Some(start) if start < at_ns + byte_ns => None,
            _ => Some(at_ns + byte_ns),
        };
    }

    /// Level of the interrupt line.
    pub(crate) fn interrupt(&self) -> bool {
        let on = |enable: u32, flags: u32| self.cr1 & enable != 0 && self.flags & flags != 0;
        on(RXNEIE, RXNE | ORE)
            || on(IDLEIE, IDLE)
            || on(TCIE, TC)
            || on(TXEIE, TXE)
            || (self.cr3 & EIE != 0 && self.flags & (FE | ORE) != 0)
    }

    /// Guest load. Any width: an 8-bit load of RDR is what the HAL does.
    pub(crate) fn read(&mut self, offset: u64) -> u32 {
        match offset {
            CR1 => self.cr1,
            CR2 => self.cr2,
            CR3 => self.cr3,
            BRR => self.brr,
            GTPR => self.gtpr,
            RTOR => self.rtor,
            ISR => {
                let acknowledge = |enable, flag| {
                    if self.cr1 & (UE | enable) == UE | enable {
                        flag
                    } else {
                        0
                    }
                };
                self.flags | acknowledge(TE, TEACK) | acknowledge(RE, REACK)
            }
            RDR => {
                self.flags &= !RXNE;
                u32::from(self.received)
            }
            TDR => self.waiting.map_or(0, u32::from),
            _ => 0,
        }
    }

    /// Guest store at `now_ns`.
    pub(crate) fn write(&mut self, offset: u64, value: u32, now_ns: u64) {
        match offset {
            CR1 => self.cr1 = value,
            CR2 => self.cr2 = value,
            CR3 => self.cr3 = value,
            BRR => self.brr = value & 0xffff,
            GTPR => self.gtpr = value,
            RTOR => self.rtor = value,
            RQR if value & RXFRQ != 0 => self.flags &= !RXNE,
            ICR => self.flags &= !(value & CLEARABLE),
            TDR => self.transmit(value.to_le_bytes()[0], now_ns),
            _ => {}
        }
    }

    /// Models the enable time of an RS485 transceiver: how long it takes from the enable signal until the line is driven. Without any lead time
    /// (DEAT 0) the start bit of the first byte of a burst is short by it. How short a receiver bears depends on the parts: here it loses the byte.
    fn enables_too_late(&self) -> bool {
        self.cr3 & DEM != 0 && self.cr1 & DEAT == 0
    }

    fn transmit(&mut self, byte: u8, now_ns: u64) {
        let byte_ns = self.byte_ns();
        if self.cr1 & (UE | TE) != UE | TE || byte_ns == 0 {
            return;
        }
        self.flags &= !TC;
        if self.shifting.is_none() {
            self.muffled = self.enables_too_late();
            self.shifting = Some(Transmitted::whole(byte, now_ns + byte_ns));
        } else {
            // A store while TXE is clear overwrites the waiting byte, as on silicon.
            self.waiting = Some(byte);
            self.flags &= !TXE;
        }
    }
}
