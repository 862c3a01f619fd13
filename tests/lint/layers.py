#!/usr/bin/env python3
"""Layers: crates and modules use only those below their own, and no modules use each other in a circle.

CRATES lists what each crate may use of the others, beside its tests. NOT_IN_ENGINE lists crates that the engine uses neither
itself nor through others. LAYERS lists each crate's modules from the bottom up; those that share a line are one layer. A
module's own files form no circle either, but a file and the one that declares it may use each other. Test modules may use
anything. In OpenCL C, files include headers alone.
"""

import re
import subprocess
import sys
import tomllib

from tree import read, text_files

CRATES = {
    "kernels": [],
    "server/client": [],
    "server/geometry": [],
    "server/codec": ["isopeel-kernels"],
    "server/extraction": ["isopeel-codec", "isopeel-geometry", "isopeel-kernels", "isopeel-view", "isopeel-volumes"],
    "server/mesh": ["isopeel-extraction", "isopeel-geometry", "isopeel-kernels", "isopeel-view", "isopeel-volumes"],
    "server/view": ["isopeel-geometry", "isopeel-kernels"],
    "server/volumes": ["isopeel-geometry", "isopeel-kernels"],
    "server": ["isopeel-client", "isopeel-codec", "isopeel-extraction", "isopeel-geometry", "isopeel-kernels", "isopeel-mesh", "isopeel-view", "isopeel-volumes"],
}

# Crates of servers and command lines, which programs that use the engine do not get.
NOT_IN_ENGINE = {"axum", "clap", "hyper", "reqwest", "tokio", "utoipa"}

LAYERS = {
    "kernels/src": """
        checked lock
        interned
        activity constants error shared_slice sources tables
        bulk
        buffer cancel device interest layout pace transfer
        params rectilinear tuning volume
        expression feature mask program surface synthetic
        context pyramid
        mesh_regions tree
        stages
        cut
        engine
        check
        testing
    """,
    "server/client/src": """
        chunk
        error
        connection frame
        surface
        viewer
    """,
    "server/geometry/src": """
        intersections uneven
    """,
    "server/codec/src": """
        values
        chunk
        index_codec order range_coder vertex_codec
        predictive
        encode decode
    """,
    "server/extraction/src": """
        dataset_views error fields joined memory observer open_steps residency user_time
        chunk_bytes grids host_memory keys
        byte_search camera context histogram_cache identity job_error pins shares statistics
        feature_fields results
        cuts decisions intersections tree_steps
        workspace
        host_space on_device reading uploads
        ahead computed counting cube_cuts histograms overviews questions release slices
        tree_surfaces
        final_surfaces refine
        complete requests
    """,
    "server/mesh/src": """
        caps decimal rows transform xml
        mesh
        topology
        clean
        gifti glb obj ply precomputed stl three_mf usda vtp
        usdz
    """,
    "server/view/src": """
        error outward
        camera interest mask quality transfer_function
        binary
        chosen_parts expression opening parts schemas
        feature
        edit
        request
    """,
    "server/volumes/src": """
        disk json
        read_error
        axis_scales beneath codec frame labels notices parallel private progress remote statistics step times turned vectors
        findings identity unpacked
        location
        described numbered replaced stored testing
        scalar
        conversion rectilinear
        decode pieces
        formats
        open
        demo memory
        catalog
        watch
    """,
    "server/src": """
        bounded_read clock error metrics pool private_folder
        device problem
        service
        wire export access
        jobs uploads
        stream
        rest
        serve
        cli
    """,
}

TEST_MODULE = re.compile(r"#\[cfg\(test\)\]\s*(?:pub(?:\(\w+\))? )?mod (\w+)\s*(;|\{.*)", re.DOTALL)
USE = re.compile(r"\b(?:crate|self|super)::")
REEXPORT = re.compile(r"^pub(?:\(\w+\))? use ", re.MULTILINE)


def expand(text, at):
    """The paths of the use tree at `at` (`a::{b, c::{d, e}}`: a::b, a::c::d, a::c::e), and where it ends."""
    head = re.compile(r"[\w:]*").match(text, at)
    at = head.end()
    if text[at] != "{":
        return [head[0]], at
    paths = []
    while text[at] != "}":
        inner, at = expand(text, re.compile(r"[{,]\s*").match(text, at).end())
        paths += inner
        at = re.compile(r"\*?(?:\s+as\s+\w+)?\s*").match(text, at).end()
    return [head[0] + path for path in paths], at + 1


