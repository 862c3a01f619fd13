"""What is measured of a mesh. Distances and edges are those of quality.py, topology that of topology.py; results are kept beside
the mesh."""
import contextlib
import io
import json
from functools import cached_property

import igl
import igl.copyleft.cgal
import numpy as np
import quality
import topology
import trimesh
from scipy.ndimage import map_coordinates


def kept(mesh, name, measure):
    """A measured value, from the file beside the mesh if it is there."""
    path = mesh.with_suffix(".json")
    found = json.loads(path.read_text()) if path.exists() else {}
    if name not in found:
        found[name] = measure()
        path.write_text(json.dumps(found))
    return found[name]


def rms(*parts):
    """Of several directions, each of the same weight."""
    return float(np.sqrt(np.mean([np.mean(part**2) for part in parts])))


def read_with_normals(path):
    """Points in world units, triangles, and the normals that the file has of its vertices, or those of its triangles by area."""
    mesh = trimesh.load(path, process=False, force="mesh")
    points, faces = np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int64)
    sent = mesh.metadata["_ply_raw"]["vertex"]["data"]
    if "nx" in (sent.dtype.names or ()):
        return points, faces, np.stack([sent["nx"], sent["ny"], sent["nz"]], 1).astype(float)
    corners = points[faces]
    by_area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(points)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], by_area)
    return points, faces, normals


def unit(vectors):
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1), 1e-30)[:, None]


# Voxels from a mesh at which the surface is called lost.
LOST = 2


class Truth:
    """The trilinear isosurface of an input, as quality.py has it."""

    def __init__(self, source):
        self.source = source
        self.volume, self.spacing = source.read()

    @cached_property
    def surface(self):
        points, faces = quality.reference(self.volume, self.source.iso)
        tree = igl.AABB()
        tree.init(points, faces)
        return points, faces, tree

    @cached_property
    def samples(self):
        points, faces, _ = self.surface
        return quality.sample(points, faces, quality.SAMPLES, 1)[0]

    def nearest(self, samples):
        """Distances in voxels to the surface, and where it is nearest."""
        points, faces, tree = self.surface
        squared, _, nearest = tree.squared_distance(points, faces, samples)
        return np.sqrt(np.maximum(squared, 0)), nearest

    def distances(self, path):
        def measure():
            points, faces = quality.read_mesh(path, self.spacing)
            own, _ = quality.sample(points, faces, quality.SAMPLES, 2)
            to_truth, _ = self.nearest(own)
            to_mesh, _ = quality.distance(self.samples, points, faces)
            return dict(
                triangles=len(faces),
                rms=rms(to_truth, to_mesh),
                hausdorff=float(max(to_truth.max(), to_mesh.max())),
                **quality.edge_report(points, faces, self.volume.shape),
            )

        return kept(path, "distances", measure)

    def lost(self, path):
        """The share of the surface that is lost, and the rms without it."""

        def measure():
            points, faces = quality.read_mesh(path, self.spacing)
            to_truth, _ = self.nearest(quality.sample(points, faces, quality.SAMPLES, 2)[0])
            to_mesh, _ = quality.distance(self.samples, points, faces)
            return [float((to_mesh > LOST).mean()), rms(to_truth, to_mesh[to_mesh <= LOST])]

        return kept(path, "lost", measure)

    def gradient(self, at):
        """Of the trilinear interpolant, in world units, at points in index space."""
        size = np.array(self.volume.shape[::-1])
        low = np.clip(np.floor(at).astype(int), 0, size - 2)
        t = at - low
        corner = {
            (x, y, z): self.volume[low[:, 2] + z, low[:, 1] + y, low[:, 0] + x].astype(float)
            for x in (0, 1) for y in (0, 1) for z in (0, 1)
        }
        gradient = np.zeros_like(at)
        for (x, y, z), value in corner.items():
            weights = [np.where(side, t[:, axis], 1 - t[:, axis]) for axis, side in enumerate((x, y, z))]
            for axis, side in enumerate((x, y, z)):
                others = weights[axis - 1] * weights[axis - 2]
                gradient[:, axis] += value * others * (1 if side else -1)
        return gradient / self.spacing

    def smooth_gradient(self, at):
        """Central differences, interpolated, in world units: what a ray caster shades with."""
        low, high = np.eye(3) * -1, np.eye(3)
        value = lambda shifted: map_coordinates(self.volume, shifted[:, ::-1].T, np.float32, order=1, mode="nearest")
        return np.stack([value(at + high[a]) - value(at + low[a]) for a in range(3)], 1) / (2 * np.array(self.spacing))

    def shading(self, path):
        """Root mean square angles, in degrees, between the interpolated normals and the field's gradients where the surface is
        nearest: the trilinear interpolant's own, and central differences."""

        def measure():
            points, faces, normals = read_with_normals(path)
            rng = np.random.default_rng(3)
            corners = points[faces]
            area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
            pick = np.minimum(np.searchsorted(np.cumsum(area), rng.random(quality.SAMPLES) * area.sum()), len(faces) - 1)
            u, v = np.sqrt(rng.random(quality.SAMPLES)), rng.random(quality.SAMPLES)
            weights = np.stack([1 - u, u * (1 - v), u * v], 1)[:, :, None]
            _, nearest = self.nearest((weights * corners[pick]).sum(1) / self.spacing)
            shaded = unit((weights * unit(normals)[faces[pick]]).sum(1))
            return [self.angle(shaded, -gradient(nearest)) for gradient in (self.gradient, self.smooth_gradient)]

        return kept(path, "shading", measure)

    @staticmethod
    def angle(shaded, wanted):
        cosine = (shaded * unit(wanted)).sum(1)
        # Which side a file's triangles face is the same everywhere, and no error of shading.
        cosine *= np.sign(cosine.mean())
        return rms(np.degrees(np.arccos(np.clip(cosine, -1, 1))))

    def in_part(self, path, name, field, threshold):
        """rms where a field of the same grid is `threshold` or more, and where it is below."""

        def measure():
            points, faces = quality.read_mesh(path, self.spacing)
            own, _ = quality.sample(points, faces, quality.SAMPLES, 2)
            to_truth, _ = self.nearest(own)
            to_mesh, _ = quality.distance(self.samples, points, faces)
            value = lambda at: map_coordinates(field, at[:, ::-1].T, np.float32, order=1)
            a, b = value(own) >= threshold, value(self.samples) >= threshold
            return dict(triangles=len(faces), inside=rms(to_truth[a], to_mesh[b]), outside=rms(to_truth[~a], to_mesh[~b]),
                        share=float(b.mean()))

        return kept(path, f"in {name}", measure)


def topology_of(path):
    return kept(path, "topology", lambda: topology.describe(str(path)))


def self_intersections(path):
    """Triangles that meet another one elsewhere than in the corners and edges they share, by exact predicates (CGAL's)."""

    def measure():
        mesh = trimesh.load(path, process=False, force="mesh")
        points, weld = np.unique(np.asarray(mesh.vertices), axis=0, return_inverse=True)
        faces = weld.reshape(-1)[np.asarray(mesh.faces)].astype(np.int64)
        faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
        with contextlib.redirect_stdout(io.StringIO()):
            pairs = igl.copyleft.cgal.remesh_self_intersections(points.astype(float), faces, detect_only=True)[2]
        return len(np.unique(pairs))

    return kept(path, "self-intersecting", measure)
