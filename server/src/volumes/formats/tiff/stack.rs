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

/// Returns a value of ImageJ's description.
fn imagej_value<'a>(description: &'a str, name: &str) -> Option<&'a str> {
    let mut lines = description.lines().filter_map(|line| line.split_once('='));
    lines.find(|(n, _)| *n == name).map(|(_, value)| value.trim())
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
            unit: None,
            calibration: None,
            value_unit: None,
            missing: None,
            notices: Notices::default(),
            planes: (0..pages).map(|page| (0, page)).collect(),
        }
    }

    /// Reads the description that ImageJ writes into the first page: lines of names and values. The channel is the fastest index of the
    /// pages, the frame the slowest.
    pub fn of_imagej(description: &str, pages: usize, resolution: Resolution) -> Result<Self, String> {
        let value = |name: &str| imagej_value(description, name);
        let is_plain = ["channels", "slices", "frames"]
            .into_iter()
            .all(|name| value(name).is_none());
        let count = |name: &str| match value(name) {
            None if is_plain && name == "slices" => Ok(pages as u32),
            None => Ok(1),
            Some(text) => text
                .parse()
                .map_err(|_| format!("{name} is {text:?}, expected a number")),
        };
        let (channels, slices, frames) = (count("channels")?, count("slices")?, count("frames")?);
        let images = [slices, frames]
            .iter()
            .try_fold(channels, |n: u32, m| n.checked_mul(*m));
        if images.map(|n| n as usize) != Some(pages) || pages == 0 {
            let what = format!("{channels} channels, {slices} slices and {frames} frames");
            return Err(format!("{what} in {pages} pages, expected a page for each"));
        }
        let mut stack = Self {
            slices,
            channels: vec![None; channels as usize],
            frames,
            ..Self::of_pages(pages)
        };
        stack.place_imagej(description, resolution);
        stack.calibrate_imagej(description);
        let interval = value("finterval").and_then(|text| text.parse().ok());
        stack.interval = interval.map(|interval| (interval, value("tunit").unwrap_or("sec").to_owned()));
        let order = value("order").filter(|order| !order.eq_ignore_ascii_case("default"));
        let order = order.unwrap_or("czt").to_ascii_lowercase();
        stack
            .order_pages(&order)
            .map_err(|why| format!("order is {order:?}, {why}"))?;
        Ok(stack)
    }

    /// Orders the pages by `c`, `z` and `t`; the first letter of `order` is the fastest index.
    fn order_pages(&mut self, order: &str) -> Result<(), &'static str> {
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

    /// Sets the distances of samples as ImageJ does. Its tacit assumptions become notices.
    pub fn place_imagej(&mut self, description: &str, resolution: Resolution) {
        let value = |name: &str| imagej_value(description, name);
        let named = value("unit").filter(|unit| !unit.is_empty() && !matches!(*unit, "pixel" | "pixels" | "null"));
        self.unit = named.and_then(LengthUnit::parse);
        let is_known = |size: &f64| size.is_finite() && *size > 0.0;
        let depth = value("spacing")
            .and_then(|text| text.parse::<f64>().ok())
            .map(f64::abs)
            .filter(is_known);
        let uses_pixels = named.is_some() || resolution.is_of_file;
        let along = resolution.pixels.map(|pixels| pixels.map(|pixels| 1.0 / pixels));
        let along = along.map(|size| size.filter(|size| uses_pixels && is_known(size)));
        if along == [None; 2] && depth.is_none() && named.is_none() {
            return;
        }
        let [x, y] = [along[0].or(along[1]), along[1].or(along[0])].map(|size| size.unwrap_or(1.0));
        self.spacing = [x, y, depth.unwrap_or(1.0)];
        let unit = named.map_or_else(|| "pixel".to_owned(), str::to_owned);
        if along == [None; 2] {
            let notice = format!("the size of pixels is missing: they are 1 {unit} wide, as ImageJ takes them");
            self.notices.add(notice);
        }
        if depth.is_none() && self.slices > 1 {
            let notice = format!("the distance of slices is missing: it is 1 {unit}, as ImageJ takes it");
            self.notices.add(notice);
        }
        match named {
            None => self
                .notices
                .add("distances of samples have no unit: their ratio is that of the file"),
            Some(unit) if self.unit.is_none() => {
                let notice = format!("the unit of lengths, {unit:?}, is not known: distances are without one");
                self.notices.add(notice);
            }
            Some(_) => {}
        }
    }

    /// Sets ImageJ's calibration function, which applies to numbers of 8 and 16 bits.
    pub fn calibrate_imagej(&mut self, description: &str) {
        let value = |name: &str| imagej_value(description, name);
        let number = |name: &str| value(name)?.parse::<f64>().ok().filter(|number| number.is_finite());
        let unit = value("vunit").filter(|unit| !unit.is_empty() && !unit.eq_ignore_ascii_case("gray value"));
        self.value_unit = unit.map(str::to_owned);
        match (value("cf"), number("c0"), number("c1")) {
            (None | Some("20"), ..) => {}
            (Some("0"), Some(intercept), Some(slope)) => {
                self.calibration = match (slope, intercept) {
                    (1.0, 0.0) => None,
                    (1.0, -32768.0) => Some(Calibration::Signed),
                    _ => Some(Calibration::Line { slope, intercept }),
                };
            }
            (Some(function), ..) => {
                self.value_unit = None;
                let notice = format!(
                    "values are the stored numbers: ImageJ shows them by its calibration function {function}, which is no straight line"
                );
                self.notices.add(notice);
            }
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
    fn pages_of_imagej_go_through_channels_first() {
        let text =
            "ImageJ=1.54f\nimages=12\nchannels=2\nslices=3\nframes=2\nhyperstack=true\nunit=\\u00B5m\nspacing=0.5\n";
        let resolution = |pixels| Resolution {
            pixels,
            is_of_file: false,
        };
        let stack = Stack::of_imagej(text, 12, resolution([Some(4.0), Some(5.0)])).unwrap();
        assert!(stack.notices.is_empty(), "{:?}", stack.notices);
        assert_eq!(
            (stack.spacing, stack.unit),
            ([0.25, 0.2, 0.5], Some(LengthUnit::Micrometre))
        );
        assert_eq!(stack.step(1, 1), [(0, 7), (0, 9), (0, 11)]);
    }

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
    fn pages_are_in_the_order_that_the_file_says() {
        let text = "ImageJ=1.54f\nchannels=2\nslices=3\nframes=2\norder=";
        let of = |order: &str| Stack::of_imagej(&format!("{text}{order}\n"), 12, Resolution::default());
        assert_eq!(of("default").unwrap().step(1, 1), [(0, 7), (0, 9), (0, 11)]);
        assert_eq!(of("zct").unwrap().step(1, 1), [(0, 9), (0, 10), (0, 11)]);
        assert_eq!(of("tzc").unwrap().step(1, 1), [(0, 7), (0, 9), (0, 11)]);
        assert!(of("zz").is_err() && of("c").is_err());
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
    fn counts_that_do_not_fit_are_refused() {
        for text in [
            "ImageJ=1\nslices=5",
            "ImageJ=1\nslices=65536\nchannels=65536",
            "ImageJ=1\nslices=x",
            "ImageJ=1\nframes=0",
        ] {
            assert!(Stack::of_imagej(text, 4, Resolution::default()).is_err(), "{text}");
        }
    }

    #[test]
    fn distances_that_are_partly_known_keep_their_ratio() {
        let [inch, own] = [false, true].map(|is_of_file| {
            move |text: &str, pixels: [f64; 2]| {
                let resolution = Resolution {
                    pixels: pixels.map(Some),
                    is_of_file,
                };
                let stack = Stack::of_imagej(&format!("ImageJ=1\n{text}"), 4, resolution).unwrap();
                (stack.spacing, stack.unit, stack.notices.lines().count())
            }
        });
        assert_eq!(inch("unit=pixel\n", [72.0; 2]), ([1.0; 3], None, 0));
        assert_eq!(inch("unit=pixel\nspacing=3\n", [72.0; 2]), ([1.0, 1.0, 3.0], None, 2));
        assert_eq!(own("spacing=3\n", [2.0, 4.0]), ([0.5, 0.25, 3.0], None, 1));
        assert_eq!(
            own("unit=mm\n", [2.0, 4.0]),
            ([0.5, 0.25, 1.0], Some(LengthUnit::Millimetre), 1)
        );
        assert_eq!(
            own("unit=furlong\nspacing=-2\n", [2.0, 0.0]),
            ([0.5, 0.5, 2.0], None, 1)
        );
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

    #[test]
    fn values_are_those_that_imagej_shows() {
        let of = |text: &str| {
            let stack = Stack::of_imagej(&format!("ImageJ=1\n{text}"), 4, Resolution::default()).unwrap();
            (stack.calibration, stack.value_unit, stack.notices.is_empty())
        };
        assert_eq!(
            of("cf=0\nc0=-32768\nc1=1\nvunit=HU\n"),
            (Some(Calibration::Signed), Some("HU".into()), true)
        );
        let line = Calibration::Line {
            slope: 2.0,
            intercept: -1000.0,
        };
        assert_eq!(
            of("cf=0\nc0=-1000.0\nc1=2.0\nvunit=Gray Value\n"),
            (Some(line), None, true)
        );
        assert_eq!(of("cf=0\nc0=0\nc1=1\n"), (None, None, true));
        assert_eq!(of("cf=8\nc0=1\nc1=2\nvunit=OD\n"), (None, None, false));
        assert_eq!(of(""), (None, None, true));
    }
}
