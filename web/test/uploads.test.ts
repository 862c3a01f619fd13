/** What is sent of files that the user brings, and what is done when it fails: with a server's answers, and tus-js-client's own client. */

import { createServer, type IncomingMessage, type Server, type ServerResponse } from "node:http";
import type { AddressInfo } from "node:net";
import { Readable } from "node:stream";
import type { ReadableStream } from "node:stream/web";
import type { UploadOptions } from "tus-js-client";
import { afterEach, describe, expect, test, vi } from "vitest";
import { isPassing, keyOf, upload, type NamedFile, type UploadPhase } from "../src/net/uploads";
import { tidy } from "../src/ui/dropped";
import { removedText, uploadText } from "../src/ui/words";

// Its build for Node.js reads streams, that for browsers blobs.
vi.mock("tus-js-client", async (original) => {
  const tus = await original<typeof import("tus-js-client")>();
  class Upload extends tus.Upload {
    constructor(blob: Blob, options: UploadOptions) {
      super(Readable.fromWeb(blob.stream() as ReadableStream), { ...options, uploadSize: blob.size });
    }
  }
  return { ...tus, Upload };
});

const named = (name: string, text = name, lastModified = 1): NamedFile => ({ name, file: new File([text], name, { lastModified }) });

let server: Server | undefined;
afterEach(() => server?.close());

/** A server that keeps an upload, and fails the requests for which `fail` returns a status. */
async function serve(fail: (request: IncomingMessage, received: string) => number | undefined) {
  const seen: string[] = [];
  let [received, length] = ["", 0];
  const read = async (request: IncomingMessage) => {
    let body = "";
    for await (const piece of request) body += String(piece);
    return body;
  };
  const respond = async (request: IncomingMessage, response: ServerResponse) => {
    const { method = "", url = "" } = request;
    seen.push(`${method} ${url}`);
    const body = await read(request);
    const status = fail(request, received);
    if (status !== undefined) {
      response.writeHead(status, { "content-type": "application/problem+json" });
      return response.end(JSON.stringify({ detail: `refused with ${status}` }));
    }
    const info = { id: "u1", state: "receiving", title: "scan", bytes: length, receivedBytes: received.length, volumes: ["upload-u1"], error: null };
    const tus = { "tus-resumable": "1.0.0", "upload-length": String(length) };
    if (method === "POST" && url === "/lab/api/v1/uploads") {
      length = (JSON.parse(body) as { files: { bytes: number }[] }).files.reduce((sum, { bytes }) => sum + bytes, 0);
      seen.push(body);
      response.writeHead(201, { "content-type": "application/json" });
      return response.end(JSON.stringify(info));
    }
    if (method === "PATCH") {
      if (Number(request.headers["upload-offset"]) !== received.length) return response.writeHead(409).end();
      received += body;
    }
    if (method === "HEAD" || method === "PATCH") return response.writeHead(method === "HEAD" ? 200 : 204, { ...tus, "upload-offset": String(received.length) }).end();
    if (method === "POST") return response.writeHead(200, { "content-type": "application/json" }).end(JSON.stringify({ ...info, state: "ready" }));
    return response.writeHead(204).end();
  };
  server = createServer((request, response) => void respond(request, response));
  await new Promise<void>((done) => server?.listen(0, "127.0.0.1", done));
  const { port } = server.address() as AddressInfo;
  return { base: new URL(`http://127.0.0.1:${port}/lab/`), seen, received: () => received };
}

