"""Test volumes for measurements. `volumes.py NAME N f32|u8 OUT.nrrd [closed]`

sin: eight plane waves plus 1 % white noise (isovalue 0.5; u8: 159.5), about 0.69 M triangles at 256^3, 2.8 M at 512^3.
ml:  Marschner-Lobb, smooth (isovalue 0.5), about 0.98 M triangles at 256^3.
gyroid: two gyroids of different period, no noise (isovalue 0.1).
closed: the outermost samples are set to the minimum, so every surface is closed inside the volume.
"""
import sys

import numpy as np


def sin_waves(n, seed=7):
    rng = np.random.default_rng(seed)
    waves = []
    for _ in range(8):
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        waves.append((2 * np.pi * rng.uniform(1, 3) * direction, rng.uniform(0, 6.28), rng.uniform(0.5, 1)))
    noise = np.random.default_rng(seed + 4)
    x = (np.arange(n) + 0.5) / n
    out = np.empty((n, n, n), np.float32)
    for z in range(n):
        plane = sum(a * np.sin(k[0] * x[None, :] + k[1] * x[:, None] + k[2] * x[z] + p) for k, p, a in waves)
        out[z] = plane / 3 + (256 / n) * 0.01 * noise.standard_normal((n, n))
    return out


def marschner_lobb(n):
    x = np.linspace(-1, 1, n)
    r = np.sqrt(x[None, :] ** 2 + x[:, None] ** 2)
    rho = np.cos(2 * np.pi * 6 * np.cos(np.pi * r / 2))
    return np.stack([((1 - np.sin(np.pi * z / 2)) + 0.25 * (1 + rho)) / 2.5 for z in x]).astype(np.float32)


def gyroid(n):
    g = lambda f, x, y, z: np.sin(f * x) * np.cos(f * y) + np.sin(f * y) * np.cos(f * z) + np.sin(f * z) * np.cos(f * x)
    x = np.linspace(0, 2 * np.pi, n, dtype=np.float32)
    return np.stack([g(4, x[None, :], x[:, None], z) + 0.5 * g(9, x[None, :], x[:, None], z) for z in x]).astype(np.float32)


VOLUMES = {"sin": sin_waves, "ml": marschner_lobb, "gyroid": gyroid}


def write_nrrd(path, volume, spacing=(1, 1, 1)):
    kind = {"float32": "float", "uint8": "uint8", "int16": "int16", "uint16": "uint16"}[volume.dtype.name]
    nz, ny, nx = volume.shape
    header = (
        f"NRRD0004\ntype: {kind}\ndimension: 3\nsizes: {nx} {ny} {nz}\n"
        f"spacings: {spacing[0]} {spacing[1]} {spacing[2]}\nendian: little\nencoding: raw\n\n"
    )
    with open(path, "wb") as f:
        f.write(header.encode())
        volume.tofile(f)


def read_nrrd(path):
    import gzip

    header, _, data = open(path, "rb").read().partition(b"\n\n")
    fields = {}
    for line in header.decode().splitlines()[1:]:
        if ":" in line and not line.startswith("#"):
            key, value = line.split(":", 1)
            fields[key.strip()] = value.lstrip("=").strip()
    if fields["encoding"] in ("gzip", "gz"):
        data = gzip.decompress(data)
    dtype = {"float": "<f4", "uint8": "u1", "int16": "<i2", "uint16": "<u2"}[fields["type"]]
    nx, ny, nz = map(int, fields["sizes"].split())
    return np.frombuffer(data, dtype).reshape(nz, ny, nx), tuple(float(s) for s in fields["spacings"].split())


if __name__ == "__main__":
    name, n, kind, path = sys.argv[1], int(sys.argv[2]), sys.argv[3], sys.argv[4]
    volume = VOLUMES[name](n)
    if kind == "u8":
        volume = np.clip(np.round((volume + 2) * 63.75), 0, 255).astype(np.uint8)
    if "closed" in sys.argv[5:]:
        inner = volume[1:-1, 1:-1, 1:-1].copy()
        volume[:] = volume.min()
        volume[1:-1, 1:-1, 1:-1] = inner
    write_nrrd(path, volume)
