import { readFileSync } from "node:fs";
import type { IncomingMessage, Server } from "node:http";
import type { Duplex } from "node:stream";
import solid from "vite-plugin-solid";
import { defineConfig } from "vitest/config";
import type { Plugin } from "vite";
import { DOCUMENTS } from "./src/ui/documents.ts";

/** Where `npm run dev` finds a server: `ISOPEEL_SERVER=http://host:port npm run dev`. */
const server = process.env["ISOPEEL_SERVER"] ?? "http://127.0.0.1:8417";

/** `vite --mode fixture` serves the tests' synthetic volume instead of a real server. */
function fixture(): Plugin {
  return {
    name: "isopeel-fixture",
    async configureServer(vite) {
      const { FixtureServer } = (await vite.ssrLoadModule("/test/fixture.ts")) as typeof import("./test/fixture.ts");
      const fixture = new FixtureServer();
      vite.middlewares.use((request, response, next) => {
        if (!fixture.respond(request, response)) next();
      });
      // Vite has a socket of its own on the same server, for hot reloading.
      (vite.httpServer as Server | null)?.on("upgrade", (request: IncomingMessage, socket: Duplex, head: Buffer) => {
        fixture.upgrade(request, socket, head);
      });
    },
  };
}

/** The documentation beside the page, as text that every browser shows. */
function documents(): Plugin {
  return {
    name: "isopeel-documents",
    apply: "build",
    generateBundle() {
      for (const { name } of DOCUMENTS) {
        const source = readFileSync(new URL(`../docs/${name}.md`, import.meta.url), "utf8");
        this.emitFile({ type: "asset", fileName: `docs/${name}.txt`, source });
      }
    },
  };
}

export default defineConfig(({ mode }) => ({
  // Relative addresses: the server may sit behind any path.
  base: "./",
  build: { target: "es2022", chunkSizeWarningLimit: 950 },
  worker: { format: "es" as const },
  // The tests run in Node: without this the components would ask for the browser's files of all packages.
  plugins: [solid({ ssr: mode === "test" }), documents(), ...(mode === "fixture" ? [fixture()] : [])],
  server: mode === "fixture" ? {} : { proxy: { "/api": { target: server, ws: true } } },
  test: { include: ["test/**/*.test.ts"], environment: "node", testTimeout: 30_000 },
}));
