#!/usr/bin/env python3
"""Draws the figures of algorithm.md as SVG files in docs/images.

    python3 docs/drawings.py           writes them
    python3 docs/drawings.py --check   fails when a committed file differs

Standard library only; the same input gives the same bytes. Colours follow the reader's light or dark scheme.
"""

import argparse
import pathlib
import re
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent
IMAGES = ROOT / "docs" / "images"

STYLE = """
svg { --paper: #ffffff; --ink: #24292f; --muted: #6e7781; --grid: #c3c9d0; --fill: #eef1f4;
      --x: #c2410c; --y: #15803d; --z: #1d4ed8; --accent: #b45309; --soft: #fbe3b5; --inside: #1d4ed8; --within: #d6e4ff; }
@media (prefers-color-scheme: dark) {
  svg { --paper: #0d1117; --ink: #e6edf3; --muted: #9aa4af; --grid: #3d444d; --fill: #1b2129;
        --x: #ff9b6a; --y: #5fd38d; --z: #8db4ff; --accent: #f0b429; --soft: #4d3a10; --inside: #8db4ff; --within: #1b315c; } }
.paper { fill: var(--paper); }
text { font: 15px system-ui, "DejaVu Sans", sans-serif; fill: var(--ink); text-anchor: middle; }
.title { font-weight: 600; }
.small { font-size: 13px; fill: var(--muted); }
.left { text-anchor: start; }
.number { font-weight: 600; dominant-baseline: central; }
.line { stroke: var(--ink); stroke-width: 1.6; fill: none; stroke-linecap: round; stroke-linejoin: round; }
.thin { stroke: var(--grid); stroke-width: 1; fill: none; }
.hidden { stroke: var(--muted); stroke-width: 1.3; stroke-dasharray: 4 4; fill: none; }
.face { fill: var(--fill); stroke: none; }
.marked { fill: var(--soft); stroke: var(--accent); stroke-width: 1.8; stroke-linejoin: round; }
.guide { stroke: var(--accent); stroke-width: 1; stroke-dasharray: 3 4; fill: none; }
.sample { fill: var(--ink); }
.x { stroke: var(--x); } .y { stroke: var(--y); } .z { stroke: var(--z); }
.tx { fill: var(--x); } .ty { fill: var(--y); } .tz { fill: var(--z); }
.axis { stroke-width: 2.4; fill: none; stroke-linecap: round; }
.badge { fill: var(--paper); stroke: var(--ink); stroke-width: 1.4; }
.badge.far { stroke: var(--muted); stroke-dasharray: 3 3; }
.tag { fill: var(--paper); }
.inside { fill: var(--inside); stroke: var(--inside); stroke-width: 1.6; }
.outside { fill: var(--paper); stroke: var(--ink); stroke-width: 1.6; }
.within { fill: var(--within); stroke: none; }
.surface { stroke: var(--accent); stroke-width: 3; fill: none; stroke-linecap: round; }
.vertex { fill: var(--accent); stroke: var(--paper); stroke-width: 1.5; }
.polygon { fill: var(--soft); fill-opacity: 0.75; stroke: var(--accent); stroke-width: 2.2; stroke-linejoin: round; }
.end { fill: var(--ink); stroke: var(--paper); stroke-width: 2; }
"""


def number(value):
    """A coordinate with at most one decimal."""
    text = f"{value:.1f}"
    return text[:-2] if text.endswith(".0") else text


def points(corners):
    return " ".join(f"{number(x)},{number(y)}" for x, y in corners)


class Drawing:
    """Collects SVG elements."""

    def __init__(self, width, height, title):
        self.size = (width, height)
        self.title = title
        self.parts = []

    def add(self, element):
        self.parts.append(element)

    def line(self, a, b, kind="line"):
        self.add(
            f'<line class="{kind}" x1="{number(a[0])}" y1="{number(a[1])}" x2="{number(b[0])}" y2="{number(b[1])}"/>'
        )

    def polygon(self, corners, kind):
        self.add(f'<polygon class="{kind}" points="{points(corners)}"/>')

    def path(self, corners, kind):
        self.add(f'<polyline class="{kind}" points="{points(corners)}"/>')

    def circle(self, at, radius, kind):
        self.add(f'<circle class="{kind}" cx="{number(at[0])}" cy="{number(at[1])}" r="{number(radius)}"/>')

    def text(self, at, words, kind=""):
        kind = f' class="{kind}"' if kind else ""
        self.add(f'<text{kind} x="{number(at[0])}" y="{number(at[1])}">{words}</text>')

    def tagged(self, at, words, kind):
        """A number on a patch of background, so that no line runs through it."""
        half = 6 + 4.5 * len(words)
        self.add(
            f'<rect class="tag" x="{number(at[0] - half)}" y="{number(at[1] - 10)}" '
            f'width="{number(2 * half)}" height="20" rx="5"/>'
        )
        self.text(at, words, f"number {kind}")

    def svg(self):
        width, height = self.size
        head = (
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" '
            f'viewBox="0 0 {width} {height}" role="img">'
        )
        body = [f"<title>{self.title}</title>", f"<style>{STYLE}</style>"]
        body.append(f'<rect class="paper" width="{width}" height="{height}" rx="8"/>')
        return "\n".join([head, *body, *self.parts, "</svg>"]) + "\n"


