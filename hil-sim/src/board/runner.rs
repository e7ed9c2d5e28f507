//! Runs the firmware image in QEMU, in lock-step with whatever is on its motor bus.

use std::ffi::OsString;
use std::fs::File;
use std::io::{self, BufReader};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::PathBuf;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use thiserror::Error;

use super::elf::Region;
use super::line::{Line, Passage};
use super::wire::{
    Cause, Order, Poke, Port, RegionCount, Report, RngFault, TimedByte, WIRE_VERSION,
};

/// Guest time of one instruction as QEMU's `-icount shift`: 16 ns, that is 62.5 MIPS or 1.28 cycles each at 80 MHz.
const ICOUNT_SHIFT: u32 = 4;
/// Longest guest time without an exchange, so that a run that is to be stopped does not run far ahead.
const HORIZON_NS: u64 = 25_000_000;
/// Battery voltage 7.6 V (2 cells) through the board's divider 10/43 into 3.3 V at 12 bit.
pub const BATTERY_FULL_SAMPLE: u16 = 2193;
/// How long the runner sleeps between two looks whether QEMU has connected or died.
const CONNECT_POLL: Duration = Duration::from_millis(2);

/// One byte on its way to the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Arrival {
    /// The byte.
    pub byte: u8,
    /// End of its stop bit, nanoseconds of guest time.
    pub end_ns: u64,
    /// It arrives with a framing error.
    pub damaged: bool,
}

/// What is on the motor bus of the board.
pub trait BusPeer {
    /// A byte from the board whose stop bit ended at `end_ns`. Called in order of time, before [`Self::advance_to`].
    fn sent(&mut self, byte: u8, end_ns: u64);

    /// Lets time pass up to `now_ns`.
    fn advance_to(&mut self, now_ns: u64);

    /// Every byte for the board that is due at the present time or later, in order of time. Asked after every exchange; the answer replaces the one
    /// before.
    fn arrivals(&mut self, into: &mut Vec<Arrival>);

    /// When something will happen by itself: a byte arrives, a driver gives up waiting.
    fn next_event_ns(&self) -> Option<u64>;
}

/// Nothing on the bus.
#[derive(Clone, Copy, Debug, Default)]
pub struct EmptyBus;

impl BusPeer for EmptyBus {
    fn sent(&mut self, _byte: u8, _end_ns: u64) {}
    fn advance_to(&mut self, _now_ns: u64) {}
    fn arrivals(&mut self, _into: &mut Vec<Arrival>) {}
    fn next_event_ns(&self) -> Option<u64> {
        None
    }
}

/// What to run and what to count.
#[derive(Clone, Debug)]
pub struct BoardConfig {
    /// `qemu-system-arm`, version 10.
    pub qemu: PathBuf,
    /// The firmware image.
    pub elf: PathBuf,
    /// The plugin of crate `qemu-shim`.
    pub plugin: PathBuf,
    /// Seed of the random number generator that the guest sees.
    pub seed: u64,
    /// What is wrong with that generator.
    pub rng_fault: Option<RngFault>,
    /// Regions whose instructions are counted.
    pub regions: Vec<Region>,
    /// Functions whose instructions are counted one by one: start and end address, in order of address.
    pub profile: Vec<(u32, u32)>,
    /// Lowest and highest address of the painted stack, if its use is to be measured.
    pub stack: Option<(u32, u32)>,
    /// Where the guest's log goes (defmt frames); `None` drops it.
    pub log: Option<PathBuf>,
}

/// Why a run ended early.
#[derive(Debug, Error)]
pub enum BoardError {
    /// The socket for the plugin.
    #[error(
        "cannot open the lock-step socket {path}: {source}; check that the directory is writable"
    )]
    Socket {
        /// Its path.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// The log file.
    #[error("cannot create the log file {path}: {source}")]
    Log {
        /// Its path.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// QEMU could not be started.
    #[error(
        "cannot start {program}: {source}; install qemu-system-arm 10.0 (Debian 12: bookworm-backports)"
    )]
    Start {
        /// Program name.
        program: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// QEMU ended before the plugin connected: a wrong version, a missing file.
    #[error("QEMU ended before it began ({status}); its own message stands above")]
    DiedAtStart {
        /// Exit status.
        status: ExitStatus,
    },
    /// The plugin speaks another version of the messages.
    #[error(
        "plugin speaks lock-step version {found}, this program {WIRE_VERSION}; build both from one commit"
    )]
    Version {
        /// The plugin's version.
        found: u64,
    },
    /// The stream broke: QEMU crashed.
    #[error("QEMU is gone in mid-run: {source}")]
    Gone {
        /// The system's reason.
        source: io::Error,
    },
    /// The guest ended the run by itself: 1 = panic, 2 = HardFault.
    #[error(
        "the firmware ended itself at {now_ns} ns of guest time with code {code:?}: 1 is a panic, 2 a HardFault; see its log"
    )]
    GuestExit {
        /// Guest time.
        now_ns: u64,
        /// Exit code of QEMU.
        code: Option<i32>,
    },
}

