//! Contact sheets: pictures in rows, each with a caption below.

use kiln_asset::Raster;

use crate::{MeasureError, font};

/// Pixels around tiles.
const GAP: u32 = 8;

/// Size of a caption's pixel, pixels.
pub(crate) const SCALE: u32 = 2;

pub(crate) const PAPER: [u8; 4] = [24, 24, 26, 255];
pub(crate) const INK: [u8; 4] = [230, 230, 230, 255];

/// A picture with a caption.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tile {
    /// The picture; drawn as it is, top left in its cell.
    pub picture: Raster,
    /// One or more lines, split at `\n`; too long ones are cut.
    pub caption: String,
}

/// The tiles in rows: columns as wide as their widest picture, rows as high as their highest picture and caption.
pub fn sheet(rows: &[Vec<Tile>]) -> Raster {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let column_width = |k: usize| rows.iter().filter_map(|r| r.get(k)).map(|t| t.picture.width).max().unwrap_or(0);
    let widths: Vec<u32> = (0..columns).map(column_width).collect();
    let line = (font::HEIGHT + 3) * SCALE;
    let lines = |row: &[Tile]| row.iter().map(|t| t.caption.lines().count() as u32).max().unwrap_or(0);
    let picture_height = |row: &[Tile]| row.iter().map(|t| t.picture.height).max().unwrap_or(0);

    let width = GAP + widths.iter().map(|w| w + GAP).sum::<u32>();
    let height = GAP + rows.iter().map(|r| picture_height(r) + lines(r) * line + GAP).sum::<u32>();
    let mut out = Raster::filled(width, height, PAPER);
    let mut y = GAP;
    for row in rows {
        let mut x = GAP;
        for (tile, cell) in row.iter().zip(&widths) {
            paste(&mut out, &tile.picture, x, y);
            for (k, text) in tile.caption.lines().enumerate() {
                write(&mut out, text, x, y + picture_height(row) + k as u32 * line + 2 * SCALE, *cell);
            }
            x += cell + GAP;
        }
        y += picture_height(row) + lines(row) * line + GAP;
    }
    out
}

fn paste(onto: &mut Raster, picture: &Raster, x: u32, y: u32) {
    for row in 0..picture.height {
        let from = row as usize * picture.width as usize;
        let to = (y + row) as usize * onto.width as usize + x as usize;
        let width = picture.width as usize;
        onto.texels[to..to + width].copy_from_slice(&picture.texels[from..from + width]);
    }
}

/// Draws a line of text with its upper left corner at `(x, y)`, cut at `width` pixels; it must lie within the picture.
pub(crate) fn write(onto: &mut Raster, text: &str, x: u32, y: u32, width: u32) {
    let step = (font::WIDTH + 1) * SCALE;
    for (k, character) in text.chars().take((width / step) as usize).enumerate() {
        for gy in 0..font::HEIGHT * SCALE {
            for gx in 0..font::WIDTH * SCALE {
                if font::covers(character, gx / SCALE, gy / SCALE) {
                    let at = (y + gy) as usize * onto.width as usize + (x + k as u32 * step + gx) as usize;
                    onto.texels[at] = INK;
                }
            }
        }
    }
}

/// The picture as PNG bytes, RGBA.
///
/// # Errors
/// The picture has no texels, or the encoder refuses.
pub fn encode_png(picture: &Raster) -> Result<Vec<u8>, MeasureError> {
    let bytes: Vec<u8> = picture.texels.as_flattened().to_vec();
    let mut out = std::io::Cursor::new(Vec::new());
    image::RgbaImage::from_raw(picture.width, picture.height, bytes)
        .ok_or_else(|| MeasureError::Encode("size and texels differ".into()))?
        .write_to(&mut out, image::ImageFormat::Png)
        .map_err(|e| MeasureError::Encode(e.to_string()))?;
    Ok(out.into_inner())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tile(width: u32, height: u32, grey: u8, caption: &str) -> Tile {
        Tile { picture: Raster::filled(width, height, [grey; 4]), caption: caption.into() }
    }

    #[test]
    fn tiles_lie_side_by_side_and_captions_below() {
        let out = sheet(&[vec![tile(20, 10, 50, "I"), tile(30, 12, 60, "")], vec![tile(5, 5, 70, "")]]);
        assert_eq!((out.width, out.height), (8 + 28 + 38, 8 + 12 + 20 + 8 + 5 + 8));
        let at = |x: u32, y: u32| out.texels[(y * out.width + x) as usize];
        assert_eq!(at(8, 8), [50; 4]);
        assert_eq!(at(27, 17), [50; 4]);
        assert_eq!(at(28, 8), PAPER);
        assert_eq!(at(36, 19), [60; 4]);
        assert_eq!(at(8, 48), [70; 4]);
        // The stem of the I, two pixels wide, in the middle of its cell.
        assert_eq!(at(8 + 4, 8 + 12 + 4 + 6), INK);
        assert_eq!(at(8 + 6, 8 + 12 + 4 + 6), PAPER);
        assert_eq!(out.texels.iter().filter(|t| **t == INK).count(), 11 * 4);
    }

    #[test]
    fn long_captions_are_cut_and_no_tiles_make_an_empty_sheet() {
        let out = sheet(&[vec![tile(24, 4, 0, "IIIIIIIIIIII")]]);
        assert_eq!(out.texels.iter().filter(|t| **t == INK).count(), 2 * 11 * 4);
        assert_eq!(sheet(&[]).texels.len(), 64);
    }

    #[test]
    fn png_bytes_decode_to_the_picture() {
        let out = sheet(&[vec![tile(20, 10, 50, "PNG 5/7")]]);
        let png = encode_png(&out).expect("encodes");
        let back = image::load_from_memory(&png).expect("decodes").to_rgba8();
        assert_eq!(back.dimensions(), (out.width, out.height));
        assert_eq!(back.as_raw().as_slice(), out.texels.as_flattened());
        assert!(encode_png(&Raster { width: 2, height: 2, texels: Vec::new() }).is_err());
    }
}
