//! `rb-host camera` from the outside: foreign recordings in, silhouettes, figures and pictures out.

use std::fmt::Write as _;

use camera::depth::{DepthFrame, NO_READING};
use camera::{Silhouette, View, picture};
use control::kinematics;
use control::linalg::{Pose, Vec3};
use control::robot::RobotModel;

use crate::rig::{Folder, gait, rb};

const SIZE: (usize, usize) = (160, 120);
const FRAMES: usize = 12;

/// The robot lying straight, `x_m` along, as a small camera sees it.
fn outline(x_m: f32) -> Silhouette {
    let robot = RobotModel::default();
    let base = Pose {
        position_m: Vec3::new(x_m, 0.0, 0.055),
        ..Pose::default()
    };
    let bodies = kinematics::forward(&robot, &[0.0; 6]).rebased(3, &base);
    let view = View::new(2.27, (0.0, 0.0), 0.0, SIZE, 145.0).unwrap();
    view.render(&camera::Solid::meta_module(&robot), bodies.bodies())
}

/// Where the robot is in frame `k`: from 0.9 m left to 0.9 m right.
fn along_m(k: usize) -> f32 {
    -0.9 + 1.8 * k as f32 / (FRAMES - 1) as f32
}

/// Depth as a Kinect 2.27 m up has it: ground at 941 with a unit of noise, a lying robot's top 7 units closer, pixels without reading.
fn depth(robot: Option<&Silhouette>) -> DepthFrame {
    let raw = |i: usize| match robot {
        _ if i.is_multiple_of(397) => NO_READING,
        Some(robot) if robot.get(i % SIZE.0, i / SIZE.0) => 934,
        _ => 940 + (i % 3) as u16,
    };
    DepthFrame {
        width: SIZE.0,
        height: SIZE.1,
        raw: (0..SIZE.0 * SIZE.1).map(raw).collect(),
    }
}

/// A dump as fakenect-record leaves it: little-endian samples behind a PGM header, colour and accelerometer lines between.
fn dump(folder: &Folder, name: &str, robots: &[Option<Silhouette>]) {
    std::fs::create_dir_all(folder.path(name)).unwrap();
    let mut index = String::new();
    for (k, robot) in robots.iter().enumerate() {
        let file = format!("d-{:.6}-{}.pgm", 1_325_000_000.5 + k as f64 / 30.0, k);
        let mut bytes = format!("P5 {} {} 65535\n", SIZE.0, SIZE.1).into_bytes();
        let frame = depth(robot.as_ref());
        bytes.extend(frame.raw.iter().flat_map(|raw| raw.to_le_bytes()));
        folder.write(&format!("{name}/{file}"), bytes);
        let _ = writeln!(
            index,
            "r-1325000000.2-{k}.ppm\n{file}\na-1325000000.3-{k}.dump"
        );
    }
    folder.write(&format!("{name}/INDEX.txt"), index);
}

fn robots() -> Vec<Option<Silhouette>> {
    (0..FRAMES).map(|k| Some(outline(along_m(k)))).collect()
}

fn silhouette_of(folder: &Folder, name: &str) -> Silhouette {
    picture::read_silhouette_png(&std::fs::read(folder.path(name)).unwrap()).unwrap()
}

#[test]
fn a_kinect_dump_becomes_the_silhouettes_of_the_robot() {
    let folder = Folder::new("kinect");
    dump(&folder, "run", &robots());
    dump(&folder, "empty", &[None, None, None]);
    for (source, output) in [("run", "depth"), ("empty", "scene")] {
        rb(&folder, &["camera", "import", source, "-o", output]).expect(0);
    }
    rb(
        &folder,
        &["camera", "background", "scene", "-o", "ground.pgm"],
    )
    .expect(0);
    // From the empty scene, and from the run itself, in which no pixel shows the robot for half of the time.
    let cut = [
        "camera",
        "silhouette",
        "depth",
        "-o",
        "film",
        "--background",
        "ground.pgm",
        "--json",
    ];
    let done = rb(&folder, &cut).expect(0);
    assert_eq!(
        (
            done.json()["frames"].as_u64(),
            done.json()["empty"].as_u64()
        ),
        (Some(12), Some(0))
    );
    rb(&folder, &["camera", "silhouette", "depth", "-o", "median"]).expect(0);
    for film in ["film", "median"] {
        for k in [0, 5, 11] {
            let found = silhouette_of(&folder, &format!("{film}/{k:05}.png"));
            let (overlap, union) = found.overlap_and_union_px(&outline(along_m(k))).unwrap();
            assert!(
                f64::from(overlap) > 0.97 * f64::from(union),
                "{film} {k}: {overlap} of {union}"
            );
        }
    }
    let index = std::fs::read_to_string(folder.path("film/index.csv")).unwrap();
    assert!(
        index.starts_with("t_s,file\n0.000000,00000.png\n0.033333,00001.png\n"),
        "{index}"
    );
}

