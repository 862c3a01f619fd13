/** What can be taken along: the link, the command line, and the mesh of what is seen. */

import { DropdownMenu } from "@kobalte/core/dropdown-menu";
import { For, Show } from "solid-js";
import { LACKING } from "../state/roles";
import type { MeshFormat } from "./actions";
import { useModel } from "./model";
import { useSurfaceName, useVisibleCount } from "./surfaceNames";
import { Icon } from "./widgets/icon";

export const FORMATS: readonly { readonly format: MeshFormat; readonly text: string }[] = [
  { format: "glb", text: "GLB, with colours, in metres" },
  { format: "ply", text: "PLY" },
  { format: "stl", text: "STL, for printing" },
  { format: "vtp", text: "VTP, for ParaView" },
];

export function ExportMenu() {
  const model = useModel();
  const { actions, view } = model;
  const mayDownload = () => model.may("export");
  const name = useSurfaceName();
  const visible = useVisibleCount();
  return (
    <DropdownMenu modal={false} placement="bottom-end" gutter={8}>
      <DropdownMenu.Trigger class="icon-button" aria-label="Share and export" title="Share and export">
        <Icon name="share" />
      </DropdownMenu.Trigger>
      <DropdownMenu.Portal>
        <DropdownMenu.Content class="menu">
          <DropdownMenu.Item class="menu-item" disabled={view() === undefined} onSelect={actions.copyLink}>
            Copy link
          </DropdownMenu.Item>
          <DropdownMenu.Item class="menu-item" disabled={view() === undefined} onSelect={() => actions.copyCommand()}>
            Copy as command line
          </DropdownMenu.Item>
          <DropdownMenu.Separator class="menu-separator" />
          <DropdownMenu.Group>
            <DropdownMenu.GroupLabel class="menu-label">Download the mesh{name() && ` of ${name()}`}</DropdownMenu.GroupLabel>
            <For each={FORMATS}>
              {({ format, text }) => (
                <DropdownMenu.Item class="menu-item" disabled={view() === undefined || !mayDownload()} onSelect={() => actions.download(format)}>
                  {text}
                </DropdownMenu.Item>
              )}
            </For>
            <Show when={!mayDownload()}>
              <p class="menu-label">{LACKING.export}</p>
            </Show>
            <Show when={visible() > 1 && mayDownload()}>
              <DropdownMenu.Item class="menu-item" onSelect={() => actions.downloadAll()}>
                {visible() === 2 ? "GLB of both visible surfaces" : `GLB of all ${visible()} visible surfaces`}
              </DropdownMenu.Item>
            </Show>
          </DropdownMenu.Group>
        </DropdownMenu.Content>
      </DropdownMenu.Portal>
    </DropdownMenu>
  );
}
