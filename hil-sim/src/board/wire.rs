//! The lock-step messages between the QEMU plugin and the host side, one definition for both.
//!
//! The plugin sends a [`Report`] and waits for an [`Order`]; guest time stands still meanwhile. An order holds every
//! byte that is already on its way to the guest, with the instant its stop bit ends, and replaces the order before.
//! All integers are little-endian. This file is also compiled into the plugin, so it uses nothing but `std`.

use std::io::{self, Read, Write};

/// Version of these messages; the plugin sends it first and the host side refuses another one.
pub const WIRE_VERSION: u32 = 2;

/// Most bytes in one message: a guard against a broken peer, far above any burst (a 96 KiB RAM cannot queue more).
const MAX_BYTES: u32 = 1 << 20;

/// Most regions in one message.
const MAX_REGIONS: u32 = 64;

/// The serial ports of the board, in the order of their numbers on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Port {
    /// RS485 to the motor drivers.
    Bus,
    /// Host link over the cable (USB serial).
    Wire,
    /// Host link over the Bluetooth module.
    Radio,
}

impl Port {
    /// All ports, by number.
    pub const ALL: [Port; 3] = [Port::Bus, Port::Wire, Port::Radio];

    /// Number of the port on the wire.
    #[must_use]
    pub fn number(self) -> u8 {
        match self {
            Port::Bus => 0,
            Port::Wire => 1,
            Port::Radio => 2,
        }
    }

    fn from_number(number: u8) -> io::Result<Self> {
        Port::ALL
            .get(usize::from(number))
            .copied()
            .ok_or_else(|| bad("unknown port number"))
    }
}

/// One byte on a serial line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TimedByte {
    /// Which line.
    pub port: Port,
    /// The byte.
    pub byte: u8,
    /// Guest time at the end of its stop bit, nanoseconds.
    pub end_ns: u64,
    /// The line was not at rest where the stop bit belongs: the receiver sees a framing error.
    pub damaged: bool,
}

/// What is wrong with the board's random number generator: an option of the plugin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RngFault {
    /// It never has a word ready.
    Silent,
    /// An error of its seed that no restart takes away.
    Seed,
    /// An error of its seed in mid-sequence, once in every life of the machine, that a restart takes away.
    SeedOnce,
    /// Its clock is dead.
    Clock,
    /// It gives the same word for ever.
    Stuck,
}

impl RngFault {
    /// All of them.
    pub const ALL: [RngFault; 5] = [
        RngFault::Silent,
        RngFault::Seed,
        RngFault::SeedOnce,
        RngFault::Clock,
        RngFault::Stuck,
    ];

    /// The value of the option `rng`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            RngFault::Silent => "silent",
            RngFault::Seed => "seed",
            RngFault::SeedOnce => "seed-once",
            RngFault::Clock => "clock",
            RngFault::Stuck => "stuck",
        }
    }
}

/// Instructions counted between two addresses of the image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RegionCount {
    /// How many times the region was run through.
    pub runs: u64,
    /// Fewest instructions in one run.
    pub min: u64,
    /// Most instructions in one run.
    pub max: u64,
    /// Sum over all runs.
    pub sum: u64,
    /// Most instructions of all runs between two begins of the first region.
    pub most_in_period: u64,
}

/// Why the plugin speaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// The guest has not run yet; carries [`WIRE_VERSION`] in `now_ns`.
    Hello,
    /// The guest sent bytes, or the instant asked for by the last order has come.
    Sync,
    /// The last message: figures of the run; no order follows.
    Final,
}

/// Plugin to host.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Report {
    /// Why it is sent.
    pub cause: Cause,
    /// Guest time, nanoseconds.
    pub now_ns: u64,
    /// Instructions executed so far.
    pub instructions: u64,
    /// Nanoseconds one byte takes on each port, from the guest's baud rate register; 0 while a port is off.
    pub byte_ns: [u64; 3],
    /// Bytes the guest sent since the last report.
    pub sent: Vec<TimedByte>,
    /// Bytes lost in the guest because it read too late, per port.
    pub overruns: [u64; 3],
    /// Only in the last message: resets by the watchdog.
    pub watchdog_bites: u64,
    /// Only in the last message: the counted regions, in the order of the plugin's options.
    pub regions: Vec<RegionCount>,
    /// Only in the last message: instructions of each function of the profile.
    pub profile: Vec<u64>,
    /// Only in the last message: bytes of stack never written; `u64::MAX` when not asked for.
    pub stack_untouched: u64,
}

