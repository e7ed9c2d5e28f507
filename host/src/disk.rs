//! Files on the disk: read with a limit, written in one step, never overwritten unasked, and named in every error.

mod unfinished;

use std::fs::{File, OpenOptions};
use std::io::{self, ErrorKind, Read, Write};
use std::path::{Path, PathBuf};

use crate::failure::{Exit, Failure, Outcome};
pub use unfinished::{Held, begin, claim, finish, must_be_empty};

/// Largest text file that people write by hand, such as a model, a manifest or settings.
pub const MAX_TEXT: u64 = 4 << 20;
/// Largest file of measurements read into memory: over a day of samples at 100 Hz is 12 GB, an hour is 0.5 GB.
pub const MAX_DATA: u64 = 1 << 30;

/// Largest picture: 16-bit depth of 4096 x 4096 pixels.
pub const MAX_PICTURE: u64 = 36 << 20;

/// Opens a regular file only. A pipe would wait for ever and a device has no end.
///
/// # Errors
/// As the system tells, or [`ErrorKind::InvalidInput`] for anything but a regular file.
pub fn open_regular(path: &Path) -> io::Result<File> {
    let mut options = OpenOptions::new();
    options.read(true);
    #[cfg(unix)]
    {
        use std::os::unix::fs::OpenOptionsExt;
        // A pipe without a writer opens at once; on a regular file the flag has no effect.
        options.custom_flags(libc::O_NONBLOCK);
    }
    must_be_regular(options.open(path)?)
}

/// The file itself, if it is a regular one.
///
/// # Errors
/// [`ErrorKind::InvalidInput`] for anything but a regular file.
pub fn must_be_regular(file: File) -> io::Result<File> {
    if file.metadata()?.is_file() {
        return Ok(file);
    }
    let why = "this is a folder, a device or a pipe; a regular file is needed";
    Err(io::Error::new(ErrorKind::InvalidInput, why))
}

/// Reads a regular file of at most `limit` bytes.
///
/// # Errors
/// As [`open_regular`], or [`ErrorKind::FileTooLarge`].
pub fn read_regular(path: &Path, limit: u64) -> io::Result<Vec<u8>> {
    read_opened(open_regular(path)?, limit)
}

/// Reads an opened file of at most `limit` bytes.
///
/// # Errors
/// As the system tells, or [`ErrorKind::FileTooLarge`].
pub fn read_opened(file: File, limit: u64) -> io::Result<Vec<u8>> {
    // Told at once for a file whose length is known, and by the limit below for one that grows.
    if file.metadata()?.len() > limit {
        return Err(too_large(limit));
    }
    read_to_limit(file, limit)
}

/// Text of a regular file of at most `limit` bytes.
///
/// # Errors
/// As [`read_regular`], or [`ErrorKind::InvalidData`] where the file is not UTF-8 text.
pub fn read_regular_text(path: &Path, limit: u64) -> io::Result<String> {
    read_opened_text(open_regular(path)?, limit)
}

/// Text of an opened file of at most `limit` bytes. A byte of zero is no text: it is refused before the rest is read, because a file
/// of a few bytes on the disk can be a gigabyte of them.
///
/// # Errors
/// As [`read_opened`], or [`ErrorKind::InvalidData`] where the file is not UTF-8 text.
pub fn read_opened_text(mut file: File, limit: u64) -> io::Result<String> {
    if file.metadata()?.len() > limit {
        return Err(too_large(limit));
    }
    let mut bytes = Vec::new();
    (&mut file).take(HEAD).read_to_end(&mut bytes)?;
    if let Some(at) = bytes.iter().position(|byte| *byte == 0) {
        return Err(no_text(at));
    }
    let rest = (limit + 1).saturating_sub(bytes.len() as u64);
    file.take(rest).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > limit {
        return Err(too_large(limit));
    }
    as_text(bytes)
}

/// What is looked at before the whole of a text is read.
const HEAD: u64 = 4096;

/// Text of a file that a person named, of at most `limit` bytes; this may be a pipe.
///
/// # Errors
/// As the system tells, [`ErrorKind::FileTooLarge`], or [`ErrorKind::InvalidData`] where the file is not UTF-8.
pub fn read_text(path: &Path, limit: u64) -> io::Result<String> {
    as_text(read_to_limit(File::open(path)?, limit)?)
}

