/** WCAG 2.2 AA, by axe. */

const TAGS = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"];

/** Rules that the page as it is now breaks, or a part of it, with the elements. */
export async function violations(page, part = "html") {
  const { AxeBuilder } = await import("@axe-core/playwright");
  // Details of violations alone: those of what passes take axe a third of its time.
  const options = { resultTypes: ["violations"], runOnly: { type: "tag", values: TAGS } };
  // Without a page of its own, which the library else opens to join what it found.
  const { violations } = await new AxeBuilder({ page }).include(part).options(options).setLegacyMode(true).analyze();
  return violations.map(({ id, nodes }) => `${id}: ${nodes.map(({ target, failureSummary }) => `${target} (${failureSummary})`).join("; ")}`);
}
