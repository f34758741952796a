//! The node graph: a forest that is checked and walked without recursion, so that no file can exhaust the stack.

use std::collections::{BTreeMap, BTreeSet};

use glam::{DMat4, DQuat, DVec3};

use super::ImportLimits;
use super::accessor::{Accessor, Reader};
use super::error::Defects;
use super::json::Object;
use super::material::note_extensions;
use super::primitive::{Context, FLOAT, Rule, SIGNED, rule, usable};
use super::report::{Notes, RepairKind};
use super::source::Bytes;

/// A mesh placed by a node.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Placement {
    pub(super) node: usize,
    pub(super) mesh: usize,
    /// The node's name, may be empty.
    pub(super) name: String,
    pub(super) object_from_mesh: DMat4,
    /// Where the node places the mesh many times; [`spread`] makes a placement of each.
    pub(super) instances: Option<Instances>,
}

/// `EXT_mesh_gpu_instancing`: accessors of translations, rotations and scales of the same length, those there are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Instances {
    accessors: [Option<usize>; 3],
    pub(super) count: u64,
}

const INSTANCING: &str = "EXT_mesh_gpu_instancing";
const INSTANCE_RULES: [(&str, Rule); 3] = [
    ("TRANSLATION", rule(&["VEC3"], FLOAT, &[])),
    ("ROTATION", rule(&["VEC4"], FLOAT, SIGNED)),
    ("SCALE", rule(&["VEC3"], FLOAT, &[])),
];

struct Node<'a> {
    object: Object<'a>,
    /// (place in `children`, node).
    children: Vec<(usize, usize)>,
    mesh: Option<usize>,
    instances: Option<Instances>,
    skinned: bool,
    parent_from_node: DMat4,
}

/// Every mesh of the default scene in place, depth first in the order in which nodes are listed. Without any scene all nodes
/// without a parent count.
pub(super) fn read_placements(
    root: &Object<'_>,
    mesh_count: usize,
    context: &Context<'_>,
    limits: &ImportLimits,
    defects: &mut Defects,
    notes: &mut Notes,
) -> Vec<Placement> {
    let objects = root.objects("nodes", defects);
    let count = objects.len();
    let nodes: Vec<Option<Node<'_>>> = (objects.into_iter())
        .map(|node| node.map(|node| read_node(node, count, mesh_count, context, defects, notes)))
        .collect();
    let parents = find_parents(&nodes, defects);
    refuse_cycles(&parents, defects);
    let roots = read_roots(root, &parents, defects, notes);
    walk(&nodes, &roots, limits, defects)
}

fn read_node<'a>(
    object: Object<'a>,
    node_count: usize,
    mesh_count: usize,
    context: &Context<'_>,
    defects: &mut Defects,
    notes: &mut Notes,
) -> Node<'a> {
    note_extensions(&object, &[INSTANCING], defects, notes);
    let extensions = object.object("extensions", defects);
    let instances = extensions.and_then(|e| e.object(INSTANCING, defects));
    let instances = instances.and_then(|instances| read_instances(&instances, context, defects, notes));
    notes.not_carried("nodes with a camera", object.has("camera") as u64);
    let mesh = object.index("mesh", "meshes", mesh_count, defects);
    let children = object.indices("children", "nodes", node_count, defects);
    let parent_from_node = read_transform(&object, defects, notes);
    let skinned = object.has("skin");
    Node { object, children, mesh, instances, skinned, parent_from_node }
}

fn read_instances(
    object: &Object<'_>,
    context: &Context<'_>,
    defects: &mut Defects,
    notes: &mut Notes,
) -> Option<Instances> {
    let list = object.need_object("attributes", defects)?;
    for name in list.keys().filter(|name| INSTANCE_RULES.iter().all(|rule| rule.0 != *name)) {
        notes.not_carried(&format!("instance attribute {name}"), 1);
    }
    // Rotations may be normalised integers whether or not the file says that it uses quantised attributes.
    let context = Context { quantized: true, ..*context };
    let mut accessors = [None; 3];
    let mut count = None;
    for (slot, (name, rule)) in accessors.iter_mut().zip(INSTANCE_RULES).filter(|(_, (name, _))| list.has(name)) {
        let (index, accessor) = usable(&list, name, rule, &context, false, defects)?;
        *slot = Some(index);
        let first = *count.get_or_insert(accessor.count);
        if first != accessor.count {
            defects.invalid(list.path_of(name), format!("{} elements, but the first has {first}", accessor.count));
            return None;
        }
    }
    if count.is_none() {
        defects.invalid(list.path, "names neither translations nor rotations nor scales");
    }
    Some(Instances { accessors, count: count? })
}

