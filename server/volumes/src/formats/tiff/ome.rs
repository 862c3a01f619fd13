//! OME-TIFF: XML in the first page assigns pages of one or more files to slices (<https://docs.openmicroscopy.org/ome-model/>).

use std::collections::{HashMap, HashSet};

use quick_xml::Reader;
use quick_xml::events::{BytesStart, Event};

use super::super::super::{LengthUnit, Notices};
use super::stack::{Index, Stack};

/// Finds a file of a set by its name, or the file itself for `None`. Returns its index among the files, and its number of pages.
pub type FindFile<'a> = dyn FnMut(Option<&str>) -> Result<(usize, usize), String> + 'a;

/// `Pixels` and its child elements.
#[derive(Default)]
struct Pixels {
    name: Option<String>,
    attributes: HashMap<String, String>,
    channels: Vec<HashMap<String, String>>,
    blocks: Vec<Block>,
}

/// `TiffData`: consecutive planes.
#[derive(Default)]
struct Block {
    attributes: HashMap<String, String>,
    file: Option<String>,
}

/// Whether a description is that of an OME-TIFF.
pub fn is_ome(description: &str) -> bool {
    let text = description.trim_start();
    text.starts_with('<') && text.contains("<OME")
}

/// Reads the volumes that the XML describes.
pub fn read(xml: &str, find: &mut FindFile<'_>) -> Result<Vec<Stack>, String> {
    let stacks: Vec<Stack> = parse(xml)?
        .iter()
        .map(|pixels| stack(pixels, find))
        .collect::<Result<_, _>>()?;
    if stacks.is_empty() {
        return Err("no Pixels in its XML, expected at least one".into());
    }
    Ok(stacks)
}

fn parse(xml: &str) -> Result<Vec<Pixels>, String> {
    let mut reader = Reader::from_str(xml);
    let (mut found, mut name): (Vec<Pixels>, Option<String>) = (Vec::new(), None);
    loop {
        let event = reader.read_event().map_err(|e| format!("its XML: {e}"))?;
        let (Event::Start(element) | Event::Empty(element)) = event else {
            if let Event::Eof = event {
                return Ok(found);
            }
            continue;
        };
        let attributes = attributes(&element)?;
        match (element.local_name().as_ref(), found.last_mut()) {
            ("BinaryOnly", _) => {
                let file = attributes.get("MetadataFile").map_or("", String::as_str);
                return Err(format!(
                    "its metadata are in {file:?}, expected them in the file itself"
                ));
            }
            ("Image", _) => name = attributes.get("Name").cloned(),
            ("Pixels", _) => found.push(Pixels {
                name: name.take(),
                attributes,
                ..Pixels::default()
            }),
            ("Channel", Some(pixels)) => pixels.channels.push(attributes),
            ("TiffData", Some(pixels)) => pixels.blocks.push(Block { attributes, file: None }),
            ("UUID", Some(pixels)) => {
                if let Some(block) = pixels.blocks.last_mut() {
                    block.file = attributes.get("FileName").cloned();
                }
            }
            _ => {}
        }
    }
}

fn attributes(element: &BytesStart<'_>) -> Result<HashMap<String, String>, String> {
    let read = |attribute: Result<quick_xml::events::attributes::Attribute<'_>, _>| {
        let attribute = attribute.map_err(|e: quick_xml::events::attributes::AttrError| format!("its XML: {e}"))?;
        let name = attribute.key.local_name().as_ref().to_owned();
        let value = quick_xml::escape::unescape(&attribute.value).map_err(|e| format!("its XML: {e}"))?;
        Ok((name, value.into_owned()))
    };
    element.attributes().map(read).collect()
}

/// Returns a number among the attributes.
fn number(attributes: &HashMap<String, String>, name: &str, default: Option<u32>) -> Result<u32, String> {
    match (attributes.get(name), default) {
        (Some(text), _) => text
            .trim()
            .parse()
            .map_err(|_| format!("{name} is {text:?}, expected a whole number")),
        (None, Some(default)) => Ok(default),
        (None, None) => Err(format!("Pixels without {name}, expected a number")),
    }
}

fn stack(pixels: &Pixels, find: &mut FindFile<'_>) -> Result<Stack, String> {
    let size = |name: &str| match number(&pixels.attributes, name, None)? {
        0 => Err(format!("{name} is 0, expected at least 1")),
        n => Ok(n),
    };
    let (slices, samples, frames) = (size("SizeZ")?, size("SizeC")?, size("SizeT")?);
    // A channel may have several samples in one plane: RGB.
    let channels = match pixels.channels.len() as u32 {
        0 => samples,
        n => n.min(samples),
    };
    let sizes = [slices, channels, frames];
    let placed = place(pixels, sizes, find)?;
    // Placed planes are existing pages, so this many can be allocated.
    if let Some([z, channel, frame]) = first_missing(&placed, sizes) {
        return Err(format!(
            "no page for slice {z} of channel {channel} at time {frame}, expected one for each"
        ));
    }
    let mut notices = Notices::default();
    let (spacing, unit) = spacing(&pixels.attributes, slices, &mut notices);
    let name = |i: u32| {
        pixels
            .channels
            .get(i as usize)?
            .get("Name")
            .cloned()
            .filter(|name| !name.is_empty())
    };
    let mut stack = Stack {
        name: pixels.name.clone(),
        slices,
        channels: (0..channels).map(name).collect(),
        frames,
        interval: interval(&pixels.attributes),
        spacing,
        origin: [0.0; 3],
        unit,
        calibration: None,
        value_unit: None,
        missing: None,
        notices,
        planes: Vec::new(),
    };
    stack.planes = stack.order(|Index { z, channel, frame }| placed[&[z, channel, frame]]);
    Ok(stack)
}

