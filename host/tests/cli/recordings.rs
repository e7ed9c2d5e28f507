//! The main job on the emulated robot, and what becomes of its recording when it is damaged.

use host::recording::{DamageKind, Recording, parse};

use crate::rig::{Folder, gait, rb};

fn record(folder: &Folder, name: &str, args: &[&str]) -> Vec<u8> {
    let gait = gait("crawl.toml");
    rb(
        folder,
        &[&["-p", "sim:", "run", &gait, "-r", name], args].concat(),
    )
    .expect(0);
    std::fs::read(folder.path(name)).unwrap()
}

fn samples(recording: &Recording) -> usize {
    recording.runs.iter().map(|r| r.samples.len()).sum()
}

#[test]
fn main_job_upload_run_30_s_record_plot() {
    let folder = Folder::new("main-job");
    rb(&folder, &["-p", "sim:", "upload", &gait("crawl.toml")]).expect(0);
    let bytes = record(&folder, "crawl.mcap", &["-d", "30s"]);
    let recording = parse(&bytes);
    let run = &recording.runs[0];
    let end = run.end.as_ref().unwrap();
    assert_eq!(
        (
            end.reason.as_str(),
            end.cycles,
            end.dropped_by_module,
            end.lost_on_link
        ),
        ("completed", 600, 0, 0)
    );
    assert!(recording.damage.is_empty());
    // Set-points are the gait's own, as `rec check` computes them with the law.
    rb(&folder, &["rec", "check", "crawl.mcap"]).expect(0);
    // Joints follow: at 43 % of the no-load speed no joint may stay behind by a quarter of its swing.
    for (k, amplitude_deg) in [20.0, 40.0, 35.0, 35.0, 40.0, 20.0].into_iter().enumerate() {
        let mean = |f: &dyn Fn(&host::recording::SampleRow) -> f64| {
            run.samples.iter().map(f).sum::<f64>() / run.samples.len() as f64
        };
        let rms = mean(&|s| {
            (s.joints[k].setpoint_rad - s.joints[k].feedback.unwrap().position_rad).powi(2)
        })
        .sqrt();
        assert!(
            rms.to_degrees() < amplitude_deg / 4.0,
            "joint {k}: {} deg",
            rms.to_degrees()
        );
    }
    rb(&folder, &["rec", "plot", "crawl.mcap"]).expect(0);
    let picture = std::fs::read_to_string(folder.path("crawl.svg")).unwrap();
    for words in ["crawl", "A.M0", "B.M2", "bus voltage", "completed"] {
        assert!(picture.contains(words), "{words}");
    }
    dataset_reads_back(&folder, run.samples.len());
}

/// The data set folder is what the data set reader takes.
fn dataset_reads_back(folder: &Folder, samples: usize) {
    rb(
        folder,
        &[
            "rec",
            "convert",
            "crawl.mcap",
            "--to",
            "dataset",
            "-o",
            "set",
        ],
    )
    .expect(0);
    let text = std::fs::read_to_string(folder.path("set/dataset.toml")).unwrap();
    let (manifest, _) = files::dataset::Manifest::parse("dataset.toml", &text).unwrap();
    assert_eq!(
        (manifest.runs.len(), manifest.runs[0].gait.as_str()),
        (1, "crawl")
    );
    let csv = std::fs::read_to_string(folder.path("set/run01.csv")).unwrap();
    let rows = csv.lines().count();
    assert!(rows > 600 && rows < 2 * samples, "{rows} rows");
    let header = csv.lines().next().unwrap();
    for column in [
        "t_s",
        "bus_v",
        "setpoint_rad_0",
        "applied_setpoint_rad_5",
        "enable_3",
        "temperature_c_2",
        "duty_4",
    ] {
        assert!(header.split(',').any(|c| c == column), "{column}");
    }
}

#[test]
fn same_command_same_bytes() {
    let folder = Folder::new("same");
    let a = record(&folder, "a.mcap", &["-d", "3s"]);
    let b = record(&folder, "b.mcap", &["-d", "3s"]);
    assert_eq!(a, b);
}

#[test]
fn repeats_and_100_hz_are_recorded_whole() {
    let folder = Folder::new("repeat");
    let bytes = record(
        &folder,
        "r.mcap",
        &["-d", "2s", "--repeat", "3", "--rate", "100"],
    );
    let recording = parse(&bytes);
    assert_eq!(recording.runs.len(), 3);
    assert!(
        recording
            .runs
            .iter()
            .all(|r| r.samples.len() > 200 && r.end.is_some())
    );
    rb(&folder, &["rec", "check", "r.mcap"]).expect(0);
}

#[test]
fn an_existing_recording_is_not_overwritten() {
    let folder = Folder::new("exists");
    folder.write("o.mcap", "precious");
    let done = rb(
        &folder,
        &[
            "-p",
            "sim:",
            "run",
            &gait("crawl.toml"),
            "-d",
            "1s",
            "-r",
            "o.mcap",
        ],
    )
    .expect(2);
    assert!(done.err.contains("--force"), "{}", done.err);
    assert_eq!(std::fs::read(folder.path("o.mcap")).unwrap(), b"precious");
}

/// A recording cut anywhere gives back every record before the cut, and says where it ends.
#[test]
fn a_cut_recording_reads_up_to_the_cut() {
    let folder = Folder::new("cut");
    let bytes = record(&folder, "c.mcap", &["-d", "2s"]);
    let whole = samples(&parse(&bytes));
    let mut before = 0;
    for cut in (0..bytes.len()).step_by(61) {
        let recording = parse(&bytes[..cut]);
        let now = samples(&recording);
        assert!(
            now >= before,
            "cut at {cut}: {now} samples, {before} at an earlier cut"
        );
        before = now;
        let damage = recording.damage.last().unwrap();
        assert!(damage.offset <= cut as u64, "{damage:?}");
        assert!(
            matches!(
                damage.kind,
                DamageKind::Cut | DamageKind::NotClosed | DamageKind::End
            ),
            "{cut}: {damage:?}"
        );
    }
    assert_eq!(before, whole);
}

/// One wrong byte anywhere is found or harmless; nothing panics, and no sample that was not recorded appears.
#[test]
fn a_wrong_byte_never_invents_samples() {
    let folder = Folder::new("flip");
    let mut bytes = record(&folder, "f.mcap", &["-d", "1s"]);
    let truth = parse(&bytes);
    let known: std::collections::BTreeSet<u64> =
        truth.runs[0].samples.iter().map(|s| s.t_us).collect();
    for at in (0..bytes.len()).step_by(41) {
        bytes[at] ^= 0x5a;
        let read = parse(&bytes);
        for sample in read.runs.iter().flat_map(|r| &r.samples) {
            assert!(known.contains(&sample.t_us), "byte {at}");
        }
        bytes[at] ^= 0x5a;
    }
}

#[test]
fn files_that_are_no_recording_exit_3_or_8() {
    let folder = Folder::new("no-mcap");
    folder.write("text.mcap", "hello");
    folder.write("empty.mcap", "");
    rb(&folder, &["rec", "info", "text.mcap"]).expect(3);
    rb(&folder, &["rec", "check", "empty.mcap"]).expect(8);
    rb(&folder, &["rec", "info", "absent.mcap"]).expect(3);
}
