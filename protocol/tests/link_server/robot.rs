//! A module and a host joined in memory.
#![allow(unreachable_pub, reason = "shared inside one test binary")]

use crate::common::*;
use heapless::Vec as HVec;
use protocol::link::*;

/// A module that writes down what it is told.
#[derive(Default)]
pub struct Robot {
    pub key: Option<Key>,
    pub boot_id: u32,
    pub nonces: u8,
    pub calls: Vec<String>,
    pub pending: bool,
    pub refuse: Option<Reject>,
}

impl Robot {
    fn order(&mut self, call: String) -> Result<Outcome, Reject> {
        self.calls.push(call);
        match self.refuse {
            Some(reason) => Err(reason),
            None if self.pending => Ok(Outcome::Pending),
            None => Ok(Outcome::Done(())),
        }
    }
}

impl ModuleHandler for Robot {
    fn hello(&mut self) -> Hello {
        Hello {
            boot_id: self.boot_id,
            ..hello()
        }
    }
    fn info(&mut self) -> Info {
        info()
    }
    fn fresh_nonce(&mut self) -> Result<Nonce, Reject> {
        self.nonces += 1;
        Ok(Nonce([self.nonces; NONCE_LEN]))
    }
    fn key(&self) -> Option<Key> {
        self.key
    }
    fn bad_tag(&mut self, request: u8) {
        self.calls.push(format!("bad tag {request}"));
    }
    fn stop(&mut self) {
        self.calls.push("stop".into());
    }
    fn put_gait(
        &mut self,
        slot: u8,
        activate: bool,
        gait: &WireGait,
    ) -> Result<Outcome<StoredGait>, Reject> {
        let digest = gait.digest();
        Ok(
            match self.order(format!("put {slot} {activate} {}", gait.name))? {
                Outcome::Done(()) => Outcome::Done(StoredGait {
                    slot,
                    digest,
                    active: activate,
                }),
                Outcome::Pending => Outcome::Pending,
            },
        )
    }
    fn get_gait(&mut self, slot: u8) -> Result<(Digest, WireGait), Reject> {
        if slot == 2 {
            Ok((gait().digest(), gait()))
        } else {
            Err(Reject::SlotEmpty)
        }
    }
    fn slots(&mut self) -> (Option<u8>, HVec<Option<SlotInfo>, MAX_SLOTS>) {
        (Some(1), HVec::from_slice(&[None, None]).unwrap())
    }
    fn activate_slot(&mut self, slot: u8) -> Result<Outcome, Reject> {
        self.order(format!("activate {slot}"))
    }
    fn erase_slot(&mut self, slot: u8) -> Result<Outcome, Reject> {
        self.order(format!("erase {slot}"))
    }
    fn start(&mut self, order: &StartOrder) -> Result<Outcome, Reject> {
        let lease = order.lease_ms.map_or(String::new(), |ms| format!(" {ms}"));
        self.order(format!("start {} {}{lease}", order.slot, order.duration_ms))
    }
    fn heartbeat(&mut self) -> Result<Outcome, Reject> {
        self.order("heartbeat".into())
    }
    fn change_gait(&mut self, slot: u8, _digest: Digest) -> Result<Outcome, Reject> {
        self.order(format!("change {slot}"))
    }
    fn set_drivers(&mut self, profile: protocol::bus::Profile) -> Result<Outcome, Reject> {
        self.order(format!("drivers {profile:?}"))
    }
    fn set_robot(&mut self, robot: &WireRobot) -> Result<Outcome, Reject> {
        self.order(format!("robot {}", robot.speeds_rad_s.len()))
    }
    fn robot(&mut self) -> Result<WireRobot, Reject> {
        Ok(crate::common::robot(3))
    }
    fn clear_fault(&mut self) -> Result<Outcome, Reject> {
        self.order("clear".into())
    }
    fn zero(&mut self, joint_mask: u16) -> Result<Outcome, Reject> {
        self.order(format!("zero {joint_mask}"))
    }
    fn subscribe(&mut self, rate: TelemetryRate) -> Result<(), Reject> {
        self.calls.push(format!("subscribe {rate:?}"));
        Ok(())
    }
    fn events(
        &mut self,
        since: u32,
        into: &mut HVec<Event, { message::MAX_EVENTS }>,
    ) -> (u32, u32) {
        let _ = into.push(Event {
            seq: since,
            t_us: 1,
            kind: EventKind::KeySet,
        });
        (since + 1, 0)
    }
    fn drain(&mut self, from: u32) -> Result<SampleBlock, Reject> {
        Ok(SampleBlock {
            first: from,
            ..SampleBlock::default()
        })
    }
    fn bus_raw(&mut self, bytes: &[u8], listen_ms: u16) -> Result<Outcome<BusAnswer>, Reject> {
        Ok(
            match self.order(format!("bus {} {listen_ms}", bytes.len()))? {
                Outcome::Done(()) => Outcome::Done(BusAnswer {
                    status: BusStatus::Heard,
                    bytes: HVec::from_slice(&[0xFF; 256]).unwrap(),
                }),
                Outcome::Pending => Outcome::Pending,
            },
        )
    }
    fn set_key(&mut self, key: &Key) -> Result<Outcome, Reject> {
        self.key = Some(*key);
        self.order("key".into())
    }
    fn reset(&mut self) -> Result<Outcome, Reject> {
        self.order("reset".into())
    }
    fn crash(&mut self) -> Option<CrashRecord> {
        None
    }
}

