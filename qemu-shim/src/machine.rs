// SPDX-License-Identifier: GPL-2.0-or-later
//! What the plugin adds to QEMU's `b-l475e-iot01a`: three USARTs with byte times, the blocks of
//! [`crate::blocks`], the level of the STOP input, and the lock-step with the host side.
//!
//! All of it runs under QEMU's big lock: MMIO callbacks, the timer, the reset handler. Guest time under `-icount` is a
//! function of the instructions executed and of the timers, so every run with the same orders is the same run.

use std::ffi::{CStr, c_int, c_uint, c_void};
use std::io::BufReader;
use std::os::unix::net::UnixStream;
use std::sync::{Mutex, PoisonError};

use crate::blocks::{
    Adc, Flash, RegisterFile, ResetFlags, Rng, STORE_ADDRESS, STORE_BYTES, Watchdog,
};
use crate::counters;
use crate::ffi::{self, AccessImpl, AccessValid, MemoryRegionOps, MemoryRegionRoom, TimerRoom};
use crate::options::Options;
use crate::sleep;
use crate::usart::{Transmitted, Usart};
use crate::wire::{Cause, Order, Port, Report, TimedByte, WIRE_VERSION};

/// Base address and interrupt number of each port (RM0351 tables 2 and 58): USART2, USART1, UART4.
const USARTS: [(u64, c_int); 3] = [(0x4000_4400, 38), (0x4001_3800, 37), (0x4000_4c00, 52)];
/// The other register blocks, in the order of [`Block`]; the last one is the pages of the slot store.
const BLOCKS: [(u64, u64); 8] = [
    (0x4000_7000, 0x400),
    (0x4002_2000, 0x400),
    (0x4000_3000, 0x400),
    (0x5004_0000, 0x400),
    (0x5006_0800, 0x400),
    (0x1fff_7400, 0x400),
    (0x4002_1094, 4),
    (STORE_ADDRESS, STORE_BYTES as u64),
];
/// Index of the motor bus in [`USARTS`].
const BUS: usize = 0;
/// A guest that sends without end is interrupted after this time.
const LONGEST_BURST_NS: u64 = 50_000_000;
const USART_BYTES: u64 = 0x400;
/// PWR_CR1 after reset: voltage range 1.
const PWR_INITIAL: [(u64, u32); 1] = [(0x00, 0x0000_0200)];
/// Above QEMU's own models (priority 0 and 10).
const PRIORITY: c_int = 10_000;
/// STOP input: PD14.
const STOP_GPIO: (&CStr, c_int) = (c"/machine/soc/gpiod", 14);
const CPU_PATH: &CStr = c"/machine/soc/armv7m";
/// Paint of cortex-m-rt's `paint-stack`.
const STACK_PAINT: u32 = 0xcccc_cccc;

#[derive(Clone, Copy)]
enum Block {
    Usart(usize),
    Pwr,
    Flash,
    Watchdog,
    Adc,
    Rng,
    Identity,
    ResetFlags,
    Store,
}

impl Block {
    fn from_index(index: usize) -> Option<Self> {
        let others = [
            Block::Pwr,
            Block::Flash,
            Block::Watchdog,
            Block::Adc,
            Block::Rng,
            Block::Identity,
            Block::ResetFlags,
            Block::Store,
        ];
        match index.checked_sub(USARTS.len()) {
            None => Some(Block::Usart(index)),
            Some(other) => others.get(other).copied(),
        }
    }
}

struct Machine {
    options: Options,
    reader: BufReader<UnixStream>,
    writer: UnixStream,
    usarts: [Usart; 3],
    pwr: RegisterFile,
    flash: Flash,
    watchdog: Watchdog,
    adc: Adc,
    rng: Rng,
    identity: RegisterFile,
    reset_flags: ResetFlags,
    powered: bool,
    bitten: bool,
    interrupts: [*mut c_void; 3],
    levels: [bool; 3],
    stop_line: *mut c_void,
    nmi: *mut c_void,
    watchdog_bites: u64,
    timer: *mut TimerRoom,
    next_sync_ns: u64,
}

