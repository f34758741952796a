//! One document out of a file, its parents, the command line's settings and the overrides.

use std::io;

use super::diagnostic::{Code, Origin, Report, nearest, suggest};
use super::dom::{self, Data, Entry, Node, Table};
use super::options::{AssetOptions, FileOptions, Kind, OverrideOptions, StageOptions};
use super::pipeline::Override;
use super::setting::{Elsewhere, FromTable, Key, Options, Shape, Standard, check_keys, mistyped};

/// The language that this kiln reads.
pub const LANGUAGE: u32 = 1;

/// Parents of parents of parents: far beyond any use, far below any trouble.
const MAX_PARENTS: usize = 32;

/// What reading all files gave.
pub(crate) struct Composed {
    /// The file laid over its parents.
    pub(crate) document: Table,
    /// The file's own version.
    pub(crate) language: u32,
    /// First syntax error of each source that has one: (source, offset).
    pub(crate) syntax: Vec<(usize, usize)>,
}

/// Reads the file and its parents, checks what belongs to each file alone, and lays them over each other.
/// `None` if a file is written in a newer language: the rest of it means nothing here.
pub(crate) fn files(
    name: &str,
    text: &str,
    read_base: &dyn Fn(&str) -> io::Result<String>,
    report: &mut Report,
) -> Option<Composed> {
    let mut layers: Vec<Table> = Vec::new();
    let mut names: Vec<String> = Vec::new();
    let mut syntax = Vec::new();
    let mut next = Some((normal(name), text.to_owned()));
    let mut language = LANGUAGE;
    let mut newer = false;
    let given = name;
    while let Some((name, text)) = next.take() {
        let source = report.add_source(if names.is_empty() { given } else { &name }, &text, false);
        let (mut table, first_error) = dom::document(source, &text, report);
        syntax.extend(first_error.map(|offset| (source, offset)));
        names.push(name);
        match version(source, &table, first_error.is_some(), report) {
            Version::Newer => {
                newer = true;
                break;
            }
            Version::Known(number) if source == 0 => language = number,
            _ => {}
        }
        top_keys(source, &table, report);
        default_ids(&mut table, report);
        next = parent(&names, &table, read_base, report);
        layers.push(table);
    }
    if newer {
        report.retain(|diagnostic| diagnostic.code == Code::VersionNewer);
        return None;
    }
    let mut document = Table::default();
    for layer in layers.into_iter().rev() {
        document = if document.entries.is_empty() { layer } else { laid_over(document, layer, report) };
    }
    Some(Composed { document, language, syntax })
}

enum Version {
    Known(u32),
    Newer,
    Unknown,
}

fn version(source: usize, table: &Table, broken: bool, report: &mut Report) -> Version {
    let Some(node) = table.get("kiln") else {
        if !broken {
            let help = Some(format!("write `kiln = {LANGUAGE}` as the first line"));
            let message = "the file does not say which version of the language it is written in";
            report.add(Code::VersionMissing, &Origin::new(source, 0..0), message, "`kiln` is missing", help);
        }
        return Version::Unknown;
    };
    match node.data {
        Data::Integer(Some(number)) if number > i64::from(LANGUAGE) => {
            let message =
                format!("the file is written in version {number} of the language, this kiln reads up to {LANGUAGE}");
            let help = Some(String::from("use a newer kiln"));
            report.add(Code::VersionNewer, &node.origin, message, "newer", help);
            Version::Newer
        }
        Data::Integer(Some(number)) if number >= 1 => Version::Known(LANGUAGE.min(number as u32)),
        Data::Integer(_) => {
            let message = format!("no version of the language has this number; versions go from 1 to {LANGUAGE}");
            report.add(Code::VersionInvalid, &node.origin, message, "no such version", None);
            Version::Unknown
        }
        _ => {
            mistyped(node, "a whole number", Some(format!("write `kiln = {LANGUAGE}`")), report);
            Version::Unknown
        }
    }
}

