//! The table of keys, for the docs and for help on the command line.

use super::options::{AssetOptions, Kind, OverrideOptions, StageOptions, kind_sentence};
use super::setting::{Choice, Key, Options, Shape, Standard, plain};

/// One group of keys with its title.
#[derive(Clone, Debug, PartialEq)]
pub struct Group {
    /// Where the keys stand: `[asset]`, `[[stage]]`, or a kind.
    pub title: String,
    /// What the table is for.
    pub sentence: &'static str,
    /// The keys in the order of the resolved form.
    pub keys: Vec<Key>,
}

/// Every key that a pipeline can have, group by group: what the parser itself goes by.
pub fn groups() -> Vec<Group> {
    let group = |title: &str, sentence, keys| Group { title: title.to_owned(), sentence, keys };
    let mut groups = vec![
        group("top of the file", "Version, parent and the tables below.", super::compose::file_keys()),
        group("[asset]", "What is built from what.", AssetOptions::keys()),
        group("[[stage]], every kind", "Name, kind and input of a stage.", StageOptions::keys()),
    ];
    for kind in Kind::ALL {
        groups.push(group(kind.as_str(), kind_sentence(kind).trim(), kind.keys()));
    }
    groups.push(group("[[override]]", "Other values for some of many assets.", OverrideOptions::keys()));
    groups
}

/// The reference as markdown: a section a group, a table row a key. Every name that a key takes is listed with it.
pub fn reference() -> String {
    let mut out = String::new();
    for group in groups() {
        out.push_str(&format!("## {}\n\n{}\n\n", group.title, group.sentence));
        out.push_str("| key | takes | default | meaning |\n| --- | --- | --- | --- |\n");
        for key in &group.keys {
            out.push_str(&format!(
                "| `{}` | {} | {} | {} |\n",
                key.name,
                takes(key),
                standard(key),
                cell(&meaning(key))
            ));
        }
        out.push('\n');
    }
    out.push_str(
        "Lengths are strings with a unit: um, mm, cm, m, km, or diag, a share of the diagonal of the asset's\n",
    );
    out.push_str("bounding box. glTF's unit is the metre.\n");
    out
}

/// The keys of one kind for a terminal, without markdown; `None` if there is no such kind.
pub fn help(kind: &str) -> Option<String> {
    let kind = Kind::from_name(kind)?;
    let keys = kind.keys();
    let width = keys.iter().map(|key| key.name.len()).max().unwrap_or(0);
    let mut out = format!("{}: {}\n", kind.as_str(), kind_sentence(kind).trim());
    for key in &keys {
        let standard = standard(key).replace('`', "");
        out.push_str(&format!(
            "  {:width$}  {} ({}; {standard})\n",
            key.name,
            meaning(key),
            takes(key).replace('`', "")
        ));
    }
    Some(out)
}

fn meaning(key: &Key) -> String {
    key.sentence.trim().to_owned()
}

fn takes(key: &Key) -> String {
    if !key.is_ready() {
        return String::from("-");
    }
    let choices = key.shape.choices();
    if !choices.is_empty() {
        let names: Vec<String> = choices.iter().map(choice).collect();
        let start = if matches!(key.shape, Shape::List(_)) { "list of " } else { "" };
        return format!("{start}{}", names.join(", "));
    }
    let mut text = key.shape.describe();
    if let Some((least, most)) = key.range {
        text.push_str(&format!(", {} to {}", plain(least), plain(most)));
    }
    cell(&text)
}

fn choice(choice: &Choice) -> String {
    if choice.ready { format!("`{}`", choice.name) } else { format!("`{}` (later)", choice.name) }
}

fn standard(key: &Key) -> String {
    match &key.standard {
        Standard::Value(value) => format!("`{}`", value.to_toml()),
        Standard::Required => String::from("required"),
        Standard::Derived("") => String::from("-"),
        Standard::Derived(from) => (*from).to_owned(),
        Standard::Later => String::from("not in this version"),
    }
}

fn cell(text: &str) -> String {
    text.replace('|', "\\|")
}
