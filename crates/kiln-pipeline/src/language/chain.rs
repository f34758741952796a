//! Whether the stages form a chain that can run, decided before anything runs.
//!
//! What flows between stages: the asset, then a mesh, then levels, then the container. The rules:
//!
//! | stage | takes | gives |
//! | --- | --- | --- |
//! | merge | the asset | a mesh |
//! | simplify | a mesh or one level | levels |
//! | atlas | one level without an atlas | that level with an atlas |
//! | bake | levels with an atlas; `high` an earlier mesh | levels with textures |
//! | pack | levels without an unbaked atlas | the container, last |

use super::diagnostic::{Code, Origin, Report, nearest, suggest};
use super::length::{Length, Unit};
use super::options::{
    BakeMethod, Kind, LevelBudget, Metric, Normals, PackLayout, PackVertices, Placement, RuleLevel, SubmeshRule,
};
use super::pipeline::{RelativeTo, Stage, StageInput, StageSettings};
use super::read::Draft;

/// What a stage hands on, as far as it is known before anything runs.
#[derive(Clone, Debug)]
struct Flow {
    what: What,
    /// Number of levels; `None` if unknown.
    count: Option<usize>,
    /// What bounds the one level that is there.
    budget: Option<LevelBudget>,
    /// Index of the atlas that no bake has filled yet.
    atlas: Option<usize>,
    /// True after a bake.
    baked: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum What {
    Asset,
    Mesh,
    Levels,
    Container,
    /// After a defect that has been reported: nothing more is said.
    Unknown,
}

impl What {
    fn describe(self) -> &'static str {
        match self {
            What::Asset => "the asset",
            What::Mesh => "a mesh",
            What::Levels => "levels",
            What::Container => "a container",
            What::Unknown => "nothing known",
        }
    }
}

impl Flow {
    const UNKNOWN: Flow = Flow { what: What::Unknown, count: None, budget: None, atlas: None, baked: false };
    const ASSET: Flow = Flow { what: What::Asset, ..Flow::UNKNOWN };
}

/// The stages, if the chain is sound.
pub(crate) fn check(drafts: Vec<Draft>, report: &mut Report) -> Option<Vec<Stage>> {
    let before = report.len();
    let mut walk = Walk { drafts: &drafts, flows: Vec::new(), used: vec![false; drafts.len()], report };
    let mut inputs = Vec::new();
    let mut highs = Vec::new();
    for index in 0..drafts.len() {
        let input = walk.input(index);
        let incoming = match input {
            Some(StageInput::Asset) => Flow::ASSET,
            Some(StageInput::Stage(before)) => walk.flows[before].clone(),
            None => Flow::UNKNOWN,
        };
        highs.push(walk.high(index));
        let flow = walk.step(index, &incoming);
        walk.flows.push(flow);
        inputs.push(input);
    }
    for index in 0..drafts.len() {
        walk.rules(index, &inputs);
    }
    walk.pack();
    walk.layouts(&inputs);
    walk.left_over(&inputs);
    let only_doubts = walk.report.found()[before..].iter().all(|d| d.severity == super::Severity::Warning);
    if !only_doubts {
        return None;
    }
    let sizes: Vec<Option<u32>> = (0..drafts.len()).map(|index| atlas_size(index, &inputs, &drafts)).collect();
    drafts
        .into_iter()
        .zip(inputs)
        .zip(highs)
        .zip(sizes)
        .map(|(((draft, input), high), size)| {
            let mut settings = draft.settings?;
            if let StageSettings::Bake(bake) = &mut settings {
                bake.size = bake.size.or(size);
            }
            let origins = draft.origins;
            let cage_from = origins.get("cage").map(|origin| RelativeTo::of(origin, report));
            Some(Stage { id: draft.id?, input: input?, high, cage_from, settings, header: draft.header, origins })
        })
        .collect()
}

/// The size of the nearest atlas that the stage descends from.
fn atlas_size(mut index: usize, inputs: &[Option<StageInput>], drafts: &[Draft]) -> Option<u32> {
    loop {
        if let Some(StageSettings::Atlas(atlas)) = &drafts[index].settings {
            return Some(atlas.size);
        }
        match inputs[index] {
            Some(StageInput::Stage(before)) => index = before,
            _ => return None,
        }
    }
}

