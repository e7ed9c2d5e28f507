//! The robot behind an endpoint: bytes of a foreign client reach it, and its time follows the clock outside.

use hil_sim::endpoint::{Tcp, channel};
use hil_sim::robot::host::SimHost;
use hil_sim::robot::ideal::IdealMotors;
use hil_sim::robot::link::RX_RING_BYTES;
use hil_sim::robot::serve::{RobotEvent, serve};
use hil_sim::robot::{EmulatedRobot, Setup};
use protocol::link::{
    Client, EventKind, FromModule, MAX_FRAME, Message, Reject, ToModule, VERSION,
};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::ops::ControlFlow;
use std::time::Duration;

#[test]
fn a_client_behind_an_endpoint_gets_its_answer() {
    let (mut near, mut far) = channel();
    let client = std::thread::spawn(move || {
        use hil_sim::endpoint::Endpoint as _;
        let mut client = Client::new(7);
        let mut frame = [0; MAX_FRAME];
        let hello = ToModule::Hello { protocol: VERSION };
        let (_, len) = client.request(&hello, None, &mut frame).expect("fits");
        far.write(&frame[..len]).expect("the robot is there");
        let mut input = [0; 256];
        loop {
            let count = far
                .read(&mut input, Duration::from_millis(100))
                .expect("the robot is there");
            for byte in &input[..count] {
                if let Some(Ok(received)) = client.push(*byte) {
                    return (received.message, far);
                }
            }
        }
    });
    let mut robot = EmulatedRobot::with_motors(
        Setup {
            link_byte_ns: 0,
            ..Setup::default()
        },
        IdealMotors::new(false),
    );
    let mut statuses = 0;
    serve(&mut robot, &mut near, &mut |event| {
        statuses += u32::from(matches!(event, RobotEvent::Status { .. }));
        if client.is_finished() && statuses > 1 {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    })
    .expect("the channel stays");
    let (answer, _far) = client.join().expect("no panic");
    assert!(matches!(answer, FromModule::Hello(_)));
    assert!(
        robot.now_us() >= 200_000,
        "two status reports take two tenths of a second"
    );
}

/// Megabytes of junk at once: the robot's ring takes its 1 KiB, the rest is lost and counted, and STOP is answered as soon as the ring is through.
#[test]
fn a_flood_on_one_line_is_bounded_and_the_next_stop_is_heard() {
    let mut robot = EmulatedRobot::ideal(Setup::default());
    let line = robot.link();
    robot.run_for(100_000);
    for part in 0..30_u8 {
        line.write(&vec![part; 100_000]);
    }
    assert_eq!(line.lost_bytes(), 3_000_000 - RX_RING_BYTES as u64);
    // 1 KiB at 115200 baud.
    robot.run_for(89_000);
    let mut host = SimHost::new(line);
    let begin_us = robot.now_us();
    host.ask(&mut robot, &ToModule::Stop).expect("heard");
    assert!(robot.now_us() - begin_us < 20_000);
}

/// The same through a socket, by a client that leaves before its junk is through.
#[test]
fn the_junk_of_a_client_that_left_does_not_reach_the_next_one() {
    let mut tcp = Tcp::listen("127.0.0.1:0").expect("a free port");
    let address = tcp.local();
    let client = std::thread::spawn(move || {
        let mut flooder = TcpStream::connect(address).expect("listens");
        flooder.write_all(&vec![0x55; 4_000_000]).expect("taken");
        drop(flooder);
        let mut client = Client::new(7);
        let mut frame = [0; MAX_FRAME];
        let (_, len) = client
            .request(&ToModule::Stop, None, &mut frame)
            .expect("fits");
        let mut stream = TcpStream::connect(address).expect("listens");
        stream.write_all(&frame[..len]).expect("taken");
        let mut input = [0; 256];
        loop {
            let count = stream.read(&mut input).expect("open");
            assert!(count > 0, "closed without an answer");
            for byte in &input[..count] {
                if let Some(Ok(received)) = client.push(*byte) {
                    return received.message;
                }
            }
        }
    });
    let mut robot = EmulatedRobot::ideal(Setup::default());
    serve(&mut robot, &mut tcp, &mut |_| {
        if client.is_finished() {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    })
    .expect("the socket stays");
    let answer = client.join().expect("no panic");
    assert_eq!(answer, FromModule::Ack { request: 9 });
    assert!(robot.link().lost_bytes() > 0);
}

/// One client's answer to a request over TCP.
fn ask(stream: &mut TcpStream, client: &mut Client, message: &ToModule) -> FromModule {
    let mut frame = [0; MAX_FRAME];
    let (sequence, len) = client.request(message, None, &mut frame).expect("fits");
    stream
        .write_all(&frame[..len])
        .expect("the emulation listens");
    let mut input = [0; 256];
    loop {
        let count = stream.read(&mut input).expect("an answer");
        assert!(count > 0, "the emulation hung up");
        for byte in &input[..count] {
            if let Some(Ok(received)) = client.push(*byte)
                && received.header.sequence == sequence
            {
                return received.message;
            }
        }
    }
}

#[test]
fn a_second_client_of_one_line_hears_that_it_is_taken_and_may_stop() {
    let mut endpoint = Tcp::listen("127.0.0.1:0").expect("a free port");
    let address = endpoint.local();
    let clients = std::thread::spawn(move || {
        let hello = ToModule::Hello { protocol: VERSION };
        let connect = || TcpStream::connect(address).expect("the emulation listens");
        let (mut first, mut one) = (connect(), Client::new(7));
        let answer = ask(&mut first, &mut one, &hello);
        assert!(matches!(answer, FromModule::Hello(_)), "{answer:?}");
        let (mut second, mut other) = (connect(), Client::new(90));
        let request = hello.kind();
        let reason = Reject::Held { link: 0 };
        assert_eq!(
            ask(&mut second, &mut other, &hello),
            FromModule::Nack { request, reason }
        );
        let request = ToModule::Stop.kind();
        assert_eq!(
            ask(&mut second, &mut other, &ToModule::Stop),
            FromModule::Ack { request }
        );
        // The robot has heard it.
        // Eight events of the start stand before it.
        let events = ask(&mut first, &mut one, &ToModule::GetEvents { since: 8 });
        let FromModule::Events { events, .. } = events else {
            panic!("{events:?}")
        };
        let stop = EventKind::Stop { input: false };
        assert!(events.iter().any(|event| event.kind == stop), "{events:?}");
        // The line is free again when the first has left.
        drop(first);
        while !matches!(ask(&mut second, &mut other, &hello), FromModule::Hello(_)) {}
    });
    let mut robot = EmulatedRobot::ideal(Setup {
        link_byte_ns: 0,
        ..Setup::default()
    });
    serve(&mut robot, &mut endpoint, &mut |_| {
        if clients.is_finished() {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    })
    .expect("the listener stays");
    clients.join().expect("no panic");
}
