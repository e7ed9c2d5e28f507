//! Off-the-shelf Dynamixel and Feetech clients drive the emulated motors over a pseudo-terminal.

use std::ops::ControlFlow;
use std::path::Path;
use std::process::{Command, Output};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use hil_sim::endpoint::Pty;
use hil_sim::motor::JointKind;
use hil_sim::pace::{Pace, serve};
use hil_sim::world::{World, WorldParams};
use protocol::bus::Profile;
use tests::{python_clients, root, skip, target_dir};

/// Serves six of our neutral motors on a pseudo-terminal while `client` runs with its path.
fn with_motors<T>(pace: Pace, client: impl FnOnce(&Path) -> T) -> T {
    with_drivers(Profile::Packed, pace, client)
}

/// As [`with_motors`], with drivers of any kind.
fn with_drivers<T>(profile: Profile, pace: Pace, client: impl FnOnce(&Path) -> T) -> T {
    let mut pty = Pty::open(None).unwrap();
    let device = pty.device().to_owned();
    let mut params = WorldParams::metamodule(1, JointKind::catalogue_joint);
    for joint in &mut params.joints {
        joint.driver.profile = profile;
    }
    let mut world = World::on_stand(&params).unwrap();
    let done = Arc::new(AtomicBool::new(false));
    let stop = Arc::clone(&done);
    let server = std::thread::spawn(move || {
        serve(&mut world, &mut pty, pace, &mut |_| {
            if stop.load(Ordering::Relaxed) {
                ControlFlow::Break(())
            } else {
                ControlFlow::Continue(())
            }
        })
    });
    let result = client(Path::new(&device));
    done.store(true, Ordering::Relaxed);
    server.join().unwrap().unwrap();
    result
}

fn passes(mut command: Command) {
    judge(&command.output().unwrap());
}

fn judge(output: &Output) {
    let text = String::from_utf8_lossy(&output.stdout);
    println!("{text}");
    assert!(
        output.status.success() && text.contains("ALL CHECKS PASSED"),
        "{text}\n{}",
        String::from_utf8_lossy(&output.stderr)
    );
}

#[test]
fn robotis_sdk_for_python_drives_the_motors() {
    let python = match python_clients() {
        Ok(python) => python,
        Err(why) => return skip("robotis_sdk_for_python_drives_the_motors", &why),
    };
    for pace in [Pace::Real, Pace::Prompt] {
        with_motors(pace, |device| {
            let mut command = Command::new(&python);
            command
                .arg(root().join("tests/foreign/drive_with_dynamixel_sdk.py"))
                .arg(device);
            passes(command);
        });
    }
}

/// Off-the-shelf servos as the emulation offers them, driven by the SDKs of their makers.
#[test]
fn makers_sdks_for_python_drive_the_servos() {
    let python = match python_clients() {
        Ok(python) => python,
        Err(why) => return skip("makers_sdks_for_python_drive_the_servos", &why),
    };
    let (x, feetech) = ("drive_x_with_dynamixel_sdk.py", "drive_with_feetech_sdk.py");
    for (profile, script) in [
        (Profile::Xl330, x),
        (Profile::Xc330, x),
        (Profile::Xm430, x),
        (Profile::Sts, feetech),
        (Profile::Scs, feetech),
    ] {
        with_drivers(profile, Pace::Real, |device| {
            let mut command = Command::new(&python);
            command
                .arg(root().join("tests/foreign").join(script))
                .arg(device)
                .arg(profile.info().name);
            passes(command);
        });
    }
}

/// `rustypot` brings 62 crates: it lives in a package of its own that only this test builds.
#[test]
fn rustypot_drives_the_motors() {
    let manifest = root().join("tests/foreign-rustypot/Cargo.toml");
    let target = target_dir().join("foreign-rustypot");
    let build = Command::new(env!("CARGO"))
        .args(["build", "--quiet", "--manifest-path"])
        .arg(&manifest)
        .arg("--target-dir")
        .arg(&target)
        .output()
        .unwrap();
    if !build.status.success() {
        let why = String::from_utf8_lossy(&build.stderr);
        // Without the registry the package cannot be built; anything else is our fault.
        let offline = why.contains("failed to download")
            || why.contains("failed to get")
            || why.contains("network");
        assert!(offline, "foreign-rustypot does not build: {why}");
        return skip("rustypot_drives_the_motors", &why);
    }
    with_motors(Pace::Real, |device| {
        let mut command = Command::new(target.join("debug/foreign-rustypot"));
        command.arg(device);
        passes(command);
    });
}
