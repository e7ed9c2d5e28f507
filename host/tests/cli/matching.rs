//! The fit of the simulator to films, from the outside: a known robot is found again, with the same bytes however it is run.

use files::model::{Key, Model};

use crate::rig::{Folder, command, gait, rb};
use crate::search::{assert_same, left_by, signalled};

/// Camera of the filmed robot; the rest of it is the shipped model, but without noise, so that repetitions are one.
const HEIGHT_M: f64 = 2.307;
const SHIFT_S: f64 = 0.89;

/// Films of two gaits, and a model that knows all but the camera.
fn film(folder: &Folder) {
    let with = |height_m: f64, shift_s: f64| {
        let mut model = Model::hand_tuned();
        model.set(Key::CpgNoise, 0.0).unwrap();
        model.set(Key::CameraHeight, height_m).unwrap();
        model.set(Key::CameraTimeShift, shift_s).unwrap();
        model.to_toml()
    };
    folder.write("robot.toml", with(HEIGHT_M, SHIFT_S));
    folder.write("blind.toml", with(2.1, 0.0));
    let args = [
        "sim",
        "--camera",
        "--repeat",
        "2",
        "-d",
        "4s",
        "-m",
        "robot.toml",
        "-o",
        "films",
    ];
    rb(
        folder,
        &[&args[..], &[&gait("crawl.toml"), &gait("paddle.toml")]].concat(),
    )
    .expect(0);
}

const FIT: [&str; 13] = [
    "optimise",
    "model",
    "films",
    "-m",
    "blind.toml",
    "--training",
    "crawl",
    "--rows",
    "21-22",
    "--particles",
    "8",
    "--iterations",
    "12",
];

#[test]
fn a_small_fit_finds_the_camera_with_the_same_bytes_however_it_is_run() {
    let folder = Folder::new("fit");
    film(&folder);
    let done = rb(
        &folder,
        &[&FIT[..], &["-o", "one", "-j", "1", "--json"]].concat(),
    )
    .expect(0);
    let fitted = std::fs::read_to_string(folder.path("one/model.toml")).unwrap();
    let fitted = Model::parse("fitted", &fitted).unwrap();
    let off = |key, truth: f64| (fitted.value(key) - truth).abs();
    assert!(off(Key::CameraHeight, HEIGHT_M) < 0.03);
    assert!(off(Key::CameraTimeShift, SHIFT_S) < 0.1);
    let table = &done.json()["table_iii"];
    let after = table["after"]["training"].as_f64().unwrap();
    assert!(
        after > table["before"]["training"].as_f64().unwrap() + 0.1 && after > 0.95,
        "{table}"
    );
    assert_eq!(table["gaits"][1]["set"], "test");
    assert!(
        table["gaits"][1]["after"].as_f64().unwrap() > 0.95,
        "{table}"
    );
    let curve = std::fs::read_to_string(folder.path("one/curve.svg")).unwrap();
    assert!(curve.contains(">best<") && curve.contains(">mean<"));

    let expected = left_by(&folder, "one");
    rb(&folder, &[&FIT[..], &["-o", "two", "-j", "2"]].concat()).expect(0);
    assert_same(&folder, "two", &expected);
    let cut = command(&folder, &[&FIT[..], &["-o", "cut", "-j", "2"]].concat());
    signalled(cut, "-TERM", &folder, "cut").expect(130);
    let resume = [
        "optimise",
        "model",
        "films",
        "-o",
        "cut",
        "--resume",
        "--iterations",
        "12",
    ];
    rb(&folder, &[&resume[..], &["-j", "1"]].concat()).expect(0);
    assert_same(&folder, "cut", &expected);
    let other = rb(&folder, &[&resume[..], &["--seed", "2"]].concat()).expect(2);
    assert!(other.err.contains("--resume"), "{}", other.err);
}

#[test]
fn a_fit_says_what_is_wrong_with_its_films() {
    let folder = Folder::new("fit-bad");
    film(&folder);
    let none = rb(&folder, &["optimise", "model", "films", "-o", "a"]).expect(3);
    assert!(none.err.contains("--training"), "{}", none.err);
    let unknown = [
        "optimise",
        "model",
        "films",
        "-o",
        "b",
        "--training",
        "crawl,g99",
    ];
    let unknown = rb(&folder, &unknown).expect(2);
    assert!(
        unknown.err.contains("g99") && unknown.err.contains("paddle"),
        "{}",
        unknown.err
    );
    // One film goes empty.
    let film = folder.path("films/paddle_2");
    let empty = std::fs::read(film.join("00000.png")).unwrap();
    let blank = blank_like(&empty);
    for entry in std::fs::read_dir(&film).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|e| e == "png") {
            std::fs::write(path, &blank).unwrap();
        }
    }
    let blind = rb(&folder, &[&FIT[..], &["-o", "c"]].concat()).expect(3);
    assert!(
        blind.err.contains("paddle") && blind.err.contains("trial 2"),
        "{}",
        blind.err
    );
    // One frame is cut short, one line has no time.
    std::fs::write(film.join("00007.png"), &empty[..30]).unwrap();
    let cut = rb(&folder, &[&FIT[..], &["-o", "d"]].concat()).expect(3);
    assert!(cut.err.contains("00007.png"), "{}", cut.err);
    std::fs::write(
        film.join("index.csv"),
        "t_s,file\n0.0,00000.png\nsoon,00001.png\n",
    )
    .unwrap();
    let line = rb(&folder, &[&FIT[..], &["-o", "e"]].concat()).expect(3);
    assert!(line.err.contains("index.csv:3"), "{}", line.err);
}

/// An empty frame of the same size.
fn blank_like(png: &[u8]) -> Vec<u8> {
    let mut frame = camera::picture::read_silhouette_png(png).unwrap();
    frame.clear();
    camera::picture::silhouette_png(&frame).unwrap()
}
