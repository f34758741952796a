//! Which models a pipeline builds, and into which files.
//!
//! `{path}` in the output is the model's path below the fixed part of the input (the folders before the first one with
//! a `*`, `?` or `[`; for a single file its folder), without the extension; `{name}` is the last part of that. `*` and
//! `?` do not cross a `/`, `**` stands for any folders; neither meets a name that starts with a dot, so `.kiln` and
//! `.git` are never searched.

use std::collections::btree_map::{BTreeMap, Entry};
use std::collections::{BTreeSet, VecDeque};
use std::io;
use std::rc::Rc;
use std::sync::Arc;

use glob::{MatchOptions, Pattern};

use super::compose::normal;
use super::diagnostic::{Code, Diagnostic, Report, nearest};
use super::pipeline::Pipeline;

/// One name in a folder.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct DirEntry {
    /// The last part of its path.
    pub name: String,
    /// True for a folder that may be searched.
    pub is_dir: bool,
}

/// One model to build.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct AssetBuild {
    /// The model, relative to what the pipeline's input is relative to.
    pub input: String,
    /// The container, relative to what the pipeline's output is relative to.
    pub output: String,
    /// The model below the input's fixed part, extension included: what overrides are matched against.
    pub relative: String,
    /// `{path}`.
    pub path: String,
    /// `{name}`.
    pub name: String,
}

/// All models of a pipeline.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Expansion {
    /// Sorted by `input`; empty if a diagnostic is an error.
    pub builds: Vec<AssetBuild>,
    /// Every folder that was listed, sorted: a change in one of them can change `builds`.
    pub listed: Vec<String>,
    /// No match, unreadable folders, equal outputs, overrides that match nothing.
    pub diagnostics: Vec<Diagnostic>,
}

/// An `input` that matches the path `path` and nothing else: characters that globs read are put into brackets.
pub fn literal(path: &str) -> String {
    Pattern::escape(path)
}

/// Finds the models. `list` gives the content of a folder in any order; it is called at most once a folder, with a
/// path that is relative to what the input is relative to (`.` for that place itself).
pub fn expand_inputs(pipeline: &Pipeline, list: &dyn Fn(&str) -> io::Result<Vec<DirEntry>>) -> Expansion {
    let mut report = Report::new(Arc::clone(&pipeline.sources));
    let input = &pipeline.asset.input;
    let parts: Vec<&str> = split(&input.text);
    let is_glob = |part: &&str| part.contains(['*', '?', '[']);
    let fixed = parts.iter().position(is_glob).unwrap_or(parts.len()).min(parts.len().saturating_sub(1));
    let root = parts[..fixed].join("/");
    let mut search = Search { list, folders: BTreeMap::new(), failed: Vec::new() };
    let matched = search.run(&root, &parts[fixed..]);

    for (folder, error) in &search.failed {
        let missing = folder == &root && error.kind() == io::ErrorKind::NotFound;
        let code = if missing { Code::InputMissing } else { Code::InputUnreadable };
        let message = if missing {
            format!("the folder {} does not exist", shown(folder))
        } else {
            format!("the folder {} cannot be listed: {error}", shown(folder))
        };
        let help = Some(String::from("paths are relative to the folder of the file that they stand in"));
        report.add(code, &input.origin, message, "no such place", help);
    }
    if matched.is_empty() && search.failed.is_empty() {
        let last = parts.last().copied().unwrap_or_default();
        let names: Vec<String> = search.names_in(&root);
        let is_file = !parts.iter().any(is_glob);
        let message = if is_file {
            format!("there is no model {}", input.text)
        } else {
            String::from("no model matches the glob")
        };
        let help = match nearest(last, names.iter().map(String::as_str)).filter(|_| is_file) {
            Some(near) => format!("did you mean `{near}`?"),
            None => format!("searched below {}", shown(&root)),
        };
        report.add(Code::InputMissing, &input.origin, message, "no match", Some(help));
    }

    let builds: Vec<AssetBuild> = matched.into_iter().map(|found| named(found, &root, pipeline)).collect();
    clashes(pipeline, &builds, &mut report);
    if !builds.is_empty() {
        for rule in pipeline.overrides.iter().filter(|rule| !builds.iter().any(|build| rule.matches(&build.relative))) {
            let message = format!("the override `{}` matches no model", rule.pattern.as_str());
            let help = format!("it is matched against paths such as `{}`", builds[0].relative);
            report.add(Code::OverrideUnmatched, &rule.origin, message, "no match", Some(help));
        }
    }
    let diagnostics = report.finish();
    let listed = search.folders.into_keys().map(|folder| shown(&folder).to_owned()).collect();
    let builds = if super::has_errors(&diagnostics) { Vec::new() } else { builds };
    Expansion { builds, listed, diagnostics }
}

