//! URIs: data URIs decoded, file URIs turned into paths that stay inside the model's folder.

/// What a URI refers to.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Target {
    /// The bytes themselves.
    Bytes(Vec<u8>),
    /// A file: '/'-separated path below the model's folder.
    File(String),
}

/// What `uri` refers to.
///
/// # Errors
/// What is wrong with it: other schemes, absolute paths, broken escapes or base64.
pub(super) fn resolve(uri: &str) -> Result<Target, String> {
    if let Some(data) = strip_scheme(uri, "data:") {
        return decode_data(data).map(Target::Bytes);
    }
    let decoded = percent_decode(uri)?;
    let text = String::from_utf8(decoded).map_err(|_| "file name is not UTF-8".to_owned())?;
    relative(&text).map(Target::File)
}

fn strip_scheme<'a>(uri: &'a str, scheme: &str) -> Option<&'a str> {
    let head = uri.get(..scheme.len())?;
    head.eq_ignore_ascii_case(scheme).then(|| &uri[scheme.len()..])
}

/// What to say of a path that leaves the model's folder and may not.
pub(super) fn leaves(path: &str) -> String {
    format!("`{path}` leaves the model's folder; move the file beside the model, or allow files outside")
}

/// The path without `.` and inner `..`. Where it leaves the folder it starts with `..`; it is never absolute.
pub(super) fn relative(text: &str) -> Result<String, String> {
    let absolute = || format!("`{text}` is no relative path; move the file beside the model");
    if text.is_empty() {
        return Err("is empty".into());
    }
    if text.contains(['\\', '\0']) {
        return Err(format!("`{text}` holds a backslash or a zero; separate folders by /"));
    }
    if text.starts_with('/') {
        return Err(absolute());
    }
    let mut parts: Vec<&str> = Vec::new();
    for (i, part) in text.split('/').enumerate() {
        match part {
            "" | "." => {}
            ".." => match parts.last() {
                Some(last) if *last != ".." => drop(parts.pop()),
                _ => parts.push(".."),
            },
            // `http://x`, `file:x`, `C:x`: neither remote nor absolute files are fetched.
            part if i == 0 && part.contains(':') => return Err(absolute()),
            part => parts.push(part),
        }
    }
    match parts.last() {
        Some(last) if *last != ".." => Ok(parts.join("/")),
        _ => Err(format!("`{text}` is a folder")),
    }
}

fn percent_decode(text: &str) -> Result<Vec<u8>, String> {
    let mut out = Vec::with_capacity(text.len());
    let mut bytes = text.bytes();
    while let Some(byte) = bytes.next() {
        if byte != b'%' {
            out.push(byte);
            continue;
        }
        let mut digit = || bytes.next().and_then(|b| char::from(b).to_digit(16));
        match (digit(), digit()) {
            (Some(high), Some(low)) => out.push((high << 4 | low) as u8),
            _ => return Err("a % without two hexadecimal digits behind it".into()),
        }
    }
    Ok(out)
}

/// `[mediatype][;base64],data`
fn decode_data(text: &str) -> Result<Vec<u8>, String> {
    let (head, data) = text.split_once(',').ok_or("data URI without a comma")?;
    let is_base64 = head.rsplit(';').next().is_some_and(|last| last.trim().eq_ignore_ascii_case("base64"));
    let raw = percent_decode(data)?;
    if is_base64 { decode_base64(&raw) } else { Ok(raw) }
}

fn decode_base64(text: &[u8]) -> Result<Vec<u8>, String> {
    let digits = match text {
        [head @ .., b'=', b'='] | [head @ .., b'='] => head,
        whole => whole,
    };
    let mut out = Vec::with_capacity(digits.len() / 4 * 3 + 2);
    let mut held = 0u32;
    let mut bits = 0;
    for (i, byte) in digits.iter().enumerate() {
        let value = match byte {
            b'A'..=b'Z' => byte - b'A',
            b'a'..=b'z' => byte - b'a' + 26,
            b'0'..=b'9' => byte - b'0' + 52,
            b'+' | b'-' => 62,
            b'/' | b'_' => 63,
            _ => return Err(format!("byte {i} of the base64 data is no base64 digit")),
        };
        held = (held << 6 | value as u32) & 0xFFFF;
        bits += 6;
        if bits >= 8 {
            bits -= 8;
            out.push((held >> bits) as u8);
        }
    }
    // One digit alone holds 6 bits: no byte.
    if bits == 6 { Err("base64 data ends inside a byte".into()) } else { Ok(out) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_uris_are_decoded_and_stay_inside() {
        let file = |uri: &str| resolve(uri).expect("inside");
        assert_eq!(file("a%20b/c.png"), Target::File("a b/c.png".into()));
        assert_eq!(file("./x/../tex.png"), Target::File("tex.png".into()));
        assert_eq!(file("%C3%A4.bin"), Target::File("\u{e4}.bin".into()));
    }

    #[test]
    fn uris_that_are_no_relative_paths_are_refused() {
        for uri in [
            "/etc/passwd",
            "//host/x",
            "http://host/x.bin",
            "file:x",
            "C:/x",
            "a\\..\\..\\x",
            "..",
            ".",
            "",
            "a%00b",
            "%zz",
            "%F",
        ] {
            assert!(resolve(uri).is_err(), "{uri} was taken");
        }
    }

    #[test]
    fn paths_that_leave_the_folder_say_so_at_their_start() {
        let file = |uri: &str| resolve(uri).ok();
        assert_eq!(file("../a/b.png"), Some(Target::File("../a/b.png".into())));
        assert_eq!(file("%2e%2e/b.png"), Some(Target::File("../b.png".into())));
        assert_eq!(file("a/../../../b.png"), Some(Target::File("../../b.png".into())));
        for uri in ["..", "a/../..", "/etc/passwd", "http://host/x", "C:/x", "..\\x"] {
            assert_eq!(file(uri), None, "{uri}");
        }
    }

    #[test]
    fn data_uris_are_decoded() {
        let data = |uri: &str| resolve(uri).expect("data");
        assert_eq!(data("data:application/octet-stream;base64,AAEC/w=="), Target::Bytes(vec![0, 1, 2, 255]));
        assert_eq!(data("DATA:;base64,TWE="), Target::Bytes(b"Ma".to_vec()));
        assert_eq!(data("data:;base64,TWFu"), Target::Bytes(b"Man".to_vec()));
        assert_eq!(data("data:;base64,TWFu%2B%2B%2B%2B"), Target::Bytes(vec![b'M', b'a', b'n', 0xFB, 0xEF, 0xBE]));
        assert_eq!(data("data:text/plain,a%20b"), Target::Bytes(b"a b".to_vec()));
        for uri in ["data:;base64", "data:;base64,A", "data:;base64,TW!u", "data:;base64,T=Fu"] {
            assert!(resolve(uri).is_err(), "{uri} was taken");
        }
    }
}
