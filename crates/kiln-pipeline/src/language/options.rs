//! Every key of the language: one struct a table, defaults and sentences included.
//!
//! The parser, the reference, `--set`, overrides and the resolved form all come from here.

pub use super::density::{DensityRule, DensityRules};
use super::diagnostic::{Code, Report};
use super::dom::{Data, Node};
use super::length::Length;
pub use super::metric::{MetricChoice, Solid, ViewMetric, ViewSet, ViewUpdate};
use super::setting::{
    Choice, FromTable, Key, Options, Setting, Shape, check_keys, choices, choose, mistyped, options, read_within,
};
use super::value::Value;

choices! {
    /// Kind of a stage.
    pub enum Kind {
        /// Joins the submeshes of the asset into one mesh with shared points at their boundaries.
        "merge" => Merge,
        /// Collapses edges and cuts levels of detail out of one collapse sequence.
        "simplify" => Simplify,
        /// Makes a second UV layout without overlaps, for a bake to write into.
        "atlas" => Atlas,
        /// Carries the surface of a high mesh into textures of the atlas.
        "bake" => Bake,
        /// Writes levels, materials and textures into one container.
        "pack" => Pack,
    }
}

choices! {
    /// A repair that merge makes where it is asked for.
    pub enum MergeRepair {
        /// Drops faces that their submesh has already, same points in the same winding.
        "duplicate-faces" => DuplicateFaces,
        /// Rebuilds normals without direction from their faces.
        "zero-normals" => ZeroNormals,
        /// Turns over faces that are wound against their neighbours, and closed parts that are wound inwards.
        "winding" => Winding,
    }
}

choices! {
    /// What an edge costs.
    pub enum Metric {
        /// Area-weighted plane quadrics with border, seam and boundary constraints, and the slide of attributes.
        "quadric" => Quadric,
        /// Volume, border and shape of the mesh as it is (Lindstrom and Turk): least error of all, at half the speed; free
        /// placement only.
        "memoryless" => Memoryless,
        /// Viewpoint entropy, each face its own region.
        "viewpoint-entropy" => ViewpointEntropy,
        /// Viewpoint mutual information, each face its own region.
        "viewpoint-mutual-information" => ViewpointMutualInformation,
        /// Generalised entropy of texture regions over viewpoints.
        "region-entropy" => RegionEntropy,
        /// Generalised mutual information of texture regions over viewpoints.
        "region-mutual-information" => RegionMutualInformation,
    }
}

choices! {
    /// Where the kept point of a collapse stands.
    pub enum Placement {
        /// On the end that stays: no new positions, so levels can share one vertex buffer.
        "half-edge" => HalfEdge,
        /// Where the level lies nearest to its source; attributes follow. Four tenths less error, vertices of its own for
        /// every level.
        "free" => Free,
    }
}

choices! {
    /// When submesh boundaries may change.
    pub enum BoundaryRule {
        /// Their points go along them whenever that is cheapest.
        "along" => Along,
        /// As before, but only when nothing else is left.
        "last" => Last,
        /// Never.
        "lock" => Lock,
    }
}

choices! {
    /// What a collapse near a texture border pays by.
    pub enum BorderCost {
        /// How far it moves the texture along the surface, and on how much of it.
        "shift" => Shift,
        /// The share of the mesh's area on the edge, if the edge itself crosses a border: the published form.
        "area" => Area,
    }
}

choices! {
    /// What becomes of the input's normals.
    pub enum Normals {
        /// They stay; only missing ones are made.
        "keep" => Keep,
        /// All are made anew from the simplified faces.
        "rebuild" => Rebuild,
    }
}

choices! {
    /// Who lays out the atlas.
    pub enum UnwrapperName {
        /// Decided from counted properties of the mesh and from failed checks, never from a clock.
        "auto" => Auto,
        /// The built-in one.
        "uvunwrap" => Uvunwrap,
        /// xatlas in a child process.
        "xatlas" => Xatlas,
        /// Flat projections of small clusters: coarse charts, the fastest.
        "planar" => Planar,
    }
}

choices! {
    /// A map of a material.
    pub enum MaterialMap {
        /// Normals.
        "normal" => Normal,
        /// Base colour and alpha.
        "base-color" => BaseColor,
        /// Roughness in green, metallic in blue.
        "metallic-roughness" => MetallicRoughness,
        /// Occlusion in red.
        "occlusion" => Occlusion,
        /// Emission.
        "emissive" => Emissive,
    }
}

