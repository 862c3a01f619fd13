//! Detects the format of a file by its first bytes. If they fit several formats or none, the ending of the name decides.

use super::{EXPECTED, FORMATS, Format};
use crate::codec::Encoding;
use crate::{FileLocation, ReadError};

/// Bytes at the beginning of a file that are examined. HDF5 may begin behind a user block.
const HEAD_BYTES: usize = 8192;

/// First bytes of files that are no volumes, with advice for each.
const OTHERS: &[(&[u8], &str)] = &[
    (
        b"version https://git-lfs.github.com/spec/",
        "a Git LFS pointer, the file itself was not fetched: `git lfs pull` fetches it",
    ),
    (
        b"/annex/objects/",
        "a git-annex pointer, the file itself was not fetched: `git annex get` fetches it",
    ),
    (
        b"GRIB",
        "a GRIB file, which is not read: convert it to NetCDF, with `cdo -f nc4 copy IN.grib OUT.nc` or `grib_to_netcdf -o OUT.nc IN.grib`",
    ),
    (
        b"MATLAB 5.0 MAT-file",
        "a MATLAB file of version 7 or before, which is not read: save it with `save(NAME, '-v7.3')`, which writes HDF5",
    ),
    (
        b"\x0e\x03\x13\x01",
        "an HDF4 file, which is not read: convert it to HDF5 with `h4toh5`, or to NetCDF",
    ),
    (
        b"SIMPLE  =",
        "a FITS file, which is not read: convert it, for example with Python, `numpy.save('OUT.npy', astropy.io.fits.getdata('IN.fits'))`",
    ),
    (
        b" BDV",
        "an OpenVDB file, which is not read: copy its grid to an array with pyopenvdb (`copyToArray`), and save that as .npy",
    ),
    (b"\x89PNG\r\n", "a PNG image, which is not read: save slices as TIFF"),
    (b"\xff\xd8\xff", "a JPEG image, which is not read: save slices as TIFF"),
    (b"%PDF", "a PDF document, expected a volume"),
    (b"ply\n", "a surface (PLY), expected a volume"),
    (b"ply\r\n", "a surface (PLY), expected a volume"),
    (b"Rar!", "an archive (RAR), expected a volume: unpack it first"),
    (
        b"7z\xbc\xaf\x27\x1c",
        "an archive (7z), expected a volume: unpack it first",
    ),
];

/// Returns why a file that begins with these bytes is no volume, if it is a known other kind of file.
fn is_other(head: &[u8]) -> Option<&'static str> {
    if head.is_empty() {
        return Some("is empty, expected a volume");
    }
    // From version 7.3 on, MATLAB writes the same words before HDF5.
    let known = OTHERS
        .iter()
        .find(|(magic, _)| head.starts_with(magic) && !is_hdf5(head));
    if let Some((_, what)) = known {
        return Some(what);
    }
    if head.get(257..262) == Some(b"ustar") {
        return Some("an archive (tar), expected a volume: unpack it first");
    }
    let text = String::from_utf8_lossy(&head[..head.len().min(512)])
        .trim_start()
        .to_ascii_lowercase();
    if ["<!doctype html", "<html", "<head"]
        .iter()
        .any(|tag| text.starts_with(tag))
    {
        return Some(
            "a web page (HTML), as servers send in place of a file, with an error or a sign-in: download the file again, and look at its \
             first lines",
        );
    }
    if text.starts_with("<?xml") && text.contains("<error>") {
        return Some("an error message of a server (XML) in place of the file: download it again");
    }
    None
}

/// Whether HDF5 begins here, or behind a user block.
pub(super) fn is_hdf5(head: &[u8]) -> bool {
    const MAGIC: &[u8] = b"\x89HDF\r\n\x1a\n";
    [0, 512, 1024, 2048, 4096]
        .iter()
        .any(|&at| head.get(at..).is_some_and(|rest| rest.starts_with(MAGIC)))
}

/// Whether it is NetCDF of version 1, 2 or 5, or HDF5.
pub(super) fn is_variables(head: &[u8]) -> bool {
    is_hdf5(head) || matches!(head, [b'C', b'D', b'F', 1 | 2 | 5, ..])
}

/// Whether it is a header of NIfTI, or one of Analyze 7.5, which has the same size.
pub(super) fn is_nifti(head: &[u8]) -> bool {
    let size: Option<[u8; 4]> = head.first_chunk().copied();
    let is_size = |size: [u8; 4]| {
        [348, 540]
            .iter()
            .any(|&n: &i32| n.to_le_bytes() == size || n.to_be_bytes() == size)
    };
    size.is_some_and(is_size) && head.len() >= 348
}

pub(super) fn is_tiff(head: &[u8]) -> bool {
    [&b"II*\0"[..], b"MM\0*", b"II+\0", b"MM\0+"]
        .iter()
        .any(|magic| head.starts_with(magic))
}

pub(super) fn is_metaimage(head: &[u8]) -> bool {
    let text = String::from_utf8_lossy(&head[..head.len().min(2048)]);
    let mut lines = text
        .lines()
        .map(str::trim)
        .filter(|line| !line.is_empty() && !line.starts_with('#'));
    let first = lines.next().and_then(|line| line.split_once('='));
    first.is_some_and(|(name, _)| matches!(name.trim(), "ObjectType" | "NDims" | "Comment")) && text.contains("NDims")
}

