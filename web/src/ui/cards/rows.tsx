/** Names and values in two columns. */

import { For } from "solid-js";

export type Row = readonly [string, string];

export function Rows(props: { readonly rows: readonly Row[] }) {
  return (
    <dl class="rows">
      <For each={props.rows}>
        {([term, value]) => (
          <>
            <dt>{term}</dt>
            <dd>{value}</dd>
          </>
        )}
      </For>
    </dl>
  );
}
