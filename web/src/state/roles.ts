/** What the user may do, by their token. Pure. */

import type { SessionInfo } from "../protocol/types";

/** Those that decide what the page offers. */
export type Role = Exclude<SessionInfo["roles"][number], "view" | "push" | "admin">;

/** Why something is off. */
export const LACKING: Readonly<Record<Role, string>> = {
  edit: "You may only look: to change this takes a token for edit",
  export: "To download meshes takes a token for export",
  upload: "To upload takes a token for upload",
};

/** Whether a role is there; all are while the server has not said which. */
export function has(session: SessionInfo | undefined, role: Role): boolean {
  return session === undefined || session.roles.includes(role);
}
