import { describe, expect, test } from "vitest";
import { emptyMap, isSettled, reduce, SequenceError, type Effects, type RegionEvent } from "../src/regions/map";

/** Runs events in a short notation: `p5:2` prefix of level 5 with 2 regions, `a=1` chunk, `a=-` empty chunk, `c` committed, `r1` resident. */
class Script {
  readonly state = emptyMap();
  generation = 1;
  level = 0;

  run(...steps: string[]): Effects {
    const all = { swaps: [] as Effects["swaps"][number][], dropped: [] as number[] };
    for (const step of steps) {
      const { swaps, dropped } = reduce(this.state, this.event(step));
      all.swaps.push(...swaps);
      all.dropped.push(...dropped);
    }
    return all;
  }

  private event(step: string): RegionEvent {
    const { generation } = this;
    const prefix = /^p(\d):(\d+)$/.exec(step);
    if (prefix !== null) {
      this.level = Number(prefix[1]);
      return { type: "prefix", generation, level: this.level, regions: Number(prefix[2]), final: this.level === 0 };
    }
    const chunk = /^([\w,]+)=(\d+|-)$/.exec(step);
    if (chunk !== null) {
      const id = chunk[2] === "-" ? null : Number(chunk[2]);
      return { type: "chunk", generation, level: this.level, region: chunk[1]!, id };
    }
    if (step === "c") return { type: "committed", generation, level: this.level };
    if (step === "superseded") return { type: "superseded", generation };
    if (step === "reset") return { type: "reset" };
    return { type: "resident", id: Number(step.slice(1)) };
  }

  get shown(): Record<string, number> {
    return Object.fromEntries(this.state.shown);
  }
}

describe("a prefix", () => {
  test("is shown as a whole, once committed and all resident", () => {
    const s = new Script();
    expect(s.run("p5:2", "a=1", "r1", "b=2", "r2").swaps).toEqual([]);
    expect(s.run("c").swaps).toEqual([{ generation: 1, level: 5, final: false, show: [1, 2], remove: [] }]);
    expect(s.run("p4:1", "a=3", "c").swaps).toEqual([]);
    expect(s.shown).toEqual({ a: 1, b: 2 });
    expect(s.run("r3").swaps).toEqual([{ generation: 1, level: 4, final: false, show: [3], remove: [1] }]);
    expect(s.shown).toEqual({ a: 3, b: 2 });
    expect(isSettled(s.state)).toBe(true);
  });

  test("of empty chunks removes regions at once", () => {
    const s = new Script();
    s.run("p1:2", "a=1", "b=2", "r1", "r2", "c");
    expect(s.run("p0:1", "b=-", "c").swaps).toEqual([{ generation: 1, level: 0, final: true, show: [], remove: [2] }]);
    expect(s.shown).toEqual({ a: 1 });
  });

  test("without chunks is shown when committed", () => {
    const s = new Script();
    expect(s.run("p0:0", "c").swaps).toHaveLength(1);
  });

  test("waits for the one before it, whatever is uploaded first", () => {
    const s = new Script();
    s.run("p5:1", "a=1", "c", "p4:1", "a=2", "c", "r2");
    expect(s.shown).toEqual({});
    const { swaps } = s.run("r1");
    expect(swaps.map((w) => w.level)).toEqual([5, 4]);
    expect(s.shown).toEqual({ a: 2 });
  });
});

describe("regions of several sizes", () => {
  test("give way to each other in one change", () => {
    const s = new Script();
    s.run("p0:3", "0,0,0,0=1", "1,0,0,0=2", "2,0,0,0=3", "c", "r1", "r2", "r3");
    // The low corner of the first one is that of the larger one.
    expect(s.run("p0:3", "0,0,0,1=4", "0,0,0,0=-", "1,0,0,0=-", "c").swaps).toEqual([]);
    expect(s.shown).toEqual({ "0,0,0,0": 1, "1,0,0,0": 2, "2,0,0,0": 3 });
    expect(s.run("r4").swaps).toEqual([{ generation: 1, level: 0, final: true, show: [4], remove: [1, 2] }]);
    expect(s.shown).toEqual({ "0,0,0,1": 4, "2,0,0,0": 3 });
    expect(s.run("p0:2", "0,0,0,0=5", "0,0,0,1=-", "r5", "c").swaps[0]).toMatchObject({ show: [5], remove: [4] });
    expect(s.shown).toEqual({ "0,0,0,0": 5, "2,0,0,0": 3 });
  });
});

