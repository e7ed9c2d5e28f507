//! Names in files are text in a report, a picture and a page, whatever they look like.

use crate::rig::{Folder, rb};

/// Would run, load or close something in HTML or SVG.
const NAMES: [&str; 5] = [
    "<script>alert(1)</script>",
    "\\\" onload=\\\"alert(1)",
    "</text></svg><img src=x onerror=alert(1)>",
    "]]><iframe src=//x>",
    "&lt;b&gt;&#60;i",
];
/// What must not stand in a page as it was written.
const RAW: [&str; 5] = [
    "<script>alert",
    "\" onload=\"alert",
    "<img src=x",
    "<iframe",
    "'><",
];

fn clean(text: &str, what: &str) {
    for raw in RAW {
        assert!(!text.contains(raw), "{what} holds {raw}");
    }
}

#[test]
fn names_of_files_gaits_and_sets_are_text_in_every_page_and_picture() {
    let folder = Folder::new("markup");
    std::fs::create_dir(folder.path("set")).unwrap();
    let mut csv = String::from("t_s,setpoint_rad,position_rad\n");
    for k in 0..400 {
        let t = f64::from(k) * 0.01;
        csv += &format!("{t},{},{}\n", (3.0 * t).sin(), (3.0 * t - 0.2).sin());
    }
    folder.write("set/a.csv", &csv);
    folder.write("set/b <img src=x onerror=alert(1)>.csv", &csv);
    for name in NAMES {
        let manifest = format!(
            "format = 1\nrobot = \"bench\"\nname = \"{name}\"\n\"{name}\" = 1\n[bench]\n\
             [[run]]\nfile = \"a.csv\"\ngait = \"{name}\"\n[[run]]\nfile = \"b <img src=x onerror=alert(1)>.csv\"\ngait = \"{name}2\"\n"
        );
        folder.write("set/dataset.toml", manifest);
        let args = [
            "gap",
            "report",
            "set",
            "-o",
            "r.html",
            "--force",
            "--time-limit",
            "1s",
        ];
        rb(&folder, &args).expect(0);
        clean(
            &std::fs::read_to_string(folder.path("r.html")).unwrap(),
            name,
        );
        let crawl = std::fs::read_to_string(crate::rig::gait("crawl.toml")).unwrap();
        let short: String = name.chars().take(30).collect();
        let short = short.trim_end_matches('\\');
        folder.write(
            "g.toml",
            crawl.replace("\"crawl\"", &format!("\"{short}\"")),
        );
        let run = rb(
            &folder,
            &["-p", "sim:", "run", "g.toml", "-d", "1s", "-r", "g.mcap"],
        );
        if run.code == 0 {
            rb(
                &folder,
                &["rec", "plot", "g.mcap", "-o", "g.svg", "--force"],
            )
            .expect(0);
            clean(
                &std::fs::read_to_string(folder.path("g.svg")).unwrap(),
                name,
            );
            std::fs::remove_file(folder.path("g.mcap")).unwrap();
        }
    }
}
