import { defineConfig } from "eslint/config";
import tseslint from "typescript-eslint";

export default defineConfig(
  { ignores: ["dist", "node_modules"] },
  tseslint.configs.strictTypeChecked,
  {
    languageOptions: { parserOptions: { projectService: { allowDefaultProject: ["eslint.config.js"] } } },
    rules: {
      eqeqeq: "error",
      "@typescript-eslint/switch-exhaustiveness-check": "error",
      // Numbers are what most of our messages are made of.
      "@typescript-eslint/restrict-template-expressions": ["error", { allowNumber: true }],
      // `() => doIt()` as a handler and `return done()` as a way out read better than blocks.
      "@typescript-eslint/no-confusing-void-expression": "off",
      "@typescript-eslint/no-unused-vars": ["error", { varsIgnorePattern: "^_", argsIgnorePattern: "^_" }],
    },
  },
  // A function fits on a screen.
  {
    files: ["src/**"],
    ignores: ["src/protocol/generated.ts"],
    rules: {
      "max-lines": ["error", 400],
      "max-lines-per-function": ["error", { max: 60, skipBlankLines: true, skipComments: true }],
    },
  },
  // Plain JavaScript.
  { files: ["*.mjs", ".*.mjs"], extends: [tseslint.configs.disableTypeChecked] },
  // Tests index arrays they have just made.
  { files: ["test/**"], rules: { "@typescript-eslint/no-non-null-assertion": "off" } },
);
