//! The build-state file: what the last builds of one pipeline knew of actions. It spares work and is never the truth.
//!
//! ```text
//! header   "kiln state 2\n" and zeros up to 16 bytes, generation u64
//! frames   { length u32, kind u32, first 8 bytes of BLAKE3(kind, payload) } payload
//!          kind 2  head      manifest fields shared by many actions
//!          kind 3  last      an action's last manifest and record, by id; names its head by its hash
//!          kind 5  note      what to say of an asset at length, by its name
//! ```
//!
//! Appended to at the end of a build, a later frame wins; rewritten, under a new generation, when more than half of the entries
//! are dead. A frame's checksum is verified when it is used. A damaged frame is skipped, a torn tail is cut, a missing file is an
//! empty one: never an error.
//!
//! The index (`index`) says where the frames of each asset lie, so that a build of few assets reads theirs alone. It holds for
//! one generation and length of this file; at any other, all of it is read.

use std::collections::{HashMap, HashSet};
use std::fs::{self, File};
use std::hash::{BuildHasher, RandomState};
use std::io::{Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::disk;
use crate::error::IoError;
use crate::hash::ContentHash;
use crate::index::{Frame, StateMark};
use crate::manifest::{Field, InputField, Manifest};
use crate::report::Record;
use crate::store::{Store, decode, encode};

const MAGIC: &[u8; 16] = b"kiln state 2\n\0\0\0";
/// Magic and generation.
const HEADER: usize = 24;
/// Length, kind, checksum.
const FRAME: usize = 16;

const HEAD: u32 = 0x6b02;
const LAST: u32 = 0x6b03;
const NOTE: u32 = 0x6b05;

/// A file this much longer than when all of it was last known is read and tidied as a whole, bytes.
const SLACK: u64 = 64 << 10;

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

/// How much of the file is in memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Loaded {
    Nothing,
    /// What some assets need.
    Some,
    All,
}

/// What a frame is of.
enum Of {
    Head(ContentHash),
    Last(String),
    Note(String),
}

/// The file in memory.
pub(crate) struct State {
    path: PathBuf,
    generation: u64,
    /// End of the last whole frame.
    valid: u64,
    /// Length when all of it was last known.
    compact: u64,
    loaded: Loaded,
    /// Another builder wrote since this one read: places known by the index need not hold any more.
    overtaken: bool,
    heads: HashMap<ContentHash, (Arc<[Field]>, Frame)>,
    last: HashMap<String, (Last, ContentHash, Frame)>,
    notes: HashMap<String, ([u8; 8], Frame)>,
    /// Frames in the file and to be appended, dead ones included.
    entries: usize,
    appended: Vec<u8>,
    /// What the frames in `appended` are of, and where they begin there.
    pending: Vec<(Of, Frame)>,
}

impl State {
    /// Reads nothing yet.
    pub(crate) fn new(path: PathBuf) -> State {
        State {
            path,
            generation: 0,
            valid: 0,
            compact: 0,
            loaded: Loaded::Nothing,
            overtaken: false,
            heads: HashMap::new(),
            last: HashMap::new(),
            notes: HashMap::new(),
            entries: 0,
            appended: Vec::new(),
            pending: Vec::new(),
        }
    }

    /// Reads the frames of some assets; `false`, and nothing is known, if they are not where the index says.
    pub(crate) fn load_some(&mut self, mark: StateMark, frames: &[Frame]) -> bool {
        let sound = mark.length <= mark.compact.saturating_mul(2).saturating_add(SLACK);
        if self.loaded != Loaded::Nothing || mark.generation == 0 || !sound || self.read_some(mark, frames).is_none() {
            self.heads.clear();
            self.last.clear();
            return false;
        }
        (self.generation, self.valid, self.compact) = (mark.generation, mark.length, mark.compact);
        self.loaded = Loaded::Some;
        true
    }

    fn read_some(&mut self, mark: StateMark, frames: &[Frame]) -> Option<()> {
        let mut file = File::open(&self.path).ok()?;
        let mut header = [0; HEADER];
        file.read_exact(&mut header).ok()?;
        if generation_of(&header)? != mark.generation || file.metadata().ok()?.len() != mark.length {
            return None;
        }
        for frame in frames.iter().filter(|frame| frame.length > 0) {
            let (kind, payload) = read_frame(&mut file, mark.length, *frame)?;
            self.take_in(kind, &payload, *frame)?;
        }
        Some(())
    }