// SAFETY: the raw pointers are QEMU objects that live as long as the process, used under QEMU's big lock only.
unsafe impl Send for Machine {}

static MACHINE: Mutex<Option<Machine>> = Mutex::new(None);

fn with_machine<T>(action: impl FnOnce(&mut Machine) -> T) -> Option<T> {
    MACHINE
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .as_mut()
        .map(action)
}

fn now_ns() -> u64 {
    // SAFETY: reads a clock; MMIO callbacks, timers and reset handlers may do so at any time.
    let now = unsafe { ffi::qemu_clock_get_ns(ffi::CLOCK_VIRTUAL) };
    u64::try_from(now).unwrap_or(0)
}

/// Connects to the host side and asks to be called when the machine is complete.
pub(crate) fn install(options: Options) -> std::io::Result<()> {
    let writer = UnixStream::connect(&options.socket)?;
    let reader = BufReader::new(writer.try_clone()?);
    let (clock_hz, seed, rng_fault) = (options.clock_hz, options.seed, options.rng_fault);
    let machine = Machine {
        options,
        reader,
        writer,
        usarts: std::array::from_fn(|_| Usart::new(clock_hz)),
        pwr: RegisterFile::new(&PWR_INITIAL),
        flash: Flash::new(),
        watchdog: Watchdog::new(),
        adc: Adc::new(0),
        rng: Rng::new(seed, rng_fault),
        identity: identity(seed),
        reset_flags: ResetFlags::new(),
        powered: false,
        bitten: false,
        interrupts: [std::ptr::null_mut(); 3],
        levels: [false; 3],
        stop_line: std::ptr::null_mut(),
        nmi: std::ptr::null_mut(),
        watchdog_bites: 0,
        timer: Box::into_raw(Box::new(TimerRoom([0; 128]))),
        next_sync_ns: 0,
    };
    *MACHINE.lock().unwrap_or_else(PoisonError::into_inner) = Some(machine);
    let notifier = Box::new(ffi::Notifier {
        notify: machine_done,
        node: [std::ptr::null_mut(); 2],
    });
    // SAFETY: the notifier lives for ever; QEMU links it into its list and calls it once.
    unsafe { ffi::qemu_add_machine_init_done_notifier(Box::into_raw(notifier)) };
    Ok(())
}

/// Sends the last report. Nothing can be done about a host side that is gone.
pub(crate) fn finish() {
    with_machine(|machine| {
        let _ = machine.report(Cause::Final);
    });
}

extern "C" fn machine_done(_notifier: *mut ffi::Notifier, _data: *mut c_void) {
    with_machine(|machine| {
        for (index, &(address, irq)) in USARTS.iter().enumerate() {
            map(address, USART_BYTES, index);
            machine.interrupts[index] = input_line(CPU_PATH, irq);
        }
        for (index, &(address, bytes)) in BLOCKS.iter().enumerate() {
            map(address, bytes, USARTS.len() + index);
        }
        machine.nmi = named_input(CPU_PATH, c"NMI");
        machine.stop_line = input_line(STOP_GPIO.0, STOP_GPIO.1);
        // SAFETY: `timer` is zeroed room of sufficient size that is never freed; a null group is the main loop's.
        unsafe {
            ffi::timer_init_full(
                machine.timer,
                std::ptr::null_mut(),
                ffi::CLOCK_VIRTUAL,
                ffi::SCALE_NS,
                0,
                timer_fired,
                std::ptr::null_mut(),
            );
            ffi::qemu_register_reset(machine_reset, std::ptr::null_mut());
        }
        sleep::prepare();
        let hello = Report::new(Cause::Hello, u64::from(WIRE_VERSION));
        let sent = hello.write(&mut machine.writer);
        let answer = sent.and_then(|()| Order::read(&mut machine.reader));
        machine.obey(answer);
        machine.settle(0);
    });
}

