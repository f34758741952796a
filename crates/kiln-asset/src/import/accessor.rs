//! Buffers, views and accessors: every offset, stride and count is checked here, without overflow, before a byte is read.
//!
//! Two steps. [`read_views`] and [`read_accessors`] judge the JSON alone, against the lengths that the buffers *claim*;
//! [`super::source`] loads buffers and judges the claims. After that every element that [`Reader`] is asked for lies inside.

use super::error::Defects;
use super::json::Object;
use super::meshopt::{self, Encoded};
use super::report::{Notes, RepairKind};
use super::source::Bytes;

/// Type of one number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Component {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

impl Component {
    fn from_code(code: u64) -> Option<Component> {
        Some(match code {
            5120 => Component::I8,
            5121 => Component::U8,
            5122 => Component::I16,
            5123 => Component::U16,
            5125 => Component::U32,
            5126 => Component::F32,
            _ => return None,
        })
    }

    pub(super) fn name(self) -> &'static str {
        match self {
            Component::I8 => "BYTE",
            Component::U8 => "UNSIGNED_BYTE",
            Component::I16 => "SHORT",
            Component::U16 => "UNSIGNED_SHORT",
            Component::U32 => "UNSIGNED_INT",
            Component::F32 => "FLOAT",
        }
    }

    /// Bytes of one number.
    pub(super) fn size(self) -> u64 {
        match self {
            Component::I8 | Component::U8 => 1,
            Component::I16 | Component::U16 => 2,
            Component::U32 | Component::F32 => 4,
        }
    }

    /// The largest value: the restart value of indices, 1.0 of normalised numbers.
    pub(super) fn greatest(self) -> u32 {
        match self {
            Component::I8 => i8::MAX as u32,
            Component::U8 => u8::MAX as u32,
            Component::I16 => i16::MAX as u32,
            Component::U16 => u16::MAX as u32,
            Component::U32 | Component::F32 => u32::MAX,
        }
    }

    /// A number of this type from its bits, widened; normalised ones become `[0, 1]` or `[-1, 1]` (glTF 2.0, 3.6.2.2).
    fn float(self, bits: u32, normalized: bool) -> f32 {
        let value = match self {
            Component::I8 => bits as u8 as i8 as f32,
            Component::I16 => bits as u16 as i16 as f32,
            Component::U8 | Component::U16 | Component::U32 => bits as f32,
            Component::F32 => return f32::from_bits(bits),
        };
        if normalized { (value / self.greatest() as f32).max(-1.0) } else { value }
    }
}

/// `type` of an accessor: (name, numbers an element, rows of a matrix or 0).
const SHAPES: [(&str, usize, u64); 7] =
    [("SCALAR", 1, 0), ("VEC2", 2, 0), ("VEC3", 3, 0), ("VEC4", 4, 0), ("MAT2", 4, 2), ("MAT3", 9, 3), ("MAT4", 16, 4)];

/// A range of a buffer.
#[derive(Clone, Copy, Debug)]
pub(super) struct View {
    pub(super) buffer: usize,
    /// First byte in the buffer.
    pub(super) start: u64,
    /// Bytes.
    pub(super) length: u64,
    stride: Option<u64>,
    /// What it is decoded from; `buffer` then is one of those that decoding adds behind the file's own.
    pub(super) encoded: Option<Encoded>,
}

/// Elements at a fixed step in a buffer; all of them lie inside their view.
#[derive(Clone, Copy, Debug)]
struct Run {
    buffer: usize,
    start: usize,
    /// Bytes from one element to the next.
    stride: usize,
    /// Bytes of one element.
    size: usize,
}

/// Replacements for some elements.
#[derive(Clone, Copy, Debug)]
struct Sparse {
    count: u64,
    indices: Run,
    index_component: Component,
    values: Run,
}

/// A checked accessor.
#[derive(Clone, Debug)]
pub(super) struct Accessor {
    pub(super) path: String,
    pub(super) component: Component,
    pub(super) shape: &'static str,
    pub(super) lanes: usize,
    pub(super) normalized: bool,
    pub(super) count: u64,
    base: Option<Run>,
    sparse: Option<Sparse>,
}

impl Accessor {
    /// The same with its elements packed from the start of another buffer: what a decompressor gave for it.
    pub(super) fn moved(&self, buffer: usize, component: Component) -> Accessor {
        let size = component.size() as usize * self.lanes;
        Accessor { component, base: Some(Run { buffer, start: 0, stride: size, size }), sparse: None, ..self.clone() }
    }

