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
  const kept = s.fullTriangles > 0 ? ` (${((100 * s.triangles) / s.fullTriangles).toFixed(1)} %)` : "";
  return [
    ["Triangles", `${formatCount(s.triangles)}${kept}`],
    ["Full surface", formatCount(s.fullTriangles)],
    ...criterionRows(s),
    ...errorRows(s),
    ["Vertices", formatCount(s.vertices)],
    ["Active cells", formatCount(s.activeCells)],
    ["Leaves, level 0 to 5", s.leaves.map(formatCount).join(" · ")],
    ["Lost cubes", formatCount(s.lostCubes)],
    ["Unpatched vertices", formatCount(s.unpatchedVertices)],
    ...Object.entries(s.stagesMs).map(([stage, ms]) => [`Stage ${stage}`, `${ms.toFixed(2)} ms`] as const),
    ["Server, all stages", formatMs(s.wallMs)],
    ["Device memory", `${formatBytes(s.deviceBytes)} + volume ${formatBytes(s.volumeBytes)}`],
  ];
}

/** β, or the tolerance where an error or a budget decided. */
function criterionRows({ beta, tolerance, isTreeCut }: Statistics): (readonly [string, string])[] {
  const cut = ["Cut of", isTreeCut ? "the vertex tree" : "the octree"] as const;
  if (beta !== null) return [["β in force", formatValue(beta, 3)], cut];
  if (tolerance === null) return [cut];
  return [["Tolerance in force", tolerance < 0 ? "nothing is merged" : formatValue(tolerance, 3)], cut];
}

/** The measured error, else the estimate, else nothing. */
function errorRows({ error, estimatedError }: Statistics): (readonly [string, string])[] {
  if (error !== null) {
    return [
      ["Error, rms", formatValue(error.rms, 3)],
      ["Error, maximum", formatValue(error.max, 3)],
    ];
  }
  if (estimatedError === null) return [];
  return [
    ["Error, rms", `≈ ${formatValue(estimatedError.rms, 3)}`],
    ["Error, worst leaf", `≈ ${formatValue(estimatedError.worstLeaf, 3)}`],
  ];
}