/// Figures of a finished run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BoardFigures {
    /// Guest time at the end, nanoseconds.
    pub guest_ns: u64,
    /// Instructions executed.
    pub instructions: u64,
    /// Exchanges over the lock-step socket.
    pub exchanges: u64,
    /// Bytes lost in the guest per port: bus, wire, radio.
    pub overruns: [u64; 3],
    /// Resets by the watchdog.
    pub watchdog_bites: u64,
    /// The counted regions in the order of the configuration.
    pub regions: Vec<RegionCount>,
    /// Instructions of each function of the profile.
    pub profile: Vec<u64>,
    /// Bytes of stack never used, if asked for.
    pub stack_untouched: Option<u64>,
}

/// A board in QEMU. Guest time moves only inside [`Self::run_until`].
pub struct BoardRunner<B: BusPeer> {
    child: Child,
    reader: BufReader<UnixStream>,
    writer: UnixStream,
    bus: B,
    bus_log: Vec<TimedByte>,
    arriving: Vec<TimedByte>,
    links: [Line; 2],
    report: Report,
    inputs: Inputs,
    exchanges: u64,
    final_report: bool,
}

/// Levels of the board's inputs and one-time events for the next order.
#[derive(Clone, Debug)]
struct Inputs {
    stop_open: bool,
    battery_sample: u16,
    reset: bool,
    restart_counts: bool,
    damage: Vec<u32>,
    pokes: Vec<Poke>,
}

fn link_index(port: Port) -> Option<usize> {
    usize::from(port.number()).checked_sub(1)
}

fn plugin_option(config: &BoardConfig, socket: &std::path::Path) -> OsString {
    let mut option = config.plugin.clone().into_os_string();
    option.push(",socket=");
    option.push(socket);
    option.push(format!(",seed={}", config.seed));
    if let Some(fault) = config.rng_fault {
        option.push(format!(",rng={}", fault.name()));
    }
    for region in &config.regions {
        let ends: Vec<_> = region.ends.iter().map(|end| format!("{end:x}")).collect();
        option.push(format!(",region={:x}:{}", region.begin, ends.join("+")));
    }
    if !config.profile.is_empty() {
        option.push(",profile=");
        option.push(profile_path(socket));
    }
    if let Some((low, high)) = config.stack {
        option.push(format!(",stack={low:x}:{high:x}"));
    }
    option
}

/// Where the plugin reads the functions of the profile.
fn profile_path(socket: &std::path::Path) -> PathBuf {
    socket.with_extension("profile")
}

fn socket_path() -> PathBuf {
    static NUMBER: AtomicU64 = AtomicU64::new(0);
    let number = NUMBER.fetch_add(1, Ordering::Relaxed);
    std::env::temp_dir().join(format!("rb-board-{}-{number}.sock", std::process::id()))
}

/// Waits for the plugin, but not for a QEMU that has died.
fn accept(listener: &UnixListener, child: &mut Child) -> Result<UnixStream, BoardError> {
    let gone = |source| BoardError::Gone { source };
    listener.set_nonblocking(true).map_err(gone)?;
    loop {
        match listener.accept() {
            Ok((stream, _)) => {
                stream.set_nonblocking(false).map_err(gone)?;
                return Ok(stream);
            }
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
            Err(source) => return Err(gone(source)),
        }
        if let Some(status) = child.try_wait().map_err(gone)? {
            return Err(BoardError::DiedAtStart { status });
        }
        std::thread::sleep(CONNECT_POLL);
    }
}