    /// Whether any byte of the file stands behind it.
    pub(super) fn has_data(&self) -> bool {
        self.base.is_some() || self.sparse.is_some()
    }

    /// Number of replaced elements.
    pub(super) fn replaced_count(&self) -> u64 {
        self.sparse.map_or(0, |sparse| sparse.count)
    }

    /// `VEC3 of FLOAT`, to be read by people.
    pub(super) fn describe(&self) -> String {
        let normalized = if self.normalized { "normalized " } else { "" };
        format!("{} of {normalized}{}", self.shape, self.component.name())
    }
}

/// The buffer views; `None` where one is defective. `buffer_lengths`: `[buffer_count]` claimed lengths.
pub(super) fn read_views(
    root: &Object<'_>,
    buffer_lengths: &[Option<u64>],
    defects: &mut Defects,
) -> Vec<Option<View>> {
    let mut decoded = buffer_lengths.len();
    let mut out = Vec::new();
    for view in root.objects("bufferViews", defects) {
        let view = view.and_then(|view| match meshopt::extension(&view, defects) {
            Some(extension) => read_compressed_view(&view, &extension, buffer_lengths, decoded, defects),
            None => read_view(&view, buffer_lengths, defects),
        });
        decoded += view.is_some_and(|view| view.encoded.is_some()) as usize;
        out.push(view);
    }
    out
}

/// A view whose content is decoded into the buffer `decoded`.
fn read_compressed_view(
    view: &Object<'_>,
    extension: &Object<'_>,
    buffer_lengths: &[Option<u64>],
    decoded: usize,
    defects: &mut Defects,
) -> Option<View> {
    view.need_index("buffer", "buffers", buffer_lengths.len(), defects);
    let length = view.need_unsigned("byteLength", defects);
    let stride = view.unsigned("byteStride", defects);
    let encoded = meshopt::read_encoded(extension, buffer_lengths, defects)?;
    let length = length?;
    if length > encoded.decoded_length() {
        let message = format!("{length} bytes, but its compressed data decodes to {}", encoded.decoded_length());
        defects.invalid(view.path_of("byteLength"), message);
        return None;
    }
    if stride.is_some() && encoded.attribute_stride().is_some_and(|of| stride != Some(of)) {
        defects.invalid(view.path_of("byteStride"), "is not that of its compressed data");
        return None;
    }
    let stride = encoded.attribute_stride();
    Some(View { buffer: decoded, start: 0, length, stride, encoded: Some(encoded) })
}

fn read_view(view: &Object<'_>, buffer_lengths: &[Option<u64>], defects: &mut Defects) -> Option<View> {
    let buffer = view.need_index("buffer", "buffers", buffer_lengths.len(), defects);
    let length = view.need_unsigned("byteLength", defects);
    let start = if view.has("byteOffset") { view.unsigned("byteOffset", defects) } else { Some(0) };
    let stride = view.unsigned("byteStride", defects);
    if stride.is_none() && view.has("byteStride") {
        return None;
    }
    if let Some(stride) = stride.filter(|stride| !(1..=252).contains(stride)) {
        defects.invalid(view.path_of("byteStride"), format!("{stride} bytes; it must lie between 1 and 252"));
        return None;
    }
    let (buffer, length, start) = (buffer?, length?, start?);
    let have = buffer_lengths[buffer]?;
    if start.checked_add(length).is_none_or(|end| end > have) {
        let message = format!("{length} bytes from byte {start} do not fit into buffers[{buffer}] of {have} bytes");
        defects.invalid(view.path.clone(), message);
        return None;
    }
    Some(View { buffer, start, length, stride, encoded: None })
}

/// How many elements an accessor may have.
#[derive(Clone, Copy)]
pub(super) struct MostElements {
    pub(super) stored: u64,
    /// Where no view stands behind them, all being zero but for the replaced ones: such a count costs a file nothing.
    pub(super) zeros: u64,
}

/// The accessors; `None` where one is defective.
pub(super) fn read_accessors(
    root: &Object<'_>,
    views: &[Option<View>],
    most: MostElements,
    defects: &mut Defects,
    notes: &mut Notes,
) -> Vec<Option<Accessor>> {
    let accessors = root.objects("accessors", defects);
    accessors.iter().map(|accessor| read_accessor(accessor.as_ref()?, views, most, defects, notes)).collect()
}

