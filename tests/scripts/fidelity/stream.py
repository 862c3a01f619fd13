"""The surface that a viewer on a CPU has at `done`, before a better one: a cut of cubes. Written from server/PROTOCOL.md."""
import asyncio
import json
import re
import struct
import subprocess

import meshoptimizer
import numpy as np
import websockets


def decode_chunk(frame):
    """Region (size and coordinates), its vertices in index space, its triangles."""
    if frame[:4] != b"ISOP":
        raise SystemExit("a chunk without its magic")
    version, size = (struct.unpack_from("<H", frame, at)[0] for at in (4, 18))
    if version != 3 or size > 2:
        raise SystemExit(f"a chunk of version {version} and size {size}, expected version 3 and a size up to 2")
    lattice = struct.unpack_from("<H", frame, 16)[0]
    coordinates = struct.unpack_from("<3I", frame, 20)
    region = size, *coordinates
    vertices, indices, vertex_bytes, _ = struct.unpack_from("<4I", frame, 56)
    if vertices == 0:
        return region, np.empty((0, 3)), np.empty((0, 3), np.int64)
    payload = frame[96:]
    # Of another type than its default, floats, the decoder returns an array of the wrong size.
    records = meshoptimizer.decode_vertex_buffer(vertices, 12, payload[:vertex_bytes])
    lattice_points = np.ascontiguousarray(records).view("<i2").reshape(vertices, 6)[:, :3]
    faces = meshoptimizer.decode_index_buffer(indices, 4, payload[vertex_bytes:])
    return region, np.array(coordinates) * 32 + lattice_points / lattice, np.asarray(faces).reshape(-1, 3).astype(np.int64)


async def first_surface(uri, volume, edit):
    """Vertices in index space, triangles and statistics of an edit's first `done`."""
    regions = {}
    async with websockets.connect(uri, subprotocols=["isopeel.v3"], max_size=None, compression=None) as socket:
        await socket.send(json.dumps({"type": "open", "volume": volume}))
        await socket.send(json.dumps({"type": "edit", **edit}))
        while True:
            frame = await asyncio.wait_for(socket.recv(), 300)
            if isinstance(frame, bytes):
                region, points, faces = decode_chunk(frame)
                regions[region] = points, faces
                continue
            message = json.loads(frame)
            if message["type"] == "error":
                raise SystemExit(f"the server answered {message}")
            if message["type"] == "done":
                break
    starts = np.cumsum([0] + [len(points) for points, _ in regions.values()])
    points = np.concatenate([points for points, _ in regions.values()])
    faces = np.concatenate([faces + start for (_, faces), start in zip(regions.values(), starts)])
    if len(faces) != message["statistics"]["triangles"]:
        raise SystemExit(f"{len(faces)} triangles received, {message['statistics']['triangles']} stated")
    return points, faces, message["statistics"]


def cut_of_cubes(isopeel, path, edit):
    """What `first_surface` has of the volume at `path`, from a server of its own."""
    command = [isopeel, "serve", "--no-auth", "--no-demo", "--listen", "127.0.0.1:0", path]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as server:
        try:
            address = re.search(r"http://(\S+)", server.stdout.readline())[1]
            surface = asyncio.run(first_surface(f"ws://{address}/api/v1/stream", path.stem, edit))
        finally:
            server.terminate()
    if surface[2]["isTreeCut"]:
        raise SystemExit("the first surface is a tree cut already: the cut of cubes comes first on a CPU alone (--device)")
    return surface