impl<B: BusPeer> BoardRunner<B> {
    /// Starts QEMU; the guest stands before its first instruction.
    ///
    /// # Errors
    /// [`BoardError`] but for `GuestExit`.
    pub fn start(config: &BoardConfig, bus: B) -> Result<Self, BoardError> {
        let path = socket_path();
        let listener = UnixListener::bind(&path).map_err(|source| BoardError::Socket {
            path: path.clone(),
            source,
        })?;
        let started =
            Self::spawn(config, &path).and_then(|mut child| match accept(&listener, &mut child) {
                Ok(stream) => Ok((child, stream)),
                Err(error) => {
                    let _ = child.kill();
                    let _ = child.wait();
                    Err(error)
                }
            });
        // The name is no longer needed, whether it worked or not.
        let _ = std::fs::remove_file(&path);
        let _ = std::fs::remove_file(profile_path(&path));
        let (child, writer) = started?;
        let mut reader = BufReader::new(
            writer
                .try_clone()
                .map_err(|source| BoardError::Gone { source })?,
        );
        let report = Report::read(&mut reader).map_err(|source| BoardError::Gone { source })?;
        if report.cause != Cause::Hello || report.now_ns != u64::from(WIRE_VERSION) {
            return Err(BoardError::Version {
                found: report.now_ns,
            });
        }
        let inputs = Inputs {
            stop_open: false,
            battery_sample: BATTERY_FULL_SAMPLE,
            reset: false,
            restart_counts: false,
            damage: Vec::new(),
            pokes: Vec::new(),
        };
        Ok(BoardRunner {
            child,
            reader,
            writer,
            bus,
            bus_log: Vec::new(),
            arriving: Vec::new(),
            links: Default::default(),
            report: Report::new(Cause::Sync, 0),
            inputs,
            exchanges: 0,
            final_report: false,
        })
    }

    fn spawn(config: &BoardConfig, socket: &std::path::Path) -> Result<Child, BoardError> {
        if !config.profile.is_empty() {
            let lines: Vec<_> = config
                .profile
                .iter()
                .map(|(start, end)| format!("{start:x} {end:x}\n"))
                .collect();
            let path = profile_path(socket);
            std::fs::write(&path, lines.concat())
                .map_err(|source| BoardError::Socket { path, source })?;
        }
        let log = match &config.log {
            None => Stdio::null(),
            Some(path) => Stdio::from(File::create(path).map_err(|source| BoardError::Log {
                path: path.clone(),
                source,
            })?),
        };
        Command::new(&config.qemu)
            .args([
                "-machine",
                "b-l475e-iot01a",
                "-nodefaults",
                "-display",
                "none",
                "-icount",
            ])
            .arg(format!("shift={ICOUNT_SHIFT},sleep=off"))
            .args(["-semihosting-config", "enable=on,target=native", "-kernel"])
            .arg(&config.elf)
            .arg("-plugin")
            .arg(plugin_option(config, socket))
            .stdin(Stdio::null())
            .stdout(log)
            .spawn()
            .map_err(|source| BoardError::Start {
                program: config.qemu.clone(),
                source,
            })
    }

    /// Guest time, nanoseconds.
    #[must_use]
    pub fn now_ns(&self) -> u64 {
        self.report.now_ns
    }

    /// What is on the motor bus.
    pub fn bus(&mut self) -> &mut B {
        &mut self.bus
    }

    /// Takes every byte that the board has put on its motor bus since the last call.
    pub fn take_bus_log(&mut self) -> Vec<TimedByte> {
        std::mem::take(&mut self.bus_log)
    }

    /// Queues bytes towards the guest on a host link. They travel at the guest's baud rate.
    pub fn send(&mut self, port: Port, bytes: &[u8]) {
        self.queue(port, bytes, Passage::Whole);
    }

    /// As [`Self::send`], but every byte arrives with a framing error.
    pub fn send_damaged(&mut self, port: Port, bytes: &[u8]) {
        self.queue(port, bytes, Passage::Damaged);
    }

    /// As [`Self::send`], but all arrive in the instant of the byte before: no guest is fast enough to take them.
    pub fn send_at_once(&mut self, port: Port, bytes: &[u8]) {
        self.queue(port, bytes, Passage::AtOnce);
    }

    fn queue(&mut self, port: Port, bytes: &[u8], passage: Passage) {
        if let Some(index) = link_index(port) {
            self.links[index].queue(bytes, passage);
        }
    }

    /// Takes what the guest has sent on a host link.
    pub fn receive(&mut self, port: Port) -> Vec<u8> {
        link_index(port).map_or_else(Vec::new, |index| {
            std::mem::take(&mut self.links[index].received)
        })
    }

    /// Opens or closes the STOP circuit.
    pub fn set_stop(&mut self, open: bool) {
        self.inputs.stop_open = open;
    }

    /// What the battery's voltage converts to, 0..=4095.
    pub fn set_battery_sample(&mut self, sample: u16) {
        self.inputs.battery_sample = sample;
    }

    /// Resets the guest when time moves next. The slot store keeps its content.
    pub fn reset(&mut self) {
        self.inputs.reset = true;
    }

    /// Forgets the counted regions and the profile so far when time moves next.
    pub fn restart_counts(&mut self) {
        self.inputs.restart_counts = true;
    }

    /// Makes the 64-bit word at this byte of the slot store unreadable when time moves next.
    pub fn damage(&mut self, byte: u32) {
        self.inputs.damage.push(byte);
    }

