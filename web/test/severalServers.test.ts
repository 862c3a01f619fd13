/** A page behind a proxy that chooses among several servers by the volume in the address of the stream. */

import { afterEach, beforeEach, describe, expect, test, vi } from "vitest";
import { WebSocket } from "ws";
import { hasSeveralServers } from "../src/state/viewer";
import { ActingPage } from "./acting";
import { FixtureServer, VOLUMES } from "./fixture";

const ID = "0123456789abcdef0123456789abcdef";
const KEY = "k".repeat(32);
const CODINGS = { codings: ["predictive", "values"] };

let server: FixtureServer;
let address: (volume: string | undefined) => string;
let several: boolean;
let linked: string | undefined;
let page: ActingPage;

beforeEach(async () => {
  vi.stubGlobal("WebSocket", WebSocket);
  server = new FixtureServer();
  server.paceMs = 1;
  const port = await server.listen();
  address = (volume) => `ws://127.0.0.1:${port}/api/v1/stream${volume === undefined ? "" : `?volume=${volume}`}`;
  [several, linked] = [true, undefined];
  page = new ActingPage(address, { hasSeveralServers: () => several, linked: () => linked });
});

afterEach(async () => {
  page.client.stop();
  await server.close();
  vi.unstubAllGlobals();
});

const opened = (volume: string) => vi.waitFor(() => expect(page.client.ready && page.store.viewer.volume?.id).toBe(volume), 5000);
const received = (type: string) => server.received.filter((message) => message.type === type);

describe("the address of the stream", () => {
  test("has the volume, and another volume has another connection", async () => {
    page.client.start();
    await vi.waitFor(() => expect(server.queries).toEqual([""]));
    page.open("ball", 0);
    await opened("ball");
    expect(server.queries).toEqual(["", "?volume=ball"]);
    page.open("ball-mirrored", 0);
    await opened("ball-mirrored");
    expect(server.queries).toEqual(["", "?volume=ball", "?volume=ball-mirrored"]);
    expect(received("open").map((message) => "volume" in message && message.volume)).toEqual(["ball", "ball-mirrored"]);
  });

  test("is that of the link's volume from the start", async () => {
    linked = "ball";
    page.client.start();
    await vi.waitFor(() => expect(server.queries).toEqual(["?volume=ball"]));
    page.open("ball", 0);
    await opened("ball");
    expect(server.queries).toEqual(["?volume=ball"]);
  });

  test("stays if there is one server", async () => {
    several = false;
    page.open("ball", 0);
    page.client.start();
    await opened("ball");
    page.open("ball-mirrored", 0);
    await opened("ball-mirrored");
    expect(server.queries).toEqual(["?volume=ball"]);
  });

  test("of a follower has the volume of the group's link, as long as it follows", async () => {
    page.client.start();
    await vi.waitFor(() => expect(server.queries).toEqual([""]));
    page.client.join(ID, "Ann", "ball");
    await vi.waitFor(() => expect(received("join")).toEqual([{ type: "join", name: "Ann", group: ID, ...CODINGS }]));
    page.store.dispatch({ type: "open", target: { volume: "ball-mirrored", step: 0 } });
    page.client.restart();
    await vi.waitFor(() => expect(received("join")).toHaveLength(2), 5000);
    expect(server.queries).toEqual(["", "?volume=ball", "?volume=ball"]);
  });

  test("of a leader is that of its group, also after a reload", async () => {
    page.client.leadOn({ group: ID, key: KEY, via: "ball" });
    page.open("ball-mirrored", 0);
    page.client.start();
    await opened("ball-mirrored");
    expect(server.queries).toEqual(["?volume=ball"]);
    await vi.waitFor(() => expect(received("lead")).toEqual([{ type: "lead", resume: { group: ID, key: KEY }, ...CODINGS }]));
  });
});

test("there are several servers if the list of volumes names the one for jobs", () => {
  const [ball] = VOLUMES;
  const listed = (jobServer: unknown) => hasSeveralServers({ volumes: [{ ...ball, jobServer }] as never });
  expect(hasSeveralServers({ volumes: undefined })).toBe(false);
  expect([null, undefined, "a"].map(listed)).toEqual([false, false, true]);
});
