//! Compressed buffer views: `EXT_meshopt_compression` and `KHR_meshopt_compression`.
//!
//! A compressed view names where its encoded bytes lie and what they decode to: `count` elements of `byteStride` bytes. Judged
//! here like everything else before a byte is read; decoded later into a buffer of its own, which the view then means. Encoded
//! data can decode to no more than the codecs' greatest ratios allow, so that a claim costs a file what it is worth.
//!
//! **Source.** A. Kapoulkine, *EXT_meshopt_compression*, Khronos glTF extension registry, 2020, and its successor of 2025. The
//! decoders are meshoptimizer's own, which are made for input from outside.

use super::accessor::View;
use super::error::Defects;
use super::json::Object;
use super::source::Bytes;

/// The two names; the second adds a filter and a newer version of the vertex codec, which the decoder tells by itself.
pub(super) const EXTENSIONS: [&str; 2] = ["EXT_meshopt_compression", "KHR_meshopt_compression"];

/// What was encoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mode {
    Attributes,
    Triangles,
    Indices,
}

/// What was done to attributes before they were encoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Filter {
    None,
    Octahedral,
    Quaternion,
    Exponential,
    Color,
}

/// Encoded bytes and what they decode to; sizes are checked against each other.
#[derive(Clone, Copy, Debug)]
pub(super) struct Encoded {
    buffer: usize,
    start: u64,
    length: u64,
    count: u64,
    /// Bytes of an element.
    stride: u64,
    mode: Mode,
    filter: Filter,
}

impl Encoded {
    /// Bytes after decoding.
    pub(super) fn decoded_length(&self) -> u64 {
        self.count.saturating_mul(self.stride)
    }

    /// Bytes of an element, if elements are attributes.
    pub(super) fn attribute_stride(&self) -> Option<u64> {
        (self.mode == Mode::Attributes).then_some(self.stride)
    }
}

/// The extension object of a view, if it is compressed.
pub(super) fn extension<'a>(view: &Object<'a>, defects: &mut Defects) -> Option<Object<'a>> {
    let extensions = view.object("extensions", defects)?;
    // A view may carry both names; the newer says the same or more.
    let name = EXTENSIONS.iter().rev().find(|name| extensions.has(name))?;
    extensions.object(name, defects)
}

/// Whether a buffer says that it has no bytes of its own because its views are compressed.
pub(super) fn is_placeholder(buffer: &Object<'_>, defects: &mut Defects) -> bool {
    let Some(extensions) = buffer.object("extensions", defects) else { return false };
    let says = |name: &&str| {
        let extension = extensions.object(name, defects);
        extension.is_some_and(|e| e.boolean("fallback", defects) == Some(true))
    };
    EXTENSIONS.iter().any(says)
}

/// Reads a view's extension. `buffer_lengths`: `[buffer_count]` claimed lengths, `None` where unknown.
pub(super) fn read_encoded(
    object: &Object<'_>,
    buffer_lengths: &[Option<u64>],
    defects: &mut Defects,
) -> Option<Encoded> {
    let buffer = object.need_index("buffer", "buffers", buffer_lengths.len(), defects);
    let length = object.need_unsigned("byteLength", defects);
    let start = if object.has("byteOffset") { object.unsigned("byteOffset", defects) } else { Some(0) };
    let stride = object.need_unsigned("byteStride", defects);
    let count = object.need_unsigned("count", defects);
    let mode = read_mode(object, defects);
    let filter = read_filter(object, defects);
    let encoded = Encoded {
        buffer: buffer?,
        start: start?,
        length: length?,
        count: count?,
        stride: stride?,
        mode: mode?,
        filter: filter?,
    };
    let before = defects.count();
    encoded.check(object, buffer_lengths[encoded.buffer]?, defects);
    (defects.count() == before).then_some(encoded)
}