describe("an ended generation", () => {
  test("loses its uncommitted chunks, and the surface on screen remains", () => {
    const s = new Script();
    s.run("p5:1", "a=1", "r1", "c", "p4:2", "a=2", "b=3");
    expect(s.run("superseded").dropped).toEqual([2, 3]);
    expect(s.shown).toEqual({ a: 1 });
    // Its upload was under way when the chunk was dropped.
    expect(s.run("r2")).toEqual({ swaps: [], dropped: [] });
  });

  test("keeps what was committed, which the server does not send again", () => {
    const s = new Script();
    s.run("p5:2", "a=1", "b=2", "c", "superseded");
    s.generation = 2;
    s.run("p5:1", "a=3", "c");
    expect(s.run("r1", "r2", "r3").swaps).toHaveLength(2);
    expect(s.shown).toEqual({ a: 3, b: 2 });
  });

  test("collapses its committed prefixes and drops chunks replaced by later ones", () => {
    const s = new Script();
    s.run("p5:2", "a=1", "b=2", "c", "p4:2", "a=3", "b=-", "c", "p3:1", "c=9");
    const { dropped } = s.run("superseded");
    expect([...dropped].sort()).toEqual([1, 2, 9]);
    expect(s.run("r3").swaps).toEqual([{ generation: 1, level: 4, final: false, show: [3], remove: [] }]);
    expect(s.shown).toEqual({ a: 3 });
  });

  test("ends with the first prefix of the next, also without `superseded`", () => {
    const s = new Script();
    s.run("p5:1", "a=1");
    s.generation = 2;
    expect(s.run("p5:1").dropped).toEqual([1]);
    s.run("a=2", "c", "r2");
    expect(s.shown).toEqual({ a: 2 });
  });

  test("does not end the newer one when its end arrives late", () => {
    const s = new Script();
    s.generation = 2;
    s.run("p5:1", "a=1");
    expect(reduce(s.state, { type: "superseded", generation: 1 }).dropped).toEqual([]);
    expect(s.run("c", "r1").swaps).toHaveLength(1);
  });
});

describe("reset", () => {
  test("keeps the surface until the first whole surface, which then replaces all of it", () => {
    const s = new Script();
    s.run("p0:2", "a=1", "b=2", "r1", "r2", "c", "p0:1", "a=3");
    expect(s.run("reset").dropped).toEqual([3]);
    expect(s.shown).toEqual({ a: 1, b: 2 });
    s.generation = 5;
    const { swaps } = s.run("p5:1", "a=4", "c", "r4");
    expect(swaps).toEqual([{ generation: 5, level: 5, final: false, show: [4], remove: [1, 2] }]);
    expect(s.shown).toEqual({ a: 4 });
  });

  test("holds after an uncommitted first prefix too", () => {
    const s = new Script();
    s.run("p0:1", "a=1", "r1", "c", "reset", "p5:1", "b=2", "superseded");
    s.generation = 2;
    s.run("p5:1", "c=3", "c", "r3");
    expect(s.shown).toEqual({ c: 3 });
  });
});

describe("order broken", () => {
  test.each([
    ["chunk without a prefix", ["a=1"]],
    ["chunk after committed", ["p5:0", "c", "a=1"]],
    ["prefix in a prefix", ["p5:1", "p4:1"]],
    ["more chunks than announced", ["p5:1", "a=1", "b=2"]],
    ["fewer chunks than announced", ["p5:2", "a=1", "c"]],
    ["a region twice", ["p5:2", "a=1", "a=2"]],
    ["committed without a prefix", ["c"]],
  ])("%s", (_, steps) => {
    expect(() => new Script().run(...steps)).toThrow(SequenceError);
  });
});

test("any order of uploads ends in the last committed map", () => {
  let seed = 7;
  const random = (n: number) => (seed = (seed * 48271) % 0x7fffffff) % n;
  for (let round = 0; round < 300; round += 1) {
    const state = emptyMap();
    const expected = new Map<string, number>();
    const uploads: number[] = [];
    const dropped = new Set<number>();
    let id = 0;
    const apply = (event: RegionEvent) => {
      for (const t of reduce(state, event).dropped) dropped.add(t);
    };
    const uploadOne = () => {
      const at = random(Math.max(1, uploads.length));
      const [next] = uploads.splice(at, 1);
      if (next !== undefined && !dropped.has(next)) apply({ type: "resident", id: next });
    };
    for (let generation = 1; generation <= 4; generation += 1) {
      const depth = random(4);
      for (let level = 5; level >= 5 - depth; level -= 1) {
        const changes = ["a", "b", "c", "d"].filter(() => random(2) === 1);
        apply({ type: "prefix", generation, level, regions: changes.length, final: level === 0 });
        const cut = random(5) === 0 ? random(changes.length + 1) : Infinity;
        const mine: [string, number | null][] = [];
        changes.slice(0, cut).forEach((region) => {
          const t = random(4) === 0 ? null : ++id;
          mine.push([region, t]);
          apply({ type: "chunk", generation, level, region, id: t });
          if (t !== null) uploads.push(t);
          if (random(2) === 0) uploadOne();
        });
        if (cut !== Infinity) break;
        apply({ type: "committed", generation, level });
        for (const [region, t] of mine) if (t === null) expected.delete(region); else expected.set(region, t);
      }
      apply({ type: "superseded", generation });
    }
    while (uploads.length > 0) uploadOne();
    expect(Object.fromEntries(state.shown)).toEqual(Object.fromEntries(expected));
    expect(isSettled(state)).toBe(true);
    expect(state.prefixOf.size).toBe(0);
  }
});
