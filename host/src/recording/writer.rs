//! Writes a recording so that a power cut loses at most the last second.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use control::gait::Gait;
use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, WriteOptions, Writer};

use super::rows::{EventRow, RunEndRow, RunStart, SampleRow};
use super::schema::{CPG, EVENTS, JOINT_STATES, MOTORS, TOPICS, Topic};
use super::{FORMAT, PROFILE, RUN_METADATA, decode};
use crate::disk;

/// Samples per chunk: one second at 20 Hz, which is what a power cut may lose.
const SAMPLES_PER_CHUNK: u32 = 20;

/// What stands at the head of a recording.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Header {
    /// `rb-host` version.
    pub tool: String,
    /// Firmware id.
    pub firmware: String,
    /// Robot id.
    pub robot: String,
    /// Port URI.
    pub port: String,
    /// Whether the robot is the emulated one in this process.
    pub emulated: bool,
    /// Digest of the robot model in the firmware, hexadecimal.
    pub model_digest: String,
    /// Nanoseconds to add to the device clock to get recording time: 0 on virtual time, else the host clock's offset.
    pub clock_offset_ns: i64,
}

/// Why a recording could not be written.
#[derive(Debug, thiserror::Error)]
pub enum RecorderError {
    /// The file exists.
    #[error("{path} exists")]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// The file cannot be created.
    #[error("cannot create {path}")]
    Create {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// Writing failed; what was written before is readable.
    #[error("cannot write {path}; everything recorded before is kept")]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: mcap::McapError,
    },
}

/// A file whose `flush` reaches the disk, not only the kernel.
#[derive(Debug)]
struct DiskFile(File);

impl Write for DiskFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        match self.0.sync_data() {
            // A pipe or a special file cannot be synchronised; there is nothing to lose then.
            Err(e) if e.kind() == io::ErrorKind::InvalidInput => Ok(()),
            other => other,
        }
    }
}

impl Seek for DiskFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.0.seek(to)
    }
}

/// A file under another name until its run begins; removed when that never happens.
#[derive(Debug)]
struct Unborn(PathBuf);

impl Drop for Unborn {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

impl Unborn {
    fn rename(self, path: &Path) -> io::Result<()> {
        std::fs::rename(&self.0, path)
    }
}

/// A recording being written.
pub struct Recorder {
    path: PathBuf,
    unborn: Option<Unborn>,
    writer: Writer<DiskFile>,
    channels: [u16; TOPICS.len()],
    clock_offset_ns: i64,
    sequence: u32,
    since_flush: u32,
}

impl core::fmt::Debug for Recorder {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Recorder")
            .field("path", &self.path)
            .finish_non_exhaustive()
    }
}

impl Recorder {
    /// Creates the file and writes header, schemas and channels. It gets its name when its run starts: a robot that refuses leaves
    /// neither an empty recording nor a hole where an earlier one stood.
    ///
    /// # Errors
    /// [`RecorderError`]
    pub fn create(path: &Path, force: bool, header: &Header) -> Result<Self, RecorderError> {
        if !force && path.symlink_metadata().is_ok() {
            let path = path.to_owned();
            return Err(RecorderError::Exists { path });
        }
        let fresh = (!disk::is_special(path)).then(|| disk::fresh(path));
        let mut options = OpenOptions::new();
        options.write(true).truncate(true).create(true);
        let file = options
            .open(fresh.as_deref().unwrap_or(path))
            .map_err(|source| {
                let path = path.to_owned();
                RecorderError::Create { path, source }
            })?;
        let unborn = fresh.map(Unborn);
        Self::open(path, (file, unborn), header).map_err(|source| RecorderError::Write {
            path: path.to_owned(),
            source,
        })
    }

    fn open(
        path: &Path,
        (file, unborn): (File, Option<Unborn>),
        header: &Header,
    ) -> mcap::McapResult<Self> {
        // Chunks are appended whole: nothing already on the disk is changed later.
        let options = WriteOptions::new()
            .profile(PROFILE)
            .library(format!("rb-host {}", env!("CARGO_PKG_VERSION")))
            .compression(None)
            .disable_seeking(true);
        let mut writer = options.create(DiskFile(file))?;
        let mut channels = [0; TOPICS.len()];
        for (channel, topic) in channels.iter_mut().zip(TOPICS) {
            let schema = writer.add_schema(topic.schema, "ros2msg", topic.text.as_bytes())?;
            *channel = writer.add_channel(schema, topic.topic, "cdr", &BTreeMap::new())?;
        }
        let metadata = [
            ("format", FORMAT.to_string()),
            ("tool", header.tool.clone()),
            ("firmware", header.firmware.clone()),
            ("robot", header.robot.clone()),
            ("port", header.port.clone()),
            ("emulated", header.emulated.to_string()),
            ("model_digest", header.model_digest.clone()),
            ("clock_offset_ns", header.clock_offset_ns.to_string()),
        ];
        writer.write_metadata(&metadata_record(&metadata))?;
        writer.flush()?;
        Ok(Self {
            path: path.to_owned(),
            unborn,
            writer,
            channels,
            clock_offset_ns: header.clock_offset_ns,
            sequence: 0,
            since_flush: 0,
        })
    }

    /// Attaches a file such as `gait.toml`.
    ///
    /// # Errors
    /// [`RecorderError::Write`]
    pub fn attach(
        &mut self,
        name: &str,
        media_type: &str,
        data: &[u8],
    ) -> Result<(), RecorderError> {
        let attachment = Attachment {
            log_time: 0,
            create_time: 0,
            name: name.to_owned(),
            media_type: media_type.to_owned(),
            data: data.into(),
        };
        self.write(|w| {
            w.attach(&attachment)?;
            w.flush()
        })
    }

