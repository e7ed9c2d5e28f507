//! Prints the verdict of a data set folder as JSON.
use files::dataset::{Manifest, Recording};
fn main() {
    let dir = std::env::args().nth(1).expect("folder");
    let read = |f: &str| std::fs::read_to_string(format!("{dir}/{f}")).expect("file");
    let (m, _) = Manifest::parse("dataset.toml", &read("dataset.toml")).expect("manifest");
    let recs: Vec<Recording> = m
        .runs
        .iter()
        .map(|r| {
            Recording::parse(&r.file, &read(&r.file), &m)
                .expect("csv")
                .0
        })
        .collect();
    let t0 = std::time::Instant::now();
    let d = gap::diagnose(&m, &recs, 0, &gap::Settings::default()).expect("diagnosis");
    eprintln!("refused {:?}", d.selection.refused);
    println!(
        "{}",
        serde_json::to_string_pretty(&d.verdict).expect("json")
    );
    eprintln!(
        "steps {:?} floor_cost {} {:?}",
        d.selection
            .steps
            .iter()
            .map(|s| (s.added.map(|e| e.name()), s.held_out))
            .collect::<Vec<_>>(),
        d.floor.cost(),
        t0.elapsed()
    );
}
