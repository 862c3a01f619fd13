"""What is measured on: volumes with an isovalue. The outermost samples are set to the minimum, so every surface is closed."""
import gzip
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from volumes import VOLUMES, read_nrrd, write_nrrd


DEMO = Path(__file__).resolve().parents[3] / "server/demo"


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
    nx, ny, nz = map(int, np.frombuffer(data, "<i2", 3, 42))
    if np.frombuffer(data, "<i2", 1, 70)[0] != 2:
        raise SystemExit(f"{path}: samples of 8 bits expected")
    start = int(np.frombuffer(data, "<f4", 1, 108)[0])
    return np.frombuffer(data, "u1", nx * ny * nz, start).reshape(nz, ny, nx)


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


def ball_in(shape):
    """255 in a ball around a part of the frontal lobes, else 0."""
    z, y, x = np.indices(shape)
    return (255 * ((x - 98) ** 2 + (y - 180) ** 2 + (z - 110) ** 2 < 45**2)).astype(np.uint8)


def open_brain(iso, work):
    """The demo volume's T1 image; grey matter and a ball beside it, as other fields of its folder."""
    fields = work / "brain"
    meshes = work / f"brain-{iso}"
    for folder in (fields, meshes):
        folder.mkdir(parents=True, exist_ok=True)
    if not (fields / "ball.nrrd").exists():
        t1 = closed(read_nifti(DEMO / "t1.nii.gz"))
        write_nrrd(fields / "t1.nrrd", t1)
        write_nrrd(fields / "gm.nrrd", read_nifti(DEMO / "gm.nii.gz"))
        write_nrrd(fields / "ball.nrrd", ball_in(t1.shape))
    return Input("brain", f"`mni152`, T1 at {iso}", fields / "t1.nrrd", iso, meshes)
