/** The list of volumes, of a server that answers and of one that does not. */

import { createServer, type ServerResponse } from "node:http";
import type { AddressInfo } from "node:net";
import { afterEach, describe, expect, test, vi } from "vitest";
import { listVolumes } from "../src/net/rest";
import type { VolumeSummary } from "../src/protocol/types";
import type { Actions } from "../src/ui/actions";
import { Model } from "../src/ui/model";
import { Connecting } from "../src/wiring/connecting";
import { VOLUMES } from "./fixture";

/** Asks a server that answers as `respond` does; `limitMs` as for `listVolumes`. */
async function listOf(respond: (response: ServerResponse) => void, limitMs?: number): Promise<readonly VolumeSummary[]> {
  const server = createServer((_, response) => respond(response));
  await new Promise<void>((listening) => server.listen(0, "127.0.0.1", listening));
  try {
    const { port } = server.address() as AddressInfo;
    return await listVolumes(new URL(`http://127.0.0.1:${port}/`), limitMs);
  } finally {
    server.closeAllConnections();
    server.close();
  }
}

describe("the list of volumes", () => {
  test("is waited for no longer than a limit, until all of it is there", async () => {
    expect(await listOf((response) => response.end(JSON.stringify(VOLUMES)))).toEqual(VOLUMES);
    const text = "the server has not answered within 0.05 s";
    await expect(listOf(() => undefined, 50)).rejects.toThrow(text);
    await expect(listOf((response) => response.write("["), 50)).rejects.toThrow(text);
  });

  test("that was refused says why, in the server's words", async () => {
    const refuse = (response: ServerResponse) => response.writeHead(503).end(JSON.stringify({ detail: "the server stops" }));
    await expect(listOf(refuse)).rejects.toThrow("the server stops");
  });
});

describe("a page that lists the volumes", () => {
  afterEach(() => vi.unstubAllGlobals());

  test("says so, and offers to try again until it has it", async () => {
    const listed: (readonly VolumeSummary[])[] = [];
    const model = new Model({} as Actions);
    const connecting = new Connecting(model, new URL("http://host/"), (volumes) => listed.push(volumes), () => undefined);
    const answers = [() => Promise.reject(new Error("no way")), () => Promise.reject(new Error("no way")), () => Promise.resolve(Response.json(VOLUMES))];
    vi.stubGlobal("fetch", () => answers.shift()?.());

    await connecting.loadVolumes();
    for (const left of [1, 0]) {
      expect(model.toasts()).toMatchObject([{ text: "The list of volumes could not be read: no way", good: false }]);
      model.toasts()[0]?.retry?.();
      expect(model.toasts()).toEqual([]);
      expect(answers).toHaveLength(left);
      await vi.waitFor(() => expect(left === 1 ? model.toasts() : listed).toHaveLength(1));
    }
    expect(listed).toEqual([VOLUMES]);
    expect(model.toasts()).toEqual([]);
  });

  test("is told which paths the server cannot read, and why", async () => {
    const model = new Model({} as Actions);
    const connecting = new Connecting(model, new URL("http://host/"), () => undefined, () => undefined);
    const unreadable = [{ name: "scan.nii.gz", reason: "file: a Git LFS pointer" }];
    vi.stubGlobal("fetch", (url: URL) => Promise.resolve(Response.json(url.pathname.endsWith("unreadable") ? unreadable : VOLUMES)));
    await connecting.loadVolumes();
    expect(model.toasts()).toMatchObject([{ text: "The server cannot read scan.nii.gz: file: a Git LFS pointer" }]);
  });
});
