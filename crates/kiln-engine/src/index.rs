//! The index: every file that a build looks at, with its stat and content, and which asset reads it.
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
//!
//! One file, read once into flat arrays: a build that finds all as it was opens nothing else, and one that changes few entries
//! appends a patch. It is replaced as a whole where files come or go, or patches amount to a quarter of it. A torn or foreign patch
//! ends the reading. Losing the file costs time only, and so does an index of another moment than the state file: `state.rs` looks
//! closer then.

use std::fs;
use std::path::Path;

use crate::disk::{self, Stat};
use crate::error::IoError;
use crate::hash::ContentHash;
use crate::store::Store;

const HEADER: &[u8; 16] = b"kiln index 1\n\0\0\0";
/// Header, length and digest of what lies between here and the patches.
const BODY: usize = 16 + 8 + 32;
/// Length, base, digest.
const PATCH: usize = 4 + 8 + 32;

/// A part of the names.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Span {
    start: u32,
    length: u32,
}

/// The payload of a frame in the state file; length 0 for none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Frame {
    pub(crate) offset: u64,
    pub(crate) length: u32,
}

/// What is known of a file's bytes, or of a folder's listing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Content {
    /// Not known: whoever looks takes it for changed.
    Unknown,
    /// It was looked for and is absent.
    Absent,
    /// The digest of its bytes or names.
    Hash(ContentHash),
}

/// One file or folder that was looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Entry {
    name: Span,
    /// Its groups, in `owners`.
    owners: Span,
    /// Stands for `content` while it is the same; `None`: look at the content.
    pub(crate) stat: Option<Stat>,
    pub(crate) content: Content,
    /// It makes the plan: the pipeline, its parents, a listed folder.
    pub(crate) plan: bool,
    /// A folder: its content is its listing.
    pub(crate) folder: bool,
    /// A target and not an input.
    pub(crate) output: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Folder {
    name: Span,
    first: u32,
}

/// One asset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Group {
    name: Span,
    brief: Span,
    /// What to say of it at length.
    pub(crate) note: Frame,
    first_frame: u32,
    /// It was not finished: it is to be built whatever the files say.
    pub(crate) open: bool,
}

/// The state file that an index was written beside.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct StateMark {
    /// Tells one state file from the one that replaced it.
    pub(crate) generation: u64,
    /// Its length, bytes.
    pub(crate) length: u64,
    /// Its length when all of it was last known, bytes.
    pub(crate) compact: u64,
}

/// Where an index lies in its file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Place {
    /// First bytes of the digest of all but the patches.
    base: [u8; 8],
    /// Length without patches, and with them, bytes.
    whole: u64,
    end: u64,
}

/// The file in memory.
#[derive(Clone, Debug, Default)]
pub(crate) struct Index {
    place: Place,
    /// Digest of all that makes the plan and is no file; `None`: a memo of contents only.
    pub(crate) key: Option<ContentHash>,
    pub(crate) state: StateMark,
    names: String,
    folders: Vec<Folder>,
    pub(crate) entries: Vec<Entry>,
    owners: Vec<u32>,
    pub(crate) groups: Vec<Group>,
    frames: Vec<Frame>,
}

/// One line of an index to be made.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Line {
    pub(crate) path: String,
    pub(crate) stat: Option<Stat>,
    pub(crate) content: Content,
    pub(crate) plan: bool,
    pub(crate) folder: bool,
    pub(crate) output: bool,
    pub(crate) owners: Vec<u32>,
}

/// One asset of an index to be made.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Asset {
    pub(crate) name: String,
    pub(crate) brief: String,
    pub(crate) note: Frame,
    pub(crate) frames: Vec<Frame>,
    pub(crate) open: bool,
}

/// Folder and name of a path.
fn split(path: &str) -> (&str, &str) {
    match path.rsplit_once('/') {
        // A file in the file system's root keeps its slash.
        Some(("", _)) | None => ("", path),
        Some(parts) => parts,
    }
}

impl PartialEq for Index {
    /// Whether they say the same, wherever they lie.
    fn eq(&self, other: &Index) -> bool {
        self.key == other.key
            && self.state == other.state
            && self.names == other.names
            && self.folders == other.folders
            && self.entries == other.entries
            && self.owners == other.owners
            && self.groups == other.groups
            && self.frames == other.frames
    }
}

impl Index {
    /// An index of these lines; two lines of one path become one, with the owners of both.
    pub(crate) fn new(key: Option<ContentHash>, mut lines: Vec<Line>, assets: &[Asset]) -> Index {
        lines.sort_by(|a, b| split(&a.path).cmp(&split(&b.path)));
        lines.dedup_by(|next, kept| {
            let same = next.path == kept.path;
            if same {
                kept.owners.append(&mut next.owners);
                kept.output &= next.output;
                kept.plan |= next.plan;
            }
            same
        });
        let mut index = Index { key, ..Index::default() };
        for line in &lines {
            let (folder, name) = split(&line.path);
            if index.folders.last().is_none_or(|last| index.text(last.name) != folder) {
                let name = index.push_text(folder);
                index.folders.push(Folder { name, first: index.entries.len() as u32 });
            }
            let owners = Span { start: index.owners.len() as u32, length: line.owners.len() as u32 };
            index.owners.extend_from_slice(&line.owners);
            let name = index.push_text(name);
            let Line { stat, content, plan, folder, output, .. } = *line;
            index.entries.push(Entry { name, owners, stat, content, plan, folder, output });
        }
        for asset in assets {
            let name = index.push_text(&asset.name);
            // Most assets have the same to say.
            let last = index.groups.last().map(|group| group.brief).filter(|&last| index.text(last) == asset.brief);
            let brief = last.unwrap_or_else(|| index.push_text(&asset.brief));
            let first_frame = index.frames.len() as u32;
            index.frames.extend_from_slice(&asset.frames);
            index.groups.push(Group { name, brief, note: asset.note, first_frame, open: asset.open });
        }
        index
    }

