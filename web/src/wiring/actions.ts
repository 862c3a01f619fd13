/** Actions of the user that are events of the state, move the camera, or copy and save something; the app does the others. */

import type { Store } from "../state/store";
import type { UserEvent } from "../state/work";
import { toWire } from "../transfer/model";
import type { Actions } from "../ui/actions";
import type { Model } from "../ui/model";
import { copyCommand, copyOut, downloadMesh } from "../ui/takeAlong";
import { downloadAll } from "./allSurfaces";
import type { Cameras } from "./cameras";
import type { Framing } from "./framing";

/** The app's parts; the page's actions are made before most of them. */
interface Parts {
  readonly store: Store;
  readonly model: Model;
  readonly framing: Framing;
  readonly cameras: Cameras;
  readonly base: URL;
}

const EDITS: readonly UserEvent["type"][] = ["edit", "add", "arrange", "remove"];
const SHARED: readonly UserEvent["type"][] = [...EDITS, "step", "undo", "redo"];

/** Whether the event changes surfaces. */
export const isEdit = ({ type }: UserEvent): boolean => EDITS.includes(type);

/** Whether the event changes what the members of a group see. */
export const isShared = (event: UserEvent): boolean => SHARED.includes(event.type) || (event.type === "page" && event.layers.slicing !== undefined);

type StateNames = "changePage" | "goToStep" | "edit" | "editByOpening" | "editPoints" | "changeLook" | "changeStyle" | "addSurface" | "arrangeSurfaces" | "removeSurface" | "selectSurface" | "endGesture" | "undo" | "redo";

/** @param act dispatches the event and shows what it has changed, if the user may do that */
export function stateActions(store: Store, act: (event: UserEvent) => void): Pick<Actions, StateNames> {
  return {
    changePage: (layers) => act({ type: "page", layers }),
    goToStep: (step, gesture) => act({ type: "step", step, gesture }),
    edit: (edit, gesture) => act({ type: "edit", edit, gesture }),
    editByOpening: (edit) => {
      const { view, state: { opening } } = store;
      if (view !== undefined && opening !== undefined) act({ type: "edit", edit: edit(view, opening) });
    },
    editPoints: (points, gesture) => act({ type: "edit", edit: { transferFunction: toWire(points) }, gesture }),
    changeLook: (look, gesture) => act({ type: "look", look, gesture }),
    changeStyle: (surface, style, gesture) => act({ type: "style", surface, style, gesture }),
    addSurface: (iso) => act({ type: "add", iso }),
    arrangeSurfaces: (arrange) => {
      const { surfaces, state: { opening } } = store;
      const arranged = opening && arrange(surfaces, opening);
      if (arranged !== undefined) act({ type: "arrange", surfaces: arranged });
    },
    removeSurface: (surface) => act({ type: "remove", surface }),
    selectSurface: (surface) => act({ type: "select", surface }),
    endGesture: () => act({ type: "end-gesture" }),
    undo: () => act({ type: "undo" }),
    redo: () => act({ type: "redo" }),
  };
}

type OtherNames = "fit" | "home" | "lookFrom" | "facing" | "colorSpan" | "address" | "copyLink" | "copyCommand" | "downloadAll" | "download";

/** @param address that of the state that is shown */
export function otherActions(parts: () => Parts, address: () => string): Pick<Actions, OtherNames> {
  return {
    fit: () => parts().framing.fit(),
    home: () => parts().framing.home(),
    lookFrom: (axis) => parts().framing.lookFrom(axis),
    colorSpan: (number, of) => parts().framing.colorSpan(number, of),
    facing: (normal) => parts().framing.facing(normal),
    address,
    copyLink: () => void copyOut(parts().model, address(), "Link copied"),
    copyCommand: (cap) => void copyCommand(parts().model, parts().store, parts().cameras.onScreen, cap),
    downloadAll: (cap) => void downloadAll(parts().model, parts().store, parts().base, cap),
    download: (format, cap) => void downloadMesh(parts().model, parts().store, parts().base, format, cap),
  };
}