fn read_mode(object: &Object<'_>, defects: &mut Defects) -> Option<Mode> {
    let Some(name) = object.string("mode", defects) else {
        if !object.has("mode") {
            defects.invalid(object.path_of("mode"), "is missing");
        }
        return None;
    };
    Some(match name {
        "ATTRIBUTES" => Mode::Attributes,
        "TRIANGLES" => Mode::Triangles,
        "INDICES" => Mode::Indices,
        other => {
            let message = format!("`{other}`; expected ATTRIBUTES, TRIANGLES or INDICES");
            defects.invalid(object.path_of("mode"), message);
            return None;
        }
    })
}

fn read_filter(object: &Object<'_>, defects: &mut Defects) -> Option<Filter> {
    let name = if object.has("filter") { object.string("filter", defects)? } else { "NONE" };
    Some(match name {
        "NONE" => Filter::None,
        "OCTAHEDRAL" => Filter::Octahedral,
        "QUATERNION" => Filter::Quaternion,
        "EXPONENTIAL" => Filter::Exponential,
        "COLOR" => Filter::Color,
        other => {
            let message = format!("`{other}`; expected NONE, OCTAHEDRAL, QUATERNION, EXPONENTIAL or COLOR");
            defects.invalid(object.path_of("filter"), message);
            return None;
        }
    })
}

/// The vertex codec gives at most so many bytes for one: blocks of 256 vertices may have 2 bits for a lane of 4 bytes that does
/// not change.
const GREATEST_RATIO: u64 = 256 * 4;
/// Bytes that even an empty stream decodes from: header and tail.
const SLACK: u64 = 4096;

impl Encoded {
    /// The extension's rules and the codecs' bounds.
    fn check(&self, object: &Object<'_>, have: u64, defects: &mut Defects) {
        let mut wrong = |key: &str, message: String| defects.invalid(object.path_of(key), message);
        let Encoded { stride, count, length, .. } = *self;
        let stride_fits = match self.mode {
            Mode::Attributes => stride % 4 == 0 && (4..=256).contains(&stride),
            Mode::Triangles | Mode::Indices => stride == 2 || stride == 4,
        };
        if !stride_fits {
            wrong("byteStride", format!("{stride} bytes do not suit the mode"));
            return;
        }
        let filter_fits = match self.filter {
            Filter::None => true,
            Filter::Octahedral | Filter::Color => stride == 4 || stride == 8,
            Filter::Quaternion => stride == 8,
            Filter::Exponential => true,
        };
        if !filter_fits || self.filter != Filter::None && self.mode != Mode::Attributes {
            wrong("filter", format!("does not suit elements of {stride} bytes in this mode"));
        }
        if self.mode == Mode::Triangles && count % 3 != 0 {
            wrong("count", format!("{count} indices are no whole triangles"));
        }
        let most = match self.mode {
            Mode::Attributes => length.saturating_mul(GREATEST_RATIO).saturating_add(SLACK) / stride,
            // A byte or more for every triangle, or for every index.
            Mode::Triangles => length.saturating_mul(3),
            Mode::Indices => length,
        };
        if count == 0 || count > most {
            wrong("count", format!("{count} elements cannot come out of {length} bytes"));
        }
        if self.start.checked_add(length).is_none_or(|end| end > have) {
            let (start, buffer) = (self.start, self.buffer);
            let message = format!("{length} bytes from byte {start} do not fit into buffers[{buffer}] of {have} bytes");
            defects.invalid(object.path.clone(), message);
        }
    }