class View:
    """A parallel projection: x to the right and a little down, y to the right and up, z up."""

    X, Y, Z = (0.86, 0.26), (0.55, -0.38), (0.0, -1.0)

    def __init__(self, origin, scale):
        self.origin, self.scale = origin, scale

    def __call__(self, x, y, z):
        across = x * self.X[0] + y * self.Y[0] + z * self.Z[0]
        down = x * self.X[1] + y * self.Y[1] + z * self.Z[1]
        return self.origin[0] + self.scale * across, self.origin[1] + self.scale * down


def corner_offset(corner):
    return corner & 1, corner >> 1 & 1, corner >> 2 & 1


def edge_corners(edge):
    """The low and the high corner of an edge: edge = 4 axis + u + 2 v."""
    axis = edge // 4
    low = (edge & 1) << (axis + 1) % 3 | (edge >> 1 & 1) << (axis + 2) % 3
    return low, low | 1 << axis


def check_numbering():
    """The numbering drawn here is the kernels': their packed table of low corners holds the same."""
    packed = None
    for header in sorted((ROOT / "kernels" / "cl").rglob("*.h")):
        found = re.search(r"uint edge_low_corner\(uint edge\)\s*\{[^}]*?\(0x([0-9a-f]+)ul", header.read_text())
        if found:
            packed = int(found.group(1), 16)
    if packed is None:
        sys.exit("drawings: edge_low_corner was not found in kernels/cl")
    for edge in range(12):
        if packed >> 4 * edge & 7 != edge_corners(edge)[0]:
            sys.exit(f"drawings: edge {edge} begins at another corner in kernels/cl")


def box(view, low, high):
    """Corners of a box, by corner number."""
    return [view(*(high[i] if corner_offset(c)[i] else low[i] for i in range(3))) for c in range(8)]


def outline(drawing, corners, hidden=True):
    """Edges of a box; those behind are dashed."""
    for edge in range(12):
        low, high = edge_corners(edge)
        behind = 2 in (low, high)  # the corner that all hidden edges share
        if behind and not hidden:
            continue
        drawing.line(corners[low], corners[high], "hidden" if behind else "line")


def faces(drawing, view, low, high, kind):
    """The three visible faces of a box."""
    c = box(view, low, high)
    drawing.polygon([c[0], c[1], c[5], c[4]], kind)
    drawing.polygon([c[1], c[3], c[7], c[5]], kind)
    drawing.polygon([c[4], c[5], c[7], c[6]], kind)


def grid(drawing, view, n):
    """Lines between n^3 parts on the visible faces of the unit box."""
    for i in range(1, n):
        t = i / n
        drawing.path([view(t, 0, 0), view(t, 0, 1), view(t, 1, 1)], "thin")
        drawing.path([view(0, 0, t), view(1, 0, t), view(1, 1, t)], "thin")
        drawing.path([view(1, t, 0), view(1, t, 1), view(0, t, 1)], "thin")


def cube_brick_region():
    d = Drawing(860, 360, "A cell, a brick of 8 by 8 by 8 cells and a region of 4 by 4 by 4 bricks")
    cell, brick, region = View((60, 200), 70), View((270, 225), 125), View((560, 250), 165)
    parts = [(cell, 1, None), (brick, 8, 1 / 8), (region, 4, 1 / 4)]
    for view, n, part in parts:
        faces(d, view, (0, 0, 0), (1, 1, 1), "face")
        if n > 1:
            grid(d, view, n)
            low, high = (1 - part, 0, 1 - part), (1, part, 1)
            faces(d, view, low, high, "marked")
        outline(d, box(view, (0, 0, 0), (1, 1, 1)), hidden=n == 1)
    for c in range(8):
        d.circle(cell(*corner_offset(c)), 4, "sample")
    # The marked part of each is the box to its left.
    for view, part, left in ((brick, 1 / 8, cell), (region, 1 / 4, brick)):
        d.line(left(1, 1, 1), view(1 - part, part, 1), "guide")
        d.line(left(1, 0, 0), view(1 - part, 0, 1 - part), "guide")
    for x, title, words in (
        (110, "cell: level 0", "8 samples at its corners"),
        (355, "brick: level 3", "8 × 8 × 8 cells"),
        (680, "region: level 5", "32 × 32 × 32 cells = 4 × 4 × 4 bricks"),
    ):
        d.text((x, 325), title, "title")
        d.text((x, 346), words, "small")
    return d


