//! Writes the seeds: small valid files of every format, by the writer of the reader tests, and those of other programs.

#[path = "fuzz_targets/common.rs"]
#[allow(dead_code)]
mod common;
#[path = "../tests/volumes/write.rs"]
mod write;
#[path = "../tests/volumes/write_mrc.rs"]
mod write_mrc;
#[path = "../tests/volumes/write_vtk.rs"]
#[allow(dead_code)]
mod write_vtk;

use std::path::Path;

use write::{KINDS, Volume};

/// The fixtures of formats that libraries decode: target, and how their names end.
const FIXTURES: [(&str, &str); 8] = [
    ("dicom", ".dcm"),
    ("variables", ".h5"),
    ("variables", ".nc"),
    ("variables", ".nc4"),
    ("variables", ".ims"),
    ("variables", ".vtkhdf"),
    ("tiff", ".tif"),
    ("vti", ".vtr"),
];

fn main() -> std::io::Result<()> {
    for (i, kind) in KINDS.into_iter().enumerate() {
        let v = Volume::new([3, 2, 4], 1 + i as u32 % 3, kind, i % 2 == 0);
        let still = Volume::new([3, 2, 4], 1, kind, i % 2 == 0);
        let nifti = write::nifti(&v, |h| h.f32(112, 1.0 + (i % 2) as f32));
        let seeds = [
            ("nrrd", write::nrrd(&v, "raw")),
            ("nrrd", write::nrrd(&v, "gzip")),
            ("nrrd", write::nrrd(&v, "bzip2")),
            ("nrrd", write::nrrd(&v, "hex")),
            ("nrrd", write::nrrd(&v, "text")),
            (
                "nrrd",
                with((write::nrrd_header(&v, "raw") + "data file: data\n").into(), v.bytes()),
            ),
            ("metaimage", write::mha(&v, false)),
            ("metaimage", write::mha(&v, true)),
            (
                "metaimage",
                with(write::meta_header(&v, false, "data").into(), v.bytes()),
            ),
            ("nifti", write::gzip(&nifti)),
            ("nifti", nifti),
            ("nifti", write::nifti2(&v)),
            ("nifti", with(write::analyze(&still), still.bytes())),
            ("mgh", write::mgh(&Volume::new([3, 2, 4], 1, ('i', 2), true))),
            ("npy", write::npy(&v, false)),
            ("npy", write::npy(&v, true)),
            ("npz", write::npz(&v, false)),
            ("npz", write::npz(&v, true)),
            ("raw", with(write::sidecar(&v, "data", "raw"), v.bytes())),
            ("raw", with(write::sidecar(&v, "data", "gzip"), write::zlib(&v.bytes()))),
            // Two time steps, then two parts of one.
            ("pvd", of_times(1, write_vtk::vti(&still, "raw"))),
            ("pvd", of_times(0, write_vtk::vti(&still, "zlib"))),
            ("pvti", of_pieces(write_vtk::pvti_files(&still))),
            ("pvti", of_pieces(write_vtk::pvtr_files(&still))),
            ("vti", write_vtk::vti(&still, "raw")),
            ("vti", write_vtk::vti(&still, "zlib")),
            ("vti", write_vtk::vti(&still, "base64")),
            ("vti", write_vtk::vti(&still, "text")),
            ("vtk", write_vtk::vtk(&still, false)),
            ("vtk", write_vtk::vtk(&still, true)),
        ];
        let map = write_mrc::has_mode(&v).then(|| ("mrc", write_mrc::mrc(&v, |_| {})));
        for (n, (target, bytes)) in seeds.into_iter().chain(map).enumerate() {
            let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(target);
            std::fs::create_dir_all(&folder)?;
            std::fs::write(folder.join(format!("seed-{i}-{n}")), bytes)?;
        }
    }
    copy_fixtures("")?;
    copy_fixtures("dicom")?;
    // Arrays of one chunk.
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = here.join("corpus/zarr");
    std::fs::create_dir_all(&folder)?;
    for name in ["v3-zstd", "v3-gzip", "v3-blosc", "v3-transpose", "v3-shards"] {
        let array = here.join(format!("../../tests/fixtures/volumes/{name}.zarr"));
        let read = |file: &str| std::fs::read(array.join(file));
        std::fs::write(folder.join(name), with(read("zarr.json")?, read("c/0/0/0")?))?;
    }
    let folder = here.join("corpus/n5");
    std::fs::create_dir_all(&folder)?;
    for name in ["raw/plain", "raw/zipped", "bloscs"] {
        let dataset = here.join("../../tests/fixtures/volumes/convention.n5").join(name);
        let read = |file: &str| std::fs::read(dataset.join(file));
        std::fs::write(
            folder.join(name.replace('/', "-")),
            with(read("attributes.json")?, read("0/0/0")?),
        )?;
    }
    let folder = here.join("corpus/spim_data");
    std::fs::create_dir_all(&folder)?;
    let read = |ending: &str| {
        std::fs::read(
            here.join("../../tests/fixtures/volumes/convention_bdv")
                .with_extension(ending),
        )
    };
    let xml = String::from_utf8_lossy(&read("xml")?).replace("convention_bdv.h5", "data");
    std::fs::write(folder.join("views"), with(xml.into_bytes(), read("h5")?))?;
    // Volumes of one chunk.
    let folder = here.join("corpus/precomputed");
    std::fs::create_dir_all(&folder)?;
    let info = |kind: &str, rest: &str| {
        format!(
            r#"{{"type":"image","data_type":"{kind}","num_channels":1,"scales":[{{"key":"s","size":[2,3,4],"resolution":[8,8,30],
            "chunk_sizes":[[2,3,4]],{rest}}}]}}"#
        )
    };
    let raw = Volume::new([2, 3, 4], 1, ('u', 2), false).bytes();
    // One block of one label.
    let labels = [1u32, 2, 2, 7].into_iter().flat_map(u32::to_le_bytes).collect();
    let blocks = r#""encoding":"compressed_segmentation","compressed_segmentation_block_size":[8,8,8]"#;
    let sharding = r#""encoding":"raw","sharding":{"@type":"neuroglancer_uint64_sharded_v1","preshift_bits":0,"hash":"identity",
        "minishard_bits":0,"shard_bits":0}"#;
    // The shard's index, the chunk, then the minishard's index: number, offset and size of the chunk.
    let words = |words: &[u64]| words.iter().flat_map(|word| word.to_le_bytes()).collect::<Vec<u8>>();
    let shard = [words(&[48, 72]), raw.clone(), words(&[0, 0, 48])].concat();
    let seeds = [
        ("raw", with(info("uint16", r#""encoding":"raw""#).into(), raw.clone())),
        (
            "gzip",
            with(info("uint16", r#""encoding":"raw""#).into(), write::gzip(&raw)),
        ),
        ("labels", with(info("uint32", blocks).into(), labels)),
        ("shard", with(info("uint16", sharding).into(), shard)),
    ];
    for (name, bytes) in seeds {
        std::fs::write(folder.join(name), bytes)?;
    }
    Ok(())
}

/// A header and the file `data` that it names.
fn with(header: Vec<u8>, data: Vec<u8>) -> Vec<u8> {
    [header.as_slice(), common::SEPARATOR, data.as_slice()].concat()
}

/// A collection that lists an image twice, for the time 0 and for `second`: as two time steps, or as two parts of one.
fn of_times(second: u32, image: Vec<u8>) -> Vec<u8> {
    let listed = write_vtk::pvd(&["data.vti", "data.vti"]);
    let listed = listed.replace("timestep=\"1\"", &format!("timestep=\"{second}\""));
    with(listed.into(), image)
}

/// A grid and the file of its one piece.
fn of_pieces(files: Vec<(&str, Vec<u8>)>) -> Vec<u8> {
    let [(_, whole), (name, piece)] = <[_; 2]>::try_from(files).expect("a grid of one piece");
    let whole = String::from_utf8(whole).expect("markup").replace(name, "data");
    with(whole.into(), piece)
}

/// Those of a folder in the fixtures' folder.
fn copy_fixtures(below: &str) -> std::io::Result<()> {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    for entry in std::fs::read_dir(here.join("../../tests/fixtures/volumes").join(below))? {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if let Some((target, _)) = FIXTURES.iter().find(|(_, ending)| name.ends_with(ending)) {
            let folder = here.join("corpus").join(target);
            std::fs::create_dir_all(&folder)?;
            std::fs::copy(&path, folder.join(&name))?;
        }
    }
    Ok(())
}
