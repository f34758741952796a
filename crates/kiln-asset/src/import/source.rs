//! Where bytes come from: files beside the model, data URIs, the GLB's binary chunk.

use std::collections::BTreeMap;
use std::io;
use std::ops::Deref;
use std::sync::Arc;

use super::error::Defects;
use super::json::Object;
use super::meshopt;
use super::uri::{self, Target};
use super::{Files, ImportLimits};

/// Bytes in memory, borrowed from the model's file or shared.
#[derive(Clone)]
pub(super) enum Bytes<'a> {
    Borrowed(&'a [u8]),
    Shared(Arc<[u8]>),
}

impl Deref for Bytes<'_> {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        match self {
            Bytes::Borrowed(bytes) => bytes,
            Bytes::Shared(bytes) => bytes,
        }
    }
}

/// Why a URI gives no bytes.
pub(super) enum Failure {
    /// The URI itself is wrong, or the file is past the limits.
    Invalid(String),
    /// There is no such file.
    Missing(String),
    /// The system's fault.
    Io(String),
}

/// Loads what URIs refer to, each file once.
pub(super) struct Sources<'f> {
    files: &'f dyn Files,
    loaded: BTreeMap<String, Arc<[u8]>>,
    /// Bytes that may still be loaded.
    left: u64,
    /// Files may lie outside the model's folder.
    outside: bool,
}

impl<'f> Sources<'f> {
    pub(super) fn new(files: &'f dyn Files, limits: &ImportLimits) -> Sources<'f> {
        Sources { files, loaded: BTreeMap::new(), left: limits.max_file_bytes, outside: limits.allow_outside }
    }

    /// The file `relative`, if it lies where files may lie; at most as long as the limits leave.
    pub(super) fn file(&mut self, relative: &str) -> Result<Arc<[u8]>, Failure> {
        if relative.starts_with("../") && !self.outside {
            return Err(Failure::Invalid(uri::leaves(relative)));
        }
        if let Some(bytes) = self.loaded.get(relative) {
            return Ok(bytes.clone());
        }
        let bytes = self.files.read_at_most(relative, self.left).map_err(|e| match e.kind() {
            io::ErrorKind::NotFound => Failure::Missing(format!("there is no file `{relative}`")),
            _ => Failure::Io(format!("`{relative}`: {e}")),
        })?;
        let Some(left) = self.left.checked_sub(bytes.len() as u64) else {
            return Err(Failure::Invalid(format!("`{relative}` exceeds the limit on bytes of one model's files")));
        };
        self.left = left;
        let bytes: Arc<[u8]> = bytes.into();
        self.loaded.insert(relative.to_owned(), bytes.clone());
        Ok(bytes)
    }

    /// What a URI refers to, and its file's path if it is one.
    pub(super) fn uri(&mut self, uri: &str) -> Result<(Arc<[u8]>, Option<String>), Failure> {
        match uri::resolve(uri).map_err(Failure::Invalid)? {
            Target::Bytes(bytes) => Ok((bytes.into(), None)),
            Target::File(path) => Ok((self.file(&path)?, Some(path))),
        }
    }
}

/// The buffers' claimed lengths (`None`: unknown; 0 where a buffer only holds a place for what compressed views decode to) and
/// bytes (empty where defective).
pub(super) fn read_buffers<'a>(
    root: &Object<'_>,
    binary: Option<&'a [u8]>,
    sources: &mut Sources<'_>,
    defects: &mut Defects,
) -> (Vec<Option<u64>>, Vec<Bytes<'a>>) {
    let mut lengths = Vec::new();
    let mut contents = Vec::new();
    for (i, buffer) in root.objects("buffers", defects).iter().enumerate() {
        let length = buffer.as_ref().and_then(|buffer| buffer.need_unsigned("byteLength", defects));
        if let Some(buffer) = buffer
            && !buffer.has("uri")
            && (i > 0 || binary.is_none())
            && meshopt::is_placeholder(buffer, defects)
        {
            lengths.push(Some(0));
            contents.push(Bytes::Borrowed(&[]));
            continue;
        }
        let bytes = buffer.as_ref().and_then(|buffer| {
            let binary = binary.filter(|_| i == 0);
            read_buffer(buffer, binary, sources, defects)
        });
        if let (Some(buffer), Some(length), Some(bytes)) = (buffer, length, &bytes)
            && (bytes.len() as u64) < length
        {
            let message = format!("says {length} bytes, but there are {}", bytes.len());
            defects.invalid(buffer.path_of("byteLength"), message);
        }
        lengths.push(length);
        contents.push(bytes.unwrap_or(Bytes::Borrowed(&[])));
    }
    (lengths, contents)
}

fn read_buffer<'a>(
    buffer: &Object<'_>,
    binary: Option<&'a [u8]>,
    sources: &mut Sources<'_>,
    defects: &mut Defects,
) -> Option<Bytes<'a>> {
    if !buffer.has("uri") {
        if binary.is_none() {
            defects.invalid(buffer.path.clone(), "has no URI and is not a GLB's own first buffer");
        }
        return binary.map(Bytes::Borrowed);
    }
    let uri = buffer.string("uri", defects)?;
    let path = buffer.path_of("uri");
    match sources.uri(uri) {
        Ok((bytes, _)) => Some(Bytes::Shared(bytes)),
        Err(Failure::Invalid(message)) => {
            defects.invalid(path, message);
            None
        }
        Err(Failure::Missing(message) | Failure::Io(message)) => {
            defects.io(path, message);
            None
        }
    }
}
