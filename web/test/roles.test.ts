import { describe, expect, it } from "vitest";
import { has, LACKING } from "../src/state/roles";

describe("what the user may do", () => {
  it("is what the server has said, and everything until it has", () => {
    const looks = { roles: ["view"], expiresSeconds: null, jobs: false, uploads: false } as const;
    const takes = { roles: ["view", "edit", "export"], expiresSeconds: 60, jobs: true, uploads: true } as const;
    const names = ["edit", "export", "upload"] as const;
    expect(names.map((role) => has(undefined, role))).toEqual([true, true, true]);
    expect(names.map((role) => has(looks, role))).toEqual([false, false, false]);
    expect(names.map((role) => has(takes, role))).toEqual([true, true, false]);
    for (const role of names) expect(LACKING[role]).toContain(`a token for ${role}`);
  });
});
