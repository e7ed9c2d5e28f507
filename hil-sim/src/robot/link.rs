//! The host link of the emulated robot: two byte pipes with the byte time of the line, and the end a client holds.

use super::executor::VirtualClock;
use firmware::ports::{Clock, LinkRx, LinkTx, PortError};
use std::cell::RefCell;
use std::collections::VecDeque;
use std::future::poll_fn;
use std::rc::Rc;
use std::task::Poll;

/// Byte time of 115200 baud 8N1 in ns: 10 bits.
pub const BYTE_NS_115200: u64 = 86_806;

/// What the module holds of a client's bytes that it has not looked at: the receive ring of the board. What comes on top is lost and counted.
pub const RX_RING_BYTES: usize = 1024;

/// Bytes on their way in one direction.
#[derive(Debug, Default)]
struct Pipe {
    /// Arrival time in ns and value, in order.
    bytes: VecDeque<(u64, u8)>,
    free_at_ns: u64,
    /// Bytes lost so far because the ring was full.
    lost: u64,
    /// Reports one error to the receiver before the next byte.
    broken: Option<PortError>,
}

impl Pipe {
    fn send(&mut self, now_ns: u64, byte_ns: u64, bytes: &[u8]) {
        let mut at = self.free_at_ns.max(now_ns);
        for byte in bytes {
            at += byte_ns;
            self.bytes.push_back((at, *byte));
        }
        self.free_at_ns = at;
    }

    /// As [`Pipe::send`], into a ring. The receiver is told that bytes were lost.
    fn send_bounded(&mut self, now_ns: u64, byte_ns: u64, bytes: &[u8]) {
        let room = RX_RING_BYTES.saturating_sub(self.bytes.len());
        let (taken, lost) = bytes.split_at(room.min(bytes.len()));
        self.send(now_ns, byte_ns, taken);
        if !lost.is_empty() {
            self.lost += lost.len() as u64;
            self.broken = Some(PortError::Overrun);
        }
    }

    /// Drops what is under way.
    fn clear(&mut self) {
        *self = Self {
            lost: self.lost,
            ..Self::default()
        };
    }

    fn take(&mut self, now_ns: u64) -> Option<u8> {
        let (at, byte) = *self.bytes.front()?;
        (at <= now_ns).then(|| {
            self.bytes.pop_front();
            byte
        })
    }
}

#[derive(Debug)]
struct Line {
    byte_ns: u64,
    to_module: Pipe,
    to_host: Pipe,
    connected: bool,
}

/// What the module's transmitter may queue ahead, as a UART ring does.
const TX_AHEAD_BYTES: usize = 64;

/// One host link. Clones are the same line.
#[derive(Debug, Clone)]
pub struct LinkLine {
    clock: VirtualClock,
    line: Rc<RefCell<Line>>,
}

impl LinkLine {
    /// A connected line. `byte_ns` 0 = bytes take no time.
    #[must_use]
    pub fn new(clock: VirtualClock, byte_ns: u64) -> Self {
        let line = Line {
            byte_ns,
            to_module: Pipe::default(),
            to_host: Pipe::default(),
            connected: true,
        };
        Self {
            clock,
            line: Rc::new(RefCell::new(line)),
        }
    }

    fn now_ns(&self) -> u64 {
        self.clock.now_us() * 1000
    }

    /// Client side: puts bytes on the line. Lost when the link is cut, or when they are more than the module's ring holds.
    /// Returns when the last one arrives, ns.
    pub fn write(&self, bytes: &[u8]) -> u64 {
        let now_ns = self.now_ns();
        let line = &mut *self.line.borrow_mut();
        if line.connected {
            line.to_module.send_bounded(now_ns, line.byte_ns, bytes);
        }
        line.to_module.free_at_ns
    }

    /// Client side: takes every byte that has arrived by now.
    pub fn read(&self, into: &mut Vec<u8>) -> usize {
        let now_ns = self.now_ns();
        let line = &mut *self.line.borrow_mut();
        let before = into.len();
        while let Some(byte) = line.to_host.take(now_ns) {
            into.push(byte);
        }
        into.len() - before
    }

    /// Bytes of clients lost so far because the module's ring was full.
    #[must_use]
    pub fn lost_bytes(&self) -> u64 {
        self.line.borrow().to_module.lost
    }

    /// Client side: whether bytes wait to be read by now.
    #[must_use]
    pub fn readable(&self) -> bool {
        let now_ns = self.now_ns();
        self.line
            .borrow()
            .to_host
            .bytes
            .front()
            .is_some_and(|(at, _)| *at <= now_ns)
    }

    /// Cuts the link: bytes on their way are lost, later ones vanish.
    pub fn cut(&self) {
        let line = &mut *self.line.borrow_mut();
        line.connected = false;
        line.to_module.clear();
        line.to_module.broken = Some(PortError::Closed);
        line.to_host.clear();
    }

    /// The link is back.
    pub fn reconnect(&self) {
        self.line.borrow_mut().connected = true;
    }

    /// Whether the link is up.
    #[must_use]
    pub fn is_connected(&self) -> bool {
        self.line.borrow().connected
    }

    /// The module's receiver reports an error before the next byte.
    pub fn disturb(&self, error: PortError) {
        self.line.borrow_mut().to_module.broken = Some(error);
    }

    /// The module restarted: what its transmitter held is lost.
    pub(super) fn module_reset(&self) {
        let line = &mut *self.line.borrow_mut();
        line.to_module.broken = None;
        let now_ns = self.clock.now_us() * 1000;
        line.to_host.bytes.retain(|(at, _)| *at <= now_ns);
        line.to_host.free_at_ns = now_ns;
    }
}

impl LinkRx for LinkLine {
    async fn read(&mut self, into: &mut [u8]) -> Result<usize, PortError> {
        poll_fn(|_| {
            let now_ns = self.now_ns();
            let line = &mut *self.line.borrow_mut();
            if let Some(error) = line.to_module.broken.take() {
                return Poll::Ready(Err(error));
            }
            let mut count = 0;
            for place in into.iter_mut() {
                let Some(byte) = line.to_module.take(now_ns) else {
                    break;
                };
                *place = byte;
                count += 1;
            }
            if count > 0 {
                return Poll::Ready(Ok(count));
            }
            if let Some((at, _)) = line.to_module.bytes.front() {
                self.clock.poll_again_at(at.div_ceil(1000));
            }
            Poll::Pending
        })
        .await
    }
}

impl LinkTx for LinkLine {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, PortError> {
        poll_fn(|_| {
            let now_ns = self.now_ns();
            let line = &mut *self.line.borrow_mut();
            if !line.connected {
                // A radio without a peer drops what is sent, at the speed of the line to its module.
                return Poll::Ready(Ok(bytes.len()));
            }
            let ahead = (line.to_host.free_at_ns.saturating_sub(now_ns))
                .checked_div(line.byte_ns)
                .unwrap_or(0) as usize;
            let room = TX_AHEAD_BYTES.saturating_sub(ahead).min(bytes.len());
            if room == 0 {
                self.clock
                    .poll_again_at((now_ns + line.byte_ns * 8).div_ceil(1000));
                return Poll::Pending;
            }
            line.to_host.send(now_ns, line.byte_ns, &bytes[..room]);
            Poll::Ready(Ok(room))
        })
        .await
    }
}
