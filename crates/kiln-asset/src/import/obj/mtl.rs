//! MTL: material libraries of OBJ, made for Phong's shading, with the later statements for metallic-roughness.
//!
//! | statement | becomes |
//! | --- | --- |
//! | `Kd`, `map_Kd` | base colour; both are multiplied, and `Kd` is linear light |
//! | `d`, `Tr` | alpha, `Tr` = 1 - `d`; below 1 the material blends |
//! | `map_d` of the same file as `map_Kd` | blends by the picture's alpha |
//! | `Ke`, `map_Ke` | emission; a picture alone counts with factor 1 |
//! | `norm` | normal map, `-bm` its scale |
//! | `Pm` | metallic factor, else 0 |
//! | `Pr` | roughness factor |
//! | `Ns` | without `Pr`: roughness (2 / (Ns + 2))^(1/4); without both 1 |
//! | option `-clamp on` | clamped to the edge, else repeated |
//!
//! Everything else is listed as not carried: bump maps are heights and no normals, pictures of one channel would have to be mixed
//! into one. Options that would move or recolour a picture are refused, since the model would look wrong without.
//!
//! **Sources.** Wavefront Technologies, "MTL material format", 1995. The exponent's width of lobe: B. Walter, S. Marschner, H. Li, K.
//! Torrance, "Microfacet models for refraction through rough surfaces", EGSR 2007, sect. 5.2: alpha = sqrt(2 / (Ns + 2)), and
//! glTF's roughness is its root. `Pr`, `Pm`, `norm`: the PBR extension of Exocortex' Clara.io.

use std::collections::BTreeMap;

use super::super::error::Defects;
use super::super::picture::{Pictures, file_beside};
use super::super::report::{Notes, RepairKind};
use super::super::soup::Left;
use super::super::text::{Lines, excerpt, lossy, number, split_keyword, values};
use super::LONGEST_NAME;
use crate::material::{AlphaMode, Material};

/// White and rough, no metal.
pub(super) fn plain(name: &str) -> Material {
    Material { name: name.to_owned(), metallic_factor: 0.0, ..Default::default() }
}

/// A picture that a material names.
struct Map {
    /// The library's name and line.
    path: String,
    /// The picture's path in the model's folder, or what is wrong with its name.
    file: Result<String, String>,
    clamps: bool,
    /// Value of `-bm`.
    strength: f32,
    /// An option that is not read.
    refused: Option<String>,
}

/// A material of a library.
pub(super) struct Definition {
    factors: Material,
    has_emission: bool,
    has_roughness: bool,
    exponent: Option<f32>,
    base_color: Option<Map>,
    emissive: Option<Map>,
    normal: Option<Map>,
    alpha: Option<Map>,
}

impl Definition {
    fn new(name: &str) -> Definition {
        Definition {
            factors: plain(name),
            has_emission: false,
            has_roughness: false,
            exponent: None,
            base_color: None,
            emissive: None,
            normal: None,
            alpha: None,
        }
    }

    /// The material, with its pictures.
    pub(super) fn material(
        &self,
        pictures: &mut Pictures<'_, '_>,
        defects: &mut Defects,
        notes: &mut Notes,
    ) -> Material {
        let mut out = self.factors.clone();
        if let Some(exponent) = self.exponent.filter(|_| !self.has_roughness) {
            out.roughness_factor = roughness(exponent);
        }
        if out.base_color_factor[3] < 1.0 {
            out.alpha_mode = AlphaMode::Blend;
        }
        let mut texture = |map: &Option<Map>| map.as_ref().and_then(|map| map.texture(pictures, defects, notes));
        out.base_color = texture(&self.base_color);
        out.emissive = texture(&self.emissive);
        out.normal = texture(&self.normal);
        if out.emissive.is_some() && !self.has_emission {
            out.emissive_factor = [1.0; 3];
        }
        if let Some(map) = self.normal.as_ref().filter(|_| out.normal.is_some()) {
            out.normal_scale = map.strength;
        }
        if let Some(alpha) = &self.alpha {
            let same = |base: &Map| matches!((&base.file, &alpha.file), (Ok(a), Ok(b)) if a == b);
            match self.base_color.as_ref().is_some_and(same) {
                true => out.alpha_mode = AlphaMode::Blend,
                false => notes.not_carried("MTL statement `map_d`", 1),
            }
        }
        out
    }
}

