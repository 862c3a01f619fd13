//! Roles of the axes of an array: space, time, channels.

use super::super::super::ReadError;
use super::super::header::{self, Channels, MAX_CHANNELS, not_3d, numbers};
use super::header::{Header, vectors};

/// The axes of the array by role: space, time and channels.
pub(super) struct Axes {
    pub(super) count: usize,
    pub(super) space: [usize; 3],
    pub(super) time: Option<usize>,
    pub(super) dims: [u32; 3],
    pub(super) steps: u32,
    pub(super) strides: [u64; 4],
    /// The kind of the channels' axis, in lower case; empty if it has none.
    channel_kind: String,
    pub(super) channel_count: u32,
    /// Samples between channels.
    pub(super) channel_distance: u64,
}

impl Axes {
    pub(super) fn parse(header: &Header<'_>) -> Result<Self, ReadError> {
        let path = header.location.path();
        let count: usize = header
            .number("dimension")?
            .ok_or_else(|| header.error("dimension", "missing"))?;
        if !(1..=16).contains(&count) {
            return Err(header.error("dimension", format!("{count}, expected 1 to 16")));
        }
        let sizes: Vec<u64> = numbers(path, "sizes", header.required("sizes")?, Some(count))?;
        let sizes = header::sizes(path, "sizes", &sizes)?;
        let Roles {
            space,
            time,
            channels,
            kinds,
        } = Roles::parse(header, &sizes)?;
        let space: [usize; 3] = space
            .as_slice()
            .try_into()
            .map_err(|_| not_3d(path, "dimension", format!("{} axes in space", space.len())))?;
        // `StoredSamples::new` refuses products above 64 bits, so a saturated stride is never used.
        let stride = |axis: usize| sizes[..axis].iter().fold(1u64, |p, &n| p.saturating_mul(u64::from(n)));
        let total = stride(count);
        Ok(Self {
            count,
            space,
            time,
            dims: space.map(|a| sizes[a]),
            steps: time.map_or(1, |t| sizes[t]),
            strides: [
                stride(space[0]),
                stride(space[1]),
                stride(space[2]),
                time.map_or(total, stride),
            ],
            channel_kind: channels.map_or_else(String::new, |c| kinds[c].clone()),
            channel_count: channels.map_or(1, |c| sizes[c]),
            channel_distance: channels.map_or(total, stride),
        })
    }

    /// Returns how the channels become fields.
    pub(super) fn channels(&self, name: &str) -> Channels {
        let is_vector = ["vector", "normal", "gradient"]
            .iter()
            .any(|word| self.channel_kind.ends_with(word));
        match self.channel_kind.as_str() {
            "list" => match self.channel_count {
                1 => Channels::numbered(name, 1),
                n => Channels::named(name, &(1..=n).map(|n| format!("layer {n}")).collect::<Vec<_>>()),
            },
            "rgb-color" | "rgba-color" if self.channel_count >= 3 => Channels::Luminance,
            _ if is_vector => Channels::vector(name, self.channel_count),
            _ => Channels::numbered(name, self.channel_count),
        }
    }
}

/// Roles of the axes.
struct Roles {
    space: Vec<usize>,
    time: Option<usize>,
    channels: Option<usize>,
    /// Kind of every axis, in lower case.
    kinds: Vec<String>,
}

impl Roles {
    fn parse(header: &Header<'_>, sizes: &[u32]) -> Result<Self, ReadError> {
        let count = sizes.len();
        let kinds: Vec<String> = match header.get("kinds") {
            Some(text) => text.split_whitespace().map(str::to_ascii_lowercase).collect(),
            None => vec!["???".to_owned(); count],
        };
        if kinds.len() != count {
            return Err(header.error("kinds", format!("{} kinds, expected {count}", kinds.len())));
        }
        let directions = header.get("space directions").and_then(vectors);
        let of_kind = |kind: &str| kinds.iter().position(|k| k == kind);
        let time = match header.is_segmentation() {
            true => None,
            false => of_kind("time").or_else(|| of_kind("list")),
        };
        let mut roles = Self {
            space: Vec::new(),
            time,
            channels: None,
            kinds,
        };
        for (axis, &size) in sizes.iter().enumerate() {
            let in_space = directions.as_ref().and_then(|d| d.get(axis)).map(Option::is_some);
            match roles.kinds[axis].as_str() {
                _ if roles.time == Some(axis) => {}
                "domain" | "space" => roles.space.push(axis),
                "???" | "none" if in_space == Some(true) || (in_space.is_none() && count == 3) => {
                    roles.space.push(axis);
                }
                _ if size == 1 => {}
                "???" | "none" if count == 4 => {
                    let why =
                        format!("axis {axis} of 4 may be time or components, expected `kinds` to tell (domain, time)");
                    return Err(header.error("kinds", why));
                }
                "???" | "none" => return Err(not_3d(header.location.path(), "dimension", count)),
                kind if roles.channels.is_some() || u64::from(size) > MAX_CHANNELS => {
                    let why = format!(
                        "{kind:?} along axis {axis}: {size} components a sample, \
                         expected one axis of {MAX_CHANNELS} at most"
                    );
                    return Err(header.error("kinds", why));
                }
                _ => roles.channels = Some(axis),
            }
        }
        Ok(roles)
    }
}