/// Lays our registers over an address of the machine. `index` counts the USARTs, then [`BLOCKS`].
fn map(address: u64, bytes: u64, index: usize) {
    let ops = Box::new(MemoryRegionOps {
        read: mmio_read,
        write: mmio_write,
        read_with_attrs: std::ptr::null(),
        write_with_attrs: std::ptr::null(),
        endianness: ffi::LITTLE_ENDIAN,
        valid: AccessValid {
            min: 1,
            max: 4,
            unaligned: false,
            accepts: std::ptr::null(),
        },
        implemented: AccessImpl {
            min: 1,
            max: 4,
            unaligned: false,
        },
    });
    let room = Box::into_raw(Box::new(MemoryRegionRoom([0; 1024])));
    // SAFETY: the machine exists; region and ops are leaked on purpose and outlive it; the opaque pointer is a number.
    unsafe {
        ffi::memory_region_init_io(
            room,
            std::ptr::null_mut(),
            Box::into_raw(ops),
            std::ptr::without_provenance_mut(index),
            c"rb-shim".as_ptr(),
            bytes,
        );
        ffi::memory_region_add_subregion_overlap(ffi::get_system_memory(), address, room, PRIORITY);
    }
}

fn device(path: &CStr) -> *mut c_void {
    let mut ambiguous = false;
    // SAFETY: the machine is complete; the path is a C string.
    let device = unsafe { ffi::object_resolve_path(path.as_ptr(), &mut ambiguous) };
    if device.is_null() {
        eprintln!(
            "rb-shim: QEMU has no {path:?}: this plugin needs machine b-l475e-iot01a of QEMU 10.0"
        );
        // SAFETY: ends the process; the machine cannot be completed.
        unsafe { ffi::_exit(1) }
    }
    device
}

fn input_line(path: &CStr, number: c_int) -> *mut c_void {
    // SAFETY: the device exists and has that input: an interrupt of the core or a pin of the port.
    unsafe { ffi::qdev_get_gpio_in(device(path), number) }
}

fn named_input(path: &CStr, name: &CStr) -> *mut c_void {
    // SAFETY: the device exists; the core has an input of that name.
    unsafe { ffi::qdev_get_gpio_in_named(device(path), name.as_ptr(), 0) }
}

extern "C" fn mmio_read(opaque: *mut c_void, offset: u64, width: c_uint) -> u64 {
    let now = now_ns();
    with_machine(|machine| {
        Block::from_index(opaque.addr()).map_or(0, |block| machine.load(block, offset, width, now))
    })
    .map_or(0, u64::from)
}

extern "C" fn mmio_write(opaque: *mut c_void, offset: u64, value: u64, width: c_uint) {
    let now = now_ns();
    with_machine(|machine| {
        if let Some(block) = Block::from_index(opaque.addr()) {
            machine.store(block, offset, value as u32, width, now);
        }
    });
}

extern "C" fn timer_fired(_opaque: *mut c_void) {
    let now = now_ns();
    with_machine(|machine| {
        machine.advance(now);
        if machine.watchdog.bites_at_ns().is_some_and(|at| now >= at) {
            machine.watchdog = Watchdog::new();
            machine.watchdog_bites += 1;
            machine.bitten = true;
            request_reset();
        }
        if machine.wants_sync(now) {
            let answer = machine
                .report(Cause::Sync)
                .and_then(|()| Order::read(&mut machine.reader));
            machine.obey(answer);
        }
        machine.settle(now);
    });
}

extern "C" fn machine_reset(_opaque: *mut c_void) {
    sleep::set_resetting(false);
    let now = now_ns();
    with_machine(|machine| {
        machine.usarts.iter_mut().for_each(Usart::reset);
        // The first one is QEMU's own, as power comes up.
        if std::mem::replace(&mut machine.powered, true) {
            machine
                .reset_flags
                .reset(std::mem::take(&mut machine.bitten));
        }
        machine.pwr = RegisterFile::new(&PWR_INITIAL);
        machine.flash.reset();
        machine.watchdog = Watchdog::new();
        machine.adc.reset();
        // The reset has also dropped the levels at the GPIO inputs: the next order, now, drives them again.
        machine.next_sync_ns = now;
        machine.settle(now);
    });
}