choices! {
    /// A texture that a bake writes.
    pub enum MapName {
        /// Normals of the high mesh in `space`.
        "normal" => Normal,
        /// Base colour and alpha.
        "base-color" => BaseColor,
        /// Roughness in green, metallic in blue.
        "metallic-roughness" => MetallicRoughness,
        /// Occlusion in red.
        "occlusion" => Occlusion,
        /// Emission.
        "emissive" => Emissive,
        /// Signed distance of the high mesh along the texel's line, metres; beside the material, as those below.
        "height" => Height,
        /// Place on the high mesh.
        "position" => Position,
        /// Normal of the high mesh in the axes of the asset, without its normal maps.
        "object-normal" => ObjectNormal,
        /// Number of the high submesh.
        "object-id" => ObjectId,
        /// Number of the source's material, -1 for none.
        "material-id" => MaterialId,
        /// Mean curvature of the high mesh, 1 / metre, convex positive.
        "curvature" => Curvature,
        /// Open share of the hemisphere over the high mesh, by rays.
        "ambient-occlusion" => AmbientOcclusion,
        /// Mean direction of that share.
        "bent-normal" => BentNormal,
        /// The source's alpha.
        "opacity" => Opacity,
        /// Share of the texel that met the high mesh.
        "coverage" => Coverage,
        later {
            /// One set of maps for each level, instead of one for all levels of a layout.
            "per-level",
        }
    }
}

choices! {
    /// How a texel finds its place on the high mesh.
    pub enum BakeMethod {
        /// Where the texel's own line, out of the low mesh, meets it.
        "mirrored-vertex" => MirroredVertex,
        /// The place with the same texture coordinate, where both meshes share a layout without overlaps: no atlas is needed.
        "correspondence" => Correspondence,
    }
}

choices! {
    /// Along which directions a bake looks out of the low mesh.
    pub enum BakeDirections {
        /// The mean normal of each point, mixed over the face: no gap at hard edges.
        "smooth" => Smooth,
        /// The face's normal: straight onto flat parts, jumps at every edge.
        "face" => Face,
        /// The normal of each vertex: smooth within smooth parts, straight behind hard edges, where a gap opens.
        "mixed" => Mixed,
    }
}

choices! {
    /// Which of several surfaces on a texel's line is shown.
    pub enum BakeHit {
        /// The outermost within `front`: parts that float above the surface are kept.
        "outermost" => Outermost,
        /// The one nearest to the low mesh: safe where the surface folds over itself.
        "nearest" => Nearest,
    }
}

choices! {
    /// Which submeshes of the high mesh a submesh of the low one may show.
    pub enum BakeMatch {
        /// Its own by name; where a line does not meet that, any.
        "prefer-name" => Prefer,
        /// Its own by name, nothing else.
        "name" => Name,
        /// Any.
        "any" => Any,
    }
}

choices! {
    /// How many samples a texel is made of.
    pub enum BakeSamples {
        /// One, at its centre; textures are averaged over the texel all the same.
        "1x1" => One,
        /// Four.
        "2x2" => Two,
        /// Sixteen.
        "4x4" => Four,
        /// Sixty-four.
        "8x8" => Eight,
    }
}

choices! {
    /// How finely baked maps are written.
    pub enum BakeDepth {
        /// 8 bits a channel; lengths and numbers as floats.
        "8-bit" => Eight,
        /// 16 bits a channel; lengths and numbers as floats.
        "16-bit" => Sixteen,
        /// 32-bit floats.
        "float" => Float,
    }
}

choices! {
    /// Where the occlusion map comes from.
    pub enum BakeOcclusion {
        /// The source's maps.
        "source" => Source,
        /// Rays against the high mesh.
        "rays" => Rays,
        /// Both, multiplied.
        "both" => Both,
    }
}

choices! {
    /// The frame that baked normals are written in.
    pub enum Space {
        /// MikkTSpace frames of the low mesh, +Y up.
        "tangent" => Tangent,
        /// Axes of the asset.
        "object" => Object,
    }
}

