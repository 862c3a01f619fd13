import { describe, expect, it } from "vitest";
import { withoutToken } from "../src/net/session";

describe("the token in an address", () => {
  it.each([
    ["http://127.0.0.1:8417/#token=isop_abc", "http://127.0.0.1:8417/", "isop_abc"],
    ["http://127.0.0.1:8417/?embed#v=1&token=isop_abc&volume=head", "http://127.0.0.1:8417/?embed#v=1&volume=head", "isop_abc"],
    ["http://127.0.0.1:8417/#volume=head&iso=3", "http://127.0.0.1:8417/#volume=head&iso=3", undefined],
    ["http://127.0.0.1:8417/", "http://127.0.0.1:8417/", undefined],
  ])("%s", (address, href, token) => {
    expect(withoutToken(address)).toEqual({ href, token });
  });
});
