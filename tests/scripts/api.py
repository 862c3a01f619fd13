#!/usr/bin/env python3
"""Requests that schemathesis generates from server/openapi.json, to a server of the release binary.

    api.py ISOPEEL [EXAMPLES]

For each role of a token: requests of every operation, good ones and bad ones, and sequences of them by the document's links. Every
answer must be one that the document has: status, kind of content, schema and headers. EXAMPLES (100) is how many an operation gets.
"""

import os
import pathlib
import subprocess
import sys
import tempfile
import time
import urllib.request

ROLES = ["view", "edit", "export", "upload", "push", "admin"]
CHECKS = [
    "not_a_server_error",
    "status_code_conformance",
    "content_type_conformance",
    "response_headers_conformance",
    "response_schema_conformance",
    "use_after_free",
    "ignored_auth",
]
# Bodies and answers that are bytes, of which schemathesis knows nothing; and a volume that is there, in every second request.
HOOKS = '''
import schemathesis

KINDS = ["application/octet-stream", "application/zip", "model/3mf", "model/gltf-binary", "model/obj", "model/stl", "model/mesh", "model/vnd.usdz+zip"]

@schemathesis.serializer("application/offset+octet-stream")
def of_bytes(ctx, value):
    return value if isinstance(value, bytes) else str(value).encode()

@schemathesis.deserializer(*KINDS)
def as_text(ctx, response):
    return ""

def is_second():
    is_second.count += 1
    return is_second.count % 2 == 0

is_second.count = 0

@schemathesis.hook
def map_path_parameters(context, path_parameters):
    if path_parameters and context.operation.path.startswith("/api/v1/volumes/") and is_second():
        path_parameters["id"] = "VOLUME"
    return path_parameters

@schemathesis.hook
def map_query(context, query):
    if query and "volume" in query and is_second():
        query["volume"] = "VOLUME"
    return query

@schemathesis.hook
def map_body(context, body):
    if isinstance(body, dict) and "volume" in body and is_second():
        body["volume"] = "VOLUME"
    return body
'''
SECONDS_TO_START = 120


def main():
    binary, examples = os.path.abspath(sys.argv[1]), sys.argv[2] if len(sys.argv) > 2 else "100"
    repository = pathlib.Path(__file__).resolve().parents[2]
    volume = next((repository / "server" / "demo").glob("t1*.nii.gz"))
    with tempfile.TemporaryDirectory() as folder:
        state, hooks = pathlib.Path(folder, "state"), pathlib.Path(folder, "hooks.py")
        state.mkdir(mode=0o700)
        hooks.write_text(HOOKS.replace("VOLUME", volume.name.partition(".")[0]))
        tokens = {role: make_token(binary, state, role) for role in ROLES}
        with serve(binary, state, pathlib.Path(folder, "uploads"), volume) as (server, address):
            failed = [role for role, token in tokens.items() if not tries(address, role, token, hooks, examples)]
            if server.poll() is not None:
                failed.append("the server has ended")
    if failed:
        sys.exit(f"undocumented answers: {', '.join(failed)}")


def make_token(binary, state, role):
    command = [binary, "token", "create", "--state-folder", state, "--user", role, "--role", role]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()[-1]


class serve:
    """A server, while it runs, and its address."""

    def __init__(self, binary, state, uploads, volume):
        uploads.mkdir(mode=0o700)
        limits = ["--rate-token", "1000000", "--rate-peer", "1000000"]
        self.command = [binary, "serve", "--listen", "127.0.0.1:0", "--state-folder", state, "--uploads", uploads, *limits, volume]

    def __enter__(self):
        self.server = subprocess.Popen(self.command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        address = self.server.stdout.readline().split("#")[0].strip().rstrip("/")
        end = time.monotonic() + SECONDS_TO_START
        while time.monotonic() < end and not is_ready(address):
            time.sleep(0.2)
        return self.server, address

    def __exit__(self, *_):
        self.server.terminate()
        self.server.wait()


def is_ready(address):
    try:
        with urllib.request.urlopen(f"{address}/readyz") as answer:
            return answer.status == 200
    except OSError:
        return False


def tries(address, role, token, hooks, examples):
    """Whether all answers to a role are as documented."""
    print(f"=== {role}", flush=True)
    schemathesis = pathlib.Path(sys.executable).with_name("schemathesis")
    command = [schemathesis, "run", f"{address}/api/v1/openapi.json", "--header", f"Authorization: Bearer {token}"]
    command += ["--checks", ",".join(CHECKS), "--max-examples", examples, "--continue-on-failure", "--request-timeout", "60"]
    # Browsers are redirected to an issuer to sign in; and of a stream of events the document can say no more than that it is text.
    command += ["--exclude-path-regex", "/oidc/|/events$", "--warnings", "off"]
    environment = dict(os.environ, SCHEMATHESIS_HOOKS=hooks.stem, PYTHONPATH=str(hooks.parent))
    return subprocess.run(command, env=environment).returncode == 0


main()
