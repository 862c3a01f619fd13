"""A client that openapi-python-client has generated: every operation, and the types of their answers.

    client.py FOLDER URL VOLUME TOKEN DESCRIPTION      # the folder has the package isopeel_client, the description is openapi.json
"""
import hashlib
import importlib
import json
import re
import sys
import time
import typing
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

folder, url, volume, token, description = sys.argv[1:]
sys.path.insert(0, folder)

from io import BytesIO

from isopeel_client.api.extract import extract, extract_by_address
from isopeel_client.api.health import healthz, list_devices, readyz, show_memory, show_metrics
from isopeel_client.api.jobs import cancel_job, fetch_job_result, follow_job, list_jobs, remove_job, show_job, show_job_results, submit_job
from isopeel_client.api.session import (
    begin_session, check_session, complete_sign_in, issue_ticket, lend_embed_token, show_embed, show_oidc, sign_in, sign_out,
)
from isopeel_client.api.uploads import (
    create_upload, finish_upload, list_uploads, remove_upload, send_upload_part, show_upload, show_upload_offset,
)
from isopeel_client.api.volumes import list_unreadable, list_volumes, show_expression, show_overview, show_slice, show_volume
from isopeel_client.client import AuthenticatedClient, Client
from isopeel_client.models import (
    EmbedTokenRequest, ExtractRequest, FieldInfo, Format, JobRequest, JobState, Problem, Role, SessionRequest, ShowSliceAxis, ShowSliceFormat,
    UploadRequest,
)
from isopeel_client.types import File

OPERATIONS = [
    (method, path, operation)
    for path, item in json.loads(Path(description).read_text())["paths"].items()
    for method, operation in item.items()
    if "operationId" in operation
]


def expected_types(operation):
    """Names of the types that bodies of answers have in Python."""
    for status, response in operation["responses"].items():
        for content in response.get("content", {}).values():
            if status < "300" or status == "401":
                for schema in content["schema"].get("oneOf", [content["schema"]]):
                    yield schema["$ref"].rpartition("/")[2] if "$ref" in schema else {"array": "list", "string": "str"}[schema["type"]]


def check_types():
    """Each operation has a function for waiting and one for asyncio, whose results have the types of its answers."""
    assert len(OPERATIONS) > 30, OPERATIONS
    for _, _, operation in OPERATIONS:
        name = operation["operationId"]
        module = importlib.import_module(f"isopeel_client.api.{operation['tags'][0]}.{name}")
        for function in (module.sync_detailed, module.asyncio_detailed):
            (answer,) = typing.get_args(typing.get_type_hints(function)["return"])
            types = {getattr(each, "__name__", str(each)) for each in typing.get_args(answer) or [answer]}
            types |= {"list"} if typing.get_origin(answer) is list else set()
            missing = set(expected_types(operation)) - types
            assert not missing, f"{name}: {types}, without {missing}"


requested = []


def client_of(kind, **options):
    hooks = {"request": [lambda request: requested.append((request.method, request.url.path))]}
    return kind(base_url=url, timeout=120, httpx_args={"event_hooks": hooks}, **options)


check_types()
client, stranger = client_of(AuthenticatedClient, token=token), client_of(Client)
assert volume in [summary.id for summary in list_volumes.sync(client=client)]
info = show_volume.sync(volume, client=client)
assert not isinstance(info, Problem), info

wanted = {"iso": 100, "triangles": {"share": 0.05}, "format": "stl"}
posted = extract.sync(client=client, body=ExtractRequest.from_dict({"volume": volume, **wanted})).payload.read()
triangles = int.from_bytes(posted[80:84], "little")
assert triangles > 100 and len(posted) == 84 + 50 * triangles, (triangles, len(posted))
by_address = extract_by_address.sync(client=client, volume=volume, format_=Format.STL, iso=100).payload.read()
assert len(by_address) > len(posted)

refused = extract.sync(client=client, body=ExtractRequest.from_dict({"volume": volume, "iso": 1e6, "format": "stl"}))
assert isinstance(refused, Problem) and refused.code == "empty-surface", refused

job = submit_job.sync(client=client, body=JobRequest.from_dict({"volume": volume, "extractions": [wanted, {**wanted, "iso": 1e6}]}))
deadline = time.monotonic() + 120
while job.state in (JobState.QUEUED, JobState.RUNNING):
    assert time.monotonic() < deadline, job
    time.sleep(0.05)
    job = show_job.sync(job.id, client=client)
