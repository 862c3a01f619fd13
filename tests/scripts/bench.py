#!/usr/bin/env python3
"""isopeel beside what people use today, on this machine, in one run. Writes BENCHMARKS.md.

    tests/scripts/bench.py [--device SEL] [--size 256 512] [--rounds 2] [--repeats 3] [--gpu LINES.jsonl ... [--gpu-commit C]]

Makes its own virtual environment in target/bench-venv (VTK, fast-simplification), builds the binary and its peer, makes
every volume on the device, saves it, and times both on the same samples. Rounds take turns, so that a busy machine is busy
for both; the best of all rounds counts. `--gpu` adds what `isopeel bench` printed on another machine. Where the packages
cannot be installed, the stream is timed alone.
"""
import argparse
import json
import os
import platform
import shlex
import struct
import subprocess
import sys
import tempfile
import venv
from datetime import date

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
VENV = os.path.join(ROOT, "target", "bench-venv")
PACKAGES = ["numpy==2.4.*", "vtk==9.*", "fast-simplification==0.*"]
BINARY = os.path.join(ROOT, "target", "release", "isopeel")
PEER = os.path.join(ROOT, "target", "release", "examples", "simplify_peer")

# Flying edges, timed in a process of its own: VTK sets its threads up once.
VTK = r"""
import json, struct, sys, time
import numpy as np, vtk
from vtk.util import numpy_support as vn
path, iso, threads, repeats, fraction, mesh_path = sys.argv[1], *map(float, sys.argv[2:6]), sys.argv[6]
header, _, data = open(path, "rb").read().partition(b"\n\n")
fields = dict(l.split(": ", 1) for l in header.decode().splitlines()[1:])
nx, ny, nz = map(int, fields["sizes"].split())
dtype = {"float": "<f4", "uint8": "u1"}[fields["type"]]
image = vtk.vtkImageData()
image.SetDimensions(nx, ny, nz)
samples = np.frombuffer(data, dtype)
image.GetPointData().SetScalars(vn.numpy_to_vtk(samples))
vtk.vtkSMPTools.SetBackend("Sequential" if threads == 1 else "STDThread")
vtk.vtkSMPTools.Initialize(int(threads))
def flying_edges():
    edges = vtk.vtkFlyingEdges3D()
    edges.SetInputData(image)
    edges.SetValue(0, iso)
    edges.ComputeNormalsOn()
    edges.ComputeGradientsOff()
    edges.ComputeScalarsOff()
    start = time.perf_counter()
    edges.Update()
    return time.perf_counter() - start, edges.GetOutput()
flying_edges()
times = []
for _ in range(int(repeats)):
    seconds, mesh = flying_edges()
    times.append(seconds)
result = dict(best_s=min(times), triangles=mesh.GetNumberOfPolys(), vtk=vtk.vtkVersion.GetVTKVersion())
points = np.ascontiguousarray(vn.vtk_to_numpy(mesh.GetPoints().GetData()), np.float32)
faces = np.ascontiguousarray(vn.vtk_to_numpy(mesh.GetPolys().GetConnectivityArray()).reshape(-1, 3), np.uint32)
if fraction < 1:
    import fast_simplification
    start = time.perf_counter()
    _, kept = fast_simplification.simplify(points, faces.astype(np.int32), 1 - fraction)
    result.update(fast_s=time.perf_counter() - start, fast_triangles=len(kept))
if mesh_path != "-":
    with open(mesh_path, "wb") as out:
        out.write(struct.pack("<II", len(points), len(faces)))
        out.write(points.tobytes())
        out.write(np.ascontiguousarray(vn.vtk_to_numpy(mesh.GetPointData().GetNormals()), np.float32).tobytes())
        out.write(faces.tobytes())
print(json.dumps(result))
"""


def call(command, **options):
    print("+", " ".join(map(str, command))[:200], file=sys.stderr, flush=True)
    return subprocess.run(list(map(str, command)), check=True, **options)


def lines(command, **options):
    text = call(command, stdout=subprocess.PIPE, text=True, **options).stdout
    return [json.loads(line) for line in text.splitlines()]


