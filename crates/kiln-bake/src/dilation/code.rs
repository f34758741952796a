//! How texels are averaged: decoded, summed, encoded, for each kind and each sort of picture.

use std::marker::PhantomData;

use glam::{Vec3, Vec4};
use kiln_asset::{DeepRaster, Raster};
use kiln_geom::colour::{linear_to_srgb, srgb_to_linear, unorm8};

/// How a picture's texels are averaged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TexelKind {
    /// RGB in sRGB, alpha linear. A deep picture's colours are linear already: as [`TexelKind::Linear`].
    Srgb,
    /// Every channel linear.
    Linear,
    /// RGB is a unit vector as `(n + 1) / 2`.
    Normal,
    /// RGB is a unit vector in `[-1, 1]`. In bytes, which hold none: as [`TexelKind::Normal`].
    Vector,
    /// Numbers that have no mean: copied.
    Nearest,
}

/// A picture whose texels can be filled.
pub trait Texels {
    /// One texel.
    type Texel: Copy + Send + Sync;
    /// Code of [`TexelKind::Srgb`].
    type Srgb: Code<Texel = Self::Texel>;
    /// Code of [`TexelKind::Linear`].
    type Linear: Code<Texel = Self::Texel>;
    /// Code of [`TexelKind::Normal`].
    type Normal: Code<Texel = Self::Texel>;
    /// Code of [`TexelKind::Vector`].
    type Vector: Code<Texel = Self::Texel>;
    /// Code of [`TexelKind::Nearest`].
    type Nearest: Code<Texel = Self::Texel>;

    /// Texels across, and all texels, row by row.
    fn grid(&mut self) -> (usize, &mut [Self::Texel]);
}

/// From a texel to what can be averaged, and back from a mean.
pub trait Code {
    /// One texel.
    type Texel: Copy + Send + Sync;
    /// Whether the first of several values stands for all instead of their mean.
    const COPIES: bool = false;
    /// What a picture gets that has nothing to take from.
    const NOTHING: Vec4 = Vec4::W;

    /// The texel's value.
    fn decode(texel: Self::Texel) -> Vec4;
    /// The texel of a mean.
    fn encode(mean: Vec4) -> Self::Texel;
}

/// A [`Code`] of bytes or floats, by what they hold.
#[derive(Debug)]
pub struct Held<T, K>(PhantomData<(T, K)>);

/// RGB in sRGB.
#[derive(Debug)]
pub struct Srgb;
/// Every channel as it is.
#[derive(Debug)]
pub struct Linear;
/// Unit vectors as `(n + 1) / 2`.
#[derive(Debug)]
pub struct Normal;
/// Unit vectors as they are.
#[derive(Debug)]
pub struct Vector;
/// Copied.
#[derive(Debug)]
pub struct Nearest;

type Bytes = [u8; 4];
type Floats = [f32; 4];

impl Texels for Raster {
    type Texel = Bytes;
    type Srgb = Held<Bytes, Srgb>;
    type Linear = Held<Bytes, Linear>;
    type Normal = Held<Bytes, Normal>;
    type Vector = Held<Bytes, Normal>;
    type Nearest = Held<Bytes, Nearest>;

    fn grid(&mut self) -> (usize, &mut [Bytes]) {
        (self.width as usize, &mut self.texels)
    }
}

impl Texels for DeepRaster {
    type Texel = Floats;
    type Srgb = Held<Floats, Linear>;
    type Linear = Held<Floats, Linear>;
    type Normal = Held<Floats, Normal>;
    type Vector = Held<Floats, Vector>;
    type Nearest = Held<Floats, Nearest>;

    fn grid(&mut self) -> (usize, &mut [Floats]) {
        (self.width as usize, &mut self.texels)
    }
}

/// A vector's mean at unit length; straight up where vectors cancel.
fn unit(mean: Vec4) -> Vec3 {
    let vector = mean.truncate();
    let length = vector.length();
    if length < 1e-6 { Vec3::Z } else { vector / length }
}