impl Machine {
    fn advance(&mut self, now: u64) {
        self.usarts.iter_mut().for_each(|u| u.advance(now));
    }

    /// A burst has ended or the host side wants to hear. Not in the middle of a burst on the motor bus, because the host
    /// side must not let time pass beyond the start of a byte that it has not been told of.
    fn wants_sync(&self, now: u64) -> bool {
        let due = now >= self.next_sync_ns || self.usarts.iter().any(Usart::has_news);
        let in_burst = self.usarts[BUS].transmitting()
            && now < self.next_sync_ns.saturating_add(LONGEST_BURST_NS);
        due && !in_burst
    }

    fn load(&mut self, block: Block, offset: u64, width: c_uint, now: u64) -> u32 {
        match block {
            Block::Usart(index) => {
                self.advance(now);
                let value = self.usarts[index].read(offset);
                self.settle(now);
                value
            }
            Block::Pwr => self.pwr.read(offset),
            Block::Flash => self.flash.read(offset),
            Block::Watchdog => self.watchdog.read(offset),
            Block::Adc => self.adc.read(offset),
            Block::Rng => self.rng.read(offset),
            Block::Identity => self.identity.read(offset),
            Block::ResetFlags => self.reset_flags.read(),
            Block::Store => {
                let (value, unreadable) = self.flash.load(offset, width);
                if unreadable {
                    self.raise_nmi();
                }
                value
            }
        }
    }

    fn store(&mut self, block: Block, offset: u64, value: u32, width: c_uint, now: u64) {
        match block {
            Block::Usart(index) => {
                self.advance(now);
                self.usarts[index].write(offset, value, now);
                self.settle(now);
            }
            Block::Pwr => self.pwr.write(offset, value),
            Block::Flash => self.flash.write(offset, value),
            Block::Watchdog => {
                self.watchdog.write(offset, value, now);
                self.settle(now);
            }
            Block::Adc => self.adc.write(offset, value),
            Block::Rng => self.rng.write(offset, value),
            Block::Identity => {}
            Block::ResetFlags => self.reset_flags.write(value),
            Block::Store => self.flash.store(offset, value, width),
        }
    }

    /// An edge: the controller takes it and stays pending until the handler runs.
    fn raise_nmi(&self) {
        // SAFETY: the line is an input of the core, looked up when the machine was complete.
        unsafe {
            ffi::qemu_set_irq(self.nmi, 1);
            ffi::qemu_set_irq(self.nmi, 0);
        }
    }

    /// After any change: interrupt lines to their levels, timer to the next event.
    fn settle(&mut self, now: u64) {
        for ((usart, &line), level) in self
            .usarts
            .iter()
            .zip(&self.interrupts)
            .zip(&mut self.levels)
        {
            if usart.interrupt() != *level {
                *level = usart.interrupt();
                // SAFETY: the line is an input of the interrupt controller, looked up when the machine was complete.
                unsafe { ffi::qemu_set_irq(line, c_int::from(*level)) };
            }
        }
        let events = self.usarts.iter().map(Usart::next_event_ns);
        let next = events
            .chain([self.watchdog.bites_at_ns()])
            .flatten()
            .min()
            .unwrap_or(u64::MAX);
        let at = if self.wants_sync(now) {
            // What ended inside an MMIO access is reported by the timer, at once.
            now
        } else if self.usarts[BUS].transmitting() {
            next
        } else {
            next.min(self.next_sync_ns)
        };
        // SAFETY: the timer was initialised when the machine was complete.
        unsafe {
            match i64::try_from(at) {
                Ok(at) => ffi::timer_mod_ns(self.timer, at),
                Err(_) => ffi::timer_del(self.timer),
            }
        }
    }