choices! {
    /// How texels are stored.
    pub enum TextureCoding {
        /// As they are: 4 bytes a texel, or as a deep bake asks for.
        "raw" => Raw,
        /// In blocks that GPUs read, 1 byte a texel: BC5 for tangent-space normals, else BC7. Deep and extra maps stay raw.
        "bc" => Bc,
    }
}

choices! {
    /// An arrangement of levels in the container.
    pub enum PackLayout {
        /// Each level with its own index range; without it only the finest level is there beside the other layouts.
        "discrete" => Discrete,
        /// Vertices in collapse order: any triangle count is a prefix of one vertex and one index buffer. Needs half-edge placement.
        "sliding-window" => SlidingWindow,
        /// Octree clusters in tree and leaf buffers, as Kanaya et al. print them: any detail in three reads a vertex.
        "tree-leaf" => TreeLeaf,
        /// The same octree with one texel a node.
        "compact-tree" => CompactTree,
        /// A cluster DAG: meshlets of at most 128 triangles that are chosen one by one for a view.
        "clusters" => Clusters,
    }
}

choices! {
    /// Whose vertices the levels use.
    pub enum PackVertices {
        /// Each level has its own: coarse levels are usable before finer ones have arrived.
        "own" => Own,
        /// All levels use the finest one's, coarse ones its first: smaller. Needs half-edge placement.
        "shared" => Shared,
    }
}

choices! {
    /// How payload is stored.
    pub enum PackCompression {
        /// As it lies in memory: mapped and lent without a copy.
        "none" => None,
        /// Geometry by the meshopt codecs, which decode at memory speed, the rest by zstd; lossless.
        "meshopt" => Meshopt,
        /// All by zstd; lossless.
        "zstd" => Zstd,
    }
}

choices! {
    /// Where an octree's node stands for its vertices.
    pub enum TreeNodes {
        /// At their mean.
        "mean" => Mean,
        /// Where the planes of their faces are nearest.
        "quadric" => Quadric,
    }
}

/// What a level of detail is limited by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LevelBudget {
    /// Share of the source asset's triangles, above 0 and at most 1.
    Keep(f64),
    /// Number of triangles, at least 1.
    Triangles(u32),
    /// Deviation from the source asset.
    Error(Length),
}

options! {
    /// The top of the file.
    pub struct FileOptions {
        /// Version of the language that the file is written in; older ones are read for ever.
        "kiln" => kiln: u32, required;
        /// Parent file, relative to this one; stages are matched by id, lists are replaced.
        "base" => base: Option<String>, derived("no parent");
    }
}

options! {
    /// `[asset]`: what is built from what.
    pub struct AssetOptions {
        /// Model or glob of models, relative to the file; one build for each match.
        "input" => input: String, required;
        /// Container to write; {path} is the model's path under the glob's fixed part, {name} its last part, both without extension.
        "output" => output: String, required;
        /// Whether a model may refer to files outside its own folder.
        "allow-outside" => allow_outside: bool, default(false);
        /// Greatest sum of a model's files, MiB.
        "max-file-size" => max_file_size: u32, default(8192), within 1..=1_048_576;
        /// Most triangles of a model, all instances in place.
        "max-triangles" => max_triangles: u32, default(1 << 26), within 1..=1_431_655_764;
        /// Most vertices of a model, all instances in place.
        "max-vertices" => max_vertices: u32, default(1 << 26), within 1..=4_294_967_294u32;
        /// Most submeshes of a model.
        "max-submeshes" => max_submeshes: u32, default(1 << 20), within 1..=16_777_216;
        /// Most nodes from a root down to a mesh.
        "max-node-depth" => max_node_depth: u32, default(4096), within 1..=1_000_000;
        /// Greatest width and height of an image in texels.
        "max-image-side" => max_image_side: u32, default(16_384), within 1..=65_536;
    }
}

options! {
    /// Keys of every `[[stage]]`.
    pub struct StageOptions {
        /// Name of the stage: lower-case letters, digits and hyphens, a letter first.
        "id" => id: Option<String>, derived("the kind, where that is unique");
        /// What the stage does.
        "kind" => kind: Option<Kind>, derived("must be given");
        /// Id of the earlier stage whose result it takes.
        "from" => from: Option<StageRef>, derived("the stage before");
    }
}

