#!/usr/bin/env python3
"""Retired words: identifiers and phrases that the standing vocabulary (docs/glossary.md) replaced. None comes back.

Prints `file:line: word -> replacement` for each one found. `code` patterns see neither comments nor the text of strings, so
that an English word may be retired as an identifier alone.
"""

import re
import sys
from fnmatch import fnmatch

from tree import read, text_files

OPENCL = ["kernels/cl/*"]

# (pattern, what to write, files that it is retired in: all where none are named)
CODE = [
    (r"ones(_low|_high)?|twos|fours|eights", "level1_mask, level2_count, vec4s, ...", ["kernels/*"]),
    (r"\w*_(twos|fours|eights)|(twos|fours|eights)_\w*|\w*_FOURS|FOURS_\w*", "level1_mask, load_vec4s, VEC4_ROWS", []),
    (r"turn|swing|TURN\w*|turned\w*", "flip_winding, use_other_diagonal, PERMUTE_X", OPENCL),
    (r"(?<!\.)(several|even|many)|SEVERAL", "multi_sheet_mask, even_sheet_mask, sheets_ge3_mask", OPENCL),
    (r"places?|\w+_places?|NO_PLACE|PLACE_\w+|named|shape", "position_normal, index_slot, count_flags, compact_index", OPENCL),
    (r"Place|places|Placements?|placements?|PLACEMENT\w*|\w+_placements?", "FileLocation, VertexRecord, AffineTransform",
     ["kernels/*", "server/*", "tests/*"]),
    (r"\w*(?<![A-Z])ROOM|room_\w+|\w+_room", "capacity", []),
    (r"MOST|LEAST|(MOST|LEAST)_\w+|\w+_(MOST|LEAST)", "MAX_..., MIN_...", []),
    (r"(?<![Aa]t )most|\w+_(most|least)|(most|least)_\w+", "max, min", []),
    (r"Halt", "JobError", []),
    (r"meet(?=\()", "match_twin", ["server/*"]),
    (r"Side", "HalfEdge", ["server/*"]),
    (r"PATIENCE|starving_since", "STARVATION_LIMIT, waiting_since", ["server/*"]),
    (r"answer(?=: Duration)|(?<=self\.)answer(?!\()", "first_prefix_target", ["server/src/stream/*"]),
    (r"standing", "unchanged", ["server/*", "web/*", "tests/tests/*"]),
    (r"guess(ed)?", "predicted_prefix", ["server/*"]),
    (r"[Ss]trayed|[Aa]nchors?|separate", "vanished parts, locked vertices, split sheets", ["server/src/*"]),
    (r"Patch\w*|patch(es)?", "RegionMesh", ["web/*"]),
    (r"SHELL\w*|shell|ring", "halo cells, HALO_CELLS", OPENCL),
]
ANYWHERE = [
    (r"(\w+_)?hoods?(_\w+)?|Hood", "LeafHalo, halo", []),
    (r"TURNED_\w+|turned round", "axis permutation, flipped winding", ["kernels/*", "docs/*"]),
    (r"(in|of|by) (twos|fours|eights)|fours that", "array-of-structures to structure-of-arrays transpose, vec4s", []),
    (r"makes? good", "one Jacobi step", []),
    (r"looks? around", "what is read", []),
    (r"(is|are) told|says so below|wants? more than|has more to say", "what is passed, which condition holds",
     ["kernels/*", "server/*"]),
    (r"dual_place", "dual_scan", []),
    (r"rooms?", "capacity, space", []),
    (r"[Dd]esk", "WorkerState", []),
    (r"the most (that|of|which|it|they)\b|greatest|(?<![Aa]t )least", "maximum, minimum", []),
    (r"rims?", "boundary", []),
    (r"books", "accounting", []),
    (r"(in )?nobody's hands?", "exclusively owned", []),
    (r"shells?", "halo", ["kernels/*"]),
]

# (file, pattern of the line, why the word may stand there)
EXCEPTIONS = [
    ("tests/lint/*", "", "names the words that it looks for"),
    ("*", "least (recently|significant)", "standard terms"),
    ("kernels/cl/generate.cl", r"\bshape\b", "the Shape of a synthetic volume"),
    ("kernels/cl/*tree*", r"\bring\b", "the ring of neighbours around a vertex, the standard term"),
    ("kernels/cl/lib/args.h", "uint shape;", "the Shape of a synthetic volume"),
    ("web/src/protocol/generated.ts", "", "made from the server's types"),
    ("server/src/cli/extract.rs", "feature's least and greatest value", "text of --help"),
    ("web/src/*", '"Error, greatest"|square and greatest, world', "what a user reads, changed with the interface"),
]

STRING = r'"(?:\\.|[^"\\\n])*"'
SLASHES = re.compile(STRING + r"|//.*|/\*.*?(?:\*/|$)", re.MULTILINE)
STARS = re.compile(STRING + r"|//.*|/\*.*?(?:\*/|$)|^[ \t]*\*.*", re.MULTILINE)
HASHES = re.compile(STRING + r"|#.*")
# How strings and comments look, none of which passes the end of a line.
NOT_CODE = {".rs": SLASHES, ".cl": SLASHES, ".h": SLASHES, ".ts": STARS, ".mjs": STARS, ".js": STARS, ".py": HASHES}


def compiled(table):
    return [(re.compile(rf"(?<!\w)(?:{pattern})(?!\w)"), word, files) for pattern, word, files in table]


def hits(path, rules, text, lines):
    for pattern, replacement, files in rules:
        if files and not any(fnmatch(path, glob) for glob in files):
            continue
        for match in pattern.finditer(text):
            number = text.count("\n", 0, match.start()) + 1
            line = lines[number - 1]
            if not any(fnmatch(path, glob) and re.search(of_line, line) for glob, of_line, _ in EXCEPTIONS):
                yield number, match[0], replacement


def main():
    code, anywhere, count = compiled(CODE), compiled(ANYWHERE), 0
    for path in text_files("."):
        text, not_code = read(path), NOT_CODE.get(path.suffix)
        lines = text.split("\n")
        found = set(hits(str(path), anywhere, text, lines))
        if not_code:
            found |= set(hits(str(path), code, not_code.sub("", text), lines))
        for number, word, replacement in sorted(found):
            print(f"{path}:{number}: {word} -> {replacement}")
        count += len(found)
    sys.exit(count > 0)


if __name__ == "__main__":
    main()
