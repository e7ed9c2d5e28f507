use std::path::Path;
use files::dataset::{Manifest, Recording};
fn main() {
    for path in std::env::args().skip(1) {
        let start = std::time::Instant::now();
        let folder = Path::new(&path);
        let read = |f: &str| std::fs::read_to_string(folder.join(f)).expect("file");
        let (manifest, _) = Manifest::parse("dataset.toml", &read("dataset.toml")).expect("manifest");
        let recordings: Vec<Recording> = manifest.runs.iter().map(|r| Recording::parse(&r.file, &read(&r.file), &manifest).expect("csv").0).collect();
        let model = manifest.model.as_ref().map_or_else(files::model::Model::hand_tuned, |m| files::model::Model::parse(m, &read(m)).expect("model"));
        let text = gap::whole::search_text(&manifest, &recordings, &model, &[]);
        println!("== {path} {:.1} s\n{}", start.elapsed().as_secs_f64(), text.expect("diagnosed"));
    }
}
