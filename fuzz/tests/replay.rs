//! The corpus and every input that once failed, replayed; and some mutations of each, so that a target cannot rot.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

use fuzz::{Mutator, TARGETS, corpus, seeds, target};

/// Mutations of a target in this test.
const MUTATIONS: usize = 2000;

fn replay(name: &str, mutations: usize) {
    let target = target(name).unwrap();
    let mut inputs = seeds::of(name);
    assert!(!inputs.is_empty(), "{name} has no seed");
    inputs.extend(corpus::read(name));
    inputs.extend(corpus::folder(&corpus::regressions(name)));
    inputs.iter().for_each(|input| (target.run)(input));
    let mut mutator = Mutator::new(1, target.longest, target.text);
    for _ in 0..mutations {
        let input = mutator.next(&inputs);
        (target.run)(&input);
    }
    println!("{name}: {} inputs and {mutations} mutations", inputs.len());
}

#[test]
fn readers_of_text_take_their_corpus_and_mutations_of_it() {
    let text = TARGETS.iter().filter(|target| target.text);
    text.for_each(|target| replay(target.name, MUTATIONS));
}

#[test]
fn readers_of_bytes_take_their_corpus_and_mutations_of_it() {
    let fast = TARGETS
        .iter()
        .filter(|target| !target.text && target.name != "robot");
    fast.for_each(|target| replay(target.name, MUTATIONS));
}

#[test]
fn the_firmware_takes_its_corpus_and_mutations_of_it() {
    replay("robot", 30);
}

#[test]
fn every_folder_and_file_belongs_to_a_target() {
    for place in ["corpus", "regressions"] {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(place);
        for entry in std::fs::read_dir(path).into_iter().flatten().flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            assert!(
                target(name.trim_end_matches(".bin")).is_some(),
                "{place}/{name}"
            );
        }
    }
}