options! {
    /// Options of a merge stage.
    pub struct MergeOptions {
        /// Greatest distance between border points of different submeshes that become one point.
        "weld" => weld: Length, default(Length::diag(1e-5));
        /// Repairs to make, [] for none; faces with two corners at one point and vertices without a face always go.
        "repair" => repair: MergeRepairs, default(MergeRepairs(vec![MergeRepair::DuplicateFaces, MergeRepair::ZeroNormals]));
    }
}

options! {
    /// Options of a simplify stage.
    pub struct SimplifyOptions {
        /// What an edge costs; those that look at the model from views also as a table of kind and any of alpha, views, size, update and
        /// prepass, and for regions sigma, k, min-size, reach and side.
        "metric" => metric: MetricChoice, default(MetricChoice::from(Metric::Quadric));
        /// Whether sliding texture coordinates, normals and colours have a price, beside the surface.
        "attributes" => attributes: bool, default(true);
        /// Where the kept point of a collapse stands.
        "placement" => placement: Placement, default(Placement::HalfEdge);
        /// What becomes of the input's normals.
        "normals" => normals: Normals, default(Normals::Keep);
        /// Angle in degrees between faces above which made normals split into a hard edge.
        "normal-angle" => normal_angle: f64, default(30.0), within 0..=180;
        /// Levels of detail, finest first; each has exactly one of keep (share of the source asset's triangles), triangles and error (a length).
        "levels" => levels: Vec<LevelBudget>, required;
        /// When submesh boundaries may change.
        "boundary" => boundary: BoundaryRule, default(BoundaryRule::Along);
        /// Greatest diagonal of a loose component's bounding box that may vanish where a level would miss its budget otherwise.
        "prune" => prune: Option<Length>, derived("nothing is pruned");
        /// Materials whose submeshes stay untouched: names, `*` any run of characters, `?` one.
        "lock" => lock: Globs, default(Globs::default());
        /// Rules for submeshes with budgets of their own, each `[[stage.submesh]]`; they hold for all later simplify stages.
        "submesh" => submesh: SubmeshRules, default(SubmeshRules::default());
        /// Raises the cost of edges that cross a border in a texture, so that what is painted there stays in place longer.
        "texture-border" => texture_border: Option<TextureBorder>, derived("off");
    }
}

options! {
    /// What counts as a texture border and what crossing one costs.
    pub struct TextureBorder {
        /// Map of the materials whose borders count, or a list of maps.
        "map" => maps: MapList, default(MapList(vec![MaterialMap::BaseColor]));
        /// Texels over which a picture is smoothed before borders are looked for.
        "sigma" => sigma: f64, default(0.75), within 0..=16;
        /// Low threshold, as a share of the high one: weaker borders go nowhere.
        "low" => low: f64, default(0.5), within 0..=1;
        /// High threshold: the share of possible borders that are too weak to begin one.
        "high" => high: f64, default(0.6), within 0..=1;
        /// What a collapse near a border pays by.
        "cost" => cost: BorderCost, default(BorderCost::Shift);
        /// Factor on what it pays.
        "weight" => weight: f64, default(1.0), within 0..=1_000_000;
        /// Longest side in texels of a picture when borders are looked for; larger ones are halved first.
        "side" => side: u32, default(512), within 16..=4096;
    }
}

options! {
    /// Options of an atlas stage.
    pub struct AtlasOptions {
        /// Who lays it out.
        "unwrapper" => unwrapper: UnwrapperName, default(UnwrapperName::Auto);
        /// Width and height in texels.
        "size" => size: u32, default(2048), within 16..=16384;
        /// Least empty space between charts in texels.
        "padding" => padding: u32, default(16), within 0..=256;
        /// Most sheets over which the submeshes are spread, each whole on one; as few are used as give about the same density.
        "sheets" => sheets: Option<u32>, derived("one sheet"), within 1..=64;
        /// Rules of name (a glob over submeshes, the last that matches holds) and factor: how many times the texels per length of
        /// the others those submeshes get.
        "density" => density: Option<DensityRules>, derived("the same for all");
        /// Seconds after which the stage fails instead of going on, 0 for no limit; it never chooses a result and is no part of
        /// fingerprints.
        "time-limit" => time_limit: u32, default(300), within 0..=604_800;
    }
}

