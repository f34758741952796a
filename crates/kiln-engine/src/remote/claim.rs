//! Bytes from a remote to records: what is accepted as a claim, and nothing else.
//!
//! ```text
//! record object   "kilnrec1", BLAKE3 of the payload, payload; then, if signed, "kilnsig1", public key, signature
//! payload         bincode `legacy()` of a record: see `store/record.rs`
//! signed          "kiln signed record 1" and the payload's hash: the fingerprint is in the payload
//! list object     as a record object without signature; payload: paths. It says what to look at, never what is true
//! ```

use std::collections::BTreeSet;

use super::sign::{PublicKey, SigningKey};
use crate::hash::Fingerprint;
use crate::report::Record;
use crate::store::{decode, open_sealed, sealed};

/// Longest record or list that is taken, bytes.
pub(crate) const CLAIM_LIMIT: u64 = 16 << 20;

/// Most outputs, found files, or listed paths.
const MOST_ENTRIES: usize = 1 << 16;
/// Longest name or path, bytes.
const LONGEST_NAME: usize = 4096;

const SIGNATURE_MAGIC: &[u8; 8] = b"kilnsig1";
/// Magic, public key, signature.
const SIGNATURE: usize = 8 + 32 + 64;
const SIGNED_DOMAIN: &[u8] = b"kiln signed record 1";

fn signed_message(sealed: &[u8]) -> Option<Vec<u8>> {
    Some([SIGNED_DOMAIN, sealed.get(8..40)?].concat())
}

/// The bytes to send for a record.
pub(crate) fn record_object(record: &Record, key: Option<&SigningKey>) -> Vec<u8> {
    let mut bytes = sealed(record);
    if let Some((key, message)) = key.zip(signed_message(&bytes)) {
        let signature = key.sign(&message);
        bytes.extend_from_slice(SIGNATURE_MAGIC);
        bytes.extend_from_slice(&key.public().0);
        bytes.extend_from_slice(&signature);
    }
    bytes
}

/// The record in `bytes`, or what is wrong with them. With `trusted` keys it must be signed by one of them.
pub(crate) fn open_record(
    bytes: &[u8],
    fingerprint: &Fingerprint,
    trusted: &[PublicKey],
    longest_blob: u64,
) -> Result<Record, &'static str> {
    let (object, signature) = split_signature(bytes);
    if !trusted.is_empty() {
        let (key, signature) = signature.ok_or("is not signed")?;
        let key =
            trusted.iter().find(|trusted| trusted.0[..] == *key).ok_or("is signed by a key that is not trusted")?;
        let message = signed_message(object).ok_or("is too short")?;
        if !key.verifies(&message, signature) {
            return Err("has a wrong signature");
        }
    }
    let payload = open_sealed(object).ok_or("is damaged")?;
    let record: Record = decode(payload).ok_or("is no record")?;
    if record.fingerprint != *fingerprint {
        return Err("is the record of something else");
    }
    well_formed(&record, longest_blob)?;
    Ok(record)
}

/// The sealed object alone: who looks after a remote folder with `kiln cache` need not know its signers.
pub(crate) fn unsigned(bytes: &[u8]) -> &[u8] {
    split_signature(bytes).0
}

type KeyAndSignature<'a> = (&'a [u8], &'a [u8]);

/// The sealed object, and key and signature if there are any.
fn split_signature(bytes: &[u8]) -> (&[u8], Option<KeyAndSignature<'_>>) {
    let Some(at) = bytes.len().checked_sub(SIGNATURE) else { return (bytes, None) };
    let (object, tail) = bytes.split_at(at);
    match tail.strip_prefix(SIGNATURE_MAGIC) {
        Some(rest) => (object, Some(rest.split_at(32))),
        None => (bytes, None),
    }
}

fn well_formed(record: &Record, longest_blob: u64) -> Result<(), &'static str> {
    let mut names = BTreeSet::new();
    if record.outputs.len() > MOST_ENTRIES || record.discovered.len() > MOST_ENTRIES {
        return Err("has too many entries");
    }
    for output in &record.outputs {
        if !is_name(&output.name) || !names.insert(&output.name) {
            return Err("has a wrong or repeated output name");
        }
        if output.length > longest_blob {
            return Err("names a blob that is too long");
        }
    }
    if !record.discovered.iter().all(|(path, _)| is_path(path))
        || !record.discovered.is_sorted_by(|(a, _), (b, _)| a < b)
    {
        return Err("has a wrong list of files");
    }
    let timed = record.seconds.is_finite() && record.seconds >= 0.0;
    if !timed || !is_name(&record.kind) {
        return Err("has a wrong kind or time");
    }
    // Its sentences are shown to people: nothing in it may speak to a terminal.
    let report = std::str::from_utf8(&record.report).map_err(|_| "has a wrong report")?;
    if speaks_to_terminals(report) {
        return Err("has a report with control characters");
    }
    Ok(())
}

/// Whether a JSON text holds control characters, plain or escaped, but for white space.
fn speaks_to_terminals(json: &str) -> bool {
    let mut rest = json.chars();
    while let Some(c) = rest.next() {
        if c.is_control() && !c.is_ascii_whitespace() {
            return true;
        }
        if c == '\\' {
            let digits = rest.as_str().get(1..5).and_then(|digits| u32::from_str_radix(digits, 16).ok());
            match rest.next() {
                Some('b' | 'f') => return true,
                Some('u') if digits.and_then(char::from_u32).is_some_and(char::is_control) => return true,
                _ => {}
            }
        }
    }
    false
}

fn is_name(name: &str) -> bool {
    !name.is_empty() && name.len() <= LONGEST_NAME && !name.chars().any(char::is_control)
}

/// A relative path; whether it may lead out of its folder the action says, see `build/resolve.rs`.
fn is_path(path: &str) -> bool {
    is_name(path) && !path.starts_with('/') && !path.contains(['\\', ':'])
}

/// The bytes to send for a list.
pub(crate) fn list_object(list: &[String]) -> Vec<u8> {
    sealed(&list.to_vec())
}

/// The list in `bytes`.
pub(crate) fn open_list(bytes: &[u8]) -> Result<Vec<String>, &'static str> {
    let list: Vec<String> = open_sealed(bytes).and_then(decode).ok_or("is damaged")?;
    let sound = list.len() <= MOST_ENTRIES && list.iter().all(|path| is_path(path));
    if sound && list.is_sorted_by(|a, b| a < b) { Ok(list) } else { Err("is no list of files") }
}
