//! Tree and leaf buffers as OpenEXR, out and in, lossless.
//!
//! | file | channels | a texel is |
//! | --- | --- | --- |
//! | `tree.exr` | R, G, B, A: f32 | a texel of the tree buffer: x, y, z, q; the picture is the buffer's texture |
//! | `leaf.exr` | R, G, B, A: f32 | a vertex: x, y, z, and the number of its terminal node's texel |
//! | `counts.exr` | Y: u32 | triangles alive at each threshold |
//! | `normals.exr`, `uv0.exr`, `uv1.exr`, `colors.exr` | as many as they have: f32 | the same attribute of each vertex, beside `leaf.exr` |
//!
//! Lists are cut into rows of the tree buffer's width, at least 64, the last one filled with zeros. `tree.exr` says the numbers that the
//! picture does not tell as attributes: `kilnNodes`, `kilnColumns`, `kilnRowStarts` (a text of numbers); each list says its length,
//! `kilnLength`. [`read`] takes the first three back into what [`kiln_format::TreeLeafView`] lends.

use std::io::Cursor;

use exr::image::{AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer};
use exr::meta::attribute::{AttributeValue, IntegerBounds, LineOrder, Text};
use exr::meta::header::{ImageAttributes, LayerAttributes};
use exr::prelude::{
    Blocks, Compression, ReadChannels as _, ReadLayers as _, SmallVec, Vec2, WritableImage, read as open,
};
use kiln_format::layout::{MAX_TREE_ROWS, MAX_TREE_TEXELS, MAX_TREE_WIDTH, TreeHeader};
use kiln_format::record::MAX_ELEMENTS;
use kiln_format::{Container, LevelView, TreeLeafView};

use crate::PackError;

/// Tree and leaf buffers on their own.
#[derive(Clone, Debug, PartialEq)]
pub struct TreeBuffers {
    /// Counts; no checkpoints.
    pub header: TreeHeader,
    /// `[rows + 1]`.
    pub row_starts: Vec<u32>,
    /// `[nodes + 1]`.
    pub face_counts: Vec<u32>,
    /// `[width * rows * blocks]`.
    pub tree: Vec<[f32; 4]>,
    /// `[vertices]`.
    pub leaf: Vec<[f32; 4]>,
}

impl TreeBuffers {
    /// As a container lends them.
    pub fn view(&self) -> TreeLeafView<'_> {
        TreeLeafView {
            header: self.header,
            checkpoints: &[],
            row_starts: &self.row_starts,
            face_counts: &self.face_counts,
            tree: &self.tree,
            leaf: &self.leaf,
        }
    }
}

/// The files of a container's tree and leaf buffers: name and bytes.
///
/// # Errors
/// A container without them.
pub fn write(container: &Container<'_>) -> Result<Vec<(&'static str, Vec<u8>)>, PackError> {
    let Some(view) = container.layouts().tree_leaf else {
        return Err(PackError::Unsupported("the container has no tree and leaf buffers (layout \"tree-leaf\")".into()));
    };
    let width = (view.header.width as usize).max(64);
    let mut files = vec![
        ("tree.exr", picture(view.header.width as usize, view.tree, &["R", "G", "B", "A"], tree_facts(&view))?),
        ("leaf.exr", list(width, view.leaf, &["R", "G", "B", "A"])?),
        ("counts.exr", counts(width, view.face_counts)?),
    ];
    if let Some(level) = container.level(0) {
        attributes(&level, width, &mut files)?;
    }
    Ok(files)
}

fn attributes(level: &LevelView<'_>, width: usize, files: &mut Vec<(&'static str, Vec<u8>)>) -> Result<(), PackError> {
    if let Some(normals) = level.normals() {
        files.push(("normals.exr", list(width, normals, &["R", "G", "B"])?));
    }
    for (name, uv) in [("uv0.exr", level.uv0()), ("uv1.exr", level.uv1())] {
        if let Some(uv) = uv {
            files.push((name, list(width, uv, &["R", "G"])?));
        }
    }
    if let Some(colors) = level.colors() {
        files.push(("colors.exr", list(width, colors, &["R", "G", "B", "A"])?));
    }
    Ok(())
}