/// Bytes to write into the guest's RAM: a seeded bit flip, a left-over of the boot before.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Poke {
    /// First address.
    pub address: u32,
    /// New content.
    pub bytes: Vec<u8>,
}

/// Host to plugin.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Order {
    /// End the run; the plugin answers with the final report.
    pub quit: bool,
    /// Level of the STOP input: the emergency circuit is open.
    pub stop_open: bool,
    /// Reset the guest now, as the reset pin would.
    pub reset: bool,
    /// Forget the counted regions and the profile so far.
    pub restart_counts: bool,
    /// What the battery's voltage converts to, 0..=4095.
    pub battery_sample: u16,
    /// Words of the slot store to make unreadable, by their first byte.
    pub damage: Vec<u32>,
    /// What to write into the guest's RAM before it runs on.
    pub pokes: Vec<Poke>,
    /// Report at this guest time at the latest, nanoseconds.
    pub next_sync_ns: u64,
    /// Every byte on its way to the guest, in order of time per port.
    pub bytes: Vec<TimedByte>,
}

fn bad(text: &'static str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, text)
}

struct Out(Vec<u8>);

impl Out {
    fn u8(&mut self, value: u8) {
        self.0.push(value);
    }
    fn u64(&mut self, value: u64) {
        self.0.extend_from_slice(&value.to_le_bytes());
    }
    fn bytes(&mut self, bytes: &[TimedByte]) {
        self.u64(bytes.len() as u64);
        for b in bytes {
            self.u8(b.port.number());
            self.u8(b.byte);
            self.u64(b.end_ns);
            self.u8(u8::from(b.damaged));
        }
    }
}

fn read_u8(from: &mut impl Read) -> io::Result<u8> {
    let mut b = [0];
    from.read_exact(&mut b)?;
    Ok(b[0])
}

fn read_u64(from: &mut impl Read) -> io::Result<u64> {
    let mut b = [0; 8];
    from.read_exact(&mut b)?;
    Ok(u64::from_le_bytes(b))
}

fn read_small<T: TryFrom<u64>>(from: &mut impl Read) -> io::Result<T> {
    T::try_from(read_u64(from)?).map_err(|_| bad("number out of range"))
}

fn read_poke(from: &mut impl Read) -> io::Result<Poke> {
    let address = read_small(from)?;
    let mut bytes = vec![0; read_count(from, MAX_BYTES)? as usize];
    from.read_exact(&mut bytes)?;
    Ok(Poke { address, bytes })
}

fn read_count(from: &mut impl Read, limit: u32) -> io::Result<u64> {
    let count = read_u64(from)?;
    if count > u64::from(limit) {
        return Err(bad("count out of range"));
    }
    Ok(count)
}

fn read_bytes(from: &mut impl Read) -> io::Result<Vec<TimedByte>> {
    let count = read_count(from, MAX_BYTES)?;
    (0..count)
        .map(|_| {
            Ok(TimedByte {
                port: Port::from_number(read_u8(from)?)?,
                byte: read_u8(from)?,
                end_ns: read_u64(from)?,
                damaged: read_bool(from)?,
            })
        })
        .collect()
}

fn read_three(from: &mut impl Read) -> io::Result<[u64; 3]> {
    Ok([read_u64(from)?, read_u64(from)?, read_u64(from)?])
}

fn read_bool(from: &mut impl Read) -> io::Result<bool> {
    match read_u8(from)? {
        0 => Ok(false),
        1 => Ok(true),
        _ => Err(bad("flag is neither 0 nor 1")),
    }
}

impl Report {
    /// A report without figures.
    #[must_use]
    pub fn new(cause: Cause, now_ns: u64) -> Self {
        Report {
            cause,
            now_ns,
            instructions: 0,
            byte_ns: [0; 3],
            sent: Vec::new(),
            overruns: [0; 3],
            watchdog_bites: 0,
            regions: Vec::new(),
            profile: Vec::new(),
            stack_untouched: u64::MAX,
        }
    }

