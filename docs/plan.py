#!/usr/bin/env python3
"""Plans many servers behind one proxy (docs/scaling.md): viewers, volumes, bytes and devices, up to a million viewers.

    python3 docs/plan.py           prints the tables
    python3 docs/plan.py --write   writes them into docs/scaling.md
    python3 docs/plan.py --check   fails when those in docs/scaling.md differ

It is a model: volumes are placed by consistent hashing as nginx does it, and everything else is arithmetic with the assumptions below. What
is measured names its source; what is assumed says so. Standard library only; the same assumptions give the same tables.
"""

import argparse
import bisect
import dataclasses
import hashlib
import math
import pathlib
import sys

PAGE = pathlib.Path(__file__).resolve().parent / "scaling.md"
BEGIN, END = "<!-- docs/plan.py -->", "<!-- end of docs/plan.py -->"


@dataclasses.dataclass(frozen=True)
class Given:
    """A number of the model, and its source."""

    value: float
    text: str
    source: str


MEASURED = "measured"
ASSUMED = "assumed"
GIVENS = {
    "seats": Given(1024, "viewers that a server takes", "limit, server/src/stream/viewers.rs"),
    "edits": Given(52, "edits a second of a server with one H200, 256³", f"{MEASURED}, 64 viewers with volumes of their own"),
    "edit_mb": Given(3.8, "MB sent for an edit of the isovalue, 512³, as a volume opens", f"{MEASURED}, BENCHMARKS.md, H200"),
    "open_mb": Given(3.8, "MB sent when a volume is opened", f"{ASSUMED}, as an edit"),
    "load_gbs": Given(1.3, "GB/s at which a server reads a time step", f"{MEASURED}, BENCHMARKS.md: 0.54 GB in 0.40 s"),
    "back_s": Given(1.8, "s until edits work again after a server was killed, a small volume", f"{MEASURED}, above, nginx, the slowest of four"),
    "host_gb": Given(1.9, "GB of host memory for 1,000 viewers, beyond volumes", f"{MEASURED}, reliability.md"),
    "page_mb": Given(0.44, "MB of the page, compressed", f"{MEASURED}, web/dist"),
    "summary_b": Given(134, "bytes of a volume in the list of volumes", f"{MEASURED}, without notices"),
    "packed": Given(12, "ratio by which that list is compressed", f"{MEASURED}, 10,000 of them"),
    "device_gb": Given(99.5, "GB of an H200 for volumes, two thirds of its memory", "limit, docs/command-line.md"),
    "points": Given(160, "points of a server on nginx's ring", "nginx, ngx_http_upstream_hash_module"),
    "volume_gb": Given(0.54, "GB of a volume, 512³ of 4 bytes", ASSUMED),
    "volumes": Given(10_000, "volumes behind one address", ASSUMED),
    "exponent": Given(1.0, "popularity: the n-th volume has viewers in proportion to 1 ÷ n", ASSUMED),
    "active": Given(0.1, "share of viewers who edit", ASSUMED),
    "rate": Given(0.2, "edits a second of a viewer who edits, on average over drags and pauses", ASSUMED),
    "alike": Given(0.5, "share of edits whose surface another viewer has too, so that it is made once", ASSUMED),
    "session_s": Given(900, "s that a viewer stays with a volume", ASSUMED),
    "bound": Given(1000, "viewers of a server above which the proxy takes the next one on the ring", "choice, `max_conns`"),
    "line_gbits": Given(25, "Gbit/s of a proxy's and of a server's line", ASSUMED),
    "fill": Given(0.5, "of a line or of a server's edits that are used", "choice"),
    "failure_h": Given(2000, "h between two failures of a server", ASSUMED),
}
CASES = [(2, 1_500), (10, 8_000), (100, 80_000), (1_000, 800_000), (1_000, 1_000_000), (1_250, 1_000_000)]
# The viewers of a volume are divided into this many parts. One part of each volume comes after the other.
ROUNDS = 10


def given(name):
    return GIVENS[name].value


def position(text):
    return int.from_bytes(hashlib.blake2b(text.encode(), digest_size=8).digest(), "big")


def ring_of(servers):
    """The ring: sorted points, and the server of each."""
    points = [(position(f"server {s} point {p}"), s) for s in range(servers) for p in range(int(given("points")))]
    points.sort()
    return [at for at, _ in points], [server for _, server in points]


class Ring:
    """A ring, some of whose servers take no more: their points lead to the next ones."""

    def __init__(self, ring, gone=()):
        self.places, self.servers = ring
        self.next = list(range(len(self.places)))
        self.closed = set(gone)
        self.all = len(set(self.servers))

    def close(self, server):
        self.closed.add(server)

    def first(self, key):
        """The point of a key."""
        return bisect.bisect_left(self.places, position(key)) % len(self.places)

    def open_from(self, point):
        """The server of the first point from this one whose server takes more; `None`: there is none."""
        if len(self.closed) == self.all:
            return None
        passed, at = [], point
        while self.servers[self.next[at]] in self.closed:
            passed.append(at)
            at = (self.next[at] + 1) % len(self.places)
        for before in passed:
            self.next[before] = self.next[at]
        return self.servers[self.next[at]]


def viewers_of_volumes(viewers):
    """Viewers of each volume, the most popular first."""
    weights = [1 / n ** given("exponent") for n in range(1, int(given("volumes")) + 1)]
    total = sum(weights)
    return [viewers * weight / total for weight in weights]