impl Map {
    fn texture(
        &self,
        pictures: &mut Pictures<'_, '_>,
        defects: &mut Defects,
        notes: &mut Notes,
    ) -> Option<crate::material::TextureRef> {
        if let Some(option) = &self.refused {
            defects.unsupported(self.path.clone(), format!("{option} is not read; apply it to the UVs or the picture"));
            return None;
        }
        match &self.file {
            Ok(file) => pictures.texture(file, self.clamps, &self.path, defects, notes),
            Err(message) => {
                defects.invalid(self.path.clone(), message.clone());
                None
            }
        }
    }
}

/// Roughness of a Phong exponent, see the page's sources.
fn roughness(exponent: f32) -> f32 {
    // Roots are rounded exactly everywhere.
    (2.0 / (f64::from(exponent.max(0.0)) + 2.0)).sqrt().sqrt() as f32
}

/// Adds the definitions of the library `file` to `out`, the first of each name.
pub(super) fn read(
    file: &str,
    bytes: &[u8],
    out: &mut BTreeMap<String, Definition>,
    defects: &mut Defects,
    notes: &mut Notes,
) {
    let mut left = Left::default();
    let mut at: Option<Definition> = None;
    let mut finish = |definition: Option<Definition>, left: &mut Left| {
        let Some(definition) = definition else { return };
        match out.contains_key(&definition.factors.name) {
            true => left.add("materials defined again", 1),
            false => drop(out.insert(definition.factors.name.clone(), definition)),
        }
    };
    let mut lines = Lines::new(bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes));
    while let Some((line, statement)) = lines.line() {
        let (keyword, rest) = split_keyword(statement);
        if keyword.is_empty() || keyword[0] == b'#' {
            continue;
        }
        if keyword.eq_ignore_ascii_case(b"newmtl") {
            finish(at.take(), &mut left);
            at = Some(Definition::new(&lossy(rest, LONGEST_NAME)));
            continue;
        }
        match &mut at {
            Some(definition) => {
                let mut reader = Statement { file, line, rest, defects, notes, left: &mut left };
                reader.read(keyword, definition);
            }
            None => left.add("MTL statements before the first material", 1),
        }
    }
    finish(at, &mut left);
    left.finish(notes);
}

/// A statement of a library at work.
struct Statement<'a> {
    file: &'a str,
    line: u64,
    rest: &'a [u8],
    defects: &'a mut Defects,
    notes: &'a mut Notes,
    left: &'a mut Left,
}