#[test]
fn folders_of_pictures_are_imported_as_what_they_are() {
    let folder = Folder::new("folders");
    std::fs::create_dir(folder.path("png")).unwrap();
    std::fs::create_dir(folder.path("deep")).unwrap();
    for k in 0..3 {
        let frame = outline(along_m(k));
        folder.write(
            &format!("png/f{k}.png"),
            picture::silhouette_png(&frame).unwrap(),
        );
        folder.write(&format!("deep/f{k}.png"), depth_png(&depth(Some(&frame))));
    }
    let import = |source: &str, output: &str| {
        rb(
            &folder,
            &[
                "camera", "import", source, "-o", output, "--rate", "10", "--json",
            ],
        )
        .expect(0)
        .json()
    };
    let film = import("png", "film");
    assert_eq!(
        (film["kind"].as_str(), film["length_s"].as_f64()),
        (Some("silhouettes"), Some(0.2))
    );
    assert_eq!(
        silhouette_of(&folder, "film/00002.png"),
        outline(along_m(2))
    );
    assert_eq!(import("deep", "depth")["kind"], "depth frames");
    let bytes = std::fs::read(folder.path("depth/00001.pgm")).unwrap();
    let read = camera::depth::read_pgm(&bytes, camera::depth::Samples::BigEndian).unwrap();
    assert_eq!(read, depth(Some(&outline(along_m(1)))));
}

/// A 16-bit grey PNG, as recorders of other depth cameras write.
fn depth_png(frame: &DepthFrame) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, frame.width as u32, frame.height as u32);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Sixteen);
    let data: Vec<u8> = frame.raw.iter().flat_map(|raw| raw.to_be_bytes()).collect();
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(&data).unwrap();
    drop(writer);
    bytes
}

/// Writes a film folder of the robot at these places.
fn film(folder: &Folder, name: &str, places_m: &[f32]) {
    std::fs::create_dir(folder.path(name)).unwrap();
    let mut index = "t_s,file\n".to_owned();
    for (k, x_m) in places_m.iter().enumerate() {
        folder.write(
            &format!("{name}/{k}.png"),
            picture::silhouette_png(&outline(*x_m)).unwrap(),
        );
        let _ = writeln!(index, "{},{k}.png", k as f64 / 30.0);
    }
    folder.write(&format!("{name}/index.csv"), index);
}

#[test]
fn two_films_are_compared_and_drawn() {
    let folder = Folder::new("pair");
    film(&folder, "robot", &[0.0, 0.1, 0.2, 0.3]);
    film(&folder, "sim", &[-0.1, 0.0, 0.1, 0.2, 0.3]);
    let done = rb(
        &folder,
        &["camera", "compare", "robot", "sim", "-o", "r.csv", "--json"],
    )
    .expect(0)
    .json();
    let (overlap, union) = outline(0.0).overlap_and_union_px(&outline(-0.1)).unwrap();
    let first = done["r_per_frame"][0].as_f64().unwrap();
    assert!((first - f64::from(overlap) / f64::from(union)).abs() < 1e-12);
    let csv = std::fs::read_to_string(folder.path("r.csv")).unwrap();
    assert_eq!(csv.lines().count(), 5);
    // One frame later the simulation is where the robot is.
    let shifted = [
        "camera", "compare", "robot", "sim", "--shift", "33ms", "--json",
    ];
    assert_eq!(rb(&folder, &shifted).expect(0).json()["r"], 1.0);

    let draw = |args: &[&str]| rb(&folder, &[&["camera"], args].concat()).expect(0);
    draw(&["overlay", "robot", "sim", "--at", "0.1", "-o", "frame.png"]);
    draw(&["strip", "robot", "sim", "--frames", "3", "-o", "strip.png"]);
    draw(&["animate", "robot", "sim", "-o", "overlay.png"]);
    draw(&["animate", "robot", "sim", "-o", "overlay.html"]);
    let info = |name: &str| {
        let bytes = std::fs::read(folder.path(name)).unwrap();
        let reader = png::Decoder::new(std::io::Cursor::new(bytes))
            .read_info()
            .unwrap();
        reader.info().clone()
    };
    assert_eq!(
        (info("frame.png").width, info("frame.png").height),
        (160, 120)
    );
    assert_eq!(
        (info("strip.png").width, info("strip.png").height),
        (480, 240)
    );
    assert_eq!(info("overlay.png").animation_control.unwrap().num_frames, 4);
    let page = std::fs::read_to_string(folder.path("overlay.html")).unwrap();
    assert_eq!(
        page.lines().filter(|line| line.starts_with("[0.")).count(),
        4
    );
    assert!(!page.contains("http"), "the page needs the network");
}

