//! openPMD in HDF5 (<https://github.com/openPMD/openPMD-standard>): meshes of three axes, whose components are fields and whose iterations
//! are time steps.
//!
//! A mesh states the distance of samples (`gridSpacing`, `gridUnitSI`), the position of the first one (`gridGlobalOffset`) and the names of
//! its axes (`axisLabels`, in the order of `dataOrder`). A component states its position in the cell (`position`) and its factor to SI
//! units (`unitSI`).
//! The largest mesh is opened, with all others on its grid; `file.h5:E` names one.

use super::{Array, MAX_STEPS, World, numbered, of_index, seconds, volume};
use crate::formats::header::{self, Channels, GridFields};
use crate::formats::named_axes::{self, AxisFacts};
use crate::formats::variables::file::{Attribute, Attributes, Variable, VariableFile};
use crate::numbered::join_steps;
use crate::{FileLocation, LengthUnit, OpenedFile, ReadError};

const FIELDS: GridFields = GridFields {
    dims: "shape",
    spacing: "gridSpacing",
    origin: "gridGlobalOffset",
    direction: "axisLabels",
};

/// A mesh of an iteration: its name, its attributes, and its components with their names.
struct Mesh {
    name: String,
    attributes: Attributes,
    components: Vec<(String, Variable)>,
}

pub(super) fn open(location: &FileLocation, file: &dyn VariableFile) -> Result<OpenedFile, ReadError> {
    let fail = |field: &str, why: String| ReadError::new(location.path(), field, why);
    let root = file.attributes_of("/");
    let iterations = numbered(file.members("/data")[0].clone(), "");
    if iterations.is_empty() || iterations.len() > MAX_STEPS {
        return Err(fail(
            "data",
            format!("{} iterations, expected 1 to {MAX_STEPS}", iterations.len()),
        ));
    }
    let meshes_path = root
        .text("meshesPath")
        .unwrap_or("meshes/")
        .trim_matches('/')
        .to_owned();
    let (mut files, mut times) = (Vec::new(), Vec::new());
    let mut chosen: Vec<String> = Vec::new();
    for (_, iteration) in &iterations {
        let group = format!("/data/{iteration}");
        let meshes = meshes(file, &format!("{group}/{meshes_path}"));
        if files.is_empty() {
            chosen = choose(location, &meshes)?;
        }
        let wanted: Vec<Mesh> = meshes.into_iter().filter(|mesh| chosen.contains(&mesh.name)).collect();
        files.push((location.clone(), open_meshes(location, wanted)?));
        let attributes = file.attributes_of(&group);
        let number = |name: &str| attributes.numbers(name).first().copied();
        times.push(number("time").map(|time| time * number("timeUnitSI").unwrap_or(1.0)));
    }
    join_steps(files, seconds(times.into_iter().collect()))
}

/// Reads the meshes of an iteration, sorted by name.
fn meshes(file: &dyn VariableFile, group: &str) -> Vec<Mesh> {
    let [records, scalars] = file.members(group);
    let read = |path: String| {
        let mut variable = file.variable(&path).ok()?;
        variable.attributes = file.attributes_of(&path);
        Some(variable)
    };
    let mut meshes = Vec::new();
    for name in scalars {
        let path = format!("{group}/{name}");
        let attributes = file.attributes_of(&path);
        let components = read(path)
            .map(|variable| (name.clone(), variable))
            .into_iter()
            .collect();
        meshes.push(Mesh {
            name,
            attributes,
            components,
        });
    }
    for name in records {
        let path = format!("{group}/{name}");
        let [_, components] = file.members(&path);
        let component = |own: String| Some((format!("{name} {own}"), read(format!("{path}/{own}"))?));
        let components = components.into_iter().filter_map(component).collect();
        let attributes = file.attributes_of(&path);
        meshes.push(Mesh {
            name,
            attributes,
            components,
        });
    }
    meshes.sort_by(|a, b| a.name.cmp(&b.name));
    meshes
}

