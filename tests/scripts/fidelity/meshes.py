"""How each method makes a mesh. Meshes are kept: one that lies in its folder, made by the same binary, is not made again."""
import hashlib
import json
import subprocess
from functools import cache

import fast_simplification
import meshoptimizer
import numpy as np
import quality
import scipy.ndimage
import trimesh

from fidelity.stream import cut_of_cubes


def flying_edges(volume, spacing, iso):
    points, faces = quality.flying_edges(volume, spacing, iso)
    return points.astype(np.float32), faces.astype(np.uint32)


def coarser(volume, spacing, iso, triangles, full):
    """Marching cubes on a coarser grid: trilinear samples, so many that the triangles come out near those wanted."""
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


class Maker:
    """Makes the meshes of one input: each function returns the mesh's path."""

    def __init__(self, isopeel, source):
        self.isopeel, self.source = isopeel, source
        self.binary = hashlib.sha256(isopeel.read_bytes()).hexdigest()[:16]

    @cache
    def full(self):
        """The full surface of VTK, in world units."""
        volume, spacing = self.source.read()
        return flying_edges(volume, spacing, self.source.iso)

    def full_triangles(self):
        path = self.source.folder / "full.json"
        if not path.exists():
            path.write_text(json.dumps(len(self.full()[1])))
        return json.loads(path.read_text())

    def kept(self, slug, made_by, make):
        """The mesh `slug`, made anew unless it lies there with the same `made_by`."""
        mesh = self.source.folder / f"{slug}.ply"
        stamp = mesh.with_suffix(".made-by")
        if not (mesh.exists() and stamp.exists() and stamp.read_text() == made_by):
            mesh.with_suffix(".json").unlink(missing_ok=True)
            make(mesh)
            stamp.write_text(made_by)
        return mesh

    def save(self, slug, make):
        return self.kept(slug, "peer", lambda mesh: trimesh.Trimesh(*make(), process=False).export(mesh))

    def vtk_full(self):
        return self.save("vtk-full", self.full)

    def meshopt(self, triangles):
        def make():
            points, faces = self.full()
            result = np.empty(faces.size, np.uint32)
            count = meshoptimizer.simplify(
                result, faces.ravel(), np.ascontiguousarray(points), target_index_count=3 * triangles, target_error=1e9
            )
            return points, result[:count].reshape(-1, 3)

        return self.save(f"meshopt-{triangles}", make)

    def fast(self, triangles):
        def make():
            points, faces = self.full()
            return fast_simplification.simplify(points, faces.astype(np.int32), 1 - triangles / len(faces))

        return self.save(f"fast-{triangles}", make)

    def coarser(self, triangles):
        volume, spacing = self.source.read()
        return self.save(
            f"coarser-{triangles}", lambda: coarser(volume, spacing, self.source.iso, triangles, self.full_triangles())
        )

    def isopeel_mesh(self, slug, options, path=None):
        command = [self.isopeel, "extract", path or self.source.path, f"--iso={self.source.iso:g}", *options]
        return self.kept(
            slug,
            f"{self.binary} {' '.join(map(str, options))}",
            lambda mesh: subprocess.run([*command, "-o", mesh], check=True, stderr=subprocess.DEVNULL),
        )

    def dual(self):
        return self.isopeel_mesh("dual", ["--beta=-1"])

    def marching_cubes_full(self):
        return self.isopeel_mesh("marching-cubes", ["--mesher", "marching-cubes", "--beta=-1"])

    def marching_cubes(self, triangles):
        options = ["--mesher", "marching-cubes", "--triangles", str(triangles), "--max-error", "none", "--topology", "free"]
        return self.isopeel_mesh(f"marching-cubes-{triangles}", options)

    def tree(self, triangles):
        return self.isopeel_mesh(f"tree-{triangles}", ["--triangles", str(triangles)])

    def octree(self, triangles):
        def make(mesh):
            edit = {"iso": self.source.iso, "triangles": triangles}
            points, faces, _ = cut_of_cubes(self.isopeel, self.source.path, edit)
            spacing = self.source.read()[1]
            trimesh.Trimesh((points * spacing).astype(np.float32), faces, process=False).export(mesh)

        return self.kept(f"octree-{triangles}", self.binary, make)