/// File and page of planes, by slice, channel and frame.
type Placed = HashMap<[u32; 3], (usize, usize)>;

fn first_missing(placed: &Placed, [slices, channels, frames]: [u32; 3]) -> Option<[u32; 3]> {
    let planes = (0..frames).flat_map(|t| (0..channels).flat_map(move |c| (0..slices).map(move |z| [z, c, t])));
    planes.into_iter().find(|plane| !placed.contains_key(plane))
}

/// Finds the file and page of every plane. `sizes` are those of Z, C and T.
fn place(pixels: &Pixels, sizes: [u32; 3], find: &mut FindFile<'_>) -> Result<Placed, String> {
    let order = pixels.attributes.get("DimensionOrder").map_or("XYZCT", String::as_str);
    let axes: Vec<usize> = order.chars().skip(2).filter_map(|axis| "ZCT".find(axis)).collect();
    if order.len() != 5 || axes.len() != 3 {
        return Err(format!(
            "DimensionOrder {order:?}, expected XY and then Z, C, T in any order"
        ));
    }
    let whole = [Block::default()];
    let blocks = if pixels.blocks.is_empty() {
        &whole[..]
    } else {
        &pixels.blocks
    };
    let (mut placed, mut used) = (Placed::new(), HashSet::new());
    for Block { attributes, file } in blocks {
        let (file, pages) = find(file.as_deref())?;
        let first = |name: &str| number(attributes, name, Some(0));
        let (mut at, page) = (
            [first("FirstZ")?, first("FirstC")?, first("FirstT")?],
            first("IFD")? as usize,
        );
        // If a page is named, one plane is meant, else all.
        let default = if attributes.contains_key("IFD") {
            1
        } else {
            pages as u32
        };
        let count = number(attributes, "PlaneCount", Some(default))? as usize;
        for page in page..(page + count).min(pages) {
            if at.iter().zip(sizes).any(|(at, size)| *at >= size) {
                break;
            }
            if !used.insert((file, page)) {
                return Err(format!("page {} has several planes, expected one", page + 1));
            }
            placed.insert(at, (file, page));
            // Advance like an odometer; it stops after the last plane.
            for (i, &axis) in axes.iter().enumerate() {
                at[axis] += 1;
                if at[axis] < sizes[axis] || i == 2 {
                    break;
                }
                at[axis] = 0;
            }
        }
    }
    Ok(placed)
}

/// Returns the time between frames, in seconds unless the file states another unit.
fn interval(attributes: &HashMap<String, String>) -> Option<(f64, String)> {
    let increment = attributes.get("TimeIncrement")?.trim().parse().ok()?;
    let unit = attributes.get("TimeIncrementUnit").map_or("s", String::as_str);
    Some((increment, unit.to_owned()))
}

