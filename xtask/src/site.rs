//! `cargo xtask site`: the pages as one web site, in `target/site/`, with every link of it followed.

use crate::sh;
use anyhow::{Context, Result, bail};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Component, Path, PathBuf};

/// The mdBook that is installed below `target/` where none is on the path.
const MDBOOK: &str = "mdbook@0.5.4";

/// Builds the site and checks its links. Without mdBook, and without a way to install it, says so.
pub(crate) fn run() -> Result<()> {
    let program = match mdbook() {
        Ok(program) => program,
        Err(error) => {
            eprintln!("SKIPPED  web site of the pages: needs mdBook, {error:#}");
            return Ok(());
        }
    };
    sh::run(&program, &["build"])?;
    let site = sh::root().join("target/site");
    let broken = broken_links(&site)?;
    if !broken.is_empty() {
        bail!("links of the web site lead nowhere:\n{}", broken.join("\n"));
    }
    Ok(())
}

/// The program on the path, else the one below `target/`, which is installed when it is not there.
pub(crate) fn mdbook() -> Result<String> {
    let tools = sh::target_dir().join("tools");
    let own = tools.join("bin/mdbook").to_string_lossy().into_owned();
    for program in ["mdbook", own.as_str()] {
        if sh::output(program, &["--version"]).is_ok() {
            return Ok(program.to_owned());
        }
    }
    let tools = tools.to_string_lossy();
    let install = ["install", MDBOOK, "--locked", "--quiet", "--root", &tools];
    sh::run("cargo", &install).context("which could not be installed")?;
    sh::output(&own, &["--version"])?;
    Ok(own)
}

/// A page of the site: where its links lead, and what a link may point at in it.
struct Page {
    links: Vec<String>,
    anchors: BTreeSet<String>,
}

/// Links and pictures of all pages that lead to no file or to no place in a page.
fn broken_links(site: &Path) -> Result<Vec<String>> {
    let mut pages = BTreeMap::new();
    let mut open = vec![site.to_path_buf()];
    while let Some(folder) = open.pop() {
        for entry in std::fs::read_dir(&folder)? {
            let path = entry?.path();
            if path.is_dir() {
                open.push(path);
            } else if path.extension().is_some_and(|e| e == "html") {
                let page = read(&std::fs::read_to_string(&path)?);
                pages.insert(path, page);
            }
        }
    }
    let mut broken = Vec::new();
    for (path, page) in &pages {
        for link in &page.links {
            let (target, anchor) = link.split_once('#').unwrap_or((link, ""));
            let file = resolve(site, path, target);
            let whole = match pages.get(&file) {
                Some(page) => anchor.is_empty() || page.anchors.contains(anchor),
                None => file.is_file(),
            };
            if !whole {
                let page = path.strip_prefix(site).unwrap_or(path);
                broken.push(format!("{}: {link}", page.display()));
            }
        }
    }
    Ok(broken)
}

/// Links within the site, and ids, of an HTML page.
fn read(html: &str) -> Page {
    let values = |name: &str| -> Vec<String> {
        let start = format!(" {name}=\"");
        let parts = html.split(&start).skip(1);
        let values = parts.filter_map(|rest| rest.split('"').next());
        values.map(|value| value.replace("&amp;", "&")).collect()
    };
    let outside = |link: &String| {
        let start = link.split('/').next().unwrap_or_default();
        start.contains(':')
    };
    let mut links = [values("href"), values("src")].concat();
    links.retain(|link| !outside(link));
    Page {
        links,
        anchors: [values("id"), values("name")]
            .concat()
            .into_iter()
            .collect(),
    }
}

/// The file that a link of a page names; a folder stands for its `index.html`.
fn resolve(site: &Path, page: &Path, target: &str) -> PathBuf {
    if target.is_empty() {
        return page.to_path_buf();
    }
    let start = match target.strip_prefix('/') {
        Some(_) => site,
        None => page.parent().unwrap_or(site),
    };
    let mut file = PathBuf::new();
    for part in start.join(target.trim_start_matches('/')).components() {
        match part {
            Component::ParentDir => drop(file.pop()),
            Component::CurDir => {}
            part => file.push(part),
        }
    }
    if file.is_dir() {
        file.push("index.html");
    }
    file
}

#[cfg(test)]
mod tests {
    use super::{broken_links, resolve};
    use std::path::Path;

    #[test]
    fn a_link_names_a_file_of_the_site() {
        let site = Path::new("/site");
        let page = Path::new("/site/how-to/a.html");
        for (target, file) in [
            ("", "/site/how-to/a.html"),
            ("b.html", "/site/how-to/b.html"),
            ("../c.html", "/site/c.html"),
            ("/d.html", "/site/d.html"),
        ] {
            assert_eq!(resolve(site, page, target), Path::new(file), "{target}");
        }
    }

    #[test]
    fn a_link_that_leads_nowhere_is_found() {
        let site = std::env::temp_dir().join(format!("rb-site-{}", std::process::id()));
        std::fs::create_dir_all(&site).unwrap();
        let whole = "<h1 id=\"top\"></h1><a href=\"#top\"></a><a href=\"b.html#two\"></a>\
            <a href=\"https://example.org/x\"></a>";
        let broken = "<h2 id=\"two\"></h2><a href=\"a.html#gone\"></a><img src=\"gone.png\">";
        std::fs::write(site.join("a.html"), whole).unwrap();
        std::fs::write(site.join("b.html"), broken).unwrap();
        let found = broken_links(&site).unwrap();
        std::fs::remove_dir_all(&site).unwrap();
        assert_eq!(found, ["b.html: a.html#gone", "b.html: gone.png"]);
    }
}
