//! The host link from both ends: the module's server with a handler that uses the law, and the host's client.

use crate::{Hostile, law, sink};
use control::gait::Gait;
use control::robot::RobotModel;
use heapless::Vec;
use protocol::link::event::Event;
use protocol::link::frame::MAX_FRAME;
use protocol::link::gait::MAX_GAIT;
use protocol::link::message::MAX_EVENTS;
use protocol::link::reject::Reject;
use protocol::link::server::{
    BusAnswer, Completed, ModuleHandler, Outcome, Port, Server, StartOrder, StoredGait,
};
use protocol::link::status::{
    Counters, CrashRecord, Hello, Info, ModuleState, ResetCause, SlotInfo,
};
use protocol::link::telemetry::{Sample, SampleBlock, SampleLog};
use protocol::link::{
    BusStatus, Client, Digest, FromModule, Key, MAX_SLOTS, Nonce, TelemetryRate, ToModule,
    WireContact, WireGait, WireRobot,
};

/// A module that answers with whatever comes out of the port.
struct Module<'a> {
    h: &'a mut Hostile,
    stored: Option<WireGait>,
    log: SampleLog<2>,
}

impl Module<'_> {
    fn outcome(&mut self) -> Result<Outcome, Reject> {
        match self.h.byte() {
            0 => Ok(Outcome::Done(())),
            1 => Ok(Outcome::Pending),
            _ => Err(Reject::Busy),
        }
    }
}

impl ModuleHandler for Module<'_> {
    fn hello(&mut self) -> Hello {
        let firmware = heapless::String::new();
        let model_digest = Digest(self.h.bytes());
        Hello {
            protocol: self.h.byte(),
            robot_id: self.h.byte(),
            boot_id: self.h.word(),
            firmware,
            model_digest,
            keyed: true,
        }
    }
    fn info(&mut self) -> Info {
        Info {
            state: ModuleState::Idle,
            fault: None,
            reset_cause: ResetCause::PowerOn,
            slots: self.h.byte(),
            active_slot: Some(self.h.byte()),
            battery_mv: self.h.word() as u16,
            homed_mask: self.h.word() as u16,
            motor_mask: self.h.word() as u16,
            uptime_us: self.h.time(),
            cycles: self.h.word(),
            counters: Counters::default(),
        }
    }
    fn fresh_nonce(&mut self) -> Result<Nonce, Reject> {
        Ok(Nonce(self.h.bytes()))
    }
    fn key(&self) -> Option<Key> {
        Some(Key(Hostile.bytes()))
    }
    fn bad_tag(&mut self, request: u8) {
        sink(request);
    }
    fn stop(&mut self) {}
    fn put_gait(
        &mut self,
        slot: u8,
        activate: bool,
        gait: &WireGait,
    ) -> Result<Outcome<StoredGait>, Reject> {
        let valid = Gait::try_from(gait);
        sink(valid.as_ref().map(WireGait::from).ok());
        if valid.is_err() {
            return Err(Reject::Busy);
        }
        self.stored = Some(gait.clone());
        Ok(Outcome::Done(StoredGait {
            slot,
            digest: gait.digest(),
            active: activate,
        }))
    }
    fn get_gait(&mut self, _slot: u8) -> Result<(Digest, WireGait), Reject> {
        let gait = self.stored.clone().ok_or(Reject::Busy)?;
        Ok((gait.digest(), gait))
    }
    fn slots(&mut self) -> (Option<u8>, Vec<Option<SlotInfo>, MAX_SLOTS>) {
        (Some(self.h.byte()), Vec::new())
    }
    fn activate_slot(&mut self, _slot: u8) -> Result<Outcome, Reject> {
        self.outcome()
    }
    fn erase_slot(&mut self, _slot: u8) -> Result<Outcome, Reject> {
        self.outcome()
    }
    fn start(&mut self, _order: &StartOrder) -> Result<Outcome, Reject> {
        self.outcome()
    }
    fn heartbeat(&mut self) -> Result<Outcome, Reject> {
        self.outcome()
    }
    fn change_gait(&mut self, _slot: u8, _digest: Digest) -> Result<Outcome, Reject> {
        self.outcome()
    }
    fn clear_fault(&mut self) -> Result<Outcome, Reject> {
        self.outcome()
    }
    fn zero(&mut self, _joint_mask: u16) -> Result<Outcome, Reject> {
        self.outcome()
    }
    fn subscribe(&mut self, _rate: TelemetryRate) -> Result<(), Reject> {
        Ok(())
    }
    fn events(&mut self, since: u32, _into: &mut Vec<Event, MAX_EVENTS>) -> (u32, u32) {
        (since, 0)
    }
    fn drain(&mut self, from: u32) -> Result<SampleBlock, Reject> {
        let to_recorder = self.h.byte() > 7;
        Ok(self.log.drain(from, to_recorder))
    }
    fn bus_raw(&mut self, bytes: &[u8], _listen_ms: u16) -> Result<Outcome<BusAnswer>, Reject> {
        let mut heard = Vec::new();
        let _ = heard.extend_from_slice(bytes);
        Ok(Outcome::Done(BusAnswer {
            status: BusStatus::Heard,
            bytes: heard,
        }))
    }
    fn set_key(&mut self, _key: &Key) -> Result<Outcome, Reject> {
        self.outcome()
    }
    fn set_robot(&mut self, robot: &WireRobot) -> Result<Outcome, Reject> {
        let machine = robot.machine(&RobotModel::default());
        let machine = machine.map_err(|error| Reject::Robot(error.into()))?;
        sink(WireRobot::from(&machine));
        self.outcome()
    }
    fn robot(&mut self) -> Result<WireRobot, Reject> {
        let contact = WireContact::from_number(self.h.byte()).ok_or(Reject::Busy)?;
        let speeds_rad_s = Vec::new();
        Ok(WireRobot {
            contact,
            speeds_rad_s,
        })
    }
    fn reset(&mut self) -> Result<Outcome, Reject> {
        self.outcome()
    }
    fn crash(&mut self) -> Option<CrashRecord> {
        None
    }
}

