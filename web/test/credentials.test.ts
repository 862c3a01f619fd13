import { afterEach, beforeEach, describe, expect, it, vi } from "vitest";
import type { HostEvent, HostPort } from "../src/embed/hostPort";

const BASE = new URL("https://isopeel.example/below/");
const STREAM = new URL("wss://isopeel.example/below/api/v1/stream");
const LAB = "https://lab.example";

/** What the server was asked, and what it answers with. */
interface Asked {
  readonly path: string;
  readonly method: string;
  readonly bearer: string | null;
  readonly credentials: string | undefined;
}

let asked: Asked[];
let status: number;
let seconds: number | null;

beforeEach(() => {
  vi.resetModules();
  vi.useFakeTimers();
  [asked, status, seconds] = [[], 200, 600];
  vi.stubGlobal("fetch", (url: URL, { method = "GET", headers, credentials }: RequestInit = {}) => {
    asked.push({ path: url.href, method, bearer: new Headers(headers).get("authorization"), credentials });
    const bodies: Record<string, object> = { session: { roles: ["view"], expiresSeconds: seconds }, tickets: { ticket: "once" }, embed: { origins: [LAB] } };
    return Promise.resolve(new Response(JSON.stringify(bodies[url.pathname.split("/").at(-1) ?? ""]), { status }));
  });
});

afterEach(() => {
  vi.unstubAllGlobals();
  vi.useRealTimers();
});

describe("a token that was handed over", () => {
  it("goes into headers, without the cookie, and stands in no address", async () => {
    const { hold, request, streamAddress } = await import("../src/net/credentials");
    await request(new URL("api/v1/volumes", BASE));
    expect(streamAddress(STREAM)).toBe(STREAM.href);
    expect(await hold(BASE, "secret")).toEqual({ roles: ["view"], expiresSeconds: 600 });
    await request(new URL("api/v1/volumes", BASE), { headers: { accept: "application/json" } });
    expect(await streamAddress(STREAM)).toBe(`${STREAM.href}?ticket=once`);
    const shown = { bearer: "Bearer secret", credentials: "omit" };
    const at = (path: string) => ({ path: `https://isopeel.example/below/api/v1/${path}`, method: "GET" });
    expect(asked).toEqual([
      { ...at("volumes"), bearer: null, credentials: undefined },
      { ...at("session"), ...shown },
      { ...at("volumes"), ...shown },
      { ...at("tickets"), ...shown, method: "POST" },
    ]);
  });

  it("stands in the address of no stream, which has the volume for a proxy of several servers", async () => {
    const { hold, streamAddress, streamUrl } = await import("../src/net/credentials");
    const stream = streamUrl(BASE, "ct head");
    expect(streamAddress(stream)).toBe(`${STREAM.href}?volume=ct+head`);
    await hold(BASE, "secret");
    expect(await streamAddress(stream)).toBe(`${STREAM.href}?volume=ct+head&ticket=once`);
    expect(asked.at(-1)?.path).toBe(`${BASE.href}api/v1/tickets?volume=ct+head`);
  });

  it("stays where the next one is not taken", async () => {
    const { hold, request } = await import("../src/net/credentials");
    await hold(BASE, "first");
    status = 401;
    await expect(hold(BASE, "second")).rejects.toThrow("the server does not take this token");
    status = 500;
    await expect(hold(BASE, "second")).rejects.toThrow("HTTP 500");
    await request(new URL("api/v1/volumes", BASE));
    expect(asked.at(-1)?.bearer).toBe("Bearer first");
  });
});

describe("the token of a frame", () => {
  async function frame() {
    const { EmbedToken } = await import("../src/wiring/embedToken");
    const sent: { event: HostEvent; among: readonly string[] }[] = [];
    const port = { emit: (event: HostEvent, among: readonly string[]) => void sent.push({ event, among }) } as unknown as HostPort;
    const taken = vi.fn();
    return { token: new EmbedToken(port, BASE, taken), sent, taken };
  }
  const said = (reason: string) => ({ event: { type: "token", reason }, among: [BASE.origin, LAB] });

  it("is asked for from origins that the server names, and taken from no other", async () => {
    const { token, sent, taken } = await frame();
    token.ask();
    await vi.advanceTimersByTimeAsync(0);
    expect(sent).toEqual([said("wanted")]);
    // Not with each attempt to connect, but again.
    await vi.advanceTimersByTimeAsync(4000);
    token.ask();
    await vi.advanceTimersByTimeAsync(1000);
    expect(sent).toHaveLength(1);
    token.ask();
    await vi.advanceTimersByTimeAsync(0);
    expect(sent).toEqual([said("wanted"), said("wanted")]);
    await expect(token.take("secret", "https://evil.example")).rejects.toThrow("the server takes no token from a page of https://evil.example");
    expect(asked.map(({ path }) => path)).toEqual([`${BASE.href}api/v1/embed`]);
    expect(taken).not.toHaveBeenCalled();
    await token.take("secret", LAB);
    expect(taken).toHaveBeenCalledOnce();
    token.ask();
    await vi.advanceTimersByTimeAsync(0);
    expect(sent.at(-1)).toEqual(said("expired"));
  });

  it.each([
    [600, 540_000],
    [20, 10_000],
  ])("of %i s is asked for anew after %i ms", async (lifetime, after) => {
    seconds = lifetime;
    const { token, sent } = await frame();
    await token.take("secret", LAB);
    await vi.advanceTimersByTimeAsync(after - 1);
    expect(sent).toEqual([]);
    await vi.advanceTimersByTimeAsync(1);
    expect(sent).toEqual([said("expiring")]);
    await token.take("next", LAB);
    await vi.advanceTimersByTimeAsync(after);
    expect(sent).toHaveLength(2);
  });

  it("of a server that is away is asked for when it is back", async () => {
    const { token, sent } = await frame();
    status = 503;
    token.ask();
    await vi.advanceTimersByTimeAsync(0);
    expect(sent).toEqual([{ event: { type: "token", reason: "wanted" }, among: [] }]);
    status = 200;
    token.ask();
    await vi.advanceTimersByTimeAsync(0);
    expect(sent.at(-1)).toEqual(said("wanted"));
  });
});