fn read_to_limit(file: impl Read, limit: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    file.take(limit + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > limit {
        return Err(too_large(limit));
    }
    Ok(bytes)
}

fn too_large(limit: u64) -> io::Error {
    let limit = if limit >= 1 << 20 {
        format!("{} MiB", limit >> 20)
    } else {
        format!("{limit} bytes")
    };
    let why = format!("the file is larger than {limit}, the most that is read of such a file");
    io::Error::new(ErrorKind::FileTooLarge, why)
}

fn as_text(bytes: Vec<u8>) -> io::Result<String> {
    String::from_utf8(bytes).map_err(|error| no_text(error.utf8_error().valid_up_to()))
}

fn no_text(at: usize) -> io::Error {
    let why = format!("byte {at} is not UTF-8 text; save the file as UTF-8");
    io::Error::new(ErrorKind::InvalidData, why)
}

/// The file as text for a command: as [`read_text`].
///
/// # Errors
/// Exit code 3 with the file's name.
pub fn text(path: &Path) -> Outcome<String> {
    read_text(path, MAX_TEXT).map_err(|e| bad_file(path, &e))
}

/// A file that could not be read.
#[must_use]
pub fn bad_file(path: &Path, error: &io::Error) -> Failure {
    Failure::say(
        Exit::BadFile,
        format!("cannot read {}: {error}", path.display()),
    )
}

fn cannot_write(path: &Path, error: &io::Error) -> Failure {
    Failure::say(
        Exit::Other,
        format!("cannot write {}: {error}", path.display()),
    )
}

/// Makes a folder and those above it.
///
/// # Errors
/// Exit code 1 with the folder's name.
pub fn make_folder(path: &Path) -> Outcome {
    std::fs::create_dir_all(path).map_err(|error| {
        Failure::say(
            Exit::Other,
            format!("cannot make the folder {}: {error}", path.display()),
        )
    })
}

/// Writes a folder of texts, with `force` beside what it holds already; gives their paths.
///
/// # Errors
/// As [`begin`] and [`finish`].
pub fn write_folder(
    folder: &Path,
    files: &[(String, String)],
    force: bool,
) -> Outcome<Vec<PathBuf>> {
    match force {
        true => make_folder(folder)?,
        false => {
            begin(folder)?;
            let names: Vec<String> = files.iter().map(|file| file.0.clone()).collect();
            claim(folder, &names)?;
        }
    }
    let mut written = Vec::new();
    for (name, text) in files {
        let path = folder.join(name);
        write(&path, text.as_bytes())?;
        written.push(path);
    }
    finish(folder)?;
    Ok(written)
}

/// An error of a TOML file as `FILE:LINE: what is wrong`.
#[must_use]
pub fn toml_error(path: &Path, text: &str, error: &toml::de::Error) -> Failure {
    let before = error.span().map_or(0, |span| span.start).min(text.len());
    let line = text.as_bytes()[..before]
        .iter()
        .filter(|b| **b == b'\n')
        .count()
        + 1;
    let message = format!("{}:{line}: {}", path.display(), error.message());
    Failure::say(Exit::BadFile, message)
}

/// Removes a folder with everything in it; one that is not there is no error.
///
/// # Errors
/// Exit code 1 with the folder's name.
pub fn remove_folder(path: &Path) -> Outcome {
    match std::fs::remove_dir_all(path) {
        Err(error) if error.kind() != ErrorKind::NotFound => {
            let message = format!("cannot remove {}: {error}", path.display());
            Err(Failure::say(Exit::Other, message))
        }
        _ => Ok(()),
    }
}

/// Name of a file while it is written.
#[must_use]
pub fn fresh(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".new");
    PathBuf::from(name)
}

/// Whether something stands at `path` that is no regular file, such as /dev/stdout: it is written to, not replaced.
#[must_use]
pub fn is_special(path: &Path) -> bool {
    std::fs::metadata(path).is_ok_and(|meta| !meta.is_file())
}

/// Writes a file in one step: after a power cut the old or the new one is there, never half of it.
///
/// # Errors
/// Exit code 1 with the file's name.
pub fn write(path: &Path, bytes: &[u8]) -> Outcome {
    let step = || {
        if is_special(path) {
            return std::fs::write(path, bytes);
        }
        let fresh = fresh(path);
        let mut file = File::create(&fresh)?;
        let written = file.write_all(bytes).and_then(|()| file.sync_all());
        if let Err(error) = written {
            let _ = std::fs::remove_file(&fresh);
            return Err(error);
        }
        std::fs::rename(&fresh, path)
    };
    step().map_err(|error| cannot_write(path, &error))
}

/// Writes one of many files that only count when a list that names them is written after them.
///
/// # Errors
/// Exit code 1 with the file's name.
pub fn write_part(path: &Path, bytes: &[u8]) -> Outcome {
    std::fs::write(path, bytes).map_err(|error| cannot_write(path, &error))
}

/// Writes a new file; an existing one only with `force`.
///
/// # Errors
/// Exit code 2 when it exists, 1 when the disk refuses.
pub fn write_new(path: &Path, bytes: &[u8], force: bool) -> Outcome {
    must_be_free(path, force)?;
    write(path, bytes)
}

/// Checks, before any long work, that a file can be written.
///
/// # Errors
/// Exit code 2 when it exists and `force` is not given, or when its folder is not there.
pub fn must_be_free(path: &Path, force: bool) -> Outcome {
    let shown = path.display();
    if path.is_dir() {
        let message = format!("{shown} is a folder; a file is to be written");
        return Err(Failure::say(Exit::Usage, message).hint("name a file in it"));
    }
    if !force && path.symlink_metadata().is_ok() {
        return Err(exists(path));
    }
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty());
    match folder {
        Some(folder) if !folder.is_dir() => {
            let message = format!(
                "cannot write {shown}: there is no folder {}",
                folder.display()
            );
            Err(Failure::say(Exit::Usage, message).hint("make the folder first"))
        }
        _ => Ok(()),
    }
}

/// The one refusal to overwrite.
#[must_use]
pub fn exists(path: &Path) -> Failure {
    Failure::say(Exit::Usage, format!("{} exists", path.display()))
        .hint("name another file or give --force")
}
