//! The header: encoding, and what each element's rows hold.

use super::super::error::Defects;
use super::super::text::{Lines, excerpt, lossy, split_keyword, words};

/// How rows are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    Text,
    LittleEndian,
    BigEndian,
}

/// Type of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn parse(word: &[u8]) -> Option<Scalar> {
        Some(match word {
            b"char" | b"int8" => Scalar::I8,
            b"uchar" | b"uint8" => Scalar::U8,
            b"short" | b"int16" => Scalar::I16,
            b"ushort" | b"uint16" => Scalar::U16,
            b"int" | b"int32" => Scalar::I32,
            b"uint" | b"uint32" => Scalar::U32,
            b"float" | b"float32" => Scalar::F32,
            b"double" | b"float64" => Scalar::F64,
            _ => return None,
        })
    }

    /// Bytes of one number.
    pub(super) fn size(self) -> usize {
        match self {
            Scalar::I8 | Scalar::U8 => 1,
            Scalar::I16 | Scalar::U16 => 2,
            Scalar::I32 | Scalar::U32 | Scalar::F32 => 4,
            Scalar::F64 => 8,
        }
    }

    pub(super) fn is_float(self) -> bool {
        matches!(self, Scalar::F32 | Scalar::F64)
    }

    /// Least and greatest value of an integer type.
    pub(super) fn range(self) -> (f64, f64) {
        match self {
            Scalar::I8 => (-128.0, 127.0),
            Scalar::U8 => (0.0, 255.0),
            Scalar::I16 => (-32_768.0, 32_767.0),
            Scalar::U16 => (0.0, 65_535.0),
            Scalar::I32 => (-2_147_483_648.0, 2_147_483_647.0),
            Scalar::U32 => (0.0, 4_294_967_295.0),
            Scalar::F32 | Scalar::F64 => (f64::NEG_INFINITY, f64::INFINITY),
        }
    }
}

/// A column of an element.
pub(super) struct Property {
    pub(super) name: String,
    /// Type of the value, or of a list's values.
    pub(super) scalar: Scalar,
    /// Type of the count before a list's values.
    pub(super) count: Option<Scalar>,
}

/// A kind of row.
pub(super) struct Element {
    pub(super) name: String,
    pub(super) count: u64,
    pub(super) line: u64,
    pub(super) properties: Vec<Property>,
}

impl Element {
    /// Fewest bytes that a row can take.
    pub(super) fn least_bytes(&self, encoding: Encoding) -> u64 {
        let size = |p: &Property| p.count.unwrap_or(p.scalar).size() as u64;
        match encoding {
            // A digit and what follows it.
            Encoding::Text => 2 * self.properties.len() as u64,
            _ => self.properties.iter().map(size).sum(),
        }
    }

    pub(super) fn property(&self, name: &str) -> Option<usize> {
        self.properties.iter().position(|p| p.name == name)
    }
}

/// What stands before the rows.
pub(super) struct Header<'a> {
    pub(super) encoding: Encoding,
    pub(super) elements: Vec<Element>,
    /// Values of `comment TextureFile`.
    pub(super) texture_files: Vec<(u64, String)>,
    /// The first other comment.
    pub(super) generator: String,
    /// Lines of the header.
    pub(super) line_count: u64,
    pub(super) body: &'a [u8],
}

/// Most elements, and most properties of all of them: the readers of this format know a handful.
const MOST_DECLARED: usize = 4096;