impl Mesh {
    fn shape(&self) -> Vec<u64> {
        self.components
            .first()
            .map(|(_, variable)| variable.sizes())
            .unwrap_or_default()
    }

    /// Returns why the mesh is no volume, if it is none.
    fn refusal(&self) -> Option<String> {
        let geometry = self.attributes.text("geometry").unwrap_or("cartesian");
        if geometry != "cartesian" {
            return Some(format!("geometry {geometry:?}, expected cartesian"));
        }
        let shape = self.shape();
        if shape.iter().filter(|&&size| size > 1).count() != 3 {
            return Some(format!("{shape:?} samples, expected 3 axes"));
        }
        self.components
            .iter()
            .find_map(|(_, variable)| variable.stored.clone().err())
    }

    /// Returns the numbers of an attribute with one number for each axis, in the order in which the axes are stored.
    fn listed(&self, name: &str) -> Vec<f64> {
        let mut numbers = self.attributes.numbers(name);
        if self.is_fastest_first() {
            numbers.reverse();
        }
        numbers
    }

    /// Whether attributes list the axis first that is stored fastest.
    fn is_fastest_first(&self) -> bool {
        self.attributes.text("dataOrder") == Some("F")
    }

    fn roles(&self) -> Result<named_axes::AxisRoles, String> {
        let mut labels = self.attributes.texts("axisLabels").to_vec();
        if self.is_fastest_first() {
            labels.reverse();
        }
        let facts = self
            .shape()
            .into_iter()
            .enumerate()
            .map(|(axis, size)| (size, labels.get(axis).map(String::as_str)));
        let facts: Vec<AxisFacts<'_>> = facts
            .map(|(size, name)| AxisFacts {
                size,
                name,
                ..AxisFacts::default()
            })
            .collect();
        named_axes::assign(&facts)
    }

    /// Returns the grid of a component's samples, and a notice of its unknown properties.
    fn world(&self, space: [usize; 3], component: &Variable) -> (World, Option<String>) {
        let (spacing, offset) = (self.listed("gridSpacing"), self.listed("gridGlobalOffset"));
        let mut position = component.attributes.numbers("position");
        if self.is_fastest_first() {
            position.reverse();
        }
        let units = self.listed("gridUnitSI");
        let unit = |axis: usize| units.get(axis).or(units.first()).copied().unwrap_or(1.0);
        let mut world = of_index();
        let Some((known, notice)) =
            super::super::place::known_spacing(space.map(|axis| spacing.get(axis).map(|step| step * unit(axis))))
        else {
            return (
                world,
                Some(format!(
                    "{} has no gridSpacing: samples are 1 apart along each axis",
                    self.name
                )),
            );
        };
        for (role, axis) in space.into_iter().enumerate() {
            world.spacing[role] = known[role].abs();
            world.direction[role][role] = if known[role] < 0.0 { -1.0 } else { 1.0 };
            let first = offset.get(axis).copied().unwrap_or(0.0) * unit(axis);
            world.origin[role] = first + known[role] * position.get(axis).copied().unwrap_or(0.0);
        }
        (world, notice)
    }
}

