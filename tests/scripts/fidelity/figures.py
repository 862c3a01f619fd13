"""The tables of the page: each function measures what its table needs and returns the lines."""
import json

from volumes import read_nrrd

from fidelity.measures import self_intersections, topology_of

TREE, MESHOPT, FAST = "isopeel, vertex tree", "VTK + meshopt_simplify", "VTK + fast-simplification"


def table(head, rows):
    """Markdown; the first column and those of names are to the left."""
    sides = ["---" if column in ("volume", "method", "part") else "---:" for column in head]
    lines = [head, sides, *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines) + "\n"


def percent(share):
    return f"{share:.0%}"


class Measured:
    """An input with its maker of meshes and its truth."""

    def __init__(self, source, maker, truth):
        self.source, self.maker, self.truth = source, maker, truth

    def wanted(self, share):
        return round(self.maker.full_triangles() * share)

    def tree(self, share):
        return self.maker.tree(self.wanted(share))

    def compared(self, share):
        """Distances of the tree's cut and of both peers with its number of triangles."""
        count = self.wanted(share)
        return [self.truth.distances(mesh(count)) for mesh in (self.maker.tree, self.maker.meshopt, self.maker.fast)]


def against_peers(inputs, shares):
    rows, ratios = [], []
    for one in inputs:
        for share in shares:
            tree, meshopt, fast = one.compared(share)
            ratios.append(tree["rms"] / meshopt["rms"])
            rows.append([
                one.source.title, percent(share), f"{tree['triangles']:,}", f"{tree['rms']:.4f}", f"{ratios[-1]:.2f}",
                f"{tree['rms'] / fast['rms']:.2f}", f"{tree['hausdorff']:.2f}",
                f"{tree['hausdorff'] / min(meshopt['hausdorff'], fast['hausdorff']):.2f}",
            ])
    head = ["volume", "of full", "triangles", "rms", "÷ meshopt_simplify", "÷ fast-simplification", "hausdorff", "÷ the better peer's"]
    mean = sum(ratios) / len(ratios)
    return table(head, rows) + f"\nThe mean of rms ÷ meshopt_simplify's over all rows is {mean:.2f}.\n"


def shading(inputs, shares):
    rows = []
    for one in inputs:
        for share in shares:
            count = one.wanted(share)
            tree, peer = one.truth.shading(one.maker.tree(count)), one.truth.shading(one.maker.meshopt(count))
            rows.append([one.source.title, percent(share), *(f"{value:.1f}°" for value in (tree[0], peer[0])),
                         f"{tree[0] / peer[0]:.2f}", *(f"{value:.1f}°" for value in (tree[1], peer[1])), f"{tree[1] / peer[1]:.2f}"])
    return table(["volume", "of full", "tree", "peer", "÷", "tree, smooth", "peer, smooth", "÷"], rows)


def octree(inputs, share):
    rows = []
    for one in inputs:
        cut = one.truth.distances(one.maker.octree(one.wanted(share)))
        peer = one.truth.distances(one.maker.meshopt(cut["triangles"]))
        lost, without = one.truth.lost(one.maker.octree(one.wanted(share)))
        rows.append([one.source.title, f"{cut['triangles']:,}", f"{cut['rms']:.4f}", f"{peer['rms']:.4f}",
                     f"{cut['rms'] / peer['rms']:.2f}", f"{cut['hausdorff']:.2f}", f"{peer['hausdorff']:.2f}", f"{lost:.3%}",
                     f"{without:.4f}"])
    return table(["volume", "triangles", "rms", "peer's", "÷", "hausdorff", "peer's", "lost", "rms without"], rows)


def topology(inputs, shares):
    rows = []
    columns = ["components", "genus", "odd_edges", "nonmanifold_edges", "duplicate_triangles", "pillows", "pinched_vertices"]
    for one in inputs:
        meshes = [("full", one.maker.dual()), *((percent(share), one.tree(share)) for share in shares)]
        for name, mesh in meshes:
            found = topology_of(mesh)
            rows.append([one.source.title, name, *(f"{found[column]:,}" for column in columns)])
    return table(["volume", "of full", *(column.replace("_", " ").replace("nonmanifold", "non-manifold") for column in columns)], rows)