    /// Reads all of it; does nothing the second time.
    pub(crate) fn load(&mut self) {
        if self.loaded == Loaded::All {
            return;
        }
        self.loaded = Loaded::All;
        self.heads.clear();
        self.last.clear();
        let bytes = fs::read(&self.path).unwrap_or_default();
        let (frames, valid) = frames(&bytes);
        self.generation = generation_of(&bytes).unwrap_or(0);
        (self.valid, self.compact, self.entries) = (valid as u64, valid as u64, frames.len());
        for (kind, range) in frames {
            if let Some(payload) = verified(&bytes, kind, &range) {
                // A frame that does not decode was written by a defect: what it knew is known no more.
                let _ = self.take_in(kind, payload, Frame { offset: range.start as u64, length: range.len() as u32 });
            }
        }
    }

    fn take_in(&mut self, kind: u32, payload: &[u8], frame: Frame) -> Option<()> {
        match kind {
            HEAD => {
                let fields: Vec<Field> = decode(payload)?;
                self.heads.insert(ContentHash::of(payload), (fields.into(), frame));
            }
            LAST => {
                let stored: StoredLast = decode(payload)?;
                let head = self.heads.get(&stored.head)?.0.clone();
                let manifest = Manifest::of_parts(head, stored.inputs);
                let last = Last { manifest, record: Arc::new(stored.record) };
                self.last.insert(stored.id, (last, stored.head, frame));
            }
            NOTE => {
                let (name, _): (String, Vec<u8>) = decode(payload)?;
                self.notes.insert(name, (checksum(kind, payload), frame));
            }
            _ => {}
        }
        Some(())
    }

    /// What the last build knew of action `id`.
    pub(crate) fn last(&self, id: &str) -> Option<&Last> {
        self.last.get(id).map(|(last, ..)| last)
    }

    /// All actions' last builds, by id.
    pub(crate) fn lasts(&self) -> impl Iterator<Item = (&str, &Last)> {
        self.last.iter().map(|(id, (last, ..))| (id.as_str(), last))
    }

    /// The frames that say so: the head's and its own. After `save`.
    pub(crate) fn frames_of(&self, id: &str) -> Option<[Frame; 2]> {
        let (_, head, frame) = self.last.get(id)?;
        Some([self.heads.get(head)?.1, *frame])
    }

    /// Where the note of an asset lies. After `save`.
    pub(crate) fn note_frame(&self, name: &str) -> Option<Frame> {
        self.notes.get(name).map(|(_, frame)| *frame)
    }

    /// The note of the asset `name` that lies at `frame`.
    pub(crate) fn read_note(&self, mark: StateMark, name: &str, frame: Frame) -> Option<Vec<u8>> {
        let mut file = File::open(&self.path).ok()?;
        let mut header = [0; HEADER];
        file.read_exact(&mut header).ok()?;
        if generation_of(&header)? != mark.generation {
            return None;
        }
        let (kind, payload) = read_frame(&mut file, mark.length, frame)?;
        let (of, note): (String, Vec<u8>) = decode(&payload)?;
        (kind == NOTE && of == name).then_some(note)
    }

    /// What an index that is written now says of this file.
    pub(crate) fn mark(&self) -> StateMark {
        let generation = if self.overtaken { 0 } else { self.generation };
        StateMark { generation, length: self.valid, compact: self.compact }
    }

    /// Notes an action's manifest and record.
    pub(crate) fn set_last(&mut self, id: &str, last: Last) {
        if self.last(id) == Some(&last) {
            return;
        }
        let (name, head) = stored_head(&last);
        if !self.heads.contains_key(&name) {
            let frame = self.push(HEAD, &head, Of::Head(name));
            self.heads.insert(name, (last.manifest.head.clone(), frame));
        }
        let frame = self.push(LAST, &stored_last(id, name, &last), Of::Last(id.to_owned()));
        self.last.insert(id.to_owned(), (last, name, frame));
    }

    /// Notes what to say of an asset.
    pub(crate) fn set_note(&mut self, name: &str, note: &[u8]) {
        let payload = encode(&(name, note));
        let sum = checksum(NOTE, &payload);
        if self.notes.get(name).is_none_or(|(known, _)| *known != sum) {
            let frame = self.push(NOTE, &payload, Of::Note(name.to_owned()));
            self.notes.insert(name.to_owned(), (sum, frame));
        }
    }

    /// Forgets the notes of other assets.
    pub(crate) fn keep_notes(&mut self, names: &HashSet<&str>) {
        self.notes.retain(|name, _| names.contains(name.as_str()));
    }

    fn push(&mut self, kind: u32, payload: &[u8], of: Of) -> Frame {
        push_frame(&mut self.appended, kind, payload);
        self.entries += 1;
        let length = payload.len() as u32;
        let frame = Frame { offset: (self.appended.len() - payload.len()) as u64, length };
        self.pending.push((of, frame));
        frame
    }

