import { expect, test } from "vitest";
import { isLoopback } from "../src/net/loopback";

test("this machine's own names are known, and no other's", () => {
  const hosts = ["http://localhost:8417", "http://127.0.0.1:8417", "http://127.1.2.3/", "http://[::1]:8417", "http://a.localhost/"];
  for (const url of hosts) expect([url, isLoopback(new URL(url).hostname)]).toEqual([url, true]);
  const others = ["http://10.0.0.1", "http://127.example.org", "https://localhost.example.org", "http://[::2]", "http://127.0.0.1.example.org"];
  for (const url of others) expect([url, isLoopback(new URL(url).hostname)]).toEqual([url, false]);
});