/// Keys of a file's top, `kiln` and `base` included.
pub(crate) fn file_keys() -> Vec<Key> {
    let table = |name, sentence: &str, shape| Key {
        name,
        shape,
        standard: Standard::Derived(""),
        range: None,
        sentence: sentence.to_owned(),
    };
    let mut keys = FileOptions::keys();
    // A missing version has its own diagnostic.
    keys.iter_mut().for_each(|key| key.standard = Standard::Derived(""));
    keys.push(table("asset", "What is built from what.", Shape::Table("input and output")));
    keys.push(table("stage", "The stages.", Shape::List(Box::new(Shape::Table("id, kind and the kind's keys")))));
    keys.push(table("override", "Other values for some assets.", Shape::List(Box::new(Shape::Table("match and set")))));
    keys
}

fn top_keys(source: usize, table: &Table, report: &mut Report) {
    let elsewhere = |name: &str| {
        let plural = match name {
            "stages" => "stage",
            "overrides" => "override",
            _ => return stage_or_asset_key(name),
        };
        Some((Code::KeyUnknown, format!("unknown key `{name}` at the top of the file"), format!("write [[{plural}]]")))
    };
    check_keys(table, &file_keys(), "the top of the file", &Origin::new(source, 0..0), &elsewhere, report);
    if let Some(node) = table.get("asset")
        && node.table().is_none()
    {
        mistyped(node, "a table", Some(String::from("write [asset]")), report);
    }
    for name in ["stage", "override"] {
        let Some(node) = table.get(name) else { continue };
        match node.list() {
            None => mistyped(node, "a list of tables", Some(format!("write [[{name}]]")), report),
            Some(items) => items.iter().filter(|item| item.table().is_none()).for_each(|item| {
                mistyped(item, "a table", Some(format!("write [[{name}]]")), report);
            }),
        }
    }
}

fn stage_or_asset_key(name: &str) -> Option<Elsewhere> {
    let message = format!("unknown key `{name}` at the top of the file");
    if AssetOptions::keys().iter().any(|key| key.name == name) {
        return Some((Code::KeyUnknown, message, format!("`{name}` belongs below [asset]")));
    }
    let of_stage = StageOptions::keys().iter().any(|key| key.name == name)
        || Kind::ALL.iter().any(|kind| kind.keys().iter().any(|key| key.name == name));
    of_stage.then(|| (Code::KeyUnknown, message, format!("`{name}` belongs below a [[stage]]")))
}

fn is_id(text: &str) -> bool {
    text.bytes().next().is_some_and(|first| first.is_ascii_lowercase())
        && text.bytes().all(|byte| byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'-')
}

fn stages_mut(table: &mut Table) -> impl Iterator<Item = &mut Node> {
    table
        .entries
        .iter_mut()
        .filter(|entry| entry.name == "stage")
        .filter_map(|entry| match &mut entry.node.data {
            Data::List(items) => Some(items.iter_mut().filter(|item| item.table().is_some())),
            _ => None,
        })
        .flatten()
}

/// Gives every stage of one file its id, and checks the ids.
fn default_ids(table: &mut Table, report: &mut Report) {
    let kinds: Vec<String> = stages_mut(table)
        .filter_map(|node| node.table().and_then(|stage| stage.text("kind")).map(str::to_owned))
        .collect();
    let mut seen: Vec<(String, Origin)> = Vec::new();
    let mut unnamed = 0;
    for node in stages_mut(table) {
        let header = node.origin.clone();
        let Some(stage) = node.table_mut() else { continue };
        if stage.get("id").is_none() {
            // A stage without a kind is reported where kinds are read.
            let Some(kind) = stage.get("kind").cloned() else { continue };
            let Data::Text(text) = &kind.data else { continue };
            if kinds.iter().filter(|other| *other == text).count() > 1 {
                let message = format!("several stages have the kind `{text}`, so each needs an id of its own");
                unnamed += 1;
                let help = Some(format!("for example id = \"{text}-{unnamed}\""));
                report.add(Code::StageIdMissing, &header, message, "`id` is missing", help);
                continue;
            }
            if !is_id(text) {
                continue;
            }
            let entry = Entry { name: String::from("id"), key: kind.origin.clone(), node: kind };
            stage.entries.push(entry);
        }
        let Some(Node { data: Data::Text(id), origin }) = stage.get("id") else { continue };
        if !is_id(id) {
            let lower: String = id
                .to_lowercase()
                .chars()
                .map(|c| if c.is_ascii_lowercase() || c.is_ascii_digit() { c } else { '-' })
                .collect();
            let lower = lower.trim_start_matches(|c: char| !c.is_ascii_lowercase());
            let help = is_id(lower).then(|| format!("for example \"{lower}\""));
            let message = "an id starts with a letter a to z and goes on with letters, digits and hyphens";
            report.add(Code::StageId, origin, message, "not an id", help);
        }
        if let Some((_, first)) = seen.iter().find(|(other, _)| other == id) {
            let message = format!("two stages have the id `{id}`");
            let help = Some(format!("the first one is at {}", report.place(first)));
            report.add(Code::StageIdRepeated, origin, message, "again", help);
            continue;
        }
        seen.push((id.clone(), origin.clone()));
    }
}

