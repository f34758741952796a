//! The typed pipeline: what the rest of kiln sees.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::compose;
use super::diagnostic::{Diagnostic, Origin, Report, Sources};
use super::dom::Table;
use super::options::{AssetOptions, AtlasOptions, BakeOptions, Kind, MergeOptions, PackOptions, SimplifyOptions};
use super::read;
use super::setting::Options;
use super::value::{Value, toml_lines};

/// A pipeline without defects: its stages form a chain that can run.
#[derive(Clone, Debug)]
pub struct Pipeline {
    /// Version of the language that the file is written in.
    pub language: u32,
    /// What is built from what.
    pub asset: AssetPaths,
    /// In the order of the file; the last one packs. Overrides are not applied: [`Pipeline::for_asset`].
    pub stages: Vec<Stage>,
    /// Other values for some assets.
    pub overrides: Vec<Override>,
    /// The texts that diagnostics of this pipeline point into.
    pub sources: Arc<Sources>,
    /// File, parents and settings laid over each other.
    pub(crate) document: Table,
}

/// `[asset]`.
#[derive(Clone, Debug, PartialEq)]
pub struct AssetPaths {
    /// Model or glob.
    pub input: AssetPath,
    /// Template of the container's path.
    pub output: AssetPath,
    /// What a model may be, with the two paths as they were written.
    pub options: AssetOptions,
}

/// A path as it was written and what it is relative to.
#[derive(Clone, Debug, PartialEq)]
pub struct AssetPath {
    /// `/`-separated; may be absolute.
    pub text: String,
    /// Where a relative path starts.
    pub relative_to: RelativeTo,
    /// Where it was written.
    pub origin: Origin,
}

/// Where a relative path starts.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RelativeTo {
    /// In the folder of this file (the pipeline's or a parent's name, as it was given or read).
    File(String),
    /// In the current folder: the path came from `--set`.
    CurrentFolder,
}

impl RelativeTo {
    /// For a path that was written at `origin`.
    pub(crate) fn of(origin: &Origin, report: &Report) -> RelativeTo {
        match report.sources.0.get(origin.source) {
            Some(source) if !source.command_line => RelativeTo::File(source.name.clone()),
            _ => RelativeTo::CurrentFolder,
        }
    }

    /// The path as seen from where the pipeline's own name is seen from; absolute paths stay.
    pub fn join(&self, path: &str) -> String {
        match self {
            RelativeTo::File(file) if !path.starts_with('/') => {
                format!("{}{path}", file.rfind('/').map_or("", |at| &file[..=at]))
            }
            _ => path.to_owned(),
        }
    }
}

/// What a stage takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StageInput {
    /// The asset as it was imported.
    Asset,
    /// The result of the stage with this index, which is lower than its own.
    Stage(usize),
}

/// One stage.
#[derive(Clone, Debug, PartialEq)]
pub struct Stage {
    /// `[a-z][a-z0-9-]*`, unique.
    pub id: String,
    /// What it takes.
    pub input: StageInput,
    /// For a bake, the index of the stage named by `high`.
    pub high: Option<usize>,
    /// For a bake with a cage, where that path starts.
    pub cage_from: Option<RelativeTo>,
    /// Its options, defaults filled.
    pub settings: StageSettings,
    /// Place of its `[[stage]]` header.
    pub header: Origin,
    /// Places of the values that were given: key, or `levels[0]` for an item of a list.
    pub origins: BTreeMap<String, Origin>,
}

/// Options of a stage by kind.
#[derive(Clone, Debug, PartialEq)]
pub enum StageSettings {
    /// Of a merge stage.
    Merge(MergeOptions),
    /// Of a simplify stage.
    Simplify(SimplifyOptions),
    /// Of an atlas stage.
    Atlas(AtlasOptions),
    /// Of a bake stage; `size` is filled.
    Bake(BakeOptions),
    /// Of a pack stage.
    Pack(PackOptions),
}

impl StageSettings {
    /// The kind they belong to.
    pub fn kind(&self) -> Kind {
        match self {
            StageSettings::Merge(_) => Kind::Merge,
            StageSettings::Simplify(_) => Kind::Simplify,
            StageSettings::Atlas(_) => Kind::Atlas,
            StageSettings::Bake(_) => Kind::Bake,
            StageSettings::Pack(_) => Kind::Pack,
        }
    }

    /// Every key with its value, in the order of the reference.
    pub fn values(&self) -> Vec<(String, Value)> {
        match self {
            StageSettings::Merge(options) => options.values(),
            StageSettings::Simplify(options) => options.values(),
            StageSettings::Atlas(options) => options.values(),
            StageSettings::Bake(options) => options.values(),
            StageSettings::Pack(options) => options.values(),
        }
    }
}

impl Stage {
    /// What it does.
    pub fn kind(&self) -> Kind {
        self.settings.kind()
    }

    /// Where the value of a key was written, or the stage's header if it has its default.
    pub fn origin(&self, key: &str) -> &Origin {
        self.origins.get(key).unwrap_or(&self.header)
    }

    fn values(&self, stages: &[Stage]) -> Vec<(String, Value)> {
        let mut values = vec![
            (String::from("id"), Value::Text(self.id.clone())),
            (String::from("kind"), Value::Text(self.kind().as_str().to_owned())),
        ];
        if let StageInput::Stage(index) = self.input
            && let Some(before) = stages.get(index)
        {
            values.push((String::from("from"), Value::Text(before.id.clone())));
        }
        values.extend(self.settings.values());
        values
    }
}

