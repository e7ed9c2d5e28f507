//! Files that people write: what is accepted is written and read back to the same.

use control::gait::Gait;
use files::dataset::{Manifest, Recording};
use files::model::Model;
use files::structure::Structure;
use protocol::link::WireGait;
use protocol::link::gait::MAX_GAIT;

/// The input as text; bytes that are no UTF-8 are refused before a parser sees them.
fn text(data: &[u8]) -> &str {
    core::str::from_utf8(data).unwrap_or("")
}

pub(crate) fn gait(data: &[u8]) {
    let Ok(gait) = files::gait::parse("f", text(data)) else {
        return;
    };
    let again = files::gait::parse("f", &files::gait::to_toml(&gait)).expect("what we wrote");
    assert_eq!(again, gait, "the file says something else");
    let wire = WireGait::from(&gait);
    let mut buffer = [0; MAX_GAIT];
    let read = WireGait::from_bytes(wire.to_bytes(&mut buffer)).expect("what we wrote");
    assert_eq!(
        Gait::try_from(&read),
        Ok(gait),
        "the wire says something else"
    );
}

pub(crate) fn model(data: &[u8]) {
    if let Ok(model) = Model::parse("f", text(data)) {
        let again = Model::parse("f", &model.to_toml()).expect("what we wrote");
        assert_eq!(again, model);
    }
}

pub(crate) fn structure(data: &[u8]) {
    drop(Structure::parse("f", text(data)));
}

pub(crate) fn scenario(data: &[u8]) {
    drop(hil_sim::scenario::parse("f", text(data)));
}

pub(crate) fn dataset(data: &[u8]) {
    if let Ok((manifest, _)) = Manifest::parse("f", text(data)) {
        for run in &manifest.runs {
            assert!(!run.file.contains("..") || files::dataset::is_inside(&run.file));
        }
    }
}

/// Manifests that columns are read under.
const MANIFESTS: [&str; 3] = [
    "format = 1\nrobot = \"metamodule\"\n[[run]]\nfile = \"a.csv\"\n",
    "format = 1\nrobot = \"bench\"\n[bench]\n[[run]]\nfile = \"a.csv\"\n",
    "format = 1\nrobot = \"bench\"\n[signals]\nsetpoint_m = \"s\"\n[bench]\nmotion = \"linear\"\n[[run]]\nfile = \"a.csv\"\n",
];

/// The first character chooses the manifest.
pub(crate) fn csv(data: &[u8]) {
    let text = text(data);
    let Some(first) = text.chars().next() else {
        return;
    };
    let manifest = MANIFESTS[first as usize % MANIFESTS.len()];
    let (manifest, _) = Manifest::parse("f", manifest).expect("a manifest of ours");
    if let Ok((recording, _)) = Recording::parse("f", &text[first.len_utf8()..], &manifest) {
        assert_eq!(recording.t_s().len(), recording.len());
        let rising = recording.t_s().windows(2).all(|pair| pair[0] <= pair[1]);
        assert!(rising, "times fall");
    }
}
