#!/usr/bin/env python3
"""Exported surfaces in the programs of others: meshio, VTK, trimesh, lib3mf, nibabel, OpenUSD, and Open3D where it is installed.

    tests/scripts/exports.py ISOPEEL      # the binary

Each reader must find the vertices and triangles that `--stats` counts, in the same place, whole: no edge of a closed surface has one
side. Frame and unit must be where each format has a field for them. Runs in the environment of fixtures.py, or if ANY_PYTHON is set in any that has
these.
"""
import importlib.util
import json
import os
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

if {"-h", "--help"} & set(sys.argv[1:]):
    sys.exit(print(__doc__.strip()))

ROOT = Path(__file__).resolve().parent.parent.parent
VENV = ROOT / "target/fixtures-venv"
VOLUME = ROOT / "server/demo/t1.nii.gz"

if Path(sys.prefix) != VENV and not os.environ.get("ANY_PYTHON"):
    if not (VENV / "bin/python").exists():
        sys.exit("run tests/scripts/fixtures.py first, which makes the environment")
    os.execv(VENV / "bin/python", [VENV / "bin/python", *sys.argv])

import zipfile

import lib3mf
import meshio
import nibabel
import nrrd
import numpy as np
import trimesh
import vtk
from pxr import Usd, UsdGeom, UsdShade, UsdValidation
from vtk.util.numpy_support import vtk_to_numpy


def extract(binary, folder, extension, *options):
    path = folder / f"surface.{extension}"
    command = [binary, "extract", VOLUME, "--iso", "100", "--beta", "0.05", "-o", path, "--stats", *options]
    return path, json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def expect(what, found, expected):
    if found != expected:
        sys.exit(f"{what}: {found}, expected {expected}")


def read_vtk(reader, path):
    reader.SetFileName(str(path))
    reader.Update()
    return reader.GetOutput()


def boundary(triangles):
    """Edges with one triangle."""
    edges = np.sort(np.concatenate([triangles[:, pair] for pair in ([0, 1], [1, 2], [2, 0])]), axis=1)
    return int((np.unique(edges, axis=0, return_counts=True)[1] == 1).sum())


def polygons(data):
    return vtk_to_numpy(data.GetPolys().GetConnectivityArray()).reshape(-1, 3)


def bounds(points):
    return np.concatenate([points.min(axis=0), points.max(axis=0)])


def check_ply(path, triangles):
    mesh = meshio.read(path)
    expect("PLY in meshio, triangles", len(mesh.cells_dict["triangle"]), triangles)
    expect("PLY in meshio, point data", {"nx", "smoothness", "feature"} - set(mesh.point_data), set())
    data = read_vtk(vtk.vtkPLYReader(), path)
    expect("PLY in VTK, triangles", data.GetNumberOfPolys(), triangles)
    expect("PLY in VTK, points", data.GetNumberOfPoints(), len(mesh.points))
    header = path.read_bytes()[:2000].split(b"end_header")[0].decode()
    expect("PLY, frame and unit", "comment frame LPS, unit mm" in header, True)
    if importlib.util.find_spec("open3d"):
        import open3d

        read = open3d.io.read_triangle_mesh(str(path))
        expect("PLY in Open3D", (len(read.triangles), len(read.vertices)), (triangles, len(mesh.points)))
        expect("PLY in Open3D, normals", read.has_vertex_normals(), True)
        print("Open3D:", open3d.__version__)
    return mesh.points, mesh.cells_dict["triangle"]


def check_stl(path, triangles, points, edges):
    data = read_vtk(vtk.vtkSTLReader(), path)
    expect("STL in VTK, triangles", data.GetNumberOfPolys(), triangles)
    expect("STL in VTK, edges with one side", boundary(polygons(data)), edges)
    expect("STL in VTK, place", np.array_equal(bounds(vtk_to_numpy(data.GetPoints().GetData())), bounds(points.astype(np.float32))), True)
    mesh = meshio.read(path)
    expect("STL in meshio, triangles", len(mesh.cells_dict["triangle"]), triangles)
    expect("STL, frame and unit", b"SPACE=LPS, unit mm" in path.read_bytes()[:80], True)


def check_vtp(path, triangles, points):
    data = read_vtk(vtk.vtkXMLPolyDataReader(), path)
    expect("VTP in VTK, triangles", data.GetNumberOfPolys(), triangles)
    expect("VTP in VTK, place", np.array_equal(vtk_to_numpy(data.GetPoints().GetData()), points), True)
    names = [data.GetPointData().GetArrayName(i) for i in range(data.GetPointData().GetNumberOfArrays())]
    expect("VTP in VTK, point data", sorted(names), ["feature", "normal", "smoothness"])
    expect("VTP in VTK, level", data.GetCellData().GetArray("level").GetNumberOfTuples(), triangles)
    text = [data.GetFieldData().GetAbstractArray(name).GetValue(0) for name in ("frame", "unit")]
    expect("VTP in VTK, frame and unit", text, ["LPS", "mm"])


