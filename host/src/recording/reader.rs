//! Reads a recording back, whole or damaged.

use std::collections::BTreeMap;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

use mcap::records::Record;

use super::rows::{EventRow, RunEndRow, RunStart, SampleRow};
use super::scan::{Damage, DamageKind, MAX_DAMAGE, Sink, scan};
use super::schema::{EVENTS, MOTORS};
use super::{RUN_METADATA, decode};
use crate::disk;

/// A file stored in the recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Attachment {
    /// File name.
    pub name: String,
    /// Media type.
    pub media_type: String,
    /// Content.
    pub data: Vec<u8>,
}

/// A channel with the number of its messages.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ChannelCount {
    /// Topic.
    pub topic: String,
    /// Type name.
    pub schema: String,
    /// Message encoding.
    pub encoding: String,
    /// Messages read.
    pub messages: u64,
    /// Recording time of the first and last message, ns.
    pub span_ns: Option<(u64, u64)>,
}

/// One run of a recording.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RunData {
    /// Number within the recording.
    pub run: u32,
    /// How it began, if that was recorded.
    pub start: Option<RunStart>,
    /// Samples in the order of their device time, each once.
    pub samples: Vec<SampleRow>,
    /// Events in the order of their time.
    pub events: Vec<EventRow>,
    /// How it ended, if that was recorded.
    pub end: Option<RunEndRow>,
}

/// All that could be read of a recording.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Recording {
    /// Profile in the header.
    pub profile: String,
    /// Writing program.
    pub library: String,
    /// The `rb.run` metadata of the whole file.
    pub about: BTreeMap<String, String>,
    /// Runs in order.
    pub runs: Vec<RunData>,
    /// Attached files.
    pub attachments: Vec<Attachment>,
    /// Channels in order of their id.
    pub channels: Vec<ChannelCount>,
    /// Damaged places in file order; empty = the file is whole.
    pub damage: Vec<Damage>,
}

impl Recording {
    /// An attached text file.
    #[must_use]
    pub fn text(&self, name: &str) -> Option<&str> {
        let attachment = self.attachments.iter().find(|a| a.name == name)?;
        core::str::from_utf8(&attachment.data).ok()
    }

    /// The topics of a file that another program wrote; `None` for a recording of rb-host.
    #[must_use]
    pub fn foreign_topics(&self) -> Option<String> {
        let ours = |c: &ChannelCount| c.topic == MOTORS.topic && c.schema == MOTORS.schema;
        if self.channels.is_empty() || self.channels.iter().any(ours) {
            return None;
        }
        let mut topics: Vec<&str> = self.channels.iter().map(|c| c.topic.as_str()).collect();
        topics.sort_unstable();
        Some(topics.join(", "))
    }

    /// Whether the robot was an emulated one, in the process of rb-host or behind a port.
    #[must_use]
    pub fn is_emulated(&self) -> bool {
        let about = |key: &str| self.about.get(key).map(String::as_str);
        about("emulated") == Some("true") || about("port").is_some_and(|p| p.starts_with("sim:"))
    }
}

/// Why a recording cannot be read at all.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file cannot be opened or read.
    #[error("cannot read {path}")]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// Larger than this reader takes.
    #[error(
        "{path} is larger than 1 GiB, the most that is read; cut the recording with the mcap tool first"
    )]
    TooLarge {
        /// The file.
        path: PathBuf,
    },
    /// No MCAP file.
    #[error("{path} is not an MCAP recording (its first bytes differ)")]
    NotMcap {
        /// The file.
        path: PathBuf,
    },
}

/// Reads a recording. Damage is told in the result; only a file that is no recording is an error.
///
/// # Errors
/// [`ReadError`]
pub fn read(path: &Path) -> Result<Recording, ReadError> {
    read_opened(path, disk::open_regular(path))
}

/// Reads a recording that was opened; `path` is for messages.
///
/// # Errors
/// [`ReadError`]
pub(super) fn read_opened(path: &Path, opened: io::Result<File>) -> Result<Recording, ReadError> {
    let io = |source| ReadError::Io {
        path: path.to_owned(),
        source,
    };
    let file = match opened.and_then(|file| disk::read_opened(file, disk::MAX_DATA)) {
        Err(error) if error.kind() == io::ErrorKind::FileTooLarge => {
            return Err(ReadError::TooLarge {
                path: path.to_owned(),
            });
        }
        other => other.map_err(io)?,
    };
    let recording = parse(&file);
    match recording.damage.first() {
        Some(Damage {
            kind: DamageKind::Magic,
            ..
        }) => Err(ReadError::NotMcap {
            path: path.to_owned(),
        }),
        _ => Ok(recording),
    }
}