/// The parent's name and text, if the file has one that can be read.
fn parent(
    names: &[String],
    table: &Table,
    read_base: &dyn Fn(&str) -> io::Result<String>,
    report: &mut Report,
) -> Option<(String, String)> {
    let node = table.get("base")?;
    let Data::Text(text) = &node.data else {
        mistyped(node, "a path", Some(String::from("a file has one parent")), report);
        return None;
    };
    if text.trim().is_empty() {
        report.add(Code::ValueEmpty, &node.origin, "`base` names no file", "empty", None);
        return None;
    }
    let child = names.last().map_or("", String::as_str);
    let path = if text.starts_with('/') {
        normal(text)
    } else {
        normal(&format!("{}{text}", child.rfind('/').map_or("", |at| &child[..=at])))
    };
    if names.contains(&path) || names.len() > MAX_PARENTS {
        let mut way = names.to_vec();
        way.push(path);
        let help = Some(format!("the way round: {}", way.join(" -> ")));
        report.add(Code::BaseCycle, &node.origin, "a file cannot be its own parent", "leads back", help);
        return None;
    }
    match read_base(&path) {
        Ok(text) => Some((path, text)),
        Err(error) => {
            let message = format!("the parent {path} cannot be read: {error}");
            let help = Some(String::from("`base` is relative to the folder of the file that names it"));
            report.add(Code::BaseUnreadable, &node.origin, message, "not readable", help);
            None
        }
    }
}

/// The path without `.` and with `..` taken back where a folder precedes it.
pub fn normal(path: &str) -> String {
    let mut parts: Vec<&str> = Vec::new();
    for part in path.split('/') {
        match part {
            "." => {}
            "" if !parts.is_empty() => {}
            ".." if parts.last().is_some_and(|last| !last.is_empty() && *last != "..") => {
                parts.pop();
            }
            part => parts.push(part),
        }
    }
    parts.join("/")
}

/// `child` laid over `parent`: tables key by key, stages by id, everything else replaced. A stage that the parent lacks
/// stands directly after the stage before it in the child.
fn laid_over(parent: Table, child: Table, report: &mut Report) -> Table {
    let mut result = parent;
    for entry in child.entries {
        let Some(below) = result.entries.iter_mut().find(|below| below.name == entry.name) else {
            result.entries.push(entry);
            continue;
        };
        match (entry.name.as_str(), &mut below.node.data, entry.node.data) {
            ("asset", Data::Table(below), Data::Table(above)) => above.entries.into_iter().for_each(|e| below.put(e)),
            ("stage", Data::List(below), Data::List(above)) => stages_over(below, above, report),
            (_, _, data) => {
                below.key = entry.key;
                below.node = Node { data, origin: entry.node.origin };
            }
        }
    }
    result
}

fn stages_over(below: &mut Vec<Node>, above: Vec<Node>, report: &mut Report) {
    let mut place = 0;
    for stage in above {
        let id = stage.table().and_then(|table| table.text("id")).map(str::to_owned);
        let found = below.iter().position(|b| id.is_some() && b.table().and_then(|t| t.text("id")) == id.as_deref());
        let Some(at) = found else {
            below.insert(place, stage);
            place += 1;
            continue;
        };
        place = at + 1;
        let (Some(old), Data::Table(new)) = (below[at].table_mut(), stage.data) else { continue };
        if let (Some(was), Some(is), Some(node)) = (old.text("kind"), new.text("kind"), new.get("kind"))
            && was != is
        {
            let message = format!("the parent's stage `{}` has the kind `{was}`", id.unwrap_or_default());
            let help = Some(String::from("give the stage another id, or leave its kind out"));
            report.add(Code::StageKindChanged, &node.origin, message, "another kind", help);
            continue;
        }
        new.entries.into_iter().filter(|entry| entry.name != "kind").for_each(|entry| old.put(entry));
        below[at].origin = stage.origin;
    }
}

