#!/usr/bin/env python3
"""How much memory of its own `isopeel serve` holds while a viewer opens a large raw volume, beside the volume on the device.

    tests/scripts/load_memory.py [--gib 2] [--isopeel target/release/isopeel] [--work FOLDER]

Reads RssAnon of the process (memory that is no file's) every 5 ms while GET /api/v1/volumes/ID loads the volume and counts its values.
Where the device is this machine's processors, its buffers are in RssAnon too: what /api/v1/memory says of them is taken off. What the
program held before, mostly the driver and its compiler, is printed beside that.
"""
import argparse
import json
import subprocess
import tempfile
import threading
import time
import urllib.request
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
MIB = 1 << 20


def rss_anon(pid):
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("RssAnon:"):
            return 1024 * int(line.split()[1])
    return 0


def write(folder, gib):
    side = 1024
    slices = int(gib * (1 << 30)) // (2 * side * side)
    plane = bytes((x * 7 + y) % 251 if k else (x + y) % 7 for y in range(side) for x in range(side) for k in (1, 0))
    with open(folder / "large.raw", "wb") as file:
        for _ in range(slices):
            file.write(plane)
    (folder / "large.json").write_text(json.dumps({"file": "large.raw", "type": "i16", "dims": [side, side, slices]}))
    return folder / "large.json"


def get(port, path):
    with urllib.request.urlopen(f"http://127.0.0.1:{port}{path}", timeout=600) as answer:
        return json.load(answer)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gib", type=float, default=2)
    parser.add_argument("--isopeel", type=Path, default=ROOT / "target/release/isopeel")
    parser.add_argument("--work", type=Path, help="where the volume is written; by default a folder that is removed")
    parser.add_argument("--port", type=int, default=8098)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=arguments.work) as temporary:
        path = write(Path(temporary), arguments.gib)
        server = subprocess.Popen([arguments.isopeel, "serve", "--no-auth", "--listen", f"127.0.0.1:{arguments.port}", path], stderr=subprocess.DEVNULL)
        try:
            before = None
            while before is None:
                time.sleep(0.5)
                try:
                    before = get(arguments.port, "/api/v1/memory") and rss_anon(server.pid)
                except OSError:
                    pass
            peak, done = [0], threading.Event()

            def watch():
                while not done.is_set():
                    peak[0] = max(peak[0], rss_anon(server.pid))
                    time.sleep(0.005)

            watcher = threading.Thread(target=watch)
            watcher.start()
            start = time.perf_counter()
            get(arguments.port, "/api/v1/volumes/large")
            seconds = time.perf_counter() - start
            done.set()
            watcher.join()
            memory = get(arguments.port, "/api/v1/memory")
        finally:
            server.terminate()
            server.wait()
    device = sum(memory[name] for name in ("volumeBytes", "otherDeviceBytes", "idleBytes")) if memory["isHostMemory"] else 0
    print(f"before {before // MIB} MiB, peak {peak[0] // MIB} MiB, of which the device's {device // MIB} MiB; loaded in {seconds:.1f} s")
    print(f"held beside the device's buffers: {(peak[0] - device) // MIB} MiB, {(peak[0] - device - before) // MIB} MiB more than before")


main()