struct Walk<'a> {
    drafts: &'a [Draft],
    flows: Vec<Flow>,
    /// Whether a later stage takes or names the stage.
    used: Vec<bool>,
    report: &'a mut Report,
}

impl Walk<'_> {
    fn find(&self, id: &str) -> Option<usize> {
        self.drafts.iter().position(|draft| draft.id.as_deref() == Some(id))
    }

    /// Ids of the stages before `index` that satisfy the condition.
    fn earlier(&self, index: usize, keep: impl Fn(usize) -> bool) -> Vec<&str> {
        (0..index).filter(|at| keep(*at)).filter_map(|at| self.drafts[at].id.as_deref()).collect()
    }

    fn input(&mut self, index: usize) -> Option<StageInput> {
        let draft = &self.drafts[index];
        let Some(from) = &draft.from else {
            return match index.checked_sub(1) {
                None => Some(StageInput::Asset),
                Some(before) => {
                    self.used[before] = true;
                    Some(StageInput::Stage(before))
                }
            };
        };
        let origin = draft.origin("from");
        match self.find(from) {
            Some(before) if before < index => {
                self.used[before] = true;
                Some(StageInput::Stage(before))
            }
            Some(later) => {
                self.forward("from", from, later == index, origin);
                None
            }
            None => {
                let help = suggest("earlier stages", from, &self.earlier(index, |_| true));
                self.report.add(
                    Code::ChainFrom,
                    origin,
                    format!("no stage has the id `{from}`"),
                    "no such stage",
                    help,
                );
                None
            }
        }
    }

    fn forward(&mut self, key: &str, id: &str, itself: bool, origin: &Origin) {
        let message = if itself {
            format!("`{key}` names the stage itself")
        } else {
            format!("`{key}` names the later stage `{id}`")
        };
        let label = if itself { "itself" } else { "comes later" };
        let help = Some(format!("`{key}` takes the id of a stage that stands before this one"));
        self.report.add(Code::ChainForward, origin, message, label, help);
    }

    /// The stage that a bake's `high` names.
    fn high(&mut self, index: usize) -> Option<usize> {
        let draft = &self.drafts[index];
        let Some(StageSettings::Bake(bake)) = &draft.settings else { return None };
        let id = &bake.high.0;
        // Missing, empty or of a wrong type: said where it was read.
        if id.is_empty() {
            return None;
        }
        let origin = draft.origin("high");
        let yields_mesh = |at: usize| self.drafts[at].kind() == Some(Kind::Merge);
        match self.find(id) {
            Some(at) if at >= index => {
                self.forward("high", id, at == index, origin);
                None
            }
            Some(at) if yields_mesh(at) => {
                self.used[at] = true;
                Some(at)
            }
            Some(at) => {
                self.used[at] = true;
                let gives = self.flows.get(at).map_or(What::Unknown, |flow| flow.what);
                if gives == What::Unknown && self.drafts[at].kind().is_none() {
                    return None;
                }
                let kind = self.drafts[at].kind().map_or("", Kind::as_str);
                let message = format!("`high` needs a mesh, and `{id}` is a {kind} stage that gives levels");
                let help = suggest("stages that give a mesh", "", &self.earlier(index, yields_mesh));
                self.report.add(Code::ChainHigh, origin, message, "gives no mesh", help);
                None
            }
            None => {
                let meshes = self.earlier(index, yields_mesh);
                let help = match nearest(id, self.earlier(index, |_| true)) {
                    Some(near) => Some(format!("did you mean `{near}`?")),
                    None => suggest("stages that give a mesh", "", &meshes),
                };
                self.report.add(Code::ChainHigh, origin, format!("no stage has the id `{id}`"), "no such stage", help);
                None
            }
        }
    }

    fn refuse(&mut self, index: usize, code: Code, message: String, label: &str, help: &str) -> Flow {
        let draft = &self.drafts[index];
        // Where the input was chosen by hand, the choice is what to look at.
        let by_input = matches!(code, Code::ChainInput | Code::ChainLevels | Code::ChainOrder | Code::ChainBakeUnlaid);
        let origin = draft.origin(if by_input && draft.from.is_some() { "from" } else { "kind" }).clone();
        self.report.add(code, &origin, message, label, Some(help.to_owned()));
        Flow::UNKNOWN
    }

    /// What the stage gives, after checking what it takes.
    fn step(&mut self, index: usize, incoming: &Flow) -> Flow {
        let draft = &self.drafts[index];
        let Some(settings) = &draft.settings else { return Flow::UNKNOWN };
        let kind = settings.kind();
        // What a stage gives is known even where it cannot take what comes in.
        if incoming.what == What::Container && kind != Kind::Pack {
            // The pack that is not last gets the message.
            return Flow::UNKNOWN;
        }
        match settings {
            StageSettings::Merge(_) => {
                if !matches!(incoming.what, What::Asset | What::Unknown) {
                    let message = format!("merge takes the asset, not {}", incoming.what.describe());
                    self.refuse(index, Code::ChainInput, message, "not first", "merge is the first stage");
                }
                Flow { what: What::Mesh, count: Some(1), budget: Some(LevelBudget::Keep(1.0)), ..Flow::UNKNOWN }
            }
            StageSettings::Simplify(options) => {
                let count = (!options.levels.is_empty()).then_some(options.levels.len());
                let budget = if count == Some(1) { options.levels.first().copied() } else { None };
                let gives = Flow { what: What::Levels, count, budget, atlas: incoming.atlas, baked: incoming.baked };
                let levels = options.levels.clone();
                let rebuilds = options.normals == Normals::Rebuild;
                let places = options.metric.metric == Metric::Memoryless && options.placement == Placement::HalfEdge;
                match incoming.what {
                    What::Asset => {
                        let message = String::from("simplify takes a mesh, not the asset");
                        let help = "put a merge stage before it";
                        self.refuse(index, Code::ChainInput, message, "no merge before", help);
                    }
                    _ if incoming.baked => {
                        let message = String::from("a simplify after a bake is not supported in this version");
                        let help = "move it before the bake: levels of one layout share the maps baked at the finest";
                        return self.refuse(index, Code::ChainOrder, message, "after a bake", help);
                    }
                    What::Levels => self.one_level(index, incoming, "simplify"),
                    _ => {}
                }
                if rebuilds && incoming.atlas.is_some() {
                    let origin = draft.origin("normals");
                    let message = "normals cannot be rebuilt after an atlas: its levels share one tangent-space map";
                    let help = Some(String::from("rebuild them in the simplify stage before the atlas"));
                    self.report.add(Code::ChainNormals, origin, message, "after an atlas", help);
                }
                if places {
                    let origin = draft.origin("metric");
                    let message = "the metric `memoryless` places points freely, and `placement` is \"half-edge\"";
                    let help = Some(String::from("add placement = \"free\""));
                    self.report.add(Code::ChainPlacement, origin, message, "needs free placement", help);
                }
                self.levels(index, &levels, incoming);
                gives
            }
            StageSettings::Atlas(atlas) => {
                let (sheets, most) =
                    (atlas.sheets.unwrap_or(1), kiln_bake::atlas::AtlasOptions::most_sheets(atlas.size));
                if sheets > most {
                    let message = format!("{sheets} sheets of {} texels do not lie side by side", atlas.size);
                    let help =
                        format!("`sheets` is at most {most} at that size: UVs beyond are too coarse for its texels");
                    self.report.add(Code::ValueRange, draft.origin("sheets"), message, "too many", Some(help));
                }
                let gives = Flow { what: What::Levels, atlas: Some(index), count: Some(1), ..incoming.clone() };
                match incoming.what {
                    What::Asset | What::Mesh => {
                        let message = format!("atlas takes one level, not {}", incoming.what.describe());
                        let help = "put a simplify stage before it; levels = [ { keep = 1.0 } ] changes nothing";
                        self.refuse(index, Code::ChainInput, message, "no simplify before", help);
                    }
                    _ if incoming.baked || incoming.atlas.is_some() => {
                        let message = String::from("a second atlas is not supported in this version");
                        let help = "leave one atlas and one bake in the chain";
                        return self.refuse(index, Code::ChainOrder, message, "the second atlas", help);
                    }
                    What::Levels => self.one_level(index, incoming, "atlas"),
                    _ => {}
                }
                gives
            }
            StageSettings::Bake(bake) => {
                match incoming.what {
                    What::Unknown => {}
                    _ if incoming.baked => {
                        let message = String::from("a second bake is not supported in this version");
                        let help = "name all textures in the first bake's `maps`";
                        return self.refuse(index, Code::ChainOrder, message, "the second bake", help);
                    }
                    // The model's own layout will do, if it holds; what is wrong with it is said when it is looked at.
                    _ if incoming.atlas.is_none() && bake.method == BakeMethod::Correspondence => {}
                    _ if incoming.atlas.is_none() => {
                        let message = String::from("bake has no atlas before it to write into");
                        let help = "put an atlas stage between the simplify stages, or leave the bake out; method = \"correspondence\" bakes into the model's own layout";
                        self.refuse(index, Code::ChainBakeUnlaid, message, "no atlas before", help);
                    }
                    _ => {}
                }
                Flow { what: What::Levels, count: incoming.count, budget: None, atlas: None, baked: true }
            }
            StageSettings::Pack(_) => {
                if matches!(incoming.what, What::Asset | What::Mesh) {
                    let message = format!("pack takes levels, not {}", incoming.what.describe());
                    let help = "put a simplify stage before it; levels = [ { keep = 1.0 } ] packs the mesh as it is";
                    self.refuse(index, Code::ChainInput, message, "no levels before", help);
                }
                Flow { what: What::Container, ..Flow::UNKNOWN }
            }
        }
    }

    fn one_level(&mut self, index: usize, incoming: &Flow, who: &str) {
        if let Some(count) = incoming.count.filter(|count| *count != 1) {
            let message = format!("{who} starts from one level, and {count} come in");
            let help = "put further levels into the last simplify stage; a stage before it has one";
            self.refuse(index, Code::ChainLevels, message, "several levels come in", help);
        }
    }

    /// Levels get coarser; the first may equal what comes in.
    fn levels(&mut self, index: usize, levels: &[LevelBudget], incoming: &Flow) {
        let draft = &self.drafts[index];
        for (at, level) in levels.iter().enumerate() {
            let origin = draft.origin(&format!("levels[{at}]"));
            // Only like can be compared with like before anything runs.
            let finer = levels[..at].iter().rev().find_map(|earlier| coarser(*earlier, *level).map(|c| (*earlier, c)));
            if let Some((earlier, is_coarser)) = finer {
                if !is_coarser {
                    let message = format!("levels get coarser: {} does not come after {}", said(*level), said(earlier));
                    let help = Some(String::from("finest first, each with fewer triangles or a greater error"));
                    self.report.add(Code::LevelOrder, origin, message, "not coarser", help);
                }
                continue;
            }
            let Some(left) = incoming.budget else { continue };
            if coarser(left, *level) == Some(false) && left != *level {
                let message = format!("{} is finer than the {} that comes in", said(*level), said(left));
                let help = match level {
                    LevelBudget::Keep(_) => "`keep` is the share of the SOURCE asset's triangles, in every stage",
                    LevelBudget::Triangles(_) => "a level cannot have more triangles than the mesh that it is cut from",
                    LevelBudget::Error(_) => "`error` is measured against the SOURCE asset, in every stage",
                };
                self.report.add(Code::LevelAbove, origin, message, "finer than what is left", Some(help.to_owned()));
            }
        }
    }

    /// What rules for submeshes refer to: a level that the stage has, a rule that is there, and never themselves.
    fn rules(&mut self, index: usize, inputs: &[Option<StageInput>]) {
        let drafts = self.drafts;
        let Some(StageSettings::Simplify(own)) = &drafts[index].settings else { return };
        // Rules of earlier stages hold on: theirs first, so that later ones win.
        let mut all: Vec<&SubmeshRule> = own.submesh.0.iter().collect();
        let mut at = index;
        while let Some(StageInput::Stage(before)) = inputs[at] {
            if let Some(StageSettings::Simplify(earlier)) = &drafts[before].settings {
                all.splice(0..0, &earlier.submesh.0);
            }
            at = before;
        }
        let first_own = all.len() - own.submesh.0.len();
        let named = |name: &str| all.iter().rposition(|rule| rule.name == name);
        for (at, rule) in own.submesh.0.iter().enumerate() {
            let origin = |key: &str| drafts[index].origin(&format!("submesh[{at}].{key}"));
            match &rule.level {
                RuleLevel::Keep(_) => {}
                RuleLevel::Level(level) if own.levels.is_empty() || (*level as usize) < own.levels.len() => {}
                RuleLevel::Level(level) => {
                    let count = own.levels.len();
                    let some = if count == 1 { "one level" } else { &format!("{count} levels") };
                    let message = format!("the stage has {some}, and `level` names number {level}");
                    let help = format!("levels are counted from 0, the finest, to {}", count - 1);
                    self.report.add(Code::RuleLevel, origin("level"), message, "no such level", Some(help));
                }
                RuleLevel::Relative { to, .. } => {
                    let mut next = named(to);
                    if next.is_none() {
                        let names: Vec<&str> = all.iter().map(|rule| rule.name.as_str()).collect();
                        let help = suggest("names of rules", to, &names);
                        let message = format!("no rule has the name `{to}`");
                        self.report.add(Code::RuleUnknown, origin("relative-to"), message, "no such rule", help);
                    }
                    // Each step leads to another rule; more steps than rules lead in a ring.
                    let mut way = vec![rule.name.as_str()];
                    while let Some(on) = next.filter(|_| way.len() <= all.len()) {
                        way.push(&all[on].name);
                        if on == first_own + at {
                            let message = "a rule cannot be relative to itself";
                            let help = Some(format!("the way round: {}", way.join(" -> ")));
                            self.report.add(Code::RuleCycle, origin("relative-to"), message, "leads back", help);
                            break;
                        }
                        next = match &all[on].level {
                            RuleLevel::Relative { to, .. } => named(to),
                            _ => None,
                        };
                    }
                }
            }
        }
    }

    /// The last stage packs, and no other.
    fn pack(&mut self) {
        let packs: Vec<usize> =
            (0..self.drafts.len()).filter(|index| self.drafts[*index].kind() == Some(Kind::Pack)).collect();
        let Some(last) = self.drafts.len().checked_sub(1) else { return };
        match packs[..] {
            [] => {
                // A stage whose kind could not be read may have been meant as the pack.
                if self.drafts.iter().all(|draft| draft.kind().is_some()) {
                    let origin = self.drafts[last].header.clone();
                    let help = Some(String::from("end the pipeline with [[stage]] kind = \"pack\""));
                    self.report.add(Code::ChainPack, &origin, "nothing packs the result", "the last stage", help);
                }
            }
            [only] if only == last => {}
            [only] => {
                let message = String::from("pack is the last stage");
                self.refuse(only, Code::ChainPack, message, "not last", "move it to the end of the pipeline");
            }
            [_, ref more @ ..] => {
                for extra in more {
                    let message = String::from("a pipeline packs once");
                    let help = "one pack writes every layout: name them in its `layouts`";
                    self.refuse(*extra, Code::ChainPack, message, "a second pack", help);
                }
            }
        }
    }

    /// Layouts that ask something of the levels: a sliding window and shared vertices are cut from one sequence of half-edge collapses.
    fn layouts(&mut self, inputs: &[Option<StageInput>]) {
        let drafts = self.drafts;
        let Some(last) = drafts.len().checked_sub(1) else { return };
        let Some(StageSettings::Pack(pack)) = &drafts[last].settings else { return };
        let window = pack.layouts.contains(&PackLayout::SlidingWindow);
        let who = match pack.vertices {
            _ if window => "a sliding window",
            PackVertices::Shared => "a shared vertex buffer",
            PackVertices::Own => return,
        };
        let mut at = last;
        while let Some(StageInput::Stage(before)) = inputs[at] {
            at = before;
            let Some(StageSettings::Simplify(options)) = &drafts[at].settings else { continue };
            let name = drafts[at].name();
            let mut refuse = |what: &str, key: &str, label: &str, help: &str| {
                let message = format!("{who} needs {what} in `{name}`");
                self.report.add(Code::ChainLayout, drafts[at].origin(key), message, label, Some(help.to_owned()));
            };
            if options.placement == Placement::Free {
                let help = "with placement = \"half-edge\" every level uses vertices of the finest";
                refuse("placement = \"half-edge\"", "placement", "moves points", help);
            }
            if options.normals == Normals::Rebuild {
                let help = "rebuild them in a simplify stage of one level before it";
                refuse("normals = \"keep\"", "normals", "makes new ones at each level", help);
            }
            if window && options.prune.is_some() {
                let help = "leave `prune` out: loose components go by collapses as far as they can";
                refuse("levels without `prune`", "prune", "no collapse tells what went", help);
            }
            let ruled = |draft: &Draft| match &draft.settings {
                Some(StageSettings::Simplify(options)) => !options.submesh.0.is_empty(),
                _ => false,
            };
            // Rules hold for all later stages.
            let mut ruling = Some(at).filter(|at| ruled(&drafts[*at]));
            let mut earlier = at;
            while let (None, Some(StageInput::Stage(before))) = (ruling, inputs[earlier]) {
                earlier = before;
                ruling = Some(earlier).filter(|at| ruled(&drafts[*at]));
            }
            if let Some(ruling) = ruling.filter(|_| window) {
                let message = format!("{who} has one order of collapses, and rules for submeshes ask for others");
                let help = Some(String::from("leave the rules or the layout out"));
                let origin = drafts[ruling].origin("submesh[0].name");
                self.report.add(Code::ChainLayout, origin, message, "a rule of its own", help);
            }
            return;
        }
    }

    /// Atlases that nothing bakes and stages that nothing takes.
    fn left_over(&mut self, inputs: &[Option<StageInput>]) {
        // With a stage that could not be read or placed, nobody knows what it would have taken.
        let unread = self.drafts.iter().any(|draft| draft.kind().is_none()) || inputs.iter().any(Option::is_none);
        if unread {
            return;
        }
        let mut baked = vec![false; self.drafts.len()];
        for (index, draft) in self.drafts.iter().enumerate() {
            if draft.kind() == Some(Kind::Bake) {
                let mut at = index;
                while let Some(StageInput::Stage(before)) = inputs[at] {
                    baked[before] = true;
                    at = before;
                }
            }
        }
        for (index, baked) in baked.into_iter().enumerate() {
            let kind = self.drafts[index].kind();
            if kind == Some(Kind::Atlas) && !baked {
                let message = String::from("the atlas has no bake after it");
                let help = "add a bake stage, or leave the atlas out to keep the model's own UVs and textures";
                self.refuse(index, Code::ChainAtlasUnbaked, message, "never baked", help);
            } else if !self.used[index] && kind != Some(Kind::Pack) && index + 1 != self.drafts.len() {
                let name = self.drafts[index].name().to_owned();
                let origin = self.drafts[index].header.clone();
                let help = Some(String::from("remove it, or name it in a later stage's `from`"));
                let message = format!("no later stage takes what `{name}` makes");
                self.report.add(Code::ChainUnused, &origin, message, "unused", help);
            }
        }
    }
}

/// Whether `next` is coarser than `before`; `None` where the two cannot be compared before anything runs.
fn coarser(before: LevelBudget, next: LevelBudget) -> Option<bool> {
    match (before, next) {
        (LevelBudget::Keep(before), LevelBudget::Keep(next)) => Some(next < before),
        (LevelBudget::Triangles(before), LevelBudget::Triangles(next)) => Some(next < before),
        (LevelBudget::Error(before), LevelBudget::Error(next)) => compare(before, next).map(|order| order.is_lt()),
        _ => None,
    }
}

fn compare(a: Length, b: Length) -> Option<std::cmp::Ordering> {
    match (a.unit, b.unit) {
        (Unit::Diag, Unit::Diag) => a.value.partial_cmp(&b.value),
        _ => a.absolute()?.partial_cmp(&b.absolute()?),
    }
}

fn said(level: LevelBudget) -> String {
    match level {
        LevelBudget::Keep(keep) => format!("keep = {}", super::value::number(keep)),
        LevelBudget::Triangles(triangles) => format!("triangles = {triangles}"),
        LevelBudget::Error(error) => format!("error = \"{error}\""),
    }
}