def python():
    """An interpreter with the peers' packages; None where they cannot be had."""
    path = os.path.join(VENV, "bin", "python")
    try:
        if not os.path.exists(path):
            venv.create(VENV, with_pip=True)
        if subprocess.run([path, "-c", "import vtk, fast_simplification"], capture_output=True).returncode:
            call([path, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *PACKAGES])
    except (OSError, subprocess.CalledProcessError) as error:
        print(f"no VTK and fast-simplification here, so no peers are timed: {error}", file=sys.stderr)
        return None
    return path


class Best(dict):
    """The minimum seen for each key."""

    def see(self, key, value):
        if value is not None:
            self[key] = min(value, self.get(key, value))


def stream(args, folder, interpreter):
    """The lines of the path that a viewer takes, and the peers' pipeline to as many triangles, milliseconds by setting."""
    size = min(args.size)
    device = ["--device", args.device] if args.device else []
    found = lines([BINARY, "bench", "--volume", "sin", "--size", size, "--case", "stream", "--repeats", args.repeats,
                   "--save", folder, *device])
    edits = [line for line in found if line.get("case") == "stream"]
    drags = [line for line in found if line.get("case") == "drag"]
    peers = {}
    if interpreter:
        mesh = os.path.join(folder, "mesh")
        volume = os.path.join(folder, f"sin-{size}-f32.nrrd")
        # The isovalue that all of the stream's lie around.
        extracted, = lines([interpreter, "-c", VTK, volume, 0.5, os.cpu_count(), args.repeats, 1, mesh])
        for line in edits:
            if line["edit"] != "isovalue" or line["setting"] == "opening":
                continue
            fraction = 1 if line["setting"] == "full" else min(1, line["triangles"] / extracted["triangles"])
            bricks = next(r for r in lines([PEER, mesh, fraction, args.repeats]) if r["way"] == "bricks")
            parts = [extracted["best_s"], 0 if fraction == 1 else bricks["best_s"], bricks["encode_best_s"]]
            peers[line["setting"]] = dict(bricks, parts=[1e3 * part for part in parts])
    return found[0], edits, drags, peers


def spread(value):
    return "" if value is None else f"{value['median']:.1f} ({value['best']:.1f})"


def edit_table(edits):
    yield "| setting | edit | first | done | device | triangles | regions sent | kB sent |"
    yield "|---|---|---|---|---|---|---|---|"
    for line in edits:
        yield "| {} | {} | {} | {} | {} | {:,} | {} | {:.0f} |".format(
            line["setting"], line["edit"], spread(line.get("first_ms")), spread(line["done_ms"]), spread(line["device_ms"]),
            line["triangles"], line["chunks"], line["encoded_bytes"] / 1e3)


def drag_table(drags):
    yield "\nDrags at the opening setting, edits sent at an even rate while the client reads:\n"
    yield "| edit | edits a second | edits | surfaces shown | longest time without one, ms | settled after the last edit, ms |"
    yield "|---|---|---|---|---|---|"
    for line in drags:
        yield (f"| {line['edit']} | {line['hz']:.0f} | {line['edits']} | {line['commits']} | {line['longest_gap_ms']:.0f} "
               f"| {line['settle_ms']:.0f} |")


