#!/usr/bin/env python3
"""Ten volumes whose surfaces are known × all formats × real readers: a table of cells that are wrong.

    tests/scripts/export_table.py ISOPEEL      # the binary

Each cell compares what a reader finds with the ball that the volume holds: its place, the volume that it encloses, with sign, in the unit that the
format has, and whether it is closed. Runs in the environment of fixtures.py, or if ANY_PYTHON is set in any that has these readers.
"""
import json
import os
import struct
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

if {"-h", "--help"} & set(sys.argv[1:]):
    sys.exit(print(__doc__.strip()))

ROOT = Path(__file__).resolve().parent.parent.parent
VENV = ROOT / "target/fixtures-venv"

if Path(sys.prefix) != VENV and not os.environ.get("ANY_PYTHON"):
    if not (VENV / "bin/python").exists():
        sys.exit("run tests/scripts/fixtures.py first, which makes the environment")
    os.execv(VENV / "bin/python", [VENV / "bin/python", *sys.argv])

import lib3mf
import meshio
import nibabel
import numpy as np
import trimesh
import vtk
from pxr import Usd, UsdGeom
from vtk.util.numpy_support import vtk_to_numpy

METRES = {"mm": 1e-3, "um": 1e-6, "angstrom": 1e-10}
SIZE = np.array([40, 36, 32])


def turned(degrees):
    a, b = np.radians([degrees, 40])
    z = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    x = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    return z @ x


class Ball:
    """A volume in LPS: rows of `steps` lead from a sample to the next. The ball's centre and radius are in its unit."""

    def __init__(self, steps=np.eye(3), unit="mm", radius=11.3, sign=1, shift=(0, 0, 0), labels=False, times=1):
        self.steps, self.unit, self.radius, self.sign = np.asarray(steps, float), unit, radius, sign
        self.origin, self.labels, self.times = np.array([-13.5, 250.25, 8.0]), labels, times
        self.centre = self.origin + ((SIZE - 1) / 2 + 0.3 + np.array(shift)) @ self.steps

    def write(self, path):
        at = np.stack(np.meshgrid(*[np.arange(n, dtype=float) for n in SIZE], indexing="ij"), axis=-1) @ self.steps + self.origin
        values = self.sign * (self.radius - np.linalg.norm(at - self.centre, axis=-1))
        if self.labels:
            values = np.where(values > 0, 7, 0)
        values = np.stack([values - 0.5 * step for step in range(self.times)], axis=-1)
        unit = f'"{self.unit}"'
        axes = "" if self.times == 1 else " none"
        vectors = " ".join("(%r,%r,%r)" % tuple(map(float, row)) for row in self.steps)
        header = (
            f"NRRD0005\ntype: {'uint8' if self.labels else 'float'}\ndimension: {3 if self.times == 1 else 4}\n"
            f"space: left-posterior-superior\nsizes: {SIZE[0]} {SIZE[1]} {SIZE[2]}{'' if self.times == 1 else f' {self.times}'}\n"
            f"space directions: {vectors}{axes}\nspace origin: (%r,%r,%r)\nspace units: {unit} {unit} {unit}\n" % tuple(map(float, self.origin))
            + ("" if self.times == 1 else "kinds: domain domain domain time\n")
            + "endian: little\nencoding: raw\n\n"
        )
        data = values.astype("u1" if self.labels else "<f4").tobytes(order="F")
        path.write_bytes(header.encode() + data)