assert job.state == JobState.DONE and job.extractions.empty == 1, job
first, second = show_job_results.sync(job.id, client=client)
assert second.problem.code == "empty-surface", second
fetched = fetch_job_result.sync(job.id, 0, client=client).payload.read()
assert fetched == posted and hashlib.sha256(fetched).hexdigest() == first.sha256
missing = fetch_job_result.sync(job.id, 1, client=client)
assert isinstance(missing, Problem) and missing.code == "no-result", missing
events = follow_job.sync(job.id, client=client)
assert isinstance(events, str) and "event: done" in events, events
assert job.id in [other.id for other in list_jobs.sync(client=client)]
other = submit_job.sync(client=client, body=JobRequest.from_dict({"volume": volume, "extractions": [wanted] * 20}))
cancelled = cancel_job.sync(other.id, client=client)
assert not isinstance(cancelled, Problem), cancelled
assert remove_job.sync_detailed(job.id, client=client).status_code == 204

assert healthz.sync(client=stranger) and readyz.sync(client=stranger)
assert "isopeel_" in show_metrics.sync(client=client)
assert not isinstance(show_memory.sync(client=client), Problem)
assert [status.device for status in list_devices.sync(client=client)] == [0]
assert list_unreadable.sync(client=client) == []
described = show_expression.sync(volume, client=client, expression="2 * t1")
assert isinstance(described, FieldInfo), described
mistake = show_expression.sync(volume, client=client, expression="2 *", typed=True)
assert isinstance(mistake, Problem) and mistake.code == "bad-edit", mistake
plane = show_slice.sync(volume, client=client, axis=ShowSliceAxis.Z, index=20, format_=ShowSliceFormat.NII).payload.read()
assert plane[344:347] == b"n+1", plane[:4]
assert len(show_overview.sync(volume, client=client).payload.read()) > 1000

# A volume that the client brings.
header = b"NRRD0004\ntype: uint8\ndimension: 3\nsizes: 4 4 4\nencoding: raw\n\n"
content = header + bytes(range(64))
upload = create_upload.sync(client=client, body=UploadRequest.from_dict({"files": [{"name": "ramp.nrrd", "bytes": len(content)}]}))
assert not isinstance(upload, Problem), upload
part = File(payload=BytesIO(content))
assert send_upload_part.sync_detailed(upload.id, client=client, body=part, upload_offset=0, tus_resumable="1.0.0").status_code == 204
assert show_upload_offset.sync_detailed(upload.id, client=client).headers["upload-offset"] == str(len(content))
assert not isinstance(finish_upload.sync(upload.id, client=client), Problem)
assert not isinstance(show_upload.sync(upload.id, client=client), Problem)
assert upload.id in [other.id for other in list_uploads.sync(client=client).uploads]
assert remove_upload.sync_detailed(upload.id, client=client).status_code == 204

# A page with the token, a frame with a token that was lent, and a browser that an issuer sends back.
assert show_embed.sync(client=stranger).origins == []
refused = check_session.sync(client=stranger)
assert isinstance(refused, Problem) and refused.code == "unauthorized", refused
# Changes by a cookie need the page that they come from.
page = client_of(Client, headers={"origin": url})
assert begin_session.sync_detailed(client=page, body=SessionRequest(token=token)).status_code == 204
assert Role.ADMIN in check_session.sync(client=page).roles
assert issue_ticket.sync(client=page).ticket
assert not isinstance(sign_out.sync(client=page), Problem)
lent = lend_embed_token.sync(client=client, body=EmbedTokenRequest(roles=[Role.VIEW], seconds=60))
assert not isinstance(lent, Problem), lent
assert check_session.sync(client=client_of(AuthenticatedClient, token=lent.token)).roles == [Role.VIEW]
assert show_oidc.sync(client=stranger).sign_in
browser = client_of(Client)
leave = sign_in.sync_detailed(client=browser)
assert leave.status_code == 303, leave
asked = parse_qs(urlsplit(leave.headers["location"]).query)
back = complete_sign_in.sync_detailed(client=browser, code=asked["nonce"][0], state=asked["state"][0])
assert (back.status_code, back.headers["location"]) == (303, f"{url}/"), back
assert check_session.sync(client=browser).roles == [Role.VIEW]

for method, path, operation in OPERATIONS:
    pattern = re.sub(r"\{\w+\}", "[^/]+", path)
    is_used = any(method.upper() == other and re.fullmatch(pattern, at) for other, at in requested)
    assert is_used, f"{operation['operationId']} was not used"
print(triangles)
