//! The key `metric`: a name, or a table of the name and its parameters.

use super::diagnostic::{Code, Report};
use super::dom::{Data, Node};
use super::options::{Metric, key_of};
use super::setting::{FromTable, Options, Setting, Shape, check_keys, choices, mistyped, options};
use super::value::Value;

choices! {
    /// A solid at whose vertices views stand.
    pub enum Solid {
        /// 12 views.
        "icosahedron" => Icosahedron,
        /// 20 views.
        "dodecahedron" => Dodecahedron,
    }
}

choices! {
    /// Which costs are found again after a collapse.
    pub enum ViewUpdate {
        /// All that may have changed.
        "exact" => Exact,
        /// Those around the kept point, as published: faster, and wrong where faces hide each other.
        "published" => Published,
    }
}

/// Where views stand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ViewSet {
    /// At the vertices of a solid.
    Solid(Solid),
    /// So many, spread evenly.
    Count(u32),
}

impl ViewSet {
    /// Number of views.
    pub fn count(self) -> u32 {
        match self {
            ViewSet::Solid(Solid::Icosahedron) => 12,
            ViewSet::Solid(Solid::Dodecahedron) => 20,
            ViewSet::Count(count) => count,
        }
    }
}

options! {
    /// Parameters of the metrics that look at the model from views.
    pub struct ViewMetric {
        /// Order of the generalised entropy or mutual information; 1 is Shannon's.
        "alpha" => alpha: f64, default(1.0), within 0.05..=16.0;
        /// Where the views stand: a solid around the model, or how many spread evenly.
        "views" => views: ViewSet, default(ViewSet::Solid(Solid::Dodecahedron));
        /// Width and height in pixels of what a view sees.
        "size" => size: u32, default(256), within 16..=1024;
        /// Which costs are found again after a collapse.
        "update" => update: ViewUpdate, default(ViewUpdate::Exact);
        /// Share of the incoming triangles to which quadrics bring the mesh before the views are asked.
        "prepass" => prepass: Option<f64>, derived("no pre-pass"), within 0.0001..=1;
        /// Texels over which a picture is smoothed before it falls into regions.
        "sigma" => sigma: f64, default(0.8), within 0..=16;
        /// How large regions grow: codes times texels.
        "k" => k: f64, default(300.0), within 0..=1_000_000;
        /// Fewest texels of a region.
        "min-size" => min_size: u32, default(50), within 1..=1_000_000;
        /// Texels of its own that a region has on all sides of one of them; what is thinner goes to its neighbours.
        "reach" => reach: u32, default(2), within 0..=64;
        /// Longest side in texels of a picture when it falls into regions; larger ones are halved first.
        "side" => side: u32, default(512), within 16..=4096;
    }
}

/// Parameters that only metrics of texture regions have.
const REGION_KEYS: [&str; 5] = ["sigma", "k", "min-size", "reach", "side"];

/// Most pixels of all views together: some gigabytes of fragments.
const MOST_PIXELS: u64 = 1 << 26;

/// A metric, written as its name or as a table `{ kind = NAME, ... }` with its parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct MetricChoice {
    /// Which.
    pub metric: Metric,
    /// Its parameters, if it looks at the model from views.
    pub views: Option<ViewMetric>,
}

impl Metric {
    /// Whether it looks at the model from views.
    pub fn has_views(self) -> bool {
        self.sees_regions() || matches!(self, Metric::ViewpointEntropy | Metric::ViewpointMutualInformation)
    }

    /// Whether it sees the regions of textures.
    pub fn sees_regions(self) -> bool {
        matches!(self, Metric::RegionEntropy | Metric::RegionMutualInformation)
    }
}

impl From<Metric> for MetricChoice {
    fn from(metric: Metric) -> MetricChoice {
        MetricChoice { metric, views: metric.has_views().then(ViewMetric::default) }
    }
}

impl Setting for MetricChoice {
    fn shape() -> Shape {
        Shape::ChoiceOrTable(Metric::CHOICES)
    }

    fn read(node: &Node, report: &mut Report) -> Option<Self> {
        let Some(table) = node.table() else { return Metric::read(node, report).map(MetricChoice::from) };
        let Some(kind) = table.get("kind") else {
            let help = Some(String::from("for example { kind = \"quadric\" }"));
            report.add(Code::KeyMissing, &node.origin, "a metric needs the key `kind`", "`kind` is missing", help);
            return None;
        };
        let metric = Metric::read(kind, report)?;
        let name = metric.as_str();
        if !metric.has_views() {
            for entry in table.entries.iter().filter(|entry| entry.name != "kind") {
                let message = format!("the metric `{name}` has no parameter `{}`", entry.name);
                report.add(Code::KeyUnknown, &entry.key, message, "no such key", None);
            }
            return Some(MetricChoice::from(metric));
        }
        let blind = |key: &str| !metric.sees_regions() && REGION_KEYS.contains(&key);
        let mut keys = vec![key_of("kind", Metric::shape())];
        keys.extend(ViewMetric::keys().into_iter().filter(|key| !blind(key.name)));
        let elsewhere = |key: &str| {
            let message = format!("the metric `{name}` has no parameter `{key}`");
            let help = "each face is a region here; `region-entropy` and `region-mutual-information` see textures";
            blind(key).then(|| (Code::KeyUnknown, message, String::from(help)))
        };
        check_keys(table, &keys, &format!("the metric `{name}`"), &node.origin, &elsewhere, report);
        let views = ViewMetric::from_table(table, report);
        let pixels = u64::from(views.views.count()) * u64::from(views.size) * u64::from(views.size);
        if pixels > MOST_PIXELS {
            let message =
                format!("{} views of {} x {} pixels are too many", views.views.count(), views.size, views.size);
            let help = format!("all views together may have {} million pixels", MOST_PIXELS >> 20);
            report.add(Code::ValueRange, &node.origin, message, format!("{} million", pixels >> 20), Some(help));
            return None;
        }
        Some(MetricChoice { metric, views: Some(views) })
    }

    fn write(&self) -> Value {
        let Some(views) = &self.views else { return self.metric.write() };
        let mut entries = vec![(String::from("kind"), self.metric.write())];
        let reads = |name: &str| self.metric.sees_regions() || !REGION_KEYS.contains(&name);
        entries.extend(views.values().into_iter().filter(|(name, _)| reads(name)));
        Value::Table(entries)
    }
}

impl Setting for ViewSet {
    fn shape() -> Shape {
        Solid::shape()
    }

    fn read(node: &Node, report: &mut Report) -> Option<Self> {
        match node.data {
            Data::Text(_) => Solid::read(node, report).map(ViewSet::Solid),
            Data::Integer(Some(count)) if (2..=256).contains(&count) => Some(ViewSet::Count(count as u32)),
            Data::Integer(_) => {
                report.add(Code::ValueRange, &node.origin, "`views` must lie between 2 and 256", "out of range", None);
                None
            }
            _ => {
                let help = Some(String::from("for example \"dodecahedron\" or 24"));
                mistyped(node, "a solid's name or a number of views", help, report);
                None
            }
        }
    }

    fn write(&self) -> Value {
        match self {
            ViewSet::Solid(solid) => solid.write(),
            ViewSet::Count(count) => count.write(),
        }
    }
}
