//! Keys of robots, one file each, readable by their owner alone.

use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

use protocol::link::{KEY_LEN, Key, Nonce};

/// Where keys are kept.
#[derive(Debug, Clone)]
pub struct KeyStore {
    folder: Option<PathBuf>,
    file: Option<PathBuf>,
}

impl KeyStore {
    /// `file`, if given, holds the key of every robot; else each has `folder/robot-ID.key`.
    #[must_use]
    pub fn new(folder: Option<PathBuf>, file: Option<PathBuf>) -> Self {
        Self { folder, file }
    }

    /// The file of a robot's key.
    #[must_use]
    pub fn path(&self, robot_id: u8) -> Option<PathBuf> {
        let in_folder = || {
            self.folder
                .as_ref()
                .map(|folder| folder.join(format!("robot-{robot_id}.key")))
        };
        self.file.clone().or_else(in_folder)
    }

    /// The key of a robot, if its file holds one.
    #[must_use]
    pub fn load(&self, robot_id: u8) -> Option<Key> {
        let text = std::fs::read_to_string(self.path(robot_id)?).ok()?;
        parse_key(text.trim())
    }

    /// Writes a key where [`KeyStore::load`] finds it, readable by its owner alone.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn save(&self, robot_id: u8, key: &Key) -> io::Result<PathBuf> {
        let path = self.path(robot_id).ok_or_else(|| {
            io::Error::new(
                io::ErrorKind::NotFound,
                "no folder for keys: set HOME or key_file",
            )
        })?;
        let folder = path.parent().map_or(Ok(()), std::fs::create_dir_all);
        let written = folder.and_then(|()| write_private(&path, &format_key(key)));
        match written {
            Ok(()) => Ok(path),
            Err(error) => {
                let message = format!("cannot write {}: {error}", path.display());
                Err(io::Error::new(error.kind(), message))
            }
        }
    }
}

#[cfg(unix)]
fn write_private(path: &Path, text: &str) -> io::Result<()> {
    use std::os::unix::fs::{OpenOptionsExt, PermissionsExt};
    let mut options = std::fs::OpenOptions::new();
    let mut file = options
        .write(true)
        .create(true)
        .truncate(true)
        .mode(0o600)
        .open(path)?;
    file.set_permissions(std::fs::Permissions::from_mode(0o600))?;
    file.write_all(text.as_bytes())?;
    file.sync_all()
}

#[cfg(not(unix))]
fn write_private(path: &Path, text: &str) -> io::Result<()> {
    let mut file = std::fs::File::create(path)?;
    file.write_all(text.as_bytes())?;
    file.sync_all()
}

/// A new key from the operating system.
///
/// # Errors
/// There is no source of randomness.
pub fn new_key() -> io::Result<Key> {
    Ok(Key(random()?))
}

/// A challenge for the robot.
///
/// # Errors
/// There is no source of randomness.
pub fn new_nonce() -> io::Result<Nonce> {
    Ok(Nonce(random()?))
}

fn random<const N: usize>() -> io::Result<[u8; N]> {
    let mut bytes = [0; N];
    std::fs::File::open("/dev/urandom")?.read_exact(&mut bytes)?;
    Ok(bytes)
}

fn format_key(key: &Key) -> String {
    let mut text: String = key.0.iter().map(|b| format!("{b:02x}")).collect();
    text.push('\n');
    text
}

fn parse_key(text: &str) -> Option<Key> {
    if text.len() != 2 * KEY_LEN || !text.is_ascii() {
        return None;
    }
    let mut bytes = [0; KEY_LEN];
    for (i, byte) in bytes.iter_mut().enumerate() {
        *byte = u8::from_str_radix(text.get(2 * i..2 * i + 2)?, 16).ok()?;
    }
    Some(Key(bytes))
}