impl Statement<'_> {
    fn path(&self) -> String {
        format!("{}:{}", self.file, self.line)
    }

    fn read(&mut self, keyword: &[u8], out: &mut Definition) {
        let lower = keyword.to_ascii_lowercase();
        match lower.as_slice() {
            b"kd" => {
                if let Some([r, g, b]) = self.color() {
                    let [.., alpha] = out.factors.base_color_factor;
                    out.factors.base_color_factor = [r, g, b, alpha];
                }
            }
            b"ke" => {
                if let Some(color) = self.color() {
                    out.factors.emissive_factor = color;
                    out.has_emission = true;
                }
            }
            b"d" => {
                if let Some(alpha) = self.unit() {
                    out.factors.base_color_factor[3] = alpha;
                }
            }
            b"tr" => {
                if let Some(transparency) = self.unit() {
                    out.factors.base_color_factor[3] = 1.0 - transparency;
                }
            }
            b"ns" => out.exponent = self.scalar().or(out.exponent),
            b"pr" => {
                if let Some(roughness) = self.unit() {
                    out.factors.roughness_factor = roughness;
                    out.has_roughness = true;
                }
            }
            b"pm" => out.factors.metallic_factor = self.unit().unwrap_or(out.factors.metallic_factor),
            b"map_kd" => out.base_color = self.map(),
            b"map_ke" => out.emissive = self.map(),
            b"norm" | b"map_norm" => out.normal = self.map(),
            b"map_d" => out.alpha = self.map(),
            _ => self.left.add(format!("MTL statement {}", excerpt(keyword)), 1),
        }
    }

    /// One number, or three alike.
    fn color(&mut self) -> Option<[f32; 3]> {
        let first = values(self.rest).next().unwrap_or_default();
        if first == b"spectral" || first == b"xyz" {
            self.left.add(format!("MTL colour by {}", excerpt(first)), 1);
            return None;
        }
        let mut found = Vec::new();
        for word in values(self.rest).take(4) {
            found.push(self.number(word)?);
        }
        let color = match found[..] {
            [grey] => [grey; 3],
            [r, g, b] => [r, g, b],
            _ => {
                self.defects.invalid(self.path(), format!("{} numbers; 1 or 3 expected", found.len()));
                return None;
            }
        };
        Some(self.clamped(color))
    }

    fn scalar(&mut self) -> Option<f32> {
        // `d -halo 0.5`: less of it where seen from the front.
        let mut words = values(self.rest).filter(|word| *word != b"-halo");
        let Some(word) = words.next() else {
            self.defects.invalid(self.path(), "a number is missing");
            return None;
        };
        self.number(word)
    }

    fn unit(&mut self) -> Option<f32> {
        let value = self.scalar()?;
        let [value] = self.clamped([value]);
        Some(value)
    }

    /// A finite number, or a defect.
    fn number(&mut self, word: &[u8]) -> Option<f32> {
        let value = number(word).filter(|value| value.is_finite());
        if value.is_none() {
            self.defects.invalid(self.path(), format!("{} is no finite number", excerpt(word)));
        }
        value
    }

    fn clamped<const N: usize>(&mut self, values: [f32; N]) -> [f32; N] {
        let outside = values.iter().any(|v| !(0.0..=1.0).contains(v));
        let path = self.path();
        self.notes.repair(RepairKind::FactorClamped, outside as u64, || path);
        values.map(|v| v.clamp(0.0, 1.0))
    }

    /// Options, then the file's name up to the line's end.
    fn map(&mut self) -> Option<Map> {
        let mut map = Map {
            path: self.path(),
            file: Err("a file's name is missing".into()),
            clamps: false,
            strength: 1.0,
            refused: None,
        };
        let mut rest = self.rest;
        while rest.starts_with(b"-") {
            let (option, behind) = split_keyword(rest);
            // Words that an option takes: (at least, at most, what none of them changes).
            let (least, most, neutral): (usize, usize, &[f32]) = match option {
                b"-o" | b"-t" => (1, 3, &[0.0, 0.0, 0.0]),
                b"-s" => (1, 3, &[1.0, 1.0, 1.0]),
                b"-mm" => (2, 2, &[0.0, 1.0]),
                b"-bm" | b"-boost" | b"-texres" | b"-blendu" | b"-blendv" | b"-cc" | b"-clamp" | b"-imfchan"
                | b"-type" => (1, 1, &[]),
                // A file's name may begin so.
                _ => break,
            };
            rest = behind;
            let mut changes = false;
            for k in 0..most {
                let (word, behind) = split_keyword(rest);
                let value = number(word);
                // The last word is the file's name, even if it looks like a number.
                if k >= least && (value.is_none() || behind.is_empty()) {
                    break;
                }
                changes |= neutral.get(k).is_some_and(|neutral| value != Some(*neutral));
                match option {
                    b"-clamp" => map.clamps = word == b"on",
                    b"-bm" => map.strength = self.number(word)?,
                    _ => {}
                }
                rest = behind;
            }
            if changes {
                map.refused = Some(format!("the option {}", excerpt(option)));
            } else if neutral.is_empty() && !matches!(option, b"-clamp" | b"-bm") {
                self.left.add(format!("MTL option {}", excerpt(option)), 1);
            }
        }
        if !rest.is_empty() {
            let place = self.path();
            map.file = file_beside(self.file, &String::from_utf8_lossy(rest), || place, self.notes);
        }
        Some(map)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_phong_exponent_becomes_the_roughness_of_an_equally_wide_lobe() {
        assert_eq!(roughness(0.0), 1.0);
        // alpha = sqrt(2/32) = 1/4.
        assert_eq!(roughness(30.0), 0.5);
        assert_eq!(roughness(-5.0), 1.0);
    }
}
