//! How option structs and the language's keys come from one table.
//!
//! `options!` declares a struct, its defaults, its keys, their reader, their writer and their documentation at once, and
//! `choices!` an enum of names: a key that the parser takes and the reference lacks cannot be written down.

use super::diagnostic::{Code, Report, nearest, suggest};
use super::dom::{Data, Node, Table};
use super::length::{Length, LengthError, Unit};
use super::value::{Value, number};

/// Type of a key, as far as messages, the reference and `--set` need to know it.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// Any string.
    Text,
    /// A string with number and unit.
    Length,
    /// One of these names: (name, sentence, implemented).
    Choice(&'static [Choice]),
    /// One of these names, or a table with `kind` and the name's parameters.
    ChoiceOrTable(&'static [Choice]),
    /// The id of a stage.
    StageId,
    /// A whole number.
    Integer,
    /// A number.
    Number,
    /// True or false.
    Boolean,
    /// A list of these.
    List(Box<Shape>),
    /// A table; the text names its keys.
    Table(&'static str),
}

/// One name that a key takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Choice {
    /// As it is written.
    pub name: &'static str,
    /// What it means, one sentence.
    pub sentence: &'static str,
    /// False if this version only recognises it.
    pub ready: bool,
}

impl Shape {
    /// True if `--set KEY=VALUE` takes VALUE as it stands.
    pub fn is_string(&self) -> bool {
        matches!(self, Shape::Text | Shape::Length | Shape::Choice(_) | Shape::ChoiceOrTable(_) | Shape::StageId)
    }

    /// With its article: "a length", "a list of levels".
    pub fn describe(&self) -> String {
        match self {
            Shape::Text => String::from("a string"),
            Shape::Length => String::from("a length"),
            Shape::Choice(_) => String::from("a name"),
            Shape::ChoiceOrTable(_) => String::from("a name or a table"),
            Shape::StageId => String::from("a stage's id"),
            Shape::Integer => String::from("a whole number"),
            Shape::Number => String::from("a number"),
            Shape::Boolean => String::from("true or false"),
            Shape::List(item) => format!("a list of {}", item.plural()),
            Shape::Table(keys) => format!("a table with {keys}"),
        }
    }

    fn plural(&self) -> String {
        match self {
            Shape::Text => String::from("strings"),
            Shape::Length => String::from("lengths"),
            Shape::Choice(_) | Shape::ChoiceOrTable(_) => String::from("names"),
            Shape::StageId => String::from("stage ids"),
            Shape::Integer => String::from("whole numbers"),
            Shape::Number => String::from("numbers"),
            Shape::Boolean => String::from("trues or falses"),
            Shape::List(item) => format!("lists of {}", item.plural()),
            Shape::Table(keys) => format!("tables with {keys}"),
        }
    }

    /// The names that the key takes, ready or not.
    pub fn choices(&self) -> &'static [Choice] {
        match self {
            Shape::Choice(choices) | Shape::ChoiceOrTable(choices) => choices,
            Shape::List(item) => item.choices(),
            _ => &[],
        }
    }
}

