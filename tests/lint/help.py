#!/usr/bin/env python3
"""Each script says what it is for: `--help` prints it, succeeds, and does nothing else, with nothing installed but Python and bash."""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SECONDS = 20


def scripts():
    """Programs that people type."""
    for folder in ("tests/scripts", "docs", "packaging"):
        for path in sorted((ROOT / folder).iterdir()):
            if path.suffix in {".py", ".sh", ".mjs"} and path.stat().st_mode & 0o111:
                yield path


def wrong(path):
    """What is wrong with a script, or nothing."""
    name = path.relative_to(ROOT)
    try:
        done = subprocess.run([path, "--help"], cwd="/", capture_output=True, text=True, timeout=SECONDS, stdin=subprocess.DEVNULL)
    except subprocess.TimeoutExpired:
        return f"{name} --help goes on after {SECONDS} s, expected that it ends"
    if done.returncode != 0 or len(done.stdout) < 80:
        return f"{name} --help ends with {done.returncode} and says {(done.stdout + done.stderr)[:200]!r}, expected what it is for"
    return None


def main():
    with ThreadPoolExecutor(2) as pool:
        found = [line for line in pool.map(wrong, scripts()) if line]
    print("\n".join(found), end="\n" if found else "")
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
