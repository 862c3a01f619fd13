/** All that is known of the last final surface. */

import { Show } from "solid-js";
import type { Statistics } from "../../protocol/types";
import { allTriangles } from "../../state/counts";
import type { LengthScale } from "../../state/lengths";
import { formatBytes, formatCount, formatLength, formatMs, formatValue } from "../format";
import { countWords } from "../words";
import { useModel, useScale } from "../model";
import type { Card } from "./card";
import { EnclosedSums } from "./enclosed";
import { Rows, type Row } from "./rows";

function surfaceRows(s: Statistics, scale: LengthScale): readonly Row[] {
  return [
    ["Triangles", countWords(s.triangles, allTriangles(s)).replace(" triangles", "")],
    ["Vertices", formatCount(s.vertices)],
    ...errorRows(s, scale),
    ...criterionRows(s, scale),
  ];
}

/** For those who know how surfaces are made. */
function diagnosticRows(s: Statistics): readonly Row[] {
  return [
    ["Cut of", s.isTreeCut ? "the vertex tree" : "the octree"],
    ["Active cells", formatCount(s.activeCells)],
    ["Leaves, level 0 to 5", s.leaves.map(formatCount).join(" · ")],
    ["Lost cubes", formatCount(s.lostCubes)],
    ["Unpatched vertices", formatCount(s.unpatchedVertices)],
    ...Object.entries(s.stagesMs).map(([stage, ms]) => [`Stage ${stage}`, `${ms.toFixed(2)} ms`] as const),
    ["Server, all stages", formatMs(s.wallMs)],
    ["Device memory", `${formatBytes(s.deviceBytes)} + volume ${formatBytes(s.volumeBytes)}`],
  ];
}

/** β, or the tolerance if an error or a budget decided. */
function criterionRows({ beta, tolerance }: Statistics, scale: LengthScale): readonly Row[] {
  if (beta !== null) return [["β applied", formatValue(beta, 3)]];
  return tolerance === null ? [] : [["Tolerance applied", tolerance < 0 ? "nothing is merged" : formatLength(tolerance, scale, 3)]];
}

/** The measured error, else the estimate, else nothing. */
function errorRows({ error, estimatedError }: Statistics, scale: LengthScale): readonly Row[] {
  if (error !== null) {
    return [
      ["Error, RMS", formatLength(error.rms, scale, 3)],
      ["Error, maximum", formatLength(error.max, scale, 3)],
    ];
  }
  if (estimatedError === null) return [];
  return [["Error, RMS", `≈ ${formatLength(estimatedError.rms, scale, 3)}`]];
}

function Body() {
  const { viewer } = useModel();
  const scale = useScale();
  const statistics = () => viewer().statistics;
  return (
    <>
      <EnclosedSums />
      <Show when={statistics()}>
        {(known) => (
          <>
            <Rows rows={surfaceRows(known(), scale())} />
            <details class="fold">
              <summary>Diagnostics</summary>
              <Rows rows={diagnosticRows(known())} />
            </details>
          </>
        )}
      </Show>
    </>
  );
}

export const numbersCard: Card = { id: "numbers", title: "Numbers", icon: "numbers", folded: true, isLocal: true, isOfSurface: true, body: Body };