options! {
    /// Options of a bake stage.
    pub struct BakeOptions {
        /// Id of the earlier stage whose mesh is carried over.
        "high" => high: StageRef, required;
        /// Textures to write.
        "maps" => maps: Vec<MapName>, default(vec![MapName::Normal, MapName::BaseColor, MapName::MetallicRoughness]);
        /// How a texel finds its place on the high mesh.
        "method" => method: BakeMethod, default(BakeMethod::MirroredVertex);
        /// The frame that normals are written in.
        "space" => space: Space, default(Space::Tangent);
        /// Width and height in texels.
        "size" => size: Option<u32>, derived("the atlas's size"), within 16..=16384;
        /// Texels that each chart grows into the padding after the transfer.
        "dilation" => dilation: u32, default(8), within 0..=256;
        /// Samples of a texel, weighted by a tent of one texel's radius.
        "samples" => samples: BakeSamples, default(BakeSamples::One);
        /// How finely maps are written.
        "depth" => depth: BakeDepth, default(BakeDepth::Eight);
        /// Where lines look, out of the low mesh.
        "directions" => directions: BakeDirections, default(BakeDirections::Smooth);
        /// Which of several surfaces on a line is shown.
        "hit" => hit: BakeHit, default(BakeHit::Outermost);
        /// How far in front of the low mesh the high one is looked for.
        "front" => front: Option<Length>, derived("1.5 times the finest level's error, at least 0.001 diag");
        /// How far behind the low mesh the high one is looked for.
        "back" => back: Option<Length>, derived("1.5 times the finest level's error, at least 0.001 diag");
        /// Model around the low mesh that says how far in front each part looks, instead of `front`; relative to this file, with `{name}` and `{path}` as in `output`.
        "cage" => cage: Option<String>, derived("no cage");
        /// Takes surfaces that face away from the low mesh too.
        "back-faces" => back_faces: bool, default(false);
        /// Which submeshes go together.
        "match" => matching: BakeMatch, default(BakeMatch::Prefer);
        /// Where the occlusion map comes from.
        "occlusion" => occlusion: BakeOcclusion, default(BakeOcclusion::Source);
        /// Rays of a texel for ambient occlusion and bent normals; each of its samples asks at least one.
        "rays" => rays: u32, default(64), within 1..=4096;
        /// How far those rays go.
        "ray-length" => ray_length: Option<Length>, derived("1 diag");
        later {
            /// Keeps the model's own layout beside the atlas.
            "keep-source-uv";
        }
    }
}

options! {
    /// Options of a pack stage.
    pub struct PackOptions {
        /// How levels lie in the container.
        "layouts" => layouts: Vec<PackLayout>, default(vec![PackLayout::Discrete]);
        /// How the texels of materials' textures are stored.
        "textures" => textures: TextureCoding, default(TextureCoding::Raw);
        /// Whose vertices the levels use.
        "vertices" => vertices: PackVertices, default(PackVertices::Own);
        /// How payload is stored.
        "compression" => compression: PackCompression, default(PackCompression::None);
        /// Where an octree's node stands for its vertices, in the layouts `tree-leaf` and `compact-tree`.
        "nodes" => nodes: TreeNodes, default(TreeNodes::Quadric);
        /// Places on the scale of detail of each of these layouts at which the error is measured, the ends among them; the runtime chooses by them.
        "checkpoints" => checkpoints: u32, default(24), within 2..=256;
    }
}

options! {
    /// `[[override]]`: other values for some of many assets.
    pub struct OverrideOptions {
        /// Glob over the models' paths below the input's fixed part, extension included; `*` does not cross a `/`.
        "match" => pattern: String, required;
        /// Values by "stage.ID.KEY".
        "set" => set: SetTable, required;
    }
}

/// Keys of a submesh rule.
pub(crate) const RULE_KEYS: [&str; 5] = ["name", "keep", "level", "relative-to", "factor"];

impl Kind {
    /// The keys of a stage of this kind beside `id`, `kind` and `from`.
    pub fn keys(self) -> Vec<Key> {
        match self {
            Kind::Merge => MergeOptions::keys(),
            Kind::Simplify => SimplifyOptions::keys(),
            Kind::Atlas => AtlasOptions::keys(),
            Kind::Bake => BakeOptions::keys(),
            Kind::Pack => PackOptions::keys(),
        }
    }

    /// Every kind in the order of a common pipeline.
    pub const ALL: [Kind; 5] = [Kind::Merge, Kind::Simplify, Kind::Atlas, Kind::Bake, Kind::Pack];

