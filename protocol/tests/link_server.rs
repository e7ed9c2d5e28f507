//! The module's end of the link: what is carried out, what is refused, what is done once.
#![allow(clippy::unwrap_used, reason = "helpers of tests")]

mod common;

use common::*;
use heapless::Vec as HVec;
use protocol::link::*;

/// A module that writes down what it is told.
#[derive(Default)]
struct Robot {
    key: Option<Key>,
    nonces: u8,
    calls: Vec<String>,
    pending: bool,
    refuse: Option<Reject>,
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
        hello()
    }
    fn info(&mut self) -> Info {
        info()
    }
    fn fresh_nonce(&mut self) -> Nonce {
        self.nonces += 1;
        Nonce([self.nonces; NONCE_LEN])
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
        self.order(format!("start {} {}", order.slot, order.duration_ms))
    }
    fn clear_fault(&mut self) -> Result<Outcome, Reject> {
        self.order("clear".into())
    }
    fn zero(&mut self, joint_mask: u8) -> Result<Outcome, Reject> {
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

struct Session {
    robot: Robot,
    server: Server,
    host: Client,
}

impl Session {
    fn new(port: Port, key: Option<Key>) -> Self {
        let mut session = Self {
            robot: Robot {
                key,
                ..Robot::default()
            },
            server: Server::new(port, ROBOT, BOOT),
            host: Client::new(0xFFFE),
        };
        let answer = session.ask(&ToModule::Hello { protocol: VERSION }, None);
        assert_eq!(answer, FromModule::Hello(hello()));
        assert_eq!(session.host.boot_id(), BOOT);
        session
    }

    fn bytes(&mut self, message: &ToModule, proof: Option<(&Key, &Nonce)>) -> Vec<u8> {
        let mut out = [0; MAX_FRAME];
        let (_, len) = self.host.request(message, proof, &mut out).unwrap();
        out[..len].to_vec()
    }

    /// Every answer to these bytes, with its sequence number.
    fn send(&mut self, bytes: &[u8]) -> Vec<(u16, FromModule)> {
        let mut answers = Vec::new();
        let mut out = [0; MAX_FRAME];
        for &byte in bytes {
            if let Some(len) = self.server.push(byte, 4321, &mut self.robot, &mut out) {
                answers.extend(receive(&mut self.host, &out[..len]));
            }
        }
        answers
    }

    fn ask(&mut self, message: &ToModule, proof: Option<(&Key, &Nonce)>) -> FromModule {
        let bytes = self.bytes(message, proof);
        let mut answers = self.send(&bytes);
        assert_eq!(answers.len(), 1, "{message:?}");
        answers.remove(0).1
    }

    fn nonce(&mut self) -> Nonce {
        match self.ask(&ToModule::GetChallenge, None) {
            FromModule::Challenge { nonce } => nonce,
            other => panic!("{other:?}"),
        }
    }

    fn order(&mut self, message: &ToModule) -> FromModule {
        let nonce = self.nonce();
        self.ask(message, Some((&KEY, &nonce)))
    }
}

fn receive(host: &mut Client, bytes: &[u8]) -> Vec<(u16, FromModule)> {
    bytes
        .iter()
        .filter_map(|byte| host.push(*byte))
        .map(|received| {
            let received = received.unwrap();
            (received.header.sequence, received.message)
        })
        .collect()
}

fn nack(message: &ToModule, reason: Reject) -> FromModule {
    FromModule::Nack {
        request: message.kind(),
        reason,
    }
}

fn orders() -> Vec<ToModule> {
    to_module()
        .into_iter()
        .filter(|message| message.tag().is_some())
        .collect()
}

#[test]
fn every_request_is_answered_with_its_number() {
    let mut session = Session::new(Port::Wire, Some(KEY));
    for message in to_module() {
        let bytes = if message.tag().is_some() {
            let nonce = session.nonce();
            session.bytes(&message, Some((&KEY, &nonce)))
        } else {
            session.bytes(&message, None)
        };
        let answers = session.send(&bytes);
        assert_eq!(answers.len(), 1, "{message:?}");
        assert!(
            !matches!(answers[0].1, FromModule::Nack { .. }),
            "{answers:?}"
        );
        // Bytes 2.. of the body are the sequence; read it back through an independent COBS decoder.
        let mut body = bytes[1..].to_vec();
        let len = cobs::decode_in_place(&mut body).unwrap();
        assert!(len >= 13);
        assert_eq!(answers[0].0, u16::from_le_bytes([body[2], body[3]]));
    }
}

#[test]
fn orders_need_the_right_tag_and_a_nonce_serves_once() {
    for port in [Port::Wire, Port::Radio] {
        for message in orders() {
            let mut session = Session::new(port, Some(KEY));
            assert_eq!(
                session.ask(&message, None),
                nack(&message, Reject::NoChallenge)
            );
            let nonce = session.nonce();
            assert_eq!(
                session.nonce(),
                nonce,
                "an open challenge is repeated, so a flood of requests cannot void it"
            );
            assert_eq!(
                session.ask(&message, None),
                nack(&message, Reject::BadTag),
                "no tag"
            );
            let other_key = Key([0x4C; KEY_LEN]);
            assert_eq!(
                session.ask(&message, Some((&other_key, &nonce))),
                nack(&message, Reject::BadTag)
            );
            let other_nonce = Nonce([9; NONCE_LEN]);
            assert_eq!(
                session.ask(&message, Some((&KEY, &other_nonce))),
                nack(&message, Reject::BadTag)
            );
            assert!(
                session
                    .robot
                    .calls
                    .iter()
                    .all(|call| call.starts_with("bad tag")),
                "{:?}",
                session.robot.calls
            );

            let answer = session.ask(&message, Some((&KEY, &nonce)));
            assert!(!matches!(answer, FromModule::Nack { .. }), "{answer:?}");
            let done = session.robot.calls.len();
            assert_eq!(
                session.ask(&message, Some((&KEY, &nonce))),
                nack(&message, Reject::NoChallenge),
                "used nonce"
            );
            let fresh = session.nonce();
            assert_ne!(fresh, nonce);
            assert_eq!(
                session.ask(&message, Some((&KEY, &nonce))),
                nack(&message, Reject::BadTag),
                "old nonce"
            );
            assert_eq!(
                session
                    .robot
                    .calls
                    .iter()
                    .filter(|call| !call.starts_with("bad tag"))
                    .count(),
                done - 3
            );
        }
    }
}

#[test]
fn a_tag_is_bound_to_type_and_every_byte() {
    let mut session = Session::new(Port::Radio, Some(KEY));
    let nonce = session.nonce();
    let signed = session.bytes(
        &ToModule::ActivateSlot {
            slot: 1,
            tag: Tag::NONE,
        },
        Some((&KEY, &nonce)),
    );
    let mut body = signed[1..].to_vec();
    let len = cobs::decode_in_place(&mut body).unwrap();
    let message = body[8..len - 4].to_vec();
    // The same tag under another type, with another slot, with one bit of the tag changed: re-framed with a good checksum.
    let forge = |change: &dyn Fn(&mut Vec<u8>)| {
        let mut forged = body[..8].to_vec();
        let mut message = message.clone();
        change(&mut message);
        forged.extend_from_slice(&message);
        forged.extend_from_slice(&protocol::crc::crc32c(&forged).to_le_bytes());
        let mut out = vec![0; cobs::max_encoding_length(forged.len()) + 2];
        let len = cobs::encode(&forged, &mut out[1..]);
        out.truncate(len + 2);
        out
    };
    let erase = ToModule::EraseSlot {
        slot: 1,
        tag: Tag::NONE,
    }
    .kind();
    let mut forgeries = vec![forge(&|m| m[0] = erase), forge(&|m| m[1] = 2)];
    for bit in 0..TAG_LEN * 8 {
        forgeries.push(forge(&move |m| m[2 + bit / 8] ^= 1 << (bit % 8)));
    }
    for forged in forgeries {
        let answers = session.send(&forged);
        assert!(
            matches!(
                answers[..],
                [(
                    _,
                    FromModule::Nack {
                        reason: Reject::BadTag,
                        ..
                    }
                )]
            ),
            "{answers:?}"
        );
    }
    assert!(matches!(
        session.send(&signed)[..],
        [(_, FromModule::Ack { .. })]
    ));
    assert_eq!(
        session
            .robot
            .calls
            .iter()
            .filter(|call| *call == "activate 1")
            .count(),
        1
    );
}

/// HMAC-SHA-256 of Python's hmac module over the documented bytes.
#[test]
fn the_tag_is_the_documented_one() {
    let tag = KEY.sign(&NONCE, 7, &[3]);
    assert_eq!(
        tag.0,
        [
            0xFC, 0x65, 0x7E, 0xA4, 0x72, 0x64, 0xA3, 0xDC, 0x70, 0x7C, 0x10, 0xC3, 0x01, 0x94,
            0xFE, 0x29
        ]
    );
}

#[test]
fn without_a_key_only_a_wire_port_obeys() {
    for message in orders() {
        let mut radio = Session::new(Port::Radio, None);
        assert_eq!(radio.ask(&message, None), nack(&message, Reject::NoKey));
        assert!(radio.robot.calls.is_empty());
        let mut wire = Session::new(Port::Wire, None);
        assert!(!matches!(wire.ask(&message, None), FromModule::Nack { .. }));
    }
}

#[test]
fn a_key_is_set_on_a_wire_port_only() {
    let message = ToModule::SetKey { key: KEY };
    for key in [None, Some(Key([1; KEY_LEN]))] {
        let mut radio = Session::new(Port::Radio, key);
        assert_eq!(
            radio.ask(&message, None),
            nack(&message, Reject::WirePortOnly)
        );
        assert_eq!(radio.robot.key, key);
        let mut wire = Session::new(Port::Wire, key);
        assert_eq!(
            wire.ask(&message, None),
            FromModule::Ack {
                request: message.kind()
            }
        );
        assert_eq!(wire.robot.key, Some(KEY));
    }
}

#[test]
fn stop_is_obeyed_whatever_else_is_wrong() {
    let stop = |header: Header| frame(&header, &ToModule::Stop);
    let mut session = Session::new(Port::Radio, None);
    session.robot.pending = true;
    let wrong_boot = Header {
        boot_id: 1,
        ..host_header(1)
    };
    let wrong_version = Header {
        version: 77,
        ..host_header(2)
    };
    for header in [host_header(0), wrong_boot, wrong_version] {
        let answers = session.send(&stop(header));
        assert_eq!(
            answers,
            [(
                header.sequence,
                FromModule::Ack {
                    request: ToModule::Stop.kind()
                }
            )]
        );
    }
    assert_eq!(session.robot.calls, ["stop"; 3]);

    // Also while an order is being carried out, and it does not end that order.
    let mut wire = Session::new(Port::Wire, None);
    wire.robot.pending = true;
    let erase = wire.bytes(
        &ToModule::EraseSlot {
            slot: 0,
            tag: Tag::NONE,
        },
        None,
    );
    assert!(wire.send(&erase).is_empty());
    assert_eq!(wire.send(&stop(host_header(9))).len(), 1);
    assert!(wire.server.is_pending());
}

#[test]
fn other_versions_and_sessions_are_named() {
    let mut session = Session::new(Port::Wire, None);
    let other = Header {
        version: 2,
        ..host_header(3)
    };
    assert_eq!(
        session.send(&frame(&other, &ToModule::GetInfo)),
        [(
            3,
            nack(&ToModule::GetInfo, Reject::Version { theirs: 2, ours: 1 })
        )]
    );
    let hello = ToModule::Hello { protocol: 5 };
    assert_eq!(
        session.ask(&hello, None),
        nack(&hello, Reject::Version { theirs: 5, ours: 1 })
    );
    for message in to_module() {
        let old = Header {
            boot_id: BOOT ^ 1,
            ..host_header(4)
        };
        let answers = session.send(&frame(&old, &message));
        match message {
            ToModule::Hello { .. } | ToModule::GetInfo | ToModule::Stop => {
                assert!(!matches!(answers[0].1, FromModule::Nack { .. }));
            }
            _ => assert_eq!(answers, [(4, nack(&message, Reject::OtherSession))]),
        }
    }
    assert_eq!(session.robot.calls, ["stop"]);
    assert_eq!(session.server.counters().bad_version, 1);
    let FromModule::Info(info) = session.ask(&ToModule::GetInfo, None) else {
        panic!()
    };
    assert_eq!(
        info.counters.link.bad_version, 1,
        "the host sees what the module threw away"
    );
}

#[test]
fn own_echo_is_ignored() {
    let mut session = Session::new(Port::Wire, None);
    let echo = frame(&module_header(1), &FromModule::Ack { request: 0 });
    assert!(session.send(&echo).is_empty());
    assert_eq!(session.server.counters().foreign, 1);
    let request = session.bytes(&ToModule::GetInfo, None);
    assert!(receive(&mut session.host, &request).is_empty());
    assert_eq!(session.host.counters().foreign, 1);
}

#[test]
fn a_repeated_order_is_done_once_and_answered_again() {
    for refuse in [None, Some(Reject::NotHomed { missing_mask: 3 })] {
        let mut session = Session::new(Port::Radio, Some(KEY));
        session.robot.refuse = refuse;
        for message in orders() {
            session.robot.calls.clear();
            let nonce = session.nonce();
            let bytes = session.bytes(&message, Some((&KEY, &nonce)));
            let first = session.send(&bytes);
            // Requests that change nothing may come in between.
            session.ask(&ToModule::Ping { host_t_us: 0 }, None);
            let second = session.send(&bytes);
            assert_eq!(first, second, "{message:?}");
            assert_eq!(session.robot.calls.len(), 1);
        }
    }
}

#[test]
fn while_an_order_is_pending_others_are_busy_and_questions_are_answered() {
    let mut session = Session::new(Port::Wire, None);
    session.robot.pending = true;
    let put = session.bytes(
        &ToModule::PutGait {
            slot: 3,
            activate: false,
            gait: gait(),
            tag: Tag::NONE,
        },
        None,
    );
    assert!(session.send(&put).is_empty());
    assert!(
        session.send(&put).is_empty(),
        "the repeat waits for the same answer"
    );
    let erase = ToModule::EraseSlot {
        slot: 1,
        tag: Tag::NONE,
    };
    assert_eq!(session.ask(&erase, None), nack(&erase, Reject::Busy));
    assert!(matches!(
        session.ask(&ToModule::GetInfo, None),
        FromModule::Info(_)
    ));
    assert!(matches!(
        session.ask(&ToModule::Ping { host_t_us: 5 }, None),
        FromModule::Pong {
            host_t_us: 5,
            module_t_us: 4321
        }
    ));

    let mut out = [0; MAX_FRAME];
    let stored = StoredGait {
        slot: 3,
        digest: gait().digest(),
        active: false,
    };
    let len = session
        .server
        .complete(Ok(Completed::GaitStored(stored)), &mut out)
        .unwrap();
    let answers = receive(&mut session.host, &out[..len]);
    assert!(matches!(
        answers[..],
        [(
            _,
            FromModule::GaitStored {
                slot: 3,
                active: false,
                ..
            }
        )]
    ));
    assert_eq!(session.send(&put), answers, "the repeat now gets it");
    assert_eq!(session.robot.calls, ["put 3 false crawl"]);
    assert_eq!(
        session.server.complete(Ok(Completed::Ack), &mut out),
        None,
        "nothing is pending any more"
    );
}

#[test]
fn the_largest_answers_are_kept_whole() {
    let mut session = Session::new(Port::Wire, None);
    let raw = session.bytes(
        &ToModule::BusRaw {
            bytes: HVec::new(),
            listen_ms: 1,
            tag: Tag::NONE,
        },
        None,
    );
    let first = session.send(&raw);
    assert!(matches!(&first[..], [(_, FromModule::BusReply { bytes, .. })] if bytes.len() == 256));
    assert_eq!(session.send(&raw), first);
}

#[test]
fn damaged_orders_change_nothing_and_the_link_goes_on() {
    let mut session = Session::new(Port::Radio, Some(KEY));
    let nonce = session.nonce();
    let put = session.bytes(
        &ToModule::PutGait {
            slot: 3,
            activate: true,
            gait: gait(),
            tag: Tag::NONE,
        },
        Some((&KEY, &nonce)),
    );
    for at in 0..put.len() {
        for bit in 0..8 {
            let mut damaged = put.clone();
            damaged[at] ^= 1 << bit;
            session.send(&damaged);
            session.send(&[0]);
        }
        session.send(&put[..at]);
    }
    session.send(&[0]);
    // An outer zero may turn into something else and leave the frame whole: then it was this gait, once.
    let calls: Vec<_> = session
        .robot
        .calls
        .iter()
        .filter(|call| *call != "put 3 true crawl")
        .collect();
    assert!(calls.is_empty(), "{calls:?}");
    assert!(session.robot.calls.len() <= 1);
    assert!(matches!(
        session.ask(&ToModule::GetInfo, None),
        FromModule::Info(_)
    ));
    session.order(&ToModule::EraseSlot {
        slot: 1,
        tag: Tag::NONE,
    });
    assert_eq!(session.robot.calls.last().unwrap(), "erase 1");
}

#[test]
fn unasked_messages_carry_their_own_count() {
    let mut session = Session::new(Port::Wire, None);
    for expected in 0..3 {
        let mut out = [0; MAX_FRAME];
        let len = session
            .server
            .send(&FromModule::Sample(sample(1)), &mut out)
            .unwrap();
        assert_eq!(
            receive(&mut session.host, &out[..len]),
            [(expected, FromModule::Sample(sample(1)))]
        );
    }
}
