import { describe, expect, test } from "vitest";
import { HostPort, type PageWindow } from "../src/embed/hostPort";
import { embedOptions } from "../src/embed/origins";
import { readRequest, type HostRequest } from "../src/embed/requests";
import { changedLink, decodeLink, type LinkState } from "../src/state/link";
import { DEFAULT_LOOK } from "../src/state/look";
import { DEFAULT_STYLE } from "../src/state/surfaceList";
import { OPENING } from "./fixture";

const OWN = "http://isopeel.example:8417";
const FRIEND = "https://lab.example";

describe("who may speak", () => {
  const origins = (search: string) => embedOptions(search, OWN)?.origins;

  test("is the page's own origin, and those that the address names", () => {
    expect(embedOptions("", OWN)).toBeUndefined();
    expect(embedOptions("?origin=https://lab.example", OWN)).toBeUndefined();
    expect(origins("?embed")).toEqual([OWN]);
    expect(origins(`?embed&origin=${FRIEND}&origin=http://localhost:3000/`)).toEqual([OWN, FRIEND, "http://localhost:3000"]);
    expect(origins(`?embed&origin=HTTPS://LAB.example:443&origin=${OWN}`)).toEqual([OWN, FRIEND]);
  });

  test.each(["*", "https://*.example", "null", "lab.example", "https://lab.example/page", "https://me@lab.example", "javascript:alert(1)", "file:///", ""])("is not %j, and a problem names it", (name) => {
    const options = embedOptions(`?embed&origin=${encodeURIComponent(name)}`, OWN);
    expect(options?.origins).toEqual([OWN]);
    expect(options?.problems).toEqual([`The address names ${JSON.stringify(name)} as an origin, expected one such as https://example.org`]);
  });
});

describe("requests", () => {
  const read = (fields: object) => readRequest({ isopeel: 1, id: 7, ...fields });

  test("are read", () => {
    expect(read({ type: "get" })).toEqual({ type: "get" });
    expect(read({ type: "set", link: "http://a.example/#v=1&volume=head" })).toEqual({ type: "set", link: "v=1&volume=head" });
    expect(read({ type: "change", values: { iso: 300, color: "error", share: null } })).toEqual({ type: "change", values: new Map([["iso", "300"], ["color", "error"], ["share", null]]) });
    expect(read({ type: "token", token: "isop_abc_d-e" })).toEqual({ type: "token", token: "isop_abc_d-e" });
    expect(read({ type: "camera" })).toEqual({ type: "camera", to: undefined });
    expect(read({ type: "camera", view: "+x" })).toEqual({ type: "camera", to: "+x" });
    expect(read({ type: "camera", position: [1, 2, 3], target: [0, 0, 0] })).toEqual({ type: "camera", to: { position: [1, 2, 3], target: [0, 0, 0] } });
    expect(read({ type: "image", scale: 2, caption: "A head" })).toEqual({ type: "image", image: { scale: 2, transparent: false, colorBar: true, scaleBar: true, isovalues: true, caption: "A head" } });
  });

  const circular: Record<string, unknown> = {};
  circular["self"] = circular;
  test.each([
    [{ isopeel: 2, type: "get" }, "isopeel is 2, expected 1, the version of these messages"],
    [{ id: undefined, type: "get" }, "id is undefined, expected a number or a text, which the answer repeats"],
    [{ id: {}, type: "get" }, "id is {}, expected a number or a text, which the answer repeats"],
    [{ type: "fetch" }, 'type is "fetch", expected one of get, set, change, camera, image, token'],
    [{ type: "toString" }, 'type is "toString", expected one of get, set, change, camera, image, token'],
    [{}, "type is undefined, expected one of get, set, change, camera, image, token"],
    [{ type: "get", iso: 3 }, 'get has no field "iso". It has: none'],
    [{ type: "set", hash: "" }, 'set has no field "hash". It has: link'],
    [{ type: "set" }, "link is undefined, expected a text"],
    [{ type: "set", link: "a".repeat(70_000) }, "link has 70000 characters, expected at most 65536"],
    [{ type: "change", values: [1] }, "values is [1], expected an object"],
    [{ type: "change", values: { iso: NaN } }, "values.iso is null, expected a number, a text or null"],
    [{ type: "change", values: { iso: circular } }, "values.iso is object, expected a number, a text or null"],
    [{ type: "camera", view: "up" }, 'view is "up", expected one of home, fit, +x, -x, +y, -y, +z, -z'],
    [{ type: "camera", view: "fit", target: [0, 0, 0] }, "camera has a view beside position or target, expected one of both"],
    [{ type: "camera", position: [1, 2, 3] }, "target is undefined, expected three numbers"],
    [{ type: "camera", position: [1, 2, "3"], target: [0, 0, 0] }, 'position is [1,2,"3"], expected three numbers'],
    [{ type: "camera", position: [0, 0, 0], target: [0, 0, 0] }, "position and target are the same place: there is no direction to look in"],
    [{ type: "token" }, "token is none, expected the text that POST /api/v1/embed-tokens has answered with"],
    [{ type: "token", token: "isop_a b" }, "token is none, expected the text that"],
    [{ type: "token", token: "a".repeat(1025) }, "token is none, expected the text that"],
    [{ type: "image", scale: 9 }, "scale is 9, expected a number, 1 to 4"],
    [{ type: "image", transparent: "yes" }, 'transparent is "yes", expected true or false'],
    [{ type: "image", caption: "a".repeat(301) }, "caption has 301 characters, expected at most 300"],
  ])("%j is refused", (fields, message) => {
    expect(() => read(fields)).toThrow(message);
  });
});

