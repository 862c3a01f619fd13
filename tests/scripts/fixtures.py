#!/usr/bin/env python3
"""Writes tests/fixtures/volumes anew: small volumes by independent programs, and what these programs say is in them.

    tests/scripts/fixtures.py [NAME ...]      # modules of tests/scripts/fixtures, by default all of them

`make test-formats` writes them elsewhere, with every sample in the lists: FIXTURES is the folder, EVERY_SAMPLE is set.

Runs in a virtual environment of its own, made from fixtures-requirements.txt at the first run. A module NAME has a function
`write(folder)` that returns the entries of NAME.json; common.py says what they hold. server/tests/volumes/fixtures.rs compares them
with what isopeel reads.
"""
import importlib
import json
import os
import subprocess
import sys
from pathlib import Path

if {"-h", "--help"} & set(sys.argv[1:]):
    sys.exit(print(__doc__.strip()))

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
VENV = ROOT / "target" / "fixtures-venv"
FOLDER = Path(os.environ.get("FIXTURES", ROOT / "tests/fixtures/volumes"))


def enter_environment():
    python = VENV / "bin/python"
    if Path(sys.prefix) == VENV:
        return
    if not python.exists():
        subprocess.run([sys.executable, "-m", "venv", VENV], check=True)
        subprocess.run([python, "-m", "pip", "install", "--quiet", "-r", HERE / "fixtures-requirements.txt"], check=True)
    os.execv(python, [python, *sys.argv])


def main():
    enter_environment()
    sys.path.insert(0, str(HERE / "fixtures"))
    FOLDER.mkdir(parents=True, exist_ok=True)
    modules = sorted(path.stem for path in (HERE / "fixtures").glob("*.py") if path.stem != "common")
    for name in sys.argv[1:] or modules:
        entries = importlib.import_module(name).write(FOLDER)
        lines = ",\n".join(json.dumps(entry, ensure_ascii=False) for entry in entries)
        (FOLDER / f"{name}.json").write_text(f"[\n{lines}\n]\n", encoding="utf-8")
        print(f"{name}: {len(entries)} volumes")


main()
