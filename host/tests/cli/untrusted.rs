//! Files that others wrote: they do not steer the terminal, lead out of their folder, or stop a command; other programs' are named.

use std::path::Path;
use std::process::Command;

use crate::rig::{Folder, command, rb};

#[test]
fn text_of_files_does_not_steer_the_terminal() {
    let folder = Folder::new("escapes");
    std::fs::create_dir(folder.path("set")).unwrap();
    let head = "format = 1\nrobot = \"bench\"\n[bench]\n";
    let run = "[[run]]\nfile = \"a.csv\"\n";
    let bad = "\u{1b}]0;title\u{7}\u{9b}31m\u{202e}";
    let csv = "t_s,setpoint_rad,position_rad\n0,0,0\n0.1,0,0\n";
    folder.write("model.toml", format!("\"{bad}\" = 3\n"));
    folder.write("s.toml", "format = 1\n\"\\u001b[2J\" = 3\n");
    let key = "\"\\u001b]0;title\\u0007\\u009b31m\\u202e\" = 1\n";
    let sets = [
        (format!("{head}{key}{run}"), csv.to_owned()),
        (
            format!("{head}[[run]]\nfile = \"x\\u001b]0;title\\u0007.csv\"\n"),
            csv.to_owned(),
        ),
        (
            format!("{head}{run}"),
            csv.replacen("t_s", &format!("{bad},t_s"), 1),
        ),
    ];
    for (manifest, csv) in sets {
        folder.write("set/dataset.toml", manifest);
        folder.write("set/a.csv", csv);
        for args in [
            &["rec", "check", "set"][..],
            &["rec", "check", "set", "--json"],
            &["gap", "report", "set", "--time-limit", "0s"],
            &["model", "check", "model.toml"],
            &["-p", "sim:s.toml", "info"],
        ] {
            let done = rb(&folder, args);
            let steers = |c: char| (c.is_control() && c != '\n') || c == '\u{202e}';
            for text in [&done.out, &done.err] {
                assert!(!text.contains(steers), "{args:?}: {text:?}");
            }
        }
    }
}

#[cfg(unix)]
#[test]
fn a_data_set_reads_regular_files_of_its_own_folder_only() {
    let folder = Folder::new("paths");
    std::fs::create_dir(folder.path("set")).unwrap();
    folder.write(
        "secret.csv",
        "t_s,setpoint_rad,position_rad\n0,0,0\n0.1,0,0\n",
    );
    for pipe in ["set/pipe.csv", "set/model.toml", "pipe"] {
        let made = Command::new("mkfifo")
            .arg(folder.path(pipe))
            .status()
            .unwrap();
        assert!(made.success());
    }
    for (run, words) in [
        (
            "file = \"/dev/zero\"",
            "dataset.toml:4: `run.file` must be a path inside",
        ),
        (
            "file = \"../secret.csv\"",
            "dataset.toml:4: `run.file` must be a path inside",
        ),
        ("file = \"sub/../../secret.csv\"", "must be a path inside"),
        (
            "file = \"a.csv\"\nframes = \"/tmp\"",
            "`run.frames` must be a path inside",
        ),
        (
            "file = \"pipe.csv\"",
            "pipe.csv: this is a folder, a device or a pipe",
        ),
        ("file = \".\"", ".: this is a folder"),
        (
            "file = \"a.csv\"\n[metamodule]\nmodel = \"/dev/zero\"",
            "`metamodule.model` must be a path inside",
        ),
    ] {
        let manifest = format!("format = 1\nrobot = \"metamodule\"\n[[run]]\n{run}\n");
        folder.write("set/dataset.toml", manifest);
        let done = rb(&folder, &["gap", "report", "set"]).expect(3);
        assert!(done.err.contains(words), "{run}: {}", done.err);
        let checked = rb(&folder, &["rec", "check", "set"]).expect(8);
        assert!(checked.out.contains(words), "{run}: {}", checked.out);
    }
    // The model of the set is a pipe.
    let manifest = "format = 1\nrobot = \"metamodule\"\n[metamodule]\nmodel = \"model.toml\"\n[[run]]\nfile = \"a.csv\"\n";
    folder.write("set/dataset.toml", manifest);
    let checked = rb(&folder, &["rec", "check", "set"]).expect(8);
    assert!(
        checked
            .out
            .contains("model.toml: this is a folder, a device or a pipe"),
        "{}",
        checked.out
    );
    // A device that a person names has an end too.
    rb(&folder, &["model", "check", "/dev/zero"]).expect(3);
    rb(&folder, &["gap", "report", "/dev/zero"]).expect(3);
    // A pipe that a person names is waited for, until a signal comes.
    let mut child = command(&folder, &["gait", "check", "pipe"])
        .spawn()
        .unwrap();
    std::thread::sleep(std::time::Duration::from_millis(300));
    let id = child.id().to_string();
    Command::new("kill").args(["-TERM", &id]).status().unwrap();
    assert!(!child.wait().unwrap().success());
}

