//! The module's end of the link: what is carried out, what is refused, what is done once.
#![allow(clippy::unwrap_used, reason = "helpers of tests")]

#[path = "../common/mod.rs"]
mod common;
mod robot;
mod tags;

use common::*;
use heapless::Vec as HVec;
use protocol::link::*;
use robot::*;

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

/// Two programs may count from the same number: another order is another order.
#[test]
fn an_order_with_the_number_of_the_last_one_is_carried_out() {
    let mut session = Session::new(Port::Wire, None);
    session.host = Client::new(7);
    session.ask(&ToModule::Hello { protocol: VERSION }, None);
    let tag = Tag::NONE;
    let first = session.bytes(&ToModule::ActivateSlot { slot: 1, tag }, None);
    session.send(&first);
    session.host = Client::new(7);
    session.ask(&ToModule::Hello { protocol: VERSION }, None);
    let second = session.bytes(&ToModule::ActivateSlot { slot: 2, tag }, None);
    let third = session.bytes(&ToModule::EraseSlot { slot: 2, tag }, None);
    for bytes in [&second, &third] {
        let answers = session.send(bytes);
        assert!(matches!(answers[..], [(_, FromModule::Ack { .. })]));
    }
    assert_eq!(session.robot.calls, ["activate 1", "activate 2", "erase 2"]);
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

/// A block that a module sends unasked must never pass for the answer to a request, whatever the two counts are.
#[test]
fn unasked_messages_carry_their_own_count_that_no_request_has() {
    let mut session = Session::new(Port::Wire, None);
    let mut out = [0; MAX_FRAME];
    for expected in (0..=0x7FFF).chain(0..3) {
        let len = session
            .server
            .send(&FromModule::Ack { request: 0 }, &mut out)
            .unwrap();
        let received = receive(&mut session.host, &out[..len]);
        assert_eq!(received[0].0, UNASKED | expected);
    }
    let mut host = Client::new(0xFFFE);
    for expected in [0x7FFE, 0x7FFF, 0, 1] {
        let (sequence, len) = host
            .request(&ToModule::Ping { host_t_us: 0 }, None, &mut out)
            .unwrap();
        assert_eq!(sequence, expected);
        let mut decoder = Decoder::new();
        let header = out[..len]
            .iter()
            .find_map(|byte| decoder.push(*byte).map(|frame| frame.header))
            .unwrap();
        assert!(header.is_answer() && header.sequence == sequence);
    }
}

#[test]
fn what_cannot_be_read_is_named_and_counted() {
    let mut session = Session::new(Port::Wire, None);
    // The envelope by hand around any message bytes.
    let framed = |message: &[u8]| {
        let mut body = vec![VERSION, SOURCE_HOST, 9, 0];
        body.extend(BOOT.to_le_bytes());
        body.extend_from_slice(message);
        body.extend(protocol::crc::crc32c(&body).to_le_bytes());
        let mut bytes = cobs::encode_vec(&body);
        bytes.push(0);
        bytes
    };
    for (message, reason) in [
        (&[77, 1, 2][..], Reject::UnknownType { kind: 77 }),
        (&[4], Reject::Malformed),
        (&[1, 0], Reject::TrailingBytes),
        (&[8, 1], Reject::Malformed),
    ] {
        let request = message[0];
        assert_eq!(
            session.send(&framed(message)),
            [(9, FromModule::Nack { request, reason })]
        );
    }
    let counters = *session.server.counters();
    assert_eq!(
        (
            counters.unknown_type,
            counters.malformed,
            counters.trailing_bytes
        ),
        (1, 2, 1)
    );
    assert!(session.robot.calls.is_empty());

    // STOP with anything behind it is still STOP.
    let stop = ToModule::Stop.kind();
    assert_eq!(
        session.send(&framed(&[stop, 1, 2, 3])),
        [(9, FromModule::Ack { request: stop })]
    );
}

#[test]
fn questions_can_be_refused_and_orders_can_fail_later() {
    let mut session = Session::new(Port::Wire, None);
    let question = ToModule::GetGait { slot: 1 };
    assert_eq!(
        session.ask(&question, None),
        nack(&question, Reject::SlotEmpty)
    );

    session.robot.pending = true;
    let erase = ToModule::EraseSlot {
        slot: 1,
        tag: Tag::NONE,
    };
    let bytes = session.bytes(&erase, None);
    assert!(session.send(&bytes).is_empty());
    let mut out = [0; MAX_FRAME];
    let fault = Reject::Storage {
        fault: StorageFault::ReadBack,
    };
    let len = session.server.complete(Err(fault), &mut out).unwrap();
    let answers = receive(&mut session.host, &out[..len]);
    assert!(matches!(&answers[..], [(_, message)] if *message == nack(&erase, fault)));
    assert_eq!(session.send(&bytes), answers);
}

#[test]
fn a_reconnect_in_the_middle_of_a_frame_costs_that_frame_only() {
    let mut session = Session::new(Port::Wire, None);
    let request = session.bytes(&ToModule::GetInfo, None);
    for cut in 0..request.len() {
        session.send(&request[..cut]);
        session.server.restart();
        assert_eq!(session.send(&request).len(), 1, "cut at {cut}");
    }
    let mut out = [0; MAX_FRAME];
    let len = session
        .server
        .send(&FromModule::Sample(sample(1)), &mut out)
        .unwrap();
    receive(&mut session.host, &out[..len / 2]);
    session.host.restart();
    assert_eq!(receive(&mut session.host, &out[..len]).len(), 1);
}