fn read_transform(object: &Object<'_>, defects: &mut Defects, notes: &mut Notes) -> DMat4 {
    if object.has("matrix") {
        if let Some(key) = ["translation", "rotation", "scale"].iter().find(|key| object.has(key)) {
            defects.invalid(object.path_of("matrix"), format!("stands beside `{key}`; only one of the two may"));
            return DMat4::IDENTITY;
        }
        let Some(m) = object.floats::<16>("matrix", defects) else { return DMat4::IDENTITY };
        if [m[3], m[7], m[11], m[15]] != [0.0, 0.0, 0.0, 1.0] {
            defects.invalid(object.path_of("matrix"), "its fourth row is not 0 0 0 1");
        }
        return DMat4::from_cols_array(&m);
    }
    let translation = object.floats::<3>("translation", defects).unwrap_or([0.0; 3]);
    let scale = object.floats::<3>("scale", defects).unwrap_or([1.0; 3]);
    let rotation = object.floats::<4>("rotation", defects).unwrap_or([0.0, 0.0, 0.0, 1.0]);
    let rotation = read_rotation(rotation, || object.path_of("rotation"), defects, notes);
    DMat4::from_scale_rotation_translation(DVec3::from_array(scale), rotation, DVec3::from_array(translation))
}

fn read_rotation(xyzw: [f64; 4], path: impl Fn() -> String, defects: &mut Defects, notes: &mut Notes) -> DQuat {
    let raw = DQuat::from_array(xyzw);
    let length = raw.length();
    if !(length > 1e-12 && length.is_finite()) {
        defects.invalid(path(), format!("quaternion of length {length}"));
        return DQuat::IDENTITY;
    }
    notes.repair(RepairKind::RotationScaled, ((length - 1.0).abs() > 0.01) as u64, path);
    raw.normalize()
}