#[cfg(unix)]
#[test]
fn no_file_of_a_data_set_is_a_link_that_leads_out_of_it() {
    use std::os::unix::fs::symlink;

    let folder = Folder::new("links");
    std::fs::create_dir_all(folder.path("set/film")).unwrap();
    std::fs::create_dir_all(folder.path("set/gaits")).unwrap();
    std::fs::create_dir(folder.path("outside")).unwrap();
    let csv = "t_s,setpoint_rad_0,position_rad_0\n0,0,0\n0.1,0,0\n";
    folder.write("outside/a.csv", csv);
    folder.write("outside/model.toml", rb(&folder, &["model", "show"]).out);
    folder.write("outside/index.csv", "t_s,file\n0,0.png\n");
    folder.write("set/in.csv", csv);
    folder.write("set/film/index.csv", "t_s,file\n0,0.png\n");
    for (link, target) in [
        ("set/a.csv", "../outside/a.csv"),
        ("set/b.csv", "folder/a.csv"),
        ("set/folder", "../outside"),
        ("set/model.toml", "../outside/model.toml"),
        ("set/film/0.png", "../../outside/a.csv"),
        ("set/gaits/g.toml", "../../outside/a.csv"),
        ("set/c.csv", "/etc/hostname"),
        ("set/inside.csv", "in.csv"),
    ] {
        symlink(target, folder.path(link)).unwrap();
    }
    let out = "the name leads out of the folder of the data set";
    for (run, more) in [
        ("a.csv", ""),
        ("b.csv", ""),
        ("folder/a.csv", ""),
        ("c.csv", ""),
        ("in.csv", "frames = \"folder\"\n"),
        ("in.csv", "frames = \"film\"\n"),
        ("in.csv", "[metamodule]\nmodel = \"model.toml\"\n"),
        ("in.csv", "[metamodule]\nmodel = \"folder/model.toml\"\n"),
    ] {
        let manifest =
            format!("format = 1\nrobot = \"metamodule\"\n[[run]]\nfile = \"{run}\"\n{more}");
        folder.write("set/dataset.toml", &manifest);
        let done = rb(&folder, &["gap", "report", "set"]).expect(3);
        assert!(done.err.contains(out), "{manifest}: {}", done.err);
        rb(&folder, &["rec", "check", "set"]).expect(8);
    }
    // A gait of the set, and a link that stays inside.
    let manifest =
        "format = 1\nrobot = \"metamodule\"\n[[run]]\nfile = \"inside.csv\"\ngait = \"g\"\n";
    folder.write("set/dataset.toml", manifest);
    let checked = rb(&folder, &["rec", "check", "set"]).expect(0);
    assert!(checked.out.contains("2 rows"), "{}", checked.out);
}

/// An MCAP as another program writes it.
fn foreign(path: &Path, compression: Option<mcap::Compression>) {
    let options = mcap::WriteOptions::new().compression(compression);
    let file = std::io::BufWriter::new(std::fs::File::create(path).unwrap());
    let mut writer = options.create(file).unwrap();
    for topic in ["/joint_states", "/joint_command"] {
        let channel = writer
            .add_channel(0, topic, "json", &std::collections::BTreeMap::new())
            .unwrap();
        for k in 0..50 {
            let header = mcap::records::MessageHeader {
                channel_id: channel,
                sequence: k,
                log_time: u64::from(k) * 1_000_000,
                publish_time: 0,
            };
            writer
                .write_to_known_channel(&header, b"{\"position\":[0,0,0,0,0,0]}")
                .unwrap();
        }
    }
    writer.finish().unwrap();
}

#[test]
fn recordings_of_other_programs_are_named_in_every_compression() {
    let folder = Folder::new("foreign-mcap");
    std::fs::create_dir(folder.path("bag")).unwrap();
    for compression in [
        None,
        Some(mcap::Compression::Lz4),
        Some(mcap::Compression::Zstd),
    ] {
        foreign(&folder.path("bag/bag.mcap"), compression);
        let info = rb(&folder, &["rec", "info", "bag/bag.mcap", "--json"])
            .expect(0)
            .json();
        assert_eq!(info["damage"], serde_json::json!([]), "{compression:?}");
        assert_eq!(info["channels"][0]["messages"], 50, "{compression:?}");
        for args in [
            &["gap", "report", "bag"][..],
            &["gap", "report", "bag/bag.mcap"],
            &["rec", "plot", "bag/bag.mcap"],
        ] {
            let done = rb(&folder, args).expect(3);
            let words = "MCAP file of another program (topics: /joint_command, /joint_states)";
            assert!(done.err.contains(words), "{args:?}: {}", done.err);
        }
    }
}
