//! A picture for people: a texture, dimmed, its borders white over it, the edges of a mesh in its UV space: orange where they cross
//! a border, blue where not.

use glam::Vec2;
use kiln_asset::Raster;

use super::MapBorders;

/// Least longest side, pixels: borders found in a smaller picture are drawn larger.
const SIDE: u32 = 1024;
const BORDER: [u8; 4] = [255, 255, 255, 255];
const CROSSES: [u8; 4] = [255, 128, 0, 255];
const CLEAR: [u8; 4] = [40, 110, 230, 255];

/// Draws `segments` (UV ends, v down, with whether they cross a border) over the borders of `texture`.
pub fn debug_picture(texture: &Raster, map: &MapBorders, segments: &[([Vec2; 2], bool)]) -> Raster {
    let borders = &map.borders;
    let scale = (SIDE / borders.width.max(borders.height).max(1)).max(1);
    let (width, height) = (borders.width * scale, borders.height * scale);
    let mut out = Raster::filled(width, height, [0, 0, 0, 255]);
    if out.texels.is_empty() || texture.texels.is_empty() {
        return out;
    }
    for y in 0..height {
        for x in 0..width {
            let column = (u64::from(x) * u64::from(texture.width) / u64::from(width)) as usize;
            let row = (u64::from(y) * u64::from(texture.height) / u64::from(height)) as usize;
            let texel = texture.texels[row * texture.width as usize + column];
            let dimmed = [texel[0] / 2, texel[1] / 2, texel[2] / 2, 255];
            let is_border = borders.get(x / scale, y / scale);
            out.texels[y as usize * width as usize + x as usize] = if is_border { BORDER } else { dimmed };
        }
    }
    // Those that cross a border last, so that none is hidden.
    for crosses in [false, true] {
        for ([a, b], _) in segments.iter().filter(|s| s.1 == crosses) {
            line(&mut out, map, *a, *b, if crosses { CROSSES } else { CLEAR });
        }
    }
    out
}

fn line(out: &mut Raster, map: &MapBorders, a: Vec2, b: Vec2, colour: [u8; 4]) {
    let size = Vec2::new(out.width as f32, out.height as f32);
    let (from, step) = (a * size, (b - a) * size);
    let longest = step.abs().max_element();
    if !longest.is_finite() || !from.is_finite() {
        return;
    }
    // Longer ones than a few pictures would only fill it.
    let count = (longest.ceil() as u32).clamp(1, 4 * out.width.max(out.height));
    for i in 0..=count {
        let place = (from + step * (i as f32 / count as f32)).floor();
        let x = map.wrap[0].texel(place.x as i64, out.width as usize);
        let y = map.wrap[1].texel(place.y as i64, out.height as usize);
        out.texels[y * out.width as usize + x] = colour;
    }
}
