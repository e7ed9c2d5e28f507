//! The parts list of a package: CycloneDX 1.5, JSON, out of `cargo metadata`.

use crate::sh;
use anyhow::{Context, Result};
use serde_json::{Value, json};
use std::collections::BTreeSet;

/// The list of everything that is linked into `package`: normal dependencies and theirs.
///
/// # Errors
/// `cargo metadata` fails, or knows no such package.
pub(crate) fn write(package: &str) -> Result<String> {
    let text = sh::output("cargo", &["metadata", "--format-version", "1", "--locked"])?;
    let list = list(&serde_json::from_str(&text)?, package)?;
    Ok(serde_json::to_string_pretty(&list)? + "\n")
}

fn list(metadata: &Value, package: &str) -> Result<Value> {
    let packages = array(&metadata["packages"])?;
    let root = packages
        .iter()
        .find(|p| p["name"] == package)
        .with_context(|| format!("no package `{package}`"))?;
    let linked = linked(metadata, &root["id"])?;
    let mut parts: Vec<Value> = packages
        .iter()
        .filter(|p| *p != root && p["id"].as_str().is_some_and(|id| linked.contains(id)))
        .map(part)
        .collect();
    parts.sort_by_key(|part| part["bom-ref"].to_string());
    Ok(json!({
        "bomFormat": "CycloneDX",
        "specVersion": "1.5",
        "version": 1,
        "metadata": { "component": part(root) },
        "components": parts,
    }))
}

/// Ids of all packages that `start` reaches by normal dependencies.
fn linked(metadata: &Value, start: &Value) -> Result<BTreeSet<String>> {
    let nodes = array(&metadata["resolve"]["nodes"])?;
    let mut open = vec![start.as_str().unwrap_or_default().to_owned()];
    let mut found = BTreeSet::new();
    while let Some(id) = open.pop() {
        if !found.insert(id.clone()) {
            continue;
        }
        let node = nodes
            .iter()
            .find(|node| node["id"] == id.as_str())
            .context("a package without a node")?;
        for dependency in array(&node["deps"])? {
            if array(&dependency["dep_kinds"])?
                .iter()
                .any(|kind| kind["kind"].is_null())
            {
                open.extend(dependency["pkg"].as_str().map(str::to_owned));
            }
        }
    }
    Ok(found)
}

fn array(value: &Value) -> Result<&Vec<Value>> {
    value.as_array().context("cargo metadata has another form")
}

fn part(package: &Value) -> Value {
    let text = |key: &str| package[key].as_str().unwrap_or_default();
    let (name, version) = (text("name"), text("version"));
    let url = format!("pkg:cargo/{name}@{version}");
    let mut part = json!({ "type": "library", "bom-ref": url, "name": name, "version": version });
    if package["source"].is_string() {
        part["purl"] = json!(url);
    }
    if !text("license").is_empty() {
        part["licenses"] = json!([{ "expression": text("license").replace('/', " OR ") }]);
    }
    part
}

#[cfg(test)]
mod tests {
    use super::*;

    fn node(id: &str, dependencies: &[(&str, Value)]) -> Value {
        let dependency =
            |(id, kind): &(&str, Value)| json!({ "pkg": id, "dep_kinds": [{ "kind": kind }] });
        json!({ "id": id, "deps": dependencies.iter().map(dependency).collect::<Vec<_>>() })
    }

    #[test]
    fn a_list_holds_what_is_linked_and_no_more() {
        let package = |name: &str, source: Value| json!({ "id": name, "name": name, "version": "1.0.0", "license": "MIT/Apache-2.0", "source": source });
        let metadata = json!({
            "packages": [package("host", Value::Null), package("a", json!("registry")), package("b", json!("registry")), package("test", json!("registry"))],
            "resolve": { "nodes": [
                node("host", &[("a", Value::Null), ("test", json!("dev"))]),
                node("a", &[("b", Value::Null)]),
                node("b", &[]),
                node("test", &[]),
            ] },
        });
        let list = list(&metadata, "host").unwrap();
        let names: Vec<&Value> = list["components"]
            .as_array()
            .unwrap()
            .iter()
            .map(|c| &c["name"])
            .collect();
        assert_eq!(names, ["a", "b"]);
        assert_eq!(list["components"][0]["purl"], "pkg:cargo/a@1.0.0");
        assert_eq!(
            list["components"][0]["licenses"][0]["expression"],
            "MIT OR Apache-2.0"
        );
        assert_eq!(list["metadata"]["component"]["name"], "host");
    }
}
