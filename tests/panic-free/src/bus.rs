//! The motor bus from both ends: a driver that hears anything, and a master that gets anything back.

use crate::{Hostile, sink};
use protocol::bus::packet::StatusError;
use protocol::bus::{
    DriverHandler, DriverServer, Exchange, PackedFeedback, Profile, Register, Request,
};

struct Driver<'a>(&'a mut Hostile);

impl DriverHandler for Driver<'_> {
    fn latch(&mut self, now_ns: u64) {
        sink(now_ns);
    }
    fn read(&self, register: Register) -> i32 {
        sink(register);
        Hostile.word() as i32
    }
    fn feedback(&mut self) -> PackedFeedback {
        PackedFeedback::default()
    }
    fn write(&mut self, register: Register, value: i32) -> Result<(), StatusError> {
        sink((register, value));
        StatusError::from_byte(self.0.byte()).map_or(Ok(()), Err)
    }
    fn reboot(&mut self) {}
}

pub(crate) fn drive(h: &mut Hostile) {
    let mut server = DriverServer::new(h.time());
    for _ in 0..h.word() {
        let (byte, now_ns) = (h.byte(), h.time());
        sink(server.push(byte, now_ns, &mut Driver(h)));
        sink(server.poll(h.time()));
        sink((server.deadline_ns(), *server.counters()));
    }
    let ids = h.bytes::<6>();
    let requests = [
        Request::ping(h.byte()),
        Request::read(h.byte(), h.word() as u16, h.word() as u16),
        Request::write(h.byte(), Register::GoalPosition, h.word() as i32),
        Request::set_points(&ids.map(|id| (id, i32::from(id)))),
        Request::sync_read(h.word() as u16, h.word() as u16, &ids),
        Request::fast_sync_read(h.word() as u16, h.word() as u16, &ids),
        Request::feedback(&ids),
        Request::fast_feedback(&ids),
        Request::reboot(h.byte()),
    ];
    for request in requests.into_iter().flatten() {
        exchange(h, request);
    }
    profiles(h, &ids);
}

/// Off-the-shelf servos, whichever the settings name.
fn profiles(h: &mut Hostile, ids: &[u8; 6]) {
    let Some(profile) = Profile::from_number(h.byte()) else {
        return;
    };
    let info = profile.info();
    sink(Profile::of_model(info.framing, h.word() as u16));
    let goals = ids.map(|id| (id, h.word() as i32));
    let requests = [
        info.ping(h.byte()),
        info.read(h.byte(), h.word() as u16, h.word() as u16),
        info.write(h.byte(), h.word() as u16, &h.bytes::<40>()),
        info.read_field(h.byte(), &info.model),
        info.read_feedback(ids),
        info.set_points(&goals),
        info.sync_write(&info.torque, &goals),
    ];
    for request in requests.into_iter().flatten() {
        exchange(h, request);
    }
    sink(info.decode(&h.bytes::<20>(), h.time()));
    sink(info.decode(&h.bytes::<31>(), h.time()));
    sink((
        info.goal_counts(h.word() as i32),
        info.angle_urad(h.word() as i32),
    ));
}

fn exchange(h: &mut Hostile, request: Request) {
    sink((request.answer_bytes(), request.patience_ns(h.time())));
    let mut exchange = Exchange::new(request);
    for _ in 0..h.word() {
        exchange.push(h.byte());
        if h.byte() == 0 {
            exchange.finish();
        }
        while let Some(answer) = exchange.next_answer() {
            sink((
                answer.feedback(),
                answer.value(Register::PresentPosition),
                answer.id,
            ));
        }
        sink((exchange.is_complete(), exchange.missing().count()));
    }
}
