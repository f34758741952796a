//! The key `density` of an atlas: a list of tables of a glob and a factor.

use super::diagnostic::{Code, Report};
use super::dom::{Data, Node};
use super::setting::{FromTable, Options, Setting, Shape, check_keys, mistyped, options};
use super::value::Value;

options! {
    /// How dense the texels of some submeshes are.
    pub struct DensityRule {
        /// Glob over names of submeshes: `*` any run of characters, `?` one.
        "name" => name: String, required;
        /// How many times the texels per length of factor 1 they get.
        "factor" => factor: f64, required, within 0.0625..=16.0;
    }
}

impl Setting for DensityRule {
    fn shape() -> Shape {
        Shape::Table("name and factor")
    }

    fn read(node: &Node, report: &mut Report) -> Option<Self> {
        let Some(table) = node.table() else {
            let help = Some(String::from("for example { name = \"head*\", factor = 2.0 }"));
            mistyped(node, "a table with name and factor", help, report);
            return None;
        };
        let before = report.len();
        check_keys(table, &DensityRule::keys(), "a density rule", &node.origin, &|_| None, report);
        let rule = DensityRule::from_table(table, report);
        if let Some(name) = table.get("name").filter(|name| matches!(&name.data, Data::Text(text) if text.is_empty())) {
            report.add(Code::ValueEmpty, &name.origin, "a submesh's name is never empty", "empty", None);
        }
        (report.len() == before).then_some(rule)
    }

    fn write(&self) -> Value {
        Value::Table(self.values())
    }
}

/// The rules in order: of several that match a submesh the last one holds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DensityRules(pub Vec<DensityRule>);

impl Setting for DensityRules {
    fn shape() -> Shape {
        Vec::<DensityRule>::shape()
    }

    fn read(node: &Node, report: &mut Report) -> Option<Self> {
        Vec::<DensityRule>::read(node, report).map(DensityRules)
    }

    fn write(&self) -> Value {
        self.0.write()
    }
}