def stream_tables(edits, drags, peers, threads):
    size = edits[0]["dims"][0]
    yield "\n### What a viewer waits for\n"
    yield (f"`isopeel bench --case stream`, `sin` {size}³: edits through a WebSocket of the whole server on the loopback interface, one "
           "viewer, median (best) of all runs in milliseconds, nothing answered from memory. *first*: to the first `committed`, a "
           "whole surface that may be coarse. *done*: to the last byte of the final surface. *device*: all stages. Settings: "
           "`opening` is what the volume opens with (gradient magnitude as a feature, an error of 0.1vx and a quarter of the "
           "triangles at most); 25 % and 8 % are budgets of triangles and `full` is everything, without guards. *Rested*: the viewer had "
           "rested for a quarter of a second before, so the vertex tree is there, of which these edits are cuts; the others are cuts of "
           "cubes, where the tree takes long. Decoding, upload and drawing in the browser are left out: `make bench-browser` has them.\n")
    yield from edit_table(edits)
    yield from drag_table(drags)
    if not peers:
        yield "\nVTK was not at hand, so nothing stands beside these."
        return
    yield (f"\nA new isovalue beside what one would otherwise run to the same bytes on the wire, on {threads} threads, from samples in "
           "memory to as many triangles: VTK's flying edges with normals, meshoptimizer's simplification of locked 64³ bricks, its "
           "strips and codecs with vertices of the same 12 bytes, 4 of them empty where isopeel has its features. Best times, "
           "milliseconds. The peer's time ends before any socket and leaves out cutting its mesh into bricks; isopeel's is edit to "
           "`done` through the socket, and its bytes include a coarse surface before the final one. Triangles and bytes are those of "
           "the last run; the peer has an isovalue of 0.5, around which isopeel's lie.\n")
    yield "| setting | isopeel, first | isopeel, done | VTK | + simplify | + encode | peer | peer ÷ isopeel, done | triangles, isopeel | triangles, peer | kB, isopeel | kB, peer |"
    yield "|---|---|---|---|---|---|---|---|---|---|---|---|"
    for line in edits:
        peer = peers.get(line["setting"])
        if line["edit"] != "isovalue" or not peer:
            continue
        total, done = sum(peer["parts"]), line["done_ms"]["best"]
        extract, simplify, encode = (f"{part:.1f}" for part in peer["parts"])
        yield (f"| {line['setting']} | {line['first_ms']['best']:.1f} | {done:.1f} | {extract} | {simplify} | {encode} | {total:.1f} "
               f"| {total / done:.2f} | {line['triangles']:,} | {peer['triangles']:,} | {line['encoded_bytes'] / 1e3:.0f} "
               f"| {peer['encoded_bytes'] / 1e3:.0f} |")


def measure(args, folder, interpreter):
    best, facts = Best(), {}
    threads = os.cpu_count()
    device = ["--device", args.device] if args.device else []
    for turn in range(args.rounds):
        for size in args.size:
            for kind in ("f32", "u8"):
                name = f"sin-{size}-{kind}"
                fractions = [1, 0.25] if kind == "f32" else [1]
                cases = ["next", "first", "edit"] if kind == "f32" else ["next"]
                device_line, *found = lines([
                    BINARY, "bench", "--volume", "sin", "--size", size, "--type", kind, "--case", *cases,
                    "--fraction", *fractions, "--repeats", args.repeats, "--save", folder, *device])
                facts["device"] = device_line
                for line in found:
                    key = (name, line["case"], line["fraction"])
                    best.see(key, line["wall_ms"]["best"])
                    facts[key] = line
                iso = found[0]["iso"]
                last = kind == "f32" and size == max(args.size)
                for count in sorted({1, threads}):
                    mesh = os.path.join(folder, "mesh") if last and count == threads else "-"
                    fraction = 0.25 if mesh != "-" and turn == 0 else 1
                    volume = os.path.join(folder, f"{name}.nrrd")
                    result, = lines([interpreter, "-c", VTK, volume, iso, count, args.repeats, fraction, mesh])
                    best.see((name, "vtk", count), result["best_s"] * 1e3)
                    facts[name, "vtk"] = result
                    if "fast_s" in result:
                        best.see((name, "fast"), result["fast_s"] * 1e3)
                if last:
                    for result in lines([PEER, os.path.join(folder, "mesh"), 0.25, 1]):
                        best.see((name, "meshopt", result["way"]), result["best_s"] * 1e3)
        for line in lines([BINARY, "bench", "--volume", "sin", "ml", "--size", 256, "--case", "encode", "--fraction", 1,
                           "--repeats", args.repeats, *device])[1:]:
            key = (line["volume"], "encode")
            best.see(key, line["wall_ms"]["best"])
            best.see((line["volume"], "encode meshopt"), line["meshopt_wall_ms"]["best"])
            facts[key] = line
        for volume, sizes in (("spheres", [512]), ("sphere", [128, 256, 512])):
            for line in lines([BINARY, "bench", "--volume", volume, "--size", *sizes, "--case", "edit", "--fraction", 1,
                               "--repeats", args.repeats, *device])[1:]:
                key = (line["volume"], line["dims"][0], "growth")
                best.see(key, line["wall_ms"]["best"])
                facts[key] = line
    return best, facts, threads


def ratio(value):
    return f"{value:.2f}"