    /// Notes the start of a run.
    ///
    /// # Errors
    /// [`RecorderError::Write`]
    pub fn start_run(&mut self, start: &RunStart) -> Result<(), RecorderError> {
        let metadata = [
            ("event", "start".to_owned()),
            ("run", start.run.to_string()),
            ("gait", start.gait.clone()),
            ("digest", start.digest.clone()),
            ("duration_s", start.duration_s.to_string()),
            ("rate_hz", start.rate_hz.to_string()),
        ];
        self.write(|w| {
            w.write_metadata(&metadata_record(&metadata))?;
            w.flush()
        })?;
        self.take_name()
    }

    /// From here on the file stands under its own name.
    fn take_name(&mut self) -> Result<(), RecorderError> {
        let Some(unborn) = self.unborn.take() else {
            return Ok(());
        };
        let path = &self.path;
        unborn.rename(path).map_err(|source| RecorderError::Create {
            path: path.clone(),
            source,
        })
    }

    /// Appends one sample to `/joint_states` and `/rb/motors`.
    ///
    /// # Errors
    /// [`RecorderError::Write`]
    pub fn sample(&mut self, row: &SampleRow) -> Result<(), RecorderError> {
        let time_ns = self.time_ns(row.t_us);
        self.message(JOINT_STATES, time_ns, &decode::joint_state(row, time_ns))?;
        self.message(MOTORS, time_ns, &decode::motors(row, time_ns))?;
        self.since_flush += 1;
        if self.since_flush >= SAMPLES_PER_CHUNK {
            self.flush()?;
        }
        Ok(())
    }

    /// Appends an event.
    ///
    /// # Errors
    /// [`RecorderError::Write`]
    pub fn event(&mut self, row: &EventRow) -> Result<(), RecorderError> {
        let time_ns = self.time_ns(row.t_us);
        self.message(EVENTS, time_ns, &decode::event(row, time_ns))
    }

    /// Appends the set-points that the host computes for the same gait; `start_us` is the device time of its first tick.
    ///
    /// # Errors
    /// [`RecorderError::Write`]
    pub fn host_cpg(
        &mut self,
        run: u32,
        gait: &Gait,
        cycles: u32,
        start_us: u64,
    ) -> Result<(), RecorderError> {
        let mut state = control::cpg::start(gait);
        for cycle in 0..cycles {
            let set_points = control::cpg::step(gait, &mut state, control::CYCLE_S);
            let angles = set_points.as_slice().iter();
            let values: Vec<f64> = angles.map(|angle| f64::from(*angle)).collect();
            let time_ns = self.time_ns(start_us + u64::from(cycle) * control::CYCLE_US);
            self.message(CPG, time_ns, &decode::cpg(run, cycle, &values, time_ns))?;
        }
        Ok(())
    }

    /// Notes the end of a run with its counts, and flushes.
    ///
    /// # Errors
    /// [`RecorderError::Write`]
    pub fn end_run(&mut self, end: &RunEndRow) -> Result<(), RecorderError> {
        let metadata = [
            ("event", "end".to_owned()),
            ("run", end.run.to_string()),
            ("reason", end.reason.clone()),
            ("cycles", end.cycles.to_string()),
            ("holds", end.holds.to_string()),
            ("samples", end.samples.to_string()),
            ("dropped_by_module", end.dropped_by_module.to_string()),
            ("recorded", end.recorded.to_string()),
            ("lost_on_link", end.lost_on_link.to_string()),
            ("reconnects", end.reconnects.to_string()),
            ("setpoint_crc32c", format!("{:08x}", end.setpoint_crc32c)),
        ];
        self.write(|w| {
            w.write_metadata(&metadata_record(&metadata))?;
            w.flush()
        })
    }

    /// Writes out the current chunk.
    ///
    /// # Errors
    /// [`RecorderError::Write`]
    pub fn flush(&mut self) -> Result<(), RecorderError> {
        self.since_flush = 0;
        self.write(Writer::flush)
    }

    /// Closes the file with its index.
    ///
    /// # Errors
    /// [`RecorderError::Write`]
    pub fn finish(mut self) -> Result<(), RecorderError> {
        self.write(|w| w.finish().map(drop))?;
        self.take_name()?;
        let Self { path, writer, .. } = self;
        writer
            .into_inner()
            .flush()
            .map_err(|e| RecorderError::Write {
                path,
                source: e.into(),
            })
    }

    /// The file being written.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Recording time of a device time.
    fn time_ns(&self, t_us: u64) -> u64 {
        let device_ns = t_us.saturating_mul(1000);
        device_ns.saturating_add_signed(self.clock_offset_ns)
    }

    fn message(&mut self, topic: Topic, time_ns: u64, data: &[u8]) -> Result<(), RecorderError> {
        let place = TOPICS.iter().position(|t| *t == topic).unwrap_or(0);
        let header = MessageHeader {
            channel_id: self.channels[place],
            sequence: self.sequence,
            log_time: time_ns,
            publish_time: time_ns,
        };
        self.sequence = self.sequence.wrapping_add(1);
        self.write(|w| w.write_to_known_channel(&header, data))
    }

    fn write(
        &mut self,
        action: impl FnOnce(&mut Writer<DiskFile>) -> mcap::McapResult<()>,
    ) -> Result<(), RecorderError> {
        action(&mut self.writer).map_err(|source| RecorderError::Write {
            path: self.path.clone(),
            source,
        })
    }
}

fn metadata_record(entries: &[(&str, String)]) -> Metadata {
    let metadata = entries
        .iter()
        .map(|(k, v)| ((*k).to_owned(), v.clone()))
        .collect();
    Metadata {
        name: RUN_METADATA.to_owned(),
        metadata,
    }
}
