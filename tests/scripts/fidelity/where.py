"""Where on the surface a mesh is off: beside block borders, at the walls that close the volume, where the surface is curved."""
import numpy as np
import quality

from fidelity.figures import percent, table
from fidelity.measures import kept, rms, unit

BLOCK = 32
# Voxels from the border of the volume that still belong to a closing wall.
WALL = 3


def curvature(truth, at):
    """The maximum turn of the smooth gradient along four directions of the surface, over 3 voxels, in radians a voxel."""
    normal = unit(truth.smooth_gradient(at))
    across = np.where(np.abs(normal[:, :1]) < 0.9, [[1, 0, 0]], [[0, 1, 0]])
    first = unit(np.cross(normal, across))
    second = np.cross(normal, first)
    last = np.array(truth.volume.shape[::-1]) - 1.001
    turned = np.zeros(len(at))
    for along in (first, second, (first + second) / 2**0.5, (first - second) / 2**0.5):
        ends = [unit(truth.smooth_gradient(np.clip(at + side * along, 0, last))) for side in (1.5, -1.5)]
        turned = np.maximum(turned, np.arccos(np.clip((ends[0] * ends[1]).sum(1), -1, 1)) / 3)
    return turned


def parts_of(truth):
    """Names and masks of parts of the surface, over the samples of the truth."""
    at = truth.samples
    wall = np.minimum(at, np.array(truth.volume.shape[::-1]) - 1 - at).min(1) <= WALL
    border = np.abs(at - BLOCK * np.round(at / BLOCK)).min(1) < 1
    turned = curvature(truth, at)
    curved = turned >= np.quantile(turned[~wall], 0.9)
    return {
        "all": np.full(len(at), True),
        "closing walls": wall,
        "within 1 voxel of a block's border": ~wall & border,
        "the most curved tenth": ~wall & curved,
        "the rest": ~wall & ~border & ~curved,
    }


def by_part(one, share):
    """rms from the surface to each mesh, by part of the surface."""
    truth, count = one.truth, one.wanted(share)
    meshes = [("tree", one.maker.tree(count)), ("fast-simplification", one.maker.fast(count)),
              ("full surface", one.maker.dual()), ("VTK, full", one.maker.vtk_full())]

    def measured(mesh):
        points, faces = quality.read_mesh(mesh, truth.spacing)
        off, _ = quality.distance(truth.samples, points, faces)
        return {name: [float(mask.mean()), rms(off[mask])] for name, mask in parts_of(truth).items()}

    found = [kept(mesh, "by part", lambda mesh=mesh: measured(mesh)) for _, mesh in meshes]
    rows = []
    for name, (area, tree) in found[0].items():
        fast = found[1][name][1]
        rows.append([name, percent(area), f"{tree:.4f}", f"{fast:.4f}", f"{tree / fast:.2f}", *(f"{one[name][1]:.4f}" for one in found[2:])])
    return table(["part", "of the surface", "tree", "fast-simplification", "÷", "full surface", "VTK, full"], rows)
