//! Volumes of the benchmark, which are generated from formulas.

use std::fs::File;
use std::io::Write;
use std::ops::Range;
use std::path::Path;

use clap::ValueEnum;
use isopeel_kernels::{Engine, Error, Grid, SampleType, Samples, Shape, Synthetic, Volume};

use super::BenchError;

/// A volume by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum VolumeName {
    /// Eight plane waves and 1 % noise: 0.69 M triangles at 256³, four times as many at twice the size
    Sin,
    /// Eight other waves and noise: 13.9 M triangles at 1024³
    Waves,
    /// Marschner-Lobb, smooth: 0.98 M triangles at 256³
    Ml,
    /// Two gyroids, smooth
    Gyroid,
    /// One ball of radius 40 in any size
    Sphere,
    /// 1, 8, 27, … balls of radius 40, as many as fit: a growing surface in one size
    Spheres,
    /// 256×256×225 u8 with 0.7 M triangles, the size of the paper's head
    Head,
    /// 661×401×42 f32 with a second field, the size of the paper's hurricane
    Hurricane,
    /// 2048×56×239 f32 with a second field, the size of the paper's fluid
    Fluid,
}

/// Type of the samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum TypeName {
    /// Unsigned 8 bit
    U8,
    /// Signed 8 bit
    I8,
    /// Unsigned 16 bit
    U16,
    /// Signed 16 bit
    I16,
    /// 32-bit float
    F32,
}

impl From<TypeName> for SampleType {
    fn from(name: TypeName) -> Self {
        match name {
            TypeName::U8 => Self::U8,
            TypeName::I8 => Self::I8,
            TypeName::U16 => Self::U16,
            TypeName::I16 => Self::I16,
            TypeName::F32 => Self::F32,
        }
    }
}

/// Parameters of one generated volume.
#[derive(Clone, Debug)]
pub(super) struct Recipe {
    pub name: String,
    pub grid: Grid,
    pub sample_type: SampleType,
    pub field: Synthetic,
    /// The user feature: a second field on the same grid, and the range of values that is normalised to 0 to 1.
    pub feature: Option<(Synthetic, [f32; 2])>,
    pub iso: f32,
}

/// Samples along each axis for one ball of radius 40 and the space around it.
const BALL_PITCH: u32 = 96;

impl Recipe {
    fn new(name: &str, dims: [u32; 3], sample_type: SampleType, shape: Shape, period: f32) -> Self {
        Self {
            name: name.to_owned(),
            grid: Grid {
                dims,
                spacing: [1.0; 3],
            },
            sample_type,
            field: Synthetic {
                shape,
                period,
                closed: false,
            },
            feature: None,
            iso: shape.isovalue(sample_type),
        }
    }

    fn with_feature(mut self) -> Self {
        let period = self.field.period;
        self.feature = Some((
            Synthetic {
                shape: Shape::Gyroid,
                period,
                closed: false,
            },
            [0.0, 2.0],
        ));
        self
    }

    /// Returns a variant with at most `max_size` samples along each axis, and with closed surfaces.
    pub fn small_and_closed(&self, max_size: u32) -> Self {
        let mut small = self.clone();
        small.grid.dims = self.grid.dims.map(|n| n.min(max_size));
        small.field.period = self.field.period.min(max_size as f32);
        small.field.closed = true;
        small
    }

    pub fn generate(&self, engine: &Engine) -> Result<Volume, Error> {
        engine.generate(&self.grid, self.sample_type, &self.field)
    }

    /// Generates the feature, if the recipe has one.
    pub fn generate_feature(&self, engine: &Engine) -> Result<Option<Volume>, Error> {
        let feature = self.feature.as_ref();
        feature
            .map(|(synthetic, _)| engine.generate(&self.grid, SampleType::F32, synthetic))
            .transpose()
    }

    /// Reads all samples of the volume back from the device.
    pub fn download(&self, engine: &Engine, volume: &Volume) -> Result<Samples, Error> {
        let mut samples = engine.download(volume, 0..0)?;
        reserve(&mut samples, self.grid.sample_count() as usize);
        for planes in self.slabs() {
            append(&mut samples, engine.download(volume, planes)?);
        }
        Ok(samples)
    }

    /// Returns ranges of planes that are read back one after another, so that the buffers stay small.
    fn slabs(&self) -> impl Iterator<Item = Range<u32>> {
        const PLANES: u32 = 64;
        let nz = self.grid.dims[2];
        (0..nz)
            .step_by(PLANES as usize)
            .map(move |first| first..(first + PLANES).min(nz))
    }

