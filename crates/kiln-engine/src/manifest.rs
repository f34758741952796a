//! What a fingerprint covers: one ordered list of fields, hashed and explained by the same walk.
//!
//! A manifest never holds times, absolute paths or thread counts. An input's *name* and *content* count, the place it came
//! from does not: a renamed but equal file, or a moved project folder, leaves the fingerprint as it is.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::hash::{ContentHash, Fingerprint};
use crate::reason::StaleReason;

/// Names this layout of the hashed bytes; raise it when the walk below changes.
const DOMAIN: &[u8] = b"kiln action manifest 1";

/// A parameter's value. Floats count by their bits, so that `0.0` and `-0.0` differ and no rounding hides a change.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Value {
    /// A string, or any value that the caller wrote canonically.
    Text(String),
    /// A whole number.
    Integer(i64),
    /// A yes or no.
    Flag(bool),
    /// An `f64`, by bits.
    Double(u64),
    /// An `f32`, by bits.
    Single(u32),
    /// A digest.
    Hash(ContentHash),
}

impl Value {
    /// Appends a form that no other value shares.
    fn hash_into(&self, hasher: &mut blake3::Hasher) {
        match self {
            Value::Text(text) => {
                hasher.update(&[0]);
                hash_text(hasher, text);
            }
            Value::Integer(number) => {
                hasher.update(&[1]).update(&number.to_le_bytes());
            }
            Value::Flag(flag) => {
                hasher.update(&[2, *flag as u8]);
            }
            Value::Double(bits) => {
                hasher.update(&[3]).update(&bits.to_le_bytes());
            }
            Value::Single(bits) => {
                hasher.update(&[4]).update(&bits.to_le_bytes());
            }
            Value::Hash(hash) => {
                hasher.update(&[5]).update(&hash.0);
            }
        }
    }
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Value::Text(text) => f.write_str(text),
            Value::Integer(number) => write!(f, "{number}"),
            Value::Flag(flag) => write!(f, "{flag}"),
            Value::Double(bits) => write!(f, "{}", f64::from_bits(*bits)),
            Value::Single(bits) => write!(f, "{}", f32::from_bits(*bits)),
            Value::Hash(hash) => write!(f, "{}", hash.short()),
        }
    }
}

macro_rules! value_from {
    ($($type:ty => $make:expr),* $(,)?) => {
        $(impl From<$type> for Value {
            fn from(value: $type) -> Value {
                #[allow(clippy::redundant_closure_call, reason = "one table for all types")]
                ($make)(value)
            }
        })*
    };
}

value_from! {
    &str => |v: &str| Value::Text(v.to_owned()),
    String => Value::Text,
    bool => Value::Flag,
    u8 => |v| Value::Integer(i64::from(v)),
    u16 => |v| Value::Integer(i64::from(v)),
    u32 => |v| Value::Integer(i64::from(v)),
    i32 => |v| Value::Integer(i64::from(v)),
    i64 => Value::Integer,
    u64 => |v: u64| i64::try_from(v).map_or_else(|_| Value::Text(v.to_string()), Value::Integer),
    usize => |v: usize| Value::from(v as u64),
    f32 => |v: f32| Value::Single(v.to_bits()),
    f64 => |v: f64| Value::Double(v.to_bits()),
    ContentHash => Value::Hash,
}

/// What a field is about. The order is the order in which causes are named: a raised stage version before a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Topic {
    /// The kind of stage, and whether it finds files.
    Kind,
    /// Its semantic version.
    Version,
    /// A foreign crate or library; the name is what stands before `@`.
    Foreign,
    /// Where results are bit-identical.
    NumericClass,
    /// GPU, driver and shaders.
    DeviceClass,
    /// A parameter.
    Parameter,
}

/// One value that is no input.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Field {
    /// What it is about.
    pub topic: Topic,
    /// Its name within the topic; empty where there is only one.
    pub name: String,
    /// Its value.
    pub value: Value,
}