def table(args, best, facts, threads):
    rows = []
    for size in args.size:
        for kind in ("f32", "u8"):
            name = f"sin-{size}-{kind}"
            speed = best[name, "vtk", threads] / best[name, "next isovalue", 1]
            must, goal = ("≥ 0.9", "≥ 1.5") if size < 512 else ("≥ 1.6", "≥ 2.5")
            rows.append((1, f"full surface with normals, speed ÷ VTK on {threads} threads, `sin` {size}³ {kind}", must, goal,
                         ratio(speed)))
    largest = f"sin-{max(args.size)}-f32"
    own = best[largest, "next isovalue", 0.25]
    full = best[largest, "vtk", threads]
    rows.append((2, f"isovalue → mesh at 25 %, time ÷ VTK's full mesh, `{largest}`", "≤ 1.0", "≤ 0.6", ratio(own / full)))
    for way in ("bricks", "whole"):
        peer = full + best[largest, "meshopt", way]
        rows.append((3, f"the same, speed ÷ (flying edges + meshoptimizer, {way})", "≥ 3", "≥ 5", ratio(peer / own)))
    rows.append((3, "the same, speed ÷ (flying edges + fast-simplification)", "≥ 25", "≥ 45",
                 ratio((full + best[largest, "fast"]) / own)))
    rows.append((4, "α/β/transfer-function edit, time ÷ first isovalue, 25 %", "≤ 0.35", "≤ 0.15",
                 ratio(best[largest, "edit", 0.25] / best[largest, "first isovalue", 0.25])))
    for size in args.size:
        line = facts[f"sin-{size}-f32", "next isovalue", 1]
        rows.append((9, f"device bytes beyond the volume a full triangle, `sin` {size}³", "≤ 80", "≤ 30",
                     f"{line['device_bytes_per_full_triangle']:.1f}"))
    for volume, must, goal in (("sin", "≤ 4.5", "≤ 3.8"), ("ml", "≤ 3.8", "≤ 3.0")):
        line = facts[volume, "encode"]
        rows.append((10, f"bytes a triangle on the wire, `{volume}` 256³ full", must, goal, f"{line['bytes_per_triangle']:.2f}"))
    for volume in ("sin", "ml"):
        line = facts[volume, "encode"]
        more = line["encoded_bytes"] / line["meshopt_bytes"] - 1
        speed = best[volume, "encode meshopt"] / best[volume, "encode"]
        rows.append((11, f"encode throughput ÷ meshoptimizer's strips, `{volume}` 256³ full", "≥ 1.5 at ≤ 5 % more bytes",
                     "≥ 3", f"{speed:.2f} at {more:+.1%}"))
    balls = sorted((facts[k]["triangles"], best[k]) for k in facts if k[1:] == (512, "growth") and k[0] != "sphere")
    if len(balls) > 1:
        per = [time / triangles * 1e6 for triangles, time in balls]
        rows.append((12, f"edit, ns a triangle, {balls[0][0]} to {balls[-1][0]} triangles in 512³", "linear", "linear",
                     " ".join(f"{v:.0f}" for v in per)))
    flat = [best["sphere", size, "growth"] for size in (128, 256, 512)]
    rows.append((12, "edit of one sphere of radius 40 in 128³, 256³, 512³, ms", "flat", "flat",
                 " ".join(f"{v:.2f}" for v in flat)))
    return rows


def stage_tables(args, best, facts, threads):
    largest = f"sin-{max(args.size)}-f32"
    yield "\n### Stages alone\n"
    yield ("Calls into the engine and the encoder, best of all rounds. They leave out what a viewer's path has beyond them: the socket "
           "and the session, coarse surfaces before the final one, the default feature, guards, the search of β for a budget, and "
           f"opening a volume. VTK {facts[largest, 'vtk']['vtk']}.\n")
    yield "| # | figure | must | goal | here |"
    yield "|---|---|---|---|---|"
    for number, what, must, goal, here in table(args, best, facts, threads):
        yield f"| {number} | {what} | {must} | {goal} | {here} |"
    yield "\nFigures 5 to 8 are those of a GPU; figure 13 is taken by the browser tests.\n"
    yield "Best times, milliseconds:\n"
    yield "| what | ms |"
    yield "|---|---|"
    for key, value in best.items():
        yield f"| {' '.join(map(str, key))} | {value:.2f} |"