/// Returns the names of the meshes that are opened, the largest one first.
fn choose(location: &FileLocation, meshes: &[Mesh]) -> Result<Vec<String>, ReadError> {
    let fail = |why: String| ReadError::new(location.path(), "meshes", why);
    let shown = |mesh: &Mesh| match mesh.refusal() {
        Some(why) => format!("{} ({why})", mesh.name),
        None => format!("{} ({:?})", mesh.name, mesh.shape()),
    };
    let list = || meshes.iter().map(shown).collect::<Vec<_>>().join(", ");
    if let Some(part) = location.part() {
        let part = part.trim_matches('/');
        return match meshes.iter().find(|mesh| mesh.name == part) {
            Some(mesh) => mesh
                .refusal()
                .map_or(Ok(vec![mesh.name.clone()]), |why| Err(fail(format!("{part}: {why}")))),
            None => Err(fail(format!("none is named {part:?}, expected one of {}", list()))),
        };
    }
    let volumes: Vec<&Mesh> = meshes.iter().filter(|mesh| mesh.refusal().is_none()).collect();
    let Some(largest) = volumes
        .iter()
        .rev()
        .max_by_key(|mesh| mesh.shape().iter().fold(1u64, |n, &m| n.saturating_mul(m)))
    else {
        return Err(fail(format!(
            "no mesh is a volume, expected one of 3 axes; found {}",
            list()
        )));
    };
    let same = |mesh: &&&Mesh| {
        let lists = ["gridSpacing", "gridGlobalOffset", "gridUnitSI"];
        mesh.shape() == largest.shape()
            && mesh.roles().ok() == largest.roles().ok()
            && lists.iter().all(|name| mesh.listed(name) == largest.listed(name))
    };
    let mut chosen: Vec<String> = volumes.iter().filter(same).map(|mesh| mesh.name.clone()).collect();
    chosen.sort_by_key(|name| *name != largest.name);
    Ok(chosen)
}

/// Makes a volume of the meshes of an iteration.
fn open_meshes(location: &FileLocation, meshes: Vec<Mesh>) -> Result<OpenedFile, ReadError> {
    let mut notices = Vec::new();
    let mut arrays = Vec::new();
    let mut worlds: Vec<(String, World)> = Vec::new();
    for mesh in meshes {
        let roles = mesh
            .roles()
            .map_err(|why| ReadError::new(location.path(), &mesh.name, why))?;
        notices.extend(roles.notices.iter().map(|notice| format!("{}: {notice}", mesh.name)));
        let unit = unit_of(&mesh.attributes.numbers("unitDimension"));
        for (name, mut variable) in mesh.components.iter().cloned() {
            let (world, notice) = mesh.world(roles.space, &variable);
            notices.extend(notice);
            worlds.push((name.clone(), world));
            if let Some(&factor) = variable.attributes.numbers("unitSI").first() {
                variable
                    .attributes
                    .set("scale_factor", Attribute::Numbers(vec![factor], None));
            }
            if let Some(unit) = &unit {
                variable.attributes.set("units", Attribute::Text(unit.clone()));
            }
            let array = Array::new(location, variable, &roles)?;
            arrays.push(Array {
                channels: Channels::Fields(vec![name]),
                ..array
            });
        }
    }
    let Some((first, world)) = worlds.first().cloned() else {
        return Err(ReadError::new(
            location.path(),
            "meshes",
            "missing in an iteration, expected those of the first",
        ));
    };
    let others: Vec<&str> = worlds
        .iter()
        .filter(|(_, other)| *other != world)
        .map(|(name, _)| name.as_str())
        .collect();
    if !others.is_empty() {
        notices.push(format!(
            "{} lie elsewhere in the cells than {first}: all were put where {first} is",
            others.join(", ")
        ));
    }
    let mut opened = volume(location, &arrays, &world, &FIELDS)?;
    opened.geometry.unit = Some(LengthUnit::Metre);
    Ok(header::with_notices(opened, notices))
}

/// Returns the unit of SI with these powers of length, mass, time, current, temperature, amount and luminous intensity.
fn unit_of(powers: &[f64]) -> Option<String> {
    let symbols = ["m", "kg", "s", "A", "K", "mol", "cd"];
    let factors = symbols.iter().zip(powers).filter(|(_, power)| **power != 0.0);
    let factors: Vec<String> = factors
        .map(|(symbol, power)| {
            if *power == 1.0 {
                (*symbol).to_owned()
            } else {
                format!("{symbol}^{power}")
            }
        })
        .collect();
    (powers.len() == symbols.len() && !factors.is_empty()).then(|| factors.join(" "))
}