/// Where an input came from: for people, never hashed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Origin {
    /// A file that the plan names, relative to the plan's root.
    File {
        /// The path.
        path: String,
    },
    /// A file that the action found while it ran, relative to the action's folder.
    Discovered {
        /// The path.
        path: String,
    },
    /// An output of an action before it.
    Upstream {
        /// The action's id.
        action: String,
        /// The output's name.
        output: String,
    },
    /// Bytes in the plan.
    Bytes,
}

/// One input: its name and content count, its origin does not.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct InputField {
    /// The action's name for it; for a discovered file its relative path.
    pub name: String,
    /// Its content; `None` for a file that was looked for and is absent.
    pub hash: Option<ContentHash>,
    /// Where it came from.
    pub origin: Origin,
}

/// Everything that an action's outputs depend on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Manifest {
    /// Sorted by topic and name; shared, since many actions differ in their inputs only.
    pub(crate) head: Arc<[Field]>,
    /// Sorted by name, declared ones before discovered ones.
    pub(crate) inputs: Vec<InputField>,
}

/// One step of the walk: the key of a field and its value.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Key<'a> {
    Head(Topic, &'a str),
    Declared(&'a str),
    Discovered(&'a str),
}

#[derive(Clone, Copy)]
enum Entry<'a> {
    Head(&'a Field),
    Input(&'a InputField),
}

impl Entry<'_> {
    fn same_value(&self, other: &Entry<'_>) -> bool {
        match (self, other) {
            (Entry::Head(a), Entry::Head(b)) => a.value == b.value,
            (Entry::Input(a), Entry::Input(b)) => a.hash == b.hash,
            _ => false,
        }
    }
}

impl Manifest {
    /// A manifest of the given fields, in canonical order.
    pub fn new(mut head: Vec<Field>, inputs: Vec<InputField>) -> Manifest {
        head.sort_by(|a, b| (a.topic, &a.name).cmp(&(b.topic, &b.name)));
        Manifest::of_parts(head.into(), inputs)
    }

    /// A manifest of a head that is in order.
    pub(crate) fn of_parts(head: Arc<[Field]>, mut inputs: Vec<InputField>) -> Manifest {
        inputs.sort_by(|a, b| input_key(a).cmp(&input_key(b)));
        Manifest { head, inputs }
    }

    /// The manifest with discovered files `files` (path relative to the action's folder, content) in place of its own.
    pub fn with_discovered(&self, files: &[(String, Option<ContentHash>)]) -> Manifest {
        let declared = self.inputs.iter().filter(|input| !matches!(input.origin, Origin::Discovered { .. }));
        let found = files.iter().map(|(path, hash)| InputField {
            name: path.clone(),
            hash: *hash,
            origin: Origin::Discovered { path: path.clone() },
        });
        Manifest::of_parts(self.head.clone(), declared.cloned().chain(found).collect())
    }

    /// The discovered files' paths, relative to the action's folder.
    pub fn discovered(&self) -> impl Iterator<Item = &str> {
        self.inputs.iter().filter_map(|input| match &input.origin {
            Origin::Discovered { path } => Some(path.as_str()),
            _ => None,
        })
    }

    /// The one walk over all fields: what it visits is what is hashed, and what is explained.
    fn walk<'a>(&'a self, mut visit: impl FnMut(Key<'a>, Entry<'a>)) {
        for field in self.head.iter() {
            visit(Key::Head(field.topic, &field.name), Entry::Head(field));
        }
        for input in &self.inputs {
            visit(input_key(input), Entry::Input(input));
        }
    }

    /// The digest of all fields.
    pub fn fingerprint(&self) -> Fingerprint {
        let mut hasher = blake3::Hasher::new();
        hasher.update(DOMAIN);
        self.walk(|key, entry| {
            let (tag, name) = match key {
                Key::Head(topic, name) => (topic as u8, name),
                Key::Declared(name) => (0x80, name),
                Key::Discovered(name) => (0x81, name),
            };
            hasher.update(&[tag]);
            hash_text(&mut hasher, name);
            match entry {
                Entry::Head(field) => field.value.hash_into(&mut hasher),
                Entry::Input(input) => {
                    hasher.update(&[input.hash.is_some() as u8]);
                    hasher.update(&input.hash.map_or([0; 32], |hash| hash.0));
                }
            }
        });
        Fingerprint(*hasher.finalize().as_bytes())
    }

    /// The first field in which `self` (now) differs from `old` (the last build), or `None` where both fingerprints are equal.
    pub fn first_difference(&self, old: &Manifest) -> Option<StaleReason> {
        let mut before = BTreeMap::new();
        old.walk(|key, entry| {
            before.insert(key, entry);
        });
        let mut changed: BTreeMap<Key<'_>, (Option<Entry<'_>>, Option<Entry<'_>>)> = BTreeMap::new();
        self.walk(|key, entry| match before.remove(&key) {
            Some(last) if last.same_value(&entry) => {}
            last => {
                changed.insert(key, (last, Some(entry)));
            }
        });
        changed.extend(before.into_iter().map(|(key, entry)| (key, (Some(entry), None))));
        changed.into_iter().next().map(|(key, (old, new))| explain(key, old, new))
    }
}

fn input_key(input: &InputField) -> Key<'_> {
    match input.origin {
        Origin::Discovered { .. } => Key::Discovered(&input.name),
        _ => Key::Declared(&input.name),
    }
}

