/** The inspector's cards, in their order. A further card is a file and a line here. */

import { lazy } from "solid-js";
import { labelFields } from "../../state/labels";
import type { Card } from "./card";
import { detailCard } from "./detail";
import { lookCard } from "./look";
import { mattersCard } from "./matters";
import { numbersCard } from "./numbers";
import { surfaceCard } from "./surface";
import { timeCard } from "./time";

/** Its body is loaded when it is first unfolded. */
function onDemand(card: Omit<Card, "body" | "folded">, load: Parameters<typeof lazy>[0]): Card {
  return { ...card, folded: true, body: lazy(load) };
}

export const CARDS: readonly Card[] = [
  timeCard,
  surfaceCard,
  detailCard,
  mattersCard,
  onDemand({ id: "labels", title: "Labels", icon: "labels", when: ({ volume }) => labelFields(volume()).length > 0, isOfSurface: true }, () => import("./labels")),
  lookCard,
  onDemand({ id: "view", title: "View", icon: "view" }, () => import("./view")),
  onDemand({ id: "clip", title: "Clip", icon: "clip" }, () => import("./clip")),
  onDemand({ id: "slices", title: "Slices", icon: "slices" }, () => import("./slices")),
  onDemand({ id: "volume", title: "Volume", icon: "volume" }, () => import("./volume")),
  onDemand({ id: "measure", title: "Measure", icon: "measure" }, () => import("./measure")),
  onDemand({ id: "compare", title: "Compare", icon: "compare" }, () => import("./compare")),
  onDemand({ id: "story", isLocal: true, title: "Story", icon: "story" }, () => import("./story")),
  onDemand({ id: "out", isLocal: true, title: "Export", icon: "image" }, () => import("./out")),
  onDemand({ id: "jobs", isLocal: true, title: "Batch jobs", icon: "jobs", when: (model) => model.hasJobs() }, () => import("./jobs")),
  onDemand({ id: "together", isLocal: true, title: "Follow me", icon: "together", when: ({ viewer }) => viewer().groups }, () => import("./together")),
  onDemand({ id: "data", isLocal: true, title: "Data", icon: "data" }, () => import("./data")),
  numbersCard,
];
