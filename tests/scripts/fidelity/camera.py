"""A camera with a depth buffer of its own: what it sees of a mesh, and how far that is from another mesh, in pixels."""
from dataclasses import dataclass

import igl
import numpy as np
import trimesh
from numba import njit


class Mesh:
    def __init__(self, path):
        mesh = trimesh.load(path, process=False, force="mesh")
        self.points, self.faces = np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int64)

    def distances(self, points):
        """Distance of each point to this mesh."""
        return np.sqrt(np.maximum(igl.point_mesh_squared_distance(points, self.points, self.faces)[0], 0))


@dataclass(frozen=True)
class Seen:
    """Points of a mesh that a camera sees: their rows and columns in the picture, positions and depths."""

    row: np.ndarray
    column: np.ndarray
    points: np.ndarray
    depth: np.ndarray


class Camera:
    """A perspective camera in world coordinates, z up. `fov`: vertical, degrees. `focal`: pixels of a unit at distance 1."""

    def __init__(self, position, target, size, fov):
        self.position, self.target = np.array(position, float), np.array(target, float)
        self.size, self.fov = size, fov
        self.focal = size[1] / 2 / np.tan(np.radians(fov) / 2)
        forward = self.target - self.position
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        self.axes = np.stack([right, np.cross(right, forward), forward])

    def enlarged(self, factor):
        """The same camera with `factor` times as many pixels along each side."""
        return Camera(self.position, self.target, tuple(factor * side for side in self.size), self.fov)

    def options(self):
        """The camera as options of `isopeel extract`."""
        numbers = ",".join(repr(float(x)) for x in [*self.position, *self.target])
        return ["--camera", numbers, "--viewport", f"{self.size[0]}x{self.size[1]}", "--fov", str(self.fov)]

    def in_eye(self, points):
        """Positions as right, up and depth."""
        return (points - self.position) @ self.axes.T

    def rays(self, row, column):
        """Directions of pixels as right, up and depth, the depth being 1."""
        width, height = self.size
        return np.stack([(column + 0.5 - width / 2) / self.focal, (height / 2 - row - 0.5) / self.focal, np.ones(np.shape(row))], -1)

    def buffers(self, mesh):
        """Depth and triangle of each pixel; infinity and -1 where there is none."""
        depth = np.full(self.size[::-1], np.inf)
        triangle = np.full(self.size[::-1], -1)
        fill(self.in_eye(mesh.points), mesh.faces, self.focal, depth, triangle)
        return depth, triangle

    def see(self, mesh, samples=None, seed=1):
        """What is seen of a mesh: at all pixels, or at `samples` random ones."""
        depth, _ = self.buffers(mesh)
        row, column = np.nonzero(np.isfinite(depth))
        if samples is not None and len(row) > samples:
            chosen = np.random.default_rng(seed).choice(len(row), samples, replace=False)
            row, column = row[chosen], column[chosen]
        at = depth[row, column]
        return Seen(row, column, self.position + (self.rays(row, column) * at[:, None]) @ self.axes, at)

    def pixels(self, seen, mesh):
        """Distance of each seen point to a mesh, in pixels at the depth of that point."""
        return mesh.distances(seen.points) * self.focal / seen.depth


def root_mean_square(there, back):
    """Of both directions, which weigh the same."""
    return float(np.sqrt((np.mean(there**2) + np.mean(back**2)) / 2))


@njit(cache=True)
def fill(eye, faces, focal, depth, triangle):
    height, width = depth.shape
    for t in range(len(faces)):
        a, b, c = eye[faces[t, 0]], eye[faces[t, 1]], eye[faces[t, 2]]
        if a[2] <= 1e-6 or b[2] <= 1e-6 or c[2] <= 1e-6:
            continue
        ax, ay = a[0] / a[2] * focal + width / 2, height / 2 - a[1] / a[2] * focal
        bx, by = b[0] / b[2] * focal + width / 2, height / 2 - b[1] / b[2] * focal
        cx, cy = c[0] / c[2] * focal + width / 2, height / 2 - c[1] / c[2] * focal
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0:
            continue
        for y in range(int(max(0, np.floor(min(ay, by, cy)))), int(min(height - 1, np.ceil(max(ay, by, cy)))) + 1):
            for x in range(int(max(0, np.floor(min(ax, bx, cx)))), int(min(width - 1, np.ceil(max(ax, bx, cx)))) + 1):
                u = ((bx - x - 0.5) * (cy - y - 0.5) - (by - y - 0.5) * (cx - x - 0.5)) / area
                v = ((cx - x - 0.5) * (ay - y - 0.5) - (cy - y - 0.5) * (ax - x - 0.5)) / area
                w = 1 - u - v
                if u < 0 or v < 0 or w < 0:
                    continue
                z = 1 / (u / a[2] + v / b[2] + w / c[2])
                if z < depth[y, x]:
                    depth[y, x] = z
                    triangle[y, x] = t
