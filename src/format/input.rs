//! Where the bytes of a file come from: memory, or a file of which ranges are read when they are wanted.
//!
//! Files are read and not mapped: when somebody cuts a mapped file short, the process that looks at it dies; a read fails,
//! which can be told.

use std::fs::File;
use std::io;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::channel;
use std::time::Instant;

use crate::error::{Error, Result, is_passing};
use crate::model::retry::{Retry, TRIES};
use crate::model::{Answer, INTERRUPT_INTERVAL, Traffic, Workers};

/// Bytes that somebody wants.
pub struct RangeRequest {
    /// Which; inside of the file as it was opened.
    pub range: Range<u64>,
    /// What takes them, all of them.
    pub answer: Answer<io::Result<Vec<u8>>>,
}

/// Bytes of which ranges are read.
pub trait Input: Send + Sync {
    /// Number of bytes.
    fn length(&self) -> u64;

    /// Reads a batch of ranges, the most wanted first, and returns before they are there. Each is answered by itself: in any
    /// order, from any thread. What blocks runs on `workers`, see [`read_blocking`]. Ranges that touch may be read as one.
    fn read(&self, batch: Vec<RangeRequest>, workers: &Workers);

    /// See [`crate::model::PageSource::batch_size`].
    fn batch_size(&self) -> usize {
        1
    }

    /// See [`crate::model::PageSource::tries`].
    fn tries(&self) -> u32 {
        TRIES
    }

    /// Whether nobody waits for what is opened or read now: then no pause is waited out.
    fn is_stopped(&self) -> bool {
        false
    }

    /// What reading has cost so far, where that is counted.
    fn traffic(&self) -> Traffic {
        Traffic::default()
    }
}

/// Answers a batch by calls that block, on the threads of who asks.
pub fn read_blocking(
    batch: Vec<RangeRequest>,
    workers: &Workers,
    read: impl Fn(Range<u64>) -> io::Result<Vec<u8>> + Send + Sync + 'static,
) {
    let read = Arc::new(read);
    for RangeRequest { range, answer } in batch {
        let read = Arc::clone(&read);
        workers.last(move || answer.send(read(range)));
    }
}

/// Reads ranges and waits for them; what fails for a passing reason is read again.
pub fn read_now(input: &dyn Input, ranges: &[Range<u64>]) -> io::Result<Vec<Vec<u8>>> {
    let mut found: Vec<Option<Vec<u8>>> = vec![None; ranges.len()];
    let mut retry = Retry::default();
    loop {
        let (sender, receiver) = channel();
        let absent = (0..ranges.len()).filter(|i| found[*i].is_none());
        let request = |i: usize| {
            let sender = sender.clone();
            let take = move |bytes| drop(sender.send((i, bytes)));
            RangeRequest { range: ranges[i].clone(), answer: Answer::new(take) }
        };
        let batch = absent.map(request).collect();
        drop(sender);
        input.read(batch, &Workers::inline());
        let mut failed = None;
        for (i, bytes) in receiver {
            match bytes.unwrap_or_else(|| Err(io::Error::new(io::ErrorKind::Unsupported, "no answer"))) {
                Ok(bytes) if bytes.len() as u64 == ranges[i].end - ranges[i].start => found[i] = Some(bytes),
                Ok(_) => return Err(io::ErrorKind::UnexpectedEof.into()),
                Err(error) if is_passing(&error) => failed = Some(error),
                Err(error) => return Err(error),
            }
        }
        let Some(error) = failed else { return Ok(found.into_iter().flatten().collect()) };
        let now = Instant::now();
        retry.failed(now);
        if retry.failures() >= input.tries() {
            return Err(error);
        }
        loop {
            if input.is_stopped() {
                return Err(error);
            }
            let pause = retry.pause(Instant::now());
            if pause.is_zero() {
                break;
            }
            std::thread::sleep(pause.min(INTERRUPT_INTERVAL));
        }
    }
}

/// Bytes in memory are there at once.
impl Input for Vec<u8> {
    fn length(&self) -> u64 {
        self.len() as u64
    }

    fn read(&self, batch: Vec<RangeRequest>, _: &Workers) {
        for RangeRequest { range, answer } in batch {
            let bytes = self.get(range.start as usize..range.end as usize);
            answer.send(bytes.map(<[u8]>::to_vec).ok_or_else(|| io::ErrorKind::UnexpectedEof.into()));
        }
    }
}

/// A file that stays open: what is renamed over it later does not change what is read.
#[derive(Debug)]
pub struct OnDisk {
    file: Arc<File>,
    length: u64,
}

impl OnDisk {
    /// Opens a file.
    pub fn open(path: &Path) -> Result<Self> {
        let io = |source| Error::Io { path: path.to_path_buf(), source };
        let file = File::open(path).map_err(io)?;
        let length = file.metadata().map_err(io)?.len();
        Ok(Self { file: Arc::new(file), length })
    }
}

#[cfg(unix)]
fn read_at(file: &File, bytes: &mut [u8], offset: u64) -> io::Result<usize> {
    std::os::unix::fs::FileExt::read_at(file, bytes, offset)
}

#[cfg(windows)]
fn read_at(file: &File, bytes: &mut [u8], offset: u64) -> io::Result<usize> {
    std::os::windows::fs::FileExt::seek_read(file, bytes, offset)
}

/// All bytes of a range.
fn read_range(file: &File, range: &Range<u64>) -> io::Result<Vec<u8>> {
    let mut bytes = vec![0; (range.end - range.start) as usize];
    let mut done = 0;
    while done < bytes.len() {
        match read_at(file, &mut bytes[done..], range.start + done as u64) {
            Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
            Ok(count) => done += count,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(bytes)
}

impl Input for OnDisk {
    fn length(&self) -> u64 {
        self.length
    }

    fn read(&self, batch: Vec<RangeRequest>, workers: &Workers) {
        let file = Arc::clone(&self.file);
        read_blocking(batch, workers, move |range| read_range(&file, &range));
    }
}
