//! From the composed document to typed values, every defect reported.

use std::collections::BTreeMap;

use super::diagnostic::{Code, Origin, Report, nearest, suggest};
use super::dom::{Data, Node, Table};
use super::options::{
    AssetOptions, AtlasOptions, BakeOptions, Kind, MergeOptions, PackOptions, RULE_KEYS, SimplifyOptions, StageOptions,
    read_kind,
};
use super::pipeline::{AssetPath, AssetPaths, RelativeTo, StageSettings};
use super::setting::{Elsewhere, FromTable, Key, Options, Standard, check_keys};

/// A stage as far as it could be read.
#[derive(Clone, Debug)]
pub(crate) struct Draft {
    pub(crate) id: Option<String>,
    pub(crate) from: Option<String>,
    /// `None` if the kind is missing or unknown.
    pub(crate) settings: Option<StageSettings>,
    pub(crate) header: Origin,
    pub(crate) origins: BTreeMap<String, Origin>,
}

impl Draft {
    pub(crate) fn kind(&self) -> Option<Kind> {
        self.settings.as_ref().map(StageSettings::kind)
    }

    pub(crate) fn origin(&self, key: &str) -> &Origin {
        self.origins.get(key).unwrap_or(&self.header)
    }

    /// For messages: the id, else the kind.
    pub(crate) fn name(&self) -> &str {
        self.id.as_deref().unwrap_or_else(|| self.kind().map_or("?", Kind::as_str))
    }
}

/// Reads `[asset]`.
pub(crate) fn asset(document: &Table, report: &mut Report) -> Option<AssetPaths> {
    let Some(node) = document.get("asset") else {
        let help = Some(String::from("write [asset] with input = \"MODEL\" and output = \"build/{name}.kiln\""));
        report.add(Code::KeyMissing, &Origin::default(), "the pipeline has no [asset]", "`asset` is missing", help);
        return None;
    };
    let table = node.table()?;
    check_keys(table, &AssetOptions::keys(), "[asset]", &node.origin, &|_| None, report);
    let options = AssetOptions::from_table(table, report);
    let path = |name: &str, text: String, report: &mut Report| {
        let node = table.get(name).filter(|node| matches!(node.data, Data::Text(_)))?;
        if text.trim().is_empty() || text.ends_with('/') {
            let label = if text.trim().is_empty() { "empty" } else { "a folder" };
            report.add(Code::ValueEmpty, &node.origin, format!("`{name}` names no file"), label, None);
            return None;
        }
        let relative_to = RelativeTo::of(&node.origin, report);
        Some(AssetPath { text, relative_to, origin: node.origin.clone() })
    };
    let input = path("input", options.input.clone(), report);
    let output = path("output", options.output.clone(), report);
    if let Some(input) = &input {
        glob_of(table, input, report);
    }
    if let Some(output) = &output {
        template(output, report);
    }
    Some(AssetPaths { input: input?, output: output?, options })
}

/// Checks each part of the input as a glob.
fn glob_of(table: &Table, input: &AssetPath, report: &mut Report) {
    let Some(node) = table.get("input") else { return };
    for part in input.text.split('/') {
        if let Err(error) = glob::Pattern::new(part) {
            super::compose::glob_error(node, part, &error, report);
            return;
        }
    }
}

/// Checks the names in braces.
fn template(output: &AssetPath, report: &mut Report) {
    let mut rest = output.text.as_str();
    while let Some(open) = rest.find('{') {
        let after = &rest[open + 1..];
        let Some(close) = after.find('}') else {
            let message = "the output's `{` is never closed";
            let help = Some(String::from("{path} and {name} are replaced"));
            report.add(Code::TemplateUnknown, &output.origin, message, "no `}`", help);
            return;
        };
        let name = &after[..close];
        if name != "path" && name != "name" {
            let help = nearest(name, ["path", "name"]).map_or_else(
                || String::from("{path} is the model's path under the glob's fixed part, {name} its last part"),
                |near| format!("did you mean {{{near}}}?"),
            );
            let message = format!("the output has no {{{name}}}");
            report.add(Code::TemplateUnknown, &output.origin, message, "no such name", Some(help));
        }
        rest = &after[close + 1..];
    }
}

/// Reads every `[[stage]]`.
pub(crate) fn stages(document: &Table, report: &mut Report) -> Vec<Draft> {
    let items = document.get("stage").and_then(Node::list).unwrap_or_default();
    // `[[stages]]` has its own diagnostic.
    let none = document.get("stage").is_none() && document.get("stages").is_none();
    if none || (items.is_empty() && document.get("stage").is_some_and(|n| n.list().is_some())) {
        let origin = document.entry("stage").map_or_else(Origin::default, |entry| entry.key.clone());
        let help = Some(String::from("a common chain is merge, simplify, atlas, simplify, bake, pack"));
        report.add(Code::StageNone, &origin, "the pipeline has no stage", "no [[stage]]", help);
    }
    items.iter().filter_map(|item| item.table().map(|table| stage(table, &item.origin, report))).collect()
}

