//! Names and colours of labels in a file beside the volume: of ITK-SNAP, FreeSurfer, or a table with columns.
//!
//! For a volume `aseg.nii.gz` of whole numbers, these files are tried: `aseg.label`, `aseg.ctab`, `aseg.lut`, `aseg.txt`, `aseg.tsv`,
//! `aseg.csv`; then `dseg.tsv` (BIDS) and `FreeSurferColorLUT.txt` in the same folder.

use super::super::{FileLocation, Label, MAX_LABELS, OpenedFile};

/// Maximum bytes of a table. FreeSurfer's has 70,000.
const MAX_BYTES: usize = 1 << 20;
const ENDINGS: [&str; 6] = ["label", "ctab", "lut", "txt", "tsv", "csv"];
const SHARED: [&str; 2] = ["dseg.tsv", "FreeSurferColorLUT.txt"];

/// Names the labels of a file's main field, if it may have labels and there is a table beside it.
pub fn name_labels(location: &FileLocation, file: &mut OpenedFile) {
    let Some(field) = file
        .fields
        .first_mut()
        .filter(|field| field.labels.is_empty() && may_be_labels(&field.stored_type))
    else {
        return;
    };
    if location.address().is_some() || location.part().is_some() {
        return;
    }
    let stem = location.stem();
    let own = ENDINGS.map(|ending| format!("{stem}.{ending}"));
    for name in own.iter().map(String::as_str).chain(SHARED) {
        let table = location
            .sibling(name, "labels")
            .ok()
            .and_then(|table| table.open().ok()?.head(MAX_BYTES).ok());
        let labels = table
            .map(|bytes| read(&String::from_utf8_lossy(&bytes)))
            .unwrap_or_default();
        if !labels.is_empty() {
            file.notices.add(format!("names of labels are those of {name:?}"));
            field.labels = labels;
            return;
        }
    }
}

/// Whether stored samples are whole numbers, judged by the name of their type.
pub fn may_be_labels(stored_type: &str) -> bool {
    let name = stored_type.to_ascii_lowercase();
    [
        "int", "char", "short", "long", "u8", "i8", "u16", "i16", "u32", "i32", "u64", "i64", "uint", "ushrt",
    ]
    .iter()
    .any(|word| name.contains(word))
}

/// Returns the labels of a table; none if the text is no table of labels.
fn read(text: &str) -> Vec<Label> {
    let mut lines = text
        .trim_start_matches('\u{feff}')
        .lines()
        .map(str::trim)
        .filter(|line| !line.is_empty())
        .peekable();
    let columns = lines.peek().and_then(|line| Columns::of(line));
    if columns.is_some() {
        lines.next();
    }
    let mut labels = Vec::new();
    for line in lines.filter(|line| !line.starts_with('#')) {
        let label = match &columns {
            Some(columns) => columns.label(line),
            None => of_line(line),
        };
        // A line that is no label makes the text no table.
        match label {
            Some(label) => labels.push(label),
            None => return Vec::new(),
        }
    }
    labels.sort_by_key(|label: &Label| label.value);
    labels.dedup_by_key(|label| label.value);
    labels.truncate(MAX_LABELS);
    labels
}

/// Parses a line of ITK-SNAP, `1 255 0 0 1 1 1 "Name"`, or of FreeSurfer, `1 Name 255 0 0 0`.
fn of_line(line: &str) -> Option<Label> {
    let (number, rest) = line.split_once(char::is_whitespace)?;
    let value: i64 = number.parse().ok()?;
    if let Some((numbers, name)) = rest.split_once('"') {
        let numbers: Vec<&str> = numbers.split_whitespace().collect();
        let color = color(numbers.get(..3)?)?;
        return Some(Label::new(value, name.trim_end_matches('"'), Some(color)));
    }
    let words: Vec<&str> = rest.split_whitespace().collect();
    let numbers = words
        .iter()
        .rev()
        .take_while(|word| word.parse::<f64>().is_ok())
        .count()
        .min(words.len().saturating_sub(1));
    let (name, numbers) = words.split_at(words.len() - numbers);
    // Red, green, blue, and perhaps transparency.
    let color = color(numbers.get(..3)?)?;
    Some(Label::new(value, &name.join(" "), Some(color)))
}

