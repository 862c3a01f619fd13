/** Batch jobs: typed input, messages, and requests to the server. */

import { strFromU8, unzipSync } from "fflate";
import { afterEach, describe, expect, test, vi } from "vitest";
import { cancelJob, fetchResults, listJobs, removeJob, submitJob } from "../src/net/jobs";
import type { JobInfo } from "../src/protocol/types";
import { surfaceFileName, volumeName } from "../src/state/fileNames";
import { isovaluesOf, justFinished } from "../src/state/jobs";
import type { Store } from "../src/state/store";
import { NOTHING_KNOWN } from "./acting";
import { finishedText, formatDuration, jobText, submittedText } from "../src/ui/cards/jobWords";
import type { Model } from "../src/ui/model";
import { BatchJobs } from "../src/wiring/batchJobs";
import { OPENING } from "./fixture";

const BASE = new URL("http://host:1/below/");
const JOB: JobInfo = {
  id: "0123456789abcdef",
  volume: "head",
  state: "running",
  extractions: { total: 3, done: 1, failed: 0, empty: 0 },
  bytes: 1500,
  estimate: { triangles: 1000, bytes: 4500, seconds: 12 },
  submitted: 0,
};
const DONE: JobInfo = { ...JOB, state: "done", extractions: { total: 3, done: 3, failed: 0, empty: 0 } };

describe("isovalues that are typed", () => {
  test("are numbers with anything usual between them", () => {
    expect(isovaluesOf(" 40, 52.5;-1e2  .5 ")).toEqual([40, 52.5, -100, 0.5]);
    expect(isovaluesOf("7")).toEqual([7]);
    expect(isovaluesOf("1,2,3")).toEqual([1, 2, 3]);
  });

  test("else it is said what is wrong", () => {
    expect(isovaluesOf(" ")).toMatch(/expected a number/);
    for (const word of ["x", "1e", "0x10", "1e999", "5-7"]) expect(isovaluesOf(`1 ${word}`)).toContain(`“${word}” is no isovalue`);
    for (const word of ["1,5", "1,024", "1,024,000"]) expect(isovaluesOf(`7; ${word} 9`)).toContain(`“${word}” can be one isovalue or two`);
    expect(isovaluesOf(Array(10_001).fill("1").join(" "))).toBe("10001 isovalues, expected at most 10000");
  });
});

describe("a job in words", () => {
  test("says how far it is", () => {
    expect(jobText({ ...JOB, state: "queued" })).toBe("queued, 3 files");
    expect(jobText(JOB)).toBe("1 of 3 files");
    expect(jobText({ ...JOB, etaSeconds: 7200 })).toBe("1 of 3 files, about 2 h left");
    expect(jobText({ ...JOB, paused: "disk-full" })).toBe("1 of 3 files, stands still: the server’s disk is full");
    expect(jobText(DONE)).toBe("3 files, 1.5 kB");
    expect(jobText({ ...DONE, extractions: { total: 3, done: 2, failed: 0, empty: 1 } })).toBe("2 files, 1.5 kB, 1 without a surface");
    expect(jobText({ ...JOB, state: "cancelled" })).toBe("cancelled, 1 of 3 files, 1.5 kB");
    const failed: JobInfo = { ...JOB, state: "failed", extractions: { total: 3, done: 1, failed: 2, empty: 0 } };
    expect(jobText(failed)).toBe("failed, 1 of 3 files, 1.5 kB: 2 could not be made");
    expect(jobText({ ...failed, error: { code: "input-changed", detail: "head.nrrd has changed" } })).toContain("head.nrrd has changed");
    expect([0.2, 89, 90, 5399, 5400].map(formatDuration)).toEqual(["1 s", "89 s", "2 min", "90 min", "2 h"]);
    expect(submittedText(JOB)).toBe("The server makes 3 files: up to 4.5 kB, about 12 s when nobody else uses it");
  });

  test("its end is said once", () => {
    expect(justFinished([], [DONE])).toEqual([]);
    expect(justFinished([JOB], [DONE])).toEqual([DONE]);
    expect(justFinished([DONE], [DONE])).toEqual([]);
    expect(finishedText(DONE, undefined)).toBe("3 files of head are ready");
    expect(finishedText({ ...DONE, volume: "upload-1" }, [{ id: "upload-1", title: "Ann’s head" }])).toBe("3 files of Ann’s head are ready");
    expect(finishedText({ ...DONE, extractions: { total: 3, done: 1, failed: 0, empty: 2 } }, [])).toBe("1 file of head is ready, 2 without a surface");
    expect(finishedText({ ...DONE, state: "failed" }, [])).toBe("The batch job of head has failed");
  });
});

