//! Meaning of world positions: the directions of the world's axes, and the unit of lengths.

use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::Geometry;

/// Directions of the world's axes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Frame {
    /// Axes of a patient: to the left, to the back (posterior), to the head (superior); as in DICOM and ITK.
    Lps,
    /// Axes of a patient: to the right, to the front (anterior), to the head (superior); as in NIfTI.
    Ras,
    /// The file's own axes, whose meaning it does not state.
    #[default]
    World,
    /// The volume's own axes: positions count samples.
    Index,
}

impl Frame {
    /// Returns the name in files, messages and on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Lps => "LPS",
            Self::Ras => "RAS",
            Self::World => "world",
            Self::Index => "index",
        }
    }

    /// Whether the axes are those of a patient.
    pub const fn is_anatomical(self) -> bool {
        matches!(self, Self::Lps | Self::Ras)
    }
}

impl FromStr for Frame {
    type Err = String;

    /// Parses the name of a frame that positions can be requested in.
    fn from_str(text: &str) -> Result<Self, String> {
        [Self::Lps, Self::Ras, Self::Index]
            .into_iter()
            .find(|frame| frame.name().eq_ignore_ascii_case(text))
            .ok_or_else(|| format!("{text:?}, expected LPS, RAS or index"))
    }
}

impl Geometry {
    /// Returns the same samples in another frame. Every volume has an index frame. The frames of patients differ in the signs of x and y.
    /// Any other change of frame has no effect: the meaning of axes that the file does not describe is unknown.
    #[must_use]
    pub fn in_frame(mut self, frame: Frame) -> Self {
        if frame == Frame::Index {
            return Self {
                frame,
                ..Self::of_index(self.dims)
            };
        }
        if self.frame != frame && self.frame.is_anatomical() && frame.is_anatomical() {
            self.origin = half_turn(self.origin);
            self.direction = self.direction.map(half_turn);
            self.frame = frame;
        }
        self
    }
}

/// Converts between the two frames of a patient. `0 −` instead of a sign: −0 would show in `info`.
fn half_turn([x, y, z]: [f64; 3]) -> [f64; 3] {
    [0.0 - x, 0.0 - y, z]
}

/// Unit of lengths in the world.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[expect(missing_docs, reason = "names of units")]
pub enum LengthUnit {
    Angstrom,
    Nanometre,
    Micrometre,
    Millimetre,
    Centimetre,
    Metre,
    Kilometre,
    /// Unit of longitude and latitude: an angle, no length.
    Degree,
}

impl LengthUnit {
    const ALL: [Self; 8] = [
        Self::Angstrom,
        Self::Nanometre,
        Self::Micrometre,
        Self::Millimetre,
        Self::Centimetre,
        Self::Metre,
        Self::Kilometre,
        Self::Degree,
    ];

    /// Returns the symbol for display.
    pub const fn symbol(self) -> &'static str {
        match self {
            Self::Angstrom => "Å",
            Self::Nanometre => "nm",
            Self::Micrometre => "µm",
            Self::Millimetre => "mm",
            Self::Centimetre => "cm",
            Self::Metre => "m",
            Self::Kilometre => "km",
            Self::Degree => "°",
        }
    }

    /// Returns the symbol in ASCII, for headers that hold nothing else.
    pub const fn ascii_symbol(self) -> &'static str {
        match self {
            Self::Angstrom => "angstrom",
            Self::Micrometre => "um",
            Self::Degree => "degree",
            other => other.symbol(),
        }
    }

    /// Returns the length in metres; `None` for an angle.
    pub const fn metres(self) -> Option<f64> {
        Some(match self {
            Self::Angstrom => 1e-10,
            Self::Nanometre => 1e-9,
            Self::Micrometre => 1e-6,
            Self::Millimetre => 1e-3,
            Self::Centimetre => 1e-2,
            Self::Metre => 1.0,
            Self::Kilometre => 1e3,
            Self::Degree => return None,
        })
    }

    /// Parses the unit that a file names, by its symbol or in English; `None` for an unknown unit.
    pub fn parse(text: &str) -> Option<Self> {
        let text = text.trim().trim_matches('"').trim();
        if let Some(unit) = Self::ALL.into_iter().find(|unit| unit.symbol() == text) {
            return Some(unit);
        }
        let word = text.to_lowercase();
        // `meter` and `metre`, in the singular and plural.
        let word = word.trim_end_matches('s').replace("meter", "metre");
        Some(match word.as_str() {
            "angstrom" | "å" | "ångström" => Self::Angstrom,
            "nanometre" => Self::Nanometre,
            // The Greek letter and the micro sign; ImageJ writes the escape.
            "um" | "μm" | "µm" | "\\u00b5m" | "micron" | "micrometre" => Self::Micrometre,
            "millimetre" => Self::Millimetre,
            "centimetre" => Self::Centimetre,
            "metre" => Self::Metre,
            "kilometre" => Self::Kilometre,
            "degree" | "deg" | "degree_north" | "degree_east" | "degrees_north" | "degrees_east" | "degree_n"
            | "degree_e" | "degrees_n" | "degrees_e" | "degreen" | "degreee" | "degreesn" | "degreese" => Self::Degree,
            _ => return None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patient_frames_turn_into_each_other() {
        let ras = Geometry {
            origin: [1.0, 2.0, 3.0],
            frame: Frame::Ras,
            ..Geometry::of_index([2, 2, 2])
        };
        let lps = ras.in_frame(Frame::Lps);
        assert_eq!((lps.origin, lps.frame), ([-1.0, -2.0, 3.0], Frame::Lps));
        assert_eq!(lps.direction, [[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]]);
        assert_eq!(lps.in_frame(Frame::Ras), ras);
    }

    #[test]
    fn frames_are_asked_for_by_name() {
        assert_eq!("ras".parse(), Ok(Frame::Ras));
        assert_eq!("index".parse(), Ok(Frame::Index));
        for text in ["world", "", "LPI"] {
            assert!(text.parse::<Frame>().is_err(), "{text}");
        }
    }

    #[test]
    fn unknown_axes_stay_as_they_are() {
        let world = Geometry::of_index([2, 3, 4]);
        assert_eq!(world.in_frame(Frame::Lps), world);
        let index = Geometry {
            spacing: [2.0; 3],
            unit: Some(LengthUnit::Metre),
            ..world
        }
        .in_frame(Frame::Index);
        assert_eq!((index.spacing, index.unit, index.dims), ([1.0; 3], None, [2, 3, 4]));
    }

    #[test]
    fn units_as_files_name_them() {
        for (text, unit) in [
            ("mm", LengthUnit::Millimetre),
            ("\"mm\"", LengthUnit::Millimetre),
            ("Micron", LengthUnit::Micrometre),
            ("\u{3bc}m", LengthUnit::Micrometre),
            ("micrometers", LengthUnit::Micrometre),
            ("degrees_north", LengthUnit::Degree),
        ] {
            assert_eq!(LengthUnit::parse(text), Some(unit), "{text}");
        }
        assert_eq!(LengthUnit::parse("furlong"), None);
    }
}
