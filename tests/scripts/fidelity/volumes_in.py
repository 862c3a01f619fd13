"""What is measured on: volumes with an isovalue. The outermost samples are set to the least, so every surface is closed."""
import gzip
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from volumes import VOLUMES, read_nrrd, write_nrrd

BRAIN = "brain"


@dataclass(frozen=True)
class Input:
    name: str
    title: str
    path: Path
    iso: float
    folder: Path  # of the meshes

    def read(self):
        """Samples and spacing."""
        return read_nrrd(self.path)


def closed(volume):
    result = np.full_like(volume, volume.min())
    result[1:-1, 1:-1, 1:-1] = volume[1:-1, 1:-1, 1:-1]
    return result


def read_nifti(path):
    """Samples of a NIfTI-1 file of bytes; where it lies in the world is left out."""
    data = gzip.decompress(path.read_bytes())
    nx, ny, nz = np.frombuffer(data, "<i2", 3, 42)
    if np.frombuffer(data, "<i2", 1, 70)[0] != 2:
        raise SystemExit(f"{path}: samples of 8 bits expected")
    start = int(np.frombuffer(data, "<f4", 1, 108)[0])
    return np.frombuffer(data, "u1", int(nx) * ny * nz, start).reshape(nz, ny, nx)


def open_input(name, size, data, work):
    """`sin`, `ml`: made, of `size` samples along each axis; `STEM ISO`: STEM.nrrd in `data`."""
    stem, _, value = name.partition(" ")
    folder = work / name.replace(" ", "")
    folder.mkdir(parents=True, exist_ok=True)
    made = stem in VOLUMES
    iso = float(value) if value else 0.5
    path = work / f"{stem}-{size}.nrrd" if made else work / f"{stem}.nrrd"
    if not path.exists():
        volume, spacing = (VOLUMES[stem](size), (1, 1, 1)) if made else read_nrrd(data / f"{stem}.nrrd")
        write_nrrd(path, closed(volume), spacing)
    title = f"`{stem}`, {size}³, isovalue {iso:g}" if made else f"`{stem}` at {iso:g}"
    return Input(name, title, path, iso, folder)


def open_brain(data, work):
    """The demo volume's T1 image at the isovalue it opens with; grey matter beside it, as another field of its folder."""
    fields = work / BRAIN
    meshes = work / f"{BRAIN}-meshes"
    for folder in (fields, meshes):
        folder.mkdir(parents=True, exist_ok=True)
    if not (fields / "gm.nrrd").exists():
        write_nrrd(fields / "t1.nrrd", closed(read_nifti(data / "mni152-t1.nii.gz")))
        write_nrrd(fields / "gm.nrrd", read_nifti(data / "mni152-gm.nii.gz"))
    return Input(BRAIN, "`mni152`, T1 at 140", fields / "t1.nrrd", 140.0, meshes)