/// Returns the distances of samples in the unit of the first axis that has one. A missing distance is taken from the others, with a notice.
fn spacing(attributes: &HashMap<String, String>, slices: u32, notices: &mut Notices) -> ([f64; 3], Option<LengthUnit>) {
    let along = |axis: &str| {
        let size = attributes
            .get(&format!("PhysicalSize{axis}"))?
            .trim()
            .parse::<f64>()
            .ok()?;
        let unit = attributes
            .get(&format!("PhysicalSize{axis}Unit"))
            .map_or("µm", |unit| unit.trim());
        (size.is_finite() && size > 0.0).then_some((size, unit))
    };
    let all = [along("X"), along("Y"), along("Z")];
    let Some((_, first)) = all.into_iter().flatten().next() else {
        return ([1.0; 3], None);
    };
    let metres = |unit: &str| LengthUnit::parse(unit).and_then(LengthUnit::metres);
    let in_first = |(size, unit): (f64, &str)| match (metres(unit), metres(first)) {
        _ if unit == first => Some(size),
        (Some(own), Some(other)) => Some(size * (own / other)),
        _ => None,
    };
    let known = all.map(|size| size.and_then(in_first));
    // Pixels are mostly square.
    let in_plane = known[0].or(known[1]).or(known[2]).unwrap_or(1.0);
    let spacing = [
        known[0].unwrap_or(in_plane),
        known[1].unwrap_or(in_plane),
        known[2].unwrap_or(in_plane),
    ];
    for (axis, name) in ["X", "Y", "Z"].into_iter().enumerate() {
        if known[axis].is_none() && (axis < 2 || slices > 1) {
            notices.add(format!(
                "PhysicalSize{name} is missing or not in a known unit: samples along it are {in_plane} {first} apart, as along another axis"
            ));
        }
    }
    let unit = LengthUnit::parse(first);
    if unit.is_none() {
        notices.add(format!(
            "the unit of lengths, {first:?}, is not known: distances are without one"
        ));
    }
    (spacing, unit)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn xml(order: &str, inside: &str) -> String {
        format!(
            r#"<?xml version="1.0"?><OME xmlns="x"><Image ID="Image:0" Name="a &amp; b"><Pixels DimensionOrder="{order}"
            SizeX="4" SizeY="4" SizeZ="2" SizeC="2" SizeT="1" PhysicalSizeX="0.5" PhysicalSizeY="0.5" PhysicalSizeZ="2"
            PhysicalSizeXUnit="mm" PhysicalSizeYUnit="mm" PhysicalSizeZUnit="m">{inside}</Pixels></Image></OME>"#
        )
    }

    /// A set of two files, of 4 and 2 pages.
    fn find(name: Option<&str>) -> Result<(usize, usize), String> {
        match name {
            None => Ok((0, 4)),
            Some("b.tif") => Ok((1, 2)),
            Some(name) => Err(format!("{name}: not found")),
        }
    }

    #[test]
    fn planes_follow_the_order_of_dimensions() {
        let both = r#"<Channel Name="red"/><Channel/>"#;
        for (order, second) in [("XYZCT", [(0, 2), (0, 3)]), ("XYCZT", [(0, 1), (0, 3)])] {
            let stacks = read(&xml(order, both), &mut find).unwrap();
            assert_eq!(stacks[0].step(1, 0), second, "{order}");
            assert_eq!(stacks[0].name.as_deref(), Some("a & b"));
            assert_eq!(stacks[0].channels, [Some("red".into()), None]);
            assert_eq!(
                (stacks[0].spacing, stacks[0].unit),
                ([0.5, 0.5, 2000.0], Some(LengthUnit::Millimetre))
            );
        }
    }

    #[test]
    fn sizes_that_are_partly_known_are_used() {
        let of = |sizes: &[(&str, &str)]| {
            let attributes = sizes
                .iter()
                .map(|(name, value)| ((*name).to_owned(), (*value).to_owned()));
            let mut notices = Notices::default();
            let (spacing, unit) = spacing(&attributes.collect(), 2, &mut notices);
            (spacing, unit, notices.lines().count())
        };
        let micrometres = Some(LengthUnit::Micrometre);
        assert_eq!(
            of(&[("PhysicalSizeX", "0.2"), ("PhysicalSizeY", "0.3")]),
            ([0.2, 0.3, 0.2], micrometres, 1)
        );
        assert_eq!(of(&[("PhysicalSizeZ", "2")]), ([2.0; 3], micrometres, 2));
        let pixels = ["X", "Y", "Z"].map(|axis| format!("PhysicalSize{axis}Unit"));
        let all = [("PhysicalSizeX", "1"), ("PhysicalSizeY", "1"), ("PhysicalSizeZ", "4")];
        let units = pixels.iter().map(|name| (name.as_str(), "pixel"));
        let sizes: Vec<_> = all.into_iter().chain(units).collect();
        assert_eq!(of(&sizes), ([1.0, 1.0, 4.0], None, 1));
        assert_eq!(
            of(&[("PhysicalSizeX", "0"), ("PhysicalSizeY", "nan")]),
            ([1.0; 3], None, 0)
        );
    }

    #[test]
    fn planes_may_be_in_other_files() {
        let inside = r#"<TiffData IFD="1" PlaneCount="2"/>
            <TiffData FirstC="1" PlaneCount="2"><UUID FileName="b.tif">u</UUID></TiffData>"#;
        let stacks = read(&xml("XYZCT", inside), &mut find).unwrap();
        assert_eq!(
            (stacks[0].step(0, 0), stacks[0].step(1, 0)),
            (&[(0, 1), (0, 2)][..], &[(1, 0), (1, 1)][..])
        );
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        for (inside, expected) in [
            (
                r#"<TiffData IFD="0" PlaneCount="3"/>"#,
                "no page for slice 1 of channel 1",
            ),
            (r#"<TiffData IFD="0"/><TiffData IFD="0"/>"#, "page 1 has several planes"),
            (r#"<TiffData><UUID FileName="c.tif"/></TiffData>"#, "c.tif: not found"),
            (r#"<TiffData PlaneCount="many"/>"#, "expected a whole number"),
        ] {
            let error = read(&xml("XYZCT", inside), &mut find).unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
        assert!(read(&xml("XYZC", ""), &mut find).is_err());
        assert!(read("<OME><BinaryOnly MetadataFile=\"a.companion.ome\"/></OME>", &mut find).is_err());
        assert!(read("<OME/>", &mut find).is_err());
    }
}
