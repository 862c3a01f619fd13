//! Assigns pages to the slices, channels and time steps of a volume, and determines the distances of samples.

use super::super::super::{LengthUnit, Notices};

/// A volume in pages.
#[derive(Clone, Debug, PartialEq)]
pub struct Stack {
    /// Name of the volume, in a file with several.
    pub name: Option<String>,
    pub slices: u32,
    /// Names of the channels, `None` for a channel without a name; at least one channel.
    pub channels: Vec<Option<String>>,
    pub frames: u32,
    /// Time between frames, and its unit, if the file states them.
    pub interval: Option<(f64, String)>,
    pub spacing: [f64; 3],
    /// Position of the first sample.
    pub origin: [f64; 3],
    pub unit: Option<LengthUnit>,
    /// ImageJ's calibration of the stored numbers.
    pub calibration: Option<Calibration>,
    /// Unit of the values.
    pub value_unit: Option<String>,
    /// The stored value of pixels without a measurement.
    pub missing: Option<f64>,
    /// Notices of assumptions.
    pub notices: Notices,
    /// File and page of every slice: by frame, then channel, then slice.
    pub planes: Vec<(usize, usize)>,
}

/// ImageJ's calibration of numbers of 8 and 16 bits, which it stores unsigned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Calibration {
    /// Signed 16-bit numbers: 32768 less than stored.
    Signed,
    Line {
        slope: f64,
        intercept: f64,
    },
}

impl Calibration {
    /// Returns the same calibration as a line, for numbers of another type than 16 bits.
    pub fn as_line(self) -> Self {
        match self {
            Self::Signed => Self::Line {
                slope: 1.0,
                intercept: -32768.0,
            },
            line => line,
        }
    }
}

/// Resolution: pixels along x and y in a unit of length.
#[derive(Clone, Copy, Debug, Default)]
pub struct Resolution {
    pub pixels: [Option<f64>; 2],
    /// Whether the unit is the file's own, not inch or centimetre.
    pub is_of_file: bool,
}

/// Slice, channel and frame of a plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Index {
    pub z: u32,
    pub channel: u32,
    pub frame: u32,
}

impl Stack {
    /// A stack in which every page is a slice.
    pub fn of_pages(pages: usize) -> Self {
        Self {
            name: None,
            slices: pages as u32,
            channels: vec![None],
            frames: 1,
            interval: None,
            spacing: [1.0; 3],
            origin: [0.0; 3],
            unit: None,
            calibration: None,
            value_unit: None,
            missing: None,
            notices: Notices::default(),
            planes: (0..pages).map(|page| (0, page)).collect(),
        }
    }