/// One value for one key of one stage.
#[derive(Clone, Debug)]
pub(crate) struct Assignment {
    pub(crate) id: String,
    pub(crate) entry: Entry,
}

/// Puts values into the document's stages. Stages that do not exist are passed over: whoever made the assignment has
/// said so.
pub(crate) fn assign(document: &mut Table, set: &[Assignment]) {
    for one in set {
        for node in stages_mut(document) {
            if let Some(stage) = node.table_mut()
                && stage.text("id") == Some(&one.id)
            {
                stage.put(one.entry.clone());
            }
        }
    }
}

/// Why a path names no key: message and help.
struct NoKey(String, Option<String>);

/// The type of `stage.ID.KEY`.
fn stage_key(document: &mut Table, id: &str, key: &str) -> Result<Shape, NoKey> {
    let stages: Vec<(String, Option<Kind>)> = stages_mut(document)
        .filter_map(|node| node.table())
        .filter_map(|stage| Some((stage.text("id")?.to_owned(), stage.text("kind").and_then(Kind::from_name))))
        .collect();
    let Some((_, kind)) = stages.iter().find(|(other, _)| other == id) else {
        let ids: Vec<&str> = stages.iter().map(|(id, _)| id.as_str()).collect();
        return Err(NoKey(format!("no stage has the id `{id}`"), suggest("stages", id, &ids)));
    };
    if key == "id" || key == "kind" {
        return Err(NoKey(format!("`{key}` says what the stage is and cannot be set from outside"), None));
    }
    // An unknown kind is reported at the stage; until it is mended nobody knows its keys.
    let Some(kind) = kind else { return Ok(Shape::Text) };
    let mut keys = StageOptions::keys();
    keys.retain(|known| known.name == "from");
    keys.splice(0..0, kind.keys());
    match keys.iter().find(|known| known.name == key) {
        Some(known) => Ok(known.shape.clone()),
        None => {
            let names: Vec<&str> = keys.iter().map(|known| known.name).collect();
            let message = format!("unknown key `{key}` in the {} stage `{id}`", kind.as_str());
            Err(NoKey(message, suggest("valid keys", key, &names)))
        }
    }
}

/// Applies `--set KEY=VALUE` arguments in order: `asset.input`, `asset.output`, `stage.ID.KEY`. The value is taken as it
/// stands where the key takes a string, else it is TOML.
pub(crate) fn settings(document: &mut Table, arguments: &[String], report: &mut Report) {
    for argument in arguments {
        let source = report.add_source("--set", argument, true);
        let Some(equals) = argument.find('=') else {
            let help = Some(String::from("for example --set stage.lods.levels='[{ keep = 0.1 }]'"));
            let origin = Origin::new(source, 0..argument.len());
            report.add(Code::SetSyntax, &origin, "a setting is KEY=VALUE", "no `=`", help);
            continue;
        };
        let name = argument[..equals].trim();
        let start = argument.len() - argument.trim_start().len();
        let key = Origin::new(source, start.min(equals)..(start + name.len()).min(equals));
        let parts: Vec<&str> = name.split('.').collect();
        let target = match parts[..] {
            ["asset", field] => match AssetOptions::keys().into_iter().find(|known| known.name == field) {
                Some(known) => Ok(known.shape),
                None => Err(NoKey(
                    format!("unknown key `{name}`"),
                    suggest("valid keys", name, &["asset.input", "asset.output"]),
                )),
            },
            ["stage", id, field] => stage_key(document, id, field),
            _ => {
                let known =
                    nearest(parts[0], ["asset", "stage"]).map_or(String::new(), |n| format!("; `{n}.` is near"));
                let help = format!("settable are asset.input, asset.output and stage.ID.KEY{known}");
                Err(NoKey(format!("unknown key `{name}`"), Some(help)))
            }
        };
        let shape = match target {
            Ok(shape) => shape,
            Err(NoKey(message, help)) => {
                report.add(Code::SetUnknown, &key, message, "no such key", help);
                continue;
            }
        };
        let value_at = equals + 1;
        let text = &argument[value_at..];
        // A name with parameters is a table, and no name starts with a brace.
        let as_table = matches!(shape, Shape::ChoiceOrTable(_)) && text.trim_start().starts_with('{');
        let node = if shape.is_string() && !as_table {
            let origin = Origin::new(source, value_at..argument.len());
            Some(Node { data: Data::Text(text.to_owned()), origin })
        } else {
            dom::value(source, value_at, text, report)
        };
        let Some(node) = node else { continue };
        let entry = |name: &str| Entry { name: name.to_owned(), key: key.clone(), node: node.clone() };
        match parts[..] {
            ["asset", field] => {
                if document.get("asset").is_none() {
                    let data = Data::Table(Table::default());
                    let node = Node { data, origin: key.clone() };
                    document.put(Entry { name: String::from("asset"), key: key.clone(), node });
                }
                let asset = document.entries.iter_mut().find(|entry| entry.name == "asset");
                if let Some(table) = asset.and_then(|entry| entry.node.table_mut()) {
                    table.put(entry(field));
                }
            }
            ["stage", id, field] => assign(document, &[Assignment { id: id.to_owned(), entry: entry(field) }]),
            _ => {}
        }
    }
}

