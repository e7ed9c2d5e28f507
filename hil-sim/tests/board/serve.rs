//! The board's cable for a client outside.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use hil_sim::board::serve::serve;
use hil_sim::endpoint::{Endpoint, channel};
use protocol::link::{Client, FromModule, MAX_FRAME, ToModule};

use crate::common::{board, built};

/// Says HELLO until the module answers. The line is given back: a dropped one would look like a client that hung up.
fn client<E: Endpoint>(mut line: E, done: &AtomicBool) -> (E, FromModule) {
    let mut client = Client::new(1);
    let mut input = [0; 256];
    let mut rounds = 0_u32;
    loop {
        if rounds.is_multiple_of(100) {
            let mut out = [0; MAX_FRAME];
            let protocol = protocol::link::VERSION;
            let request = client.request(&ToModule::Hello { protocol }, None, &mut out);
            let (_, length) = request.expect("fits");
            line.write(&out[..length]).expect("served");
        }
        rounds += 1;
        let count = line
            .read(&mut input, Duration::from_millis(20))
            .expect("served");
        for &byte in &input[..count] {
            if let Some(Ok(received)) = client.push(byte)
                && matches!(received.message, FromModule::Hello(_))
            {
                done.store(true, Ordering::Release);
                return (line, received.message);
            }
        }
    }
}

#[test]
fn a_client_outside_gets_its_hello_answered() {
    let Some(built) = built("serving the board's cable") else {
        return;
    };
    let (mut board, _) = board(&built.config());
    let (ours, theirs) = channel();
    let mut ours = ours;
    let done = Arc::new(AtomicBool::new(false));
    let answered = Arc::clone(&done);
    let outside = std::thread::spawn(move || client(theirs, &answered));
    serve(&mut board, &mut ours, &mut |_| {
        if done.load(Ordering::Acquire) {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    })
    .expect("serves");
    let (_line, answer) = outside.join().expect("client");
    assert!(matches!(answer, FromModule::Hello(_)));
}
