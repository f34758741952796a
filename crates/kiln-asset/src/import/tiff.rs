//! The size of a TIFF's first picture, from its first directory alone.

/// Classic and BigTIFF, both byte orders.
pub(super) const MAGICS: [&[u8]; 4] = [b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"];

/// Tags and types of a directory's entries.
const WIDTH: u64 = 256;
const HEIGHT: u64 = 257;
const SHORT: u64 = 3;
const LONG: u64 = 4;
const LONG8: u64 = 16;

/// Width and height, texels.
pub(super) fn size(bytes: &[u8]) -> Option<(u32, u32)> {
    let big_endian = bytes.starts_with(b"MM");
    let number = |at: u64, count: usize| -> Option<u64> {
        let at = usize::try_from(at).ok()?;
        let part = bytes.get(at..at.checked_add(count)?)?;
        let fold = |sum: u64, byte: &u8| sum << 8 | u64::from(*byte);
        Some(if big_endian { part.iter().fold(0, fold) } else { part.iter().rev().fold(0, fold) })
    };
    MAGICS.iter().any(|magic| bytes.starts_with(magic)).then_some(())?;
    let big = number(2, 2)? == 43;
    // BigTIFF: word size 8 and a zero, then everything wider.
    let (directory, word, entry) = if big { (number(8, 8)?, 8, 20) } else { (number(4, 4)?, 4, 12) };
    let count = number(directory, if big { 8 } else { 2 })?;
    let first = directory.checked_add(if big { 8 } else { 2 })?;
    let (mut width, mut height) = (None, None);
    // Entries are sorted by tag, so both come early; a directory longer than the file ends the search.
    for k in 0..count {
        let at = first.checked_add(k.checked_mul(entry)?)?;
        let (tag, kind) = (number(at, 2)?, number(at + 2, 2)?);
        if tag > HEIGHT {
            break;
        }
        if tag == WIDTH || tag == HEIGHT {
            let length = match kind {
                SHORT => 2,
                LONG => 4,
                LONG8 if big => 8,
                _ => return None,
            };
            let value = u32::try_from(number(at + 4 + word, length)?).ok()?;
            *(if tag == WIDTH { &mut width } else { &mut height }) = Some(value);
        }
    }
    Some((width?, height?))
}
