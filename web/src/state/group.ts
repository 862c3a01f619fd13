/** A group of viewers who are shown what one of them does: what the page knows of it. Pure. */

import type { Group, ServerMessage } from "../protocol/types";

/** What the user does about the group. */
export type GroupAct =
  | { readonly type: "start" | "copy" | "leave" | "camera" }
  | { readonly type: "ask"; readonly asks: boolean }
  | { readonly type: "give"; readonly to: number }
  | { readonly type: "name"; readonly name: string };

/** The group that the page is in. */
export interface GroupState extends Group {
  /** The user turns the camera alone: it follows nobody. */
  readonly isApart: boolean;
}

/** Number of who has started it. */
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

/** The address that others join by. It has no secret but the group's id. */
export function groupLink(page: string, group: string): string {
  const address = new URL(page);
  address.hash = `${NAME}=${group}`;
  return address.href;
}

/** The group that an address' hash asks for. */
export function groupOf(hash: string): string | undefined {
  return /^#?follow=([0-9a-f]{32})$/.exec(hash)?.[1];
}

/** How many follow, in words. */
export function followersText(followers: number): string {
  return followers === 0 ? "Nobody follows yet" : followers === 1 ? "1 follows" : `${followers} follow`;
}

export const followerName = ({ number, name }: Group["people"][number]) => name ?? `Follower ${number}`;

/** What is new to say of it; `undefined`: nothing. */
export function groupNews(before: Group | undefined, now: Group): string | undefined {
  if (before === undefined) return now.you === LEADER ? undefined : "You follow now: the picture and the camera are another's";
  if (isLed(before) && !isLed(now)) return now.you === LEADER ? "You have control again" : "You have control: the others follow you";
  if (!isLed(before) && isLed(now)) return now.you === LEADER ? "Another has control now" : "The leader has control again";
  if (now.you !== LEADER && before.leaderAway !== now.leaderAway) return now.leaderAway ? AWAY : "The leader is back";
  const asked = now.people.find(({ number, asks }) => asks && before.people.every((other) => other.number !== number || !other.asks));
  return asked && `${followerName(asked)} asks for control`;
}
