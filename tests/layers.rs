//! The modules of the firmware import each other in one direction only.
//!
//! The graph comes from the text: every path that begins with `crate`, `self`, `super` or the crate's own name, in a `use` or anywhere else, leads to the
//! file of the longest module in it. Methods that several files add to one type need no import, and are not seen.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use tests::root;

/// A module by its names from the root of the crate.
type Module = Vec<String>;
/// Which modules a module imports.
type Graph = BTreeMap<Module, BTreeSet<Module>>;

/// Names, `::` and single signs of Rust text, without comments, strings and characters.
fn tokens(text: &str) -> Vec<String> {
    let chars: Vec<char> = text.chars().collect();
    let (mut at, mut tokens) = (0, Vec::new());
    let is_name = |c: &char| c.is_alphanumeric() || *c == '_';
    while let Some(c) = chars.get(at).copied() {
        let next = chars.get(at + 1).copied().unwrap_or(' ');
        let start = at;
        at += 1;
        match (c, next) {
            ('/', '/') => at += until(&chars[at..], |rest| rest[0] == '\n'),
            ('/', '*') => at += 2 + until(&chars[at..], |rest| rest.starts_with(&['*', '/'])),
            ('"', _) => {
                while chars.get(at).is_some_and(|c| *c != '"') {
                    at += if chars[at] == '\\' { 2 } else { 1 };
                }
                at += 1;
            }
            // A character; without a closing mark it is a lifetime.
            ('\'', '\\') => at += 2 + until(&chars[at + 2..], |rest| rest[0] == '\''),
            ('\'', _) if chars.get(at + 1) == Some(&'\'') => at += 2,
            (':', ':') => {
                at += 1;
                tokens.push("::".to_owned());
            }
            _ if is_name(&c) => {
                at += until(&chars[at..], |rest| !is_name(&rest[0]));
                tokens.push(chars[start..at].iter().collect());
            }
            _ if c.is_whitespace() => {}
            _ => tokens.push(c.to_string()),
        }
    }
    tokens
}

/// How many characters come before the place where `end` holds.
fn until(chars: &[char], end: impl Fn(&[char]) -> bool) -> usize {
    let mut places = 0..chars.len();
    places.find(|at| end(&chars[*at..])).unwrap_or(chars.len())
}

/// All paths of a list such as `a::{b, c::{self, d}}` that begins at `at`; gives the place behind it.
fn expand(tokens: &[String], mut at: usize, prefix: &Module, into: &mut Vec<Module>) -> usize {
    let mut path = prefix.clone();
    while let Some(token) = tokens.get(at) {
        if token == "{" {
            at += 1;
            while tokens.get(at).is_some_and(|token| token != "}") {
                at = expand(tokens, at, &path, into);
                at += usize::from(tokens.get(at).is_some_and(|token| token == ","));
            }
            return at + 1;
        }
        path.push(token.clone());
        at += 1;
        if tokens.get(at).is_none_or(|token| token != "::") {
            break;
        }
        at += 1;
    }
    // `name as other`
    if tokens.get(at).is_some_and(|token| token == "as") {
        at += 2;
    }
    into.push(path);
    at
}

/// Paths in the text of `module`, from the root of the crate. Modules within the file count as the file's own names.
fn paths(text: &str, module: &Module, crate_name: &str) -> Vec<Module> {
    let tokens = tokens(text);
    let (mut at, mut depth, mut inner) = (0, 0_usize, Vec::new());
    let mut found = Vec::new();
    while at < tokens.len() {
        let before = at.checked_sub(1).map_or("", |before| &tokens[before]);
        match tokens[at].as_str() {
            "{" => depth += 1,
            "}" => {
                depth = depth.saturating_sub(1);
                if inner.last().is_some_and(|(_, opened)| *opened == depth) {
                    inner.pop();
                }
            }
            "mod" if tokens.get(at + 2).is_some_and(|token| token == "{") => {
                inner.push((tokens[at + 1].clone(), depth));
            }
            first
                if before != "::"
                    && tokens.get(at + 1).is_some_and(|token| token == "::")
                    && (["crate", "self", "super"].contains(&first) || first == crate_name) =>
            {
                let mut here = module.clone();
                here.extend(inner.iter().map(|(name, _)| name.clone()));
                let mut list = Vec::new();
                at = expand(&tokens, at, &Vec::new(), &mut list);
                found.extend(list.into_iter().map(|path| from_root(&here, &path)));
                continue;
            }
            _ => {}
        }
        at += 1;
    }
    found
}

/// `path` as written in the module `here`, from the root of the crate.
fn from_root(here: &Module, path: &[String]) -> Module {
    let mut whole = Module::new();
    for (place, name) in path.iter().enumerate() {
        match name.as_str() {
            "super" if place == 0 => whole = here[..here.len().saturating_sub(1)].to_vec(),
            "super" => drop(whole.pop()),
            "self" if place == 0 => whole = here.clone(),
            "self" => {}
            // `crate` or the crate's own name.
            _ if place == 0 => {}
            _ => whole.push(name.clone()),
        }
    }
    whole
}

