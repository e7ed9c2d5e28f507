//! Drives the emulated motors with rustypot, unmodified. Usage: foreign-rustypot DEVICE

use std::error::Error;
use std::time::Duration;

use rustypot::DynamixelProtocolHandler;
use serialport::SerialPort;

const IDS: [u8; 6] = [1, 2, 3, 4, 5, 6];
const TORQUE: u8 = 64;
const GOAL: u8 = 116;
const POSITION: u8 = 132;
const P_GAIN: u8 = 84;
const ACCESS_ERROR: u8 = 7;

type Result<T> = std::result::Result<T, Box<dyn Error>>;

fn check(condition: bool, what: &str) -> Result<()> {
    println!("{} {what}", if condition { "ok" } else { "FAILED" });
    if condition { Ok(()) } else { Err(what.into()) }
}

fn counts(bytes: &[u8]) -> Result<i32> {
    Ok(i32::from_le_bytes(bytes.try_into()?))
}

fn single(io: &DynamixelProtocolHandler, port: &mut dyn SerialPort) -> Result<()> {
    for id in IDS {
        check(io.ping(port, id)?, &format!("ping {id}"))?;
    }
    let mut found = io.broadcast_ping(port)?;
    found.sort_unstable();
    check(found == IDS, &format!("broadcast ping finds {found:?}"))?;
    io.write(port, 1, P_GAIN, &640_u16.to_le_bytes())?;
    check(io.read(port, 1, P_GAIN, 2)? == 640_u16.to_le_bytes(), "gain written and read back")?;
    let refused = io.write_with_error(port, 1, POSITION, &[0; 4])?;
    check(refused.v2_instruction_error() == ACCESS_ERROR, "read-only register: access error")?;
    // Bytes FF FF FD FF, stuffed on the wire in both directions.
    let stuffed = 0xFFFD_FFFF_u32.to_le_bytes();
    io.write(port, 2, GOAL, &stuffed)?;
    check(io.read(port, 2, GOAL, 4)? == stuffed, "a goal that holds FF FF FD survives")
}

fn cycles(io: &DynamixelProtocolHandler, port: &mut dyn SerialPort) -> Result<()> {
    let on = vec![vec![1]; IDS.len()];
    io.sync_write(port, &IDS, TORQUE, &on)?;
    let mut target = 0_i32;
    for cycle in 0..200 {
        target = (target + 5).min(500);
        let goals: Vec<_> = IDS
            .iter()
            .map(|id| if id % 2 == 1 { target } else { -target }.to_le_bytes().to_vec())
            .collect();
        io.sync_write(port, &IDS, GOAL, &goals)?;
        let read = if cycle % 2 == 0 {
            io.sync_read(port, &IDS, POSITION, 4)?
        } else {
            io.fast_sync_read(port, &IDS, POSITION, 4)?
        };
        if read.len() != IDS.len() {
            check(false, &format!("cycle {cycle}: {} answers", read.len()))?;
        }
    }
    check(true, "200 cycles of sync write and (fast) sync read")?;
    for _ in 0..400 {
        let read = io.sync_read(port, &IDS, POSITION, 4)?;
        let mut reached = true;
        for (id, bytes) in IDS.iter().zip(&read) {
            let goal = if id % 2 == 1 { 500 } else { -500 };
            reached &= (counts(bytes)? - goal).abs() <= 2;
        }
        if reached {
            return check(true, "positions reached");
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    check(false, "positions reached")
}

fn reboot(io: &DynamixelProtocolHandler, port: &mut dyn SerialPort) -> Result<()> {
    check(io.reboot(port, 3)?, "reboot")?;
    std::thread::sleep(Duration::from_millis(100));
    check(io.read(port, 3, TORQUE, 1)? == [0], "torque is off after it")
}

fn main() -> Result<()> {
    let device = std::env::args().nth(1).ok_or("usage: foreign-rustypot DEVICE")?;
    let mut port = serialport::new(device, 1_000_000).timeout(Duration::from_secs(2)).open()?;
    let io = DynamixelProtocolHandler::v2();
    single(&io, port.as_mut())?;
    cycles(&io, port.as_mut())?;
    reboot(&io, port.as_mut())?;
    println!("ALL CHECKS PASSED");
    Ok(())
}
