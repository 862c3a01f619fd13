//! Fields and key/value pairs of a header, and lists of vectors in them.

use super::super::super::{FileLocation, Label, MAX_LABELS, ReadError};

/// Header of a file.
pub(super) struct Header<'a> {
    pub(super) location: &'a FileLocation,
    pub(super) fields: Vec<(String, String)>,
    pub(super) pairs: Vec<(String, String)>,
    /// Offset of samples in the same file: after the empty line, or at the end of the bytes.
    pub(super) data_offset: usize,
}

impl<'a> Header<'a> {
    pub(super) fn parse(location: &'a FileLocation, bytes: &[u8]) -> Result<Self, ReadError> {
        let mut header = Header {
            location,
            fields: Vec::new(),
            pairs: Vec::new(),
            data_offset: bytes.len(),
        };
        let mut at = 0;
        for (number, line) in bytes.split_inclusive(|&b| b == b'\n').enumerate() {
            at += line.len();
            let line = line.strip_suffix(b"\n").unwrap_or(line);
            let line = line.strip_suffix(b"\r").unwrap_or(line);
            if number == 0 {
                // The first version used another magic word.
                if !matches!(
                    line,
                    b"NRRD00.01" | [b'N', b'R', b'R', b'D', b'0', b'0', b'0', b'1'..=b'5']
                ) {
                    return Err(header.error("magic", "expected NRRD0001 to NRRD0005 on the first line"));
                }
                continue;
            }
            if line.is_empty() {
                header.data_offset = at;
                break;
            }
            if header.get("data file").is_some_and(|file| file.starts_with("LIST")) {
                // Names of files follow, one a line, up to the end.
                break;
            }
            let line = String::from_utf8_lossy(line);
            if line.starts_with('#') {
            } else if let Some((key, value)) = line.split_once(":=") {
                header.pairs.push((key.trim().to_owned(), value.trim().to_owned()));
            } else if let Some((name, value)) = line.split_once(": ").or_else(|| line.split_once(':')) {
                let name = canonical(name);
                if header.get(&name).is_some() {
                    return Err(header.error(name, "given twice, expected once"));
                }
                header.fields.push((name, value.trim().to_owned()));
            } else {
                let shown: String = line.chars().take(40).collect();
                let why = format!(
                    "line {} is {shown:?}, expected `field: value` or `key:=value`",
                    number + 1
                );
                return Err(header.error("header", why));
            }
        }
        Ok(header)
    }

    pub(super) fn error(&self, field: impl Into<String>, why: impl Into<String>) -> ReadError {
        ReadError::new(self.location.path(), field, why)
    }

    pub(super) fn get(&self, name: &str) -> Option<&str> {
        self.fields.iter().find(|(n, _)| n == name).map(|(_, v)| v.as_str())
    }

    pub(super) fn required(&self, name: &str) -> Result<&str, ReadError> {
        self.get(name)
            .ok_or_else(|| self.error(name, "missing, expected in every NRRD header"))
    }

    pub(super) fn number<T: std::str::FromStr>(&self, name: &str) -> Result<Option<T>, ReadError> {
        self.get(name)
            .map(|v| {
                v.parse()
                    .map_err(|_| self.error(name, format!("{v:?}, expected a whole number")))
            })
            .transpose()
    }

    /// Returns the value of a key.
    fn pair(&self, key: &str) -> Option<&str> {
        self.pairs
            .iter()
            .find(|(k, _)| k == key)
            .map(|(_, value)| value.as_str())
    }

    /// Whether the file is a segmentation of 3D Slicer, whose axis of kind `list` has layers.
    pub(super) fn is_segmentation(&self) -> bool {
        self.pair("Segment0_ID").or(self.pair("Segment0_Name")).is_some()
    }

    /// Returns the segments of a layer.
    pub(super) fn segments(&self, layer: usize) -> Vec<Label> {
        let value = |i: usize, name: &str| self.pair(&format!("Segment{i}_{name}"));
        let is_there = |i: &usize| value(*i, "ID").or(value(*i, "Name")).is_some();
        let segments = (0..MAX_LABELS).take_while(is_there).filter_map(|i| {
            // Files from before layers existed have one layer for each segment, with the value 1.
            let number = |name: &str| value(i, name).and_then(|text| text.parse::<i64>().ok());
            let own = number("Layer").map_or(i, |own| usize::try_from(own).unwrap_or(usize::MAX));
            let color = value(i, "Color").and_then(|text| {
                let channels: Vec<f64> = text.split_whitespace().map(str::parse).collect::<Result<_, _>>().ok()?;
                let channels: [f64; 3] = channels.try_into().ok()?;
                Some(channels.map(|channel| (255.0 * channel).round() as u8))
            });
            let name = value(i, "Name").or(value(i, "ID")).unwrap_or_default();
            (own == layer).then(|| Label::new(number("LabelValue").unwrap_or(1), name, color))
        });
        let mut labels: Vec<Label> = segments.collect();
        labels.sort_by_key(|label| label.value);
        labels
    }

    pub(super) fn missing(&self) -> Result<Option<f32>, ReadError> {
        let names = ["missing value", "missing_value", "_FillValue"];
        let Some((key, value)) = self.pairs.iter().find(|(k, _)| names.contains(&k.as_str())) else {
            return Ok(None);
        };
        let value: f64 = value
            .parse()
            .map_err(|_| self.error(key, format!("{value:?}, expected a number")))?;
        Ok(Some(value as f32))
    }
}

/// Returns a field name in the first spelling of the format's specification.
fn canonical(name: &str) -> String {
    match name.trim().to_ascii_lowercase().as_str() {
        "datafile" => "data file".into(),
        "lineskip" => "line skip".into(),
        "byteskip" => "byte skip".into(),
        "sampleunits" => "sample units".into(),
        "spaceunits" => "space units".into(),
        "axismins" => "axis mins".into(),
        "axismaxs" => "axis maxs".into(),
        "centerings" => "centers".into(),
        other => other.into(),
    }
}

/// Parses vectors such as `(1,0,0) none (0, 1, 0)`.
pub(super) fn vectors(text: &str) -> Option<Vec<Option<Vec<f64>>>> {
    let mut out = Vec::new();
    let mut rest = text.trim_start();
    while !rest.is_empty() {
        if let Some(inner) = rest.strip_prefix('(') {
            let (inside, after) = inner.split_once(')')?;
            out.push(Some(
                inside
                    .split(',')
                    .map(|n| n.trim().parse().ok())
                    .collect::<Option<Vec<f64>>>()?,
            ));
            rest = after.trim_start();
        } else {
            rest = rest.strip_prefix("none")?.trim_start();
            out.push(None);
        }
    }
    Some(out)
}
