/** Checks that a layer of src/ uses only those that layers.json allows it, and that no cycle comes in. Part of `npm run lint`. */

import { readFileSync } from "node:fs";

/** Each folder of src/ with the folders it may use, from the bottom up. */
const LAYERS = Object.entries(JSON.parse(readFileSync(new URL("layers.json", import.meta.url), "utf8")));

for (const [i, [layer, uses]] of LAYERS.entries()) {
  const below = LAYERS.slice(0, i).map(([name]) => name);
  const above = uses.filter((name) => !below.includes(name));
  if (above.length > 0) throw new Error(`layers.json: ${layer} uses ${above.join(", ")}, which is not below it`);
}

const layerRules = LAYERS.map(([layer, uses]) => ({
  name: `layer-${layer}`,
  comment: `src/${layer} may use ${uses.length === 0 ? "no other layer" : uses.join(", ")} (layers.json)`,
  severity: "error",
  from: { path: `^src/${layer}/` },
  to: { path: "^(src|test)/", pathNot: `^src/(${[layer, ...uses].join("|")})/` },
}));

export default {
  forbidden: [
    ...layerRules,
    {
      name: "no-file-outside-the-layers",
      comment: "a file of src/ lies in a folder that layers.json names; app.ts and main.ts join the layers",
      severity: "error",
      from: {},
      to: { path: "^src/", pathNot: `^src/((${LAYERS.map(([name]) => name).join("|")})/|(app|main)\\.ts$)` },
    },
    {
      name: "three-in-scene-only",
      severity: "error",
      from: { path: "^src/", pathNot: "^src/scene/" },
      to: { path: "node_modules/(@types/)?three/" },
    },
    { name: "no-cycle", severity: "error", from: {}, to: { circular: true } },
    { name: "no-unresolvable", severity: "error", from: {}, to: { couldNotResolve: true } },
    {
      name: "no-dev-dependency-in-src",
      severity: "error",
      from: { path: "^src/" },
      to: { dependencyTypes: ["npm-dev"], dependencyTypesNot: ["type-only"], pathNot: "node_modules/@types/" },
    },
  ],
  options: {
    doNotFollow: { path: "node_modules" },
    tsPreCompilationDeps: true,
    tsConfig: { fileName: "tsconfig.json" },
    enhancedResolveOptions: { exportsFields: ["exports"], conditionNames: ["import", "types", "default"] },
  },
};
