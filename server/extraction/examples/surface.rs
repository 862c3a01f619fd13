//! Extracts a quarter of the triangles of an isosurface, and writes them as a PLY file: `surface VOLUME ISOVALUE FILE.ply`.

use std::path::Path;
use std::sync::Arc;

use isopeel_extraction::dataset_views::opening_view;
use isopeel_extraction::{Making, Options, Workspace};
use isopeel_kernels::{Engine, Never};
use isopeel_view::Edit;
use isopeel_volumes::{VolumeStep, open_dataset};

fn main() -> Result<(), Box<dyn std::error::Error>> {
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
    let extraction = workspace.surface(&volume, &view, Making::default(), &Never)?;
    let mesh = extraction.mesh(&volume)?;
    let (vertices, triangles) = (mesh.positions.len(), mesh.triangles.len());
    let mut ply = format!(
        "ply\nformat ascii 1.0\nelement vertex {vertices}\nproperty double x\nproperty double y\nproperty double z\n\
         element face {triangles}\nproperty list uchar int vertex_indices\nend_header\n"
    );
    ply.extend(mesh.positions.iter().map(|[x, y, z]| format!("{x} {y} {z}\n")));
    ply.extend(mesh.triangles.iter().map(|[a, b, c]| format!("3 {a} {b} {c}\n")));
    std::fs::write(file, ply)?;
    println!("{triangles} triangles, {:?}", extraction.statistics(&volume, "").error);
    Ok(())
}