impl Code for Held<Bytes, Srgb> {
    type Texel = Bytes;

    #[inline(always)]
    fn decode([r, g, b, a]: Bytes) -> Vec4 {
        Vec4::new(srgb_to_linear(r), srgb_to_linear(g), srgb_to_linear(b), a as f32 / 255.0)
    }

    #[inline(always)]
    fn encode(mean: Vec4) -> Bytes {
        [linear_to_srgb(mean.x), linear_to_srgb(mean.y), linear_to_srgb(mean.z), unorm8(mean.w)]
    }
}

impl Code for Held<Bytes, Linear> {
    type Texel = Bytes;

    #[inline(always)]
    fn decode(texel: Bytes) -> Vec4 {
        Vec4::from(texel.map(|c| c as f32 / 255.0))
    }

    #[inline(always)]
    fn encode(mean: Vec4) -> Bytes {
        mean.to_array().map(unorm8)
    }
}

impl Code for Held<Bytes, Normal> {
    type Texel = Bytes;

    #[inline(always)]
    fn decode([r, g, b, a]: Bytes) -> Vec4 {
        let signed = |c: u8| 2.0 * (c as f32 / 255.0) - 1.0;
        Vec4::new(signed(r), signed(g), signed(b), a as f32 / 255.0)
    }

    #[inline(always)]
    fn encode(mean: Vec4) -> Bytes {
        let [r, g, b] = unit(mean).to_array().map(|c| unorm8(0.5 * c + 0.5));
        [r, g, b, unorm8(mean.w)]
    }
}

impl Code for Held<Bytes, Nearest> {
    type Texel = Bytes;
    const COPIES: bool = true;
    const NOTHING: Vec4 = Vec4::ZERO;

    #[inline(always)]
    fn decode(texel: Bytes) -> Vec4 {
        Vec4::from(texel.map(f32::from))
    }

    #[inline(always)]
    fn encode(value: Vec4) -> Bytes {
        value.to_array().map(|c| c as u8)
    }
}

impl Code for Held<Floats, Linear> {
    type Texel = Floats;

    #[inline(always)]
    fn decode(texel: Floats) -> Vec4 {
        Vec4::from(texel)
    }

    #[inline(always)]
    fn encode(mean: Vec4) -> Floats {
        mean.to_array()
    }
}

impl Code for Held<Floats, Normal> {
    type Texel = Floats;

    #[inline(always)]
    fn decode([x, y, z, a]: Floats) -> Vec4 {
        Vec4::new(2.0 * x - 1.0, 2.0 * y - 1.0, 2.0 * z - 1.0, a)
    }

    #[inline(always)]
    fn encode(mean: Vec4) -> Floats {
        (0.5 * unit(mean) + 0.5).extend(mean.w).to_array()
    }
}

impl Code for Held<Floats, Vector> {
    type Texel = Floats;

    #[inline(always)]
    fn decode(texel: Floats) -> Vec4 {
        Vec4::from(texel)
    }

    #[inline(always)]
    fn encode(mean: Vec4) -> Floats {
        unit(mean).extend(mean.w).to_array()
    }
}

impl Code for Held<Floats, Nearest> {
    type Texel = Floats;
    const COPIES: bool = true;
    const NOTHING: Vec4 = Vec4::ZERO;

    #[inline(always)]
    fn decode(texel: Floats) -> Vec4 {
        Vec4::from(texel)
    }

    #[inline(always)]
    fn encode(value: Vec4) -> Floats {
        value.to_array()
    }
}

/// The values' mean, or the first of them; [`Code::NOTHING`] of none.
#[inline]
pub(super) fn mean<C: Code>(values: impl IntoIterator<Item = Vec4>) -> Vec4 {
    let mut values = values.into_iter();
    let Some(first) = values.next() else { return C::NOTHING };
    if C::COPIES {
        return first;
    }
    let (mut sum, mut count) = (first, 1u32);
    for value in values {
        sum += value;
        count += 1;
    }
    sum / count as f32
}
