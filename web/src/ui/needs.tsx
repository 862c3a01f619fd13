/** What only some may do: off for others, who read why, instead of learning it from a refusal. */

import { Show, type JSX } from "solid-js";
import { LACKING, type Role } from "../state/roles";
import { useModel } from "./model";

/** Controls that are of use with a role alone. */
export function Needs(props: { readonly role: Role; readonly children: JSX.Element }) {
  const model = useModel();
  const isOff = () => !model.may(props.role);
  return (
    <>
      <Show when={isOff()}>
        <p class="note lacking">{LACKING[props.role]}</p>
      </Show>
      {/* What is no field of a form, such as a handle in a plot, is off too. */}
      <fieldset class="needs" disabled={isOff()} inert={isOff()}>
        {props.children}
      </fieldset>
    </>
  );
}
