/** Statistics of the last final surface. */

import type { Statistics } from "../../protocol/types";
import { h } from "../dom";
import { formatBytes, formatCount, formatMs, formatValue } from "../format";

export class StatisticsSection {
  private readonly list = h("dl", { class: "statistics" });
  readonly element = h("details", { class: "section" }, h("summary", {}, "Statistics"), this.list);

  set(statistics: Statistics | undefined): void {
    const rows = statistics === undefined ? ([["No surface yet", ""]] as const) : rowsOf(statistics);
    this.list.replaceChildren(...rows.flatMap(([term, value]) => [h("dt", {}, term), h("dd", {}, value)]));
  }
}

function rowsOf(s: Statistics): (readonly [string, string])[] {
  const kept = s.full_triangles > 0 ? ` (${((100 * s.triangles) / s.full_triangles).toFixed(1)} %)` : "";
  return [
    ["Triangles", `${formatCount(s.triangles)}${kept}`],
    ["Full surface", formatCount(s.full_triangles)],
    ["β in force", formatValue(s.beta, 3)],
    ["Error, rms", s.error === null ? "not stated" : formatValue(s.error.rms, 3)],
    ["Error, greatest", s.error === null ? "not stated" : formatValue(s.error.max, 3)],
    ["Vertices", formatCount(s.vertices)],
    ["Active cells", formatCount(s.active_cells)],
    ["Leaves, level 0 to 5", s.leaves.map(formatCount).join(" · ")],
    ["Lost cubes", formatCount(s.lost_cubes)],
    ["Unpatched vertices", formatCount(s.unpatched_vertices)],
    ...Object.entries(s.stages_ms).map(([stage, ms]) => [`Stage ${stage}`, `${ms.toFixed(2)} ms`] as const),
    ["Server, all stages", formatMs(s.wall_ms)],
    ["Device memory", `${formatBytes(s.device_bytes)} + volume ${formatBytes(s.volume_bytes)}`],
  ];
}
