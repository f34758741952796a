//! The build-state file: what the last builds of one pipeline saw. It spares work and is never the truth.
//!
//! ```text
//! header   "kiln state 1\n" and zeros up to 16 bytes
//! frames   { length u32, kind u32, first 8 bytes of BLAKE3(kind, payload) } payload
//!          kind 1  memo      path, stat, content
//!          kind 2  head      manifest fields shared by many actions
//!          kind 3  last      an action's last manifest and record, by id; names its head by number
//!          kind 4  noop      stats of everything that a build without work looks at (`noop.rs`)
//! ```
//!
//! Appended to at the end of a build, a later frame wins; rewritten when more than half of the entries are dead. Opening reads
//! the file once and walks the frame lengths; a frame's checksum is verified when it is used, so the check for a build without
//! work touches one frame. A damaged frame is skipped, a torn tail is cut, a missing file is an empty one: never an error.

use std::collections::{HashMap, HashSet};
use std::fs;
use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::disk::{self, Stat};
use crate::error::IoError;
use crate::hash::ContentHash;
use crate::manifest::{Field, InputField, Manifest};
use crate::report::Record;
use crate::store::{Store, decode, encode};

const HEADER: &[u8; 16] = b"kiln state 1\n\0\0\0";
/// Length, kind, checksum.
const FRAME: usize = 16;

const MEMO: u32 = 0x6b01;
const HEAD: u32 = 0x6b02;
const LAST: u32 = 0x6b03;
const NOOP: u32 = 0x6b04;

/// What is known of an action's last build.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Last {
    pub(crate) manifest: Manifest,
    pub(crate) record: Arc<Record>,
}

#[derive(Serialize, Deserialize)]
struct StoredLast {
    id: String,
    head: ContentHash,
    inputs: Vec<InputField>,
    record: Record,
}

/// What a build met.
#[derive(Default)]
pub(crate) struct Seen<'a> {
    /// Ids of its actions.
    pub(crate) actions: HashSet<&'a str>,
    /// Paths of the files that it looked at.
    pub(crate) files: HashSet<&'a str>,
}

/// The file in memory.
pub(crate) struct State {
    path: PathBuf,
    bytes: Vec<u8>,
    frames: Vec<(u32, Range<usize>)>,
    /// End of the last whole frame.
    valid: usize,
    loaded: bool,
    memo: HashMap<String, (Stat, ContentHash)>,
    heads: HashMap<ContentHash, Arc<[Field]>>,
    last: HashMap<String, Last>,
    noop: Option<Vec<u8>>,
    /// Frames in the file and to be appended, dead ones included.
    entries: usize,
    appended: Vec<u8>,
}

impl State {
    /// Reads the file and finds its frames.
    pub(crate) fn open(path: PathBuf) -> State {
        let bytes = fs::read(&path).unwrap_or_default();
        let (frames, valid) = frames(&bytes);
        State {
            path,
            entries: frames.len(),
            bytes,
            frames,
            valid,
            loaded: false,
            memo: HashMap::new(),
            heads: HashMap::new(),
            last: HashMap::new(),
            noop: None,
            appended: Vec::new(),
        }
    }

    /// The last no-op frame, if it verifies. Does not decode anything else.
    pub(crate) fn noop(&self) -> Option<&[u8]> {
        if self.noop.is_some() {
            return self.noop.as_deref();
        }
        let (kind, range) = self.frames.iter().rfind(|(kind, _)| *kind == NOOP)?;
        verified(&self.bytes, *kind, range)
    }

    /// Decodes memo and manifests; does nothing the second time.
    pub(crate) fn load(&mut self) {
        if self.loaded {
            return;
        }
        self.loaded = true;
        self.noop = self.noop().map(<[u8]>::to_vec);
        let bytes = std::mem::take(&mut self.bytes);
        for (kind, range) in std::mem::take(&mut self.frames) {
            if let Some(payload) = verified(&bytes, kind, &range) {
                // A frame that does not decode was written by a defect: what it knew is known no more.
                let _ = self.take_in(kind, payload);
            }
        }
    }

