/** A group of viewers who are shown what one of them does: what the page knows of it. Pure. */

import type { Group, ServerMessage } from "../protocol/types";

/** What the user does about the group. */
export type GroupAct =
  /** `free`: the camera is the user's own; `camera`: that of the one in control again. */
  | { readonly type: "start" | "copy" | "leave" | "free" | "camera" }
  | { readonly type: "ask"; readonly asks: boolean }
  | { readonly type: "give"; readonly to: number }
  | { readonly type: "name"; readonly name: string };

/** The group that the page is in. */
export interface GroupState extends Group {
  /** The user turns the camera alone: it does not follow that of the one in control. */
  readonly isApart: boolean;
}

/** Number of the member that has started it. */
export const LEADER = 0;

const NAME = "follow";

/** For those who follow; the server waits half a minute. */
export const AWAY = "The leader’s connection was lost: the group waits for it";

/** Messages that are about a group alone. */
export function isAboutGroup(message: ServerMessage): message is Extract<ServerMessage, { readonly type: "group" | "led" | "posed" | "left" }> {
  return ["group", "led", "posed", "left"].includes(message.type);
}

/** What another member shows is shown. */
export const isLed = (group: Group | undefined) => group !== undefined && group.control !== group.you;

/** The address that others join by. It has no secret but the group's id. `via`: the volume by which a proxy of several servers finds the group's. */
export function groupLink(page: string, group: string, via?: string): string {
  const address = new URL(page);
  address.hash = `${NAME}=${group}${via === undefined ? "" : `&volume=${encodeURIComponent(via)}`}`;
  return address.href;
}

/** The group that an address' hash asks for. */
export function groupOf(hash: string): string | undefined {
  return /^#?follow=([0-9a-f]{32})(?:&volume=[^&]*)?$/.exec(hash)?.[1];
}

/** The volume that an address' hash names, of a link or of a group. */
export function volumeOf(hash: string): string | undefined {
  return new URLSearchParams(hash.replace(/^#/, "")).get("volume") ?? undefined;
}

/** How many follow, in words. */
function followersText(followers: number): string {
  return followers === 0 ? "No followers yet" : followers === 1 ? "1 follower" : `${followers} followers`;
}

/** Who shows and who is shown, in one line. */
export function barText({ you, control, followers, people, isApart }: GroupState): string {
  const count = followersText(followers);
  if (control === you) return you === LEADER ? `You lead · ${count}` : `You have control · ${count}`;
  const holder = control === LEADER ? "the leader" : followerName(people.find(({ number }) => number === control) ?? { number: control, name: null });
  return `Following ${holder}${isApart ? ", free camera" : ""} · ${count}`;
}

export const followerName = ({ number, name }: Pick<Group["people"][number], "number" | "name">) => name ?? `Follower ${number}`;

/** What is new to say of it; `undefined`: nothing. */
export function groupNews(before: Group | undefined, now: Group): string | undefined {
  // The bar names the one in control, and followers that ask for it.
  if (before === undefined) return undefined;
  if (isLed(before) && !isLed(now)) return now.you === LEADER ? "You have control again" : "You have control: the others follow you";
  if (!isLed(before) && isLed(now)) return now.you === LEADER ? "Another has control now" : "The leader has control again";
  return now.you !== LEADER && before.leaderAway && !now.leaderAway ? "The leader is back" : undefined;
}
