//! Two ways to the motor bus: through the robot's controller, or directly over a USB-RS485 stick.

use std::path::Path;
use std::time::{Duration, Instant};

use protocol::bus::StatusError;
use protocol::bus::master::{Exchange, Request};
use protocol::link::{FromModule, Tag, ToModule};

use crate::link::{Link, LinkError, Robot, serial::SerialLink};

/// Baud rate of the motor bus [paper].
const BUS_BAUD: u32 = 1_000_000;
/// Byte time at that rate with start and stop bit.
const BYTE_NS: u64 = 10_000;
/// A USB serial adapter delivers what it received in packets up to this late (the usual latency timer).
const ADAPTER_LATENCY: Duration = Duration::from_millis(20);
/// Extra listening of the robot's controller, ms.
const CONTROLLER_SLACK_MS: u64 = 3;

/// An answer of a driver.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DriverAnswer {
    /// Bus id.
    pub id: u8,
    /// Error of the instruction.
    pub error: Option<StatusError>,
    /// The driver has a hardware error latched.
    pub alert: bool,
    /// Data.
    pub data: Vec<u8>,
}

/// A way to the motor bus.
#[derive(Debug)]
pub enum BusWay {
    /// Through the robot's controller; not while a gait runs.
    Robot(Box<Robot>),
    /// Over a serial port of this computer.
    Direct(SerialLink),
}

impl BusWay {
    /// Opens a serial port as the bus.
    ///
    /// # Errors
    /// [`LinkError::Open`]
    pub fn direct(path: &Path) -> Result<Self, LinkError> {
        SerialLink::open(path, BUS_BAUD).map(Self::Direct)
    }

    /// Sends one request and collects the answers.
    ///
    /// # Errors
    /// [`LinkError`]; a driver that does not answer is no error.
    pub fn exchange(&mut self, request: Request) -> Result<Vec<DriverAnswer>, LinkError> {
        let patience_ns = request.patience_ns(BYTE_NS);
        let mut exchange = Exchange::new(request);
        match self {
            Self::Robot(robot) => through_robot(robot, &mut exchange, patience_ns),
            Self::Direct(port) => over_port(port, &mut exchange, Duration::from_nanos(patience_ns)),
        }
    }
}

fn through_robot(
    robot: &mut Robot,
    exchange: &mut Exchange,
    patience_ns: u64,
) -> Result<Vec<DriverAnswer>, LinkError> {
    let request = "bus order";
    let bytes = heapless::Vec::from_slice(exchange.request().bytes())
        .map_err(|_| LinkError::TooLarge { request })?;
    let listen_ms = (patience_ns.div_ceil(1_000_000) + CONTROLLER_SLACK_MS).min(1000) as u16;
    let answer = robot.ask(&ToModule::BusRaw {
        bytes,
        listen_ms,
        tag: Tag::NONE,
    })?;
    let FromModule::BusReply { bytes, .. } = answer else {
        return Err(LinkError::WrongAnswer { request });
    };
    let mut answers = Vec::new();
    for byte in bytes {
        exchange.push(byte);
        collect(exchange, &mut answers);
    }
    exchange.finish();
    collect(exchange, &mut answers);
    Ok(answers)
}

fn over_port(
    port: &mut SerialLink,
    exchange: &mut Exchange,
    patience: Duration,
) -> Result<Vec<DriverAnswer>, LinkError> {
    port.send(exchange.request().bytes())?;
    let until = Instant::now() + patience + ADAPTER_LATENCY;
    let mut answers = Vec::new();
    while !exchange.is_complete() || exchange.request().is_answered() && answers.is_empty() {
        let left = until.saturating_duration_since(Instant::now());
        if left.is_zero() {
            break;
        }
        let mut bytes = Vec::new();
        port.receive(left, &mut bytes)?;
        for byte in bytes {
            exchange.push(byte);
            collect(exchange, &mut answers);
        }
    }
    exchange.finish();
    collect(exchange, &mut answers);
    Ok(answers)
}

fn collect(exchange: &mut Exchange, answers: &mut Vec<DriverAnswer>) {
    while let Some(answer) = exchange.next_answer() {
        answers.push(DriverAnswer {
            id: answer.id,
            error: answer.error,
            alert: answer.alert,
            data: answer.data.to_vec(),
        });
    }
}
