/** Area and enclosed volume of the selected surface, when they are asked for. */

import { Match, Switch } from "solid-js";
import type { Enclosed } from "../../state/enclosed";
import { lengthUnit } from "../../state/lengths";
import { useModel, useScale } from "../model";
import { Button } from "../widgets/button";
import { errorWords } from "../words";
import { enclosedNote, enclosedRows } from "./enclosedWords";
import { Rows } from "./rows";

export function EnclosedSums() {
  const { actions, enclosed, facts, viewer } = useModel();
  const isDue = () => facts().busy || viewer().shown === undefined;
  const sums = () => {
    const now = enclosed();
    return now === undefined || now === "summing" ? undefined : now;
  };
  return (
    <div class="enclosed" role="status">
      <Switch
        fallback={
          <div class="control row">
            <span class="label">Area and volume</span>
            <Button disabled={isDue()} onClick={actions.sumUp}>
              Compute
            </Button>
          </div>
        }
      >
        <Match when={enclosed() === "summing"}>
          <p class="note">Computing</p>
        </Match>
        <Match when={sums()}>{(of) => <Sums of={of()} />}</Match>
      </Switch>
    </div>
  );
}

function Sums(props: { readonly of: Enclosed }) {
  const { viewer, volume } = useModel();
  const scale = useScale();
  const error = () => {
    const { statistics } = viewer();
    return statistics && errorWords([statistics], scale());
  };
  return (
    <>
      <Rows rows={enclosedRows(props.of, lengthUnit(volume()))} />
      <p class="note">{enclosedNote(props.of, error())}</p>
    </>
  );
}