    /// The kind of that name.
    pub fn from_name(name: &str) -> Option<Kind> {
        Kind::ALL.into_iter().find(|kind| kind.as_str() == name)
    }
}

/// The id of a stage, as it was written; the chain checks that it exists.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct StageRef(pub String);

impl Setting for StageRef {
    fn shape() -> Shape {
        Shape::StageId
    }

    fn read(node: &Node, report: &mut Report) -> Option<Self> {
        match &node.data {
            Data::Text(text) if text.is_empty() => {
                report.add(Code::ValueEmpty, &node.origin, "a stage's id is never empty", "empty", None);
                None
            }
            Data::Text(text) => Some(StageRef(text.clone())),
            _ => {
                mistyped(node, "a stage's id", None, report);
                None
            }
        }
    }

    fn write(&self) -> Value {
        Value::Text(self.0.clone())
    }
}

/// The repairs of a merge, ascending: their order means nothing. Unlike other lists this one may be empty.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MergeRepairs(pub Vec<MergeRepair>);

impl Setting for MergeRepairs {
    fn shape() -> Shape {
        Vec::<MergeRepair>::shape()
    }

    fn read(node: &Node, report: &mut Report) -> Option<Self> {
        if node.list().is_some_and(<[Node]>::is_empty) {
            return Some(MergeRepairs::default());
        }
        let mut repairs = Vec::<MergeRepair>::read(node, report)?;
        repairs.sort_unstable();
        Some(MergeRepairs(repairs))
    }

    fn write(&self) -> Value {
        self.0.write()
    }
}

/// Globs over names, in which only `*` and `?` mean something. Unlike other lists this one may be empty.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Globs(pub Vec<String>);

impl Setting for Globs {
    fn shape() -> Shape {
        Vec::<String>::shape()
    }

    fn read(node: &Node, report: &mut Report) -> Option<Self> {
        if node.list().is_some_and(<[Node]>::is_empty) {
            return Some(Globs::default());
        }
        Vec::<String>::read(node, report).map(Globs)
    }

    fn write(&self) -> Value {
        self.0.write()
    }
}

/// What a submesh rule grants.
#[derive(Clone, Debug, PartialEq)]
pub enum RuleLevel {
    /// Share of each submesh's own source triangles, above 0 and at most 1; 1 leaves it untouched.
    Keep(f64),
    /// What it has in this level of the stage without rules; 0 is the finest.
    Level(u32),
    /// A multiple of the share that the submeshes of another rule reached.
    Relative {
        /// The other rule's name, as it is written there.
        to: String,
        /// Above 0.
        factor: f64,
    },
}

/// One `[[stage.submesh]]`.
#[derive(Clone, Debug, PartialEq)]
pub struct SubmeshRule {
    /// Glob over names of submeshes: `*` any run of characters, `?` one.
    pub name: String,
    /// What it grants them.
    pub level: RuleLevel,
}

impl Setting for SubmeshRule {
    fn shape() -> Shape {
        Shape::Table("name and one of keep, level, and relative-to with factor")
    }