def cube_numbering():
    d = Drawing(860, 420, "Numbers of the corners, edges and faces of a cube")
    view = View((70, 290), 185)
    c = box(view, (0, 0, 0), (1, 1, 1))
    for edge in range(12):
        low, high = edge_corners(edge)
        dash = ' stroke-dasharray="5 5"' if 2 in (low, high) else ""
        a, b = c[low], c[high]
        d.add(
            f'<line class="axis {"xyz"[edge // 4]}"{dash} x1="{number(a[0])}" y1="{number(a[1])}" '
            f'x2="{number(b[0])}" y2="{number(b[1])}"/>'
        )
    for edge in range(12):
        low, high = edge_corners(edge)
        # Edges 1 and 10 are behind others in their middle.
        t = {1: 0.72, 10: 0.32}.get(edge, 0.5)
        at = tuple(c[low][i] + t * (c[high][i] - c[low][i]) for i in range(2))
        d.tagged(at, str(edge), f"t{'xyz'[edge // 4]}")
    for corner in range(8):
        d.circle(c[corner], 13, "badge")
        d.text(c[corner], str(corner), "number")
    d.text((204, 400), "corners (in circles) and edges", "title")

    view = View((525, 290), 185)
    c = box(view, (0, 0, 0), (1, 1, 1))
    faces(d, view, (0, 0, 0), (1, 1, 1), "face")
    outline(d, c)
    # Numbers of the faces at the back stand outside the cube.
    outside = {0: view(-0.62, 0.5, 0.62), 3: view(0.62, 1.75, 0.75), 4: view(0.4, 0.5, -0.42)}
    for face in range(6):
        axis, side = face // 2, face & 1
        at = [0.5, 0.5, 0.5]
        at[axis] = side
        middle = view(*at)
        label = outside.get(face, middle)
        if face in outside:
            d.line(label, middle, "guide")
            d.circle(middle, 3, "vertex")
        d.circle(label, 14, "badge far" if face in outside else "badge")
        d.text(label, str(face), f"number t{'xyz'[axis]}")
    d.text((654, 400), "faces (dashed: at the back)", "title")

    o = View((400, 340), 46)
    for axis, end in enumerate(((1, 0, 0), (0, 1, 0), (0, 0, 1))):
        a, b = o(0, 0, 0), o(*end)
        d.line(a, b, f"axis {'xyz'[axis]}")
        label = o(*(1.28 * v for v in end))
        d.text(label, "xyz"[axis], f"number t{'xyz'[axis]}")
    return d


def minimal_edge():
    d = Drawing(860, 380, "The leaves around a minimal edge, seen along the edge, and the polygon that joins their vertices")
    size = 74

    def panel(left, leaves, title, words):
        # Leaves: low corner and size in fine cells from the edge, vertex inside, label of the places that it takes.
        at = lambda u, v: (left + size * u, 158 - size * v)
        for (u, v), n, _, _ in leaves:
            d.polygon([at(u, v), at(u + n, v), at(u + n, v + n), at(u, v + n)], "face")
        d.polygon([at(*vertex) for _, _, vertex, _ in leaves], "polygon")
        for (u, v), n, vertex, _ in leaves:
            d.path([at(u, v), at(u + n, v), at(u + n, v + n), at(u, v + n), at(u, v)], "line")
        for (u, v), n, vertex, (label, lu, lv) in leaves:
            d.circle(at(*vertex), 6, "vertex")
            d.text(at(lu, lv), label, "small")
        d.circle(at(0, 0), 7, "end")
        low = min(u for (u, _), _, _, _ in leaves)
        middle = left + size * (low + 1) / 2
        d.text((middle, 340), title, "title")
        d.text((middle, 361), words, "small")

    panel(
        130,
        [
            ((0, 0), 1, (0.55, 0.40), ("k = 0", 0.62, 0.78)),
            ((-1, 0), 1, (-0.42, 0.52), ("k = 1", -0.62, 0.78)),
            ((-1, -1), 1, (-0.58, -0.46), ("k = 3", -0.62, -0.88)),
            ((0, -1), 1, (0.45, -0.55), ("k = 2", 0.62, -0.88)),
        ],
        "four leaves: a quad",
        "order around the edge: 0 1 3 2",
    )
    panel(
        445,
        [
            ((0, 0), 1, (0.55, 0.40), ("k = 0", 0.62, 0.78)),
            ((-1, 0), 1, (-0.42, 0.52), ("k = 1", -0.62, 0.78)),
            ((-2, -2), 2, (-0.85, -0.80), ("k = 3, coarser", -1.0, -1.82)),
            ((0, -1), 1, (0.45, -0.55), ("k = 2", 0.62, -0.88)),
        ],
        "four leaves, one coarser: a quad",
        "no leaf around the edge is finer",
    )
    panel(
        740,
        [
            ((0, 0), 1, (0.55, 0.40), ("k = 0", 0.62, 0.78)),
            ((-2, -1), 2, (-0.95, 0.10), ("k = 1 and 3", -1.0, 0.78)),
            ((0, -1), 1, (0.45, -0.55), ("k = 2", 0.62, -0.88)),
        ],
        "three leaves: a triangle",
        "the coarser leaf takes two places",
    )
    d.text((20, 32), "Seen along the minimal edge (large dot). Squares: leaves. Orange: their vertices and the polygon.", "left")
    return d


