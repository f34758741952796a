//! The index as a file.
//!
//! ```text
//! header   "kiln index 1\n" and zeros up to 16 bytes, BLAKE3 of the rest
//! counts   names, folders, entries, owners, groups, frames; the key; the state file that `frames` point into
//! names    all texts, end to end
//! folders  { name, first entry }                        sorted by name
//! entries  { name, owners, stat, content, flags }       consecutive for each folder, sorted by name
//! owners   group numbers
//! groups   { name, brief, note, first frame, flags }    an asset: its actions' frames, what to say of it
//! frames   { offset, length }                           in the state file
//! patches  { length, first 8 bytes of the digest above, BLAKE3 }, the state file, { number, entry }, { number, group, frames }
//! ```

use std::fs;
use std::path::Path;

use super::{Content, Entry, Folder, Frame, Group, Index, Span, StateMark};
use crate::disk::{self, Stat};
use crate::error::IoError;
use crate::hash::ContentHash;
use crate::store::Store;

const HEADER: &[u8; 16] = b"kiln index 1\n\0\0\0";
/// Header, length and digest of what lies between here and the patches.
const BODY: usize = 16 + 8 + 32;
/// Length, base, digest.
const PATCH: usize = 4 + 8 + 32;

/// Where an index lies in its file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Place {
    /// First bytes of the digest of all but the patches.
    base: [u8; 8],
    /// Length without patches, and with them, bytes.
    whole: u64,
    end: u64,
}

impl Index {
    /// The index at `path`, if there is one that verifies.
    pub(crate) fn read(path: &Path) -> Option<Index> {
        Index::of_bytes(&fs::read(path).ok()?)
    }

    /// Replaces the index at `path`.
    pub(crate) fn write(&mut self, path: &Path, store: &Store) -> Result<(), IoError> {
        let bytes = self.to_bytes();
        let temporary = store.write_temporary(&[&bytes], false)?;
        disk::rename(&temporary, path)?;
        self.place = Place::of(&bytes, bytes.len() as u64);
        Ok(())
    }

    /// Writes these entries and groups as a patch behind the index at `path`, or all of it where that will not do.
    ///
    /// Builders that patch one file at the same moment leave claims of both: each holds for what its own saw.
    pub(crate) fn update(
        &mut self,
        path: &Path,
        store: &Store,
        entries: &[usize],
        groups: &[usize],
    ) -> Result<(), IoError> {
        let patch = self.patch(entries, groups);
        let end = self.place.end + patch.len() as u64;
        let fits = self.place.whole > 0 && end - self.place.whole <= self.place.whole / 4;
        if !fits || fs::metadata(path).map_or(0, |metadata| metadata.len()) != self.place.end {
            return self.write(path, store);
        }
        disk::append(path, &patch)?;
        self.place.end = end;
        Ok(())
    }

    pub(crate) fn patch(&self, entries: &[usize], groups: &[usize]) -> Vec<u8> {
        let mut out = Writer(vec![0; PATCH]);
        out.mark(self.state);
        out.word(entries.len() as u32);
        for &entry in entries {
            out.word(entry as u32);
            out.entry(&self.entries[entry]);
        }
        out.word(groups.len() as u32);
        for &group in groups {
            out.word(group as u32);
            out.group(&self.groups[group]);
            let frames = self.frames(group);
            out.word(frames.len() as u32);
            frames.iter().for_each(|frame| out.frame(*frame));
        }
        let length = (out.0.len() - PATCH) as u32;
        let seal = ContentHash::of(&out.0[PATCH..]);
        out.0[..4].copy_from_slice(&length.to_le_bytes());
        out.0[4..12].copy_from_slice(&self.place.base);
        out.0[12..PATCH].copy_from_slice(&seal.0);
        out.0
    }

    /// Takes in the patch that `bytes` begin with; gives its length.
    fn take_patch(&mut self, bytes: &[u8]) -> Option<u64> {
        let mut reader = Reader(bytes);
        let length = reader.word()? as usize;
        let base = reader.take(8)?;
        let seal = reader.hash()?;
        let body = reader.take(length)?;
        if base != self.place.base || seal != ContentHash::of(body) {
            return None;
        }
        let mut reader = Reader(body);
        self.state = reader.mark()?;
        for _ in 0..reader.word()? {
            let number = reader.word()? as usize;
            *self.entries.get_mut(number)? = reader.entry()?;
        }
        for _ in 0..reader.word()? {
            let number = reader.word()? as usize;
            *self.groups.get_mut(number)? = reader.group()?;
            let first = self.groups[number].first_frame as usize;
            let count = reader.word()? as usize;
            for frame in self.frames.get_mut(first..first.checked_add(count)?)? {
                *frame = reader.frame()?;
            }
        }
        Some((PATCH + length) as u64)
    }

