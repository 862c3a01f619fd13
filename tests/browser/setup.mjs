/** What the tests of a file share: a volume, a server with it, and a browser. */

import { after, beforeEach } from "node:test";
import { makeVolume, startBrowser, startServer } from "./harness.mjs";

/**
 * They are there before the first test of the file that is not skipped, and gone after the last.
 *
 * @param make writes a volume or several, and returns their `path` or `paths`, and how they are removed
 * @param options of the server
 * @returns an object that has `volume`, `server` and `browser` while tests run
 */
export function setUp(make = makeVolume, options = {}) {
  const at = {};
  let started;
  const start = async () => {
    at.volume = make();
    at.server = await startServer(at.volume.paths ?? [at.volume.path], options);
    at.browser = await startBrowser();
  };
  // `before` runs even if all tests of the file are skipped.
  beforeEach(() => (started ??= start()));
  after(async () => {
    await at.browser?.close();
    await at.server?.stop();
    at.volume?.remove();
  });
  return at;
}