    fn take_in(&mut self, kind: u32, payload: &[u8]) -> Option<()> {
        match kind {
            MEMO => {
                let (path, stat, hash): (String, Stat, ContentHash) = decode(payload)?;
                self.memo.insert(path, (stat, hash));
            }
            HEAD => {
                let fields: Vec<Field> = decode(payload)?;
                self.heads.insert(ContentHash::of(payload), fields.into());
            }
            LAST => {
                let stored: StoredLast = decode(payload)?;
                let head = self.heads.get(&stored.head)?.clone();
                let manifest = Manifest::of_parts(head, stored.inputs);
                self.last.insert(stored.id, Last { manifest, record: Arc::new(stored.record) });
            }
            _ => {}
        }
        Some(())
    }

    /// The content that the file at `path` had when its stat was the one given.
    pub(crate) fn memo(&self, path: &str) -> Option<&(Stat, ContentHash)> {
        self.memo.get(path)
    }

    /// What the last build knew of action `id`.
    pub(crate) fn last(&self, id: &str) -> Option<&Last> {
        self.last.get(id)
    }

    /// All actions' last builds, by id.
    pub(crate) fn lasts(&self) -> Vec<(&String, &Last)> {
        sorted(&self.last)
    }

    /// Notes a file's content.
    pub(crate) fn set_memo(&mut self, path: &str, stat: Stat, hash: ContentHash) {
        if self.memo.get(path) != Some(&(stat, hash)) {
            self.memo.insert(path.to_owned(), (stat, hash));
            self.push(MEMO, &encode(&(path, stat, hash)));
        }
    }

    /// Notes an action's manifest and record.
    pub(crate) fn set_last(&mut self, id: &str, last: Last) {
        if self.last.get(id) == Some(&last) {
            return;
        }
        let (name, head) = stored_head(&last);
        if self.heads.insert(name, last.manifest.head.clone()).is_none() {
            self.push(HEAD, &head);
        }
        self.push(LAST, &stored_last(id, name, &last));
        self.last.insert(id.to_owned(), last);
    }

    /// Notes the no-op frame.
    pub(crate) fn set_noop(&mut self, payload: Vec<u8>) {
        if self.noop.as_ref() != Some(&payload) {
            self.push(NOOP, &payload);
            self.noop = Some(payload);
        }
    }

    fn push(&mut self, kind: u32, payload: &[u8]) {
        push_frame(&mut self.appended, kind, payload);
        self.entries += 1;
    }

    /// Writes what is new. Another process that writes at the same moment goes first, and ours is dropped: costs time only.
    ///
    /// A rewrite keeps the actions and files that `seen` names: others belong to a plan of the past.
    pub(crate) fn save(&mut self, store: &Store, seen: &Seen<'_>) -> Result<(), IoError> {
        if self.appended.is_empty() {
            return Ok(());
        }
        let live = self.memo.len() + self.heads.len() + self.last.len() + self.noop.is_some() as usize;
        let wasteful = self.entries > 2 * live + 64;
        let Some(lock) = store.try_lock(&self.path)? else { return Ok(()) };
        let length = fs::metadata(&self.path).map_or(0, |metadata| metadata.len());
        if length != self.valid as u64 {
            // A torn tail, or frames of another builder: keep what is whole.
            (_, self.valid) = frames(&fs::read(&self.path).unwrap_or_default());
        }
        let appended = std::mem::take(&mut self.appended);
        if wasteful {
            self.rewrite(store, seen)?;
        } else if self.valid == 0 {
            disk::write(&self.path, &[HEADER, &appended], false)?;
            self.valid = HEADER.len() + appended.len();
        } else {
            if length != self.valid as u64 {
                disk::truncate(&self.path, self.valid as u64)?;
            }
            disk::append(&self.path, &appended)?;
            self.valid += appended.len();
        }
        drop(lock);
        Ok(())
    }