/// Reads the header. `None` where a defect was noted.
pub(super) fn read<'a>(main: &str, bytes: &'a [u8], defects: &mut Defects) -> Option<Header<'a>> {
    let mut lines = Lines::new(bytes);
    let path = |line: u64| format!("{main}:{line}");
    if lines.line().is_none_or(|(_, line)| line.trim_ascii() != b"ply") {
        defects.invalid(path(1), "does not begin with `ply`");
        return None;
    }
    let mut encoding = None;
    let mut header = Header {
        encoding: Encoding::Text,
        elements: Vec::new(),
        texture_files: Vec::new(),
        generator: String::new(),
        line_count: 0,
        body: &[],
    };
    let mut declared = 0;
    let mut sound = true;
    loop {
        let Some((number, line)) = lines.line() else {
            defects.invalid(main, "the header has no `end_header`");
            return None;
        };
        let (keyword, rest) = split_keyword(line);
        let outcome = match keyword {
            b"format" => read_format(rest).map(|found| encoding = Some(found)),
            b"comment" => {
                let (first, name) = split_keyword(rest);
                if first == b"TextureFile" {
                    header.texture_files.push((number, lossy(name, 4096)));
                } else if header.generator.is_empty() {
                    header.generator = lossy(rest, 100);
                }
                Ok(())
            }
            b"obj_info" | b"" => Ok(()),
            b"element" => read_element(rest, number, &mut header.elements),
            b"property" => read_property(rest, &mut header.elements),
            b"end_header" => {
                header.line_count = number;
                break;
            }
            other => Err(format!("{} is no statement of a header", excerpt(other))),
        };
        declared += matches!(keyword, b"element" | b"property") as usize;
        if declared > MOST_DECLARED {
            defects.invalid(path(number), format!("more than {MOST_DECLARED} elements and properties"));
            return None;
        }
        if let Err(message) = outcome {
            defects.invalid(path(number), message);
            sound = false;
        }
    }
    header.body = lines.rest();
    let Some(encoding) = encoding else {
        // A format line that is there and wrong has been told.
        if sound {
            defects.invalid(main, "the header has no `format`");
        }
        return None;
    };
    header.encoding = encoding;
    sound.then_some(header)
}

fn read_format(rest: &[u8]) -> Result<Encoding, String> {
    let mut words = words(rest);
    let encoding = match words.next().unwrap_or_default() {
        b"ascii" => Encoding::Text,
        b"binary_little_endian" => Encoding::LittleEndian,
        b"binary_big_endian" => Encoding::BigEndian,
        other => {
            let names = "`ascii`, `binary_little_endian` or `binary_big_endian`";
            return Err(format!("format {}; expected {names}", excerpt(other)));
        }
    };
    match words.next() {
        Some(b"1.0") => Ok(encoding),
        other => Err(format!("version {}; only `1.0` exists", excerpt(other.unwrap_or_default()))),
    }
}

fn read_element(rest: &[u8], line: u64, elements: &mut Vec<Element>) -> Result<(), String> {
    let mut words = words(rest);
    let (Some(name), Some(count), None) = (words.next(), words.next(), words.next()) else {
        return Err("expected `element NAME COUNT`".into());
    };
    let digits = std::str::from_utf8(count).ok();
    let parsed = digits.and_then(|digits| digits.parse().ok());
    let name = lossy(name, 100);
    // A repeated or broken one is kept, so that the properties behind it find their place.
    let repeated = elements.iter().any(|e| e.name == name);
    elements.push(Element { name: name.clone(), count: parsed.unwrap_or(0), line, properties: Vec::new() });
    match (parsed, repeated) {
        (None, _) => Err(format!("count {} is no whole number up to 2^64", excerpt(count))),
        (_, true) => Err(format!("a second element `{name}`")),
        _ => Ok(()),
    }
}

fn read_property(rest: &[u8], elements: &mut [Element]) -> Result<(), String> {
    let element = elements.last_mut().ok_or("a property before any element")?;
    let words: Vec<&[u8]> = words(rest).collect();
    let scalar = |word: &[u8]| Scalar::parse(word).ok_or_else(|| format!("{} is no type", excerpt(word)));
    let (count, item, name) = match words[..] {
        [b"list", count, item, name] => (Some(scalar(count)?), scalar(item)?, name),
        [item, name] => (None, scalar(item)?, name),
        _ => return Err("expected `property TYPE NAME` or `property list TYPE TYPE NAME`".into()),
    };
    if count.is_some_and(Scalar::is_float) {
        return Err("a list whose count is no integer".into());
    }
    let name = lossy(name, 100);
    if element.property(&name).is_some() {
        return Err(format!("a second property `{name}` of `{}`", element.name));
    }
    element.properties.push(Property { name, scalar: item, count });
    Ok(())
}