/// The reason that belongs to one differing field.
fn explain(key: Key<'_>, old: Option<Entry<'_>>, new: Option<Entry<'_>>) -> StaleReason {
    match key {
        Key::Head(topic, name) => {
            let shown = |entry: Option<Entry<'_>>| match entry {
                Some(Entry::Head(field)) => Some(field.value.to_string()),
                _ => None,
            };
            let (old, new) = (shown(old), shown(new));
            let version = |value: &Option<String>| value.as_deref().and_then(|text| text.parse().ok()).unwrap_or(0);
            match topic {
                Topic::Version => StaleReason::StageVersionChanged { old: version(&old), new: version(&new) },
                Topic::Foreign => StaleReason::ForeignVersionChanged { old, new },
                Topic::NumericClass => StaleReason::NumericClassChanged { old, new },
                Topic::DeviceClass => StaleReason::DeviceClassChanged { old, new },
                Topic::Kind if name.is_empty() => {
                    StaleReason::StageKindChanged { old: old.unwrap_or_default(), new: new.unwrap_or_default() }
                }
                Topic::Kind | Topic::Parameter => StaleReason::ParameterChanged { name: name.to_owned(), old, new },
            }
        }
        Key::Declared(_) | Key::Discovered(_) => {
            let input = |entry: Option<Entry<'_>>| match entry {
                Some(Entry::Input(input)) => Some((input.origin.clone(), input.hash)),
                _ => None,
            };
            explain_input(key, input(old), input(new))
        }
    }
}

type InputSide = Option<(Origin, Option<ContentHash>)>;

fn explain_input(key: Key<'_>, old: InputSide, new: InputSide) -> StaleReason {
    let (Key::Declared(name) | Key::Discovered(name) | Key::Head(_, name)) = key;
    let hash = |side: &InputSide| side.as_ref().and_then(|(_, hash)| *hash);
    let (before, now) = (hash(&old), hash(&new));
    match new.or(old).map(|(origin, _)| origin) {
        Some(Origin::File { path } | Origin::Discovered { path }) => match (before, now) {
            (Some(old), Some(new)) => StaleReason::InputFileChanged { path, old, new },
            (Some(_), None) => StaleReason::InputFileMissing { path },
            _ => StaleReason::InputFileAdded { path },
        },
        Some(Origin::Upstream { action, .. }) => {
            StaleReason::UpstreamOutputChanged { input: name.to_owned(), action, old: before, new: now }
        }
        _ => {
            let shown = |hash: Option<ContentHash>| hash.map(|hash| hash.short());
            StaleReason::ParameterChanged { name: name.to_owned(), old: shown(before), new: shown(now) }
        }
    }
}

fn hash_text(hasher: &mut blake3::Hasher, text: &str) {
    hasher.update(&(text.len() as u64).to_le_bytes()).update(text.as_bytes());
}
