//! The emulated servos of every control table on one bus, and the master that reads them.

use hil_sim::motor::JointKind;
use hil_sim::world::{World, WorldParams};
use protocol::bus::packet::{Builder, TooLong};
use protocol::bus::{Exchange, Instruction, Profile, Request, feetech};

use crate::Bytes;

/// Instructions of Dynamixel 2; one that does not exist is left to the raw bytes.
const INSTRUCTIONS: [Instruction; 15] = [
    Instruction::Ping,
    Instruction::Read,
    Instruction::Write,
    Instruction::RegWrite,
    Instruction::Action,
    Instruction::FactoryReset,
    Instruction::Reboot,
    Instruction::Clear,
    Instruction::Status,
    Instruction::SyncRead,
    Instruction::SyncWrite,
    Instruction::FastSyncRead,
    Instruction::BulkRead,
    Instruction::BulkWrite,
    Instruction::FastBulkRead,
];
/// Bits a second that drivers can be set to.
const BAUDS: [u32; 4] = [57_600, 115_200, 1_000_000, 4_000_000];
/// Pause after a packet, ns, one to sixteen times: shorter and longer than drivers wait for the one before them (`server::SKIP_NS`).
const STEP_NS: u64 = 200_000;

/// Two drivers, each of any profile, hear packets of both framings, noise and the master's own orders; the master hears all that
/// they say.
pub(crate) fn servos(data: &[u8]) {
    let mut input = Bytes::new(data);
    let profiles = [input.byte(), input.byte()]
        .map(|byte| Profile::ALL[usize::from(byte) % Profile::ALL.len()]);
    let joints = [JointKind::Intra, JointKind::Inter].map(JointKind::neutral);
    let mut params = WorldParams::of(1, &joints);
    for (joint, profile) in params.joints.iter_mut().zip(profiles) {
        joint.driver.profile = profile;
    }
    let mut world = World::on_stand(&params).expect("a neutral world");
    while !input.is_empty() {
        let (kind, id) = (input.byte(), input.byte());
        let profile = profiles[usize::from(kind >> 7)];
        let mut master: Option<(Profile, Exchange)> = None;
        let bytes = match kind % 8 {
            0..=2 => dynamixel(id, &mut input),
            3 | 4 => whole(feetech::packet(id, input.byte(), &[input.block()])),
            5 => input.block().to_vec(),
            6 => {
                world.set_baud(BAUDS[usize::from(id) % BAUDS.len()]);
                continue;
            }
            _ => {
                let request = order(profile, id, &mut input);
                let bytes = request.as_ref().map(|r| r.bytes().to_vec());
                master = request.map(|request| (profile, Exchange::new(request)));
                bytes.unwrap_or_default()
            }
        };
        let end_ns = world.write_bytes(world.now_ns(), &bytes);
        world.advance_to(end_ns + STEP_NS * u64::from(1 + (kind >> 3) % 16));
        hear(&mut world, master.as_mut());
    }
    for index in 0..world.joints() {
        let angle_rad = world.joint(index).map(|joint| joint.link_rad);
        assert!(angle_rad.is_some_and(f64::is_finite), "{angle_rad:?}");
    }
}

fn whole(packet: Result<impl core::ops::Deref<Target = [u8]>, TooLong>) -> Vec<u8> {
    packet.map_or_else(|_| Vec::new(), |packet| packet.to_vec())
}

fn dynamixel(id: u8, input: &mut Bytes<'_>) -> Vec<u8> {
    let instruction = INSTRUCTIONS[usize::from(input.byte()) % INSTRUCTIONS.len()];
    whole(Builder::new(id, instruction).params(input.block()).finish())
}

/// What the firmware may ask of a driver of `profile`.
fn order(profile: Profile, id: u8, input: &mut Bytes<'_>) -> Option<Request> {
    let info = profile.info();
    let request = match input.byte() % 5 {
        0 => info.ping(id),
        1 => info.read(id, u16::from(input.byte()), u16::from(input.byte())),
        2 => info.write(id, u16::from(input.byte()), input.block()),
        3 => info.read_feedback(input.block()),
        _ => {
            let goal_urad = i32::from(input.byte()) * 10_000;
            info.set_points(&[(id, goal_urad), (1, -goal_urad)])
        }
    };
    request.ok()
}

fn hear(world: &mut World, master: Option<&mut (Profile, Exchange)>) {
    let Some((profile, master)) = master else {
        while world.next_byte().is_some() {}
        return;
    };
    while let Some(arrival) = world.next_byte() {
        master.push(arrival.byte);
        while let Some(answer) = master.next_answer() {
            let _ = profile.info().decode(answer.data, world.now_ns() / 1000);
        }
    }
    master.finish();
    while master.next_answer().is_some() {}
    assert!(master.missing().count() <= master.request().ids().len());
}
