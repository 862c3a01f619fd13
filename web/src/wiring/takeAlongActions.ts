/** Actions of the buttons that copy or save something: a link, a command line, meshes. */

import type { Store } from "../state/store";
import type { Actions } from "../ui/actions";
import type { Model } from "../ui/model";
import { copyCommand, copyOut, downloadMesh } from "../ui/takeAlong";
import { downloadAll } from "./allSurfaces";

type TakeAlong = Pick<Actions, "address" | "copyLink" | "copyCommand" | "downloadAll" | "download">;

/**
 * @param model as `base` known only after the actions are made
 * @param address that of the state that is shown
 */
export function takeAlongActions(model: () => Model, store: Store, base: () => URL, address: () => string): TakeAlong {
  return {
    address,
    copyLink: () => void copyOut(model(), address(), "Link copied"),
    copyCommand: (cap) => void copyCommand(model(), store, cap),
    downloadAll: (cap) => void downloadAll(model(), store, base(), cap),
    download: (format, cap) => void downloadMesh(model(), store, base(), format, cap),
  };
}