fn stage(table: &Table, header: &Origin, report: &mut Report) -> Draft {
    let common = StageOptions::keys();
    let kind = match table.get("kind") {
        Some(node) => read_kind(node, report),
        None => {
            let kinds: Vec<&str> = Kind::ALL.iter().map(|kind| kind.as_str()).collect();
            let help = Some(format!("kinds: {}", kinds.join(", ")));
            report.add(Code::KeyMissing, header, "a stage needs the key `kind`", "`kind` is missing", help);
            None
        }
    };
    let id = table.text("id").map(str::to_owned);
    // The kind has been read, and one message is enough.
    let mut rest = table.clone();
    rest.entries
        .retain(|entry| entry.name != "kind" && (entry.name != "id" || !matches!(entry.node.data, Data::Text(_))));
    let from = StageOptions::from_table(&rest, report).from.map(|from| from.0);
    let settings = kind.map(|kind| {
        let mut keys = common;
        keys.iter_mut().for_each(|key| key.standard = Standard::Derived(""));
        let article = if kind == Kind::Atlas { "an" } else { "a" };
        let place = format!("{article} {} stage", kind.as_str());
        keys.splice(0..0, kind.keys());
        for key in keys.iter_mut().filter(|key| swallowed(table, key.name)) {
            key.standard = Standard::Derived("");
        }
        check_keys(table, &keys, &place, header, &|name| of_another_kind(name, kind, &keys), report);
        rules(table, &keys, report);
        match kind {
            Kind::Merge => StageSettings::Merge(MergeOptions::from_table(table, report)),
            Kind::Simplify => StageSettings::Simplify(SimplifyOptions::from_table(table, report)),
            Kind::Atlas => StageSettings::Atlas(AtlasOptions::from_table(table, report)),
            Kind::Bake => StageSettings::Bake(BakeOptions::from_table(table, report)),
            Kind::Pack => StageSettings::Pack(PackOptions::from_table(table, report)),
        }
    });
    Draft { id, from, settings, header: header.clone(), origins: origins(table) }
}

/// What to say of a key that is unknown here and known in another kind of stage.
fn of_another_kind(name: &str, kind: Kind, keys: &[Key]) -> Option<Elsewhere> {
    if nearest(name, keys.iter().map(|key| key.name)).is_some() {
        return None;
    }
    let others: Vec<&str> = Kind::ALL
        .into_iter()
        .filter(|other| *other != kind && other.keys().iter().any(|key| key.name == name))
        .map(Kind::as_str)
        .collect();
    if others.is_empty() {
        return None;
    }
    let names: Vec<&str> = keys.iter().filter(|key| key.is_ready()).map(|key| key.name).collect();
    let message = format!("`{name}` is a key of {}, not of {}", others.join(" and "), kind.as_str());
    Some((Code::KeyUnknown, message, format!("valid keys: {}", names.join(", "))))
}

/// True if a submesh rule holds this key, which then is misplaced and not missing.
fn swallowed(table: &Table, name: &str) -> bool {
    let rules = table.get("submesh").and_then(Node::list).unwrap_or_default();
    rules.iter().filter_map(Node::table).any(|rule| rule.get(name).is_some()) && !RULE_KEYS.contains(&name)
}

/// Explains keys of the stage that stand after a `[[stage.submesh]]` header.
fn rules(table: &Table, keys: &[Key], report: &mut Report) {
    let Some(node) = table.get("submesh") else { return };
    let items = node.list().map_or_else(|| vec![node], |items| items.iter().collect());
    for entry in items.into_iter().filter_map(Node::table).flat_map(|rule| &rule.entries) {
        if RULE_KEYS.contains(&entry.name.as_str()) {
            continue;
        }
        if keys.iter().any(|key| key.name == entry.name) {
            let message = format!("`{}` lands in the rule, not in the stage", entry.name);
            let help =
                "everything below a [[stage.submesh]] header belongs to that rule: move the key above the first one";
            report.add(Code::KeyMisplaced, &entry.key, message, "a key of the stage", Some(help.to_owned()));
        } else {
            let message = format!("unknown key `{}` in a submesh rule", entry.name);
            let help = suggest("valid keys", &entry.name, &RULE_KEYS);
            report.add(Code::KeyUnknown, &entry.key, message, "no such key", help);
        }
    }
}

/// Where each value of a stage stands, items of lists and their values included.
fn origins(table: &Table) -> BTreeMap<String, Origin> {
    let mut origins = BTreeMap::new();
    for entry in &table.entries {
        origins.insert(entry.name.clone(), entry.node.origin.clone());
        for (index, item) in entry.node.list().unwrap_or_default().iter().enumerate() {
            let place = format!("{}[{index}]", entry.name);
            for inner in item.table().into_iter().flat_map(|table| &table.entries) {
                origins.insert(format!("{place}.{}", inner.name), inner.node.origin.clone());
            }
            origins.insert(place, item.origin.clone());
        }
    }
    origins
}
