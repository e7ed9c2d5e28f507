//! Every key of a file stands on a page, and every stage, verdict and metric too.

use serde_json::Value;
use std::collections::BTreeSet;
use tests::root;

/// Names of all properties of a schema, at any depth.
fn keys(schema: &Value, found: &mut BTreeSet<String>) {
    if let Some(properties) = schema["properties"].as_object() {
        found.extend(properties.keys().cloned());
        properties.values().for_each(|inner| keys(inner, found));
    }
    keys_of_lists(schema, found);
}

fn keys_of_lists(schema: &Value, found: &mut BTreeSet<String>) {
    if schema["items"].is_object() {
        keys(&schema["items"], found);
    }
    for choice in ["oneOf", "anyOf"] {
        schema[choice]
            .as_array()
            .into_iter()
            .flatten()
            .for_each(|inner| keys(inner, found));
    }
}

fn page(name: &str) -> String {
    std::fs::read_to_string(root().join("docs").join(name)).unwrap()
}

/// Whether the page has the word between characters that are no part of a name.
fn holds(page: &str, word: &str) -> bool {
    let part = |c: char| c.is_alphanumeric() || c == '_';
    page.match_indices(word)
        .any(|(at, _)| !page[..at].ends_with(part) && !page[at + word.len()..].starts_with(part))
}

#[test]
fn every_key_of_a_file_is_explained() {
    let pages = page("reference/files.md") + &page("how-to/your-data.md");
    let mut missing = Vec::new();
    for name in ["gait", "dataset", "robot"] {
        let text = page(&format!("schema/{name}.json"));
        let mut found = BTreeSet::new();
        keys(&serde_json::from_str(&text).unwrap(), &mut found);
        // The page says that an angle in degrees may be given in radians too.
        let known =
            |key: &&String| holds(&pages, key) || holds(&pages, &key.replace("_rad", "_deg"));
        let unknown = found.iter().filter(|key| !known(key));
        missing.extend(unknown.map(|key| format!("{name}: {key}")));
    }
    assert!(
        missing.is_empty(),
        "docs/reference/files.md lacks {missing:?}"
    );
}

#[test]
fn every_key_and_word_of_the_verdict_is_explained() {
    let page = page("reference/verdict.md");
    let read = |name: &str| -> Value {
        serde_json::from_str(&self::page(&format!("schema/{name}.json"))).unwrap()
    };
    let (schema, causes) = (read("gap-1"), read("gap-2"));
    let words = |of: &Value| -> Vec<String> {
        of.as_array()
            .unwrap()
            .iter()
            .map(|w| w.as_str().unwrap().to_owned())
            .collect()
    };
    let mut wanted: Vec<String> = schema["properties"]
        .as_object()
        .unwrap()
        .keys()
        .cloned()
        .collect();
    wanted.extend(words(&schema["properties"]["verdict"]["enum"]));
    wanted.extend(words(
        &schema["properties"]["where"]["items"]["properties"]["stage"]["enum"],
    ));
    wanted.extend(words(
        &schema["properties"]["where"]["items"]["properties"]["regime"]["enum"],
    ));
    let mut of_causes = BTreeSet::new();
    keys(&causes, &mut of_causes);
    wanted.extend(of_causes);
    let cause = &causes["properties"]["causes"]["items"]["properties"];
    wanted.extend(words(&cause["scope"]["enum"]));
    wanted.extend(words(&cause["kind"]["enum"]));
    wanted.retain(|word| !holds(&page, word));
    assert!(
        wanted.is_empty(),
        "docs/reference/verdict.md lacks {wanted:?}"
    );
}