/// Whether it is a file of VTK's XML formats of one of these types.
pub(super) fn is_vtk(head: &[u8], types: &[&str]) -> bool {
    let text = String::from_utf8_lossy(&head[..head.len().min(4096)]);
    let element = text.find("<VTKFile").map(|at| &text[at..]);
    let attribute = element
        .and_then(|element| element.split_once("type="))
        .map(|(_, rest)| rest);
    let quoted = attribute.and_then(|rest| {
        let quote = rest.chars().next()?;
        rest[quote.len_utf8()..].split_once(quote)
    });
    quoted.is_some_and(|(name, _)| types.contains(&name))
}

/// Returns the compression of a file that begins with these bytes.
fn packing(head: &[u8]) -> Option<Encoding> {
    match head {
        [0x1f, 0x8b, ..] => Some(Encoding::Deflate),
        [b'B', b'Z', b'h', b'1'..=b'9', ..] => Some(Encoding::Bzip2),
        [0x28, 0xb5, 0x2f, 0xfd, ..] => Some(Encoding::Zstd),
        _ => None,
    }
}

/// Returns the format of a file and its location, which is marked as compressed or not according to its first bytes.
///
/// # Errors
/// It cannot be read, is of no format, or is known to be something else.
pub fn format_of(location: &FileLocation) -> Result<(&'static Format, FileLocation), ReadError> {
    let named = Format::of(location.path());
    let stored = location.open_stored()?.head(HEAD_BYTES)?;
    let refuse = |why: &str| Err(ReadError::new(location.path(), "file", why));
    if let Some(why) = is_other(&stored) {
        return refuse(why);
    }
    let packing = packing(&stored);
    let location = match packing {
        Some(packing) => location.clone().packed(packing),
        None => location.unpacked(),
    };
    let head = match packing {
        None => stored,
        // The reader reports what is wrong with the compressed file.
        Some(_) => location.open()?.head(HEAD_BYTES).unwrap_or_default(),
    };
    if packing.is_some()
        && !head.is_empty()
        && let Some(why) = is_other(&head)
    {
        return refuse(why);
    }
    let fits = |format: &&Format| (format.is_content)(&head);
    let format = named.filter(fits).or_else(|| FORMATS.iter().find(fits)).or(named);
    match format {
        Some(format) => Ok((format, location)),
        None => refuse(&format!("unknown format, {EXPECTED}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(name: &str, bytes: &[u8]) -> Result<(&'static str, bool), String> {
        let location = FileLocation::bytes(name.to_owned(), bytes.to_vec());
        let found = format_of(&location).map_err(|error| error.why)?;
        Ok((found.0.endings[0], found.1.packing().is_some()))
    }

    fn gzip(bytes: &[u8]) -> Vec<u8> {
        use std::io::Write;
        let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        packed.write_all(bytes).unwrap();
        packed.finish().unwrap()
    }

    #[test]
    fn the_first_bytes_decide() {
        let mut map = vec![0; 1024];
        map[208..212].copy_from_slice(b"MAP ");
        let mut mat = b"MATLAB 7.3 MAT-file".to_vec();
        mat.resize(512, 0);
        mat.extend(b"\x89HDF\r\n\x1a\n");
        for (name, bytes, ending) in [
            ("volume.rec", map.as_slice(), ".mrc"),
            ("volume.bin", &map, ".mrc"),
            ("a.mat", &mat, ".h5"),
            ("a.dat", b"CDF\x02", ".h5"),
            ("a", b"NRRD0004\n", ".nrrd"),
            ("a.nrrd", b"\x93NUMPY\x01\0", ".npy"),
            ("a.txt", b"# comment\nNDims = 3\n", ".mha"),
            (
                "a.xml",
                b"<?xml version=\"1.0\"?>\n<VTKFile type=\"ImageData\" >",
                ".vti",
            ),
            ("a.xml", b"<VTKFile version='1' type='PImageData'>", ".pvti"),
            ("a.vti", b"<VTKFile type=\"Collection\">", ".pvd"),
            ("a.data", b"MM\0*\0\0\0\x08", ".tif"),
        ] {
            assert_eq!(of(name, bytes), Ok((ending, false)), "{name}");
            assert_eq!(of(name, &gzip(bytes)), Ok((ending, true)), "{name}, compressed");
        }
        assert_eq!(
            of("a.nrrd.gz", b"NRRD0004\n"),
            Ok((".nrrd", false)),
            "not compressed, whatever its name says"
        );
        assert_eq!(
            of("a.nrrd", b"something"),
            Ok((".nrrd", false)),
            "the ending decides where the bytes do not"
        );
        assert!(of("a.xyz", b"something").unwrap_err().starts_with("unknown format"));
    }

    #[test]
    fn what_is_no_volume_is_named() {
        for (name, bytes, words) in [
            (
                "a.nii.gz",
                &b"version https://git-lfs.github.com/spec/v1\noid sha256:abc\n"[..],
                "git lfs pull",
            ),
            ("a.nii.gz", b"\n<!DOCTYPE html><html>", "web page"),
            ("a.nrrd", b"", "is empty"),
            ("a.nc", b"GRIB\0\0\0\x02", "cdo -f nc4 copy"),
            ("a.mat", b"MATLAB 5.0 MAT-file, Platform", "-v7.3"),
            ("a.h5", b"\x0e\x03\x13\x01", "h4toh5"),
            (
                "a.mha",
                b"<?xml version=\"1.0\"?><Error><Code>AccessDenied",
                "error message",
            ),
        ] {
            let error = of(name, bytes).unwrap_err();
            assert!(error.contains(words), "{error}");
        }
    }
}