fn read_accessor(
    accessor: &Object<'_>,
    views: &[Option<View>],
    most: MostElements,
    defects: &mut Defects,
    notes: &mut Notes,
) -> Option<Accessor> {
    let component = read_component(accessor, defects);
    let shape = read_shape(accessor, defects);
    let count = accessor.need_unsigned("count", defects);
    let normalized = accessor.boolean("normalized", defects).unwrap_or(false);
    let count_path = accessor.path_of("count");
    let most = if accessor.has("bufferView") { most.stored } else { most.zeros.min(most.stored) };
    let count = match count? {
        0 => {
            defects.invalid(count_path, "is 0, but an accessor has at least one element");
            None
        }
        count if count > most => {
            defects.invalid(count_path, format!("{count} elements, the limit here is {most}"));
            None
        }
        count => Some(count),
    };
    let (component, (shape, lanes, rows), count) = (component?, shape?, count?);
    // Matrix columns start at multiples of 4 bytes.
    let size = match rows {
        0 => component.size() * lanes as u64,
        rows => (component.size() * rows).next_multiple_of(4) * rows,
    };
    let element = Element { component, size, strided: true };
    let base = match accessor.has("bufferView") {
        true => Some(read_run(accessor, views, element, count, defects, notes)?),
        false => None,
    };
    let sparse = match accessor.has("sparse") {
        true => Some(read_sparse(accessor, views, element, count, defects, notes)?),
        false => None,
    };
    Some(Accessor { path: accessor.path.clone(), component, shape, lanes, normalized, count, base, sparse })
}

fn read_component(object: &Object<'_>, defects: &mut Defects) -> Option<Component> {
    let code = object.need_unsigned("componentType", defects)?;
    let component = Component::from_code(code);
    if component.is_none() {
        defects.invalid(object.path_of("componentType"), format!("{code} is no component type of glTF 2.0"));
    }
    component
}

fn read_shape(accessor: &Object<'_>, defects: &mut Defects) -> Option<(&'static str, usize, u64)> {
    let name = match accessor.string("type", defects) {
        Some(name) => name,
        None if accessor.has("type") => return None,
        None => {
            defects.invalid(accessor.path_of("type"), "is missing");
            return None;
        }
    };
    let shape = SHAPES.iter().find(|shape| shape.0 == name).copied();
    if shape.is_none() {
        defects.invalid(accessor.path_of("type"), format!("`{name}` is no accessor type of glTF 2.0"));
    }
    shape
}

#[derive(Clone, Copy)]
struct Element {
    component: Component,
    size: u64,
    /// Whether the view's stride counts.
    strided: bool,
}

/// `count` elements from `byteOffset` of `bufferView` of `object`, if they fit.
fn read_run(
    object: &Object<'_>,
    views: &[Option<View>],
    element: Element,
    count: u64,
    defects: &mut Defects,
    notes: &mut Notes,
) -> Option<Run> {
    let index = object.need_index("bufferView", "bufferViews", views.len(), defects);
    let offset = if object.has("byteOffset") { object.unsigned("byteOffset", defects) } else { Some(0) };
    let (view, offset) = (views[index?]?, offset?);
    let stride = view.stride.filter(|_| element.strided).unwrap_or(element.size);
    if stride < element.size {
        let message = format!("elements of {} bytes overlap at the view's stride of {stride}", element.size);
        defects.invalid(object.path_of("bufferView"), message);
        return None;
    }
    let end = (count - 1)
        .checked_mul(stride)
        .and_then(|last| last.checked_add(element.size))
        .and_then(|bytes| bytes.checked_add(offset));
    if end.is_none_or(|end| end > view.length) {
        let message = format!(
            "{count} elements of {} bytes at stride {stride} from byte {offset} do not fit into a view of {} bytes",
            element.size, view.length
        );
        defects.invalid(object.path.clone(), message);
        return None;
    }
    let start = view.start.checked_add(offset)?;
    if start % element.component.size() != 0 || stride % element.component.size() != 0 {
        notes.repair(RepairKind::Misaligned, 1, || object.path.clone());
    }
    Some(Run {
        buffer: view.buffer,
        start: usize::try_from(start).ok()?,
        stride: usize::try_from(stride).ok()?,
        size: usize::try_from(element.size).ok()?,
    })
}

