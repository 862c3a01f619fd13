#!/usr/bin/env python3
"""How true a decimated surface is, and how its peers do: writes the table of docs/fidelity.md.

    tests/scripts/fidelity.py [--isopeel target/release/isopeel] [--size 256] [--fractions 0.5 0.25 0.15 0.08]

Measures with quality.py and volumes.py of --measure (default: ../shared/measure beside the repository), in a virtual
environment of its own, made from fidelity-requirements.txt at the first run. Distances in voxels, against the trilinear
isosurface; seconds without reading and writing files, volume resident, best of --repeats.
"""
import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
VENV = ROOT / "target" / "fidelity-venv"

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--isopeel", type=Path, default=ROOT / "target/release/isopeel", help="the binary to measure")
parser.add_argument("--measure", type=Path, default=ROOT.parent / "shared/measure", help="folder of quality.py and volumes.py")
parser.add_argument("--data", type=Path, default=ROOT.parent / "shared/data", help="folder of ct-head.nrrd")
parser.add_argument("--size", type=int, default=256, help="samples along each axis of sin and ml")
parser.add_argument("--fractions", type=float, nargs="+", default=[0.5, 0.25, 0.15, 0.08], help="of the full-resolution triangles")
parser.add_argument("--volumes", nargs="+", default=["sin", "ml", "ct-head 517", "ct-head -300"])
parser.add_argument("--repeats", type=int, default=2, help="runs of each method; the fastest counts")
parser.add_argument("--output", type=Path, default=ROOT / "docs/fidelity.md", help="page to write; - prints the table alone")
parser.add_argument("--work", type=Path, help="folder for volumes and meshes that is kept [default: a temporary one]")
parser.add_argument("--python", type=Path, help="interpreter that has the requirements, instead of the own environment")
args = parser.parse_args()


def enter_environment():
    """Goes on in an interpreter that has the requirements."""
    if os.environ.get("ISOPEEL_FIDELITY"):
        return
    python = args.python
    if python is None:
        python = VENV / "bin/python"
        stamp = VENV / "requirements.txt"
        wanted = (HERE / "fidelity-requirements.txt").read_text()
        if not stamp.exists() or stamp.read_text() != wanted:
            subprocess.run([sys.executable, "-m", "venv", VENV], check=True)
            subprocess.run([python, "-m", "pip", "install", "-q", "-r", HERE / "fidelity-requirements.txt"], check=True)
            stamp.write_text(wanted)
    os.execve(python, [str(python), *sys.argv], {**os.environ, "ISOPEEL_FIDELITY": "1"})


enter_environment()
sys.path.insert(0, str(args.measure))

import fast_simplification
import meshoptimizer
import numpy as np
import scipy.ndimage
import trimesh
import vtk
from vtk.util import numpy_support as vn
from volumes import VOLUMES, read_nrrd, write_nrrd


def best(run):
    """Result and seconds of the fastest run."""
    fastest = None
    for _ in range(args.repeats):
        start = time.perf_counter()
        result = run()
        seconds = time.perf_counter() - start
        if fastest is None or seconds < fastest[1]:
            fastest = result, seconds
    return fastest


def flying_edges(volume, spacing, iso):
    image = vtk.vtkImageData()
    image.SetDimensions(*volume.shape[::-1])
    image.SetSpacing(*spacing)
    image.GetPointData().SetScalars(vn.numpy_to_vtk(np.ascontiguousarray(volume).ravel()))
    edges = vtk.vtkFlyingEdges3D()
    edges.SetInputData(image)
    edges.SetValue(0, iso)
    edges.ComputeNormalsOn()
    edges.ComputeScalarsOff()
    edges.Update()
    mesh = edges.GetOutput()
    points = vn.vtk_to_numpy(mesh.GetPoints().GetData()).astype(np.float32)
    return points, vn.vtk_to_numpy(mesh.GetPolys().GetConnectivityArray()).reshape(-1, 3).astype(np.uint32)


def meshopt(volume, spacing, iso, triangles):
    points, faces = flying_edges(volume, spacing, iso)
    result = np.empty(faces.size, np.uint32)
    count = meshoptimizer.simplify(
        result, faces.ravel(), np.ascontiguousarray(points), target_index_count=3 * triangles, target_error=1e9
    )
    return points, result[:count].reshape(-1, 3)


def fast(volume, spacing, iso, triangles):
    points, faces = flying_edges(volume, spacing, iso)
    return fast_simplification.simplify(points, faces.astype(np.int32), 1 - triangles / len(faces))


