//! Hostile variants of every kind of file: seeded mutations of good ones, and cases by hand.

use std::process::Command;
use std::sync::atomic::{AtomicUsize, Ordering};

use fuzz::{Mutator, seeds};

use crate::rig::{Done, Folder, command, finish, gait, rb};

/// Seeded mutations of each kind.
const MUTATIONS: usize = 260;
/// Private memory a command may have, KiB, and its processor time, s: set by the system, so an excess is a death.
const MEMORY_KIB: u32 = 512 * 1024;
const PROCESSOR_S: u32 = 20;
/// Exit codes that the command line promises; a death by a signal or a panic is none of them.
const CODES: [i32; 8] = [0, 1, 2, 3, 4, 5, 7, 8];

/// Runs a command under the limits and looks at what it says.
fn limited(folder: &Folder, args: &[&str], what: &dyn std::fmt::Display) -> Done {
    let script =
        format!("ulimit -d {MEMORY_KIB}; ulimit -t {PROCESSOR_S}; ulimit -c 0; exec \"$0\" \"$@\"");
    let inner = command(folder, args);
    let mut outer = Command::new("sh");
    outer
        .arg("-c")
        .arg(script)
        .arg(inner.get_program())
        .args(args);
    for (name, value) in inner.get_envs() {
        match value {
            Some(value) => outer.env(name, value),
            None => outer.env_remove(name),
        };
    }
    outer.env("RAYON_NUM_THREADS", "2");
    outer
        .current_dir(folder.path("."))
        .stdin(std::process::Stdio::null());
    let done = finish(outer.output().unwrap());
    let steers = |c: char| (c.is_control() && c != '\n' && c != '\t') || c == '\u{202e}';
    assert!(CODES.contains(&done.code), "{what}: {args:?}: {done:?}");
    for text in [&done.out, &done.err] {
        assert!(!text.contains("panicked"), "{what}: {args:?}: {text}");
        assert!(!text.contains(steers), "{what}: {args:?}: {text:?}");
    }
    done
}

/// A kind of file: a good one, and what reads it.
struct Kind {
    name: &'static str,
    /// Where the variant is written.
    file: &'static str,
    good: Vec<Vec<u8>>,
    text: bool,
    commands: Vec<Vec<&'static str>>,
}

const BENCH: &str = "format = 1\nrobot = \"bench\"\n[bench]\nsupply_v = { value = 7.4, tolerance = 0.05 }\n[[run]]\nfile = \"a.csv\"\n";
const COLUMNS: &str = "t_s,setpoint_rad,position_rad,duty\n0,0,0,0\n0.01,0.1,0.02,0.3\n0.02,0.1,0.05,0.2\n0.03,0.1,0.08,0.1\n";
const FILMED: &str =
    "format = 1\nrobot = \"metamodule\"\n[[run]]\nfile = \"a.csv\"\nframes = \"film\"\n";

fn kinds(folder: &Folder) -> Vec<Kind> {
    let crawl = gait("crawl.toml");
    rb(
        folder,
        &["-p", "sim:", "run", &crawl, "-d", "1s", "-r", "good.mcap"],
    )
    .expect(0);
    let film = ["sim", &crawl, "-d", "1s", "--camera", "-o", "filmed"];
    rb(folder, &film).expect(0);
    let frames = std::fs::read_dir(folder.path("filmed")).unwrap().flatten();
    let film = frames
        .map(|e| e.path())
        .find(|p| p.join("index.csv").exists())
        .unwrap();
    for set in ["csv", "dataset", "index", "pictures"] {
        std::fs::create_dir_all(folder.path(set).join("film")).unwrap();
        folder.write(&format!("{set}/a.csv"), COLUMNS);
        let manifest = if set == "index" { FILMED } else { BENCH };
        folder.write(&format!("{set}/dataset.toml"), manifest);
        for entry in std::fs::read_dir(&film).unwrap().flatten() {
            std::fs::copy(
                entry.path(),
                folder.path(set).join("film").join(entry.file_name()),
            )
            .unwrap();
        }
    }
    folder.write(
        "index/a.csv",
        COLUMNS.replace("_rad", "_rad_0").replace("duty", "duty_0"),
    );
    let read = |name: &str| std::fs::read(folder.path(name)).unwrap();
    let picture = std::fs::read(film.join("00000.png")).unwrap();
    let mut manifests = seeds::of("dataset");
    manifests.push(BENCH.into());
    let text = |name, file, good, commands| Kind {
        name,
        file,
        good,
        text: true,
        commands,
    };
    vec![
        text(
            "gait",
            "f.toml",
            seeds::of("gait"),
            vec![vec!["gait", "check", "f.toml"]],
        ),
        text(
            "model",
            "m.toml",
            seeds::of("model"),
            vec![vec!["model", "check", "m.toml"]],
        ),
        text(
            "robot",
            "r.toml",
            seeds::of("structure"),
            vec![vec!["sim", "good.toml", "-d", "50ms", "--robot", "r.toml"]],
        ),
        text(
            "scenario",
            "s.toml",
            seeds::of("scenario"),
            vec![vec!["-p", "sim:s.toml", "info"]],
        ),
        text(
            "data set",
            "dataset/dataset.toml",
            manifests,
            vec![vec!["rec", "check", "dataset"]],
        ),
        text(
            "CSV",
            "csv/a.csv",
            vec![COLUMNS.into()],
            vec![
                vec!["rec", "check", "csv"],
                vec!["gap", "report", "csv", "--time-limit", "0s"],
            ],
        ),
        text(
            "index",
            "index/film/index.csv",
            vec![read("index/film/index.csv")],
            vec![
                vec!["rec", "check", "index"],
                vec!["camera", "compare", "index/film", "index/film"],
            ],
        ),
        Kind {
            name: "picture",
            file: "pictures/film/00000.png",
            good: vec![picture],
            text: false,
            commands: vec![vec!["camera", "compare", "pictures/film", "pictures/film"]],
        },
        Kind {
            name: "MCAP",
            file: "f.mcap",
            good: vec![read("good.mcap")],
            text: false,
            commands: vec![
                vec!["rec", "info", "f.mcap"],
                vec!["rec", "check", "f.mcap"],
                vec![
                    "rec", "convert", "f.mcap", "--to", "csv", "--force", "-o", "out.csv",
                ],
            ],
        },
    ]
}