    /// The decoded elements: [`Encoded::decoded_length`] bytes.
    fn decode(&self, buffers: &[Bytes<'_>]) -> Option<Vec<u8>> {
        let start = usize::try_from(self.start).ok()?;
        let bytes = buffers.get(self.buffer)?.get(start..start.checked_add(usize::try_from(self.length).ok()?)?)?;
        let count = usize::try_from(self.count).ok()?;
        let stride = self.stride as usize;
        let mut out = codec::decode(self.mode, bytes, count, stride)?;
        codec::filter(self.filter, &mut out, stride);
        Some(out)
    }
}

/// Decodes every compressed view into the buffer that it stands for: entry `i` of the result belongs to the `i`-th of them.
/// `limit`: bytes that may be decoded in all.
pub(super) fn decode_views(views: &[Option<View>], buffers: &mut Vec<Bytes<'_>>, limit: u64, defects: &mut Defects) {
    let compressed = || views.iter().enumerate().filter_map(|(i, v)| Some((i, v.as_ref()?.encoded?)));
    let sum = compressed().fold(0u64, |sum, (_, encoded)| sum.saturating_add(encoded.decoded_length()));
    if sum > limit {
        defects.invalid("bufferViews", format!("{sum} bytes after decompression, the limit is {limit}"));
        return;
    }
    // Many views over the same bytes would cost a small file much: each byte may be decoded once.
    let encoded = compressed().fold(0u64, |sum, (_, encoded)| sum.saturating_add(encoded.length));
    let have = buffers.iter().fold(0u64, |sum, buffer| sum.saturating_add(buffer.len() as u64));
    if encoded > have {
        defects.invalid("bufferViews", format!("{encoded} compressed bytes in buffers of {have}: views overlap"));
        return;
    }
    for (i, encoded) in compressed() {
        let decoded = encoded.decode(buffers).unwrap_or_else(|| {
            defects.invalid(format!("bufferViews[{i}]"), "its compressed data is broken");
            Vec::new()
        });
        buffers.push(Bytes::Shared(decoded.into()));
    }
}

/// The one place that calls meshoptimizer's functions, which take pointers.
#[allow(unsafe_code, reason = "meshoptimizer's safe wrappers want element types of sizes known when compiling")]
mod codec {
    use super::{Filter, Mode};
    use ::meshopt::ffi;

    /// `count` elements of `stride` bytes out of `bytes`; `None` where they are broken.
    ///
    /// The caller has checked that `stride` suits `mode`: 2 or 4 for indices, a multiple of 4 up to 256 for attributes, whole
    /// triangles for triangles. These are all preconditions that meshoptimizer asserts.
    pub(super) fn decode(mode: Mode, bytes: &[u8], count: usize, stride: usize) -> Option<Vec<u8>> {
        // Words, since the decoders may write whole ones; zeroed, so that nothing is read uninitialised.
        let mut words = vec![0u32; count.checked_mul(stride)?.div_ceil(4)];
        let to = words.as_mut_ptr().cast();
        let (from, length) = (bytes.as_ptr(), bytes.len());
        // SAFETY: `to` has room for `count * stride` bytes, aligned to 4; `from` for `length`; both outlive the call. The
        // decoders read and write inside these bounds for any content.
        let code = unsafe {
            match mode {
                Mode::Attributes => ffi::meshopt_decodeVertexBuffer(to, count, stride, from, length),
                Mode::Triangles => ffi::meshopt_decodeIndexBuffer(to, count, stride, from, length),
                Mode::Indices => ffi::meshopt_decodeIndexSequence(to, count, stride, from, length),
            }
        };
        let mut out = bytemuck::cast_slice(&words).to_vec();
        out.truncate(count * stride);
        (code == 0).then_some(out)
    }

    /// Undoes a filter in place. `data` holds whole elements of `stride` bytes, which suits `filter`.
    pub(super) fn filter(filter: Filter, data: &mut [u8], stride: usize) {
        if filter == Filter::None {
            return;
        }
        let mut words: Vec<u32> = bytemuck::pod_collect_to_vec(data);
        let count = data.len() / stride;
        let at = words.as_mut_ptr().cast();
        // SAFETY: `at` holds `count * stride` bytes, aligned to 4, which is what the filters' types need.
        unsafe {
            match filter {
                Filter::None => {}
                Filter::Octahedral => ffi::meshopt_decodeFilterOct(at, count, stride),
                Filter::Quaternion => ffi::meshopt_decodeFilterQuat(at, count, stride),
                Filter::Exponential => ffi::meshopt_decodeFilterExp(at, count, stride),
                Filter::Color => ffi::meshopt_decodeFilterColor(at, count, stride),
            }
        }
        data.copy_from_slice(&bytemuck::cast_slice(&words)[..data.len()]);
    }
}
