//! Lengths with a unit.

use std::fmt;

/// Unit of a [`Length`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Unit {
    /// Micrometres.
    Micrometre,
    /// Millimetres.
    Millimetre,
    /// Centimetres.
    Centimetre,
    /// Metres: the unit of glTF and of object space.
    Metre,
    /// Kilometres.
    Kilometre,
    /// Share of the diagonal of the asset's bounding box.
    Diag,
}

impl Unit {
    /// Every unit, smallest first, the relative one last.
    pub const ALL: [Unit; 6] =
        [Unit::Micrometre, Unit::Millimetre, Unit::Centimetre, Unit::Metre, Unit::Kilometre, Unit::Diag];

    /// As it is written in a pipeline.
    pub fn as_str(self) -> &'static str {
        match self {
            Unit::Micrometre => "um",
            Unit::Millimetre => "mm",
            Unit::Centimetre => "cm",
            Unit::Metre => "m",
            Unit::Kilometre => "km",
            Unit::Diag => "diag",
        }
    }

    /// What a number in this unit is divided by to be in metres, or multiplied by: (factor, divide). Dividing by a
    /// power of ten rounds once, so "0.1 mm" is the double nearest to 0.0001.
    fn metres(self, value: f64) -> Option<f64> {
        match self {
            Unit::Micrometre => Some(value / 1e6),
            Unit::Millimetre => Some(value / 1e3),
            Unit::Centimetre => Some(value / 1e2),
            Unit::Metre => Some(value),
            Unit::Kilometre => Some(value * 1e3),
            Unit::Diag => None,
        }
    }
}

/// A distance in object space, absolute or relative to the asset's size: `"0.1 mm"`, `"1e-5 diag"`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Length {
    /// Finite, not negative, in `unit`.
    pub value: f64,
    /// What `value` counts.
    pub unit: Unit,
}

/// Why a text is not a length.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LengthError {
    /// No number at the start.
    Number,
    /// A number alone.
    NoUnit,
    /// A number and something that is no unit.
    Unit(String),
    /// Below zero or not finite.
    Range,
}

impl Length {
    /// `value` times the bounding box's diagonal.
    pub const fn diag(value: f64) -> Length {
        Length { value, unit: Unit::Diag }
    }

    /// `value` metres.
    pub const fn metres(value: f64) -> Length {
        Length { value, unit: Unit::Metre }
    }

    /// The length in object units (metres) for an asset whose bounding box has this diagonal (metres).
    pub fn resolve(self, diagonal: f64) -> f32 {
        self.unit.metres(self.value).unwrap_or(self.value * diagonal) as f32
    }

    /// Reads a number, optional blanks, and a unit.
    ///
    /// # Errors
    /// Says which of the two is missing or wrong.
    pub fn parse(text: &str) -> Result<Length, LengthError> {
        let text = text.trim();
        // The longest prefix that is a number: "1e-5 diag", "2.5mm"; an "e" may also start a unit, so try from the back.
        let digits = text.find(|c: char| !c.is_ascii_digit() && !matches!(c, '.' | 'e' | 'E' | '+' | '-'));
        let mut end = digits.unwrap_or(text.len());
        let value = loop {
            if end == 0 {
                return Err(LengthError::Number);
            }
            if let Ok(value) = text[..end].parse::<f64>() {
                break value;
            }
            end -= 1;
        };
        let unit = text[end..].trim();
        if unit.is_empty() {
            return Err(LengthError::NoUnit);
        }
        let unit = Unit::ALL.into_iter().find(|known| known.as_str() == unit);
        let unit = unit.ok_or_else(|| LengthError::Unit(text[end..].trim().to_owned()))?;
        if !(value.is_finite() && value >= 0.0) {
            return Err(LengthError::Range);
        }
        // "-0" is a zero, and one zero only may reach a fingerprint.
        Ok(Length { value: value + 0.0, unit })
    }

    /// Metres if the unit is absolute.
    pub(crate) fn absolute(self) -> Option<f64> {
        self.unit.metres(self.value)
    }
}

impl fmt::Display for Length {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", super::setting::plain(self.value), self.unit.as_str())
    }
}
