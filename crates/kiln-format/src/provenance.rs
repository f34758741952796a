//! What made the file, and how strings lie in tables.
//!
//! The section carries its own strings, so that no other section changes when only its maker does.

use unicode_normalization::UnicodeNormalization;

use crate::envelope::first_nonzero;
use crate::error::{Code, FormatError};
use crate::prelude::*;
use crate::record::{MAX_STRING, ProvenanceHeader};

/// What made the file. No times, no absolute paths, no names of machines: the same build gives the same bytes everywhere.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Provenance {
    /// BLAKE3 of the pipeline with its defaults filled in.
    pub pipeline: [u8; 32],
    /// The tool and its version: `kiln 0.1.0`.
    pub tool: String,
    /// The numeric class: which machines give the same bytes.
    pub numeric_class: String,
    /// The device class of stages that ran on a GPU, or empty.
    pub device_class: String,
    /// Inputs by relative name, each with the BLAKE3 of its bytes; sorted by name.
    pub inputs: Vec<(String, [u8; 32])>,
    /// Stages in order: id or kind, and semantic version.
    pub stages: Vec<(String, String)>,
}

/// Appends length, bytes in normalisation form C, and zeros up to a multiple of 4.
pub(crate) fn put_string(out: &mut Vec<u8>, string: &str) -> Result<(), FormatError> {
    let normal: String = string.nfc().collect();
    if normal.len() > MAX_STRING as usize {
        let found = format!("{} bytes", normal.len());
        return Err(FormatError::new(Code::Text, "string", format!("at most {MAX_STRING} bytes"), found));
    }
    out.extend((normal.len() as u32).to_le_bytes());
    out.extend(normal.as_bytes());
    out.resize(out.len().next_multiple_of(4), 0);
    Ok(())
}

fn cut<'a>(rest: &mut &'a [u8], count: usize, at: &str) -> Result<&'a [u8], FormatError> {
    let (head, tail) = rest.split_at_checked(count).ok_or_else(|| {
        FormatError::new(Code::TableLength, at, format!("{count} bytes"), format!("{} bytes", rest.len()))
    })?;
    *rest = tail;
    Ok(head)
}

/// Cuts what [`put_string`] appended off the front.
pub(crate) fn cut_string<'a>(rest: &mut &'a [u8], at: &str) -> Result<&'a str, FormatError> {
    let length: u32 = bytemuck::pod_read_unaligned(cut(rest, 4, at)?);
    if length > MAX_STRING {
        return Err(FormatError::new(Code::Text, at, format!("at most {MAX_STRING} bytes"), length));
    }
    let bytes = cut(rest, length as usize, at)?;
    let padding = cut(rest, (length as usize).next_multiple_of(4) - length as usize, at)?;
    if let Some((_, byte)) = first_nonzero(padding) {
        return Err(FormatError::new(Code::Padding, at, "zeros behind the string", format!("{byte:#04x}")));
    }
    let string = core::str::from_utf8(bytes)
        .map_err(|e| FormatError::new(Code::Text, at, "UTF-8", format!("bad bytes after {}", e.valid_up_to())))?;
    if !unicode_normalization::is_nfc(string) {
        return Err(FormatError::new(Code::Text, at, "normalisation form C", format!("{string:?}")));
    }
    Ok(string)
}

/// The section's bytes; inputs are sorted by name.
pub(crate) fn write(provenance: &Provenance) -> Result<Vec<u8>, FormatError> {
    let header = ProvenanceHeader {
        pipeline: provenance.pipeline,
        input_count: provenance.inputs.len() as u32,
        stage_count: provenance.stages.len() as u32,
        reserved: [0; 6],
    };
    let mut out = bytemuck::bytes_of(&header).to_vec();
    for string in [&provenance.tool, &provenance.numeric_class, &provenance.device_class] {
        put_string(&mut out, string)?;
    }
    let mut inputs: Vec<_> =
        provenance.inputs.iter().map(|(name, hash)| (name.nfc().collect::<String>(), hash)).collect();
    inputs.sort();
    for (name, hash) in inputs {
        out.extend(hash);
        put_string(&mut out, &name)?;
    }
    for (name, version) in &provenance.stages {
        put_string(&mut out, name)?;
        put_string(&mut out, version)?;
    }
    Ok(out)
}

/// The section's content.
pub(crate) fn read(mut rest: &[u8], strict: bool) -> Result<Provenance, FormatError> {
    let header: ProvenanceHeader = bytemuck::pod_read_unaligned(cut(&mut rest, size_of::<ProvenanceHeader>(), "PROV")?);
    if strict && header.reserved != [0; 6] {
        return Err(FormatError::new(Code::Reserved, "PROV.reserved", "zero", "another value"));
    }
    // An input takes at least 36 bytes, a stage 8: counts beyond the section are refused before anything is kept for them.
    let least = header.input_count as u64 * 36 + header.stage_count as u64 * 8;
    if least > rest.len() as u64 {
        let expected = format!("{} inputs and {} stages", header.input_count, header.stage_count);
        return Err(FormatError::new(Code::TableLength, "PROV", expected, format!("{} bytes", rest.len())));
    }
    let mut provenance = Provenance {
        pipeline: header.pipeline,
        tool: cut_string(&mut rest, "PROV.tool")?.into(),
        numeric_class: cut_string(&mut rest, "PROV.numeric_class")?.into(),
        device_class: cut_string(&mut rest, "PROV.device_class")?.into(),
        ..Provenance::default()
    };
    for number in 0..header.input_count {
        let at = format!("PROV.inputs[{number}]");
        let hash: [u8; 32] = bytemuck::pod_read_unaligned(cut(&mut rest, 32, &at)?);
        let name = cut_string(&mut rest, &at)?;
        if provenance.inputs.last().is_some_and(|(last, hash_before)| (last.as_str(), hash_before) > (name, &hash)) {
            return Err(FormatError::new(Code::Order, at, "inputs sorted by name", format!("{name:?}")));
        }
        provenance.inputs.push((name.into(), hash));
    }
    for number in 0..header.stage_count {
        let at = format!("PROV.stages[{number}]");
        let name = cut_string(&mut rest, &at)?.to_string();
        provenance.stages.push((name, cut_string(&mut rest, &at)?.into()));
    }
    if !rest.is_empty() {
        return Err(FormatError::new(Code::TableLength, "PROV", "the end", format!("{} bytes more", rest.len())));
    }
    Ok(provenance)
}
