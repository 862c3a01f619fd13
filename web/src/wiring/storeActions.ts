/** Actions of the user that change the store alone; the app does the others. */

import type { Store } from "../state/store";
import { toWire } from "../transfer/model";
import type { Actions } from "../ui/actions";

type Names =
  | "goToStep"
  | "edit"
  | "editByOpening"
  | "editPoints"
  | "changeLook"
  | "changeStyle"
  | "addSurface"
  | "arrangeSurfaces"
  | "removeSurface"
  | "selectSurface"
  | "endGesture"
  | "undo"
  | "redo";

/**
 * @param change does something, and shows what it has changed
 * @param mayChange whether what is shown is the user's to change; else nothing is done, and it is shown as it is
 * @param mayEdit whether the server lets them change surfaces, if what is shown is theirs
 */
export function storeActions(store: Store, change: (act: () => void) => void, mayChange: () => boolean, mayEdit: () => boolean): Pick<Actions, Names> {
  const changeShown = (act: () => void) => change(mayChange() ? act : () => undefined);
  const editShown = (act: () => void) => change(mayChange() && mayEdit() ? act : () => undefined);
  return {
    goToStep: (step, gesture) => changeShown(() => store.goTo(step, gesture)),
    edit: (edit, gesture) => editShown(() => store.edit(edit, gesture)),
    editByOpening: (edit) => editShown(() => store.view && store.opening && store.edit(edit(store.view, store.opening))),
    editPoints: (points, gesture) => editShown(() => store.edit({ transferFunction: toWire(points) }, gesture)),
    changeLook: (look, gesture) => change(() => store.changeLook(look, gesture)),
    changeStyle: (number, style, gesture) => change(() => store.changeStyle(number, style, gesture)),
    addSurface: (iso) => editShown(() => store.addSurface(iso)),
    arrangeSurfaces: (act) => editShown(() => store.arrangeSurfaces(act)),
    removeSurface: (number) => editShown(() => store.removeSurface(number)),
    selectSurface: (number) => change(() => store.select(number)),
    endGesture: () => change(() => store.endGesture()),
    undo: () => changeShown(() => store.undo()),
    redo: () => changeShown(() => store.redo()),
  };
}
