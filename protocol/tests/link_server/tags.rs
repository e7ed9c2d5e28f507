//! Who may give orders: tags, nonces, keys, and what an attacker has recorded.

use crate::common::*;
use crate::robot::*;
use crate::{nack, orders};
use protocol::link::*;

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
        // The port looks at no more than some a second, and the challenge stays open.
        let mut session = Session::new(Port::Radio, Some(KEY));
        assert_eq!(session.nonce(), nonce);
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
        assert!(matches!(
            session.send(&signed)[..],
            [(_, FromModule::Ack { .. })]
        ));
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

/// An attacker has recorded everything the host ever sent and plays it again, mixed, in the same boot and in later ones, with a challenge open.
#[test]
fn replayed_sessions_move_nothing() {
    let mut recorded = Vec::new();
    let mut rng = Rng(0xA77A_C4E5);
    for boot in 0..40 {
        let mut session = Session::boot(Port::Radio, Some(KEY), BOOT + boot);
        session.robot.nonces = boot as u8 * 6;
        for message in orders().into_iter().take(5) {
            let nonce = session.nonce();
            let bytes = session.bytes(&message, Some((&KEY, &nonce)));
            session.send(&bytes);
            recorded.push(bytes);
        }
        assert_eq!(session.robot.calls.len(), 5);
        session.robot.calls.clear();
        for _ in 0..500 {
            // Slowly enough for each to be looked at, with a challenge open.
            session.now_us += server::TAG_TRY_US;
            session.nonce();
            session.send(&recorded[rng.below(recorded.len())]);
        }
        let moved: Vec<_> = session
            .robot
            .calls
            .iter()
            .filter(|call| !call.starts_with("bad tag"))
            .collect();
        assert!(moved.is_empty(), "boot {boot}: {moved:?}");
    }
}

/// The owner signs, the frame is held back, and something happens before it is let through.
#[test]
fn an_order_that_was_held_back_is_void_after_stop_hello_or_its_age() {
    type Meanwhile = fn(&mut Session);
    let voids: [(&str, Meanwhile); 6] = [
        ("STOP", |s| {
            s.ask(&ToModule::Stop, None);
        }),
        ("STOP of a stranger in another version", |s| {
            let header = Header {
                version: 77,
                boot_id: 1,
                ..host_header(9)
            };
            s.send(&frame(&header, &ToModule::Stop));
        }),
        ("HELLO", |s| {
            s.ask(&ToModule::Hello { protocol: VERSION }, None);
        }),
        ("age", |s| s.now_us += server::CHALLENGE_LIFE_US),
        ("age, the challenge asked for again in between", |s| {
            s.now_us += server::CHALLENGE_LIFE_US - 1;
            s.nonce();
            s.now_us += 1;
        }),
        ("the module voids it", |s| s.server.void_challenge()),
    ];
    for port in [Port::Wire, Port::Radio] {
        for message in orders() {
            for (what, meanwhile) in voids {
                let mut session = Session::new(port, Some(KEY));
                let nonce = session.nonce();
                let held_back = session.bytes(&message, Some((&KEY, &nonce)));
                meanwhile(&mut session);
                session.robot.calls.clear();
                let answers = session.send(&held_back);
                assert_eq!(answers[0].1, nack(&message, Reject::NoChallenge), "{what}");
                // With the next challenge open it is a wrong tag.
                assert_ne!(session.nonce(), nonce);
                session.send(&held_back);
                assert_eq!(
                    session.robot.calls,
                    [format!("bad tag {}", message.kind())],
                    "{what}"
                );
                // And the owner is not locked out.
                let answer = session.order(&message);
                assert!(!matches!(answer, FromModule::Nack { .. }), "{answer:?}");
            }
            let mut session = Session::new(port, Some(KEY));
            let nonce = session.nonce();
            session.now_us += server::CHALLENGE_LIFE_US - 1;
            let answer = session.ask(&message, Some((&KEY, &nonce)));
            assert!(!matches!(answer, FromModule::Nack { .. }), "in time");
        }
    }
}

/// The module's state is proved to the host that asked, and to nobody else.
#[test]
fn a_state_is_proved_with_the_key_over_the_hosts_nonce() {
    let nonce = Nonce([0x5A; NONCE_LEN]);
    let ask = ToModule::ProveState { nonce };
    let mut session = Session::new(Port::Radio, Some(KEY));
    let answer = session.ask(&ask, None);
    let FromModule::State { state, tag, .. } = answer else {
        panic!("{answer:?}")
    };
    assert_eq!(state, info().state);
    assert!(KEY.proves(&nonce, &answer));
    assert!(!KEY.proves(&Nonce([1; NONCE_LEN]), &answer), "a replay");
    assert!(!Key([0x4C; KEY_LEN]).proves(&nonce, &answer));
    let forged = FromModule::State {
        state: ModuleState::Idle,
        uptime_us: info().uptime_us + 1,
        tag,
    };
    assert!(!KEY.proves(&nonce, &forged));
    assert!(!KEY.proves(&nonce, &FromModule::Ack { request: 9 }));
    // The tag of a state is the tag of no order, whatever the type.
    let payload = [ModuleState::Idle as u8];
    assert!((0..=u8::MAX).all(|kind| {
        !KEY.verify(
            &nonce,
            kind,
            &payload,
            &KEY.sign_state(&nonce, kind, &payload),
        )
    }));

    let mut keyless = Session::new(Port::Wire, None);
    let answer = keyless.ask(&ask, None);
    assert!(matches!(answer, FromModule::State { tag: Tag::NONE, .. }));
    assert!(!KEY.proves(&nonce, &answer));
}

