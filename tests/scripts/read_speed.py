#!/usr/bin/env python3
"""How fast isopeel reads one volume in each format, beside plain reading and Python's gzip; prints a table for server/FORMATS.md.

    tests/scripts/read_speed.py [--samples 512x512x256] [--work FOLDER] [--processor-time]

The files are in the system's cache, so that decoding and copying are measured, not the disk. With --processor-time the processors' time is
measured, of all threads together, for a machine that others use meanwhile. Runs in the environment of fixtures.py.
"""
import argparse
import gzip
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

if {"-h", "--help"} & set(sys.argv[1:]):
    sys.exit(print(__doc__.strip()))

ROOT = Path(__file__).resolve().parent.parent.parent
VENV = ROOT / "target/fixtures-venv"
RUNS = 5

if Path(sys.prefix) != VENV:
    if not (VENV / "bin/python").exists():
        sys.exit("run tests/scripts/fixtures.py first, which makes the environment")
    os.execv(VENV / "bin/python", [VENV / "bin/python", *sys.argv])

import h5py
import nibabel
import nrrd
import numpy as np
import tifffile
import vtk
import zarr
from vtk.util.numpy_support import numpy_to_vtk


def volume(shape):
    """Like a CT: smooth values of 12 bits, with noise."""
    z, y, x = (np.linspace(-1, 1, n, dtype=np.float32) for n in shape)
    ball = 1000 * np.exp(-4 * (z[:, None, None] ** 2 + y[None, :, None] ** 2 + x**2))
    return (ball + np.random.default_rng(1).normal(0, 5, shape) + 1000).astype(np.int16)


def write_vti(path, array, compressor):
    image = vtk.vtkImageData()
    image.SetDimensions(array.shape[::-1])
    image.GetPointData().SetScalars(numpy_to_vtk(array.ravel()))
    writer = vtk.vtkXMLImageDataWriter()
    writer.SetFileName(str(path))
    writer.SetInputData(image)
    writer.SetDataModeToAppended()
    writer.EncodeAppendedDataOff()
    writer.SetCompressorTypeToZLib() if compressor else writer.SetCompressorTypeToNone()
    writer.Write()


def write(folder, array):
    """All files, in the order of the table."""
    array.tofile(folder / "raw.raw")
    sidecar = {"file": "raw.raw", "type": "i16", "dims": array.shape[::-1]}
    (folder / "raw.json").write_text(json.dumps(sidecar))
    nrrd.write(str(folder / "plain.nrrd"), array.T, {"encoding": "raw"})
    np.save(folder / "plain.npy", array)
    write_vti(folder / "plain.vti", array, False)
    nibabel.save(nibabel.Nifti1Image(array.T, np.eye(4)), folder / "plain.nii")
    with h5py.File(folder / "plain.h5", "w") as file:
        file["v"] = array
    tifffile.imwrite(folder / "plain.tif", array)
    packed = gzip.compress((folder / "plain.nii").read_bytes(), 6)
    (folder / "gzip.nii.gz").write_bytes(packed)
    np.savez_compressed(folder / "deflate.npz", v=array)
    write_vti(folder / "zlib.vti", array, True)
    with h5py.File(folder / "gzip.h5", "w") as file:
        file.create_dataset("v", data=array, chunks=(32, 64, 64), compression="gzip", shuffle=True)
    zarr.create_array(folder / "zstd.zarr", data=array, chunks=(64, 64, 64), overwrite=True)
    tifffile.imwrite(folder / "deflate.tif", array, compression="deflate")
    return ["raw.json", "plain.nrrd", "plain.npy", "plain.vti", "plain.nii", "plain.h5", "plain.tif", "gzip.nii.gz", "deflate.npz", "zlib.vti",
            "gzip.h5", "zstd.zarr", "deflate.tif"]


def best(work, clock):
    times = []
    for _ in range(RUNS):
        start = clock()
        work()
        times.append(clock() - start)
    return min(times)


def read_times(reader, paths, processor_time):
    """Seconds of each file."""
    if not processor_time:
        lines = subprocess.run([reader, *paths], check=True, capture_output=True, text=True).stdout.splitlines()
        return [json.loads(line)["seconds"] for line in lines]

    def used():
        usage = resource.getrusage(resource.RUSAGE_CHILDREN)
        return usage.ru_utime + usage.ru_stime

    def once(path):
        """Of one process, which reads the file RUNS times."""
        return best(lambda: subprocess.run([reader, path], check=True, capture_output=True), used)

    start = once(paths[0].with_name("tiny.npy"))
    return [(once(path) - start) / RUNS for path in paths]


def read_into(path):
    buffer = np.empty(path.stat().st_size, np.uint8)
    with open(path, "rb", buffering=0) as file:
        view, at = memoryview(buffer), 0
        while at < len(view):
            at += file.readinto(view[at:])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", default="512x512x256", help="along x, y, z")
    parser.add_argument("--work", type=Path, help="where files are written; by default a folder that is removed")
    parser.add_argument("--processor-time", action="store_true")
    parser.add_argument("--reader", type=Path, help="the example read_speed; by default it is built")
    arguments = parser.parse_args()
    if not arguments.reader:
        subprocess.run(["cargo", "build", "--locked", "--quiet", "--release", "--package", "isopeel", "--example", "read_speed"], cwd=ROOT, check=True)
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.work or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        array = volume(tuple(int(n) for n in arguments.samples.split("x"))[::-1])
        names = write(folder, array)
        paths = [folder / name for name in names]
        np.save(folder / "tiny.npy", array[:2, :2, :2])
        clock = time.process_time if arguments.processor_time else time.perf_counter
        plain = best(lambda: read_into(folder / "raw.raw"), clock)
        unzip = best(lambda: gzip.decompress((folder / "gzip.nii.gz").read_bytes()), clock)
        reader = arguments.reader or ROOT / "target/release/examples/read_speed"
        mib = array.nbytes / 2**20
        print(f"Plain reading: {mib / plain:.0f} MiB/s; Python's gzip: {mib / unzip:.0f} MiB/s\n")
        print("| file | MiB/s | ÷ plain reading | ÷ Python's gzip |\n|---|---:|---:|---:|")
        for name, seconds in zip(names, read_times(reader, paths, arguments.processor_time)):
            print(f"| `{name}` | {mib / seconds:.0f} | {plain / seconds:.2f} | {unzip / seconds:.1f} |")


main()
