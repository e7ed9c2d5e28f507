//! Folders that a command fills. While it does, a list of what it writes stands in the folder: where the list is left, the command was
//! cut off, and the next one removes what is listed and nothing else.

use std::collections::BTreeSet;
use std::fs::OpenOptions;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use super::{cannot_write, fresh, make_folder, write};
use crate::failure::{Exit, Failure, Outcome};

/// The list.
const UNFINISHED: &str = ".unfinished";
/// Its first line.
const HEAD: &str =
    "A command is filling this folder, or was cut off; the same command fills it anew. It writes:";

/// Begins a folder that must be empty, or one that a cut-off command left: what that one wrote is removed. [`claim`] comes before what
/// is written, [`finish`] ends it.
///
/// # Errors
/// Exit code 2 when it holds something else; 1 when the disk refuses.
pub fn begin(folder: &Path) -> Outcome {
    let held = must_be_empty(folder)?;
    // Files first, then the folders that held them, the inner ones before the outer ones.
    for name in held.files.iter().filter(|name| *name != UNFINISHED) {
        remove(std::fs::remove_file(folder.join(name)), &folder.join(name))?;
    }
    for name in held.folders.iter().rev() {
        remove(std::fs::remove_dir(folder.join(name)), &folder.join(name))?;
    }
    make_folder(folder)?;
    write(&folder.join(UNFINISHED), format!("{HEAD}\n").as_bytes())
}

/// Tells, before they are written, the names of files in a folder that [`begin`] began; `/` parts folders.
///
/// # Errors
/// Exit code 1 when the disk refuses.
pub fn claim(folder: &Path, names: &[String]) -> Outcome {
    let list = folder.join(UNFINISHED);
    let text: String = names.iter().map(|name| format!("{name}\n")).collect();
    let added = OpenOptions::new().append(true).open(&list);
    added
        .and_then(|mut file| {
            file.write_all(text.as_bytes())
                .and_then(|()| file.sync_all())
        })
        .map_err(|error| cannot_write(&list, &error))
}

/// Ends a folder that [`begin`] began: all files are there.
///
/// # Errors
/// Exit code 1 when the disk refuses.
pub fn finish(folder: &Path) -> Outcome {
    let mark = folder.join(UNFINISHED);
    remove(std::fs::remove_file(&mark), &mark)
}

fn remove(removed: std::io::Result<()>, path: &Path) -> Outcome {
    match removed {
        Err(error) if error.kind() != ErrorKind::NotFound => {
            let message = format!("cannot remove {}: {error}", path.display());
            Err(Failure::say(Exit::Other, message))
        }
        _ => Ok(()),
    }
}

/// What a folder holds that a cut-off command left.
#[derive(Debug, Default)]
pub struct Held {
    /// Names of files, and of everything else that is no folder.
    files: BTreeSet<String>,
    /// Names of folders, outer ones before inner ones.
    folders: BTreeSet<String>,
}

impl Held {
    /// Adds what stands in `folder` below `within`; links are not followed.
    fn add(&mut self, folder: &Path, within: &str) -> std::io::Result<()> {
        for entry in std::fs::read_dir(folder.join(within))? {
            let entry = entry?;
            let own = entry.file_name().to_string_lossy().into_owned();
            let name = match within {
                "" => own,
                within => format!("{within}/{own}"),
            };
            if entry.file_type()?.is_dir() {
                self.add(folder, &name)?;
                self.folders.insert(name);
            } else {
                self.files.insert(name);
            }
        }
        Ok(())
    }

    /// The first thing that is not on the list of the command that was cut off.
    fn foreign(&self, list: &str) -> Option<&String> {
        // A last line without its end was cut off, and what it names was not begun.
        let whole = list.rfind('\n').map_or("", |end| &list[..end]);
        let mut listed: BTreeSet<PathBuf> = [UNFINISHED.into()].into();
        let mut folders = BTreeSet::new();
        for name in whole.lines().skip(1).map(Path::new) {
            folders.extend(name.ancestors().skip(1).map(Path::to_owned));
            listed.insert(fresh(name));
            listed.insert(name.to_owned());
        }
        listed.insert(fresh(Path::new(UNFINISHED)));
        let file = |name: &&String| !listed.contains(Path::new(name));
        let folder = |name: &&String| !folders.contains(Path::new(name));
        let foreign = self.files.iter().find(file);
        foreign.or_else(|| self.folders.iter().find(folder))
    }
}

