//! BigDataViewer's XML (`SpimData`): the file with the samples, its views, and the position of each view in the world.

use std::collections::BTreeMap;

use quick_xml::Reader;
use quick_xml::XmlVersion;
use quick_xml::events::{BytesStart, Event};

use super::header;
use crate::{FileLocation, LengthUnit, ReadError};

/// Maximum bytes of such a file.
const MAX_BYTES: usize = 16 << 20;
/// Maximum nesting of elements.
const MAX_DEPTH: usize = 64;

/// Contents of the XML.
#[derive(Debug, Default)]
pub(super) struct SpimData {
    /// `bdv.hdf5`, `bdv.n5`, …
    pub(super) format: String,
    pub(super) file: String,
    pub(super) setups: BTreeMap<u64, Setup>,
    /// Transformations from pixels to the world by time point and setup: the rows of a matrix.
    registrations: BTreeMap<(u64, u64), [f64; 12]>,
}

/// A view: an angle, a channel or a tile.
#[derive(Debug, Default)]
pub(super) struct Setup {
    pub(super) name: Option<String>,
    voxel_size: Option<[f64; 3]>,
    unit: Option<String>,
}

/// Grid of the samples of a view in the world.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ViewGrid {
    pub(super) spacing: [f64; 3],
    pub(super) origin: [f64; 3],
    pub(super) direction: [[f64; 3]; 3],
    pub(super) unit: Option<LengthUnit>,
}

/// Reads the description beside a file or folder with samples, whose name differs only in its ending.
pub(super) fn beside(location: &FileLocation) -> Option<SpimData> {
    let name = format!("{}.xml", location.stem());
    let xml = location.sibling(&name, "file").ok()?;
    read(&xml).ok()
}

/// Reads such a file.
pub(super) fn read(location: &FileLocation) -> Result<SpimData, ReadError> {
    let bytes = location.open()?.head(MAX_BYTES + 1)?;
    let fail = |why: String| ReadError::new(location.path(), "SpimData", why);
    if bytes.len() > MAX_BYTES {
        return Err(fail(format!("more than {MAX_BYTES} bytes, expected fewer")));
    }
    let text = std::str::from_utf8(&bytes).map_err(|e| fail(e.to_string()))?;
    parse(text).map_err(fail)
}

/// State of the parser.
#[derive(Default)]
struct Reading {
    data: SpimData,
    /// Names of the enclosing elements.
    path: Vec<String>,
    text: String,
    setup: u64,
    /// Time point and setup of the current view.
    view: Option<(u64, u64)>,
}

fn parse(text: &str) -> Result<SpimData, String> {
    let mut reader = Reader::from_str(text);
    let mut reading = Reading::default();
    loop {
        match reader.read_event().map_err(|e| e.to_string())? {
            Event::Start(element) => reading.start(&element)?,
            Event::Empty(element) => {
                reading.start(&element)?;
                reading.end()?;
            }
            Event::Text(text) => reading.text.push_str(&text.xml10_content()),
            Event::End(_) => reading.end()?,
            Event::Eof => return Ok(reading.data),
            _ => {}
        }
    }
}

impl Reading {
    fn start(&mut self, element: &BytesStart<'_>) -> Result<(), String> {
        if self.path.len() >= MAX_DEPTH {
            return Err(format!("more than {MAX_DEPTH} elements in each other"));
        }
        let name = element.local_name().as_ref().to_owned();
        let attribute = |name: &str| -> Result<Option<String>, String> {
            let found = element.try_get_attribute(name).map_err(|e| e.to_string())?;
            let value = found.map(|a| {
                a.normalized_value(XmlVersion::Implicit1_0)
                    .map(|value| value.into_owned())
            });
            value.transpose().map_err(|e| e.to_string())
        };
        let number = |name: &str| -> Result<u64, String> {
            let text = attribute(name)?.unwrap_or_default();
            text.trim()
                .parse()
                .map_err(|_| format!("{name} is {text:?}, expected a whole number"))
        };
        match name.as_str() {
            "ImageLoader" => self.data.format = attribute("format")?.unwrap_or_default(),
            "ViewRegistration" => {
                let view = (number("timepoint")?, number("setup")?);
                self.data.registrations.insert(view, IDENTITY);
                self.view = Some(view);
            }
            _ => {}
        }
        self.path.push(name);
        self.text.clear();
        Ok(())
    }

