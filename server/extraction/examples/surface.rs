//! Extracts a quarter of the triangles of an isosurface, and writes them as a PLY file: `surface VOLUME ISOVALUE FILE.ply`.

use std::error::Error;
use std::io::{BufWriter, Write};
use std::path::Path;
use std::sync::Arc;

use isopeel_extraction::dataset_views::opening_view;
use isopeel_extraction::{Options, Workspace};
use isopeel_kernels::{Engine, Never};
use isopeel_view::Edit;
use isopeel_volumes::{VolumeStep, open_dataset};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [path, isovalue, file] = arguments.as_slice() else {
        return Err("expected VOLUME ISOVALUE FILE.ply".into());
    };
    let volume = VolumeStep::new(Arc::new(open_dataset(Path::new(path))?), 0)?;
    let edit = Edit {
        iso: Some(isovalue.parse()?),
        triangles: Some("25%".parse()?),
        ..Edit::default()
    };
    let view = opening_view(volume.dataset())?.apply(&edit, &volume.dataset().field_names())?;
    let mut workspace = Workspace::new(Engine::open(None)?, Options::default());
    let extraction = workspace.surface(&volume, &view, u64::MAX, true, &Never)?;
    let mesh = extraction.mesh(&volume)?;
    let (vertices, triangles) = (mesh.positions.len(), mesh.triangles.len());
    let mut ply = BufWriter::new(std::fs::File::create(file)?);
    writeln!(ply, "ply\nformat ascii 1.0\nelement vertex {vertices}")?;
    writeln!(ply, "property double x\nproperty double y\nproperty double z")?;
    writeln!(
        ply,
        "element face {triangles}\nproperty list uchar int vertex_indices\nend_header"
    )?;
    mesh.positions
        .iter()
        .try_for_each(|[x, y, z]| writeln!(ply, "{x} {y} {z}"))?;
    mesh.triangles
        .iter()
        .try_for_each(|[a, b, c]| writeln!(ply, "3 {a} {b} {c}"))?;
    println!("{triangles} triangles, {:?}", extraction.statistics(&volume, "").error);
    Ok(ply.flush()?)
}
