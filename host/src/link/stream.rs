//! One reader thread per open port: a read that hangs in the driver never hangs a command.

use std::io::{self, Read};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

/// Chunks waiting between thread and command; 100 Hz telemetry fills about 100 chunks a second.
const QUEUE: usize = 1024;

/// Bytes from a port, read by a thread.
#[derive(Debug)]
pub(super) struct ByteStream {
    chunks: Receiver<io::Result<Vec<u8>>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    ended: bool,
}

impl ByteStream {
    /// Starts to read. `port` must return within about 100 ms (`TimedOut` or `WouldBlock`) when nothing comes.
    pub(super) fn start(mut port: impl Read + Send + 'static) -> Self {
        let (sender, chunks) = sync_channel(QUEUE);
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let thread = std::thread::spawn(move || pump(&mut port, &sender, &stopped));
        Self {
            chunks,
            stop,
            thread: Some(thread),
            ended: false,
        }
    }

    /// Appends what has arrived, waiting up to `wait` for the first chunk.
    pub(super) fn receive(&mut self, wait: Duration, into: &mut Vec<u8>) -> io::Result<()> {
        if self.ended {
            return Err(gone());
        }
        match self.chunks.recv_timeout(wait) {
            Ok(chunk) => self.take(chunk, into)?,
            Err(RecvTimeoutError::Timeout) => return Ok(()),
            Err(RecvTimeoutError::Disconnected) => {
                self.ended = true;
                return Err(gone());
            }
        }
        while let Ok(chunk) = self.chunks.try_recv() {
            // What came before the end of the stream is used first; the end is told by the next call.
            if self.take(chunk, into).is_err() {
                break;
            }
        }
        Ok(())
    }

    fn take(&mut self, chunk: io::Result<Vec<u8>>, into: &mut Vec<u8>) -> io::Result<()> {
        match chunk {
            Ok(bytes) => {
                into.extend(bytes);
                Ok(())
            }
            Err(error) => {
                self.ended = true;
                Err(error)
            }
        }
    }

    /// Ends the thread and waits for it, so that its port is closed.
    pub(super) fn stop(&mut self) {
        self.stop.store(true, Ordering::SeqCst);
        // Room for a thread that waits on a full queue.
        while self.chunks.try_recv().is_ok() {}
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

impl Drop for ByteStream {
    fn drop(&mut self) {
        self.stop();
    }
}

fn gone() -> io::Error {
    io::Error::new(
        io::ErrorKind::ConnectionAborted,
        "the other side has closed it",
    )
}

fn pump(port: &mut impl Read, sender: &SyncSender<io::Result<Vec<u8>>>, stop: &AtomicBool) {
    let mut buffer = [0; 1024];
    while !stop.load(Ordering::SeqCst) {
        let chunk = match port.read(&mut buffer) {
            Ok(0) => Err(gone()),
            Ok(n) => Ok(buffer[..n].to_vec()),
            Err(e) if is_pause(&e) => continue,
            Err(e) => Err(e),
        };
        let last = chunk.is_err();
        // A full queue means nobody listens any more; bytes are dropped and the framing finds the next frame.
        let _ = sender.try_send(chunk);
        if last {
            return;
        }
    }
}

fn is_pause(error: &io::Error) -> bool {
    use io::ErrorKind::{Interrupted, TimedOut, WouldBlock};
    matches!(error.kind(), TimedOut | WouldBlock | Interrupted)
}
