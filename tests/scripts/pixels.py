#!/usr/bin/env python3
"""How far a surface that was made for a camera is off in that camera's picture, in pixels.

    tests/scripts/pixels.py gain VOLUME.nrrd ISO [--budget 50000] [--near 8 16]
    tests/scripts/pixels.py promise VOLUME.nrrd ISO [--cameras 20] [--error 1px]

`gain`: the same budget, cut alike everywhere and cut for the camera, at cameras from which a voxel covers 4, 8 and 16 pixels. `promise`: the error
that was asked for, at random cameras outside of the surface, without a budget. The truth is the full mesh of the same program. A depth
buffer of its own says what the camera sees; distances of seen points of the truth to the mesh, and of seen points of the mesh to the
truth, are divided by depth. Needs numpy, numba, libigl and trimesh.
"""
import argparse
import json
import subprocess
import tempfile
from pathlib import Path

import igl
import numpy as np
import trimesh
from numba import njit

ROOT = Path(__file__).resolve().parent.parent.parent
SAMPLES = 40_000
WIDTH, HEIGHT, FOV = 1280, 960, 45.0

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("what", choices=["gain", "promise"])
parser.add_argument("volume", type=Path)
parser.add_argument("iso")
parser.add_argument("--isopeel", type=Path, default=ROOT / "target/release/isopeel")
parser.add_argument("--budget", type=int, default=50_000)
parser.add_argument("--near", type=float, nargs="+", default=[4, 8, 16])
parser.add_argument("--cameras", type=int, default=20)
parser.add_argument("--error", default="1px")
args = parser.parse_args()


class Camera:
    """A camera in the world. `focal`: pixels of a unit at distance 1."""

    def __init__(self, position, target):
        self.position, self.target = np.array(position, float), np.array(target, float)
        self.focal = HEIGHT / 2 / np.tan(np.radians(FOV) / 2)
        forward = self.target - self.position
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        self.axes = np.stack([right, np.cross(right, forward), forward])

    def options(self):
        numbers = ",".join(repr(float(x)) for x in [*self.position, *self.target])
        return ["--camera", numbers, "--viewport", f"{WIDTH}x{HEIGHT}", "--fov", str(FOV)]

    def depths(self, points, faces):
        depth = np.full((HEIGHT, WIDTH), np.inf)
        fill((points - self.position) @ self.axes.T, faces, self.focal, depth)
        return depth

    def seen(self, depth, seed):
        """Some of the points that a depth buffer shows, and their depths."""
        y, x = np.nonzero(np.isfinite(depth))
        if len(y) > SAMPLES:
            some = np.random.default_rng(seed).choice(len(y), SAMPLES, replace=False)
            y, x = y[some], x[some]
        at = depth[y, x]
        ray = np.stack([(x + 0.5 - WIDTH / 2) / self.focal, (HEIGHT / 2 - y - 0.5) / self.focal, np.ones(len(x))], 1)
        return self.position + (ray * at[:, None]) @ self.axes, at


@njit(cache=True)
def fill(eye, faces, focal, depth):
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


class Mesh:
    def __init__(self, path):
        mesh = trimesh.load(path, process=False, force="mesh")
        self.points, self.faces = np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int64)

    def distances(self, seen_points):
        return np.sqrt(np.maximum(igl.point_mesh_squared_distance(seen_points, self.points, self.faces)[0], 0))


class Surface:
    """The surface of a volume, and its full mesh."""

    def __init__(self, folder):
        self.folder = folder
        self.full, _ = self.extract("--beta", "-1")
        self.low, self.high = self.full.points.min(0), self.full.points.max(0)
        self.size = np.linalg.norm(self.high - self.low)

    def extract(self, *options):
        path = self.folder / "mesh.ply"
        command = [args.isopeel, "extract", args.volume, "--iso", args.iso, "--no-measure", "--stats", "--output", path, *options]
        made = subprocess.run([str(word) for word in command], capture_output=True, check=True, text=True)
        return Mesh(path), json.loads(made.stdout)

    def look(self, camera):
        """What a camera sees of the truth: depths, seen points and their depths."""
        depth = camera.depths(self.full.points, self.full.faces)
        return depth, *camera.seen(depth, 1)

    def error(self, camera, looked, mesh):
        """Root mean square and 99.9 % quantile, pixels."""
        _, seen_points, at = looked
        there = mesh.distances(seen_points) * camera.focal / at
        seen, seen_at = camera.seen(camera.depths(mesh.points, mesh.faces), 2)
        back = self.full.distances(seen) * camera.focal / seen_at
        rms = np.sqrt((np.mean(there**2) + np.mean(back**2)) / 2)
        return float(rms), float(max(np.quantile(there, 0.999), np.quantile(back, 0.999)))

    def camera_at(self, distance, direction):
        """A camera that looks at the vertex of the surface that is the farthest in a direction, from this distance."""
        nearest = self.full.points[np.argmax(self.full.points @ direction)]
        return Camera(nearest + direction * distance, nearest - direction * self.size / 8)


def gain(surface):
    smallest = min(spacings())
    uniform, _ = surface.extract("--triangles", str(args.budget))
    direction = np.array([0.5, -0.8, 0.3]) / np.linalg.norm([0.5, -0.8, 0.3])
    for pixels in args.near:
        focal = HEIGHT / 2 / np.tan(np.radians(FOV) / 2)
        camera = surface.camera_at(focal * smallest / pixels, direction)
        looked = surface.look(camera)
        mesh, statistics = surface.extract("--triangles", str(args.budget), *camera.options())
        before, after = (surface.error(camera, looked, one) for one in (uniform, mesh))
        voxel = camera.focal * smallest / np.median(looked[2])
        print(
            f"{voxel:5.1f} px a voxel (nearest {pixels:.0f}): uniform {before[0]:.3f}, camera {after[0]:.3f}, ratio {before[0] / after[0]:.2f}; "
            f"99.9 %: {before[1]:.2f}, {after[1]:.2f}; stated {statistics['pixels']['within']:.3f} by {statistics['pixels']['limitedBy']}, "
            f"{statistics['triangles']} triangles",
            flush=True,
        )


def spacings():
    for line in args.volume.read_bytes()[:4096].split(b"\n"):
        if line.startswith(b"spacings:"):
            return [float(x) for x in line.split()[1:]]
    return [1.0]


def promise(surface):
    random = np.random.default_rng(7)
    worst = []
    for n in range(args.cameras):
        direction = random.normal(size=3)
        direction /= np.linalg.norm(direction)
        distance = surface.size * 2.0 ** random.uniform(-5, 1)
        camera = surface.camera_at(distance, direction)
        looked = surface.look(camera)
        mesh, statistics = surface.extract("--error", args.error, *camera.options())
        rms, quantile = surface.error(camera, looked, mesh)
        voxel = camera.focal * min(spacings()) / np.median(looked[2])
        worst.append(rms)
        print(
            f"{n:2} {voxel:5.1f} px a voxel: rms {rms:.3f}, 99.9 % {quantile:.2f}; stated {statistics['pixels']['within']:.3f} "
            f"by {statistics['pixels']['limitedBy']}, {statistics['triangles']} triangles",
            flush=True,
        )
    print(f"largest {max(worst):.3f}, mean {np.mean(worst):.3f} pixels of {args.error}")


with tempfile.TemporaryDirectory() as folder:
    {"gain": gain, "promise": promise}[args.what](Surface(Path(folder)))