def intersections(inputs, shares):
    rows = []
    for one in inputs:
        full = self_intersections(one.maker.dual())
        for share in shares:
            count = one.wanted(share)
            tree, meshopt, fast = (self_intersections(mesh(count)) for mesh in (one.maker.tree, one.maker.meshopt, one.maker.fast))
            ratio = f"{tree / full:.2f}" if full else "–"
            rows.append([one.source.title, percent(share), f"{full:,}", f"{tree:,}", ratio, f"{meshopt:,}", f"{fast:,}"])
    return table(["volume", "of full", "full surface", "tree", "÷", "meshopt_simplify", "fast-simplification"], rows)


UNIFORM = [(0, 0.1)]
PAINTED = [(0, 0.1), (0.4999, 0.1), (0.5, 0.95), (1, 0.95)]


def painted(brain, feature, slug, points, share):
    """rms of the tree's cut with this importance by a field of 0 to 255, where that is half of it or more and elsewhere."""
    field, _ = read_nrrd(brain.source.path.parent / f"{feature}.nrrd")
    count = brain.wanted(share)
    file = brain.source.folder / f"{slug}.json"
    file.write_text(json.dumps({"points": [{"x": x, "importance": i, "color": "#ffffff"} for x, i in points]}))
    options = ["--field", "t1", "--feature", feature, "--feature-range", "0", "255", "--alpha", "1",
               "--transfer-function", file, "--triangles", str(count)]
    mesh = brain.maker.isopeel_mesh(f"{feature}-{slug}-{count}", options, brain.source.path.parent)
    return brain.truth.in_part(mesh, feature, field, 127.5)


def importance(brains, share):
    """A part painted, against the same importance everywhere."""
    rows = []
    for brain in brains:
        full = brain.maker.dual()
        for feature, name in (("gm", "grey matter"), ("ball", "ball")):
            field, _ = read_nrrd(brain.source.path.parent / f"{feature}.nrrd")
            finest = brain.truth.in_part(full, feature, field, 127.5)
            before, after = (painted(brain, feature, slug, points, share) for slug, points in (("uniform", UNIFORM), ("painted", PAINTED)))
            rows.append([brain.source.title, name, percent(finest["share"]), f"{finest['inside']:.4f}", f"{before['inside']:.4f}",
                         f"{after['inside']:.4f}", f"{after['inside'] / before['inside']:.2f}", f"{before['outside']:.4f}",
                         f"{after['outside']:.4f}"])
    head = ["volume", "part", "of the surface", "rms there, full", "uniform", "painted", "÷ uniform", "elsewhere, uniform", "painted"]
    return table(head, rows)


def everything(one, shares):
    """All methods on one input."""
    maker = one.maker
    full = [("VTK flying edges", maker.vtk_full), ("isopeel, marching cubes", maker.marching_cubes_full), ("isopeel, dual", maker.dual)]
    meshes = [("100%", name, make()) for name, make in full]
    methods = [
        ("isopeel, marching cubes", maker.marching_cubes), ("isopeel, octree", maker.octree), (TREE, maker.tree),
        (MESHOPT, maker.meshopt), (FAST, maker.fast), ("VTK, coarser grid", maker.coarser),
    ]
    for share in shares:
        meshes += [(percent(share), name, make(one.wanted(share))) for name, make in methods]
    rows = []
    for share, name, mesh in meshes:
        found = one.truth.distances(mesh)
        rows.append([share, name, f"{found['triangles']:,}", f"{found['rms']:.4f}", f"{found['hausdorff']:.2f}",
                     found["interior_open_edges"], found["nonmanifold_edges"]])
    return f"### {one.source.title}\n\n" + table(["of full", "method", "triangles", "rms", "hausdorff", "open", "non-manifold"], rows)
