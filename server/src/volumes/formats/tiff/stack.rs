//! Which pages are the slices of a volume, its channels and its time steps, and how far apart they are.

use super::super::super::LengthUnit;

/// A volume in pages.
#[derive(Clone, Debug, PartialEq)]
pub struct Stack {
    /// Its name in a file with several.
    pub name: Option<String>,
    pub slices: u32,
    /// Names of the channels, where they have any; at least one.
    pub channels: Vec<Option<String>>,
    pub frames: u32,
    /// Time between frames, and its unit, where the file has them.
    pub interval: Option<(f64, String)>,
    pub spacing: [f64; 3],
    pub unit: Option<LengthUnit>,
    /// File and page of every slice: by frame, then channel, then slice.
    pub planes: Vec<(usize, usize)>,
}

/// Place of a slice among the planes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Index {
    pub z: u32,
    pub channel: u32,
    pub frame: u32,
}

impl Stack {
    /// A page is a slice.
    pub fn of_pages(pages: usize) -> Self {
        Self {
            name: None,
            slices: pages as u32,
            channels: vec![None],
            frames: 1,
            interval: None,
            spacing: [1.0; 3],
            unit: None,
            planes: (0..pages).map(|page| (0, page)).collect(),
        }
    }

    /// What ImageJ wrote into the first page: lines of names and values. The channel is the fastest index of the pages, the frame
    /// the slowest. `resolution`: pixels along x and y in one of the units.
    pub fn of_imagej(description: &str, pages: usize, resolution: [Option<f64>; 2]) -> Result<Self, String> {
        let value = |name: &str| {
            let mut lines = description.lines().filter_map(|line| line.split_once('='));
            lines.find(|(n, _)| *n == name).map(|(_, value)| value.trim())
        };
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
        if let Some(unit) = value("unit").filter(|unit| !unit.is_empty() && *unit != "pixel") {
            let depth = value("spacing").and_then(|text| text.parse().ok()).unwrap_or(1.0);
            let [x, y] = resolution.map(|pixels| pixels.map_or(1.0, |pixels| 1.0 / pixels));
            stack.spacing = [x, y, f64::abs(depth)];
            stack.unit = LengthUnit::parse(unit);
        }
        let interval = value("finterval").and_then(|text| text.parse().ok());
        stack.interval = interval.map(|interval| (interval, value("tunit").unwrap_or("sec").to_owned()));
        let page = |Index { z, channel, frame }| (frame * slices + z) * channels + channel;
        stack.planes = stack.order(|index| (0, page(index) as usize));
        Ok(stack)
    }

    /// What tifffile wrote into the first page: the array's shape, slowest axis first. Of four axes the first one is time, as in
    /// `.npy`. `None` where another program wrote it, or the pages are another array's.
    pub fn of_tifffile(description: &str, pages: usize) -> Option<Self> {
        let value: serde_json::Value = serde_json::from_str(description).ok()?;
        let sizes: Option<Vec<u64>> = value
            .get("shape")?
            .as_array()?
            .iter()
            .map(serde_json::Value::as_u64)
            .collect();
        let &[frames, slices, _, _] = sizes?.as_slice() else {
            return None;
        };
        let mut stack = Self::of_pages(pages);
        stack.frames = u32::try_from(frames).ok().filter(|&n| n > 0)?;
        stack.slices = u32::try_from(slices).ok()?;
        (frames.checked_mul(slices)? == pages as u64).then_some(stack)
    }

    /// Planes in their order, each where `place` says.
    pub fn order(&self, mut place: impl FnMut(Index) -> (usize, usize)) -> Vec<(usize, usize)> {
        let mut planes = Vec::new();
        for frame in 0..self.frames {
            for channel in 0..self.channels.len() as u32 {
                planes.extend((0..self.slices).map(|z| place(Index { z, channel, frame })));
            }
        }
        planes
    }

    /// The planes of a channel's time step.
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
        let stack = Stack::of_imagej(text, 12, [Some(4.0), Some(5.0)]).unwrap();
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
    fn counts_that_do_not_fit_are_refused() {
        for text in [
            "ImageJ=1\nslices=5",
            "ImageJ=1\nslices=65536\nchannels=65536",
            "ImageJ=1\nslices=x",
            "ImageJ=1\nframes=0",
        ] {
            assert!(Stack::of_imagej(text, 4, [None; 2]).is_err(), "{text}");
        }
        assert_eq!(
            Stack::of_imagej("ImageJ=1\nunit=pixel\n", 4, [Some(72.0); 2])
                .unwrap()
                .spacing,
            [1.0; 3]
        );
    }
}