    fn report(&mut self, cause: Cause) -> std::io::Result<()> {
        let (instructions, regions, profile) = counters::read();
        let mut report = Report::new(cause, now_ns());
        report.instructions = instructions;
        for (index, port) in Port::ALL.into_iter().enumerate() {
            let usart = &mut self.usarts[index];
            report.byte_ns[index] = usart.byte_ns();
            report.overruns[index] = usart.overruns();
            let sent = usart.take_sent().into_iter();
            report.sent.extend(sent.map(|s| TimedByte {
                port,
                byte: s.byte,
                end_ns: s.end_ns,
                damaged: s.damaged,
            }));
        }
        if cause == Cause::Final {
            report.watchdog_bites = self.watchdog_bites;
            report.regions = regions;
            report.profile = profile;
            report.stack_untouched = self.options.stack.map_or(u64::MAX, untouched_stack);
        }
        report.write(&mut self.writer)
    }

    fn obey(&mut self, answer: std::io::Result<Order>) {
        let order = match answer {
            Ok(order) => order,
            Err(error) => {
                eprintln!("rb-shim: the host side is gone: {error}");
                // SAFETY: ends the process; there is nothing left to simulate for.
                unsafe { ffi::_exit(1) }
            }
        };
        if order.quit {
            let sent = self.report(Cause::Final);
            // SAFETY: ends the process without QEMU's own clean-up, which needs its main thread.
            unsafe { ffi::_exit(c_int::from(sent.is_err())) }
        }
        for (index, port) in Port::ALL.into_iter().enumerate() {
            let bytes = order.bytes.iter().filter(|b| b.port == port);
            self.usarts[index].schedule(bytes.map(|b| Transmitted {
                byte: b.byte,
                end_ns: b.end_ns,
                damaged: b.damaged,
            }));
        }
        self.next_sync_ns = order.next_sync_ns;
        for mut poke in order.pokes {
            // SAFETY: the buffer has the length given; QEMU ignores addresses that are no RAM.
            unsafe {
                let length = poke.bytes.len() as u64;
                ffi::cpu_physical_memory_rw(
                    u64::from(poke.address),
                    poke.bytes.as_mut_ptr().cast(),
                    length,
                    true,
                );
            }
        }
        if order.restart_counts {
            counters::restart();
        }
        self.adc.set_sample(order.battery_sample);
        order
            .damage
            .iter()
            .for_each(|&byte| self.flash.damage(byte as usize));
        // SAFETY: the line is an input of the GPIO port, looked up when the machine was complete.
        unsafe { ffi::qemu_set_irq(self.stop_line, c_int::from(order.stop_open)) };
        if order.reset {
            request_reset();
        }
    }
}

/// The chip's unique id (RM0351 section 49.1, 0x1fff7590): the seed and a name.
fn identity(seed: u64) -> RegisterFile {
    let name = u32::from_le_bytes(*b"QEMU");
    RegisterFile::new(&[
        (0x190, seed as u32),
        (0x194, (seed >> 32) as u32),
        (0x198, name),
    ])
}

/// Honoured by QEMU's main loop after the current instruction.
fn request_reset() {
    sleep::set_resetting(true);
    // SAFETY: sets a flag; callable at any time under the big lock.
    unsafe { ffi::qemu_system_reset_request(ffi::RESET_CAUSE_GUEST) };
}

/// Bytes at the low end of the stack that still carry their paint.
fn untouched_stack((low, high): (u64, u64)) -> u64 {
    let mut words = vec![0_u32; ((high - low) / 4) as usize];
    // SAFETY: the buffer has room for the bytes asked for; the range lies in the guest's SRAM.
    unsafe {
        ffi::cpu_physical_memory_rw(
            low,
            words.as_mut_ptr().cast(),
            4 * words.len() as u64,
            false,
        )
    };
    4 * words
        .iter()
        .take_while(|&&w| u32::from_le(w) == STACK_PAINT)
        .count() as u64
}