describe("the line to the page around", () => {
  /** A frame in a page whose messages the test sends, and the answers that it gets. */
  function frame(answer: (request: HostRequest) => unknown = () => "done", around?: string) {
    const sent: { message: Record<string, unknown>; to: string }[] = [];
    let listener: (event: MessageEvent) => void = () => undefined;
    const parent = { postMessage: (message: Record<string, unknown>, to: string) => void sent.push({ message, to }) };
    const page = { parent, addEventListener: (_: string, listen: typeof listener) => (listener = listen) } as unknown as PageWindow;
    const port = new HostPort(page, [OWN, FRIEND], around, answer);
    const say = (data: unknown, origin = FRIEND, source: unknown = parent) => listener({ data, origin, source } as MessageEvent);
    const turn = () => new Promise((next) => setTimeout(next));
    return { port, sent, say, turn };
  }
  const get = { isopeel: 1, id: "a", type: "get" };

  test("answers requests of origins that may speak, and repeats their id", async () => {
    const { say, sent, turn } = frame(() => Promise.resolve({ triangles: 7 }));
    say(get);
    say({ ...get, id: 2 }, OWN);
    await turn();
    expect(sent).toEqual([
      { to: FRIEND, message: { isopeel: 1, type: "reply", id: "a", ok: true, value: { triangles: 7 } } },
      { to: OWN, message: { isopeel: 1, type: "reply", id: 2, ok: true, value: { triangles: 7 } } },
    ]);
  });

  test("refuses others, and says what would let them in", async () => {
    const asked: unknown[] = [];
    const { say, sent, turn } = frame((request) => asked.push(request));
    say(get, "https://evil.example");
    say(get, "null");
    say({ ...get, id: [] }, "http://lab.example");
    await turn();
    expect(asked).toEqual([]);
    const refused = { isopeel: 1, type: "reply", ok: false };
    expect(sent).toEqual([
      { to: "https://evil.example", message: { ...refused, id: "a", error: "isopeel takes no messages from https://evil.example: the address has to name it: ?embed&origin=https://evil.example" } },
      { to: "*", message: { ...refused, id: "a", error: "isopeel takes no messages from null: a page without an origin cannot be let in" } },
      { to: "http://lab.example", message: { ...refused, id: null, error: expect.stringContaining("?embed&origin=http://lab.example") as string } },
    ]);
  });

  test("leaves messages alone that are not meant for it, or of another window", async () => {
    const { say, sent, turn } = frame();
    for (const data of ["text", null, 3, { type: "get" }, [get]]) say(data);
    say(get, FRIEND, {});
    await turn();
    expect(sent).toEqual([]);
  });

  test("says what was wrong with a request, or with what it asked for", async () => {
    const { say, sent, turn } = frame(() => {
      throw new Error("there is no surface yet");
    });
    say({ isopeel: 1, id: 5, type: "jump" });
    say({ isopeel: 1, type: "get" });
    say(get);
    await turn();
    expect(sent.map(({ message }) => [message["id"], message["ok"], message["error"]])).toEqual([
      [5, false, 'type is "jump", expected one of get, set, change, camera, image, token'],
      [null, false, "id is undefined, expected a number or a text, which the answer repeats"],
      ["a", false, "there is no surface yet"],
    ]);
  });

  test("is dead in a page that stands in no frame: it would answer itself", async () => {
    const sent: unknown[] = [];
    let listens = false;
    const page = { postMessage: (message: unknown) => void sent.push(message), addEventListener: () => (listens = true) };
    Object.assign(page, { parent: page });
    new HostPort(page as unknown as PageWindow, [OWN], undefined, () => "done").emit({ type: "error", message: "over" });
    await Promise.resolve();
    expect([listens, sent]).toEqual([false, []]);
  });

  test("takes a few requests at once, and no more", async () => {
    const waiting: (() => void)[] = [];
    const { say, sent, turn } = frame(() => new Promise<void>((done) => waiting.push(done)));
    for (let id = 0; id < 9; id += 1) say({ ...get, id });
    await turn();
    expect(sent.map(({ message }) => message["error"])).toEqual(["8 requests are under way, and no more are taken: wait for their answers"]);
    waiting[0]?.();
    await turn();
    say({ ...get, id: 10 });
    await turn();
    expect(waiting).toHaveLength(9);
  });

  test("tells what happens to those alone that may know it", async () => {
    const event = { type: "error", message: "over" } as const;
    const told = (port: HostPort, sent: { to: string }[]) => {
      sent.length = 0;
      port.emit(event);
      return sent.map(({ to }) => to);
    };
    const unknown = frame();
    // Those that the server names and the address too, never all.
    unknown.port.emit({ type: "token", reason: "wanted" }, [FRIEND, "https://other.example"]);
    expect(unknown.sent).toEqual([{ to: FRIEND, message: { isopeel: 1, type: "token", reason: "wanted" } }]);
    expect(told(unknown.port, unknown.sent)).toEqual([OWN, FRIEND]);
    unknown.say(get);
    await unknown.turn();
    expect(told(unknown.port, unknown.sent)).toEqual([FRIEND]);
    const known = frame(() => "done", OWN);
    expect(told(known.port, known.sent)).toEqual([OWN]);
    const stranger = frame(() => "done", "https://evil.example");
    stranger.say(get, "https://evil.example");
    expect(told(stranger.port, stranger.sent)).toEqual([]);
    expect(unknown.sent[0]?.to).toBe(FRIEND);
  });
});