    fn read(node: &Node, report: &mut Report) -> Option<Self> {
        let Some(table) = node.table() else {
            let help = Some(String::from("for example { name = \"wheel*\", keep = 0.5 }"));
            mistyped(node, "a rule", help, report);
            return None;
        };
        // Unknown keys are reported where the stage is read.
        let Some(name) = table.get("name") else {
            let help = Some(String::from("`name` takes a submesh's name; `*` stands for any characters, `?` for one"));
            report.add(Code::KeyMissing, &node.origin, "a rule needs the key `name`", "`name` is missing", help);
            return None;
        };
        let text = String::read(name, report)?;
        if text.is_empty() {
            report.add(Code::ValueEmpty, &name.origin, "a submesh's name is never empty", "empty", None);
            return None;
        }
        let given: Vec<&str> =
            ["keep", "level", "relative-to"].into_iter().filter(|name| table.get(name).is_some()).collect();
        let [one] = given[..] else {
            let misspelt = table.entries.iter().any(|entry| !RULE_KEYS.contains(&entry.name.as_str()));
            if given.is_empty() && misspelt {
                return None;
            }
            let (message, label) = match given.len() {
                0 => ("a rule needs one of keep, level and relative-to", String::from("none of them")),
                _ => (
                    "a rule takes exactly one of keep, level and relative-to",
                    format!("{} are given", given.join(" and ")),
                ),
            };
            let help = Some(String::from("of several rules that match a submesh the last one holds"));
            report.add(Code::RuleShape, &node.origin, message, label, help);
            return None;
        };
        if let (Some(factor), true) = (table.entry("factor"), one != "relative-to") {
            let message = format!("`factor` belongs to `relative-to`, and `{one}` is given");
            report.add(Code::RuleShape, &factor.key, message, "of what?", None);
            return None;
        }
        let value = table.get(one)?;
        let level = match one {
            "keep" => RuleLevel::Keep(share("each submesh's own source", value, report)?),
            "level" => RuleLevel::Level(u32::read(value, report)?),
            _ => {
                let to = String::read(value, report)?;
                let Some(factor) = table.get("factor") else {
                    let help = Some(String::from("factor = 0.5 is half the level that the other rule reached"));
                    let message = "`relative-to` needs the key `factor`";
                    report.add(Code::KeyMissing, &value.origin, message, "`factor` is missing", help);
                    return None;
                };
                let number = f64::read(factor, report)?;
                if !(number > 0.0 && number <= 1e6) {
                    let message = "`factor` must be above 0 and at most 1000000";
                    report.add(Code::ValueRange, &factor.origin, message, "out of range", None);
                    return None;
                }
                RuleLevel::Relative { to, factor: number }
            }
        };
        Some(SubmeshRule { name: text, level })
    }

    fn write(&self) -> Value {
        let mut entries = vec![(String::from("name"), self.name.write())];
        match &self.level {
            RuleLevel::Keep(keep) => entries.push((String::from("keep"), keep.write())),
            RuleLevel::Level(level) => entries.push((String::from("level"), level.write())),
            RuleLevel::Relative { to, factor } => {
                entries.push((String::from("relative-to"), to.write()));
                entries.push((String::from("factor"), factor.write()));
            }
        }
        Value::Table(entries)
    }
}

/// The rules of a stage in order. Unlike other lists this one may be empty.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SubmeshRules(pub Vec<SubmeshRule>);

impl Setting for SubmeshRules {
    fn shape() -> Shape {
        Vec::<SubmeshRule>::shape()
    }

    fn read(node: &Node, report: &mut Report) -> Option<Self> {
        if node.list().is_some_and(<[Node]>::is_empty) {
            return Some(SubmeshRules::default());
        }
        Vec::<SubmeshRule>::read(node, report).map(SubmeshRules)
    }

    fn write(&self) -> Value {
        self.0.write()
    }
}

/// Rules in their canonical text.
pub(crate) fn rules_text(rules: &[SubmeshRule]) -> String {
    Value::List(rules.iter().map(Setting::write).collect()).to_toml()
}

/// One map or a list of maps.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MapList(pub Vec<MaterialMap>);

impl Setting for MapList {
    fn shape() -> Shape {
        Vec::<MaterialMap>::shape()
    }

    fn read(node: &Node, report: &mut Report) -> Option<Self> {
        match node.data {
            Data::Text(_) => MaterialMap::read(node, report).map(|map| MapList(vec![map])),
            _ => Vec::<MaterialMap>::read(node, report).map(MapList),
        }
    }

    fn write(&self) -> Value {
        self.0.write()
    }
}

impl Setting for TextureBorder {
    fn shape() -> Shape {
        Shape::Table("any of map, sigma, low, high, cost, weight and side")
    }

    fn read(node: &Node, report: &mut Report) -> Option<Self> {
        let Some(table) = node.table() else {
            let help = match &node.data {
                Data::Text(map) => format!("write {{ map = \"{map}\" }}"),
                Data::List(_) => String::from("write { map = [ ... ] }"),
                Data::Boolean(false) => String::from("leave the key out"),
                _ => String::from("for example { map = \"base-color\" }; {} has all defaults"),
            };
            mistyped(node, "a table", Some(help), report);
            return None;
        };
        check_keys(table, &TextureBorder::keys(), "`texture-border`", &node.origin, &|_| None, report);
        Some(TextureBorder::from_table(table, report))
    }

    fn write(&self) -> Value {
        Value::Table(self.values())
    }
}

/// The keys of a level.
const LEVEL_KEYS: [&str; 3] = ["keep", "triangles", "error"];