pub(crate) fn drive(h: &mut Hostile) {
    serve(h);
    receive(h);
    if let Some(wire) = WireGait::from_bytes(&h.bytes::<200>()) {
        let mut out = [0; MAX_GAIT];
        sink(wire.to_bytes(&mut out).len());
    }
    sink(law::some_gait(h).as_ref().map(WireGait::from));
}

fn serve(h: &mut Hostile) {
    let port = if h.byte() > 3 {
        Port::Wire
    } else {
        Port::Radio
    };
    let mut server = Server::new(port, h.byte(), h.word());
    let mut out = [0; MAX_FRAME];
    let mut module = Module {
        h,
        stored: None,
        log: SampleLog::new(),
    };
    for _ in 0..module.h.word() {
        let (byte, now_us) = (module.h.byte(), module.h.time());
        sink(server.push(byte, now_us, &mut module, &mut out));
        let sample = Sample {
            t_us: module.h.time(),
            ..Sample::of(module.h.byte())
        };
        module.log.push(&sample);
        if server.is_pending() && module.h.byte() > 7 {
            sink(server.complete(Ok(Completed::Ack), &mut out));
        }
        match module.h.byte() {
            0 => server.restart(),
            3 => server.void_challenge(),
            1 => module.log.begin(1, module.h.byte()),
            2 => module.log.flush(),
            _ => sink((module.log.next_unsent().is_some(), module.log.dropped())),
        }
        sink(&out);
    }
}

fn receive(h: &mut Hostile) {
    let mut client = Client::new(h.word() as u16);
    let mut out = [0; MAX_FRAME];
    let (key, nonce) = (Key(h.bytes()), Nonce(h.bytes()));
    for _ in 0..h.word() {
        sink(client.request(
            &ToModule::GetGait { slot: h.byte() },
            Some((&key, &nonce)),
            &mut out,
        ));
        let Some(Ok(received)) = client.push(h.byte()) else {
            continue;
        };
        if let FromModule::SampleBlock(block) | FromModule::SampleBlockOf(block) = &received.message
        {
            for sample in block.samples() {
                sink(sample.is_ok());
            }
        }
        sink(key.proves(&nonce, &received.message));
        sink(received);
    }
}
