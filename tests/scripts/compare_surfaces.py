#!/usr/bin/env python3
"""Compares surfaces that drivers made of the same volumes: counts, topology and bits.

    tests/scripts/compare_surfaces.py FOLDER FOLDER...

Each folder holds one driver's surfaces as PLY files of the same names; drivers.sh writes them (STEPS=surfaces). Prints a
table. Exits with 1 when counts or topology differ from those of the first folder; different bits alone are only stated.
"""

import hashlib
import sys
from collections import Counter
from pathlib import Path
from typing import NamedTuple

if {"-h", "--help"} & set(sys.argv[1:]):
    sys.exit(print(__doc__.strip()))

COLUMNS = ["surface", "driver", "triangles", "vertices", "Euler", "parts", "open edges", "edges of 3 or more", "same bits"]


class Surface(NamedTuple):
    """What is compared: equal tuples are equal counts and topology."""

    triangles: int
    vertices: int
    euler: int
    parts: int
    open_edges: int
    shared_edges: int


def read_ply(path: Path) -> tuple[int, memoryview]:
    """Returns the number of vertices, and the corners of the triangles as 32-bit numbers, three each."""
    data = path.read_bytes()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    header = data[:end].decode("ascii").split("\n")
    assert "format binary_little_endian 1.0" in header, f"{path}: expected a little-endian PLY file"
    counts, size, element = {}, 0, ""
    for words in map(str.split, header):
        if words[:1] == ["element"]:
            element = words[1]
            counts[element] = int(words[2])
        elif words[:1] == ["property"] and element == "vertex":
            size += {"float": 4, "uchar": 1, "double": 8}[words[1]]
    faces = data[end + size * counts["vertex"] :]
    # Each face is its number of corners, a byte, and the corners.
    assert len(faces) == 13 * counts["face"] and faces[::13] == bytes([3]) * counts["face"], f"{path}: expected triangles alone"
    corners = bytearray(12 * counts["face"])
    for byte in range(12):
        corners[byte::12] = faces[1 + byte :: 13]
    return counts["vertex"], memoryview(corners).cast("I")


def find(parents: list[int], at: int) -> int:
    """The root of a vertex's part; paths are halved."""
    while parents[at] != at:
        parents[at] = parents[parents[at]]
        at = parents[at]
    return at


def measure(path: Path) -> Surface:
    """Counts and topology of a file."""
    vertices, corners = read_ply(path)
    parents = list(range(vertices))
    edges: Counter[int] = Counter()
    for at in range(0, len(corners), 3):
        a, b, c = corners[at], corners[at + 1], corners[at + 2]
        for start, end in ((a, b), (b, c), (c, a)):
            edges[min(start, end) * vertices + max(start, end)] += 1
        root = find(parents, a)
        parents[find(parents, b)] = root
        parents[find(parents, c)] = root
    triangles = len(corners) // 3
    uses = Counter(edges.values())
    return Surface(
        triangles=triangles,
        vertices=vertices,
        euler=vertices - len(edges) + triangles,
        parts=sum(parent == at for at, parent in enumerate(parents)),
        open_edges=uses[1],
        shared_edges=sum(count for use, count in uses.items() if use > 2),
    )


def main(folders: list[Path]) -> int:
    """Prints the table; returns the exit status."""
    names = sorted(path.name for path in folders[0].glob("*.ply"))
    assert names, f"{folders[0]} holds no surfaces"
    measured: dict[bytes, Surface] = {}
    rows, differing = [COLUMNS], 0
    for name in names:
        first = None
        for folder in folders:
            path = folder / name
            if not path.exists():
                rows.append([name, folder.name, "none"] + [""] * 6)
                differing += 1
                continue
            digest = hashlib.sha256(path.read_bytes()).digest()
            # The same bytes are measured once.
            if digest not in measured:
                measured[digest] = measure(path)
            first = first or digest
            rows.append([name, folder.name, *map(str, measured[digest]), "yes" if digest == first else "no"])
            differing += measured[digest] != measured[first]
    widths = [max(len(row[column]) for row in rows) for column in range(len(COLUMNS))]
    for row in rows:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip())
    print(f"{differing} surfaces differ from those of {folders[0].name} in counts or topology")
    return int(differing > 0)


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    sys.exit(main([Path(argument) for argument in sys.argv[1:]]))
