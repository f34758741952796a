//! Lines and numbers of text formats, from bytes that need not be UTF-8.

use std::borrow::Cow;

/// The lines of a text, without their ends. A text ends its lines as it ends the first one: by LF (CR LF counts as LF), or by CR.
pub(super) struct Lines<'a> {
    rest: &'a [u8],
    end: u8,
    /// Of the line given last; the first is 1.
    number: u64,
}

impl<'a> Lines<'a> {
    pub(super) fn new(text: &'a [u8]) -> Lines<'a> {
        let first = text.iter().position(|b| matches!(b, b'\r' | b'\n'));
        let returns = first.is_some_and(|at| text[at] == b'\r' && text.get(at + 1) != Some(&b'\n'));
        Lines { rest: text, end: if returns { b'\r' } else { b'\n' }, number: 0 }
    }

    /// What lies behind the line given last.
    pub(super) fn rest(&self) -> &'a [u8] {
        self.rest
    }

    /// The next line with its number, blank ones too.
    pub(super) fn line(&mut self) -> Option<(u64, &'a [u8])> {
        if self.rest.is_empty() {
            return None;
        }
        let length = self.rest.iter().position(|b| *b == self.end);
        let (line, rest) = self.rest.split_at(length.unwrap_or(self.rest.len()));
        self.rest = rest.get(1..).unwrap_or_default();
        self.number += 1;
        Some((self.number, line.strip_suffix(b"\r").unwrap_or(line)))
    }

    /// The next statement with the number of its first line: a line, and while it ends in a backslash, the next one too. A
    /// comment (`#`) is not continued, since a path may end it.
    pub(super) fn statement(&mut self) -> Option<(u64, Cow<'a, [u8]>)> {
        let (number, line) = self.line()?;
        let Some(head) = line.strip_suffix(b"\\").filter(|_| !line.trim_ascii_start().starts_with(b"#")) else {
            return Some((number, Cow::Borrowed(line)));
        };
        let mut joined = head.to_vec();
        while let Some((_, line)) = self.line() {
            joined.push(b' ');
            let part = line.strip_suffix(b"\\");
            joined.extend_from_slice(part.unwrap_or(line));
            if part.is_none() {
                break;
            }
        }
        Some((number, Cow::Owned(joined)))
    }
}

/// The words of a line.
pub(super) fn words(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty())
}

/// The words of a line up to a comment.
pub(super) fn values(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    words(line).take_while(|word| word[0] != b'#')
}

/// First word and what follows it, trimmed.
pub(super) fn split_keyword(line: &[u8]) -> (&[u8], &[u8]) {
    let line = line.trim_ascii();
    let length = line.iter().position(u8::is_ascii_whitespace).unwrap_or(line.len());
    (&line[..length], line[length..].trim_ascii())
}

/// A number of the file as the nearest `f32`; NaN for the spellings of C libraries (`-nan(ind)`, `1.#INF`). `None`: no number.
pub(super) fn number(word: &[u8]) -> Option<f32> {
    parse(word, f32::NAN)
}

/// The same as the nearest `f64`.
pub(super) fn wide_number(word: &[u8]) -> Option<f64> {
    parse(word, f64::NAN)
}

fn parse<T: std::str::FromStr>(word: &[u8], nan: T) -> Option<T> {
    let text = std::str::from_utf8(word).ok()?;
    if let Ok(value) = text.parse() {
        return Some(value);
    }
    let lower = text.trim_start_matches(['+', '-']).to_ascii_lowercase();
    (lower.starts_with("nan(") || ["1.#ind", "1.#qnan", "1.#snan", "1.#inf"].iter().any(|c| lower.starts_with(c)))
        .then_some(nan)
}

/// Text for people: what is no UTF-8 is replaced, and at most `most` characters are kept.
pub(super) fn lossy(bytes: &[u8], most: usize) -> String {
    // No character has more than 4 bytes.
    let head = &bytes[..bytes.len().min(4 * most)];
    String::from_utf8_lossy(head).chars().take(most).map(|c| if c.is_control() { ' ' } else { c }).collect()
}

/// Longest excerpt of a file in a message, characters.
const EXCERPT: usize = 40;

/// A word of the file in a message.
pub(super) fn excerpt(word: &[u8]) -> String {
    format!("`{}`", lossy(word, EXCERPT))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all(text: &str) -> Vec<(u64, String)> {
        let mut lines = Lines::new(text.as_bytes());
        std::iter::from_fn(|| lines.statement().map(|(n, s)| (n, String::from_utf8_lossy(&s).into_owned()))).collect()
    }

    #[test]
    fn lines_end_as_the_first_one_does() {
        for text in ["a\nb\n\nc", "a\r\nb\r\n\r\nc\r\n", "a\rb\r\rc"] {
            let expected = [(1, "a"), (2, "b"), (3, ""), (4, "c")].map(|(n, s)| (n, s.to_owned()));
            assert_eq!(all(text), expected, "{text:?}");
        }
        assert!(all("").is_empty());
    }

    #[test]
    fn a_backslash_continues_a_statement_but_no_comment() {
        let expected = [(1, "f 1 2  3 "), (4, "# C:\\x\\"), (5, "v 1")].map(|(n, s)| (n, s.to_owned()));
        assert_eq!(
            all("f 1 2 \\\n3\\\n\n# C:\\x\\\nv 1\\"),
            [(1, "f 1 2  3 ".to_owned()), expected[1].clone(), expected[2].clone()]
        );
    }

    #[test]
    fn numbers_are_read_as_c_writes_them() {
        for (word, value) in
            [("1", 1.0), (".5", 0.5), ("5.", 5.0), ("+2", 2.0), ("-1e-3", -1e-3), ("inf", f32::INFINITY)]
        {
            assert_eq!(number(word.as_bytes()), Some(value), "{word}");
        }
        for word in ["nan", "-nan", "-nan(ind)", "1.#QNAN0", "-1.#IND"] {
            assert!(number(word.as_bytes()).is_some_and(f32::is_nan), "{word}");
        }
        for word in ["", "x", "1,5", "1.0f", "0x10", "--1", "1.#"] {
            assert_eq!(number(word.as_bytes()), None, "{word}");
        }
    }
}