fn read_sparse(
    accessor: &Object<'_>,
    views: &[Option<View>],
    element: Element,
    elements: u64,
    defects: &mut Defects,
    notes: &mut Notes,
) -> Option<Sparse> {
    let sparse = accessor.object("sparse", defects)?;
    let count = sparse.need_unsigned("count", defects);
    let indices = sparse.need_object("indices", defects);
    let values = sparse.need_object("values", defects);
    let (count, indices, values) = (count?, indices?, values?);
    if count == 0 || count > elements {
        defects.invalid(sparse.path_of("count"), format!("{count} replacements of {elements} elements"));
        return None;
    }
    let index_component = read_component(&indices, defects)?;
    if !matches!(index_component, Component::U8 | Component::U16 | Component::U32) {
        let message = format!("expected an unsigned type, found {}", index_component.name());
        defects.invalid(indices.path_of("componentType"), message);
        return None;
    }
    let index = Element { component: index_component, size: index_component.size(), strided: false };
    let index_run = read_run(&indices, views, index, count, defects, notes);
    let value_run = read_run(&values, views, Element { strided: false, ..element }, count, defects, notes);
    Some(Sparse { count, indices: index_run?, index_component, values: value_run? })
}

/// Reads elements of a checked accessor out of loaded buffers.
pub(super) struct Reader<'a> {
    component: Component,
    lanes: usize,
    normalized: bool,
    base: Option<(&'a [u8], Run)>,
    /// Ascending indices of replaced elements, and their values.
    sparse: Option<(Vec<u32>, &'a [u8], Run)>,
}

impl<'a> Reader<'a> {
    /// A reader of `accessor`; `None`, with a defect, where its list of replaced elements is broken.
    ///
    /// Buffers must hold as many bytes as they claim ([`super::source`] checks it); a shorter one reads as zeros.
    pub(super) fn new(accessor: &Accessor, buffers: &'a [Bytes<'a>], defects: &mut Defects) -> Option<Reader<'a>> {
        let bytes = |run: Run| -> &'a [u8] { buffers.get(run.buffer).map_or(&[], |buffer| buffer) };
        let mut sparse = None;
        if let Some(Sparse { count, indices, index_component, values }) = accessor.sparse {
            let mut replaced: Vec<u32> = Vec::new();
            for i in 0..count as usize {
                let index = unsigned(index_component, element(bytes(indices), indices, i), 0);
                let path = || format!("{}.sparse.indices[{i}]", accessor.path);
                if index as u64 >= accessor.count {
                    defects.invalid(path(), format!("element {index} of {}", accessor.count));
                    return None;
                }
                if replaced.last().is_some_and(|last| *last >= index) {
                    defects.invalid(path(), "indices do not ascend");
                    return None;
                }
                replaced.push(index);
            }
            sparse = Some((replaced, bytes(values), values));
        }
        Some(Reader {
            component: accessor.component,
            lanes: accessor.lanes,
            normalized: accessor.normalized,
            base: accessor.base.map(|run| (bytes(run), run)),
            sparse,
        })
    }

    fn element(&self, index: u32) -> &'a [u8] {
        if let Some((replaced, bytes, run)) = &self.sparse
            && let Ok(k) = replaced.binary_search(&index)
        {
            return element(bytes, *run, k);
        }
        self.base.map_or(&[], |(bytes, run)| element(bytes, run, index as usize))
    }

    /// The numbers of one element; lanes that it lacks are `fill`.
    pub(super) fn floats<const N: usize>(&self, index: u32, fill: f32) -> [f32; N] {
        let bytes = self.element(index);
        std::array::from_fn(|lane| {
            if lane >= self.lanes {
                return fill;
            }
            self.component.float(unsigned(self.component, bytes, lane), self.normalized)
        })
    }

    /// The unsigned numbers of one element.
    pub(super) fn unsigned<const N: usize>(&self, index: u32) -> [u32; N] {
        let bytes = self.element(index);
        std::array::from_fn(|lane| unsigned(self.component, bytes, lane))
    }
}

fn element(bytes: &[u8], run: Run, index: usize) -> &[u8] {
    let start = index.checked_mul(run.stride).and_then(|at| at.checked_add(run.start));
    start.and_then(|start| bytes.get(start..start.checked_add(run.size)?)).unwrap_or(&[])
}

/// Number `lane` of an element, little-endian, widened; 0 outside.
fn unsigned(component: Component, bytes: &[u8], lane: usize) -> u32 {
    let size = component.size() as usize;
    match bytes.get(lane * size..(lane + 1) * size) {
        Some([a]) => *a as u32,
        Some([a, b]) => u16::from_le_bytes([*a, *b]) as u32,
        Some([a, b, c, d]) => u32::from_le_bytes([*a, *b, *c, *d]),
        _ => 0,
    }
}
