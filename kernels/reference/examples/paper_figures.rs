//! The steps of the paper's mesher as surfaces to look at (figures 3 to 6 of the paper): `paper_figures FOLDER [BETA]`.
//!
//! Every file in FOLDER holds triangles of ct-head at isovalue 517: the number of triangles (u32), then positions and normals
//! (nine f32 each a triangle, world units), then levels (u8); little-endian. The finished surface is the device's; what is
//! not yet refined or not yet patched never leaves a device, so those are the twins', over the same cut.

use isopeel_kernels::tables::{cases, cube};
use isopeel_kernels::{CutParams, Engine, Feature, Isovalue, Level, Never, REGION_CELLS, Surface, Vertex};
use isopeel_reference::{Cut, Field, FineEdge, Leaf, Mesh, Pipeline, construct, files, march, pack};
use std::io::Write;
use std::path::PathBuf;

const VOLUME: &str = "ct-head.nrrd";
const ISO: f32 = 517.0;

/// A triangle's corners with their normals, and its level.
type Triangle = ([[f32; 3]; 3], [[f32; 3]; 3], u8);

/// Corners of leaves' own cubes, joined by straight lines: nothing between them has been looked at.
fn coarse(pipeline: &Pipeline<'_>, cut: &Cut) -> Vec<Triangle> {
    let table = cases::case_triangles();
    let mut triangles = Vec::new();
    for (&leaf, node) in &cut.leaves {
        let entry = &table[usize::from(node.signs)];
        for corners in entry[1..1 + 3 * usize::from(entry[0])].chunks_exact(3) {
            let vertices = [0, 1, 2].map(|i| coarse_vertex(pipeline, leaf, usize::from(corners[i])));
            triangles.push((vertices.map(|v| v.0), vertices.map(|v| v.1), leaf.level));
        }
    }
    triangles
}

/// Point at which the linear interpolant between the two samples at the ends of a leaf's edge has the isovalue.
fn coarse_vertex(pipeline: &Pipeline<'_>, leaf: Leaf, edge: usize) -> ([f32; 3], [f32; 3]) {
    let field = pipeline.field;
    let samples = field.cube_samples(usize::from(leaf.level), leaf.cube);
    let ends = cube::edge_corners(edge).map(|corner| {
        let up = cube::corner_offset(corner);
        std::array::from_fn::<u32, 3, _>(|axis| samples[up[axis]][axis])
    });
    let values = ends.map(|p| field.at(p));
    let t = ((pipeline.iso - values[0]) / (values[1] - values[0])).clamp(0.0, 1.0);
    let mix = |a: f32, b: f32| a + (b - a) * t;
    let gradients = ends.map(|p| field.gradient(p));
    let position = |axis: usize| mix(ends[0][axis] as f32, ends[1][axis] as f32) * field.grid.spacing[axis];
    let normal = |axis: usize| -mix(gradients[0][axis], gradients[1][axis]);
    (std::array::from_fn(position), std::array::from_fn(normal))
}

/// A twin's mesh, patched or not.
fn refined(pipeline: &Pipeline<'_>, mesh: &Mesh) -> Vec<Triangle> {
    let spacing = pipeline.field.grid.spacing;
    let position = |edge: FineEdge| {
        let at = mesh.vertices[&edge].position;
        std::array::from_fn(|axis| at[axis] as f32 / Vertex::LATTICE as f32 * spacing[axis])
    };
    let normal = |edge: FineEdge| pack::normal(pipeline.field, edge, mesh.vertices[&edge].t);
    let triangles = mesh.triangles.iter();
    triangles
        .map(|t| (t.vertices.map(position), t.vertices.map(normal), t.leaf.level))
        .collect()
}

fn finished(surface: &Surface, spacing: [f32; 3]) -> Vec<Triangle> {
    let mut triangles = Vec::new();
    for region in &surface.regions {
        let levels = (0u8..).zip(region.level_triangles);
        let levels = levels.flat_map(|(level, count)| std::iter::repeat_n(level, count as usize));
        for (corners, level) in region.indices.chunks_exact(3).zip(levels) {
            let vertices = [0, 1, 2].map(|i| region.vertices[corners[i] as usize]);
            let position = |v: Vertex| {
                std::array::from_fn(|axis| {
                    let low = (region.coords[axis] * REGION_CELLS) as f32;
                    (low + v.position[axis] as f32 / Vertex::LATTICE as f32) * spacing[axis]
                })
            };
            triangles.push((vertices.map(position), vertices.map(|v| v.unit_normal()), level));
        }
    }
    triangles
}

fn write(folder: &std::path::Path, name: &str, triangles: &[Triangle]) -> std::io::Result<()> {
    let mut bytes = (triangles.len() as u32).to_le_bytes().to_vec();
    let floats = |bytes: &mut Vec<u8>, corners: [[f32; 3]; 3]| {
        bytes.extend(corners.iter().flatten().flat_map(|v| v.to_le_bytes()));
    };
    triangles.iter().for_each(|t| floats(&mut bytes, t.0));
    triangles.iter().for_each(|t| floats(&mut bytes, t.1));
    bytes.extend(triangles.iter().map(|t| t.2));
    std::fs::File::create(folder.join(name))?.write_all(&bytes)?;
    eprintln!("{name}: {} triangles", triangles.len());
    Ok(())
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let folder = PathBuf::from(arguments.next().ok_or("expected a folder to write to")?);
    let beta: f32 = arguments.next().map_or(Ok(0.02), |b| b.parse())?;
    let (grid, samples) = files::read_from_data_folder(VOLUME);
    let engine = Engine::open(std::env::var("ISOPEEL_DEVICE").ok().as_deref())?;
    std::fs::create_dir_all(&folder)?;

    let field = Field::from_samples(grid, &samples, None);
    let pipeline = Pipeline::new(&field, construct::Feature::None, ISO);
    let params = CutParams::paper(beta);
    let cut = pipeline.cut(&params, Level::FINEST);
    write(&folder, "coarse.bin", &coarse(&pipeline, &cut))?;
    write(
        &folder,
        "refined.bin",
        &refined(&pipeline, &march::march(&field, &pipeline.pyramid, ISO, &cut)),
    )?;

    let volume = engine.upload(grid, &samples, None)?;
    let pyramid = engine.build_pyramid(&volume, Feature::None, Isovalue::new(ISO)?, &Never)?;
    for (name, beta) in [("patched.bin", beta), ("full.bin", -1.0)] {
        let surface = engine.peel(&volume, &pyramid, &CutParams::paper(beta), Level::FINEST, &Never)?;
        write(&folder, name, &finished(&surface, grid.spacing))?;
    }
    Ok(())
}