fn graph(files: &BTreeMap<Module, String>, crate_name: &str) -> Graph {
    let file_of = |path: &Module| {
        let mut lengths = (1..=path.len()).rev();
        let found = lengths.find(|length| files.contains_key(&path[..*length]));
        found.map(|length| path[..length].to_vec())
    };
    let edges = files.iter().map(|(module, text)| {
        let to = paths(text, module, crate_name);
        let to: BTreeSet<Module> = to.iter().filter_map(file_of).collect();
        let others = to.into_iter().filter(|other| other != module);
        (module.clone(), others.collect())
    });
    edges.collect()
}

/// Modules of a cycle, in the order in which each imports the next; none if there is no cycle.
fn cycle(graph: &Graph) -> Option<Vec<Module>> {
    fn visit(
        graph: &Graph,
        module: &Module,
        way: &mut Vec<Module>,
        done: &mut BTreeSet<Module>,
    ) -> Option<Vec<Module>> {
        if let Some(start) = way.iter().position(|other| other == module) {
            return Some(way[start..].to_vec());
        }
        if done.contains(module) {
            return None;
        }
        way.push(module.clone());
        let mut next = graph.get(module).into_iter().flatten();
        let found = next.find_map(|other| visit(graph, other, way, done));
        way.pop();
        done.insert(module.clone());
        found
    }
    let mut done = BTreeSet::new();
    let mut modules = graph.keys();
    modules.find_map(|module| visit(graph, module, &mut Vec::new(), &mut done))
}

fn read(folder: &Path, module: &Module, into: &mut BTreeMap<Module, String>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let stem = path.file_stem().unwrap().to_string_lossy().into_owned();
        let mut inner = module.clone();
        if !["mod", "lib", "main"].contains(&stem.as_str()) {
            inner.push(stem);
        }
        if path.is_dir() {
            read(&path, &inner, into);
        } else if path.extension().is_some_and(|extension| extension == "rs") && !inner.is_empty() {
            into.insert(inner, std::fs::read_to_string(&path).unwrap());
        }
    }
}

#[test]
fn modules_of_the_firmware_import_each_other_in_one_direction() {
    let mut files = BTreeMap::new();
    read(&root().join("firmware/src"), &Module::new(), &mut files);
    let graph = graph(&files, "firmware");
    let imports = |from: &[&str], to: &[&str]| {
        let name = |words: &[&str]| words.iter().map(|w| (*w).to_owned()).collect::<Module>();
        graph[&name(from)].contains(&name(to))
    };
    // The graph is there: an empty one has no cycle either.
    assert!(imports(&["app"], &["app", "core"]));
    assert!(imports(&["app", "cycle"], &["app", "core"]));
    assert!(imports(&["app", "core"], &["slots"]));
    assert!(imports(&["tasks"], &["app", "types"]));
    if let Some(cycle) = cycle(&graph) {
        let names: Vec<String> = cycle.iter().map(|module| module.join("::")).collect();
        panic!("{} imports the first again", names.join(" imports "));
    }
}

#[test]
fn a_circle_of_imports_is_found_however_it_is_written() {
    let files = |texts: &[(&str, &str)]| -> BTreeMap<Module, String> {
        let module = |name: &str| name.split("::").map(str::to_owned).collect();
        let files = texts
            .iter()
            .map(|(name, text)| (module(name), (*text).to_owned()));
        files.collect()
    };
    let circle_of = |texts: &[(&str, &str)]| cycle(&graph(&files(texts), "own")).map(|c| c.len());
    let back = [
        "use super::b::Thing;",
        "use crate::a::{c::Other, b::{self, Thing}};",
        "use super::{c, b as other};",
        "fn f() { let x = super::b::Thing::new(); }",
        "use own::a::b::Thing;",
        "mod tests { mod deeper { use super::super::super::b::*; } }",
        "fn g() -> char { let c = '\\''; let d: &'static str = \"{\"; crate::a::b::f(c, d) }",
    ];
    for text in back {
        let texts = [("a", ""), ("a::b", "use super::c::F;"), ("a::c", text)];
        assert_eq!(circle_of(&texts), Some(2), "{text}");
    }
    let none = [
        "// use super::b::Thing;",
        "/* use super::b::Thing; */ use other::b::Thing;",
        "const TEXT: &str = \"super::b::Thing \\\" crate::a::b\";",
        "mod tests { use super::*; }",
        "fn f() { b::g() }",
    ];
    for text in none {
        let texts = [("a", ""), ("a::b", "use super::c::F;"), ("a::c", text)];
        assert_eq!(circle_of(&texts), None, "{text}");
    }
    let three = [
        ("a", "pub use self::b::B;"),
        ("a::b", "use crate::d::D;"),
        ("d", "use crate::a::B;"),
    ];
    assert_eq!(
        circle_of(&three),
        Some(3),
        "a name that the parent hands on"
    );
}
