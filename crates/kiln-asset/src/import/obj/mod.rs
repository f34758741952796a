//! Wavefront OBJ: lines of text that list positions, UVs and normals, and polygons over them.
//!
//! **Problem.** As for glTF (see the page above): everything that the text says is taken as it stands or refused with its line.
//!
//! **Method.**
//! ```text
//! statements   `v`, `vt`, `vn` into pools; `f` into polygons of (position, UV, normal), negative indices counted from
//!              where they stand; `o`, `g`, `usemtl` choose the part that polygons go to
//! indices      against the pools of the whole file, since `f` may stand before `v`
//! materials    the libraries' definitions of what polygons use                                    (mtl)
//! polygons     cut into triangles, one vertex for every different corner of a part        (polygon, soup)
//! flatten      as for glTF
//! ```
//! **Rules.** One submesh for every (object, group, material) in the order of its first polygon, named by object, or group, or
//! `object/group`, or `mesh0`; where such a base has several materials then `/` and the material's name. An `o` ends the group.
//! V is turned over (OBJ's points up). Colours behind a position are sRGB, as Blender and MeshLab write them; the weight of a position
//! has no meaning for polygons. Polygons without `usemtl` have no material. Libraries are read in the order in which they are
//! named; the first definition of a material counts. `mtllib a b.mtl` is one name with a space if there is such a file, else
//! two. Smoothing groups have no influence.
//!
//! **Limits.** Points, lines, free-form curves and surfaces are not carried, and listed. The crates `tobj` 4.0.5
//! and `obj` 0.10.2 were looked at and left. Both stop at the first error and know no continued lines; `tobj` does not tell the line,
//! panics on `Kd 1 2`, takes index 0 for none and NaN for a place, refuses comments behind numbers and text that is not UTF-8, and
//! fans concave polygons.
//!
//! **Source.** Wavefront Technologies, The Advanced Visualizer, Appendix B1, "Object Files (.obj)".

mod mtl;

use std::collections::{BTreeMap, BTreeSet};

use glam::{Vec2, Vec3};

use super::ImportLimits;
use super::error::{Defects, ImportError};
use super::picture::{Pictures, file_beside};
use super::report::{ImportReport, ModelFormat, Notes, RepairKind};
use super::soup::{self, Corner, Left, NONE, Part, Soup, linear_from_srgb};
use super::source::{Failure, Sources};
use super::text::{Lines, excerpt, lossy, number, split_keyword, values, words};
use crate::Asset;
use crate::material::Material;

/// Most material libraries of one model.
const MOST_LIBRARIES: usize = 256;
/// Longest name that is kept, characters.
const LONGEST_NAME: usize = 1024;

/// The model in the text `bytes` of the file `main`.
pub(super) fn import(
    main: &str,
    bytes: &[u8],
    sources: &mut Sources<'_>,
    limits: &ImportLimits,
) -> Result<(Asset, ImportReport), ImportError> {
    let mut text = Text::new(main, limits);
    let mut lines = Lines::new(bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes));
    while let Some((line, statement)) = lines.statement() {
        text.statement(line, &statement);
    }
    text.check_indices();
    let Text { soup, parts, materials, libraries, mut defects, mut notes, left, generator, .. } = text;
    left.finish(&mut notes);

    let mut pictures = Pictures::new(sources, &limits.images);
    let library = read_libraries(main, &libraries, pictures.sources, &mut defects, &mut notes);
    for used in &materials {
        let material = match library.get(used.name.as_str()) {
            Some(definition) => definition.material(&mut pictures, &mut defects, &mut notes),
            None => {
                notes.repair(RepairKind::MaterialUndefined, 1, || format!("`{}` in line {}", used.name, used.line));
                mtl::plain(&used.name)
            }
        };
        pictures.set.materials.push(material);
    }
    let unused = library.len() - materials.iter().filter(|used| library.contains_key(used.name.as_str())).count();
    notes.not_carried("materials that no polygon uses", unused as u64);
    defects.check()?;

    let parts = name_parts(&parts, &pictures.set.materials);
    let mut report = ImportReport { format: ModelFormat::Obj, generator, ..Default::default() };
    report.meshes = parts.base_count;
    report.stored_vertices = soup.positions.len() as u64;
    let primitives = soup.into_primitives(
        main,
        &parts.list,
        |line| format!("line {line}"),
        |line| format!("{main}:{line}"),
        &mut defects,
        &mut notes,
    );
    soup::finish(main, parts.list, primitives, pictures, report, defects, notes)
}

