/** A group: others join by a link and are shown what one of them does. */

import { createSignal, For, Match, Show, Switch } from "solid-js";
import { AWAY, followerName, followersText, isLed, LEADER, type GroupState } from "../../state/group";
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
      <Match when={group()}>{(of) => <Following group={of()} />}</Match>
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

function Leading(props: { readonly group: GroupState }) {
  const { actions } = useModel();
  const holder = () => {
    const known = props.group.people.find(({ number }) => number === props.group.control);
    return known === undefined ? "A follower" : followerName(known);
  };
  return (
    <>
      <div class="control row">
        <span class="label" role="status">
          {followersText(props.group.followers)}
        </span>
        <Button onClick={() => actions.group({ type: "copy" })}>Copy link</Button>
      </div>
      <Show when={isLed(props.group)}>
        <div class="control row">
          <p class="note">{holder()} has control: you see what they see</p>
          <Button onClick={() => actions.group({ type: "give", to: LEADER })}>Take it back</Button>
        </div>
        <Camera group={props.group} />
      </Show>
      <People group={props.group} />
      <div class="control row">
        <p class="note">Anyone with access to this server can join by this link</p>
        <Button onClick={() => actions.group({ type: "leave" })}>End</Button>
      </div>
    </>
  );
}

/** Those who ask for control, and those who have a name. */
function People(props: { readonly group: GroupState }) {
  const { actions } = useModel();
  const known = () => props.group.people.filter(({ asks, name: own }) => asks || own !== null);
  return (
    <Show when={known().length > 0}>
      <ul class="people" aria-label="Who follows">
        <For each={known()}>
          {(follower) => (
            <li class="control row">
              <span class="clipped">
                {followerName(follower)}
                <Show when={follower.asks}> asks for control</Show>
              </span>
              <Show when={follower.asks}>
                <Button label={`Give control to ${followerName(follower)}`} onClick={() => actions.group({ type: "give", to: follower.number })}>
                  Give control
                </Button>
              </Show>
            </li>
          )}
        </For>
      </ul>
    </Show>
  );
}

function Following(props: { readonly group: GroupState }) {
  const { actions } = useModel();
  return (
    <>
      <div class="control row">
        <span class="label" role="status">
          {isLed(props.group) ? "You are following" : "You have control"} · {followersText(props.group.followers)}
        </span>
        <Button onClick={() => actions.group({ type: "leave" })}>Leave</Button>
      </div>
      <Show when={props.group.leaderAway}>
        <p class="note">{AWAY}</p>
      </Show>
      <Show when={isLed(props.group)} fallback={<GiveBack />}>
        <Camera group={props.group} />
        <Needs role="edit">
          <div class="control row">
            <p class="note">{props.group.asks ? "Request sent" : "To change something yourself"}</p>
            <Button onClick={() => actions.group({ type: "ask", asks: !props.group.asks })}>{props.group.asks ? "Ask no more" : "Ask for control"}</Button>
          </div>
        </Needs>
      </Show>
      <Name />
    </>
  );
}

/** Who looks around alone finds back. */
function Camera(props: { readonly group: GroupState }) {
  const { actions } = useModel();
  return (
    <Show when={props.group.isApart}>
      <div class="control row">
        <p class="note">Free camera</p>
        <Button onClick={() => actions.group({ type: "camera" })}>Follow the camera</Button>
      </div>
    </Show>
  );
}

function GiveBack() {
  const { actions } = useModel();
  return (
    <div class="control row">
      <p class="note">What you change is shown to all</p>
      <Button onClick={() => actions.group({ type: "give", to: LEADER })}>Give it back</Button>
    </div>
  );
}

function Name() {
  const { actions } = useModel();
  const change = (chosen: string) => {
    setName(chosen);
    actions.group({ type: "name", name: chosen });
  };
  return <TextRow label="Your name, for the leader" value={name()} maxLength={40} placeholder="none" onChange={change} />;
}