    /// Writes the message in one piece.
    ///
    /// # Errors
    /// Those of the stream.
    pub fn write(&self, to: &mut impl Write) -> io::Result<()> {
        let mut out = Out(Vec::with_capacity(128 + 11 * self.sent.len()));
        out.u8(match self.cause {
            Cause::Hello => 0,
            Cause::Sync => 1,
            Cause::Final => 2,
        });
        out.u64(self.now_ns);
        out.u64(self.instructions);
        self.byte_ns.iter().for_each(|&v| out.u64(v));
        out.bytes(&self.sent);
        self.overruns.iter().for_each(|&v| out.u64(v));
        out.u64(self.watchdog_bites);
        out.u64(self.regions.len() as u64);
        for r in &self.regions {
            [r.runs, r.min, r.max, r.sum, r.most_in_period]
                .iter()
                .for_each(|&v| out.u64(v));
        }
        out.u64(self.profile.len() as u64);
        self.profile.iter().for_each(|&v| out.u64(v));
        out.u64(self.stack_untouched);
        to.write_all(&out.0)?;
        to.flush()
    }

    /// Reads one message.
    ///
    /// # Errors
    /// Those of the stream, and `InvalidData` for bytes that are no report.
    pub fn read(from: &mut impl Read) -> io::Result<Self> {
        let cause = match read_u8(from)? {
            0 => Cause::Hello,
            1 => Cause::Sync,
            2 => Cause::Final,
            _ => return Err(bad("unknown cause")),
        };
        let now_ns = read_u64(from)?;
        let instructions = read_u64(from)?;
        let byte_ns = read_three(from)?;
        let sent = read_bytes(from)?;
        let overruns = read_three(from)?;
        let watchdog_bites = read_u64(from)?;
        let count = read_count(from, MAX_REGIONS)?;
        let regions = (0..count)
            .map(|_| {
                Ok(RegionCount {
                    runs: read_u64(from)?,
                    min: read_u64(from)?,
                    max: read_u64(from)?,
                    sum: read_u64(from)?,
                    most_in_period: read_u64(from)?,
                })
            })
            .collect::<io::Result<Vec<_>>>()?;
        let profile = (0..read_count(from, MAX_BYTES)?)
            .map(|_| read_u64(from))
            .collect::<io::Result<_>>()?;
        let stack_untouched = read_u64(from)?;
        Ok(Report {
            cause,
            now_ns,
            instructions,
            byte_ns,
            sent,
            overruns,
            watchdog_bites,
            regions,
            profile,
            stack_untouched,
        })
    }
}

impl Order {
    /// Writes the message in one piece.
    ///
    /// # Errors
    /// Those of the stream.
    pub fn write(&self, to: &mut impl Write) -> io::Result<()> {
        let mut out = Out(Vec::with_capacity(24 + 11 * self.bytes.len()));
        out.u8(u8::from(self.quit));
        out.u8(u8::from(self.stop_open));
        out.u8(u8::from(self.reset));
        out.u8(u8::from(self.restart_counts));
        out.u64(u64::from(self.battery_sample));
        out.u64(self.damage.len() as u64);
        self.damage
            .iter()
            .for_each(|&byte| out.u64(u64::from(byte)));
        out.u64(self.pokes.len() as u64);
        for poke in &self.pokes {
            out.u64(u64::from(poke.address));
            out.u64(poke.bytes.len() as u64);
            poke.bytes.iter().for_each(|&byte| out.u8(byte));
        }
        out.u64(self.next_sync_ns);
        out.bytes(&self.bytes);
        to.write_all(&out.0)?;
        to.flush()
    }

    /// Reads one message.
    ///
    /// # Errors
    /// Those of the stream, and `InvalidData` for bytes that are no order.
    pub fn read(from: &mut impl Read) -> io::Result<Self> {
        Ok(Order {
            quit: read_bool(from)?,
            stop_open: read_bool(from)?,
            reset: read_bool(from)?,
            restart_counts: read_bool(from)?,
            battery_sample: read_small(from)?,
            damage: (0..read_count(from, MAX_BYTES)?)
                .map(|_| read_small(from))
                .collect::<io::Result<_>>()?,
            pokes: (0..read_count(from, MAX_BYTES)?)
                .map(|_| read_poke(from))
                .collect::<io::Result<_>>()?,
            next_sync_ns: read_u64(from)?,
            bytes: read_bytes(from)?,
        })
    }
}
