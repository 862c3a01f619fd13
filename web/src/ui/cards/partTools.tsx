/** What a click on the surface does: hides the piece that is connected to it, or keeps it alone. */

import { For, Show } from "solid-js";
import type { Statistics, View } from "../../protocol/types";
import { isKept, placesOf, withoutPlace, type Parts, type PartTool } from "../../state/parts";
import { cutsTree } from "../../protocol/view";
import { formatValue } from "../format";
import { useModel } from "../model";
import { Button } from "../widgets/button";
import { Icon } from "../widgets/icon";
import { Tools } from "./tools";

const HINTS = {
  "hide-part": "Click a piece to hide all that is connected to it",
  "keep-part": "Click a piece to show nothing but what is connected to it",
  "keep-another": "All are shown: click a piece to keep it too",
} as const;
const TOOLS = [
  { tool: "hide-part", text: "Hide part", title: HINTS["hide-part"] },
  { tool: "keep-part", text: "Keep part", title: HINTS["keep-part"] },
  { tool: "keep-another", text: "Keep another", title: "Shows all, so that a click keeps a further piece" },
] as const;

const count = (n: number) => (n === 1 ? "1 part" : `${n} parts`);

/** How many were chosen, and what for. */
export function partsWords(parts: Parts): string {
  const places = placesOf(parts).length;
  return parts !== null && "keep" in parts ? `${count(places)} kept, all others hidden` : `${count(places)} hidden`;
}

/** Note on the parts of the shown surface; empty if they are as chosen. */
export function partsNote(parts: Parts, statistics: Statistics | undefined): string {
  if (parts === null || statistics === undefined) return "";
  if (!statistics.isTreeCut) return "All parts are shown until the surface has been refined";
  const unmatched = statistics.unmatchedPositions ?? 0;
  if (unmatched === 0) return "";
  return unmatched === 1 ? "At one of these places there is no surface now" : `At ${unmatched} of these places there is no surface now`;
}

/** Parts are removed from the vertex tree alone, and the server says which are next to a place. */
export function offersParts(view: View | undefined, questions: readonly string[]): boolean {
  return view !== undefined && cutsTree(view) && questions.includes("probe");
}

export function PartTools(props: { readonly parts: Parts }) {
  const { page } = useModel();
  const isOffered = (tool: PartTool) => tool !== "keep-another" || isKept(props.parts) || page().kept.length > 0;
  return (
    <div class="parts">
      <Tools label="What a click does with a part" tools={TOOLS} isOffered={isOffered} hint={(tool) => <span role="status">{HINTS[tool]}</span>} />
      <Show when={props.parts !== null}>
        <Chosen parts={props.parts} />
      </Show>
    </div>
  );
}

function Chosen(props: { readonly parts: Parts }) {
  const { actions, viewer } = useModel();
  const verb = () => (isKept(props.parts) ? "Kept" : "Hidden");
  const note = () => partsNote(props.parts, viewer().statistics);
  return (
    <>
      <div class="control row">
        <span class="label" role="status">
          {partsWords(props.parts)}
        </span>
        <Button onClick={() => actions.edit({ parts: null })} quiet>
          Show all
        </Button>
      </div>
      <ul class="regions" aria-label="Chosen parts">
        <For each={placesOf(props.parts)}>
          {(place, index) => (
            <li>
              <span>
                {verb()} at {place.map((n) => formatValue(n, 3)).join(", ")}
              </span>
              <button
                type="button"
                class="icon-button"
                aria-label={verb() === "Kept" ? `No longer keep part ${index() + 1}` : `Show part ${index() + 1}`}
                on:click={() => actions.edit({ parts: withoutPlace(props.parts, index()) })}
              >
                <Icon name="close" />
              </button>
            </li>
          )}
        </For>
      </ul>
      <Show when={note()}>
        <p class="note">{note()}</p>
      </Show>
    </>
  );
}