describe("a link that is changed", () => {
  const state: LinkState = {
    volume: "head",
    step: 2,
    surfaces: [{ number: 0, view: { ...OPENING, iso: 300, alpha: 0.2 }, style: DEFAULT_STYLE }],
    selected: 0,
    opening: OPENING,
    look: { ...DEFAULT_LOOK, wireframe: true },
    openingLook: DEFAULT_LOOK,
    pose: { position: [1, 2, 3], target: [0, 0, 0] },
  };
  const change = (values: Record<string, string | null>) => changedLink(state, new Map(Object.entries(values)));

  test("keeps what is not named, and loses what is null", () => {
    expect(change({ iso: "250", wire: null, color: "error" })).toBe("v=1&volume=head&step=2&iso=250&alpha=0.2&color=error&camera=1,2,3,0,0,0");
    expect(decodeLink(change({ share: "0.1" }))).toMatchObject({ surfaces: [{ edit: { iso: 300, triangles: { share: 0.1 } } }], look: { wireframe: true } });
  });

  test("of another volume keeps nothing", () => {
    expect(change({ volume: "brain", map: "vik" })).toBe("v=1&volume=brain&map=vik");
    expect(change({ volume: "head", alpha: null })).toBe("v=1&volume=head&step=2&iso=300&wire=1&camera=1,2,3,0,0,0");
  });

  test("has no other names", () => {
    expect(change({ "s2.iso": "500", "s2.tint": "ff0000" })).toContain("&s2.iso=500&s2.tint=ff0000");
    expect(() => change({ "s2.volume": "3" })).toThrow(/^A link has no “s2.volume”/);
    expect(() => change({ isovalue: "3" })).toThrow(/^A link has no “isovalue”. It has: v, volume, step, iso, /);
  });
});
