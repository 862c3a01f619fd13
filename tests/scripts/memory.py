#!/usr/bin/env python3
"""How much of the server's memory it explains, after many edits by several viewers.

    tests/scripts/memory.py [--edits 10000] [--viewers 4] [--volume FILE] [--isopeel target/release/isopeel]

Starts a server, edits as viewers do (isovalue, beta, alpha, budget, feature; some edits replace the one before), and prints what
GET /api/v1/memory says beside what the operating system says. Makes its own virtual environment in target/memory-venv.
"""
import argparse
import json
import os
import random
import subprocess
import sys
import time
import urllib.request
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
VENV = ROOT / "target" / "memory-venv"

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--edits", type=int, default=10_000)
parser.add_argument("--viewers", type=int, default=4)
parser.add_argument("--volume", help="a volume instead of the demo")
parser.add_argument("--isopeel", type=Path, default=ROOT / "target/release/isopeel", help="the binary to measure")
parser.add_argument("--port", type=int, default=8099)
args = parser.parse_args()

if Path(sys.prefix) != VENV:
    if not (VENV / "bin/python").exists():
        venv.create(VENV, with_pip=True)
        subprocess.run([VENV / "bin/pip", "install", "-q", "websockets==15.*"], check=True)
    os.execv(VENV / "bin/python", [VENV / "bin/python", *sys.argv])

import asyncio  # noqa: E402

import websockets  # noqa: E402


def get(path):
    with urllib.request.urlopen(f"http://127.0.0.1:{args.port}{path}") as answer:
        return json.load(answer)


def report(count):
    memory = get("/api/v1/memory")
    explained = sum(n for name, n in memory.items() if name.endswith("Bytes") and name != "residentBytes")
    if not memory["isHostMemory"]:
        explained = memory["programBytes"] + memory["surfaceBytes"]
    print(json.dumps({"edits": count, **memory, "explained": explained, "ratio": round(memory["residentBytes"] / explained, 3)}), flush=True)


async def viewer(number, volume, isovalues):
    chosen = random.Random(number)
    uri = f"ws://127.0.0.1:{args.port}/api/v1/stream"
    async with websockets.connect(uri, subprotocols=["isopeel.v3"], max_size=None, compression=None) as socket:
        await socket.send(json.dumps({"type": "open", "volume": volume}))
        for edit in range(args.edits // args.viewers):
            kinds = [{"iso": chosen.uniform(*isovalues)}, {"beta": chosen.uniform(0.01, 0.3)}, {"alpha": chosen.random()},
                     {"triangles": chosen.randrange(20_000, 300_000)}, {"feature": chosen.choice(["none", "gradient-magnitude"])}]
            await socket.send(json.dumps({"type": "edit", **chosen.choices(kinds, [8, 4, 3, 3, 2])[0]}))
            if chosen.random() < 0.3:
                continue  # the next edit replaces this one
            while True:
                frame = await asyncio.wait_for(socket.recv(), 60)
                if isinstance(frame, str) and json.loads(frame)["type"] in ("done", "error"):
                    break
            if number == 0 and edit % 250 == 0:
                report(edit * args.viewers)


async def viewers():
    volume = get("/api/v1/volumes")[0]["id"]
    field = get(f"/api/v1/volumes/{volume}")["fields"][0]
    low, high = field["range"]
    isovalues = (low + 0.4 * (high - low), low + 0.5 * (high - low))
    await asyncio.gather(*(viewer(number, volume, isovalues) for number in range(args.viewers)))


server = subprocess.Popen([args.isopeel, "serve", "--no-auth", "--listen", f"127.0.0.1:{args.port}", *([args.volume] if args.volume else [])], stderr=subprocess.DEVNULL)
try:
    for _ in range(100):
        time.sleep(0.2)
        try:
            report(0)
            break
        except OSError:
            continue
    asyncio.run(viewers())
    report(args.edits)
finally:
    server.terminate()
    server.wait()
