//! Both wires: bytes as they are, and messages with right checksums.

use std::collections::VecDeque;

use hil_sim::robot::ideal::IdealMotors;
use hil_sim::robot::wire::{MotorBus, Received};
use protocol::bus::packet::Builder;
use protocol::bus::{Exchange, Instruction, Request};
use protocol::link::{
    Client, Decoder, FromModule, Header, MAX_FRAME, Message, SOURCE_HOST, ToModule, VERSION, encode,
};

use crate::Bytes;

/// Instructions of the bus, with one that does not exist left to the raw bytes.
const INSTRUCTIONS: [Instruction; 8] = [
    Instruction::Ping,
    Instruction::Read,
    Instruction::Write,
    Instruction::Reboot,
    Instruction::SyncRead,
    Instruction::SyncWrite,
    Instruction::FastSyncRead,
    Instruction::Status,
];

/// Six drivers hear packets and noise; a master hears what they say, and the packets too.
pub(crate) fn bus(data: &[u8]) {
    let mut input = Bytes::new(data);
    let mut motors = IdealMotors::new(input.byte() & 1 == 1);
    let request = match input.byte() % 4 {
        0 => Request::ping(input.byte()),
        1 => Request::read(
            input.byte(),
            u16::from(input.byte()),
            u16::from(input.byte()),
        ),
        2 => Request::feedback(input.block()),
        _ => Request::fast_feedback(input.block()),
    };
    let mut master = request.ok().map(Exchange::new);
    let (mut now_ns, mut heard) = (0_u64, VecDeque::new());
    while !input.is_empty() {
        let (kind, id) = (input.byte(), input.byte());
        let bytes = match kind % 16 {
            15 => input.block().to_vec(),
            kind => {
                let instruction = INSTRUCTIONS[usize::from(kind) % INSTRUCTIONS.len()];
                let packet = Builder::new(id, instruction).params(input.block());
                packet.finish().map_or_else(|_| Vec::new(), |p| p.to_vec())
            }
        };
        if let Some(master) = &mut master {
            hear(master, bytes.iter().copied());
        }
        let end_ns = motors.transmit(now_ns, &bytes);
        now_ns = end_ns + 200_000 * u64::from(kind >> 4);
        motors.receive(now_ns, &mut heard);
        if let Some(master) = &mut master {
            let whole = heard.drain(..).filter_map(|received| match received {
                Received::Byte(byte) => Some(byte),
                Received::Spoiled => None,
            });
            hear(master, whole);
        }
        heard.clear();
    }
    if let Some(master) = &mut master {
        master.finish();
        hear(master, std::iter::empty());
        assert!(master.missing().count() <= master.request().ids().len());
    }
}

fn hear(master: &mut Exchange, bytes: impl Iterator<Item = u8>) {
    for byte in bytes {
        master.push(byte);
        while let Some(answer) = master.next_answer() {
            let _ = answer.feedback();
        }
    }
    while master.next_answer().is_some() {}
}

/// Frames of both directions. What is decoded is encoded to a frame that is decoded to the same.
pub(crate) fn link(data: &[u8]) {
    let mut input = Bytes::new(data);
    let (mut decoder, mut client) = (Decoder::new(), Client::new(7));
    while !input.is_empty() {
        let kind = input.byte();
        let bytes = match kind % 8 {
            7 => input.block().to_vec(),
            6 => cobs_frame(input.block()),
            kind => {
                let source = if kind < 3 { SOURCE_HOST } else { 1 };
                framed(source, 1, 0, input.byte(), input.block())
            }
        };
        for &byte in &bytes {
            if let Some(frame) = decoder.push(byte) {
                same_again(frame.decode::<ToModule>().ok());
                same_again(frame.decode::<FromModule>().ok());
            }
            if let Some(Ok(received)) = client.push(byte) {
                samples(&received.message);
            }
        }
    }
}

/// A frame around a type byte and a payload.
pub(crate) fn framed(source: u8, sequence: u16, boot_id: u32, kind: u8, payload: &[u8]) -> Vec<u8> {
    let mut body = vec![VERSION, source];
    body.extend_from_slice(&sequence.to_le_bytes());
    body.extend_from_slice(&boot_id.to_le_bytes());
    body.push(kind);
    body.extend_from_slice(payload);
    cobs_frame(&body)
}

/// Right checksum and delimiters around a body.
fn cobs_frame(body: &[u8]) -> Vec<u8> {
    let sum = crc::Crc::<u32>::new(&crc::CRC_32_ISCSI).checksum(body);
    let mut whole = body.to_vec();
    whole.extend_from_slice(&sum.to_le_bytes());
    let mut frame = vec![0];
    frame.extend(stuffed(&whole));
    frame.push(0);
    frame
}

/// Consistent overhead byte stuffing, written from its definition.
fn stuffed(body: &[u8]) -> Vec<u8> {
    let mut out = vec![1];
    let mut code_at = 0;
    for &byte in body {
        if byte == 0 {
            code_at = out.len();
            out.push(1);
            continue;
        }
        out.push(byte);
        out[code_at] += 1;
        if out[code_at] == 0xFF {
            code_at = out.len();
            out.push(1);
        }
    }
    out
}

fn same_again<M: Message + PartialEq + core::fmt::Debug>(message: Option<M>) {
    let Some(message) = message else {
        return;
    };
    let header = Header {
        version: VERSION,
        source: SOURCE_HOST,
        sequence: 1,
        boot_id: 0,
    };
    let mut out = [0; MAX_FRAME];
    let len = encode(&header, &message, &mut out).expect("MAX_FRAME suffices");
    let (mut decoder, mut again) = (Decoder::new(), None);
    for &byte in &out[..len] {
        if let Some(frame) = decoder.push(byte) {
            again = Some(frame.decode::<M>().expect("our own frame"));
        }
    }
    // Not a number is not equal to itself; its bytes are.
    let bytes = |m: &M| postcard::to_slice(m, &mut [0; MAX_FRAME]).map(|b| b.to_vec());
    let again = again.expect("a frame");
    assert_eq!(bytes(&again), bytes(&message), "{message:?}");
}

fn samples(message: &FromModule) {
    if let FromModule::SampleBlock(block) | FromModule::SampleBlockOf(block) = message {
        let count = block.samples().take(100_000).count();
        assert!(count <= usize::from(block.count) + 1);
    }
}
