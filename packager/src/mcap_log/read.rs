//! Reading logs record by record, with all checksums, in bounded memory.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::Read;
use std::path::Path;

use mcap::records::Record;
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};

use crate::error::{PackError, Result};

/// Longest record that is read: a chunk of messages with one large image or cloud.
const MAX_RECORD_BYTES: usize = 256 << 20;

/// Bytes that are read from the file at once, at most.
const READ_BYTES: usize = 4 << 20;

/// What is of interest in a log.
pub(crate) enum LogRecord<'a> {
    /// A metadata record.
    Metadata {
        /// Name of the record.
        name: &'a str,
        /// Its entries.
        entries: &'a BTreeMap<String, String>,
    },
    /// A message.
    Message {
        /// Topic of its channel.
        topic: &'a str,
        /// Log time, nanoseconds.
        time_ns: u64,
        /// Serialised content.
        data: &'a [u8],
    },
}

/// Reads a whole log.
///
/// # Errors
/// [`PackError::Read`], and [`PackError::Damaged`] where a checksum fails, a length leads out of the file,
/// or a record would need more memory than any that we write.
pub(crate) fn for_each_record(path: &Path, mut visit: impl FnMut(LogRecord<'_>)) -> Result<()> {
    let mut file = File::open(path).map_err(|e| PackError::read(path, e))?;
    let damaged = |e: mcap::McapError| PackError::damaged(path, e.to_string());
    let options = LinearReaderOptions::default()
        .with_validate_chunk_crcs(true)
        .with_validate_data_section_crc(true)
        .with_validate_summary_section_crc(true)
        .with_check_finishes_after_end_magic(true)
        .with_record_length_limit(MAX_RECORD_BYTES);
    let mut reader = LinearReader::new_with_options(options);
    let mut topics: HashMap<u16, String> = HashMap::new();
    while let Some(event) = reader.next_event() {
        match event.map_err(damaged)? {
            LinearReadEvent::ReadRequest(wanted) => {
                let buffer = reader.insert(wanted.clamp(1, READ_BYTES));
                let count = file.read(buffer).map_err(|e| PackError::io(path, e))?;
                reader.notify_read(count);
            }
            LinearReadEvent::Record { data, opcode } => {
                match mcap::parse_record(opcode, data).map_err(damaged)? {
                    Record::Channel(channel) => {
                        topics.insert(channel.id, channel.topic);
                    }
                    Record::Message { header, data } => {
                        let topic = topics.get(&header.channel_id).ok_or_else(|| {
                            let channel = header.channel_id;
                            PackError::damaged(path, format!("no channel {channel} was declared"))
                        })?;
                        visit(LogRecord::Message { topic, time_ns: header.log_time, data: &data });
                    }
                    Record::Metadata(metadata) => {
                        let (name, entries) = (&metadata.name, &metadata.metadata);
                        visit(LogRecord::Metadata { name, entries });
                    }
                    _ => {}
                }
            }
        }
    }
    Ok(())
}