    pub(crate) fn to_bytes(&self) -> Vec<u8> {
        let lists = self.entries.len() * ENTRY + (self.owners.len() + 9) * 4 + self.folders.len() * 12;
        let assets = self.groups.len() * GROUP + self.frames.len() * 12;
        let mut out = Writer(Vec::with_capacity(BODY + self.names.len() + lists + assets + 64));
        out.0.extend_from_slice(HEADER);
        out.0.extend_from_slice(&[0; BODY - HEADER.len()]);
        let counts = [
            self.names.len(),
            self.folders.len(),
            self.entries.len(),
            self.owners.len(),
            self.groups.len(),
            self.frames.len(),
        ];
        for count in counts {
            out.word(count as u32);
        }
        out.word(self.key.is_some() as u32);
        out.0.extend_from_slice(&self.key.map_or([0; 32], |key| key.0));
        out.mark(self.state);
        out.0.extend_from_slice(self.names.as_bytes());
        for folder in &self.folders {
            out.span(folder.name);
            out.word(folder.first);
        }
        for entry in &self.entries {
            out.entry(entry);
        }
        for owner in &self.owners {
            out.word(*owner);
        }
        for group in &self.groups {
            out.group(group);
        }
        for frame in &self.frames {
            out.frame(*frame);
        }
        let length = (out.0.len() - BODY) as u64;
        out.0[16..24].copy_from_slice(&length.to_le_bytes());
        let seal = ContentHash::of(&out.0[BODY..]);
        out.0[24..BODY].copy_from_slice(&seal.0);
        out.0
    }

    pub(crate) fn of_bytes(bytes: &[u8]) -> Option<Index> {
        let mut header = Reader(bytes.strip_prefix(HEADER)?);
        let length = usize::try_from(header.long()?).ok()?;
        let seal = header.hash()?;
        let body = header.take(length)?;
        if seal != ContentHash::of(body) {
            return None;
        }
        let mut index = Index::of_body(body)?;
        let whole = BODY + length;
        index.place = Place::of(bytes, whole as u64);
        while let Some(length) = bytes.get(index.place.end as usize..).and_then(|rest| index.take_patch(rest)) {
            index.place.end += length;
        }
        Some(index)
    }

    fn of_body(body: &[u8]) -> Option<Index> {
        let mut reader = Reader(body);
        let mut counts = [0; 6];
        for count in &mut counts {
            *count = reader.word()? as usize;
        }
        let [names, folders, entries, owners, groups, frames] = counts;
        let has_key = reader.word()? == 1;
        let key = reader.hash()?;
        let state = reader.mark()?;
        let mut index = Index {
            key: has_key.then_some(key),
            state,
            names: std::str::from_utf8(reader.take(names)?).ok()?.to_owned(),
            // What is read next is at least that long, or the reading ends: no count makes room for more than the file holds.
            ..Index::default()
        };
        index.folders = reader.list(folders, 12, |r| Some(Folder { name: r.span()?, first: r.word()? }))?;
        index.entries = reader.list(entries, ENTRY, Reader::entry)?;
        index.owners = reader.list(owners, 4, Reader::word)?;
        index.groups = reader.list(groups, GROUP, Reader::group)?;
        index.frames = reader.list(frames, 12, Reader::frame)?;
        (reader.0.is_empty() && index.is_sound()).then_some(index)
    }

    /// Numbers that would lead outside were written by a defect: such an index is none.
    fn is_sound(&self) -> bool {
        let starts = self.folders.windows(2).all(|pair| pair[0].first < pair[1].first);
        let within = self.folders.iter().all(|folder| (folder.first as usize) < self.entries.len());
        let all = self.folders.first().map_or(self.entries.is_empty(), |first| first.first == 0);
        starts && within && all && self.owners.iter().all(|&owner| (owner as usize) < self.groups.len())
    }
}