def unbounded(ring, servers, volumes):
    """Viewers of each server, if each volume is at one."""
    load, ring = [0.0] * servers, Ring(ring)
    for n, viewers in enumerate(volumes):
        load[ring.servers[ring.first(f"volume {n}")]] += viewers
    return load


def bounded(ring, servers, volumes, gone=()):
    """Viewers come in turns, and go to the first server on the ring with free capacity. Returns the viewers of each server, those of each
    volume at each server, and the number that has found no place."""
    load, places, without, ring = [0.0] * servers, [{} for _ in volumes], 0.0, Ring(ring, gone)
    points = [ring.first(f"volume {n}") for n in range(len(volumes))]
    for _ in range(ROUNDS):
        for n, viewers in enumerate(volumes):
            left = viewers / ROUNDS
            while left > 0:
                server = ring.open_from(points[n])
                if server is None:
                    without += left
                    break
                taken = min(left, given("bound") - load[server])
                load[server] += taken
                places[n][server] = places[n].get(server, 0) + taken
                left -= taken
                if load[server] >= given("bound"):
                    ring.close(server)
    return load, places, without


def opened_at(places, servers):
    """Expected number of open volumes of each server: a volume with 0.1 viewers on average is open a tenth of the time."""
    expected = [0.0] * servers
    for at in places:
        for server, viewers in at.items():
            expected[server] += 1 - math.exp(-viewers)
    return expected


def plan(servers, viewers):
    """The figures of one column."""
    ring, volumes = ring_of(servers), viewers_of_volumes(viewers)
    load, places, without = bounded(ring, servers, volumes)
    opened = opened_at(places, servers)
    owners = Ring(ring)
    first = sum(at.get(owners.servers[owners.first(f"volume {n}")], 0) for n, at in enumerate(places))
    fullest = max(range(servers), key=load.__getitem__)
    _, _, without_one = bounded(ring, servers, volumes, [fullest])
    mean = viewers / servers
    edits = mean * given("active") * given("rate")
    made = edits * (1 - given("alike"))
    list_mb = given("volumes") * given("summary_b") / 1e6 / given("packed")
    mb = edits * given("edit_mb") + mean / given("session_s") * (given("open_mb") + given("page_mb") + list_mb)
    all_gbits = mb * 8 / 1000 * servers
    each_gb = given("volume_gb")
    return {
        "case": f"{number(servers)}; {number(viewers)}",
        "mean": number(mean),
        "ring": number(max(unbounded(ring, servers, volumes))),
        "bound": number(max(load)),
        "first": f"{number(100 * first / viewers)} %",
        "copies": number(len(places[0])),
        "without": number(without),
        "without_one": number(without_one),
        "open": number(max(opened)),
        "device": number(max(opened) * each_gb),
        "host": number(mean / 1000 * given("host_gb"), 1),
        "made": f"{number(made, 1)}; {number(100 * made / given('edits'))} %",
        "gbits": f"{number(all_gbits / servers, 2)}; {number(all_gbits)}",
        "proxies": number(math.ceil(all_gbits / given("line_gbits") / given("fill"))),
        "failures": number(servers / given("failure_h") * 24, 2),
        "waits": number(365 * 24 / given("failure_h") * (given("back_s") + each_gb / given("load_gbs")), 1),
        "reload": number(max(opened) * each_gb / given("load_gbs")),
    }


ROWS = {
    "mean": "viewers of a server, mean",
    "ring": "fullest server, by the ring alone",
    "bound": "fullest server, with the bound",
    "first": "viewers at the first server of their volume",
    "copies": "servers that have the most popular volume",
    "without": "viewers without a place",
    "without_one": "the same, when the fullest server has ended",
    "open": "open volumes of a server, most",
    "device": "GB of them",
    "host": "GB of host memory beyond volumes, mean",
    "made": "surfaces made a second by a server; share of its device",
    "gbits": "Gbit/s of a server; of all",
    "proxies": "proxies",
    "failures": "servers that fail a day",
    "waits": "s a year in which a viewer waits after failures",
    "reload": "s in which a server reads all of its volumes",
}


def number(value, digits=0):
    return f"{value:,.{digits}f}"


def table(head, rows):
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def tables():
    def shown(value):
        return number(value, 0 if value == int(value) else 1 if value >= 10 else 2)

    givens = [[entry.text, shown(entry.value), entry.source] for entry in GIVENS.values()]
    columns = [plan(*case) for case in CASES]
    results = [[text, *(column[name] for column in columns)] for name, text in ROWS.items()]
    return "\n\n".join(
        [
            table(["a number of the model", "value", "from"], givens),
            table(["servers; viewers", *(column["case"] for column in columns)], results),
        ]
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="write the tables into docs/scaling.md")
    parser.add_argument("--check", action="store_true", help="fail when those in docs/scaling.md differ")
    args = parser.parse_args()
    text = tables()
    if not args.write and not args.check:
        print(text)
        return
    page = PAGE.read_text()
    before, _, rest = page.partition(BEGIN)
    _, _, after = rest.partition(END)
    if not rest or not after:
        sys.exit(f"plan.py: docs/scaling.md has no {BEGIN} and {END}")
    wanted = f"{before}{BEGIN}\n\n{text}\n\n{END}{after}"
    if args.write:
        PAGE.write_text(wanted)
    elif page != wanted:
        sys.exit("plan.py: the tables in docs/scaling.md are not those of docs/plan.py: type docs/plan.py --write")


if __name__ == "__main__":
    main()
