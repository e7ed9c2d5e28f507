//! The search from the outside: the same bytes on any number of threads or processes, cut or whole.

use std::process::Command;

use crate::rig::{Done, Folder, command, finish, rb};

/// Iterations of the small search; enough that a signal sent at its first checkpoint arrives before its end.
const ITERATIONS: &str = "50";

/// Two repetitions of two seconds for six particles: one group of lanes per iteration.
const SETTINGS: &str = "format = 1\nparticles = 6\niterations = 50\nseed = 9\n\
    [space]\nduration_s = 2\n[score]\nrepetitions = 2\n[select]\ncount = 3\nbest = 1\ntraining = 1\n";

/// Everything a finished search leaves, in the order of names.
pub(crate) fn left_by(folder: &Folder, name: &str) -> Vec<(String, String)> {
    let mut paths = vec![folder.path(name)];
    let mut found = Vec::new();
    while let Some(path) = paths.pop() {
        if path.is_dir() {
            paths.extend(std::fs::read_dir(&path).unwrap().map(|e| e.unwrap().path()));
        } else {
            let inside = path.strip_prefix(folder.path(name)).unwrap();
            let text = std::fs::read_to_string(&path).unwrap();
            found.push((inside.display().to_string(), text));
        }
    }
    found.sort();
    found
}

#[track_caller]
pub(crate) fn assert_same(folder: &Folder, name: &str, expected: &[(String, String)]) {
    let found = left_by(folder, name);
    let names = |set: &[(String, String)]| set.iter().map(|f| f.0.clone()).collect::<Vec<_>>();
    assert_eq!(names(&found), names(expected), "{name}");
    for ((file, a), (_, b)) in found.iter().zip(expected) {
        assert!(a == b, "{file} of `{name}` differs");
    }
}