    /// Writes the live entries to a new file.
    fn rewrite(&mut self, store: &Store, seen: &Seen<'_>) -> Result<(), IoError> {
        self.last.retain(|id, _| seen.actions.contains(id.as_str()));
        self.memo.retain(|path, _| seen.files.contains(path.as_str()));
        let mut heads = HashMap::new();
        let mut bytes = HEADER.to_vec();
        let mut entries = 0;
        let mut push = |kind, payload: &[u8]| {
            push_frame(&mut bytes, kind, payload);
            entries += 1;
        };
        for (path, (stat, hash)) in sorted(&self.memo) {
            push(MEMO, &encode(&(path, stat, hash)));
        }
        for (id, last) in sorted(&self.last) {
            let (name, head) = stored_head(last);
            if heads.insert(name, last.manifest.head.clone()).is_none() {
                push(HEAD, &head);
            }
            push(LAST, &stored_last(id, name, last));
        }
        if let Some(noop) = &self.noop {
            push(NOOP, noop);
        }
        self.heads = heads;
        self.entries = entries;
        let temporary = store.write_temporary(&[&bytes], false)?;
        disk::rename(&temporary, &self.path)?;
        self.valid = bytes.len();
        Ok(())
    }
}

fn sorted<T>(map: &HashMap<String, T>) -> Vec<(&String, &T)> {
    let mut entries: Vec<_> = map.iter().collect();
    entries.sort_by_key(|(key, _)| *key);
    entries
}

fn stored_head(last: &Last) -> (ContentHash, Vec<u8>) {
    let head = encode(&last.manifest.head.to_vec());
    (ContentHash::of(&head), head)
}

fn stored_last(id: &str, head: ContentHash, last: &Last) -> Vec<u8> {
    let (inputs, record) = (last.manifest.inputs.clone(), (*last.record).clone());
    encode(&StoredLast { id: id.to_owned(), head, inputs, record })
}

fn checksum(kind: u32, payload: &[u8]) -> [u8; 8] {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&kind.to_le_bytes()).update(payload);
    let mut first = [0; 8];
    first.copy_from_slice(&hasher.finalize().as_bytes()[..8]);
    first
}

fn push_frame(bytes: &mut Vec<u8>, kind: u32, payload: &[u8]) {
    let length = u32::try_from(payload.len()).expect("invariant: a frame holds one file or action, far below 4 GiB");
    bytes.extend(length.to_le_bytes());
    bytes.extend(kind.to_le_bytes());
    bytes.extend(checksum(kind, payload));
    bytes.extend_from_slice(payload);
}

fn word(bytes: &[u8], at: usize) -> Option<u32> {
    bytes.get(at..at + 4)?.try_into().ok().map(u32::from_le_bytes)
}

/// Kind and payload range of every whole frame, and the end of the last one.
fn frames(bytes: &[u8]) -> (Vec<(u32, Range<usize>)>, usize) {
    let mut found = Vec::new();
    if !bytes.starts_with(HEADER) {
        return (found, 0);
    }
    let mut at = HEADER.len();
    while let (Some(length), Some(kind)) = (word(bytes, at), word(bytes, at + 4)) {
        let start = at + FRAME;
        let end = start.saturating_add(length as usize);
        if !(MEMO..=NOOP).contains(&kind) || end > bytes.len() {
            break;
        }
        found.push((kind, start..end));
        at = end;
    }
    (found, at)
}

fn verified<'a>(bytes: &'a [u8], kind: u32, range: &Range<usize>) -> Option<&'a [u8]> {
    let payload = bytes.get(range.clone())?;
    let expected = bytes.get(range.start.checked_sub(8)?..range.start)?;
    (checksum(kind, payload)[..] == *expected).then_some(payload)
}
