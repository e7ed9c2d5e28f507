//! The one door to files that a data set names: somebody else may have written the data set.
//!
//! A name is looked up inside the folder only. Absolute names, `..` and symbolic links that lead out of the folder are refused by
//! the system call where there is one (`openat2`), so a folder that changes meanwhile opens no gap. Folders, devices and pipes are
//! refused as well, and so is a file above the caller's limit.

use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use cap_std::ambient_authority;
use cap_std::fs::{Dir, File, OpenOptions};

use crate::disk;

/// A folder whose files may come from anybody.
#[derive(Debug)]
pub struct DataFolder {
    path: PathBuf,
    dir: Dir,
}

impl DataFolder {
    /// Opens a folder that a person named.
    ///
    /// # Errors
    /// As the system says.
    pub fn open(path: &Path) -> io::Result<Self> {
        // The folder of a file that is named without one.
        let here = if path.as_os_str().is_empty() {
            Path::new(".")
        } else {
            path
        };
        let dir = Dir::open_ambient_dir(here, ambient_authority())?;
        let path = path.to_owned();
        Ok(Self { path, dir })
    }

    /// The folder that holds a data set: `data` itself, or the folder of a single recording.
    ///
    /// # Errors
    /// As the system says.
    pub fn of(data: &Path) -> io::Result<Self> {
        if data.is_dir() {
            return Self::open(data);
        }
        Self::open(data.parent().unwrap_or(data))
    }

    /// Path for messages.
    #[must_use]
    pub fn shown(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// Whether something with this name can be opened through this door.
    #[must_use]
    pub fn has(&self, name: &str) -> bool {
        self.dir.metadata(name).is_ok()
    }

    /// Whether a regular file has this name.
    #[must_use]
    pub fn has_file(&self, name: &str) -> bool {
        self.dir.metadata(name).is_ok_and(|meta| meta.is_file())
    }

    /// When a file was last written.
    #[must_use]
    pub fn modified(&self, name: &str) -> Option<SystemTime> {
        let time = self.dir.metadata(name).ok()?.modified().ok()?;
        Some(time.into_std())
    }

    /// Opens a regular file of the folder.
    ///
    /// # Errors
    /// As the system says, or [`ErrorKind::InvalidInput`] for a name that leads out of the folder and for anything but a regular file.
    pub fn file(&self, name: &str) -> io::Result<std::fs::File> {
        let mut options = OpenOptions::new();
        options.read(true);
        #[cfg(unix)]
        {
            use cap_std::fs::OpenOptionsExt;
            // A pipe without a writer opens at once; on a regular file the flag has no effect.
            options.custom_flags(libc::O_NONBLOCK);
        }
        let opened = self.dir.open_with(name, &options).map_err(leads_out)?;
        disk::must_be_regular(File::into_std(opened))
    }

    /// Reads a regular file of at most `limit` bytes.
    ///
    /// # Errors
    /// As [`Self::file`], or [`ErrorKind::FileTooLarge`].
    pub fn bytes(&self, name: &str, limit: u64) -> io::Result<Vec<u8>> {
        disk::read_opened(self.file(name)?, limit)
    }

    /// Text of a regular file of at most `limit` bytes.
    ///
    /// # Errors
    /// As [`Self::bytes`], or [`ErrorKind::InvalidData`] where the file is not UTF-8 text.
    pub fn text(&self, name: &str, limit: u64) -> io::Result<String> {
        disk::read_opened_text(self.file(name)?, limit)
    }
}

/// What the library says of a name that leads out has no word of the folder.
fn leads_out(error: io::Error) -> io::Error {
    if error.kind() == ErrorKind::PermissionDenied && error.raw_os_error().is_none() {
        let why = "the name leads out of the folder of the data set; copy the file into it";
        return io::Error::new(ErrorKind::InvalidInput, why);
    }
    error
}