class Crate:
    """Modules as tuples of names, () for the crate itself, and which modules each of them uses."""

    def __init__(self, folder):
        self.sources, tests = {}, set()
        for path in text_files(folder):
            names = path.relative_to(folder).with_suffix("").parts
            module = names[:-1] if names[-1] in ("mod", "lib", "main") else names
            if path.suffix == ".rs" and path.name != "main.rs":
                text = re.sub(r"^[ \t]*//.*", "", read(path), flags=re.MULTILINE)
                tests |= {(*module, name) for name, _ in TEST_MODULE.findall(text)}
                self.sources[module] = (path, TEST_MODULE.sub("", text))
        for test in tests:
            self.sources = {m: source for m, source in self.sources.items() if m[: len(test)] != test}
        self.reexports = {}
        for module, (_, text) in self.sources.items():
            for match in REEXPORT.finditer(text):
                for path in expand(text, match.end())[0]:
                    *_, name = target = self.absolute(module, path.split("::"))
                    if target != (*module, name):
                        self.reexports[(*module, name)] = target
        self.uses = {module: self.used_by(module) for module in self.sources if module}

    @staticmethod
    def absolute(module, names):
        """`names` as written in `module`, from the root of the crate."""
        if names[0] == "crate":
            return tuple(names[1:])
        while names[0] in ("self", "super"):
            module = module[:-1] if names[0] == "super" else module
            names = names[1:]
        return (*module, *names)

    def defining(self, path):
        """The module where what `path` names is defined, () where it is the root."""
        for length in range(len(path), 0, -1):
            if path[:length] in self.sources:
                return path[:length]
            if path[:length] in self.reexports:
                return self.defining(self.reexports[path[:length]])
        return ()

    def used_by(self, module):
        text, used = self.sources[module][1], set()
        for match in USE.finditer(text):
            for path in expand(text, match.start())[0]:
                used.add(self.defining(self.absolute(module, path.split("::"))))
        related = {other for other in used if module[: len(other)] == other or other[: len(module)] == module}
        return used - related


def circles(uses):
    """Some circle for what is left of the graph when all that is in none is taken away."""
    while free := [node for node, used in uses.items() if not used & uses.keys()]:
        uses = {node: used for node, used in uses.items() if node not in free}
    if uses:
        walk = [min(uses)]
        while walk.count(walk[-1]) == 1:
            walk.append(min(uses[walk[-1]] & uses.keys()))
        yield walk[walk.index(walk[-1]) :]


def crate_problems(folder, layers):
    crate = Crate(folder)
    layer_of = {name: layer for layer, line in enumerate(layers.strip().splitlines()) for name in line.split()}
    tops = {module[0] for module in crate.uses}
    yield from (f"{folder}: {name} has no layer in {__file__}" for name in sorted(tops - layer_of.keys()))
    yield from (f"{folder}: no module {name}, which has a layer" for name in sorted(layer_of.keys() - tops))
    between_tops = {top: set() for top in tops}
    for module, used in sorted(crate.uses.items()):
        for other in sorted(used):
            if layer_of.get(module[0], 0) < layer_of.get(other[0], 0):
                yield f"{crate.sources[module][0]}: uses {'::'.join(other)} of a layer above"
            if other[0] != module[0]:
                between_tops[module[0]].add(other[0])
    for circle in (*circles(between_tops), *circles(crate.uses)):
        yield f"{folder}: a circle: " + " uses ".join(n if isinstance(n, str) else "::".join(n) for n in circle)


def dependency_problems():
    for folder, allowed in CRATES.items():
        used = [name for name in tomllib.loads(read(f"{folder}/Cargo.toml"))["dependencies"] if name.startswith("isopeel-")]
        yield from (f"{folder}/Cargo.toml: uses {name}, which is not below it" for name in used if name not in allowed)


def engine_problems():
    command = "cargo tree --locked --package isopeel-extraction --edges normal --prefix none --format {lib}"
    tree = subprocess.run(command.split(), check=True, capture_output=True, text=True).stdout
    found = sorted(NOT_IN_ENGINE & set(tree.split()))
    yield from (f"server/extraction: depends on {name}" for name in found)


def include_problems():
    for path in text_files("kernels/cl"):
        for name in re.findall(r'^\s*#\s*include\s+["<](.*)[">]', read(path), re.MULTILINE):
            if not name.endswith(".h"):
                yield f"{path}: includes {name}, only headers may be"


def main():
    problems = [problem for folder, layers in LAYERS.items() for problem in crate_problems(folder, layers)]
    problems += [*dependency_problems(), *engine_problems(), *include_problems()]
    print("\n".join(problems), end="\n" if problems else "")
    sys.exit(bool(problems))


if __name__ == "__main__":
    main()
