#!/usr/bin/env python3
"""What the binary is made of: crates, and the packages of the web client that it embeds.

    packaging/third_party.py FOLDER

writes FOLDER/THIRD-PARTY.txt, each with its licence and the texts that it comes with, and FOLDER/isopeel.cdx.json, the same as a bill of
materials (CycloneDX 1.6). Reads what cargo and npm have downloaded; asks no server.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import uuid
from datetime import datetime, timezone
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
# Licences that a package states in its README alone.
STATED = {"combine-errors": "MIT"}
TEXTS = re.compile(r"^(licen[cs]e|copying|notice|copyright|unlicense)", re.IGNORECASE)
TARGETS = ["x86_64-unknown-linux-gnu", "aarch64-unknown-linux-gnu"]


def crates():
    """The crates that the binary links, without those of builds and tests alone: (name, version, licence, folder)."""
    command = ["cargo", "metadata", "--locked", "--format-version", "1"]
    for target in TARGETS:
        command += ["--filter-platform", target]
    found = json.loads(subprocess.run(command, cwd=ROOT, check=True, capture_output=True).stdout)
    packages = {package["id"]: package for package in found["packages"]}
    nodes = {node["id"]: node for node in found["resolve"]["nodes"]}
    first = next(id for id, package in packages.items() if package["name"] == "isopeel")
    seen, waiting = set(), [first]
    while waiting:
        id = waiting.pop()
        if id in seen:
            continue
        seen.add(id)
        for dependency in nodes[id]["deps"]:
            if any(kind["kind"] is None for kind in dependency["dep_kinds"]):
                waiting.append(dependency["pkg"])
    for id in seen:
        package = packages[id]
        if package["source"] is not None:
            folder = Path(package["manifest_path"]).parent
            yield "cargo", package["name"], package["version"], package["license"] or "see its texts", folder


def npm_packages():
    """The packages that the web client's bundle may have parts of: those that it depends on at run time, directly or not."""
    lock = json.loads((ROOT / "web" / "package-lock.json").read_text())
    for place, package in lock["packages"].items():
        if place and not package.get("dev") and not package.get("link"):
            name = place.rsplit("node_modules/", 1)[1]
            yield "npm", name, package["version"], package.get("license") or STATED.get(name, "see its texts"), ROOT / "web" / place


def libraries():
    """What compilers add."""
    rustc = subprocess.run(["rustc", "--version"], cwd=ROOT, check=True, capture_output=True, text=True).stdout.split()[1]
    none = Path("/nonexistent")
    yield "generic", "rust-std", rustc, "MIT OR Apache-2.0", none
    # zig's, which are linked into the binary: those of its LLVM
    yield "generic", "libc++", "of zig", "Apache-2.0 WITH LLVM-exception", none
    yield "generic", "libunwind", "of zig", "Apache-2.0 WITH LLVM-exception", none


def texts(folder):
    """The licences that a package comes with."""
    files = sorted(path for path in folder.iterdir() if path.is_file() and TEXTS.match(path.name)) if folder.is_dir() else []
    return [(path.name, path.read_text(errors="replace").strip()) for path in files]


def write_texts(path, packages):
    """All licences, equal texts once."""
    places = {}
    for kind, name, version, _, folder in packages:
        for file, text in texts(folder):
            places.setdefault(text, []).append(f"{name} {version} ({file})")
    with path.open("w") as out:
        out.write("isopeel contains the following packages.\n\n")
        for kind, name, version, licence, _ in packages:
            out.write(f"{name} {version} ({kind}): {licence}\n")
        for text, names in sorted(places.items(), key=lambda item: item[1]):
            out.write("\n" + "=" * 80 + "\n" + "\n".join(names) + "\n" + "-" * 80 + "\n" + text + "\n")


def licence_of(text):
    """As CycloneDX has it: one name, or an expression."""
    expression = text.replace("/", " OR ")
    if expression == "see its texts":
        return [{"license": {"name": expression}}]
    return [{"expression": expression}]


def write_bill(path, packages, version, time):
    """The bill of materials, which is the same for the same packages and time."""
    components = []
    for kind, name, number, licence, _ in packages:
        group, _, plain = name.rpartition("/")
        number = number.replace(" ", "-")
        url = f"pkg:{kind}/{(group.replace('@', '%40') + '/') if group else ''}{plain}@{number}"
        component = {"type": "library", "bom-ref": url, "name": plain, "version": number, "purl": url}
        components.append(({"group": group} if group else {}) | component | {"licenses": licence_of(licence)})
    own = {"type": "application", "bom-ref": "isopeel", "name": "isopeel", "version": version}
    bill = {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "serialNumber": f"urn:uuid:{uuid.uuid5(uuid.NAMESPACE_URL, version + json.dumps(components))}",
        "version": 1,
        "metadata": {"timestamp": time, "component": own | {"licenses": licence_of("MIT OR Apache-2.0")}},
        "components": components,
    }
    path.write_text(json.dumps(bill, indent=1) + "\n")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", metavar="FOLDER", type=Path)
    folder = parser.parse_args().folder
    packages = sorted([*crates(), *npm_packages(), *libraries()], key=lambda package: package[:3])
    missing = [f"{name} {version}" for _, name, version, licence, place in packages if licence == "see its texts" and not texts(place)]
    if missing:
        sys.exit(f"third_party.py: no licence is known of {', '.join(missing)}")
    version = re.search(r'^version = "(.+)"', (ROOT / "Cargo.toml").read_text(), re.MULTILINE)[1]
    seconds = int(os.environ.get("SOURCE_DATE_EPOCH", "0"))
    folder.mkdir(parents=True, exist_ok=True)
    write_texts(folder / "THIRD-PARTY.txt", packages)
    time = datetime.fromtimestamp(seconds, timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ")
    write_bill(folder / "isopeel.cdx.json", packages, version, time)
    print(f"{len(packages)} packages")


if __name__ == "__main__":
    main()
