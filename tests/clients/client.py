"""A client that openapi-python-client has generated: extracts, submits, follows and fetches.

    client.py FOLDER URL VOLUME      # the folder has the package isopeel_client
"""
import hashlib
import sys
import time

folder, url, volume = sys.argv[1:]
sys.path.insert(0, folder)

from isopeel_client.api.extract import extract, extract_by_address
from isopeel_client.api.jobs import fetch_job_result, remove_job, show_job, show_job_results, submit_job
from isopeel_client.api.volumes import list_volumes, show_volume
from isopeel_client.client import Client
from isopeel_client.models import ExtractRequest, Format, JobRequest, JobState, Problem

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
assert remove_job.sync_detailed(job.id, client=client).status_code == 204
print(triangles)
