//! PLY, the polygon file format: a header in text that declares rows of numbers, then the rows as text or binary.
//!
//! **Problem.** As for glTF (see the page above): what the header promises must be there and mean something, or the place of what is
//! wrong is told: `element face[12].vertex_indices`.
//!
//! **Method.**
//! ```text
//! header      encoding, elements, properties; counts against the bytes left, before anything is allocated    (header)
//! vertex      rows into positions, normals, UVs, colours                                                     (rows)
//! face        lists of indices into polygons; lists of UVs by corner
//! other       passed over and counted
//! polygons    cut into triangles, one vertex for every different corner                             (polygon, soup)
//! flatten     as for glTF
//! ```
//! **Rules.** Read of `vertex`: `x y z`, `nx ny nz`, UVs called `s t`, `u v` or `texture_u texture_v` (V is turned over: it
//! points up here), `red green blue alpha`, each in any type. Colours in integers are sRGB over the type's range and become
//! linear; colours in floats are linear already. Read of `face`: `vertex_indices` or `vertex_index`, and MeshLab's `texcoord` (two
//! numbers a corner; the vertices' own UVs are left out then) and `texnumber`. `comment TextureFile` names base colour pictures: each is a
//! material without metal. One submesh `mesh0`, or one for each picture in the order of use, `mesh0/` and its name. Without
//! pictures there is no material.
//!
//! **Limits.** Point clouds and triangle strips are refused by name. A row of a text must be one line. The crate `ply-rs-bw` 4.0.1 was
//! looked at and left: it refuses `.5` and `nan`, lets a repeated property shift the layout silently, refuses headers that are
//! not UTF-8, stops at the first error and does not tell its property. With a checked header before it, nothing would be left of
//! it but the decoding of eight types of numbers.
//!
//! **Source.** G. Turk, "The PLY polygon file format", Stanford University, 1994.

mod header;
mod rows;

use std::collections::{BTreeMap, HashMap};

use glam::{Vec2, Vec3, Vec4};

use self::header::{Element, Header, Scalar};
use self::rows::{Fault, Row, Rows};
use super::ImportLimits;
use super::error::{Defects, ImportError};
use super::picture::{Pictures, file_beside};
use super::report::{ImportReport, ModelFormat, Notes, RepairKind};
use super::soup::{self, Corner, Left, NONE, Part, Soup, linear_from_srgb};
use super::source::Sources;
use crate::Asset;
use crate::material::Material;

/// The model in the `bytes` of the file `main`.
pub(super) fn import(
    main: &str,
    bytes: &[u8],
    sources: &mut Sources<'_>,
    limits: &ImportLimits,
) -> Result<(Asset, ImportReport), ImportError> {
    let mut defects = Defects::default();
    let Some(header) = header::read(main, bytes, &mut defects) else {
        defects.check()?;
        return Err(ImportError::invalid(main, "the header cannot be read"));
    };
    check_counts(main, &header, limits, &mut defects);
    defects.check()?;

    let find = |name: &str| header.elements.iter().find(|e| e.name == name);
    let mut reader = Reader {
        vertex_count: find("vertex").map_or(0, |e| e.count),
        normals: find("vertex").and_then(normal_columns),
        uvs: find("vertex").and_then(uv_columns).filter(|_| find("face").and_then(corner_uvs).is_none()),
        soup: Soup::new(limits),
        texture_count: header.texture_files.len(),
        parts: Vec::new(),
        part_of: BTreeMap::new(),
        uv_ids: HashMap::new(),
        defects,
        notes: Notes::default(),
        left: Left::default(),
    };
    let outcome = reader.read(&header);
    let Reader { soup, parts, mut defects, mut notes, left, .. } = reader;
    left.finish(&mut notes);
    if let Err(fault) = outcome {
        defects.invalid(fault.0, fault.1);
    }

    let mut pictures = Pictures::new(sources, &limits.images);
    let materials = read_materials(&header, &parts, &mut pictures, &mut defects, &mut notes);
    let part = |number: &Option<usize>| {
        let material = number.map(|number| materials[&number]);
        let name = material.map_or("", |m| pictures.set.materials[m].name.as_str());
        let name = if parts.len() < 2 || name.is_empty() { "mesh0".to_owned() } else { format!("mesh0/{name}") };
        Part { name, material }
    };
    let parts: Vec<Part> = parts.iter().map(part).collect();
    defects.check()?;
    let generator = header.generator;
    let mut report = ImportReport { format: ModelFormat::Ply, generator, meshes: 1, ..Default::default() };
    report.stored_vertices = soup.positions.len() as u64;
    let place = |face: u64| format!("element face[{face}]");
    let path = |face: u64| format!("element face[{face}].vertex_indices");
    let primitives = soup.into_primitives(main, &parts, place, path, &mut defects, &mut notes);
    soup::finish(main, parts, primitives, pictures, report, defects, notes)
}

