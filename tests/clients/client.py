"""A client that openapi-python-client has generated: every operation but signing in.

    client.py FOLDER URL VOLUME      # the folder has the package isopeel_client
"""
import hashlib
import sys
import time

folder, url, volume = sys.argv[1:]
sys.path.insert(0, folder)

from io import BytesIO

from isopeel_client.api.extract import extract, extract_by_address
from isopeel_client.api.health import healthz, readyz, show_memory, show_metrics
from isopeel_client.api.jobs import cancel_job, fetch_job_result, follow_job, list_jobs, remove_job, show_job, show_job_results, submit_job
from isopeel_client.api.session import check_session, issue_ticket, show_embed, show_oidc, sign_out
from isopeel_client.api.uploads import (
    create_upload, finish_upload, list_uploads, remove_upload, send_upload_part, show_upload, show_upload_offset,
)
from isopeel_client.api.volumes import list_unreadable, list_volumes, show_expression, show_slice, show_volume
from isopeel_client.client import Client
from isopeel_client.models import ExtractRequest, Format, JobRequest, JobState, Problem, ShowSliceAxis, ShowSliceFormat, UploadRequest
from isopeel_client.types import File

client = Client(base_url=url, timeout=120)
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

assert healthz.sync(client=client) and readyz.sync(client=client)
assert "isopeel_" in show_metrics.sync(client=client)
assert not isinstance(show_memory.sync(client=client), Problem)
assert list_unreadable.sync(client=client) == []
described = show_expression.sync(volume, client=client, expression="2 * t1")
assert not isinstance(described, Problem), described
plane = show_slice.sync(volume, client=client, axis=ShowSliceAxis.Z, index=20, format_=ShowSliceFormat.NII).payload.read()
assert plane[344:347] == b"n+1", plane[:4]

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

# A server without tokens and without an issuer has little to say of sessions.
for answer in (
    show_embed.sync_detailed(client=client), show_oidc.sync_detailed(client=client), check_session.sync_detailed(client=client),
    issue_ticket.sync_detailed(client=client), sign_out.sync_detailed(client=client),
):
    assert answer.status_code < 500, answer
print(triangles)