/// The parent of every node; a second one is a defect, so that what is left is a forest, perhaps with rings.
fn find_parents(nodes: &[Option<Node<'_>>], defects: &mut Defects) -> Vec<Option<usize>> {
    let mut parents: Vec<Option<usize>> = vec![None; nodes.len()];
    for (parent, node) in nodes.iter().enumerate() {
        let Some(node) = node else { continue };
        for (k, child) in &node.children {
            match parents[*child] {
                None => parents[*child] = Some(parent),
                Some(first) => defects.invalid(
                    format!("nodes[{parent}].children[{k}]"),
                    format!("node {child} already is a child of node {first}; a node has one parent"),
                ),
            }
        }
    }
    parents
}

/// Names one node of every ring of parents.
fn refuse_cycles(parents: &[Option<usize>], defects: &mut Defects) {
    // Walk `w` marks what it meets; meeting its own mark closes a ring. Every node is marked once.
    let mut walk_of: Vec<usize> = vec![usize::MAX; parents.len()];
    for start in 0..parents.len() {
        let mut at = start;
        while walk_of[at] == usize::MAX {
            walk_of[at] = start;
            match parents[at] {
                Some(parent) => at = parent,
                None => break,
            }
        }
        if walk_of[at] == start && parents[at].is_some() {
            // A ring, unless the walk stopped at a root (which has no parent).
            defects.invalid(format!("nodes[{at}]"), "is its own ancestor");
        }
    }
}

fn read_roots(root: &Object<'_>, parents: &[Option<usize>], defects: &mut Defects, notes: &mut Notes) -> Vec<usize> {
    let scenes = root.objects("scenes", defects);
    if scenes.is_empty() && !root.has("scene") {
        return (0..parents.len()).filter(|n| parents[*n].is_none()).collect();
    }
    let default = if root.has("scene") { root.index("scene", "scenes", scenes.len(), defects) } else { Some(0) };
    notes.not_carried("scenes besides the default one", scenes.len().saturating_sub(1) as u64);
    let Some(Some(scene)) = default.map(|default| &scenes[default]) else { return Vec::new() };
    note_extensions(scene, &[], defects, notes);
    let mut seen = BTreeSet::new();
    let mut roots = Vec::new();
    for (i, node) in scene.indices("nodes", "nodes", parents.len(), defects) {
        let path = format!("{}[{i}]", scene.path_of("nodes"));
        if let Some(parent) = parents[node] {
            defects.invalid(path, format!("node {node} is a child of node {parent}, not a root"));
        } else if !seen.insert(node) {
            defects.invalid(path, format!("node {node} is listed twice"));
        } else {
            roots.push(node);
        }
    }
    roots
}

fn walk(nodes: &[Option<Node<'_>>], roots: &[usize], limits: &ImportLimits, defects: &mut Defects) -> Vec<Placement> {
    let mut placements = Vec::new();
    // In a sound forest each node is met at most once; in a defective one, too, by this table.
    let mut met = vec![false; nodes.len()];
    let mut stack: Vec<(usize, DMat4, u32)> = roots.iter().rev().map(|n| (*n, DMat4::IDENTITY, 1)).collect();
    while let Some((index, object_from_parent, depth)) = stack.pop() {
        let Some(node) = nodes[index].as_ref().filter(|_| !std::mem::replace(&mut met[index], true)) else { continue };
        if depth > limits.max_node_depth {
            let message = format!("lies deeper than {} nodes, the limit", limits.max_node_depth);
            defects.invalid(format!("nodes[{index}]"), message);
            continue;
        }
        let object_from_node = object_from_parent * node.parent_from_node;
        if let Some(mesh) = node.mesh {
            if !object_from_node.is_finite() {
                defects.invalid(format!("nodes[{index}]"), "its transform in the scene is not finite");
            }
            // A skin places the mesh by its joints; the node's own transform does not count (glTF 2.0, 3.7.3.2). Skins are
            // not carried, so the mesh stays in the space it was bound in.
            let object_from_mesh = if node.skinned { DMat4::IDENTITY } else { object_from_node };
            let name = node.object.string("name", defects).unwrap_or_default().to_owned();
            placements.push(Placement { node: index, mesh, name, object_from_mesh, instances: node.instances });
        }
        stack.extend(node.children.iter().rev().map(|(_, child)| (*child, object_from_node, depth + 1)));
    }
    placements
}

/// Every placement of many instances as many placements, in their order.
pub(super) fn spread(
    placements: Vec<Placement>,
    accessors: &[Option<Accessor>],
    buffers: &[Bytes<'_>],
    defects: &mut Defects,
    notes: &mut Notes,
) -> Vec<Placement> {
    let mut out = Vec::with_capacity(placements.len());
    for placement in placements {
        let Some(Instances { accessors: of, count }) = placement.instances else {
            out.push(placement);
            continue;
        };
        let path = format!("nodes[{}].extensions.{INSTANCING}", placement.node);
        let readers = of.map(|index| Reader::new(accessors[index?].as_ref()?, buffers, defects));
        for i in 0..count as u32 {
            let read = |k: usize, neutral: [f64; 4]| {
                readers[k].as_ref().map_or(neutral, |reader| reader.floats::<4>(i, 0.0).map(f64::from))
            };
            let rotation = read_rotation(read(1, [0.0, 0.0, 0.0, 1.0]), || path.clone(), defects, notes);
            let [translation, scale] = [read(0, [0.0; 4]), read(2, [1.0; 4])].map(|v| DVec3::new(v[0], v[1], v[2]));
            let mesh_from_instance = DMat4::from_scale_rotation_translation(scale, rotation, translation);
            let object_from_mesh = placement.object_from_mesh * mesh_from_instance;
            if !object_from_mesh.is_finite() {
                defects.invalid(path.clone(), format!("the transform of instance {i} is not finite"));
            }
            out.push(Placement { object_from_mesh, instances: None, ..placement.clone() });
        }
    }
    out
}

/// Names of submeshes, unique and readable. The rule: the node's name, or its mesh's, or `mesh<i>`; where the mesh has several
/// primitives `/` and the material's name or the primitive's number follow; and where that is taken already, `#2`, `#3` and so on.
/// What kiln itself exported says its submeshes' names in `extras`.
pub(super) struct Names {
    taken: BTreeSet<String>,
    /// The last number given to a name.
    last: BTreeMap<String, u64>,
}

impl Names {
    pub(super) fn new() -> Names {
        Names { taken: BTreeSet::new(), last: BTreeMap::new() }
    }

    /// The wished name, or the first free numbered one.
    pub(super) fn unique(&mut self, wish: String) -> String {
        if self.taken.insert(wish.clone()) {
            return wish;
        }
        let last = self.last.entry(wish.clone()).or_insert(1);
        loop {
            *last += 1;
            let name = format!("{wish}#{last}");
            if self.taken.insert(name.clone()) {
                return name;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeated_names_are_numbered_past_names_that_look_numbered() {
        let mut names = Names::new();
        let given: Vec<String> =
            ["wheel", "wheel#2", "wheel", "wheel", "hub"].iter().map(|n| names.unique((*n).into())).collect();
        assert_eq!(given, ["wheel", "wheel#2", "wheel#3", "wheel#4", "hub"]);
    }

    #[test]
    fn rings_are_found_and_chains_are_not_rings() {
        let rings = |parents: &[Option<usize>]| {
            let mut defects = Defects::default();
            refuse_cycles(parents, &mut defects);
            defects.check().err().map_or(Vec::new(), |e| e.defects().iter().map(|d| d.path.clone()).collect())
        };
        assert!(rings(&[None, Some(0), Some(1), Some(1)]).is_empty());
        assert_eq!(rings(&[Some(0)]), ["nodes[0]"]);
        assert_eq!(rings(&[Some(2), Some(0), Some(1), None, Some(5), Some(4)]), ["nodes[0]", "nodes[4]"]);
    }
}