type Facts = Vec<(&'static str, AttributeValue)>;

fn tree_facts(view: &TreeLeafView<'_>) -> Facts {
    let starts: Vec<String> = view.row_starts.iter().map(u32::to_string).collect();
    vec![
        ("kilnNodes", AttributeValue::I32(view.header.nodes as i32)),
        ("kilnColumns", AttributeValue::I32(view.header.columns as i32)),
        ("kilnRowStarts", AttributeValue::Text(Text::new_or_panic(starts.join(" ")))),
    ]
}

/// `values` in rows of `width`.
fn list<const N: usize>(width: usize, values: &[[f32; N]], names: &[&str; N]) -> Result<Vec<u8>, PackError> {
    let mut filled = values.to_vec();
    filled.resize(values.len().next_multiple_of(width).max(width), [0.0; N]);
    picture(width, &filled, names, vec![("kilnLength", AttributeValue::I32(values.len() as i32))])
}

fn picture<const N: usize>(
    width: usize,
    texels: &[[f32; N]],
    names: &[&str; N],
    facts: Facts,
) -> Result<Vec<u8>, PackError> {
    let channel =
        |(k, name): (usize, &&str)| AnyChannel::new(*name, FlatSamples::F32(texels.iter().map(|t| t[k]).collect()));
    encode(width, texels.len() / width.max(1), names.iter().enumerate().map(channel).collect(), facts)
}

fn counts(width: usize, values: &[u32]) -> Result<Vec<u8>, PackError> {
    let mut filled = values.to_vec();
    filled.resize(values.len().next_multiple_of(width), 0);
    let height = filled.len() / width;
    let channels = SmallVec::from_iter([AnyChannel::new("Y", FlatSamples::U32(filled))]);
    encode(width, height, channels, vec![("kilnLength", AttributeValue::I32(values.len() as i32))])
}

fn encode(
    width: usize,
    height: usize,
    channels: SmallVec<[AnyChannel<FlatSamples>; 4]>,
    facts: Facts,
) -> Result<Vec<u8>, PackError> {
    let size = Vec2(width, height);
    let encoding =
        Encoding { compression: Compression::ZIP16, blocks: Blocks::ScanLines, line_order: LineOrder::Increasing };
    let mut own = LayerAttributes::default();
    own.other.extend(facts.into_iter().map(|(name, value)| (Text::new_or_panic(name), value)));
    let layer = Layer::new(size, own, encoding, AnyChannels::sort(channels));
    let image = Image::empty(ImageAttributes::new(IntegerBounds::from_dimensions(size))).with_layer(layer);
    let mut out = Cursor::new(Vec::new());
    let written = image.write().non_parallel().to_buffered(&mut out);
    written.map_err(|e| PackError::Unsupported(format!("OpenEXR: {e}")))?;
    Ok(out.into_inner())
}

/// Tree and leaf buffers out of `tree.exr`, `leaf.exr` and `counts.exr`.
///
/// # Errors
/// Files that are none of these, or do not belong together. What stands in the texels is not looked at: a container that is written of them
/// is checked as any.
pub fn read(tree: &[u8], leaf: &[u8], counts: &[u8]) -> Result<TreeBuffers, PackError> {
    let wrong = |file: &str, what: &str| PackError::Unsupported(format!("{file}: {what}"));
    let texture = Decoded::new("tree.exr", tree)?;
    let (nodes, columns) = (texture.number("kilnNodes")?, texture.number("kilnColumns")?);
    let starts = texture.text("kilnRowStarts")?;
    let row_starts: Vec<u32> = starts.split(' ').map_while(|s| s.parse().ok()).collect();
    let rows = row_starts.len().saturating_sub(1);
    if rows == 0 || rows > MAX_TREE_ROWS as usize || texture.width == 0 || texture.width > MAX_TREE_WIDTH as usize {
        return Err(wrong("tree.exr", "its rows or its width are none of a tree buffer"));
    }
    let tree = texture.vectors()?;
    let blocks = (columns as usize).div_ceil(texture.width);
    if tree.len() != texture.width * rows * blocks || tree.len() > MAX_TREE_TEXELS as usize {
        return Err(wrong("tree.exr", "its size does not fit its columns and rows"));
    }
    let width = texture.width as u32;
    let leaves = Decoded::new("leaf.exr", leaf)?;
    let mut leaf = leaves.vectors()?;
    leaf.truncate(leaves.number("kilnLength")? as usize);
    let list = Decoded::new("counts.exr", counts)?;
    let mut face_counts = list.integers()?;
    face_counts.truncate(list.number("kilnLength")? as usize);
    if face_counts.len() != nodes as usize + 1 {
        return Err(wrong("counts.exr", "it has not one count for each threshold"));
    }
    let vertices = leaf.len() as u32;
    let header = TreeHeader { nodes, vertices, rows: rows as u32, columns, width, checkpoints: 0, reserved: [0; 10] };
    Ok(TreeBuffers { header, row_starts, face_counts, tree, leaf })
}

/// One file, decoded.
struct Decoded {
    name: &'static str,
    width: usize,
    channels: SmallVec<[AnyChannel<FlatSamples>; 4]>,
    facts: LayerAttributes,
}

impl Decoded {
    fn new(name: &'static str, bytes: &[u8]) -> Result<Decoded, PackError> {
        let fail = |what: String| PackError::Unsupported(format!("{name}: {what}"));
        // What it says of its size, before anything is allocated for it.
        let said =
            exr::meta::MetaData::read_from_buffered(Cursor::new(bytes), true).map_err(|e| fail(e.to_string()))?;
        let size = said.headers.first().map_or(Vec2(0, 0), |header| header.layer_size);
        // Lists of zeros shrink to a hundredth and less; a small file has at most as many texels as the largest tree buffer.
        let most = (MAX_TREE_TEXELS as usize).max(bytes.len().saturating_mul(64).min(MAX_ELEMENTS as usize));
        if size.0.checked_mul(size.1).is_none_or(|texels| texels > most) {
            return Err(fail(format!("{} x {} texels are too many", size.0, size.1)));
        }
        let reader = open().no_deep_data().largest_resolution_level().all_channels().first_valid_layer();
        let image = reader.all_attributes().non_parallel().from_buffered(Cursor::new(bytes));
        let image = image.map_err(|e| fail(e.to_string()))?;
        let layer = image.layer_data;
        Ok(Decoded { name, width: layer.size.0, channels: layer.channel_data.list, facts: layer.attributes })
    }

    fn fail(&self, what: &str) -> PackError {
        PackError::Unsupported(format!("{}: {what}", self.name))
    }

    fn fact(&self, key: &str) -> Option<&AttributeValue> {
        self.facts.other.iter().find(|(name, _)| **name == *key).map(|(_, value)| value)
    }

    fn number(&self, key: &str) -> Result<u32, PackError> {
        match self.fact(key) {
            Some(AttributeValue::I32(number)) if *number >= 0 => Ok(*number as u32),
            _ => Err(self.fail(&format!("no number {key}"))),
        }
    }

    fn text(&self, key: &str) -> Result<String, PackError> {
        match self.fact(key) {
            Some(AttributeValue::Text(text)) => Ok(text.to_string()),
            _ => Err(self.fail(&format!("no text {key}"))),
        }
    }

    fn channel(&self, name: &str) -> Result<&FlatSamples, PackError> {
        let found = self.channels.iter().find(|channel| channel.name.to_string() == name);
        found.map(|channel| &channel.sample_data).ok_or_else(|| self.fail(&format!("no channel {name}")))
    }

    fn vectors(&self) -> Result<Vec<[f32; 4]>, PackError> {
        let mut planes = [&[][..]; 4];
        for (plane, name) in planes.iter_mut().zip(["R", "G", "B", "A"]) {
            let FlatSamples::F32(values) = self.channel(name)? else {
                return Err(self.fail("its floats are not 32 bits"));
            };
            *plane = values;
        }
        let [r, g, b, a] = planes;
        Ok(r.iter().zip(g).zip(b).zip(a).map(|(((r, g), b), a)| [*r, *g, *b, *a]).collect())
    }

    fn integers(&self) -> Result<Vec<u32>, PackError> {
        match self.channel("Y")? {
            FlatSamples::U32(values) => Ok(values.clone()),
            _ => Err(self.fail("its numbers are no integers")),
        }
    }
}