def gpu_tables(paths, commit):
    for path in paths:
        with open(path) as file:
            lines = [json.loads(line) for line in file if line.startswith("{")]
        # Of several runs in one file the first speaks for the device.
        device, found = lines[0], [line for line in lines if "volume" in line]
        yield f"\n## {device['device']}\n"
        yield (f"Commit {commit}. Driver {device['driver']}; its own copies {device['copy_gb_s']:.0f} GB/s (read + written), launch "
               f"{device['launch_us']:.1f} µs, launch and wait {device['launch_and_wait_us']:.1f} µs.")
        volumes = dict.fromkeys((line["volume"], tuple(line["dims"]), line["type"]) for line in found)
        for key in volumes:
            of_volume = [line for line in found if (line["volume"], tuple(line["dims"]), line["type"]) == key]
            name = f"{key[0]} {'×'.join(map(str, key[1]))} {key[2]}"
            edits, drags = ([line for line in of_volume if line["case"] == case] for case in ("stream", "drag"))
            if edits:
                yield f"\n### {name}: what a viewer waits for\n"
                yield from edit_table(edits)
            if drags:
                yield from drag_table(drags)
            yield f"\n### {name}: stages alone\n"
            yield "Best of all runs, milliseconds; *device* without the mesh's read-back.\n"
            yield from gpu_stage_table([line for line in of_volume if line["case"] not in ("stream", "drag")])


def gpu_stage_table(found):
    yield "| case | kept | triangles | device | wall | ÷ copy bandwidth | B a full triangle | B a triangle sent |"
    yield "|---|---|---|---|---|---|---|---|"
    for line in found:
        def show(value, form="{:.2f}"):
            return "" if value is None else form.format(value)
        best = lambda key: (line.get(key) or {}).get("best")
        yield "| {} | {} | {} | {} | {} | {} | {} | {} |".format(
            line["case"], show(line.get("fraction"), "{:.0%}"), show(line.get("triangles"), "{:,}"), show(best("device_ms"), "{:.3f}"),
            show(best("wall_ms"), "{:.3f}"), show(line.get("bandwidth_fraction"), "{:.3f}"),
            show(line.get("device_bytes_per_full_triangle"), "{:.1f}"), show(line.get("bytes_per_triangle")))


def cpu_model():
    try:
        with open("/proc/cpuinfo") as file:
            return next(l.split(":", 1)[1].strip() for l in file if l.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or "unknown"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", help="OpenCL device, as isopeel devices lists them")
    parser.add_argument("--size", type=int, nargs="+", default=[256, 512])
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--gpu", nargs="*", default=[], help="output of isopeel bench on other machines")
    parser.add_argument("--gpu-commit", help="what those ran, where it is not this commit")
    parser.add_argument("--output", default=os.path.join(ROOT, "BENCHMARKS.md"))
    args = parser.parse_args()
    call(["cargo", "build", "--locked", "--release", "--package", "isopeel", "--bins", "--examples"], cwd=ROOT)
    interpreter = python()
    threads = os.cpu_count()
    with tempfile.TemporaryDirectory() as folder:
        device, edits, drags, peers = stream(args, folder, interpreter)
        # Every figure of the stages is a ratio to a peer.
        stages = stage_tables(args, *measure(args, folder, interpreter)) if interpreter else []
    commit = subprocess.run(["git", "describe", "--always", "--dirty"], cwd=ROOT, capture_output=True, text=True).stdout.strip()
    text = [
        "# Benchmarks\n",
        "Historical. Written by `make bench`; how each part came to be as fast as it is stands in "
        "[docs/performance.md](docs/performance.md). Ratios are of times taken in one run on one machine; every count was compared "
        "with a reference before it was timed.\n",
        f"## {device['device']}\n",
        f"{cpu_model()}, {threads} cores, {platform.system()} {platform.machine()}; {device['platform']} {device['driver']}: "
        f"copies {device['copy_gb_s']:.1f} GB/s (read + written), launch and wait {device['launch_and_wait_us']:.0f} µs. "
        f"Commit {commit}, {date.today().isoformat()}. Command: `tests/scripts/bench.py {shlex.join(sys.argv[1:])}`",
        *stream_tables(edits, drags, peers, threads),
        *stages,
        *gpu_tables(args.gpu, args.gpu_commit or commit),
    ]
    with open(args.output, "w") as out:
        out.write("\n".join(text) + "\n")
    print("\n".join(text))


if __name__ == "__main__":
    main()
