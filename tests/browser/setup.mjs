/** What the tests of a file share: a volume, a server with it, and a browser. */

import { after, before } from "node:test";
import { makeVolume, startBrowser, startServer } from "./harness.mjs";

/**
 * They are there before the first test of the file, and gone after the last.
 *
 * @param make writes a volume or several, and returns their `path` or `paths`, and how they are removed
 * @param options of the server
 * @returns an object that has `volume`, `server` and `browser` while tests run
 */
export function setUp(make = makeVolume, options = {}) {
  const at = {};
  before(async () => {
    at.volume = make();
    at.server = await startServer(at.volume.paths ?? [at.volume.path], options);
    at.browser = await startBrowser();
  });
  after(async () => {
    await at.browser?.close();
    await at.server?.stop();
    at.volume?.remove();
  });
  return at;
}