/// R, R_H, W and F_meta of a data set whose robot is the model that is asked.
#[test]
fn a_data_set_compares_with_the_model_that_made_it() {
    let folder = Folder::new("set");
    let model = files::model::Model::hand_tuned();
    let mut exact = model.clone();
    exact.set(files::model::Key::CpgNoise, 0.0).unwrap();
    folder.write("exact.toml", exact.to_toml());
    let args = [
        "sim",
        "--camera",
        "--repeat",
        "2",
        "-d",
        "3s",
        "-m",
        "exact.toml",
        "-o",
        "set",
    ];
    rb(
        &folder,
        &[&args[..], &[&gait("crawl.toml"), &gait("roll.toml")]].concat(),
    )
    .expect(0);
    let done = rb(
        &folder,
        &["camera", "compare", "set", "-m", "exact.toml", "--json"],
    )
    .expect(0)
    .json();
    for row in done["gaits"].as_array().unwrap() {
        assert_eq!(row["r_h"], 1.0, "{row}");
        assert!(row["r"].as_f64().unwrap() > 0.99, "{row}");
        let product = row["mean_speed_m_s"].as_f64().unwrap() * row["r_h"].as_f64().unwrap();
        assert_eq!(row["w_gait"].as_f64(), Some(product));
    }
    assert!(done["f_meta"].as_f64().unwrap() > 0.99);
    // The same through pictures: the run filmed again by the model is the film.
    let simulate = [
        "camera",
        "simulate",
        "set",
        "--run",
        "roll_1",
        "-m",
        "exact.toml",
        "-o",
        "again",
    ];
    rb(&folder, &simulate).expect(0);
    let same = rb(
        &folder,
        &["camera", "compare", "set/roll_1", "again", "--json"],
    )
    .expect(0)
    .json();
    assert!(
        same["r"].as_f64().unwrap() > 0.99 && same["frames"] == 90,
        "{same}"
    );
}

#[test]
fn camera_commands_say_what_is_wrong() {
    let folder = Folder::new("camera-bad");
    film(&folder, "robot", &[0.0, 0.1]);
    dump(&folder, "short", &robots()[..2]);
    std::fs::create_dir(folder.path("void")).unwrap();
    let listed = std::fs::read_to_string(folder.path("short/INDEX.txt")).unwrap();
    let second = listed
        .lines()
        .filter(|l| l.starts_with("d-"))
        .nth(1)
        .unwrap()
        .to_owned();
    let path = folder.path("short").join(&second);
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..500]).unwrap();
    let cases: [(&[&str], i32, &str); 11] = [
        (&["import", "nowhere", "-o", "a"], 3, "nowhere"),
        (&["import", "void", "-o", "a"], 3, "no depth frame"),
        (&["import", "short", "-o", "a"], 3, "cut short"),
        (&["import", "robot", "-o", "a", "--rate", "0"], 2, "--rate"),
        (&["import", "robot", "-o", "robot"], 2, "not empty"),
        (&["background", "robot", "-o", "g.pgm"], 3, "0.png"),
        (&["silhouette", "void", "-o", "b"], 3, "index.csv"),
        (
            &["overlay", "robot", "robot", "--at", "9s", "-o", "x.png"],
            2,
            "in common",
        ),
        (&["animate", "robot", "robot", "-o", "x.gif"], 2, ".html"),
        (&["compare", "robot"], 3, "dataset.toml"),
        (&["compare", "robot", "void"], 3, "index.csv"),
    ];
    for (args, code, word) in cases {
        let done = rb(&folder, &[&["camera"], args].concat()).expect(code);
        assert!(done.err.contains(word), "{args:?}: {}", done.err);
    }
}