def coarser(volume, spacing, iso, triangles):
    """Marching cubes on a coarser grid: trilinear samples, so many that the triangles come out near those wanted."""
    full = len(flying_edges(volume, spacing, iso)[1])
    factor = (triangles / full) ** 0.5
    for _ in range(6):
        shape = [max(4, round((n - 1) * factor) + 1) for n in volume.shape]
        at = np.meshgrid(*[np.linspace(0, n - 1, m) for n, m in zip(volume.shape, shape)], indexing="ij")
        small = scipy.ndimage.map_coordinates(volume.astype(np.float32), at, order=1)
        steps = [s * (n - 1) / (m - 1) for s, n, m in zip(spacing, volume.shape[::-1], shape[::-1])]
        mesh = flying_edges(small, steps, iso)
        if abs(len(mesh[1]) / triangles - 1) < 0.03:
            break
        factor *= (triangles / max(1, len(mesh[1]))) ** 0.5
    return mesh


def save(path, points, faces):
    trimesh.Trimesh(points, faces, process=False).export(path)


def isopeel(volume, iso, options, mesh):
    command = [args.isopeel, "extract", volume, f"--iso={iso}", *options, "-o", mesh, "--stats"]
    runs = [json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout) for _ in range(args.repeats)]
    return min(run["wallMs"] for run in runs) / 1000


def measure(volume, iso, meshes):
    """What quality.py says of each mesh."""
    command = [sys.executable, args.measure / "quality.py", volume, str(iso), *meshes]
    lines = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()
    return [json.loads(line) for line in lines]


def methods(path, iso, folder):
    """Each method at full resolution and at each fraction: name, fraction, seconds, mesh."""
    volume, spacing = read_nrrd(path)
    budgets = [(fraction, None) for fraction in args.fractions]
    (points, faces), seconds = best(lambda: flying_edges(volume, spacing, iso))
    full = len(faces)
    save(folder / "vtk-full.ply", points, faces)
    yield "VTK flying edges", 1, seconds, folder / "vtk-full.ply"
    for name, mesher in [("isopeel, marching cubes", "marching-cubes"), ("isopeel, dual", "dual")]:
        mesh = folder / f"{mesher}-full.ply"
        yield name, 1, isopeel(path, iso, ["--mesher", mesher, "--beta=-1"], mesh), mesh
    for fraction, _ in budgets:
        triangles = round(full * fraction)
        budget = ["--triangles", str(triangles)]
        for name, slug, options in [
            ("isopeel, marching cubes", "mc", ["--mesher", "marching-cubes", "--max-error", "none", "--topology", "free"]),
            ("isopeel, vertex tree", "tree", []),
        ]:
            mesh = folder / f"{slug}-{fraction}.ply"
            yield name, fraction, isopeel(path, iso, [*budget, *options], mesh), mesh
        for name, slug, run in [
            ("VTK + meshopt_simplify", "meshopt", meshopt),
            ("VTK + fast-simplification", "fast", fast),
            ("VTK, coarser grid", "coarser", coarser),
        ]:
            mesh = folder / f"{slug}-{fraction}.ply"
            (points, faces), seconds = best(lambda: run(volume, spacing, iso, triangles))
            save(mesh, points, faces)
            # Finding the grid takes several trials, which no one would count.
            yield name, fraction, None if run is coarser else seconds, mesh


def table(name, path, iso, folder):
    rows = list(methods(path, iso, folder))
    found = measure(path, iso, [row[3] for row in rows])
    lines = [
        f"### {name}",
        "",
        "| of full | method | triangles | rms | hausdorff | open | non-manifold | seconds |",
        "|---:|---|---:|---:|---:|---:|---:|---:|",
    ]
    for (method, fraction, seconds, _), q in zip(rows, found):
        took = "–" if seconds is None else f"{seconds:.2f}"
        lines.append(
            f"| {fraction:.0%} | {method} | {q['triangles']:,} | {q['rms']:.4f} | {q['hausdorff']:.2f} | "
            f"{q['interior_open_edges']} | {q['nonmanifold_edges']} | {took} |"
        )
    return "\n".join(lines) + "\n"


def volume_of(name, folder):
    """Path and isovalue; sin and ml are made, closed."""
    if name in VOLUMES:
        path = folder / f"{name}-{args.size}.nrrd"
        if not path.exists():
            volume = VOLUMES[name](args.size)
            inner = volume[1:-1, 1:-1, 1:-1].copy()
            volume[:] = volume.min()
            volume[1:-1, 1:-1, 1:-1] = inner
            write_nrrd(path, volume)
        return path, 0.5
    stem, iso = name.split()
    return args.data / f"{stem}.nrrd", float(iso)


def main():
    with tempfile.TemporaryDirectory() as scratch:
        work = args.work or Path(scratch)
        work.mkdir(parents=True, exist_ok=True)
        tables = []
        for name in args.volumes:
            path, iso = volume_of(name, work)
            folder = work / name.replace(" ", "")
            folder.mkdir(exist_ok=True)
            title = f"`{name}`, {args.size}³, closed, isovalue {iso}" if name in VOLUMES else f"`{name.split()[0]}` at {iso:g}"
            tables.append(table(title, path, iso, folder))
            print(tables[-1], flush=True)
    if str(args.output) == "-":
        return
    head, _, _ = args.output.read_text().partition("<!-- tables -->")
    args.output.write_text(head + "<!-- tables -->\n\n" + "\n".join(tables))


main()
