/** The picture alone, in a frame of another page: no controls, but a way to the whole page. */

import { createSignal } from "solid-js";
import { Announcer } from "./announcer";
import { ConnectionBanner } from "./connectionBanner";
import { Hint } from "./hint";
import { Legend } from "./legend";
import { useModel } from "./model";
import { Notice } from "./notice";
import { Toasts } from "./toasts";

export function EmbeddedPage(props: { readonly viewport: HTMLElement }) {
  const { actions } = useModel();
  /** The address of this state with all controls. */
  const wholePage = () => {
    const address = new URL(actions.address());
    address.search = "";
    return address.href;
  };
  const [address, setAddress] = createSignal(wholePage());
  // The state changes all the time; its address is only needed when the user points at the link or focuses it.
  const renew = () => setAddress(wholePage());
  return (
    <div class="page embedded">
      <main class="picture" aria-label="Surface">
        {props.viewport}
        <Legend />
        <Hint />
        <ConnectionBanner />
        <Notice />
        <Toasts />
        <a class="whole-page" href={address()} target="_blank" rel="noopener" on:pointerenter={renew} on:pointerdown={renew} on:focus={renew}>
          Open in isopeel
        </a>
      </main>
      <Announcer />
    </div>
  );
}