def ambiguous_face():
    d = Drawing(860, 630, "An ambiguous face: contours and the dual mesh for both pairings")
    size = 170
    # Corners of the face; inside are the two on a diagonal.
    corners = {(0, 0): True, (1, 0): False, (1, 1): True, (0, 1): False}
    low, right, high, left_side = (0.52, 0), (1, 0.45), (0.48, 1), (0, 0.55)

    def square(left, top):
        return lambda p: (left + size * p[0], top + size * (1 - p[1]))

    def frame(at):
        d.path([at(p) for p in ((0, 0), (1, 0), (1, 1), (0, 1), (0, 0))], "line")

    def signs(at):
        for p, inside in corners.items():
            d.circle(at(p), 8, "inside" if inside else "outside")

    at = square(130, 70)
    d.polygon([at(p) for p in ((0, 0), low, left_side)], "within")
    d.polygon([at(p) for p in ((1, 1), high, right)], "within")
    frame(at)
    d.line(at(low), at(left_side), "surface")
    d.line(at(high), at(right), "surface")
    signs(at)
    d.text((215, 278), "inside corners separated", "title")
    d.text((215, 299), "the rule of all tables", "small")

    at = square(560, 70)
    d.polygon([at(p) for p in ((0, 0), low, right, (1, 1), high, left_side)], "within")
    frame(at)
    d.line(at(low), at(right), "surface")
    d.line(at(high), at(left_side), "surface")
    signs(at)
    d.text((645, 278), "flipped: outside corners separated", "title")
    d.text((645, 299), "only in one of two cells, where both join the face", "small")

    def spokes(at, hubs):
        frame(at)
        for hub, ends in hubs:
            for end in ends:
                d.line(at(hub), at(end), "surface")
        signs(at)
        for hub, _ in hubs:
            d.circle(at(hub), 8, "vertex")

    at = square(130, 375)
    spokes(at, [((0.5, 0.5), (low, right, high, left_side))])
    d.text((215, 583), "not flipped: one mesh edge, four polygons", "title")
    d.text((215, 604), "one vertex in the cell before and one behind the face", "small")

    at = square(560, 375)
    spokes(at, [((0.68, 0.30), (low, right)), ((0.32, 0.70), (high, left_side))])
    d.text((645, 583), "flipped: two mesh edges, two polygons each", "title")
    d.text((645, 604), "two vertices in the cell before the face: a manifold", "small")

    d.text((20, 34), "The face with its contour. Filled corners are inside.", "left")
    d.text((20, 348), "The dual mesh, seen through the face: mesh edges end-on (dots), the polygons that meet there (lines).", "left")
    return d


DRAWINGS = {
    "cube-brick-region": cube_brick_region,
    "cube-numbering": cube_numbering,
    "minimal-edge": minimal_edge,
    "ambiguous-face": ambiguous_face,
}


def main():
    parser = argparse.ArgumentParser(description="Draws the figures of docs/algorithm.md.")
    parser.add_argument("--check", action="store_true", help="write nothing, fail when a committed file differs")
    check = parser.parse_args().check
    check_numbering()
    stale = []
    for name, draw in DRAWINGS.items():
        path, svg = IMAGES / f"{name}.svg", draw().svg()
        if check:
            if not path.is_file() or path.read_text() != svg:
                stale.append(str(path.relative_to(ROOT)))
        else:
            path.write_text(svg)
    if stale:
        sys.exit(f"stale: {', '.join(stale)}; run python3 docs/drawings.py")


if __name__ == "__main__":
    main()
