//! After a build: the index by which the next one finds out what there is to do.

use std::collections::{BTreeMap, HashSet};
use std::path::Path;

use crate::context::join;
use crate::disk;
use crate::engine::Engine;
use crate::error::IoError;
use crate::index::{Asset, Content, Index, Line};
use crate::noop::{self, Group, Memory};
use crate::plan::{Plan, Source};
use crate::report::{ActionState, BuildReport, TargetState};

/// What the files of one pipeline's outputs depend on, as the last build knew it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Dependencies {
    /// Files that made the plan, relative to its root, sorted.
    pub files: Vec<String>,
    /// Folders whose listings made the plan, relative to its root, sorted.
    pub folders: Vec<String>,
    /// Each asset's outputs and the files that were read for them, relative to the plan's root, in the plan's order.
    pub assets: Vec<AssetFiles>,
}

/// The files of one asset.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct AssetFiles {
    /// Its name.
    pub name: String,
    /// Written for it, sorted.
    pub outputs: Vec<String>,
    /// Read for it, sorted.
    pub inputs: Vec<String>,
    /// Looked for in vain: their appearance makes it stale. Sorted.
    pub absent: Vec<String>,
}

/// An index, and the entries and groups by which a patch can tell it from the one in the file.
type Patched = (Index, Option<(Vec<usize>, Vec<usize>)>);

impl Engine {
    /// After a build: lets [`Engine::look`] answer from now on. Assets that were not finished are built again whatever their files
    /// say; a cancelled build is not remembered. After [`Look::Changed`](crate::Look::Changed), `memory` names the changed assets
    /// alone, and what is known of the others stays.
    ///
    /// # Errors
    /// The files of the state cannot be written.
    pub fn remember(&mut self, plan: &Plan, report: &BuildReport, memory: &Memory) -> Result<(), IoError> {
        if report.cancelled || report.actions.len() != plan.actions.len() {
            return Ok(());
        }
        let _writing = disk::writing();
        for group in &memory.groups {
            self.state.set_note(&group.name, &group.note);
        }
        if self.partial.is_none() {
            self.state.keep_notes(&memory.groups.iter().map(|group| group.name.as_str()).collect());
        }
        self.state.save(&self.store, &HashSet::new(), false)?;
        let mark = self.state.mark();
        let (mut index, patch) = match (self.partial.take(), self.index.take().flatten()) {
            (Some(groups), Some(index)) => self.patched(index, &groups, plan, report, memory),
            (Some(_), None) => (Index::default(), None),
            (None, _) => (self.index_of_all(plan, report, memory), None),
        };
        index.state = mark;
        let written = match patch {
            Some((entries, groups)) => index.update(&self.index_path, &self.store, &entries, &groups),
            None => index.write(&self.index_path, &self.store),
        };
        self.index = Some(Some(index));
        written
    }

    fn index_of_all(&self, plan: &Plan, report: &BuildReport, memory: &Memory) -> Index {
        let known: BTreeMap<&str, &Line> = self.plan_lines.iter().map(|line| (line.path.as_str(), line)).collect();
        let mut lines = Vec::new();
        for (paths, folder) in [(&memory.files, false), (&memory.folders, true)] {
            for path in paths {
                lines.push(self.plan_line(&plan.root, path, folder, known.get(path.as_str()).copied()));
            }
        }
        let mut assets = Vec::new();
        for (number, group) in memory.groups.iter().enumerate() {
            let owned = self.lines_of(plan, report, group).into_values();
            lines.extend(owned.map(|line| Line { owners: vec![number as u32], ..line }));
            assets.push(self.asset_of(plan, report, group));
        }
        Index::new(Some(memory.key), lines, &assets)
    }

