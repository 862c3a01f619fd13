#!/usr/bin/env python3
"""Counts of cuts in float64, written from docs/algorithm.md (sections 1 to 4) alone: no table, kernel or twin is shared.

    expected_cuts.py FIXTURE [FOLDER]    recomputes every line from the volumes in FOLDER and compares
    expected_cuts.py --synthetic         prints the lines of tests/fixtures/expected-cuts-synthetic.jsonl

Needs numpy. Guards are off and the transfer function is the identity.
"""

import gzip
import json
import sys
from functools import cache
from pathlib import Path

if {"-h", "--help"} & set(sys.argv[1:]):
    sys.exit(print(__doc__.strip()))

import numpy as np

LEVELS = 6
CORNERS = [(b & 1, b >> 1 & 1, b >> 2 & 1) for b in range(8)]


def triangles_of_case(signs):
    """Triangles of a case with inside corners separated on ambiguous faces: a contour of k crossings gives k - 2.

    Contours on the cube's surface, a sphere, divide it into one part more than there are contours. The parts are groups of
    inside corners, joined by edges, and of outside corners, joined by edges and across ambiguous faces.
    """
    inside = [signs >> b & 1 for b in range(8)]

    def ambiguous(a, b):
        """Whether a and b lie diagonally on a face whose other two corners have the other sign."""
        differ = a ^ b
        if bin(differ).count("1") != 2:
            return False
        bit = differ & -differ
        return inside[a ^ bit] != inside[a] and inside[b ^ bit] != inside[a]

    def parts(sign):
        group = {b: b for b in range(8) if inside[b] == sign}
        for a in group:
            for b in group:
                if bin(a ^ b).count("1") == 1 or (sign == 0 and ambiguous(a, b)):
                    old, new = group[a], group[b]
                    group.update({c: new for c in group if group[c] == old})
        return len(set(group.values()))

    crossed = sum(inside[a] != inside[a | bit] for a in range(8) for bit in (1, 2, 4) if not a & bit)
    return crossed - 2 * (parts(1) + parts(0) - 1) if crossed else 0


TRIANGLES = np.array([triangles_of_case(signs) for signs in range(256)])
assert TRIANGLES.sum() == 820 and TRIANGLES.max() == 5


def corners(values):
    """The 8 corner values of every cell; axes are z, y, x."""
    nz, ny, nx = (n - 1 for n in values.shape)
    return [values[dz : dz + nz, dy : dy + ny, dx : dx + nx] for dx, dy, dz in CORNERS]


class Surface:
    """Sums over the active cells of one isovalue, by level."""

    def __init__(self, values, spacing, iso, feature=None):
        self.values, self.iso = values, iso
        corner = corners(values)
        signs = sum((c >= iso).astype(int) << b for b, c in enumerate(corner))
        missing = sum(np.isnan(c) for c in corner) > 0
        active = ~missing & (signs != 0) & (signs != 255)
        self.cells = np.argwhere(active)
        self.triangles = TRIANGLES[signs[active]]
        gradient = []
        for axis in range(3):
            high = sum(c[active] for b, c in enumerate(corner) if b >> axis & 1)
            low = sum(c[active] for b, c in enumerate(corner) if not b >> axis & 1)
            gradient.append((high - low) / 4 / spacing[axis])
        gradient = np.stack(gradient, axis=1)
        length = np.linalg.norm(gradient, axis=1, keepdims=True)
        gradient = np.divide(gradient, length, out=np.zeros_like(gradient), where=length > 0)
        n = self.triangles.astype(float)
        f = np.zeros(len(n)) if feature is None else sum(c[active] for c in corners(feature)) / 8
        moments = np.column_stack([n, n[:, None] * gradient, n * (gradient**2).sum(axis=1), n * f])
        with_missing = np.argwhere(missing)
        self.levels = []
        for level in range(LEVELS):
            cubes, below = np.unique(self.cells >> level, axis=0, return_inverse=True)
            sums = np.zeros((len(cubes), moments.shape[1]))
            np.add.at(sums, below.ravel(), moments)
            banned = {tuple(cube) for cube in np.unique(with_missing >> level, axis=0)}
            banned = np.array([tuple(cube) in banned for cube in cubes], dtype=bool)
            self.levels.append((cubes, below.ravel(), sums, banned))

    def count(self, alpha, beta, feature_range):
        """Leaves of each level, and triangles of marching cubes on them."""
        undecided = np.ones(len(self.cells), dtype=bool)
        leaves, triangles = [0] * LEVELS, 0
        for level in range(LEVELS - 1, 0, -1):
            cubes, below, sums, banned = self.levels[level]
            n = sums[:, 0]
            mean = sums[:, 1:4] / n[:, None]
            variance = np.maximum(sums[:, 4] / n - (mean**2).sum(axis=1), 0)
            importance = (1 - alpha) * (1 - 1 / (1 + variance))
            if alpha:
                low, high = feature_range
                importance += alpha * np.clip((abs(sums[:, 5] / n) - low) / (high - low), 0, 1)
            decimated = (importance <= beta) & ~banned
            chosen = np.unique(below[undecided & decimated[below]])
            undecided &= ~decimated[below]
            leaves[level] = len(chosen)
            low = cubes[chosen] << level
            high = np.minimum(low + (1 << level), np.array(self.values.shape) - 1)
            signs = np.zeros(len(chosen), dtype=int)
            for b, (dx, dy, dz) in enumerate(CORNERS):
                at = np.where(np.array([dz, dy, dx], dtype=bool), high, low)
                signs |= (self.values[tuple(at.T)] >= self.iso).astype(int) << b
            triangles += TRIANGLES[signs].sum()
        leaves[0] = undecided.sum()
        return [int(n) for n in leaves], int(triangles + self.triangles[undecided].sum())