describe("an upload", () => {
  test("sends its files one after the other, below the page's own path, and is read", async () => {
    const { base, seen, received } = await serve(() => undefined);
    const phases: UploadPhase[] = [];
    const files = [named("scan/1.dcm", "abc"), named("scan/2.dcm", "defg")];
    const made = await upload(base, files, new AbortController().signal, (phase) => phases.push(phase));
    expect(made.volumes).toEqual(["upload-u1"]);
    expect(received()).toBe("abcdefg");
    expect(JSON.parse(seen[1] ?? "")).toEqual({ files: [{ name: "scan/1.dcm", bytes: 3 }, { name: "scan/2.dcm", bytes: 4 }] });
    expect(seen.filter((line) => line.startsWith("P"))).toEqual(["POST /lab/api/v1/uploads", "PATCH /lab/api/v1/uploads/u1", "POST /lab/api/v1/uploads/u1/finish"]);
    expect([phases[0], phases.at(-1)]).toEqual(["declaring", "reading"]);
    expect(phases).toContain("sending");
  });

  test("goes on where it was when the server is busy for a while", async () => {
    let failures = 0;
    const { base, received } = await serve((request) => (request.method === "PATCH" && (failures += 1) <= 1 ? 503 : undefined));
    const phases: UploadPhase[] = [];
    await upload(base, [named("a.nii", "0123456789")], new AbortController().signal, (phase) => phases.push(phase));
    expect(received()).toBe("0123456789");
    expect(phases).toContain("waiting");
  });

  test("is read when the server is back", async () => {
    let failures = 0;
    const { base, seen } = await serve((request) => (request.url?.endsWith("/finish") === true && (failures += 1) <= 1 ? 503 : undefined));
    const made = await upload(base, [named("a.nii")], new AbortController().signal, () => undefined);
    expect(made.state).toBe("ready");
    expect(seen.filter((line) => line.endsWith("/finish")).length).toBe(2);
  });

  test("that the server has removed meanwhile says so", async () => {
    const { base } = await serve((request) => (request.method === "HEAD" ? 404 : undefined));
    await expect(upload(base, [named("a.nii")], new AbortController().signal, () => undefined)).rejects.toThrow("the server has removed the upload meanwhile");
  });

  test("ends with the server's own words where nothing helps", async () => {
    const full = await serve((request) => (request.method === "PATCH" ? 507 : undefined));
    await expect(upload(full.base, [named("a.nii")], new AbortController().signal, () => undefined)).rejects.toThrow("refused with 507");
    server?.close();
    const off = await serve(() => 501);
    await expect(upload(off.base, [named("a.nii")], new AbortController().signal, () => undefined)).rejects.toThrow("refused with 501");
    expect([0, 409, 423, 429, 503].every(isPassing)).toBe(true);
    expect([400, 403, 404, 413, 501, 507].some(isPassing)).toBe(false);
  });

  test("that is cancelled before the server has answered is removed too", async () => {
    const cancelled = new AbortController();
    const { base, seen } = await serve((request) => {
      if (request.url?.endsWith("/uploads") === true) cancelled.abort();
      return undefined;
    });
    await expect(upload(base, [named("a.nii")], cancelled.signal, () => undefined)).rejects.toThrow();
    expect(seen.at(-1)).toBe("DELETE /lab/api/v1/uploads/u1");
  });

  test("that is cancelled is removed", async () => {
    const cancelled = new AbortController();
    const { base, seen } = await serve((request) => {
      if (request.method === "PATCH") cancelled.abort();
      return undefined;
    });
    await expect(upload(base, [named("a.nii")], cancelled.signal, () => undefined)).rejects.toThrow();
    expect(seen.at(-1)).toBe("DELETE /lab/api/v1/uploads/u1");
  });
});

describe("files", () => {
  test("are the same upload when they are dropped again, and another one when they have changed", () => {
    const files = [named("a", "x"), named("b", "yy")];
    expect(keyOf(files)).toBe(keyOf([named("a", "z"), named("b", "zz")]));
    for (const other of [[named("a", "x")], [named("a", "xx"), named("b", "yy")], [named("a", "x", 2), named("b", "yy")], [named("c", "x"), named("b", "yy")]]) {
      expect(keyOf(other)).not.toBe(keyOf(files));
    }
    expect(keyOf(files)).toMatch(/^[\x21-\x7e]{1,255}$/);
  });

  test("are in the order of their names, without what systems leave", () => {
    const names = ["scan/2.dcm", "scan/.DS_Store", "scan/1.dcm", "Thumbs.db", "x.zarr/.zattrs"];
    expect(tidy(names.map((name) => named(name))).map(({ name }) => name)).toEqual(["scan/1.dcm", "scan/2.dcm", "x.zarr/.zattrs"]);
  });
});

test("what an upload is doing is said in words", () => {
  const now = { title: "scan", files: 1200, phase: "sending", sent: 3_400_000, total: 10_000_000 } as const;
  expect(uploadText(now)).toBe("Uploading scan, 1,200 files: 3.4 MB of 10 MB");
  expect(uploadText({ ...now, files: 1, phase: "waiting" })).toBe("Uploading scan: the connection was lost, going on as soon as it is back");
  expect(uploadText({ ...now, files: 1, phase: "reading" })).toBe("scan is there and is being read");
  expect(removedText("Head")).toBe("“Head” was removed from the server, or has expired there");
});