/// A material in use, and the line of its first polygon.
struct UsedMaterial {
    name: String,
    line: u64,
}

/// Where polygons go.
struct PartKey {
    object: String,
    group: String,
    material: Option<usize>,
}

/// What the statements read so far have said.
struct Text<'a> {
    main: &'a str,
    soup: Soup,
    parts: Vec<PartKey>,
    part_of: BTreeMap<(String, String, Option<String>), u32>,
    materials: Vec<UsedMaterial>,
    material_of: BTreeMap<String, usize>,
    libraries: Vec<(u64, Vec<u8>)>,
    object: String,
    group: String,
    material: Option<String>,
    /// Part of the names above, once a polygon asked for it.
    part: Option<u32>,
    generator: String,
    defects: Defects,
    notes: Notes,
    left: Left,
}

impl<'a> Text<'a> {
    fn new(main: &'a str, limits: &ImportLimits) -> Text<'a> {
        Text {
            main,
            soup: Soup::new(limits),
            parts: Vec::new(),
            part_of: BTreeMap::new(),
            materials: Vec::new(),
            material_of: BTreeMap::new(),
            libraries: Vec::new(),
            object: String::new(),
            group: String::new(),
            material: None,
            part: None,
            generator: String::new(),
            defects: Defects::default(),
            notes: Notes::default(),
            left: Left::default(),
        }
    }

    fn invalid(&mut self, line: u64, message: impl Into<String>) {
        self.defects.invalid(format!("{}:{line}", self.main), message);
    }

    fn statement(&mut self, line: u64, statement: &[u8]) {
        let (keyword, rest) = split_keyword(statement);
        match keyword {
            b"" => {}
            b"v" => self.position(line, rest),
            b"vt" => self.uv(line, rest),
            b"vn" => self.normal(line, rest),
            b"f" | b"fo" => self.polygon(line, rest),
            b"o" => {
                self.object = lossy(rest, LONGEST_NAME);
                self.group.clear();
                self.part = None;
            }
            b"g" => {
                self.group = lossy(rest, LONGEST_NAME);
                self.part = None;
            }
            b"usemtl" => {
                self.material = (!rest.is_empty()).then(|| lossy(rest, LONGEST_NAME));
                self.part = None;
            }
            b"mtllib" => self.libraries.push((line, rest.to_vec())),
            b"s" => {}
            b"l" => self.left.add("lines", 1),
            b"p" => self.left.add("points", 1),
            comment if comment[0] == b'#' => {
                if line == 1 {
                    let text = statement.trim_ascii().trim_ascii_start();
                    self.generator = lossy(text.get(1..).unwrap_or_default().trim_ascii(), 100);
                }
            }
            b"vp" | b"cstype" | b"deg" | b"bmat" | b"step" | b"curv" | b"curv2" | b"surf" | b"parm" | b"trim"
            | b"hole" | b"scrv" | b"sp" | b"end" | b"con" => self.left.add("statements of free-form geometry", 1),
            other => self.left.add(format!("statement {}", excerpt(other)), 1),
        }
    }

    /// The numbers of a statement: at least `least`, at most `MOST`. The rest are 0.
    fn numbers<const MOST: usize>(&mut self, line: u64, rest: &[u8], least: usize) -> Option<([f32; MOST], usize)> {
        let mut found = [0.0; MOST];
        let mut count = 0;
        for word in values(rest) {
            let Some(value) = number(word) else {
                self.invalid(line, format!("{} is no number", excerpt(word)));
                return None;
            };
            if count == MOST {
                self.invalid(line, format!("more than {MOST} numbers"));
                return None;
            }
            found[count] = value;
            count += 1;
        }
        if count < least {
            self.invalid(line, format!("{count} numbers, at least {least} expected"));
            return None;
        }
        Some((found, count))
    }

    fn position(&mut self, line: u64, rest: &[u8]) {
        let read = self.numbers::<8>(line, rest, 3);
        let ([x, y, z, more @ ..], count) = read.unwrap_or_default();
        let position = Vec3::new(x, y, z);
        if !position.is_finite() {
            self.invalid(line, format!("lies at {position}: not finite"));
        }
        // x y z, x y z w, x y z r g b, x y z r g b a.
        let [r, g, b, a, _] = more;
        let color = match count {
            6 => Some([r, g, b, 1.0]),
            7 => Some([r, g, b, a]),
            5 | 8 => {
                self.invalid(line, format!("{count} numbers; 3, or 4 with weight, or 6 or 7 with colour expected"));
                None
            }
            _ => None,
        };
        let color = color.map(|code| linear_from_srgb(code, || format!("line {line}"), &mut self.notes));
        let colors = &mut self.soup.colors;
        if color.is_some() || !colors.is_empty() {
            // Those before the first colour have none.
            colors.resize(self.soup.positions.len(), None);
            colors.push(color);
        }
        // A broken one is kept too, so that indices keep their meaning.
        self.soup.positions.push(position);
    }

    fn uv(&mut self, line: u64, rest: &[u8]) {
        let ([u, v, _], _) = self.numbers::<3>(line, rest, 1).unwrap_or_default();
        self.soup.uvs.push(Vec2::new(u, 1.0 - v));
    }

    fn normal(&mut self, line: u64, rest: &[u8]) {
        let ([x, y, z], _) = self.numbers::<3>(line, rest, 3).unwrap_or_default();
        self.soup.normals.push(Vec3::new(x, y, z));
    }

    fn polygon(&mut self, line: u64, rest: &[u8]) {
        let sizes = [self.soup.positions.len(), self.soup.uvs.len(), self.soup.normals.len()];
        for word in values(rest) {
            match corner(word, sizes) {
                Ok(corner) => self.soup.corners.push(corner),
                Err(message) => {
                    self.soup.drop_open();
                    return self.invalid(line, format!("corner {}: {message}", excerpt(word)));
                }
            }
        }
        let count = self.soup.open_corners();
        if count < 3 {
            self.soup.drop_open();
            return self.invalid(line, format!("a polygon of {count} corners"));
        }
        let part = match self.part {
            Some(part) => part,
            None => self.choose_part(line),
        };
        self.soup.close_polygon(line, part);
    }

    /// The part of the present object, group and material.
    fn choose_part(&mut self, line: u64) -> u32 {
        let key = (self.object.clone(), self.group.clone(), self.material.clone());
        let part = match self.part_of.get(&key) {
            Some(part) => *part,
            None => {
                let material = self.material.as_ref().map(|name| {
                    *self.material_of.entry(name.clone()).or_insert_with(|| {
                        self.materials.push(UsedMaterial { name: name.clone(), line });
                        self.materials.len() - 1
                    })
                });
                let (object, group, _) = key.clone();
                self.parts.push(PartKey { object, group, material });
                let part = self.parts.len() as u32 - 1;
                self.part_of.insert(key, part);
                part
            }
        };
        self.part = Some(part);
        part
    }

    /// Every index against the whole file's lists.
    fn check_indices(&mut self) {
        let sizes = [self.soup.positions.len(), self.soup.uvs.len(), self.soup.normals.len()];
        let ends = self.soup.polygons.iter().skip(1).map(|p| p.first).chain([self.soup.corners.len()]);
        for (polygon, end) in self.soup.polygons.iter().zip(ends) {
            for corner in &self.soup.corners[polygon.first..end] {
                let indices = [corner.position, corner.uv, corner.normal];
                for ((index, size), what) in indices.iter().zip(sizes).zip(["v", "vt", "vn"]) {
                    if *index != NONE && *index as usize >= size {
                        let message =
                            format!("a corner refers to `{what}` {}, but there are {size}", *index as u64 + 1);
                        self.defects.invalid(format!("{}:{}", self.main, polygon.place), message);
                    }
                }
            }
        }
    }
}

/// `v`, `v/vt`, `v//vn` or `v/vt/vn`. `sizes`: how many of each the file has listed so far.
fn corner(word: &[u8], sizes: [usize; 3]) -> Result<Corner, String> {
    let mut indices = [NONE; 3];
    let mut parts = word.split(|b| *b == b'/');
    for (k, what) in ["v", "vt", "vn"].into_iter().enumerate() {
        let Some(digits) = parts.next() else { break };
        if !digits.is_empty() {
            indices[k] = index(digits, sizes[k], what)?;
        } else if k == 0 {
            return Err("it has no position".into());
        }
    }
    if parts.next().is_some() {
        return Err("it has more than three indices".into());
    }
    Ok(Corner { position: indices[0], uv: indices[1], normal: indices[2] })
}

/// An index as the file spells it, from 0: counted from 1, or backwards from the last one if negative.
fn index(digits: &[u8], size: usize, what: &str) -> Result<u32, String> {
    let text = std::str::from_utf8(digits).ok();
    let value: i64 =
        text.and_then(|text| text.parse().ok()).ok_or_else(|| format!("{} is no index", excerpt(digits)))?;
    let index = match value {
        0 => return Err(format!("`{what}` 0; they are counted from 1")),
        1.. => value - 1,
        _ => size as i64 + value,
    };
    if index < 0 {
        return Err(format!("`{what}` {value}, but {size} stand before it"));
    }
    u32::try_from(index).ok().filter(|index| *index != NONE).ok_or_else(|| format!("`{what}` {value} is out of range"))
}

struct NamedParts {
    list: Vec<Part>,
    base_count: u64,
}

/// Wished names by the rule of the page.
fn name_parts(keys: &[PartKey], materials: &[Material]) -> NamedParts {
    let base = |key: &PartKey| match (key.object.trim(), key.group.trim()) {
        ("", "") => "mesh0".to_owned(),
        ("", name) | (name, "") => name.to_owned(),
        (object, group) if object == group => object.to_owned(),
        (object, group) => format!("{object}/{group}"),
    };
    let mut counts: BTreeMap<String, u32> = BTreeMap::new();
    keys.iter().for_each(|key| *counts.entry(base(key)).or_default() += 1);
    let part = |(k, key): (usize, &PartKey)| {
        let base = base(key);
        let material = key.material.map_or("", |m| materials[m].name.trim());
        let name = match (counts[&base], material) {
            (1, _) => base,
            (_, "") => format!("{base}/{k}"),
            (_, material) => format!("{base}/{material}"),
        };
        Part { name, material: key.material }
    };
    NamedParts { list: keys.iter().enumerate().map(part).collect(), base_count: counts.len() as u64 }
}

/// All definitions of the libraries, by name.
fn read_libraries(
    main: &str,
    named: &[(u64, Vec<u8>)],
    sources: &mut Sources<'_>,
    defects: &mut Defects,
    notes: &mut Notes,
) -> BTreeMap<String, mtl::Definition> {
    let mut out = BTreeMap::new();
    let mut seen: BTreeSet<Vec<u8>> = BTreeSet::new();
    for (line, names) in named {
        let path = format!("{main}:{line}");
        // One name with spaces, or several.
        let whole = [names.as_slice()];
        let split: Vec<&[u8]> = words(names).collect();
        if split.is_empty() {
            defects.invalid(path.clone(), "`mtllib` without a file's name");
            continue;
        }
        for (several, list) in [(false, whole.as_slice()), (true, split.as_slice())] {
            let last = several || split.len() == 1;
            let mut missing = false;
            for name in list {
                if !seen.insert(name.to_vec()) {
                    continue;
                }
                if seen.len() > MOST_LIBRARIES {
                    defects.invalid(path, format!("more than {MOST_LIBRARIES} material libraries"));
                    return out;
                }
                missing |= !read_library(&path, *line, name, last, sources, &mut out, defects, notes);
            }
            if last || !missing {
                break;
            }
        }
    }
    out
}

/// Reads a library; false if there is no such file. `told`: that is worth a note.
#[allow(clippy::too_many_arguments, reason = "one caller; the pieces belong to it")]
fn read_library(
    path: &str,
    line: u64,
    name: &[u8],
    told: bool,
    sources: &mut Sources<'_>,
    out: &mut BTreeMap<String, mtl::Definition>,
    defects: &mut Defects,
    notes: &mut Notes,
) -> bool {
    let name = String::from_utf8_lossy(name);
    let outcome = file_beside("", &name, || format!("line {line}"), notes)
        .map_err(Failure::Invalid)
        .and_then(|file| sources.file(&file).map(|bytes| (file, bytes)));
    match outcome {
        Ok((file, bytes)) => mtl::read(&file, &bytes, out, defects, notes),
        Err(Failure::Missing(message)) => {
            notes.repair(RepairKind::LibraryMissing, told as u64, || format!("line {line}: {message}"));
            return false;
        }
        Err(Failure::Invalid(message)) => defects.invalid(path, message),
        Err(Failure::Io(message)) => defects.io(path, message),
    }
    true
}