/// Parts of a path; the first is empty if it is absolute.
fn split(path: &str) -> Vec<&str> {
    let mut parts: Vec<&str> = Vec::new();
    for (index, part) in path.split('/').enumerate() {
        // Repeated `**` means what one means.
        let needless = part == "." || part.is_empty() && index > 0 || part == "**" && parts.last() == Some(&"**");
        if !needless {
            parts.push(part);
        }
    }
    parts
}

fn shown(folder: &str) -> &str {
    if folder.is_empty() { "." } else { folder }
}

fn join(folder: &str, name: &str) -> String {
    if folder.is_empty() { name.to_owned() } else { format!("{}/{name}", folder.trim_end_matches('/')) }
}

fn named(input: String, root: &str, pipeline: &Pipeline) -> AssetBuild {
    let relative =
        if root.is_empty() { input.as_str() } else { input[root.len()..].trim_start_matches('/') }.to_owned();
    let start = relative.rfind('/').map_or(0, |at| at + 1);
    // A leading dot is part of the name and no extension.
    let end = relative[start..].rfind('.').filter(|at| *at > 0).map_or(relative.len(), |at| start + at);
    let (path, name) = (relative[..end].to_owned(), relative[start..end].to_owned());
    let output = filled(&pipeline.asset.output.text, &path, &name);
    AssetBuild { input, output, relative, path, name }
}

impl AssetBuild {
    /// A template as `output` is one, filled for this build.
    pub fn filled(&self, template: &str) -> String {
        filled(template, &self.path, &self.name)
    }
}

/// The template with its names replaced in one pass: a model called `{name}` stays what it is called.
fn filled(template: &str, path: &str, name: &str) -> String {
    let mut out = String::new();
    let mut rest = template;
    while let Some(open) = rest.find('{') {
        out.push_str(&rest[..open]);
        rest = &rest[open..];
        if let Some(after) = rest.strip_prefix("{path}") {
            out.push_str(path);
            rest = after;
        } else if let Some(after) = rest.strip_prefix("{name}") {
            out.push_str(name);
            rest = after;
        } else {
            out.push('{');
            rest = &rest[1..];
        }
    }
    out.push_str(rest);
    out
}

/// Reports equal outputs, all of them in one diagnostic, and outputs that are inputs.
fn clashes(pipeline: &Pipeline, builds: &[AssetBuild], report: &mut Report) {
    let (input, output) = (&pipeline.asset.input, &pipeline.asset.output);
    let mut writers: BTreeMap<String, Vec<&AssetBuild>> = BTreeMap::new();
    for build in builds {
        writers.entry(normal(&output.relative_to.join(&build.output))).or_default().push(build);
    }
    let repeated: Vec<&Vec<&AssetBuild>> = writers.values().filter(|builds| builds.len() > 1).collect();
    if let Some(first) = repeated.first() {
        let models: Vec<&str> = first.iter().map(|build| build.relative.as_str()).collect();
        let shown = models[..models.len().min(3)].join(", ");
        let more = if models.len() > 3 { format!(" and {} more", models.len() - 3) } else { String::new() };
        let others = match repeated.len() {
            1 => String::new(),
            2 => String::from("; one more output likewise"),
            count => format!("; {} more outputs likewise", count - 1),
        };
        let message = format!("{} would be written by {shown}{more}{others}", first[0].output);
        let help = if output.text.contains("{path}") {
            "models that differ only in their extension have the same {path}: build them by two pipelines"
        } else {
            "use {path} in the output: it differs wherever the models' paths differ"
        };
        report.add(Code::OutputRepeated, &output.origin, message, "written twice", Some(help.to_owned()));
    }
    for build in builds {
        if let Some(writer) = writers.get(&normal(&input.relative_to.join(&build.input))).and_then(|all| all.first()) {
            let message = format!("the output {} would replace a model", writer.output);
            let help = Some(String::from("outputs end in .kiln and lie in a folder of their own"));
            report.add(Code::OutputIsInput, &output.origin, message, "a model", help);
            return;
        }
    }
}