    /// Writes into the guest's RAM before time moves next.
    pub fn poke(&mut self, address: u32, bytes: &[u8]) {
        self.inputs.pokes.push(Poke {
            address,
            bytes: bytes.to_vec(),
        });
    }

    /// Runs until `until_ns` of guest time.
    ///
    /// # Errors
    /// [`BoardError::Gone`], [`BoardError::GuestExit`].
    pub fn run_until(&mut self, until_ns: u64) -> Result<(), BoardError> {
        while self.now_ns() < until_ns {
            self.exchange(until_ns, false)?;
        }
        Ok(())
    }

    /// Runs until the guest has sent something on `port`, `until_ns` at the latest. True if it has.
    ///
    /// # Errors
    /// As [`Self::run_until`].
    pub fn run_until_received(&mut self, port: Port, until_ns: u64) -> Result<bool, BoardError> {
        let has = |runner: &Self| {
            link_index(port).is_some_and(|index| !runner.links[index].received.is_empty())
        };
        while !has(self) && self.now_ns() < until_ns {
            self.exchange(until_ns, false)?;
        }
        Ok(has(self))
    }

    /// Ends the run.
    ///
    /// # Errors
    /// As [`Self::run_until`].
    pub fn finish(&mut self) -> Result<BoardFigures, BoardError> {
        self.exchange(u64::MAX, true)?;
        let _ = self.child.wait();
        let report = &self.report;
        Ok(BoardFigures {
            guest_ns: report.now_ns,
            instructions: report.instructions,
            exchanges: self.exchanges,
            overruns: report.overruns,
            watchdog_bites: report.watchdog_bites,
            regions: report.regions.clone(),
            profile: report.profile.clone(),
            stack_untouched: Some(report.stack_untouched).filter(|&bytes| bytes != u64::MAX),
        })
    }

    /// One order and its report.
    fn exchange(&mut self, until_ns: u64, quit: bool) -> Result<(), BoardError> {
        let order = self.order(until_ns, quit);
        let gone = |source| BoardError::Gone { source };
        order.write(&mut self.writer).map_err(gone)?;
        self.report = Report::read(&mut self.reader).map_err(gone)?;
        self.exchanges += 1;
        self.digest();
        if self.report.cause == Cause::Final {
            self.final_report = true;
            if !quit {
                let code = self.child.wait().map_err(gone)?.code();
                return Err(BoardError::GuestExit {
                    now_ns: self.report.now_ns,
                    code,
                });
            }
        }
        Ok(())
    }

    fn order(&mut self, until_ns: u64, quit: bool) -> Order {
        let now = self.now_ns();
        let mut arrivals = Vec::new();
        self.bus.arrivals(&mut arrivals);
        self.arriving.clear();
        self.arriving
            .extend(arrivals.into_iter().map(|arrival| TimedByte {
                port: Port::Bus,
                byte: arrival.byte,
                end_ns: arrival.end_ns,
                damaged: arrival.damaged,
            }));
        let mut bytes = self.arriving.clone();
        for (line, port) in self.links.iter_mut().zip([Port::Wire, Port::Radio]) {
            line.launch(port, now, self.report.byte_ns[usize::from(port.number())]);
            bytes.extend(&line.travelling);
        }
        let event_ns = self.bus.next_event_ns().unwrap_or(u64::MAX);
        let next_sync_ns = event_ns.max(now + 1);
        Order {
            quit,
            stop_open: self.inputs.stop_open,
            reset: std::mem::take(&mut self.inputs.reset),
            restart_counts: std::mem::take(&mut self.inputs.restart_counts),
            battery_sample: self.inputs.battery_sample,
            damage: std::mem::take(&mut self.inputs.damage),
            pokes: std::mem::take(&mut self.inputs.pokes),
            next_sync_ns: next_sync_ns.min(until_ns).min(now + HORIZON_NS),
            bytes,
        }
    }

    /// Hands the report's bytes to their receivers and lets time pass for them.
    fn digest(&mut self) {
        let now = self.now_ns();
        for sent in &self.report.sent {
            match link_index(sent.port) {
                None => {
                    self.bus.sent(sent.byte, sent.end_ns);
                    self.bus_log.push(*sent);
                }
                Some(index) => self.links[index].received.push(sent.byte),
            }
        }
        self.bus.advance_to(now);
        for line in &mut self.links {
            line.travelling.retain(|byte| byte.end_ns > now);
        }
    }
}

impl<B: BusPeer> Drop for BoardRunner<B> {
    fn drop(&mut self) {
        if !self.final_report {
            // Nobody waits for its figures any more.
            let _ = self.child.kill();
        }
        let _ = self.child.wait();
    }
}