/// Bytes of an entry.
const ENTRY: usize = 8 + 8 + 40 + 32 + 4;
/// Bytes of a group.
const GROUP: usize = 8 + 8 + 12 + 4 + 4;

impl Place {
    /// Of an index of `whole` bytes without patches, which `bytes` begin with.
    fn of(bytes: &[u8], whole: u64) -> Place {
        let mut base = [0; 8];
        base.copy_from_slice(&bytes[24..32]);
        Place { base, whole, end: whole }
    }
}

struct Writer(Vec<u8>);

impl Writer {
    fn word(&mut self, word: u32) {
        self.0.extend_from_slice(&word.to_le_bytes());
    }

    fn long(&mut self, long: u64) {
        self.0.extend_from_slice(&long.to_le_bytes());
    }

    fn span(&mut self, span: Span) {
        self.word(span.start);
        self.word(span.length);
    }

    fn frame(&mut self, frame: Frame) {
        self.long(frame.offset);
        self.word(frame.length);
    }

    fn mark(&mut self, mark: StateMark) {
        for number in [mark.generation, mark.length, mark.compact] {
            self.long(number);
        }
    }

    fn group(&mut self, group: &Group) {
        self.span(group.name);
        self.span(group.brief);
        self.frame(group.note);
        self.word(group.first_frame);
        self.word(group.open as u32);
    }

    fn entry(&mut self, entry: &Entry) {
        self.span(entry.name);
        self.span(entry.owners);
        let stat = entry.stat.unwrap_or_default();
        for number in [stat.size, stat.mtime as u64, stat.ctime as u64, stat.inode, stat.device] {
            self.long(number);
        }
        let (known, hash) = match entry.content {
            Content::Unknown => (0, [0; 32]),
            Content::Absent => (1, [0; 32]),
            Content::Hash(hash) => (2, hash.0),
        };
        self.0.extend_from_slice(&hash);
        let flags = [entry.stat.is_some(), entry.plan, entry.folder, entry.output];
        self.word(flags.iter().rev().fold(known, |word, flag| word << 1 | *flag as u32));
    }
}

struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (head, tail) = self.0.split_at_checked(count)?;
        self.0 = tail;
        Some(head)
    }

    fn word(&mut self) -> Option<u32> {
        self.take(4)?.try_into().ok().map(u32::from_le_bytes)
    }

    fn long(&mut self) -> Option<u64> {
        self.take(8)?.try_into().ok().map(u64::from_le_bytes)
    }

    fn hash(&mut self) -> Option<ContentHash> {
        self.take(32)?.try_into().ok().map(ContentHash)
    }

    fn span(&mut self) -> Option<Span> {
        Some(Span { start: self.word()?, length: self.word()? })
    }

    fn frame(&mut self) -> Option<Frame> {
        Some(Frame { offset: self.long()?, length: self.word()? })
    }

    fn mark(&mut self) -> Option<StateMark> {
        Some(StateMark { generation: self.long()?, length: self.long()?, compact: self.long()? })
    }

    fn group(&mut self) -> Option<Group> {
        let (name, brief, note) = (self.span()?, self.span()?, self.frame()?);
        Some(Group { name, brief, note, first_frame: self.word()?, open: self.word()? == 1 })
    }

    fn entry(&mut self) -> Option<Entry> {
        let (name, owners) = (self.span()?, self.span()?);
        let stat = Stat {
            size: self.long()?,
            mtime: self.long()? as i64,
            ctime: self.long()? as i64,
            inode: self.long()?,
            device: self.long()?,
        };
        let hash = self.hash()?;
        let flags = self.word()?;
        let is = |bit: u32| flags >> bit & 1 == 1;
        let content = match flags >> 4 {
            0 => Content::Unknown,
            1 => Content::Absent,
            _ => Content::Hash(hash),
        };
        Some(Entry { name, owners, stat: is(0).then_some(stat), content, plan: is(1), folder: is(2), output: is(3) })
    }

    /// `count` values of `size` bytes each.
    fn list<T>(&mut self, count: usize, size: usize, one: impl Fn(&mut Reader<'a>) -> Option<T>) -> Option<Vec<T>> {
        let mut part = Reader(self.take(count.checked_mul(size)?)?);
        let mut list = Vec::with_capacity(count);
        for _ in 0..count {
            list.push(one(&mut part)?);
        }
        Some(list)
    }
}
