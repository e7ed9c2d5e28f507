//! dev: diagnoses folders, writes FOLDER.verdict.json
use files::dataset::{Manifest, Recording};
fn main() {
    for dir in std::env::args().skip(1) {
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
        let v = &d.verdict;
        let extra = format!(
            "refused {:?} steps {:?} floor_cost {:.3} {:.1}s",
            d.selection.refused,
            d.selection
                .steps
                .iter()
                .map(|s| (s.added.map(|e| e.name()), s.held_out))
                .collect::<Vec<_>>(),
            d.floor.cost(),
            t0.elapsed().as_secs_f64()
        );
        let out = serde_json::json!({"verdict": v, "extra": extra, "free": d.selection.model.free.iter().map(|f| (format!("{:?}", f.p), d.selection.model.params.get(f.p), f.pull(d.selection.model.params.get(f.p)))).collect::<Vec<_>>() });
        std::fs::write(
            format!("{}.verdict.json", dir.trim_end_matches('/')),
            serde_json::to_string_pretty(&out).expect("json"),
        )
        .expect("write");
        println!(
            "{dir} {:?} {:?} {extra}",
            v.verdict,
            v.effects
                .iter()
                .map(|e| (
                    e.effect.name(),
                    e.parameters.values().map(|p| p.value).collect::<Vec<_>>()
                ))
                .collect::<Vec<_>>()
        );
    }
}
