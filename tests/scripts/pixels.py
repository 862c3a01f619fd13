#!/usr/bin/env python3
"""How far a surface that was made for a camera is off in that camera's picture, in pixels.

    tests/scripts/pixels.py gain VOLUME.nrrd ISO [--budget 50000] [--near 8 16]
    tests/scripts/pixels.py promise VOLUME.nrrd ISO [--cameras 20] [--error 1px]
    tests/scripts/pixels.py picture [--budget 50000] [--output docs/images/camera.webp]

`gain`: the same budget, with uniform detail and cut for the camera, at cameras from which a voxel
covers 4, 8 and 16 pixels. `promise`: the error that was asked for, at random cameras outside of the
surface, without a budget. `picture`: both cuts of the demo volume, near a gyrus, with their edges and
with their error as colour. The truth is the full mesh of the same program. A depth buffer of its own
says what the camera sees; distances of seen points of the truth to the mesh, and of seen points of
the mesh to the truth, are divided by depth. Runs in a virtual environment of its own, made from
fidelity-requirements.txt at the first run.
"""
import argparse
import json
import subprocess
import tempfile
from pathlib import Path

from fidelity.environment import enter_environment

ROOT = Path(__file__).resolve().parent.parent.parent
SAMPLES = 40_000
SIZE, FOV = (1280, 960), 45.0
# Of the picture: the volume as the viewer opens it, and the camera of docs/gallery.md.
DEMO, DEMO_SURFACE, DEMO_TITLE = ROOT / "server/demo", ["--field=t1", "--iso=140"], "MNI152 brain, T1 at 140"
POSITION, TARGET, PICTURE_SIZE, PICTURE_FOV = (95, 20, 80), (27, -8, 52), (900, 600), 32.0

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("what", choices=["gain", "promise", "picture"])
parser.add_argument("volume", type=Path, nargs="?", help="of gain and promise")
parser.add_argument("iso", nargs="?", help="isovalue, of gain and promise")
parser.add_argument("--isopeel", type=Path, default=ROOT / "target/release/isopeel", help="the binary to measure")
parser.add_argument("--budget", type=int, default=50_000, help="triangles [default: 50000]")
parser.add_argument("--near", type=float, nargs="+", default=[4, 8, 16], help="pixels that the nearest voxel covers")
parser.add_argument("--cameras", type=int, default=20)
parser.add_argument("--error", default="1px")
parser.add_argument("--output", type=Path, default=ROOT / "docs/images/camera.webp", help="file of picture")
parser.add_argument("--python", type=Path, help="interpreter that has the requirements, instead of the own environment")
args = parser.parse_args()
if (args.what == "picture") != (args.iso is None):
    parser.error(f"{args.what}: expected {'no volume' if args.what == 'picture' else 'a volume and an isovalue'}")

enter_environment(args.python)

import numpy as np

from fidelity.camera import Camera, Mesh, root_mean_square


class Surface:
    """The surface of a volume, and its full mesh."""

    def __init__(self, folder, volume, *which):
        self.folder, self.volume, self.which = folder, volume, which
        self.full, self.statistics = self.extract("--beta", "-1")
        self.low, self.high = self.full.points.min(0), self.full.points.max(0)
        self.size = np.linalg.norm(self.high - self.low)

    def extract(self, *options):
        """A mesh, and its statistics."""
        path = self.folder / "mesh.ply"
        command = [args.isopeel, "extract", self.volume, *self.which, "--no-measure", "--stats", "--output", path, *options]
        made = subprocess.run([str(word) for word in command], capture_output=True, check=True, text=True)
        return Mesh(path), json.loads(made.stdout)

    def look(self, camera):
        """What a camera sees of the truth."""
        return camera.see(self.full, SAMPLES, seed=1)

    def error(self, camera, truth, mesh):
        """Root mean square and 99.9 % quantile, pixels."""
        there = camera.pixels(truth, mesh)
        back = camera.pixels(camera.see(mesh, SAMPLES, seed=2), self.full)
        return root_mean_square(there, back), float(max(np.quantile(there, 0.999), np.quantile(back, 0.999)))

    def camera_at(self, distance, direction):
        """A camera that looks at the vertex of the surface that is the farthest in a direction, from this distance."""
        nearest = self.full.points[np.argmax(self.full.points @ direction)]
        return Camera(nearest + direction * distance, nearest - direction * self.size / 8, SIZE, FOV)


def gain(folder):
    surface = Surface(folder, args.volume, f"--iso={args.iso}")
    smallest = min(spacings())
    uniform, _ = surface.extract("--triangles", str(args.budget))
    direction = np.array([0.5, -0.8, 0.3]) / np.linalg.norm([0.5, -0.8, 0.3])
    for pixels in args.near:
        focal = SIZE[1] / 2 / np.tan(np.radians(FOV) / 2)
        camera = surface.camera_at(focal * smallest / pixels, direction)
        truth = surface.look(camera)
        mesh, statistics = surface.extract("--triangles", str(args.budget), *camera.options())
        before, after = (surface.error(camera, truth, one) for one in (uniform, mesh))
        voxel = camera.focal * smallest / np.median(truth.depth)
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


def promise(folder):
    surface = Surface(folder, args.volume, f"--iso={args.iso}")
    random = np.random.default_rng(7)
    worst = []
    for n in range(args.cameras):
        direction = random.normal(size=3)
        direction /= np.linalg.norm(direction)
        distance = surface.size * 2.0 ** random.uniform(-5, 1)
        camera = surface.camera_at(distance, direction)
        truth = surface.look(camera)
        mesh, statistics = surface.extract("--error", args.error, *camera.options())
        rms, quantile = surface.error(camera, truth, mesh)
        voxel = camera.focal * min(spacings()) / np.median(truth.depth)
        worst.append(rms)
        print(
            f"{n:2} {voxel:5.1f} px a voxel: rms {rms:.3f}, 99.9 % {quantile:.2f}; stated {statistics['pixels']['within']:.3f} "
            f"by {statistics['pixels']['limitedBy']}, {statistics['triangles']} triangles",
            flush=True,
        )
    print(f"largest {max(worst):.3f}, mean {np.mean(worst):.3f} pixels of {args.error}")


def picture(folder):
    from fidelity.camera_picture import draw, panel

    surface = Surface(folder, DEMO, *DEMO_SURFACE)
    camera = Camera(POSITION, TARGET, PICTURE_SIZE, PICTURE_FOV)
    uniform, _ = surface.extract("--triangles", str(args.budget))
    mesh, _ = surface.extract("--triangles", str(args.budget), *camera.options())
    panels = [
        panel("uniform detail", camera, surface.full, uniform),
        panel("finer where you look", camera, surface.full, mesh),
    ]
    voxel = camera.focal / np.median(camera.see(surface.full).depth)
    width, height = camera.size
    base = f"{DEMO_TITLE}, at most {args.budget:,} of {surface.statistics['fullTriangles']:,} triangles; {width} by {height} pixels, {voxel:.0f} per voxel"
    draw(panels, base, args.output)
    for one in panels:
        print(f"{one.title}: {one.triangles} triangles, rms {one.rms:.3f} pixels, {one.beyond:.2%} of the picture off by more than 1")
    print(f"{panels[0].rms / panels[1].rms:.2f} times as near; {args.output}: {args.output.stat().st_size / 1000:.0f} kB")


with tempfile.TemporaryDirectory() as folder:
    {"gain": gain, "promise": promise, "picture": picture}[args.what](Path(folder))