    fn push_text(&mut self, text: &str) -> Span {
        let start = self.names.len() as u32;
        self.names.push_str(text);
        Span { start, length: text.len() as u32 }
    }

    fn text(&self, span: Span) -> &str {
        self.names.get(span.start as usize..span.start as usize + span.length as usize).unwrap_or_default()
    }

    /// Number of folders that entries lie in.
    pub(crate) fn folder_count(&self) -> usize {
        self.folders.len()
    }

    /// A folder's path and its entries' numbers.
    pub(crate) fn folder(&self, folder: usize) -> (&str, std::ops::Range<usize>) {
        let end = self.folders.get(folder + 1).map_or(self.entries.len(), |next| next.first as usize);
        (self.text(self.folders[folder].name), self.folders[folder].first as usize..end)
    }

    /// The last part of an entry's path.
    pub(crate) fn name(&self, entry: usize) -> &str {
        self.text(self.entries[entry].name)
    }

    /// An entry's path.
    pub(crate) fn path(&self, entry: usize) -> String {
        let folder = self.folders.partition_point(|folder| folder.first as usize <= entry) - 1;
        crate::context::join(self.text(self.folders[folder].name), self.name(entry))
    }

    /// The entry of a path.
    pub(crate) fn find(&self, path: &str) -> Option<usize> {
        let (folder, name) = split(path);
        let at = self.folders.binary_search_by(|known| self.text(known.name).cmp(folder)).ok()?;
        let (_, range) = self.folder(at);
        let start = range.start;
        self.entries[range].binary_search_by(|known| self.text(known.name).cmp(name)).ok().map(|found| start + found)
    }

    /// The content that the file at `path` had when its stat was the one given.
    pub(crate) fn memo(&self, path: &str) -> Option<(Stat, ContentHash)> {
        let entry = self.entries.get(self.find(path)?)?;
        match (entry.stat, entry.content) {
            (Some(stat), Content::Hash(hash)) if !entry.folder => Some((stat, hash)),
            _ => None,
        }
    }

    /// The groups that read or write an entry.
    pub(crate) fn owners(&self, entry: usize) -> &[u32] {
        let Span { start, length } = self.entries[entry].owners;
        self.owners.get(start as usize..(start + length) as usize).unwrap_or_default()
    }

    /// The owners of all entries.
    pub(crate) fn all_owners(&self) -> &[u32] {
        &self.owners
    }

    /// Replaces what is said of a group; `asset` has as many frames as it. Gives whether a patch can say so.
    pub(crate) fn set_group(&mut self, group: usize, asset: &Asset) -> bool {
        let same = self.brief(group) == asset.brief;
        if !same {
            self.groups[group].brief = self.push_text(&asset.brief);
        }
        (self.groups[group].note, self.groups[group].open) = (asset.note, asset.open);
        let first = self.groups[group].first_frame as usize;
        if let Some(frames) = self.frames.get_mut(first..first + asset.frames.len()) {
            frames.copy_from_slice(&asset.frames);
        }
        same
    }

    /// A group's name.
    pub(crate) fn group_name(&self, group: usize) -> &str {
        self.text(self.groups[group].name)
    }

    /// What to say of a group in short.
    pub(crate) fn brief(&self, group: usize) -> &str {
        self.text(self.groups[group].brief)
    }

    /// The frames of a group's actions in the state file: for each action its head and its last build.
    pub(crate) fn frames(&self, group: usize) -> &[Frame] {
        let end = self.groups.get(group + 1).map_or(self.frames.len(), |next| next.first_frame as usize);
        self.frames.get(self.groups[group].first_frame as usize..end).unwrap_or_default()
    }

    /// All lines, to make another index of them.
    pub(crate) fn lines(&self) -> Vec<Line> {
        let mut lines = Vec::with_capacity(self.entries.len());
        for folder in 0..self.folder_count() {
            let (path, range) = self.folder(folder);
            for number in range {
                let Entry { stat, content, plan, folder, output, .. } = self.entries[number];
                let path = crate::context::join(path, self.name(number));
                lines.push(Line { path, stat, content, plan, folder, output, owners: self.owners(number).to_vec() });
            }
        }
        lines
    }

    /// All assets, to make another index of them.
    pub(crate) fn assets(&self) -> Vec<Asset> {
        let asset = |group: usize| Asset {
            name: self.group_name(group).to_owned(),
            brief: self.brief(group).to_owned(),
            note: self.groups[group].note,
            frames: self.frames(group).to_vec(),
            open: self.groups[group].open,
        };
        (0..self.groups.len()).map(asset).collect()
    }

    // --- the file ---

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