    /// What is known of a file or folder that makes the plan: what it held before the caller read it, and nothing if it may have
    /// changed since.
    fn plan_line(&self, root: &Path, path: &str, folder: bool, known: Option<&Line>) -> Line {
        let full = root.join(path);
        let now = noop::stat(&full).ok().flatten();
        let line = |stat, content| Line {
            path: path.to_owned(),
            stat,
            content,
            plan: true,
            folder,
            output: false,
            owners: Vec::new(),
        };
        if let Some(known) = known.filter(|known| known.folder == folder) {
            let then = self.looked.get(path).copied().unwrap_or(known.stat);
            return if then.is_some() && then == now {
                line(known.stat, known.content)
            } else {
                line(None, Content::Unknown)
            };
        }
        match now {
            // It is now as it was long before the plan was made.
            Some(stat) if self.is_settled(&stat) => {
                let (after, content) = noop::read(&full, folder);
                if after == Some(stat) { line(after, content) } else { line(None, Content::Unknown) }
            }
            _ => line(None, Content::Unknown),
        }
    }

    /// Everything that was looked at for a group, by path.
    fn lines_of(&self, plan: &Plan, report: &BuildReport, group: &Group) -> BTreeMap<String, Line> {
        let mut lines = BTreeMap::new();
        let mut add = |path: String, output: bool| {
            let unknown = || Line {
                path: path.clone(),
                stat: None,
                content: Content::Unknown,
                plan: false,
                folder: false,
                output,
                owners: Vec::new(),
            };
            let line = self.seen_of(&path).map_or_else(unknown, |seen| Line { output, ..seen.line(&path) });
            lines.entry(path).or_insert(line);
        };
        for &action in &group.actions {
            for input in &plan.actions[action].inputs {
                if let Source::File { path } = &input.source {
                    add(path.clone(), false);
                }
            }
            let Some(folder) = &plan.actions[action].discovers else { continue };
            let found = report.actions[action].record.iter().flat_map(|record| &record.discovered);
            for path in found.map(|(path, _)| path).chain(&report.actions[action].sought) {
                add(join(folder, path), false);
            }
        }
        for &target in &group.targets {
            add(plan.targets[target].path.clone(), true);
        }
        lines
    }

    fn asset_of(&self, plan: &Plan, report: &BuildReport, group: &Group) -> Asset {
        let frames = |&action: &usize| self.state.frames_of(&plan.actions[action].id).unwrap_or_default();
        Asset {
            name: group.name.clone(),
            brief: group.brief.clone(),
            note: self.state.note_frame(&group.name).unwrap_or_default(),
            frames: group.actions.iter().flat_map(frames).collect(),
            open: !is_finished(report, group),
        }
    }

    /// The index with the groups of `memory`, which are `known`, as they are now; the numbers of the entries and groups that are
    /// not as they were, if a patch can say so.
    fn patched(
        &self,
        mut index: Index,
        known: &[usize],
        plan: &Plan,
        report: &BuildReport,
        memory: &Memory,
    ) -> Patched {
        let numbers: BTreeMap<&str, usize> = known.iter().map(|&group| (index.group_name(group), group)).collect();
        let numbers: Option<Vec<usize>> = memory.groups.iter().map(|g| numbers.get(g.name.as_str()).copied()).collect();
        let numbers = numbers.filter(|numbers| numbers.len() == known.len());
        // Where the assets are not those that were found changed, nothing is known: the next build looks closer.
        let Some(numbers) = numbers else { return (Index::default(), None) };
        let all: Vec<_> = memory.groups.iter().map(|group| self.lines_of(plan, report, group)).collect();
        let assets: Vec<_> = memory.groups.iter().map(|group| self.asset_of(plan, report, group)).collect();
        let mut entries = self.check_plan_entries(&mut index, &plan.root);
        entries.extend_from_slice(&self.touched);
        let fits =
            numbers.iter().zip(all.iter().zip(&assets)).all(|(&g, (lines, asset))| index.fits(g, lines.keys(), asset));
        if fits {
            let mut patch = true;
            for (&number, (lines, asset)) in numbers.iter().zip(all.iter().zip(&assets)) {
                entries.extend(index.replace(lines.values()));
                patch &= index.set_group(number, asset);
            }
            return (index, patch.then_some((entries, numbers)));
        }
        // Other files than before: all is laid out anew.
        let mut every = index.assets();
        let mut lines = index.lines();
        for line in &mut lines {
            line.owners.retain(|&owner| !numbers.contains(&(owner as usize)));
        }
        lines.retain(|line| line.plan || !line.owners.is_empty());
        for ((&number, owned), asset) in numbers.iter().zip(all).zip(assets) {
            let owned = owned.into_values().map(|line| Line { owners: vec![number as u32], ..line });
            // Before what other assets saw of the same file: this is newer.
            lines.splice(0..0, owned);
            every[number] = asset;
        }
        (Index::new(index.key, lines, &every), None)
    }