fn color(words: &[&str]) -> Option<[u8; 3]> {
    let channel = |word: &&str| word.parse::<u8>().ok();
    let channels: Vec<u8> = words.iter().map(channel).collect::<Option<_>>()?;
    channels.try_into().ok()
}

/// Meaning of the columns of a table.
struct Columns {
    separator: char,
    index: usize,
    name: Option<usize>,
    color: Option<usize>,
}

impl Columns {
    fn of(line: &str) -> Option<Self> {
        let separator = ['\t', ',', ';']
            .into_iter()
            .find(|&separator| line.contains(separator))?;
        let names: Vec<String> = line
            .split(separator)
            .map(|name| name.trim().trim_matches('"').to_ascii_lowercase())
            .collect();
        let find = |known: &[&str]| names.iter().position(|name| known.contains(&name.as_str()));
        Some(Self {
            separator,
            index: find(&["index", "label", "value", "id", "labelvalue"])?,
            name: find(&["name", "label_name", "labelname", "structure", "abbreviation"]),
            color: find(&["color", "colour"]),
        })
    }

    fn label(&self, line: &str) -> Option<Label> {
        let cells: Vec<&str> = line
            .split(self.separator)
            .map(|cell| cell.trim().trim_matches('"'))
            .collect();
        let value: i64 = cells.get(self.index)?.parse().ok()?;
        let name = self.name.and_then(|name| cells.get(name)).copied().unwrap_or_default();
        let color = self.color.and_then(|color| of_hex(cells.get(color)?));
        Some(Label::new(value, name, color))
    }
}

/// Parses a colour such as `#ff0000`.
fn of_hex(text: &str) -> Option<[u8; 3]> {
    let digits = text
        .strip_prefix('#')
        .filter(|digits| digits.len() == 6 && digits.is_ascii())?;
    let number = u32::from_str_radix(digits, 16).ok()?;
    let [_, r, g, b] = number.to_be_bytes();
    Some([r, g, b])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_of_three_programs_are_read() {
        let snap = "################\n# ITK-SnAP Label Description File\n    0     0    0    0        0  0  0    \"Clear Label\"\n    \
                    7   255    0  128        1  1  1    \"Left, \u{e9}\"\n";
        assert_eq!(
            read(snap),
            [
                Label::new(0, "Clear Label", Some([0; 3])),
                Label::new(7, "Left, \u{e9}", Some([255, 0, 128]))
            ]
        );
        let freesurfer = "#$Id\n\n#No. Label Name:  R   G   B   A\n  0   Unknown   0   0   0   0\r\n17  Left-Hippocampus  220 216 20  0\n";
        assert_eq!(
            read(freesurfer)[1],
            Label::new(17, "Left-Hippocampus", Some([220, 216, 20]))
        );
        let bids = "index\tname\tabbreviation\tcolor\n2\tWhite matter\tWM\t#ff00fe\n1\tGray Matter\tGM\tn/a\n";
        assert_eq!(
            read(bids),
            [
                Label::new(1, "Gray Matter", None),
                Label::new(2, "White matter", Some([255, 0, 254]))
            ]
        );
        assert_eq!(read("index,name\n-3,\"a\"\n"), [Label::new(-3, "a", None)]);
    }

    #[test]
    fn other_texts_have_no_labels() {
        for text in [
            "",
            "# notes",
            "scanned on Monday",
            "1 2 3",
            "1 name",
            "index\tname\nx\ty\n",
            "a,b\n1,2\n",
            "1 a 256 0 0",
        ] {
            assert!(read(text).is_empty(), "{text:?}");
        }
    }
}