struct Search<'a> {
    list: &'a dyn Fn(&str) -> io::Result<Vec<DirEntry>>,
    /// Content of each listed folder.
    folders: BTreeMap<String, Rc<Vec<DirEntry>>>,
    failed: Vec<(String, io::Error)>,
}

impl Search<'_> {
    fn content(&mut self, folder: &str) -> Rc<Vec<DirEntry>> {
        match self.folders.entry(folder.to_owned()) {
            Entry::Occupied(known) => Rc::clone(known.get()),
            Entry::Vacant(place) => {
                let content = match (self.list)(if folder.is_empty() { "." } else { folder }) {
                    Ok(mut content) => {
                        content.sort();
                        content
                    }
                    Err(error) => {
                        self.failed.push((folder.to_owned(), error));
                        Vec::new()
                    }
                };
                Rc::clone(place.insert(Rc::new(content)))
            }
        }
    }

    fn names_in(&self, folder: &str) -> Vec<String> {
        let content = self.folders.get(folder).map(|content| content.as_slice()).unwrap_or_default();
        content.iter().filter(|entry| !entry.is_dir).map(|entry| entry.name.clone()).collect()
    }

    /// Files below `root` whose parts match, sorted.
    fn run(&mut self, root: &str, parts: &[&str]) -> BTreeSet<String> {
        let patterns: Vec<Option<Pattern>> = parts.iter().map(|part| Pattern::new(part).ok()).collect();
        let options =
            MatchOptions { case_sensitive: true, require_literal_separator: true, require_literal_leading_dot: true };
        let mut found = BTreeSet::new();
        let mut seen = BTreeSet::new();
        let mut open = VecDeque::from([(root.to_owned(), 0_usize)]);
        while let Some((folder, at)) = open.pop_front() {
            // Two ways through `**` lead to the same place; a folder linked into itself ends at the depth limit.
            let deep = folder.bytes().filter(|byte| *byte == b'/').count() > MAX_DEPTH;
            if deep || !seen.insert((folder.clone(), at)) {
                continue;
            }
            let Some(part) = parts.get(at) else { continue };
            let last = at + 1 == parts.len();
            let wild = *part == "**";
            if wild && !last {
                open.push_back((folder.clone(), at + 1));
            }
            if *part == ".." {
                open.push_back((join(&folder, part), at + 1));
                continue;
            }
            for entry in self.content(&folder).iter() {
                let hidden = entry.name.starts_with('.');
                let path = join(&folder, &entry.name);
                if wild {
                    if entry.is_dir && !hidden {
                        open.push_back((path, at));
                    } else if last && !entry.is_dir && !hidden {
                        found.insert(path);
                    }
                    continue;
                }
                if !patterns[at].as_ref().is_some_and(|pattern| pattern.matches_with(&entry.name, options)) {
                    continue;
                }
                match (last, entry.is_dir) {
                    (true, false) => {
                        found.insert(path);
                    }
                    (false, true) => open.push_back((path, at + 1)),
                    _ => {}
                }
            }
        }
        found
    }
}

/// Folders below folders: deeper than any tree of models, shallow enough to end a loop of links.
const MAX_DEPTH: usize = 64;
