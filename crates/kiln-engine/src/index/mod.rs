//! The index: every file that a build looks at, with its stat and content, and which asset reads it.
//!
//! One file (`file` says how it is laid out), read once into flat arrays: a build that finds all as it was opens nothing else, and
//! one that changes few entries appends a patch. It is replaced as a whole where files come or go, or patches amount to a quarter of
//! it. A torn or foreign patch ends the reading. Losing the file costs time only, and so does an index of another moment than the
//! state file: `state.rs` looks closer then.

mod file;

use crate::disk::Stat;
use crate::hash::ContentHash;
use file::Place;

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
}
