/** The notice above the surface while there is no connection. */

import { createEffect, createSignal, onCleanup, Show } from "solid-js";
import { useModel } from "./model";
import { Button } from "./widgets/button";

/** The notice appears after this long without a connection. */
const DELAY_MS = 1200;

export function ConnectionBanner() {
  const { actions, connection } = useModel();
  const [late, setLate] = createSignal(false);
  const isConnected = () => connection().isConnected;
  /** Why the connection was closed stays in sight while the next ones fail. */
  const text = (before = "") => {
    const { reason, signIn } = connection();
    if (signIn !== undefined) return reason;
    if (reason !== undefined) return `Connection closed: ${reason}. Reconnecting`;
    return late() && before !== "" ? before : "No connection to the server. Reconnecting";
  };
  createEffect(() => {
    if (isConnected()) return void setLate(false);
    const timer = setTimeout(() => setLate(true), DELAY_MS);
    onCleanup(() => clearTimeout(timer));
  });
  return (
    <Show when={late() && !isConnected()}>
      <div class="banner" role="status">
        <span>{text()}</span>
        <Show when={connection().signIn}>{(href) => <a href={href()}>Sign in</a>}</Show>
        <Button quiet onClick={actions.retry}>
          Retry now
        </Button>
      </div>
    </Show>
  );
}