def check_glb(path, triangles, points):
    """Metres and Y up, by the node: x stays, y is the head, z the face."""
    data = path.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    head = json.loads(data[20 : 20 + length])
    accessors, primitive = head["accessors"], head["meshes"][0]["primitives"][0]
    expect("GLB, triangles", accessors[primitive["indices"]]["count"], 3 * triangles)
    expect("GLB, shared vertices once", accessors[primitive["attributes"]["POSITION"]]["count"], len(points))
    extras = head["asset"]["extras"]
    expect("GLB, frame and unit", (extras["frame"], extras["unit"]), ("LPS", "mm"))
    importer = vtk.vtkGLTFReader()
    importer.SetFileName(str(path))
    importer.Update()
    data = importer.GetOutput()
    while not isinstance(data, vtk.vtkPolyData):
        data = data.GetBlock(0)
    expect("GLB in VTK, triangles", data.GetNumberOfPolys(), triangles)
    placed = vtk_to_numpy(data.GetPoints().GetData())
    turned = np.stack([points[:, 0], points[:, 2], -points[:, 1]], axis=1) / 1000
    expect("GLB in VTK, metres with Y up", bool(np.allclose(bounds(placed), bounds(turned), atol=1e-6)), True)


def check_obj(path, triangles, points):
    data = read_vtk(vtk.vtkOBJReader(), path)
    expect("OBJ in VTK, triangles", data.GetNumberOfPolys(), triangles)
    read = trimesh.load(path, process=False)
    expect("OBJ in trimesh, triangles and vertices", (len(read.faces), len(read.vertices)), (triangles, len(points)))
    expect("OBJ in trimesh, place", bool(np.abs(read.vertices - points).max() < 1e-4), True)
    head = path.read_text()[:2000]
    expect("OBJ, frame and unit", "# frame LPS, unit mm" in head, True)


def check_3mf(path, triangles, points):
    wrapper = lib3mf.get_wrapper()
    model = wrapper.CreateModel()
    reader = model.QueryReader("3mf")
    reader.SetStrictModeActive(True)
    reader.ReadFromFile(str(path))
    warnings = [reader.GetWarning(i) for i in range(reader.GetWarningCount())]
    expect("3MF in lib3mf, warnings", warnings, [])
    expect("3MF in lib3mf, unit", model.GetUnit(), lib3mf.ModelUnit.MilliMeter)
    objects = model.GetMeshObjects()
    expect("3MF in lib3mf, objects", objects.Count(), 1)
    objects.MoveNext()
    mesh = objects.GetCurrentMeshObject()
    expect("3MF in lib3mf, triangles and vertices", (mesh.GetTriangleCount(), mesh.GetVertexCount()), (triangles, len(points)))
    expect("3MF in lib3mf, name", mesh.GetName().startswith("t1"), True)
    scene = trimesh.load(path)
    extent = np.asarray(scene.bounds).ravel()
    expect("3MF in trimesh, place", bool(np.allclose(extent, bounds(points), atol=1e-3)), True)


def check_gifti(path, triangles, points):
    image = nibabel.load(path)
    found, corners = image.agg_data("NIFTI_INTENT_POINTSET"), image.agg_data("NIFTI_INTENT_TRIANGLE")
    expect("GIFTI in nibabel, triangles", corners.shape, (triangles, 3))
    expect("GIFTI in nibabel, RAS", bool(np.allclose(found * [-1, -1, 1], points, atol=1e-4)), True)
    array = image.get_arrays_from_intent("NIFTI_INTENT_POINTSET")[0]
    expect("GIFTI in nibabel, space", array.coordsys.dataspace, 1)
    expect("GIFTI in nibabel, unit", image.meta["unit"], "mm")


def check_precomputed(path, triangles, placed):
    """`placed`: the corners of each triangle. In another unit rounding decides otherwise which of two sheets that lie on each other is which."""
    with zipfile.ZipFile(path) as package:
        expect("precomputed, kind", json.loads(package.read("info"))["@type"], "neuroglancer_legacy_mesh")
        (fragment,) = json.loads(package.read("1:0"))["fragments"]
        data = package.read(fragment)
    if importlib.util.find_spec("cloudvolume"):
        from cloudvolume import Mesh

        mesh = Mesh.from_precomputed(data)
        found, corners = mesh.vertices, mesh.faces
        print("cloud-volume: read")
    else:
        count = struct.unpack_from("<I", data)[0]
        found = np.frombuffer(data, "<f4", 3 * count, 4).reshape(-1, 3)
        corners = np.frombuffer(data, "<u4", offset=4 + 12 * count).reshape(-1, 3)
    expect("precomputed, triangles", len(corners), triangles)
    expect("precomputed, nanometres", bool(np.allclose(found[corners], placed * 1e6, rtol=1e-6, atol=1e2)), True)


