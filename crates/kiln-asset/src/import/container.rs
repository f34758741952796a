//! The outer shell: GLB chunks, or bare JSON.

use serde_json::Value;

use super::ImportLimits;
use super::error::ImportError;
use super::report::ModelFormat;

/// A model file taken apart.
pub(super) struct Shell<'a> {
    pub(super) format: ModelFormat,
    pub(super) json: Value,
    /// The GLB's binary chunk.
    pub(super) binary: Option<&'a [u8]>,
}

const GLB_MAGIC: &[u8] = b"glTF";
const CHUNK_JSON: u32 = 0x4E4F_534A;
const CHUNK_BIN: u32 = 0x004E_4942;

/// Takes a file apart. What it is, its first bytes say; its name does not.
pub(super) fn open<'a>(main: &str, bytes: &'a [u8], limits: &ImportLimits) -> Result<Shell<'a>, ImportError> {
    let (format, json, binary) = if bytes.starts_with(GLB_MAGIC) {
        let (json, binary) = split_glb(main, bytes)?;
        (ModelFormat::Glb, json, binary)
    } else {
        (ModelFormat::Gltf, bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes), None)
    };
    if json.len() as u64 > limits.max_json_bytes {
        let message = format!("{} bytes of JSON, the limit is {}", json.len(), limits.max_json_bytes);
        return Err(ImportError::invalid(main, message));
    }
    // serde_json refuses more than 128 nested levels, so no recursion here or later can run away.
    let json = serde_json::from_slice(json).map_err(|e| ImportError::invalid(main, format!("not JSON: {e}")))?;
    Ok(Shell { format, json, binary })
}

fn word(bytes: &[u8], at: usize) -> Option<u32> {
    let word = bytes.get(at..at.checked_add(4)?)?;
    word.try_into().ok().map(u32::from_le_bytes)
}

/// The JSON chunk and the binary chunk of a GLB; other chunks are skipped, as the format asks.
fn split_glb<'a>(main: &str, bytes: &'a [u8]) -> Result<(&'a [u8], Option<&'a [u8]>), ImportError> {
    let invalid = |message: String| ImportError::invalid(main, message);
    let header = (word(bytes, 4), word(bytes, 8));
    let (Some(version), Some(length)) = header else {
        return Err(invalid(format!("GLB header of 12 bytes is cut off at {}", bytes.len())));
    };
    if version != 2 {
        return Err(ImportError::unsupported(main, format!("GLB version {version}, only 2 is read")));
    }
    if length as usize != bytes.len() {
        return Err(invalid(format!("GLB header says {length} bytes, the file has {}", bytes.len())));
    }
    let mut at = 12;
    let mut json = None;
    let mut binary = None;
    for chunk in 0.. {
        if at == bytes.len() {
            break;
        }
        let (Some(length), Some(kind)) = (word(bytes, at), word(bytes, at + 4)) else {
            return Err(invalid(format!("GLB chunk {chunk} at byte {at}: its header is cut off")));
        };
        let start = at + 8;
        let Some(content) = start.checked_add(length as usize).and_then(|end| bytes.get(start..end)) else {
            return Err(invalid(format!("GLB chunk {chunk} at byte {at}: {length} bytes do not fit into the file")));
        };
        match (chunk, kind) {
            (0, CHUNK_JSON) => json = Some(content),
            (0, _) => return Err(invalid("the first GLB chunk is not JSON".into())),
            (1, CHUNK_BIN) => binary = Some(content),
            _ => {}
        }
        at = start + content.len();
    }
    let json = json.ok_or_else(|| invalid("GLB without a JSON chunk".into()))?;
    Ok((json, binary))
}
