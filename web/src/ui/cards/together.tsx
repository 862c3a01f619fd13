/** A group: others join by a link and are shown what one of them does. */

import { createSignal, For, Match, Show, Switch } from "solid-js";
import { followerName, isLed, LEADER, type GroupState } from "../../state/group";
import { useModel } from "../model";
import { Needs } from "../needs";
import { Button } from "../widgets/button";
import { TextRow } from "../widgets/textRow";

/** Kept while the page is open: the card may be folded in between. */
const [name, setName] = createSignal("");

export default function Body() {
  const { group } = useModel();
  return (
    <Switch fallback={<Start />}>
      <Match when={group()?.you === LEADER && group()}>{(of) => <Leading group={of()} />}</Match>
      <Match when={group()}>
        <Following />
      </Match>
    </Switch>
  );
}

function Start() {
  const { actions } = useModel();
  return (
    <Needs role="edit">
      <div class="control row">
        <p class="note">Others see what you see, and turn as you turn. They join by a link</p>
        <Button onClick={() => actions.group({ type: "start" })}>Start</Button>
      </div>
    </Needs>
  );
}

/** What is done most is in the bar over the picture. */
function Leading(props: { readonly group: GroupState }) {
  return (
    <>
      <p class="note">Anyone with access to this server can join by the link. You can give control to a follower that asks for it</p>
      <People group={props.group} />
    </>
  );
}

/** Those who have a name, or ask for control. */
function People(props: { readonly group: GroupState }) {
  const known = () => props.group.people.filter(({ asks, name: own }) => asks || own !== null);
  return (
    <Show when={known().length > 0}>
      <ul class="people" aria-label="Who follows">
        <For each={known()}>
          {(follower) => (
            <li class="clipped">
              {followerName(follower)}
              <Show when={follower.asks}> asks for control</Show>
              <Show when={follower.number === props.group.control}> has control</Show>
            </li>
          )}
        </For>
      </ul>
    </Show>
  );
}

/** A name for the leader. */
function Following() {
  const { actions, group } = useModel();
  const change = (chosen: string) => {
    setName(chosen);
    actions.group({ type: "name", name: chosen });
  };
  return (
    <>
      <Show when={isLed(group())}>
        <p class="note">You see what the one in control shows: controls are off until you have control or leave</p>
      </Show>
      <TextRow label="Your name, for the leader" value={name()} maxLength={40} placeholder="none" onChange={change} />
    </>
  );
}