    /// Writes the samples of the volume as `NAME-NX-TYPE.nrrd`.
    pub fn save(&self, engine: &Engine, volume: &Volume, folder: &Path) -> Result<(), BenchError> {
        let [nx, ny, nz] = self.grid.dims;
        let kind = self.sample_type.name();
        let path = folder.join(format!("{}-{nx}-{kind}.nrrd", self.name));
        let failed = |source| BenchError::Save {
            path: path.clone(),
            source,
        };
        std::fs::create_dir_all(folder).map_err(failed)?;
        let mut file = File::create(&path).map_err(failed)?;
        let stored = match self.sample_type {
            SampleType::U8 => "uint8",
            SampleType::I8 => "int8",
            SampleType::U16 => "uint16",
            SampleType::I16 => "int16",
            SampleType::F32 => "float",
        };
        let header = format!(
            "NRRD0004\ntype: {stored}\ndimension: 3\nsizes: {nx} {ny} {nz}\nspacings: 1 1 1\nendian: little\nencoding: raw\n\n"
        );
        file.write_all(header.as_bytes()).map_err(failed)?;
        for planes in self.slabs() {
            let samples = engine.download(volume, planes)?;
            file.write_all(samples.as_bytes()).map_err(failed)?;
        }
        Ok(())
    }

    /// Returns another isovalue, whose surface has about the same size.
    pub fn next_iso(&self) -> f32 {
        match self.sample_type {
            SampleType::F32 => self.iso + 0.01,
            _ => self.iso + 1.0,
        }
    }

    /// Returns name, size and type, for messages.
    pub fn title(&self) -> String {
        let [x, y, z] = self.grid.dims;
        format!("{} {x}x{y}x{z} {}", self.name, self.sample_type.name())
    }
}

fn reserve(samples: &mut Samples, count: usize) {
    match samples {
        Samples::U8(v) => v.reserve_exact(count),
        Samples::I8(v) => v.reserve_exact(count),
        Samples::U16(v) => v.reserve_exact(count),
        Samples::I16(v) => v.reserve_exact(count),
        Samples::F32(v) => v.reserve_exact(count),
    }
}

/// Appends samples of the same type.
fn append(samples: &mut Samples, more: Samples) {
    match (samples, more) {
        (Samples::U8(v), Samples::U8(more)) => v.extend(more),
        (Samples::I8(v), Samples::I8(more)) => v.extend(more),
        (Samples::U16(v), Samples::U16(more)) => v.extend(more),
        (Samples::I16(v), Samples::I16(more)) => v.extend(more),
        (Samples::F32(v), Samples::F32(more)) => v.extend(more),
        (v, more) => unreachable!("{:?} and {:?} of one volume", v.sample_type(), more.sample_type()),
    }
}

impl VolumeName {
    /// Returns the recipes of the volumes with this name, for each size and type.
    pub fn recipes(self, sizes: &[u32], types: &[TypeName]) -> Vec<Recipe> {
        match self {
            Self::Head => return vec![Recipe::new("head", [256, 256, 225], SampleType::U8, Shape::Sin, 220.0)],
            Self::Hurricane => {
                return vec![
                    Recipe::new("hurricane", [661, 401, 42], SampleType::F32, Shape::Sin, 256.0).with_feature(),
                ];
            }
            Self::Fluid => {
                return vec![Recipe::new("fluid", [2048, 56, 239], SampleType::F32, Shape::Sin, 626.0).with_feature()];
            }
            _ => {}
        }
        let mut recipes = Vec::new();
        for &size in sizes {
            for &sample_type in types {
                let make = |name: &str, shape| Recipe::new(name, [size; 3], sample_type.into(), shape, size as f32);
                recipes.extend(match self {
                    Self::Sin => vec![make("sin", Shape::Sin)],
                    Self::Waves => vec![make("waves", Shape::Waves)],
                    Self::Ml => vec![make("ml", Shape::MarschnerLobb)],
                    Self::Gyroid => vec![make("gyroid", Shape::Gyroid)],
                    Self::Spheres => {
                        let max_balls = (size / BALL_PITCH).max(1);
                        (1..=max_balls)
                            .map(|k| make(&format!("spheres-{}", k.pow(3)), Shape::Spheres(k)))
                            .collect()
                    }
                    _ => vec![make("sphere", Shape::Spheres(1))],
                });
            }
        }
        recipes
    }
}