ANISOTROPIC = turned(25) @ np.diag([0.9, 1.0, 1.2])
MIRRORED = np.diag([-1.0, 1, 1]) @ ANISOTROPIC.T
# Name, volume, options, whether the surface is closed, radii of its balls.
VOLUMES = [
    ("oblique", Ball(ANISOTROPIC.T), [], True, [11.3]),
    ("mirrored", Ball(MIRRORED), [], True, [11.3]),
    ("µm", Ball(unit="um"), [], True, [11.3]),
    ("Å", Ball(unit="angstrom"), [], True, [11.3]),
    ("labels", Ball(labels=True), ["--label", "7"], True, [11.3]),
    ("low inside", Ball(sign=-1), [], True, [11.3]),
    ("open", Ball(shift=(0, 0, 15)), [], False, [11.3]),
    ("capped", Ball(shift=(0, 0, 15)), ["--cap"], True, [11.3]),
    ("several", Ball(), [], True, [11.3, 7.3]),
    ("steps", Ball(times=3), ["--step", "2"], True, [10.3]),
]
FORMATS = {
    "glb": ["VTK", "trimesh"],
    "ply": ["VTK", "trimesh", "meshio"],
    "stl": ["VTK", "trimesh", "meshio"],
    "vtp": ["VTK"],
    "obj": ["VTK", "trimesh"],
    "3mf": ["lib3mf", "trimesh"],
    "surf.gii": ["nibabel"],
    "precomputed.zip": ["itself"],
    "usdz": ["OpenUSD"],
}
SEVERAL = {"glb", "obj", "3mf", "precomputed.zip", "usdz"}
FIXED_UNITS = {"glb": 1, "stl": 1e-3, "3mf": 1e-3, "surf.gii": 1e-3, "precomputed.zip": 1e-9, "usdz": 1}


def of_vtk(data):
    return vtk_to_numpy(data.GetPoints().GetData()).astype(float), vtk_to_numpy(data.GetPolys().GetConnectivityArray()).reshape(-1, 3)


def read_vtk(form, path):
    readers = {"glb": vtk.vtkGLTFReader, "ply": vtk.vtkPLYReader, "stl": vtk.vtkSTLReader, "vtp": vtk.vtkXMLPolyDataReader, "obj": vtk.vtkOBJReader}
    reader = readers[form]()
    reader.SetFileName(str(path))
    reader.Update()
    data = reader.GetOutput()
    if not isinstance(data, vtk.vtkMultiBlockDataSet):
        return [of_vtk(data)]
    found, iterator = [], data.NewIterator()
    while not iterator.IsDoneWithTraversal():
        found.append(of_vtk(iterator.GetCurrentDataObject()))
        iterator.GoToNextItem()
    return found


def read_trimesh(form, path):
    # By itself it joins the objects of an OBJ.
    options = {"split_objects": True} if form == "obj" else {}
    scene = trimesh.load(path, process=False, **options)
    if isinstance(scene, trimesh.Trimesh):
        return [(np.asarray(scene.vertices, float), scene.faces)]
    return [(np.asarray(mesh.vertices, float), mesh.faces) for mesh in scene.dump()]


def read_lib3mf(_, path):
    model = lib3mf.get_wrapper().CreateModel()
    model.QueryReader("3mf").ReadFromFile(str(path))
    found, objects = [], model.GetMeshObjects()
    placed = model.GetBuildItems()
    moves = []
    while placed.MoveNext():
        moves.append(np.array(placed.GetCurrent().GetObjectTransform().Fields).reshape(4, 3))
    while objects.MoveNext():
        mesh, move = objects.GetCurrentMeshObject(), moves[len(found)]
        points = np.array([vertex.Coordinates for vertex in mesh.GetVertices()], float)
        found.append((points @ move[:3] + move[3], np.array([triangle.Indices for triangle in mesh.GetTriangleIndices()])))
    return found


def read_usd(_, path):
    stage = Usd.Stage.Open(str(path))
    found, metres = [], UsdGeom.GetStageMetersPerUnit(stage)
    for mesh in (UsdGeom.Mesh(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)):
        to_world = np.array(mesh.ComputeLocalToWorldTransform(0))
        points = np.array(mesh.GetPointsAttr().Get(), float) @ to_world[:3, :3] + to_world[3, :3]
        found.append((points * metres, np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)))
    return found


def read(reader, form, path):
    if reader == "VTK":
        found = read_vtk(form, path)
    elif reader == "trimesh":
        found = read_trimesh(form, path)
    elif reader == "lib3mf":
        found = read_lib3mf(form, path)
    elif reader == "OpenUSD":
        found = read_usd(form, path)
    elif reader == "meshio":
        mesh = meshio.read(path)
        found = [(mesh.points.astype(float), mesh.cells_dict["triangle"])]
    elif reader == "nibabel":
        image = nibabel.load(path)
        points = image.agg_data("NIFTI_INTENT_POINTSET").astype(float) * [-1, -1, 1]
        found = [(points, image.agg_data("NIFTI_INTENT_TRIANGLE"))]
    else:
        found = []
        with zipfile.ZipFile(path) as package:
            for segment in (name for name in package.namelist() if name.endswith(":0")):
                (fragment,) = json.loads(package.read(segment))["fragments"]
                data = package.read(fragment)
                count = struct.unpack_from("<I", data)[0]
                points = np.frombuffer(data, "<f4", 3 * count, 4).reshape(-1, 3).astype(float)
                found.append((points, np.frombuffer(data, "<u4", offset=4 + 12 * count).reshape(-1, 3)))
    if form in ("glb", "usdz"):
        # Y up, z towards the viewer: back to LPS.
        found = [(points[:, [0, 2, 1]] * [1, -1, 1], corners) for points, corners in found]
    return found


