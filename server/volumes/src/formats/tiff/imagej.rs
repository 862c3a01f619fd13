//! The description of ImageJ: counts of pages, distances and place of samples, calibration of values.

use super::super::super::LengthUnit;
use super::stack::{Calibration, Resolution, Stack};

/// Returns a value of ImageJ's description.
fn imagej_value<'a>(description: &'a str, name: &str) -> Option<&'a str> {
    let mut lines = description.lines().filter_map(|line| line.split_once('='));
    lines.find(|(n, _)| *n == name).map(|(_, value)| value.trim())
}

/// Returns a finite number of ImageJ's description.
fn imagej_number(description: &str, name: &str) -> Option<f64> {
    let number: f64 = imagej_value(description, name)?.parse().ok()?;
    number.is_finite().then_some(number)
}

impl Stack {
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

    /// Sets distances and positions of samples as ImageJ does: position = (pixel − origin) · distance, with the origin in pixels.
    pub fn place_imagej(&mut self, description: &str, resolution: Resolution) {
        self.space_imagej(description, resolution);
        self.convert_units(description);
        let pixels = ["xorigin", "yorigin", "zorigin"].map(|name| imagej_number(description, name).unwrap_or(0.0));
        self.origin = std::array::from_fn(|axis| 0.0 - pixels[axis] * self.spacing[axis]);
        if imagej_value(description, "inverty").is_some_and(|text| text.eq_ignore_ascii_case("true")) {
            self.notices.add(
                "y increases from the first row on: \"Invert Y\" of ImageJ, which counts from the last, is not used",
            );
        }
    }

    /// Converts distances along y and z with a unit of their own to the unit along x.
    fn convert_units(&mut self, description: &str) {
        let metres = |unit: LengthUnit| unit.metres();
        for (axis, name) in [(1, "yunit"), (2, "zunit")] {
            let unit = imagej_value(description, name).filter(|unit| !unit.is_empty());
            let Some(unit) = unit.filter(|unit| imagej_value(description, "unit") != Some(unit)) else {
                continue;
            };
            let of_axis = LengthUnit::parse(unit).and_then(metres);
            if let (Some(of_axis), Some(of_x)) = (of_axis, self.unit.and_then(metres)) {
                self.spacing[axis] *= of_axis / of_x;
            } else {
                let notice =
                    format!("{name} is {unit:?}, which cannot be converted to the unit along x: taken as that");
                self.notices.add(notice);
            }
        }
    }

    /// Sets the distances of samples as ImageJ does. Its tacit assumptions become notices.
    fn space_imagej(&mut self, description: &str, resolution: Resolution) {
        let value = |name: &str| imagej_value(description, name);
        let named = value("unit").filter(|unit| !unit.is_empty() && !matches!(*unit, "pixel" | "pixels" | "null"));
        self.unit = named.and_then(LengthUnit::parse);
        let is_known = |size: &f64| size.is_finite() && *size > 0.0;
        let depth = imagej_number(description, "spacing").map(f64::abs).filter(is_known);
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
        let number = |name: &str| imagej_number(description, name);
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
    fn pages_are_in_the_order_that_the_file_says() {
        let text = "ImageJ=1.54f\nchannels=2\nslices=3\nframes=2\norder=";
        let of = |order: &str| Stack::of_imagej(&format!("{text}{order}\n"), 12, Resolution::default());
        assert_eq!(of("default").unwrap().step(1, 1), [(0, 7), (0, 9), (0, 11)]);
        assert_eq!(of("zct").unwrap().step(1, 1), [(0, 9), (0, 10), (0, 11)]);
        assert_eq!(of("tzc").unwrap().step(1, 1), [(0, 7), (0, 9), (0, 11)]);
        assert!(of("zz").is_err() && of("c").is_err());
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
    fn positions_are_those_that_imagej_shows() {
        let of = |text: &str| {
            let resolution = Resolution {
                pixels: [Some(4.0), Some(2.0)],
                is_of_file: false,
            };
            let stack = Stack::of_imagej(&format!("ImageJ=1\nspacing=3\n{text}"), 4, resolution).unwrap();
            (stack.spacing, stack.origin, stack.notices.lines().count())
        };
        let origin = "xorigin=10\nyorigin=-4.5\nzorigin=1.5\n";
        assert_eq!(
            of(&format!("unit=mm\n{origin}")),
            ([0.25, 0.5, 3.0], [-2.5, 2.25, -4.5], 0)
        );
        assert_eq!(of("unit=mm\nxorigin=NaN\n"), ([0.25, 0.5, 3.0], [0.0; 3], 0));
        assert_eq!(of("unit=mm\ninverty=true\n"), ([0.25, 0.5, 3.0], [0.0; 3], 1));
        assert_eq!(
            of("unit=mm\nyunit=cm\nzunit=mm\nzorigin=2\n"),
            ([0.25, 5.0, 3.0], [0.0, 0.0, -6.0], 0)
        );
        assert_eq!(of("unit=mm\nzunit=frame\n"), ([0.25, 0.5, 3.0], [0.0; 3], 1));
        // Pixels have an origin, too.
        let stack = Stack::of_imagej("ImageJ=1\nzorigin=2\n", 4, Resolution::default()).unwrap();
        assert_eq!((stack.spacing, stack.origin), ([1.0; 3], [0.0, 0.0, -2.0]));
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