pub struct Session {
    pub robot: Robot,
    pub server: Server,
    pub host: Client,
    /// The module's clock.
    pub now_us: u64,
}

impl Session {
    pub fn new(port: Port, key: Option<Key>) -> Self {
        Self::boot(port, key, BOOT)
    }

    pub fn boot(port: Port, key: Option<Key>, boot_id: u32) -> Self {
        let mut session = Self {
            robot: Robot {
                key,
                boot_id,
                ..Robot::default()
            },
            server: Server::new(port, ROBOT, boot_id),
            host: Client::new(0xFFFE),
            now_us: 4321,
        };
        let answer = session.ask(&ToModule::Hello { protocol: VERSION }, None);
        assert!(matches!(answer, FromModule::Hello(_)));
        assert_eq!(session.host.boot_id(), boot_id);
        session
    }

    pub fn bytes(&mut self, message: &ToModule, proof: Option<(&Key, &Nonce)>) -> Vec<u8> {
        let mut out = [0; MAX_FRAME];
        let (_, len) = self.host.request(message, proof, &mut out).unwrap();
        out[..len].to_vec()
    }

    /// Every answer to these bytes, with its sequence number.
    pub fn send(&mut self, bytes: &[u8]) -> Vec<(u16, FromModule)> {
        let mut answers = Vec::new();
        let mut out = [0; MAX_FRAME];
        for &byte in bytes {
            if let Some(len) = self
                .server
                .push(byte, self.now_us, &mut self.robot, &mut out)
            {
                answers.extend(receive(&mut self.host, &out[..len]));
            }
        }
        answers
    }

    pub fn ask(&mut self, message: &ToModule, proof: Option<(&Key, &Nonce)>) -> FromModule {
        let bytes = self.bytes(message, proof);
        let mut answers = self.send(&bytes);
        assert_eq!(answers.len(), 1, "{message:?}");
        answers.remove(0).1
    }

    pub fn nonce(&mut self) -> Nonce {
        match self.ask(&ToModule::GetChallenge, None) {
            FromModule::Challenge { nonce } => nonce,
            other => panic!("{other:?}"),
        }
    }

    pub fn order(&mut self, message: &ToModule) -> FromModule {
        let nonce = self.nonce();
        self.ask(message, Some((&KEY, &nonce)))
    }
}

pub fn receive(host: &mut Client, bytes: &[u8]) -> Vec<(u16, FromModule)> {
    bytes
        .iter()
        .filter_map(|byte| host.push(*byte))
        .map(|received| {
            let received = received.unwrap();
            (received.header.sequence, received.message)
        })
        .collect()
}
