//! A view on parsed JSON that knows its own path, so that every defect can say where it lies.
//!
//! Getters return `None` for an absent property and for one of the wrong type; the wrong type is a defect. Code that needs a
//! value calls the getter's `need_` sister, for which absence is a defect too.

use serde_json::{Map, Value};

use super::error::Defects;

/// A JSON object and its path from the document's root (empty for the root).
#[derive(Clone)]
pub(super) struct Object<'a> {
    map: &'a Map<String, Value>,
    pub(super) path: String,
}

impl<'a> Object<'a> {
    pub(super) fn root(value: &'a Value, defects: &mut Defects) -> Option<Object<'a>> {
        Object::at(value, String::new(), defects)
    }

    fn at(value: &'a Value, path: String, defects: &mut Defects) -> Option<Object<'a>> {
        match value {
            Value::Object(map) => Some(Object { map, path }),
            other => {
                wrong_type(path, "an object", other, defects);
                None
            }
        }
    }

    /// The path of a property.
    pub(super) fn path_of(&self, key: &str) -> String {
        if self.path.is_empty() { key.to_owned() } else { format!("{}.{key}", self.path) }
    }

    pub(super) fn has(&self, key: &str) -> bool {
        self.map.contains_key(key)
    }

    /// Names of all properties, in the order in which the parser keeps them.
    pub(super) fn keys(&self) -> impl Iterator<Item = &'a str> + use<'a> {
        self.map.keys().map(String::as_str)
    }

    fn missing<T>(&self, key: &str, value: Option<T>, defects: &mut Defects) -> Option<T> {
        if value.is_none() && !self.has(key) {
            defects.invalid(self.path_of(key), "is missing");
        }
        value
    }

    pub(super) fn object(&self, key: &str, defects: &mut Defects) -> Option<Object<'a>> {
        Object::at(self.map.get(key)?, self.path_of(key), defects)
    }

    pub(super) fn need_object(&self, key: &str, defects: &mut Defects) -> Option<Object<'a>> {
        self.missing(key, self.object(key, defects), defects)
    }