    /// What makes the plan must be as it was when it was looked at, or it is not known. Gives the entries that are not.
    fn check_plan_entries(&self, index: &mut Index, root: &Path) -> Vec<usize> {
        let mut moved = Vec::new();
        for entry in 0..index.entries.len() {
            if index.entries[entry].plan {
                let path = index.path(entry);
                let then = self.looked.get(&path).copied().unwrap_or(index.entries[entry].stat);
                if then.is_none() || noop::stat(&root.join(&path)).ok().flatten() != then {
                    (index.entries[entry].stat, index.entries[entry].content) = (None, Content::Unknown);
                    moved.push(entry);
                }
            }
        }
        moved
    }

    /// What the last build, or the one before a fresh look, left of each asset: its name and its short text, in the plan's order.
    pub fn briefs(&self) -> impl Iterator<Item = (&str, &str)> {
        let index = self.index.iter().flatten();
        index.flat_map(|index| (0..index.groups.len()).map(move |group| (index.group_name(group), index.brief(group))))
    }

    /// The bytes that [`Group::note`] left of the asset `group` (its place among the briefs).
    pub fn note(&self, group: usize) -> Option<Vec<u8>> {
        let index = self.index.as_ref()?.as_ref()?;
        self.state.read_note(index.state, index.group_name(group), index.groups.get(group)?.note)
    }

    /// What the outputs depend on: after a look that found all fresh, or after [`Engine::remember`].
    pub fn dependencies(&self) -> Dependencies {
        let mut all = Dependencies::default();
        let Some(index) = self.index.as_ref().and_then(Option::as_ref) else { return all };
        let names = (0..index.groups.len()).map(|group| index.group_name(group).to_owned());
        all.assets = names.map(|name| AssetFiles { name, ..AssetFiles::default() }).collect();
        for (number, entry) in index.entries.iter().enumerate() {
            let path = index.path(number);
            for &owner in index.owners(number) {
                let asset = &mut all.assets[owner as usize];
                match (entry.output, entry.content) {
                    (true, _) => asset.outputs.push(path.clone()),
                    (false, Content::Absent) => asset.absent.push(path.clone()),
                    (false, _) => asset.inputs.push(path.clone()),
                }
            }
            match (entry.plan, entry.folder) {
                (true, true) => all.folders.push(path),
                (true, false) => all.files.push(path),
                _ => {}
            }
        }
        for asset in &mut all.assets {
            for list in [&mut asset.outputs, &mut asset.inputs, &mut asset.absent] {
                list.sort();
            }
        }
        all.files.sort();
        all.folders.sort();
        all
    }
}

fn is_finished(report: &BuildReport, group: &Group) -> bool {
    let action = |&action: &usize| matches!(report.actions[action].state, ActionState::Fresh | ActionState::Ran { .. });
    let target =
        |&target: &usize| matches!(report.targets[target].state, TargetState::Unchanged | TargetState::Written { .. });
    group.actions.iter().all(action) && group.targets.iter().all(target)
}

impl Index {
    /// Whether a group owns exactly these files, and `asset` has as many frames as it.
    fn fits<'a>(&self, group: usize, paths: impl ExactSizeIterator<Item = &'a String>, asset: &Asset) -> bool {
        let owner = group as u32;
        let count = self.all_owners().iter().filter(|&&o| o == owner).count();
        let owned = |path: &String| self.find(path).is_some_and(|entry| self.owners(entry).contains(&owner));
        count == paths.len() && self.frames(group).len() == asset.frames.len() && paths.into_iter().all(owned)
    }

    /// Replaces what is known of files that are all there; gives their numbers.
    fn replace<'a>(&mut self, lines: impl Iterator<Item = &'a Line>) -> Vec<usize> {
        let mut replaced = Vec::new();
        for line in lines {
            if let Some(number) = self.find(&line.path) {
                let entry = &mut self.entries[number];
                (entry.stat, entry.content) = (line.stat, line.content);
                replaced.push(number);
            }
        }
        replaced
    }
}