def check_usdz(path, triangles, points):
    """Millimetres and Y up, by the stage and its root: x stays, y is the head, z the face."""
    stage = Usd.Stage.Open(str(path))
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    expect("USDZ, validators", len(validators) > 20, True)
    found = [error.GetMessage() for error in UsdValidation.ValidationContext(validators).Validate(stage)]
    expect("USDZ, errors of OpenUSD's validators", found, [])
    with zipfile.ZipFile(path) as package:
        (layer,) = package.infolist()
    start = layer.header_offset + 30 + sum(struct.unpack_from("<HH", path.read_bytes(), layer.header_offset + 26))
    expect("USDZ, stored at a multiple of 64", (layer.compress_type, start % 64), (zipfile.ZIP_STORED, 0))
    expect("USDZ, unit and axis", (UsdGeom.GetStageMetersPerUnit(stage), UsdGeom.GetStageUpAxis(stage)), (1e-3, "Y"))
    (prim,) = [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)]
    mesh = UsdGeom.Mesh(prim)
    corners = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    found, normals = np.array(mesh.GetPointsAttr().Get(), float), np.array(mesh.GetNormalsAttr().Get())
    expect("USDZ, triangles and vertices", (len(corners), len(found), len(normals)), (triangles, len(points), len(points)))
    expect("USDZ, counts of corners", set(mesh.GetFaceVertexCountsAttr().Get()), {3})
    expect("USDZ, corners", (corners.min(), corners.max()), (0, len(points) - 1))
    to_world = np.array(mesh.ComputeLocalToWorldTransform(0))
    turned = points @ [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    expect("USDZ, place", bool(np.abs(found @ to_world[:3, :3] + to_world[3, :3] - turned).max() < 1e-4), True)
    expect("USDZ, extent", bool(np.allclose(np.array(mesh.GetExtentAttr().Get()).ravel(), bounds(found), atol=1e-6)), True)
    expect("USDZ, name", prim.GetDisplayName().startswith("t1"), True)
    expect("USDZ, volume and frame", [prim.GetCustomData()["isopeel"][name] for name in ("volume", "frame")], ["t1", "LPS"])
    material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()
    shader, _, _ = material.ComputeSurfaceSource()
    expect("USDZ, material", shader.GetShaderId(), "UsdPreviewSurface")


def check_slices(binary, folder):
    """Planes across each axis in nibabel and pynrrd: samples, and where they are, are those of the volume."""
    volume = nibabel.load(VOLUME)
    samples = np.asarray(volume.dataobj)
    for axis, index in enumerate(np.array(samples.shape) // 3):
        plane = np.take(samples, index, axis=axis)
        others = [other for other in range(3) if other != axis]
        first = np.zeros(3)
        first[axis] = index
        columns = [volume.affine[:3, column] for column in others] + [volume.affine[:3] @ [*first, 1]]
        for extension in ("nii", "nii.gz", "nrrd"):
            path = folder / f"plane.{extension}"
            subprocess.run([binary, "slice", VOLUME, "--axis", "xyz"[axis], "--index", str(index), "-o", path], check=True)
            what = f"plane across {'xyz'[axis]} as {extension}"
            if extension == "nrrd":
                image, header = nrrd.read(str(path))
                read = np.vstack([header["space directions"], header["space origin"]]) * [-1, -1, 1]
                expect(f"{what}, space", header["space"], "left-posterior-superior")
            else:
                image = nibabel.load(path)
                expect(f"{what}, unit and codes", (image.header.get_xyzt_units()[0], int(image.header["sform_code"])), ("mm", 1))
                read = image.affine[:3, [0, 1, 3]].T
                across = image.affine[:3, 2]
                expect(f"{what}, across", bool(np.allclose(across, volume.affine[:3, axis], atol=1e-4)), True)
                image = np.asarray(image.dataobj)[..., 0]
            expect(f"{what}, samples", np.array_equal(image, plane), True)
            expect(f"{what}, place", bool(np.allclose(read, columns, atol=1e-4)), True)


def main():
    binary = sys.argv[1]
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        path, stats = extract(binary, folder, "ply")
        triangles = stats["triangles"]
        points, corners = check_ply(path, triangles)
        edges = boundary(corners)
        check_stl(extract(binary, folder, "stl")[0], triangles, points, edges)
        check_vtp(extract(binary, folder, "vtp")[0], triangles, points)
        check_vtp(extract(binary, folder, "vtp", "--compress", "zlib")[0], triangles, points)
        check_glb(extract(binary, folder, "glb")[0], triangles, points)
        check_obj(extract(binary, folder, "obj")[0], triangles, points)
        check_3mf(extract(binary, folder, "3mf")[0], triangles, points)
        check_gifti(extract(binary, folder, "surf.gii")[0], triangles, points)
        check_precomputed(extract(binary, folder, "precomputed.zip")[0], triangles, points[corners])
        check_slices(binary, folder)
        check_usdz(extract(binary, folder, "usdz")[0], triangles, points)
        turned = meshio.read(extract(binary, folder, "ply", "--frame", "RAS")[0])
        expect("--frame RAS", bool(np.allclose(turned.points * [-1, -1, 1], points, atol=1e-4)), True)
        counted = meshio.read(extract(binary, folder, "ply", "--frame", "index")[0])
        expect("--frame index", bool(counted.points.min() > 0 and counted.points.max() < 300), True)
    print(f"{triangles} triangles, {len(points)} vertices, {edges} edges with one side: as --stats says, in all readers")


main()