/// A flood of forged orders costs a bounded number of checks a second, on its own port, and STOP gets through.
#[test]
fn wrong_tags_are_looked_at_a_few_times_a_second_only() {
    let order = ToModule::ClearFault { tag: Tag::NONE };
    let wrong = Key([0x4C; KEY_LEN]);
    for port in [Port::Wire, Port::Radio] {
        let mut session = Session::new(port, Some(KEY));
        let looked_at = |session: &Session| {
            let bad = session.robot.calls.iter();
            bad.filter(|call| call.starts_with("bad tag")).count() as u64
        };
        // Ten seconds, one forgery a millisecond.
        for _ in 0..10_000 {
            session.now_us += 1_000;
            let nonce = session.nonce();
            session.ask(&order, Some((&wrong, &nonce)));
        }
        let most = server::TAG_TRIES + 10_000_000 / server::TAG_TRY_US;
        assert!(looked_at(&session) <= most, "{}", looked_at(&session));
        assert!(looked_at(&session) >= most - 2, "{}", looked_at(&session));

        // The owner is told how long to wait, and then his order is carried out.
        let nonce = session.nonce();
        let answer = session.ask(&order, Some((&KEY, &nonce)));
        let FromModule::Nack {
            reason: Reject::TooManyTags { wait_ms },
            ..
        } = answer
        else {
            panic!("{answer:?}");
        };
        assert!(u64::from(wait_ms) * 1_000 <= server::TAG_TRY_US);
        assert!(!session.robot.calls.contains(&"clear".to_owned()));
        assert_eq!(
            session.ask(&ToModule::Stop, None),
            FromModule::Ack {
                request: ToModule::Stop.kind()
            }
        );
        session.now_us += u64::from(wait_ms) * 1_000;
        let answer = session.order(&order);
        assert!(matches!(answer, FromModule::Ack { .. }), "{answer:?}");
        // Right tags are not counted.
        for _ in 0..100 {
            session.now_us += 2 * server::TAG_TRY_US;
            let answer = session.order(&order);
            assert!(matches!(answer, FromModule::Ack { .. }), "{answer:?}");
        }
    }
}

/// What an old or a lazy client would send: another version, no tag, a tag of zeros, the tag over another domain. None of it gives an order.
#[test]
fn nothing_weaker_than_this_versions_proof_is_taken() {
    for message in orders() {
        for version in (0..=u8::MAX).filter(|version| *version != VERSION) {
            let mut session = Session::new(Port::Radio, Some(KEY));
            let nonce = session.nonce();
            let signed = session.bytes(&message, Some((&KEY, &nonce)));
            let answers = session.send(&of_version(version, &signed));
            let reason = Reject::Version {
                theirs: version,
                ours: VERSION,
            };
            assert_eq!(answers[0].1, nack(&message, reason));
            assert!(session.robot.calls.is_empty(), "{:?}", session.robot.calls);
        }
        let mut session = Session::new(Port::Radio, Some(KEY));
        session.nonce();
        // `Client` leaves the tag at zero where it has no key.
        assert_eq!(session.ask(&message, None), nack(&message, Reject::BadTag));
    }
    // An older host says so in HELLO, and is told which version is spoken.
    let mut session = Session::new(Port::Radio, Some(KEY));
    for protocol in [0, VERSION + 1, u8::MAX] {
        let hello = ToModule::Hello { protocol };
        let reason = Reject::Version {
            theirs: protocol,
            ours: VERSION,
        };
        assert_eq!(session.ask(&hello, None), nack(&hello, reason));
    }
}

/// The frame with another version and a right checksum.
fn of_version(version: u8, bytes: &[u8]) -> Vec<u8> {
    let mut body = bytes[1..].to_vec();
    let len = cobs::decode_in_place(&mut body).unwrap();
    body.truncate(len - 4);
    body[0] = version;
    body.extend_from_slice(&protocol::crc::crc32c(&body).to_le_bytes());
    let mut out = vec![0; cobs::max_encoding_length(body.len()) + 2];
    let len = cobs::encode(&body, &mut out[1..]);
    out.truncate(len + 2);
    out
}