    /// Orders the pages by `c`, `z` and `t`; the first letter of `order` is the fastest index.
    pub(super) fn order_pages(&mut self, order: &str) -> Result<(), &'static str> {
        let sizes = [self.channels.len() as u32, self.slices, self.frames];
        let (mut strides, mut stride, mut seen) = ([0; 3], 1, [false; 3]);
        for letter in order.chars() {
            let axis = "czt".find(letter).filter(|&axis| !seen[axis]);
            let axis = axis.ok_or("expected c, z and t in some order")?;
            (strides[axis], seen[axis]) = (stride, true);
            stride *= sizes[axis];
        }
        if seen.iter().zip(sizes).any(|(seen, size)| !seen && size > 1) {
            return Err("expected each of c, z and t that has several pages");
        }
        let [c, z, t] = strides;
        self.planes = self.order(|index| (0, (index.channel * c + index.z * z + index.frame * t) as usize));
        Ok(())
    }

    /// Adds a notice if an orientation would turn rows and columns, which is not done. `orientation`: as the specification numbers it.
    pub fn tell_of_orientation(&mut self, orientation: u64) {
        if orientation != 1 {
            self.notices.add(format!(
                "rows and columns are as they are stored, as in ImageJ and tifffile: Orientation {orientation}, which turns or mirrors them, is not used"
            ));
        }
    }

    /// Sets the ratio of the pixels' sides if they are not square, for a file that does not state the distance of slices.
    pub fn keep_ratio(&mut self, resolution: Resolution) {
        let is_known = |pixels: &f64| pixels.is_finite() && *pixels > 0.0;
        let [Some(x), Some(y)] = resolution.pixels.map(|pixels| pixels.filter(is_known)) else {
            return;
        };
        let height = x / y;
        if (height - 1.0).abs() > 1e-3 {
            self.spacing = [1.0, height, 1.0];
            self.notices.add(format!(
                "pixels are {height:.4} times as high as wide, by the resolution; the distance of slices is missing, it is taken to be the width"
            ));
        }
    }

    /// Reads the description that tifffile writes into the first page: the array's shape, slowest axis first, and the letters of its axes,
    /// if they were given. Of four axes without letters the first one is time, as in `.npy`. `None` if another program wrote the
    /// description, or if the pages are of another array.
    pub fn of_tifffile(description: &str, pages: usize) -> Option<Self> {
        let value: serde_json::Value = serde_json::from_str(description).ok()?;
        let sizes = value.get("shape")?.as_array()?.iter().map(serde_json::Value::as_u64);
        let sizes: Vec<u64> = sizes.collect::<Option<_>>()?;
        let axes = value.get("axes").and_then(serde_json::Value::as_str);
        let axes = axes.filter(|axes| axes.len() == sizes.len() && axes.is_ascii());
        let mut stack = Self::of_pages(pages);
        match (axes, sizes.as_slice()) {
            (Some(axes), sizes) => Some(Self::of_letters(&axes.to_ascii_lowercase(), sizes, pages)),
            (None, &[frames, slices, _, _]) => {
                stack.frames = u32::try_from(frames).ok().filter(|&n| n > 0)?;
                stack.slices = u32::try_from(slices).ok()?;
                (frames.checked_mul(slices)? == pages as u64).then_some(stack)
            }
            (None, [_, _, _, _, _, ..]) => {
                let notice = format!(
                    "the file does not say what the {} axes of {sizes:?} are: pages are slices",
                    sizes.len()
                );
                stack.notices.add(notice);
                Some(stack)
            }
            _ => None,
        }
    }

    /// Orders the pages of an array by the letters of its axes, the slowest first. The last two letters are the axes of a page.
    fn of_letters(axes: &str, sizes: &[u64], pages: usize) -> Self {
        let of_page = if axes.ends_with("yxs") { 3 } else { 2 };
        let (above, below) = axes.split_at(axes.len().saturating_sub(of_page));
        let mut stack = Self::of_pages(pages);
        let size = |letter: char| {
            let size = above.find(letter).map_or(1, |at| sizes[at]);
            u32::try_from(size).ok().filter(|&size| size > 0)
        };
        let counts = [size('c'), size('z'), size('t')];
        let total = counts
            .iter()
            .try_fold(1u64, |n, size| n.checked_mul(u64::from((*size)?)));
        let is_known = below.starts_with("yx") && total == Some(pages as u64) && above.contains('z');
        if let ([Some(channels), Some(slices), Some(frames)], true) = (counts, is_known) {
            let order: String = above.chars().rev().filter(|letter| "czt".contains(*letter)).collect();
            let mut ordered = stack.clone();
            ordered.channels = vec![None; channels as usize];
            (ordered.slices, ordered.frames) = (slices, frames);
            if ordered.order_pages(&order).is_ok() {
                return ordered;
            }
        }
        if !(below == "yx" && above.len() == 1 && matches!(above, "z" | "q" | "i")) {
            let axes = axes.to_ascii_uppercase();
            let notice =
                format!("the file says that its axes are {axes}, slowest first: pages are taken for slices, Z, Y, X");
            stack.notices.add(notice);
        }
        stack
    }

    /// Lists the planes, ordered by frame, channel and slice; `place` maps the index of a plane to its file and page.
    pub fn order(&self, mut place: impl FnMut(Index) -> (usize, usize)) -> Vec<(usize, usize)> {
        let mut planes = Vec::new();
        for frame in 0..self.frames {
            for channel in 0..self.channels.len() as u32 {
                planes.extend((0..self.slices).map(|z| place(Index { z, channel, frame })));
            }
        }
        planes
    }

    /// Returns the planes of a channel's time step.
    pub fn step(&self, channel: usize, frame: u32) -> &[(usize, usize)] {
        let slices = self.slices as usize;
        let first = (frame as usize * self.channels.len() + channel) * slices;
        &self.planes[first..first + slices]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_of_tifffile_may_have_time_steps() {
        let stack = Stack::of_tifffile(r#"{"shape": [2, 3, 5, 7]}"#, 6).unwrap();
        assert_eq!((stack.frames, stack.step(0, 1)), (2, &[(0, 3), (0, 4), (0, 5)][..]));
        for text in [
            r#"{"shape": [6, 5, 7]}"#,
            r#"{"shape": [0, 3, 5, 7]}"#,
            r#"{"shape": [2, 4, 5, 7]}"#,
            "{}",
            "[1]",
            "",
        ] {
            assert!(Stack::of_tifffile(text, 6).is_none(), "{text}");
        }
    }

    #[test]
    fn letters_of_tifffile_say_what_axes_are() {
        let of = |axes: &str, shape: &str| {
            let text = format!(r#"{{"shape": [{shape}], "axes": "{axes}"}}"#);
            let stack = Stack::of_tifffile(&text, 6).unwrap();
            let sizes = [stack.channels.len() as u32, stack.slices, stack.frames];
            (sizes, stack.step(0, 0).to_vec(), stack.notices.is_empty())
        };
        let pages = |pages: &[usize]| pages.iter().map(|page| (0, *page)).collect::<Vec<_>>();
        assert_eq!(of("CZYX", "2, 3, 5, 7"), ([2, 3, 1], pages(&[0, 1, 2]), true));
        assert_eq!(of("ZCYX", "3, 2, 5, 7"), ([2, 3, 1], pages(&[0, 2, 4]), true));
        assert_eq!(of("ZTYXS", "3, 2, 5, 7, 3"), ([1, 3, 2], pages(&[0, 2, 4]), true));
        let all = pages(&[0, 1, 2, 3, 4, 5]);
        assert_eq!(of("ZYX", "6, 5, 7"), ([1, 6, 1], all.clone(), true));
        for (axes, shape) in [
            ("XYZ", "6, 5, 7"),
            ("TYX", "6, 5, 7"),
            ("CZYX", "4, 3, 5, 7"),
            ("QYXZ", "6, 5, 7, 2"),
            ("Y", "6"),
        ] {
            assert_eq!(of(axes, shape), ([1, 6, 1], all.clone(), false), "{axes}");
        }
    }

    #[test]
    fn pixels_that_are_no_squares_keep_their_ratio() {
        let of = |pixels: [f64; 2]| {
            let mut stack = Stack::of_pages(4);
            stack.keep_ratio(Resolution {
                pixels: pixels.map(Some),
                is_of_file: false,
            });
            (stack.spacing, stack.notices.is_empty())
        };
        assert_eq!(of([72.0, 72.0]), ([1.0; 3], true));
        assert_eq!(of([300.0, 150.0]), ([1.0, 2.0, 1.0], false));
        assert_eq!(of([0.0, 150.0]), ([1.0; 3], true));
    }
}