/// One kind of file after the other; each variant by one of the kind's commands, in turn.
fn mutations(kind: &Kind, folder: &Folder, count: &AtomicUsize) {
    let longest = kind.good.iter().map(Vec::len).max().unwrap_or(0) + 4096;
    let mut mutator = Mutator::new(33, longest, kind.text);
    for k in 0..MUTATIONS {
        let variant = mutator.next(&kind.good);
        folder.write(kind.file, &variant);
        let args = &kind.commands[k % kind.commands.len()];
        let what = format!("{} {k}", kind.name);
        limited(folder, args, &what);
        count.fetch_add(1, Ordering::Relaxed);
    }
}

#[test]
fn thousands_of_hostile_files_end_with_an_error_and_nothing_worse() {
    let count = AtomicUsize::new(0);
    let begin = |k: usize| {
        let folder = Folder::new("hostile");
        std::fs::copy(gait("first-move.toml"), folder.path("good.toml")).unwrap();
        let kinds = kinds(&folder);
        (k < kinds.len())
            .then(|| mutations(&kinds[k], &folder, &count))
            .is_some()
    };
    // Two at a time, each kind in a folder of its own.
    let next = AtomicUsize::new(0);
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| while begin(next.fetch_add(1, Ordering::Relaxed)) {});
        }
    });
    let folder = Folder::new("by-hand");
    let cases = by_hand(&folder);
    println!(
        "{} mutations and {cases} cases by hand",
        count.load(Ordering::Relaxed)
    );
    assert!(count.into_inner() + cases >= 2000);
}

/// Files that no mutation finds: bombs, endless lists, depth, sparse files, numbers at their ends. Returns how many.
fn by_hand(folder: &Folder) -> usize {
    let mut cases = 0;
    let mut case = |file: &str, bytes: &[u8], args: &[&str]| {
        folder.write(file, bytes);
        limited(folder, args, &format!("{file} of {} bytes", bytes.len()));
        cases += 1;
    };
    std::fs::create_dir_all(folder.path("set/film")).unwrap();
    folder.write("set/dataset.toml", BENCH);
    folder.write("set/a.csv", COLUMNS);
    let check = ["rec", "check", "set"];
    let report = ["gap", "report", "set", "--time-limit", "0s"];
    for opening in [
        "[",
        "a = [",
        "a = {b = ",
        "a.",
        "[[",
        "\"",
        "a = '''",
        "{\"a\":",
    ] {
        let deep = opening.repeat(200_000).into_bytes();
        case("set/dataset.toml", &deep, &check);
        case("f.toml", &deep, &["gait", "check", "f.toml"]);
        case("f.toml", &deep, &["model", "check", "f.toml"]);
        case("s.toml", &deep, &["-p", "sim:s.toml", "info"]);
    }
    case("set/dataset.toml", BENCH.as_bytes(), &check);
    for csv in [
        format!(
            "t_s,setpoint_rad,position_rad\n{}",
            "0.1,".repeat(3_000_000)
        ),
        format!("{}\n0\n", "x,".repeat(1_000_000)),
        format!(
            "t_s,setpoint_rad,position_rad\n0,0,0\n1e300,0,0\n{}",
            "2e300,1,1\n".repeat(3)
        ),
        "t_s,setpoint_rad,position_rad\n0,1e308,-1e308\n0.1,-1e308,1e308\n0.2,1e308,0\n".into(),
        "t_s,setpoint_rad,position_rad\n-9e15,0,0\n9e15,1,1\n".into(),
        format!(
            "t_s,setpoint_rad,position_rad\n\"{}\n",
            "a".repeat(20_000_000)
        ),
    ] {
        case("set/a.csv", csv.as_bytes(), &check);
        case("set/a.csv", csv.as_bytes(), &report);
    }
    let film = ["camera", "compare", "set/film", "set/film"];
    for index in [
        "t_s,file\n1e300,0.png\n".to_owned(),
        "t_s,file\n0,0.png\n1e15,0.png\n".into(),
        format!(
            "t_s,file\n{}",
            (0..300_000)
                .map(|k| format!("{k},0.png\n"))
                .collect::<String>()
        ),
        "t_s,file\n0,../../a.csv\n".into(),
        "t_s,file\n0,/dev/zero\n".into(),
    ] {
        folder.write("set/film/0.png", png(8, 8, 1));
        case("set/film/index.csv", index.as_bytes(), &film);
    }
    folder.write("set/film/index.csv", "t_s,file\n0,0.png\n");
    for (width, height, bits) in [
        (u32::MAX, u32::MAX, 16),
        (1 << 31, 1, 1),
        (65_535, 65_535, 8),
        (4096, 4096, 16),
        (0, 0, 1),
    ] {
        case("set/film/0.png", &png(width, height, bits), &film);
    }
    for bomb in bombs() {
        case("b.mcap", &bomb, &["rec", "info", "b.mcap"]);
        case("b.mcap", &bomb, &["rec", "check", "b.mcap"]);
    }
    sparse(folder);
    cases + 3
}