/// The header's counts against the bytes behind it, and the elements that a mesh needs.
fn check_counts(main: &str, header: &Header<'_>, limits: &ImportLimits, defects: &mut Defects) {
    // The last value of a text may end with it.
    let mut left = header.body.len() as u64 + 1;
    for element in &header.elements {
        let least = element.least_bytes(header.encoding).saturating_mul(element.count);
        if least > left {
            let message = format!(
                "{} rows of `{}` take {least} bytes at least, but {} are left",
                element.count,
                element.name,
                left.saturating_sub(1)
            );
            defects.invalid(format!("{main}:{}", element.line), message);
        }
        left = left.saturating_sub(least);
    }
    let find = |name: &str| header.elements.iter().find(|e| e.name == name);
    match find("vertex") {
        None => defects.invalid(main, "the header declares no element `vertex`"),
        Some(vertex) => {
            for name in ["x", "y", "z"] {
                if vertex.property(name).is_none_or(|p| vertex.properties[p].count.is_some()) {
                    defects.invalid("element vertex", format!("has no number `{name}`"));
                }
            }
            let most = limits.max_vertices.min(super::MOST_IDS);
            if vertex.count > most {
                defects.invalid("element vertex", format!("{} vertices, the limit is {most}", vertex.count));
            }
        }
    }
    if find("tristrips").is_some_and(|e| e.count > 0) {
        defects.unsupported("element tristrips", "triangle strips are not read; write the model with faces");
    } else {
        match find("face") {
            Some(face) if face.count > 0 => match index_property(face) {
                Some(property) if face.properties[property].scalar.is_float() => {
                    defects.invalid("element face", "its list of vertices is not of integers");
                }
                Some(_) => {}
                None => defects.invalid("element face", "has no list `vertex_indices` or `vertex_index`"),
            },
            _ => defects.unsupported(main, "a cloud of points: it has no faces, and only surfaces are read"),
        }
    }
}

fn index_property(face: &Element) -> Option<usize> {
    let property = face.property("vertex_indices").or_else(|| face.property("vertex_index"))?;
    face.properties[property].count.map(|_| property)
}

fn corner_uvs(face: &Element) -> Option<usize> {
    face.property("texcoord").filter(|p| face.properties[*p].count.is_some())
}

fn normal_columns(vertex: &Element) -> Option<Columns<3>> {
    Columns::find(vertex, &[["nx", "ny", "nz"]])
}

fn uv_columns(vertex: &Element) -> Option<Columns<2>> {
    Columns::find(vertex, &[["s", "t"], ["u", "v"], ["texture_u", "texture_v"]])
}

/// A row's values by column.
struct Columns<const N: usize>([usize; N]);

impl<const N: usize> Columns<N> {
    /// The first list of names of which `element` has all as single numbers.
    fn find(element: &Element, names: &[[&str; N]]) -> Option<Columns<N>> {
        let single = |name: &&str| element.property(name).filter(|p| element.properties[*p].count.is_none());
        names.iter().find_map(|names| {
            let found: Vec<usize> = names.iter().filter_map(single).collect();
            found.try_into().ok().map(Columns)
        })
    }

    fn values(&self, row: &Row) -> [f32; N] {
        self.0.map(|column| row.scalar(column) as f32)
    }
}

/// A way to red, green, blue and alpha.
struct Color {
    columns: Columns<3>,
    scalars: [Scalar; 3],
    alpha: Option<(usize, Scalar)>,
}

impl Color {
    fn find(element: &Element) -> Option<Color> {
        let names = [["red", "green", "blue"], ["diffuse_red", "diffuse_green", "diffuse_blue"], ["r", "g", "b"]];
        let columns = Columns::find(element, &names)?;
        let scalar = |column: usize| element.properties[column].scalar;
        let alpha = Columns::find(element, &[["alpha"], ["a"]]).map(|Columns([column])| (column, scalar(column)));
        Some(Color { scalars: columns.0.map(scalar), columns, alpha })
    }

