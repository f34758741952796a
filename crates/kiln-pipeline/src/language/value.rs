//! Plain values and their canonical text, for `--dry-run` and for the pipeline's hash.

/// A value as it is written out: defaults filled, no spans, no comments.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// Not set and without a default: left out.
    Absent,
    /// A string.
    Text(String),
    /// A whole number.
    Integer(i64),
    /// A finite number.
    Number(f64),
    /// True or false.
    Boolean(bool),
    /// Values in order.
    List(Vec<Value>),
    /// Named values in the order of the language's table.
    Table(Vec<(String, Value)>),
}

/// A number's shortest text that reads back to the same double, always with a point or an exponent.
pub(crate) fn number(value: f64) -> String {
    let magnitude = value.abs();
    if magnitude != 0.0 && !(1e-4..1e15).contains(&magnitude) { format!("{value:e}") } else { format!("{value:?}") }
}

fn quoted(text: &str, out: &mut String) {
    out.push('"');
    for c in text.chars() {
        match c {
            '"' => out.push_str("\\\""),
            '\\' => out.push_str("\\\\"),
            '\n' => out.push_str("\\n"),
            '\r' => out.push_str("\\r"),
            '\t' => out.push_str("\\t"),
            c if c.is_control() => out.push_str(&format!("\\u{:04x}", u32::from(c))),
            c => out.push(c),
        }
    }
    out.push('"');
}

fn key(name: &str, out: &mut String) {
    let bare = !name.is_empty() && name.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'-' || b == b'_');
    if bare { out.push_str(name) } else { quoted(name, out) }
}

impl Value {
    /// True for [`Value::Absent`].
    pub fn is_absent(&self) -> bool {
        *self == Value::Absent
    }

    /// As a TOML value on one line (an empty text if absent).
    pub fn to_toml(&self) -> String {
        let mut out = String::new();
        self.inline(&mut out);
        out
    }

    fn inline(&self, out: &mut String) {
        match self {
            Value::Absent => {}
            Value::Text(text) => quoted(text, out),
            Value::Integer(value) => out.push_str(&value.to_string()),
            Value::Number(value) => out.push_str(&number(*value)),
            Value::Boolean(value) => out.push_str(if *value { "true" } else { "false" }),
            Value::List(items) => {
                out.push('[');
                for (index, item) in items.iter().enumerate() {
                    out.push_str(if index == 0 { "" } else { ", " });
                    item.inline(out);
                }
                out.push(']');
            }
            Value::Table(entries) => {
                out.push('{');
                let present = entries.iter().filter(|(_, value)| !value.is_absent());
                for (index, (name, value)) in present.enumerate() {
                    out.push_str(if index == 0 { " " } else { ", " });
                    key(name, out);
                    out.push_str(" = ");
                    value.inline(out);
                }
                out.push_str(" }");
            }
        }
    }

    /// As compact JSON; absent values are left out of tables.
    pub fn to_json(&self) -> String {
        let mut out = String::new();
        self.json(&mut out);
        out
    }

    fn json(&self, out: &mut String) {
        match self {
            Value::Absent => out.push_str("null"),
            Value::Text(text) => quoted(text, out),
            Value::Integer(value) => out.push_str(&value.to_string()),
            Value::Number(value) => out.push_str(&number(*value)),
            Value::Boolean(value) => out.push_str(if *value { "true" } else { "false" }),
            Value::List(items) => {
                out.push('[');
                for (index, item) in items.iter().enumerate() {
                    out.push_str(if index == 0 { "" } else { "," });
                    item.json(out);
                }
                out.push(']');
            }
            Value::Table(entries) => {
                out.push('{');
                let present = entries.iter().filter(|(_, value)| !value.is_absent());
                for (index, (name, value)) in present.enumerate() {
                    out.push_str(if index == 0 { "" } else { "," });
                    quoted(name, out);
                    out.push(':');
                    value.json(out);
                }
                out.push('}');
            }
        }
    }
}

/// A table's lines `key = value`, one an entry that is present.
pub(crate) fn toml_lines(entries: &[(String, Value)], out: &mut String) {
    for (name, value) in entries.iter().filter(|(_, value)| !value.is_absent()) {
        key(name, out);
        out.push_str(" = ");
        value.inline(out);
        out.push('\n');
    }
}