/// Sends a signal once the search has stored its first checkpoint.
pub(crate) fn signalled(mut command: Command, signal: &str, folder: &Folder, name: &str) -> Done {
    let child = command
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    let checkpoint = folder.path(name).join("checkpoint.json");
    while !checkpoint.exists() {
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    let pid = child.id().to_string();
    let sent = Command::new("kill").args([signal, &pid]).status().unwrap();
    assert!(sent.success());
    finish(child.wait_with_output().unwrap())
}

/// The search on one thread, which every other way must repeat.
fn whole(folder: &Folder) -> Vec<(String, String)> {
    folder.write("small.toml", SETTINGS);
    let args = ["optimise", "gait", "-s", "small.toml", "-j", "1"];
    rb(folder, &[&args[..], &["-o", "whole"]].concat()).expect(0);
    let left = left_by(folder, "whole");
    assert!(left.iter().any(|(name, _)| name.ends_with("g01.toml")));
    left
}

#[test]
fn threads_and_interruption_change_no_byte() {
    let folder = Folder::new("search");
    let expected = whole(&folder);
    let args = ["optimise", "gait", "-s", "small.toml", "-j", "2"];
    rb(&folder, &[&args[..], &["-o", "threads"]].concat()).expect(0);
    assert_same(&folder, "threads", &expected);

    let cut = command(&folder, &[&args[..], &["-o", "cut"]].concat());
    signalled(cut, "-TERM", &folder, "cut").expect(130);
    let resume = ["optimise", "gait", "-o", "cut", "--resume", "-j", "1"];
    rb(&folder, &resume).expect(0);
    assert_same(&folder, "cut", &expected);

    // Killed outright: the checkpoint is old or new, never half.
    let killed = command(&folder, &[&args[..], &["-o", "killed"]].concat());
    assert_ne!(signalled(killed, "-KILL", &folder, "killed").code, 0);
    let resume = ["optimise", "gait", "-o", "killed", "--resume"];
    rb(&folder, &resume).expect(0);
    assert_same(&folder, "killed", &expected);
}

#[test]
fn a_resumed_search_keeps_its_settings_and_can_be_made_longer() {
    let folder = Folder::new("longer");
    let expected = whole(&folder);
    let short = [
        "optimise",
        "gait",
        "-s",
        "small.toml",
        "-o",
        "short",
        "--iterations",
        "7",
    ];
    rb(&folder, &short).expect(0);
    let resume = ["optimise", "gait", "-o", "short", "--resume"];
    let other = rb(&folder, &[&resume[..], &["--seed", "2"]].concat()).expect(2);
    assert!(other.err.contains("--resume"), "{}", other.err);
    rb(
        &folder,
        &[&resume[..], &["--iterations", ITERATIONS]].concat(),
    )
    .expect(0);
    assert_same(&folder, "short", &expected);
}

/// A search on another structure: its gaits have as many oscillators as the robot has motors, and a resumed search knows the robot.
#[test]
fn another_robot_is_searched_and_resumed() {
    let folder = Folder::new("module");
    folder.write("small.toml", SETTINGS);
    let module = format!("{}/../robots/module.toml", env!("CARGO_MANIFEST_DIR"));
    let args = ["optimise", "gait", "-s", "small.toml", "--robot", &module];
    rb(&folder, &[&args[..], &["-o", "whole"]].concat()).expect(0);
    let cut = [&args[..], &["-o", "cut", "--iterations", "9"]].concat();
    rb(&folder, &cut).expect(0);
    let resume = ["optimise", "gait", "-o", "cut", "--resume"];
    let more = ["--iterations", ITERATIONS];
    rb(&folder, &[&resume[..], &more].concat()).expect(0);
    assert_same(&folder, "cut", &left_by(&folder, "whole"));
    let found = std::fs::read_to_string(folder.path("whole/gaits/g01.toml")).unwrap();
    assert_eq!(found.matches("[[oscillator]]").count(), 3, "{found}");
    // Speeds for six joints do not fit a robot with three.
    let six = "joint_speed_rad_s = [2.5, 1.5, 2.5, 2.5, 1.5, 2.5]";
    let text = SETTINGS.replace("[space]", &format!("[space]\n{six}"));
    folder.write("small.toml", text);
    let refused = rb(&folder, &[&args[..], &["-o", "six"]].concat()).expect(3);
    assert!(refused.err.contains("6 entries"), "{}", refused.err);
}

/// Needs a build with `--features mpi` and OpenMPI's `mpirun`; `cargo xtask test` runs it where both are to be had.
#[cfg(feature = "mpi")]
mod mpi {
    use super::*;

    /// rb-host in `size` processes, more than there are cores if need be, also as root as in a container.
    fn mpirun(folder: &Folder, size: &str, args: &[&str]) -> Command {
        let inner = command(folder, &[]);
        let mut outer = Command::new("mpirun");
        outer
            .args(["-n", size, "--allow-run-as-root", "--oversubscribe"])
            .arg(inner.get_program())
            .args(["optimise", "gait", "--engine", "mpi", "-j", "1"])
            .args(args)
            .current_dir(folder.path(""))
            .env("NO_COLOR", "1");
        outer
    }

    #[test]
    fn mpi_processes_change_no_byte() {
        let folder = Folder::new("mpi");
        let expected = whole(&folder);
        for size in ["1", "2", "3"] {
            let name = format!("ranks{size}");
            let mut run = mpirun(&folder, size, &["-s", "small.toml", "-o", &name]);
            finish(run.output().unwrap()).expect(0);
            assert_same(&folder, &name, &expected);
        }
    }

    #[test]
    fn mpi_interrupted_and_resumed_changes_no_byte() {
        let folder = Folder::new("mpi-cut");
        let expected = whole(&folder);
        // One process is told to stop; all must end together, and the job must say that it was stopped.
        let args = ["-s", "small.toml", "-o", "limit", "--time-limit", "0s"];
        finish(mpirun(&folder, "2", &args).output().unwrap()).expect(130);
        let cut = mpirun(&folder, "2", &["-s", "small.toml", "-o", "cut"]);
        assert_ne!(signalled(cut, "-TERM", &folder, "cut").code, 0);
        for name in ["limit", "cut"] {
            let mut again = mpirun(&folder, "2", &["-o", name, "--resume"]);
            finish(again.output().unwrap()).expect(0);
            assert_same(&folder, name, &expected);
        }
    }

    #[test]
    fn mpi_a_process_that_cannot_start_ends_the_others() {
        let folder = Folder::new("mpi-refused");
        folder.write("small.toml", SETTINGS);
        let args = ["-s", "small.toml", "-o", "done", "--iterations", "1"];
        finish(mpirun(&folder, "2", &args).output().unwrap()).expect(0);
        let again = finish(mpirun(&folder, "2", &args).output().unwrap());
        assert_ne!(again.code, 0);
        assert!(
            again.err.contains("already holds a search"),
            "{}",
            again.err
        );
    }
}
