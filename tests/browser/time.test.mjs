/** Time steps: moved through by keys, played, kept in link and history; one that appears is shown without a restart. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { makeSteps, openPage, rested, settled, startBrowser, startServer, TIMEOUT_MS } from "./harness.mjs";

test("steps are moved through and played, and a new one appears", { timeout: 2 * TIMEOUT_MS }, async () => {
  const steps = makeSteps(5);
  const [server, browser] = [await startServer([steps.path, "--watch"]), await startBrowser()];
  try {
    const { page, faults, messages } = await openPage(browser, server.url);
    await rested(page);
    const slider = page.getByRole("slider", { name: "Time step", exact: true });
    const step = (wanted) => settled(page, (now, wanted) => now.step === wanted, wanted);
    assert.equal(await slider.getAttribute("aria-valuetext"), "step 10, 1 of 5");
    const first = (await step(0)).triangles;
    await slider.press("ArrowRight");
    await step(1);
    // Half a number changes nothing, and is no error.
    const field = page.getByLabel("Number of the time step, from 1");
    await field.fill("");
    await field.press("Enter");
    await step(1);
    await field.fill("5");
    await field.press("Enter");
    assert.notEqual((await step(4)).triangles, first);
    // The address follows a moment later.
    await page.waitForFunction(() => window.location.hash.includes("step=4"));
    await page.locator(".viewport canvas").press("Control+z");
    await step(1);
    await page.locator(".viewport canvas").press(",");
    assert.equal((await step(0)).triangles, first);

    await page.getByRole("button", { name: "Loop" }).click();
    await page.getByRole("button", { name: "Play", exact: true }).click();
    await step(4);
    await page.getByRole("button", { name: "Play", exact: true }).waitFor();
    const asked = messages.filter(({ type }) => type === "step").map((message) => message.step);
    assert.deepEqual(asked.slice(-4), [1, 2, 3, 4], "one after the other");
    assert.equal(messages.filter(({ type }) => type === "open").length, 1);

    steps.add(5);
    await page.getByText("of 6", { exact: true }).waitFor();
    await page.getByRole("button", { name: "Next time step" }).click();
    await step(5);
    assert.equal(await slider.getAttribute("aria-valuetext"), "step 15, 6 of 6");
    assert.deepEqual(faults, []);
  } finally {
    await browser.close();
    await server.stop();
    steps.remove();
  }
});