    fn list(&self, key: &str, defects: &mut Defects) -> Option<&'a [Value]> {
        match self.map.get(key)? {
            Value::Array(list) => Some(list),
            other => {
                wrong_type(self.path_of(key), "an array", other, defects);
                None
            }
        }
    }

    /// The objects of an array; `None` entries are defects already noted, kept so that positions stay true.
    pub(super) fn objects(&self, key: &str, defects: &mut Defects) -> Vec<Option<Object<'a>>> {
        let list = self.list(key, defects).unwrap_or_default();
        let path = self.path_of(key);
        list.iter().enumerate().map(|(i, v)| Object::at(v, format!("{path}[{i}]"), defects)).collect()
    }

    pub(super) fn count(&self, key: &str) -> usize {
        self.map.get(key).and_then(Value::as_array).map_or(0, Vec::len)
    }

    pub(super) fn string(&self, key: &str, defects: &mut Defects) -> Option<&'a str> {
        match self.map.get(key)? {
            Value::String(text) => Some(text),
            other => {
                wrong_type(self.path_of(key), "a string", other, defects);
                None
            }
        }
    }

    /// A string that an application keeps in `extras`, where anything may stand.
    pub(super) fn extra(&self, key: &str) -> Option<&'a str> {
        self.map.get("extras")?.get(key)?.as_str()
    }

    pub(super) fn strings(&self, key: &str, defects: &mut Defects) -> Vec<(String, &'a str)> {
        let path = self.path_of(key);
        let mut out = Vec::new();
        for (i, value) in self.list(key, defects).unwrap_or_default().iter().enumerate() {
            match value {
                Value::String(text) => out.push((format!("{path}[{i}]"), text.as_str())),
                other => wrong_type(format!("{path}[{i}]"), "a string", other, defects),
            }
        }
        out
    }

    pub(super) fn boolean(&self, key: &str, defects: &mut Defects) -> Option<bool> {
        match self.map.get(key)? {
            Value::Bool(value) => Some(*value),
            other => {
                wrong_type(self.path_of(key), "true or false", other, defects);
                None
            }
        }
    }

    /// An unsigned integer. `3.0` is one, as JSON has it.
    pub(super) fn unsigned(&self, key: &str, defects: &mut Defects) -> Option<u64> {
        let value = self.map.get(key)?;
        let integer = as_unsigned(value);
        if integer.is_none() {
            wrong_type(self.path_of(key), "an unsigned integer", value, defects);
        }
        integer
    }

    pub(super) fn need_unsigned(&self, key: &str, defects: &mut Defects) -> Option<u64> {
        self.missing(key, self.unsigned(key, defects), defects)
    }

    /// A finite number that a `f32` can hold.
    pub(super) fn float(&self, key: &str, defects: &mut Defects) -> Option<f32> {
        let value = self.map.get(key)?;
        let float = as_f64(value).map(|v| v as f32).filter(|v| v.is_finite());
        if float.is_none() {
            wrong_type(self.path_of(key), "a 32-bit number", value, defects);
        }
        float
    }

    /// `N` finite numbers.
    pub(super) fn floats<const N: usize>(&self, key: &str, defects: &mut Defects) -> Option<[f64; N]> {
        let list = self.list(key, defects)?;
        if list.len() != N {
            defects.invalid(self.path_of(key), format!("expected {N} numbers, found {}", list.len()));
            return None;
        }
        let mut out = [0.0; N];
        for (i, value) in list.iter().enumerate() {
            match as_f64(value) {
                Some(v) => out[i] = v,
                None => {
                    wrong_type(format!("{}[{i}]", self.path_of(key)), "a number", value, defects);
                    return None;
                }
            }
        }
        Some(out)
    }

    /// A reference into a list of `count` entries named `what`.
    pub(super) fn index(&self, key: &str, what: &str, count: usize, defects: &mut Defects) -> Option<usize> {
        let value = self.unsigned(key, defects)?;
        in_range(value, &self.path_of(key), what, count, defects)
    }

    pub(super) fn need_index(&self, key: &str, what: &str, count: usize, defects: &mut Defects) -> Option<usize> {
        self.missing(key, self.index(key, what, count, defects), defects)
    }

    /// References into a list of `count` entries named `what`, each with its place in the array.
    pub(super) fn indices(&self, key: &str, what: &str, count: usize, defects: &mut Defects) -> Vec<(usize, usize)> {
        let path = self.path_of(key);
        let mut out = Vec::new();
        for (i, value) in self.list(key, defects).unwrap_or_default().iter().enumerate() {
            let path = format!("{path}[{i}]");
            match as_unsigned(value) {
                Some(v) => out.extend(in_range(v, &path, what, count, defects).map(|v| (i, v))),
                None => wrong_type(path, "an unsigned integer", value, defects),
            }
        }
        out
    }
}

fn in_range(value: u64, path: &str, what: &str, count: usize, defects: &mut Defects) -> Option<usize> {
    match usize::try_from(value) {
        Ok(index) if index < count => Some(index),
        _ => {
            defects.invalid(path, format!("refers to {what}[{value}], but there are {count}"));
            None
        }
    }
}

fn as_f64(value: &Value) -> Option<f64> {
    value.as_f64().filter(|v| v.is_finite())
}

fn as_unsigned(value: &Value) -> Option<u64> {
    /// Integers up to here are exact in a double.
    const EXACT: f64 = 9_007_199_254_740_992.0;
    value.as_u64().or_else(|| {
        let float = value.as_f64()?;
        (float.fract() == 0.0 && (0.0..=EXACT).contains(&float)).then_some(float as u64)
    })
}

fn wrong_type(path: String, expected: &str, found: &Value, defects: &mut Defects) {
    let found = match found {
        Value::Null => "null".to_owned(),
        Value::Bool(b) => b.to_string(),
        Value::Number(n) => n.to_string(),
        Value::String(_) => "a string".to_owned(),
        Value::Array(_) => "an array".to_owned(),
        Value::Object(_) => "an object".to_owned(),
    };
    let path = if path.is_empty() { "document".to_owned() } else { path };
    defects.invalid(path, format!("expected {expected}, found {found}"));
}