/// The document's overrides, each checked for itself.
pub(crate) fn overrides(document: &Table, report: &mut Report) -> Vec<Override> {
    let Some(items) = document.get("override").and_then(Node::list) else { return Vec::new() };
    let mut scratch = document.clone();
    let mut read = Vec::new();
    for item in items {
        let Some(table) = item.table() else { continue };
        check_keys(table, &OverrideOptions::keys(), "an override", &item.origin, &|_| None, report);
        let options = OverrideOptions::from_table(table, report);
        let mut set = Vec::new();
        if let Some(values) = table.get("set").and_then(Node::table) {
            assignments(values, &mut Vec::new(), &mut scratch, &mut set, report);
        }
        let Some(node) = table.get("match").filter(|node| matches!(node.data, Data::Text(_))) else { continue };
        match glob::Pattern::new(&options.pattern) {
            Ok(pattern) => read.push(Override { pattern, origin: node.origin.clone(), set }),
            Err(error) => glob_error(node, &options.pattern, &error, report),
        }
    }
    read
}

pub(crate) fn glob_error(node: &Node, glob: &str, error: &glob::PatternError, report: &mut Report) {
    let message = format!("`{glob}` is malformed at character {}: {}", error.pos + 1, error.msg);
    let help =
        Some(String::from("`*` and `?` match within a name, `**` whole folders, `[ab]` one of several characters"));
    report.add(Code::GlobSyntax, &node.origin, message, "malformed", help);
}

/// Walks a `set` table whose names may be quoted paths or nested tables, down to `stage.ID.KEY`.
fn assignments(
    values: &Table,
    path: &mut Vec<String>,
    document: &mut Table,
    set: &mut Vec<Assignment>,
    report: &mut Report,
) {
    for entry in &values.entries {
        let depth = path.len();
        path.extend(entry.name.split('.').map(str::to_owned));
        let nested = entry.node.table().filter(|_| path.len() < 3);
        match (path.as_slice(), nested) {
            ([root, id, key], _) if root == "stage" => match stage_key(document, id, key) {
                Ok(_) => {
                    let entry = Entry { name: key.clone(), key: entry.key.clone(), node: entry.node.clone() };
                    set.push(Assignment { id: id.clone(), entry });
                }
                Err(NoKey(message, help)) => {
                    report.add(Code::OverridePath, &entry.key, message, "names no key", help);
                }
            },
            ([root, ..], Some(deeper)) if root == "stage" => assignments(deeper, path, document, set, report),
            _ => {
                let message = format!("an override sets `stage.ID.KEY`, not `{}`", path.join("."));
                let help = Some(String::from("for example { \"stage.lods.levels\" = [ { keep = 0.1 } ] }"));
                report.add(Code::OverridePath, &entry.key, message, "names no key", help);
            }
        }
        path.truncate(depth);
    }
}
