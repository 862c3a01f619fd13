#!/usr/bin/env python3
"""How true a decimated surface is, and how its peers do: writes the tables and pictures of docs/fidelity.md.

    tests/scripts/fidelity.py --work FOLDER [--isopeel target/release/isopeel] [--parts peers shading …] [--volumes sin …]

Measures with quality.py, topology.py and volumes.py of tests/scripts/measure, in a
virtual environment of its own, made from fidelity-requirements.txt at the first run. Meshes and results are kept in --work: a
run that was broken off goes on where it was. Meshes of isopeel are made anew for another binary; delete the folder after a change of a
measure or of a peer's version. Cuts of the octree are those of a server on a CPU.
"""
import argparse
import os
import sys
import tempfile
from pathlib import Path

from fidelity.environment import enter_environment

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
VOLUMES = ["sin", "ml", "ct-head 517", "ct-head -300"]
# Isovalues of the demo volume: two at the outside of grey matter, and the one that it opens with, at its inside.
BRAINS = [110, 120, 140]
PARTS = ["peers", "shading", "octree", "topology", "intersections", "importance", "where", "all", "pictures"]

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--isopeel", type=Path, default=ROOT / "target/release/isopeel", help="the binary to measure")
parser.add_argument("--data", type=Path, default=os.environ.get("ISOPEEL_DATA"), help="folder of ct-head.nrrd [default: ISOPEEL_DATA]")
parser.add_argument("--size", type=int, default=256, help="samples along each axis of sin and ml")
parser.add_argument("--fractions", type=float, nargs="+", default=[0.5, 0.25, 0.15, 0.08], help="of the full-resolution triangles")
parser.add_argument("--volumes", nargs="+", default=VOLUMES, help="sin and ml are made, others are in --data")
parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS), help="tables to make; all of them are needed for the page")
parser.add_argument("--output", type=Path, default=ROOT / "docs/fidelity.md", help="page to write; - prints the tables alone")
parser.add_argument("--work", type=Path, help="folder for volumes, meshes and results that is kept [default: a temporary one]")
parser.add_argument("--python", type=Path, help="interpreter that has the requirements, instead of the own environment")
args = parser.parse_args()
missing = [name for name in args.volumes if name not in ("sin", "ml") and not (args.data and (args.data / f"{name.split()[0]}.nrrd").exists())]
if missing:
    parser.error(f"{', '.join(missing)}: not in --data ({args.data}), expected a folder that has them, or --volumes sin ml")


enter_environment(args.python)
sys.path.insert(0, str(HERE / "measure"))

from fidelity import figures
from fidelity.measures import Truth
from fidelity.meshes import Maker
from fidelity.pictures import draw
from fidelity.where import by_part
from fidelity.volumes_in import open_brain, open_input


def measured(source):
    return figures.Measured(source, Maker(args.isopeel.resolve(), source), Truth(source))


def make(part, inputs, work):
    """The lines of one table; none of the pictures, which are files."""
    opened = lambda name: measured(open_input(name, args.size, args.data, work))
    return {
        "peers": lambda: figures.against_peers(inputs, args.fractions),
        "shading": lambda: figures.shading(inputs, [0.25, 0.08]),
        "octree": lambda: figures.octree([one for one in inputs if one.source.name != "ct-head 517"], 0.25),
        "topology": lambda: figures.topology(inputs, args.fractions),
        "intersections": lambda: figures.intersections(inputs, args.fractions),
        "importance": lambda: figures.importance([measured(open_brain(iso, work)) for iso in BRAINS], 0.15),
        "where": lambda: by_part(opened("ml"), 0.08),
        "all": lambda: "\n".join(figures.everything(one, args.fractions) for one in inputs),
        "pictures": lambda: draw(opened("ct-head 517"), ROOT / "docs/images"),
    }[part]()


def main():
    with tempfile.TemporaryDirectory() as scratch:
        work = (args.work or Path(scratch)).resolve()
        work.mkdir(parents=True, exist_ok=True)
        inputs = [measured(open_input(name, args.size, args.data, work)) for name in args.volumes]
        sections = {}
        for part in args.parts:
            sections[part] = make(part, inputs, work)
            if sections[part] is not None:
                print(sections[part], flush=True)
    if set(args.parts) == set(PARTS) and args.volumes == VOLUMES and str(args.output) != "-":
        write_page(sections)


def write_page(sections):
    """Each table takes the place of the one that the page has between the marks of its name."""
    page = args.output.read_text()
    for part, text in sections.items():
        if text is None:
            continue
        start, end = f"<!-- {part} -->\n", f"<!-- end of {part} -->"
        if start not in page or end not in page:
            raise SystemExit(f"{args.output} lacks the marks of '{part}': {start.strip()} and {end}")
        head, _, rest = page.partition(start)
        page = head + start + "\n" + text + "\n" + end + rest.partition(end)[2]
    args.output.write_text(page)


main()
