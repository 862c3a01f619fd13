/** Times, bytes and the device, behind a button in the top line. */

import { Popover } from "@kobalte/core/popover";
import { Show } from "solid-js";
import { signOut } from "../net/session";
import { Rows } from "./cards/rows";
import { useModel } from "./model";
import { Button } from "./widgets/button";
import { statusRows } from "./words";

export function StatusPopover() {
  const { connection, viewer } = useModel();
  return (
    <Popover placement="bottom-start" gutter={8}>
      <Popover.Trigger class="status-button" aria-label="Status">
        <span class="dot" />
      </Popover.Trigger>
      <Popover.Portal>
        <Popover.Content class="popover">
          <Popover.Title class="popover-title">Status</Popover.Title>
          <Rows rows={statusRows(viewer())} />
          <Show when={connection().canSignOut}>
            <Button quiet onClick={() => void signOut(new URL(".", window.location.href))}>
              Sign out
            </Button>
          </Show>
        </Popover.Content>
      </Popover.Portal>
    </Popover>
  );
}