/// One `[[override]]`.
#[derive(Clone, Debug)]
pub struct Override {
    /// Matched against a model's path below the input's fixed part, extension included.
    pub pattern: glob::Pattern,
    /// Place of the glob.
    pub origin: Origin,
    /// What it sets: (id, key, value).
    pub(crate) set: Vec<compose::Assignment>,
}

impl Override {
    /// True if it holds for the model with this path below the input's fixed part.
    pub fn matches(&self, relative: &str) -> bool {
        let options = glob::MatchOptions {
            case_sensitive: true,
            require_literal_separator: true,
            require_literal_leading_dot: false,
        };
        self.pattern.matches_with(relative, options)
    }
}

/// A pipeline as it holds for one asset.
#[derive(Clone, Debug, PartialEq)]
pub struct ResolvedPipeline {
    /// Version of the language that the file is written in.
    pub language: u32,
    /// In the order of the file; the last one packs.
    pub stages: Vec<Stage>,
    /// Indices of the overrides that hold, in the order in which they were applied.
    pub overrides: Vec<usize>,
}

impl Pipeline {
    /// The stage with this id.
    pub fn stage(&self, id: &str) -> Option<&Stage> {
        self.stages.iter().find(|stage| stage.id == id)
    }

    /// The stages for the model with this path below the input's fixed part, extension included: every override that
    /// matches is applied, a later one wins.
    ///
    /// # Errors
    /// Several overrides that are each sound may make an unsound chain together.
    pub fn for_asset(&self, relative: &str) -> Result<ResolvedPipeline, Vec<Diagnostic>> {
        let applied: Vec<usize> = (0..self.overrides.len()).filter(|i| self.overrides[*i].matches(relative)).collect();
        if applied.is_empty() {
            return Ok(ResolvedPipeline { language: self.language, stages: self.stages.clone(), overrides: applied });
        }
        let mut document = self.document.clone();
        for index in &applied {
            compose::assign(&mut document, &self.overrides[*index].set);
        }
        let mut report = Report::new(Arc::clone(&self.sources));
        let read = read::stages(&document, &mut report);
        let stages = super::chain::check(read, &mut report);
        let diagnostics = report.finish();
        match stages {
            Some(stages) if !super::diagnostic::has_errors(&diagnostics) => {
                Ok(ResolvedPipeline { language: self.language, stages, overrides: applied })
            }
            _ => Err(diagnostics),
        }
    }

    /// The pipeline with every default filled, overrides listed and not applied, for people to read.
    pub fn to_resolved_toml(&self) -> String {
        let mut out = format!("kiln = {}\n\n[asset]\n", self.language);
        toml_lines(&self.asset_values(), &mut out);
        stages_toml(&self.stages, &mut out);
        for rule in &self.overrides {
            out.push_str("\n[[override]]\n");
            toml_lines(&override_values(rule), &mut out);
        }
        out
    }

    /// The same as compact JSON.
    pub fn to_resolved_json(&self) -> String {
        let overrides = self.overrides.iter().map(|rule| Value::Table(override_values(rule))).collect();
        let mut entries = vec![
            (String::from("kiln"), Value::Integer(i64::from(self.language))),
            (String::from("asset"), Value::Table(self.asset_values())),
            (String::from("stage"), stages_value(&self.stages)),
        ];
        if !self.overrides.is_empty() {
            entries.push((String::from("override"), Value::List(overrides)));
        }
        Value::Table(entries).to_json()
    }

    fn asset_values(&self) -> Vec<(String, Value)> {
        self.asset.options.values()
    }
}

impl ResolvedPipeline {
    /// The stages as TOML, every default filled and every `from` written out. It depends on neither comments, blanks
    /// and key order nor on paths nor on limits of time, so its bytes may be hashed into a container's provenance.
    pub fn to_resolved_toml(&self) -> String {
        let mut out = format!("kiln = {}\n", self.language);
        for stage in &self.stages {
            let values = stage.values(&self.stages).into_iter().filter(|(name, _)| !TIME_KEYS.contains(&name.as_str()));
            out.push_str("\n[[stage]]\n");
            toml_lines(&values.collect::<Vec<_>>(), &mut out);
        }
        out
    }

    /// The same as compact JSON.
    pub fn to_resolved_json(&self) -> String {
        let language = Value::Integer(i64::from(self.language));
        let entries = vec![(String::from("kiln"), language), (String::from("stage"), stages_value(&self.stages))];
        Value::Table(entries).to_json()
    }
}

/// Keys that decide whether there is a result in time, and never which: no part of fingerprints and of provenance.
pub(crate) const TIME_KEYS: [&str; 1] = ["time-limit"];

fn stages_toml(stages: &[Stage], out: &mut String) {
    for stage in stages {
        out.push_str("\n[[stage]]\n");
        toml_lines(&stage.values(stages), out);
    }
}

fn stages_value(stages: &[Stage]) -> Value {
    Value::List(stages.iter().map(|stage| Value::Table(stage.values(stages))).collect())
}

fn override_values(rule: &Override) -> Vec<(String, Value)> {
    let mut set: Vec<(String, Value)> =
        rule.set.iter().map(|one| (format!("stage.{}.{}", one.id, one.entry.name), one.entry.node.plain())).collect();
    // Two settings of one override never touch the same key, so their order means nothing.
    set.sort_by(|a, b| a.0.cmp(&b.0));
    vec![
        (String::from("match"), Value::Text(rule.pattern.as_str().to_owned())),
        (String::from("set"), Value::Table(set)),
    ]
}
