//! The robot behind an endpoint: bytes of a foreign client reach it, and its time follows the clock outside.

use hil_sim::endpoint::channel;
use hil_sim::robot::ideal::IdealMotors;
use hil_sim::robot::serve::{RobotEvent, serve};
use hil_sim::robot::{EmulatedRobot, Setup};
use protocol::link::{Client, FromModule, MAX_FRAME, ToModule, VERSION};
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