/// A gigabyte of nothing, which takes no place on the disk.
fn sparse(folder: &Folder) {
    for (file, args) in [
        ("set/a.csv", &["rec", "check", "set"][..]),
        ("set/dataset.toml", &["rec", "check", "set"]),
        ("f.toml", &["gait", "check", "f.toml"]),
    ] {
        folder.write("set/dataset.toml", BENCH);
        std::fs::File::create(folder.path(file))
            .unwrap()
            .set_len(1 << 30)
            .unwrap();
        limited(folder, args, &"a sparse file");
        std::fs::remove_file(folder.path(file)).unwrap();
    }
}

/// A PNG with this header and no data.
fn png(width: u32, height: u32, bits: u8) -> Vec<u8> {
    let mut out = b"\x89PNG\r\n\x1a\n".to_vec();
    let mut header = [width.to_be_bytes(), height.to_be_bytes()].concat();
    header.extend([bits, 0, 0, 0, 0]);
    for (kind, data) in [
        (b"IHDR", &header[..]),
        (b"IDAT", &[0x78, 1, 3, 0, 0, 0, 0, 1]),
        (b"IEND", &[]),
    ] {
        out.extend((data.len() as u32).to_be_bytes());
        let body = [&kind[..], data].concat();
        out.extend(&body);
        out.extend(
            crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC)
                .checksum(&body)
                .to_be_bytes(),
        );
    }
    out
}

/// Recordings of a few hundred kilobytes that unpack to gigabytes, and lengths that no file has.
fn bombs() -> Vec<Vec<u8>> {
    let mut bombs = Vec::new();
    for (compression, sizes) in [
        (
            mcap::Compression::Zstd,
            [(1 << 20, 3000), (64 << 20, 40), (16, 2_000_000)],
        ),
        (
            mcap::Compression::Lz4,
            [(1 << 20, 1000), (64 << 20, 20), (16, 2_000_000)],
        ),
    ] {
        for (bytes, messages) in sizes {
            let options = mcap::WriteOptions::new()
                .compression(Some(compression))
                .chunk_size(Some(64 << 20));
            let mut writer = options.create(std::io::Cursor::new(Vec::new())).unwrap();
            let channel = writer
                .add_channel(0, "/zeros", "json", &std::collections::BTreeMap::new())
                .unwrap();
            let data = vec![0; bytes];
            for sequence in 0..messages {
                let header = mcap::records::MessageHeader {
                    channel_id: channel,
                    sequence,
                    log_time: 0,
                    publish_time: 0,
                };
                writer.write_to_known_channel(&header, &data).unwrap();
            }
            writer.finish().unwrap();
            bombs.push(writer.into_inner().into_inner());
        }
    }
    let magic = b"\x89MCAP0\r\n";
    let zeros = [&magic[..], &vec![0; 4 << 20]].concat();
    let length =
        |opcode: u8, length: u64| [&magic[..], &[opcode], &length.to_le_bytes(), &[0; 64]].concat();
    bombs.push(zeros);
    bombs.extend([1, 3, 4, 5, 6, 9, 12].map(|opcode| length(opcode, u64::MAX)));
    bombs.extend([1, 3, 4, 5, 6, 9, 12].map(|opcode| length(opcode, 40)));
    bombs
}