    fn read(&self, row: &Row, path: impl Fn() -> String, notes: &mut Notes) -> Vec4 {
        let unit = |value: f64, scalar: Scalar| if scalar.is_float() { value } else { value / scalar.range().1 };
        let [r, g, b] = [0, 1, 2].map(|k| unit(row.scalar(self.columns.0[k]), self.scalars[k]) as f32);
        let a = self.alpha.map_or(1.0, |(column, scalar)| unit(row.scalar(column), scalar) as f32);
        if !self.scalars.iter().all(|scalar| scalar.is_float()) {
            return linear_from_srgb([r, g, b, a], path, notes);
        }
        let color = Vec4::new(r, g, b, a);
        notes.repair(RepairKind::ColorNotFinite, !color.is_finite() as u64, &path);
        if color.is_finite() { color } else { Vec4::ONE }
    }
}

/// What the rows read so far hold.
struct Reader {
    vertex_count: u64,
    /// Of vertices.
    normals: Option<Columns<3>>,
    /// Of vertices, where corners have none.
    uvs: Option<Columns<2>>,
    soup: Soup,
    texture_count: usize,
    /// By part: the number of its picture.
    parts: Vec<Option<usize>>,
    part_of: BTreeMap<Option<usize>, u32>,
    /// Corners' UVs by their bits.
    uv_ids: HashMap<[u32; 2], u32>,
    defects: Defects,
    notes: Notes,
    left: Left,
}

/// Where and what.
struct Broken(String, String);

fn broken(element: &Element, index: u64, fault: Fault) -> Broken {
    let path = match fault.property {
        Some(property) => format!("element {}[{index}].{}", element.name, element.properties[property].name),
        None => format!("element {}[{index}]", element.name),
    };
    Broken(path, fault.message)
}

impl Reader {
    fn read(&mut self, header: &Header<'_>) -> Result<(), Broken> {
        let mut rows = Rows::new(header.encoding, header.line_count, header.body);
        for element in header.elements.iter().filter(|e| !e.properties.is_empty()) {
            match element.name.as_str() {
                "vertex" => self.vertices(element, &mut rows)?,
                "face" => self.faces(element, &mut rows)?,
                other => {
                    self.left.add(format!("element `{other}`"), element.count);
                    let skipped = rows.skip(element, &mut Row::default());
                    skipped.map_err(|fault| Broken(format!("element {other}"), fault.message))?;
                }
            }
        }
        Ok(())
    }

    /// Notes the properties that are not in `used`.
    fn note_left(&mut self, element: &Element, used: &[usize]) {
        for (k, property) in element.properties.iter().enumerate() {
            if !used.contains(&k) {
                self.left.add(format!("property `{}` of `{}`", property.name, element.name), element.count);
            }
        }
    }

    fn vertices(&mut self, element: &Element, rows: &mut Rows<'_>) -> Result<(), Broken> {
        let Some(place) = Columns::find(element, &[["x", "y", "z"]]) else { return Ok(()) };
        let color = Color::find(element);
        let mut used = place.0.to_vec();
        used.extend(self.normals.iter().flat_map(|c| c.0));
        used.extend(self.uvs.iter().flat_map(|c| c.0));
        used.extend(color.iter().flat_map(|c| c.columns.0.into_iter().chain(c.alpha.map(|(column, _)| column))));
        self.note_left(element, &used);
        // The count has been checked against the file's length.
        self.soup.positions.reserve_exact(element.count as usize);
        let mut row = Row::default();
        for index in 0..element.count {
            if let Err(fault) = rows.read(element, &mut row) {
                let (fatal, Broken(path, message)) = (fault.fatal, broken(element, index, fault));
                if fatal {
                    return Err(Broken(path, message));
                }
                self.defects.invalid(path, message);
                continue;
            }
            let position = Vec3::from_array(place.values(&row));
            if !position.is_finite() {
                self.defects.invalid(format!("element vertex[{index}]"), format!("lies at {position}: not finite"));
            }
            self.soup.positions.push(position);
            if let Some(normal) = &self.normals {
                self.soup.normals.push(Vec3::from_array(normal.values(&row)));
            }
            if let Some(uv) = &self.uvs {
                let [u, v] = uv.values(&row);
                self.soup.uvs.push(Vec2::new(u, 1.0 - v));
            }
            if let Some(color) = &color {
                let color = color.read(&row, || format!("element vertex[{index}]"), &mut self.notes);
                self.soup.colors.push(Some(color));
            }
        }
        Ok(())
    }

