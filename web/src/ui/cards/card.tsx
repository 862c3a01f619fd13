/** What a card of the inspector is. */

import type { Component } from "solid-js";
import type { Role } from "../../state/roles";
import type { Model } from "../model";
import type { IconName } from "../widgets/icon";

export interface Card {
  /** In `PageLayers` and in the page's structure. */
  readonly id: string;
  readonly title: string;
  readonly icon: IconName;
  /** Shown folded until the user unfolds it. */
  readonly folded?: boolean;
  /** Whether there is such a card for the open volume; without it always. */
  readonly when?: (model: Model) => boolean;
  /** All of it is of use to those alone who have this role. */
  readonly needs?: Role;
  /** It changes nothing that is shown: of use to those too who follow another. */
  readonly isLocal?: boolean;
  /** The card is about the selected surface, and names it if there are several. */
  readonly isOfSurface?: boolean;
  readonly body: Component;
}
