import type { AddressInfo } from "node:net";
import { afterEach, beforeEach, describe, expect, test, vi } from "vitest";
import { WebSocket, WebSocketServer, type WebSocket as Socket } from "ws";
import { keepLeading, takeLeading } from "../src/net/leading";
import type { Group, ServerMessage } from "../src/protocol/types";
import { barText, groupLink, groupNews, groupOf, volumeOf } from "../src/state/group";
import { ActingPage } from "./acting";
import { CAPABILITIES, OPENING, VOLUMES } from "./fixture";

const ID = "0123456789abcdef0123456789abcdef";

describe("a group in words and links", () => {
  test("a link names the group alone, and no other address does", () => {
    const link = groupLink("http://host:1/x?y#token=secret", ID);
    expect(link).toBe(`http://host:1/x?y#follow=${ID}`);
    expect(groupOf(new URL(link).hash)).toBe(ID);
    for (const hash of ["", "#v=1&volume=a", `#follow=${ID}0`, "#follow=../x", `#follow=${ID}&volume=a&x=b`]) expect(groupOf(hash)).toBeUndefined();
  });

  test("of several servers a link has the volume by which a proxy finds the group's", () => {
    const link = groupLink("http://host:1/x", ID, "ct head");
    expect(link).toBe(`http://host:1/x#follow=${ID}&volume=ct%20head`);
    expect([groupOf(new URL(link).hash), volumeOf(new URL(link).hash)]).toEqual([ID, "ct head"]);
    expect(["", `#follow=${ID}`, "#v=1&volume=a&iso=2"].map(volumeOf)).toEqual([undefined, undefined, "a"]);
  });

  test("what is new is said once", () => {
    const group: Group = { type: "group", group: ID, you: 0, control: 0, followers: 1, asks: false, leaderAway: false, people: [{ number: 1, name: null, asks: false }] };
    const asked: Group = { ...group, people: [{ number: 1, name: "Ann", asks: true }] };
    expect(groupNews(undefined, group)).toBeUndefined();
    expect(groupNews(group, asked)).toBeUndefined();
    expect(groupNews(asked, { ...asked, control: 1 })).toBe("Another has control now");
    const away: Group = { ...group, you: 1, leaderAway: true };
    expect(groupNews({ ...group, you: 1 }, away)).toBeUndefined();
    expect(groupNews(away, { ...away, leaderAway: false })).toBe("The leader is back");
    expect(groupNews({ ...group, you: 1 }, { ...group, you: 1, control: 1 })).toBe("You have control: the others follow you");
  });
});

test("the bar says who leads, whose the camera is, and how many follow", () => {
  const group = { type: "group", group: ID, you: 0, control: 0, followers: 1, asks: false, leaderAway: false, people: [{ number: 1, name: "Ann", asks: false }], isApart: false } as const;
  expect(barText(group)).toBe("You lead · 1 follower");
  expect(barText({ ...group, control: 1 })).toBe("Following Ann · 1 follower");
  expect(barText({ ...group, you: 2, people: [], followers: 3 })).toBe("Following the leader · 3 followers");
  expect(barText({ ...group, you: 2, people: [], control: 1, isApart: true })).toBe("Following Follower 1, free camera · 1 follower");
  expect(barText({ ...group, you: 1, people: [], control: 1 })).toBe("You have control · 1 follower");
});

describe("the group that a tab leads", () => {
  const leading = { group: ID, key: "k".repeat(32) };
  const stored = new Map<string, string>();

  beforeEach(() => {
    stored.clear();
    const setItem = (name: string, value: string) => void stored.set(name, value);
    const removeItem = (name: string) => void stored.delete(name);
    vi.stubGlobal("sessionStorage", { setItem, removeItem, getItem: (name: string) => stored.get(name) ?? null });
  });

  afterEach(() => vi.unstubAllGlobals());

  test("is there again after a reload, once, and is nowhere in between", () => {
    expect(takeLeading()).toBeUndefined();
    keepLeading(undefined);
    expect(stored.size).toBe(0);
    keepLeading({ ...leading, via: "head" }, 1000);
    expect(takeLeading(60_999)).toEqual({ ...leading, via: "head" });
    keepLeading(leading, 1000);
    expect(takeLeading(60_999)).toEqual(leading);
    expect(stored.size).toBe(0);
    expect(takeLeading(60_999)).toBeUndefined();
  });

  test("is forgotten where the page stays away, and what is not of this page leads nothing", () => {
    keepLeading(leading, 1000);
    expect(takeLeading(61_000)).toBeUndefined();
    expect(stored.size).toBe(0);
    for (const other of ["", "{", "null", "[]", `{"group":"${ID}","key":7,"at":1000}`, `{"group":"${ID}","key":"k"}`]) {
      stored.set("isopeel-leads", other);
      expect(takeLeading(1000)).toBeUndefined();
    }
    const closed = () => {
      throw new Error("closed to this page");
    };
    vi.stubGlobal("sessionStorage", { getItem: closed, setItem: closed });
    keepLeading(leading);
    expect(takeLeading()).toBeUndefined();
  });
});