    fn faces(&mut self, element: &Element, rows: &mut Rows<'_>) -> Result<(), Broken> {
        let Some(indices) = index_property(element) else { return Ok(()) };
        let uvs = corner_uvs(element);
        let number = Columns::find(element, &[["texnumber"]]).filter(|_| self.texture_count > 0);
        let used: Vec<usize> = [indices].into_iter().chain(uvs).chain(number.iter().flat_map(|c| c.0)).collect();
        self.note_left(element, &used);
        let mut row = Row::default();
        for index in 0..element.count {
            if let Err(fault) = rows.read(element, &mut row) {
                let (fatal, Broken(path, message)) = (fault.fatal, broken(element, index, fault));
                if fatal {
                    return Err(Broken(path, message));
                }
                self.defects.invalid(path, message);
                continue;
            }
            let texture = match &number {
                Some(Columns([column])) => Some(row.scalar(*column)).filter(|number| *number >= 0.0),
                None => (self.texture_count > 0).then_some(0.0),
            };
            if let Err((column, message)) = self.face(index, row.list(indices), uvs.map(|p| row.list(p)), texture) {
                self.soup.drop_open();
                let name = column.unwrap_or(&element.properties[indices].name);
                self.defects.invalid(format!("element face[{index}].{name}"), message);
            }
        }
        Ok(())
    }

    /// Adds a polygon, or tells the property at fault (`None`: the indices).
    fn face(
        &mut self,
        index: u64,
        corners: &[f64],
        uvs: Option<&[f64]>,
        texture: Option<f64>,
    ) -> Result<(), (Option<&'static str>, String)> {
        if corners.len() < 3 {
            return Err((None, format!("a polygon of {} corners", corners.len())));
        }
        if let Some(texture) = texture.filter(|number| *number >= self.texture_count as f64) {
            return Err((Some("texnumber"), format!("picture {texture} of {}", self.texture_count)));
        }
        let uvs = uvs.filter(|uvs| !uvs.is_empty());
        if let Some(uvs) = uvs.filter(|uvs| uvs.len() != 2 * corners.len()) {
            return Err((Some("texcoord"), format!("{} numbers for {} corners", uvs.len(), corners.len())));
        }
        for (k, vertex) in corners.iter().enumerate() {
            if !(0.0..self.vertex_count as f64).contains(vertex) {
                return Err((None, format!("index {k} is {vertex}, but there are {} vertices", self.vertex_count)));
            }
            let vertex = *vertex as u32;
            let uv = uvs.map(|uvs| Vec2::new(uvs[2 * k] as f32, 1.0 - uvs[2 * k + 1] as f32));
            let uv = match uv {
                Some(uv) => self.corner_uv(uv),
                None => {
                    if self.uvs.is_some() {
                        vertex
                    } else {
                        NONE
                    }
                }
            };
            let normal = if self.normals.is_some() { vertex } else { NONE };
            self.soup.corners.push(Corner { position: vertex, uv, normal });
        }
        let texture = texture.map(|number| number as usize);
        let part = *self.part_of.entry(texture).or_insert_with(|| {
            self.parts.push(texture);
            self.parts.len() as u32 - 1
        });
        self.soup.close_polygon(index, part);
        Ok(())
    }

    /// Equal UVs of corners become one, so that their corners can be one vertex.
    fn corner_uv(&mut self, uv: Vec2) -> u32 {
        let uvs = &mut self.soup.uvs;
        *self.uv_ids.entry(uv.to_array().map(f32::to_bits)).or_insert_with(|| {
            uvs.push(uv);
            uvs.len() as u32 - 1
        })
    }
}

/// The materials of all parts' pictures, by the pictures' numbers.
fn read_materials(
    header: &Header<'_>,
    parts: &[Option<usize>],
    pictures: &mut Pictures<'_, '_>,
    defects: &mut Defects,
    notes: &mut Notes,
) -> BTreeMap<usize, usize> {
    let mut out = BTreeMap::new();
    for number in parts.iter().flatten() {
        let (line, name) = &header.texture_files[*number];
        let mut material = Material { metallic_factor: 0.0, ..Default::default() };
        match file_beside("", name, || format!("line {line}"), notes) {
            Ok(file) => {
                let path = format!("TextureFile[{number}]");
                material.name = super::material::stem(&file);
                material.base_color = pictures.texture(&file, false, &path, defects, notes);
            }
            Err(message) => defects.invalid(format!("TextureFile[{number}]"), message),
        }
        out.insert(*number, pictures.set.materials.len());
        pictures.set.materials.push(material);
    }
    notes.not_carried("pictures that no face uses", (header.texture_files.len() - out.len()) as u64);
    out
}
