//! The emulated robot for clients outside this process: its host link on a pseudo-terminal, TCP or a serial port, its
//! virtual time tied to the wall clock.

use super::EmulatedRobot;
use super::wire::MotorBus;
use crate::endpoint::{Endpoint, EndpointError};
use protocol::link::{
    Decoder, FromModule, Header, MAX_FRAME, Message, Reject, SOURCE_HOST, ToModule, encode,
};
use std::ops::ControlFlow;
use std::time::{Duration, Instant};

/// Longest wait for a byte: the robot's cycle is 50 ms, so 2 ms steps leave its timing alone.
const PATIENCE: Duration = Duration::from_millis(2);
/// Longest stretch caught up with, us: after a suspended laptop, time goes on from there. As for a board in QEMU: half of the lease of `rb-host`.
const LONGEST_JUMP_US: u64 = 500_000;
/// Between two status reports.
const STATUS_EVERY: Duration = Duration::from_millis(100);

/// What happens while serving.
#[derive(Clone, Debug, PartialEq)]
pub enum RobotEvent {
    /// Clients can connect.
    Ready {
        /// What to connect to.
        address: String,
    },
    /// About ten times a second.
    Status {
        /// Virtual time, s.
        virtual_s: f64,
        /// Real time left out because the machine was too slow or asleep, in all, s.
        behind_s: f64,
        /// Resets of the processor so far.
        resets: u32,
        /// Bytes of clients lost so far because they came faster than the robot's line carries them.
        lost_bytes: u64,
        /// Clients so far, where the endpoint can tell.
        clients: u64,
    },
}

/// Serves the robot's cable on `endpoint` until `on_event` breaks. Give the robot a link without byte times
/// (`Setup::link_byte_ns` 0) when the endpoint has its own.
///
/// # Errors
/// The endpoint is gone for good.
pub fn serve<M: MotorBus + 'static>(
    robot: &mut EmulatedRobot<M>,
    endpoint: &mut dyn Endpoint,
    on_event: &mut dyn FnMut(&RobotEvent) -> ControlFlow<()>,
) -> Result<(), EndpointError> {
    if on_event(&RobotEvent::Ready {
        address: endpoint.address(),
    })
    .is_break()
    {
        return Ok(());
    }
    let (start, mut offset_us) = (Instant::now(), robot.now_us());
    let (mut last_status, mut behind_us) = (start, 0);
    let mut input = [0; 1024];
    let mut client = (endpoint.connected(), endpoint.clients());
    let mut others = Decoder::new();
    loop {
        let count = endpoint.read(&mut input, PATIENCE)?;
        endpoint.others(&mut |bytes| answer_other(robot, &mut others, bytes))?;
        client = follow_client(robot, endpoint, client);
        let mut now_us = offset_us + start.elapsed().as_micros() as u64;
        let late_us = now_us
            .saturating_sub(robot.now_us())
            .saturating_sub(LONGEST_JUMP_US);
        offset_us -= late_us.min(offset_us);
        behind_us += late_us;
        now_us = now_us.saturating_sub(late_us);
        if let Some(bytes) = input.get(..count).filter(|bytes| !bytes.is_empty()) {
            robot.link().write(bytes);
        }
        robot.run_until(now_us);
        let mut output = Vec::new();
        if robot.link().read(&mut output) > 0 {
            endpoint.write(&output)?;
        }
        if last_status.elapsed() >= STATUS_EVERY {
            last_status = Instant::now();
            let status = RobotEvent::Status {
                virtual_s: robot.now_us() as f64 * 1e-6,
                behind_s: behind_us as f64 * 1e-6,
                resets: robot.resets(),
                lost_bytes: robot.link().lost_bytes(),
                clients: endpoint.clients(),
            };
            if on_event(&status).is_break() {
                return Ok(());
            }
        }
    }
}

/// What a second client on the line of the first hears: that the robot is held. STOP goes through.
fn answer_other<M: MotorBus + 'static>(
    robot: &EmulatedRobot<M>,
    decoder: &mut Decoder,
    bytes: &[u8],
) -> Vec<u8> {
    let mut answers = Vec::new();
    for byte in bytes {
        let Some(frame) = decoder.push(*byte) else {
            continue;
        };
        let (header, request) = (frame.header, frame.kind());
        if header.source != SOURCE_HOST {
            continue;
        }
        let mut out = [0; MAX_FRAME];
        let answer = if request == ToModule::Stop.kind() {
            if let Ok(length) = encode(&header, &ToModule::Stop, &mut out) {
                robot.link().write(&out[..length]);
            }
            FromModule::Ack { request }
        } else {
            // The emulated robot's cable is its link 0.
            let reason = Reject::Held { link: 0 };
            FromModule::Nack { request, reason }
        };
        // Of no boot and no robot: whoever hears it has no session.
        let header = Header {
            source: u8::MAX,
            ..header
        };
        if let Ok(length) = encode(&header, &answer, &mut out) {
            answers.extend_from_slice(&out[..length]);
        }
    }
    answers
}

/// A client that left takes what is under way with it, and the robot is told that the link is gone: the next client finds a free line.
fn follow_client<M: MotorBus + 'static>(
    robot: &EmulatedRobot<M>,
    endpoint: &dyn Endpoint,
    before: (bool, u64),
) -> (bool, u64) {
    let now = (endpoint.connected(), endpoint.clients());
    if now != before {
        if before.0 {
            robot.link().cut();
        }
        if now.0 {
            robot.link().reconnect();
        }
    }
    now
}
