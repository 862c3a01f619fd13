"""The repository's text files, for the checks beside this file."""

import os
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
NOT_OURS = {".git", "target", "node_modules", "dist", "artefacts"}
TEXT = {".rs", ".cl", ".h", ".ts", ".mjs", ".js", ".py", ".sh", ".md", ".toml", ".html", ".css", ".yml", ".yaml"}
TEXT_NAMES = {"Makefile", "Dockerfile", "run"}


def text_files(*folders):
    """Paths relative to ROOT of every text file in these folders, "." for all; sorted."""
    found = []
    for folder in folders:
        for parent, folders_here, files in os.walk(ROOT / folder):
            folders_here[:] = [name for name in folders_here if name not in NOT_OURS]
            paths = (Path(parent, name).relative_to(ROOT) for name in files)
            found += [path for path in paths if path.suffix in TEXT or path.name in TEXT_NAMES]
    return sorted(set(found))


def read(path):
    return (ROOT / path).read_text(encoding="utf-8")
