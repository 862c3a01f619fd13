/** People sign in by an issuer of OpenID Connect: npm's `oidc-provider`, which is certified. */

import assert from "node:assert/strict";
import { generateKeyPairSync } from "node:crypto";
import { once } from "node:events";
import { mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { createServer } from "node:http";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { test } from "node:test";
import Provider from "oidc-provider";
import { makeVolume, MORE, openPage, saveScreenshot, settled, startBrowser, startServer, TIMEOUT_MS } from "./harness.mjs";

const SECRET = "a secret of 32 letters and digits";
/** Groups of the people at the issuer, by their names there. */
const GROUPS = { ann: ["staff"], bob: ["visitors"] };

async function freePort() {
  const probe = createServer().listen(0, "127.0.0.1");
  await once(probe, "listening");
  const { port } = probe.address();
  probe.close();
  return port;
}

/** An issuer that signs by `alg`, for the server at `home`. */
async function startIssuer(home, alg) {
  const port = await freePort();
  const issuer = `http://127.0.0.1:${port}`;
  const kind = alg === "ES256" ? ["ec", { namedCurve: "P-256" }] : ["rsa", { modulusLength: 2048 }];
  const key = generateKeyPairSync(...kind).privateKey.export({ format: "jwk" });
  const provider = new Provider(issuer, {
    clients: [
      {
        client_id: "isopeel",
        client_secret: SECRET,
        redirect_uris: [`${home}api/v1/oidc/callback`],
        post_logout_redirect_uris: [home],
        id_token_signed_response_alg: alg,
      },
    ],
    jwks: { keys: [{ ...key, alg, use: "sig", kid: "1" }] },
    scopes: ["openid", "groups"],
    claims: { openid: ["sub"], groups: ["groups"] },
    conformIdTokenClaims: false,
    cookies: { keys: ["of a test"] },
    findAccount: (_context, accountId) => ({ accountId, claims: () => ({ sub: accountId, groups: GROUPS[accountId] ?? [] }) }),
    enabledJWA: { idTokenSigningAlgValues: [alg] },
  });
  const server = createServer(provider.callback()).listen(port, "127.0.0.1");
  await once(server, "listening");
  return {
    issuer,
    stop: () => {
      server.closeAllConnections();
      server.close();
    },
  };
}

/** Goes through the issuer's pages as that person. */
async function signIn(page, name) {
  await page.getByRole("link", { name: "Sign in" }).click();
  await page.locator("input[name=login]").fill(name);
  await page.locator("input[name=password]").fill("any");
  await page.getByRole("button").first().click();
  // It asks what the server may know.
  await page.getByRole("button", { name: "Continue" }).click();
}

for (const alg of ["RS256", "ES256"])
  test(`people sign in, have the roles of their groups and sign out (${alg})`, { timeout: 4 * TIMEOUT_MS, ...(alg === "ES256" && MORE) }, async () => {
    const volume = makeVolume();
    const port = await freePort();
    const home = `http://localhost:${port}/`;
    const { issuer, stop } = await startIssuer(home, alg);
    const folder = mkdtempSync(join(tmpdir(), "isopeel-browser-"));
    const secret = join(folder, "secret");
    writeFileSync(secret, `${SECRET}\n`);
    const options = ["--public-url", home, "--oidc-issuer", issuer, "--oidc-client-id", "isopeel", "--oidc-client-secret-file", secret];
    const server = await startServer([volume.path], { port, options: [...options, "--oidc-scope", "openid groups", "--oidc-role", "staff=edit"] });
    const browser = await startBrowser();
    try {
      const context = await browser.newContext();
      const { page } = await openPage(context, home);
      await page.getByText("Sign in at 127.0.0.1").waitFor();
      await saveScreenshot(page, "sign-in");
      await signIn(page, "ann");
      await settled(page);
      await page.waitForFunction(() => window.location.hash.startsWith("#v=1&volume=bumpy"));
      const link = page.url();
      assert.equal(await page.evaluate(() => document.cookie), "", "scripts see no cookie");
      // What only who may edit does; exports are for another role.
      const statuses = await page.evaluate(async () => {
        const extract = { method: "POST", headers: { "content-type": "application/json" }, body: '{"volume": "bumpy", "format": "stl"}' };
        return [(await fetch("api/v1/volumes")).status, (await fetch("api/v1/extract", extract)).status];
      });
      assert.deepEqual(statuses, [200, 403]);
      // Signing out closes the stream that is open, in another page too.
      const other = await openPage(context, link);
      await settled(other.page);
      await page.getByRole("button", { name: "Status" }).click();
      await page.getByRole("button", { name: "Sign out" }).click();
      await page.getByRole("button", { name: /yes/i }).click();
      await page.getByText("Sign in at 127.0.0.1").waitFor();
      await other.page.getByText("Sign in at 127.0.0.1").waitFor();

      // Somebody of no group that has a role here.
      await signIn(page, "bob");
      await page.getByText("none of your groups has a role on this server").waitFor();
      assert.ok(!page.url().includes("sign-in-failed"), page.url());
      assert.equal(await page.evaluate(async () => (await fetch("api/v1/volumes")).status), 401);

      // Without the issuer a token lets people in as before.
      stop();
      const withToken = await openPage(await browser.newContext(), home.slice(0, -1) + server.secret);
      await settled(withToken.page);
    } finally {
      await browser.close();
      await server.stop();
      stop();
      volume.remove();
      rmSync(folder, { recursive: true });
    }
  });
