//! Rows of numbers in three encodings.

use super::super::text::{Lines, excerpt, number, wide_number, words};
use super::header::{Element, Encoding, Property, Scalar};

/// The values of one row; kept from row to row for its memory.
#[derive(Default)]
pub(super) struct Row {
    /// Values of all properties one behind the other.
    values: Vec<f64>,
    /// First value by property, and the end.
    firsts: Vec<usize>,
}

impl Row {
    /// The values of a property: one, or a list's.
    pub(super) fn list(&self, property: usize) -> &[f64] {
        &self.values[self.firsts[property]..self.firsts[property + 1]]
    }

    /// The value of a property that is no list.
    pub(super) fn scalar(&self, property: usize) -> f64 {
        self.values[self.firsts[property]]
    }
}

/// What is wrong with a row.
pub(super) struct Fault {
    /// Property, if it is one's fault.
    pub(super) property: Option<usize>,
    pub(super) message: String,
    /// The rows behind it cannot be found.
    pub(super) fatal: bool,
}

/// Reads rows one behind the other.
pub(super) struct Rows<'a> {
    encoding: Encoding,
    lines: Lines<'a>,
    /// Lines before the first row.
    header_lines: u64,
    bytes: &'a [u8],
}

impl<'a> Rows<'a> {
    pub(super) fn new(encoding: Encoding, header_lines: u64, body: &'a [u8]) -> Rows<'a> {
        Rows { encoding, lines: Lines::new(body), header_lines, bytes: body }
    }

    /// The next row of `element`.
    pub(super) fn read(&mut self, element: &Element, row: &mut Row) -> Result<(), Fault> {
        row.values.clear();
        row.firsts.clear();
        match self.encoding {
            Encoding::Text => self.read_text(element, row)?,
            _ => self.read_binary(element, row)?,
        }
        row.firsts.push(row.values.len());
        Ok(())
    }

    /// Passes over all rows of `element`.
    pub(super) fn skip(&mut self, element: &Element, row: &mut Row) -> Result<(), Fault> {
        let fixed = element.properties.iter().all(|p| p.count.is_none());
        if self.encoding != Encoding::Text && fixed {
            let size = element.least_bytes(self.encoding).saturating_mul(element.count);
            let rest = usize::try_from(size).ok().and_then(|size| self.bytes.get(size..));
            self.bytes = rest.ok_or_else(truncated)?;
            return Ok(());
        }
        // What is not used need not be right, only there.
        for _ in 0..element.count {
            match self.encoding {
                Encoding::Text => drop(self.line()?),
                _ => self.read(element, row)?,
            }
        }
        Ok(())
    }

    /// The next line that is not blank.
    fn line(&mut self) -> Result<(u64, &'a [u8]), Fault> {
        loop {
            let (number, line) = self.lines.line().ok_or_else(truncated)?;
            if !line.trim_ascii().is_empty() {
                return Ok((number + self.header_lines, line));
            }
        }
    }

    fn read_text(&mut self, element: &Element, row: &mut Row) -> Result<(), Fault> {
        let (number, line) = self.line()?;
        let fault =
            |property, message: String| Fault { property, message: format!("{message} (line {number})"), fatal: false };
        let mut words = words(line);
        for (k, property) in element.properties.iter().enumerate() {
            row.firsts.push(row.values.len());
            let mut next = |scalar: Scalar| {
                let word = words.next().ok_or_else(|| fault(Some(k), "the line ends before it".into()))?;
                parse(word, scalar).map_err(|message| fault(Some(k), message))
            };
            let count = match property.count {
                Some(count) => length(next(count)?).map_err(|message| fault(Some(k), message))?,
                None => 1,
            };
            for _ in 0..count {
                // Each value is a word of the line, so a wrong count costs nothing.
                row.values.push(next(property.scalar)?);
            }
        }
        match words.next() {
            Some(word) => Err(fault(None, format!("the line goes on with {}", excerpt(word)))),
            None => Ok(()),
        }
    }

    fn read_binary(&mut self, element: &Element, row: &mut Row) -> Result<(), Fault> {
        for (k, property) in element.properties.iter().enumerate() {
            row.firsts.push(row.values.len());
            let at = |mut fault: Fault| {
                fault.property = Some(k);
                fault
            };
            let count = match property.count {
                Some(count) => {
                    let found = self.number(count).map_err(at)?;
                    length(found).map_err(|message| Fault { property: Some(k), message, fatal: true })?
                }
                None => 1,
            };
            self.values(property, count, row).map_err(at)?;
        }
        Ok(())
    }

    fn values(&mut self, property: &Property, count: u64, row: &mut Row) -> Result<(), Fault> {
        let size = count.saturating_mul(property.scalar.size() as u64);
        if size > self.bytes.len() as u64 {
            return Err(truncated());
        }
        for _ in 0..count {
            let value = self.number(property.scalar)?;
            row.values.push(value);
        }
        Ok(())
    }

    fn number(&mut self, scalar: Scalar) -> Result<f64, Fault> {
        let (head, rest) = self.bytes.split_at_checked(scalar.size()).ok_or_else(truncated)?;
        self.bytes = rest;
        let mut word = [0u8; 8];
        // The number's bytes stand first, the least significant one before the others.
        word[..head.len()].copy_from_slice(head);
        if self.encoding == Encoding::BigEndian {
            word[..head.len()].reverse();
        }
        let bits = u64::from_le_bytes(word);
        Ok(match scalar {
            Scalar::I8 => f64::from(bits as i8),
            Scalar::U8 => f64::from(bits as u8),
            Scalar::I16 => f64::from(bits as i16),
            Scalar::U16 => f64::from(bits as u16),
            Scalar::I32 => f64::from(bits as i32),
            Scalar::U32 => f64::from(bits as u32),
            Scalar::F32 => f64::from(f32::from_bits(bits as u32)),
            Scalar::F64 => f64::from_bits(bits),
        })
    }
}

fn truncated() -> Fault {
    Fault { property: None, message: "the file ends inside or before it".into(), fatal: true }
}

/// A word of a text as the declared type holds it.
fn parse(word: &[u8], scalar: Scalar) -> Result<f64, String> {
    let value = match scalar {
        Scalar::F32 => number(word).map(f64::from),
        _ => wide_number(word),
    };
    let value = value.ok_or_else(|| format!("{} is no number", excerpt(word)))?;
    let (least, greatest) = scalar.range();
    let fits = scalar.is_float() || value.trunc() == value && (least..=greatest).contains(&value);
    if !fits {
        return Err(format!("{} is no integer from {least} to {greatest}", excerpt(word)));
    }
    Ok(value)
}

/// A list's count.
fn length(value: f64) -> Result<u64, String> {
    if value < 0.0 { Err(format!("a list of {value} values")) } else { Ok(value as u64) }
}