/// Reads a recording from memory.
#[must_use]
pub fn parse(file: &[u8]) -> Recording {
    let mut collector = Collector::default();
    scan(file, &mut collector);
    collector.finish()
}

#[derive(Default)]
struct Collector {
    recording: Recording,
    schemas: BTreeMap<u16, String>,
    channels: BTreeMap<u16, ChannelCount>,
    runs: BTreeMap<u32, RunData>,
}

impl Sink for Collector {
    fn record(&mut self, offset: u64, record: Record<'_>) {
        match record {
            Record::Header(header) => {
                self.recording.profile = header.profile;
                self.recording.library = header.library;
            }
            Record::Schema { header, .. } => {
                self.schemas.insert(header.id, header.name);
            }
            Record::Channel(channel) => {
                let schema = self
                    .schemas
                    .get(&channel.schema_id)
                    .cloned()
                    .unwrap_or_default();
                self.channels.entry(channel.id).or_insert(ChannelCount {
                    topic: channel.topic,
                    schema,
                    encoding: channel.message_encoding,
                    messages: 0,
                    span_ns: None,
                });
            }
            Record::Message { header, data } => {
                self.message(offset, header.channel_id, header.log_time, &data)
            }
            Record::Attachment { header, data, .. } => {
                self.recording.attachments.push(Attachment {
                    name: header.name,
                    media_type: header.media_type,
                    data: data.into_owned(),
                })
            }
            Record::Metadata(metadata) if metadata.name == RUN_METADATA => {
                self.metadata(metadata.metadata)
            }
            _ => {}
        }
    }

    fn damage(&mut self, damage: Damage) {
        if self.recording.damage.len() < MAX_DAMAGE {
            self.recording.damage.push(damage);
        }
    }
}

impl Collector {
    fn message(&mut self, offset: u64, channel: u16, time_ns: u64, data: &[u8]) {
        let Some(channel) = self.channels.get_mut(&channel) else {
            return self.damage(Damage {
                offset,
                kind: DamageKind::Channel,
            });
        };
        channel.messages += 1;
        let (first, last) = channel.span_ns.unwrap_or((time_ns, time_ns));
        channel.span_ns = Some((first.min(time_ns), last.max(time_ns)));
        let read = if channel.schema == MOTORS.schema && channel.topic == MOTORS.topic {
            decode::read_motors(data).map(|row| self.run(row.run).samples.push(row))
        } else if channel.schema == EVENTS.schema {
            decode::read_event(data).map(|row| self.run(row.run).events.push(row))
        } else {
            Ok(())
        };
        if read.is_err() {
            self.damage(Damage {
                offset,
                kind: DamageKind::Message,
            });
        }
    }

    fn run(&mut self, run: u32) -> &mut RunData {
        self.runs.entry(run).or_insert_with(|| RunData {
            run,
            ..RunData::default()
        })
    }

    fn metadata(&mut self, map: BTreeMap<String, String>) {
        let number = |key: &str| map.get(key).and_then(|v| v.parse().ok()).unwrap_or(0u32);
        let text = |key: &str| map.get(key).cloned().unwrap_or_default();
        let real = |key: &str| map.get(key).and_then(|v| v.parse().ok()).unwrap_or(0.0f64);
        let run = number("run");
        match map.get("event").map(String::as_str) {
            Some("start") => {
                self.run(run).start = Some(RunStart {
                    run,
                    gait: text("gait"),
                    digest: text("digest"),
                    duration_s: real("duration_s"),
                    rate_hz: real("rate_hz"),
                });
            }
            Some("end") => {
                self.run(run).end = Some(RunEndRow {
                    run,
                    reason: text("reason"),
                    cycles: number("cycles"),
                    holds: number("holds"),
                    samples: number("samples"),
                    dropped_by_module: number("dropped_by_module"),
                    recorded: number("recorded"),
                    lost_on_link: number("lost_on_link"),
                    reconnects: number("reconnects"),
                    setpoint_crc32c: u32::from_str_radix(&text("setpoint_crc32c"), 16).unwrap_or(0),
                });
            }
            _ => self.recording.about.extend(map),
        }
    }

    fn finish(self) -> Recording {
        let mut recording = self.recording;
        recording.channels = self.channels.into_values().collect();
        recording.runs = self.runs.into_values().collect();
        for run in &mut recording.runs {
            // A link that dropped out delivers the missing samples later.
            run.samples.sort_by_key(|s| s.t_us);
            run.samples.dedup_by_key(|s| s.t_us);
            run.events.sort_by_key(|e| (e.t_us, e.seq));
        }
        recording
    }
}