impl Setting for LevelBudget {
    fn shape() -> Shape {
        Shape::Table("exactly one of keep, triangles and error")
    }

    fn read(node: &Node, report: &mut Report) -> Option<Self> {
        let Some(table) = node.table() else {
            let help = match node.data {
                Data::Float(value) if value > 0.0 && value <= 1.0 => Some(format!("write {{ keep = {value} }}")),
                Data::Integer(Some(value)) if value > 1 => Some(format!("write {{ triangles = {value} }}")),
                _ => Some(String::from("for example { keep = 0.25 }")),
            };
            mistyped(node, "a level", help, report);
            return None;
        };
        let keys = [
            key_of("keep", <f64 as Setting>::shape()),
            key_of("triangles", <u32 as Setting>::shape()),
            key_of("error", <Length as Setting>::shape()),
        ];
        let before = report.len();
        check_keys(table, &keys, "a level", &node.origin, &|_| None, report);
        let given: Vec<&str> = LEVEL_KEYS.into_iter().filter(|name| table.get(name).is_some()).collect();
        if given.len() != 1 {
            if given.is_empty() && report.len() > before {
                return None;
            }
            let (message, label) = match given.len() {
                0 => (String::from("a level needs one of keep, triangles and error"), String::from("none of them")),
                _ => (
                    String::from("a level takes exactly one of keep, triangles and error"),
                    format!("{} are given", given.join(" and ")),
                ),
            };
            let help = "write one level for each: the levels stand in order, finest first";
            report.add(Code::LevelShape, &node.origin, message, label, Some(help.to_owned()));
            return None;
        }
        if let Some(keep) = table.get("keep") {
            return share("the source asset's", keep, report).map(LevelBudget::Keep);
        }
        if let Some(triangles) = table.get("triangles") {
            return read_within("triangles", triangles, Some((1.0, f64::from(u32::MAX))), report)
                .map(LevelBudget::Triangles);
        }
        table.get("error").and_then(|error| Length::read(error, report)).map(LevelBudget::Error)
    }

    fn write(&self) -> Value {
        let (name, value) = match self {
            LevelBudget::Keep(keep) => ("keep", keep.write()),
            LevelBudget::Triangles(triangles) => ("triangles", triangles.write()),
            LevelBudget::Error(error) => ("error", error.write()),
        };
        Value::Table(vec![(name.to_owned(), value)])
    }
}

/// A share above 0 and at most 1 of `whose` triangles.
fn share(whose: &str, node: &Node, report: &mut Report) -> Option<f64> {
    let value = f64::read(node, report)?;
    if value > 0.0 && value <= 1.0 {
        return Some(value);
    }
    let help = if (2.0..=100.0).contains(&value) {
        format!("`keep` is a share: {} percent is {}", value, value / 100.0)
    } else {
        format!("`keep` is the share of {whose} triangles that stays; 1.0 keeps all")
    };
    let message = "`keep` must be above 0 and at most 1";
    report.add(Code::ValueRange, &node.origin, message, "out of range", Some(help));
    None
}

pub(super) fn key_of(name: &'static str, shape: Shape) -> Key {
    Key { name, shape, standard: super::setting::Standard::Derived(""), range: None, sentence: String::new() }
}

/// Marks the value of `set`; what is in it is read against the stages by the module `compose`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SetTable;

impl Setting for SetTable {
    fn shape() -> Shape {
        Shape::Table("keys \"stage.ID.KEY\"")
    }

    fn read(node: &Node, report: &mut Report) -> Option<Self> {
        if node.table().is_none() {
            let help = Some(String::from("for example { \"stage.lods.levels\" = [ { keep = 0.1 } ] }"));
            mistyped(node, "a table", help, report);
            return None;
        }
        Some(SetTable)
    }

    fn write(&self) -> Value {
        Value::Absent
    }
}

/// The choice of that name, for callers that only have a text.
pub(crate) fn read_kind(node: &Node, report: &mut Report) -> Option<Kind> {
    choose(node, Kind::CHOICES, report).and_then(Kind::from_name)
}

/// Sentence of a kind.
pub(crate) fn kind_sentence(kind: Kind) -> &'static str {
    let known: Option<&Choice> = Kind::CHOICES.iter().find(|choice| choice.name == kind.as_str());
    known.map_or("", |choice| choice.sentence)
}