    fn end(&mut self) -> Result<(), String> {
        let text = std::mem::take(&mut self.text);
        let text = text.trim();
        let path: Vec<&str> = self.path.iter().rev().map(String::as_str).collect();
        match path.as_slice() {
            ["hdf5" | "n5", "ImageLoader", ..] => text.clone_into(&mut self.data.file),
            ["id", "ViewSetup", ..] => {
                self.setup = text
                    .parse()
                    .map_err(|_| format!("the id of a setup is {text:?}, expected a number"))?;
                self.data.setups.entry(self.setup).or_default();
            }
            ["name", "ViewSetup", ..] => self.setup().name = Some(text.to_owned()).filter(|name| !name.is_empty()),
            ["unit", "voxelSize", ..] => self.setup().unit = Some(text.to_owned()),
            ["size", "voxelSize", ..] => self.setup().voxel_size = Some(numbers(text)?),
            ["affine", "ViewTransform", ..] => {
                let affine = numbers(text)?;
                if let Some(whole) = self.view.and_then(|view| self.data.registrations.get_mut(&view)) {
                    *whole = product(whole, &affine);
                }
            }
            _ => {}
        }
        self.path.pop();
        Ok(())
    }

    fn setup(&mut self) -> &mut Setup {
        self.data.setups.entry(self.setup).or_default()
    }
}

/// Returns the factor from lengths of the world to the unit of the voxels' size; `None` with a notice if it is not the same along each
/// axis. Programs write registrations in voxels as well as in that unit.
fn scale_of_world(lengths: [f64; 3], voxel: [f64; 3]) -> (Option<f64>, Option<String>) {
    let ratios: [f64; 3] = std::array::from_fn(|axis| voxel[axis] / lengths[axis]);
    let first = ratios[0];
    if first.is_finite() && first > 0.0 && ratios.iter().all(|ratio| (ratio / first - 1.0).abs() <= 1e-3) {
        return (Some(first), None);
    }
    let notice = format!(
        "the registration has voxels of {lengths:?}, the view says {voxel:?}: the unit of lengths is not known"
    );
    (None, Some(notice))
}

const IDENTITY: [f64; 12] = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];

fn numbers<const N: usize>(text: &str) -> Result<[f64; N], String> {
    let words = text.split_whitespace().map(str::parse);
    let numbers: Result<Vec<f64>, _> = words.collect();
    let numbers = numbers.ok().and_then(|numbers| numbers.try_into().ok());
    numbers.ok_or_else(|| format!("{text:?}, expected {N} numbers"))
}

/// Returns the transformation that applies `b`, then `a`.
fn product(a: &[f64; 12], b: &[f64; 12]) -> [f64; 12] {
    std::array::from_fn(|i| {
        let (row, column) = (i / 4, i % 4);
        let moved = if column == 3 { a[4 * row + 3] } else { 0.0 };
        (0..3).map(|k| a[4 * row + k] * b[4 * k + column]).sum::<f64>() + moved
    })
}

