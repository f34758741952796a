//! A TOML document as a tree whose every node knows the text it came from, so that documents can be laid over each
//! other and still be pointed into.

use std::ops::Range;

use toml::de::{DeTable, DeValue};

use super::diagnostic::{Code, Origin, Report};
use super::value::Value;

/// A value and its place.
#[derive(Clone, Debug)]
pub(crate) struct Node {
    pub(crate) data: Data,
    pub(crate) origin: Origin,
}

/// What a node holds.
#[derive(Clone, Debug)]
pub(crate) enum Data {
    Text(String),
    /// `None` if it does not fit 64 bits.
    Integer(Option<i64>),
    Float(f64),
    Boolean(bool),
    Datetime,
    List(Vec<Node>),
    Table(Table),
}

/// Named nodes in the order of the text.
#[derive(Clone, Debug, Default)]
pub(crate) struct Table {
    pub(crate) entries: Vec<Entry>,
}

/// One `key = value`.
#[derive(Clone, Debug)]
pub(crate) struct Entry {
    pub(crate) name: String,
    /// Place of the key.
    pub(crate) key: Origin,
    pub(crate) node: Node,
}

impl Table {
    pub(crate) fn entry(&self, name: &str) -> Option<&Entry> {
        self.entries.iter().find(|entry| entry.name == name)
    }

    pub(crate) fn get(&self, name: &str) -> Option<&Node> {
        self.entry(name).map(|entry| &entry.node)
    }

    pub(crate) fn text(&self, name: &str) -> Option<&str> {
        match &self.get(name)?.data {
            Data::Text(text) => Some(text),
            _ => None,
        }
    }

    /// Replaces the entry of that name in place, or appends.
    pub(crate) fn put(&mut self, new: Entry) {
        match self.entries.iter_mut().find(|entry| entry.name == new.name) {
            Some(entry) => *entry = new,
            None => self.entries.push(new),
        }
    }
}

impl Node {
    /// The type's name as people say it.
    pub(crate) fn type_name(&self) -> &'static str {
        match self.data {
            Data::Text(_) => "a string",
            Data::Integer(_) => "a whole number",
            Data::Float(_) => "a number with a point",
            Data::Boolean(_) => "true or false",
            Data::Datetime => "a date",
            Data::List(_) => "a list",
            Data::Table(_) => "a table",
        }
    }

    pub(crate) fn table(&self) -> Option<&Table> {
        match &self.data {
            Data::Table(table) => Some(table),
            _ => None,
        }
    }

    pub(crate) fn table_mut(&mut self) -> Option<&mut Table> {
        match &mut self.data {
            Data::Table(table) => Some(table),
            _ => None,
        }
    }

    pub(crate) fn list(&self) -> Option<&[Node]> {
        match &self.data {
            Data::List(items) => Some(items),
            _ => None,
        }
    }

    /// Without its places; a date becomes absent.
    pub(crate) fn plain(&self) -> Value {
        match &self.data {
            Data::Text(text) => Value::Text(text.clone()),
            Data::Integer(value) => value.map_or(Value::Absent, Value::Integer),
            Data::Float(value) => Value::Number(*value),
            Data::Boolean(value) => Value::Boolean(*value),
            Data::Datetime => Value::Absent,
            Data::List(items) => Value::List(items.iter().map(Node::plain).collect()),
            Data::Table(table) => {
                let mut entries: Vec<(String, Value)> =
                    table.entries.iter().map(|entry| (entry.name.clone(), entry.node.plain())).collect();
                entries.sort_by(|a, b| a.0.cmp(&b.0));
                Value::Table(entries)
            }
        }
    }

    /// Whole or not, as a double.
    pub(crate) fn number(&self) -> Option<f64> {
        match self.data {
            Data::Integer(value) => value.map(|value| value as f64),
            Data::Float(value) => Some(value),
            _ => None,
        }
    }
}

/// The document in `text`, with every syntax error reported. The second value is where the first error stands: what
/// lies before it was read as it was meant.
pub(crate) fn document(source: usize, text: &str, report: &mut Report) -> (Table, Option<usize>) {
    let (table, errors) = DeTable::parse_recoverable(text);
    let place = |error: &toml::de::Error| error.span().unwrap_or(text.len()..text.len());
    let first = errors.iter().map(|error| place(error).start).min();
    let repeats = |error: &toml::de::Error| error.message() == "duplicate key";
    let broken = errors.iter().filter(|error| !repeats(error)).map(|error| place(error).start).min();
    for error in &errors {
        let span = place(error);
        let message = sentence(error.message());
        // After a broken header its keys land in the table before: their repetition is no defect of its own.
        if repeats(error) && broken.is_some_and(|broken| broken < span.start) {
            continue;
        }
        let help = message
            .starts_with("string values must be quoted")
            .then(|| String::from("strings stand in quotes, lengths too: \"0.1 mm\""));
        report.add(Code::Syntax, &Origin::new(source, span), message, "", help);
    }
    (convert_table(source, table.get_ref()), first)
}

/// One TOML value, with every syntax error reported; its spans start at `offset` of the source.
pub(crate) fn value(source: usize, offset: usize, text: &str, report: &mut Report) -> Option<Node> {
    let (value, errors) = DeValue::parse_recoverable(text);
    for error in &errors {
        let span = error.span().unwrap_or(text.len()..text.len());
        let origin = Origin::new(source, span.start + offset..span.end + offset);
        let help = "a value that is no string is written as in a pipeline, quotes of strings within lists included";
        report.add(Code::SetSyntax, &origin, sentence(error.message()), "", Some(help.to_owned()));
    }
    if !errors.is_empty() {
        return None;
    }
    let mut node = convert(source, value.get_ref(), value.span());
    shift(&mut node, offset);
    Some(node)
}

/// The parser's messages on one line.
fn sentence(message: &str) -> String {
    message.split_whitespace().collect::<Vec<_>>().join(" ")
}

fn shift(node: &mut Node, offset: usize) {
    node.origin.span.start += offset;
    node.origin.span.end += offset;
    match &mut node.data {
        Data::List(items) => items.iter_mut().for_each(|item| shift(item, offset)),
        Data::Table(table) => {
            for entry in &mut table.entries {
                entry.key.span.start += offset;
                entry.key.span.end += offset;
                shift(&mut entry.node, offset);
            }
        }
        _ => {}
    }
}

fn convert(source: usize, value: &DeValue<'_>, span: Range<usize>) -> Node {
    let data = match value {
        DeValue::String(text) => Data::Text(text.to_string()),
        DeValue::Integer(integer) => Data::Integer(i64::from_str_radix(integer.as_str(), integer.radix()).ok()),
        DeValue::Float(float) => Data::Float(float.as_str().parse().unwrap_or(f64::NAN)),
        DeValue::Boolean(value) => Data::Boolean(*value),
        DeValue::Datetime(_) => Data::Datetime,
        DeValue::Array(items) => {
            Data::List(items.iter().map(|item| convert(source, item.get_ref(), item.span())).collect())
        }
        DeValue::Table(table) => Data::Table(convert_table(source, table)),
    };
    Node { data, origin: Origin::new(source, span) }
}

fn convert_table(source: usize, table: &DeTable<'_>) -> Table {
    let entries = table
        .iter()
        .map(|(key, value)| Entry {
            name: key.get_ref().to_string(),
            key: Origin::new(source, key.span()),
            node: convert(source, value.get_ref(), value.span()),
        })
        .collect();
    Table { entries }
}