    /// Writes what is new. Another process that writes at the same moment goes first, and ours is dropped: costs time only.
    ///
    /// `tidy`: it may be rewritten; a rewrite keeps the actions in `live`, others belong to a plan of the past.
    pub(crate) fn save(&mut self, store: &Store, live: &HashSet<&str>, tidy: bool) -> Result<(), IoError> {
        if self.appended.is_empty() {
            return Ok(());
        }
        let count = self.heads.len() + self.last.len() + self.notes.len();
        let wasteful = tidy && self.loaded == Loaded::All && self.entries > 2 * count + 64;
        let Some(lock) = store.try_lock(&self.path)? else {
            self.overtaken = true;
            return Ok(());
        };
        let length = fs::metadata(&self.path).map_or(0, |metadata| metadata.len());
        if length != self.valid {
            // A torn tail, or frames of another builder: keep what is whole.
            let bytes = fs::read(&self.path).unwrap_or_default();
            let (valid, generation) = (frames(&bytes).1 as u64, generation_of(&bytes).unwrap_or(0));
            self.overtaken |= (valid, generation) != (self.valid, self.generation);
            (self.valid, self.generation) = (valid, generation);
        }
        let appended = std::mem::take(&mut self.appended);
        if wasteful {
            self.rewrite(store, live)?;
        } else if self.valid == 0 {
            self.generation = new_generation();
            disk::write(&self.path, &[MAGIC, &self.generation.to_le_bytes(), &appended], false)?;
            self.settle(HEADER as u64);
            self.valid = (HEADER + appended.len()) as u64;
        } else {
            if length != self.valid {
                disk::truncate(&self.path, self.valid)?;
            }
            disk::append(&self.path, &appended)?;
            self.settle(self.valid);
            self.valid += appended.len() as u64;
        }
        if self.loaded == Loaded::All {
            self.compact = self.valid;
        }
        drop(lock);
        Ok(())
    }

    /// The appended frames lie in the file now, from `base` on.
    fn settle(&mut self, base: u64) {
        for (of, frame) in std::mem::take(&mut self.pending) {
            let place = match &of {
                Of::Head(name) => self.heads.get_mut(name).map(|(_, place)| place),
                Of::Last(id) => self.last.get_mut(id).map(|(.., place)| place),
                Of::Note(name) => self.notes.get_mut(name).map(|(_, place)| place),
            };
            if let Some(place) = place {
                *place = Frame { offset: base + frame.offset, ..frame };
            }
        }
    }

    /// Writes the live entries to a new file. Notes are said again by whoever has them.
    fn rewrite(&mut self, store: &Store, live: &HashSet<&str>) -> Result<(), IoError> {
        self.last.retain(|id, _| live.contains(id.as_str()));
        let mut ids: Vec<String> = self.last.keys().cloned().collect();
        ids.sort();
        self.heads.clear();
        self.notes.clear();
        self.pending.clear();
        self.entries = 0;
        for id in ids {
            let Some((last, ..)) = self.last.remove(&id) else { continue };
            self.set_last(&id, last);
        }
        let appended = std::mem::take(&mut self.appended);
        self.generation = new_generation();
        let temporary = store.write_temporary(&[MAGIC, &self.generation.to_le_bytes(), &appended], false)?;
        disk::rename(&temporary, &self.path)?;
        self.settle(HEADER as u64);
        self.valid = (HEADER + appended.len()) as u64;
        self.overtaken = false;
        Ok(())
    }
}

/// Tells files apart; never reaches an output.
fn new_generation() -> u64 {
    RandomState::new().hash_one(std::process::id()).max(1)
}

fn generation_of(bytes: &[u8]) -> Option<u64> {
    let rest = bytes.strip_prefix(MAGIC)?;
    rest.get(..8)?.try_into().ok().map(u64::from_le_bytes)
}

/// Kind and payload of the frame at a place, if one that verifies lies there.
fn read_frame(file: &mut File, file_length: u64, frame: Frame) -> Option<(u32, Vec<u8>)> {
    let start = frame.offset.checked_sub(FRAME as u64)?;
    // No place makes room for more than the file holds.
    if frame.offset.checked_add(u64::from(frame.length))? > file_length {
        return None;
    }
    file.seek(SeekFrom::Start(start)).ok()?;
    let mut bytes = vec![0; FRAME + frame.length as usize];
    file.read_exact(&mut bytes).ok()?;
    let kind = word(&bytes, 4)?;
    (word(&bytes, 0)? == frame.length && checksum(kind, &bytes[FRAME..])[..] == bytes[8..FRAME]).then_some(())?;
    Some((kind, bytes.split_off(FRAME)))
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
    let length = u32::try_from(payload.len()).expect("invariant: a frame holds one action or note, far below 4 GiB");
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
    if generation_of(bytes).is_none() {
        return (found, 0);
    }
    let mut at = HEADER;
    while let (Some(length), Some(kind)) = (word(bytes, at), word(bytes, at + 4)) {
        let start = at + FRAME;
        let end = start.saturating_add(length as usize);
        if !(HEAD..=NOTE).contains(&kind) || end > bytes.len() {
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