/// Checks, before any long work, that a folder is empty, not there, or left by a cut-off command with nothing else in it; gives what
/// that one left.
///
/// # Errors
/// Exit code 2 when it holds something.
pub fn must_be_empty(folder: &Path) -> Outcome<Held> {
    let mut held = Held::default();
    match std::fs::read_to_string(folder.join(UNFINISHED)) {
        Err(_) => {
            let holds = std::fs::read_dir(folder).is_ok_and(|mut all| all.next().is_some());
            // The mark itself may have been cut off while it was made.
            let only_mark = fresh(&folder.join(UNFINISHED)).exists() && one(folder);
            if holds && !only_mark {
                let message = format!("{} exists and is not empty", folder.display());
                return Err(Failure::say(Exit::Usage, message).hint("name another folder"));
            }
        }
        Ok(list) => {
            let read = held.add(folder, "");
            read.map_err(|error| super::bad_file(folder, &error))?;
            if let Some(name) = held.foreign(&list) {
                let message = format!(
                    "{} was left by a command that was cut off, and holds {name}, which that command did not write",
                    folder.display()
                );
                return Err(Failure::say(Exit::Usage, message)
                    .hint("move it elsewhere, or name another folder"));
            }
        }
    }
    Ok(held)
}

/// Whether a folder holds one thing only.
fn one(folder: &Path) -> bool {
    std::fs::read_dir(folder).is_ok_and(|all| all.count() == 1)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]
mod tests {
    use super::*;

    fn folder(name: &str) -> PathBuf {
        let path = std::env::temp_dir().join(format!("rb-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        path
    }

    fn put(path: &Path) {
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, "x").unwrap();
    }

    #[test]
    fn a_folder_begun_anew_holds_nothing_of_the_command_that_was_cut_off() {
        let path = folder("anew");
        begin(&path).unwrap();
        claim(&path, &["a.csv".into(), "film/0.png".into()]).unwrap();
        claim(&path, &["b.csv".into()]).unwrap();
        for name in ["a.csv", "film/0.png", "b.csv.new"] {
            put(&path.join(name));
        }
        begin(&path).unwrap();
        let names: Vec<_> = std::fs::read_dir(&path).unwrap().flatten().collect();
        assert_eq!(names.len(), 1, "{names:?}");
        finish(&path).unwrap();
        assert_eq!(std::fs::read_dir(&path).unwrap().count(), 0);
        std::fs::remove_dir_all(&path).unwrap();
    }

    #[test]
    fn what_the_command_did_not_write_is_refused_and_kept() {
        let path = folder("kept");
        for name in ["notes.txt", "film/9.png", "mine/a.csv", "a.cs"] {
            let _ = std::fs::remove_dir_all(&path);
            begin(&path).unwrap();
            claim(&path, &["a.csv".into(), "film/0.png".into()]).unwrap();
            put(&path.join("a.csv"));
            put(&path.join(name));
            // A line that was cut off names nothing.
            let mut list = OpenOptions::new()
                .append(true)
                .open(path.join(UNFINISHED))
                .unwrap();
            list.write_all(b"a.cs").unwrap();
            let refused = begin(&path).unwrap_err();
            assert_eq!(refused.exit(), Exit::Usage, "{name}");
            assert!(
                path.join(name).exists() && path.join("a.csv").exists(),
                "{name}"
            );
        }
        std::fs::remove_dir_all(&path).unwrap();
    }

    #[cfg(unix)]
    #[test]
    fn a_link_is_never_followed() {
        let (path, other) = (folder("link"), folder("linked"));
        put(&other.join("0.png"));
        begin(&path).unwrap();
        claim(&path, &["film/0.png".into()]).unwrap();
        std::os::unix::fs::symlink(&other, path.join("film")).unwrap();
        begin(&path).unwrap_err();
        assert!(other.join("0.png").exists());
        std::fs::remove_dir_all(&path).unwrap();
        std::fs::remove_dir_all(&other).unwrap();
    }
}