impl SpimData {
    /// Returns the grid of a view, and a notice of its unknown properties. The level has every `step`th sample along x, y and z.
    pub(super) fn place(&self, time: u64, setup: u64, step: [f64; 3]) -> (ViewGrid, Option<String>) {
        let own = self.setups.get(&setup);
        let unit = own.and_then(|own| own.unit.as_deref()).and_then(LengthUnit::parse);
        let voxel = own.and_then(|own| own.voxel_size);
        // A sample of a coarser level is the mean of the samples that it replaces.
        let shift = step.map(|step| 0.5 * (step - 1.0));
        let Some(affine) = self.registrations.get(&(time, setup)) else {
            let size = voxel.unwrap_or([1.0; 3]);
            let grid = ViewGrid {
                spacing: std::array::from_fn(|axis| size[axis] * step[axis]),
                origin: std::array::from_fn(|axis| size[axis] * shift[axis]),
                direction: crate::Geometry::IDENTITY,
                unit,
            };
            let why = match voxel {
                Some(_) => "the view has no registration: its voxel size was taken",
                None => "the view has neither a registration nor a voxel size: samples are 1 apart along each axis",
            };
            return (grid, Some(why.to_owned()));
        };
        let columns: [[f64; 3]; 3] = std::array::from_fn(|axis| std::array::from_fn(|row| affine[4 * row + axis]));
        let (lengths, direction) = header::split_axes(columns);
        let (scale, notice) = match voxel.zip(unit) {
            Some((voxel, _)) => scale_of_world(lengths, voxel),
            None => (None, None),
        };
        let factor = scale.unwrap_or(1.0);
        let origin = std::array::from_fn(|row| {
            let moved: f64 = (0..3).map(|axis| columns[axis][row] * shift[axis]).sum();
            factor * (affine[4 * row + 3] + moved)
        });
        let grid = ViewGrid {
            spacing: std::array::from_fn(|axis| factor * lengths[axis] * step[axis]),
            origin,
            direction,
            unit: unit.filter(|_| scale.is_some()),
        };
        (grid, notice)
    }

    /// Returns the view that a location names by its number or name, or the only view.
    ///
    /// # Errors
    /// There are several views and none is named, or none has that name.
    pub(super) fn choose(&self, part: Option<&str>, found: &[u64]) -> Result<u64, String> {
        let name = |setup: &u64| self.setups.get(setup).and_then(|setup| setup.name.clone());
        let shown = |setup: &u64| match name(setup) {
            Some(name) => format!("{setup} ({name})"),
            None => setup.to_string(),
        };
        let list = || found.iter().map(shown).collect::<Vec<_>>().join(", ");
        match part {
            Some(part) => {
                let number = part.trim_start_matches("setup").trim_start_matches('s').parse().ok();
                let mut named = found
                    .iter()
                    .filter(|setup| Some(**setup) == number || name(setup).as_deref() == Some(part));
                named
                    .next()
                    .copied()
                    .ok_or_else(|| format!("no view {part:?}, expected one of {}", list()))
            }
            None => match found {
                [one] => Ok(*one),
                _ => Err(format!(
                    "{} views, expected one: name it behind a colon, as in file:0; found {}",
                    found.len(),
                    list()
                )),
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transformations_are_applied_from_the_last_to_the_first() {
        let data = parse(
            r#"<SpimData><SequenceDescription><ImageLoader format="bdv.hdf5"><hdf5 type="relative">a.h5</hdf5></ImageLoader>
            <ViewSetups><ViewSetup><id>0</id><name>left</name><voxelSize><unit>um</unit><size>2 2 3</size></voxelSize></ViewSetup></ViewSetups>
            </SequenceDescription><ViewRegistrations><ViewRegistration timepoint="0" setup="0">
            <ViewTransform><affine>1 0 0 10 0 1 0 0 0 0 1 0</affine></ViewTransform>
            <ViewTransform><affine>2 0 0 0 0 2 0 0 0 0 3 0</affine></ViewTransform>
            </ViewRegistration></ViewRegistrations></SpimData>"#,
        )
        .expect("XML");
        assert_eq!((data.format.as_str(), data.file.as_str()), ("bdv.hdf5", "a.h5"));
        let (grid, notice) = data.place(0, 0, [2.0, 2.0, 1.0]);
        assert_eq!(
            (grid.spacing, grid.origin, notice),
            ([4.0, 4.0, 3.0], [11.0, 1.0, 0.0], None)
        );
        assert_eq!(grid.unit, Some(LengthUnit::Micrometre));
        assert_eq!(data.choose(Some("left"), &[0, 1]), Ok(0));
        assert!(data.choose(None, &[0, 1]).is_err_and(|why| why.contains("0 (left), 1")));
    }

    #[test]
    fn what_is_no_xml_is_an_error() {
        assert!(parse("<a><b></a>").is_err());
        assert!(parse(&"<a>".repeat(100)).is_err());
        assert!(parse("<ViewRegistration timepoint='x' setup='0'/>").is_err());
    }
}