def faults(meshes, ball, radii, is_closed, is_capped, unit):
    """What is wrong with the meshes of a cell."""
    wrong = []
    if len(meshes) != len(radii):
        return [f"{len(meshes)} surfaces, expected {len(radii)}"]
    scale = METRES[ball.unit] / unit
    centre, spacing = ball.centre * scale, scale
    for (points, corners), radius in zip(sorted(meshes, key=lambda mesh: -np.ptp(mesh[0][:, 0])), radii):
        distance = np.linalg.norm(points - centre, axis=1) / spacing
        lower = 0 if is_capped else radius - (1.0 if ball.labels else 0.3)
        if distance.max() > radius + (1.0 if ball.labels else 0.3) or distance.min() < lower:
            wrong.append(f"vertices {distance.min():.4g} to {distance.max():.4g} from the centre, expected {radius}")
        _, same = np.unique(points, axis=0, return_inverse=True)
        corners = same.ravel()[np.asarray(corners, int)]
        edges = np.sort(np.concatenate([corners[:, pair] for pair in ([0, 1], [1, 2], [2, 0])]), axis=1)
        sides = np.unique(edges, axis=0, return_counts=True)[1]
        if bool((sides % 2 == 0).all()) != is_closed:
            wrong.append(f"{int((sides % 2).sum())} edges with an odd number of sides")
        if is_closed and not is_capped:
            a, b, c = (points[np.asarray(mesh_corners)] - centre for mesh_corners in np.asarray(corners_of(points, corners, same)).T)
            enclosed = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6 / (4 / 3 * np.pi * (radius * spacing) ** 3)
            if not 0.93 < enclosed < 1.07:
                wrong.append(f"encloses {enclosed:.3f} of the ball")
    return wrong


def corners_of(points, corners, same):
    """Corners as indices of points again, any one of those at a position."""
    first = np.zeros(corners.max() + 1, int)
    first[same.ravel()] = np.arange(len(points))
    return first[corners]


def main():
    binary, wrong, cells = sys.argv[1], [], 0
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for number, (name, ball, options, is_closed, radii) in enumerate(VOLUMES):
            volume = folder / f"volume{number}.nrrd"
            ball.write(volume)
            for form, readers in FORMATS.items():
                if len(radii) > 1 and form not in SEVERAL:
                    continue
                out = folder / f"surface.{form}"
                iso = [] if "--label" in options else ["--iso", "0"]
                several = [part for radius in radii if len(radii) > 1 for part in ("--surface", json.dumps({"iso": radii[0] - radius}))]
                command = [binary, "extract", volume, *iso, "--error", "0.05vx", *options, *several, "-o", out]
                subprocess.run(command, check=True, capture_output=True)
                for reader in readers:
                    unit = FIXED_UNITS.get(form, METRES[ball.unit])
                    found = read(reader, form, out)
                    if reader == "VTK" and form == "obj" and len(radii) > 1:
                        # Its reader joins objects.
                        cells += 1
                        expected = sum(len(corners) for _, corners in read("trimesh", form, out))
                        if sum(len(corners) for _, corners in found) != expected:
                            wrong.append(f"{name}, {form}, {reader}: triangles are missing")
                        continue
                    cells += 1
                    why = faults(found, ball, radii, is_closed, "--cap" in options, unit)
                    wrong += [f"{name}, {form}, {reader}: {fault}" for fault in why]
    print("\n".join(wrong + [f"{cells} cells, {len({fault.rsplit(': ', 1)[0] for fault in wrong})} of them wrong"]))
    sys.exit(bool(wrong))


main()