describe("a job that is submitted from the page", () => {
  test("is submitted once, however often Enter is pressed, and again after it has failed or is deleted", async () => {
    const said: string[] = [];
    let state: JobInfo["state"] = "queued";
    let posts = 0;
    let isListed = true;
    vi.stubGlobal("fetch", (_url: URL, { method }: RequestInit) => {
      if (method === "POST") posts += 1;
      return Promise.resolve(Response.json(method === undefined || method === "GET" ? (isListed ? [{ ...JOB, state }] : []) : { ...JOB, state }));
    });
    const store = { viewer: { ...NOTHING_KNOWN, view: OPENING, target: { volume: "head", step: 0 } } } as unknown as Store;
    const jobs = new BatchJobs(store, { toast: (text: string) => said.push(text) } as unknown as Model, BASE);
    await jobs.submit([7], "glb");
    await jobs.list();
    await jobs.submit([7], "glb");
    expect([posts, said.at(-1)]).toEqual([1, "This job is submitted already: change isovalues, format or settings for another one"]);
    await jobs.submit([8], "glb");
    expect(posts).toBe(2);
    state = "failed";
    await jobs.list();
    await jobs.submit([8], "glb");
    expect(posts).toBe(3);
    await jobs.remove(JOB);
    await jobs.submit([8], "glb");
    expect(posts).toBe(4);
    // Deleted by another page, or by the server.
    isListed = false;
    await jobs.list();
    await jobs.submit([8], "glb");
    expect(posts).toBe(5);
    vi.unstubAllGlobals();
  });
});

describe("names of files", () => {
  test("are those of the volume, of uploads their titles, with the isovalue or the labels", () => {
    expect(volumeName({ id: "ct-head", title: "CT of a head" })).toBe("ct-head");
    expect(volumeName({ id: "upload-6f1c", title: " Ann’s scan / 2.nii " })).toBe("Ann_s_scan_2.nii");
    expect(volumeName({ id: "upload-6f1c", title: "頭部 CT" })).toBe("頭部_CT");
    expect([volumeName(undefined), volumeName({ id: "upload-1", title: "///" })]).toEqual(["isopeel", "isopeel"]);
    expect([surfaceFileName({ id: "ct-head", title: "" }, 517.25, undefined), surfaceFileName({ id: "ct-head", title: "" }, 0.5, "Left Hippocampus")]).toEqual(["ct-head-517.25", "ct-head-Left_Hippocampus"]);
  });
});

describe("what is asked of the server", () => {
  const asked: { readonly path: string; readonly method: string; readonly options: RequestInit }[] = [];

  function answer(by: (path: string) => Response): void {
    vi.stubGlobal("fetch", (url: URL, options: RequestInit) => {
      asked.push({ path: url.pathname, method: options.method ?? "GET", options });
      return Promise.resolve(by(url.pathname));
    });
  }

  afterEach(() => {
    vi.unstubAllGlobals();
    asked.length = 0;
  });

  test("paths are those of the server, below where the page is", async () => {
    answer(() => Response.json([JOB]));
    expect(await listJobs(BASE)).toEqual([JOB]);
    await submitJob(BASE, { volume: "head", extractions: [{ iso: 7, step: 0, format: "glb" }] }, "key");
    await cancelJob(BASE, "a");
    await removeJob(BASE, "a");
    expect(asked.map(({ method, path }) => `${method} ${path}`)).toEqual(["GET /below/api/v1/jobs", "POST /below/api/v1/jobs", "POST /below/api/v1/jobs/a/cancel", "DELETE /below/api/v1/jobs/a"]);
    expect(asked[1]?.options.headers).toMatchObject({ "idempotency-key": "key" });
    answer(() => Response.json({ detail: "the user has 100 jobs that are not finished" }, { status: 429 }));
    await expect(listJobs(BASE)).rejects.toThrow("the user has 100 jobs");
  });

  const result = (path: string) =>
    path.endsWith("/1") ? Response.json({ code: "no-result" }, { status: 404 }) : new Response(path.slice(-1), { headers: { "content-disposition": `attachment; filename="0000${path.slice(-1)}-40.5.stl"` } });

  test("several results are one zip, without those that could not be made", async () => {
    answer(result);
    const { name, file } = await fetchResults(BASE, { ...JOB, extractions: { total: 3, done: 2, failed: 1, empty: 0 } }, "head");
    expect(name).toBe("head-01234567.zip");
    const found = unzipSync(new Uint8Array(await file.arrayBuffer()));
    expect(Object.entries(found).map(([name, bytes]) => [name, strFromU8(bytes)])).toEqual([["head-00000-40.5.stl", "0"], ["head-00002-40.5.stl", "2"]]);
  });

  test("one is the file itself, none and too much are said", async () => {
    answer(result);
    const { name, file } = await fetchResults(BASE, JOB, "head");
    expect([name, await file.text(), asked.length]).toEqual(["head-00000-40.5.stl", "0", 1]);
    answer(() => Response.json({}, { status: 404 }));
    await expect(fetchResults(BASE, JOB, "head")).rejects.toThrow("no results");
    await expect(fetchResults(BASE, { ...JOB, bytes: 2 ** 31 }, "head")).rejects.toThrow(`isopeel jobs fetch ${JOB.id}`);
  });
});