def nifti(path):
    data = gzip.decompress(path.read_bytes())
    dims, spacing = np.frombuffer(data, "<i2", 3, 42), np.frombuffer(data, "<f4", 3, 80)
    kind = {2: "u1", 4: "<i2"}[np.frombuffer(data, "<i2", 1, 70)[0]]
    start = int(np.frombuffer(data, "<f4", 1, 108)[0])
    values = np.frombuffer(data, kind, int(np.prod(dims.astype(int))), start)
    return values.reshape(dims[::-1]).astype(float), spacing.astype(float)


def nrrd(path):
    header, data = path.read_bytes().split(b"\n\n", 1)
    fields = dict(line.split(": ", 1) for line in header.decode().splitlines() if ": " in line)
    dims = [int(n) for n in fields["sizes"].split()]
    kind = {"uint8": "u1", "int16": "<i2"}[fields["type"]]
    values = np.frombuffer(gzip.decompress(data), kind).reshape(dims[::-1]).astype(float)
    return values, [float(n) for n in fields["spacings"].split()]


def synthetic(name):
    """Volumes of formulas; kernels/reference/tests/expected_cuts/synthetic.rs has the same, bit for bit."""
    dims = (47, 41, 37)
    z, y, x = np.meshgrid(*(np.arange(n) for n in reversed(dims)), indexing="ij")
    if name.startswith("ball"):
        dx, dy, dz = x - 23.25, y - 19.125, (z - 17.75) * 1.5
        values = np.floor(1000 - 60 * np.sqrt(dx * dx + dy * dy + dz * dz))
        if name == "ball with holes":
            values[values % 50 == 3] = np.nan
        return values, (1, 1, 1.5)
    if name == "waves":
        wave = lambda at, half: abs(at % (2 * half) - half)
        return 2.0 * (wave(x, 7) * wave(y, 5) + wave(z, 6) * wave(x + y, 9)), (1, 1, 1.5)
    if name == "rough":
        noise = (x * 73856093 ^ y * 19349663 ^ z * 83492791) * 2654435761 % 2**32 >> 24
        values = (3 * x - y + 2 * z - 80) + noise / 32
        values[(7 * x + 13 * y + 29 * z) % 997 == 0] = np.nan
        return values, (0.5, 1, 2)
    raise ValueError(name)


SETTINGS = [
    # volume, isovalue, feature and its range, (α, β)
    ("ball", 250, None, None, [(0, -1), (0, 0.005), (0, 0.02), (0, 0.07), (0, 0.3)]),
    ("ball", 250, "waves", [0, 120], [(0.35, 0.08), (1, 0.3)]),
    ("ball with holes", 250, None, None, [(0, -1), (0, 0.02), (0, 0.07)]),
    ("waves", 61, None, None, [(0, -1), (0, 0.03), (0, 0.2)]),
    ("rough", 0.25, None, None, [(0, -1), (0, 0.015), (0, 0.04), (0, 0.1)]),
]


@cache
def surface_of(load, name, iso, feature):
    values, spacing = load(name)
    return Surface(values, spacing, iso, None if feature is None else load(feature)[0])


def line(name, load, iso, alpha, feature, feature_range, beta):
    surface = surface_of(load, name, iso, feature)
    leaves, triangles = surface.count(alpha, beta, feature_range)
    return {
        "volume": name,
        "dims_xyz": list(surface.values.shape[::-1]),
        "iso": iso,
        "alpha": alpha,
        "feature": feature,
        "feature_range": feature_range,
        "beta": beta,
        "full_triangles": int(surface.triangles.sum()),
        "active_cells": len(surface.cells),
        "leaves_per_level": leaves,
        "decimated_triangles": triangles,
    }


def main():
    if sys.argv[1:] == ["--synthetic"]:
        for name, iso, feature, feature_range, cuts in SETTINGS:
            for alpha, beta in cuts:
                print(json.dumps(line(name, synthetic, iso, alpha, feature, feature_range, beta)))
        return 0
    if len(sys.argv) not in (2, 3):
        print(__doc__, file=sys.stderr)
        return 2

    def load(name):
        if len(sys.argv) == 2:
            return synthetic(name)
        path = Path(sys.argv[2]) / name
        return nrrd(path) if path.suffix == ".nrrd" else nifti(path)

    wrong = 0
    for text in Path(sys.argv[1]).read_text().splitlines():
        want = json.loads(text)
        settings = [want[key] for key in ("iso", "alpha", "feature", "feature_range", "beta")]
        got = line(want["volume"], load, *settings)
        for key in want:
            if got[key] != want[key]:
                print(f"{want['volume']} at {want['iso']}, beta {want['beta']}: {key} {got[key]}, expected {want[key]}")
                wrong += 1
    print(f"{wrong} differences")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
