/** The bar over the picture while the page is in a group: who leads, whose the camera is, control, and the way out. */

import { For, Show, type JSX } from "solid-js";
import { AWAY, barText, followerName, isLed, LEADER, type GroupState } from "../state/group";
import { useModel } from "./model";
import { Button } from "./widgets/button";
import { Icon } from "./widgets/icon";
import "./style/follow.css";

/** Requests that are shown; the others when these are answered. */
const MAX_ASKING = 3;

export function FollowBar() {
  const { group } = useModel();
  return (
    <Show when={group()}>
      {(now) => (
        <div class="follow-bar" classList={{ led: isLed(now()) }} role="group" aria-label="Group">
          <span class="follow-who" role="status">
            <Icon name="together" />
            {now().you !== LEADER && now().leaderAway ? AWAY : barText(now())}
          </span>
          <span class="inline">
            <Show when={isLed(now())} fallback={<Control group={now()} />}>
              <Camera group={now()} />
              <Asking group={now()} />
            </Show>
            <Way group={now()} />
          </span>
          <Requests group={now()} />
        </div>
      )}
    </Show>
  );
}

/** With the one who leads, or alone. */
function Camera(props: { readonly group: GroupState }) {
  const { actions } = useModel();
  return (
    <Show when={props.group.isApart} fallback={<Act act={() => actions.group({ type: "free" })}>Free camera</Act>}>
      <Act act={() => actions.group({ type: "camera" })}>Follow the camera</Act>
    </Show>
  );
}

function Asking(props: { readonly group: GroupState }) {
  const model = useModel();
  const { actions } = model;
  return (
    <Show when={props.group.you !== LEADER} fallback={<Act act={() => actions.group({ type: "give", to: LEADER })}>Take it back</Act>}>
      <Show when={model.may("edit")}>
        <Act act={() => actions.group({ type: "ask", asks: !props.group.asks })}>{props.group.asks ? "Withdraw request" : "Ask for control"}</Act>
      </Show>
    </Show>
  );
}

/** What those can do who have control. */
function Control(props: { readonly group: GroupState }) {
  const { actions } = useModel();
  return (
    <Show when={props.group.you === LEADER} fallback={<Act act={() => actions.group({ type: "give", to: LEADER })}>Give it back</Act>}>
      <Act act={() => actions.group({ type: "copy" })}>Copy link</Act>
    </Show>
  );
}

function Way(props: { readonly group: GroupState }) {
  const { actions } = useModel();
  return <Act act={() => actions.group({ type: "leave" })}>{props.group.you === LEADER ? "End" : "Leave"}</Act>;
}

/** Those who ask for control, for the leader. */
function Requests(props: { readonly group: GroupState }) {
  const { actions } = useModel();
  const asking = () => props.group.people.filter(({ asks }) => asks).slice(0, MAX_ASKING);
  return (
    <For each={asking()}>
      {(follower) => (
        <span class="follow-request">
          <span role="status">{followerName(follower)} asks for control</span>
          <Button quiet label={`Give control to ${followerName(follower)}`} onClick={() => actions.group({ type: "give", to: follower.number })}>
            Give control
          </Button>
        </span>
      )}
    </For>
  );
}

function Act(props: { readonly act: () => void; readonly children: JSX.Element }) {
  return (
    <Button quiet onClick={props.act}>
      {props.children}
    </Button>
  );
}