describe("a client that follows", () => {
  let server: WebSocketServer;
  let socket: Socket;
  const said: { readonly type: string }[] = [];
  const heard: ServerMessage[] = [];
  let page: ActingPage;

  beforeEach(async () => {
    vi.stubGlobal("WebSocket", WebSocket);
    said.length = heard.length = 0;
    server = new WebSocketServer({ port: 0, handleProtocols: () => "isopeel.v3" });
    server.on("connection", (connected: Socket) => {
      socket = connected;
      connected.on("message", (data: Buffer) => {
        const message = JSON.parse(data.toString()) as { type: string };
        // Every client asks for signs of life first.
        if (message.type !== "heartbeat") said.push(message);
      });
    });
    page = makePage();
    page.client.join(ID, undefined);
    page.client.start();
    await vi.waitFor(() => expect(said).toEqual([{ type: "join", name: null, group: ID, codings: ["predictive", "values"] }]));
  });

  function makePage(): ActingPage {
    const { port } = server.address() as AddressInfo;
    return new ActingPage(`ws://127.0.0.1:${port}`, { onMessage: (message) => heard.push(message) });
  }

  afterEach(() => {
    page.client.stop();
    server.close();
    vi.unstubAllGlobals();
  });

  const say = (message: object) => socket.send(JSON.stringify(message));
  const group = { type: "group", group: ID, you: 1, control: 0, followers: 1, asks: false, people: [] };
  const led = { type: "led", volume: "head", step: 2, surfaces: [{ surface: 0, edit: { ...OPENING, iso: 7 } }] };
  const opened = { type: "opened", volume: { ...VOLUMES[0], id: "head" }, step: 2, edit: OPENING, device: "none", capabilities: CAPABILITIES };

  test("it asks for nothing of its own until it has control, and joins again by itself", async () => {
    say(group);
    say(led);
    say(opened);
    await vi.waitFor(() => expect(heard.map(({ type }) => type)).toEqual(["group", "led", "opened"]));
    expect(page.client.following).toBe(true);
    // What the page shows of the other's is no edit.
    page.edit({ iso: 7 });
    page.client.open();
    page.client.restart();
    await vi.waitFor(() => expect(said.length).toBe(2), 5000);
    expect(said[1]).toEqual(said[0]);

    say(group);
    say(led);
    say(opened);
    say({ ...group, control: 1 });
    await vi.waitFor(() => expect(page.client.following).toBe(false));
    page.edit({ iso: 8 });
    await vi.waitFor(() => expect(said.at(-1)).toEqual({ type: "edit", iso: 8 }));
  });

  test("a group that has ended is left, and what is shown stays", async () => {
    say(group);
    say(led);
    say(opened);
    say({ type: "left", reason: "the leader has ended it" });
    await vi.waitFor(() => expect(heard.at(-1)?.type).toBe("left"));
    expect([page.client.following, page.client.ready]).toEqual([false, true]);
    page.client.restart();
    await vi.waitFor(() => expect(said.at(-1)).toEqual({ type: "open", volume: "head", step: 2, codings: ["predictive", "values"] }), 5000);
  });

  test("who leads does so again on a new connection, after what it shows, and nobody else has the key", async () => {
    const key = "k".repeat(32);
    const resume = { type: "lead", resume: { group: ID, key }, codings: ["predictive", "values"] };
    const leads = { ...group, you: 0, key };
    say(leads);
    await vi.waitFor(() => expect(heard).toEqual([{ ...group, you: 0 }]));
    page.open("head", 2);
    await vi.waitFor(() => expect(said.at(-1)?.type).toBe("open"));
    say(opened);
    await vi.waitFor(() => expect(page.client.ready).toBe(true));
    page.edit({ iso: 8 });
    await vi.waitFor(() => expect(said.at(-1)).toEqual({ type: "edit", iso: 8 }));
    // It leads already: to lead once more would end the group.
    expect(said.map(({ type }) => type)).not.toContain("lead");
    page.client.restart();
    await vi.waitFor(() => expect(said.at(-1)?.type).toBe("open"), 5000);
    const before = said.length;
    say(opened);
    await vi.waitFor(() => expect(said.at(-1)).toEqual(resume));
    expect(said.slice(before)).toMatchObject([{ type: "edit", iso: 8 }, resume]);

    // If another viewer has control, that viewer decides what is opened.
    say({ ...leads, control: 1 });
    await vi.waitFor(() => expect(page.client.following).toBe(true));
    const count = said.length;
    page.client.restart();
    await vi.waitFor(() => expect(said.slice(count)).toEqual([resume]), 5000);
    // It was too late.
    say({ type: "error", code: "unknown-group", message: "there is no such group", open: true });
    await vi.waitFor(() => expect(said.at(-1)).toEqual({ type: "open", volume: "head", step: 2, codings: ["predictive", "values"] }));
    expect(page.client.following).toBe(false);
    page.client.restart();
    await vi.waitFor(() => expect(said.slice(count)).toHaveLength(3), 5000);
    expect(said.at(-1)?.type).toBe("open");
  });

  test("a page that was loaded anew leads on, after what it shows", async () => {
    const leading = { group: ID, key: "k".repeat(32) };
    page.client.stop();
    said.length = 0;
    page = makePage();
    page.client.leadOn(leading);
    expect(page.client.leads).toEqual(leading);
    page.open("head", 2);
    page.client.start();
    await vi.waitFor(() => expect(said.at(-1)?.type).toBe("open"), 5000);
    say(opened);
    await vi.waitFor(() => expect(said.at(-1)).toEqual({ type: "lead", resume: leading, codings: ["predictive", "values"] }));
    page.client.say({ type: "leave" });
    expect(page.client.leads).toBeUndefined();
    await vi.waitFor(() => expect(said.at(-1)).toEqual({ type: "leave" }));
  });

  test("of a group that there is not, nothing is expected", async () => {
    say({ type: "error", code: "unknown-group", message: "there is no such group", open: true });
    await vi.waitFor(() => expect(heard.at(-1)?.type).toBe("error"));
    expect(page.client.following).toBe(false);
    page.open("head", 0);
    await vi.waitFor(() => expect(said.at(-1)).toEqual({ type: "open", volume: "head", step: 0, codings: ["predictive", "values"] }));
  });
});