/// What a key is worth if nobody sets it.
#[derive(Clone, Debug, PartialEq)]
pub enum Standard {
    /// This value.
    Value(Value),
    /// It must be given.
    Required,
    /// It follows from other things; the text says from which.
    Derived(&'static str),
    /// The key is not implemented yet.
    Later,
}

/// One key of a table of the language.
#[derive(Clone, Debug, PartialEq)]
pub struct Key {
    /// As it is written.
    pub name: &'static str,
    /// What it takes.
    pub shape: Shape,
    /// What it is worth if nobody sets it.
    pub standard: Standard,
    /// Least and greatest number, both allowed.
    pub range: Option<(f64, f64)>,
    /// What it does.
    pub sentence: String,
}

impl Key {
    /// False if this version only recognises it.
    pub fn is_ready(&self) -> bool {
        self.standard != Standard::Later
    }
}

/// A struct whose fields are the keys of a table of the language.
pub trait Options: Default + Clone {
    /// Its keys in the order of the reference.
    fn keys() -> Vec<Key>;
    /// Its values in the order of the keys, defaults filled.
    fn values(&self) -> Vec<(String, Value)>;
}

/// Reading of an option struct; separate from [`Options`] because its types are private.
pub(crate) trait FromTable: Options {
    /// Whatever can be read; the rest is reported and keeps its default.
    fn from_table(table: &Table, report: &mut Report) -> Self;
}

/// A type that a key can have.
pub(crate) trait Setting: Sized {
    fn shape() -> Shape;
    /// `None` after reporting why.
    fn read(node: &Node, report: &mut Report) -> Option<Self>;
    fn write(&self) -> Value;
}

/// Declares an option struct together with its keys.
macro_rules! options {
    (
        $(#[doc = $about:literal])*
        pub struct $name:ident {
            $(
                $(#[doc = $sentence:literal])*
                $key:literal => $field:ident : $type:ty, $standard:ident $(($($argument:tt)*))? $(, within $least:literal..=$most:literal)?;
            )*
            $(later {
                $( $(#[doc = $later_sentence:literal])* $later_key:literal; )*
            })?
        }
    ) => {
        $(#[doc = $about])*
        #[derive(Clone, Debug, PartialEq)]
        pub struct $name {
            $( $(#[doc = $sentence])* pub $field: $type, )*
        }

        impl Default for $name {
            fn default() -> Self {
                $name { $( $field: $crate::language::setting::options!(@default $standard $(($($argument)*))?), )* }
            }
        }

        impl $crate::language::setting::Options for $name {
            fn keys() -> Vec<$crate::language::setting::Key> {
                use $crate::language::setting::{Key, Setting, Standard};
                let _standard = $name::default();
                let ready = [$( Key {
                    name: $key,
                    shape: <$type as Setting>::shape(),
                    standard: $crate::language::setting::options!(@standard _standard.$field, $standard $(($($argument)*))?),
                    range: $crate::language::setting::options!(@range $($least, $most)?),
                    sentence: $crate::language::setting::joined(&[$($sentence),*]),
                }, )*];
                let later: Vec<Key> = vec![$( $( Key {
                    name: $later_key,
                    shape: $crate::language::setting::Shape::Text,
                    standard: Standard::Later,
                    range: None,
                    sentence: $crate::language::setting::joined(&[$($later_sentence),*]),
                }, )* )?];
                ready.into_iter().chain(later).collect()
            }

            fn values(&self) -> Vec<(String, $crate::language::value::Value)> {
                use $crate::language::setting::Setting;
                vec![$( (String::from($key), Setting::write(&self.$field)), )*]
            }
        }

        impl $crate::language::setting::FromTable for $name {
            fn from_table(
                table: &$crate::language::dom::Table,
                report: &mut $crate::language::diagnostic::Report,
            ) -> Self {
                let mut read = $name::default();
                $(
                    if let Some(node) = table.get($key) {
                        let range = $crate::language::setting::options!(@range $($least, $most)?);
                        if let Some(value) = $crate::language::setting::read_within($key, node, range, report) {
                            read.$field = value;
                        }
                    }
                )*
                read
            }
        }
    };
    (@default default($value:expr)) => { $value };
    (@default required) => { Default::default() };
    (@default derived($text:literal)) => { Default::default() };
    (@standard $field:expr, default($value:expr)) => { Standard::Value(Setting::write(&$field)) };
    (@standard $field:expr, required) => { Standard::Required };
    (@standard $field:expr, derived($text:literal)) => { Standard::Derived($text) };
    (@range) => { None::<(f64, f64)> };
    (@range $least:literal, $most:literal) => { Some((f64::from($least), f64::from($most))) };
}

/// Declares an enum of names that a key takes; those under `later` are recognised and refused.
macro_rules! choices {
    (
        $(#[doc = $about:literal])*
        pub enum $name:ident {
            $( $(#[doc = $sentence:literal])* $text:literal => $variant:ident, )*
            $(later { $( $(#[doc = $later_sentence:literal])* $later:literal, )* })?
        }
    ) => {
        $(#[doc = $about])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
        pub enum $name {
            $( $(#[doc = $sentence])* $variant, )*
        }

        impl $name {
            /// Every name that the language knows here, ready or not.
            pub const CHOICES: &'static [$crate::language::setting::Choice] = &[
                $( $crate::language::setting::Choice {
                    name: $text, sentence: concat!($($sentence),*), ready: true,
                }, )*
                $( $( $crate::language::setting::Choice {
                    name: $later, sentence: concat!($($later_sentence),*), ready: false,
                }, )* )?
            ];

            /// As it is written in a pipeline.
            pub fn as_str(self) -> &'static str {
                match self { $( $name::$variant => $text, )* }
            }
        }

        impl $crate::language::setting::Setting for $name {
            fn shape() -> $crate::language::setting::Shape {
                $crate::language::setting::Shape::Choice($name::CHOICES)
            }

            fn read(
                node: &$crate::language::dom::Node,
                report: &mut $crate::language::diagnostic::Report,
            ) -> Option<Self> {
                match $crate::language::setting::choose(node, $name::CHOICES, report)? {
                    $( $text => Some($name::$variant), )*
                    _ => None,
                }
            }

            fn write(&self) -> $crate::language::value::Value {
                $crate::language::value::Value::Text(String::from(self.as_str()))
            }
        }
    };
}

pub(crate) use {choices, options};

/// Doc comment lines as one sentence.
pub(crate) fn joined(lines: &[&str]) -> String {
    lines.iter().map(|line| line.trim()).collect::<Vec<_>>().join(" ")
}

/// Reads a value and checks its range, in that order.
pub(crate) fn read_within<T: Setting>(
    name: &str,
    node: &Node,
    range: Option<(f64, f64)>,
    report: &mut Report,
) -> Option<T> {
    if let Some((least, most)) = range {
        let outside = match node.data {
            // Beyond 64 bits is beyond every range.
            Data::Integer(value) => value.is_none_or(|value| !(least..=most).contains(&(value as f64))),
            // A float that is no whole number may still have the wrong type: that comes first, in `T::read`.
            Data::Float(value) => T::shape() == Shape::Number && !(least..=most).contains(&value),
            _ => false,
        };
        if outside {
            let message = format!("`{name}` must lie between {} and {}", plain(least), plain(most));
            report.add(Code::ValueRange, &node.origin, message, "out of range", None);
            return None;
        }
    }
    T::read(node, report)
}

/// A bound without a needless point.
pub(crate) fn plain(value: f64) -> String {
    if value.fract() == 0.0 && value.abs() < 1e15 { format!("{value:.0}") } else { number(value) }
}

/// Reports a value of the wrong type.
pub(crate) fn mistyped(node: &Node, expected: &str, help: Option<String>, report: &mut Report) {
    let found = node.type_name();
    report.add(Code::ValueType, &node.origin, format!("expected {expected}, found {found}"), found, help);
}

/// The name in `node` if it is one of `choices` and ready.
pub(crate) fn choose(node: &Node, choices: &'static [Choice], report: &mut Report) -> Option<&'static str> {
    let ready: Vec<&str> = choices.iter().filter(|choice| choice.ready).map(|choice| choice.name).collect();
    let Data::Text(text) = &node.data else {
        mistyped(node, "a name", Some(format!("one of: \"{}\"", ready.join("\", \""))), report);
        return None;
    };
    match choices.iter().find(|choice| choice.name == text) {
        Some(choice) if choice.ready => Some(choice.name),
        Some(choice) => {
            refuse_choice(node, choice, &ready, report);
            None
        }
        None => {
            // A planned name is worth suggesting only to someone who meant it.
            let all: Vec<&str> = choices.iter().map(|choice| choice.name).collect();
            let help = nearest(text, all.iter().copied())
                .map(|near| format!("did you mean `{near}`?"))
                .or_else(|| suggest("valid names", text, &ready));
            report.add(Code::ValueUnknown, &node.origin, format!("unknown name `{text}`"), "no such name", help);
            None
        }
    }
}

fn refuse_choice(node: &Node, choice: &Choice, ready: &[&str], report: &mut Report) {
    let message = format!("`{}` is planned and not supported in this version", choice.name);
    let help = format!("supported now: {}", ready.join(", "));
    report.add(Code::ValueUnsupported, &node.origin, message, "arrives later", Some(help));
}

/// Code, message and help for a key that is unknown here and known in another place.
pub(crate) type Elsewhere = (Code, String, String);

/// Reports every key of `table` that is not in `keys`, that arrives later, or that is required and absent.
/// `place` names the table in messages ("a merge stage"), `missing_at` is where absent keys are pointed out.
pub(crate) fn check_keys(
    table: &Table,
    keys: &[Key],
    place: &str,
    missing_at: &super::Origin,
    elsewhere: &dyn Fn(&str) -> Option<Elsewhere>,
    report: &mut Report,
) {
    let mut meant: Vec<&str> = Vec::new();
    for entry in &table.entries {
        match keys.iter().find(|key| key.name == entry.name) {
            Some(key) if key.is_ready() => {}
            Some(key) => {
                let message = format!("`{}` is planned and not supported in this version", key.name);
                let help = format!("remove it; what it will do: {}", key.sentence);
                report.add(Code::KeyUnsupported, &entry.key, message, "arrives later", Some(help));
            }
            None => {
                let names: Vec<&str> = keys.iter().map(|key| key.name).collect();
                if let Some((code, message, help)) = elsewhere(&entry.name) {
                    report.add(code, &entry.key, message, "not a key of this table", Some(help));
                    continue;
                }
                let preposition = if place.starts_with("the top") { "at" } else { "in" };
                let message = format!("unknown key `{}` {preposition} {place}", entry.name);
                meant.extend(nearest(&entry.name, names.iter().copied()));
                let help = suggest("valid keys", &entry.name, &names);
                report.add(Code::KeyUnknown, &entry.key, message, "no such key", help);
            }
        }
    }
    for key in keys.iter().filter(|key| key.standard == Standard::Required) {
        // A key that was misspelt is not missing as well.
        if table.get(key.name).is_none() && !meant.contains(&key.name) {
            let message = format!("{place} needs the key `{}`", key.name);
            let help = Some(format!("`{}` takes {}: {}", key.name, key.shape.describe(), key.sentence));
            report.add(Code::KeyMissing, missing_at, message, format!("`{}` is missing", key.name), help);
        }
    }
}

impl Setting for String {
    fn shape() -> Shape {
        Shape::Text
    }

    fn read(node: &Node, report: &mut Report) -> Option<Self> {
        match &node.data {
            Data::Text(text) => Some(text.clone()),
            _ => {
                mistyped(node, "a string", None, report);
                None
            }
        }
    }

    fn write(&self) -> Value {
        Value::Text(self.clone())
    }
}

impl Setting for bool {
    fn shape() -> Shape {
        Shape::Boolean
    }

    fn read(node: &Node, report: &mut Report) -> Option<Self> {
        match node.data {
            Data::Boolean(value) => Some(value),
            _ => {
                mistyped(node, "true or false", None, report);
                None
            }
        }
    }

    fn write(&self) -> Value {
        Value::Boolean(*self)
    }
}

impl Setting for u32 {
    fn shape() -> Shape {
        Shape::Integer
    }

    fn read(node: &Node, report: &mut Report) -> Option<Self> {
        match node.data {
            Data::Integer(value) => {
                let value = value.and_then(|value| u32::try_from(value).ok());
                if value.is_none() {
                    let message = format!("a count must lie between 0 and {}", u32::MAX);
                    report.add(Code::ValueRange, &node.origin, message, "out of range", None);
                }
                value
            }
            Data::Float(value) if value.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&value) => {
                let help = format!("write {value:.0}");
                mistyped(node, "a whole number", Some(help), report);
                None
            }
            _ => {
                mistyped(node, "a whole number", None, report);
                None
            }
        }
    }

    fn write(&self) -> Value {
        Value::Integer(i64::from(*self))
    }
}

impl Setting for f64 {
    fn shape() -> Shape {
        Shape::Number
    }

    fn read(node: &Node, report: &mut Report) -> Option<Self> {
        match node.number() {
            Some(value) if value.is_finite() => Some(value + 0.0),
            Some(_) => {
                report.add(Code::ValueRange, &node.origin, "a number must be finite", "not finite", None);
                None
            }
            None => {
                mistyped(node, "a number", None, report);
                None
            }
        }
    }

    fn write(&self) -> Value {
        Value::Number(*self)
    }
}

impl Setting for Length {
    fn shape() -> Shape {
        Shape::Length
    }

    fn read(node: &Node, report: &mut Report) -> Option<Self> {
        let text = match &node.data {
            Data::Text(text) => text,
            Data::Integer(_) | Data::Float(_) => {
                // The number as it would be written, so that the fix can be copied.
                let value = node.number().filter(|value| value.is_finite()).map_or_else(|| String::from("1"), plain);
                let help =
                    format!("write \"{value} m\" for metres or \"{value} diag\" for a share of the model's diagonal");
                report.add(Code::ValueLength, &node.origin, "a length needs a unit", "a bare number", Some(help));
                return None;
            }
            _ => {
                mistyped(node, "a length", Some(String::from("for example \"0.1 mm\" or \"1e-5 diag\"")), report);
                return None;
            }
        };
        let units: Vec<&str> = Unit::ALL.iter().map(|unit| unit.as_str()).collect();
        let (message, label, help) = match Length::parse(text) {
            Ok(length) => return Some(length),
            Err(LengthError::Number) => (
                format!("\"{text}\" does not start with a number"),
                "not a length",
                Some(String::from("for example \"0.1 mm\" or \"1e-5 diag\"")),
            ),
            Err(LengthError::NoUnit) => {
                let number = text.trim();
                (
                    String::from("a length needs a unit"),
                    "no unit",
                    Some(format!(
                        "write \"{number} m\" for metres or \"{number} diag\" for a share of the model's diagonal"
                    )),
                )
            }
            Err(LengthError::Unit(unit)) => {
                (format!("unknown unit `{unit}`"), "no such unit", suggest("valid units", &unit, &units))
            }
            Err(LengthError::Range) => (String::from("a length must be finite and not negative"), "out of range", None),
        };
        report.add(Code::ValueLength, &node.origin, message, label, help);
        None
    }

    fn write(&self) -> Value {
        Value::Text(self.to_string())
    }
}

impl<T: Setting> Setting for Option<T> {
    fn shape() -> Shape {
        T::shape()
    }

    fn read(node: &Node, report: &mut Report) -> Option<Self> {
        T::read(node, report).map(Some)
    }

    fn write(&self) -> Value {
        self.as_ref().map_or(Value::Absent, Setting::write)
    }
}

impl<T: Setting> Setting for Vec<T> {
    fn shape() -> Shape {
        Shape::List(Box::new(T::shape()))
    }

    fn read(node: &Node, report: &mut Report) -> Option<Self> {
        let Some(items) = node.list() else {
            let shape = Self::shape();
            if let Data::Text(text) = &node.data
                && let Some(choice) = shape.choices().iter().find(|choice| !choice.ready && choice.name == text)
            {
                let ready: Vec<&str> = shape.choices().iter().filter(|c| c.ready).map(|c| c.name).collect();
                refuse_choice(node, choice, &ready, report);
                return None;
            }
            let help = match &node.data {
                Data::Text(text) => Some(format!("write [\"{text}\"]")),
                Data::Table(_) => Some(String::from("put the table into brackets: [ { ... } ]")),
                _ => None,
            };
            mistyped(node, &shape.describe(), help, report);
            return None;
        };
        if items.is_empty() {
            report.add(Code::ValueEmpty, &node.origin, "the list is empty", "nothing in it", None);
            return None;
        }
        let mut read = Vec::with_capacity(items.len());
        let mut whole = true;
        let mut seen: Vec<&str> = Vec::new();
        for item in items {
            match T::read(item, report) {
                Some(value) => read.push(value),
                None => whole = false,
            }
            if let Data::Text(text) = &item.data {
                if seen.contains(&text.as_str()) {
                    let message = format!("`{text}` is named twice");
                    report.add(Code::ValueRepeated, &item.origin, message, "again", None);
                    whole = false;
                }
                seen.push(text);
            }
        }
        whole.then_some(read)
    }

    fn write(&self) -> Value {
        Value::List(self.iter().map(Setting::write).collect())
    }
}
